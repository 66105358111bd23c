"""The run time, in C: what a map answers. Not for users: fields of maps are asked in `fieldmap.lookup`.

The C files beside this module are compiled when the package is installed (`fieldmap.core.compile`). They need no other
library, and allocate nothing while they run.
"""

from fieldmap.core.map import CoreMap as CoreMap

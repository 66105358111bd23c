"""The run time, in C: maps, saturating iron, wrenches, least-power currents, controllers, instruments, closed loops.

Not for users: `fieldmap.lookup`, `fieldmap.control` and `fieldmap.dynamics` stand in front. docs/core.md says how to
change it.

The C files beside this module are compiled when the package is installed (`fieldmap.core.compile`). They need no other
library, and allocate nothing while they run.
"""

from fieldmap.core.map import CoreMap as CoreMap

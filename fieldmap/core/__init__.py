"""The run time, in C: maps, saturating iron, wrenches, least-power currents, controllers, instruments, closed loops.

Users call it through `fieldmap.lookup`, `fieldmap.control` and `fieldmap.dynamics`. docs/core.md is its manual.

The C files beside this module are compiled when the package is installed (`fieldmap.core.compile`). The C code needs
no other library, and it allocates nothing while it runs.
"""

from fieldmap.core.map import CoreMap as CoreMap

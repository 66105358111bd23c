"""How kernels are compiled: `njit` of numba, with what all kernels want."""

from functools import partial
from typing import Any

import numba

# Kept in files. Without numba's wrapper for callers in C, which took a seventh of the time of compiling: no kernel has
# such a caller; late_call.py makes C functions of its own.
njit: Any = partial(numba.njit, cache=True, no_cfunc_wrapper=True)

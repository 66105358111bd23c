"""A vector copied into another, number by number.

Kernels call this in the place of `to[:] = values`: for a slice numba compiles what would print two shapes that do not
fit, and links it into the kernel and each that calls it. That takes seconds and half of the size of small kernels.
"""

from fieldmap.kernels.compilation import njit
from fieldmap.typing import Array


@njit(forceinline=True)
def copy_vector(values: Array, to: Array) -> None:
    """Fill to (n,) with the first n of values."""
    for i in range(to.shape[0]):
        to[i] = values[i]

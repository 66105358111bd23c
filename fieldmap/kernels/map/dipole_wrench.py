"""Force and torque on a point dipole, docs/theory/wrench.md (1) and (2), from the field and its gradient at it."""

from typing import Any

from numba import njit

# Without contraction of products and sums: the same bits as the array code of fieldmap.field.dipole_wrench.
_EXACT: dict[str, Any] = {"cache": True, "_nrt": False}


@njit(**_EXACT)
def dipole_wrench(flux, slope, moment, wrench):
    """Fill wrench (6,) with F = (grad B)^T m and T = m x B for flux (3,), slope (3, 3) and moment (3,). Whether the
    shapes fit."""
    if moment.shape[0] != 3 or flux.shape[0] != 3 or slope.shape != (3, 3) or wrench.shape[0] != 6:
        return False
    a, b, c = moment[0], moment[1], moment[2]
    for j in range(3):
        wrench[j] = slope[0, j] * a + slope[1, j] * b + slope[2, j] * c
    wrench[3] = b * flux[2] - c * flux[1]
    wrench[4] = c * flux[0] - a * flux[2]
    wrench[5] = a * flux[1] - b * flux[0]
    return True

"""Cartesian components of axisymmetric fields, from their values in the meridian plane."""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.typing import Array

BLOCK = 64  # points whose meridian fields are evaluated in one vector loop


@inlined
def set_field(out: Array, x: float, y: float, radial: float, axial: float) -> None:
    """Write the field given by B_rho / rho and B_z to out (3,)."""
    out[0] = x * radial
    out[1] = y * radial
    out[2] = axial


@inlined
def set_gradient(out: Array, x: float, y: float, radial: float, dz: float, drho: float, curl: float) -> None:
    """Write the gradient of an axisymmetric field to out (3, 3), eq. (2).

    radial = B_rho / rho, dz = dB_z/dz, drho = dB_z/drho, curl = dB_rho/dz - dB_z/drho (mu0 J inside a
    winding, else 0). div B = 0 gives dB_rho/drho.
    """
    rho2 = x * x + y * y
    stretch = -(2.0 * radial + dz)  # dB_rho/drho - B_rho/rho
    inverse = 1.0 / math.sqrt(rho2) if rho2 > 0.0 else 0.0
    c, s = x * inverse, y * inverse
    out[0, 0] = radial + stretch * c * c
    out[0, 1] = stretch * c * s
    out[0, 2] = (drho + curl) * c
    out[1, 0] = out[0, 1]
    out[1, 1] = radial + stretch * s * s
    out[1, 2] = (drho + curl) * s
    out[2, 0] = drho * c
    out[2, 1] = drho * s
    out[2, 2] = dz


@njit
def meridian_block(points: Array, block: int) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Distances from the axis and heights of the points (n, 3) of one block, and rows for B_rho / rho, B_z, dB_z/dz and
    dB_z/drho there."""
    first, last = block * BLOCK, min(len(points), (block + 1) * BLOCK)
    rows = np.empty((6, last - first))
    rho, z = rows[0], rows[1]
    for i in range(last - first):
        x, y = points[first + i, 0], points[first + i, 1]
        rho[i] = math.sqrt(x * x + y * y)
        z[i] = points[first + i, 2]
    return rho, z, rows[2], rows[3], rows[4], rows[5]


@njit
def set_block(
    block: int,
    points: Array,
    radial: Array,
    axial: Array,
    dz: Array,
    drho: Array,
    field: Array,
    gradient: Array,
) -> None:
    """Write the rows of `meridian_block` to field (n, 3) and, unless it is empty, to gradient (n, 3, 3)."""
    first = block * BLOCK
    for i in range(len(radial)):
        set_field(field[first + i], points[first + i, 0], points[first + i, 1], radial[i], axial[i])
    if len(gradient) > 0:
        for i in range(len(radial)):
            x, y = points[first + i, 0], points[first + i, 1]
            set_gradient(gradient[first + i], x, y, radial[i], dz[i], drho[i], 0.0)

"""From the meridian plane of an axisymmetric source to Cartesian components."""

import math

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
def to_meridian(points: Array, rho: Array, z: Array) -> None:
    """Distance from the axis and height of points (n, 3), written to rho and z."""
    for i in range(len(points)):
        rho[i] = math.sqrt(points[i, 0] * points[i, 0] + points[i, 1] * points[i, 1])
        z[i] = points[i, 2]

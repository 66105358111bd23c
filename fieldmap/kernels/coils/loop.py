"""Flux density and gradient of a circular current loop, centre at the origin, axis along z, per ampere.

The formulas of docs/theory/coils.md (6)-(10): complete elliptic integrals rearranged so that nothing cancels
on the axis, near it, or far away. Singular on the wire (infinite or not a number there).
"""

import math

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.kernels.coils.elliptic import complete_integrals
from fieldmap.kernels.coils.fields import flux_density, flux_density_and_gradient
from fieldmap.kernels.coils.meridian import BLOCK, meridian_block, set_block
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.typing import Array

_WORK = 30.0 * BLOCK


@inlined
def loop_meridian(a: float, rho: float, z: float) -> tuple[float, float, float, float]:
    """(B_rho / rho, B_z, dB_z/dz, dB_z/drho) of a loop of radius a at (rho, z)."""
    a2, rho2, z2 = a * a, rho * rho, z * z
    r2 = rho2 + z2
    q2 = (a + rho) ** 2 + z2
    d2 = (a - rho) ** 2 + z2
    k, s = complete_integrals(4.0 * a * rho / q2, math.sqrt(d2 / q2))
    inverse = 1.0 / q2
    factor = MU0_OVER_2PI * k * a2 / (math.sqrt(q2) * d2)
    radial = factor * z * inverse * (4.0 - 16.0 * (a2 + r2) * inverse * s)
    axial = factor * (2.0 * (a2 + z2 - rho2) * inverse + 16.0 * (r2 - a2) * rho2 * inverse * inverse * s)
    steep = factor * inverse / d2
    p = 6.0 * a2 * (rho2 - z2) - 7.0 * a2 * a2 + r2 * r2
    first = r2 * (5.0 * rho2 - 3.0 * z2) - a2 * (3.0 * a2 + 2.0 * rho2 + 6.0 * z2)
    dz = steep * z * (2.0 * first * inverse - 16.0 * p * rho2 * inverse * inverse * s)
    e = a2 * (a2 * (a2 - rho2 + 2.0 * z2) - rho2 * rho2 - 12.0 * rho2 * z2 + z2 * z2) + rho2 * r2 * r2
    second = a2 * (a2 - 2.0 * r2) + r2 * (rho2 - 3.0 * z2)
    drho = steep * 4.0 * rho * inverse * (second - 4.0 * e * inverse * s)
    return radial, axial, dz, drho


@njit
def _loop_block(a: float, rho: Array, z: Array, radial: Array, axial: Array, dz: Array, drho: Array) -> None:
    for i in range(len(rho)):
        radial[i], axial[i], dz[i], drho[i] = loop_meridian(a, rho[i], z[i])


@njit(nogil=True)
def _loop_rows(begin, end, points, radius, field, gradient):
    for block in range(begin, end):
        rho, z, radial, axial, dz, drho = meridian_block(points, block)
        _loop_block(radius, rho, z, radial, axial, dz, drho)
        set_block(block, points, radial, axial, dz, drho, field, gradient)


def loop_flux_density(points: Array, radius: float) -> Array:
    """B (n, 3) in T/A at points (n, 3) in m."""
    return flux_density(_loop_rows, points, radius, work=_WORK, block=BLOCK)


def loop_flux_density_and_gradient(points: Array, radius: float) -> tuple[Array, Array]:
    """B (n, 3) in T/A at points (n, 3) in m and its gradient (n, 3, 3) in T/(m A)."""
    return flux_density_and_gradient(_loop_rows, points, radius, work=_WORK, block=BLOCK)

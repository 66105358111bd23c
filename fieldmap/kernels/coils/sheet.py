"""Flux density and gradient of a cylindrical current sheet (a thin solenoid), per ampere-turn.

Radius a, |z| <= height/2, centre at the origin, axis along z; one ampere-turn spread evenly over the height.
docs/theory/coils.md (11)-(14): the radial field is the difference of the vector potentials of the two end loops,
the derivative along z the difference of their fields, the axial field the difference of two complete integrals of the
third kind (Derby and Olbert, Am. J. Phys. 78 (2010) 229). Far away, where these differences cancel, loops at
Gauss-Legendre points in z take their place. Singular on the rims; on the sheet itself B_z is the mean of both sides.
"""

import math

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.kernels.coils.elliptic import complete_integrals_three
from fieldmap.kernels.coils.fields import flux_density, flux_density_and_gradient
from fieldmap.kernels.coils.loop import loop_meridian
from fieldmap.kernels.coils.meridian import BLOCK, meridian_block, set_block
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.typing import Array

_WORK = 60.0 * BLOCK
_LOST = 2e3  # factor by which cancellation in closed form may enlarge rounding errors


@inlined
def _end(a: float, rho: float, z: float) -> tuple[float, float, float, float]:
    """The loop at one end: its A_phi/rho, the axial term of eq. (12), its B_rho/rho and B_z."""
    a2, rho2, z2 = a * a, rho * rho, z * z
    q2, d2 = (a + rho) ** 2 + z2, (a - rho) ** 2 + z2
    q = math.sqrt(q2)
    inverse = 1.0 / q2
    k, s, cel = complete_integrals_three(4.0 * a * rho * inverse, math.sqrt(d2) / q, (a - rho) / (a + rho))
    strength = MU0_OVER_2PI * a2 * k * inverse / q
    potential = 16.0 * strength * s
    third = 2.0 * MU0_OVER_2PI * a * z * cel / ((a + rho) * q)
    near = strength / d2
    radial = near * z * (4.0 - 16.0 * (a2 + rho2 + z2) * inverse * s)
    axial = near * (2.0 * (a2 + z2 - rho2) + 16.0 * (rho2 + z2 - a2) * rho2 * inverse * s)
    return potential, third, radial, axial


@inlined
def sheet_meridian(a: float, half: float, rho: float, z: float) -> tuple[float, float, float, float]:
    """(B_rho / rho, B_z, dB_z/dz, dB_z/drho) of the sheet at (rho, z), closed form."""
    upper_potential, upper_third, upper_radial, upper_axial = _end(a, rho, z - half)
    lower_potential, lower_third, lower_radial, lower_axial = _end(a, rho, z + half)
    density = 0.5 / half
    return (
        density * (upper_potential - lower_potential),
        density * (lower_third - upper_third),
        density * (lower_axial - upper_axial),
        density * rho * (lower_radial - upper_radial),
    )


@inlined
def far_points(a: float, half: float, rho: float, z: float) -> int:
    """Gauss-Legendre points in z to use instead of closed form, or 0 where closed form is accurate enough."""
    r2 = rho * rho + z * z
    if r2 * r2 * r2 < (_LOST * half * a * a) ** 2 or r2 < 9.0 * half * half:
        return 0
    return 16 if r2 < 36.0 * half * half else 8


@inlined(fastmath={"reassoc"})
def far_sheet(a: float, half: float, rho: float, z: float, n: int) -> tuple[float, float, float, float]:
    """As `sheet_meridian`, by n loops."""
    radial, axial, dz, drho = 0.0, 0.0, 0.0, 0.0
    start = gauss_start(n)
    for k in range(start, start + n):
        one, two, three, four = loop_meridian(a, rho, z - half * GAUSS_NODES[k])
        weight = 0.5 * GAUSS_WEIGHTS[k]
        radial += weight * one
        axial += weight * two
        dz += weight * three
        drho += weight * four
    return radial, axial, dz, drho


@njit
def _sheet_block(
    a: float, half: float, rho: Array, z: Array, radial: Array, axial: Array, dz: Array, drho: Array
) -> None:
    for i in range(len(rho)):
        radial[i], axial[i], dz[i], drho[i] = sheet_meridian(a, half, rho[i], z[i])


@njit(nogil=True)
def _sheet_rows(begin, end, points, radius, height, field, gradient):
    half = 0.5 * height
    for block in range(begin, end):
        rho, z, radial, axial, dz, drho = meridian_block(points, block)
        _sheet_block(radius, half, rho, z, radial, axial, dz, drho)
        for i in range(len(rho)):
            n = far_points(radius, half, rho[i], z[i])
            if n > 0:
                radial[i], axial[i], dz[i], drho[i] = far_sheet(radius, half, rho[i], z[i], n)
        set_block(block, points, radial, axial, dz, drho, field, gradient)


def sheet_flux_density(points: Array, radius: float, height: float) -> Array:
    """B (n, 3) in T per ampere-turn at points (n, 3) in m."""
    return flux_density(_sheet_rows, points, radius, height, work=_WORK, block=BLOCK)


def sheet_flux_density_and_gradient(points: Array, radius: float, height: float) -> tuple[Array, Array]:
    """B (n, 3) in T and its gradient (n, 3, 3) in T/m, per ampere-turn, at points (n, 3) in m."""
    return flux_density_and_gradient(_sheet_rows, points, radius, height, work=_WORK, block=BLOCK)

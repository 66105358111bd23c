"""Flux density and gradient of a circular current loop, centre at the origin, axis along z, per ampere.

The formulas of docs/theory/coils.md (6)-(10): complete elliptic integrals rearranged so that nothing cancels
on the axis, near it, or far away. Singular on the wire (infinite or not a number there).
"""

import math

import numpy as np

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.kernels.coils.elliptic import complete_integrals
from fieldmap.kernels.coils.meridian import BLOCK, set_field, set_gradient, to_meridian
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.threads import over_rows
from fieldmap.typing import Array


@inlined
def loop_meridian(a: float, rho: float, z: float) -> tuple[float, float]:
    """(B_rho / rho, B_z) of a loop of radius a at (rho, z), T/A and T/(m A)."""
    a2, rho2, z2 = a * a, rho * rho, z * z
    q2 = (a + rho) ** 2 + z2
    d2 = (a - rho) ** 2 + z2
    k, s = complete_integrals(4.0 * a * rho / q2, math.sqrt(d2 / q2))
    inverse = 1.0 / q2
    factor = MU0_OVER_2PI * k * a2 / (math.sqrt(q2) * d2)
    radial = factor * z * inverse * (4.0 - 16.0 * (a2 + rho2 + z2) * inverse * s)
    axial = factor * (
        2.0 * (a2 + z2 - rho2) * inverse + 16.0 * (rho2 + z2 - a2) * rho2 * inverse * inverse * s
    )
    return radial, axial


@inlined
def loop_meridian_gradient(a: float, rho: float, z: float) -> tuple[float, float, float, float]:
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
def _loop_block(a: float, rho: Array, z: Array, radial: Array, axial: Array) -> None:
    for i in range(len(rho)):
        radial[i], axial[i] = loop_meridian(a, rho[i], z[i])


@njit
def _loop_gradient_block(
    a: float, rho: Array, z: Array, radial: Array, axial: Array, dz: Array, drho: Array
) -> None:
    for i in range(len(rho)):
        radial[i], axial[i], dz[i], drho[i] = loop_meridian_gradient(a, rho[i], z[i])


@njit(nogil=True)
def _loop_flux_density_rows(begin, end, points, radius, field):
    count = len(points)
    for block in range(begin, end):
        first, last = block * BLOCK, min(count, (block + 1) * BLOCK)
        here, B = points[first:last], field[first:last]
        work = np.empty((4, last - first))
        rho, z, radial, axial = work[0], work[1], work[2], work[3]
        to_meridian(here, rho, z)
        _loop_block(radius, rho, z, radial, axial)
        for i in range(last - first):
            set_field(B[i], here[i, 0], here[i, 1], radial[i], axial[i])


def loop_flux_density(points: Array, radius: float) -> Array:
    """B (n, 3) in T/A at points (n, 3) in m."""
    count = len(points)
    field = np.empty((count, 3))
    over_rows(_loop_flux_density_rows, (count + BLOCK - 1) // BLOCK, points, radius, field, work=20.0 * BLOCK)
    return field


@njit(nogil=True)
def _loop_flux_density_and_gradient_rows(begin, end, points, radius, field, gradient):
    count = len(points)
    for block in range(begin, end):
        first, last = block * BLOCK, min(count, (block + 1) * BLOCK)
        here, B, G = points[first:last], field[first:last], gradient[first:last]
        work = np.empty((6, last - first))
        rho, z, radial, axial, dz, drho = work[0], work[1], work[2], work[3], work[4], work[5]
        to_meridian(here, rho, z)
        _loop_gradient_block(radius, rho, z, radial, axial, dz, drho)
        for i in range(last - first):
            set_field(B[i], here[i, 0], here[i, 1], radial[i], axial[i])
            set_gradient(G[i], here[i, 0], here[i, 1], radial[i], dz[i], drho[i], 0.0)


def loop_flux_density_and_gradient(points: Array, radius: float) -> tuple[Array, Array]:
    """B (n, 3) in T/A at points (n, 3) in m and its gradient (n, 3, 3) in T/(m A)."""
    count = len(points)
    field, gradient = np.empty((count, 3)), np.empty((count, 3, 3))
    over_rows(
        _loop_flux_density_and_gradient_rows,
        (count + BLOCK - 1) // BLOCK,
        points,
        radius,
        field,
        gradient,
        work=30.0 * BLOCK,
    )
    return field, gradient

"""Flux density and gradient of a circular current loop, centre at the origin, axis along z, per ampere.

The formulas of docs/theory/coils.md (6)-(10): complete elliptic integrals rearranged so that nothing cancels
on the axis, near it, or far away. Singular on the wire (infinite or not a number there).
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.constants import MU0_OVER_2PI
from fieldmap.kernels.elliptic import complete_integrals

Array = NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
def loop_potential(a: float, rho: float, z: float) -> float:
    """A_phi / rho of a loop of radius a, T/A: the vector potential of docs/theory/coils.md (6)."""
    q2 = (a + rho) ** 2 + z * z
    d2 = (a - rho) ** 2 + z * z
    k, s = complete_integrals(4.0 * a * rho / q2, math.sqrt(d2 / q2))
    return MU0_OVER_2PI * 16.0 * a * a * k * s / (q2 * math.sqrt(q2))


@numba.njit(cache=True, error_model="numpy")
def add_meridian(out: Array, x: float, y: float, radial: float, axial: float) -> None:
    """Add a field given by B_rho / rho and B_z to out (3,)."""
    out[0] += x * radial
    out[1] += y * radial
    out[2] += axial


@numba.njit(cache=True, error_model="numpy")
def add_meridian_gradient(
    out: Array, x: float, y: float, radial: float, dz: float, drho: float, curl: float
) -> None:
    """Add the gradient of an axisymmetric field to out (3, 3).

    radial = B_rho / rho, dz = dB_z/dz, drho = dB_z/drho, curl = dB_rho/dz - dB_z/drho (mu0 J inside a
    winding, else 0). div B = 0 gives dB_rho/drho.
    """
    rho = math.sqrt(x * x + y * y)
    cosine, sine = 1.0, 0.0
    if rho > 0.0:
        cosine, sine = x / rho, y / rho
    stretch = -2.0 * radial - dz  # dB_rho/drho - B_rho/rho
    out[0, 0] += radial + stretch * cosine * cosine
    out[1, 1] += radial + stretch * sine * sine
    out[0, 1] += stretch * cosine * sine
    out[1, 0] += stretch * cosine * sine
    out[0, 2] += (drho + curl) * cosine
    out[1, 2] += (drho + curl) * sine
    out[2, 0] += drho * cosine
    out[2, 1] += drho * sine
    out[2, 2] += dz


@numba.njit(cache=True, parallel=True, error_model="numpy")
def loop_flux_density(points: Array, radius: float) -> Array:
    """B (n, 3) in T/A at points (n, 3) in m of a loop of the given radius."""
    field = np.zeros((len(points), 3))
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        radial, axial = loop_meridian(radius, math.sqrt(x * x + y * y), z)
        add_meridian(field[i], x, y, radial, axial)
    return field


@numba.njit(cache=True, parallel=True, error_model="numpy")
def loop_flux_density_and_gradient(points: Array, radius: float) -> tuple[Array, Array]:
    """B (n, 3) in T/A and its gradient (n, 3, 3) in T/(m A) of a loop of the given radius."""
    field = np.zeros((len(points), 3))
    gradient = np.zeros((len(points), 3, 3))
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        radial, axial, dz, drho = loop_meridian_gradient(radius, math.sqrt(x * x + y * y), z)
        add_meridian(field[i], x, y, radial, axial)
        add_meridian_gradient(gradient[i], x, y, radial, dz, drho, 0.0)
    return field, gradient

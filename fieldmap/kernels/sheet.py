"""Flux density and gradient of a cylindrical current sheet (a thin solenoid), per ampere-turn.

Radius a, |z| <= height/2, centre at the origin, axis along z; one ampere-turn spread evenly over the height.
The formulas of docs/theory/coils.md (11)-(14): the radial field is the difference of the vector potentials of
the two end loops, the derivative along z the difference of their fields, the axial field two of Bulirsch's
integrals (Derby and Olbert, Am. J. Phys. 78 (2010) 229). Far away, where those differences cancel, Gauss-Legendre
points in z take their place. Singular on the two rims; on the sheet itself B_z is the mean of both sides.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.constants import MU0_OVER_2PI
from fieldmap.kernels.elliptic import bulirsch_cel
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.kernels.loop import (
    add_meridian,
    add_meridian_gradient,
    loop_meridian,
    loop_meridian_gradient,
    loop_potential,
)

Array = NDArray[np.float64]
_FAR = 3.0  # distance over half height from which points in z are used
_FAR_POINTS = 10  # (1/3)^20 = 3e-10 in the worst direction, before the even terms that cancel


@numba.njit(cache=True, error_model="numpy")
def _far_points(a: float, half: float, rho: float, z: float) -> int:
    """Gauss-Legendre points in z for an error of 1e-14, or 0 where closed form is better."""
    distance = math.sqrt((rho - a) ** 2 + z * z) / half
    if distance < _FAR:
        return 0
    # singularity at (z +- i |rho - a|) / half from the middle of the sheet: Bernstein ellipse at least this large
    spread = distance - 1.0 / distance + math.sqrt(distance * distance - 1.0)
    return min(24, int(16.2 / math.log(spread)) + 1)


@numba.njit(cache=True, error_model="numpy")
def _end(a: float, rho: float, z: float) -> float:
    """The term of one end in the axial field, docs/theory/coils.md (12)."""
    q = math.sqrt((a + rho) ** 2 + z * z)
    kc = math.sqrt((a - rho) ** 2 + z * z) / q
    g = (a - rho) / (a + rho)
    return z / q * bulirsch_cel(kc, g * g, 1.0, g)


@numba.njit(cache=True, error_model="numpy")
def sheet_meridian(a: float, half: float, rho: float, z: float) -> tuple[float, float]:
    """(B_rho / rho, B_z) of a sheet of radius a and half height `half` at (rho, z), per ampere-turn."""
    n = _far_points(a, half, rho, z)
    radial, axial = 0.0, 0.0
    if n > 0:
        start = gauss_start(n)
        for k in range(start, start + n):
            one, two = loop_meridian(a, rho, z - half * GAUSS_NODES[k])
            radial += 0.5 * GAUSS_WEIGHTS[k] * one
            axial += 0.5 * GAUSS_WEIGHTS[k] * two
        return radial, axial
    density = 0.5 / half
    radial = density * (loop_potential(a, rho, z - half) - loop_potential(a, rho, z + half))
    axial = density * 2.0 * MU0_OVER_2PI * a / (a + rho) * (_end(a, rho, z + half) - _end(a, rho, z - half))
    return radial, axial


@numba.njit(cache=True, error_model="numpy")
def sheet_meridian_gradient(a: float, half: float, rho: float, z: float) -> tuple[float, float, float, float]:
    """(B_rho / rho, B_z, dB_z/dz, dB_z/drho) of the sheet at (rho, z), per ampere-turn."""
    n = _far_points(a, half, rho, z)
    if n > 0:
        radial, axial, dz, drho = 0.0, 0.0, 0.0, 0.0
        start = gauss_start(n)
        for k in range(start, start + n):
            one, two, three, four = loop_meridian_gradient(a, rho, z - half * GAUSS_NODES[k])
            radial += 0.5 * GAUSS_WEIGHTS[k] * one
            axial += 0.5 * GAUSS_WEIGHTS[k] * two
            dz += 0.5 * GAUSS_WEIGHTS[k] * three
            drho += 0.5 * GAUSS_WEIGHTS[k] * four
        return radial, axial, dz, drho
    radial, axial = sheet_meridian(a, half, rho, z)
    density = 0.5 / half
    upper_radial, upper_axial = loop_meridian(a, rho, z - half)
    lower_radial, lower_axial = loop_meridian(a, rho, z + half)
    dz = density * (lower_axial - upper_axial)
    drho = density * rho * (lower_radial - upper_radial)
    return radial, axial, dz, drho


@numba.njit(cache=True, parallel=True, error_model="numpy")
def sheet_flux_density(points: Array, radius: float, height: float) -> Array:
    """B (n, 3) in T per ampere-turn at points (n, 3) in m."""
    field = np.zeros((len(points), 3))
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        radial, axial = sheet_meridian(radius, 0.5 * height, math.sqrt(x * x + y * y), z)
        add_meridian(field[i], x, y, radial, axial)
    return field


@numba.njit(cache=True, parallel=True, error_model="numpy")
def sheet_flux_density_and_gradient(points: Array, radius: float, height: float) -> tuple[Array, Array]:
    """B (n, 3) in T and its gradient (n, 3, 3) in T/m per ampere-turn."""
    field = np.zeros((len(points), 3))
    gradient = np.zeros((len(points), 3, 3))
    for i in numba.prange(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        radial, axial, dz, drho = sheet_meridian_gradient(radius, 0.5 * height, math.sqrt(x * x + y * y), z)
        add_meridian(field[i], x, y, radial, axial)
        add_meridian_gradient(gradient[i], x, y, radial, dz, drho, 0.0)
    return field, gradient

"""Flux density and gradient of a circular winding of rectangular section, per ampere-turn.

inner <= r <= outer, |z| <= height/2, axis along z, uniform current density. Slices are summed over half the circle,
from the field point's own azimuth on. Azimuths have equal steps where the integrand is smooth (the error of a periodic
function falls exponentially), and are graded towards a field point that is near: docs/theory/coils.md (21)-(23).
"""

import math

import numpy as np

from fieldmap.constants import MU0_OVER_4PI
from fieldmap.kernels.coils.arc import MOST_AZIMUTHS, arc_integrals, graded_panel, nearness
from fieldmap.kernels.coils.fields import flux_density, flux_density_and_gradient
from fieldmap.kernels.coils.filament import far_distance
from fieldmap.kernels.coils.meridian import set_field, set_gradient
from fieldmap.kernels.coils.quadrature import MARGIN, STEP, Section, rule_limits
from fieldmap.kernels.compilation import njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.typing import Array

_WORK = 400.0  # of one point: some microseconds
_MOST_EQUAL = 24


@njit
def _equal_tables() -> Array:
    """tables (3, 3, 24): cosine, sine and weight of 8, 16, 24 equal steps of half a circle."""
    tables = np.empty((3, 3, _MOST_EQUAL))
    for k in range(3):
        n = STEP * (k + 1)
        for i in range(n):
            angle = math.pi * (i + 0.5) / n
            tables[k, 0, i] = math.cos(angle)
            tables[k, 1, i] = math.sin(angle)
            tables[k, 2, i] = math.pi / n
    return tables


@njit
def _equal_points(nearness2: float, digits: float) -> int:
    """Equal steps whose error exp(-2 n depth), sinh(depth/2) = sqrt(nearness2), is small enough; 0: too many."""
    for k in range(_MOST_EQUAL // STEP):
        n = STEP * (k + 1)
        bound = math.sinh(math.log(10.0) * (digits + MARGIN + 1.0) / (4.0 * n))
        if nearness2 >= bound * bound:
            return n
    return 0


@njit
def _opposite_panel(azimuths: Array, first: int, digits: float) -> int:
    """Gauss-Legendre points on the half of the azimuths away from the point."""
    n = 8 if digits < 10.1 else 16
    start = gauss_start(n)
    for k in range(n):
        angle = 0.25 * math.pi * (3.0 + GAUSS_NODES[start + k])
        azimuths[0, first + k] = math.cos(angle)
        azimuths[1, first + k] = math.sin(angle)
        azimuths[2, first + k] = 0.25 * math.pi * GAUSS_WEIGHTS[start + k]
    return first + n


@njit
def ring_azimuths(
    rho: float, section: Section, tables: Array, limits: Array, digits: float, azimuths: Array
) -> int:
    """Choose the azimuths for a point at distance rho from the axis; fill azimuths (3, :); returns how many."""
    nearness2, inside = nearness(rho, section)
    n = 0 if inside else _equal_points(nearness2, digits)
    if n > 0:
        for row in range(3):
            for k in range(n):
                azimuths[row, k] = tables[n // STEP - 1, row, k]
        return n
    kappa = math.sqrt(nearness2 / (1.0 + nearness2))
    n = graded_panel(azimuths, 0, 0.0, 1.0, kappa, 1.0, 0.0, limits)
    return _opposite_panel(azimuths, n, digits)


@njit(nogil=True)
def _ring_rows(begin, end, points, inner, outer, height, digits, field, gradient):
    half = 0.5 * height
    factor = 2.0 * MU0_OVER_4PI / ((outer - inner) * height)
    limits, tables = rule_limits(digits), _equal_tables()
    size = math.sqrt(outer * outer + half * half)
    far = far_distance(size, (outer - inner) * height * outer * outer, digits)
    azimuths = np.empty((3, MOST_AZIMUTHS))
    for i in range(begin, end):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        rho = math.sqrt(x * x + y * y)
        distance = math.sqrt(rho * rho + z * z)
        gap = distance - size if distance > far else 0.0
        section = (inner, outer, z + half, z - half)
        n = ring_azimuths(rho, section, tables, limits, digits, azimuths)
        r = arc_integrals(azimuths, n, rho, 0.0, section, gap, digits)
        set_field(field[i], x, y, factor * r[0] / max(rho, 1e-300), factor * r[2])
        if len(gradient) > 0:
            within = inner < rho < outer and abs(z) < half
            curl = 2.0 * math.pi if within else 0.0
            around = factor * r[7]  # B_rho / rho, also on the axis
            dz = -factor * (r[3] + r[7])
            set_gradient(gradient[i], x, y, around, dz, factor * (r[5] - curl), factor * curl)


def ring_flux_density(points: Array, inner: float, outer: float, height: float, digits: float) -> Array:
    """B (n, 3) in T per ampere-turn at points (n, 3) in m, to about `digits` digits."""
    return flux_density(_ring_rows, points, inner, outer, height, digits, work=_WORK)


def ring_flux_density_and_gradient(
    points: Array, inner: float, outer: float, height: float, digits: float
) -> tuple[Array, Array]:
    """B (n, 3) in T and its gradient (n, 3, 3) in T/m, per ampere-turn, at points (n, 3) in m."""
    return flux_density_and_gradient(_ring_rows, points, inner, outer, height, digits, work=_WORK)

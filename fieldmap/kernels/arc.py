"""Field integrals of a circular arc of rectangular section: slices summed over the azimuth.

Frame: centre of the arc at the origin, axis along z; r1 <= r <= r2; the middle of the arc is at the azimuth `middle`
as seen from the field point (which has azimuth 0), its half angle is `span` <= pi/2; current counter-clockwise,
density 1. Results are along (rho, azimuth, z) of the field point and lack the factor mu0/(4 pi) times the density.
An arc alone is no closed current: its field is of use only in the sum over a closed path.
"""

import math

import numba

from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.kernels.quadrature import points_even, points_sinh, section_distance, whole_points
from fieldmap.kernels.slice import arc_slice, arc_slice_gradient

_NEAREST = 1e-9  # of the arc's radius: a point on the very surface is treated as that far from it
_DEEPEST = 2.0  # the growth of sine and cosine limits the useful ellipse


@numba.njit(cache=True, error_model="numpy")
def nearness(rho: float, r1: float, r2: float, h1: float, h2: float) -> tuple[float, bool]:
    """kappa of eq. (21), the integrand being singular at tan(psi/2) = +- i kappa, and whether the point is inside."""
    distance, inside = section_distance(rho, r1, r2, h1, h2)
    distance = max(distance, _NEAREST * r2)
    d2 = distance * distance
    return math.sqrt(d2 / (d2 + 4.0 * rho * min(max(rho, r1), r2))), inside


@numba.njit(cache=True, error_model="numpy")
def choose_rule(middle: float, span: float, kappa: float, digits: float) -> tuple[int, bool, float, float]:
    """(points, whether sinh, middle and half width of the range of the variable) for azimuths middle +- span."""
    depth = min(2.0 * math.atanh(min(kappa, 0.999)), _DEEPEST)
    even = points_even(abs(middle), depth, span, digits)
    if abs(middle) + span < 3.0 and even > 4.0:
        w1 = math.asinh(math.tan(0.5 * (middle - span)) / kappa)
        w2 = math.asinh(math.tan(0.5 * (middle + span)) / kappa)
        graded = points_sinh(0.5 * (w2 - w1), digits)
        if graded < even:
            return whole_points(graded), True, 0.5 * (w1 + w2), 0.5 * (w2 - w1)
    return whole_points(even), False, middle, span


@numba.njit(cache=True, error_model="numpy")
def azimuth(w: float, sinh: bool, kappa: float) -> tuple[float, float, float]:
    """(cosine, sine, dpsi/dw) of the azimuth psi at the variable w."""
    if not sinh:
        return math.cos(w), math.sin(w), 1.0
    e = math.exp(w)
    t = 0.5 * kappa * (e - 1.0 / e)
    turn = 1.0 / (1.0 + t * t)
    return (1.0 - t * t) * turn, 2.0 * t * turn, kappa * (e + 1.0 / e) * turn


@numba.njit(cache=True, error_model="numpy")
def arc_panel(
    rho: float,
    middle: float,
    span: float,
    kappa: float,
    section: tuple[float, float, float, float],
    digits: float,
) -> tuple[float, float, float]:
    """Field integrals along (rho, azimuth, z) over azimuths middle +- span."""
    r1, r2, h1, h2 = section
    n, sinh, centre, half = choose_rule(middle, span, kappa, digits)
    radial, around, upward = 0.0, 0.0, 0.0
    start = gauss_start(n)
    for k in range(start, start + n):
        c, s, stretch = azimuth(centre + half * GAUSS_NODES[k], sinh, kappa)
        weight = half * GAUSS_WEIGHTS[k] * stretch
        outward, axial = arc_slice(rho * c, -rho * s, r1, r2, h1, h2)
        radial += weight * c * outward
        around += weight * s * outward
        upward += weight * axial
    return radial, around, upward


@numba.njit(cache=True, error_model="numpy")
def arc_panel_gradient(
    rho: float,
    middle: float,
    span: float,
    kappa: float,
    section: tuple[float, float, float, float],
    digits: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Field integrals (rho, azimuth, z); then d(rho, azimuth part)/d(rho, azimuth, z), row by row."""
    r1, r2, h1, h2 = section
    n, sinh, centre, half = choose_rule(middle, span, kappa, digits)
    radial, around, upward = 0.0, 0.0, 0.0
    g00, g01, g02, g10, g11, g12 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    start = gauss_start(n)
    for k in range(start, start + n):
        c, s, stretch = azimuth(centre + half * GAUSS_NODES[k], sinh, kappa)
        weight = half * GAUSS_WEIGHTS[k] * stretch
        outward, axial, dX, dv, dz = arc_slice_gradient(rho * c, -rho * s, r1, r2, h1, h2)
        along_rho, along_azimuth = c * dX - s * dv, s * dX + c * dv
        upward += weight * axial
        c *= weight
        s *= weight
        radial += c * outward
        around += s * outward
        g00 += c * along_rho
        g01 += c * along_azimuth
        g02 += c * dz
        g10 += s * along_rho
        g11 += s * along_azimuth
        g12 += s * dz
    return radial, around, upward, g00, g01, g02, g10, g11, g12


@numba.njit(cache=True, error_model="numpy")
def arc_integrals(
    rho: float, middle: float, span: float, r1: float, r2: float, h1: float, h2: float, digits: float
) -> tuple[float, float, float]:
    """Field integrals (rho, azimuth, z) of an arc; two panels where the point is inside the winding."""
    section = (r1, r2, h1, h2)
    kappa, inside = nearness(rho, r1, r2, h1, h2)
    if not inside or abs(middle) >= span:
        return arc_panel(rho, middle, span, kappa, section, digits)
    low, high = middle - span, middle + span
    a = arc_panel(rho, 0.5 * low, -0.5 * low, kappa, section, digits)
    b = arc_panel(rho, 0.5 * high, 0.5 * high, kappa, section, digits)
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@numba.njit(cache=True, error_model="numpy")
def arc_integrals_gradient(
    rho: float, middle: float, span: float, r1: float, r2: float, h1: float, h2: float, digits: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """`arc_panel_gradient` of an arc; two panels where the point is inside the winding."""
    section = (r1, r2, h1, h2)
    kappa, inside = nearness(rho, r1, r2, h1, h2)
    if not inside or abs(middle) >= span:
        return arc_panel_gradient(rho, middle, span, kappa, section, digits)
    low, high = middle - span, middle + span
    a = arc_panel_gradient(rho, 0.5 * low, -0.5 * low, kappa, section, digits)
    b = arc_panel_gradient(rho, 0.5 * high, 0.5 * high, kappa, section, digits)
    return (
        a[0] + b[0],
        a[1] + b[1],
        a[2] + b[2],
        a[3] + b[3],
        a[4] + b[4],
        a[5] + b[5],
        a[6] + b[6],
        a[7] + b[7],
        a[8] + b[8],
    )

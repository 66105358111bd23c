"""Field integrals of a circular arc of rectangular section: slices summed over the azimuth.

Frame of an arc: its centre is the origin, its middle on the first axis; |azimuth| <= span <= pi/4, r1 <= r <= r2,
heights h1 > h2 of the field point over the section's ends; current counter-clockwise, density 1. Results lack the
factor mu0/(4 pi) times the density. An arc alone is no closed current: its field is of use only in the sum over a
closed path.
"""

import math
from collections.abc import Callable
from typing import Any

from fieldmap.kernels.coils.elementary import exp
from fieldmap.kernels.coils.filament import filament, filament_slice, section_points
from fieldmap.kernels.coils.quadrature import Section, even_points, graded_points, section_distance
from fieldmap.kernels.coils.slice import arc_slice
from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.typing import Array

ArcIntegrals = tuple[float, float, float, float, float, float, float, float, float]

MOST_EVEN = 16
MOST_AZIMUTHS = 128  # two panels of the longest rule
_NEAREST = 1e-9  # of the outer radius: least distance of a point from the surface of the section


@njit
def even_azimuths(span: float, table: Array) -> None:
    """Fill table (3, 25): cosine, sine, weight of the rules with 8 and 16 points on |azimuth| <= span.

    The last column holds cos(span), sin(span), 4 sin(span/2).
    """
    table[0, 24], table[1, 24], table[2, 24] = math.cos(span), math.sin(span), 4.0 * math.sin(0.5 * span)
    for n, first in ((8, 0), (16, 8)):
        start = gauss_start(n)
        for k in range(n):
            table[0, first + k] = math.cos(span * GAUSS_NODES[start + k])
            table[1, first + k] = math.sin(span * GAUSS_NODES[start + k])
            table[2, first + k] = span * GAUSS_WEIGHTS[start + k]


@inlined
def _arc_ellipse(cp: float, cm: float, nearness2: float, chords: float) -> float:
    """(|z-1| + |z+1|)/2 of the integrand's singularity, z in units of the half angle, eq. (22).

    cp, cm: cosines of the angles from the point to the ends; nearness2: (distance / 2)^2 / (rho r);
    chords: 4 sin(half angle / 2).
    """
    depth2 = 4.0 * nearness2 / (1.0 + nearness2 / 3.0)
    ends = math.sqrt(2.0 * (1.0 - cp) + depth2) + math.sqrt(2.0 * (1.0 - cm) + depth2)
    return ends / chords


@inlined
def nearness(rho: float, section: Section) -> tuple[float, bool]:
    """(distance / 2)^2 / (rho r) of a point at rho from the axis of an arc, and whether it lies inside the section."""
    distance, inside = section_distance(rho, section)
    r1, r2 = section[0], section[1]
    distance = max(distance, _NEAREST * r2)
    return 0.25 * distance * distance / max(rho * min(max(rho, r1), r2), 1e-300), inside


@inlined
def graded_panel(
    azimuths: Array, first: int, t1: float, t2: float, kappa: float, cosine: float, sine: float, limits: Array
) -> int:
    """Fill azimuths (3, :) from `first` with points graded towards the field point; returns where they end.

    The azimuth psi from the point has tan(psi/2) = kappa sinh(w) in [t1, t2]; (cosine, sine) is the azimuth of the
    point itself in the frame of the result.
    """
    w1, w2 = math.asinh(t1 / kappa), math.asinh(t2 / kappa)
    middle, half = 0.5 * (w1 + w2), 0.5 * (w2 - w1)
    n = graded_points(half, limits)
    start = gauss_start(n)
    for k in range(n):
        e = exp(middle + half * GAUSS_NODES[start + k])
        t = 0.5 * kappa * (e - 1.0 / e)
        turn = 1.0 / (1.0 + t * t)
        c, s = (1.0 - t * t) * turn, 2.0 * t * turn
        azimuths[0, first + k] = cosine * c - sine * s
        azimuths[1, first + k] = sine * c + cosine * s
        azimuths[2, first + k] = half * GAUSS_WEIGHTS[start + k] * kappa * (e + 1.0 / e) * turn
    return first + n


@inlined
def arc_azimuths(px: float, py: float, section: Section, even: Array, limits: Array, azimuths: Array) -> int:
    """Choose the azimuths for a field point (px, py) of the arc's frame; fill azimuths (3, :); returns how many."""
    rho = math.sqrt(px * px + py * py)
    cosine, sine = 1.0, 0.0
    if rho > 0.0:
        cosine, sine = px / rho, py / rho
    nearness2, inside = nearness(rho, section)
    c0, s0 = even[0, 24], even[1, 24]
    # angles from the point to the ends: span - theta and -span - theta
    cp, sp = c0 * cosine + s0 * sine, s0 * cosine - c0 * sine
    cm, sm = c0 * cosine - s0 * sine, -s0 * cosine - c0 * sine
    within = cosine > c0
    if not (inside and within):
        n = even_points(_arc_ellipse(cp, cm, nearness2, even[2, 24]), limits, MOST_EVEN)
        if n == 0 and min(cp, cm) < -0.98:
            n = MOST_EVEN  # opposite the arc: far from it by construction
        if n > 0:
            first = 0 if n == 8 else 8
            for k in range(n):
                azimuths[0, k] = even[0, first + k]
                azimuths[1, k] = even[1, first + k]
                azimuths[2, k] = even[2, first + k]
            return n
    kappa = math.sqrt(nearness2 / (1.0 + nearness2))
    low, high = sm / (1.0 + cm), sp / (1.0 + cp)
    if inside and within:
        n = graded_panel(azimuths, 0, low, 0.0, kappa, cosine, sine, limits)
        return graded_panel(azimuths, n, 0.0, high, kappa, cosine, sine, limits)
    return graded_panel(azimuths, 0, low, high, kappa, cosine, sine, limits)


@inlined(fastmath={"reassoc"})
def _arc_sum(
    slice_of: Callable[..., Any],
    total: ArcIntegrals,
    factor: float,
    azimuths: Array,
    n: int,
    px: float,
    py: float,
    section: tuple[float, ...],
) -> ArcIntegrals:
    """total and `factor` times the sum over n azimuths of slice_of(X, v, *section)."""
    bx, by, bz, g00, g01, g02, g10, g11, g12 = total
    for k in range(n):
        c, s, weight = azimuths[0, k], azimuths[1, k], factor * azimuths[2, k]
        outward, axial, dX, dv, dz = slice_of(px * c + py * s, py * c - px * s, *section)
        wc, ws = weight * c, weight * s
        d0, d1 = c * dX - s * dv, s * dX + c * dv
        bx += wc * outward
        by += ws * outward
        bz += weight * axial
        g00 += wc * d0
        g01 += wc * d1
        g02 += wc * dz
        g10 += ws * d0
        g11 += ws * d1
        g12 += ws * dz
    return bx, by, bz, g00, g01, g02, g10, g11, g12


@inlined
def arc_integrals(
    azimuths: Array, n: int, px: float, py: float, section: Section, gap: float, digits: float
) -> ArcIntegrals:
    """Field integrals (3) and the derivatives of the in-plane ones along the axes of the arc's frame, row by row.

    gap: 0 for the exact section; otherwise a lower bound of the winding's distance, for the sum over filaments.
    """
    total = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if gap == 0.0:
        return _arc_sum(arc_slice, total, 1.0, azimuths, n, px, py, section)
    nr, nz = section_points(section, gap, digits)
    for i in range(nr):
        for j in range(nz):
            r, h, area = filament(nr, i, nz, j, section)
            total = _arc_sum(filament_slice, total, area * r, azimuths, n, px, py, (r, h))
    return total

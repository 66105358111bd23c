"""Straight segments in the plane: logarithmic potentials of charges and currents that are infinitely long across it.

A point (x, z) is the complex number x + i z. A segment from w1 to w2 has the unit direction e = (w2 - w1)/L and, per
length, a constant density. docs/theory/planar.md (7)-(12).
"""

import math

import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.gauss import GAUSS_NODES, GAUSS_WEIGHTS, gauss_start
from fieldmap.typing import Array

Complex = NDArray[np.complex128]
_FAR = 4.0  # of the longer segment: from this distance on, Gauss points along one of the two
_POINTS = 4


@njit
def _log(d: complex, turn: complex) -> complex:
    """log d, its branch cut opposite to conj(turn); 0 at 0, where only products with d are used."""
    if d == 0:
        return 0j
    return np.log(d * turn)


@njit
def _near(p1: complex, p2: complex, q1: complex, q2: complex) -> tuple[float, float, float]:
    """Integrals over both segments in closed form: (log, hat at q1, hat at q2), docs/theory/planar.md (10)-(12)."""
    length_p, length_q = abs(p2 - p1), abs(q2 - q1)
    e, f = (p2 - p1) / length_p, (q2 - q1) / length_q
    centre = p1 + p2 - q1 - q2
    # The differences of two segments that do not cross form a convex set without 0 inside: the ray away from its
    # centre never meets it, and the logarithm may be cut there.
    turn = centre.conjugate() / abs(centre)
    d11, d12, d21, d22 = p1 - q1, p1 - q2, p2 - q1, p2 - q2
    log11, log12, log21, log22 = _log(d11, turn), _log(d12, turn), _log(d21, turn), _log(d22, turn)
    # The antiderivatives of log d are d (log d - 1) and, once more, d^2 (log(d)/2 - 3/4).
    double = d21 * d21 * (0.5 * log21 - 0.75) - d22 * d22 * (0.5 * log22 - 0.75)
    double += d12 * d12 * (0.5 * log12 - 0.75)
    double -= d11 * d11 * (0.5 * log11 - 0.75)
    double /= e * f
    at_first = (d21 * (log21 - 1.0) - d11 * (log11 - 1.0)) / e
    at_last = (d22 * (log22 - 1.0) - d12 * (log12 - 1.0)) / e
    mean = double.imag / length_q
    return double.real, mean - at_first.imag, at_last.imag - mean


@njit
def _distant(p1: complex, p2: complex, q1: complex, q2: complex) -> tuple[float, float, float]:
    """As `_near`, with Gauss points along p."""
    length_p, length_q = abs(p2 - p1), abs(q2 - q1)
    f = (q2 - q1) / length_q
    start = gauss_start(_POINTS)
    total, first, last = 0.0, 0.0, 0.0
    for k in range(_POINTS):
        weight = 0.5 * length_p * GAUSS_WEIGHTS[start + k]
        here = 0.5 * (p1 + p2) + 0.5 * GAUSS_NODES[start + k] * (p2 - p1)
        d1, d2 = here - q1, here - q2
        square1, square2 = d1.real * d1.real + d1.imag * d1.imag, d2.real * d2.real + d2.imag * d2.imag
        # log d2 - log d1: seen from far away both ends are on one side, so that no branch matters.
        turned = d2 * d1.conjugate()
        angle = math.atan2(turned.imag, turned.real)
        # The integral of log d along q, without L (log d1 - 1).
        along = -d2 * complex(0.5 * math.log(square2 / square1), angle) * f.conjugate()
        mean = along.imag / length_q
        total += weight * (along.real + length_q * (0.5 * math.log(square1) - 1.0))
        first += weight * mean
        last += weight * (angle - mean)
    return total, first, last


@njit
def mutual_segments(p1: Complex, p2: Complex, q1: Complex, q2: Complex) -> tuple[Array, Array, Array]:
    """Potentials of segments q (m,) averaged over segments p (n,); two may touch or be the same, but not cross.

    Returns (n, m) arrays, for G = -log(r)/(2 pi): integral of G over both; of dG/dn over p and over q with the hat
    function of q1, and with that of q2. The normal n = -i e points to the right of q.
    """
    n, m = len(p1), len(q1)
    single, first, last = np.empty((n, m)), np.empty((n, m)), np.empty((n, m))
    factor = -0.5 / math.pi
    for i in range(n):
        length_p = abs(p2[i] - p1[i])
        for j in range(m):
            length_q = abs(q2[j] - q1[j])
            distance = 0.5 * abs(p1[i] + p2[i] - q1[j] - q2[j])
            if p1[i] == q1[j] and p2[i] == q2[j]:
                a, b, c = length_p * length_p * (math.log(length_p) - 1.5), 0.0, 0.0
            elif distance > _FAR * max(length_p, length_q):
                a, b, c = _distant(p1[i], p2[i], q1[j], q2[j])
            else:
                a, b, c = _near(p1[i], p2[i], q1[j], q2[j])
            single[i, j], first[i, j], last[i, j] = factor * a, factor * b, factor * c
    return single, first, last


@njit
def segment_derivatives(points: Complex, starts: Complex, ends: Complex, densities: Complex) -> Complex:
    """First three derivatives (3, n) of 1/(2 pi) sum of density * integral of log(point - w) over each segment.

    points (n,), starts, ends, densities (m,). Singular at the ends of a segment; on it, the value to one side.
    """
    out = np.zeros((3, len(points)), dtype=np.complex128)
    for j in range(len(starts)):
        step = ends[j] - starts[j]
        c = densities[j] * abs(step) / (step * 2.0 * math.pi)
        for i in range(len(points)):
            a, b = 1.0 / (points[i] - starts[j]), 1.0 / (points[i] - ends[j])
            out[0, i] += c * np.log(b / a)
            out[1, i] += c * (a - b)
            out[2, i] += c * (b * b - a * a)
    return out


@njit
def polygon_derivatives(points: Complex, corners: Complex) -> Complex:
    """First three derivatives (3, n) of the integral of log(point - w) over the area of a counter-clockwise polygon.

    Outside the polygon; docs/theory/planar.md (5).
    """
    out = np.zeros((3, len(points)), dtype=np.complex128)
    for j in range(len(corners)):
        w1, w2 = corners[j], corners[(j + 1) % len(corners)]
        slope = (w2 - w1).conjugate() / (w2 - w1)
        for i in range(len(points)):
            d1, d2 = points[i] - w1, points[i] - w2
            # conj(w) - conj(point) along the edge, continued to the point itself.
            offset = (w1 - points[i]).conjugate() + slope * d1
            log = np.log(d1 / d2)
            out[0, i] += -0.5j * offset * log
            # d offset / d point at a fixed conj(point) is the slope; the terms with conj(point) sum to zero outside.
            out[1, i] += -0.5j * (slope * log + offset * (1.0 / d1 - 1.0 / d2))
            out[2, i] += -0.5j * (
                2.0 * slope * (1.0 / d1 - 1.0 / d2) - offset * (1.0 / (d1 * d1) - 1.0 / (d2 * d2))
            )
    return out

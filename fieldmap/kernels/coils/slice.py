"""Exact integrals over a rectangular winding section: the part of arcs and bars that needs no quadrature.

A slice of a winding lies in a plane across the current. In that plane the field point has the coordinate X
(outward) and the heights h1 = z - z1 > h2 = z - z2 above the lower and upper end of the section; v is its
distance from the plane. The section is r1 <= r <= r2. With u = r - X and R = sqrt(u^2 + v^2 + h^2) the integrals
over r and z' are sums over the four corners: docs/theory/coils.md (15)-(20). Arcs carry the weight r, bars the
weight 1. Constants that drop out of the sum are chosen so that nothing cancels: `log_ratio`, `steepness`.

No branches and no library calls, so that the compiler evaluates several slices at once.
"""

import math

from fieldmap.kernels.coils.elementary import atan2, log
from fieldmap.kernels.compilation import inlined, njit


@inlined
def log_ratio(t1: float, R1: float, t2: float, R2: float, rest: float) -> float:
    """(t2 + R2) / (t1 + R1) for t1 < t2 and R_i^2 = t_i^2 + rest, without cancellation."""
    a1, a2 = R1 + abs(t1), R2 + abs(t2)
    numerator = a2 if t1 > 0.0 else (a1 if t2 < 0.0 else a1 * a2)
    denominator = a1 if t1 > 0.0 else (a2 if t2 < 0.0 else rest)
    return numerator / denominator


@inlined
def steepness(t1: float, R1: float, t2: float, R2: float, rest: float) -> tuple[float, float]:
    """t_i / (R_i rest) for i = 1, 2, both less the same constant where that avoids cancellation."""
    one_side = t1 > 0.0 or t2 < 0.0
    sign = -1.0 if t1 > 0.0 else 1.0
    n1, n2 = sign if one_side else t1, sign if one_side else t2
    d1, d2 = R1 + abs(t1) if one_side else rest, R2 + abs(t2) if one_side else rest
    return n1 / (R1 * d1), n2 / (R2 * d2)


@inlined
def angle_difference(n1: float, d1: float, n2: float, d2: float) -> float:
    """atan(n2 / d2) - atan(n1 / d1) for d1, d2 >= 0."""
    return atan2(n2 * d1 - n1 * d2, d1 * d2 + n1 * n2)


@njit(forceinline=True)
def arc_slice(
    X: float, v: float, r1: float, r2: float, h1: float, h2: float
) -> tuple[float, float, float, float, float]:
    """(outward, axial) of an arc's slice and d(outward)/dX, /dv, /dz, eqs. (17)-(19)."""
    u1, u2 = r1 - X, r2 - X
    v2, k1, k2 = v * v, h1 * h1, h2 * h2
    w1, w2 = u1 * u1 + v2, u2 * u2 + v2
    p1, p2 = v2 + k1, v2 + k2
    R11, R12 = math.sqrt(w1 + k1), math.sqrt(w1 + k2)
    R21, R22 = math.sqrt(w2 + k1), math.sqrt(w2 + k2)
    L1 = log(log_ratio(u1, R11, u2, R21, p1))
    L2 = log(log_ratio(u1, R12, u2, R22, p2))
    Z = log(log_ratio(h2, R12, h1, R11, w1) / log_ratio(h2, R22, h1, R21, w2))
    q = abs(v)
    T = angle_difference(u1 * h2, q * R12, u2 * h2, q * R22) - angle_difference(
        u1 * h1, q * R11, u2 * h1, q * R21
    )
    outward = (R22 - R12) - (R21 - R11) + X * (L2 - L1)
    axial = X * Z - h2 * L2 + h1 * L1 + q * T
    i11, i12, i21, i22 = 1.0 / R11, 1.0 / R12, 1.0 / R21, 1.0 / R22
    g11, g21 = steepness(u1, R11, u2, R21, p1)
    g12, g22 = steepness(u1, R12, u2, R22, p2)
    lower = i21 - i11 - X * (g21 - g11)
    upper = i22 - i12 - X * (g22 - g12)
    along = L2 - L1 - r2 * (i22 - i21) + r1 * (i12 - i11)
    return outward, axial, along, v * (upper - lower), h2 * upper - h1 * lower


@njit(forceinline=True)
def bar_slice(
    X: float, v: float, r1: float, r2: float, h1: float, h2: float
) -> tuple[float, float, float, float, float]:
    """(outward, axial) of a bar's slice and d(outward)/dX, /dv, /dz, eq. (20)."""
    u1, u2 = r1 - X, r2 - X
    v2, k1, k2 = v * v, h1 * h1, h2 * h2
    w1, w2 = u1 * u1 + v2, u2 * u2 + v2
    p1, p2 = v2 + k1, v2 + k2
    R11, R12 = math.sqrt(w1 + k1), math.sqrt(w1 + k2)
    R21, R22 = math.sqrt(w2 + k1), math.sqrt(w2 + k2)
    L = log(log_ratio(u1, R12, u2, R22, p2) / log_ratio(u1, R11, u2, R21, p1))
    Z = log(log_ratio(h2, R12, h1, R11, w1) / log_ratio(h2, R22, h1, R21, w2))
    g11, g21 = steepness(u1, R11, u2, R21, p1)
    g12, g22 = steepness(u1, R12, u2, R22, p2)
    lower, upper = g11 - g21, g12 - g22
    along = (1.0 / R21 - 1.0 / R11) - (1.0 / R22 - 1.0 / R12)
    return L, Z, along, v * (upper - lower), h2 * upper - h1 * lower

"""The moment that a field induces in small ellipsoids of soft iron: docs/theory/wrench.md (5)..(8).

A uniform field b0 (T) magnetises an ellipsoid uniformly. Along its axes i, with h = mu0 H and the polarisation J in it,

    h_i = b0_i - N_i J_i,   J_i = chi(s) h_i,   s = |h|,   chi = J(s) / s

so that one scalar is to be found: sum_i b0_i^2 / (s + N_i J(s))^2 = 1, whose left side falls with s. The knots of the
law bracket it; Newton's method in that piece, kept in the bracket, ends after a bounded number of steps.

soft: a flat array. soft[base] is the number of pieces; rows of SIZE numbers follow, then the laws:

    POINT      centre (3) in the frame of the body, m
    AXES       rotation (9), row by row, from the piece's axes to those of the body
    FACTORS    demagnetising factors (3) along its axes, their sum 1
    VOLUME     volume over mu0
    RELUCTANCE 1 / (mu_r - 1) of a constant permeability, 0 for an infinite one; negative: a law with knots
    LAW        where its law begins, counted from base: KNOTS values each of h, J, dJ/dh and the integral of J dh
    KNOTS      number of knots; past the last one J stays
"""

import math

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import PLAIN, PLAIN_INLINED

POINT, AXES, FACTORS, VOLUME, RELUCTANCE, LAW, KNOTS, SIZE = 0, 3, 12, 15, 16, 17, 18, 19
MOST_STEPS = 60
_ROUNDING = 4e-16


@inlined(**PLAIN_INLINED)
def _level(soft, row, a, b, c, s, j):
    """(sum_i b0_i^2 / (s + N_i J)^2)^-1/2, below 1 where s is too small; a, b, c: the squares of b0."""
    x, y, z = s + soft[row + FACTORS] * j, s + soft[row + FACTORS + 1] * j, s + soft[row + FACTORS + 2] * j
    if x <= 0.0 or y <= 0.0 or z <= 0.0:
        return 0.0
    return 1.0 / math.sqrt(a / (x * x) + b / (y * y) + c / (z * z))


@inlined(**PLAIN_INLINED)
def _level_slope(soft, row, a, b, c, s, j, slope, level):
    """Its derivative by s."""
    n1, n2, n3 = soft[row + FACTORS], soft[row + FACTORS + 1], soft[row + FACTORS + 2]
    x, y, z = s + n1 * j, s + n2 * j, s + n3 * j
    part = a * (1.0 + n1 * slope) / (x * x * x)
    part += b * (1.0 + n2 * slope) / (y * y * y)
    part += c * (1.0 + n3 * slope) / (z * z * z)
    return level * level * level * part


@inlined(**PLAIN_INLINED)
def _law(soft, law, n, k, s):
    """J, dJ/dh and the integral of J dh at s, on the piece that begins at knot k; constant past the last knot."""
    t = s - soft[law + k]
    j0, slope0, work = soft[law + n + k], soft[law + 2 * n + k], soft[law + 3 * n + k]
    if k == n - 1:
        return j0, 0.0, work + j0 * t
    width = soft[law + k + 1] - soft[law + k]
    rise = (soft[law + n + k + 1] - j0) / width
    slope1 = soft[law + 2 * n + k + 1]
    c2 = (3.0 * rise - 2.0 * slope0 - slope1) / width
    c3 = (slope0 + slope1 - 2.0 * rise) / (width * width)
    j = j0 + t * (slope0 + t * (c2 + t * c3))
    work += t * (j0 + t * (slope0 / 2.0 + t * (c2 / 3.0 + t * c3 / 4.0)))
    return j, slope0 + t * (2.0 * c2 + 3.0 * c3 * t), work


@njit(**PLAIN)
def inner_field(soft, base, row, bx, by, bz):
    """s = |h|, J, dJ/dh and the integral of J dh, inside a piece with a law, in b0 along its axes."""
    law, n = base + int(soft[row + LAW]), int(soft[row + KNOTS])
    a, b, c = bx * bx, by * by, bz * bz
    most = math.sqrt(a + b + c)
    if most == 0.0:
        return 0.0, 0.0, soft[law + 2 * n], 0.0
    low, high = 0, n
    while high - low > 1:
        middle = (low + high) // 2
        if _level(soft, row, a, b, c, soft[law + middle], soft[law + n + middle]) < 1.0:
            low = middle
        else:
            high = middle
    least = soft[law + low]
    if low < n - 1:
        most = min(most, soft[law + low + 1])
    s = 0.5 * (least + most) if low < n - 1 else most
    j, slope, work = _law(soft, law, n, low, s)
    for _ in range(MOST_STEPS):
        level = _level(soft, row, a, b, c, s, j)
        if level < 1.0:
            least = s
        else:
            most = s
        step = (1.0 - level) / _level_slope(soft, row, a, b, c, s, j, slope, level)
        following = s + step
        if not (least <= following <= most):
            following = 0.5 * (least + most)
        moved = abs(following - s)
        s = following
        j, slope, work = _law(soft, law, n, low, s)
        if moved <= _ROUNDING * most:
            break
    return s, j, slope, work


@inlined(**PLAIN_INLINED)
def _to_piece(soft, row, x, y, z):
    at = row + AXES
    return (
        soft[at] * x + soft[at + 3] * y + soft[at + 6] * z,
        soft[at + 1] * x + soft[at + 4] * y + soft[at + 7] * z,
        soft[at + 2] * x + soft[at + 5] * y + soft[at + 8] * z,
    )


@inlined(**PLAIN_INLINED)
def _from_piece(soft, row, x, y, z):
    at = row + AXES
    return (
        soft[at] * x + soft[at + 1] * y + soft[at + 2] * z,
        soft[at + 3] * x + soft[at + 4] * y + soft[at + 5] * z,
        soft[at + 6] * x + soft[at + 7] * y + soft[at + 8] * z,
    )


@inlined(**PLAIN_INLINED)
def _susceptibilities(soft, base, row, x, y, z):
    """J_i / b0_i along the axes, and s, J, dJ/dh, integral of J dh."""
    n1, n2, n3 = soft[row + FACTORS], soft[row + FACTORS + 1], soft[row + FACTORS + 2]
    if soft[row + RELUCTANCE] >= 0.0:
        nu = soft[row + RELUCTANCE]
        return 1.0 / (nu + n1), 1.0 / (nu + n2), 1.0 / (nu + n3), 0.0, 0.0, 0.0, 0.0
    s, j, slope, work = inner_field(soft, base, row, x, y, z)
    if s > 0.0:
        return j / (s + n1 * j), j / (s + n2 * j), j / (s + n3 * j), s, j, slope, work
    return (
        slope / (1.0 + n1 * slope),
        slope / (1.0 + n2 * slope),
        slope / (1.0 + n3 * slope),
        s,
        j,
        slope,
        work,
    )


@njit(**PLAIN)
def induced_moment(soft, base, p, bx, by, bz):
    """Moment (3), A m^2, of piece p in a field b0 (T), and its energy -integral of m db0, J; both in the body's
    frame."""
    row = base + 1 + SIZE * p
    x, y, z = _to_piece(soft, row, bx, by, bz)
    k1, k2, k3, _, _, _, work = _susceptibilities(soft, base, row, x, y, z)
    size = soft[row + VOLUME]
    jx, jy, jz = k1 * x, k2 * y, k3 * z
    if soft[row + RELUCTANCE] >= 0.0:
        energy = -0.5 * size * (jx * x + jy * y + jz * z)
    else:
        n1, n2, n3 = soft[row + FACTORS], soft[row + FACTORS + 1], soft[row + FACTORS + 2]
        energy = -size * (work + 0.5 * (n1 * jx * jx + n2 * jy * jy + n3 * jz * jz))
    mx, my, mz = _from_piece(soft, row, size * jx, size * jy, size * jz)
    return mx, my, mz, energy

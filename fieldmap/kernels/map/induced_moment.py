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

import numpy as np

from fieldmap.kernels.compilation import inlined, njit
from fieldmap.kernels.map.map_block import OUTER, PLAIN, PLAIN_INLINED

POINT, AXES, FACTORS, VOLUME, RELUCTANCE, LAW, KNOTS, SIZE = 0, 3, 12, 15, 16, 17, 18, 19
# The base of an array of soft pieces alone. Not a plain 0: numba would compile what is called for it once more.
ALONE = np.int64(0)
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


@njit(**PLAIN)
def _inverse(A, out):
    """out (3, 3) = A^-1."""
    out[0, 0] = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    out[0, 1] = A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2]
    out[0, 2] = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    out[1, 0] = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    out[1, 1] = A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]
    out[1, 2] = A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]
    out[2, 0] = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    out[2, 1] = A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]
    out[2, 2] = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    determinant = A[0, 0] * out[0, 0] + A[0, 1] * out[1, 0] + A[0, 2] * out[2, 0]
    for i in range(3):
        for k in range(3):
            out[i, k] /= determinant


@njit(**PLAIN)
def moment_slope(soft, base, p, bx, by, bz, work, out):
    """out (3, 3): dm_i/db0_k, A m^2/T, symmetric, in the body's frame. work (3, 3, 3): scratch.

    From h + N J(h) = b0: dJ/db0 = D (1 + N D)^-1 with D = dJ/dh = chi (1 - u u) + dJ/ds u u, u = h/s.
    """
    row = base + 1 + SIZE * p
    x, y, z = _to_piece(soft, row, bx, by, bz)
    k1, k2, k3, s, j, slope, _ = _susceptibilities(soft, base, row, x, y, z)
    D, A, inverse = work[0], work[1], work[2]
    for i in range(3):
        for k in range(3):
            D[i, k] = 0.0
    D[0, 0], D[1, 1], D[2, 2] = k1, k2, k3
    if s > 0.0:
        n1, n2, n3 = soft[row + FACTORS], soft[row + FACTORS + 1], soft[row + FACTORS + 2]
        chi = j / s
        u1, u2, u3 = x / (s + n1 * j), y / (s + n2 * j), z / (s + n3 * j)
        turned = slope - chi
        D[0, 0], D[0, 1], D[0, 2] = chi + turned * u1 * u1, turned * u1 * u2, turned * u1 * u3
        D[1, 0], D[1, 1], D[1, 2] = D[0, 1], chi + turned * u2 * u2, turned * u2 * u3
        D[2, 0], D[2, 1], D[2, 2] = D[0, 2], D[1, 2], chi + turned * u3 * u3
        for k in range(3):
            A[0, k], A[1, k], A[2, k] = n1 * D[0, k], n2 * D[1, k], n3 * D[2, k]
            A[k, k] += 1.0
        _inverse(A, inverse)
        # D (1 + N D)^-1, kept in A.
        for i in range(3):
            for k in range(3):
                A[i, k] = D[i, 0] * inverse[0, k] + D[i, 1] * inverse[1, k] + D[i, 2] * inverse[2, k]
        for i in range(3):
            for k in range(3):
                D[i, k] = 0.5 * (A[i, k] + A[k, i])
    size, at = soft[row + VOLUME], row + AXES
    for i in range(3):
        for k in range(3):
            total = 0.0
            for a in range(3):
                for b in range(3):
                    total += soft[at + 3 * i + a] * D[a, b] * soft[at + 3 * k + b]
            out[i, k] = size * total


@njit(**OUTER)
def induced_moments(soft, turns, flux, moments, energies, slopes):
    """Of a body at n poses: turns (n, 3, 3), columns its axes in the map; flux (n, s, 3), T, at its s soft pieces.

    Fills moments (n, s, 3), A m^2, and energies (n, s), J; slopes (n, s, 3, 3), dm_i/dB_k, or (n, s, 0, 0) for none.
    All in the frame of the map.
    """
    work, own = np.empty((3, 3, 3)), np.empty((3, 3))
    for n in range(flux.shape[0]):
        r = turns[n]
        for p in range(flux.shape[1]):
            b = flux[n, p]
            x = r[0, 0] * b[0] + r[1, 0] * b[1] + r[2, 0] * b[2]
            y = r[0, 1] * b[0] + r[1, 1] * b[1] + r[2, 1] * b[2]
            z = r[0, 2] * b[0] + r[1, 2] * b[1] + r[2, 2] * b[2]
            mx, my, mz, energy = induced_moment(soft, ALONE, p, x, y, z)
            energies[n, p] = energy
            for i in range(3):
                moments[n, p, i] = r[i, 0] * mx + r[i, 1] * my + r[i, 2] * mz
            if slopes.shape[2] == 0:
                continue
            moment_slope(soft, ALONE, p, x, y, z, work, own)
            for i in range(3):
                for k in range(3):
                    total = 0.0
                    for c in range(3):
                        for d in range(3):
                            total += r[i, c] * own[c, d] * r[k, d]
                    slopes[n, p, i, k] = total

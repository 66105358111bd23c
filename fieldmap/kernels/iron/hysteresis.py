"""Iron with memory: play cells at points, each with a pinning field (docs/theory/hysteresis.md)."""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.magnetisation_law import flux_density

_STEPS, _INNER_STEPS = 60, 60
_CLOSE, _INNER_CLOSE = 1e-12, 1e-15
_LEAST = 1e-13
_TURNS, _ANGLE = 12, 1e-13


@njit(inline="always")
def _norm(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@njit
def _polarisation(s, law, tables):
    """j and dj/ds at s >= 0 without hysteresis."""
    b, slope = flux_density(s, law, tables)
    return b - s, slope - 1.0


@njit
def _chord(p, law, tables):
    """Size of a reversible field, and dj/ds and j/s there."""
    s = _norm(p[0], p[1], p[2])
    j, slope = _polarisation(s, law, tables)
    return s, slope, j / s if s > 1e-30 else slope


@njit
def _drawn_back(wanted, mu, guess, law, tables):
    """s >= 0 with j(s) + mu s = wanted, by Newton's method between two bounds."""
    low, high, s = 0.0, math.inf, guess
    for _ in range(_INNER_STEPS):
        j, slope = _polarisation(s, law, tables)
        rest = j + mu * s - wanted
        if abs(rest) <= _INNER_CLOSE * wanted:
            break
        if rest > 0.0:
            high = s
        else:
            low = s
        new = s - rest / (slope + mu)
        if not low <= new <= high:
            new = 0.5 * (low + high) if high < math.inf else 2.0 * low
        if new == s:
            break
        s = new
    return s


@njit
def _straight(h, p, kappa, share, law, tables, r):
    """Fill r with the field straight towards h, as in one dimension; J(p), the size of r, and mu there."""
    _, _, chord = _chord(p, law, tables)
    jx, jy, jz = chord * p[0], chord * p[1], chord * p[2]
    for i in range(3):
        r[i] = h[i] - share * (h[i] - p[i])
    s, _, chord = _chord(r, law, tables)
    return jx, jy, jz, s, max(_norm(chord * r[0] - jx, chord * r[1] - jy, chord * r[2] - jz) / kappa, _LEAST)


@njit
def _turned(h, p, kappa, away, law, tables, r):
    """Fill r (3,) with the new reversible field of a cell that moves and return mu; -1 where the search does not end.

    r lies on the circle of radius kappa about h, in the plane of h and p: Newton's method for the direction of h - r,
    along which J(r) - J(p) has to point. It begins straight towards h. A step asks for the law once.
    """
    _, _, chord = _chord(p, law, tables)
    # u: from p to h; v: across, in the plane of both. All vectors of the search have these two components.
    ux, uy, uz = (h[0] - p[0]) / away, (h[1] - p[1]) / away, (h[2] - p[2]) / away
    h_u = h[0] * ux + h[1] * uy + h[2] * uz
    vx, vy, vz = h[0] - h_u * ux, h[1] - h_u * uy, h[2] - h_u * uz
    h_v = _norm(vx, vy, vz)
    inverse = 1.0 / h_v if h_v > 0.0 else 0.0
    vx, vy, vz = inverse * vx, inverse * vy, inverse * vz
    jp_u, jp_v = chord * (h_u - away), chord * h_v
    n_u, n_v = 1.0, 0.0
    for _ in range(_TURNS):
        r_u, r_v = h_u - kappa * n_u, h_v - kappa * n_v
        s = math.sqrt(r_u * r_u + r_v * r_v)
        j, slope = _polarisation(s, law, tables)
        chord = j / s if s > 1e-30 else slope
        g_u, g_v = chord * r_u - jp_u, chord * r_v - jp_v
        along, across = g_u * n_u + g_v * n_v, g_v * n_u - g_u * n_v
        if along <= 0.0:
            return -1.0
        # How the component across follows the angle.
        t = (r_v * n_u - r_u * n_v) / s if s > 1e-30 else 0.0
        stiffness = along + kappa * (chord + (slope - chord) * t * t)
        angle = across / stiffness
        if abs(angle) <= _ANGLE:
            r[0] = h_u * ux + h_v * vx - kappa * (n_u * ux + n_v * vx)
            r[1] = h_u * uy + h_v * vy - kappa * (n_u * uy + n_v * vy)
            r[2] = h_u * uz + h_v * vz - kappa * (n_u * uz + n_v * vz)
            return max(along / kappa, _LEAST)
        angle = min(max(angle, -0.5), 0.5)
        n_u, n_v = n_u - angle * n_v, n_v + angle * n_u
        size = math.sqrt(n_u * n_u + n_v * n_v)
        n_u, n_v = n_u / size, n_v / size
    return -1.0


@njit
def _moved(h, p, kappa, law, tables, r):
    """Fill r (3,) with the new reversible field of a cell and return mu; 0 where it stays, infinity if kappa is 0.

    1/|h - r| is nearly linear in mu, which Newton's method makes use of (More and Sorensen 1983).
    """
    if kappa == 0.0:
        r[0], r[1], r[2] = h[0], h[1], h[2]
        return math.inf
    away = _norm(h[0] - p[0], h[1] - p[1], h[2] - p[2])
    if away <= kappa:
        r[0], r[1], r[2] = p[0], p[1], p[2]
        return 0.0
    mu = _turned(h, p, kappa, away, law, tables, r)
    if mu > 0.0:
        return mu
    jx, jy, jz, s, mu = _straight(h, p, kappa, kappa / away, law, tables, r)
    low, high = 0.0, math.inf
    for _ in range(_STEPS):
        qx, qy, qz = jx + mu * h[0], jy + mu * h[1], jz + mu * h[2]
        q = _norm(qx, qy, qz)
        if q < 1e-30:
            s, factor = 0.0, 0.0
        else:
            s = _drawn_back(q, mu, s, law, tables)
            factor = s / q
        r[0], r[1], r[2] = factor * qx, factor * qy, factor * qz
        dx, dy, dz = h[0] - r[0], h[1] - r[1], h[2] - r[2]
        d = _norm(dx, dy, dz)
        if abs(d - kappa) <= _CLOSE * kappa or mu <= _LEAST:
            break
        if d > kappa:
            low = mu
        else:
            high = mu
        j, slope = _polarisation(s, law, tables)
        chord = j / s if s > 1e-30 else slope
        along = (dx * r[0] + dy * r[1] + dz * r[2]) / s if s > 1e-30 else 0.0
        pull = (d * d - along * along) / (chord + mu) + along * along / (slope + mu)
        new = mu + (1.0 / kappa - 1.0 / d) * d * d * d / pull
        if not low < new < high:
            new = 0.5 * (low + high) if high < math.inf else 4.0 * mu
        if abs(new - mu) <= 1e-15 * mu:
            break
        mu = max(new, _LEAST)
    return mu


@njit
def _respond(h, previous, pinning, weights, law, tables, polarisation, tangent, r):
    """Add up one point: polarisation (3,), tangent (6,) = dj/dh in the order xx, xy, xz, yy, yz, zz."""
    polarisation[:] = 0.0
    tangent[:] = 0.0
    e, n = np.empty(3), np.empty(3)
    for k in range(weights.size):
        mu = _moved(h, previous[k], pinning[k], law, tables, r)
        s, slope, chord = _chord(r, law, tables)
        for i in range(3):
            polarisation[i] += weights[k] * chord * r[i]
            e[i] = r[i] / s if s > 1e-30 else 0.0
        if mu == 0.0:
            continue
        across, extra, push = chord, slope - chord, 0.0
        n[:] = 0.0
        if mu < math.inf:
            across_share, along_share = chord / (chord + mu), slope / (slope + mu)
            across, extra = mu * across_share, mu * (along_share - across_share)
            for i in range(3):
                n[i] = (h[i] - r[i]) / pinning[k]
            ne = n[0] * e[0] + n[1] * e[1] + n[2] * e[2]
            push = 1.0 / ((1.0 - ne * ne) / (chord + mu) + ne * ne / (slope + mu))
            for i in range(3):
                n[i] = across_share * n[i] + (along_share - across_share) * ne * e[i]
        place = 0
        for i in range(3):
            for m in range(i, 3):
                value = extra * e[i] * e[m] + push * n[i] * n[m]
                tangent[place] += weights[k] * (value + across if i == m else value)
                place += 1


@njit(nogil=True)
def respond(begin, end, h, previous, pinning, weights, law, tables, polarisation, tangent):
    """Fill polarisation (p, 3) in T and tangent (p, 6), its derivative by h, at points that remember `previous`
    (p, k, 3).

    h (p, 3), mu0 H in T. pinning (l, k): pinning fields of the cells in each law, T; weights (k,), their sum 1; law
    (p,) and the tables of `fieldmap.kernels.iron.magnetisation_law`. Derivatives in the order xx, xy, xz, yy, yz, zz.
    """
    r = np.empty(3)
    for i in range(begin, end):
        kappa = pinning[law[i]]
        _respond(
            h[i], previous[i], kappa, weights, law[i], tables, polarisation[i], tangent[i], r
        )  # fmt: skip


@njit(nogil=True)
def advance(begin, end, h, previous, pinning, weights, law, tables, out):
    """Fill out (p, k, 3) with what the cells remember after h (p, 3); arguments as for `respond`."""
    for i in range(begin, end):
        for k in range(weights.size):
            kappa = pinning[law[i], k]
            _moved(h[i], previous[i, k], kappa, law[i], tables, out[i, k])

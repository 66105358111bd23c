"""Element loops of the second-order flux form: linear flux density per tetrahedron, from potentials on its faces.

Flux density and field strength are linear in each element and held by their values at the four points of the degree-2
rule (Stroud T3:2-1), which integrates their products exactly. The outward flux of B through face f (opposite corner
f, outward area vector S_f), weighted by the barycentric coordinate of corner c, is

    x_fc = sum_q C_fcq S_f . B_q                                                                       (C: `SHAPE`)

and a potential l on the faces together with a mean p in the element give the field strength

    h_q = t_q + (4 / V) (p D_q - sum_fc C_fcq S_f l_fc),      D_q = sum_fc C_fcq S_f,

with the p that makes div B = 0, that is sum_q D_q . b(h_q) = 0: one equation with one increasing function.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.magnetisation_law import flux_density

# Corners of the face opposite corner f, in the order of its three potentials.
CORNERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
_MAX_STEPS = 200


def _shape() -> np.ndarray:
    """C (12, 4): flux moments through unit area vectors of flux densities of value one at one of the four points."""
    b = (5.0 - math.sqrt(5.0)) / 20.0
    at_corners = np.linalg.inv(np.full((4, 4), b) + (1.0 - 4.0 * b) * np.eye(4))
    moments = (np.ones((3, 3)) + np.eye(3)) / 12.0
    return np.ascontiguousarray(np.concatenate([moments @ at_corners[face] for face in CORNERS]))


SHAPE = _shape()


@njit(inline="always")
def _divergence(shape, area, d):
    """Fill d (4, 3) with D_q."""
    for q in range(4):
        for k in range(3):
            d[q, k] = 0.0
        for f in range(4):
            c = shape[3 * f, q] + shape[3 * f + 1, q] + shape[3 * f + 2, q]
            for k in range(3):
                d[q, k] += c * area[f, k]


@njit(inline="always")
def _drive(potential, dofs, t, shape, area, scale, r):
    """Fill r (4, 3) with t_q - scale sum_fc C_fcq S_f l_fc. The mean of l is subtracted: it only shifts p."""
    mean = 0.0
    for i in range(12):
        mean += potential[dofs[i]] / 12.0
    for q in range(4):
        for k in range(3):
            r[q, k] = t[q, k]
        for f in range(4):
            c = 0.0
            for i in range(3 * f, 3 * f + 3):
                c += shape[i, q] * (potential[dofs[i]] - mean)
            for k in range(3):
                r[q, k] -= scale * c * area[f, k]


@njit
def _net_flux(p, r, d, scale, law, tables):
    """sum_q D_q . b(h_q) at h_q = r_q + scale p D_q, its derivative by p, and sum_q |D_q| |b_q|."""
    total, slope, size = 0.0, 0.0, 0.0
    for q in range(4):
        dx, dy, dz = d[q, 0], d[q, 1], d[q, 2]
        hx, hy, hz = r[q, 0] + scale * p * dx, r[q, 1] + scale * p * dy, r[q, 2] + scale * p * dz
        h = math.sqrt(hx * hx + hy * hy + hz * hz)
        b, rise = flux_density(h, law, tables)
        m = b / h if h > 1e-30 else rise
        along = dx * hx + dy * hy + dz * hz
        square = dx * dx + dy * dy + dz * dz
        total += m * along
        slope += scale * m * square
        if h > 1e-30:
            slope += scale * (rise - m) * along * along / (h * h)
        size += math.sqrt(square) * b
    return total, slope, size


@njit
def _balance(r, d, scale, law, tables):
    """The p that makes div B = 0: Newton's method inside the shrinking bracket of the root, bisection where it is slow.

    At a knee of the B-H law Newton alone can jump from one side to the other and hardly gain.
    """
    p, low, high, last = 0.0, -np.inf, np.inf, np.inf
    for _ in range(_MAX_STEPS):
        total, slope, size = _net_flux(p, r, d, scale, law, tables)
        if abs(total) <= 1e-14 * size:
            return p
        if total > 0.0:
            high = p
        else:
            low = p
        following = p - total / slope
        bracketed = high - low < np.inf
        if bracketed and not (low < following < high and abs(following - p) < 0.5 * last):
            following = 0.5 * (low + high)
        last = abs(following - p)
        if following == p:
            return p
        p = following
    return p


@njit(inline="always")
def _strength(potential, dofs, t, shape, area, volume, d, h, law, tables):
    """Fill d (4, 3) with D_q and h (4, 3) with the field strength at the points of one element."""
    scale = 4.0 / volume
    _divergence(shape, area, d)
    _drive(potential, dofs, t, shape, area, scale, h)
    p = _balance(h, d, scale, law, tables)
    for q in range(4):
        for k in range(3):
            h[q, k] += scale * p * d[q, k]


@njit(nogil=True)
def strength(begin, end, potential, t, shape, area, volume, dofs, law, tables, out):
    """Fill out (e, 4, 3) with the field strength mu0 H at the points of every element.

    potential (n,): values of the face potentials at the faces' corners; t (e, 4, 3): coil field at the points;
    shape: `SHAPE`; area (e, 4, 3), volume (e,); dofs (e, 12): numbers of the elements' potentials; law (e,) and the
    tables of `fieldmap.kernels.iron.magnetisation_law`.
    """
    d = np.empty((4, 3))
    for e in range(begin, end):
        _strength(potential, dofs[e], t[e], shape, area[e], volume[e], d, out[e], law[e], tables)


@njit(nogil=True)
def moment_matrices(begin, end, values, shape, area, volume, out):
    """Add to out (e, 12, 12) minus the derivative of the outward moments of B by the face potentials, for the symmetric
    db/dh = `values` (e, 4, 6) at the points: xx, xy, xz, yy, yz, zz.

    They are symmetric, and positive but for equal potentials on all faces. Other arguments are as for `strength`.
    """
    pair = np.empty((4, 4))
    for e in range(begin, end):
        scale = 4.0 / volume[e]
        for q in range(4):
            xx, xy, xz = scale * values[e, q, 0], scale * values[e, q, 1], scale * values[e, q, 2]
            yy, yz, zz = scale * values[e, q, 3], scale * values[e, q, 4], scale * values[e, q, 5]
            for f in range(4):
                x, y, z = area[e, f, 0], area[e, f, 1], area[e, f, 2]
                u, v, w = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
                for g in range(f + 1):
                    pair[f, g] = pair[g, f] = u * area[e, g, 0] + v * area[e, g, 1] + w * area[e, g, 2]
            for i in range(12):
                for j in range(12):
                    out[e, i, j] += shape[i, q] * shape[j, q] * pair[i // 3, j // 3]
        _remove_net_flux(out[e])


@njit(inline="always")
def _remove_net_flux(matrix):
    """N -> N - N 1 1^T N / (1^T N 1): the mean p is eliminated."""
    row = np.zeros(12)
    total = 0.0
    for i in range(12):
        for j in range(12):
            row[i] += matrix[i, j]
        total += row[i]
    for i in range(12):
        for j in range(12):
            matrix[i, j] -= row[i] * row[j] / total

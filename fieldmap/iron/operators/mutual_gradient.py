"""How sums over the mutual potentials of the surface faces follow the nodes of their mesh.

One pass over the pairs of faces gives the derivatives by all nodes, whatever moves them. Where operations a map the
mesh onto itself, face i of one chamber stands for all its images, and a sum over pairs is one over pairs with a face
there:

    sum_ij x_i y_j G(i, j)  =  sum_a sum_(i in the chamber) sum_j x_ai y_aj G(ai, aj),

with the derivative of G(ai, aj) that of G(i, j), turned by a. Charges need not have the symmetry.
"""

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.operators.surface import NEAR_DEGREE, NEAR_RADII, TOUCH_DEGREE, ChargedFaces
from fieldmap.iron.operators.symmetric_mutual import face_images
from fieldmap.kernels.iron.mutual_gradient import close_gradient, far_pulls
from fieldmap.kernels.simplex_rules import triangle_rule
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# Into which the close pairs are divided for threads.
_SHARES = 16
# Triangles whose far pairs are taken at once: 12 MB where there are 10 000.
_ROWS = 16


def mutual_gradient(
    faces: ChargedFaces,
    nodes: Index,
    count: int,
    charge: Array,
    others: Array,
    moving: NDArray[np.bool_],
    symmetry: MeshSymmetry | None = None,
) -> Array:
    """How others (k, n) . W charge (n,) follow the corners of the faces, which are `count` nodes with numbers nodes
    (n, 3): (k, count, 3), in 1/m^2 times the charges' units. Right for nodes of which all faces are marked as moving
    (n,). symmetry: of the mesh; charges and movements need not have it."""
    if symmetry is None:
        images, places, matrices = np.arange(len(charge))[None], np.arange(count)[None], np.eye(3)[None]
    else:
        # Row by row: of columns numba would compile another kernel.
        images, places = face_images(symmetry, nodes), np.ascontiguousarray(symmetry.node_images)
        matrices = symmetry.group.matrices
    first, moves = images.min(axis=0), moving[images]
    charges, of_others = charge[images], np.ascontiguousarray(others[:, images].swapaxes(0, 1))
    geometry, spheres = faces.kernel_geometry(), faces.spheres()
    near, touch = (triangle_rule(degree)[0] for degree in (NEAR_DEGREE, TOUCH_DEGREE))
    parts = np.zeros((_SHARES, count, len(others), 3))
    any_moves = moves.any(axis=0)
    given = (geometry, spheres, near, touch, NEAR_RADII, nodes, first, any_moves)
    # The pairs of a share, each with a few of its own.
    work = 10.0 * np.count_nonzero(first == np.arange(len(first))) * len(first) / _SHARES
    over_rows(close_gradient, _SHARES, *given, charges, of_others, places, matrices, parts, work=work)
    out = np.ascontiguousarray(parts.sum(axis=0).transpose(1, 0, 2))
    rows = np.flatnonzero(any_moves & (first == np.arange(len(first))))
    used = np.flatnonzero(moves[:, rows].any(axis=1))
    for a, part in zip(
        used, _of_far_pairs(faces, nodes, count, rows, charges[used], of_others[used]), strict=True
    ):
        out[:, places[a]] += part @ matrices[a].T
    return out


def _of_far_pairs(
    faces: ChargedFaces, nodes: Index, count: int, rows: Index, charges: Array, others: Array
) -> Array:
    """What far pairs make of it, by the corners of some faces, for charges (g, n) and others (g, k, n):
    (g, k, count, 3)."""
    shapes, points = triangle_rule(2)[0], faces.far_points().reshape(3, -1, 3)
    points, spheres = np.ascontiguousarray(points.swapaxes(1, 2)), faces.spheres()
    every = np.concatenate([charges[:, None], others], axis=1)
    columns = np.ascontiguousarray(every.reshape(-1, every.shape[2]).T)
    pulls = np.empty((_ROWS, 3, 3, len(columns)))
    by_corner = np.empty((len(rows), 3, *others.shape[:2], 3))
    for start in range(0, len(rows), _ROWS):
        here = slice(start, start + _ROWS)
        chosen = rows[here]
        block = pulls[: len(chosen)]
        over_rows(far_pulls, len(chosen), chosen, points, spheres, NEAR_RADII, block, work=9.0 * len(columns))
        sums = (block.reshape(-1, len(columns)) @ columns).reshape(len(chosen), 3, 3, *every.shape[:2])
        pull = np.einsum("qc,rqdgk->rcgkd", shapes, sums) / (36 * np.pi)
        own = every[:, :, chosen].transpose(2, 0, 1)[:, None, :, :, None]
        by_corner[here] = own[..., 1:, :] * pull[..., :1, :] + own[..., :1, :] * pull[..., 1:, :]
    at, flat = nodes[rows].ravel(), by_corner.reshape(3 * len(rows), -1)
    out = np.array([np.bincount(at, column, count) for column in flat.T])
    return np.ascontiguousarray(out.reshape(*others.shape[:2], 3, count).swapaxes(2, 3))

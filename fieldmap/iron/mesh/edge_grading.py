"""Graded layers of tetrahedra towards the sharp edges of any body.

Flux density is singular at the sharp edges of iron, and uniform elements waste the accuracy of everything else
there. Each level cuts every element that touches a sharp edge at a fixed fraction of its height above the edge:
elements shrink across the edge and keep their length along it, so the cost grows with the number of levels while
the first layer shrinks geometrically. Prisms that appear are split into three tetrahedra by the rule of Dompierre
et al. (Proc. 8th Int. Meshing Roundtable, 1999): every quadrilateral is cut at its vertex with the smallest number,
so that neighbours agree.
"""

from collections.abc import Callable

import numpy as np

from fieldmap.iron import topology
from fieldmap.typing import Array, Index

# Edges of a triangle and of a tetrahedron, by the number of corners.
_PAIRS_OF = {3: topology.TRIANGLE_SIDES, 4: topology.TET_EDGES}
# Row k: the order of a prism's vertices that brings vertex k to the front (Dompierre et al., table 2).
_PRISM_TURN = np.array(
    [
        [0, 1, 2, 3, 4, 5],
        [1, 2, 0, 4, 5, 3],
        [2, 0, 1, 5, 3, 4],
        [3, 5, 4, 0, 2, 1],
        [4, 3, 5, 1, 0, 2],
        [5, 4, 3, 2, 1, 0],
    ]
)
_SPLIT_A = np.array([[0, 1, 2, 5], [0, 1, 5, 4], [0, 4, 5, 3]])
_SPLIT_B = np.array([[0, 1, 2, 4], [0, 4, 2, 5], [0, 4, 5, 3]])
# Two faces that enclose more than this angle (radians) with the plane meet in a sharp edge.
_SHARP_ANGLE = 0.6


def sharp_edges(points: Array, tets: Index, candidates: Index, midpoints: tuple[Index, Array]) -> Index:
    """The candidate edges (k, 2) at which the iron's surface has a kink. Returns (s, 2), sorted.

    midpoints: all element edges (m, 2), sorted, lexicographic, and their midpoints (m, 3) on the true surface. A
    coarse polygon is kinked where the surface is smooth; parabolas through the midpoints are not.
    """
    found = topology.distinct_parts(tets, topology.TET_FACES)
    return kinked_edges(points, found.rows[found.times == 1], candidates, midpoints)


def kinked_edges(points: Array, faces: Index, candidates: Index, midpoints: tuple[Index, Array]) -> Index:
    """The candidate edges (k, 2) at which a surface of triangles (f, 3) has a kink; otherwise as `sharp_edges`."""
    sides = faces[:, topology.TRIANGLE_SIDES].reshape(-1, 2)
    opposite = faces[:, [2, 1, 0]].ravel()
    key = topology.edge_keys(sides, len(points))
    order = np.argsort(key, kind="stable")
    key, sides, opposite = key[order], sides[order], opposite[order]
    pair = np.flatnonzero(key[1:] == key[:-1])
    across = [_leaving(points, sides[pair], opposite[pair + k], midpoints) for k in range(2)]
    cosine = -np.einsum("ij,ij->i", *across)
    kinked = sides[pair[cosine < np.cos(_SHARP_ANGLE)]]
    wanted = np.sort(candidates, axis=1)
    is_candidate = np.isin(topology.edge_keys(kinked, len(points)), topology.edge_keys(wanted, len(points)))
    return topology.distinct_rows(kinked[is_candidate]).rows


def _leaving(points, sides, opposite, midpoints):
    """Unit vectors (k, 3) in the true surface, across its edge `sides` (k, 2) and towards the vertex `opposite`."""
    keys, tangent = topology.edge_keys(midpoints[0], len(points)), np.zeros((len(sides), 3))
    for end in sides.T:
        between = np.sort(np.column_stack([end, opposite]), axis=1)
        middle = midpoints[1][np.searchsorted(keys, topology.edge_keys(between, len(points)))]
        # Slope at its start of the parabola through end, middle and opposite vertex.
        tangent += 4 * middle - 3 * points[end] - points[opposite]
    along = points[sides[:, 1]] - points[sides[:, 0]]
    share = np.einsum("ij,ij->i", tangent, along) / np.einsum("ij,ij->i", along, along)
    tangent -= share[:, None] * along
    return tangent / np.linalg.norm(tangent, axis=1)[:, None]


def grade_edges(
    points: Array, tets: Index, sharp: Index, first_layer: Array, ratio: float
) -> tuple[Array, Index, Index]:
    """Refine towards sharp edges (s, 2) until the layer at each is at most `first_layer` (per tet) thick.

    tets: tetrahedra (m, 4), or the triangles (m, 3) of a surface, which keep their orientation. Returns points, tets
    and, for each new tet, the index of the tet it came from. ratio: thickness of one layer against the next, between 0
    and 1. Edges whose tets all ask for an infinite layer stay as they are.
    """
    parent = np.arange(len(tets))
    wanted = np.isin(np.arange(len(points)), np.unique(tets[np.isfinite(first_layer)]))
    sharp = sharp[wanted[sharp].all(axis=1)]
    if len(sharp) == 0:
        return points, tets, parent
    points, tets, parent, sharp = _separate(points, tets, parent, sharp)
    layer = np.full(len(points), np.inf)
    np.minimum.at(layer, tets.ravel(), np.repeat(first_layer[parent], tets.shape[1]))
    while True:
        active = _edges_too_thick(points, tets, sharp, layer, ratio)
        if len(active) == 0:
            return points, tets, parent
        n_before = len(points)
        points, tets, parent = _cut_layer(points, tets, parent, active, ratio)
        layer = np.concatenate([layer, np.full(len(points) - n_before, np.inf)])


def _edges_of(tets: Index) -> Index:
    """Edges (m * 6, 2) of tetrahedra (m, 4), or (m * 3, 2) of triangles (m, 3), sorted, one element after the other."""
    return np.sort(tets[:, _PAIRS_OF[tets.shape[1]]].reshape(-1, 2), axis=1)


def _edges_too_thick(points, tets, sharp, layer, ratio):
    """Sharp edges at which one more cut brings the layer closer to the wanted thickness.

    The layer at a vertex is the shortest element edge that leaves its sharp edge; a sharp edge is cut when both its
    ends ask for it.
    """
    singular = np.zeros(len(points), bool)
    singular[sharp] = True
    ends = topology.distinct_rows(_edges_of(tets)).rows
    leaves = singular[ends[:, 0]] ^ singular[ends[:, 1]]
    ends = ends[leaves]
    at = np.where(singular[ends[:, 0]], ends[:, 0], ends[:, 1])
    height = np.full(len(points), np.inf)
    np.minimum.at(height, at, np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1))
    active = singular & (height > layer / np.sqrt(ratio))
    return sharp[active[sharp].all(axis=1)]


def _separate(points, tets, parent, sharp):
    """Bisect edges until each tet holds at most one sharp edge and no other edge joins two singular vertices."""
    while True:
        singular = np.zeros(len(points), bool)
        singular[sharp] = True
        ends = _edges_of(tets)
        is_sharp = np.isin(topology.edge_keys(ends, len(points)), topology.edge_keys(sharp, len(points)))
        bad = (singular[ends].all(axis=1) & ~is_sharp).reshape(len(tets), -1)
        # A tet whose corner is cut off by three sharp edges: bisect its sharp edges too.
        corner = ~bad.any(axis=1) & (singular[tets].sum(axis=1) > 2)
        bad[corner] |= is_sharp.reshape(len(tets), -1)[corner]
        if not bad.any():
            return points, tets, parent, sharp
        marked = topology.distinct_rows(ends[bad.ravel()]).rows
        points, tets, parent, sharp = _bisect(points, tets, parent, sharp, marked)


def _bisect(points, tets, parent, sharp, marked):
    """Bisect those marked edges that are the longest marked edge of every tet around them."""
    n, pairs = len(points), _PAIRS_OF[tets.shape[1]]
    ends = _edges_of(tets)
    keys = topology.edge_keys(marked, n)
    place = np.searchsorted(keys, topology.edge_keys(ends, n))
    place[place == len(keys)] = 0
    is_marked = keys[place] == topology.edge_keys(ends, n)
    length = np.linalg.norm(points[marked[:, 0]] - points[marked[:, 1]], axis=1)
    # Ranks are unique, so "longest" is decided the same way in every tet.
    rank = np.empty(len(marked), np.int64)
    rank[np.lexsort((keys, length))] = np.arange(len(marked))
    value = np.where(is_marked, rank[place], -1).reshape(-1, len(pairs))
    best = value.argmax(axis=1)
    chosen_here = value[np.arange(len(tets)), best]
    beaten = np.zeros(len(marked), bool)
    losers = is_marked & (value.ravel() < np.repeat(chosen_here, len(pairs)))
    beaten[place[losers]] = True
    chosen = np.flatnonzero(~beaten)
    number = np.full(len(marked), -1)
    number[chosen] = n + np.arange(len(chosen))
    points = np.vstack([points, 0.5 * (points[marked[chosen, 0]] + points[marked[chosen, 1]])])
    winner = place.reshape(-1, len(pairs))[np.arange(len(tets)), best]
    split = np.flatnonzero((chosen_here >= 0) & (number[winner] >= 0))
    middle = number[winner[split]]
    first, second = tets[split].copy(), tets[split].copy()
    first[np.arange(len(split)), pairs[best[split], 1]] = middle
    second[np.arange(len(split)), pairs[best[split], 0]] = middle
    keep = np.setdiff1d(np.arange(len(tets)), split)
    tets = np.vstack([tets[keep], first, second])
    parent = np.concatenate([parent[keep], parent[split], parent[split]])
    cut = np.isin(topology.edge_keys(sharp, n), keys[chosen])
    if cut.any():
        where = number[np.searchsorted(keys, topology.edge_keys(sharp[cut], n))]
        halves = np.vstack([np.column_stack([sharp[cut, k], where]) for k in range(2)])
        sharp = np.vstack([sharp[~cut], halves])
    return points, tets, parent, sharp


def _cut_layer(points, tets, parent, sharp, ratio):
    """One level: new points at `ratio` of each edge that leaves a singular vertex, elements split around them."""
    n = len(points)
    singular = np.zeros(n, bool)
    singular[sharp] = True
    count = singular[tets].sum(axis=1)
    ends = topology.distinct_rows(_edges_of(tets)).rows
    ends = ends[singular[ends[:, 0]] ^ singular[ends[:, 1]]]
    start = np.where(singular[ends[:, 0]], ends[:, 0], ends[:, 1])
    stop = ends.sum(axis=1) - start
    cut = points[start] + ratio * (points[stop] - points[start])
    key = topology.edge_keys(ends, n)

    def on(a: Index, b: Index) -> Index:
        low, high = np.minimum(a, b), np.maximum(a, b)
        return n + np.searchsorted(key, low * n + high)

    untouched = np.flatnonzero(count == 0)
    one, two = np.flatnonzero(count == 1), np.flatnonzero(count == 2)
    if tets.shape[1] == 3:
        points = np.vstack([points, cut])
        new = _cut_triangles(points, tets[one], tets[two], singular, on)
        children = np.concatenate([untouched, np.tile(one, 3), np.tile(two, 3)])
        return points, np.vstack([tets[untouched], *new]), parent[children]
    ordered = np.take_along_axis(tets, np.argsort(~singular[tets], axis=1, kind="stable"), axis=1)
    a, b, c, d = ordered[one].T
    ab, ac, ad = on(a, b), on(a, c), on(a, d)
    tip = np.column_stack([a, ab, ac, ad])
    one_rest = _split_prism(np.column_stack([ab, ac, ad, b, c, d]))
    a, b, c, d = ordered[two].T
    ac, ad, bc, bd = on(a, c), on(a, d), on(b, c), on(b, d)
    wedge = _split_prism(np.column_stack([a, ac, ad, b, bc, bd]))
    two_rest = _split_prism(np.column_stack([ac, bc, c, ad, bd, d]))
    tets = np.vstack([tets[untouched], tip, one_rest, wedge, two_rest])
    children = np.concatenate([untouched, one, *(np.repeat(rows, 3) for rows in (one, two, two))])
    return np.vstack([points, cut]), tets, parent[children]


def _cut_triangles(
    points: Array, one: Index, two: Index, singular: Index, on: Callable[[Index, Index], Index]
) -> tuple[Index, Index]:
    """Three triangles (3 k, 3) for each triangle with one singular vertex, and for each with two; on: point on the edge
    between two vertices. Corners are permuted cyclically, not sorted, to keep the orientation."""
    first = np.argmax(singular[one], axis=1)
    a, b, c = np.take_along_axis(one, (first[:, None] + np.arange(3)) % 3, axis=1).T
    ab, ac = on(a, b), on(a, c)
    at_vertex = [np.column_stack([a, ab, ac]), _split_quadrilateral(points, np.column_stack([ab, b, c, ac]))]
    last = np.argmin(singular[two], axis=1)
    a, b, c = np.take_along_axis(two, (last[:, None] + np.arange(1, 4)) % 3, axis=1).T
    ac, bc = on(a, c), on(b, c)
    at_edge = [_split_quadrilateral(points, np.column_stack([a, b, bc, ac])), np.column_stack([ac, bc, c])]
    return np.vstack(at_vertex), np.vstack(at_edge)


def _split_quadrilateral(points: Array, corners: Index) -> Index:
    """Triangles (2 m, 3) for quadrilaterals (m, 4), cut along the shorter diagonal."""
    a, b, c, d = corners.T
    across = [np.linalg.norm(points[i] - points[j], axis=1) for i, j in ((a, c), (b, d))]
    by_first = (across[0] <= across[1])[:, None]
    first = np.where(by_first, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(by_first, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return np.vstack([first, second])


def _split_prism(prism: Index) -> Index:
    """Three tetrahedra (3 m, 4) for each prism (m, 6): vertices 3, 4, 5 above 0, 1, 2."""
    turned = np.take_along_axis(prism, _PRISM_TURN[prism.argmin(axis=1)], axis=1)
    first = np.minimum(turned[:, 1], turned[:, 5]) < np.minimum(turned[:, 2], turned[:, 4])
    out = np.where(first[:, None, None], turned[:, _SPLIT_A], turned[:, _SPLIT_B])
    return out.reshape(-1, 4)

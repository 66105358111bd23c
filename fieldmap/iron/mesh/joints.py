"""Thin gaps where bodies touch: the mesh is opened at the faces that two bodies share, and a sheet laid between them.

The mesher knows nothing of the gaps. Every face between two bodies becomes a flat prism as thick as the gap, split into
tetrahedra of the sheet's own permeability. A potential of second order in them holds the jump of potential across the
gap, so that the joint meets the interface condition phi_1 - phi_2 = gap b_n / mu_r. At the rim
the sheet ends in a strip of surface as wide as the gap, through which flux spreads into the air as in reality.
(With the jump at a line instead, the flux through the air near the rim would grow with the logarithm of the mesh size.)

The gap is cut out of one of the bodies: its nodes near the joint move away from the joint, its far half stays.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fieldmap.device.model import Device
from fieldmap.device.parts import joint_of
from fieldmap.device.tetrahedra import volumes
from fieldmap.iron import topology
from fieldmap.records import Record
from fieldmap.typing import Array, Index

Mask = NDArray[np.bool_]
Pair = tuple[int, int]
"""Numbers of two bodies, the smaller one first."""

# Eigenvalues of the sum of n n^T over the normals of a node's joint faces count as zero below this share of the
# largest: nearly parallel normals are taken for normals of one plane.
_ONE_PLANE = 0.05
# Nodes of a body stay if they are farther from its joints than this share of the largest distance in the body.
_FAR = 0.5
# Thickness of the first layer of elements at the rim of a sheet, over the thickness of the sheet.
_RIM_LAYER = 0.25
# Share of the flux through a gap that the air around its rim may carry without being resolved by the mesh. No gap is
# known more precisely. With less than half of this value the drive unit has 21 586 faces instead of 12 802.
_UNSEEN = 2.5e-2
# Largest exponent in the thickness of the first layer, against overflow.
_MOST_UNSEEN = 20.0
# Near its rim the sheet is divided into layers at these shares of its thickness, up to _RINGS elements from the rim. In
# a core with a gap of a twentieth of its width 0.8 % of the flux is missing with one layer, 0.1 % with these.
_LEVELS = (0.15, 0.5, 0.85)
_RINGS = 2
# Slopes of the walls at the rim of a joint that differ by less than this are alike.
_SAME_SLOPE = 0.1
# Bodies whose volumes differ by less than this share are equal in size: the gap is cut out of the first.
_SAME_SIZE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class ContactFaces(Record):
    """Faces that two bodies share: nodes (f, 3), the tets (f, 2) on both sides and the numbers (f, 2) of their bodies,
    the smaller number first."""

    nodes: Index
    tets: Index
    bodies: Index

    def of(self, pairs: Container[Pair]) -> "ContactFaces":
        """The faces between some pairs of bodies."""
        mine = np.array([pair in pairs for pair in self.pair_of_each], dtype=bool)
        return ContactFaces(self.nodes[mine], self.tets[mine], self.bodies[mine])

    @property
    def pair_of_each(self) -> list[Pair]:
        """The pair of bodies of every face."""
        return [(a, b) for a, b in self.bodies.tolist()]

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Pairs of bodies in contact, in the order of their numbers."""
        return tuple((a, b) for a, b in np.unique(self.bodies, axis=0).tolist())


def contact_faces(tets: Index, body: Index) -> ContactFaces:
    """The contact faces of tetrahedra (m, 4) of bodies (m,)."""
    nodes, owner = _shared_faces(tets)
    apart = body[owner[:, 0]] != body[owner[:, 1]]
    nodes, owner = nodes[apart], owner[apart]
    turned = body[owner[:, 0]] > body[owner[:, 1]]
    owner[turned] = owner[turned][:, ::-1]
    return ContactFaces(nodes, owner, body[owner])


def rim_edges(tets: Index, faces: ContactFaces, walls: Mask | None = None) -> Index:
    """Edges (k, 2), sorted, of these faces on the surface of the tetrahedra: where the sheets will end.

    walls (n, w): which points lie in which wall of symmetry, behind which the iron goes on.
    """
    every = topology.distinct_parts(tets, topology.TET_FACES)
    outer = every.rows[every.times == 1]
    if walls is not None:
        outer = outer[~walls[outer].all(axis=1).any(axis=1)]
    outer = topology.distinct_parts(outer, topology.TRIANGLE_SIDES).rows
    mine = topology.distinct_parts(faces.nodes, topology.TRIANGLE_SIDES).rows
    found = topology.distinct_rows(np.concatenate([outer, mine]))
    return found.rows[found.times == 2]


@dataclass(frozen=True, eq=False, repr=False)
class Sheet(Record):
    """The joint of two bodies: its name, the numbers of the bodies, thickness in m, relative permeability; drawn: a gap
    of the device's drawing, thin against the elements, that was closed for the mesher."""

    name: str
    bodies: Pair
    gap: float
    mu_r: float
    drawn: bool = False


def sheets_between(
    device: Device, pairs: Sequence[Pair], drawn: Mapping[Pair, float] | None = None
) -> tuple[Sheet, ...]:
    """The joints of the pairs of bodies of a device that touch, in their order; drawn: gaps in m that were closed."""
    sheets = []
    for pair in pairs:
        first, second = (device.bodies[number].name for number in pair)
        name = f"{first} | {second}"
        if drawn is not None and pair in drawn:
            sheets.append(Sheet(name, pair, drawn[pair], 1.0, drawn=True))
            continue
        joint = joint_of(device.joints, first, second)
        if joint is not None:
            sheets.append(Sheet(name, pair, joint.gap, joint.mu_r))
    return tuple(sheets)


def images_of_pairs(pairs: Sequence[Pair], images: Sequence[Sequence[int]]) -> tuple[Pair, ...]:
    """Pairs of bodies and their images; images: the image of each body under each operation."""
    return tuple(sorted({_ordered(of_body[a], of_body[b]) for of_body in images for a, b in pairs}))


def sheet_images(sheets: Sequence[Sheet], images: Sequence[int]) -> tuple[int, ...]:
    """The images of the bodies under an operation, then of the sheets, which are numbered after the bodies; images: of
    the bodies alone."""
    number = {sheet.bodies: len(images) + k for k, sheet in enumerate(sheets)}
    return (*images, *(number[_ordered(images[a], images[b])] for a, b in (sheet.bodies for sheet in sheets)))


def _ordered(a: int, b: int) -> Pair:
    return min(a, b), max(a, b)


def with_rims(
    points: Array,
    tets: Index,
    body: Index,
    sheets: Sequence[Sheet],
    sharp: Index,
    first_layer: Array,
    walls: Mask | None = None,
) -> tuple[Index, Array]:
    """Sharp edges (s, 2) and first layers (m,) of the tets, with the rims of sheets among them; walls as for
    `rim_edges`.

    Around a gap g of area A and rim P, elements of the size h miss flux through the air near the rim:
    P g log(h / g) / (pi A) of the flux through the gap. Where that is little, layers may be thicker than the gap.
    """
    gaps = {sheet.bodies: sheet.gap for sheet in sheets}
    faces = contact_faces(tets, body).of(gaps)
    if len(faces.nodes) == 0:
        return sharp, first_layer
    rim = rim_edges(tets, faces, walls)
    at_rim = np.full(len(points), np.inf)
    for pair, layer in _rim_layers(points, faces, rim, gaps).items():
        own = rim[_on_pair(faces, pair, len(points))[rim].all(axis=1)]
        at_rim[own] = np.minimum(at_rim[own], layer)
    every = topology.distinct_rows(np.concatenate([sharp, rim])).rows
    return every, np.minimum(first_layer, at_rim[tets].min(axis=1))


def _rim_layers(
    points: Array, faces: ContactFaces, rim: Index, gaps: Mapping[Pair, float]
) -> dict[Pair, float]:
    """Thickness of the first layer of elements at the rim of each joint that has one."""
    length = np.linalg.norm(points[rim[:, 1]] - points[rim[:, 0]], axis=1)
    area = 0.5 * np.linalg.norm(topology.area_vectors(points[faces.nodes]), axis=1)
    layers = {}
    for pair in faces.pairs:
        around = length[_on_pair(faces, pair, len(points))[rim].all(axis=1)].sum()
        if around > 0:
            unseen = _UNSEEN * np.pi * area[(faces.bodies == pair).all(axis=1)].sum() / (around * gaps[pair])
            layers[pair] = _RIM_LAYER * gaps[pair] * float(np.exp(min(unseen, _MOST_UNSEEN)))
    return layers


def _on_pair(faces: ContactFaces, pair: Pair, count: int) -> Mask:
    """Which of `count` nodes lie on faces between these bodies."""
    here = np.zeros(count, dtype=bool)
    here[faces.nodes[(faces.bodies == pair).all(axis=1)]] = True
    return here


@dataclass(frozen=True, eq=False, repr=False)
class OpenedMesh(Record):
    """Points (n, 3), tets (m, 4) and bodies (m,): the given ones, then the sheets, the k-th as body count + k.

    parent (m,): the given tet from which each comes; for tets of a sheet, the one out of which the gap is cut.
    """

    points: Array
    tets: Index
    body: Index
    parent: Index


def open_sheets(
    points: Array,
    tets: Index,
    body: Index,
    sheets: Sequence[Sheet],
    count: int,
    walls: Mask | None = None,
    moves: Array | None = None,
) -> OpenedMesh:
    """Lay the sheets between bodies. points (n, 3) in m, tets (m, 4), body (m,) among `count` bodies; walls as for
    `rim_edges`; moves (b, 3): displacements of whole bodies, m, that had closed drawn gaps and are undone here.

    Where a third body bridges a joint's rim the sheet ends there without thickness.
    """
    gaps = {sheet.bodies: sheet.gap for sheet in sheets}
    faces, parent = contact_faces(tets, body).of(gaps), np.arange(len(tets))
    if len(faces.nodes) == 0:
        return OpenedMesh(points, tets, body, parent)
    drawn = {sheet.bodies for sheet in sheets if sheet.drawn}
    gap = np.array([0.0 if pair in drawn else gaps[pair] for pair in faces.pair_of_each])
    rows = np.arange(len(gap))
    edges, rim = rim_edges(tets, faces, walls), np.zeros(len(points), dtype=bool)
    rim[edges] = True
    side = _side_of_gap(points, tets, body, faces, rim)
    inner, outer = faces.tets[rows, side], faces.tets[rows, 1 - side]
    opened, source = _split_nodes(tets, faces)
    moving, staying = (_corners_in(tets, opened, faces, owner) for owner in (inner, outer))
    shift = _shifts(len(source), moving, staying, _normals(points, tets, faces, inner), gap)
    moved = _displaced(points[source], opened, body, shift)
    if moves is not None:
        back = np.zeros((len(source), 3))
        back[opened] = moves[body][:, None]
        moved -= back
    number = {sheet.bodies: count + k for k, sheet in enumerate(sheets)}
    # Layers within the sheet are of use only where the elements at its rim are thinner than the sheet.
    fine = {pair for pair, layer in _rim_layers(points, faces, edges, gaps).items() if layer < gaps[pair]}
    near = rim.copy()
    for _ in range(_RINGS):
        near[faces.nodes[near[faces.nodes].any(axis=1)]] = True
    layered = near[faces.nodes] & np.array([pair in fine for pair in faces.pair_of_each])[:, None]
    moved, new, of_face = _filled(moved, staying, moving, layered)
    of_sheet = np.array([number[pair] for pair in faces.pair_of_each])
    bodies, parents = np.concatenate([body, of_sheet[of_face]]), np.concatenate([parent, inner[of_face]])
    return OpenedMesh(moved, np.vstack([opened, new]), bodies, parents)


def _filled(points: Array, staying: Index, moving: Index, at_rim: Mask) -> tuple[Array, Index, Index]:
    """The points and new ones inside the sheet, the sheet's tetrahedra (k, 4), and the face (k,) of each tetrahedron.

    staying, moving (f, 3): faces and their opposite faces; at_rim (f, 3): corners at which the sheet has layers. The
    corners of a face move up to the opposite face one at a time, layer by layer; each step makes a tetrahedron. The
    step to the lowest layer comes first; on one layer, the step to the node with the smallest number. Neighbouring
    prisms therefore divide their common side alike. Where both faces have a corner in common, the sheet ends in it.
    """
    ends = topology.distinct_rows(np.column_stack([staying.ravel(), moving.ravel()]))
    wide = ends.rows[:, 0] != ends.rows[:, 1]
    layered = np.zeros(len(ends.rows), dtype=bool)
    layered[ends.number[at_rim.ravel()]] = True
    layered &= wide
    low, high = (points[ends.rows[layered, k]] for k in range(2))
    heights = np.array([*_LEVELS, 1.0])
    steps = np.full((len(ends.rows), len(heights)), -1)
    for k, height in enumerate(_LEVELS):
        steps[layered, k] = len(points) + np.arange(layered.sum())
        points = np.vstack([points, low + height * (high - low)])
    steps[wide, -1] = ends.rows[wide, 1]
    ladder = steps[ends.number].reshape(len(staying), -1)
    corner = np.repeat(np.arange(3), len(heights))
    level = np.tile(heights, 3)
    # Missing steps (-1) come last.
    order = np.lexsort([ladder, np.where(ladder < 0, 2.0, level)], axis=1)
    ladder, corner = np.take_along_axis(ladder, order, axis=1), corner[order]
    now, cells, faces = staying.copy(), [], []
    for k in range(ladder.shape[1]):
        here = np.flatnonzero(ladder[:, k] >= 0)
        cells.append(np.column_stack([now[here], ladder[here, k]]))
        faces.append(here)
        now[here, corner[here, k]] = ladder[here, k]
    return points, np.vstack(cells), np.concatenate(faces)


def _shared_faces(tets: Index) -> tuple[Index, Index]:
    """Faces (f, 3) between two tets, sorted, and these tets (f, 2)."""
    found = topology.distinct_parts(tets, topology.TET_FACES)
    order = np.argsort(found.number, kind="stable")
    twice = found.times[found.number[order]] == 2
    return found.rows[found.times == 2], (order[twice] // 4).reshape(-1, 2)


def _side_of_gap(points: Array, tets: Index, body: Index, faces: ContactFaces, rim: Mask) -> Index:
    """The side (f,), 0 or 1, out of which the gap is cut: the body whose walls at the rim are more nearly perpendicular
    to the joint, so that the nodes of these walls move within them; the smaller body where both are alike. rim: which
    nodes are on it."""
    normal = _normals(points, tets, faces, faces.tets[:, 0])
    at_node = np.zeros((len(points), 3))
    np.add.at(at_node, faces.nodes.ravel(), np.repeat(normal, 3, axis=0))
    every = topology.distinct_parts(tets, topology.TET_FACES)
    alone = every.times == 1
    wall, owner = every.rows[alone], body[every.first[alone] // 4]
    area = topology.area_vectors(points[wall])
    size = np.bincount(body, np.abs(volumes(points, tets)))
    side = np.zeros(len(faces.nodes), dtype=np.int64)
    for pair in faces.pairs:
        mine = (faces.bodies == pair).all(axis=1)
        here, slope = _on_pair(faces, pair, len(points)) & rim, []
        for number in pair:
            near = (owner == number) & here[wall].any(axis=1)
            along = np.where(here[wall[near]][:, :, None], at_node[wall[near]], 0.0).sum(axis=1)
            lengths = np.linalg.norm(area[near], axis=1) * np.linalg.norm(along, axis=1)
            facing = np.abs(np.einsum("fd,fd->f", area[near], along))
            slope.append(facing.sum() / lengths.sum() if len(lengths) else 0.0)
        alike = abs(slope[0] - slope[1]) < _SAME_SLOPE
        smaller = size[pair[1]] < size[pair[0]] * (1 - _SAME_SIZE)
        side[mine] = int(smaller if alike else slope[1] < slope[0])
    return side


def _split_nodes(tets: Index, faces: ContactFaces) -> tuple[Index, Index]:
    """Tets (m, 4) with new nodes, and the old node (n,) of every node. Around each node of the faces, tets that are
    connected without crossing these faces share one node."""
    nodes, owner = _shared_faces(tets)
    count = int(tets.max()) + 1
    here = np.zeros(count, dtype=bool)
    here[faces.nodes] = True
    number = topology.distinct_rows(np.concatenate([nodes, np.sort(faces.nodes, axis=1)])).number
    joined = ~np.isin(number[: len(nodes)], number[len(nodes) :])
    corner = 4 * np.arange(len(tets))[:, None] + np.arange(4)
    links = []
    for k in range(3):
        mine = joined & here[nodes[:, k]]
        ends = [
            corner[owner[mine, s], (tets[owner[mine, s]] == nodes[mine, k, None]).argmax(axis=1)]
            for s in range(2)
        ]
        links.append(np.column_stack(ends))
    group = topology.connected(np.concatenate(links), tets.size)
    touched = np.flatnonzero(here[tets.ravel()])
    # Each group of connected corners becomes a node; the first group at an old node keeps its number.
    first = np.full(group.max() + 1, tets.size)
    np.minimum.at(first, group[touched], touched)
    leaders = np.unique(first[group[touched]])
    leader_node = tets.ravel()[leaders]
    order = np.lexsort([leaders, leader_node])
    leaders, leader_node = leaders[order], leader_node[order]
    is_new = np.r_[False, leader_node[1:] == leader_node[:-1]]
    number = leader_node.copy()
    number[is_new] = count + np.arange(is_new.sum())
    of_group = np.full(group.max() + 1, -1)
    of_group[group[leaders]] = number
    opened = tets.ravel().copy()
    opened[touched] = of_group[group[touched]]
    source = np.concatenate([np.arange(count), leader_node[is_new]])
    return opened.reshape(-1, 4), source


def _corners_in(tets: Index, opened: Index, faces: ContactFaces, owner: Index) -> Index:
    """Nodes (f, 3) of the faces in the tets (f,) that own them, in the order of the faces."""
    place = (tets[owner][:, None, :] == faces.nodes[:, :, None]).argmax(axis=2)
    return np.take_along_axis(opened[owner], place, axis=1)


def _normals(points: Array, tets: Index, faces: ContactFaces, owner: Index) -> Array:
    """Unit normals (f, 3) that point into these tets (f,)."""
    corners = points[faces.nodes]
    normal = topology.area_vectors(corners)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inwards = np.einsum("fd,fd->f", normal, points[tets[owner]].mean(axis=1) - corners.mean(axis=1))
    return normal * np.sign(inwards)[:, None]


def _shifts(count: int, moving: Index, staying: Index, normal: Array, gap: Array) -> Array:
    """Displacements (n, 3) of the nodes on joints: the gap along the normal of each face around them; NaN for other
    nodes."""
    tensor, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    for k in range(3):
        free = moving[:, k] != staying[:, k]
        n = normal[free]
        np.add.at(tensor, moving[free, k], n[:, :, None] * n[:, None, :])
        np.add.at(right, moving[free, k], gap[free, None] * n)
    shift = np.full((count, 3), np.nan)
    on = np.flatnonzero(np.trace(tensor, axis1=1, axis2=2) > 0)
    inverse = np.linalg.pinv(tensor[on], rcond=_ONE_PLANE, hermitian=True)
    shift[on] = np.einsum("nij,nj->ni", inverse, right[on])
    shift[np.setdiff1d(np.unique(np.concatenate([moving, staying])), on)] = 0.0
    return shift


def _displaced(points: Array, tets: Index, body: Index, shift: Array) -> Array:
    """Points (n, 3) after the nodes on joints have moved by `shift`, and other nodes of the same bodies with them.

    A node at the distance s from the joint and t from the nodes that stay moves by t / (s + t) times the shift.
    """
    out = points.copy()
    on = np.isfinite(shift[:, 0])
    away = np.linalg.norm(np.nan_to_num(shift), axis=1) > 0
    # Lowest and highest body of every node: they differ if the node belongs to several bodies.
    low, high = np.full(len(points), np.iinfo(np.int64).max), np.full(len(points), -1)
    np.minimum.at(low, tets.ravel(), np.repeat(body, 4))
    np.maximum.at(high, tets.ravel(), np.repeat(body, 4))
    for number in np.unique(body[away[tets].any(axis=1)]):
        mine = np.unique(tets[body == number])
        start, others = mine[away[mine]], mine[~away[mine]]
        if len(others) == 0:
            continue
        distance, nearest = cKDTree(points[start]).query(points[others])
        stays = (low < high)[others] | on[others] | (distance > _FAR * distance.max())
        free = others[~stays]
        rest, _ = cKDTree(points[others[stays]]).query(points[free])
        share = rest / (distance[~stays] + rest)
        out[free] += share[:, None] * shift[start[nearest[~stays]]]
    out[away] += shift[away]
    return out

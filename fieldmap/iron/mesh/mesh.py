"""Tetrahedra of all iron bodies: made by the mesher, rounded, and cut into layers at sharp edges.

Vertices of curved surfaces move outward so that the flat-faced body has the true body's volume. A circle replaced by
the inscribed polygon of n sides is too small by 2 pi^2 / (3 n^2); at 36 sides that costs 5e-3 of the field. For a
segment with sagitta s the polygon of equal area lies 2 s / 3 further out. Here the sagitta of every edge is the
distance of its midpoint from the true surface, and each vertex of a curved face moves by the mean that keeps the
volume under the face: face T with edges e and corners v lacks A_T sum_e d_e / 3 and gains A_T sum_v shift_v / 3.

The mesh also finds the element that contains a point; `refuse_inside` refuses points that must lie in the air.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check
from fieldmap.device.drawing import Outline
from fieldmap.device.model import Body, Device, Sphere
from fieldmap.device.parts import joint_of
from fieldmap.device.tetrahedra import boundary, subdivided
from fieldmap.device.tetrahedra import oriented as oriented
from fieldmap.device.tetrahedra import volumes as volumes
from fieldmap.errors import InputError
from fieldmap.iron import topology
from fieldmap.iron.geometry.solids import glue_bodies, joined, own_mesh
from fieldmap.iron.geometry.thin_gaps import ClosedGaps, closed_gaps
from fieldmap.iron.mesh import joints
from fieldmap.iron.mesh.chamber import (
    Chamber,
    ChamberCopies,
    MeshSymmetry,
    chamber_contacts,
    glue_chamber,
    mirror_chamber,
    on_walls,
)
from fieldmap.iron.mesh.edge_grading import grade_edges, sharp_edges
from fieldmap.iron.mesh.mesher import LocalSizes, MesherCells, mesh_solids
from fieldmap.iron.symmetry import find_symmetry
from fieldmap.kernels.iron.containment import find_tetrahedron
from fieldmap.records import Record
from fieldmap.threads import over_rows
from fieldmap.typing import Array, Index

# An edge is straight if its midpoint is closer to the chord than this fraction of its length.
_STRAIGHT = 1e-6
# Ratio of one layer's thickness to the next at sharp edges.
LAYER_RATIO = 0.4
# Moves of bodies that differ by less, m, are the same: far below the thinnest gap.
_SAME_MOVE = 1e-10
SYMMETRIES = ("auto", "workspace", "none")


class BodyMesh(Record):
    """Meshes of all bodies: elements, or surfaces of solids. body: index of each of these into `body_names`."""

    body: Index
    body_names: tuple[str, ...]

    @abstractmethod
    def containing(self, points: Array) -> Index:
        """Number (n,) of the element or solid that contains each point (n, 3), -1 in the air."""

    @abstractmethod
    def outlines(self) -> tuple[Outline, ...]:
        """The surface of every body, with the faces that it shares with other bodies."""

    @property
    def iron_names(self) -> tuple[str, ...]:
        """Names of the bodies without the sheets between them."""
        return self.body_names


@dataclass(frozen=True, eq=False, repr=False)
class IronMesh(BodyMesh):
    """Tetrahedra of all iron bodies.

    points (n, 3) in m; tets (m, 4), positively oriented; body (m,) index into `body_names`.
    Bodies that touch share points. symmetry: operations that map the mesh onto itself exactly, if it was copied from a
    chamber; cells: the mesher's own tetrahedra, before layers were cut at sharp edges, None with meshes of the user's
    own. sheets: thin gaps between bodies that touch; they come last among the bodies.
    """

    points: Array
    tets: Index
    body: Index
    body_names: tuple[str, ...]
    symmetry: MeshSymmetry | None = None
    cells: MesherCells | None = None
    sheets: tuple[joints.Sheet, ...] = ()

    @cached_property
    def nodes_of_bodies(self) -> tuple[Index, ...]:
        """Numbers of the points of each body, in order; bodies that touch share some."""
        return tuple(np.unique(self.tets[self.body == number]) for number in range(len(self.body_names)))

    @property
    def iron_names(self) -> tuple[str, ...]:
        """Names of the bodies without the sheets between them."""
        return self.body_names[: len(self.body_names) - len(self.sheets)]

    def containing(self, points: Array) -> Index:
        """Element that contains each point.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Index
            Indices (n,), -1 in the air. Points on a surface may fall on either side.
        """
        boxes = _BOXES.get(self)
        if boxes is None:
            corners = self.points[self.tets]
            lower, upper = corners.min(axis=1), corners.max(axis=1)
            boxes = _BOXES[self] = corners, lower, upper, lower.min(axis=0), upper.max(axis=0)
        element = np.full(len(points), -1)
        near = ((points >= boxes[3]) & (points <= boxes[4])).all(axis=1)
        if near.any():
            chosen, found = points[near], element[near]
            over_rows(find_tetrahedron, len(chosen), chosen, *boxes[:3], found, work=len(self.tets))
            element[near] = found
        return element

    def outlines(self) -> tuple[Outline, ...]:
        """The surface of every body, with the faces that it shares with other bodies."""
        return tuple(
            outline_of(name, self.points, boundary(self.points, self.tets[self.body == number]))
            for number, name in enumerate(self.body_names)
        )

    @property
    def drawn_sheets(self) -> tuple[int, ...]:
        """Numbers, among the bodies, of the sheets that lie in gaps of the drawing."""
        first = len(self.body_names) - len(self.sheets)
        return tuple(first + k for k, sheet in enumerate(self.sheets) if sheet.drawn)

    def without_drawn_sheets(self) -> IronMesh:
        """The iron alone, with air in the drawn gaps; the same points and numbers of bodies."""
        if not self.drawn_sheets:
            return self
        kept = ~np.isin(self.body, self.drawn_sheets)
        return IronMesh(self.points, self.tets[kept], self.body[kept], self.body_names, sheets=self.sheets)


def outline_of(name: str, points: Array, triangles: Index) -> Outline:
    """The outline of a body with these triangles (m, 3) of points (n, 3)."""
    nodes, number = np.unique(triangles, return_inverse=True)
    return Outline(name, "iron", points[nodes], number.reshape(-1, 3))


def generate_mesh(
    device: Device, refinement: float = 1.0, symmetry: str = "none", local: LocalSizes | None = None
) -> IronMesh:
    """Mesh all iron bodies of a device.

    Parameters
    ----------
    device
        Its bodies.
    refinement
        Divides every element size of the device file (2 halves them); the first layer at sharp edges is
        divided by its square, because the error of the graded elements falls twice as fast as the error of the
        layer. Bodies that are meshes are taken as they are; a refinement of 2, 4, ... halves all their edges
        once, twice, ....
    symmetry
        "auto": where the iron has mirror planes, one chamber between them is meshed and copied, so that the
        mesh has the symmetry exactly; "workspace": only with mirrors that map the box of the workspace onto
        itself; "none": meshed as a whole.
    local
        Element sizes at points, used where they are smaller than the device file's, and first layers at sharp
        edges, used instead of the device file's.

    Returns
    -------
    IronMesh
        The tetrahedra of all bodies.

    Raises
    ------
    InputError
        For an unknown symmetry; with bodies that are meshes, for a refinement other than 1, 2, 4, ....
    GeometryError
        Where the mesher fails.
    """
    known = f"must be one of {', '.join(SYMMETRIES)}"
    check(symmetry in SYMMETRIES, "symmetry", known, repr(symmetry), 'try "auto"')
    own = tuple(body for body in device.bodies if body.has_own_mesh)
    if own:
        return _with_own_meshes(device, own, refinement)
    chamber = None if symmetry == "none" else _chamber(device, symmetry == "workspace")
    closed = closed_gaps(device)
    if closed is not None:
        device = closed.device
        chamber = chamber if chamber is not None and _is_kept(chamber, closed) else None
    if chamber is not None and (shape := glue_chamber(device, chamber)) is not None:
        copied = _copied_chamber(device, chamber, shape, refinement, local, closed)
        if copied is not None:
            return copied
    return _meshed_whole(device, refinement, local, closed)


def _is_kept(chamber: Chamber, closed: ClosedGaps) -> bool:
    """Whether the operations still map the bodies onto each other after the moves that close gaps."""
    return all(
        np.abs(one.matrix @ closed.moves[k] - closed.moves[image]).max() < _SAME_MOVE
        for one in chamber.group.operations
        for k, image in enumerate(one.bodies)
    )


def _meshed_whole(
    device: Device, refinement: float, local: LocalSizes | None, closed: ClosedGaps | None
) -> IronMesh:
    points, tets, body, edges, midpoints = _made_by_mesher(glue_bodies(device), device, refinement, local)
    sharp = sharp_edges(points, tets, edges, midpoints)
    points = equal_volume_vertices(points, tets, body, *midpoints)
    first = _first_layers(device, refinement, points[tets].mean(axis=1), body, local)
    pairs = joints.contact_faces(tets, body).pairs
    sheets, opened, parent = _layered(device, points, tets, body, sharp, first, pairs, closed)
    cells = MesherCells.of(points, tets, parent[opened.parent], _largest(device, refinement)[body], local)
    return _iron_mesh(device, opened, sheets, cells)


def _copied_chamber(
    device: Device,
    chamber: Chamber,
    shape,
    refinement: float,
    local: LocalSizes | None,
    closed: ClosedGaps | None,
) -> IronMesh | None:
    """The mesh of a chamber with its copies; None if a joint lies in a wall, which would cut it along its middle."""
    points, tets, body, edges, midpoints = _made_by_mesher(shape, device, refinement, local)
    names, images = [one.name for one in device.bodies], [one.bodies for one in chamber.group.operations]
    in_walls = chamber_contacts(chamber, points, tets, body)
    if any(joint_of(device.joints, names[one], names[other]) is not None for one, other in in_walls):
        return None
    points, sharp = _rounded_chamber(chamber, points, tets, body, edges, midpoints)
    pairs = joints.images_of_pairs(joints.contact_faces(tets, body).pairs, images)
    first = _first_layers(device, refinement, points[tets].mean(axis=1), body, local)
    sheets, opened, parent = _layered(device, points, tets, body, sharp, first, pairs, closed, chamber)
    cells = MesherCells.of(points, tets, parent[opened.parent], _largest(device, refinement)[body], local)
    copies = ChamberCopies(chamber, opened.points)
    tets = copies.tets(oriented(copies.points, opened.tets))
    numbers = copies.bodies(opened.body, [joints.sheet_images(sheets, of_bodies) for of_bodies in images])
    every = (*names, *(sheet.name for sheet in sheets))
    return IronMesh(copies.all_points(), tets, numbers, every, copies.symmetry(), copies.cells(cells), sheets)


def _layered(
    device: Device,
    points: Array,
    tets: Index,
    body: Index,
    sharp: Index,
    first: Array,
    pairs: Sequence[tuple[int, int]],
    closed: ClosedGaps | None,
    chamber: Chamber | None = None,
) -> tuple[tuple[joints.Sheet, ...], joints.OpenedMesh, Index]:
    """The sheets between pairs of bodies, the mesh with them and with layers at sharp edges, and the given tet of which
    each tet with layers is a part."""

    def walls(at: Array) -> NDArray[np.bool_] | None:
        return None if chamber is None else on_walls(chamber, at)

    gaps, moves = (None, None) if closed is None else (closed.gaps, closed.moves)
    sheets = joints.sheets_between(device, pairs, gaps)
    sharp, first = joints.with_rims(points, tets, body, sheets, sharp, first, walls(points))
    graded, cut, parent = grade_edges(points, tets, sharp, first, LAYER_RATIO)
    count = len(device.bodies)
    opened = joints.open_sheets(graded, cut, body[parent], sheets, count, walls(graded), moves)
    return sheets, opened, parent


def _first_layers(
    device: Device, refinement: float, places: Array, body: Index, local: LocalSizes | None
) -> Array:
    """Thickness (m,) of the first layer at the sharp edges of tets at places (m, 3) in bodies (m,)."""
    if local is not None:
        return local.first_layer(places)
    return np.array([one.edge_size or np.inf for one in device.bodies])[body] / refinement**2


def _largest(device: Device, refinement: float) -> Array:
    """Largest element (b,) of every body."""
    return np.array([one.mesh_size or np.inf for one in device.bodies]) / refinement


def _iron_mesh(
    device: Device, opened: joints.OpenedMesh, sheets: tuple[joints.Sheet, ...], cells: MesherCells | None
) -> IronMesh:
    tets = oriented(opened.points, opened.tets)
    names = (*(body.name for body in device.bodies), *(sheet.name for sheet in sheets))
    return IronMesh(opened.points, tets, opened.body, names, None, cells, sheets)


def _with_own_meshes(device: Device, own: tuple[Body, ...], refinement: float) -> IronMesh:
    """The mesh of a device with bodies that are meshes; the other bodies are meshed together, without symmetry."""
    halvings = np.log2(refinement)
    if halvings < 0 or halvings != np.round(halvings):
        raise InputError.of(
            f"device '{device.name}', body '{own[0].name}'",
            "a mesh of your own is used as it is, or with all its edges halved: refinement 1, 2, 4, ...",
            f"refinement {refinement:g}",
            "bring a finer mesh, or take refinement 2 and compare",
        )
    others = tuple(body for body in device.bodies if not body.has_own_mesh)
    names, meshes = tuple(body.name for body in device.bodies), []
    if others:
        rest = Device.unchecked(name=device.name, bodies=others, materials=device.materials)
        meshed = generate_mesh(rest, refinement)
    for body in device.bodies:
        if body.has_own_mesh:
            points, tets = own_mesh(body)
            for _ in range(int(halvings)):
                points, tets = subdivided(points, tets)
        else:
            points, tets = meshed.points, meshed.tets[meshed.body == meshed.body_names.index(body.name)]
        meshes.append((points, tets))
    points, of_bodies = joined(meshes)
    used, tets = np.unique(np.concatenate(of_bodies), return_inverse=True)
    tets, points = tets.reshape(-1, 4), points[used]
    number = np.repeat(np.arange(len(names)), [len(one) for one in of_bodies])
    sheets = joints.sheets_between(device, joints.contact_faces(tets, number).pairs)
    return _iron_mesh(device, joints.open_sheets(points, tets, number, sheets, len(names)), sheets, None)


def _chamber(device: Device, keeps_workspace: bool) -> Chamber | None:
    """The chamber to be meshed. Where mirrors meet on a sphere, four faces meet at a pole, and errors of the field near
    it are three to eight times as large as with other meshes: devices with spheres use one mirror only."""
    round_ends = any(
        isinstance(part.shape.primitive, Sphere) for body in device.bodies for part in body.parts
    )
    group = find_symmetry(device)
    if keeps_workspace and device.bounds is not None:
        group = group.keeping_box(*device.bounds)
    return mirror_chamber(group, most_walls=1 if round_ends else 3)


def _rounded_chamber(chamber: Chamber, points, tets, body, edges, midpoints):
    """The chamber's points after rounding, and its sharp edges: found on the whole mesh, where walls are no surface."""
    copies, count = ChamberCopies(chamber, points), len(points)
    everything, all_tets = copies.all_points(), copies.tets(tets)
    ends, first, _, _ = topology.distinct_rows(np.sort(copies.nodes(midpoints[0]), axis=1))
    all_midpoints = ends, copies.vectors(midpoints[1])[first]
    sharp = sharp_edges(everything, all_tets, copies.nodes(edges), all_midpoints)
    rounded = equal_volume_vertices(everything, all_tets, copies.bodies(body), *all_midpoints)
    return copies.onto_walls(rounded[:count]), sharp[(sharp < count).all(axis=1)]


def equal_volume_vertices(points: Array, tets: Index, body: Index, edges: Index, midpoints: Array) -> Array:
    """New points (n, 3) for tets (m, 4) of bodies (m,).

    edges (k, 2), sorted, lexicographic; midpoints (k, 3) of the edges on the true surface. Works on the surfaces
    between iron and air and on curved surfaces between bodies alike.
    """
    faces, _, number, count = topology.distinct_parts(tets, topology.TET_FACES)
    # If a face separates bodies, the sum of its two owners' numbers differs from twice one of them.
    owner = np.repeat(body, 4)
    total, one = np.bincount(number, owner, len(faces)), np.zeros(len(faces))
    one[number] = owner
    return rounded_vertices(points, faces[(count == 1) | (total != 2 * one)], edges, midpoints)


def rounded_vertices(points: Array, faces: Index, edges: Index, midpoints: Array) -> Array:
    """New points (n, 3), so that surfaces of triangles `faces` (f, 3) enclose the true volume; otherwise as
    `equal_volume_vertices`."""
    bulge = midpoints - 0.5 * (points[edges[:, 0]] + points[edges[:, 1]])
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    curved = np.linalg.norm(bulge, axis=1) > _STRAIGHT * length
    if not curved.any():
        return points
    faces = np.sort(faces, axis=1)
    sides = np.searchsorted(
        topology.edge_keys(edges, len(points)),
        topology.edge_keys(faces[:, topology.TRIANGLE_SIDES], len(points)),
    )
    kept = curved[sides].any(axis=1)
    faces, sides = faces[kept], sides[kept]
    normal = topology.area_vectors(points[faces])
    area = np.linalg.norm(normal, axis=1)
    normal /= area[:, None]
    # Faces in a plane (disk faces at a round rim) have bulges in their own plane and lose no volume.
    lost = np.abs(np.einsum("ijk,ik->ij", bulge[sides], normal)) > _STRAIGHT * length[sides]
    face_is_curved = lost.any(axis=1)
    faces, sides, area = faces[face_is_curved], sides[face_is_curved], area[face_is_curved]
    weight_at_edge = np.bincount(sides.ravel(), np.repeat(area, 3), len(edges))
    weight_at_vertex = np.bincount(faces.ravel(), np.repeat(area, 3), len(points))
    shift = np.zeros_like(points)
    for end in range(2):
        np.add.at(shift, edges[:, end], 0.5 * weight_at_edge[:, None] * bulge)
    touched = weight_at_vertex > 0
    shift[touched] /= weight_at_vertex[touched, None]
    shift[~touched] = 0
    return points + shift


def _made_by_mesher(shape, device: Device, refinement: float, local: LocalSizes | None = None):
    """Points in m, tets, body index, edges of the solids (k, 2), and the curved midpoints of all element edges."""
    mesh = mesh_solids(shape, device, refinement, local)
    index = {body.name: k for k, body in enumerate(device.bodies)}
    body = np.array([index[solid.name] for solid in shape.solids])
    return mesh.points, mesh.elements, body[mesh.solids], mesh.solid_edges, (mesh.ends, mesh.midpoints)


# Corners (m, 4, 3) of the elements, lower and upper corners of their boxes, and of the box around all. Kept, because
# they take longer than the field at a point; not in the mesh itself, which would send them to other processes.
_BOXES: WeakKeyDictionary[IronMesh, tuple[Array, ...]] = WeakKeyDictionary()


def checked_points(points: ArrayLike) -> tuple[Array, bool]:
    """Points (n, 3) and whether a single point (3,) was given. Raises InputError unless finite and of such a shape."""
    x = np.ascontiguousarray(points, dtype=float)
    if x.shape[-1:] != (3,) or x.ndim > 2 or not np.isfinite(x).all():
        must_hold = "points must be finite and of shape (n, 3) or (3,)"
        raise InputError.of("points", must_hold, f"shape {x.shape}", "give x, y, z in m")
    return np.atleast_2d(x), x.ndim == 1


def refuse_inside(mesh: BodyMesh | None, x: Array) -> None:
    """Raise InputError if a point (n, 3) lies inside the iron, where the solver defines no gradient."""
    if mesh is None:
        return
    within = mesh.containing(x)
    inside = np.flatnonzero(within >= 0)
    if len(inside):
        name = mesh.body_names[mesh.body[within[inside[0]]]]
        must_hold = "the gradient is defined outside the iron only"
        received = f"{len(inside)} of {len(x)} points inside, the first at {x[inside[0]]} m in body '{name}'"
        raise InputError.of("points", must_hold, received, "keep the points in the air")

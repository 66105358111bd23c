"""Mirrors and rotations that map a device onto itself: found from its parts up to rounding, made an exact group."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.model import (
    Body,
    Box,
    Cylinder,
    Device,
    ExtrudedPolygon,
    MeshFile,
    Placement,
    RevolvedProfile,
    Ring,
    Shape,
    Sphere,
    StepFile,
    TriangleSurface,
    VolumeMesh,
)
from fieldmap.device.parts import joint_of
from fieldmap.iron.symmetry.group import Operation, SymmetryGroup, multiplication_table
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Values of cosines and sines that appear in matrices of axes along the coordinates.
_EXACT = np.array([0.0, 0.5, 1.0, np.sqrt(0.5), np.sqrt(0.75)])


def exact_matrices(found: Array) -> Array | None:
    """The exact representation next to nearly orthogonal matrices (g, 3, 3), the identity first; None if no group.

    A vector v is known by the function h -> matrices[h]^T v on the group. These functions form a subspace that left
    translations nearly keep; averaged over the group, its projector commutes with them exactly, and its eigenspace
    carries the exact representation.
    """
    table = multiplication_table(found)
    if table is None or len(np.unique(table[:, 0])) < len(found):
        return None
    order = len(found)
    inverse = np.argmax(table == 0, axis=1)
    functions = np.swapaxes(found, 1, 2).reshape(3 * order, 3) / np.sqrt(order)
    rows = 3 * np.repeat(np.arange(order), 3) + np.tile(np.arange(3), order)
    projector = np.zeros((3 * order, 3 * order))
    translations = []
    for g in range(order):
        # (g f)(h) = f(g^-1 h)
        moved = 3 * np.repeat(table[inverse[g]], 3) + np.tile(np.arange(3), order)
        translations.append(moved)
        shifted = functions[moved]
        projector += shifted @ shifted.T / order
    basis = np.linalg.eigh(projector)[1][:, -3:]
    # The orthonormal basis closest to the functions of the coordinate axes keeps the orientation.
    u, _, v = np.linalg.svd(basis.T @ functions)
    basis = basis @ (u @ v)
    exact = np.array([basis[rows].T @ basis[moved] for moved in translations])
    return _rounded(exact)


def _rounded(matrices: Array) -> Array:
    """Entries within rounding of 0, 1/2, 1 and the roots of 1/2 and 3/4 get these values."""
    size = np.abs(matrices)
    nearest = _EXACT[np.abs(size[..., None] - _EXACT).argmin(axis=-1)]
    return np.where(np.abs(size - nearest) < 1e-12, np.sign(matrices) * nearest, matrices)


@dataclass(frozen=True, eq=False, repr=False)
class Outline(Record):
    """kind: what must be equal word for word; rows (k, 8)."""

    kind: tuple[object, ...]
    rows: Array

    def moved(self, matrix: Array, centre: Array) -> "Outline":
        """The image under a linear map about `centre`."""
        rows = self.rows.copy()
        for part in (slice(0, 3), slice(3, 6)):
            rows[:, part] = (rows[:, part] - centre) @ matrix.T + centre
        return Outline(self.kind, rows)

    def is_like(self, other: "Outline", tolerance: float) -> bool:
        """Whether both are the same set of segments."""
        if self.kind != other.kind or len(self.rows) != len(other.rows):
            return False
        distance = np.abs(self.rows[:, None] - other.rows[None]).max(axis=2)
        # Both ways, for features that are as small as the tolerance.
        return bool(distance.min(axis=0).max() < tolerance and distance.min(axis=1).max() < tolerance)


@dataclass(frozen=True, eq=False, repr=False)
class Item(Record):
    """A body or winding: kind, and runs of outlines. Within a run (parts added, or parts cut) the order is free."""

    kind: tuple[object, ...]
    runs: tuple[tuple[Outline, ...], ...]

    @property
    def points(self) -> Array:
        """All segment ends (n, 3)."""
        return np.concatenate([outline.rows[:, :3] for run in self.runs for outline in run])

    def moved(self, matrix: Array, centre: Array) -> "Item":
        """The image under a linear map about `centre`."""
        return Item(self.kind, tuple(tuple(o.moved(matrix, centre) for o in run) for run in self.runs))

    def is_like(self, other: "Item", tolerance: float) -> bool:
        """Whether both are of one kind and fill the same space, as far as their parts tell."""
        if self.kind != other.kind or [len(r) for r in self.runs] != [len(r) for r in other.runs]:
            return False
        return all(_same_set(a, b, tolerance) for a, b in zip(self.runs, other.runs, strict=True))


def _same_set(these: tuple[Outline, ...], those: tuple[Outline, ...], tolerance: float) -> bool:
    left = list(those)
    for outline in these:
        match = next((k for k, other in enumerate(left) if outline.is_like(other, tolerance)), None)
        if match is None:
            return False
        del left[match]
    return True


def body_item(body: Body, kind: tuple[object, ...]) -> Item:
    """A body's parts. `kind` holds whatever else must be equal in bodies that are alike."""
    runs: list[tuple[str, list[Outline]]] = []
    for part in body.parts:
        if not runs or runs[-1][0] != part.operation:
            runs.append((part.operation, []))
        kind_of_shape, rows = _shape_rows(part.shape)
        runs[-1][1].append(Outline(kind_of_shape, _placed(rows, part.placement)))
    operations = tuple(operation for operation, _ in runs)
    return Item((*kind, operations), tuple(tuple(outlines) for _, outlines in runs))


def coil_item(coil: Coil) -> Item:
    """A winding as a space filled with turns; the sense of the current is left out."""
    path = coil.winding()
    if path.is_circle:
        half = 0.5 * path.height * np.array([0.0, 0.0, 1.0])
        rows = _both_ways(-half[None], half[None], *path.arcs[0, 5:7])
        kind: tuple[object, ...] = ("circular", abs(coil.turns))
    else:
        rows = np.concatenate([_arc_rows(path), _bar_rows(path)])
        kind = ("path", abs(coil.turns), path.thickness)
    return Item(kind, ((Outline((), _placed(rows, coil.placement)),),))


def coil_axis(coil: Coil) -> Array:
    """Direction (3,) of the moment of a positive current: an axial vector."""
    sense = np.sign(coil.turns) * coil.polarity * coil.winding().turning
    return np.asarray(coil.placement.rotation, dtype=float)[:, 2] * sense


def _arc_rows(path: WindingPath) -> Array:
    """Centre and middle of every arc, with half its length."""
    radius = 0.5 * (path.arcs[:, 5] + path.arcs[:, 6])
    flat = np.zeros((len(path.arcs), 3))
    centre, middle = flat.copy(), flat
    centre[:, :2] = path.arcs[:, :2]
    middle[:, :2] = path.arcs[:, :2] + radius[:, None] * path.arcs[:, 2:4]
    height = np.full(len(flat), path.height)
    return np.column_stack([centre, middle, radius * path.arcs[:, 4], height])


def _bar_rows(path: WindingPath) -> Array:
    """The ends of every bar, both ways."""
    half = path.bars[:, 4:] * path.bars[:, 2:4]
    level = np.zeros(len(half))
    ends = [np.column_stack([path.bars[:, :2] + side * half, level]) for side in (-1.0, 1.0)]
    return _both_ways(*ends, 0.0, path.height)


def _shape_rows(shape: Shape) -> tuple[tuple[object, ...], Array]:
    match shape:
        case Cylinder(radius, height):
            return ("turned",), _turned(np.array([[0, 0], [radius, 0], [radius, height], [0, height]]))
        case Ring(inner, outer, height):
            return ("turned",), _turned(np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]))
        case RevolvedProfile(points):
            return ("turned",), _turned(np.asarray(points, dtype=float))
        case Box((x, y, z)):
            outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
            return ("prism",), _prism(outline, z)
        case ExtrudedPolygon(points, height):
            return ("prism",), _prism(np.asarray(points, dtype=float), height)
        case Sphere(radius):
            return ("sphere",), np.array([[0.0] * 6 + [radius, 0.0]])
        case TriangleSurface(points, triangles):
            return ("surface",), _surface_rows(np.asarray(points), np.asarray(triangles))
        case StepFile(path, scale):
            # The solid's own symmetry is not looked at: a frame of three labelled points has none.
            return ("step", str(path), scale), _labelled_frame()
        case MeshFile(path, scale, region):
            return ("mesh file", str(path), scale, region), _labelled_frame()
        case VolumeMesh(points, tets):
            # As that of a STEP file: nothing but a copy of the same mesh is its image.
            kind = ("mesh", np.asarray(points).tobytes(), np.asarray(tets).tobytes())
            return kind, _labelled_frame()


def _labelled_frame() -> Array:
    rows = np.zeros((4, 8))
    rows[1:, :3] = np.eye(3) * 0.1
    rows[:, 6] = np.arange(4)
    return rows


def _surface_rows(points: Array, triangles: Index) -> Array:
    """The edges of a surface that are no diagonals of plane faces."""
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    order = np.lexsort(np.sort(sides, axis=1).T)
    one, other = order[::2], order[1::2]
    bent = np.einsum("kd,kd->k", normals[one // 3], normals[other // 3]) < 1 - 1e-9
    start, end = points[sides[one[bent]]].transpose(1, 0, 2)
    return _both_ways(start, end, 0.0, 0.0)


def _both_ways(start: Array, end: Array, *scalars: float | Array) -> Array:
    forth = np.column_stack([start, end, *(np.broadcast_to(s, len(start)) for s in scalars)])
    back = np.column_stack([end, start, *(np.broadcast_to(s, len(start)) for s in scalars)])
    return np.unique(np.concatenate([forth, back]), axis=0)


def _prism(outline: Array, height: float) -> Array:
    low = np.column_stack([outline, np.zeros(len(outline))])
    high = low + [0.0, 0.0, height]
    start = np.concatenate([low, high, low])
    end = np.concatenate([np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high])
    return _both_ways(start, end, 0.0, 0.0)


def _turned(profile: Array) -> Array:
    """Each edge of the profile as two points on the axis, with the radii as its scalars."""
    other = np.roll(profile, -1, axis=0)
    points = [np.column_stack([np.zeros((len(p), 2)), p[:, 1]]) for p in (profile, other)]
    forth = np.column_stack([*points, profile[:, 0], other[:, 0]])
    back = np.column_stack([points[1], points[0], other[:, 0], profile[:, 0]])
    return np.unique(np.concatenate([forth, back]), axis=0)


def _placed(rows: Array, placement: Placement) -> Array:
    out = rows.copy()
    rotation = np.asarray(placement.rotation, dtype=float)
    for part in (slice(0, 3), slice(3, 6)):
        out[:, part] = rows[:, part] @ rotation.T + placement.position
    return out


# Positions and lengths are compared to this fraction of the iron's size: device files give seven digits or so.
_RELATIVE_TOLERANCE = 1e-6
_IDENTITY = np.eye(3)


def find_symmetry(device: Device) -> SymmetryGroup:
    """All mirrors and rotations that map the iron onto itself, and what they do to coils and magnets.

    Bodies are alike where shape, material (for magnets: mu_r) and mesh sizes are. Lengths and positions count as
    equal within 1e-6 of the iron's size. The parts of the device file are compared, not the solids they add up to:
    a symmetric body made of parts that are not is not recognised, and a STEP body or a mesh counts as one
    without any symmetry of its own. Never raises.

    >>> import fieldmap as fm
    >>> print(find_symmetry(fm.read_device("drive_unit")))
    mirror y = 0
    >>> print(find_symmetry(fm.read_device("disk_six_cores")))
    6-fold axis z with 6 mirror planes
    """
    iron = [body_item(body, _kind(device, body)) for body in device.bodies]
    coils = [coil_item(coil) for coil in device.coils if coil.has_winding]
    if not iron:
        return SymmetryGroup((_trivial(device),), np.zeros(3), 0.0, ("no iron",))
    points = np.concatenate([item.points for item in iron])
    centre = points.mean(axis=0)
    size = float(np.abs(points - centre).max()) or max(_largest_scalar(item) for item in iron)
    centre[np.abs(centre) < 1e-12 * size] = 0.0
    tolerance = _RELATIVE_TOLERANCE * max(size, max(_largest_scalar(item) for item in iron))
    limits = tuple(
        f"body '{body.name}' {'is a mesh' if body.has_own_mesh else 'comes from a STEP file'},"
        " whose own symmetry is not looked at"
        for body in device.bodies
        if body.has_own_mesh or any(isinstance(part.shape, StepFile) for part in body.parts)
    )
    matrices = _finite_group(iron, coils, centre, tolerance)
    found = (_operation(device, m, centre, iron, coils, tolerance) for m in matrices)
    operations = tuple(operation for operation in found if _keeps_joints(device, operation.bodies))
    return SymmetryGroup(operations, centre, tolerance, limits)


def _finite_group(iron: list[Item], coils: list[Item], centre: Array, tolerance: float) -> Array:
    """Matrices (g, 3, 3), the identity first."""
    found = _candidates(iron, centre, tolerance)
    if found is None:
        # Iron with infinitely many operations. The coils may be less symmetric.
        joint = _candidates(iron + coils, centre, tolerance)
        found = [] if joint is None else _valid(joint, iron + coils, centre, tolerance)
        if len(found) < 2:
            found = _mirrors_of_axis(iron, coils, centre, tolerance)
    valid = _valid(found, iron, centre, tolerance)
    exact = exact_matrices(np.array([_IDENTITY, *valid]))
    return _IDENTITY[None] if exact is None else exact


def _valid(candidates: Sequence[Array], items: list[Item], centre: Array, tolerance: float) -> list[Array]:
    """Candidates that map the items onto themselves, each once, without the identity."""
    kept: list[Array] = [_IDENTITY]
    for matrix in candidates:
        if min(np.abs(matrix - other).max() for other in kept) < 1e-4:
            continue
        if _images(items, matrix, centre, tolerance) is not None:
            kept.append(matrix)
    return kept[1:]


def _candidates(items: list[Item], centre: Array, tolerance: float) -> list[Array] | None:
    """Orthogonal matrices that map two reference points onto possible images; None if all points lie on one axis."""
    kinds = list(dict.fromkeys((item.kind, len(item.points)) for item in items))
    label = np.concatenate([np.full(len(i.points), kinds.index((i.kind, len(i.points)))) for i in items])
    points = np.concatenate([item.points for item in items]) - centre
    _, first = np.unique(np.column_stack([np.round(points / tolerance), label]), axis=0, return_index=True)
    points, label = points[first], label[first]
    radius = np.linalg.norm(points, axis=1)
    size = radius.max()
    if size < tolerance:
        return None
    alike = (label[:, None] == label) & (np.abs(radius[:, None] - radius) < 4 * tolerance)
    far = radius > 0.1 * size
    one = int(np.where(far, alike.sum(axis=1), len(points) + 1).argmin())
    off_axis = np.linalg.norm(np.cross(points[one] / radius[one], points), axis=1)
    if off_axis.max() < 2 * tolerance:
        return None
    usable = off_axis > 0.3 * off_axis.max()
    two = int(np.where(usable, alike.sum(axis=1), len(points) + 1).argmin())
    frame = _frame(points[one], points[two])
    matrices = []
    for a in np.flatnonzero(alike[one]):
        angle_fits = np.abs(points @ points[a] - points[one] @ points[two]) < 8 * tolerance * size
        for b in np.flatnonzero(alike[two] & angle_fits):
            image = _frame(points[a], points[b])
            matrices += [image @ frame.T, image @ np.diag([1.0, 1.0, -1.0]) @ frame.T]
    return matrices


def _mirrors_of_axis(iron: list[Item], coils: list[Item], centre: Array, tolerance: float) -> list[Array]:
    """Two mirrors through the axis of round iron and their products, and the mirror across it where there is one."""
    points = np.concatenate([item.points for item in iron]) - centre
    if np.abs(points).max() < tolerance and coils:  # a sphere: the coils' axis, if they have one
        points = np.concatenate([item.points for item in coils]) - centre
        points = points if np.linalg.matrix_rank(points, tol=tolerance) == 1 else np.zeros((1, 3))
    longest = points[np.linalg.norm(points, axis=1).argmax()]
    axis = longest / np.linalg.norm(longest) if np.linalg.norm(longest) > tolerance else _IDENTITY[2]
    # The coordinate axis that is least along the axis, made perpendicular to it.
    side = _IDENTITY[np.abs(axis).argmin()]
    side = side - (side @ axis) * axis
    frame = np.column_stack([side / np.linalg.norm(side), np.cross(axis, side / np.linalg.norm(side)), axis])
    signs = [(a, b, c) for c in (1, -1) for a in (1, -1) for b in (1, -1)]
    return [frame @ np.diag(np.array(sign, dtype=float)) @ frame.T for sign in signs]


def _frame(first: Array, second: Array) -> Array:
    """Right-handed orthonormal columns: along the first, and in the half-plane of the second."""
    e1 = first / np.linalg.norm(first)
    e2 = second - (second @ e1) * e1
    e2 /= np.linalg.norm(e2)
    return np.column_stack([e1, e2, np.cross(e1, e2)])


def _images(items: list[Item], matrix: Array, centre: Array, tolerance: float) -> tuple[int, ...] | None:
    """Which item each is mapped onto; None if one is mapped onto none."""
    images = []
    for item in items:
        moved = item.moved(matrix, centre)
        image = next(
            (k for k, o in enumerate(items) if k not in images and moved.is_like(o, tolerance)), None
        )
        if image is None:
            return None
        images.append(image)
    return tuple(images)


def _operation(
    device: Device, matrix: Array, centre: Array, iron: list[Item], coils: list[Item], tolerance: float
) -> Operation:
    # The exact matrix is within the tolerance of the found one; twice as much keeps the verdict.
    bodies = _images(iron, matrix, centre, 2 * tolerance)
    if len(coils) == len(device.coils):
        windings = _images(coils, matrix, centre, 2 * tolerance)
        axes = [coil_axis(coil) for coil in device.coils]
    else:
        # The symmetry of filaments and sheets is not looked at: only where nothing moves each is its own image.
        same = np.array_equal(matrix, _IDENTITY)
        windings = tuple(range(len(device.coils))) if same else None
        axes = [np.array([0.0, 0.0, 1.0])] * len(device.coils)
    handedness = np.sign(np.linalg.det(matrix))
    signs = [] if windings is None else [axes[windings[k]] @ matrix @ axes[k] for k in range(len(axes))]
    offset = centre - matrix @ centre
    offset[np.abs(offset) < 1e-3 * tolerance] = 0.0
    images = bodies or tuple(range(len(iron)))
    return Operation(
        matrix=matrix,
        offset=offset,
        bodies=images,
        coils=windings,
        coil_signs=tuple(int(handedness * np.sign(value)) for value in signs),
        keeps_magnets=_keeps_magnets(device, matrix, images) and _keeps_background(device, matrix, offset),
    )


def _keeps_magnets(device: Device, matrix: Array, images: tuple[int, ...]) -> bool:
    materials = [device.materials[body.material] for body in device.bodies]
    handedness = np.sign(np.linalg.det(matrix))
    for material, image in zip(materials, images, strict=True):
        other = materials[image]
        moved = handedness * matrix @ material.remanence
        if np.abs(moved - other.remanence).max() > 1e-6 * np.abs(material.remanence).max():
            return False
    return True


def _keeps_joints(device: Device, images: tuple[int, ...]) -> bool:
    """Whether the joint of every pair of bodies, if they touch, is like that of their images."""
    names = [body.name for body in device.bodies]

    def about(one: int, other: int) -> tuple[float, float] | None:
        joint = joint_of(device.joints, names[one], names[other])
        return None if joint is None else (joint.gap, joint.mu_r)

    pairs = combinations(range(len(names)), 2) if device.joints else ()
    return all(about(a, b) == about(images[a], images[b]) for a, b in pairs)


def _keeps_background(device: Device, matrix: Array, offset: Array) -> bool:
    return device.background is None or device.background.is_kept_by(matrix, offset)


def _kind(device: Device, body: Body) -> tuple[object, ...]:
    material = device.materials[body.material]
    kind = (body.material,) if material.likeness is None else material.likeness
    return (*kind, body.mesh_size, body.edge_size)


def _largest_scalar(item: Item) -> float:
    return max(float(outline.rows[:, 6:].max()) for run in item.runs for outline in run)


def _trivial(device: Device) -> Operation:
    coils = len(device.coils)
    return Operation(_IDENTITY, np.zeros(3), (), tuple(range(coils)), (1,) * coils, True)

"""Mirrors and rotations that map a device onto itself: found from its parts up to rounding, made an exact group.

A finite group of mirrors and rotations as data, and its names for people.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fieldmap.device import model
from fieldmap.device.coils import Coil, WindingPath
from fieldmap.device.parts import joint_of
from fieldmap.iron.topology import TRIANGLE_TURN, area_vectors, common_sides
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Entries of orthogonal matrices closer than this are the same operation.
_SAME_OPERATION = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Operation(Record):
    """x -> matrix @ x + offset maps the iron onto itself.

    matrix (3, 3) orthogonal, offset (3,) in m. bodies: body k is mapped onto body bodies[k]. coils: coil k onto coil
    coils[k], or None where some coil has no image among the coils; coil_signs: -1 where a positive current in coil
    k becomes a negative one in its image (a current's sense is an axial vector: a mirror that contains the coil's
    axis reverses it). keeps_magnets: remanences (axial vectors too) are mapped onto each other, and the background, if
    any, onto itself.
    """

    matrix: Array
    offset: Array
    bodies: tuple[int, ...]
    coils: tuple[int, ...] | None
    coil_signs: tuple[int, ...]
    keeps_magnets: bool

    @property
    def handedness(self) -> int:
        """+1 for rotations, -1 for mirrors and other operations that turn a right hand into a left one."""
        return 1 if np.linalg.det(self.matrix) > 0 else -1

    @property
    def is_mirror(self) -> bool:
        """Whether it is the reflection in a plane."""
        return self.handedness < 0 and abs(float(np.trace(self.matrix)) - 1.0) < _SAME_OPERATION

    def __call__(self, points: Array) -> Array:
        """Images (n, 3) of points (n, 3)."""
        return points @ self.matrix.T + self.offset

    def __str__(self) -> str:
        if np.allclose(self.matrix, np.eye(3), atol=_SAME_OPERATION):
            return "identity"
        if self.is_mirror:
            return f"mirror {_plane(self)}"
        # A matrix of determinant -1 is a rotation followed by the inversion.
        turn = self.handedness * self.matrix
        axis = rotation_axis(turn)
        sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) @ axis
        angle = np.degrees(np.arctan2(sine, np.trace(turn) - 1)) % 360
        if min(angle, 360 - angle) < 1e-3:
            return "inversion"
        what = f"rotation by {angle:.4g} deg about {_axis_name(axis)}"
        return what if self.handedness > 0 else what + " with inversion"


@dataclass(frozen=True, eq=False, repr=False)
class SymmetryGroup(Record):
    """All operations found, the identity first.

    centre (3,) in m: a point that no operation moves. tolerance in m: positions and lengths that differ by less were
    taken to be equal. limits: what was not looked at, or left out, in words.
    """

    operations: tuple[Operation, ...]
    centre: Array
    tolerance: float
    limits: tuple[str, ...] = ()

    @property
    def order(self) -> int:
        """Number of operations."""
        return len(self.operations)

    @property
    def matrices(self) -> Array:
        """(order, 3, 3)."""
        return np.array([operation.matrix for operation in self.operations])

    def __str__(self) -> str:
        return _group_name(self.operations)

    def subgroup(self, members: list[int]) -> "SymmetryGroup":
        """Some of the operations.

        Parameters
        ----------
        members
            Their indices; they must form a group, the identity first.

        Returns
        -------
        'SymmetryGroup'
            The group.
        """
        chosen = tuple(self.operations[k] for k in members)
        return SymmetryGroup(chosen, self.centre, self.tolerance, self.limits)


def multiplication_table(matrices: Array) -> Index | None:
    """Products of matrices of a group.

    Parameters
    ----------
    matrices
        (g, 3, 3).

    Returns
    -------
    Index | None
        table[a, b] is the index of matrices[a] @ matrices[b]; None where a product is missing.
    """
    products = np.einsum("aij,bjk->abik", matrices, matrices)
    distance = np.abs(products[:, :, None] - matrices[None, None]).max(axis=(3, 4))
    table = distance.argmin(axis=2)
    return table if distance.min(axis=2).max() < 100 * _SAME_OPERATION else None


def rotation_axis(turn: Array) -> Array:
    """Axis of a rotation.

    Parameters
    ----------
    turn
        The rotation (3, 3).

    Returns
    -------
    Array
        Unit vector (3,); of the two, the one whose largest component is positive.
    """
    values, vectors = np.linalg.eigh(turn + turn.T)
    axis = vectors[:, values.argmax()]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def mirror_normal(mirror: Array) -> Array:
    """Normal of a mirror's plane.

    Parameters
    ----------
    mirror
        The reflection (3, 3).

    Returns
    -------
    Array
        Unit vector (3,), whose largest component is positive.
    """
    values, vectors = np.linalg.eigh(mirror)
    normal = vectors[:, values.argmin()]
    return normal * np.sign(normal[np.abs(normal).argmax()])


def _axis_name(axis: Array) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(axis @ unit) > 1 - _SAME_OPERATION:
            return f"axis {name}"
    return "axis ({})".format(", ".join(f"{value:.4g}" for value in axis))


def _plane(mirror: Operation) -> str:
    normal = mirror_normal(mirror.matrix)
    # offset = 2 (normal . p) normal for a point p of the plane.
    at = float(mirror.offset @ normal) / 2
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(normal @ unit) > 1 - _SAME_OPERATION:
            return f"{name} = 0" if abs(at) < 1e-9 else f"{name} = {1e3 * at:.6g} mm"
    parts = zip(normal, "xyz", strict=True)
    terms = " ".join(f"{value:+.4g} {name}" for value, name in parts if abs(value) > _SAME_OPERATION)
    return f"{terms.lstrip('+')} = {1e3 * at if abs(at) > 1e-9 else 0:.6g} mm"


def _group_name(operations: tuple[Operation, ...]) -> str:
    if len(operations) == 1:
        return "none"
    mirrors = [operation for operation in operations if operation.is_mirror]
    fold, axis = _main_axis(operations)
    if fold <= 2 and len(mirrors) > 0:
        planes = sorted(_plane(mirror) for mirror in mirrors)
        return ("mirror " if len(planes) == 1 else "mirrors ") + ", ".join(planes)
    if fold == 1:
        return "inversion"
    name = f"{fold}-fold {axis}"
    return f"{name} with {len(mirrors)} mirror planes" if mirrors else name


def _main_axis(operations: tuple[Operation, ...]) -> tuple[int, str]:
    """How many proper rotations, with the identity, there are about the axis with the most, and its name."""
    turns = [op.matrix for op in operations if op.handedness > 0 and not np.allclose(op.matrix, np.eye(3))]
    if not turns:
        return 1, ""
    axes = np.array([rotation_axis(turn) for turn in turns])
    count = (np.abs(axes @ axes.T) > 1 - _SAME_OPERATION).sum(axis=1)
    best = int(count.argmax())
    return int(count[best]) + 1, _axis_name(axes[best])


_SEED = 1
# Eigenvalues of a generic matrix that differ by less than this belong together.
_SAME_EIGENVALUE = 1e-9


def inverses(table: Index) -> Index:
    """Inverse of each element of a group.

    Parameters
    ----------
    table
        Of `multiplication_table` (g, g); the identity is element 0.

    Returns
    -------
    Index
        Indices (g,).
    """
    return np.argmax(table == 0, axis=1)


def irreducible_representations(table: Index) -> tuple[Array, ...]:
    """Each inequivalent irreducible representation of a group, by real orthogonal matrices.

    Parameters
    ----------
    table
        Index of the product of two elements (g, g), element 0 the identity.

    Returns
    -------
    tuple[Array, ...]
        Matrices (g, d, d) of each.

    Raises
    ------
    ValueError
        For a group that has complex ones (rotations alone, say).

    Examples
    --------
    >>> [len(m[0]) for m in irreducible_representations(np.array([[0, 1], [1, 0]]))]
    [1, 1]
    """
    order = len(table)
    weight = np.random.default_rng(_SEED).standard_normal(order)
    weight += weight[inverses(table)]
    # (R(c) f)(a) = f(a c) commutes with translations from the left.
    commuting = np.zeros((order, order))
    for c in range(order):
        commuting[np.arange(order), table[:, c]] += weight[c]
    values, vectors = np.linalg.eigh(commuting)
    found: list[Array] = []
    scale = np.abs(values).max()
    for space in np.split(vectors, np.flatnonzero(np.diff(values) > _SAME_EIGENVALUE * scale) + 1, axis=1):
        # (L(h) f)(h a) = f(a)
        matrices = np.array([space[row].T @ space for row in table])
        # Signs and zeros exactly.
        whole = np.round(matrices)
        matrices = np.where(np.abs(matrices - whole) < 1e-12, whole, matrices)
        character = np.trace(matrices, axis1=1, axis2=2)
        known = (np.trace(other, axis1=1, axis2=2) for other in found)
        if not any(np.abs(character - other).max() < 1e-6 for other in known):
            found.append(matrices)
    if sum(matrices.shape[1] ** 2 for matrices in found) != order:
        raise ValueError("the group has irreducible representations that are not real")
    return tuple(sorted(found, key=lambda matrices: matrices.shape[1]))


def fourier_matrix(representations: tuple[Array, ...]) -> Array:
    """Functions on a group to their coefficients.

    Coefficient sqrt(d/g) sum_b matrices[b, i, j] f(b), by the orthogonality of matrix entries (Schur).

    Parameters
    ----------
    representations
        Of `irreducible_representations`.

    Returns
    -------
    Array
        Orthogonal matrix (g, g), rows in the order (representation, i, j).
    """
    order = len(representations[0])
    return np.concatenate(
        [np.sqrt(m.shape[1] / order) * m.reshape(order, -1).T for m in representations], axis=0
    )


# Values of cosines and sines that appear in matrices of axes along the coordinates.
_EXACT = np.array([0.0, 0.5, 1.0, np.sqrt(0.5), np.sqrt(0.75)])


def exact_matrices(found: Array) -> Array | None:
    """The exact representation next to nearly orthogonal matrices.

    A vector v is known by the function h -> matrices[h]^T v on the group. These functions form a subspace
    that left translations nearly keep; averaged over the group, its projector commutes with them exactly, and
    its eigenspace carries the exact representation.

    Parameters
    ----------
    found
        Matrices (g, 3, 3), the identity first.

    Returns
    -------
    Array | None
        Matrices (g, 3, 3); None if they form no group.
    """
    table = multiplication_table(found)
    if table is None or len(np.unique(table[:, 0])) < len(found):
        return None
    order = len(found)
    inverse = inverses(table)
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
        """The image under a linear map.

        Parameters
        ----------
        matrix
            The map (3, 3).
        centre
            Point (3,), m, that stays.

        Returns
        -------
        'Outline'
            The image.
        """
        rows = self.rows.copy()
        for part in (slice(0, 3), slice(3, 6)):
            rows[:, part] = (rows[:, part] - centre) @ matrix.T + centre
        return Outline(self.kind, rows)

    def is_like(self, other: "Outline", tolerance: float) -> bool:
        """Whether both are the same set of segments.

        Parameters
        ----------
        other
            The other one.
        tolerance
            Largest distance that counts as none, m.

        Returns
        -------
        bool
            True if they are.
        """
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
        """The image under a linear map.

        Parameters
        ----------
        matrix
            The map (3, 3).
        centre
            Point (3,), m, that stays.

        Returns
        -------
        'Item'
            The image.
        """
        return Item(self.kind, tuple(tuple(o.moved(matrix, centre) for o in run) for run in self.runs))

    def is_like(self, other: "Item", tolerance: float) -> bool:
        """Whether both are of one kind and fill the same space, as far as their parts tell.

        Parameters
        ----------
        other
            The other one.
        tolerance
            Largest distance that counts as none, m.

        Returns
        -------
        bool
            True if they are.
        """
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


def body_item(body: model.Body, kind: tuple[object, ...]) -> Item:
    """A body's parts.

    Parameters
    ----------
    body
        The body.
    kind
        Whatever else must be equal in bodies that are alike.

    Returns
    -------
    Item
        The item.
    """
    runs: list[tuple[str, list[Outline]]] = []
    for part in body.parts:
        if not runs or runs[-1][0] != part.operation:
            runs.append((part.operation, []))
        kind_of_shape, rows = _shape_rows(part.shape)
        runs[-1][1].append(Outline(kind_of_shape, _placed(rows, part.placement)))
    operations = tuple(operation for operation, _ in runs)
    return Item((*kind, operations), tuple(tuple(outlines) for _, outlines in runs))


def coil_item(coil: Coil) -> Item:
    """A winding as a space filled with turns; the sense of the current is left out.

    Parameters
    ----------
    coil
        The coil.

    Returns
    -------
    Item
        The item.
    """
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
    """Direction of the moment of a positive current: an axial vector.

    Parameters
    ----------
    coil
        The coil.

    Returns
    -------
    Array
        Unit vector (3,).
    """
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


def _shape_rows(shape: model.Shape) -> tuple[tuple[object, ...], Array]:
    match shape.primitive:
        case model.Cylinder(radius, height):
            return ("turned",), _turned(np.array([[0, 0], [radius, 0], [radius, height], [0, height]]))
        case model.Ring(inner, outer, height):
            return ("turned",), _turned(np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]))
        case model.RevolvedProfile(points):
            return ("turned",), _turned(np.asarray(points, dtype=float))
        case model.Box((x, y, z)):
            outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2
            return ("prism",), _prism(outline, z)
        case model.ExtrudedPolygon(points, height):
            return ("prism",), _prism(np.asarray(points, dtype=float), height)
        case model.Sphere(radius):
            return ("sphere",), np.array([[0.0] * 6 + [radius, 0.0]])
        case model.TriangleSurface(points, triangles):
            return ("surface",), _surface_rows(np.asarray(points), np.asarray(triangles))
        case model.StepFile(path, scale):
            # The solid's own symmetry is not looked at: a frame of three labelled points has none.
            return ("step", str(path), scale), _labelled_frame()
        case model.MeshFile(path, scale, region):
            return ("mesh file", str(path), scale, region), _labelled_frame()
        case model.VolumeMesh(points, tets):
            # As that of a STEP file: nothing but a copy of the same mesh is its image.
            kind = ("mesh", np.asarray(points).tobytes(), np.asarray(tets).tobytes())
            return kind, _labelled_frame()
    raise TypeError(f"{type(shape).__name__}.primitive is no shape that is known here")


def _labelled_frame() -> Array:
    rows = np.zeros((4, 8))
    rows[1:, :3] = np.eye(3) * 0.1
    rows[:, 6] = np.arange(4)
    return rows


def _surface_rows(points: Array, triangles: Index) -> Array:
    """The edges of a surface that are no diagonals of plane faces."""
    normals = area_vectors(points[triangles])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one, other = common_sides(triangles)
    bent = np.einsum("kd,kd->k", normals[one // 3], normals[other // 3]) < 1 - 1e-9
    start, end = points[triangles[:, TRIANGLE_TURN].reshape(-1, 2)[one[bent]]].transpose(1, 0, 2)
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


def _placed(rows: Array, placement: model.Placement) -> Array:
    out = rows.copy()
    rotation = np.asarray(placement.rotation, dtype=float)
    for part in (slice(0, 3), slice(3, 6)):
        out[:, part] = rows[:, part] @ rotation.T + placement.position
    return out


# Positions and lengths are compared to this fraction of the iron's size: device files give seven digits or so.
_RELATIVE_TOLERANCE = 1e-6
_IDENTITY = np.eye(3)


def find_symmetry(device: model.Device) -> SymmetryGroup:
    """All mirrors and rotations that map the iron onto itself, and what they do to coils and magnets.

    Bodies are alike where shape, material (for magnets: mu_r) and mesh sizes are. Lengths and positions count
    as equal within 1e-6 of the iron's size. The parts of the device file are compared, not the solids they
    add up to: a symmetric body made of parts that are not is not recognised, and a STEP body or a mesh counts
    as one without any symmetry of its own. Never raises.

    Parameters
    ----------
    device
        The device.

    Returns
    -------
    SymmetryGroup
        The group.

    Examples
    --------
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
        if body.has_own_mesh or any(isinstance(part.shape, model.StepFile) for part in body.parts)
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
    device: model.Device, matrix: Array, centre: Array, iron: list[Item], coils: list[Item], tolerance: float
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


def _keeps_magnets(device: model.Device, matrix: Array, images: tuple[int, ...]) -> bool:
    materials = [device.materials[body.material] for body in device.bodies]
    handedness = np.sign(np.linalg.det(matrix))
    for material, image in zip(materials, images, strict=True):
        other = materials[image]
        moved = handedness * matrix @ material.remanence
        if np.abs(moved - other.remanence).max() > 1e-6 * np.abs(material.remanence).max():
            return False
    return True


def _keeps_joints(device: model.Device, images: tuple[int, ...]) -> bool:
    """Whether the joint of every pair of bodies, if they touch, is like that of their images."""
    names = [body.name for body in device.bodies]

    def about(one: int, other: int) -> tuple[float, float] | None:
        joint = joint_of(device.joints, names[one], names[other])
        return None if joint is None else (joint.gap, joint.mu_r)

    pairs = combinations(range(len(names)), 2) if device.joints else ()
    return all(about(a, b) == about(images[a], images[b]) for a, b in pairs)


def _keeps_background(device: model.Device, matrix: Array, offset: Array) -> bool:
    return device.background is None or device.background.is_kept_by(matrix, offset)


def _kind(device: model.Device, body: model.Body) -> tuple[object, ...]:
    material = device.materials[body.material]
    kind = (body.material,) if material.likeness is None else material.likeness
    return (*kind, body.mesh_size, body.edge_size)


def _largest_scalar(item: Item) -> float:
    return max(float(outline.rows[:, 6:].max()) for run in item.runs for outline in run)


def _trivial(device: model.Device) -> Operation:
    coils = len(device.coils)
    return Operation(_IDENTITY, np.zeros(3), (), tuple(range(coils)), (1,) * coils, True)

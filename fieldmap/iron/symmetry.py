"""Mirrors and rotations that map a device onto itself.

They are found from the device's parts up to rounding and then made an exact finite group. Printing it gives its name.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, groupby, product
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from fieldmap.device import model
from fieldmap.device.coils import Coil
from fieldmap.device.parts import joint_of
from fieldmap.iron.topology import TRIANGLE_TURN, area_vectors, common_sides
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Entries of orthogonal matrices count as equal when they differ by less than this.
_SAME_OPERATION = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Operation(Record):
    """x -> matrix @ x + offset maps the iron onto itself.

    matrix (3, 3) orthogonal, offset (3,) in m. bodies: body k is mapped onto body bodies[k]. coils: coil k is
    mapped onto coil coils[k]; None if any coil has no image or, except for the identity, is a filament or sheet.
    coil_signs: -1 where a positive current in coil k becomes a negative one in its image (a current's sense is an axial
    vector: a mirror that contains the coil's axis reverses it). keeps_magnets: remanences (axial vectors too) are
    mapped onto each other, and the background, if any, onto itself.
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
        """Whether the operation is the reflection in a plane."""
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
    taken to be equal. limits: parts of the device whose symmetry was not examined, in words.
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
        """Matrices (order, 3, 3) of the operations."""
        return np.array([operation.matrix for operation in self.operations])

    def __str__(self) -> str:
        return _group_name(self.operations)

    def keeping_box(self, lower: Array, upper: Array) -> "SymmetryGroup":
        """The operations that map an axis-parallel box onto itself.

        Parameters
        ----------
        lower, upper
            Corners (3,) of the box, m.

        Returns
        -------
        'SymmetryGroup'
            The group.
        """
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        return self.subgroup(
            [
                number
                for number, one in enumerate(self.operations)
                if np.abs(one(middle[None])[0] - middle).max() <= self.tolerance
                and np.abs(np.abs(one.matrix) @ half - half).max() <= self.tolerance
            ]
        )

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
        Matrices (g, 3, 3).

    Returns
    -------
    Index | None
        table[a, b] is the index of matrices[a] @ matrices[b]; None if any product is missing.
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
        The rotation (3, 3). Minus the matrix of a mirror is half a turn about the normal of its plane.

    Returns
    -------
    Array
        Unit vector (3,) along the axis, with a positive largest component.
    """
    axis = np.linalg.eigh(turn + turn.T)[1][:, -1]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def _coordinate(direction: Array) -> str:
    """The name of the coordinate axis with this direction; empty for any other direction."""
    along = np.abs(direction)
    return "xyz"[along.argmax()] if along.max() > 1 - _SAME_OPERATION else ""


def _axis_name(axis: Array) -> str:
    return "axis " + (_coordinate(axis) or "({})".format(", ".join(f"{value:.4g}" for value in axis)))


def _plane(mirror: Operation) -> str:
    normal = rotation_axis(-mirror.matrix)
    # offset = 2 (normal . p) normal for a point p of the plane.
    at = float(mirror.offset @ normal) / 2
    at = 1e3 * at if abs(at) > 1e-9 else 0.0
    name = _coordinate(normal)
    if name:
        return f"{name} = {at:.6g} mm" if at else f"{name} = 0"
    parts = zip(normal, "xyz", strict=True)
    terms = " ".join(f"{value:+.4g} {name}" for value, name in parts if abs(value) > _SAME_OPERATION)
    return f"{terms.lstrip('+')} = {at:.6g} mm"


def _group_name(operations: tuple[Operation, ...]) -> str:
    if len(operations) == 1:
        return "none"
    mirrors = [operation for operation in operations if operation.is_mirror]
    turns = [op.matrix for op in operations if op.handedness > 0 and not np.allclose(op.matrix, np.eye(3))]
    axes = np.array([rotation_axis(turn) for turn in turns]).reshape(-1, 3)
    # The number of rotations about the axis of each rotation, the identity included.
    folds = 1 + (np.abs(axes @ axes.T) > 1 - _SAME_OPERATION).sum(axis=1)
    fold = folds.max(initial=1)
    if fold <= 2 and mirrors:
        return f"mirror{'s' if len(mirrors) > 1 else ''} {', '.join(sorted(map(_plane, mirrors)))}"
    if fold == 1:
        return "inversion"
    name = f"{fold}-fold {_axis_name(axes[folds.argmax()])}"
    return f"{name} with {len(mirrors)} mirror planes" if mirrors else name


_SEED = 1
# Eigenvalues that differ by less than this share of the largest belong together.
_SAME_EIGENVALUE = 1e-9


def inverses(table: Index) -> Index:
    """Inverse of each element of a group.

    Parameters
    ----------
    table
        The `multiplication_table` (g, g); the identity is element 0.

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
        Matrices (g, d, d) of each representation.

    Raises
    ------
    ValueError
        For a group with irreducible representations that are not real (3-fold rotations alone, say).

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
        # Entries close to -1, 0 and 1 become exactly these.
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
    """The matrix that maps a function on a group to its coefficients.

    A coefficient is sqrt(d/g) sum_b matrices[b, i, j] f(b). The matrix is orthogonal because the entries of the
    representations are (Schur).

    Parameters
    ----------
    representations
        The result of `irreducible_representations`.

    Returns
    -------
    Array
        Orthogonal matrix (g, g), rows in the order (representation, i, j).
    """
    order = len(representations[0])
    return np.concatenate(
        [np.sqrt(m.shape[1] / order) * m.reshape(order, -1).T for m in representations], axis=0
    )


# Absolute values of cosines and sines of the multiples of 30 and 45 degrees.
_EXACT = np.array([0.0, 0.5, 1.0, np.sqrt(0.5), np.sqrt(0.75)])


def exact_matrices(found: Array) -> Array | None:
    """The exact representation closest to matrices that nearly form a group.

    Each vector v stands for the function h -> matrices[h]^T v on the group. These functions form a subspace
    that left translations nearly keep. Its projector, averaged over the group, commutes with the translations
    exactly, and the eigenspace of this average carries the exact representation.

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
    functions = np.swapaxes(found, 1, 2).reshape(3 * order, 3) / np.sqrt(order)
    # (g f)(h) = f(g^-1 h)
    moved = (3 * table[inverses(table)][..., None] + np.arange(3)).reshape(order, 3 * order)
    projector = np.einsum("gik,gjk->ij", functions[moved], functions[moved])
    basis = np.linalg.eigh(projector)[1][:, -3:]
    # With the orthonormal basis closest to the functions of x, y and z, the matrices keep the axes x, y and z.
    u, _, v = np.linalg.svd(basis.T @ functions)
    basis = basis @ (u @ v)
    exact = basis.T @ basis[moved]
    size = np.abs(exact)
    nearest = _EXACT[np.abs(size[..., None] - _EXACT).argmin(axis=-1)]
    return np.where(np.abs(size - nearest) < 1e-12, np.sign(exact) * nearest, exact)


class _Item(NamedTuple):
    """A body or winding. kind: properties that must be equal exactly; rows (n, 13): both ends of every segment, the
    middle of its part, and two lengths, m; then the number of the part's run and of its kind (`_Part`)."""

    kind: tuple[object, ...]
    rows: Array

    def moved(self, matrix: Array, shift: Array | float = 0.0) -> "_Item":
        points = self.rows[:, :9].reshape(-1, 3) @ matrix.T + shift
        return _Item(self.kind, np.column_stack([points.reshape(-1, 9), self.rows[:, 9:]]))

    def is_like(self, other: "_Item", tolerance: float) -> bool:
        """Whether both are of one kind and have the same segments, to a tolerance in m."""
        if self.kind != other.kind or len(self.rows) != len(other.rows):
            return False
        # Both ways, for features that are as small as the tolerance.
        pairs = ((self.rows, other.rows), (other.rows, self.rows))
        return all(cKDTree(one).query(two, p=np.inf)[0].max() < tolerance for one, two in pairs)


_Part = tuple[Array, model.Placement, tuple[object, ...], int]
"""Segments (n, 8) by both ends and two lengths, m; their placement; properties of the part that segments do not show;
and the number of its run: the parts of one run may be in any order."""


def _item(kind: tuple[object, ...], parts: Sequence[_Part]) -> _Item:
    kinds = sorted({own for *_, own, _ in parts}, key=repr)
    rows = []
    for segments, place, own, run in parts:
        ends = segments[:, :6].reshape(-1, 3) @ np.asarray(place.rotation, dtype=float).T + place.position
        same = [*ends.mean(axis=0), run, kinds.index(own)]
        middle, numbers = np.split(np.tile(same, (len(segments), 1)), [3], axis=1)
        rows.append(np.column_stack([ends.reshape(-1, 6), middle, segments[:, 6:], numbers]))
    return _Item((*kind, *kinds), np.concatenate(rows))


def _body_item(device: model.Device, body: model.Body) -> _Item:
    """The item of a body. Bodies with the same parts, material (magnets and linear iron: mu_r) and mesh sizes have
    equal items. Successive parts that are all added, or all cut, form a run."""
    material = device.materials[body.material]
    kind = (body.material,) if material.likeness is None else material.likeness
    runs = [(operation, list(run)) for operation, run in groupby(body.parts, key=lambda part: part.operation)]
    parts = [
        (_shape_rows(part.shape), part.placement, _words(part.shape), number)
        for number, (_, run) in enumerate(runs)
        for part in run
    ]
    return _item((*kind, body.mesh_size, body.edge_size, *(operation for operation, _ in runs)), parts)


def _coil_item(coil: Coil) -> _Item:
    """A winding as a space filled with turns; the sense of the current is left out."""
    path = coil.winding()
    if path.is_circle:
        (inner, outer), half = path.arcs[0, 5:7], 0.5 * path.height
        profile = np.array([[inner, -half], [outer, -half], [outer, half], [inner, half]])
        return _item(("circular", abs(coil.turns)), [(_turned(profile), coil.placement, (), 0)])
    # Centre and middle of every arc, with half its length; both ends of every bar.
    radius = 0.5 * (path.arcs[:, 5] + path.arcs[:, 6])
    centre = path.arcs[:, :2]
    middle = centre + radius[:, None] * path.arcs[:, 2:4]
    along = path.bars[:, 4:] * path.bars[:, 2:4]
    arcs = np.column_stack([_level(centre), _level(middle), radius * path.arcs[:, 4], np.zeros(len(radius))])
    bars = _segments(_level(path.bars[:, :2] - along), _level(path.bars[:, :2] + along))
    kind = ("path", abs(coil.turns), path.thickness, path.height)
    return _item(kind, [(rows, coil.placement, (), number) for number, rows in enumerate((arcs, bars))])


def _coil_axis(coil: Coil) -> Array:
    """Direction (3,) of the moment of a positive current: an axial vector."""
    sense = np.sign(coil.turns) * coil.polarity * coil.winding().turning
    return np.asarray(coil.placement.rotation, dtype=float)[:, 2] * sense


def _words(shape: model.Shape) -> tuple[object, ...]:
    """The identity of a file or mesh, whose own symmetry is not examined; empty for other shapes."""
    match shape.primitive:
        case model.StepFile(path, scale):
            return "step", str(path), scale
        case model.MeshFile(path, scale, region):
            return "mesh file", str(path), scale, region
        case model.VolumeMesh(points, tets):
            return "mesh", np.asarray(points).tobytes(), np.asarray(tets).tobytes()
    return ()


def _shape_rows(shape: model.Shape) -> Array:
    """The segments (n, 8) of a shape."""
    match shape.primitive:
        case model.Cylinder(radius, height):
            return _turned(np.array([[0, 0], [radius, 0], [radius, height], [0, height]]))
        case model.Ring(inner, outer, height):
            return _turned(np.array([[inner, 0], [outer, 0], [outer, height], [inner, height]]))
        case model.RevolvedProfile(points):
            return _turned(np.asarray(points, dtype=float))
        case model.Box((x, y, z)):
            return _prism(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]) / 2, z)
        case model.ExtrudedPolygon(points, height):
            return _prism(np.asarray(points, dtype=float), height)
        case model.Sphere(radius):
            return np.array([[0.0] * 6 + [radius, 0.0]])
        case model.TriangleSurface(points, triangles):
            return _surface_rows(np.asarray(points), np.asarray(triangles))
        case model.StepFile() | model.MeshFile() | model.VolumeMesh():
            # Three axes of different lengths have no symmetry: only a copy of the same file or mesh is an image.
            return _segments(np.zeros((3, 3)), np.diag([0.1, 0.2, 0.3]))
    raise TypeError(f"{type(shape).__name__}.primitive is no shape that is known here")


def _surface_rows(points: Array, triangles: Index) -> Array:
    """The edges of a surface, without the diagonals of plane faces."""
    normals = area_vectors(points[triangles])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    one, other = common_sides(triangles)
    bent = np.einsum("kd,kd->k", normals[one // 3], normals[other // 3]) < 1 - 1e-9
    return _segments(*points[triangles[:, TRIANGLE_TURN].reshape(-1, 2)[one[bent]]].transpose(1, 0, 2))


def _prism(outline: Array, height: float) -> Array:
    low = _level(outline)
    high = low + [0.0, 0.0, height]
    start, end = np.concatenate([low, high, low]), [np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high]
    return _segments(start, np.concatenate(end))


def _turned(profile: Array) -> Array:
    """Each edge of the profile as two points on the axis, with the radii as its lengths."""
    radius, height = profile.T
    points = np.column_stack([np.zeros((len(profile), 2)), height])
    return _segments(points, np.roll(points, -1, axis=0), np.column_stack([radius, np.roll(radius, -1)]))


def _level(points: Array) -> Array:
    """Points (n, 2) in the plane z = 0."""
    return np.column_stack([points, np.zeros(len(points))])


def _segments(start: Array, end: Array, lengths: Array | None = None) -> Array:
    """Rows (2 n, 8) of segments both ways, with a length (n, 2) at either end."""
    ends = np.zeros((len(start), 2)) if lengths is None else lengths
    return np.block([[start, end, ends], [end, start, ends[:, ::-1]]])


# Positions and lengths are compared to this fraction of the iron's size: device files give seven digits or so.
_RELATIVE_TOLERANCE = 1e-6
_IDENTITY = np.eye(3)


def find_symmetry(device: model.Device) -> SymmetryGroup:
    """All mirrors and rotations that map the iron onto itself, and their effect on coils and magnets.

    Bodies are alike if shape, material (magnets and linear iron: mu_r) and mesh sizes are equal. Lengths and positions
    count as equal within 1e-6 of the iron's size. The parts of the device file are compared, not the solids they add up
    to: a symmetric body made of unsymmetric parts is not recognised. A STEP body or a mesh counts as a body without
    symmetry. Round iron has infinitely many operations: a finite group of these is returned. Never raises.

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
    iron = [_body_item(device, body) for body in device.bodies]
    coils = [_coil_item(coil) for coil in device.coils if coil.has_winding]
    centre, tolerance, matrices = np.zeros(3), 0.0, _IDENTITY[None]
    limits: tuple[str, ...] = ("no iron",)
    if iron:
        rows = np.concatenate([item.rows for item in iron])
        centre = rows[:, :3].mean(axis=0)
        size = max(float(np.abs(rows[:, :3] - centre).max()), float(rows[:, 9:11].max()))
        centre[np.abs(centre) < 1e-12 * size] = 0.0
        tolerance = _RELATIVE_TOLERANCE * size
        iron, coils = ([item.moved(_IDENTITY, -centre) for item in items] for items in (iron, coils))
        matrices = _finite_group(iron, coils, tolerance)
        limits = tuple(
            f"body '{body.name}' {'is a mesh' if body.has_own_mesh else 'comes from a STEP file'},"
            " whose own symmetry is not looked at"
            for body in device.bodies
            if any(_words(part.shape) for part in body.parts)
        )
    found = (_operation(device, matrix, centre, iron, coils, tolerance) for matrix in matrices)
    return SymmetryGroup(tuple(one for one in found if one is not None), centre, tolerance, limits)


def _finite_group(iron: list[_Item], coils: list[_Item], tolerance: float) -> Array:
    """Matrices (g, 3, 3), the identity first."""
    found = _candidates(iron, tolerance)
    if not found:
        # Iron with infinitely many operations. The coils may be less symmetric.
        found = _valid(_candidates(iron + coils, tolerance), iron + coils, tolerance)
        if len(found) < 2:
            found = _mirrors_of_axis(iron, coils, tolerance)
    exact = exact_matrices(np.array([_IDENTITY, *_valid(found, iron, tolerance)]))
    return _IDENTITY[None] if exact is None else exact


def _valid(candidates: Sequence[Array], items: list[_Item], tolerance: float) -> list[Array]:
    """Candidates that map the items onto themselves, each once, without the identity."""
    kept: list[Array] = [_IDENTITY]
    for matrix in candidates:
        if min(np.abs(matrix - other).max() for other in kept) < 1e-4:
            continue
        if _images(items, matrix, tolerance) is not None:
            kept.append(matrix)
    return kept[1:]


def _candidates(items: list[_Item], tolerance: float) -> list[Array]:
    """Orthogonal matrices that map two reference points onto possible images; none if all points lie on one axis."""
    kinds = [(item.kind, len(item.rows)) for item in items]
    label = np.repeat([kinds.index(kind) for kind in kinds], [count for _, count in kinds])
    points = np.concatenate([item.rows[:, :3] for item in items])
    _, first = np.unique(np.column_stack([np.round(points / tolerance), label]), axis=0, return_index=True)
    points, label = points[first], label[first]
    radius = np.linalg.norm(points, axis=1)
    size = radius.max()
    if size < tolerance:
        return []
    alike = (label[:, None] == label) & (np.abs(radius[:, None] - radius) < 4 * tolerance)
    far = radius > 0.1 * size
    one = int(np.where(far, alike.sum(axis=1), len(points) + 1).argmin())
    off_axis = np.linalg.norm(np.cross(points[one] / radius[one], points), axis=1)
    if off_axis.max() < 2 * tolerance:
        return []
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


def _mirrors_of_axis(iron: list[_Item], coils: list[_Item], tolerance: float) -> list[Array]:
    """Candidates: two mirrors that contain the axis of round iron, the one perpendicular to it, and all products."""
    points = np.concatenate([item.rows[:, :3] for item in iron])
    if np.abs(points).max() < tolerance and coils:  # a sphere: the coils' axis, if they have one
        points = np.concatenate([item.rows[:, :3] for item in coils])
        points = points if np.linalg.matrix_rank(points, tol=tolerance) == 1 else np.zeros((1, 3))
    longest = points[np.linalg.norm(points, axis=1).argmax()]
    axis = longest if np.linalg.norm(longest) > tolerance else _IDENTITY[2]
    # The second direction is the coordinate axis most nearly perpendicular to this axis.
    frame = _frame(axis, _IDENTITY[np.abs(axis).argmin()])
    return [frame @ np.diag(signs) @ frame.T for signs in product((1.0, -1.0), repeat=3)]


def _frame(first: Array, second: Array) -> Array:
    """Right-handed orthonormal columns: along the first, and in the half-plane of the second."""
    e1 = first / np.linalg.norm(first)
    e2 = second - (second @ e1) * e1
    e2 /= np.linalg.norm(e2)
    return np.column_stack([e1, e2, np.cross(e1, e2)])


def _images(items: list[_Item], matrix: Array, tolerance: float) -> tuple[int, ...] | None:
    """The item onto which each item is mapped; None if an item has no image."""
    images: list[int] = []
    for item in items:
        moved = item.moved(matrix)
        left = (k for k in range(len(items)) if k not in images)
        image = next((k for k in left if moved.is_like(items[k], tolerance)), None)
        if image is None:
            return None
        images.append(image)
    return tuple(images)


def _operation(
    device: model.Device,
    matrix: Array,
    centre: Array,
    iron: list[_Item],
    coils: list[_Item],
    tolerance: float,
) -> Operation | None:
    """The operation of a matrix on bodies, coils and magnets; None if it does not map bodies onto bodies, and joints
    onto equal joints."""
    # The exact matrix is within the tolerance of the found one: twice the tolerance accepts the found images.
    bodies = _images(iron, matrix, 2 * tolerance)
    if bodies is None or not _keeps_joints(device, bodies):
        return None
    offset = centre - matrix @ centre
    offset[np.abs(offset) < 1e-3 * tolerance] = 0.0
    # Zeros lose their sign, which depends on rounding: a wall with another sign would get another mesh.
    matrix, offset = matrix + 0.0, offset + 0.0
    handedness = np.sign(np.linalg.det(matrix))
    windings: tuple[int, ...] | None = tuple(range(len(device.coils)))
    signs = [1.0] * len(device.coils)
    if not np.array_equal(matrix, _IDENTITY):
        # The symmetry of filaments and sheets is not examined.
        windings = _images(coils, matrix, 2 * tolerance) if len(coils) == len(device.coils) else None
        axes = [] if windings is None else [_coil_axis(coil) for coil in device.coils]
        signs = [
            handedness * axes[image] @ matrix @ axis for image, axis in zip(windings or (), axes, strict=True)
        ]
    moments = [device.materials[body.material].remanence for body in device.bodies]
    magnets = all(
        np.abs(handedness * matrix @ moment - moments[image]).max() <= 1e-6 * np.abs(moment).max()
        for moment, image in zip(moments, bodies, strict=True)
    )
    background = device.background is None or device.background.is_kept_by(matrix, offset)
    coil_signs = tuple(int(np.sign(sign)) for sign in signs)
    return Operation(matrix, offset, bodies, windings, coil_signs, magnets and background)


def _keeps_joints(device: model.Device, images: tuple[int, ...]) -> bool:
    """Whether every pair of bodies has the same joint as the pair of its images."""
    names = [body.name for body in device.bodies]

    def about(one: int, other: int) -> tuple[float, float] | None:
        joint = joint_of(device.joints, names[one], names[other])
        return None if joint is None else (joint.gap, joint.mu_r)

    pairs = combinations(range(len(names)), 2) if device.joints else ()
    return all(about(a, b) == about(images[a], images[b]) for a, b in pairs)

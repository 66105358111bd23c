"""A finite group of mirrors and rotations as data, and its names for people."""

from dataclasses import dataclass

import numpy as np

from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Entries of orthogonal matrices closer than this are the same operation.
_SAME = 1e-6


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
        return self.handedness < 0 and abs(float(np.trace(self.matrix)) - 1.0) < _SAME

    def __call__(self, points: Array) -> Array:
        """Images (n, 3) of points (n, 3)."""
        return points @ self.matrix.T + self.offset

    def __str__(self) -> str:
        if np.allclose(self.matrix, np.eye(3), atol=_SAME):
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
        """The operations with these indices; they must form a group, the identity first."""
        chosen = tuple(self.operations[k] for k in members)
        return SymmetryGroup(chosen, self.centre, self.tolerance, self.limits)


def multiplication_table(matrices: Array) -> Index | None:
    """table[a, b] is the index of matrices[a] @ matrices[b]; None where a product is missing."""
    products = np.einsum("aij,bjk->abik", matrices, matrices)
    distance = np.abs(products[:, :, None] - matrices[None, None]).max(axis=(3, 4))
    table = distance.argmin(axis=2)
    return table if distance.min(axis=2).max() < 100 * _SAME else None


def rotation_axis(turn: Array) -> Array:
    """Unit vector along the axis of a rotation; of the two, the one whose largest component is positive."""
    values, vectors = np.linalg.eigh(turn + turn.T)
    axis = vectors[:, values.argmax()]
    return axis * np.sign(axis[np.abs(axis).argmax()])


def mirror_normal(mirror: Array) -> Array:
    """Unit normal of a mirror's plane; its largest component is positive."""
    values, vectors = np.linalg.eigh(mirror)
    normal = vectors[:, values.argmin()]
    return normal * np.sign(normal[np.abs(normal).argmax()])


def _axis_name(axis: Array) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(axis @ unit) > 1 - _SAME:
            return f"axis {name}"
    return "axis ({})".format(", ".join(f"{value:.4g}" for value in axis))


def _plane(mirror: Operation) -> str:
    normal = mirror_normal(mirror.matrix)
    # offset = 2 (normal . p) normal for a point p of the plane.
    at = float(mirror.offset @ normal) / 2
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(normal @ unit) > 1 - _SAME:
            return f"{name} = 0" if abs(at) < 1e-9 else f"{name} = {1e3 * at:.6g} mm"
    terms = " ".join(
        f"{value:+.4g} {name}" for value, name in zip(normal, "xyz", strict=True) if abs(value) > _SAME
    )
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
    count = (np.abs(axes @ axes.T) > 1 - _SAME).sum(axis=1)
    best = int(count.argmax())
    return int(count[best]) + 1, _axis_name(axes[best])


_SEED = 1
# Eigenvalues of a generic matrix that differ by less than this belong together.
_SAME_EIGENVALUE = 1e-9


def inverses(table: Index) -> Index:
    """Index (g,) of the inverse of each element; the identity is element 0."""
    return np.argmax(table == 0, axis=1)


def irreducible_representations(table: Index) -> tuple[Array, ...]:
    """Real orthogonal matrices (g, d, d) of each inequivalent irreducible representation.

    table (g, g): index of the product of two elements, element 0 the identity. Raises ValueError for a group that
    has complex ones (rotations alone, say).

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
    """Orthogonal matrix (g, g): functions on the group to their coefficients, rows in the order (representation, i, j).

    Coefficient sqrt(d/g) sum_b matrices[b, i, j] f(b), by the orthogonality of matrix entries (Schur).
    """
    order = len(representations[0])
    return np.concatenate(
        [np.sqrt(m.shape[1] / order) * m.reshape(order, -1).T for m in representations], axis=0
    )

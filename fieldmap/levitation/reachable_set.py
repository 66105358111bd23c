"""What the coils can do at a point within the limits of their currents: the set of forces, or of flux densities.

Both are linear in the currents where the iron is, so that the box of currents becomes a zonotope: the sum of one line
segment for each coil (G. M. Ziegler, Lectures on Polytopes, section 7.3). Every face of it is spanned by two segments,
and all others stand at the ends that lie furthest along the face's normal; so its vertices are found exactly, in the
order of n^2 corners and not 2^n.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from fieldmap.arguments import checked_vectors
from fieldmap.errors import InputError, Problem
from fieldmap.field import AnyField, as_field, require_affine
from fieldmap.levitation.balance import dipole_force
from fieldmap.records import Record
from fieldmap.typing import Array

# Two segments within this angle, rad, span no face; a set thinner than this share of its length has no volume.
_PARALLEL, _THIN = 1e-9, 1e-9
# Points that lie outside by less than this share of the set's size are on its surface.
_ON = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class ReachableSet(Record):
    """Forces or flux densities that the coils can make at one point.

    quantity: "force", N, or "field", T. position (3,), m; moment (3,), A m^2, of the dipole, None for the field. lower,
    upper (n,): limits of the currents, A. constant (3,): without currents. per_ampere (n, 3): of each coil, per A.
    vertices (v, 3): corners of the set, and triangles (t, 3): their indices, outward side first; empty where the set is
    flat. volume: in N^3 or T^3.
    """

    quantity: str
    position: Array
    moment: Array | None
    coil_names: tuple[str, ...]
    lower: Array
    upper: Array
    constant: Array
    per_ampere: Array
    vertices: Array
    triangles: Array
    volume: float

    @property
    def unit(self) -> str:
        """Of the quantity."""
        return "N" if self.quantity == "force" else "T"

    def at(self, currents: ArrayLike) -> Array:
        """The quantity (..., 3) at currents (..., n), A."""
        return np.asarray(currents, dtype=float) @ self.per_ampere + self.constant

    def currents_along(self, direction: ArrayLike) -> Array:
        """Currents (n,), A, within the limits that bring it furthest along a direction (3,); 0 in coils that do not
        matter, or the limit that is nearest to it."""
        share = self.per_ampere @ np.asarray(direction, dtype=float)
        rest = np.clip(0.0, self.lower, self.upper)
        return np.where(share > 0, self.upper, np.where(share < 0, self.lower, rest))

    def largest_along(self, direction: ArrayLike) -> float:
        """How far the set reaches along a direction (3,), whose length does not matter, in its unit."""
        unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        return float(self.at(self.currents_along(unit)) @ unit)

    def holds(self, values: ArrayLike) -> Array:
        """Whether values (..., 3) can be reached, to rounding. Raises InputError for a flat set."""
        if not len(self.triangles):
            remedy = "ask largest_along, or add a coil"
            raise InputError(Problem("ReachableSet.holds", "the set must have a volume", "none", remedy))
        faces = ConvexHull(self.vertices).equations
        size = float(np.ptp(self.vertices, axis=0).max())
        off = np.asarray(values, dtype=float) @ faces[:, :3].T + faces[:, 3]
        return np.asarray((off <= _ON * size).all(axis=-1))


def reachable(
    field: AnyField,
    position: ArrayLike,
    limits: ArrayLike,
    moment: ArrayLike | None = None,
) -> ReachableSet:
    """The forces on a dipole of moment (3,), A m^2, at a position (3,), m, that currents within the limits make; or the
    flux densities there, without a moment.

    limits: the largest size of all currents, A, or of each (n,), or their lower and upper ones (2, n). The field must
    be linear in the currents, with a constant part or not. Raises InputError for one that is not, and for limits
    that are none.

    >>> reachable(field_map, (0, 0, -0.1), 3.0, moment=(0, 0, 0.8)).largest_along((0, 0, 1))    # doctest: +SKIP
    0.113
    """
    source = as_field(field)
    require_affine(source, "reachable")
    count = len(source.coil_names)
    lower, upper = _limits(limits, count)
    place = np.asarray(position, dtype=float).reshape(3)
    dipole = None if moment is None else checked_vectors("reachable, moment", moment)[0].reshape(3)

    def quantity(currents: Array) -> Array:
        if dipole is None:
            return np.asarray(source.field(place[None, :], currents)[0])
        return np.asarray(dipole_force(dipole, source.gradient(place[None, :], currents)[0]))

    constant = quantity(np.zeros(count))
    per_ampere = np.array([quantity(row) - constant for row in np.eye(count)])
    vertices, triangles, volume = zonotope(per_ampere, lower, upper)
    return ReachableSet(
        "field" if dipole is None else "force",
        place,
        dipole,
        source.coil_names,
        lower,
        upper,
        constant,
        per_ampere,
        vertices + constant,
        triangles,
        volume,
    )


def zonotope(directions: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> tuple[Array, Array, float]:
    """Corners (v, 3), triangles (t, 3) and volume of all sums of directions (n, 3) times numbers between lower (n,) and
    upper (n,). Of a flat one the ends of its faces or of its length, no triangles, and 0.

    >>> corners, triangles, volume = zonotope(np.eye(3), [0, 0, 0], [1, 2, 3])
    >>> len(corners), len(triangles), round(volume, 12)
    (8, 12, 6.0)
    """
    segments = np.asarray(directions, dtype=float) * (np.asarray(upper) - np.asarray(lower))[:, None]
    base = np.asarray(lower, dtype=float) @ np.asarray(directions, dtype=float)
    points = base + _corner_candidates(segments)
    size = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(size) < 3 or size[2] <= _THIN * size[0]:
        return np.unique(points, axis=0), np.empty((0, 3), dtype=np.int64), 0.0
    hull = ConvexHull(points)
    kept = hull.vertices
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    triangles = number[hull.simplices]
    corners = points[kept]
    # Qhull leaves the sense of its triangles open.
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    inward = np.einsum("ti,ti->t", np.cross(edges[:, 0], edges[:, 1]), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return corners, triangles, float(hull.volume)


def _corner_candidates(segments: Array) -> Array:
    """The corners of all faces, among which every corner of the zonotope is; its base at the origin."""
    moving = segments[np.linalg.norm(segments, axis=1) > 0]
    found = [np.zeros(3), moving.sum(axis=0)]
    for i, j in combinations(range(len(moving)), 2):
        normal = np.cross(moving[i], moving[j])
        if np.linalg.norm(normal) <= _PARALLEL * np.linalg.norm(moving[i]) * np.linalg.norm(moving[j]):
            continue
        along = moving @ (normal / np.linalg.norm(normal))
        # What lies in the face's plane spans it, too: its corners come with the other pairs and with both ends here.
        level = np.abs(along) <= _PARALLEL * np.linalg.norm(moving, axis=1)
        level[[i, j]] = True
        for sense in (1.0, -1.0):
            far = moving[~level & (sense * along > 0)].sum(axis=0)
            found += [far + ends for ends in _flat_corners(moving[level], normal)]
    if len(found) == 2:  # all along one line
        line = moving[0] / np.linalg.norm(moving[0]) if len(moving) else np.zeros(3)
        along = moving @ line
        found = [moving[along < 0].sum(axis=0), moving[along > 0].sum(axis=0)]
    return np.array(found)


def _flat_corners(segments: Array, normal: Array) -> list[Array]:
    """Corners of the sum of segments (k, 3) in the plane with a normal: every edge is one segment, the others stand at
    their ends."""
    if len(segments) == 2:
        return [a * segments[0] + b * segments[1] for a, b in product((0.0, 1.0), repeat=2)]
    corners = []
    for segment in segments:
        along = segments @ np.cross(normal, segment)
        beside = np.abs(along) <= _PARALLEL * np.linalg.norm(normal) * np.linalg.norm(
            segment
        ) * np.linalg.norm(segments, axis=1)
        along_edge = segments[beside] @ segment
        for sense in (1.0, -1.0):
            far = segments[~beside & (sense * along > 0)].sum(axis=0)
            corners += [
                far + segments[beside][along_edge < 0].sum(axis=0),
                far + segments[beside][along_edge > 0].sum(axis=0),
            ]
    return corners


def _limits(limits: ArrayLike, count: int) -> tuple[Array, Array]:
    given = np.asarray(limits, dtype=float)
    if given.shape in ((), (count,)):
        given = np.stack([-np.broadcast_to(given, count), np.broadcast_to(given, count)])
    good = given.shape == (2, count) and np.isfinite(given).all() and (given[0] <= given[1]).all()
    if not good or not (given[0] < given[1]).any():
        must = f"must be one number, {count} of them, or lower and upper ones (2, {count}), lower below upper"
        raise InputError(Problem("reachable(limits)", must, str(limits)[:80], "give the driver's limits, A"))
    return given[0], given[1]

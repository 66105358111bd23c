"""What the coils can do at a point within the limits of their currents: the set of forces, or of flux densities.

Both are linear in the currents where the iron is, so that the box of currents becomes a zonotope: the sum of one line
segment for each coil (G. M. Ziegler, Lectures on Polytopes, section 7.3). Segments are added one after the other, and
only corners of the hull are kept, of which there are some n^2 and not 2^n. What is not linear is searched:
`fieldmap.levitation.searched_set`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, checked_vectors
from fieldmap.field import AnyField, as_field, refuse_orientations
from fieldmap.levitation.searched_set import SearchedSet, SetAtPoint, hull_of, quantity_of, searched_set
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns
from fieldmap.typing import Array, Index

# Points that lie outside by less than this share of the set's size are on its surface.
_ON = 1e-9


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ReachableSet(SetAtPoint):
    """Forces or flux densities that the coils can make at one point, where these are linear in the currents: all of
    them.

    quantity: "force", N, or "field", T. position (3,), m; moment (3,), A m^2, or the body of magnets that the force
    acts on, None for the field. lower, upper (n,): limits of the currents, A. constant (3,): without currents.
    per_ampere (n, 3): of each coil, per A. vertices (v, 3): corners of the set, and triangles (t, 3): their indices,
    outward side first; empty where the set is flat. volume: in N^3 or T^3.
    """

    exact: ClassVar[bool] = True

    constant: Array
    per_ampere: Array

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
        remedy = "ask largest_along, or add a coil"
        check(len(self.triangles) > 0, "ReachableSet.holds", "the set must have a volume", "none", remedy)
        faces = scipy.spatial.ConvexHull(self.vertices).equations
        size = float(np.ptp(self.vertices, axis=0).max())
        off = np.asarray(values, dtype=float) @ faces[:, :3].T + faces[:, 3]
        return np.asarray((off <= _ON * size).all(axis=-1))


def reachable(
    field: AnyField,
    position: ArrayLike,
    limits: ArrayLike,
    moment: ArrayLike | MagneticBody | None = None,
    orientation: ArrayLike | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> ReachableSet | SearchedSet:
    """The forces on a dipole of moment (3,), A m^2, at a position (3,), m, that currents within the limits make; or the
    flux densities there, without a moment. In place of the moment a `MagneticBody`, with an orientation (3, 3), columns
    its axes, upright without.

    limits: the largest size of all currents, A, or of each (n,), or their lower and upper ones (2, n). What is linear
    in the currents, with a constant part or not, is found exactly (`ReachableSet`). Otherwise, for soft iron and for a
    map whose iron saturates, it is searched along 134 directions (`SearchedSet`, whose `exact` is False), within the
    currents that the map is made for: lower bounds, each with the currents that make it. A device whose saturating iron
    is solved for all currents anew (`fieldmap.iron.NonlinearSolver`) is searched along 26 directions, with some hundred
    solves; a map of it is quicker and thorough. Such a search tells `progress` how far it is. Raises InputError for a
    field that neither superposes nor has derivatives by its currents, and for limits that are none or leave no
    currents; OutsideMapError.

    >>> reachable(field_map, (0, 0, -0.1), 3.0, moment=(0, 0, 0.8)).largest_along((0, 0, 1))    # doctest: +SKIP
    0.113
    """
    source = as_field(field)
    count = len(source.coil_names)
    lower, upper = _limits(limits, count)
    place = np.asarray(position, dtype=float).reshape(3)
    if not isinstance(moment, MagneticBody):
        refuse_orientations(orientation)
    turn = checked_turns(orientation, 1)[0]
    acted_on: Array | MagneticBody | None
    if moment is None or isinstance(moment, MagneticBody):
        acted_on = moment
    else:
        acted_on = checked_vectors("reachable, moment", moment)[0].reshape(3)
    if not source.affine or (isinstance(acted_on, MagneticBody) and acted_on.soft):
        return searched_set(field, place, lower, upper, acted_on, turn, progress)
    constant, slope = quantity_of(source, place, acted_on, turn)(np.zeros(count))
    per_ampere = np.ascontiguousarray(slope.T)
    vertices, triangles, volume = zonotope(per_ampere, lower, upper)
    return ReachableSet(
        quantity="field" if acted_on is None else "force",
        position=place,
        moment=acted_on,
        coil_names=source.coil_names,
        lower=lower,
        upper=upper,
        constant=constant,
        per_ampere=per_ampere,
        vertices=vertices + constant,
        triangles=triangles,
        volume=volume,
    )


def zonotope(directions: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> tuple[Array, Index, float]:
    """Corners (v, 3), triangles (t, 3) and volume of all sums of directions (n, 3) times numbers between lower (n,) and
    upper (n,). Of a flat one no triangles, and 0.

    >>> corners, triangles, volume = zonotope(np.eye(3), [0, 0, 0], [1, 2, 3])
    >>> len(corners), len(triangles), round(volume, 12)
    (8, 12, 6.0)
    """
    segments = np.asarray(directions, dtype=float) * (np.asarray(upper) - np.asarray(lower))[:, None]
    base = np.asarray(lower, dtype=float) @ np.asarray(directions, dtype=float)
    points = base[None]
    for segment in segments:
        points = np.concatenate([points, points + segment])
        points = points[hull_of(points)[0]]
    kept, triangles, volume = hull_of(points)
    return points[kept], triangles, volume


def _limits(limits: ArrayLike, count: int) -> tuple[Array, Array]:
    given = np.asarray(limits, dtype=float)
    if given.shape in ((), (count,)):
        given = np.stack([-np.broadcast_to(given, count), np.broadcast_to(given, count)])
    good = given.shape == (2, count) and np.isfinite(given).all() and (given[0] <= given[1]).all()
    good = good and bool((given[0] < given[1]).any())
    must = f"must be one number, {count} of them, or lower and upper ones (2, {count}), lower below upper"
    check(good, "reachable(limits)", must, str(limits)[:80], "give the driver's limits, A")
    return given[0], given[1]

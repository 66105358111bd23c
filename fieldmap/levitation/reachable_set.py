"""The set of forces, or of flux densities, that the coils can make at a point within the limits of their currents.

Linear iron: the quantity is linear in the currents, so the image of the box of currents is a zonotope, the sum of one
line segment for each coil (G. M. Ziegler, Lectures on Polytopes, section 7.3). Segments are added one after the other.
Only the corners of the hull are kept; there are about n^2 of them, not 2^n.

Otherwise the set is searched: the force on soft iron grows with the square of the currents, and saturating iron makes
every quantity nonlinear. The largest force along a direction can then have several local maxima. Searches begin at the
best known currents and at others far from these. They climb with the exact derivative
(`fieldmap.lookup.wrench_actuation`). If the currents are independent, they climb first from corner to corner of the
box, then by L-BFGS-B. If several coils follow one signal (groups, or lift and directions), they climb by SLSQP, with
the limits of all coils (J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., chapters 16.7 and 18). The steps
between corners suffice for a linear quantity. The
result of one direction is a start for all others. Every value is stored with the currents that make it, so the values
are lower bounds: the true set may reach further.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, checked_vectors
from fieldmap.currents import CurrentDomain, IndependentCurrents
from fieldmap.errors import OutsideMapError
from fieldmap.field import AnyField, Field, as_field, refuse_orientations
from fieldmap.lookup import FieldMap
from fieldmap.lookup.actuation import field_actuation, wrench_actuation
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns, reacting_at
from fieldmap.records import Record
from fieldmap.typing import Array, Index

# Least difference of two starts of a search, as a share of the range of a signal.
_APART = 0.3
# Least gain of another sweep, as a share of the size of the set.
_GAIN = 1e-7
# Currents may exceed their limits by this share, because of rounding.
_ROUNDING = 1e-9
# A hull is flat if its thickness is less than this share of its length.
_THIN = 1e-9
# Points that lie outside the set by less than this share of its size count as inside.
_ON = 1e-9


class _Effort(NamedTuple):
    """Size of a search.

    Attributes
    ----------
    directions : number of directions, without the six along the axes.
    seeds : number of currents that are evaluated first.
    starts : number of searches for each direction.
    steps : largest number of steps of a search.
    sweeps : most repetitions for directions with better starts than before.
    """

    directions: int
    seeds: int
    starts: int
    steps: int
    sweeps: int


# A map is evaluated at some thousands of currents. A device that is solved at each of them, about a second each, is
# evaluated at some hundreds.
_OF_MAPS, _OF_SOLVED = _Effort(128, 128, 3, 60, 5), _Effort(20, 8, 1, 12, 2)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SetAtPoint(Record):
    """The set of a quantity at a point: see `ReachableSet` and `SearchedSet`."""

    quantity: str
    position: Array
    moment: Array | MagneticBody | None
    coil_names: tuple[str, ...]
    lower: Array
    upper: Array
    vertices: Array
    triangles: Index
    volume: float

    @property
    def unit(self) -> str:
        """Unit of the quantity."""
        return "N" if self.quantity == "force" else "T"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SearchedSet(SetAtPoint):
    """Forces or flux densities that the coils can make at one point, found by searches along many directions.

    The values are lower bounds: the true set may reach further. Points between them may be out of reach, because the
    true set need not be convex. For the quantity at other currents call `wrench` or `field` of the field.

    Attributes
    ----------
    quantity : "force", N, or "field", T.
    position : (3,), m.
    moment : (3,), A m^2, or the body that the force acts on; None for the field.
    orientation : (3, 3), its columns are the axes of the body.
    coil_names : in the order of the currents.
    lower, upper : (n,), limits of the currents, A.
    directions : (d, 3), unit vectors.
    values : (d, 3), the furthest value that was found along each direction.
    currents : (d, n), currents that make these values, A.
    vertices : (v, 3), corners of the convex hull of the values.
    triangles : (t, 3), indices of corners, counterclockwise seen from outside.
    volume : of the hull, N^3 or T^3.
    """

    exact: ClassVar[bool] = False

    orientation: Array
    directions: Array
    values: Array
    currents: Array

    def currents_along(self, direction: ArrayLike) -> Array:
        """The currents found that bring the quantity furthest along a direction.

        Parameters
        ----------
        direction
            (3,).

        Returns
        -------
        Array
            Currents (n,), A.
        """
        return self.currents[int(np.argmax(self.values @ np.asarray(direction, dtype=float)))]

    def largest_along(self, direction: ArrayLike) -> float:
        """The furthest value found along a direction.

        Parameters
        ----------
        direction
            (3,); its length does not matter.

        Returns
        -------
        float
            In the unit of the quantity: the reach of the hull of all values found, a lower bound of the reach of the
            set.
        """
        unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        return float((self.values @ unit).max())


def searched_set(
    field: AnyField,
    position: Array,
    lower: Array,
    upper: Array,
    moment: Array | MagneticBody | None,
    orientation: Array,
    progress: Callable[[str, float], None] | None = None,
) -> SearchedSet:
    """Search the set of forces on a dipole or body, or of flux densities. Arguments are as in `reachable`."""
    source = as_field(field)
    effort = _OF_MAPS if source.affine or isinstance(source, FieldMap) else _OF_SOLVED
    climb = _Climb(source, position, lower, upper, moment, orientation, effort)
    climb.know_seeds()
    directions = even_directions(effort.directions)
    found = np.zeros(len(directions), dtype=np.int64)
    for k, direction in enumerate(directions):
        found[k] = climb.furthest(direction)
        if progress is not None:
            progress("searching", (k + 1) / len(directions))
    # Later directions may have found better starts for earlier ones.
    for _ in range(effort.sweeps):
        values = np.array(climb.values)
        best = np.argmax(values @ directions.T, axis=0)
        gain = np.einsum("di,di->d", values[best] - values[found], directions)
        better = np.flatnonzero(gain > _GAIN * climb.size)
        for place in better:
            found[place] = climb.furthest(directions[place])
        if not better.size:
            break
    values, currents = np.array(climb.values)[found], np.array(climb.currents)[found]
    # Searches that end at the same corner differ by rounding.
    distinct = np.unique(np.round(values / climb.size, 9), axis=0, return_index=True)[1]
    kept, triangles, volume = hull_of(values[distinct])
    return SearchedSet(
        **_asked(source, position, lower, upper, moment),
        orientation=orientation,
        directions=directions,
        values=values,
        currents=currents,
        vertices=values[distinct][kept],
        triangles=triangles,
        volume=volume,
    )


def _asked(
    source: Field, position: Array, lower: Array, upper: Array, moment: Array | MagneticBody | None
) -> dict[str, Any]:
    """The entries of a set that are known before it is found."""
    about = {"quantity": "field" if moment is None else "force", "coil_names": source.coil_names}
    return about | {"position": position, "moment": moment, "lower": lower, "upper": upper}


def even_directions(count: int) -> Array:
    """Unit vectors (6 + count, 3): along the axes in both senses, and a spiral that covers the sphere evenly (R.
    Swinbank, R. J. Purser, Fibonacci grids, 2006)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    spiral = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    return np.concatenate([np.eye(3), -np.eye(3), spiral])


def quantity_of(
    source: Field, position: Array, moment: Array | MagneticBody | None, orientation: Array
) -> Callable[[Array], tuple[Array, Array]]:
    """The quantity as a function of the currents.

    Returns
    -------
    Callable[[Array], tuple[Array, Array]]
        A function of currents (n,), A, that gives the force or flux density (3,) and its derivatives (3, n)
        by the currents.

    Raises
    ------
    InputError
        For a field that is not linear in the currents and has no derivatives by them.
    """
    if isinstance(moment, MagneticBody) and source.affine:
        # The fields of the coils are computed only once, because that may be slow.
        points = position + moment.all_points @ orientation.T
        flux = np.concatenate([source.unit_field(points), source.constant_field(points)[:, None]], axis=1)
        slope = np.concatenate(
            [source.unit_gradient(points), source.constant_gradient(points)[:, None]], axis=1
        )
        load = moment.by_fields(flux, slope, orientation, reacting_at(source.reaction, points))

        def on_body(currents: Array) -> tuple[Array, Array]:
            wrench, slopes = load(np.append(currents, 1.0))
            return wrench[:3], slopes[:3, :-1]

        return on_body
    must = "a field that is the sum of its coils' fields, or has derivatives by its currents"
    received = f"{type(source).__name__}, which has neither"
    known = source.affine or hasattr(source, "by_currents")
    check(known, "reachable", must, received, "make a map of it: fieldmap map")

    def about(currents: Array) -> tuple[Array, Array]:
        if moment is None:
            rows = field_actuation(source, position, currents)
        else:
            rows = wrench_actuation(source, position, moment, currents, orientation)
        matrix = rows.matrix[:3]
        rest = 0.0 if rows.constant is None else rows.constant[:3]
        return matrix @ currents + rest, matrix

    return about


class _Climb:
    """The searches of one set, and all currents (k, n) and values (k, 3) that they have found.

    The unknowns of a search are shares (s,), from 0 to 1, of the ranges of the signals that determine the currents.
    """

    def __init__(
        self,
        source: Field,
        position: Array,
        lower: Array,
        upper: Array,
        moment: Array | MagneticBody | None,
        orientation: Array,
        effort: _Effort,
    ) -> None:
        self._effort = effort
        self._make = quantity_of(source, position, moment, orientation)
        self._domain = _domain_of(source, lower, upper)
        # The domain may have limits of its own, such as a driver's. They hold in addition.
        most = self._domain.largest
        self._low, self._high = np.maximum(lower, -most), np.minimum(upper, most)
        self._free = isinstance(self._domain.parametrisation, IndependentCurrents)
        self._range = self._domain.upper - self._domain.lower
        # Searches often evaluate the same place, above all corners.
        self._seen: dict[bytes, tuple[Array, Array]] = {}
        self.shares: list[Array] = []
        self.currents: list[Array] = []
        self.values: list[Array] = []
        self.size = 1.0

    def know_seeds(self) -> None:
        """Evaluate corners of the domain, its middle and random places. Raises InputError if the limits exclude all."""
        count, half = len(self._range), self._effort.seeds // 2
        random = np.random.default_rng(0)
        few = 2**count <= self._effort.seeds
        corners = np.array(list(product((0.0, 1.0), repeat=count))) if few else np.empty((0, count))
        some = (random.random((half, count)) > 0.5).astype(float)
        seeds = np.concatenate(
            [corners if len(corners) else some, np.full((1, count), 0.5), random.random((half, count))]
        )
        if not self._free:
            # Seeds with the smallest lift are added: they have the smallest currents, which stay within narrow limits.
            signals = self._domain.parametrisation.within(self._domain.lower, self._domain.upper, seeds)
            safe = np.where(self._range > 0.0, self._range, 1.0)
            seeds = (signals - self._domain.lower) / safe
            seeds = np.concatenate([seeds, seeds * (np.arange(count) > 0), seeds * 0.0 + 0.5])
            seeds[-len(signals) :, 0] = np.linspace(0.0, 1.0, len(signals))
        for shares in seeds:
            self._look(np.clip(shares, 0.0, 1.0))
        _check_leaves(bool(self.values), self._low, self._high)
        spread = float(np.ptp(np.array(self.values), axis=0).max())
        self.size = max(spread, float(np.abs(self.values).max()) * 1e-9, 1e-300)

    def furthest(self, direction: Array) -> int:
        """Index of the known currents that reach furthest along a unit vector (3,), after searches for better ones."""
        along = np.array(self.values) @ direction
        starts: list[Array] = []
        for k in np.argsort(-along, kind="stable"):
            if all(np.abs(self.shares[k] - other).max() >= _APART for other in starts):
                starts.append(self.shares[k])
            if len(starts) == self._effort.starts:
                break
        for shares in starts:
            self._search(self._through_corners(shares, direction), direction)
        return int(np.argmax(np.array(self.values) @ direction))

    def _currents(self, shares: Array) -> Array:
        signals = self._domain.lower + shares * self._range
        return np.ascontiguousarray(self._domain.parametrisation.currents(signals))

    def _by_shares(self, shares: Array) -> Array:
        """Derivatives (n, s) of the currents by the shares, at shares (s,)."""
        signals = self._domain.lower + shares * self._range
        return self._domain.parametrisation.derivative(signals) * self._range

    def _look(self, shares: Array) -> tuple[Array, Array]:
        """Value (3,) and its derivatives (3, s) at shares (s,). Places within the limits are stored."""
        key = shares.tobytes()
        if key in self._seen:
            return self._seen[key]
        currents = self._currents(shares)
        value, slope = self._make(currents)
        off = max(float((self._low - currents).max()), float((currents - self._high).max()))
        if self._free:
            currents = np.clip(currents, self._low, self._high)
        if off <= _ROUNDING * float(np.abs(currents).max()):
            self.shares.append(np.array(shares))
            self.currents.append(currents)
            self.values.append(value)
        self._seen[key] = value, slope @ self._by_shares(shares)
        return self._seen[key]

    def _through_corners(self, shares: Array, direction: Array) -> Array:
        """Go to the corner that is best for the linearised quantity, and on from there while the value increases."""
        value, slope = self._look(shares)
        for _ in range(self._effort.steps if self._free else 0):
            along = direction @ slope
            corner = np.where(along > 0.0, 1.0, np.where(along < 0.0, 0.0, shares))
            value_there, slope = self._look(corner)
            if (value_there - value) @ direction <= 0.0:
                break
            shares, value = corner, value_there
        return shares

    def _search(self, shares: Array, direction: Array) -> None:
        last = shares, *self._look(shares)

        def goal(at: Array) -> tuple[float, Array]:
            nonlocal last
            here = np.clip(at, 0.0, 1.0)
            try:
                value, slope = self._look(here)
            except OutsideMapError:
                # SLSQP may evaluate outside the domain. The value is then extrapolated linearly from the last place.
                value, slope = last[1] + last[2] @ (here - last[0]), last[2]
            else:
                last = here, value, slope
            return -float(value @ direction) / self.size, -(direction @ slope) / self.size

        how: dict[str, Any] = {"jac": True, "bounds": [(0.0, 1.0)] * len(shares)}
        if self._free:
            options = {"maxiter": self._effort.steps, "ftol": 1e-12, "gtol": 1e-9}
            scipy.optimize.minimize(goal, shares, method="L-BFGS-B", options=options, **how)
            return
        scale = float(np.abs(np.concatenate([self._low, self._high])).max())

        def room(at: Array) -> Array:
            currents = self._currents(at)
            return np.concatenate([self._high - currents, currents - self._low]) / scale

        def room_slope(at: Array) -> Array:
            slope = self._by_shares(at)
            return np.concatenate([-slope, slope]) / scale

        limits = {"type": "ineq", "fun": room, "jac": room_slope}
        options = {"maxiter": self._effort.steps, "ftol": 1e-10}
        scipy.optimize.minimize(goal, shares, method="SLSQP", constraints=[limits], options=options, **how)


def _domain_of(source: Field, lower: Array, upper: Array) -> CurrentDomain:
    """Domain of a search. For a map of saturating iron it is the domain of the map, cut to the limits if its currents
    are independent. For any other field it is the box of the limits."""
    reduced = getattr(getattr(source, "info", None), "reduced_model", None)
    if reduced is None:
        return CurrentDomain(IndependentCurrents(len(lower)), lower, upper)
    domain: CurrentDomain = reduced.domain
    if not isinstance(domain.parametrisation, IndependentCurrents):
        return domain
    low, high = np.maximum(lower, domain.lower), np.minimum(upper, domain.upper)
    _check_leaves(bool((low <= high).all()), lower, upper)
    return CurrentDomain(domain.parametrisation, low, high)


def _check_leaves(some: bool, lower: Array, upper: Array) -> None:
    """Raise InputError for limits (n,), A, that exclude all currents of the map."""
    must = "must leave some of the currents that the map is made for"
    received = f"{lower.tolist()} to {upper.tolist()} A"[:80]
    check(some, "reachable(limits)", must, received, "widen the limits")


def hull_of(points: Array) -> tuple[Index, Index, float]:
    """Convex hull of points (n, 3).

    Returns
    -------
    tuple[Index, Index, float]
        Indices (v,) of the points that are corners; triangles (t, 3) of indices into these, counterclockwise
        seen from outside; volume. A flat hull has no triangles and the volume 0.
    """
    _, size, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    rank = int((size > _THIN * size[0]).sum()) if size[0] > 0.0 else 0
    if rank < 3:
        flat = points @ axes[:rank].T
        line = np.unique([flat.argmin(), flat.argmax()]) if rank else np.zeros(1, dtype=np.int64)
        kept = scipy.spatial.ConvexHull(flat).vertices if rank == 2 else line
        return kept, np.empty((0, 3), dtype=np.int64), 0.0
    hull = scipy.spatial.ConvexHull(points)
    kept = hull.vertices
    number = np.full(len(points), -1)
    number[kept] = np.arange(len(kept))
    triangles = number[hull.simplices]
    corners = points[kept]
    # The orientation of Qhull's triangles is arbitrary.
    edges = corners[triangles[:, 1:]] - corners[triangles[:, :1]]
    inward = np.einsum("ti,ti->t", np.cross(edges[:, 0], edges[:, 1]), hull.equations[:, :3]) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return kept, triangles, float(hull.volume)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ReachableSet(SetAtPoint):
    """All forces or flux densities that the coils can make at one point, for a quantity that is linear in the currents.

    Attributes
    ----------
    quantity : "force", N, or "field", T.
    position : (3,), m.
    moment : (3,), A m^2, or the body of magnets that the force acts on; None for the field.
    coil_names : in the order of the currents.
    lower, upper : (n,), limits of the currents, A.
    constant : (3,), the quantity without currents.
    per_ampere : (n, 3), the quantity of each coil, per A.
    vertices : (v, 3), corners of the set.
    triangles : (t, 3), indices of corners, counterclockwise seen from outside; none if the set is flat.
    volume : N^3 or T^3.
    """

    exact: ClassVar[bool] = True

    constant: Array
    per_ampere: Array

    def at(self, currents: ArrayLike) -> Array:
        """The quantity at given currents.

        Parameters
        ----------
        currents
            (..., n), A.

        Returns
        -------
        Array
            (..., 3).
        """
        return np.asarray(currents, dtype=float) @ self.per_ampere + self.constant

    def currents_along(self, direction: ArrayLike) -> Array:
        """Currents within the limits that bring the quantity furthest along a direction.

        Parameters
        ----------
        direction
            (3,).

        Returns
        -------
        Array
            Currents (n,), A. Coils that do not matter have 0, or the limit nearest to 0.
        """
        share = self.per_ampere @ np.asarray(direction, dtype=float)
        rest = np.clip(0.0, self.lower, self.upper)
        return np.where(share > 0, self.upper, np.where(share < 0, self.lower, rest))

    def largest_along(self, direction: ArrayLike) -> float:
        """The furthest value of the set along a direction.

        Parameters
        ----------
        direction
            (3,); its length does not matter.

        Returns
        -------
        float
            In the unit of the quantity.
        """
        unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        return float(self.at(self.currents_along(unit)) @ unit)

    def holds(self, values: ArrayLike) -> Array:
        """Whether values can be reached, to rounding.

        Parameters
        ----------
        values
            (..., 3).

        Returns
        -------
        Array
            True (...) where they can.

        Raises
        ------
        InputError
            For a flat set.
        """
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
    """Find the forces on a dipole or a body, or the flux densities, that currents within limits can make at a point.

    A quantity that is linear in the currents, with or without a constant part, is found exactly (`ReachableSet`).
    Otherwise, for soft iron or a map with saturating iron, the set is searched along 134 directions within the domain
    of the map (`SearchedSet`, whose `exact` is False). The results are lower bounds, each with the currents that make
    it. A device with saturating iron that is solved at each set of currents (`fieldmap.iron.NonlinearSolver`) is
    searched along 26 directions, with some hundred solves; a map of it is quicker and is searched more thoroughly.

    Parameters
    ----------
    field
        Any field.
    position
        (3,), m.
    limits
        Largest absolute value of all currents, A, or of each (n,), or lower and upper limits (2, n).
    moment
        Of a dipole (3,), A m^2, or a `MagneticBody`; flux densities are found unless given.
    orientation
        Of a body (3, 3), its columns are its axes; upright unless given.
    progress
        progress(message, share) is called during a search.

    Returns
    -------
    ReachableSet | SearchedSet
        The set of forces, N, or of flux densities, T.

    Raises
    ------
    InputError
        For a field that is not linear in the currents and has no derivatives by them, and for limits that are not
        finite or exclude all currents.
    OutsideMapError
        For a position outside the box of the field.

    Examples
    --------
    >>> reachable(field_map, (0, 0, -0.1), 3.0, moment=(0, 0, 0.8)).largest_along((0, 0, 1))    # doctest: +SKIP
    0.113
    """
    source = as_field(field)
    count = len(source.coil_names)
    lower, upper = _limits(limits, count)
    place = np.asarray(position, dtype=float).reshape(3)
    acted_on: Array | MagneticBody | None
    if isinstance(moment, MagneticBody):
        acted_on = moment
    else:
        refuse_orientations(orientation)
        acted_on = None if moment is None else checked_vectors("reachable, moment", moment)[0].reshape(3)
    turn = checked_turns(orientation, 1)[0]
    if not source.affine or (isinstance(acted_on, MagneticBody) and acted_on.soft):
        return searched_set(field, place, lower, upper, acted_on, turn, progress)
    constant, slope = quantity_of(source, place, acted_on, turn)(np.zeros(count))
    per_ampere = slope.T.copy()
    vertices, triangles, volume = zonotope(per_ampere, lower, upper)
    return ReachableSet(
        **_asked(source, place, lower, upper, acted_on),
        constant=constant,
        per_ampere=per_ampere,
        vertices=vertices + constant,
        triangles=triangles,
        volume=volume,
    )


def zonotope(directions: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> tuple[Array, Index, float]:
    """All sums of directions times numbers between limits.

    Parameters
    ----------
    directions
        (n, 3).
    lower, upper
        Limits of the numbers (n,).

    Returns
    -------
    tuple[Array, Index, float]
        Corners (v, 3), triangles (t, 3) and volume. A flat set has no triangles and the volume 0.

    Examples
    --------
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

"""Evaluation of an opened map: the evaluators, and the checks before they are called.

An `Evaluator` turns coefficients, points and weights into fields. `CompiledEvaluator` does it with the C core.
`MapAtCurrents` checks shapes, divides batches among threads, and raises an error for points outside the box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.core import CoreMap
from fieldmap.core.caller import caller
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.field import Bounds, FieldAtCurrents, MagneticLoad, of_any_shape
from fieldmap.interpolants import INTERPOLANTS, Form, contract, set_size
from fieldmap.interpolants.form import with_rule
from fieldmap.reaction import signs_of
from fieldmap.records import Record, short, shortened
from fieldmap.store import Grid, StoredFields, StoredReaction
from fieldmap.threads import in_pieces
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.device.drawing import Outline

# Fewest points for each thread: a chunk of this size takes about a millisecond. For fewer points a second thread costs
# more than it saves.
CHUNK = 16384
# Methods that handle points of any leading shape themselves, so that the base class does not wrap them. A call with one
# point is then as quick as it can be.
ONE_POINT = ("field", "gradient", "field_and_gradient", "wrench")
_ONE = np.ones((1, 1))


class Evaluator(Protocol):
    """Evaluates the coefficients of a map's fields (`Form`).

    All arrays are float64 and C-contiguous. Points are (n, 3), m; weights are (n, n_fields), or (1, n_fields) for all
    points. Each method writes its results to the arrays that it is given, and returns the number of points outside the
    box. A point that is not finite gets NaN, and so does a point outside a box whose rule is not "clamp". Several
    threads may call a method at the same time.
    """

    @property
    def places(self) -> int:
        """Number of cells or nodes that hold coefficients. The time of `at` is proportional to it."""

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """Fill in flux density and gradient at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        weights
            Weights of the fields (n, n_fields), or (1, n_fields) for all points.
        flux
            Is filled: B (n, 3), T.
        slope
            Is filled: dB_i/dx_j (n, 3, 3), T/m; (n, 0, 0) for the flux density alone.

        Returns
        -------
        int
            Number of points outside the box.
        """

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """Fill in second derivatives at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        weights
            Weights of the fields (n, n_fields), or (1, n_fields) for all points.
        second
            Is filled: d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2.

        Returns
        -------
        int
            Number of points outside the box.
        """

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """Fill in the potential U with B = -grad U.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        weights
            Weights of the fields (n, n_fields), or (1, n_fields) for all points.
        values
            Is filled: U (n,), T m.

        Returns
        -------
        int
            Number of points outside the box.
        """

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """Fill in flux density and gradient of every field at weight 1.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        flux
            Is filled: (n, n_fields, 3).
        slope
            Is filled: (n, n_fields, 3, 3); (n, n_fields, 0, 0) for the flux densities alone.

        Returns
        -------
        int
            Number of points outside the box.
        """

    def at(self, weights: Array) -> Evaluator:
        """The sum of the fields as one field.

        Parameters
        ----------
        weights
            Weights of the fields (n_fields,).

        Returns
        -------
        Evaluator
            An evaluator of one field whose weight is 1.
        """

    def field_at(self, point: Any, weights: Any) -> tuple[Array, Array] | None:
        """B (3,), T, and gradient (3, 3), T/m, at one point.

        Parameters
        ----------
        point
            (3,), m.
        weights
            (n_fields,); None for an evaluator of one field; the currents of the coils for a form with a
            constant field.

        Returns
        -------
        tuple[Array, Array] | None
            Both, or None if the caller must use `field_and_gradient` instead: the point lies outside, the
            arguments do not fit, or the evaluator has no quicker way for one point.
        """

    def dipole_wrench_at(self, point: Any, moment: Any, weights: Any) -> Array | None:
        """Force and torque on one dipole, if the evaluator has a quicker way for one.

        Parameters
        ----------
        point
            Position (3,), m.
        moment
            Moment of the dipole (3,), A m^2.
        weights
            As for `field_at`.

        Returns
        -------
        Array | None
            Force, N, and torque, N m (6,); None as for `field_at`.
        """

    def core(self) -> CoreMap:
        """The map in the form that the C core reads, for compiled callers. For a form with a constant field its weights
        are the currents of the coils. Raises InputError for an evaluator that does not use the C core."""


class CompiledEvaluator:
    """The C core on the coefficients of a form. summed: the form is the sum of a map's fields, whose weight is 1.
    reaction: of the iron to magnets, for wrenches."""

    def __init__(self, form: Form, summed: bool = False, reaction: MapReaction | None = None) -> None:
        self._form, self._summed, self._reaction = form, summed, reaction
        self._core = CoreMap(form.unit)
        own = form.potential_unit is form.unit
        self._of_potential = self._core if own else CoreMap(form.potential_unit, components=1)
        alike = not form.constant and reaction is None
        self._of_currents = self._core if alike else CoreMap(form.unit, 3, form.constant, *core_of(reaction))
        self.field_at = self._of_currents.field_at
        self.dipole_wrench_at = self._of_currents.dipole_wrench_at

    @property
    def places(self) -> int:
        """See `Evaluator`."""
        return self._form.places

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        given = None if self._summed else weights
        return self._core.fields(points, given, flux, slope if slope.shape[-1] else None)

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """See `Evaluator`."""
        return self._core.second_gradients(points, None if self._summed else weights, second)

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """See `Evaluator`."""
        return self._of_potential.potentials(points, None if self._summed else weights, values)

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        return self._core.each_field(points, flux, slope if slope.shape[-1] else None)

    def at(self, weights: Array) -> CompiledEvaluator:
        """See `Evaluator`."""
        if self._summed:
            return self
        form = self._form
        unit = potential = contract(form.unit, weights, set_size(form.unit))
        if form.potential_unit is not form.unit:
            potential = contract(form.potential_unit, weights, 8)
        return CompiledEvaluator(Form(form.kind, unit, potential, form.misfit), True, self._reaction)

    def core(self) -> CoreMap:
        """See `Evaluator`."""
        return self._of_currents


@dataclass(frozen=True, eq=False, repr=False)
class Box(Record):
    """The box of a map, the rule for points outside, and the number of threads for a large batch."""

    lower: Array
    upper: Array
    outside: str
    threads: int

    def check(self, points: Array, n_outside: int) -> None:
        """Raise OutsideMapError if points lie outside and the rule is "raise"."""
        if n_outside and self.outside == "raise":
            raise outside_error(points, n_outside, self.lower, self.upper)


class MapFields:
    """Further fields of a map besides the fields of its coils.

    Parameters
    ----------
    stored
        The fields at the nodes.
    grid
        Grid of the nodes.
    kind
        Interpolant of the map; "harmonic" replaces an interpolant that the C core does not evaluate.
    box
        Box of the map, with its rule for points outside.
    cells
        Block of the harmonic form of the fields, if a file holds it.
    """

    def __init__(
        self, stored: StoredFields, grid: Grid, kind: str, box: Box, cells: Array | None = None
    ) -> None:
        own = INTERPOLANTS[kind] if INTERPOLANTS[kind].kind is not None else INTERPOLANTS["harmonic"]
        if cells is not None and own is INTERPOLANTS["harmonic"]:
            unit = with_rule(cells, box.outside)
        else:
            unit = own.form(stored.on(grid), box.outside).unit
        self._box = box
        self.core = CoreMap(unit)

    def fields(self, points: Array) -> tuple[Array, Array]:
        """See `fieldmap.reaction.Reaction`. Raises OutsideMapError by the rule of the map."""
        where = np.ascontiguousarray(points)
        flux, slope = (np.empty((len(where), self.core.sets, *tail)) for tail in ((3,), (3, 3)))
        in_chunks(self.core.each_field, where, [flux, slope], self._box)
        return np.swapaxes(flux, 0, 1), np.swapaxes(slope, 0, 1)

    def second_gradient(self, points: Array) -> Array:
        """See `fieldmap.reaction.Reaction`. Raises OutsideMapError by the rule of the map."""
        where, count = np.ascontiguousarray(points), self.core.sets
        second = np.empty((count, len(where), 3, 3, 3))
        for k, weights in enumerate(np.eye(count)):
            in_chunks(self.core.second_gradients, where, [weights[None], second[k]], self._box)
        return second


class MapReaction(MapFields):
    """The iron's reaction to magnets: a `fieldmap.reaction.Reaction`. Arguments as for `MapFields`."""

    def __init__(
        self, stored: StoredReaction, grid: Grid, kind: str, box: Box, cells: Array | None = None
    ) -> None:
        super().__init__(stored, grid, kind, box, cells)
        self.repelled = stored.repelled

    @property
    def signs(self) -> Array:
        """Signs (k,)."""
        return signs_of(self.core.sets, self.repelled)


def core_of(reaction: MapReaction | None) -> tuple[CoreMap | None, int]:
    """The reaction as `CoreMap` takes it."""
    return (None, 0) if reaction is None else (reaction.core, reaction.repelled)


def result_array(out: Array | None, shape: tuple[int, ...]) -> Array:
    """A new array, or `out` if it fits. Raises InputError if it does not."""
    if out is None:
        return np.empty(shape)
    good = isinstance(out, np.ndarray) and out.shape == shape and out.dtype == np.float64
    if not (good and out.flags.c_contiguous and out.flags.writeable):
        received = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        must_hold = f"a contiguous, writeable float64 array of shape {shape}"
        raise InputError.of("lookup, out", must_hold, received, "match it")
    return out


def in_chunks(evaluate: Callable[..., int], points: Array, others: Sequence[Array], box: Box) -> None:
    """Call evaluate(points[a:b], other[a:b], ...) for all points, on several threads if there are many points.

    An array in `others` whose length is not that of the points is passed whole.
    """
    n = len(points)

    def part(a: int, b: int) -> int:
        return evaluate(points[a:b], *(other[a:b] if len(other) == n else other for other in others))

    box.check(points, sum(in_pieces(part, n, CHUNK, box.threads)))


def outside_error(points: Array, outside: int, lower: Array, upper: Array) -> OutsideMapError:
    """The error for points (n, 3), m, if `outside` of them lie outside the box from lower to upper."""
    with np.errstate(invalid="ignore"):
        excess = np.max(np.maximum(lower - points, points - upper), axis=1)
    worst = points[np.nanargmax(excess)]
    box = " to ".join(str(tuple(round(float(x) * 1e3, 6) for x in corner)) for corner in (lower, upper))
    farthest = tuple(round(float(x) * 1e3, 6) for x in worst)
    return OutsideMapError.of(
        "points",
        f"every point lies in the map's box, {box} mm",
        f"{outside} of {len(points)} points outside, the farthest at {farthest} mm",
        'stay in the box, make a larger map, or open it with outside="nan" to get NaN there',
    )


class MapAtCurrents(FieldAtCurrents, own_shapes=ONE_POINT):
    """The field of a map at fixed currents (`FieldMap.at`): summed once, then evaluated at any points.

    Points, shapes and the rule for points outside are those of `FieldMap`. No method has an argument `currents`.

    Parameters
    ----------
    evaluator
        The evaluator of the map's fields, or of their sum.
    box
        The box of the map and its rule for points outside.
    coil_names
        In the order of the currents.
    currents
        (n_coils,), A.
    assumptions
        Assumptions of the map.
    weights
        (1, n_fields) for all points, or (n, n_fields), one row for each of n points; None if the evaluator
        has one field, the sum.
    reaction
        Reaction of the iron to magnets.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        box: Box,
        coil_names: tuple[str, ...],
        currents: Array,
        assumptions: tuple[str, ...] = (),
        weights: Array | None = None,
        reaction: MapReaction | None = None,
    ) -> None:
        self._evaluator, self._box, self._weights, self._reaction = evaluator, box, weights, reaction
        self._coil_names, self.currents, self._assumptions = coil_names, currents, assumptions
        self._domain = box.lower, box.upper

    def __repr__(self) -> str:
        return shortened(f"{type(self).__name__}({len(self.coil_names)} coils at {short(self.currents)} A)")

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return self._coil_names

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The assumptions of the map."""
        return self._assumptions

    @property
    def reaction(self) -> MapReaction | None:
        """The reaction of the iron to magnets, which forces and torques contain."""
        return self._reaction

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of the map's box, m."""
        return self._box.lower, self._box.upper

    def field(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        out
            Array of the result's shape, float64 and C order, that is filled and returned; a new one unless
            given.

        Returns
        -------
        Array
            B (..., 3), T.

        Raises
        ------
        OutsideMapError
            For points outside the box, by the rule given to `open_map`.
        """
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[0]
        return self._pair_of_any_shape(points, out, None, gradient=False)[0]

    def gradient(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Gradient of the flux density: the exact derivative of `field`.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        out
            Array of the result's shape, float64 and C order, that is filled and returned; a new one unless
            given.

        Returns
        -------
        Array
            G (..., 3, 3), G[..., i, j] = dB_i/dx_j, T/m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[1]
        return self._pair_of_any_shape(points, None, out)[1]

    def field_and_gradient(
        self, points: ArrayLike, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Flux density and its gradient in one pass.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        out
            Two arrays of the results' shapes that are filled and returned; new ones unless given.

        Returns
        -------
        tuple[Array, Array]
            B (..., 3), T, and G (..., 3, 3), T/m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        found = None if self._weights is not None else self._evaluator.field_at(points, None)
        if found is not None and out is None:
            return found
        if found is not None and out is not None:
            # A copy of one point is three times as fast as a pass of `_fill`.
            for to, of in zip(out, found, strict=True):
                result_array(to, of.shape)[...] = of
            return out
        flux, slope = (None, None) if out is None else out
        if getattr(points, "ndim", 0) == 2:
            # `_pair_of_any_shape` would take a tenth longer, for 20 points.
            return self._pair(points, flux, slope)
        return self._pair_of_any_shape(points, flux, slope)

    def _pair(
        self, points: ArrayLike, flux: Array | None, slope: Array | None, gradient: bool = True
    ) -> tuple[Array, Array]:
        """Flux density and gradient at points (n, 3) or (3,), in these arrays or new ones; without `gradient` the
        second one is empty."""
        where, single = checked_vectors("points", points)
        leading = () if single else where.shape[:1]
        b = result_array(flux, (*leading, 3))
        g = result_array(slope, (*leading, 3, 3)) if gradient else np.empty((*leading, 0, 0))
        self._fill(self._evaluator.field_and_gradient, where, *((b[None], g[None]) if single else (b, g)))
        return b, g

    _pair_of_any_shape = of_any_shape(_pair)

    def second_gradient(self, points: ArrayLike) -> Array:
        """Second derivatives (n, 3, 3, 3), [:, i, j, k] = d2B_i/dx_j dx_k, T/m^2."""
        where, single = checked_vectors("points", points)
        second = np.empty((len(where), 3, 3, 3))
        self._fill(self._evaluator.second_gradient, where, second)
        return second[0] if single else second

    def potential(self, points: ArrayLike) -> Array | float:
        """Scalar potential U with B = -grad U.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array | float
            U (...), T m.

        Raises
        ------
        OutsideMapError
            As for `field`.
        """
        where, single = checked_vectors("points", points)
        values = np.empty(len(where))
        self._fill(self._evaluator.potential, where, values)
        return float(values[0]) if single else values

    def wrench(
        self, positions: ArrayLike, moments: ArrayLike | MagneticLoad, orientations: ArrayLike | None = None
    ) -> Array:
        """Force (N) and torque (N m) on point dipoles or a body, (n, 6), about their own positions: see
        `FieldMap.wrench`."""
        if orientations is None and self._weights is None:
            load = self._evaluator.dipole_wrench_at(positions, moments, None)
            if load is not None:
                return load
        return super().wrench(positions, moments, orientations)

    def outlines(self) -> tuple[Outline, ...]:
        """The box of the map."""
        from fieldmap.device.drawing import box_outline

        return (box_outline("map", self.lower, self.upper),)

    def compiled(self) -> tuple[Any, Any]:
        """(function, data) for numba functions: see `FieldMap.compiled`."""
        if self._weights is not None:
            must_hold, remedy = (
                "a map whose fields are summed at its currents",
                "write compiled(), and give its function the currents",
            )
            raise InputError.of("compiled(currents)", must_hold, f"{self._evaluator.places} cells", remedy)
        words = caller(self._evaluator.core())
        # Imported here: numba is needed only for compiled functions.
        from fieldmap.lookup.compiled import at

        return at, words

    def _fill(self, evaluate: Callable[..., int], points: Array, *results: Array) -> None:
        weights = _ONE if self._weights is None else self._weights
        in_chunks(evaluate, points, [weights, *results], self._box)

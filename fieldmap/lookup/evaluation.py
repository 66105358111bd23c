"""Evaluation of an opened map: who evaluates its coefficients, and what stands in front of that.

An `Evaluator` turns coefficients, points and weights into fields; `CompiledEvaluator` is the package's own. In front of
it shapes are checked, batches are shared among threads, and points outside the box become an error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numba
import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.errors import InputError, OutsideMapError, Problem
from fieldmap.field import (
    Bounds,
    MagneticLoad,
    TakesPoints,
    dipole_wrench,
    has_leading_shape,
    magpylib_source,
    of_any_shape,
    over_points,
    refuse_orientations,
)
from fieldmap.interpolants import Form, contract, set_size
from fieldmap.kernels.in_threads import in_pieces
from fieldmap.kernels.map import lookup as kernels
from fieldmap.kernels.map.constant_field import evaluate_one_beside_constant
from fieldmap.kernels.map.dipole_wrench import sum_wrench_at, wrench_at
from fieldmap.kernels.map.map_block import WRONG_SHAPE
from fieldmap.records import Record, short, shortened
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.device.drawing import Outline

# Points below which a second thread costs more than it saves: a chunk of this size takes about a millisecond.
CHUNK = 16384
# What takes points of any leading shape by itself, so that nothing stands before it where one point is asked for.
ONE_POINT = ("field", "gradient", "field_and_gradient", "wrench")
_ONE = np.ones((1, 1))
_empty = np.empty


class Evaluator(Protocol):
    """What evaluates the coefficients of a map's fields (`Form`).

    Arrays are float64 and C-contiguous: points (n, 3), m; weights (n, n_fields), or (1, n_fields) for all points.
    Results are written to the arrays given for them, NaN for a point that is not finite or lies outside a box whose
    rule is not to clamp. Each method returns how many points lie outside. Calls from several threads must not disturb
    each other.
    """

    @property
    def places(self) -> int:
        """Number of cells or nodes that hold coefficients: what `at` costs, in evaluations at a point."""

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """flux (n, 3), T, and slope (n, 3, 3), T/m, or (n, 0, 0) for the field alone."""

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """second (n, 3, 3, 3), T/m^2."""

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """values (n,), T m: U with B = -grad U."""

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """flux (n, n_fields, 3) and slope (n, n_fields, 3, 3) of every field at weight 1, or (n, n_fields, 0, 0)."""

    def at(self, weights: Array) -> Evaluator:
        """The sum of the fields at weights (n_fields,), an evaluator of one field whose weight is 1."""

    def one_point(self) -> tuple[Callable[..., int], Any]:
        """(function, data) with function(data, weights, point, flux, slope) for one point (3,), 0 if it was inside and
        all arguments fit. Functions of one field are called without weights."""

    def compiled(self) -> tuple[Any, Any]:
        """(function, data) for code that numba compiles: see `FieldMap.compiled`. Raises InputError without one."""


class CompiledEvaluator:
    """Kernels that numba compiles: fieldmap.kernels.map.lookup on one block of coefficients."""

    def __init__(self, form: Form) -> None:
        self._unit, self._potential_unit, self.places = form.unit, form.potential_unit, form.places

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.evaluate_with(self._unit, weights, points, flux, slope))

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.second_gradient(self._unit, weights, points, second))

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.potential(self._potential_unit, weights, points, values))

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.evaluate_units(self._unit, points, flux, slope))

    def at(self, weights: Array) -> ContractedEvaluator:
        """See `Evaluator`."""
        block = contract(self._unit, weights, set_size(self._unit))
        own = self._potential_unit is self._unit
        return ContractedEvaluator(block, block if own else contract(self._potential_unit, weights, 8))

    def one_point(self) -> tuple[Callable[..., int], Any]:
        """See `Evaluator`."""
        n_fields = int(self._unit[kernels.SETS])
        example = self._unit, np.zeros(n_fields), np.zeros(3), np.empty(3), np.empty((3, 3))
        return closed_to_new_types(kernels.evaluate_one_with, *example), self._unit

    def one_point_beside_constant(self) -> tuple[Callable[..., int], Any]:
        """As `one_point`, for the currents of the coils where the last field is one that no current drives."""
        coils = int(self._unit[kernels.SETS]) - 1
        example = self._unit, np.zeros(coils), np.zeros(3), np.empty(3), np.empty((3, 3))
        return closed_to_new_types(evaluate_one_beside_constant, *example), self._unit

    def one_wrench(self) -> Callable[..., int]:
        """`fieldmap.kernels.map.dipole_wrench.wrench_at`, for the block of `one_point`."""
        three = np.zeros(3)
        return closed_to_new_types(wrench_at, self._unit, np.empty(0), three, three, three, np.empty(6))

    def compiled(self) -> tuple[Any, Any]:
        """See `Evaluator`."""
        return kernels.at_currents, self._unit


class ContractedEvaluator:
    """The same kernels on a block that holds the sum of the fields."""

    places = 1

    def __init__(self, block: Array, potential_block: Array) -> None:
        self._block, self._potential_block = block, potential_block

    def field_and_gradient(self, points: Array, weights: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.evaluate(self._block, points, flux, slope))

    def second_gradient(self, points: Array, weights: Array, second: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.second_gradient(self._block, weights, points, second))

    def potential(self, points: Array, weights: Array, values: Array) -> int:
        """See `Evaluator`."""
        return int(kernels.potential(self._potential_block, weights, points, values))

    def each_field(self, points: Array, flux: Array, slope: Array) -> int:
        """See `Evaluator`."""
        return self.field_and_gradient(points, _ONE, flux[:, 0], slope[:, 0])

    def at(self, weights: Array) -> ContractedEvaluator:
        """See `Evaluator`: there is nothing left to sum."""
        return self

    def one_point(self) -> tuple[Callable[..., int], Any]:
        """See `Evaluator`."""
        example = self._block, np.zeros(3), np.empty(3), np.empty((3, 3))
        return closed_to_new_types(kernels.evaluate_one, *example), self._block

    def one_wrench(self) -> Callable[..., int]:
        """`fieldmap.kernels.map.dipole_wrench.sum_wrench_at`, for the block of `one_point`."""
        return closed_to_new_types(sum_wrench_at, self._block, np.zeros(3), np.zeros(3), np.empty(6))

    def compiled(self) -> tuple[Any, Any]:
        """See `Evaluator`."""
        return kernels.at, self._block


def closed_to_new_types(kernel: Callable[..., Any], *example: object) -> Callable[..., Any]:
    """The kernel, compiled for arguments like the example and for no others.

    Other types then raise TypeError at once instead of costing seconds of compilation, whoever called the kernel
    before. Without a just-in-time compiler (NUMBA_DISABLE_JIT) there is nothing to do.
    """
    if hasattr(kernel, "disable_compile"):
        kernel(*example)
        kernel.disable_compile()
    return kernel


def wrench_kernel(evaluator: Evaluator) -> Callable[..., int]:
    """The kernel for the wrench at one point; for an evaluator that has none, one that leaves every point to others."""
    if isinstance(evaluator, CompiledEvaluator | ContractedEvaluator):
        return evaluator.one_wrench()
    return lambda *_: WRONG_SHAPE


@dataclass(frozen=True, eq=False, repr=False)
class Box(Record):
    """Where a map holds, what a point outside does, and how many threads a large batch may use."""

    lower: Array
    upper: Array
    outside: str
    threads: int

    def check(self, points: Array, n_outside: int) -> None:
        """Raise OutsideMapError if that is the rule and points lie outside."""
        if n_outside and self.outside == "raise":
            raise outside_error(points, n_outside, self.lower, self.upper)


def default_threads() -> int:
    """One per processor that this process may use, or NUMBA_NUM_THREADS."""
    return int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]


def result_array(out: Array | None, shape: tuple[int, ...]) -> Array:
    """A new array, or `out` if it fits. Raises InputError if it does not."""
    if out is None:
        return np.empty(shape)
    good = isinstance(out, np.ndarray) and out.shape == shape and out.dtype == np.float64
    if not (good and out.flags.c_contiguous and out.flags.writeable):
        received = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        problem = Problem(
            "lookup, out", f"a contiguous, writeable float64 array of shape {shape}", received, "match it"
        )
        raise InputError(problem)
    return out


def in_chunks(evaluate: Callable[..., int], points: Array, others: Sequence[Array], box: Box) -> None:
    """evaluate(points[a:b], *(other[a:b])) over all points, on several threads if there are many.

    Arrays of another length than the points are passed whole.
    """
    n = len(points)

    def part(a: int, b: int) -> int:
        return evaluate(points[a:b], *(other[a:b] if len(other) == n else other for other in others))

    box.check(points, sum(in_pieces(part, n, CHUNK, box.threads)))


def outside_error(points: Array, outside: int, lower: Array, upper: Array) -> OutsideMapError:
    """The error for points of which `outside` lie outside the box from lower to upper."""
    with np.errstate(invalid="ignore"):
        excess = np.max(np.maximum(lower - points, points - upper), axis=1)
    worst = points[np.nanargmax(excess)]
    box = " to ".join(str(tuple(round(float(x) * 1e3, 6) for x in corner)) for corner in (lower, upper))
    return OutsideMapError(
        Problem(
            "points",
            f"every point lies in the map's box, {box} mm",
            f"{outside} of {len(points)} points outside, the farthest at "
            f"{tuple(round(float(x) * 1e3, 6) for x in worst)} mm",
            'stay in the box, make a larger map, or open it with outside="nan" to get NaN there',
        )
    )


class MapAtCurrents(TakesPoints, own_shapes=ONE_POINT):
    """The field of a map at fixed currents (`FieldMap.at`): summed once, evaluated as often as you like.

    Points, shapes and what happens outside are as for `FieldMap`; there is no argument `currents`.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        box: Box,
        coil_names: tuple[str, ...],
        currents: Array,
        assumptions: tuple[str, ...] = (),
    ) -> None:
        self._evaluator, self._box = evaluator, box
        self.coil_names, self.currents, self.assumptions = coil_names, currents, assumptions
        self._start()

    def _start(self) -> None:
        self._one, self._data = self._evaluator.one_point()
        self._one_wrench: Callable[..., int] = self._first_wrench

    def _first_wrench(self, *given: Any) -> int:
        """Not when the currents are set: the kernel may have to be compiled."""
        self._one_wrench = wrench_kernel(self._evaluator)
        return self._one_wrench(*given)

    def __repr__(self) -> str:
        return shortened(f"{type(self).__name__}({len(self.coil_names)} coils at {short(self.currents)} A)")

    @property
    def lower(self) -> Array:
        """Lower corner of the box in which the field holds, m."""
        return self._box.lower

    @property
    def upper(self) -> Array:
        """Upper corner of the box in which the field holds, m."""
        return self._box.upper

    @property
    def bounds(self) -> Bounds:
        """Lower and upper corner of that box, m."""
        return self._box.lower, self._box.upper

    def field(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Flux density B (n, 3), T."""
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[0]
        if has_leading_shape(points):
            return over_points(self.field, points, out)
        where, single = checked_vectors("points", points)
        flux = result_array(None if single else out, where.shape)
        self._fill(self._evaluator.field_and_gradient, where, flux, np.empty((len(where), 0, 0)))
        return single_row(flux, out) if single else flux

    def gradient(self, points: ArrayLike, out: Array | None = None) -> Array:
        """Gradient G (n, 3, 3), G[:, i, j] = dB_i/dx_j, T/m: the exact derivative of `field`."""
        if out is None and getattr(points, "ndim", 0) == 1:
            return self.field_and_gradient(points)[1]
        if has_leading_shape(points):
            return over_points(self.gradient, points, out)
        where, single = checked_vectors("points", points)
        slope = result_array(None if single else out, (*where.shape, 3))
        self._fill(self._evaluator.field_and_gradient, where, np.empty(where.shape), slope)
        return single_row(slope, out) if single else slope

    def field_and_gradient(
        self, points: ArrayLike, out: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """B (n, 3) in T and G (n, 3, 3) in T/m in one pass."""
        try:
            if points.ndim == 1:  # type: ignore[union-attr]
                flux, slope = (_empty(3), _empty((3, 3))) if out is None else out
                if self._one(self._data, points, flux, slope) == 0:
                    return flux, slope
        except (TypeError, AttributeError, ValueError):
            pass  # a list, not float64, not contiguous, no pair: what follows sorts it out
        if has_leading_shape(points):
            return over_points(self.field_and_gradient, points, out)
        where, single = checked_vectors("points", points)
        given = (None, None) if out is None else out
        flux = result_array(None if single else given[0], where.shape)
        slope = result_array(None if single else given[1], (*where.shape, 3))
        self._fill(self._evaluator.field_and_gradient, where, flux, slope)
        return (single_row(flux, given[0]), single_row(slope, given[1])) if single else (flux, slope)

    def as_magpylib(self, **options: Any) -> Any:
        """The field as a magpylib source, NaN outside the map: see `fieldmap.field.BaseFieldAtCurrents.as_magpylib`."""
        return magpylib_source(self, self.bounds, self.outlines, **options)

    def outlines(self) -> tuple[Outline, ...]:
        """The box of the map."""
        from fieldmap.device.drawing import box_outline

        return (box_outline("map", self.lower, self.upper),)

    def second_gradient(self, points: ArrayLike) -> Array:
        """Second derivatives (n, 3, 3, 3), [:, i, j, k] = d2B_i/dx_j dx_k, T/m^2."""
        where, single = checked_vectors("points", points)
        second = np.empty((len(where), 3, 3, 3))
        self._fill(self._evaluator.second_gradient, where, second)
        return second[0] if single else second

    def potential(self, points: ArrayLike) -> Array | float:
        """Scalar potential U (n,) in T m, B = -grad U."""
        where, single = checked_vectors("points", points)
        values = np.empty(len(where))
        self._fill(self._evaluator.potential, where, values)
        return float(values[0]) if single else values

    def wrench(
        self,
        positions: ArrayLike,
        moments: ArrayLike | MagneticLoad,
        orientations: ArrayLike | None = None,
    ) -> Array:
        """Force (N) and torque (N m) on point dipoles or a body, (n, 6), about their own positions: see
        `FieldMap.wrench`."""
        try:
            if positions.ndim == moments.ndim == 1 and orientations is None:  # type: ignore[union-attr]
                load = _empty(6)
                if self._one_wrench(self._data, positions, moments, load) == 0:
                    return load
        except (TypeError, AttributeError, ValueError):
            pass  # as in `field_and_gradient`
        return np.asarray(self._wrench(positions, moments, orientations))

    @partial(of_any_shape, first="positions")
    def _wrench(self, positions: Array, moments: Any, orientations: ArrayLike | None) -> Array:
        if isinstance(moments, MagneticLoad):
            return moments.wrench(self, positions, self.currents, orientations)
        refuse_orientations(orientations)
        where, single = checked_vectors("positions", positions)
        flux, slope = self.field_and_gradient(where)
        result = dipole_wrench(flux, slope, moments)
        return result[0] if single else result

    def compiled(self) -> tuple[Any, Any]:
        """(function, data) for numba functions: see `FieldMap.compiled`."""
        return self._evaluator.compiled()

    def _fill(self, evaluate: Callable[..., int], points: Array, *results: Array) -> None:
        in_chunks(lambda p, *r: evaluate(p, _ONE, *r), points, results, self._box)

    def __getstate__(self) -> dict[str, object]:
        return {k: v for k, v in self.__dict__.items() if k not in ("_one", "_data", "_one_wrench")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._start()


def single_row(result: Array, out: Array | None) -> Array:
    """The only row of a result, written to `out` if there is one."""
    if out is None:
        return result[0]
    checked = result_array(out, result.shape[1:])
    checked[...] = result[0]
    return checked

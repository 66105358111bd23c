"""Table of the weights of a map of saturating iron over the signals of a current division, for quick lookups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fieldmap.core.current_table import FOUND, CoreTable, Table
from fieldmap.currents import ROUNDING, TOLERANCE, LiftAndDirections
from fieldmap.errors import InputError
from fieldmap.extras import require
from fieldmap.lookup.current_model import CurrentModel, require_no_memory
from fieldmap.lookup.evaluation import Evaluator
from fieldmap.records import Record
from fieldmap.store import FieldError, Grid
from fieldmap.typing import Array

# Numbers of nodes of u, x and y, tried in turn until the table's error is at most _GOOD of the model's own error.
SIZES = ((5, 17, 17), (7, 21, 21), (9, 33, 33))
_GOOD = 0.25
# Exponent of the positions of nodes, which makes them denser about x = 0 and y = 0: the field changes sharply there.
_GRADING = 1.5
_STATES, _BALANCED, _SEED = 200, 100, 11


@dataclass(frozen=True, eq=False, repr=False)
class CurrentTable(Record):
    """The weights that a `CurrentModel` gives, by cubic splines between tabulated currents.

    core: the table itself; nodes: of u, x and y; error: largest difference from the model in the map's box at 300
    states between the nodes, a third of them nearly balanced, T and T/m.
    """

    model: CurrentModel
    core: CoreTable
    nodes: tuple[int, int, int]
    error: FieldError

    def weights(self, currents: Array) -> Array:
        """Weights of the fields at currents, as `CurrentModel.weights`.

        Parameters
        ----------
        currents
            Currents (..., 6), A. For currents outside the table the model raises, gives NaN, or evaluates.

        Returns
        -------
        Array
            Weights (..., n_fields).
        """
        rows = np.ascontiguousarray(currents.reshape(-1, currents.shape[-1]))
        result = np.empty((len(rows), 6 + self.model.fields_beside_coils))
        for row, out in zip(rows, result, strict=True):
            if self.core.weights(row, out) != FOUND:
                out[:] = self.model.weights(row)
        return result.reshape(*currents.shape[:-1], -1)


def tabulate(
    model: CurrentModel | None,
    evaluator: Evaluator,
    grid: Grid,
    wanted: FieldError | None = None,
    nodes: tuple[int, int, int] | None = None,
) -> CurrentTable:
    """Make the table of an opened map of saturating iron over a current division.

    Table and model are compared by the fields of `evaluator`, at the nodes of `grid` on the surface of the box. wanted:
    error of the model. nodes: numbers for u, x and y, at least four each; unless given, enough to make the table's
    error small against `wanted`. Raises InputError for any other map, for iron with hysteresis, and for fewer nodes.
    """
    divided = None if model is None else model.model.parametrisation
    if model is None or not isinstance(divided, LiftAndDirections):
        received = "a map of linear iron" if divided is None else f"currents by {divided.name}"
        must_hold = "a map of saturating iron whose recipe has [currents] lift_and_directions"
        raise InputError.of("table of currents", must_hold, received, "do without a table")
    require_no_memory(model.model.remembers, "table of currents")
    if nodes is not None and (len(nodes) != 3 or min(nodes) < 4):
        must_hold = "must be three numbers of nodes, for u, x and y, each at least 4"
        raise InputError.of("table of currents", must_hold, f"{nodes}", "take (5, 17, 17)")
    fields = _on_the_surface(evaluator, grid, model.model.coil_count + model.fields_beside_coils)
    states = _states(model, divided)
    truth = model.of_amplitudes(np.array([model.amplitudes(currents) for currents in states]))
    for size in SIZES if nodes is None else (nodes,):
        axes, every, amplitudes = _solved(model, divided, size)
        values = model.of_amplitudes(amplitudes).reshape(*size, -1)
        # The comparison needs no slopes. They are computed once, for the final nodes.
        numbers = spline_table(axes, divided, values, np.zeros((0, 0, 0, 0, 0)))
        found = _weights(CoreTable(numbers), states)
        error = FieldError(*(_largest(found - truth, of_field) for of_field in fields))
        if wanted is None or _within(error, wanted):
            break
    slopes = model.slopes(every).swapaxes(1, 2).reshape(*size, 6, -1)
    return CurrentTable(model, CoreTable(numbers._replace(slopes=np.array(slopes, order="C"))), size, error)


def spline_table(
    axes: list[Array], divided: LiftAndDirections, values: Array, slopes: Array, margin: float = ROUNDING
) -> Table:
    """A table of weights (nu, nx, ny, k) at nodes of u, x and y, and their slopes by the currents
    (nu, nx, ny, 6, k). margin: share of the range by which currents may lie outside, for rounding."""
    interpolate = require("scipy.interpolate", "levitation", "table of currents", "do without a table")
    coefficients, knots = values, []
    for axis, nodes in enumerate(axes):
        spline = interpolate.make_interp_spline(nodes, coefficients, k=3, axis=axis)
        coefficients = np.moveaxis(spline.c, 0, axis)
        knots.append(np.array(spline.t))
    lower, upper = np.array([nodes[0] for nodes in axes]), np.array([nodes[-1] for nodes in axes])
    beside = margin * (upper - lower)
    return Table(
        exponent=divided.n,
        limit=np.inf if divided.limit is None else divided.limit * (1.0 + ROUNDING),
        mismatch=TOLERANCE,
        lower=lower - beside,
        upper=upper + beside,
        knots=(knots[0], knots[1], knots[2]),
        nodes=(np.array(axes[0]), np.array(axes[1]), np.array(axes[2])),
        coefficients=np.array(coefficients, order="C"),
        slopes=np.array(slopes, order="C"),
    )


def _within(error: FieldError, wanted: FieldError) -> bool:
    return error.flux_density <= _GOOD * wanted.flux_density and error.gradient <= _GOOD * wanted.gradient


def _weights(table: CoreTable, states: Array) -> Array:
    """Weights (s, k) of the fields after those of the coils, at currents (s, 6)."""
    found = np.empty((len(states), 6 + table.numbers.coefficients.shape[-1]))
    for currents, out in zip(np.ascontiguousarray(states), found, strict=True):
        table.weights(currents, out)
    return found[:, 6:]


def _solved(
    model: CurrentModel, divided: LiftAndDirections, nodes: tuple[int, int, int]
) -> tuple[list[Array], Array, Array]:
    """Nodes of u, x and y, currents (s, 6) of all of them, and the amplitudes (s, r) of the model there."""
    edges = zip(model.model.lower, model.model.upper, nodes, (1.0, _GRADING, _GRADING), strict=True)
    axes = [_nodes(*edge) for edge in edges]
    every = divided.currents(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))
    return axes, every, np.array([model.amplitudes(currents) for currents in every])


def _nodes(lower: float, upper: float, count: int, power: float) -> Array:
    """Nodes from lower to upper, denser about zero if zero lies between them."""
    if power == 1.0 or not lower < 0.0 < upper:
        return np.linspace(lower, upper, count)
    shares = np.linspace(-1.0, 1.0, count)
    graded = np.abs(shares) ** power
    return np.where(shares < 0.0, lower * graded, upper * graded)


def _states(model: CurrentModel, divided: LiftAndDirections) -> Array:
    """Currents (300, 6) at random, a hundred of them nearly balanced."""
    lower, upper = model.model.lower, model.model.upper
    shares = np.random.default_rng(_SEED).random((_STATES + _BALANCED, 3))
    # Currents are balanced if x and y are zero, or as near to zero as the ranges allow.
    zero = np.clip(-lower / (upper - lower), 0.0, 1.0)[1:]
    shares[_STATES:, 1:] = zero + 0.1 * (shares[_STATES:, 1:] - zero)
    return divided.currents(divided.within(lower, upper, shares))


def _on_the_surface(evaluator: Evaluator, grid: Grid, sets: int) -> tuple[Array, Array]:
    """Fields (k, n, 3) and gradients (k, n, 9) after those of the coils, at the nodes on the surface of the box, where
    they are largest."""
    points = grid.points()
    ends = np.stack([grid.lower, grid.upper])
    near = np.abs(points[:, None] - ends) < 0.5 * grid.spacing
    points = points[near.any(axis=(1, 2))]
    flux, slope = np.empty((len(points), sets, 3)), np.empty((len(points), sets, 3, 3))
    evaluator.each_field(points, flux, slope)
    return flux.swapaxes(0, 1)[6:], slope.reshape(len(points), sets, 9).swapaxes(0, 1)[6:]


def _largest(weights: Array, fields: Array) -> float:
    """Largest norm over states and points of sum_k weights (s, k) fields (k, n, d)."""
    return max(float(np.linalg.norm(np.tensordot(row, fields, 1), axis=-1).max()) for row in weights)

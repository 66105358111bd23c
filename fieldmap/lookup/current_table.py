"""Weights of a saturating map's fields over the signals of a current division, tabulated: microseconds, not Newton."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from fieldmap.device.current_division import divide_currents
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.current_table import FOUND, table_weights
from fieldmap.lookup.current_model import LARGEST_MISMATCH, MARGIN, CurrentModel
from fieldmap.store import FieldError, MapData

Array = NDArray[np.float64]
# Nodes of u, x and y: more are taken until the table's error is this share of the model's own.
SIZES = ((5, 17, 17), (7, 21, 21), (9, 33, 33))
_GOOD = 0.25
# The field turns sharply at balanced currents: nodes are denser about x = 0 and y = 0 by this power.
_GRADING = 1.5
_STATES, _BALANCED, _SEED = 200, 100, 11


@dataclass(frozen=True, eq=False)
class CurrentTable:
    """The weights that a `CurrentModel` gives, by cubic splines between tabulated currents.

    arrays: what `fieldmap.kernels.current_table.table_weights` takes; nodes: of u, x and y; error: largest difference
    from the model in the map's box at 300 states between the nodes, a third of them nearly balanced, T and T/m.
    """

    model: CurrentModel
    arrays: tuple[Array, ...]
    nodes: tuple[int, int, int]
    error: FieldError

    def weights(self, currents: Array) -> Array:
        """Weights (..., n_fields) of currents (..., 6), as `CurrentModel.weights`.

        Currents outside the table are the model's affair: it raises, gives NaN, or evaluates.
        """
        rows = np.ascontiguousarray(currents.reshape(-1, currents.shape[-1]))
        result = np.empty((len(rows), rows.shape[1] + self.arrays[-1].shape[-1]))
        for row, out in zip(rows, result, strict=True):
            if table_weights(self.arrays, row, out) != FOUND:
                out[:] = self.model.weights(row)
        return result.reshape(*currents.shape[:-1], -1)


def tabulate(model: CurrentModel | None, data: MapData) -> CurrentTable:
    """The table of a map of saturating iron whose currents are a division. Raises InputError for any other map."""
    if model is None or not model.model.division_exponent.size:
        received = "a map of linear iron" if model is None else "independent currents"
        must_hold = "a map of saturating iron whose recipe has [currents] division"
        raise InputError(Problem("tabulate_currents", must_hold, received, "leave tabulate_currents out"))
    fields = _on_the_surface(data)
    states = _states(model)
    truth = np.array([model.weights(currents)[6:] for currents in states])
    wanted = data.current_error
    for nodes in SIZES:
        arrays = _splines(model, nodes)
        found = np.array([_weights(arrays, currents) for currents in states])
        error = FieldError(*(_largest(found - truth, values) for values in fields))
        if wanted is None or _within(error, wanted):
            break
    return CurrentTable(model, arrays, nodes, error)


def _within(error: FieldError, wanted: FieldError) -> bool:
    return error.flux_density <= _GOOD * wanted.flux_density and error.gradient <= _GOOD * wanted.gradient


def _weights(arrays: tuple[Array, ...], currents: Array) -> Array:
    out = np.empty(6 + arrays[-1].shape[-1])
    table_weights(arrays, currents, out)
    return out[6:]


def _splines(model: CurrentModel, nodes: tuple[int, int, int]) -> tuple[Array, ...]:
    reduced = model.model
    lower, upper, exponent = reduced.lower, reduced.upper, reduced.division_exponent
    axes = [_nodes(*edge) for edge in zip(lower, upper, nodes, (1.0, _GRADING, _GRADING), strict=True)]
    u, x, y = np.meshgrid(*axes, indexing="ij")
    every = divide_currents(u, x, y, float(exponent[0])).reshape(-1, 6)
    amplitudes = np.array([model.amplitudes(currents) for currents in every])
    coefficients = (amplitudes @ reduced.output.T).reshape(*nodes, -1)
    knots = []
    for axis, values in enumerate(axes):
        spline = make_interp_spline(values, coefficients, k=3, axis=axis)
        coefficients = np.moveaxis(spline.c, 0, axis)
        knots.append(np.asarray(spline.t))
    margin = MARGIN * (upper - lower)
    ends = (lower - margin, upper + margin)
    return exponent, np.array([LARGEST_MISMATCH]), *ends, *knots, np.ascontiguousarray(coefficients)


def _nodes(lower: float, upper: float, count: int, power: float) -> Array:
    """Nodes from lower to upper, denser about zero where it lies between."""
    if power == 1.0 or not lower < 0.0 < upper:
        return np.linspace(lower, upper, count)
    shares = np.linspace(-1.0, 1.0, count)
    graded = np.abs(shares) ** power
    return np.where(shares < 0.0, lower * graded, upper * graded)


def _states(model: CurrentModel) -> Array:
    """Currents (300, 6) at random, a hundred of them nearly balanced."""
    lower, upper = model.model.lower, model.model.upper
    values = lower + np.random.default_rng(_SEED).random((_STATES + _BALANCED, 3)) * (upper - lower)
    values[_STATES:, 1:] *= 0.1
    u, x, y = np.clip(values, lower, upper).T
    return divide_currents(u, x, y, float(model.model.division_exponent[0]))


def _on_the_surface(data: MapData) -> tuple[Array, Array]:
    """The iron's fields (k, n, 3) and gradients (k, n, 9) at the nodes on the box's surface, where they are largest."""
    shape = data.grid.shape
    edges = [np.isin(np.arange(n), (0, n - 1)) for n in shape]
    chosen = np.array([any(pick) for pick in product(*edges)])
    coils, points = len(data.coil_names), len(chosen)
    flux = data.flux_density[coils:].reshape(-1, points, 3)[:, chosen]
    return flux, data.gradient[coils:].reshape(-1, points, 9)[:, chosen]


def _largest(weights: Array, fields: Array) -> float:
    """Largest norm over states and points of sum_k weights (s, k) fields (k, n, d)."""
    return max(float(np.linalg.norm(np.tensordot(row, fields, 1), axis=-1).max()) for row in weights)

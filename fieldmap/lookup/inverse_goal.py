"""The goal of an inverse at one place: a demand, the variables that may change, and what they give of the demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.least_power import least_power
from fieldmap.currents import CurrentParametrisation
from fieldmap.lookup.demand import Demand
from fieldmap.lookup.inverse_fields import FieldAtPoints
from fieldmap.typing import Array


@dataclass(eq=False)
class Variables:
    """Currents of coils (n,), A, or the signals (n,) of which a parametrisation makes the currents.

    low, high (n,): their limits. cost (n,): the power is sum(cost variables^2). noun, unit: for messages.
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    cost: Array
    made: CurrentParametrisation | None = None
    noun: str = "coil"
    unit: str = " A"

    def power(self, values: Array) -> float:
        """What values (n,) cost."""
        return float(self.cost @ values**2)

    def within(self, values: Array) -> Array:
        """The values (n,) within the limits that are nearest."""
        return np.clip(values, self.low, self.high)

    def nearest(self, currents: Array) -> Array:
        """Values (..., n) that make currents (..., n_coils), A, or nearly so."""
        return currents if self.made is None else self.made.nearest(currents).values

    def currents(self, values: Array) -> Array:
        """Currents (n_coils,), A, of values (n,)."""
        return values if self.made is None else np.ascontiguousarray(self.made.currents(values))

    def least_power(self, matrix: Array, wanted: Array) -> tuple[int, Array, NDArray[np.int64]]:
        """Status, values (n,) of least power with matrix (r, n) @ values = wanted (r,), and the limits that bind: see
        `fieldmap.core.least_power`."""
        found, active = np.empty(len(self.cost)), np.empty(len(self.cost), np.int64)
        return least_power(matrix, wanted, self.low, self.high, self.cost, found, active), found, active


@dataclass(eq=False)
class Goal:
    """A demand at a place. turn (3, 3): columns are the axes of the demand's body, if it has one."""

    demand: Demand
    field: FieldAtPoints
    turn: Array
    variables: Variables

    def __post_init__(self) -> None:
        self._last: tuple[bytes, tuple[Array, Array]] | None = None
        self._fields: Array | None = None

    def about(self, values: Array) -> tuple[Array, Array]:
        """What values (n,) of the variables give, (r,), and its derivatives (r, n); the last are cached."""
        key = values.tobytes()
        if self._last is None or self._last[0] != key:
            fields, weights, slopes = self.field(self.variables.currents(values))
            if fields is not self._fields:
                self._fields, self._rows = fields, self._rows_of(fields)
            given, by_weights = self._rows(weights)
            slope = by_weights @ slopes
            if self.variables.made is not None:
                slope = slope @ self.variables.made.derivative(values)
            self._last = key, (given, slope)
        return self._last[1]

    def _rows_of(self, fields: Array) -> Callable[[Array], tuple[Array, Array]]:
        """A function of the weights (k,) of fields (points, k, 12): what they give, (r,), and its derivatives (r, k) by
        the weights."""
        of, at = self.demand, fields[0].T
        if of.body is None:
            matrix = of.selection @ at
            return lambda weights: (matrix @ weights, matrix)
        flux, gradient = fields[1:, :, :3], fields[1:, :, 3:].reshape(-1, at.shape[1], 3, 3)
        load = of.body.by_fields(flux, gradient, self.turn)

        def on_body(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = load(weights)
            given = of.selection @ np.concatenate([wrench, at @ weights])
            return given, of.selection @ np.concatenate([slopes, at])

        return on_body

"""The inverse problem at one place: the field as a function of the currents, the variables, and the demand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.core.least_power import least_power
from fieldmap.currents import CurrentParametrisation
from fieldmap.errors import OutsideMapError
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.lookup.demand import Demand
from fieldmap.reaction import Reaction
from fieldmap.typing import Array

FieldAtPoints = Callable[[Array], tuple[Array, Array, Array]]
"""Function of currents (n,), A, that gives fields at the points (p, k, 12), flux density, T, and gradient row by row,
T/m; their weights (k,) at these currents; and the derivatives (k, n) of the weights by the currents, 1/A."""


@dataclass(eq=False)
class SumOfFields:
    """Fields of the coils times their currents, and further fields times weights that depend on the currents.

    each_field(points, flux, slope) fills flux density (p, fields, 3), T, and gradient (p, fields, 3, 3), T/m, at weight
    1. constant: one further field has always weight 1. iron: gives the weights of further fields of saturating iron.
    reaction: of the iron to magnets.
    """

    each_field: Callable[[Array, Array, Array], Any]
    coil_names: tuple[str, ...]
    constant: bool = False
    iron: CurrentModel | None = None
    reaction: Reaction | None = None

    met, saving = 1e-9, 1e-12
    """Shares of the demand and of the power at which a search ends."""

    def at(self, points: Array) -> FieldAtPoints:
        """The field at points (p, 3), m. Raises OutsideMapError."""
        coils = len(self.coil_names)
        if self.iron is None:
            weights, count = _weights_of_sum(coils, self.constant), coils + self.constant
        else:
            weights, count = self.iron.search().weights_and_slopes, coils + self.iron.fields_beside_coils
        flux, slope = np.empty((len(points), count, 3)), np.empty((len(points), count, 3, 3))
        self.each_field(points, flux, slope)
        if not all(map(math.isfinite, flux[:, 0, 0].tolist())):
            raise _outside(points, flux)
        fields = np.concatenate([flux, slope.reshape(-1, count, 9)], axis=2)
        return lambda currents: (fields, *weights(currents))


@cache
def _weights_of_sum(coils: int, constant: bool) -> Callable[[Array], tuple[Array, Array]]:
    """Function for the weights (the currents, and 1 for a constant field) and their derivatives by the currents."""
    unit, rest = np.eye(coils + constant, coils), np.eye(coils + 1)[coils, : coils + constant]
    return lambda currents: (unit @ currents + rest, unit)


def _outside(points: Array, flux: Array) -> OutsideMapError:
    outside = points[~np.isfinite(flux[:, 0, 0])][0]
    place = tuple(round(float(x) * 1e3, 6) for x in outside)
    must_hold = "a place in the map's box" if len(points) == 1 else "the whole body in the map's box"
    return OutsideMapError.of("currents_for, position", must_hold, f"{place} mm", "stay in the box")


@dataclass(eq=False)
class SolvedField:
    """A device with saturating iron, solved at each set of currents. by_currents: as `NonlinearSolver.by_currents`."""

    by_currents: Callable[[Array, Array], tuple[Array, Array, Array, Array]]
    coil_names: tuple[str, ...]
    reaction: Reaction | None = None

    # States are solved to about 1e-6.
    met, saving = 1e-5, 1e-5

    def at(self, points: Array) -> FieldAtPoints:
        """The field at points (p, 3), m."""

        def about(currents: Array) -> tuple[Array, Array, Array]:
            flux, slope, by_flux, by_slope = self.by_currents(points, currents)
            flux = np.concatenate([by_flux, flux[:, None]], axis=1)
            slope = np.concatenate([by_slope, slope[:, None]], axis=1)
            fields = np.concatenate([flux, slope.reshape(*flux.shape[:2], 9)], axis=2)
            # The field at these currents has weight 1. The weight of each derivative is the change of its current, 0.
            return fields, *_weights_of_sum(len(currents), True)(np.zeros(len(currents)))

        return about

    def linear_about(self, currents: Array) -> SumOfFields:
        """The field linearised about currents (n,), A: the fields of the coils per ampere, and the remainder."""

        def each_field(points: Array, flux: Array, slope: Array) -> None:
            here, gradient, flux[:, :-1], slope[:, :-1] = self.by_currents(points, currents)
            flux[:, -1] = here - currents @ flux[:, :-1]
            slope[:, -1] = gradient - np.tensordot(currents, slope[:, :-1], (0, 1))

        return SumOfFields(each_field, self.coil_names, constant=True, reaction=self.reaction)


@dataclass(eq=False)
class Variables:
    """Currents of coils (n,), A, or signals (n,) of a current parametrisation.

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
        """Power of values (n,)."""
        return float(self.cost @ values**2)

    def within(self, values: Array) -> Array:
        """The nearest values (n,) within the limits."""
        return np.clip(values, self.low, self.high)

    def nearest(self, currents: Array) -> Array:
        """Values (..., n) whose currents are nearest to currents (..., n_coils), A."""
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
    """A demand at a place. turn (3, 3): columns are the axes of the demand's body, if it has one. reacts: result of
    `reacting_at` for the body. evaluations: number of evaluations of the field at new values."""

    demand: Demand
    field: FieldAtPoints
    turn: Array
    variables: Variables
    reacts: tuple[int, Array, Array] | None = None

    def __post_init__(self) -> None:
        self._last: tuple[bytes, tuple[Array, Array]] | None = None
        self._fields: Array | None = None
        self._weights: Array | None = None
        self.evaluations = 0

    def about(self, values: Array) -> tuple[Array, Array]:
        """Components (r,) at values (n,) of the variables, and their derivatives (r, n). The last result is cached."""
        key = values.tobytes()
        if self._last is None or self._last[0] != key:
            self.evaluations += 1
            fields, weights, slopes = self.field(self.variables.currents(values))
            self._weights = weights
            if fields is not self._fields:
                self._fields, self._rows = fields, self._rows_of(fields)
            given, by_weights = self._rows(weights)
            slope = by_weights @ slopes
            if self.variables.made is not None:
                slope = slope @ self.variables.made.derivative(values)
            self._last = key, (given, slope)
        return self._last[1]

    def undirected(self) -> Array:
        """Components (r,) at the last values if flux density and gradient were parallel to the rows. They give a scale
        for a component that is only rounding, as on an axis of symmetry. Zero for force and torque on a body."""
        of, fields, weights = self.demand.selection[:, -12:], self._fields, self._weights
        if fields is None or weights is None:
            return np.zeros(len(self.demand.values))
        sizes = [
            np.abs(weights) @ np.linalg.norm(part, axis=1) for part in (fields[0, :, :3], fields[0, :, 3:])
        ]
        return np.linalg.norm(of[:, :3], axis=1) * sizes[0] + np.linalg.norm(of[:, 3:], axis=1) * sizes[1]

    def _rows_of(self, fields: Array) -> Callable[[Array], tuple[Array, Array]]:
        """A function of the weights (k,) of fields (points, k, 12) that gives the components (r,) and their derivatives
        (r, k) by the weights."""
        of, at = self.demand, fields[0].T
        if of.body is None:
            matrix = of.selection @ at
            return lambda weights: (matrix @ weights, matrix)
        flux, gradient = fields[1:, :, :3], fields[1:, :, 3:].reshape(-1, at.shape[1], 3, 3)
        load = of.body.by_fields(flux, gradient, self.turn, self.reacts)

        def on_body(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = load(weights)
            given = of.selection @ np.concatenate([wrench, at @ weights])
            return given, of.selection @ np.concatenate([slopes, at])

        return on_body

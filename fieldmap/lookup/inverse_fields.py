"""How a field at a few points follows the currents, for an inverse: as a sum of fields, or solved for them anew."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fieldmap.errors import OutsideMapError
from fieldmap.lookup.current_model import CurrentModel
from fieldmap.typing import Array

FieldAtPoints = Callable[[Array], tuple[Array, Array, Array]]
"""Of currents (n,), A: fields at the points (p, k, 12), flux density, T, and gradient row by row, T/m; their weights
(k,) in the field of these currents; and the derivatives (k, n) of the weights by the currents, 1/A."""


@dataclass(eq=False)
class SumOfFields:
    """Each coil's field times its current, and others times weights that follow the currents.

    each_field(points, flux, slope) fills flux density (p, fields, 3), T, and gradient (p, fields, 3, 3), T/m, at weight
    1. The others are one that no current drives, of weight 1 (constant), or those of the saturating iron.
    """

    each_field: Callable[[Array, Array, Array], Any]
    coil_names: tuple[str, ...]
    constant: bool = False
    iron: CurrentModel | None = None

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
    """The currents, and 1 for a constant field; and their derivatives by the currents."""
    unit, rest = np.eye(coils + constant, coils), np.eye(coils + 1)[coils, : coils + constant]
    return lambda currents: (unit @ currents + rest, unit)


def _outside(points: Array, flux: Array) -> OutsideMapError:
    outside = points[~np.isfinite(flux[:, 0, 0])][0]
    place = tuple(round(float(x) * 1e3, 6) for x in outside)
    must_hold = "a place in the map's box" if len(points) == 1 else "the whole body in the map's box"
    return OutsideMapError.of("currents_for, position", must_hold, f"{place} mm", "stay in the box")


@dataclass(eq=False)
class SolvedField:
    """A device whose saturating iron is solved for all currents anew; by_currents: as `NonlinearSolver.by_currents`."""

    by_currents: Callable[[Array, Array], tuple[Array, Array, Array, Array]]
    coil_names: tuple[str, ...]

    # States are solved to 1e-6 or so.
    met, saving = 1e-5, 1e-5

    def at(self, points: Array) -> FieldAtPoints:
        """The field at points (p, 3), m."""

        def about(currents: Array) -> tuple[Array, Array, Array]:
            flux, slope, by_flux, by_slope = self.by_currents(points, currents)
            flux = np.concatenate([by_flux, flux[:, None]], axis=1)
            slope = np.concatenate([by_slope, slope[:, None]], axis=1)
            fields = np.concatenate([flux, slope.reshape(*flux.shape[:2], 9)], axis=2)
            # The field of these currents has the weight 1, and each derivative that of a change of its current: 0.
            return fields, *_weights_of_sum(len(currents), True)(np.zeros(len(currents)))

        return about

    def linear_about(self, currents: Array) -> SumOfFields:
        """The field that is linear about currents (n,), A: of every coil at 1 A, then the rest."""

        def each_field(points: Array, flux: Array, slope: Array) -> None:
            here, gradient, flux[:, :-1], slope[:, :-1] = self.by_currents(points, currents)
            flux[:, -1] = here - currents @ flux[:, :-1]
            slope[:, -1] = gradient - np.tensordot(currents, slope[:, :-1], (0, 1))

        return SumOfFields(each_field, self.coil_names, constant=True)

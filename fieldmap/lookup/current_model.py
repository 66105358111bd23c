"""From currents to the weights of a map's fields, where the iron saturates: Newton's method on the reduced model."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.errors import NotConverged, OutsideMapError, Problem
from fieldmap.kernels.reduced_iron import newton
from fieldmap.store import ReducedModel

Array = NDArray[np.float64]
OUTSIDE_CURRENTS = ("raise", "nan", "evaluate")
# The last step is taken past this decrement, and converges quadratically: the amplitudes are good to rounding.
_TOLERANCE = 1e-6
_MOST_STEPS = 60
# Currents may lie outside the domain by this share of its range: rounding of what the user computed.
_MARGIN = 1e-9


class CurrentModel:
    """Weights of the fields of a map of saturating iron.

    outside: what currents beyond the map's domain give: "raise" (OutsideMapError), "nan", or "evaluate", which
    evaluates the model there without a statement of its error.
    """

    def __init__(self, model: ReducedModel, coil_names: tuple[str, ...], outside: str = "raise") -> None:
        self.model = model
        self._names = coil_names
        self._outside = outside
        self._range = model.upper - model.lower

    def weights(self, currents: Array) -> Array:
        """Weights (..., n_fields): the currents (..., c) in A, then those of the iron's fields.

        Equal currents give equal bits. Raises OutsideMapError for currents beyond the domain, if asked to, and
        NotConverged if Newton's method fails.
        """
        rows = currents.reshape(-1, currents.shape[-1])
        result = np.array([self._row(row) for row in rows]).reshape(*currents.shape[:-1], -1)
        return np.concatenate([currents, result], axis=-1)

    def amplitudes(self, currents: Array, start: Array | None = None) -> Array:
        """Amplitudes (r,) of the modes at currents (c,), from `start` (r,) or from the nearest known state."""
        model = self.model
        if start is None:
            away = ((model.known_currents - currents) / self._range) ** 2
            start = model.known_amplitudes[int(away.sum(axis=1).argmin())]
        arguments = (model.gradients, model.weights, model.law, *model.laws, model.air, model.constant)
        found, _, decrement = newton(model.source @ currents, *arguments, start, _TOLERANCE, _MOST_STEPS)
        if not decrement <= _TOLERANCE:
            raise NotConverged(
                Problem(
                    "reduced model of the iron",
                    f"Newton's method must reach {_TOLERANCE:g}",
                    f"{decrement:.1e} after {_MOST_STEPS} steps at {currents.tolist()} A",
                    "stay within the currents that the map was made for",
                ),
                residuals=(float(decrement),),
            )
        return np.asarray(found)

    def _row(self, currents: Array) -> Array:
        if not self._holds(currents):
            return np.full(self.model.field_count, np.nan)
        return np.asarray(self.model.output @ self.amplitudes(currents))

    def _holds(self, currents: Array) -> bool:
        if not np.isfinite(currents).all():
            return False
        margin = _MARGIN * self._range
        low, high = self.model.lower - margin, self.model.upper + margin
        beyond = np.flatnonzero((currents < low) | (currents > high))
        if self._outside == "evaluate" or not beyond.size:
            return True
        if self._outside == "nan":
            return False
        k = int(beyond[0])
        domain = f"{self.model.lower[k]:g} to {self.model.upper[k]:g} A"
        raise OutsideMapError(
            Problem(
                f"current of coil {self._names[k]}",
                f"must lie within what the map was made for, {domain}",
                f"{currents[k]:g} A",
                'make a map with a wider [currents], or open this one with outside_currents="evaluate"',
            )
        )

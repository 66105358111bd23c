"""From currents to the weights of a map's fields, where the iron saturates: Newton's method on the reduced model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fieldmap.currents import ROUNDING, TOLERANCE, IndependentCurrents
from fieldmap.errors import NotConverged, OutsideMapError, Problem
from fieldmap.kernels.map.continuation import continued
from fieldmap.kernels.map.matrix_vector import times
from fieldmap.kernels.map.reduced_iron import blended_start, newton, sensitivities
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

OUTSIDE_CURRENTS = ("raise", "nan", "evaluate")
# The last step is taken past this decrement: what is left is a few tenths of it. For lookups the larger one, still a
# thousandth of what such models are off; the other for searches that divide differences of the weights.
_TOLERANCE, _FOR_LOOKUPS = 1e-7, 1e-6
_MOST_STEPS = 60
# States behind that tell where the next one lies.
_PASSED = 3
# States whose tangents are kept at a time.
_AT_ONCE = 256
_REMEDY = 'make a map with a wider [currents], or open this one with outside_currents="evaluate"'


@dataclass(frozen=True, eq=False)
class _Path:
    """The last currents (k, c) with their amplitudes (k, r), newest last, and the factor of a tangent near the last."""

    currents: Array
    amplitudes: Array
    factor: Array

    def ahead(self, currents: Array) -> tuple[Array, Array]:
        """Amplitudes (r,) to begin with, where those passed lead to, and a factor (r, r)."""
        start, (weights, nodes) = np.empty(self.amplitudes.shape[1]), np.empty((2, len(self.currents)))
        continued(currents, self.currents, self.amplitudes, weights, nodes, start)
        return start, self.factor.copy()

    def further(self, currents: Array, amplitudes: Array, factor: Array) -> _Path:
        """With one state more."""
        kept = 1 - _PASSED
        return _Path(
            np.vstack((self.currents[kept:], currents)),
            np.vstack((self.amplitudes[kept:], amplitudes)),
            factor,
        )


class CurrentModel:
    """Weights of the fields of a map of saturating iron.

    outside: what currents beyond the map's domain give: "raise" (OutsideMapError), "nan", or "evaluate", which
    evaluates the model there without a statement of its error. follow: begin from the currents asked for before, which
    is quicker where they change little from call to call; the results then depend on earlier calls, by 1e-6 at most.
    """

    def __init__(
        self, model: ReducedModel, coil_names: tuple[str, ...], outside: str = "raise", follow: bool = False
    ) -> None:
        self.model = model
        self._follow = follow
        self._path: _Path | None = None
        self._names = coil_names
        self._outside = outside
        # Lengths by which currents are compared.
        self._range = np.maximum(np.ptp(model.known_currents, axis=0), 1e-12)
        # Copies that may be written to, as those of a pickled model: compiled for another kind of array, the kernels
        # would round otherwise.
        weights, law, offset, knots, coefficients = map(np.array, (model.weights, model.law, *model.laws))
        gradients, air = np.array(model.gradients), np.array(model.air)
        single = gradients.astype(np.float32)
        self._iron = (gradients, single, weights, law, offset, knots, coefficients, air)
        self._source, self._constant = np.array(model.source), np.array(model.constant)
        self._fixed = np.array(model.fixed) if model.fixed.size else None

    @property
    def fields_beside_coils(self) -> int:
        """How many fields a map has behind those of its coils: the iron's, and that of the background if any."""
        return self.model.field_count + (self._fixed is not None)

    def of_amplitudes(self, amplitudes: Array) -> Array:
        """Weights (..., f) of the fields behind the coils' for amplitudes (..., r): the iron's, then 1 for the
        background if there is any."""
        iron = amplitudes @ self.model.output.T
        if self._fixed is None:
            return iron
        return np.concatenate([iron, np.ones((*iron.shape[:-1], 1))], axis=-1)

    def of_state(self, amplitudes: Array) -> Array:
        """`of_amplitudes` of one state (r,)."""
        iron = np.asarray(self.model.output @ amplitudes)
        return iron if self._fixed is None else np.append(iron, 1.0)

    def weights(self, currents: Array) -> Array:
        """Weights (..., n_fields): the currents (..., c) in A, then those of the fields behind them.

        Equal currents give equal bits, unless the model follows. Raises OutsideMapError for currents beyond the
        domain, if asked to, and NotConverged if Newton's method fails.
        """
        rows = currents.reshape(-1, currents.shape[-1])
        result = np.array([self._row(row) for row in rows]).reshape(*currents.shape[:-1], -1)
        return np.concatenate([currents, result], axis=-1)

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (r,) of the modes at currents (c,), begun from what the known states predict."""
        return self._solve(currents, *self._predicted(currents), _TOLERANCE)

    def slopes(self, currents: Array, amplitudes: Array) -> Array:
        """Derivatives (s, f, c) of the weights of the fields behind the coils' by the currents, at currents (s, c) and
        their amplitudes (s, r)."""
        rows = max(len(currents) // _AT_ONCE, 1)
        parts = zip(np.array_split(currents, rows), np.array_split(amplitudes, rows), strict=True)
        slopes = np.concatenate([self._sensitivities(*part)[0] for part in parts])
        found = np.asarray(np.einsum("fr,src->sfc", self.model.output, slopes, optimize=True))
        if self._fixed is None:
            return found
        return np.concatenate([found, np.zeros((len(found), 1, found.shape[2]))], axis=1)

    def _predicted(self, currents: Array) -> tuple[Array, Array]:
        """Amplitudes (r,) to begin with, and the factor (r, r) of the tangent of the nearest known state."""
        slopes, factors = self._tangents
        known = self.model.known_currents
        start = blended_start(currents, known, self.model.known_amplitudes, slopes, self._range)
        nearest = (((currents - known) / self._range) ** 2).sum(axis=1).argmin()
        return start, factors[nearest].copy()

    def _solve(self, currents: Array, start: Array, factor: Array, tolerance: float) -> Array:
        """Amplitudes (r,), begun from `start`; factor, tolerance: see `fieldmap.kernels.map.reduced_iron.newton`."""
        found, _, decrement = newton(
            self._applied(currents),
            *self._iron,
            self._constant,
            start,
            factor,
            tolerance,
            _MOST_STEPS,
        )
        if not decrement <= tolerance:
            raise NotConverged(
                Problem(
                    "reduced model of the iron",
                    f"Newton's method must reach {tolerance:g}",
                    f"{decrement:.1e} after {_MOST_STEPS} steps at {currents.tolist()} A",
                    "stay within the currents that the map was made for",
                ),
                residuals=(float(decrement),),
            )
        return np.asarray(found)

    def _applied(self, currents: Array) -> Array:
        """Field (3 p,) of coils and background at the sample points, T."""
        own = times(self._source, currents)
        return own if self._fixed is None else own + self._fixed

    @cached_property
    def _tangents(self) -> tuple[Array, Array]:
        """Of the known states: derivatives (s, r, c) of the amplitudes by the currents, factors (s, r, r) of K."""
        return self._sensitivities(self.model.known_currents, self.model.known_amplitudes)

    def _sensitivities(self, currents: Array, amplitudes: Array) -> tuple[Array, Array]:
        sources = np.ascontiguousarray(self._source @ currents.T)
        if self._fixed is not None:
            sources += self._fixed[:, None]
        slopes, factors = sensitivities(sources, *self._iron, np.array(amplitudes), self._source)
        return slopes, factors

    def _row(self, currents: Array) -> Array:
        if not self._holds(currents):
            return np.full(self.fields_beside_coils, np.nan)
        if self._follow:
            return self.of_state(self._followed(currents))
        return self.of_state(self._solve(currents, *self._predicted(currents), _FOR_LOOKUPS))

    def _followed(self, currents: Array) -> Array:
        """The amplitudes, begun from the last ones."""
        path = self._path
        start, factor = self._predicted(currents) if path is None else path.ahead(currents)
        try:
            found = self._solve(currents, start, factor, _FOR_LOOKUPS)
        except NotConverged:
            start, factor = self._predicted(currents)
            found = self._solve(currents, start, factor, _FOR_LOOKUPS)
        # One assignment: another thread sees the old path or the new one, never a mixture.
        self._path = (
            _Path(currents[None].copy(), found[None], factor)
            if path is None
            else path.further(currents, found, factor)
        )
        return found

    def _holds(self, currents: Array) -> bool:
        if not np.isfinite(currents).all():
            return False
        if self._outside == "evaluate":
            return True
        problem = self._outside_domain(currents)
        if problem is not None and self._outside == "raise":
            raise OutsideMapError(problem)
        return problem is None

    def _outside_domain(self, currents: Array) -> Problem | None:
        domain = self.model.domain
        of, found = domain.parametrisation, domain.parametrisation.nearest(currents)
        if not found.mismatch <= TOLERANCE:
            parameters = ", ".join(f"{name} = {value}" for name, value in of.parameters.items())
            must_hold = f"must be of the parametrisation that the map was made for: {of.name}, {parameters}"
            return Problem("currents", must_hold, f"currents off it by {found.mismatch:.1e}", _REMEDY)
        k = domain.outside(found.values)
        if k is None:
            return self._over_the_limit(currents, of.excess(found.values))
        independent = isinstance(of, IndependentCurrents)
        where = (
            f"current of coil {self._names[k]}" if independent else f"currents, their {of.signal_names[k]}"
        )
        unit = f" {of.signal_units[k]}" if of.signal_units[k] != "1" else ""
        must_hold = (
            f"must lie within what the map was made for, {domain.lower[k]:g} to {domain.upper[k]:g}{unit}"
        )
        return Problem(where, must_hold, f"{found.values[k]:g}{unit}", _REMEDY)

    def _over_the_limit(self, currents: Array, excess: float) -> Problem | None:
        if excess <= ROUNDING:
            return None
        k = int(np.abs(currents).argmax())
        largest = float(np.abs(currents[k]))
        must_hold = f"must not exceed {largest / (1.0 + excess):g} A, up to which the map was made"
        return Problem(f"current of coil {self._names[k]}", must_hold, f"{largest:g} A", _REMEDY)

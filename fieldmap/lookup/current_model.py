"""From currents to the weights of a map's fields, where the iron saturates: Newton's method on the reduced model."""

from __future__ import annotations

import threading
from functools import cached_property, partial

import numpy as np

from fieldmap.core.iron import BEYOND, FOUND, NOT_CONVERGED, CoreIron, IronState
from fieldmap.core.iron_numbers import CompiledModel, core_numbers
from fieldmap.currents import ROUNDING, TOLERANCE, IndependentCurrents
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.lookup.current_solver import compiled_model, not_converged
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

OUTSIDE_CURRENTS = ("raise", "nan", "evaluate")
# What Newton's method may leave, of the state, in the norm of the energy: where results are tabulated or searched.
_TIGHT, _OF_SEARCH = 1e-8, 1e-10
# Of lookups from Python, which cost more by themselves than the step that this takes: two solves of the same currents,
# from other starts, then agree within 1e-6.
_OF_LOOKUPS = 5e-7
_REMEDY = 'make a map with a wider [currents], or open this one with outside_currents="evaluate"'


class CurrentSearch:
    """The model from point to point of a search: each solve begins from the last, wherever the currents lie, and is
    exact enough to meet a demand to 1e-9."""

    def __init__(self, state: IronState, field_count: int) -> None:
        self._state, self._count, self._fresh = state, field_count, True

    def weights_and_slopes(self, currents: Array) -> tuple[Array, Array]:
        """Weights (n_fields,) at currents (c,), and their derivatives (n_fields, c) by the currents, 1/A."""
        amperes, weights = np.array(currents, dtype=np.float64), np.empty(self._count)
        slopes = np.empty((self._count, len(currents)))
        # With slopes the state is found to a hundredth of the tolerance.
        tolerance = 100.0 * _OF_SEARCH
        status = self._state.solve(amperes, weights, slopes, tolerance=tolerance, fresh=self._fresh)
        self._fresh = False
        if status != FOUND:
            raise not_converged(currents, self._state.left)
        return weights, slopes


class CurrentModel:
    """Weights of the fields of a map of saturating iron.

    outside: what currents beyond the map's domain give: "raise" (OutsideMapError), "nan", or "evaluate", which
    evaluates the model there without a statement of its error. follow: begin from the currents asked for before, which
    is quicker where they change little from call to call; the results then depend on earlier calls, by 1e-6 at
    most, and each thread follows its own.
    """

    def __init__(
        self, model: ReducedModel, coil_names: tuple[str, ...], outside: str = "raise", follow: bool = False
    ) -> None:
        self.model = model
        self._follow = follow
        self._names = coil_names
        self._outside = outside
        self._own = threading.local()

    @cached_property
    def compiled(self) -> CompiledModel:
        """What solves take; made when it is first asked for, in a second or less.

        Currents outside the domain get no weights there, unless the model evaluates them. Raises NotConverged.
        """
        return compiled_model(self.model, checked=self._outside != "evaluate")

    @property
    def fields_beside_coils(self) -> int:
        """How many fields a map has behind those of its coils: the iron's, and that of the background if any."""
        return self.model.field_count + (self.model.fixed.size > 0)

    def of_amplitudes(self, amplitudes: Array) -> Array:
        """Weights (..., f) of the fields behind the coils' for amplitudes (..., r): the iron's, then 1 for the
        background if there is any."""
        iron = amplitudes @ self.model.output.T
        if not self.model.fixed.size:
            return iron
        return np.concatenate([iron, np.ones((*iron.shape[:-1], 1))], axis=-1)

    def weights(self, currents: Array) -> Array:
        """Weights (..., n_fields): the currents (..., c) in A, then those of the fields behind them.

        Equal currents give equal bits, unless the model follows. Raises OutsideMapError for currents beyond the
        domain, if asked to, and NotConverged if Newton's method fails.
        """
        rows = currents.reshape(-1, currents.shape[-1])
        result = np.empty((len(rows), rows.shape[1] + self.fields_beside_coils))
        for row, out in zip(np.array(rows, order="C"), result, strict=True):
            self._solve(row, out)
        return result.reshape(*currents.shape[:-1], -1)

    def weights_and_slopes(self, currents: Array) -> tuple[Array, Array]:
        """`weights` of one set of currents (c,), and their derivatives (n_fields, c) by the currents, 1/A."""
        weights = np.empty(len(currents) + self.fields_beside_coils)
        slopes = np.empty((len(weights), len(currents)))
        self._solve(np.array(currents), weights, slopes)
        return weights, slopes

    def search(self) -> CurrentSearch:
        """Weights and slopes for a search from currents to currents; the one before it in this thread ends."""
        return CurrentSearch(self._state("search"), self.model.coil_count + self.fields_beside_coils)

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (r,) of the modes at currents (c,), wherever they lie, more exactly than for a lookup."""
        state, amperes = self._state("tight"), np.array(currents, dtype=np.float64)
        weights = np.empty(len(amperes) + self.fields_beside_coils)
        if state.solve(amperes, weights, tolerance=_TIGHT, fresh=True) != FOUND:
            raise not_converged(currents, state.left)
        return state.amplitudes

    def slopes(self, currents: Array) -> Array:
        """Derivatives (s, f, c) of the weights of the fields behind the coils' by the currents, at currents (s, c),
        wherever they lie."""
        rows, coils = np.array(currents, dtype=np.float64, order="C"), currents.shape[1]
        state, weights = self._state("tight"), np.empty(coils + self.fields_beside_coils)
        slopes = np.empty((len(rows), len(weights), coils))
        for row, out in zip(rows, slopes, strict=True):
            # The state is found to a hundredth of the tolerance.
            if state.solve(row, weights, out, tolerance=100.0 * _TIGHT, fresh=True) != FOUND:
                raise not_converged(row, state.left)
        return slopes[:, coils:]

    @cached_property
    def _core(self) -> CoreIron:
        return CoreIron(core_numbers(self.compiled))

    def state_of_caller(self) -> IronState:
        """What the solves of one compiled caller remember, nothing yet. Raises NotConverged as `compiled`."""
        return self._core.state()

    def _state(self, name: str) -> IronState:
        """What solves of this name remember in this thread."""
        known = self._own.__dict__
        if name not in known:
            known[name] = self._core.state()
        state: IronState = known[name]
        return state

    def _solve(self, currents: Array, weights: Array, slopes: Array | None = None) -> None:
        """Fill weights and slopes at currents (c,); raise, or leave NaN, where they lie outside."""
        state, fresh = self._state("lookups"), not self._follow
        solve = partial(state.solve, currents, weights, slopes)
        checked = self._outside != "evaluate"
        status = solve(tolerance=_OF_LOOKUPS, checked=checked, fresh=fresh)
        if status == NOT_CONVERGED and self._follow:
            status = solve(tolerance=_OF_LOOKUPS, checked=checked)
        if status == BEYOND and self._outside == "raise":
            problem = self._outside_domain(currents)
            if problem is not None:
                raise OutsideMapError(problem)
            # Beyond the margin of one rule and within that of the other, which counts.
            status = solve(tolerance=_TIGHT)
        if status == NOT_CONVERGED:
            raise not_converged(currents, state.left)
        if status != FOUND:
            weights[: len(currents)] = currents

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_own"}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._own = threading.local()

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
            f"must lie within the currents of the map, {domain.lower[k]:g} to {domain.upper[k]:g}{unit}"
        )
        return Problem(where, must_hold, f"{found.values[k]:g}{unit}", _REMEDY)

    def _over_the_limit(self, currents: Array, excess: float) -> Problem | None:
        if excess <= ROUNDING:
            return None
        k = int(np.abs(currents).argmax())
        largest = float(np.abs(currents[k]))
        must_hold = f"must not exceed {largest / (1.0 + excess):g} A, up to which the map was made"
        return Problem(f"current of coil {self._names[k]}", must_hold, f"{largest:g} A", _REMEDY)

"""From currents to the weights of a map's fields, where the iron saturates: Newton's method on the reduced model."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import cached_property

import numpy as np

from fieldmap.currents import ROUNDING, TOLERANCE, IndependentCurrents
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.kernels.map import current_solver as kernels
from fieldmap.kernels.map.current_solver import CompiledModel, SolverState
from fieldmap.kernels.map.reduced_iron import sensitivities
from fieldmap.lookup.current_solver import compiled_model, new_state, not_converged
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

OUTSIDE_CURRENTS = ("raise", "nan", "evaluate")
# What Newton's method may leave, of the state, in the norm of the energy: where results are tabulated or searched.
_TIGHT, _OF_SEARCH = 1e-8, 1e-10
# Of lookups from Python, which cost more by themselves than the step that this takes: two solves of the same currents,
# from other starts, then agree within 1e-6.
_OF_LOOKUPS = 5e-7
# States whose tangents are kept at a time.
_AT_ONCE = 256
_REMEDY = 'make a map with a wider [currents], or open this one with outside_currents="evaluate"'


def _fill_weights(model: CompiledModel, state: SolverState, currents: Array, out: Array) -> int:
    """As `kernels.current_weights`, which programs that never call it from compiled code need not compile."""
    status: int = kernels.solve(model, state, currents, model.tolerance)
    out[:] = state.weights if status == kernels.FOUND else np.nan
    return status


class CurrentSearch:
    """The model from point to point of a search: each solve begins from the last, wherever the currents lie, and is
    exact enough to meet a demand to 1e-9."""

    def __init__(self, model: CompiledModel, state: SolverState) -> None:
        domain = model.domain._replace(checked=False)
        self._model = model._replace(tolerance=_OF_SEARCH, domain=domain)
        # `current_slopes` solves to a hundredth of its tolerance: as exactly, then.
        self._of_slopes = self._model._replace(tolerance=100.0 * _OF_SEARCH)
        self._state = state
        state.numbers[kernels.COUNT] = 0.0

    def weights(self, currents: Array) -> Array:
        """Weights (n_fields,) at currents (c,)."""
        weights = np.empty(len(self._state.weights))
        self._check(_fill_weights(self._model, self._state, currents, weights), currents)
        return weights

    def slopes(self, currents: Array) -> Array:
        """Their derivatives (n_fields, c) by the currents, 1/A."""
        weights = np.empty(len(self._state.weights))
        slopes = np.empty((len(weights), len(currents)))
        status = kernels.current_slopes(self._of_slopes, self._state, currents, weights, slopes)
        self._check(status, currents)
        return slopes

    def _check(self, status: int, currents: Array) -> None:
        if status != kernels.FOUND:
            raise not_converged(currents, self._state.numbers[kernels.LEFT])


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
        # Copies that may be written to, as those of a pickled model: compiled for another kind of array, the kernels
        # would round otherwise.
        weights, law, offset, knots, coefficients = map(np.array, (model.weights, model.law, *model.laws))
        gradients, air = np.array(model.gradients), np.array(model.air)
        single = gradients.astype(np.float32)
        self._iron = (gradients, single, weights, law, offset, knots, coefficients, air)
        self._source = np.array(model.source)
        self._fixed = np.array(model.fixed) if model.fixed.size else None
        self._own = threading.local()
        self._last_slopes: tuple[bytes, Array] = (b"", np.empty(0))

    @cached_property
    def compiled(self) -> CompiledModel:
        """What `fieldmap.kernels.map.current_solver` takes; made when it is first asked for, in a second or less.

        Currents outside the domain get no weights there, unless the model evaluates them. Raises NotConverged.
        """
        return compiled_model(self.model, checked=self._outside != "evaluate")

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
        result = np.empty((len(rows), rows.shape[1] + self.fields_beside_coils))
        for row, out in zip(np.array(rows, order="C"), result, strict=True):
            self._fill(row, out)
        return result.reshape(*currents.shape[:-1], -1)

    def weights_and_slopes(self, currents: Array) -> tuple[Array, Array]:
        """`weights` of one set of currents (c,), and their derivatives (n_fields, c) by the currents, 1/A."""
        weights = np.empty(len(currents) + self.fields_beside_coils)
        slopes = np.empty((len(weights), len(currents)))
        self._solved(kernels.current_slopes, np.array(currents), weights, slopes)
        return weights, slopes

    def search(self) -> CurrentSearch:
        """Weights and slopes for a search from currents to currents; the one before it in this thread ends."""
        return CurrentSearch(self.compiled, self._state("search"))

    def slopes_at(self, currents: Array) -> Array:
        """The slopes of a search at currents (c,): (n_fields, c). The last ones are cached."""
        key = currents.tobytes()
        known, slopes = self._last_slopes
        if known != key:
            slopes = self.search().slopes(currents)
            self._last_slopes = (key, slopes)
        return slopes

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (r,) of the modes at currents (c,), wherever they lie, more exactly than for a lookup."""
        state = self._state("tight")
        state.numbers[kernels.COUNT] = 0.0
        status = kernels.solve(self._tight, state, np.array(currents, dtype=np.float64), _TIGHT)
        if status != kernels.FOUND:
            raise not_converged(currents, state.numbers[kernels.LEFT])
        return state.amplitudes[-1].copy()

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

    @cached_property
    def _of_lookups(self) -> CompiledModel:
        return self.compiled._replace(tolerance=_OF_LOOKUPS)

    @cached_property
    def _tight(self) -> CompiledModel:
        domain = self.compiled.domain._replace(checked=False)
        return self.compiled._replace(tolerance=_TIGHT, domain=domain)

    def _state(self, name: str) -> SolverState:
        """What solves of this name remember in this thread."""
        known = self._own.__dict__
        if name not in known:
            known[name] = new_state(self.compiled)
        state: SolverState = known[name]
        return state

    def _sensitivities(self, currents: Array, amplitudes: Array) -> tuple[Array, Array]:
        sources = np.ascontiguousarray(self._source @ currents.T)
        if self._fixed is not None:
            sources += self._fixed[:, None]
        slopes, factors = sensitivities(sources, *self._iron, np.array(amplitudes), self._source)
        return slopes, factors

    def _fill(self, currents: Array, out: Array) -> None:
        self._solved(_fill_weights, currents, out)

    def _solved(self, kernel: Callable[..., int], currents: Array, *results: Array) -> None:
        """Let the kernel fill the results at currents (c,); raise, or leave NaN, where they lie outside."""
        state = self._state("lookups")
        if not self._follow:
            state.numbers[kernels.COUNT] = 0.0
        status = kernel(self._of_lookups, state, currents, *results)
        if status == kernels.NOT_CONVERGED and self._follow:
            status = kernel(self._of_lookups, state, currents, *results)
        if status == kernels.BEYOND and self._outside == "raise":
            problem = self._outside_domain(currents)
            if problem is not None:
                raise OutsideMapError(problem)
            # Beyond the margin of one rule and within that of the other, which counts.
            status = kernel(self._tight, state, currents, *results)
        if status == kernels.NOT_CONVERGED:
            raise not_converged(currents, state.numbers[kernels.LEFT])
        if status != kernels.FOUND:
            results[0][: len(currents)] = currents

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

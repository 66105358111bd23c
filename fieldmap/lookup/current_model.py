"""Weights of the fields of a map of saturating iron at given currents: Newton's method on the reduced model."""

from __future__ import annotations

import threading
from copy import copy
from functools import cached_property, partial

import numpy as np

from fieldmap.arguments import check
from fieldmap.constants import MU0
from fieldmap.core.iron import BEYOND, FOUND, NOT_CONVERGED, CoreIron, IronState, heat_of, last_currents
from fieldmap.core.iron_numbers import CompiledModel, core_numbers
from fieldmap.currents import ROUNDING, TOLERANCE, IndependentCurrents
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.lookup.current_solver import compiled_model, not_converged
from fieldmap.store import ReducedModel
from fieldmap.typing import Array

OUTSIDE_CURRENTS = ("raise", "nan", "evaluate")
STEP_TOLERANCE = 1e-7
"""Tolerance of the steps of iron with hysteresis, whose errors can add up: each begins where the last one ended."""
# Tolerances of Newton's method: the error of the state in the energy norm, as a share. `_TIGHT` is for tables,
# `_OF_SEARCH` for searches over currents.
_TIGHT, _OF_SEARCH = 1e-8, 1e-10
# Tolerance of lookups from Python. With it two solves of the same currents that begin at different states agree within
# 1e-6. The extra step of Newton's method costs less than the call itself.
_OF_LOOKUPS = 5e-7
# Tolerance of steps to the ends of small loops, whose states differ little.
_OF_LOOPS = 1e-10
# Tolerance of flux linkages, whose error is of first order in the error of the state.
_OF_LINKAGES = 1e-10
# Size of a loop, as a share of the largest currents, that moves all play cells away from the ends of their play.
_FREEING = 1e-5
_REMEDY = 'make a map with a wider [currents], or open this one with outside_currents="evaluate"'


class CurrentSearch:
    """The model in a search over currents.

    Each solve begins at the state of the previous one. Currents outside the domain are allowed. The tolerance is small
    enough for a search that must meet its demand within 1e-9.
    """

    def __init__(self, state: IronState, field_count: int, fresh: bool) -> None:
        self._state, self._count, self._fresh = state, field_count, fresh

    def weights_and_slopes(self, currents: Array) -> tuple[Array, Array]:
        """Weights (n_fields,) at currents (c,), and their derivatives (n_fields, c) by the currents, 1/A."""
        amperes, weights = np.array(currents, dtype=np.float64), np.empty(self._count)
        slopes = np.empty((self._count, len(currents)))
        # A solve with slopes finds the state to a hundredth of the tolerance.
        tolerance = 100.0 * _OF_SEARCH
        status = self._state.solve(amperes, weights, slopes, tolerance=tolerance, fresh=self._fresh)
        self._fresh = False
        if status != FOUND:
            raise not_converged(currents, self._state.left)
        return weights, slopes


class CurrentModel:
    """Weights of the fields of a map of saturating iron.

    Parameters
    ----------
    model
        The reduced model of the map.
    coil_names
        For messages.
    outside
        Rule for currents outside the domain: "raise" (OutsideMapError), "nan", or "evaluate", which evaluates
        the model there without a statement of its error.
    follow
        Begin each solve at the state of the previous call. This is quicker if currents change little from
        call to call. Results then depend on earlier calls, by 1e-6 at most. Each thread has a state of its
        own.

    Attributes
    ----------
    remembered : memory of iron with hysteresis (`IronState.remembered`), from which every solve begins; empty for other
        iron. `along` makes the first memory.
    """

    def __init__(
        self, model: ReducedModel, coil_names: tuple[str, ...], outside: str = "raise", follow: bool = False
    ) -> None:
        self.model = model
        self.remembered = np.zeros(0)
        self._follow = follow
        self._names = coil_names
        self._outside = outside
        self._own = threading.local()

    @cached_property
    def compiled(self) -> CompiledModel:
        """The model as arrays for the C core. It is made at the first call, in a second or less.

        The core refuses currents outside the domain unless `outside` is "evaluate". Raises NotConverged.
        """
        return compiled_model(self.model, checked=self._outside != "evaluate")

    @property
    def fields_beside_coils(self) -> int:
        """Number of fields that follow those of the coils: those of the iron, and the background if any."""
        return self.model.field_count + (self.model.fixed.size > 0)

    def of_amplitudes(self, amplitudes: Array) -> Array:
        """Weights (..., f) of the fields that follow those of the coils, for amplitudes (..., r) of the modes.

        The weights of the iron come first, then 1 for the background if there is one.
        """
        iron = amplitudes @ self.model.output.T
        if not self.model.fixed.size:
            return iron
        return np.concatenate([iron, np.ones((*iron.shape[:-1], 1))], axis=-1)

    def weights(self, currents: Array) -> Array:
        """Weights of all fields at currents.

        Equal currents give equal bits, unless `follow` is set.

        Parameters
        ----------
        currents
            (..., c), A.

        Returns
        -------
        Array
            (..., n_fields): the currents themselves, then the weights of the fields of the iron and the
            background.

        Raises
        ------
        OutsideMapError
            For currents outside the domain, if `outside` is "raise".
        NotConverged
            If Newton's method fails.
        """
        rows = currents.reshape(-1, currents.shape[-1])
        result = np.empty((len(rows), rows.shape[1] + self.fields_beside_coils))
        for row, out in zip(np.array(rows, order="C"), result, strict=True):
            self._solve(row, out)
        return result.reshape(*currents.shape[:-1], -1)

    def weights_and_slopes(self, currents: Array, loop: float | None = None) -> tuple[Array, Array]:
        """`weights` of one set of currents (c,), and their slopes (n_fields, c) by the currents, 1/A.

        Slopes are derivatives; at the currents of the memory they are slopes of infinitesimal loops. With `loop` (A)
        they are slopes of loops of this size: see `FieldMap.by_currents`.
        """
        weights = np.empty(len(currents) + self.fields_beside_coils)
        slopes = np.empty((len(weights), len(currents)))
        of = self
        if self.model.remembers and np.array_equal(currents, self.last_currents):
            of = self._freed()
        of._solve(np.array(currents), weights, slopes)
        if loop is None:
            return weights, slopes
        swings, secants = self._swings(currents, loop), []
        for swing in swings.T:
            plus = self.after_loop(currents, swing)
            minus = plus.along((currents - swing)[None], _OF_LOOPS)
            secants.append(0.5 * (plus.weights(currents + swing) - minus.weights(currents - swing)))
        return weights, with_secants(slopes, np.transpose(secants), swings)

    def after_loop(self, currents: Array, swing: Array) -> CurrentModel:
        """The same iron in the middle of the second of two loops, at currents (c,) plus `swing` (c,), inside the domain
        or outside. Raises NotConverged."""
        if not self.model.remembers:
            return self
        return self.along(currents + np.outer([0.0, 1.0, -1.0, 1.0], swing), _OF_LOOPS)

    def _swings(self, currents: Array, loop: float) -> Array:
        """Changes (c, d) of the currents by each signal. The largest change of a current is `loop`."""
        of = self.model.parametrisation
        slopes = of.derivative(of.nearest(currents).values)
        most = np.abs(slopes).max(axis=0)
        return np.asarray(slopes * np.divide(loop, most, out=np.zeros_like(most), where=most > 0.0))

    def _freed(self) -> CurrentModel:
        """This iron after a loop so small that it only moves cells away from the ends of their play. Otherwise rounding
        decides which of the cells at an end move."""
        swing = _FREEING * self.model.domain.largest
        return self.along(self.last_currents + np.outer([1.0, -1.0, 0.0], swing), _OF_LOOPS)

    def linkages(
        self, currents: Array, inductance: bool = False, *, checked: bool = True
    ) -> tuple[Array, Array]:
        """The iron's part of the flux linkages (c,), Wb, at currents (c,), and of their derivatives (c, c) by the
        currents, H, symmetric, which are zero without `inductance`: docs/theory/flux_linkage.md (3), (4).

        Raises OutsideMapError for currents beyond the domain unless `outside` is "evaluate" or `checked` is false, and
        NotConverged.
        """
        free = not checked or self._outside == "evaluate"
        if not free and (problem := self._outside_domain(currents)) is not None:
            raise OutsideMapError(problem)
        (state, fresh), coils = self._beginning("tight"), len(currents)
        added, slopes = np.empty(coils), np.zeros((coils, coils))
        amperes, of_slopes = np.array(currents, dtype=np.float64), slopes if inductance else None
        if state.linkages(amperes, added, of_slopes, tolerance=_OF_LINKAGES, fresh=fresh) != FOUND:
            raise not_converged(currents, state.left)
        return added / MU0, 0.5 * (slopes + slopes.T) / MU0

    def search(self) -> CurrentSearch:
        """A new search. It ends an earlier search in this thread: both use the same memory."""
        state, fresh = self._beginning("search")
        return CurrentSearch(state, self.model.coil_count + self.fields_beside_coils, fresh)

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (r,) of the modes at currents (c,), inside the domain or outside, to the tolerance of tables."""
        (state, fresh), amperes = self._beginning("tight"), np.array(currents, dtype=np.float64)
        weights = np.empty(len(amperes) + self.fields_beside_coils)
        if state.solve(amperes, weights, tolerance=_TIGHT, fresh=fresh) != FOUND:
            raise not_converged(currents, state.left)
        return state.amplitudes

    def slopes(self, currents: Array) -> Array:
        """Derivatives (s, f, c), 1/A, of the weights of the fields that follow those of the coils, at currents (s, c),
        inside the domain or outside."""
        rows, coils = np.array(currents, dtype=np.float64, order="C"), currents.shape[1]
        weights = np.empty(coils + self.fields_beside_coils)
        slopes = np.empty((len(rows), len(weights), coils))
        for row, out in zip(rows, slopes, strict=True):
            state, fresh = self._beginning("tight")
            # A solve with slopes finds the state to a hundredth of the tolerance.
            if state.solve(row, weights, out, tolerance=100.0 * _TIGHT, fresh=fresh) != FOUND:
                raise not_converged(row, state.left)
        return slopes[:, coils:]

    @cached_property
    def _core(self) -> CoreIron:
        return CoreIron(core_numbers(self.compiled))

    def state_of_caller(self) -> IronState:
        """A new state for the solves of one compiled caller. Raises NotConverged as `compiled` does."""
        return self._new_state()

    def stepped(self, currents: Array) -> CurrentModel:
        """The same iron after a straight path to currents (c,). Raises OutsideMapError for currents beyond the domain
        unless `outside` is "evaluate", and NotConverged."""
        if self._outside != "evaluate" and (problem := self._outside_domain(currents)) is not None:
            raise OutsideMapError(problem)
        return self.along(currents[None])

    def along(self, path: Array, tolerance: float = STEP_TOLERANCE) -> CurrentModel:
        """The same iron after straight steps to currents (n, c), inside the domain or outside. Raises NotConverged."""
        state, weights = self._new_state(), np.empty(self.model.coil_count + self.fields_beside_coils)
        for row in np.array(path, dtype=np.float64, order="C"):
            if state.step(row, weights, tolerance=tolerance) != FOUND:
                raise not_converged(row, state.left)
        return self.remembering(state.remembered)

    def remembering(self, remembered: Array) -> CurrentModel:
        """The same iron with another memory, numbers as `remembered`."""
        # A copy has no states of its own yet: see __setstate__.
        other = copy(self)
        other.remembered = remembered
        return other

    @property
    def last_currents(self) -> Array:
        """Currents (c,), A, to which the last step went; zero for iron that was never magnetised."""
        return last_currents(self.remembered, self.model.coil_count)

    @property
    def dissipated(self) -> float:
        """Heat dissipated in the iron on its path since it was demagnetised, J."""
        return heat_of(self.remembered) / MU0

    def _state(self, name: str) -> IronState:
        """The state in which solves of this name begin and end, one for each thread."""
        known = self._own.__dict__
        if name not in known:
            known[name] = self._new_state()
        state: IronState = known[name]
        return state

    def _new_state(self) -> IronState:
        state = self._core.state()
        if self.remembered.size:
            state.recall(self.remembered)
        return state

    def _beginning(self, name: str) -> tuple[IronState, bool]:
        """The state of this name, and whether a solve must begin afresh. Iron with hysteresis begins at its memory."""
        state = self._state(name)
        if self.model.remembers:
            state.recall(self.remembered)
        return state, not self.model.remembers

    def _solve(self, currents: Array, weights: Array, slopes: Array | None = None) -> None:
        """Fill weights and slopes at currents (c,). For currents outside the domain follow the rule `outside`."""
        state, fresh = (self._state("lookups"), False) if self._follow else self._beginning("lookups")
        solve = partial(state.solve, currents, weights, slopes)
        checked = self._outside != "evaluate"
        status = solve(tolerance=_OF_LOOKUPS, checked=checked, fresh=fresh)
        if status == NOT_CONVERGED and self._follow:
            status = solve(tolerance=_OF_LOOKUPS, checked=checked)
        if status == BEYOND and self._outside == "raise":
            problem = self._outside_domain(currents)
            if problem is not None:
                raise OutsideMapError(problem)
            # The C core and `CurrentDomain` allow different rounding. The core finds these currents outside and
            # `CurrentDomain`, which decides, finds them inside.
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


def with_secants(slopes: Array, secants: Array, swings: Array) -> Array:
    """Slopes (n, c) by currents, corrected so that changes `swings` (c, d) of the currents give `secants` (n, d).
    Slopes orthogonal to the swings do not change."""
    return np.asarray(slopes + (secants - slopes @ swings) @ np.linalg.pinv(swings))


def require_no_memory(remembers: bool, where: str) -> None:
    """Raise InputError for iron with hysteresis, whose memory would be lost. where: function and argument."""
    must_hold, received = "a map whose field the present currents tell", "one of iron with hysteresis"
    remedy = "use it at fixed currents, with the memory that it has: field.at(currents)"
    check(not remembers, where, must_hold, received, remedy)

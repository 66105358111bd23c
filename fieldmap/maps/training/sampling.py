"""Choice of the sample points: the law at few points gives the same states as the law at all points.

The points must be accurate at states that took no part in their choice. Such states are solved with the law at all
points, at extremes of the domain and at random currents; this takes a thousandth of the time of a state of the whole
iron. States with too large an error become conditions of the next choice, and others are drawn to replace them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.reduced import Conditions, GalerkinModel, Weights
from fieldmap.maps.training.cubature import Cubature, OfPoints, candidates
from fieldmap.maps.training.currents import drawn
from fieldmap.maps.training.model_error import Off
from fieldmap.maps.training.modes import solved, solved_from
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.typing import Array

# Candidate points in the first round: number per mode, least number, and most per point that may be chosen.
_CANDIDATES_PER_MODE, _FEWEST_CANDIDATES, _CANDIDATES_PER_POINT = 50, 1000, 4
# Most candidates in the last round: three matrices of their products take a gigabyte each.
_MOST_CANDIDATES = 12_000
# Weight of the energy of the error relative to its field in the workspace. Without the energy, points are chosen that
# reproduce the fields of the known states only.
_ENERGY = 0.3
# Weights of the errors of flux linkages and, if they are wanted, of inductances.
_LINKAGE, _INDUCTANCE = 0.3, 1.0
# Number of random projections that estimate the size of a point's contribution.
_PROJECTIONS = 8
# Number of states whose tangents are conditions: those whose iron is magnetised most differently.
_TANGENTS = 3
# Allowed change of the field as a multiple of the accuracy: of the states of the fit, root mean square, and of a tested
# state. If only a tested state exceeds its own, the first is multiplied by `_FINER`, down to `_FINEST`.
_FITTED, _TRIED, _FINER, _FINEST = 0.4, 0.5, 0.7, 0.05
# Tested states: extremes in the first round, random states in each round; most that become conditions in a round.
_EXTREMES, _RANDOM, _WORST, _SEED = 64, 96, 24, 20263
# Most known states in the first choice. If symmetry makes more of them, as many are drawn at random.
_MOST_STATES = 200
# Tolerance of states with the law at all points, as a share of the accuracy.
_EXACT = 0.02
ROUNDS = 12
"""Most rounds of the choice of sample points."""
OF_STATES = 0.1
"""Share of the time for the sample points that is spent on the residuals of the known states."""
# Time left when a choice begins, as a share of that when the step before it began.
_EACH = 0.6


@dataclass(frozen=True, eq=False, repr=False)
class Sampled(Record):
    """A model with the law at sample points.

    Attributes
    ----------
    model : the model.
    changed : largest relative change of the field of a tested state. Tested states took no part in the choice.
    tried : number of tested states.
    enough : whether `changed` is as small as allowed.
    """

    model: GalerkinModel
    changed: float
    tried: int
    enough: bool


def candidates_at_first(modes: int, most: int) -> int:
    """Number of points among which the first choice is made, of a model with so many modes and points at most."""
    return max(_FEWEST_CANDIDATES, min(_CANDIDATES_PER_MODE * modes, _CANDIDATES_PER_POINT * most))


def sampled(
    full: GalerkinModel,
    known: tuple[Array, Array],
    extremes: Array,
    domain: CurrentDomain,
    fields: Array,
    off: Off,
    accuracy: float,
    most: int,
    tell: Callable[[str, float], None] = lambda message, share: None,
    rounds: int = ROUNDS,
    inductance: bool = False,
) -> Sampled:
    """Choose sample points of the law, and their weights.

    Parameters
    ----------
    full
        The model with the law at all points.
    known
        Currents (s, c) and amplitudes (s, r) of the states to fit.
    extremes
        (m, c), currents that are tested first.
    domain
        Of the currents.
    fields
        (r, k), one row per mode; the Euclidean norm of amplitudes @ fields measures the size of a field.
    off
        off(currents (s, c), amplitudes (s, r), changes (s, r)) gives the relative change (s,) of the field
        that changes of the amplitudes make.
    accuracy
        Relative, of the field.
    most
        Most points; it is doubled if the points are not accurate enough.
    tell
        tell(message, share) reports progress, with the share that is done.
    rounds
        Most choices.
    inductance
        Whether the errors of inductances count.
    """
    choice = _Choice(full, known, fields, most, tell, inductance)
    tried = _Tried(full, known, domain, off, _EXACT * accuracy)
    tolerance, looked_at = _FITTED, 0
    fresh = extremes[:_EXTREMES]
    least: tuple[float, GalerkinModel] = np.inf, full
    for number in range(rounds):
        tell(f"sample points, choice {number + 1}", 1.0 - (1.0 - OF_STATES) * _EACH ** (number + 1))
        model, left = choice.model(tolerance * accuracy)
        looked_at += tried.draw(model, np.concatenate([fresh, tried.random(_RANDOM)]))
        changed = tried.changed(model)
        worst = float(changed.max(initial=0.0))
        if worst < least[0]:
            least = worst, model
        if worst <= _TRIED * accuracy:
            return Sampled(model, worst, looked_at, True)
        if number == rounds - 1:
            break
        choice.add(*tried.take(changed, _TRIED * accuracy, _WORST))
        fresh = extremes[:0]
        if left > 1.0:
            if not choice.widen():
                break
        else:
            tolerance = max(_FINER * tolerance, _FINEST)
    return Sampled(least[1], least[0], looked_at, False)


class _Choice:
    """The fit: candidate points, the states whose residuals are conditions, and the most points that may be chosen."""

    def __init__(
        self,
        full: GalerkinModel,
        known: tuple[Array, Array],
        fields: Array,
        most: int,
        tell: Callable[[str, float], None],
        inductance: bool,
    ) -> None:
        self._full, self._fields, self._most = full, fields, most
        self._weights = Weights(_ENERGY, _LINKAGE, _INDUCTANCE if inductance else 0.0)
        self._states = list(zip(*known, strict=True))
        if len(self._states) > _MOST_STATES:
            # The others are not missed: the tests find what the fit lacks.
            kept = np.random.default_rng(_SEED).choice(len(self._states), _MOST_STATES, replace=False)
            self._states = [self._states[k] for k in np.sort(kept)]
        self._contributions: list[OfPoints] = []
        self._totals: list[Array] = []
        count = len(self._states)

        def of_states(done: int) -> None:
            if done < count:
                tell(f"sample points, from state {done + 1} of {count}", OF_STATES * done / count)

        self._importance = self._count_in(self._states, of_states)
        tell("sample points, conditions of their choice", OF_STATES)
        self._taken = 0
        self._count = candidates_at_first(full.modes, most)
        self._begin()

    def _begin(self) -> None:
        chosen = candidates(self._importance, self._count)
        self._cubature = Cubature(len(self._full.weights), chosen)
        self._cubature.add(self._contributions, self._totals)
        for k in self._differently_magnetised(chosen):
            self._cubature.add_tangent(*_tangent(self._full, *self._states[k]))

    def model(self, tolerance: float) -> tuple[GalerkinModel, float]:
        """Fit the points: the model with the law at them, and the error of the fit over the allowed error."""
        factors, left = self._cubature.factors(tolerance, self._most)
        taken = np.flatnonzero(factors)
        self._taken = len(taken)
        points = self._cubature.candidates[taken]
        return self._full.sampled(points, factors[taken] * self._full.weights[points]), left

    def add(self, currents: Array, amplitudes: Array) -> None:
        """Add the residuals of states, currents (s, c) and amplitudes (s, r), as conditions."""
        before = len(self._totals)
        self._count_in(list(zip(currents, amplitudes, strict=True)))
        self._cubature.add(self._contributions[before:], self._totals[before:])

    def _count_in(
        self, states: Sequence[tuple[Array, Array]], tell: Callable[[int], None] = lambda done: None
    ) -> Array:
        """Store the contributions of points to the residuals of states, and the residuals.

        Returns the importance (p,) of the points: about the root of the sum, over states, of their squared
        contributions. tell(k) is called when k states are done.
        """
        full, found = self._full, []

        def conditions(state: tuple[Array, Array]) -> Conditions:
            return full.conditions(*state, self._fields, self._weights)

        tell(0)
        for done, one in enumerate(results_of(conditions, states), start=1):
            found.append(one)
            tell(done)
        self._contributions += [partial(_added, full, one) for one in found]
        # Random projections estimate the sizes (Drineas, Magdon-Ismail, Mahoney and Woodruff, J. Mach. Learn. Res. 13
        # (2012) 3475).
        count = full.modes + full.source.shape[1]
        mixing = np.random.default_rng(0).standard_normal((count, _PROJECTIONS))
        totals, squares = full.totals(found, mixing)
        self._totals += totals
        return np.sqrt(squares)

    def widen(self) -> bool:
        """Double the most points if all of them are used, otherwise the candidates; False if there are no more."""
        every = min(len(self._full.weights), _MOST_CANDIDATES)
        if self._taken >= min(self._most, every):
            if self._most >= every:
                return False
            self._most *= 2
        elif self._count < every:
            self._count = min(2 * self._count, every)
            self._begin()
        else:
            return False
        return True

    def _differently_magnetised(self, points: NDArray[np.int64]) -> list[int]:
        """Indices of states, each the farthest from those before it in the logarithm of the permeability."""
        some = self._full.sampled(points, self._full.weights[points])
        moments = [np.linalg.norm(some.moments(*state), axis=1) for state in self._states]
        fields = [
            np.linalg.norm((some.applied(i) - some.gradients @ a).reshape(-1, 3), axis=1)
            for i, a in self._states
        ]
        ratio = np.array(moments) / (np.array(fields) * some.weights + 1e-300)
        logarithm = np.log1p(np.maximum(ratio, 0.0))
        chosen: list[int] = []
        away = np.full(len(logarithm), np.inf)
        while len(chosen) < min(_TANGENTS, len(logarithm)):
            chosen.append(int(away.argmax()))
            away = np.minimum(away, np.linalg.norm(logarithm - logarithm[chosen[-1]], axis=1))
        return chosen


class _Tried:
    """The tested states: currents, and amplitudes with the law at all points. They take no part in the choice."""

    def __init__(
        self,
        full: GalerkinModel,
        known: tuple[Array, Array],
        domain: CurrentDomain,
        off: Off,
        tolerance: float,
    ) -> None:
        self._full, self._known, self._domain, self._off = full, known, domain, off
        self._tolerance, self._random = tolerance, np.random.default_rng(_SEED)
        self._currents, self._amplitudes = known[0][:0], known[1][:0]

    def random(self, count: int) -> Array:
        """The next random currents (count, c)."""
        return drawn(self._domain, count, self._random)

    def draw(self, model: GalerkinModel, currents: Array) -> int:
        """Solve states at more currents (s, c), beginning at the states of `model`. Returns how many these are."""
        starts = solved_from(model, self._known, currents)
        amplitudes = self._full.solutions(currents, starts, model, self._tolerance)
        self._currents = np.concatenate([self._currents, currents])
        self._amplitudes = np.concatenate([self._amplitudes, amplitudes])
        return len(currents)

    def changed(self, model: GalerkinModel) -> Array:
        """Relative changes (s,) of the fields of the tested states by the sample points of `model`."""
        found = solved(model, self._currents, self._amplitudes)
        return self._off(self._currents, self._amplitudes, found - self._amplitudes)

    def take(self, changed: Array, allowed: float, most: int) -> tuple[Array, Array]:
        """Remove the worst states, at most `most`, that change by more than allowed, and return them."""
        worst = np.argsort(-changed, kind="stable")[:most]
        worst = worst[changed[worst] > allowed]
        taken = self._currents[worst], self._amplitudes[worst]
        rest = np.setdiff1d(np.arange(len(changed)), worst)
        self._currents, self._amplitudes = self._currents[rest], self._amplitudes[rest]
        return taken


def _tangent(model: GalerkinModel, currents: Array, amplitude: Array) -> tuple[Array, OfPoints]:
    """Arguments of `Cubature.add_tangent` for a state."""
    factor = model.tangent_factor(currents, amplitude)

    def of(points: NDArray[np.int64]) -> Array:
        return model.sampled(points, model.weights[points]).roots_of_tangent(currents, amplitude, factor)

    return model.share_of_law(factor), of


def _added(model: GalerkinModel, conditions: Conditions, points: NDArray[np.int64]) -> Array:
    """Contributions (m, k) of some points to the numbers of the conditions."""
    return conditions.of_points(model.sampled(points, model.weights[points]))

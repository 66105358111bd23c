"""The law at few points in the place of all: points are added until new states come out as with the law at all points.

What sample points are to hold are states that took no part in their choice. So the law at all points is solved, too, at
extremes of the domain and at currents drawn at random: a thousandth of what the states of the whole iron cost. Those
that the points do not give well enough become conditions of the next choice, and others are drawn in their place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.reduced import GalerkinModel
from fieldmap.maps.training.cubature import Cubature, OfPoints, candidates
from fieldmap.maps.training.currents import drawn
from fieldmap.maps.training.model_error import Off
from fieldmap.maps.training.modes import solved, solved_from
from fieldmap.parallel import results_of
from fieldmap.records import Record
from fieldmap.typing import Array

# Points from which the fit may choose at first, per mode and at least, and per point that it may take at most; drawn by
# what they add.
_CANDIDATES_PER_MODE, _FEWEST_CANDIDATES, _CANDIDATES_PER_POINT = 50, 1000, 4
# And in the end: their products with each other take a gigabyte, three times over.
_MOST_CANDIDATES = 12_000
# How much the energy of the error counts that sample points cause, beside its field in the workspace. Without it points
# are chosen that keep the fields of the states that are known, and no others.
_ENERGY = 0.3
# Random projections that tell how much a point adds.
_PROJECTIONS = 8
# States whose tangents are matched: those whose iron is magnetised most differently.
_TANGENTS = 3
# What the points may change, over the accuracy: of the states of the fit, root mean square; of any state that is tried.
# Where a state is worse, the first becomes smaller by this factor, down to this share of itself.
_FITTED, _TRIED, _FINER, _FINEST = 0.4, 0.5, 0.7, 0.05
# Extremes and random states that are tried first, and random ones in each further round; of those that fall short so
# many become conditions.
_EXTREMES, _RANDOM, _WORST, _SEED = 64, 96, 24, 20263
# Known states that a choice begins with: of more, where symmetry makes many of one, so many at random.
_MOST_STATES = 200
# States with the law at all points are solved to this share of the accuracy.
_EXACT = 0.02
ROUNDS = 12
"""Of the choice of sample points; without more candidates or points it ends earlier."""
OF_STATES = 0.1
"""What of the time for the sample points goes into what the states tell of them, before their choice."""
# What the conditions, and then each round, leave of the rest.
_EACH = 0.6


@dataclass(frozen=True, eq=False, repr=False)
class Sampled(Record):
    """A model with the law at sample points.

    changed: the largest change of the field of a state that took no part in their choice, as a share of its own;
    tried: how many of these were looked at; enough: whether none changes by more than it may.
    """

    model: GalerkinModel
    changed: float
    tried: int
    enough: bool


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
) -> Sampled:
    """Choose points of the law, and weights on them.

    known: currents (s, c) and amplitudes (s, r) of states to fit; extremes (m, c): currents to try first.
    fields (r, k): numbers of the modes whose lengths tell how large a field is; off(currents (s, c),
    amplitudes (s, r), changes (s, r)): what changes of the amplitudes change of the fields, as a share. accuracy: share
    of the field; most: points to be chosen, and more only where so many do not do. tell(message,
    share) is called on the way, with how much of it is done, about. rounds: how often points are chosen at most.
    """
    choice = _Choice(full, known, fields, most, tell)
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
    """Points to choose from, states whose residuals they are to give, and at most how many of them may be taken."""

    def __init__(
        self,
        full: GalerkinModel,
        known: tuple[Array, Array],
        fields: Array,
        most: int,
        tell: Callable[[str, float], None],
    ) -> None:
        self._full, self._fields, self._most = full, fields, most
        self._states = list(zip(*known, strict=True))
        if len(self._states) > _MOST_STATES:
            # Those that are tried tell what the others would have.
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
        wanted = max(_FEWEST_CANDIDATES, _CANDIDATES_PER_MODE * full.modes)
        self._count = min(wanted, max(_FEWEST_CANDIDATES, _CANDIDATES_PER_POINT * most))
        self._begin()

    def _begin(self) -> None:
        chosen = candidates(self._importance, self._count)
        self._cubature = Cubature(len(self._full.weights), chosen)
        self._cubature.add(self._contributions, self._totals)
        for k in self._differently_magnetised(chosen):
            self._cubature.add_tangent(*_tangent(self._full, *self._states[k]))

    def model(self, tolerance: float) -> tuple[GalerkinModel, float]:
        """The model at chosen points, and what these leave over what is allowed."""
        factors, left = self._cubature.factors(tolerance, self._most)
        taken = np.flatnonzero(factors)
        self._taken = len(taken)
        points = self._cubature.candidates[taken]
        return self._full.sampled(points, factors[taken] * self._full.weights[points]), left

    def add(self, currents: Array, amplitudes: Array) -> None:
        """States (s, c), (s, r) whose residuals are to be given as well."""
        before = len(self._totals)
        self._count_in(list(zip(currents, amplitudes, strict=True)))
        self._cubature.add(self._contributions[before:], self._totals[before:])

    def _count_in(
        self, states: Sequence[tuple[Array, Array]], tell: Callable[[int], None] = lambda done: None
    ) -> Array:
        """Note what points add to the residuals of states, and all of them; the root of the sum of the squares of what
        each point adds (p,), about. tell(k) is called when k states have been asked."""
        pairs = [_contributions(self._full, *state, self._fields) for state in states]
        self._contributions += [of for _, of in pairs]
        squares = np.zeros(len(self._full.weights))
        tell(0)
        for done, (total, sizes) in enumerate(results_of(lambda pair: pair[0](), pairs), start=1):
            self._totals.append(total)
            squares += sizes**2
            tell(done)
        return np.asarray(np.sqrt(squares))

    def widen(self) -> bool:
        """Allow more points, where all were taken that may be; else choose out of more. Whether there are any."""
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
        """Numbers of states, each the farthest from those before it in the logarithm of the permeability at points."""
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
    """States with the law at all points that take no part in the choice: currents, amplitudes."""

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
        """Currents (count, c) that were not drawn before."""
        return drawn(self._domain, count, self._random)

    def draw(self, model: GalerkinModel, currents: Array) -> int:
        """Solve states at more currents (s, c), from those of the model; how many."""
        starts = solved_from(model, self._known, currents)
        amplitudes = self._full.solutions(currents, starts, model, self._tolerance)
        self._currents = np.concatenate([self._currents, currents])
        self._amplitudes = np.concatenate([self._amplitudes, amplitudes])
        return len(currents)

    def changed(self, model: GalerkinModel) -> Array:
        """What the model changes of the fields of these states (s,)."""
        found = solved(model, self._currents, self._amplitudes)
        return self._off(self._currents, self._amplitudes, found - self._amplitudes)

    def take(self, changed: Array, allowed: float, most: int) -> tuple[Array, Array]:
        """Take away those that change by more than allowed, the worst of them; their currents and amplitudes."""
        worst = np.argsort(-changed, kind="stable")[:most]
        worst = worst[changed[worst] > allowed]
        taken = self._currents[worst], self._amplitudes[worst]
        rest = np.setdiff1d(np.arange(len(changed)), worst)
        self._currents, self._amplitudes = self._currents[rest], self._amplitudes[rest]
        return taken


def _tangent(model: GalerkinModel, currents: Array, amplitude: Array) -> tuple[Array, OfPoints]:
    """What `Cubature.add_tangent` takes of a state."""
    factor = model.tangent_factor(currents, amplitude)
    of_air = solve_triangular(factor, solve_triangular(factor, model.air, lower=True).T, lower=True)

    def of(points: NDArray[np.int64]) -> Array:
        return model.sampled(points, model.weights[points]).roots_of_tangent(currents, amplitude, factor)

    return np.eye(len(factor)) - of_air, of


def _contributions(
    model: GalerkinModel, currents: Array, amplitude: Array, fields: Array
) -> tuple[Callable[[], tuple[Array, Array]], OfPoints]:
    """Of the points to a state's residual, counted by the error that they cause in its fields (r, m) and energy: what
    all of them add (r,), and about how large what each adds is (p,); and what some add (m, r)."""
    # Lengths are told by some random projections (Drineas, Magdon-Ismail, Mahoney and Woodruff, J. Mach. Learn. Res. 13
    # (2012) 3475).
    mixing = np.random.default_rng(0).standard_normal((model.modes, _PROJECTIONS))

    @cache
    def coordinates() -> Array:
        return model.error_coordinates(currents, amplitude, fields, _ENERGY)

    def summed() -> tuple[Array, Array]:
        moments, combine = model.moments(currents, amplitude), coordinates()
        mixed = combine @ mixing
        lengths = np.linalg.norm(model.contributions(moments, mixed), axis=1)
        return model.residual(moments) @ combine, lengths

    def of(points: NDArray[np.int64]) -> Array:
        some = model.sampled(points, model.weights[points])
        return some.contributions(some.moments(currents, amplitude), coordinates())

    return summed, of

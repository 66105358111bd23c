"""Where a model is worst: at extremes of the domain, and at currents that are searched for.

What the model's residual, or fewer modes and points, change of the field is cheap to look at. States that look worst
are solved, to measure the error and to train on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.maps.training.condensation import Condensed
from fieldmap.maps.training.currents import (
    climbed,
    drawn_shares,
    edge_shares,
    extreme_signals,
    reaches,
    shares_of,
)
from fieldmap.maps.training.modes import SolvedModes, solved
from fieldmap.maps.training.reduction import Reduction
from fieldmap.maps.training.sequence import Training
from fieldmap.maps.training.states import Snapshots
from fieldmap.records import Record
from fieldmap.store.stated_accuracy import HELD_OUT
from fieldmap.typing import Array

# So many extremes, images apart, are all solved. Of more, those that look worst and some at random, then those that may
# be worse than these; if any of them falls short, as many as there may be, and once the model knows what it lacked,
# again those of the others that look worst.
_FEW_EXTREMES, _WORST, _RANDOM, _MOST_SOLVED = 32, 8, 4, 64
_RANDOM_SEED = 11
# The search for the worst currents: extremes, currents at random, and as many on edges, to begin with, and how many of
# those found are solved.
_SEARCHED_EXTREMES, _SEARCHED_RANDOM, _SEARCHED_SOLVED = 32, 32, 4
# What of the time for the search goes into these solves.
_OF_SOLVES = 0.4
_SEARCH_SEED = 20264
# From how many random currents, and as many on edges, the search of what fewer modes and points change begins, beside
# all extremes, and how many of those found are solved.
_SEARCHED_CONDENSED, _SOLVED_CONDENSED = 200, 8
# Number of the first state that a search of the condensed model solves, behind all numbers of other searches.
_BEHIND_ALL = 1_000_000


@dataclass(frozen=True)
class ExtremesTried(Record):
    """What was done about the extremes of the domain: how many corners it has; at how many extremes, corners among
    them, the model was looked at; how many of these are no images of each other; how many of them were solved, and how
    many of these trained on. by_residual: whether those solved were chosen by the residual: the worst, some at random,
    and all that may be worse still. searched: currents at which a search for the worst looked at the residual."""

    corners: int
    looked_at: int
    different: int
    solved: int
    trained_on: int
    by_residual: bool
    searched: int = 0

    def and_again(self, later: "ExtremesTried") -> "ExtremesTried":
        """What was done in both, the later one with a model that knew more states."""
        return replace(
            later,
            solved=max(self.solved, later.solved),
            trained_on=self.trained_on + later.trained_on,
            searched=self.searched + later.searched,
        )


def allowed(training: Training) -> float:
    """The largest error at a state that a model was not trained on."""
    return HELD_OUT * training.plan.accuracy


def try_extremes(training: Training) -> tuple[Reduction, Snapshots, ExtremesTried]:
    """Solve extremes of the domain, train on those that the model lacks, and reduce: the model, and the solved extremes
    that are left to measure its error."""
    domain, accuracy, before = training.domain, training.plan.accuracy, training.known.solved
    signals = extreme_signals(domain)
    currents = domain.parametrisation.currents(signals)
    directions = [reaches(domain, values) for values in signals]
    different = training.different(currents, range(len(currents)))
    few, count = len(different) <= _FEW_EXTREMES, 0

    def solve(
        predict: Callable[[Array], Array], numbers: Sequence[int], found: Snapshots | None = None
    ) -> Snapshots:
        nonlocal count
        count += len(numbers)
        about = (training.plan.states, "at extremes", "extremes", directions)
        return training.solve_tried(predict, currents, *about, numbers, found)

    def looks_worst(reduction: Reduction, numbers: list[int]) -> dict[int, float]:
        """Numbers in the order of how far the model looks to be off there, and that."""
        looks = reduction.shortfall(currents[numbers])
        return {numbers[k]: float(looks[k]) for k in np.argsort(-looks, kind="stable")}

    unknown, modes = training.unknown(currents, different), training.modes()
    if few:
        left = solve(lambda values: modes.basis @ modes.amplitude(values), unknown)
        left = add_missing(training, modes, left)
        modes = modes if training.known.solved == before else training.modes()
        if training.too_few(modes) and training.more_modes():
            modes = training.modes()
        reduction = training.reduce(modes, currents)
    else:
        reduction = training.reduce(modes, currents)
        looks = looks_worst(reduction, unknown)
        order = list(looks)
        others = np.random.default_rng(_RANDOM_SEED).permutation(order[_WORST:])
        chosen = [*order[:_WORST], *others[:_RANDOM].tolist()]
        left = solve(reduction.potential, chosen)
        while True:
            rest, off = [k for k in order if k not in chosen], reduction.off(left)
            places = {k: left.number(currents[k]) for k in chosen}
            errors = {k: float(off[place]) for k, place in places.items() if place is not None}
            worse = _perhaps_worse(errors, rest, looks)[: _MOST_SOLVED - len(chosen)]
            if not worse:
                break
            chosen = [*chosen, *worse]
            left = solve(reduction.potential, worse, left)
        if off.max(initial=0.0) > accuracy:
            # Many extremes fall short where one does: they are solved to train on.
            more, rest = rest[: _MOST_SOLVED - len(chosen)], rest[_MOST_SOLVED - len(chosen) :]
            left = add_missing(training, reduction.modes, solve(reduction.potential, more, left))
        if training.known.solved > before:
            reduction = training.reduce(training.modes(), currents)
            if rest:
                left = solve(reduction.potential, list(looks_worst(reduction, rest))[:_WORST], left)
    trained, corners = training.known.solved - before, 2 ** len(domain.lower)
    return reduction, left, ExtremesTried(corners, len(currents), len(different), count, trained, not few)


def _perhaps_worse(errors: dict[int, float], rest: list[int], looks: dict[int, float]) -> list[int]:
    """Of extremes that are not solved those whose error may be larger than the largest found, if the error is no more
    times what it looks to be than at any extreme solved. errors: those found."""
    most = max((error / looks[k] for k, error in errors.items() if looks[k] > 0.0), default=0.0)
    return [k for k in rest if most * looks[k] > max(errors.values())] if errors else []


def add_missing(training: Training, modes: SolvedModes, tried: Snapshots) -> Snapshots:
    """Train on those of the tried states that the modes lack; the others, still to try the model on.

    They are solved already, and what a model does not predict must be among its states.
    """
    for k in modes.missing(tried, training.plan.accuracy) if tried.solved else ():
        # It may be the image of one that was just added.
        if training.known.number(tried.currents[k]) is None:
            training.known.add(tried.currents[k], tried.state(int(k)))
    return tried.without(training.known)


def search_worst(
    training: Training, reduction: Reduction, number: int, before: Snapshots
) -> tuple[Snapshots, int]:
    """Solve the states of currents at which the model's residual is largest, numbered from `number`: those states, with
    those of the search before that were not trained on, and at how many currents the residual was looked at.

    The worst of extremes and of currents drawn at random, inside the domain and on its edges; from the ten worst the
    search goes on to random neighbours, nearer each time.
    """
    domain, random = training.domain, np.random.default_rng(_SEARCH_SEED + number)

    def tell(share: float) -> None:
        message = "the worst currents, by the model's residual"
        training.forecast.at("search", message, (1.0 - _OF_SOLVES) * share)

    extremes = random.permutation(shares_of(domain, extreme_signals(domain)))[:_SEARCHED_EXTREMES]
    begin = _beginning(training, extremes, _SEARCHED_RANDOM, random)
    shares, looked_at = climbed(reduction.shortfall, domain, begin, random, tell)
    about = (training, reduction, shares, number, "of the largest residual")
    found = _solve_found(*about, _SEARCHED_SOLVED)
    if reduction.off(found).max(initial=0.0) > allowed(training):
        # Many fall short where one does: they are solved to train on.
        found = _solve_found(*about, len(shares))
    return found.with_earlier(before).without(training.known), looked_at


def search_condensed(training: Training, reduction: Reduction, few: Condensed, attempt: int) -> Snapshots:
    """Solve the states whose field fewer modes and points change most, sought as in `search_worst`, but from more
    currents, since no state of the solver is needed to look."""
    domain, random = training.domain, np.random.default_rng(_SEARCH_SEED - 1 - attempt)

    def change(currents: Array) -> Array:
        amplitudes = reduction.amplitudes(currents)
        changes = solved(few.model, currents, amplitudes @ few.basis) @ few.basis.T - amplitudes
        return reduction.fields.changed(currents, amplitudes, changes)

    extremes = shares_of(domain, extreme_signals(domain))
    shares, _ = climbed(change, domain, _beginning(training, extremes, _SEARCHED_CONDENSED, random), random)
    first = _BEHIND_ALL + attempt * len(shares)
    return _solve_found(training, reduction, shares, first, "that fewer modes change most", _SOLVED_CONDENSED)


def _beginning(training: Training, extremes: Array, count: int, random: np.random.Generator) -> Array:
    """Shares (m, d) of the ranges: of extremes, at random, and as many on edges."""
    drawn = (draw(training.domain, count, random) for draw in (drawn_shares, edge_shares))
    return np.concatenate([extremes, *drawn])


def _solve_found(
    training: Training, reduction: Reduction, shares: Array, first: int, text: str, most: int
) -> Snapshots:
    """Solve the first of those at shares (s, d) of the ranges that are not trained on, `most` of them, with what it
    takes to train on them; numbers and text: see `Training.solve_tried`."""
    domain = training.domain
    currents = domain.at(shares)
    chosen = training.unknown(currents, training.different(currents, range(len(currents))))[:most]
    signals = domain.parametrisation.within(domain.lower, domain.upper, shares)
    directions = [reaches(domain, values) for values in signals]
    return training.solve_tried(reduction.potential, currents, first, text, None, directions, chosen)

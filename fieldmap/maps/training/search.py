"""Search for the largest errors of a model: at extremes of the domain, and at currents that a search finds.

Indicators of the error are cheap: the residual of the model, or the change by condensation. States with the largest
indicators are solved. They measure the error, and the model is trained on those that it lacks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.maps.training.condensation import Condensed
from fieldmap.maps.training.currents import (
    STARTS,
    at_rest,
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

# Up to `_FEW_EXTREMES` extremes, images not counted, are all solved. If there are more, the `_WORST` by the indicator
# and `_RANDOM` others are solved, then those whose errors may be larger. If an error is too large, up to `_MOST_SOLVED`
# are solved, and after the training on them again the `_WORST` of the rest.
_FEW_EXTREMES, _WORST, _RANDOM, _MOST_SOLVED = 32, 8, 4, 64
_RANDOM_SEED = 11
# Search for the worst currents: number of extremes and of random currents that it begins with (as many on edges are
# added), and number of the found currents that are solved.
_SEARCHED_EXTREMES, _SEARCHED_RANDOM, _SEARCHED_SOLVED = 32, 32, 4
# Search for currents at which fields cancel: number of random currents that it begins with, distances of the neighbours
# in its rounds, and number of the found ones that are solved, of flux density and of gradient each.
_DRAWN_CANCELLING, _WIDTHS_CANCELLING, _CANCELLING = 500, (0.15, 0.05, 0.015, 0.005, 0.002), 3
_CANCELLING_SEED = 20266
SEARCHED = STARTS + 2 * _CANCELLING
"""Most currents that a search for the worst currents solves."""
# Share of the time of a search that these solves take.
_OF_SOLVES = 0.4
_SEARCH_SEED = 20264
# Search for the largest change by condensation: number of random currents that it begins with (as many on edges and all
# extremes are added), and number of the found currents that are solved.
_SEARCHED_CONDENSED, _SOLVED_CONDENSED = 200, 8
# Number of the first state that is solved for the condensed model. It is larger than all numbers of other searches.
_BEHIND_ALL = 1_000_000


@dataclass(frozen=True)
class ExtremesTried(Record):
    """What was done at the extremes of the domain.

    Attributes
    ----------
    corners : number of corners of the domain.
    looked_at : number of extremes, corners included.
    different : number of extremes that are not images of each other.
    solved : number of these that were solved.
    trained_on : number of the solved ones that the model was trained on.
    by_residual : whether the solved ones were chosen by the residual; otherwise all were solved.
    searched : number of currents at which the search for the worst currents evaluated the residual.
    """

    corners: int
    looked_at: int
    different: int
    solved: int
    trained_on: int
    by_residual: bool
    searched: int = 0

    def and_again(self, later: "ExtremesTried") -> "ExtremesTried":
        """The sum of two tries; the model of the later one was trained on more states."""
        return replace(
            later,
            solved=max(self.solved, later.solved),
            trained_on=self.trained_on + later.trained_on,
            searched=self.searched + later.searched,
        )


def allowed(training: Training) -> float:
    """The largest error that is allowed at a state that the model was not trained on."""
    return HELD_OUT * training.plan.accuracy


def try_extremes(training: Training) -> tuple[Reduction, Snapshots, ExtremesTried]:
    """Solve extremes of the domain, train on those that the model lacks, and reduce the model.

    Returns
    -------
    tuple[Reduction, Snapshots, ExtremesTried]
        The model, the solved extremes that it was not trained on, which measure its error, and the counters.
    """
    domain, accuracy, before = training.domain, training.plan.accuracy, training.known.solved
    signals = extreme_signals(domain)
    currents = domain.parametrisation.currents(signals)
    directions = [reaches(domain, values, training.plan.inductance) for values in signals]
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
        """Error indicators by number of the extreme, the largest first."""
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
            # If one extreme has too large an error, many have. More are solved to train on.
            more, rest = rest[: _MOST_SOLVED - len(chosen)], rest[_MOST_SOLVED - len(chosen) :]
            left = add_missing(training, reduction.modes, solve(reduction.potential, more, left))
        if training.known.solved > before:
            reduction = training.reduce(training.modes(), currents)
            if rest:
                left = solve(reduction.potential, list(looks_worst(reduction, rest))[:_WORST], left)
    trained, corners = training.known.solved - before, 2 ** len(domain.lower)
    return reduction, left, ExtremesTried(corners, len(currents), len(different), count, trained, not few)


def _perhaps_worse(errors: dict[int, float], rest: list[int], looks: dict[int, float]) -> list[int]:
    """Unsolved extremes whose errors may be larger than the largest one found.

    The estimate assumes that the ratio of error and indicator is nowhere larger than at the solved extremes.

    Parameters
    ----------
    errors
        Errors by number of the solved extremes.
    rest
        Numbers of the others.
    looks
        Indicators by number.
    """
    most = max((error / looks[k] for k, error in errors.items() if looks[k] > 0.0), default=0.0)
    return [k for k in rest if most * looks[k] > max(errors.values())] if errors else []


def add_missing(training: Training, modes: SolvedModes, tried: Snapshots) -> Snapshots:
    """Train on the solved states that the modes do not represent within the accuracy.

    Returns
    -------
    Snapshots
        The other solved states, which still measure the error.
    """
    for k in modes.missing(tried, training.plan.accuracy) if tried.solved else ():
        # The state may be an image of another one that was just added.
        if training.known.number(tried.currents[k]) is None:
            training.known.add(tried.currents[k], tried.held(int(k)))
    return tried.without(training.known)


def search_worst(
    training: Training, reduction: Reduction, number: int, before: Snapshots
) -> tuple[Snapshots, int]:
    """Search for the currents at which the model's residual is largest, and solve the states there.

    The search begins at extremes and at random currents, inside the domain and on its edges: see `climbed`. States
    where fields cancel are solved as well.

    Parameters
    ----------
    training, reduction
        The model.
    number
        Number of the first state that is solved.
    before
        States of the search before.

    Returns
    -------
    tuple[Snapshots, int]
        The new states and those of the search before, without states that the model is trained on, and the
        number of currents at which the residual was evaluated.
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
    cancelling = _cancelling(domain, reduction, np.random.default_rng(_CANCELLING_SEED + number))
    where = (training, reduction, cancelling, number + STARTS, "where fields cancel", len(cancelling))
    weak = _solve_found(*where)
    if max(reduction.off(some).max(initial=0.0) for some in (found, weak)) > allowed(training):
        # If one state has too large an error, many have. More are solved to train on.
        found = _solve_found(*about, len(shares))
    found = found.with_earlier(weak)
    return found.with_earlier(before).without(training.known), looked_at


def search_condensed(training: Training, reduction: Reduction, few: Condensed, attempt: int) -> Snapshots:
    """Search for the states whose fields condensation changes most, and solve them.

    The search is that of `search_worst`, from more currents, because the change is known without a state of the solver.
    """
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
    """Shares (m, d) of the ranges at which a search begins: extremes, `count` random ones, and as many on edges."""
    drawn = (draw(training.domain, count, random) for draw in (drawn_shares, edge_shares))
    return np.concatenate([extremes, *drawn])


def _cancelling(domain: CurrentDomain, reduction: Reduction, random: np.random.Generator) -> Array:
    """Shares (2 `_CANCELLING`, d) of the ranges at which the fields of coils, iron and magnets cancel in the workspace:
    first their flux densities, then their gradients; each from the weakest currents to the strongest.

    An error that is small beside each of these fields is large beside the little that they leave. Such currents are a
    thin part of the domain, which random currents miss.
    """

    def left(currents: Array) -> Array:
        return reduction.fields.left_of_sums(currents, reduction.amplitudes(currents))

    drawn, rest = drawn_shares(domain, _DRAWN_CANCELLING, random), at_rest(domain)
    of_drawn = left(domain.at(drawn))

    def found(j: int) -> Array:
        begin = drawn[np.argsort(of_drawn[:, j], kind="stable")[:STARTS]]
        shares, _ = climbed(
            lambda currents: -left(currents)[:, j], domain, begin, random, widths=_WIDTHS_CANCELLING
        )
        order = np.argsort(np.abs(shares - rest).max(axis=1), kind="stable")
        # The residual ranks currents of about one strength only: the tangent of unsaturated iron belongs to weak ones.
        looks = reduction.shortfall(domain.at(shares))
        return shares[[some[looks[some].argmax()] for some in np.array_split(order, _CANCELLING)]]

    return np.concatenate([found(0), found(1)])


def _solve_found(
    training: Training, reduction: Reduction, shares: Array, first: int, text: str, most: int
) -> Snapshots:
    """Solve the first states, at most `most`, at shares (s, d) of the ranges that the model is not trained on.

    Their tangents are solved too, so that the model can be trained on them. For `first` and `text` see
    `Training.solve_tried`.
    """
    domain = training.domain
    currents = domain.at(shares)
    chosen = training.unknown(currents, training.different(currents, range(len(currents))))[:most]
    signals = domain.parametrisation.within(domain.lower, domain.upper, shares)
    directions = [reaches(domain, values, training.plan.inductance) for values in signals]
    return training.solve_tried(reduction.potential, currents, first, text, None, directions, chosen)

"""From solved states of saturating iron to a reduced model, its fields' charges, and its errors on other states."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel, same_lengths
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.recipe import Plan
from fieldmap.maps.training.condensation import Condensed, condensed
from fieldmap.maps.training.expected import expect_modes, expect_points, expect_tried, states_needed
from fieldmap.maps.training.model_error import Errors, Trial
from fieldmap.maps.training.modes import SolvedModes, output_fields
from fieldmap.maps.training.sampling import OF_STATES, ROUNDS, Sampled, sampled
from fieldmap.maps.training.states import (
    REACH,
    Snapshots,
    Solved,
    SolvedStates,
    Wanted,
    at_rest,
    drawn_shares,
    edge_shares,
    extreme_signals,
    held_out,
    is_among,
    nearest_of,
    nothing,
    one_of,
    reaches,
    sequence,
    training_signals,
)
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.records import Record
from fieldmap.store import ReducedModel
from fieldmap.store.stated_accuracy import GRADIENT, HELD_OUT
from fieldmap.typing import Array

# States to begin with, of a sequence that fills the domain; then so many at once.
_FIRST, _AT_ONCE = 3, 4
# States are solved so much better than they are wanted; the tolerance of the solver is a thousand times its residual.
_SOLVED_BETTER = 10.0
# What the modes may leave of a state, its energy's root as a share, and what the fields of the map may leave of a
# state's field, over the accuracy.
_MODES, _FIELDS = 0.2, 0.05
# What the fields of the map may leave where the recipe names fewer than that takes, and as many as there may be.
_FIELDS_AT_MOST, _MOST_FIELDS = 0.3, 100
# Fields that make less of any state are rough, and worse for the nodes of the map than for its error.
_ROUGH_FIELDS = 1e-4
# What the recipe's modes may grow to where they leave so many times the accuracy of a state that they are made of, in
# the norm of the energy. Where these leave as much, no states or points help: the map is refused, and what it would be
# off is found with as many rounds of the choice of sample points.
_MOST_MODES, _TOO_FEW_MODES, _ROUNDS_IN_VAIN = 200, 4.0, 2
# How exactly a state with the law at all points is solved, over the accuracy, where its error is asked.
_EXACT = 0.01
# So many extremes, images apart, are all solved. Of more, those that look worst and some at random, then those that may
# be worse than these; if any of them falls short, as many as there may be, and once the model knows what it lacked,
# again those of the others that look worst.
_FEW_EXTREMES, _WORST, _RANDOM, _MOST_SOLVED = 32, 8, 4, 64
_RANDOM_SEED = 11
# The search for the worst currents: extremes, currents at random, and as many on edges, to begin with; from how many of
# the worst it goes on, to how many neighbours each, how far away as a share of the ranges, and how many of those found
# are solved.
_SEARCHED_EXTREMES, _SEARCHED_RANDOM, _STARTS, _NEIGHBOURS, _SEARCHED_SOLVED = 32, 32, 10, 3, 4
_WIDTHS = (0.15, 0.05)
# What of the time for the search goes into these solves.
_OF_SOLVES = 0.4
_SEARCH_SEED = 20264
_SEARCHED = "searched for"
# From how many random currents, and as many on edges, the search of what fewer modes and points change begins, beside
# all extremes, and how many of those found are solved.
_SEARCHED_CONDENSED, _SOLVED_CONDENSED = 200, 8
# How often at most a model is made anew of states of the search for the worst currents that fell short, and how often
# of those of the search of the condensed model.
_AGAIN, _AGAIN_CONDENSED = 8, 2
# Number of the first state that a search of the condensed model solves.
_BEHIND_ALL = 1_000_000
# What fewer modes and points may change, over what they may at first: less where a solved state falls short by it.
_CONDENSED = (1.0, 0.5, 0.2)
# Extremes whose residuals are computed at a time: so many nodal potentials are in memory.
_RANKED = 64
# At how many extremes of the domain, and other currents, the weights of the iron's fields are looked at, and
# how much larger they may be in between. They are smooth and largest at the rim, where both are.
_WEIGHED, _MARGIN = 128, 1.1
# Of second-order tetrahedra with four points each.
_POINTS_PER_UNKNOWN = 2.75


@dataclass(frozen=True, eq=False, repr=False)
class Solving(Record):
    """What solves states: the solver, the states and the workers, where fields are compared, and whom to tell."""

    solver: NonlinearSolver
    states: SolvedStates
    trial: Trial
    plan: Plan
    forecast: Forecast

    @property
    def tolerance(self) -> float:
        """Of the solver."""
        return max(self.plan.tolerance, _SOLVED_BETTER * self.plan.accuracy)

    def training(self, wanted: Sequence[Wanted], needed: int) -> list[Solved | None]:
        """Every state, or None where the solver fails; numbers as those of the states to train on. needed: how many
        will be, about."""
        first, most = wanted[0].number if wanted else 0, self.plan.states

        def tell(done: int) -> None:
            number, computed = first + done, self.states.computed
            left = max(needed - number, len(wanted) - done)
            self.forecast.at("training", f"state {number + 1} of at most {most}", computed, computed + left)
            if computed and left:
                per_state = (self.forecast.expected("training") - self.forecast.taken()) / left
                expect_tried(self.forecast, self.plan, per_state)
            self.expect_points(needed * (1 + len(self.solver.images)))

        return self.states.solve(wanted, self.tolerance, tell)

    def expect_points(self, states: int) -> None:
        """Expect the choice of sample points for so many states, images too."""
        points = round(_POINTS_PER_UNKNOWN * self.solver.unknowns)
        expect_points(self.forecast, points, self.plan.modes, states)


@dataclass(frozen=True, repr=False)
class Round(Record):
    """How far what the model predicted of some states was off when they were solved, and how many it knew by then."""

    solved: int
    errors: Errors


class TrainingSequence:
    """The states to train on, of a sequence that fills the domain, solved as far as they are needed.

    training: those that are solved, with their images, and what is added to them. rounds: how well each four were
    predicted by those before. solving: what solves them, with the plan that may have come to allow more modes.
    """

    def __init__(self, solving: Solving, domain: CurrentDomain) -> None:
        plan = solving.plan
        self.training = Snapshots(solving.solver, domain.holds)
        self.rounds: list[Round] = []
        self.solving, self._domain = solving, domain
        self._off = bool(solving.solver.device.fixed_sources)
        self._signals = training_signals(domain, plan.states, solving.solver.images, self._off)
        self._currents = domain.parametrisation.currents(self._signals)
        self._directions = [reaches(domain, values) for values in self._signals]
        self._done = min(_FIRST, plan.states)
        self._begin()

    @property
    def taken(self) -> int:
        """How many states of the sequence were asked for."""
        return self._done

    @property
    def at_its_end(self) -> bool:
        """Whether no more states may be solved."""
        return self._done >= self.solving.plan.states or not self.training.solved

    def more_modes(self) -> bool:
        """Train on as many modes as there may be from now on, the recipe's are too few; whether these are more."""
        now = self.solving.plan.modes
        most = max(now, _MOST_MODES)
        self.solving = replace(self.solving, plan=replace(self.solving.plan, modes=most))
        return most > now

    def go_on(self) -> None:
        """Solve states until the model has predicted the last of them as accurately as planned, or at the end. They
        were not among those that it knew, so that they say how good it is."""
        plan = self.solving.plan
        while not self.at_its_end:
            count = min(_AT_ONCE, plan.states - self._done)
            needed = states_needed(
                [_share(found.errors) for found in self.rounds], [r.solved for r in self.rounds], plan
            )
            if self.rounds:
                # A round that is tried on the states before it tells that these were enough.
                needed = min(max(needed, self._done) + _AT_ONCE, plan.states)
            new = slice(self._done, self._done + count)
            found = _round(
                self.solving, self.training, self._currents[new], self._directions[new], self._done, needed
            )
            self._done += count
            if found is not None:
                self.rounds.append(found)
                if _share(found.errors) <= plan.accuracy:
                    return

    def _begin(self) -> None:
        """Solve the state in the middle, and the two that begin from it and follow its tangents."""
        plan, currents, signals = self.solving.plan, self._currents, self._signals
        needed = states_needed([], [], plan)
        first = self.solving.training([Wanted(0, currents[0], None, self._directions[0])], needed)[0]
        if first is not None:
            self.training.add(currents[0], first)
        span = self._domain.upper - self._domain.lower

        def begin(k: int) -> Array | None:
            # If there is any field in it.
            if first is None or not (self._off or currents[0].any()):
                return None
            steps = (signals[k] - signals[0]) / (REACH * span)
            return np.asarray(first.potential + first.tangents @ steps)

        others = [Wanted(k, currents[k], begin(k), self._directions[k]) for k in range(1, self._done)]
        for state, solved in zip(others, self.solving.training(others, needed), strict=True):
            if solved is not None:
                self.training.add(state.currents, solved)


def _round(
    solving: Solving, training: Snapshots, currents: Array, directions: list[Array], number: int, needed: int
) -> Round | None:
    """Solve some states, numbered from `number`, see how well they were predicted, and add them. needed: see
    `Solving.training`."""
    before = training.solved
    modes = _modes(solving, training)
    amplitudes = np.array([modes.amplitude(values) for values in currents])
    starts = modes.basis @ amplitudes.T
    wanted = [
        Wanted(number + k, values, starts[:, k].copy(), directions[k]) for k, values in enumerate(currents)
    ]
    new = Snapshots(solving.solver, nothing)
    known: list[int] = []
    for k, solved in enumerate(solving.training(wanted, needed)):
        if solved is not None:
            new.add(currents[k], solved)
            known.append(k)
    if not known:
        return None
    predicted = solving.solver.charge_density(np.ascontiguousarray(starts[:, known]))
    errors = solving.trial.errors(np.eye(len(known)), predicted, new)
    for values, state in zip(new.currents, new.states, strict=True):
        training.add(values, state)
    return Round(before, errors)


def _share(errors: Errors) -> float:
    return max(errors.flux_density_share, errors.gradient_share / GRADIENT)


def _shares(of_both: Array) -> Array:
    """(s,) of shares (s, 2) of flux density and gradient."""
    return np.asarray(np.maximum(of_both[:, 0], of_both[:, 1] / GRADIENT))


def solve_tried(
    solving: Solving,
    predict: Callable[[Array], Array],
    currents: Array,
    first: int,
    stage: str | None,
    text: str,
    directions: Sequence[Array] | None = None,
    numbers: Sequence[int] | None = None,
    found: Snapshots | None = None,
) -> Snapshots:
    """The states of currents (s, c), numbered from `first`; images are taken where both are among them.

    predict(currents (c,)): nodal potential (n,) to begin from. stage, text: what is told; without a stage the text
    alone. directions: of each, where they may be trained on. numbers: which of them, all if left out; found: those that
    are there already, to add to.
    """
    found = Snapshots(solving.solver, one_of(currents)) if found is None else found
    left, gone = list(range(len(currents)) if numbers is None else numbers), 0
    count = len(left)
    before, batch = solving.states.computed, left

    def tell(done: int) -> None:
        computed = solving.states.computed - before
        message = f"state {gone + done + 1} of {count} {text}"
        if stage is None:
            solving.forecast.note(message)
        else:
            solving.forecast.at(stage, message, computed, computed + len(batch) - done)

    while left:
        batch = different_states(solving.solver, currents, left)
        wanted = [
            Wanted(
                first + k,
                currents[k],
                None if solving.states.known(first + k, currents[k]) else predict(currents[k]),
                None if directions is None else directions[k],
            )
            for k in batch
        ]
        for k, solved in zip(batch, solving.states.solve(wanted, solving.tolerance, tell), strict=True):
            if solved is not None:
                found.add(currents[k], solved)
        # An image of one that failed is solved itself.
        left = [k for k in left if k not in batch and found.number(currents[k]) is None]
        gone = count - len(left)
    return found


def different_states(solver: NonlinearSolver, currents: Array, numbers: Sequence[int]) -> list[int]:
    """Of the states of these numbers, of currents (s, c), those that are images of none before them."""
    chosen: list[int] = []
    taken = np.zeros(len(currents), bool)
    for k in numbers:
        if not taken[k]:
            chosen.append(k)
            for image in solver.images:
                taken |= is_among(image.currents(currents[k]), currents)
    return chosen


def add_missing(modes: SolvedModes, training: Snapshots, tried: Snapshots, accuracy: float) -> Snapshots:
    """Train on those of the tried states that the modes lack; the others, still to try the model on.

    They are solved already, and what a model does not predict must be among its states.
    """
    left = tried.empty(nothing)
    for k in modes.missing(tried, accuracy) if tried.solved else ():
        # It may be the image of one that was just added.
        if training.number(tried.currents[k]) is None:
            training.add(tried.currents[k], tried.state(int(k)))
    for currents, state, own in zip(tried.currents, tried.states, tried.own, strict=True):
        if training.number(currents) is None:
            left.put(currents, state, own)
    return left


@dataclass(frozen=True, eq=False, repr=False)
class Reduction(Record):
    """The iron on modes of solved states, with the law at all points (`modes`) and at sample `points`;
    charge (r, faces): density of the modes on the solver's surface faces, T; flux (r, n, 3) and gradient (r, n, 3, 3):
    of the modes in the workspace, T and T/m."""

    solver: NonlinearSolver
    modes: SolvedModes
    points: Sampled
    charge: Array
    flux: Array
    gradient: Array

    @property
    def sampled(self) -> GalerkinModel:
        """The model at the sample points."""
        return self.points.model

    @property
    def fields(self) -> Array:
        """Flux densities and gradients (r, m) of the modes, both of the same size."""
        return _same_size(self.flux, self.gradient)

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (s, r) at currents (s, c), by the sample points."""
        known, start = self.modes.currents, self.modes.amplitudes

        def solve(values: Array) -> Array:
            return self.sampled.solve(values, start[nearest_of(values, known)])[0]

        found = in_threads(solve, list(currents), threads_of_kernels())
        return np.array([one.result() for one in found]).reshape(len(currents), -1)

    def potential(self, currents: Array) -> Array:
        """Nodal potential (n,) at currents (c,)."""
        return np.asarray(self.modes.basis @ self.amplitudes(currents[None])[0])

    def shares(self, trial: Trial, currents: Array, amplitudes: Array, changes: Array) -> Array:
        """What changes (s, r) of the amplitudes (s, r) change of the fields at currents (s, c), as `_share`."""
        return _shares(trial.shares_of_sums(currents, (self.flux, self.gradient), amplitudes, changes))

    def shortfall(self, trial: Trial, currents: Array) -> Array:
        """How far the model looks to be off at currents (s, c), as `_share`: by the correction that its residual, with
        the law at all points, asks for in unsaturated iron. A measure to compare currents by, not an error."""
        parts = []
        for first in range(0, len(currents), _RANKED):
            some = currents[first : first + _RANKED]
            amplitudes = self.amplitudes(some)
            potential, air = self.modes.basis @ amplitudes.T, self.modes.air @ amplitudes.T
            change = self.solver.charge_density(self.solver.corrections(some, potential, air))
            parts.append(_shares(trial.shares(some, amplitudes @ self.charge, change)))
        return np.concatenate(parts)


def _reduce(solving: Solving, modes: SolvedModes, domain: CurrentDomain, extremes: Array) -> Reduction:
    """Choose the sample points. extremes (m, c): currents that they are tried at, beside others."""
    plan, solver = solving.plan, solving.solver
    charge = solver.charge_density(modes.basis)
    flux, gradient = solving.trial.fields(charge)
    lengths = same_lengths(_same_size(flux, gradient))

    def off(currents: Array, amplitudes: Array, changes: Array) -> Array:
        return _shares(solving.trial.shares_of_sums(currents, (flux, gradient), amplitudes, changes))

    def tell(message: str, share: float) -> None:
        # The first states say nothing of the whole: until they are done, what was expected counts.
        solving.forecast.at("points", message, share if share >= OF_STATES else 0.0)

    known = modes.currents, modes.amplitudes
    rounds = _ROUNDS_IN_VAIN if _in_vain(solving, modes) else ROUNDS
    found = sampled(
        modes.model, known, extremes, domain, lengths, off, plan.accuracy, plan.points, tell, rounds
    )
    return Reduction(solver, modes, found, charge, flux, gradient)


def _in_vain(solving: Solving, modes: SolvedModes) -> bool:
    """Whether as many modes as there may be are too few."""
    plan = solving.plan
    all_taken = modes.model.modes >= plan.modes >= _MOST_MODES
    return all_taken and modes.left > _TOO_FEW_MODES * plan.accuracy


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


def try_extremes(
    sequence: TrainingSequence, domain: CurrentDomain
) -> tuple[Reduction, Snapshots, ExtremesTried]:
    """Solve extremes of the domain, train on those that the model lacks, and reduce: the model, and the solved extremes
    that are left to measure its error."""
    solving, training = sequence.solving, sequence.training
    solver, plan, before = solving.solver, solving.plan, training.solved
    signals = extreme_signals(domain)
    currents = domain.parametrisation.currents(signals)
    directions = [reaches(domain, values) for values in signals]
    different = different_states(solver, currents, range(len(currents)))
    few = len(different) <= _FEW_EXTREMES
    solved = 0

    def solve(
        predict: Callable[[Array], Array], numbers: Sequence[int], found: Snapshots | None
    ) -> Snapshots:
        nonlocal solved
        solved += len(numbers)
        about = (plan.states, "extremes", "at extremes", directions)
        return solve_tried(solving, predict, currents, *about, numbers, found)

    # What is trained on already tells nothing of the error.
    unknown = [k for k in different if training.number(currents[k]) is None]
    modes = _modes(solving, training)
    if few:
        tried = solve(lambda values: modes.basis @ modes.amplitude(values), unknown, None)
        left = add_missing(modes, training, tried, plan.accuracy)
        modes = modes if training.solved == before else _modes(solving, training)
        if modes.left > _TOO_FEW_MODES * plan.accuracy and sequence.more_modes():
            modes = _modes(sequence.solving, training)
        reduction = _reduce(sequence.solving, modes, domain, currents)
    else:
        reduction = _reduce(solving, modes, domain, currents)
        order, looks = _worst_first(solving.trial, reduction, currents, unknown)
        others = np.random.default_rng(_RANDOM_SEED).permutation(order[_WORST:])
        chosen = [*order[:_WORST], *others[:_RANDOM].tolist()]
        left = solve(reduction.potential, chosen, None)
        while True:
            rest = [k for k in order if k not in chosen]
            off = _off(solving.trial, reduction, left)
            worse = _perhaps_worse(left, off, currents, rest, chosen, looks)[: _MOST_SOLVED - len(chosen)]
            if not worse:
                break
            chosen = [*chosen, *worse]
            left = solve(reduction.potential, worse, left)
        if off.max(initial=0.0) > plan.accuracy:
            # Many extremes fall short where one does: they are solved to train on.
            more, rest = rest[: _MOST_SOLVED - len(chosen)], rest[_MOST_SOLVED - len(chosen) :]
            left = solve(reduction.potential, more, left)
            left = add_missing(reduction.modes, training, left, plan.accuracy)
        if training.solved > before:
            reduction = _reduce(solving, _modes(solving, training), domain, currents)
            if rest:
                worst = _worst_first(solving.trial, reduction, currents, rest)[0][:_WORST]
                left = solve(reduction.potential, worst, left)
    trained = training.solved - before
    of_domain = 2 ** len(domain.lower)
    about = ExtremesTried(of_domain, len(currents), len(different), solved, trained, not few)
    return reduction, left, about


def search_worst(
    solving: Solving,
    domain: CurrentDomain,
    reduction: Reduction,
    training: Snapshots,
    number: int,
    before: Snapshots | None = None,
) -> tuple[Snapshots, int]:
    """Solve the states of currents at which the model's residual is largest, numbered from `number`: those states, with
    those of the search before that were not trained on, and at how many currents the residual was looked at.

    The worst of extremes and of currents drawn at random, inside the domain and on its edges; from the ten worst the
    search goes on to random neighbours, nearer each time.
    """
    random = np.random.default_rng(_SEARCH_SEED + number)

    def tell(share: float) -> None:
        solving.forecast.at(
            "search", "the worst currents, by the model's residual", (1.0 - _OF_SOLVES) * share
        )

    shares, looked_at = climbed(
        lambda currents: reduction.shortfall(solving.trial, currents),
        domain,
        np.concatenate(
            [
                random.permutation(_shares_of_extremes(domain))[:_SEARCHED_EXTREMES],
                drawn_shares(domain, _SEARCHED_RANDOM, random),
                edge_shares(domain, _SEARCHED_RANDOM, random),
            ]
        ),
        random,
        tell,
    )
    text = "of the largest residual"
    about = (solving, domain, reduction, training, shares, number, text)
    solved = _solve_found(*about, _SEARCHED_SOLVED)
    if _off(solving.trial, reduction, solved).max(initial=0.0) > _allowed(solving):
        # Many fall short where one does: they are solved to train on.
        solved = _solve_found(*about, len(shares))
    return together(before, solved, training), looked_at


def search_condensed(
    solving: Solving,
    domain: CurrentDomain,
    reduction: Reduction,
    few: Condensed,
    training: Snapshots,
    attempt: int,
) -> Snapshots:
    """Solve the states whose field fewer modes and points change most, sought as in `search_worst`, but from more
    currents, since no state of the solver is needed to look."""
    random = np.random.default_rng(_SEARCH_SEED - 1 - attempt)

    def change(currents: Array) -> Array:
        amplitudes = reduction.amplitudes(currents)
        pairs = list(zip(currents, amplitudes @ few.basis, strict=True))
        found = in_threads(lambda pair: few.model.solve(*pair)[0], pairs, threads_of_kernels())
        changes = np.array([one.result() for one in found]) @ few.basis.T - amplitudes
        return reduction.shares(solving.trial, currents, amplitudes, changes)

    begin = [
        _shares_of_extremes(domain),
        drawn_shares(domain, _SEARCHED_CONDENSED, random),
        edge_shares(domain, _SEARCHED_CONDENSED, random),
    ]
    shares, _ = climbed(change, domain, np.concatenate(begin), random)
    # Behind all numbers of other searches.
    first = _BEHIND_ALL + attempt * len(shares)
    text, most = "that fewer modes change most", _SOLVED_CONDENSED
    return _solve_found(solving, domain, reduction, training, shares, first, text, most)


def _solve_found(
    solving: Solving,
    domain: CurrentDomain,
    reduction: Reduction,
    training: Snapshots,
    shares: Array,
    first: int,
    text: str,
    most: int,
) -> Snapshots:
    """Solve the first of those at shares (s, d) of the ranges that are not trained on, `most` of them, with what it
    takes to train on them; numbers and text: see `solve_tried`."""
    currents = domain.at(shares)
    chosen = _unknown(solving, training, currents)[:most]
    signals = domain.parametrisation.within(domain.lower, domain.upper, shares)
    directions = [reaches(domain, values) for values in signals]
    return solve_tried(solving, reduction.potential, currents, first, None, text, directions, chosen)


def climbed(
    looks: Callable[[Array], Array],
    domain: CurrentDomain,
    shares: Array,
    random: np.random.Generator,
    tell: Callable[[float], None] = lambda share: None,
) -> tuple[Array, int]:
    """Shares (m, d) of the ranges at which looks(currents (s, c)) (s,) is largest, the largest first: from the worst of
    `shares` (s, d) on to random neighbours, nearer each time, and nearer in weak currents, where little changes much;
    and at how many it was looked at."""
    rest = at_rest(domain)
    farthest = np.maximum(rest, 1.0 - rest)
    tell(0.0)
    found, looked_at = looks(domain.at(shares)), len(shares)
    best = np.argsort(-found, kind="stable")[:_STARTS]
    shares, largest = shares[best], found[best]
    for round_number, width in enumerate(_WIDTHS):
        tell((round_number + 1) / (len(_WIDTHS) + 1))
        near = np.repeat(shares, _NEIGHBOURS, axis=0)
        strength = (np.abs(near - rest) / farthest).max(axis=1, keepdims=True)
        near = np.clip(near + width * strength * random.standard_normal(near.shape), 0.0, 1.0)
        found, looked_at = looks(domain.at(near)), looked_at + len(near)
        for k in range(len(shares)):
            own = slice(k * _NEIGHBOURS, (k + 1) * _NEIGHBOURS)
            worst = own.start + int(found[own].argmax())
            if found[worst] > largest[k]:
                shares[k], largest[k] = near[worst], found[worst]
    tell(1.0)
    return shares[np.argsort(-largest, kind="stable")], looked_at


def _shares_of_extremes(domain: CurrentDomain) -> Array:
    return np.asarray((extreme_signals(domain) - domain.lower) / (domain.upper - domain.lower))


def _unknown(solving: Solving, training: Snapshots, currents: Array) -> list[int]:
    """Numbers of the currents (s, c) that are not trained on, without images of those before them."""
    different = different_states(solving.solver, currents, range(len(currents)))
    return [k for k in different if training.number(currents[k]) is None]


def together(before: Snapshots | None, found: Snapshots, training: Snapshots | None = None) -> Snapshots:
    """States found, and those before that are no images, but for those that were trained on meanwhile."""
    both = found.empty(nothing)
    for some in (found, before) if before is not None else (found,):
        for values, state, own in zip(some.currents, some.states, some.own, strict=True):
            known = training is not None and training.number(values) is not None
            if not known and both.number(values) is None and (own or some is found):
                both.put(values, state, own)
    return both


def _modes(solving: Solving, training: Snapshots) -> SolvedModes:
    plan = solving.plan
    return SolvedModes(solving.solver, training, plan.modes, _MODES * plan.accuracy)


def _worst_first(
    trial: Trial, reduction: Reduction, currents: Array, numbers: list[int]
) -> tuple[list[int], dict[int, float]]:
    """Numbers of the currents (s, c) in the order of how far the model looks to be off there, and that."""
    looks = reduction.shortfall(trial, currents[numbers])
    order = np.argsort(-looks, kind="stable")
    return [numbers[k] for k in order], dict(zip(numbers, looks.tolist(), strict=True))


def _perhaps_worse(
    found: Snapshots, off: Array, currents: Array, rest: list[int], solved: list[int], looks: dict[int, float]
) -> list[int]:
    """Of corners that are not solved those whose error may be larger than the largest found, if the error is no more
    times what it looks to be than at any corner solved. off (s,): the errors found."""
    errors = {k: off[place] for k in solved if (place := found.number(currents[k])) is not None}
    if not errors:
        return []
    most = max((error / looks[k] for k, error in errors.items() if looks[k] > 0.0), default=0.0)
    return [k for k in rest if most * looks[k] > max(errors.values())]


def _off(trial: Trial, reduction: Reduction, tried: Snapshots) -> Array:
    """Errors (s,) of the model on solved states, as `_share`."""
    if not tried.solved:
        return np.zeros(0)
    charge = reduction.amplitudes(tried.currents) @ reduction.charge
    change = reduction.solver.charge_density(tried.potentials) - charge
    return _shares(trial.shares(tried.currents, charge + change, change))


def _off_of_modes(solving: Solving, modes: SolvedModes, tried: Snapshots, number: int) -> float:
    """Error at one of the tried states, as `_share`, of modes, with the law at all points."""
    solver = solving.solver
    amplitude = modes.amplitude(tried.currents[number], _EXACT * solving.plan.accuracy)
    potential = modes.basis @ amplitude
    charge = solver.charge_density(np.column_stack([potential, tried.potentials[:, number] - potential]))
    share = solving.trial.shares(tried.currents[number][None], charge.sum(axis=0)[None], charge[1][None])
    return float(_shares(share)[0])


@dataclass(frozen=True)
class Condensation(Record):
    """Modes and sample points that were trained, and what fewer of them change of the field of any state, at most,
    over the accuracy: the largest found."""

    modes: int
    points: int
    changed: float


@dataclass(frozen=True, eq=False, repr=False)
class Trained(Record):
    """A reduced model; charge (k, s): density of its iron fields on the solver's surface faces, T; what it was
    trained on, what was done about the extremes of the domain, and how the other states were chosen; what it was
    condensed from; its errors at solved states, by their kind; the largest weights (c + k,) of the
    map's fields over the domain; and what its error is made of."""

    model: ReducedModel
    charge: Array
    snapshots: Snapshots
    extremes: ExtremesTried
    rounds: tuple[Round, ...]
    condensation: Condensation
    errors: Mapping[str, Errors]
    largest_weights: Array
    parts: "ErrorParts"


def train(
    solver: NonlinearSolver,
    domain: CurrentDomain,
    plan: Plan,
    points: Array,
    reference: Array,
    states: SolvedStates,
    forecast: Forecast,
) -> Trained:
    """Solve, reduce and try. points (n, 3): where the field matters, in the air; reference (c,): the currents at which
    the map states its total field; states: keeps what was solved, so that a stopped run goes on. Raises NotConverged
    if no state at all could be solved."""
    sequence = TrainingSequence(
        Solving(solver, states, Trial(solver, points, domain.largest), plan, forecast), domain
    )
    tries = Tries()
    while True:
        reduction = _trained_and_tried(sequence, domain, tries)
        require_some(tries.found, states)
        found = _condensed_and_tried(sequence, domain, reduction, tries)
        # Where states at random fall short, or too many others do, more of these do not help.
        again = tries.none_short and tries.condensed < _AGAIN_CONDENSED
        short = _fall_short(sequence.solving, reduction, [found.tried[_SEARCHED]]) if again else []
        if not short:
            break
        _train_on(sequence, reduction, short)
        tries.found[_SEARCHED] = found.tried[_SEARCHED]
        tries.condensed += 1
    modes, reduced = reduction.modes, found.few.model
    amplitudes = modes.amplitudes @ found.few.basis
    model = _model(reduced, found.output, modes.currents, amplitudes, domain, reference)
    places = np.concatenate([modes.currents, _places(domain, _WEIGHED)])
    assert tries.extremes is not None
    return Trained(
        model,
        found.charge,
        sequence.training,
        tries.extremes,
        tuple(sequence.rounds),
        Condensation(reduction.sampled.modes, len(reduction.sampled.weights), found.few.changed),
        found.errors,
        _largest_weights(domain, reduced, found.output, places),
        _error_parts(sequence, reduction, found),
    )


class Tries:
    """What a model was tried on while it was trained.

    found: states that it was not trained on, by their kind; extremes: what was done about the extremes; none_short:
    whether all of them came out as they must; searches: how often the worst currents were searched for, and condensed:
    how often states that the search of the condensed model found were trained on.
    """

    def __init__(self) -> None:
        self.found: dict[str, Snapshots] = {}
        self.extremes: ExtremesTried | None = None
        self.none_short = False
        self.searches = self.condensed = 0


def _trained_and_tried(sequence: TrainingSequence, domain: CurrentDomain, tries: Tries) -> Reduction:
    """Train until no state that is tried falls short, or no more may be solved."""
    tried = tries.found
    # States at random fall short, which worst.
    more, worst = not tried, -1
    while True:
        solving = sequence.solving
        plan, allowed = solving.plan, _allowed(solving)
        if more:
            sequence.go_on()
        require_states(solving.states)
        # Sample points are dear: they are not chosen again before the modes hold the state that was worst.
        while (
            more
            and tried
            and not sequence.at_its_end
            and _off_of_modes(solving, _modes(solving, sequence.training), tried["at random"], worst)
            > allowed
        ):
            sequence.go_on()
        reduction, tried["at extremes"], extremes = try_extremes(sequence, domain)
        expect_modes(solving.forecast, len(reduction.sampled.weights), reduction.sampled.modes)
        first, random = plan.states + extremes.looked_at, held_out(domain, plan.held_out)
        tried["at random"] = solve_tried(solving, reduction.potential, random, first, "random", "at random")
        # Four states that happen to be predicted well do not tell that all are: where one of those at random is not,
        # the sequence goes on. They are never trained on.
        off = _off(solving.trial, reduction, tried["at random"])
        more, worst = bool(off.max(initial=0.0) > allowed), int(off.argmax()) if len(off) else -1
        short: list[tuple[Array, Solved]] = []
        # The search is for errors of which neither tells.
        if not more:
            number = first + len(random) + tries.searches * _STARTS
            tried[_SEARCHED], looked_at = search_worst(
                solving, domain, reduction, sequence.training, number, tried.get(_SEARCHED)
            )
            extremes = replace(extremes, searched=looked_at)
            short = _fall_short(solving, reduction, [tried["at extremes"], tried[_SEARCHED]])
            tries.searches += 1
        tries.extremes = extremes if tries.extremes is None else tries.extremes.and_again(extremes)
        tries.none_short = not (more or short)
        in_vain = _in_vain(sequence.solving, reduction.modes)
        at_the_end = in_vain or (more and sequence.at_its_end) or tries.searches >= _AGAIN
        if tries.none_short or at_the_end:
            return reduction
        _train_on(sequence, reduction, short)


def _allowed(solving: Solving) -> float:
    """The largest error at a state that a model was not trained on."""
    return HELD_OUT * solving.plan.accuracy


def _train_on(
    sequence: TrainingSequence, reduction: Reduction, short: Sequence[tuple[Array, Solved]]
) -> None:
    """Train on states that a model lacked, on more modes if it has as many as there may be."""
    if reduction.sampled.modes >= sequence.solving.plan.modes:
        sequence.more_modes()
    for currents, state in short:
        sequence.training.add(currents, state)


@dataclass(frozen=True, eq=False, repr=False)
class CondensedAndTried(Record):
    """A condensed model; output (k, q): the map's fields by its modes; charge (k, s): densities of these fields on the
    surface faces; changed: what condensation changes of a state's field at most, as a share; all states that were
    tried, by their kind, and the errors there."""

    few: Condensed
    output: Array
    charge: Array
    changed: float
    tried: Mapping[str, Snapshots]
    errors: Mapping[str, Errors]


def _condensed_and_tried(
    sequence: TrainingSequence, domain: CurrentDomain, reduction: Reduction, tries: Tries
) -> CondensedAndTried:
    """Condense a model until the states that it changes most come out as they must, or the fault is the model's own."""
    solving, snapshots = sequence.solving, sequence.training
    plan, trial, forecast = solving.plan, solving.trial, solving.forecast
    forecast.at("modes", "fields of the modes")
    combination, of_modes = _fields_of_map(reduction, domain, plan)
    charge = combination @ reduction.charge
    forecast.at("modes", "modes and points that the workspace sees")
    # What is trained on may be off as well, by points and by what is condensed.
    tried = tries.found | {"trained on": snapshots.solved_ones()}
    for number, share in enumerate(_CONDENSED):
        accuracy = share * plan.accuracy
        if _in_vain(solving, reduction.modes):
            few = Condensed(reduction.sampled, np.eye(reduction.sampled.modes), 0.0)
        else:
            few = _condensed(trial, reduction, domain, combination, of_modes, accuracy)
        attempt = tries.condensed * len(_CONDENSED) + number
        found = search_condensed(solving, domain, reduction, few, snapshots, attempt)
        tried[_SEARCHED] = together(tried.get(_SEARCHED), found)
        of_trained = max(float(_off(trial, reduction, some).max(initial=0.0)) for some in tried.values())
        forecast.at("modes", "error on solved states", 0.95)
        output = of_modes @ few.basis
        errors = {
            name: trial.errors(_weights(few.model, output, some.currents), charge, some)
            for name, some in tried.items()
            if some.solved
        }
        # Where the trained model is off by more itself, no other choice helps.
        if of_trained > _allowed(solving) or max(map(_share, errors.values())) <= _allowed(solving):
            break
    return CondensedAndTried(few, output, charge, accuracy * few.changed, tried, errors)


def _fields_of_map(reduction: Reduction, domain: CurrentDomain, plan: Plan) -> tuple[Array, Array]:
    """The iron's fields that the map keeps, as combinations (k, r) of those of the modes, and their weights by those
    of the modes (k, r)."""
    # States that are not solved need fields that those solved do not.
    amplitudes = np.concatenate([reduction.modes.amplitudes, reduction.amplitudes(_places(domain, _WEIGHED))])
    combination, output = output_fields(amplitudes, reduction.fields, plan.fields, _FIELDS * plan.accuracy)
    if len(output) == plan.fields:
        # More than the recipe names where these leave a part of the error that counts.
        leave = max(_FIELDS_AT_MOST * plan.accuracy, _ROUGH_FIELDS)
        more = output_fields(amplitudes, reduction.fields, _MOST_FIELDS, leave)
        combination, output = max((combination, output), more, key=lambda both: len(both[1]))
    return combination, output


def _fall_short(
    solving: Solving, reduction: Reduction, tried: Sequence[Snapshots]
) -> list[tuple[Array, Solved]]:
    """Solved states, images left out, that a model is to be trained on, with their currents: if any is off by more than
    is allowed, all that are off by more than the accuracy."""
    off = [_off(solving.trial, reduction, some) for some in tried]
    if max(of_some.max(initial=0.0) for of_some in off) <= _allowed(solving):
        return []
    found = []
    for some, of_some in zip(tried, off, strict=True):
        lacking = np.flatnonzero(of_some > solving.plan.accuracy)
        found += [(some.currents[k], some.state(int(k))) for k in lacking if some.own[k]]
    return found


@dataclass(frozen=True, repr=False)
class ErrorParts(Record):
    """What the error of a map's model is made of, as shares of B: states, what solved states and their modes leave of
    the worst states tried, with the law at all points; points, the largest change by sample points, and condensation
    that by fewer modes and points.

    taken: how many states, modes, points and fields were trained; limits: of which of them there could not be more.
    modes_leave: of the energy's root of a solved state; in_vain: whether that is too much for any choice of points, so
    that few were tried.
    """

    states: float
    points: float
    condensation: float
    taken: Mapping[str, int]
    limits: tuple[str, ...]
    modes_leave: float
    in_vain: bool


def _error_parts(
    sequence: TrainingSequence, reduction: Reduction, condensed: CondensedAndTried
) -> ErrorParts:
    solving, of_states, of_points = sequence.solving, 0.0, reduction.points.changed
    for some in condensed.tried.values():
        if some.solved:
            off = _off(solving.trial, reduction, some)
            number = int(off.argmax())
            own = _off_of_modes(solving, reduction.modes, some, number)
            # What the law at all points would not leave of the worst state is due to the points.
            of_states, of_points = max(of_states, own), max(of_points, float(off[number]) - own)
    fields = len(condensed.output)
    modes, in_vain = reduction.sampled.modes, _in_vain(solving, reduction.modes)
    taken = {
        "states": sequence.taken,
        "modes": modes,
        "points": len(reduction.sampled.weights),
        "fields": fields,
    }
    at_limit = {
        "states": sequence.at_its_end,
        "modes": modes >= max(solving.plan.modes, _MOST_MODES),
        "points": not (reduction.points.enough or in_vain),
        "fields": fields >= _MOST_FIELDS,
    }
    limits = tuple(name for name, reached in at_limit.items() if reached)
    left = reduction.modes.left
    return ErrorParts(of_states, of_points, condensed.changed, taken, limits, left, in_vain)


def _condensed(
    trial: Trial,
    reduction: Reduction,
    domain: CurrentDomain,
    combination: Array,
    output: Array,
    accuracy: float,
) -> Condensed:
    """The model at the sample points on fewer modes and points, as the fields of the map (k, r) see it, which are
    combinations (k, r) of those of the modes."""
    flux, gradient = (np.tensordot(combination, of, 1) for of in (reduction.flux, reduction.gradient))

    def off(currents: Array, amplitudes: Array, changes: Array) -> Array:
        whole, changed = amplitudes @ output.T, changes @ output.T
        return _shares(trial.shares_of_sums(currents, (flux, gradient), whole, changed))

    lengths = output.T @ same_lengths(_same_size(flux, gradient))
    known = reduction.modes.currents, reduction.modes.amplitudes
    return condensed(reduction.sampled, known, domain, lengths, off, accuracy)


def _same_size(flux: Array, gradient: Array) -> Array:
    """Fields (k, n, 3) and gradients (k, n, 3, 3) of the modes as one row each, both of the same size."""
    length = np.abs(flux).max() / np.abs(gradient).max()
    return np.concatenate([flux.reshape(len(flux), -1), length * gradient.reshape(len(flux), -1)], axis=1)


def _largest_weights(domain: CurrentDomain, reduced: GalerkinModel, output: Array, currents: Array) -> Array:
    """Largest currents (c,) of the domain, exactly, and largest weights (k,) of the iron's fields: those found at
    currents (s, c) all over it, and a margin for the places between."""
    iron = np.abs(_weights(reduced, output, currents)).max(axis=0)
    return np.concatenate([domain.largest, _MARGIN * iron])


def _places(domain: CurrentDomain, count: int) -> Array:
    """Currents (s, c): extremes of the domain, in a random order and at most `count`, and as many that fill it."""
    extremes = np.random.default_rng(_RANDOM_SEED).permutation(extreme_signals(domain))[:count]
    return domain.parametrisation.currents(np.concatenate([extremes, sequence(domain, 0, count)]))


def _weights(reduced: GalerkinModel, output: Array, currents: Array) -> Array:
    """Weights (s, k) of the iron's fields at currents (s, c)."""
    start = np.zeros(output.shape[1])
    return np.array([output @ reduced.solve(values, start)[0] for values in currents])


def require_states(states: SolvedStates) -> None:
    """Raise NotConverged unless at least half of the states were solved."""
    if not states.count or len(states.failed) > states.count:
        raise NotConverged(
            Problem(
                "training of the current dependence",
                "at least half of the states must be solved",
                f"{len(states.failed)} of {states.count + len(states.failed)} failed; the first: "
                f"{next(iter(states.failed.values()))}",
                "make the range of the currents smaller, or refine the mesh",
            )
        )


def require_some(tried: Mapping[str, Snapshots], states: SolvedStates) -> None:
    """Raise NotConverged unless a state was solved that the model can be tried on: a map states its error."""
    if not any(found.solved for found in tried.values()):
        raise NotConverged(
            Problem(
                "training of the current dependence",
                "a state that the model is tried on must be solved",
                f"none; the last to fail: {list(states.failed.values())[-1]}",
                "raise held_out, make the range of the currents smaller, or refine the mesh",
            )
        )


def _model(
    reduced: GalerkinModel,
    output: Array,
    currents: Array,
    amplitudes: Array,
    domain: CurrentDomain,
    reference: Array,
) -> ReducedModel:
    amplitude, _ = reduced.solve(reference, amplitudes[0])
    offset, knots, coefficients = reduced.tables.arrays
    return ReducedModel(
        reduced.gradients,
        reduced.source,
        reduced.weights,
        reduced.law,
        offset,
        knots,
        coefficients,
        reduced.air,
        reduced.constant,
        output,
        currents,
        amplitudes,
        domain.lower,
        domain.upper,
        domain.parametrisation,
        output @ amplitude,
        np.zeros(0) if reduced.fixed is None else reduced.fixed,
    )

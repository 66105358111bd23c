"""From solved states of saturating iron to a reduced model, its fields' charges, and its errors on other states."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from fieldmap.currents import CurrentDomain
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import GalerkinModel, same_lengths
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.recipe import Plan
from fieldmap.maps.training.condensation import Condensed, condensed
from fieldmap.maps.training.cubature import Contributions, empirical_cubature
from fieldmap.maps.training.expected import expect_modes, expect_points, expect_tried, states_needed
from fieldmap.maps.training.model_error import Errors, Trial
from fieldmap.maps.training.modes import SolvedModes, output_fields
from fieldmap.maps.training.states import (
    REACH,
    Snapshots,
    Solved,
    SolvedStates,
    Wanted,
    corner_signals,
    held_out,
    is_among,
    nothing,
    one_of,
    reaches,
    sequence,
    training_signals,
)
from fieldmap.records import Record
from fieldmap.store.reduced_model import ReducedModel
from fieldmap.typing import Array

# States to begin with, of a sequence that fills the domain; then so many at once.
_FIRST, _AT_ONCE = 3, 4
HELD_OUT = 2.0
"""States held out may be off by so many times the accuracy: the rounds try the modes with the law at all points, these
what sample points and the fields of the map make of them, and they are five times as many."""
# States are solved so much better than they are wanted; the tolerance of the solver is a thousand times its residual.
_SOLVED_BETTER = 10.0
# What the modes may leave of a state and the sample points change it by, its energy's root as a share, and what the
# fields of the map may leave of a state's field, over the accuracy.
_MODES, _CUBATURE, _FIELDS = 0.2, 0.4, 0.05
# How much the energy of the error counts that sample points cause, beside its field in the workspace. Without it points
# are chosen that keep the fields of the states that are known, and no others.
_ENERGY = 0.3
# Random projections that tell how much a point adds.
_PROJECTIONS = 8
# The same of the sample points where they say which corners fall short: a state more costs more than some points, and
# the residual tells which corners are worst only where it is the modes that are off there.
_CUBATURE_OF_CORNERS = 0.015
# So many corners, images apart, are all solved. Of more, those that look worst and some at random, then those that may
# be worse than these; if any of them falls short, as many as there may be, and once the model knows what it lacked,
# again those of the others that look worst.
_FEW_CORNERS, _WORST, _RANDOM, _MOST_SOLVED = 16, 8, 4, 64
_RANDOM_SEED = 11
# Corners whose residuals are computed at a time: so many nodal potentials are in memory.
_RANKED = 64
# A gradient may be off by so much more than a flux density, each as a share of its largest.
_GRADIENT = 2.0
# At how many currents of the domain the weights of the iron's fields are looked at, and how much larger they may be in
# between. They are smooth and largest at the rim, where the sequence is densest and the corners are.
_WEIGHED, _MARGIN = 128, 1.1
# Of second-order tetrahedra with four points each.
_POINTS_PER_UNKNOWN = 2.75
# What of the time for the sample points goes into their choice, after the contributions of the states.
_CHOICE = 0.4


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
    predicted by those before.
    """

    def __init__(self, solving: Solving, domain: CurrentDomain) -> None:
        plan = solving.plan
        self.training = Snapshots(solving.solver, domain.holds)
        self.rounds: list[Round] = []
        self._solving, self._domain = solving, domain
        self._off = bool(solving.solver.device.fixed_sources)
        self._signals = training_signals(domain, plan.states, solving.solver.images, self._off)
        self._currents = domain.parametrisation.currents(self._signals)
        self._directions = [reaches(domain, values) for values in self._signals]
        self._done = min(_FIRST, plan.states)
        self._begin()

    @property
    def at_its_end(self) -> bool:
        """Whether no more states may be solved."""
        return self._done >= self._solving.plan.states or not self.training.solved

    def go_on(self) -> None:
        """Solve states until the model has predicted the last of them as accurately as planned, or at the end. They
        were not among those that it knew, so that they say how good it is."""
        plan = self._solving.plan
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
                self._solving, self.training, self._currents[new], self._directions[new], self._done, needed
            )
            self._done += count
            if found is not None:
                self.rounds.append(found)
                if _share(found.errors) <= plan.accuracy:
                    return

    def _begin(self) -> None:
        """Solve the state in the middle, and the two that begin from it and follow its tangents."""
        plan, currents, signals = self._solving.plan, self._currents, self._signals
        needed = states_needed([], [], plan)
        first = self._solving.training([Wanted(0, currents[0], None, self._directions[0])], needed)[0]
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
        for state, solved in zip(others, self._solving.training(others, needed), strict=True):
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
    return max(errors.flux_density_share, errors.gradient_share / _GRADIENT)


def _shares(of_both: Array) -> Array:
    """(s,) of shares (s, 2) of flux density and gradient."""
    return np.asarray(np.maximum(of_both[:, 0], of_both[:, 1] / _GRADIENT))


def solve_tried(
    solving: Solving,
    predict: Callable[[Array], Array],
    currents: Array,
    first: int,
    stage: str,
    text: str,
    directions: Sequence[Array] | None = None,
    numbers: Sequence[int] | None = None,
    found: Snapshots | None = None,
) -> Snapshots:
    """The states of currents (s, c), numbered from `first`; images are taken where both are among them.
    predict(currents (c,)): nodal potential (n,) to begin from. stage, text: what is told. directions: of each, where
    they may be trained on. numbers: which of them, all if left out; found: those that are there already, to add to."""
    found = Snapshots(solving.solver, one_of(currents)) if found is None else found
    left, gone = list(range(len(currents)) if numbers is None else numbers), 0
    count = len(left)
    before, batch = solving.states.computed, left

    def tell(done: int) -> None:
        computed = solving.states.computed - before
        message = f"state {gone + done + 1} of {count} {text}"
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
            training.add(tried.currents[k], tried.states[k])
    for currents, state, own in zip(tried.currents, tried.states, tried.own, strict=True):
        if training.number(currents) is None:
            left.put(currents, state, own)
    return left


@dataclass(frozen=True, eq=False, repr=False)
class Reduction(Record):
    """The iron on modes of solved states, with the law at all points (`modes`) and at sample points (`sampled`);
    charge (r, faces): density of the modes on the solver's surface faces, T; flux (r, n, 3) and gradient (r, n, 3, 3):
    of the modes in the workspace, T and T/m."""

    solver: NonlinearSolver
    modes: SolvedModes
    sampled: GalerkinModel
    charge: Array
    flux: Array
    gradient: Array

    @property
    def fields(self) -> Array:
        """Flux densities and gradients (r, m) of the modes, both of the same size."""
        return _same_size(self.flux, self.gradient)

    def amplitudes(self, currents: Array) -> Array:
        """Amplitudes (s, r) at currents (s, c), by the sample points."""
        known, start = self.modes.currents, self.modes.amplitudes
        near = [int(np.argmin(np.linalg.norm(known - values, axis=1))) for values in currents]
        pairs = zip(currents, near, strict=True)
        return np.array([self.sampled.solve(values, start[k])[0] for values, k in pairs])

    def potential(self, currents: Array) -> Array:
        """Nodal potential (n,) at currents (c,)."""
        return np.asarray(self.modes.basis @ self.amplitudes(currents[None])[0])

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


def _reduce(solving: Solving, modes: SolvedModes, share: float) -> Reduction:
    """Choose the sample points. share: of the accuracy, what they may change a state by."""
    plan, solver = solving.plan, solving.solver
    charge = solver.charge_density(modes.basis)
    of_modes = solving.trial.fields(charge)
    lengths = same_lengths(_same_size(*of_modes))
    pairs = zip(modes.currents, modes.amplitudes, strict=True)
    states = [_contributions(modes.model, values, amplitude, lengths) for values, amplitude in pairs]

    def tell(done: int) -> None:
        message = f"sample points, from state {done + 1} of {len(states)}"
        if done == len(states):
            message = "sample points, their choice"
        solving.forecast.at("points", message, (1.0 - _CHOICE) * done, len(states))

    tell(0)
    chosen, factors = empirical_cubature(states, plan.points, share * plan.accuracy, tell=tell)
    sampled = modes.model.sampled(chosen, factors * modes.model.weights[chosen])
    return Reduction(solver, modes, sampled, charge, *of_modes)


def _contributions(model: GalerkinModel, currents: Array, amplitude: Array, fields: Array) -> Contributions:
    """Of the points to a state's residual, counted by the error that they cause in its fields (r, m) and energy."""
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

    return Contributions(summed, of)


@dataclass(frozen=True)
class CornersTried(Record):
    """What was done about the corners of the domain: how many it has; of how many the model was looked at; how many of
    these are no images of each other; how many of them were solved, and how many of these trained on. by_residual:
    whether those solved were chosen by the residual: the worst, some at random, and all that may be worse still."""

    in_all: int
    looked_at: int
    different: int
    solved: int
    trained_on: int
    by_residual: bool

    def and_again(self, later: "CornersTried") -> "CornersTried":
        """What was done in both, the later one with a model that knew more states."""
        return replace(
            later, solved=max(self.solved, later.solved), trained_on=self.trained_on + later.trained_on
        )


def try_corners(
    solving: Solving, domain: CurrentDomain, training: Snapshots
) -> tuple[Reduction, Snapshots, CornersTried]:
    """Solve corners of the domain, train on those that the model lacks, and reduce: the model, and the solved corners
    that are left to measure its error."""
    solver, plan, before = solving.solver, solving.plan, training.solved
    signals = corner_signals(domain)
    currents = domain.parametrisation.currents(signals)
    directions = [reaches(domain, values) for values in signals]
    different = different_states(solver, currents, range(len(currents)))
    few = len(different) <= _FEW_CORNERS
    solved = 0

    def solve(
        predict: Callable[[Array], Array], numbers: Sequence[int], found: Snapshots | None
    ) -> Snapshots:
        nonlocal solved
        solved += len(numbers)
        about = (plan.states, "corners", "in corners", directions)
        return solve_tried(solving, predict, currents, *about, numbers, found)

    modes = _modes(solving, training)
    if few:
        tried = solve(lambda values: modes.basis @ modes.amplitude(values), different, None)
        left = add_missing(modes, training, tried, plan.accuracy)
        modes = modes if training.solved == before else _modes(solving, training)
        reduction = _reduce(solving, modes, _CUBATURE)
    else:
        reduction = _reduce(solving, modes, _CUBATURE_OF_CORNERS)
        order, looks = _worst_first(solving.trial, reduction, currents, different)
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
            # Many corners fall short where one does: they are solved to train on.
            more, rest = rest[: _MOST_SOLVED - len(chosen)], rest[_MOST_SOLVED - len(chosen) :]
            left = solve(reduction.potential, more, left)
            left = add_missing(reduction.modes, training, left, plan.accuracy)
        if training.solved > before:
            reduction = _reduce(solving, _modes(solving, training), _CUBATURE_OF_CORNERS)
            if rest:
                worst = _worst_first(solving.trial, reduction, currents, rest)[0][:_WORST]
                left = solve(reduction.potential, worst, left)
    in_all, trained = 2 ** len(domain.lower), training.solved - before
    about = CornersTried(in_all, len(currents), len(different), solved, trained, not few)
    return reduction, left, about


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


def _off_of_modes(solving: Solving, training: Snapshots, tried: Snapshots, number: int) -> float:
    """Error at one of the tried states, as `_share`, of the modes of what is known, with the law at all points."""
    solver, modes = solving.solver, _modes(solving, training)
    potential = modes.basis @ modes.amplitude(tried.currents[number])
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
    trained on, what was done about the corners of the domain, and how the other states were chosen; what it was
    condensed from; its errors on states that it was not trained on, by their kind; and the largest weights (c + k,) of
    the map's fields over the domain."""

    model: ReducedModel
    charge: Array
    snapshots: Snapshots
    corners: CornersTried
    rounds: tuple[Round, ...]
    condensation: Condensation
    errors: Mapping[str, Errors]
    largest_weights: Array


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
    trial = Trial(solver, points)
    solving = Solving(solver, states, trial, plan, forecast)
    sequence = TrainingSequence(solving, domain)
    at_random = held_out(domain, plan.held_out)
    of_corners: CornersTried | None = None
    tried: dict[str, Snapshots] = {}
    worst = -1
    while True:
        sequence.go_on()
        require_states(states)
        # Sample points are dear: they are not chosen again before the modes hold the state that was worst.
        while (
            tried
            and not sequence.at_its_end
            and _off_of_modes(solving, sequence.training, tried["at random"], worst)
            > HELD_OUT * plan.accuracy
        ):
            sequence.go_on()
        reduction, in_corners, corners = try_corners(solving, domain, sequence.training)
        expect_modes(forecast, len(reduction.sampled.weights), reduction.sampled.modes)
        of_corners = corners if of_corners is None else of_corners.and_again(corners)
        tried["in corners"] = in_corners
        tried["at random"] = solve_tried(
            solving, reduction.potential, at_random, plan.states + corners.looked_at, "random", "at random"
        )
        # Four states that happen to be predicted well do not tell that all are: where one of those at random is not,
        # the sequence goes on. They are never trained on.
        off = _off(trial, reduction, tried["at random"])
        if sequence.at_its_end or off.max(initial=0.0) <= HELD_OUT * plan.accuracy:
            break
        worst = int(off.argmax())
    modes, snapshots = reduction.modes, sequence.training
    require_states(states)
    require_some(tried, states)
    forecast.at("modes", "fields of the modes")
    combination, output = output_fields(
        modes.amplitudes, reduction.fields, plan.fields, _FIELDS * plan.accuracy
    )
    forecast.at("modes", "modes and points that the workspace sees")
    few = _condensed(trial, reduction, domain, combination, output, plan.accuracy)
    reduced, output = few.model, output @ few.basis
    forecast.at("modes", "error on states not trained on", 0.95)
    model = _model(reduced, output, modes.currents, modes.amplitudes @ few.basis, domain, reference)
    charge = combination @ reduction.charge
    errors = {
        name: trial.errors(_weights(reduced, output, found.currents), charge, found)
        for name, found in tried.items()
        if found.solved
    }
    all_corners = domain.parametrisation.currents(corner_signals(domain))
    largest = _largest_weights(domain, reduced, output, np.concatenate([modes.currents, all_corners]))
    rounds = tuple(sequence.rounds)
    condensation = Condensation(reduction.sampled.modes, len(reduction.sampled.weights), few.changed)
    return Trained(model, charge, snapshots, of_corners, rounds, condensation, errors, largest)


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
    """Largest currents (c,) of the domain, exactly, and largest weights (k,) of the iron's fields: those found at the
    currents (s, c) and at a sequence that fills the domain, and a margin for the places between."""
    places = np.concatenate([currents, domain.parametrisation.currents(sequence(domain, 0, _WEIGHED))])
    iron = np.abs(_weights(reduced, output, places)).max(axis=0)
    return np.concatenate([domain.largest, _MARGIN * iron])


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

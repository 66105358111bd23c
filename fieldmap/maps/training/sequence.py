"""The states to train on: a sequence that fills the domain, solved until the model is accurate enough."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from time import monotonic

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import same_lengths
from fieldmap.maps.forecast import (
    AFTER_EXTREMES,
    AT_ONCE,
    EXTREME,
    FIRST,
    WARM,
    expect_choices,
    expect_tried,
    seconds_of_state,
    states_expected,
    training,
)
from fieldmap.maps.training.currents import REACH, extreme_signals, is_among, reaches, training_signals
from fieldmap.maps.training.model_error import Errors, ModeFields, Trial, larger
from fieldmap.maps.training.modes import SolvedModes
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.reduction import Reduction
from fieldmap.maps.training.sampling import ROUNDS, sampled
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates, Stored, Wanted
from fieldmap.parallel import results_of
from fieldmap.progress import Forecast, rate
from fieldmap.records import Record
from fieldmap.typing import Array

# Extremes that are expected to be solved, where there are more.
_MOST_EXTREMES = 45
# Tolerance of the solver for states, as a multiple of the accuracy. The residual is a thousandth of it.
_SOLVED_BETTER = 10.0
# Allowed projection error of a state onto the modes, in the energy norm, as a multiple of the accuracy; how often it is
# halved at most, if it leaves too large an error of the field of a state.
_MODES, _HALVED = 0.2, 6
# If the projection error of a training state is larger than `_TOO_FEW_MODES` times the accuracy, the limit of the
# recipe is raised to `most_modes_of` the domain. If that is not enough, more states or points do not help and the map
# is refused; the choice of sample points then has `_ROUNDS_IN_VAIN` rounds, which only serve to state the error.
_TOO_FEW_MODES, _ROUNDS_IN_VAIN = 4.0, 2
# Many signals that each saturate their own iron need modes of their own: number of modes for each signal that are
# allowed from the beginning, and after the limit was raised. Few signals have the numbers of the recipe and of `_MOST`.
_MODES_PER_SIGNAL, _MOST_PER_SIGNAL, _MOST = 5, 12, 200
# Tolerance, as a multiple of the accuracy, of a state with the law at all points whose error is measured.
_EXACT = 0.01


@dataclass(frozen=True, repr=False)
class Round(Record):
    """Errors of the model's predictions of new states, before it was trained on them.

    Attributes
    ----------
    solved : number of states that the model was trained on.
    errors : errors of its predictions.
    """

    solved: int
    errors: Errors


class Training:
    """A training in progress: it solves states and holds those that the model is trained on.

    Attributes
    ----------
    known : the states that the model is trained on, with their images.
    rounds : errors of the predictions of each round of the sequence.
    currents : (m, c), of the whole sequence, A.
    taken : number of states of the sequence that were solved or failed.
    most_modes : most modes; the limit of the recipe or of the number of signals, or `most_modes_of` the domain after
        that was too small.
    trial : compares fields at points in the air.
    """

    def __init__(
        self,
        solver: NonlinearSolver,
        domain: CurrentDomain,
        plan: Plan,
        points: Array,
        states: SolvedStates,
        forecast: Forecast,
    ) -> None:
        self.solver, self.domain, self.plan = solver, domain, plan
        self.states, self.forecast = states, forecast
        self.trial = Trial(solver, points, domain.largest)
        self.tolerance = max(plan.tolerance, _SOLVED_BETTER * plan.accuracy)
        self.most_modes = min(
            modes_at_first(plan, domain.parametrisation.signal_count), most_modes_of(domain)
        )
        self._modes_within = _MODES * plan.accuracy
        self.known = Snapshots(solver, domain.holds)
        self.rounds: list[Round] = []
        self._off = bool(solver.device.fixed_sources)
        self._signals = training_signals(domain, plan.states, solver.images, self._off)
        self.currents = domain.parametrisation.currents(self._signals)
        self.taken = min(FIRST, plan.states)
        self.seconds_of_state = seconds_of_state(solver.unknowns, solver.matrix_bytes)
        extremes = domain.parametrisation.currents(extreme_signals(domain))
        self._extremes = min(len(self.different(extremes, range(len(extremes)))), _MOST_EXTREMES)
        # The assembly says nothing of the pace of states.
        forecast.afresh(WARM)
        self._begin()

    @property
    def at_its_end(self) -> bool:
        """Whether no more states may be solved."""
        return self.taken >= self.plan.states or not self.known.solved

    def more_modes(self) -> bool:
        """Raise the limit of modes to `most_modes_of` the domain. Returns whether it was smaller before."""
        before, self.most_modes = self.most_modes, max(self.most_modes, most_modes_of(self.domain))
        return self.most_modes > before

    def go_on(self) -> None:
        """Solve states of the sequence, round by round, until those of a round were predicted within the accuracy.

        The model is trained on the states of a round only after their prediction, so that they measure its error. The
        training also ends when no more states may be solved.
        """
        plan = self.plan
        while not self.at_its_end:
            count, needed = min(AT_ONCE, plan.states - self.taken), self._needed()
            if self.rounds:
                # One more round is expected: only the round after the last state shows that it was enough.
                needed = min(max(needed, self.taken) + AT_ONCE, plan.states)
            found = next_round(self, range(self.taken, self.taken + count), needed)
            self.taken += count
            if found is not None:
                self.rounds.append(found)
                if found.errors.share <= plan.accuracy:
                    break
        self._tell(f"modes of {self.known.solved} states", 0)

    def _tell(self, message: str, left: int) -> None:
        """Tell how far the training is, with so many states left."""
        done, whole = training(self.states.computed, len(self.rounds), left, len(self.solver.images))
        self.forecast.expect("training", self.seconds_of_state * whole)
        self.forecast.at("training", message, done, whole)

    def _needed(self) -> int:
        shares, solved = (
            [found.errors.share for found in self.rounds],
            [found.solved for found in self.rounds],
        )
        images = len(self.solver.images)
        return states_expected(shares, solved, self.plan.states, self.plan.accuracy, images)

    def _begin(self) -> None:
        """Solve the state in the middle of the domain, and the next two, which begin at its linear extrapolation."""
        needed, currents, signals = self._needed(), self.currents, self._signals
        self.solve(range(1), [None], needed)
        starts: list[Array | None] = [None] * (self.taken - 1)
        # There is nothing to extrapolate from if the first state has no field.
        if self.known.solved and (self._off or currents[0].any()):
            first, span = self.known.state(0), self.domain.upper - self.domain.lower
            steps = (signals[1 : self.taken] - signals[0]) / (REACH * span)
            along = first.tangents[:, : len(span)]
            starts = [np.asarray(first.potential + along @ step) for step in steps]
        self.solve(range(1, self.taken), starts, needed)

    def solve(
        self, numbers: range, starts: Sequence[Array | None], needed: int
    ) -> list[Solved | Stored | None]:
        """Solve states of the sequence, and train on those that converge.

        Parameters
        ----------
        numbers
            Of the states in the sequence.
        starts
            Nodal potential (n,) at which each solve begins, or None.
        needed
            Expected number of states of the whole training, for the forecast.

        Returns
        -------
        list[Solved | Stored | None]
            The states; None for one that failed.
        """
        most, forecast, images = self.plan.states, self.forecast, self.solver.images

        def tell(done: int) -> None:
            number, each, nodes = numbers.start + done, self.seconds_of_state, self.solver.unknowns
            expect_tried(forecast, each, self._extremes, self.plan.held_out)
            states = needed * (1 + len(images))
            expect_choices(forecast, each, nodes, states, self.most_modes, self.plan.points)
            pace = rate(self.states.computed, forecast.taken(), "state")
            left = max(needed - number, len(numbers) - done)
            self._tell(f"state {number + 1} of at most {most}{pace}", left)

        wanted = [
            Wanted(k, self.currents[k], start, reaches(self.domain, self._signals[k], self.plan.inductance))
            for k, start in zip(numbers, starts, strict=True)
        ]
        found = self.states.solve(wanted, self.tolerance, tell)
        for state, solved in zip(wanted, found, strict=True):
            if solved is not None:
                self.known.add(state.currents, solved)
        return found

    def solve_tried(
        self,
        predict: Callable[[Array], Array],
        currents: Array,
        first: int,
        text: str,
        stage: str | None = None,
        directions: Sequence[Array] | None = None,
        numbers: Sequence[int] | None = None,
        found: Snapshots | None = None,
    ) -> Snapshots:
        """Solve states to test the model. A state that is an image of another one of them is not solved again.

        Parameters
        ----------
        predict
            predict(currents (c,)) gives the nodal potential (n,) at which the solve begins. It is called from several
            threads.
        currents
            (s, c), A.
        first
            Number of the first of these states in the checkpoint.
        text
            What these states are, for the forecast.
        stage
            Stage of the forecast; only the text is shown unless given.
        directions
            (c, d) for each state, the directions of its tangents, if the model may be trained on it.
        numbers
            Indices of the states to solve; all unless given.
        found
            Solved states to which these are added.
        """
        if found is None:
            found = Snapshots(self.solver, lambda values: bool(is_among(values, currents).any()))
        left, gone = list(range(len(currents)) if numbers is None else numbers), 0
        count = len(left)
        before, batch, begin = self.states.computed, left, monotonic()

        def tell(done: int) -> None:
            computed = self.states.computed - before
            pace = rate(computed, monotonic() - begin, "state")
            message = f"state {gone + done + 1} of {count} {text}{pace}"
            if stage is None:
                self.forecast.note(message)
                return
            each, after = (EXTREME, AFTER_EXTREMES) if stage == "extremes" else (1.0, 0.0)
            whole = each * (computed + len(batch) - done) + after
            if stage == "extremes":
                self.forecast.expect(stage, self.seconds_of_state * whole)
            self.forecast.at(stage, message, each * computed, whole)

        while left:
            batch = self.different(currents, left)
            new = [k for k in batch if self.states.known(first + k, currents[k]) is None]
            starts = dict(zip(new, results_of(lambda k: predict(currents[k]), new), strict=True))
            wanted = [
                Wanted(first + k, currents[k], starts.get(k), None if directions is None else directions[k])
                for k in batch
            ]
            for k, solved in zip(batch, self.states.solve(wanted, self.tolerance, tell), strict=True):
                if solved is not None:
                    found.add(currents[k], solved)
            # An image of one that failed is solved itself.
            left = [k for k in left if k not in batch and found.number(currents[k]) is None]
            gone = count - len(left)
        return found

    def different(self, currents: Array, numbers: Sequence[int]) -> list[int]:
        """Those of `numbers`, rows of currents (s, c), that are not images of earlier ones."""
        chosen: list[int] = []
        taken = np.zeros(len(currents), bool)
        for k in numbers:
            if not taken[k]:
                chosen.append(k)
                for image in self.solver.images:
                    taken |= is_among(image.currents(currents[k]), currents)
        return chosen

    def unknown(self, currents: Array, numbers: Sequence[int]) -> list[int]:
        """Those of `numbers`, rows of currents (s, c), that the model is not trained on: they measure its error."""
        return [k for k in numbers if self.known.number(currents[k]) is None]

    def modes(self) -> SolvedModes:
        """The modes of all states that the model is trained on."""
        return SolvedModes(self.solver, self.known, self.most_modes, self._modes_within)

    def finer_modes(self, currents: Sequence[Array]) -> None:
        """Take more modes, until they represent the fields at these currents within the accuracy.

        The model is trained on these states. Modes are chosen by energy, which does not see where fields cancel: an
        error that is small in the whole iron is large beside what is left in the workspace.
        """
        states = self.known.some(k for i in currents if (k := self.known.number(i)) is not None)
        for _ in range(_HALVED):
            modes = self.modes()
            off = max(self.off_of_modes(modes, states, k) for k in range(len(states.currents)))
            if off <= self.plan.accuracy or modes.model.modes >= self.most_modes:
                break
            self._modes_within *= 0.5

    def too_few(self, modes: SolvedModes) -> bool:
        """Whether the projection error onto the modes is so large that more states and points do not help."""
        return modes.left > _TOO_FEW_MODES * self.plan.accuracy

    def reduce(self, modes: SolvedModes, extremes: Array) -> Reduction:
        """Choose the sample points. extremes (m, c): currents at which they are tested, with others."""
        charge = self.solver.charge_density(modes.basis)
        fields = ModeFields(self.trial, *self.trial.fields(charge))
        in_vain = modes.model.modes >= self.most_modes >= most_modes_of(self.domain) and self.too_few(modes)

        points = sampled(
            modes.model,
            (modes.currents, modes.amplitudes),
            extremes,
            self.domain,
            same_lengths(fields.rows),
            fields.changed,
            self.plan.accuracy,
            self.plan.points,
            partial(self.forecast.at, "points"),
            _ROUNDS_IN_VAIN if in_vain else ROUNDS,
            self.plan.inductance,
        )
        return Reduction(self.solver, modes, points, charge, fields, in_vain)

    def off_of_modes(self, modes: SolvedModes, tried: Snapshots, number: int) -> float:
        """Error of the modes, with the law at all points, at state `number` of `tried`."""
        amplitude = modes.amplitude(tried.currents[number], _EXACT * self.plan.accuracy)
        potential = modes.basis @ amplitude
        pair = np.column_stack([potential, tried.potentials[:, number] - potential])
        charge = self.solver.charge_density(pair)
        share = self.trial.shares(tried.currents[number][None], charge.sum(axis=0)[None], charge[1][None])
        return float(larger(share)[0])


def modes_at_first(plan: Plan, signals: int) -> int:
    """Most modes of a model for so many signals, unless a state falls short."""
    return max(plan.modes, _MODES_PER_SIGNAL * signals)


def most_modes_of(domain: CurrentDomain) -> int:
    """Most modes of a model for these currents."""
    return max(_MOST, _MOST_PER_SIGNAL * domain.parametrisation.signal_count)


def next_round(training: Training, numbers: range, needed: int) -> Round | None:
    """Solve states of the sequence, compare them with the model's predictions, and train on them.

    Returns
    -------
    Round | None
        The errors of the predictions; None if no state converged.
    """
    before, modes = training.known.solved, training.modes()
    currents = training.currents[numbers.start : numbers.stop]
    starts = modes.basis @ np.array(list(results_of(modes.amplitude, list(currents)))).T
    new, known = Snapshots(training.solver), []
    for k, solved in enumerate(training.solve(numbers, list(starts.T.copy()), needed)):
        if solved is not None:
            new.add(currents[k], solved)
            known.append(k)
    if not known:
        return None
    predicted = training.solver.charge_density(np.ascontiguousarray(starts[:, known]))
    return Round(before, training.trial.errors(np.eye(len(known)), predicted, new))

"""The states to train on: of a sequence that fills the domain, solved as far as the model needs them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.reduced import same_lengths
from fieldmap.maps.forecast import Forecast, expect_points, expect_tried, states_needed
from fieldmap.maps.training.currents import REACH, is_among, reaches, training_signals
from fieldmap.maps.training.model_error import Errors, ModeFields, Trial, larger
from fieldmap.maps.training.modes import SolvedModes
from fieldmap.maps.training.plan import Plan
from fieldmap.maps.training.reduction import Reduction
from fieldmap.maps.training.sampling import OF_STATES, ROUNDS, sampled
from fieldmap.maps.training.states import Snapshots, Solved, SolvedStates, Wanted
from fieldmap.records import Record
from fieldmap.typing import Array

# States to begin with, of a sequence that fills the domain; then so many at once.
_FIRST, _AT_ONCE = 3, 4
# States are solved so much better than they are wanted; the tolerance of the solver is a thousand times its residual.
_SOLVED_BETTER = 10.0
# What the modes may leave of a state, its energy's root as a share, over the accuracy.
_MODES = 0.2
# What the recipe's modes may grow to where they leave so many times the accuracy of a state that they are made of, in
# the norm of the energy. Where these leave as much, no states or points help: the map is refused, and what it would be
# off is found with as many rounds of the choice of sample points.
MOST_MODES, _TOO_FEW_MODES, _ROUNDS_IN_VAIN = 200, 4.0, 2
# How exactly a state with the law at all points is solved, over the accuracy, where its error is asked.
_EXACT = 0.01
# Of second-order tetrahedra with four points each.
_POINTS_PER_UNKNOWN = 2.75


@dataclass(frozen=True, repr=False)
class Round(Record):
    """How far what the model predicted of some states was off when they were solved, and how many it knew by then."""

    solved: int
    errors: Errors


class Training:
    """What solves states, and those that a model is trained on.

    known: states that are solved, with their images, and what is added to them; rounds: how well each four of the
    sequence were predicted by those before; currents (m, c): of the whole sequence; taken: how many of them were asked
    for; most_modes: the recipe's, or more where these are too few; trial: the places (n, 3) in the air at which fields
    are compared.
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
        self.most_modes = plan.modes
        self.known = Snapshots(solver, domain.holds)
        self.rounds: list[Round] = []
        self._off = bool(solver.device.fixed_sources)
        self._signals = training_signals(domain, plan.states, solver.images, self._off)
        self.currents = domain.parametrisation.currents(self._signals)
        self.taken = min(_FIRST, plan.states)
        self._begin()

    @property
    def at_its_end(self) -> bool:
        """Whether no more states may be solved."""
        return self.taken >= self.plan.states or not self.known.solved

    def more_modes(self) -> bool:
        """Train on as many modes as there may be from now on, the recipe's are too few; whether these are more."""
        before, self.most_modes = self.most_modes, max(self.most_modes, MOST_MODES)
        return self.most_modes > before

    def go_on(self) -> None:
        """Solve states until the model has predicted the last of them as accurately as planned, or at the end. They
        were not among those that it knew, so that they say how good it is."""
        plan = self.plan
        while not self.at_its_end:
            count, needed = min(_AT_ONCE, plan.states - self.taken), self._needed()
            if self.rounds:
                # A round that is tried on the states before it tells that these were enough.
                needed = min(max(needed, self.taken) + _AT_ONCE, plan.states)
            found = next_round(self, range(self.taken, self.taken + count), needed)
            self.taken += count
            if found is not None:
                self.rounds.append(found)
                if found.errors.share <= plan.accuracy:
                    return

    def _needed(self) -> int:
        shares, solved = (
            [found.errors.share for found in self.rounds],
            [found.solved for found in self.rounds],
        )
        return states_needed(shares, solved, self.plan.states, self.plan.accuracy)

    def _begin(self) -> None:
        """Solve the state in the middle, and the two that begin from it and follow its tangents."""
        needed, currents, signals = self._needed(), self.currents, self._signals
        self.solve(range(1), [None], needed)
        starts: list[Array | None] = [None] * (self.taken - 1)
        # If there is any field in the first.
        if self.known.solved and (self._off or currents[0].any()):
            first, span = self.known.state(0), self.domain.upper - self.domain.lower
            steps = (signals[1 : self.taken] - signals[0]) / (REACH * span)
            starts = [np.asarray(first.potential + first.tangents @ step) for step in steps]
        self.solve(range(1, self.taken), starts, needed)

    def solve(self, numbers: range, starts: Sequence[Array | None], needed: int) -> list[Solved | None]:
        """Solve states of the sequence from nodal potentials (n,), and train on those that could be. needed: how many
        will be, about."""
        most, forecast, images = self.plan.states, self.forecast, self.solver.images

        def tell(done: int) -> None:
            number, computed = numbers.start + done, self.states.computed
            left = max(needed - number, len(numbers) - done)
            forecast.at("training", f"state {number + 1} of at most {most}", computed, computed + left)
            if computed and left:
                per_state = (forecast.expected("training") - forecast.taken()) / left
                expect_tried(forecast, self.plan.held_out, per_state)
            points = round(_POINTS_PER_UNKNOWN * self.solver.unknowns)
            expect_points(forecast, points, self.most_modes, needed * (1 + len(images)))

        wanted = [
            Wanted(k, self.currents[k], start, reaches(self.domain, self._signals[k]))
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
        """The states of currents (s, c), numbered from `first`; images are taken where both are among them.

        predict(currents (c,)): nodal potential (n,) to begin from. stage, text: what is told; without a stage the text
        alone. directions: of each, where they may be trained on. numbers: which of them, all if left out; found: those
        that are there already, to add to.
        """
        if found is None:
            found = Snapshots(self.solver, lambda values: bool(is_among(values, currents).any()))
        left, gone = list(range(len(currents)) if numbers is None else numbers), 0
        count = len(left)
        before, batch = self.states.computed, left

        def tell(done: int) -> None:
            computed = self.states.computed - before
            message = f"state {gone + done + 1} of {count} {text}"
            if stage is None:
                self.forecast.note(message)
            else:
                self.forecast.at(stage, message, computed, computed + len(batch) - done)

        while left:
            batch = self.different(currents, left)
            wanted = [
                Wanted(
                    first + k,
                    currents[k],
                    None if self.states.known(first + k, currents[k]) else predict(currents[k]),
                    None if directions is None else directions[k],
                )
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
        """Of the states of these numbers, of currents (s, c), those that are images of none before them."""
        chosen: list[int] = []
        taken = np.zeros(len(currents), bool)
        for k in numbers:
            if not taken[k]:
                chosen.append(k)
                for image in self.solver.images:
                    taken |= is_among(image.currents(currents[k]), currents)
        return chosen

    def unknown(self, currents: Array, numbers: Sequence[int]) -> list[int]:
        """Of these, those that are not trained on: such a state tells nothing of the error."""
        return [k for k in numbers if self.known.number(currents[k]) is None]

    def modes(self) -> SolvedModes:
        """Of all that is known."""
        return SolvedModes(self.solver, self.known, self.most_modes, _MODES * self.plan.accuracy)

    def too_few(self, modes: SolvedModes) -> bool:
        """Whether modes leave so much that states and points do not help."""
        return modes.left > _TOO_FEW_MODES * self.plan.accuracy

    def reduce(self, modes: SolvedModes, extremes: Array) -> Reduction:
        """Choose the sample points. extremes (m, c): currents that they are tried at, beside others."""
        charge = self.solver.charge_density(modes.basis)
        fields = ModeFields(self.trial, *self.trial.fields(charge))
        in_vain = modes.model.modes >= self.most_modes >= MOST_MODES and self.too_few(modes)

        def tell(message: str, share: float) -> None:
            # The first states say nothing of the whole: until they are done, what was expected counts.
            self.forecast.at("points", message, share if share >= OF_STATES else 0.0)

        points = sampled(
            modes.model,
            (modes.currents, modes.amplitudes),
            extremes,
            self.domain,
            same_lengths(fields.rows),
            fields.changed,
            self.plan.accuracy,
            self.plan.points,
            tell,
            _ROUNDS_IN_VAIN if in_vain else ROUNDS,
        )
        return Reduction(self.solver, modes, points, charge, fields, in_vain)

    def off_of_modes(self, modes: SolvedModes, tried: Snapshots, number: int) -> float:
        """Error at one of the tried states of modes, with the law at all points."""
        amplitude = modes.amplitude(tried.currents[number], _EXACT * self.plan.accuracy)
        potential = modes.basis @ amplitude
        pair = np.column_stack([potential, tried.potentials[:, number] - potential])
        charge = self.solver.charge_density(pair)
        share = self.trial.shares(tried.currents[number][None], charge.sum(axis=0)[None], charge[1][None])
        return float(larger(share)[0])


def next_round(training: Training, numbers: range, needed: int) -> Round | None:
    """Solve some states of the sequence, see how well they were predicted, and train on them. needed: see
    `Training.solve`."""
    before, modes = training.known.solved, training.modes()
    currents = training.currents[numbers.start : numbers.stop]
    starts = modes.basis @ np.array([modes.amplitude(values) for values in currents]).T
    new, known = Snapshots(training.solver), []
    for k, solved in enumerate(training.solve(numbers, list(starts.T.copy()), needed)):
        if solved is not None:
            new.add(currents[k], solved)
            known.append(k)
    if not known:
        return None
    predicted = training.solver.charge_density(np.ascontiguousarray(starts[:, known]))
    return Round(before, training.trial.errors(np.eye(len(known)), predicted, new))

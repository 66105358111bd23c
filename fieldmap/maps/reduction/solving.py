"""The states that a model is trained on, chosen as they are solved, and those that it is tried on."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron import NonlinearSolver
from fieldmap.maps.reduction.domain import CurrentDomain
from fieldmap.maps.reduction.greedy import Proposal, SolvedModes
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.reduction.snapshots import Snapshots, nothing, one_of
from fieldmap.maps.reduction.states import SolvedStates
from fieldmap.maps.reduction.trial import Errors, Trial

Array = NDArray[np.float64]
Say = Callable[[str, float], None]
# States to begin with, of a sequence that fills the domain; then so many at once, of a pool of so many.
_FIRST, _AT_ONCE, _POOL = 8, 8, 32
# A gradient may be off by so much more than a flux density, each as a share of its largest.
_GRADIENT = 2.0


@dataclass(frozen=True, eq=False)
class Solving:
    """What solves states: the solver, the archive, where fields are compared, and whom to tell."""

    solver: NonlinearSolver
    states: SolvedStates
    trial: Trial
    plan: Plan
    say: Say

    def one(
        self,
        number: int,
        currents: Array,
        start: Array | None,
        where: tuple[str, float],
        estimate: float = np.nan,
    ) -> Array | None:
        """Potential (n,) of a state, or None where the solver fails. where: text and share of the progress."""
        self.say(*where)
        return self.states.solve(self.solver, number, currents, self.plan.tolerance, start, estimate)

    def choose(self, modes: SolvedModes, pool: Array, first: int, count: int) -> Proposal:
        """The states numbered from `first`: those in the archive, or chosen of a pool."""
        kept = [self.states.archive.get(first + k) for k in range(count)]
        known = [state for state in kept if state is not None]
        if len(known) < count:
            return modes.propose(pool, count)
        starts = np.zeros((len(modes.basis), count))
        return Proposal(np.array([s.currents for s in known]), np.array([s.estimate for s in known]), starts)


@dataclass(frozen=True)
class Round:
    """What one choice of states showed: how many had been solved before, and how far what the model foretold of the
    next ones was off when they were solved."""

    solved: int
    estimate: float
    errors: Errors


def solve_training(solving: Solving, domain: CurrentDomain) -> tuple[Snapshots, tuple[Round, ...]]:
    """States to train on. After the first few, those that the estimate says the model lacks most; no more once the
    model foretells them as accurately as planned."""
    plan, training = solving.plan, Snapshots(solving.solver, domain.holds)
    for number, currents in enumerate(domain.sequence(0, min(_FIRST, plan.states))):
        where = f"state {number + 1} of at most {plan.states}", 0.05 + 0.4 * number / plan.states
        potential = solving.one(number, currents, training.nearest(currents), where)
        if potential is not None:
            training.add(currents, potential)
    done = _FIRST
    rounds: list[Round] = []
    while done < plan.states and training.solved:
        solving.say(f"choosing states after {done}", 0.05 + 0.4 * done / plan.states)
        pool = domain.sequence(_FIRST + _POOL * len(rounds), _POOL)
        count = min(_AT_ONCE, plan.states - done)
        found = _round(solving, training, pool, done, count)
        done += count
        if found is not None:
            rounds.append(found)
            if _share(found.errors) <= plan.accuracy:
                break
    return training, tuple(rounds)


def _round(solving: Solving, training: Snapshots, pool: Array, done: int, count: int) -> Round | None:
    """Choose states, solve them, see how well they were foretold, and add them."""
    before, plan = training.solved, solving.plan
    modes = SolvedModes(solving.solver, training, plan.modes)
    proposal = solving.choose(modes, pool, done, count)
    new = Snapshots(solving.solver, nothing)
    chosen = zip(proposal.currents, proposal.starts.T, proposal.estimates, strict=True)
    for number, (currents, start, estimate) in enumerate(chosen, done):
        where = f"state {number + 1} of at most {plan.states}", 0.05 + 0.4 * number / plan.states
        potential = solving.one(number, currents, start, where, float(estimate))
        if potential is not None:
            new.add(currents, potential)
    if not new.solved:
        return None
    amplitudes = np.array([modes.amplitude(currents) for currents in new.currents])
    errors = solving.trial.errors(amplitudes, modes.model.charge, new)
    for currents, potential in zip(new.currents, new.potentials.T, strict=True):
        training.add(currents, np.ascontiguousarray(potential))
    return Round(before, float(proposal.estimates[0]), errors)


def _share(errors: Errors) -> float:
    return max(errors.flux_density_share, errors.gradient_share / _GRADIENT)


def solve_tried(
    solving: Solving, modes: SolvedModes, currents: Array, first: int, text: str, share: float
) -> Snapshots:
    """The states of currents (s, c), numbered from `first`; images are taken where both are among them."""
    found = Snapshots(solving.solver, one_of(currents))
    for k, values in enumerate(currents):
        if found.number(values) is not None:
            continue
        known = solving.states.archive.get(first + k, values) is not None
        start = None if known else modes.basis @ modes.amplitude(values)
        where = f"state {k + 1} of {len(currents)} {text}", share + 0.2 * k / len(currents)
        potential = solving.one(first + k, values, start, where)
        if potential is not None:
            found.add(values, potential)
    return found


def add_missing(modes: SolvedModes, training: Snapshots, tried: Snapshots, accuracy: float) -> Snapshots:
    """Train on those of the tried states that the modes lack; the others, still to try the model on.

    They are solved already, and what a model does not foretell it had better know.
    """
    left = tried.empty(nothing)
    for k in modes.missing(tried, accuracy) if tried.solved else ():
        # It may be the image of one that was just added.
        if training.number(tried.currents[k]) is None:
            training.add(tried.currents[k], np.ascontiguousarray(tried.potentials[:, k]))
    for currents, potential in zip(tried.currents, tried.potentials.T, strict=True):
        if training.number(currents) is None:
            left.add(currents, np.ascontiguousarray(potential))
    return left

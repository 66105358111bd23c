"""The states that a model is trained on, chosen as they are solved, and those that it is tried on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.maps.reduction.domain import sequence
from fieldmap.maps.reduction.greedy import Proposal, SolvedModes
from fieldmap.maps.reduction.plan import Plan
from fieldmap.maps.reduction.snapshots import Snapshots, is_among, nothing, one_of
from fieldmap.maps.reduction.states import SolvedStates, Wanted
from fieldmap.maps.reduction.trial import Errors, Trial
from fieldmap.typing import Array

Say = Callable[[str, float], None]
# States to begin with, of a sequence that fills the domain; then so many at once, of a pool of so many.
_FIRST, _AT_ONCE, _POOL = 8, 8, 32
# A gradient may be off by so much more than a flux density, each as a share of its largest.
_GRADIENT = 2.0


@dataclass(frozen=True, eq=False)
class Solving:
    """What solves states: the solver, the archive and the workers, where fields are compared, and whom to tell."""

    solver: NonlinearSolver
    states: SolvedStates
    trial: Trial
    plan: Plan
    say: Say

    def training(self, wanted: Sequence[Wanted]) -> list[Array | None]:
        """Potential (n,) of every state, or None where the solver fails; numbers as those of the states to train on."""
        first, most = wanted[0].number if wanted else 0, self.plan.states

        def tell(done: int) -> None:
            self.say(f"state {first + done + 1} of at most {most}", 0.05 + 0.4 * (first + done) / most)

        return self.states.solve(wanted, self.plan.tolerance, tell)

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
    first = sequence(domain, 0, min(_FIRST, plan.states))
    middle = solving.training([Wanted(0, first[0])])
    # The others begin from the one in the middle, if that carries any current.
    start = middle[0] if first[0].any() else None
    others = [Wanted(number, currents, start) for number, currents in enumerate(first[1:], 1)]
    for currents, potential in zip(first, middle + solving.training(others), strict=True):
        if potential is not None:
            training.add(currents, potential)
    done = _FIRST
    rounds: list[Round] = []
    while done < plan.states and training.solved:
        solving.say(f"choosing states after {done}", 0.05 + 0.4 * done / plan.states)
        pool = sequence(domain, _FIRST + _POOL * len(rounds), _POOL)
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
    chosen = zip(proposal.currents, proposal.starts.T, proposal.estimates.tolist(), strict=True)
    wanted = [Wanted(number, *state) for number, state in enumerate(chosen, done)]
    for currents, potential in zip(proposal.currents, solving.training(wanted), strict=True):
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
    left, gone = list(range(len(currents))), 0

    def tell(done: int) -> None:
        solving.say(
            f"state {gone + done + 1} of {len(currents)} {text}", share + 0.2 * (gone + done) / len(currents)
        )

    while left:
        batch = _no_images_of_each_other(solving.solver, left, currents)
        wanted = [_from_modes(solving, modes, first + k, currents[k]) for k in batch]
        for k, potential in zip(
            batch, solving.states.solve(wanted, solving.plan.tolerance, tell), strict=True
        ):
            if potential is not None:
                found.add(currents[k], potential)
        # An image of one that failed is solved itself.
        left = [k for k in left if k not in batch and found.number(currents[k]) is None]
        gone = len(currents) - len(left)
    return found


def _no_images_of_each_other(solver: NonlinearSolver, numbers: list[int], currents: Array) -> list[int]:
    """Of the states of these numbers those that are images of none before them."""
    chosen: list[int] = []
    for k in numbers:
        images = [image.currents(currents[j]) for j in chosen for image in solver.images]
        if not images or not is_among(currents[k], np.array(images)).any():
            chosen.append(k)
    return chosen


def _from_modes(solving: Solving, modes: SolvedModes, number: int, currents: Array) -> Wanted:
    """A state that begins from what the modes say of it, unless it is there already."""
    known = solving.states.archive.get(number, currents) is not None
    return Wanted(number, currents, None if known else modes.basis @ modes.amplitude(currents))


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

"""The long part of training: one nonlinear solve per state, each kept as soon as it is there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import monotonic

import numpy as np

from fieldmap.iron import NonlinearSolver
from fieldmap.parallel import Common, Outcome, WorkerDied, Workers
from fieldmap.store.states import KeptState, StateArchive
from fieldmap.typing import Array

# Not the state's fault: another day, or another machine, and it is solved.
_OF_THE_MACHINE = (WorkerDied, MemoryError, OSError)


@dataclass(frozen=True, eq=False)
class Wanted:
    """A state to solve: its number, currents (c,), nodal potential (n,) to begin from, and how much it is needed,
    which is kept with it. Where it begins must not depend on which others happen to be solved already."""

    number: int
    currents: Array
    start: Array | None = None
    estimate: float = float("nan")


@dataclass
class SolvedStates:
    """Solves states, or takes them from the archive where they are there already.

    failed: number of the state -> why it could not be solved; count: states that were; earlier_seconds and
    earlier_processor_seconds: what those from the archive took in the runs that solved them.
    """

    archive: StateArchive
    solver: Common[NonlinearSolver]
    workers: Workers
    failed: dict[int, str] = field(default_factory=dict)
    count: int = 0
    earlier_seconds: float = 0.0
    earlier_processor_seconds: float = 0.0

    def solve(
        self, wanted: Sequence[Wanted], tolerance: float, tell: Callable[[int], None]
    ) -> list[Array | None]:
        """Nodal potential (n,) of every state, in their order; None where it could not be solved.

        tell(k) is called once k of them are there and others are not.
        """
        found = [self.archive.get(state.number, state.currents) for state in wanted]
        for kept in found:
            if kept is not None:
                self.earlier_seconds += kept.seconds
                self.earlier_processor_seconds += kept.processor_seconds
        missing = [k for k, kept in enumerate(found) if kept is None]
        items = [(wanted[k].currents, tolerance, wanted[k].start) for k in missing]
        done, begin = len(wanted) - len(missing), monotonic()
        if missing:
            tell(done)
        for outcome in self.workers.map(_potential, items, self.solver):
            number = missing[outcome.index]
            found[number] = self._keep(wanted[number], outcome, monotonic() - begin)
            done, begin = done + 1, monotonic()
            if done < len(wanted):
                tell(done)
        return [self._potential(state, kept) for state, kept in zip(wanted, found, strict=True)]

    def _keep(self, state: Wanted, outcome: Outcome[Array], seconds: float) -> KeptState:
        """seconds: since the state before; of several at a time each counts its share."""
        if isinstance(outcome.error, _OF_THE_MACHINE):
            raise outcome.error
        values = outcome.reason or outcome.result()
        kept = KeptState(state.currents, values, seconds, outcome.processor_seconds, state.estimate)
        self.archive.put(state.number, kept)
        return kept

    def _potential(self, state: Wanted, kept: KeptState | None) -> Array | None:
        assert kept is not None
        if isinstance(kept.values, str):
            self.failed[state.number] = kept.values
            return None
        self.count += 1
        return kept.values


def _potential(solver: NonlinearSolver, item: tuple[Array, float, Array | None]) -> Array:
    currents, tolerance, start = item
    return np.ascontiguousarray(solver.solve(currents, tolerance, start=start).state.potential[:, 0])

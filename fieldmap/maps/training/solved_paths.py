"""Paths along which iron with hysteresis is solved by the full solver, and how they are kept."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from time import monotonic
from typing import Any

import numpy as np

from fieldmap.device.model import Device
from fieldmap.histories import history_of_currents
from fieldmap.iron import HysteresisSolver, IronMemory
from fieldmap.maps.training.paths import CurrentPath
from fieldmap.parallel import Common, Workers
from fieldmap.progress import Forecast, rate
from fieldmap.records import Record
from fieldmap.store import Checkpoint
from fieldmap.typing import Array


class PathSolver:
    """A solver, and the memory of its iron after each history that ends at currents `level` (c,)."""

    def __init__(self, device: Device, refinement: float, level: Array) -> None:
        self.solver, self.level = HysteresisSolver(device, None, refinement), level

    @cached_property
    def _shaken(self) -> IronMemory:
        memory = self.solver.demagnetised
        for currents in history_of_currents("shaken", self.level):
            memory = self.solver.step(currents, memory).memory
        return memory

    def memory(self, history: str) -> IronMemory:
        """The memory where a path begins."""
        return self._shaken if history == "shaken" else self.solver.demagnetised

    def solve(self, path: CurrentPath, tolerance: float) -> tuple[Array, dict[str, Any]]:
        """Nodal potentials (s, n) at the ends of the steps, and the report of the last step."""
        memory, potentials = self.memory(path.history), []
        for currents in path.currents:
            state = self.solver.step(currents, memory, tolerance)
            memory = state.memory
            potentials.append(memory.potential)
        return np.array(potentials), asdict(state.report)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedPath(Record):
    """A path, nodal potentials (s, n) at the ends of its steps, and the solver's report of the last step."""

    path: CurrentPath
    potentials: Array
    report: dict[str, Any]


class SolvedPaths:
    """Solves paths, or takes them from the checkpoint if they are there already.

    Attributes
    ----------
    count : number of states that were solved.
    earlier_seconds, earlier_processor_seconds : time that earlier runs took for paths from the checkpoint.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        solver: Common[PathSolver],
        workers: Workers,
        tolerance: float,
        forecast: Forecast,
    ) -> None:
        self._checkpoint, self._solver, self._workers = checkpoint, solver, workers
        self._tolerance, self._forecast = tolerance, forecast
        self.count = 0
        self.earlier_seconds = self.earlier_processor_seconds = 0.0

    def solve(self, paths: Sequence[CurrentPath], stage: str, most: int) -> list[SolvedPath]:
        """Solve paths. Their states are numbered on from those of the calls before.

        stage: of the forecast; most: number of states that it is expected to take in all.
        """
        first, started = self.count, monotonic()
        begin = started
        *numbers, self.count = np.cumsum([first, *(len(path.currents) for path in paths)]).tolist()
        tried = {
            k: self._known(number, path) for k, (number, path) in enumerate(zip(numbers, paths, strict=True))
        }
        found = {k: solved for k, solved in tried.items() if solved is not None}
        missing = [k for k in tried if k not in found]

        def tell() -> None:
            if len(found) < len(paths):
                done = sum(len(solved.path.currents) for solved in found.values())
                pace = rate(done, monotonic() - started, "state")
                text = f"state {first + done + 1} on, along paths of the currents{pace}"
                before = first if stage == "training" else 0
                self._forecast.at(stage, text, before + done, max(most, before + done + 1))

        tell()
        items = [(paths[k], self._tolerance) for k in missing]
        for outcome in self._workers.map(_solved, items, self._solver):
            k = missing[outcome.index]
            potentials, report = outcome.result()
            costs = (monotonic() - begin, outcome.processor_seconds)
            begin = monotonic()
            arrays = {"currents": paths[k].currents, "potentials": potentials}
            about = {"history": paths[k].history, "report": report, "costs": costs}
            self._checkpoint.put(_key(numbers[k]), arrays, about)
            found[k] = SolvedPath(paths[k], potentials, report)
            tell()
        return [found[k] for k in range(len(paths))]

    def _known(self, number: int, path: CurrentPath) -> SolvedPath | None:
        piece = self._checkpoint.get(_key(number))
        if piece is None or piece.about["history"] != path.history:
            return None
        if not np.array_equal(piece.arrays["currents"], path.currents):
            return None
        seconds, processor_seconds = piece.about["costs"]
        self.earlier_seconds += seconds
        self.earlier_processor_seconds += processor_seconds
        return SolvedPath(path, piece.arrays["potentials"], dict(piece.about["report"]))


def _key(number: int) -> str:
    """By the number of the path's first state."""
    return f"path from state {number}"


def _solved(solver: PathSolver, item: tuple[CurrentPath, float]) -> tuple[Array, dict[str, Any]]:
    return solver.solve(*item)

"""Ways of the currents along which iron that remembers is solved, by the full solver, and how they are kept."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from time import monotonic
from typing import Any

import numpy as np

from fieldmap.device.model import Device
from fieldmap.histories import history_of_currents
from fieldmap.iron.solvers.hysteresis import HysteresisSolver, IronMemory
from fieldmap.maps.forecast import Forecast
from fieldmap.maps.training.states import Solved
from fieldmap.maps.training.ways import Way
from fieldmap.parallel import Common, Workers
from fieldmap.records import Record
from fieldmap.store import Checkpoint
from fieldmap.typing import Array


class WayLeader:
    """A solver, and what its iron remembers of each history that ends at currents `level` (c,)."""

    def __init__(self, device: Device, refinement: float, level: Array) -> None:
        self.solver, self.level = HysteresisSolver(device, None, refinement), level

    @cached_property
    def _shaken(self) -> IronMemory:
        memory = self.solver.demagnetised
        for currents in history_of_currents("shaken", self.level):
            memory = self.solver.step(currents, memory).memory
        return memory

    def memory(self, history: str) -> IronMemory:
        """Where a way begins."""
        return self._shaken if history == "shaken" else self.solver.demagnetised

    def lead(self, way: Way, tolerance: float) -> tuple[Array, dict[str, Any]]:
        """Nodal potentials (s, n) at the ends of the steps, and the report of the last."""
        memory, potentials = self.memory(way.history), []
        for currents in way.currents:
            state = self.solver.step(currents, memory, tolerance)
            memory = state.memory
            potentials.append(memory.potential)
        return np.array(potentials), asdict(state.report)


@dataclass(frozen=True, eq=False, repr=False)
class SolvedWay(Record):
    """A way, nodal potentials (s, n) at the ends of its steps, and the solver's report of the last."""

    way: Way
    potentials: Array
    report: dict[str, Any]

    @property
    def states(self) -> list[tuple[Array, Solved]]:
        """Currents (c,) and state at the end of each step."""
        nothing = np.zeros((self.potentials.shape[1], 0))
        return [
            (currents, Solved(potential, nothing, nothing))
            for currents, potential in zip(self.way.currents, self.potentials, strict=True)
        ]


class SolvedWays:
    """Solves ways, or takes them from the checkpoint where they are already.

    Attributes
    ----------
    count : number of states that were solved.
    earlier_seconds, earlier_processor_seconds : time that earlier runs took for ways from the checkpoint.
    """

    def __init__(
        self,
        checkpoint: Checkpoint,
        leader: Common[WayLeader],
        workers: Workers,
        tolerance: float,
        forecast: Forecast,
    ) -> None:
        self._checkpoint, self._leader, self._workers = checkpoint, leader, workers
        self._tolerance, self._forecast = tolerance, forecast
        self.count = 0
        self.earlier_seconds = self.earlier_processor_seconds = 0.0

    def solve(self, ways: Sequence[Way], stage: str, most: int) -> list[SolvedWay]:
        """Solve ways in the order of their numbers: those after the ways that were asked for before.

        stage: of the forecast; most: number of states that the stage is expected to take in all.
        """
        first, begin = self.count, monotonic()
        found: dict[int, SolvedWay] = {}
        missing, places = [], np.cumsum([first, *(len(way.currents) for way in ways)])

        def tell() -> None:
            done = sum(len(way.way.currents) for way in found.values())
            text = f"states {first + done + 1} on of ways of the currents"
            self._forecast.at(stage, text, first + done if stage == "training" else done, max(most, done + 1))

        for k, way in enumerate(ways):
            known = self._known(int(places[k]), way)
            if known is None:
                missing.append(k)
            else:
                found[k] = known
        if missing:
            tell()
        items = [(ways[k], self._tolerance) for k in missing]
        for outcome in self._workers.map(_led, items, self._leader):
            k = missing[outcome.index]
            potentials, report = outcome.result()
            costs = (monotonic() - begin, outcome.processor_seconds)
            begin = monotonic()
            arrays = {"currents": ways[k].currents, "potentials": potentials}
            about = {"history": ways[k].history, "report": report, "costs": costs}
            self._checkpoint.put(_key(int(places[k])), arrays, about)
            found[k] = SolvedWay(ways[k], potentials, report)
            if len(found) < len(ways):
                tell()
        self.count = int(places[-1])
        return [found[k] for k in range(len(ways))]

    def _known(self, number: int, way: Way) -> SolvedWay | None:
        piece = self._checkpoint.get(_key(number))
        if piece is None or piece.about["history"] != way.history:
            return None
        if not np.array_equal(piece.arrays["currents"], way.currents):
            return None
        seconds, processor_seconds = piece.about["costs"]
        self.earlier_seconds += seconds
        self.earlier_processor_seconds += processor_seconds
        return SolvedWay(way, piece.arrays["potentials"], dict(piece.about["report"]))


def _key(number: int) -> str:
    """By the number of the way's first state."""
    return f"way from state {number}"


def _led(leader: WayLeader, item: tuple[Way, float]) -> tuple[Array, dict[str, Any]]:
    return leader.lead(*item)

"""The long part of training: one nonlinear solve per state, each kept as soon as it is there."""

from dataclasses import dataclass, field
from time import monotonic, process_time

import numpy as np
from numpy.typing import NDArray

from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.store.states import KeptState, StateArchive

Array = NDArray[np.float64]


@dataclass
class SolvedStates:
    """Solves states one by one, or takes them from the archive where they are there already.

    failed: number of the state -> why it could not be solved; count: states that were; earlier_seconds and
    earlier_processor_seconds: what those from the archive took in the runs that solved them.
    """

    archive: StateArchive
    failed: dict[int, str] = field(default_factory=dict)
    count: int = 0
    earlier_seconds: float = 0.0
    earlier_processor_seconds: float = 0.0

    def solve(
        self,
        solver: NonlinearSolver,
        number: int,
        currents: Array,
        tolerance: float,
        start: Array | None,
        estimate: float = float("nan"),
    ) -> Array | None:
        """Nodal potential (n,) at currents (c,), begun from `start` (n,); None where the solver did not converge.

        estimate: kept with the state.
        """
        kept = self.archive.get(number, currents)
        if kept is None:
            begin, processor = monotonic(), process_time()
            values: Array | str
            try:
                values = solver.solve(currents, tolerance, start=start).state.potential[:, 0]
            except NotConverged as error:
                values = str(error)
            costs = (monotonic() - begin, process_time() - processor)
            kept = KeptState(currents, values, *costs, estimate)
            self.archive.put(number, kept)
        else:
            self.earlier_seconds += kept.seconds
            self.earlier_processor_seconds += kept.processor_seconds
        if isinstance(kept.values, str):
            self.failed[number] = kept.values
            return None
        self.count += 1
        return kept.values

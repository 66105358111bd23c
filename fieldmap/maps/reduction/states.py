"""The long part of training: one nonlinear solve per state, each kept as soon as it is there."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from fieldmap.errors import NotConverged
from fieldmap.iron import NonlinearSolver
from fieldmap.maps.reduction.basis import proper_modes
from fieldmap.store.states import StateArchive

Array = NDArray[np.float64]
Say = Callable[[str, float], None]
# With so many states solved, a reduced model of them foretells the next ones; it is renewed as they double.
_RENEWED_AT = (8, 16, 32, 64, 128)


@dataclass
class SolvedStates:
    """Solves lists of states, from the archive where they are there already.

    failed: number of the state -> why it could not be solved; seconds: of solving, this run.
    """

    archive: StateArchive
    failed: dict[int, str] = field(default_factory=dict)
    seconds: float = 0.0

    def solve_all(self, solver: NonlinearSolver, currents: Array, tolerance: float, say: Say) -> Array:
        """Nodal potentials (s, n) at currents (s, c); rows of NaN where the solver did not converge."""
        rows: list[Array] = []

        @cache
        def model(count: int) -> Callable[[Array], Array] | None:
            return _foretelling(solver, currents[:count], np.array(rows[:count])) if count else None

        for number, values in enumerate(currents):
            say(f"state {number + 1} of {len(currents)}", 0.05 + 0.85 * number / len(currents))

            def start(number: int = number, values: Array = values) -> Array | None:
                foretell = model(max((n for n in _RENEWED_AT if n <= number), default=0))
                return foretell(values) if foretell else _nearest(values, currents[:number], rows)

            rows.append(self._one(solver, number, values, tolerance, start))
        return np.array(rows)

    def _one(
        self,
        solver: NonlinearSolver,
        number: int,
        values: Array,
        tolerance: float,
        start: Callable[[], Array | None],
    ) -> Array:
        kept = self.archive.get(number, values)
        if kept is None:
            begin = monotonic()
            try:
                kept = solver.solve(values, tolerance, start=start()).state.potential[:, 0]
            except NotConverged as error:
                kept = str(error)
            self.seconds += monotonic() - begin
            self.archive.put(number, values, kept)
        if isinstance(kept, str):
            self.failed[number] = kept
            return np.full(solver.unknowns, np.nan)
        return kept


def _nearest(values: Array, currents: Array, rows: list[Array]) -> Array | None:
    """The potential of the nearest solved state, scaled in proportion to the currents."""
    good = [k for k, row in enumerate(rows) if np.isfinite(row).all() and currents[k].any()]
    if not good:
        return None
    best = min(good, key=lambda k: float(np.linalg.norm(currents[k] - values)))
    return rows[best]


def _foretelling(solver: NonlinearSolver, currents: Array, rows: Array) -> Callable[[Array], Array] | None:
    good = np.isfinite(rows).all(axis=1)
    if good.sum() < 2:
        return None
    first = int(np.flatnonzero(good)[0])
    energy = solver.energy_operator(currents[first], rows[first])
    basis = proper_modes(rows[good].T, energy, len(rows))
    model = solver.project(basis)
    known = rows[good] @ energy(basis)

    def potential(values: Array) -> Array:
        near = int(np.argmin(np.linalg.norm(currents[good] - values, axis=1)))
        return np.asarray(basis @ model.solve(values, known[near])[0])

    return potential

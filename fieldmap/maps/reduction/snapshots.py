"""Solved states, and with them their images under the symmetry of the iron."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fieldmap.iron import NonlinearSolver
from fieldmap.typing import Array

# Currents that differ by less than this share of the largest are the same state.
_SAME = 1e-9


class Snapshots:
    """Currents and nodal potentials, in the order in which they came; an image costs no solve.

    admits(currents (c,)): whether an image is wanted; solved: how many states are no images.
    """

    def __init__(self, solver: NonlinearSolver, admits: Callable[[Array], bool]) -> None:
        self._solver, self._images, self._admits = solver, solver.images, admits
        self._currents: list[Array] = []
        self._potentials: list[Array] = []
        self.solved = 0

    @property
    def currents(self) -> Array:
        """(s, c), A."""
        return np.array(self._currents)

    @property
    def potentials(self) -> Array:
        """Nodal potentials (n, s)."""
        return np.array(self._potentials).T

    def add(self, currents: Array, potential: Array) -> None:
        """A state of currents (c,) and potential (n,), and its images."""
        self._currents.append(currents)
        self._potentials.append(potential)
        for image in self._images:
            values = image.currents(currents)
            if self.number(values) is None and self._admits(values):
                self._currents.append(values)
                self._potentials.append(image.potential(potential))
        self.solved += 1

    def empty(self, admits: Callable[[Array], bool]) -> "Snapshots":
        """No states yet, of the same solver."""
        return Snapshots(self._solver, admits)

    def number(self, currents: Array) -> int | None:
        """Which state has these currents (c,)."""
        if not self._currents:
            return None
        same = is_among(currents, self.currents)
        return int(same.argmax()) if same.any() else None

    def nearest(self, currents: Array) -> Array | None:
        """Potential (n,) of the state nearest to currents (c,) that carries any."""
        if not self._currents:
            return None
        away = np.linalg.norm(self.currents - currents, axis=1)
        best = int(np.where(np.abs(self.currents).max(axis=1) > 0, away, np.inf).argmin())
        return self._potentials[best] if self._currents[best].any() else None


def is_among(currents: Array, states: Array) -> NDArray[np.bool_]:
    """Which of the states' currents (s, c) are currents (c,), up to rounding."""
    return np.asarray(np.abs(states - currents).max(axis=1) <= _SAME * np.abs(states).max(initial=0.0))


def one_of(states: Array) -> Callable[[Array], bool]:
    """Whether currents (c,) are among those of the states (s, c)."""
    return lambda currents: bool(is_among(currents, states).any())


def nothing(currents: Array) -> bool:
    """No image."""
    return False

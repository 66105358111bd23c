"""A solution that holds for one set of currents, in the place of a field that takes any."""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array


class _State(Protocol):
    @property
    def coil_names(self) -> tuple[str, ...]: ...

    @property
    def currents(self) -> Array: ...

    def field(self, points: ArrayLike) -> Array: ...

    def gradient(self, points: ArrayLike) -> Array: ...


class FixedCurrents:
    """A state of saturating iron, which knows its currents, behind `field(points, currents)`.

    state: anything with `coil_names`, `currents` (n_coils,) in A, `field(points)` and `gradient(points)`. Other
    currents than those of the state raise InputError: saturating iron does not superpose.

    Example::

        state = FixedCurrents(fieldmap.solve(device, currents))
        found = find_equilibrium(DifferencedField(state, lower, upper), currents, device.payload)
    """

    def __init__(self, state: _State) -> None:
        self.state = state

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.state.coil_names

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""
        self._check(currents)
        return self.state.field(points)

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        self._check(currents)
        return self.state.gradient(points)

    def _check(self, currents: ArrayLike) -> None:
        if not np.array_equal(np.asarray(currents, dtype=float), self.state.currents):
            raise InputError(
                Problem(
                    "FixedCurrents(currents)",
                    "must be the currents of the state: saturating iron does not superpose",
                    f"{np.asarray(currents).tolist()}, while the state holds {self.state.currents.tolist()}",
                    "solve a state at these currents",
                )
            )

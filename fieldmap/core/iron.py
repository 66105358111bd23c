"""A reduced model of saturating iron as the C core solves it: from currents to the weights of a map's fields."""

from typing import Any

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

FOUND: int = LIBRARY.OK
NOT_FINITE: int = LIBRARY.NOT_FINITE
BEYOND: int = LIBRARY.IRON_BEYOND
NOT_CONVERGED: int = LIBRARY.IRON_NOT_CONVERGED
"""Status of a solve: found; a current is not finite; currents outside the domain; too many steps."""

MOST_STEPS: int = LIBRARY.IRON_STEPS
"""Largest number of steps of a solve."""


class CoreIron:
    """A model as an array (`fieldmap.core.iron_numbers`). It is read-only, so any number of states may use it."""

    def __init__(self, numbers: Array) -> None:
        self.numbers = numbers
        self._model = LIBRARY.iron_of_numbers(numbers)

    def state(self) -> "IronState":
        """Return a new state for the solves of one thread."""
        return IronState(LIBRARY.iron_state(self._model))

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreIron, (self.numbers,)


class IronState:
    """Memory of solves: the last states, from which a solve nearby begins. For one thread at a time."""

    def __init__(self, state: Any) -> None:
        self.state = state

    def solve(
        self,
        currents: Array,
        weights: Array,
        slopes: Array | None = None,
        *,
        tolerance: float,
        checked: bool = False,
        fresh: bool = False,
    ) -> int:
        """Fill weights (n_fields,) at currents (c,), and slopes (n_fields, c), their derivatives, 1/A. Returns the
        status; results are NaN unless it is FOUND.

        tolerance: relative error of the state in the energy norm; a hundredth of it is used for slopes. checked:
        whether currents outside the domain are refused. fresh: do not begin from the last states.
        """
        return int(LIBRARY.iron_solve(self.state, currents, tolerance, checked, fresh, weights, slopes))

    def linkages(
        self,
        currents: Array,
        linkages: Array,
        inductance: Array | None,
        *,
        tolerance: float,
        fresh: bool = False,
    ) -> int:
        """Fill linkages (c,), mu0 times the flux linkages of the iron at currents (c,), T^2 m^3/A, and inductance (c,
        c), their derivatives, T^2 m^3/A^2, for which the tolerance is a hundredth. Returns the status. Unless it is
        FOUND, linkages are NaN and inductance is not filled. fresh: as for `solve`."""
        return int(LIBRARY.iron_linkages(self.state, currents, tolerance, fresh, linkages, inductance))

    def step(self, currents: Array, weights: Array, *, tolerance: float) -> int:
        """Go straight to currents (c,), and fill weights (n_fields,) there. Returns the status. If it is FOUND, the
        cells of iron with hysteresis remember the state; otherwise weights are NaN."""
        return int(LIBRARY.iron_step(self.state, currents, tolerance, weights))

    @property
    def remembered(self) -> Array:
        """The memory (n,) on which later solves and steps depend."""
        return LIBRARY.iron_remembered(self.state)

    def recall(self, remembered: Array) -> None:
        """Restore a memory (n,) of `remembered`: later results are the same to the last bit."""
        LIBRARY.iron_recall(self.state, remembered)

    def solve_in(self, applied: Array, amplitudes: Array, *, tolerance: float) -> int:
        """Solve in the field `applied` (3 p,) of coils and background at the points, T, from a first guess in
        amplitudes (r,), which the result replaces. Returns the status; unless it is FOUND, they are the last iterate
        or NaN."""
        return int(LIBRARY.iron_solve_in(self.state, applied, amplitudes, tolerance))

    @property
    def amplitudes(self) -> Array:
        """Amplitudes of the modes (r,) in the last state."""
        return LIBRARY.iron_amplitudes(self.state)[0]

    @property
    def left(self) -> float:
        """Estimated relative error of the last solve."""
        return float(LIBRARY.iron_amplitudes(self.state)[1])

    @property
    def steps(self) -> int:
        """Number of steps of the last solve."""
        return int(LIBRARY.iron_amplitudes(self.state)[2])


def last_currents(remembered: Array, coils: int) -> Array:
    """Return the currents (c,) of the last state in a memory of `IronState.remembered`; zero if there is none."""
    passed: int = LIBRARY.IRON_PASSED
    # Three numbers come first, then the currents of the last states, newest last.
    return remembered[3 + (passed - 1) * coils : 3 + passed * coils].copy()


def heat_of(remembered: Array) -> float:
    """Return the total heat of the steps in a memory of `IronState.remembered`, times mu0, T^2 m^3."""
    # The number of states and the error of the last solve come first.
    return float(remembered[2])


def continued(aim: Array, passed: Array, amplitudes: Array) -> Array:
    """Return the amplitudes (r,) from which a solve at currents `aim` (c,) begins after n <= 3 states with currents
    `passed` (n, c) and amplitudes (n, r), newest last."""
    return LIBRARY.iron_continued(aim, passed, amplitudes)

"""A reduced model of saturating iron as the C core solves it: from currents to the weights of a map's fields."""

from typing import Any

from fieldmap.core.library import LIBRARY
from fieldmap.typing import Array

FOUND: int = LIBRARY.OK
NOT_FINITE: int = LIBRARY.NOT_FINITE
BEYOND: int = LIBRARY.IRON_BEYOND
NOT_CONVERGED: int = LIBRARY.IRON_NOT_CONVERGED
"""What a solve says: it was found; a current is no number; currents beyond the domain; too many steps."""

MOST_STEPS: int = LIBRARY.IRON_STEPS
"""After which a solve gives up."""


class CoreIron:
    """A model that lies in numbers (`fieldmap.core.iron_numbers`). It is never written to, so that any number of states
    may use it."""

    def __init__(self, numbers: Array) -> None:
        self.numbers = numbers
        self._model = LIBRARY.iron_of_numbers(numbers)

    def state(self) -> "IronState":
        """What the solves of one thread remember, nothing yet."""
        return IronState(LIBRARY.iron_state(self._model))

    def __reduce__(self) -> tuple[Any, ...]:
        return CoreIron, (self.numbers,)


class IronState:
    """What solves remember: the last states, from which one near them begins. For one thread at a time."""

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
        """Fill weights (n_fields,) at currents (c,), and slopes (n_fields, c), their derivatives, 1/A; the status. NaN
        unless it is FOUND.

        tolerance: what the solve may leave of the state, in the norm of the energy; for slopes a hundredth of it.
        checked: whether currents beyond the domain are refused. fresh: begin from nothing.
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
        """Fill linkages (c,), the flux linkages that the iron adds at currents (c,), T^2 m^3/A, which is mu0 times
        Wb, and inductance (c, c), their derivatives, T^2 m^3/A^2, which makes the solve a hundred times more exact; the
        status. NaN and nothing unless it is FOUND. fresh: as for `solve`."""
        return int(LIBRARY.iron_linkages(self.state, currents, tolerance, fresh, linkages, inductance))

    def step(self, currents: Array, weights: Array, *, tolerance: float) -> int:
        """Go straight to currents (c,), after which the cells of iron with hysteresis remember the state; fill weights
        (n_fields,) there; the status. NaN unless it is FOUND: then the cells remember where the way ended."""
        return int(LIBRARY.iron_step(self.state, currents, tolerance, weights))

    @property
    def remembered(self) -> Array:
        """Numbers (n,) on which later solves and steps depend."""
        return LIBRARY.iron_remembered(self.state)

    def recall(self, remembered: Array) -> None:
        """Go on as the state of this model did that remembered these numbers (n,), to the last bit."""
        LIBRARY.iron_recall(self.state, remembered)

    def solve_in(self, applied: Array, amplitudes: Array, *, tolerance: float) -> int:
        """Solve in the field `applied` (3 p,) of coils and background at the points, T, from amplitudes (r,), which
        those found replace; the status. Unless it is FOUND they are those after the last step, or NaN."""
        return int(LIBRARY.iron_solve_in(self.state, applied, amplitudes, tolerance))

    @property
    def amplitudes(self) -> Array:
        """Of the modes (r,) in the last state."""
        return LIBRARY.iron_amplitudes(self.state)[0]

    @property
    def left(self) -> float:
        """What the last solve left of the state, estimated."""
        return float(LIBRARY.iron_amplitudes(self.state)[1])

    @property
    def steps(self) -> int:
        """How many steps the last solve took."""
        return int(LIBRARY.iron_amplitudes(self.state)[2])


def last_currents(remembered: Array, coils: int) -> Array:
    """Currents (c,) of the last state among numbers of `IronState.remembered`; zero where there is none."""
    passed: int = LIBRARY.IRON_PASSED
    # Behind three numbers lie the currents of the last states, the last one last.
    return remembered[3 + (passed - 1) * coils : 3 + passed * coils].copy()


def heat_of(remembered: Array) -> float:
    """What the steps behind numbers of `IronState.remembered` turned into heat, times mu0, T^2 m^3."""
    # Behind how many states there are and what the last solve left.
    return float(remembered[2])


def continued(aim: Array, passed: Array, amplitudes: Array) -> Array:
    """The amplitudes (r,) with which a solve at currents `aim` (c,) begins behind n states passed, 3 at most: their
    currents (n, c) and amplitudes (n, r), newest last."""
    return LIBRARY.iron_continued(aim, passed, amplitudes)

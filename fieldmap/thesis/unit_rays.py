"""The drive unit along rays of currents, all in one proportion: quadratic interpolation between solved states."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.errors import OutsideMapError, Problem
from fieldmap.thesis.unit_states import LOWER, UPPER, UnitStates
from fieldmap.typing import Array

PANELS = (
    (1.0, 1.558, 2.2),
    (1.558, 2.2, 3.0),
    (3.0, 3.6, 4.3),
    (3.6, 4.3, 5.2),
)
"""Mean currents, A, at which states on a ray are solved; the next panel begins where one is left: at 1.558 A, which is
(7-18) at z_s = 10 mm, at 3.0 and at 4.3 A."""
_ENDS = (1.558, 3.0, 4.3, 5.2)
WORDS = (
    "solved states of their own for these currents (shipped mesh), quadratic in the current level between "
    "1.0, 1.558, 2.2, 3.0, 3.6, 4.3 and 5.2 A, harmonic polynomials of degree 5 between nodes 4 mm apart"
)


class UnitRays:
    """A `LevitationField` of the drive unit for mean currents of 1.0 to 5.2 A in any proportion.

    A state whose currents were solved is taken itself. Raises OutsideMapError beyond the levels.
    """

    def __init__(self, states: UnitStates) -> None:
        self.states = states
        self.coil_names, self.lower, self.upper = states.coil_names, LOWER, UPPER

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self._sum("field", points, currents)

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self._sum("gradient", points, currents)

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self._sum("second_gradient", points, currents)

    def _sum(self, what: str, points: ArrayLike, currents: ArrayLike) -> Array:
        amperes = np.asarray(currents, dtype=float)
        mean = float(amperes.mean())
        levels = _panel(mean)
        weights = _lagrange(levels, mean)
        fields = [
            getattr(self.states.at(amperes * (level / mean)), what)(points, [1.0])
            for level, weight in zip(levels, weights, strict=True)
            if weight != 0.0
        ]
        return np.asarray(np.tensordot(weights[weights != 0.0], fields, axes=1))


def _panel(mean: float) -> Array:
    """The three levels between which a mean current is interpolated."""
    if not PANELS[0][0] - 1e-9 <= mean <= PANELS[-1][-1] + 1e-9:
        must = f"must lie within {PANELS[0][0]:g} to {PANELS[-1][-1]:g} A"
        raise OutsideMapError(Problem("mean current", must, f"{mean:g} A", "ask for another level"))
    return np.array(PANELS[int(np.searchsorted(_ENDS, mean - 1e-9))])


def _lagrange(levels: Array, mean: float) -> Array:
    """Weights of the parabola through three levels; at a level, that one alone."""
    if (near := np.abs(levels - mean) < 1e-9).any():
        return near.astype(float)
    return np.array([np.prod([(mean - b) / (a - b) for b in levels if b != a]) for a in levels])

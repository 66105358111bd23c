"""The currents that a map is made for, and the states that are solved to train and to try it."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from fieldmap.device.current_division import divide_currents

Array = NDArray[np.float64]
# Beyond this many corners only the low-discrepancy states are solved.
_MOST_CORNERS = 64
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261


@dataclass(frozen=True, eq=False)
class CurrentDomain:
    """A box of parameters, lower (d,) to upper (d,), and the currents that belong to them.

    The parameters are the currents themselves, A; or, where `division_exponent` n is given, u in A, x and y of the
    division of six currents (`fieldmap.device.current_division`, thesis (6-2), (6-3)).
    """

    lower: Array
    upper: Array
    division_exponent: float | None = None

    @property
    def middle(self) -> Array:
        """Currents (c,) in the middle."""
        return self.currents(0.5 * (self.lower + self.upper))

    def currents(self, parameters: Array) -> Array:
        """Currents (..., c) of parameters (..., d)."""
        if self.division_exponent is None:
            return parameters
        u, x, y = np.moveaxis(parameters, -1, 0)
        return divide_currents(u, x, y, self.division_exponent)

    def training(self, count: int) -> Array:
        """Currents (count, c): the middle, corners (a quarter at most), then a low-discrepancy sequence (Sobol)."""
        corners = self._corners()[: max(0, count // 4)]
        power = int(np.ceil(np.log2(max(2, count))))
        shares = qmc.Sobol(len(self.lower), seed=_SEED).random_base2(power)
        middle = np.full((1, len(self.lower)), 0.5)
        return self._at(np.concatenate([middle, corners, shares])[:count])

    def held_out(self, count: int) -> Array:
        """Currents (count, c) to try a trained model at: every third a corner, the others at random."""
        shares = np.random.default_rng(_HELD_OUT_SEED).random((count, len(self.lower)))
        corners = self._corners()[::-1]
        for k in range(0, count, 3):
            if k // 3 < len(corners):
                shares[k] = corners[k // 3]
        return self._at(shares)

    def corners(self) -> Array:
        """Currents (m, c) of the corners, at most 64, in an order that spreads them."""
        return self._at(self._corners())

    def _corners(self) -> Array:
        d = len(self.lower)
        if 2**d > _MOST_CORNERS:
            return np.empty((0, d))
        signs = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
        return signs[np.random.default_rng(_ORDER_SEED).permutation(len(signs))]

    def _at(self, shares: Array) -> Array:
        return self.currents(self.lower + shares * (self.upper - self.lower))

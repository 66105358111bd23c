"""The currents that a map is made for, and the states that are solved to train it."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

Array = NDArray[np.float64]
# Beyond this many coils the corners are too many; the low-discrepancy states must do.
_MOST_CORNERS = 64
_HELD_OUT_SEED = 20261


@dataclass(frozen=True, eq=False)
class CurrentBox:
    """Independent currents: lower (c,) to upper (c,), A."""

    lower: Array
    upper: Array

    @property
    def middle(self) -> Array:
        """Centre of the box (c,)."""
        return 0.5 * (self.lower + self.upper)

    def at(self, share: Array) -> Array:
        """Currents (n, c) for shares (n, c) between 0 and 1."""
        return self.lower + share * (self.upper - self.lower)

    def training(self, count: int) -> Array:
        """Currents (count, c): the middle, some corners, then a low-discrepancy sequence (Sobol).

        The first states of a longer list are those of a shorter one of the same eighth part of corners.
        """
        corners = self.corners()[: max(0, count // 4)]
        power = int(np.ceil(np.log2(max(2, count))))
        shares = qmc.Sobol(len(self.lower), seed=3).random_base2(power)
        states = np.concatenate([self.middle[None], corners, self.at(shares)])
        return states[:count]

    def corners(self) -> Array:
        """Corners (m, c) in an order that spreads them, at most 64."""
        c = len(self.lower)
        if 2**c > _MOST_CORNERS:
            return np.empty((0, c))
        signs = np.array(list(itertools.product((0.0, 1.0), repeat=c)))
        order = np.random.default_rng(7).permutation(len(signs))
        return self.at(signs[order])

    def held_out(self, count: int) -> Array:
        """Currents (count, c) to try a trained model at: every third a corner, the others at random."""
        random = np.random.default_rng(_HELD_OUT_SEED)
        states = self.at(random.random((count, len(self.lower))))
        corners = self.corners()[::-1]
        for k in range(0, count, 3):
            if k // 3 < len(corners):
                states[k] = corners[k // 3]
        return states

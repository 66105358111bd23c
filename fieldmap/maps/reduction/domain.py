"""The currents that a map is made for, and the states that are solved to train and to try it."""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from fieldmap.device.current_division import divide_currents, undivide_currents
from fieldmap.typing import Array

# Beyond this many corners only the low-discrepancy states are solved.
_MOST_CORNERS = 64
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261
# Currents may leave the domain by this share of its range: rounding.
_ROUNDING = 1e-9


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

    @property
    def largest(self) -> Array:
        """Largest size of every current (c,); a current of a division is linear in each of its signals."""
        if self.division_exponent is None:
            return np.maximum(np.abs(self.lower), np.abs(self.upper))
        return np.asarray(np.abs(self.corners()).max(axis=0))

    def sequence(self, first: int, count: int) -> Array:
        """Currents (count, c), from number `first` on, of a sequence that fills the domain evenly: the middle, then low
        discrepancy (Sobol), denser towards the faces, where a model has neighbours on one side only."""
        power = int(np.ceil(np.log2(max(2, first + count))))
        shares = qmc.Sobol(len(self.lower), seed=_SEED).random_base2(power)
        middle = np.full((1, len(self.lower)), 0.5)
        spread = np.concatenate([middle, 0.5 - 0.5 * np.cos(np.pi * shares)])
        return self._at(spread[first : first + count])

    def held_out(self, count: int) -> Array:
        """Currents (count, c) at random, uniform over the domain, to try a trained model at."""
        return self._at(np.random.default_rng(_HELD_OUT_SEED).random((count, len(self.lower))))

    def corners(self) -> Array:
        """Currents (m, c) of the corners; none where there are more than 64."""
        return self._at(self._corners())

    def holds(self, currents: Array) -> bool:
        """Whether currents (c,) lie in the domain, up to rounding."""
        values = currents
        if self.division_exponent is not None:
            if currents.mean() == 0.0:
                return False
            found = undivide_currents(currents, self.division_exponent)
            if found.mismatch > _ROUNDING:
                return False
            values = np.array([found.u, found.x, found.y])
        margin = _ROUNDING * (self.upper - self.lower)
        return bool(((values >= self.lower - margin) & (values <= self.upper + margin)).all())

    def _corners(self) -> Array:
        d = len(self.lower)
        if 2**d > _MOST_CORNERS:
            return np.empty((0, d))
        signs = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
        return signs[np.random.default_rng(_ORDER_SEED).permutation(len(signs))]

    def _at(self, shares: Array) -> Array:
        return self.currents(self.lower + shares * (self.upper - self.lower))

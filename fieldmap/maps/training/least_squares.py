"""Least squares with non-negative unknowns, of which few are to differ from zero.

The active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), several unknowns entering
at a time; the passive set is solved by the normal equations with a Cholesky factor that grows with it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from fieldmap.typing import Array

# Unknowns that enter at a time: those of the steepest gradient, and not less steep than this share of it.
_AT_ONCE, _STEEP = 12, 0.5
_ROUNDING = 1e-13


def sparse_nonnegative(matrix: Array, wanted: Array, tolerance: float) -> Array:
    """x (n,) >= 0 with |matrix x - wanted| <= tolerance |wanted|, or the least there is; matrix (m, n), wanted (m,).

    At most m of the unknowns differ from zero.
    """
    rows, count = matrix.shape
    passive = _Passive(matrix, wanted)
    size = float(np.linalg.norm(wanted))
    rest, last, at_once = wanted.copy(), np.inf, _AT_ONCE
    for _ in range(20 * rows):
        norm = float(np.linalg.norm(rest))
        if norm <= tolerance * size or len(passive.numbers) >= rows:
            break
        # Where several at a time have not gained anything, one does.
        at_once = _AT_ONCE if norm < (1.0 - 1e-12) * last else 1
        last = norm
        slope = rest @ matrix
        slope[passive.numbers] = -np.inf
        steepest = float(slope.max())
        if not steepest > _ROUNDING * size:
            break
        entering = np.argsort(-slope, kind="stable")[: min(at_once, rows - len(passive.numbers))]
        passive.enter(entering[slope[entering] >= _STEEP * steepest])
        passive.solve()
        rest = wanted - passive.columns @ passive.values
    x = np.zeros(count)
    x[passive.numbers] = passive.values
    return x


class _Passive:
    """The unknowns that may differ from zero, their values and columns, and the normal equations."""

    def __init__(self, matrix: Array, wanted: Array) -> None:
        self._matrix, self._wanted = matrix, wanted
        self.numbers, self.values = np.zeros(0, np.int64), np.zeros(0)
        self.columns = np.zeros((len(matrix), 0), order="F")
        self._gram, self._right = np.zeros((0, 0)), np.zeros(0)

    def enter(self, numbers: NDArray[np.int64]) -> None:
        """With the value zero."""
        new = self._matrix[:, numbers]
        across, own = self.columns.T @ new, new.T @ new
        self._gram = np.block([[self._gram, across], [across.T, own]])
        self._right = np.append(self._right, new.T @ self._wanted)
        self.columns = np.asfortranarray(np.concatenate([self.columns, new], axis=1))
        self.numbers = np.append(self.numbers, numbers)
        self.values = np.append(self.values, np.zeros(len(numbers)))

    def solve(self) -> None:
        """The least squares; unknowns that would become negative leave."""
        while len(self.numbers):
            gram = self._gram.copy()
            gram[np.diag_indices(len(gram))] *= 1.0 + _ROUNDING
            trial = cho_solve(cho_factor(gram, lower=True, overwrite_a=True), self._right)
            negative = trial <= 0.0
            if not negative.any():
                self.values = trial
                return
            # As far towards the trial as no unknown is negative; those that are zero then leave.
            step = float((self.values[negative] / (self.values[negative] - trial[negative])).min())
            self.values = self.values + step * (trial - self.values)
            stay = ~(negative & (self.values <= _ROUNDING * self.values.max()))
            if stay.all():
                stay[np.argmin(np.where(negative, self.values, np.inf))] = False
            self._leave(stay)

    def _leave(self, stay: NDArray[np.bool_]) -> None:
        self.numbers, self.values = self.numbers[stay], self.values[stay]
        self.columns, self._right = np.asfortranarray(self.columns[:, stay]), self._right[stay]
        self._gram = self._gram[np.ix_(stay, stay)]

"""Least squares with non-negative unknowns, of which few are to differ from zero.

The active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), several unknowns entering
at a time; the passive set is solved by the normal equations, whose Cholesky factor follows its changes.
"""

import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.growing_cholesky import append, remove, solve_lower, solve_upper
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
    barred: list[int] = []
    for _ in range(20 * rows):
        norm = float(np.linalg.norm(rest))
        if norm <= tolerance * size or len(passive.numbers) >= rows:
            break
        # Where several at a time have not gained anything, one does.
        at_once = _AT_ONCE if norm < (1.0 - 1e-12) * last else 1
        last = norm
        slope = rest @ matrix
        slope[passive.numbers] = -np.inf
        slope[barred] = -np.inf
        steepest = float(slope.max())
        if not steepest > _ROUNDING * size:
            break
        entering = np.argsort(-slope, kind="stable")[: min(at_once, rows - len(passive.numbers))]
        entering = entering[slope[entering] >= _STEEP * steepest]
        if not passive.enter(entering):
            # They depend on those that are there, until these change.
            barred += entering.tolist()
            continue
        barred = []
        passive.solve()
        rest = passive.rest()
    x = np.zeros(count)
    x[passive.numbers] = passive.values
    return x


class _Passive:
    """The unknowns that may differ from zero, their values and columns, and the factored normal equations."""

    def __init__(self, matrix: Array, wanted: Array) -> None:
        self._matrix, self._wanted = matrix, wanted
        self.numbers, self.values = np.zeros(0, np.int64), np.zeros(0)
        most = len(matrix) + _AT_ONCE
        self._factor, self._right = np.zeros((most, most)), np.zeros(0)
        # Their columns, each in a place that it keeps.
        self._held, self._places = np.zeros((len(matrix), most), order="F"), np.zeros(0, np.int64)
        self._free = list(range(most))

    def rest(self) -> Array:
        """What is wanted (m,), less what the values give."""
        spread = np.zeros(self._held.shape[1])
        spread[self._places] = self.values
        return self._wanted - self._held @ spread

    def enter(self, numbers: NDArray[np.int64]) -> bool:
        """With the value zero, but for those that depend on the ones that are there; whether any could."""
        before = len(self.numbers)
        for number in numbers:
            new, count = self._matrix[:, number], len(self.numbers)
            across = (self._held.T @ new)[self._places]
            if not append(self._factor, count, across, (1.0 + _ROUNDING) * (new @ new)):
                continue
            place = self._free.pop()
            self._held[:, place] = new
            self._places = np.append(self._places, place)
            self._right = np.append(self._right, new @ self._wanted)
            self.numbers = np.append(self.numbers, number)
            self.values = np.append(self.values, 0.0)
        return len(self.numbers) > before

    def solve(self) -> None:
        """The least squares; unknowns that would become negative leave."""
        while len(self.numbers):
            trial = self._right.copy()
            solve_lower(self._factor, len(trial), trial)
            solve_upper(self._factor, len(trial), trial)
            negative = trial <= 0.0
            if not negative.any():
                self.values = trial
                return
            # As far towards the trial as no unknown is negative; those that are zero then leave.
            # One that is zero and stays so goes no way at all.
            way = self.values[negative] - trial[negative]
            shares = np.divide(self.values[negative], way, out=np.zeros_like(way), where=way > 0.0)
            step = float(shares.min())
            self.values = self.values + step * (trial - self.values)
            leave = negative & (self.values <= _ROUNDING * self.values.max())
            if not leave.any():
                leave[np.argmin(np.where(negative, self.values, np.inf))] = True
            for place in np.flatnonzero(leave)[::-1]:
                self._leave(int(place))

    def _leave(self, place: int) -> None:
        remove(self._factor, len(self.numbers), place)
        self._free.append(int(self._places[place]))
        self._places = np.delete(self._places, place)
        self.numbers, self.values = np.delete(self.numbers, place), np.delete(self.values, place)
        self._right = np.delete(self._right, place)

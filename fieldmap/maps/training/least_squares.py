"""Least squares with non-negative unknowns, of which few are to differ from zero.

The active-set method of Lawson and Hanson (Solving Least Squares Problems, 1974, chapter 23), several unknowns entering
at a time, on the normal equations: the products of the columns are formed once, and the Cholesky factor of those of the
passive set follows its changes.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.growing_cholesky import append, remove, solve_lower, solve_upper
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.typing import Array

# Unknowns that enter at a time: those of the steepest gradient, and not less steep than this share of it.
_AT_ONCE, _STEEP = 12, 0.5
_ROUNDING = 1e-13
# Columns whose products with others are formed at a time.
_COLUMNS = 512


def nonnegative_path(
    products: Array,
    with_wanted: Array,
    size: float,
    most: int | None = None,
    begin: NDArray[np.int64] | None = None,
) -> Iterator[tuple[Array, float]]:
    """x (n,) >= 0 on the way to the least error, and what each leaves, |matrix x - wanted| / |wanted|.

    products (n, n) of the columns of the matrix, theirs (n,) with what is wanted, and its length `size`. The first x is
    zero, or the least squares of the unknowns `begin`; each that follows leaves less. At most `most` of the unknowns
    differ from zero.
    """
    most = len(products) if most is None else min(most, len(products))
    passive = _Passive(products, with_wanted, most)
    if begin is not None and begin.size:
        passive.enter(begin[:most])
        passive.solve()
    last = np.inf
    barred: list[int] = []
    for _ in range(20 * len(products)):
        slope = passive.slope()
        rest = size**2 - float(passive.values @ (passive.right + slope[passive.numbers]))
        yield passive.unknowns(), np.sqrt(max(rest, 0.0)) / size
        if len(passive.numbers) >= most:
            return
        # Where several at a time have not gained anything, one does.
        at_once = _AT_ONCE if rest < (1.0 - 1e-12) * last else 1
        last = rest
        slope[passive.numbers] = -np.inf
        slope[barred] = -np.inf
        steepest = float(slope.max())
        if not steepest > _ROUNDING * size:
            return
        entering = np.argsort(-slope, kind="stable")[: min(at_once, most - len(passive.numbers))]
        entering = entering[slope[entering] >= _STEEP * steepest]
        if not passive.enter(entering):
            # They depend on those that are there, until these change.
            barred += entering.tolist()
            continue
        barred = []
        passive.solve()


def products_of_columns(matrix: Array) -> Array:
    """matrix^T matrix (n, n), in blocks that do not depend on the number of threads."""
    count = matrix.shape[1]
    edges = [slice(first, min(first + _COLUMNS, count)) for first in range(0, count, _COLUMNS)]
    blocks = [(one, other) for k, one in enumerate(edges) for other in edges[k:]]
    out = np.empty((count, count))

    def fill(block: tuple[slice, slice]) -> None:
        one, other = block
        product = matrix[:, one].T @ matrix[:, other]
        out[one, other] = product
        out[other, one] = product.T

    for outcome in in_threads(fill, blocks, threads_of_kernels()):
        outcome.result()
    return out


class _Passive:
    """The unknowns that may differ from zero, their values, and the factored normal equations.

    products (n, n) of all columns, with_wanted (n,): theirs with what is wanted; most: unknowns at a time.
    """

    def __init__(self, products: Array, with_wanted: Array, most: int) -> None:
        self._products, self._with_wanted = products, with_wanted
        self.numbers, self.values, self.right = np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
        most += _AT_ONCE
        self._factor = np.zeros((most, most))
        # Their products with all, each in a place that it keeps.
        self._held, self._places = np.zeros((most, len(products))), np.zeros(0, np.int64)
        self._free = list(range(most))

    def unknowns(self) -> Array:
        """All (n,)."""
        x = np.zeros(len(self._products))
        x[self.numbers] = self.values
        return x

    def slope(self) -> Array:
        """Products (n,) of all columns with what the values leave."""
        spread = np.zeros(len(self._held))
        spread[self._places] = self.values
        return self._with_wanted - spread @ self._held

    def enter(self, numbers: NDArray[np.int64]) -> bool:
        """With the value zero, but for those that depend on the ones that are there; whether any could."""
        before = len(self.numbers)
        for number in numbers:
            row, count = self._products[number], len(self.numbers)
            if not append(self._factor, count, row[self.numbers], (1.0 + _ROUNDING) * row[number]):
                continue
            place = self._free.pop()
            self._held[place] = row
            self._places = np.append(self._places, place)
            self.right = np.append(self.right, self._with_wanted[number])
            self.numbers = np.append(self.numbers, number)
            self.values = np.append(self.values, 0.0)
        return len(self.numbers) > before

    def solve(self) -> None:
        """The least squares; unknowns that would become negative leave."""
        while len(self.numbers):
            trial = self.right.copy()
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
        self.right = np.delete(self.right, place)

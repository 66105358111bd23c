"""Hyper-reduction: few sample points with positive weights that integrate the projected law as all points do.

Empirical cubature: what the points add to the residuals of known states is matched by non-negative least squares
(Lawson and Hanson), whose solution is sparse. Positive weights keep the reduced functional convex. Farhat, Avery,
Chapman and Cortial, Int. J. Numer. Meth. Engng 98 (2014) 625; Hernandez, Caicedo and Ferrer, Comput. Methods Appl.
Mech. Engrg 313 (2017) 687. There the residuals are compressed to about as many conditions as there will be points. Then
the fit meets these few far better than the residuals themselves: m points fitted to k random combinations of them leave
about 1 / (1 - m / k)^2 of the error that the fit states. Here every residual of every state is a condition, at the
points that the fit may choose.

Residuals alone do not do. Iron of high permeability that hardly saturates is nearly linear: its states are combinations
of as many as there are currents, and a handful of points meets all their residuals while the tangent that they make is
softer than the true one by hundreds of times in other directions. New states then go there. So the law's share in the
tangent is matched too, in coordinates in which the tangent is the unit matrix.

The least squares (Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23) have several unknowns entering
at a time, on the normal equations: the products of the columns are formed once, and the Cholesky factor of those of the
passive set follows its changes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.growing_cholesky import append, remove, solve_lower, solve_upper
from fieldmap.parallel import results_of
from fieldmap.typing import Array

# How well the volume is met, as a share.
_VOLUME = 1e-3
# How far eigenvalues of the tangent of the sample points may be off from one, if its error is like a random matrix.
_TANGENT = 0.5
# What the normal equations cannot tell from zero, of what is wanted.
_LEAST = 1e-7
# Points whose products with all others are formed at a time, and states whose conditions are in memory.
_POINTS, _STATES = 256, 32
# Unknowns that enter at a time: those of the steepest gradient, and not less steep than this share of it.
_AT_ONCE, _STEEP = 12, 0.5
_ROUNDING = 1e-13
# Columns whose products with others are formed at a time.
_COLUMNS = 512

OfPoints: TypeAlias = Callable[[NDArray[np.int64]], Array]
"""Numbers (m, ...) of some points (m,); called from several threads."""


class Cubature:
    """Conditions on the weights of the points that may be chosen, as normal equations; states may be added to them.

    count: points in all; candidates (n,): those that may be chosen.
    """

    def __init__(self, count: int, candidates: NDArray[np.int64]) -> None:
        self.candidates, self._count = candidates, count
        n = len(candidates)
        self._products, self._of_tangents = np.zeros((2, n, n))
        self._wanted, self._wanted_of_tangents = np.zeros((2, n))
        self._square = self._square_of_tangents = self._allowed_of_tangents = 0.0
        self._states = 0
        self._taken = np.zeros(0, np.int64)

    def add(self, contributions: Sequence[OfPoints], totals: Sequence[Array]) -> None:
        """Residuals of states: what points add to each (m, r), and what all of them add (r,)."""
        for first in range(0, len(contributions), _STATES):
            some = contributions[first : first + _STATES]
            parts = results_of(lambda of: of(self.candidates), some)
            matrix = np.concatenate([part.T for part in parts])
            wanted = np.concatenate(totals[first : first + _STATES])
            self._products += products_of_columns(matrix)
            self._wanted += wanted @ matrix
            self._square += float(wanted @ wanted)
        self._states += len(contributions)

    def add_tangent(self, whole: Array, roots: OfPoints) -> None:
        """The law's share T in the tangent of one state, in coordinates in which the tangent is the unit matrix: the
        squares of its entries add up to the squared error.

        whole (r, r): T of all points; roots: rows H (m, 3, r) of points, whose H^T H add up to T.
        """
        rows = roots(self.candidates)
        modes = rows.shape[2]
        flat = np.ascontiguousarray(rows.reshape(-1, modes))

        def of(first: int) -> Array:
            some = flat[3 * first : 3 * (first + _POINTS)]
            squares = (some @ flat.T) ** 2
            return np.asarray(squares.reshape(-1, 3, len(rows), 3).sum(axis=(1, 3)))

        firsts = range(0, len(rows), _POINTS)
        for first, part in zip(firsts, results_of(of, firsts), strict=True):
            self._of_tangents[first : first + _POINTS] += part
        self._wanted_of_tangents += np.einsum("pij,pij->p", rows @ whole, rows)
        self._square_of_tangents += float((whole**2).sum())
        # Eigenvalues of a random symmetric matrix reach one where the squares of its entries add up to a quarter of its
        # order (Wigner's semicircle).
        self._allowed_of_tangents += _TANGENT**2 * max(modes, 4) / 4.0

    def factors(self, tolerance: float, most: int) -> tuple[Array, float]:
        """Factors (n,) >= 0 on the candidates' own weights, of which at most `most` differ from zero, and what they
        leave over what is allowed: above one where no more points help.

        tolerance: length of what the residuals of a state may be off, root mean square over the states, in their unit.
        What the volume, the sum over points without any law, may be off, and what the tangents may, counts as much as
        that of all states.
        """
        allowed = tolerance**2 * self._states
        of_volume = allowed / (_VOLUME * self._count) ** 2
        of_tangents = allowed / self._allowed_of_tangents if self._allowed_of_tangents else 0.0
        products = self._products + of_tangents * self._of_tangents + of_volume
        wanted = self._wanted + of_tangents * self._wanted_of_tangents + of_volume * self._count
        square = self._square + of_tangents * self._square_of_tangents + of_volume * self._count**2
        size = float(np.sqrt(square))
        enough = max(float(np.sqrt(allowed)) / size, _LEAST)
        path = nonnegative_path(products, wanted, size, most, self._taken)
        factors, left = next(path)
        while left > enough and (further := next(path, None)) is not None:
            factors, left = further
        # Where states are added, the next choice begins with the points of this one.
        self._taken = np.flatnonzero(factors)
        return factors, left / enough


def candidates(importance: Array, count: int, seed: int = 0) -> NDArray[np.int64]:
    """Numbers of `count` points, in their order, drawn by what they add, importance (p,); all where there are no more.
    Points that matter for the volume alone must be there to choose from."""
    if count >= len(importance):
        return np.arange(len(importance))
    weight = importance + 0.1 * importance.mean()
    drawn = np.random.default_rng(seed).choice(len(weight), count, replace=False, p=weight / weight.sum())
    return np.sort(drawn)


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

    for _ in results_of(fill, blocks):
        pass
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

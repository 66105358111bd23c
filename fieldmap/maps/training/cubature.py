"""Hyper-reduction: few sample points with positive weights that integrate the projected B(H) law as all points do.

The method is empirical cubature. Non-negative least squares (Lawson and Hanson) fit the contributions of the points to
the residuals of known states; their solution is sparse. Positive weights keep the reduced functional convex. Farhat,
Avery, Chapman and Cortial, Int. J. Numer. Meth. Engng 98 (2014) 625; Hernandez, Caicedo and Ferrer, Comput. Methods
Appl. Mech. Engrg 313 (2017) 687. These authors compress the residuals to about as many conditions as there will be
points. The fit then meets the conditions far better than the residuals: if m points are fitted to k random
combinations, the true error is about 1 / (1 - m / k)^2 times the error of the fit. Here every residual of every state
is a condition.

Residuals alone are not enough. Iron of high permeability that hardly saturates is nearly linear: its states are
combinations of as many states as there are currents. A handful of points then meets all residuals, but in other
directions the tangent of these points can be hundreds of times softer than the true one, and new states move far along
them. So the fit also matches the contribution of the law to the tangent, in coordinates in which the tangent is the
unit matrix.

The least squares (Lawson and Hanson, Solving Least Squares Problems, 1974, chapter 23) work on the normal equations,
and several unknowns enter at a time. The products of the columns are formed once. The Cholesky factor of the passive
set is updated when the set changes.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fieldmap.kernels.growing_cholesky import append, remove, solve_lower, solve_upper
from fieldmap.parallel import results_of
from fieldmap.typing import Array

# Relative error of the volume that counts as much as the errors of all states together.
_VOLUME = 1e-3
# Largest deviation from one of the eigenvalues of the tangent of the sample points, if its error is a random matrix.
_TANGENT = 0.5
# Least relative error of the fit: the normal equations cannot resolve a smaller one.
_LEAST = 1e-7
STATES_AT_ONCE = 32
"""Number of states whose conditions are in memory."""
# Number of points whose products with all others are formed at a time.
_POINTS = 256
# Most unknowns that enter at a time, and the least gradient of an unknown that enters, as a share of the steepest.
_AT_ONCE, _STEEP = 12, 0.5
_ROUNDING = 1e-13
# Columns whose products with others are formed at a time.
_COLUMNS = 512

OfPoints: TypeAlias = Callable[[NDArray[np.int64]], Array]
"""Function from indices (m,) of points to an array (m, ...) for these points. It is called from several threads."""


class Cubature:
    """Normal equations of the conditions on the weights of the candidate points. States can be added later.

    Parameters
    ----------
    count
        Number of all points.
    candidates
        (n,), indices of the points that may be chosen.
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
        """Add the residuals of states as conditions.

        Parameters
        ----------
        contributions
            For each state a function that gives the contributions (m, r) of m points to its residual.
        totals
            For each state the sum (r,) over all points.
        """
        for first in range(0, len(contributions), STATES_AT_ONCE):
            some = contributions[first : first + STATES_AT_ONCE]
            parts = results_of(lambda of: of(self.candidates), some)
            matrix = np.concatenate([part.T for part in parts])
            wanted = np.concatenate(totals[first : first + STATES_AT_ONCE])
            self._products += products_of_columns(matrix)
            self._wanted += wanted @ matrix
            self._square += float(wanted @ wanted)
        self._states += len(contributions)

    def add_tangent(self, whole: Array, roots: OfPoints) -> None:
        """Add the contribution T of the law to the tangent of one state as a condition.

        The coordinates are those in which the tangent is the unit matrix. The squared error is the sum of the squared
        entries of the error of T.

        Parameters
        ----------
        whole
            (r, r), T of all points.
        roots
            Function that gives rows H (m, 3, r) of m points; T is the sum of H^T H over all points.
        """
        rows = roots(self.candidates)
        count, modes = len(rows), rows.shape[2]
        flat = np.ascontiguousarray(rows.reshape(-1, modes))

        def of(first: int) -> Array:
            """Of `_POINTS` points and those from them on: the products are symmetric."""
            products = flat[3 * first : 3 * (first + _POINTS)] @ flat[3 * first :].T
            parts = products.reshape(-1, 3, count - first, 3)
            return np.einsum("piqj,piqj->pq", parts, parts)

        firsts = range(0, count, _POINTS)
        for first, part in zip(firsts, results_of(of, firsts), strict=True):
            last = first + len(part)
            self._of_tangents[first:last, first:] += part
            self._of_tangents[last:, first:last] += part[:, len(part) :].T
        self._wanted_of_tangents += np.einsum("pij,pij->p", rows @ whole, rows)
        self._square_of_tangents += float((whole**2).sum())
        # Eigenvalues of a random symmetric matrix reach one where the squares of its entries add up to a quarter of its
        # order (Wigner's semicircle).
        self._allowed_of_tangents += _TANGENT**2 * max(modes, 4) / 4.0

    def factors(self, tolerance: float, most: int) -> tuple[Array, float]:
        """Solve for factors on the weights of the candidates.

        The allowed errors of the volume (the sum over points without the law) and of the tangents count as much as the
        allowed error of all states.

        Parameters
        ----------
        tolerance
            Allowed norm of the error of a state's residual, root mean square over the states.
        most
            Most points.

        Returns
        -------
        tuple[Array, float]
            Factors (n,) >= 0, and the error over the allowed error. The ratio is above one if `most` points
            are too few, or if more points do not help.
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
        # After states are added, the next choice begins with the points of this one.
        self._taken = np.flatnonzero(factors)
        return factors, left / enough


def candidates(importance: Array, count: int, seed: int = 0) -> NDArray[np.int64]:
    """Draw candidate points at random.

    The probability of a point is its importance plus a constant, so that points that matter for the volume alone are
    among the candidates.

    Parameters
    ----------
    importance
        (p,), size of each point's contribution to the residuals.
    count
        Number of candidates; all points if there are not more.
    seed
        Of the random numbers.

    Returns
    -------
    NDArray[np.int64]
        Indices of the candidates, ascending.
    """
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
    """Iterates x (n,) >= 0 of the non-negative least squares |matrix x - wanted|.

    The first x is zero, or the least squares of the unknowns `begin`. The error decreases from one to the next.

    Parameters
    ----------
    products
        (n, n), matrix^T matrix.
    with_wanted
        (n,), matrix^T wanted.
    size
        |wanted|.
    most
        Most unknowns that differ from zero; all unless given.
    begin
        Indices of the unknowns that enter first.

    Yields
    ------
    Iterator[tuple[Array, float]]
        x, and its relative error |matrix x - wanted| / |wanted|.
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
        # If a step with several new unknowns did not reduce the error, the next one takes a single unknown.
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
            # These columns depend linearly on the passive set. They are barred until the set changes.
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
    """The passive set: the unknowns that may differ from zero, their values, and the factored normal equations.

    Parameters
    ----------
    products, with_wanted
        As in `nonnegative_path`.
    most
        Most unknowns in the set.
    """

    def __init__(self, products: Array, with_wanted: Array, most: int) -> None:
        self._products, self._with_wanted = products, with_wanted
        self.numbers, self.values, self.right = np.zeros(0, np.int64), np.zeros(0), np.zeros(0)
        most += _AT_ONCE
        self._factor = np.zeros((most, most))
        # Rows of `products` of the set. A row stays in its place when other unknowns leave.
        self._held, self._places = np.zeros((most, len(products))), np.zeros(0, np.int64)
        self._free = list(range(most))

    def unknowns(self) -> Array:
        """Values (n,) of all unknowns."""
        x = np.zeros(len(self._products))
        x[self.numbers] = self.values
        return x

    def slope(self) -> Array:
        """Negative gradient (n,): products of all columns with the residual."""
        spread = np.zeros(len(self._held))
        spread[self._places] = self.values
        return self._with_wanted - spread @ self._held

    def enter(self, numbers: NDArray[np.int64]) -> bool:
        """Add unknowns to the set, with the value zero, except those whose columns depend on columns in the set.

        Returns whether any was added.
        """
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
        """Solve the least squares of the set. Unknowns that would become negative leave it."""
        while len(self.numbers):
            trial = self.right.copy()
            solve_lower(self._factor, len(trial), trial)
            solve_upper(self._factor, len(trial), trial)
            negative = trial <= 0.0
            if not negative.any():
                self.values = trial
                return
            # The values move towards the trial until one becomes zero; unknowns that are zero then leave. An unknown
            # that is zero before and after has no way to go: its share is zero, without a division by zero.
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

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
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.maps.training.least_squares import nonnegative_path, products_of_columns
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.records import Record
from fieldmap.typing import Array

# How well the volume is met, as a share.
_VOLUME = 1e-3
# How far eigenvalues of the tangent of the sample points may be off from one, if its error is like a random matrix.
_TANGENT = 0.5
# What the normal equations cannot tell from zero, of what is wanted.
_LEAST = 1e-7
# Points whose products with all others are formed at a time, and states whose conditions are in memory.
_POINTS, _STATES = 256, 32


@dataclass(frozen=True, repr=False)
class Contributions(Record):
    """What each of p points adds to the r residuals of a state.

    summed(): what all points add (r,), and about how large what each point adds is (p,); of(points (m,)): what these
    points add (m, r). Both are called from several threads.
    """

    summed: Callable[[], tuple[Array, Array]]
    of: Callable[[NDArray[np.int64]], Array]


@dataclass(frozen=True, eq=False, repr=False)
class TangentRoots(Record):
    """The law's share T in the tangent of a state, in coordinates in which the tangent is the unit matrix.

    whole (r, r): T of all points; of(points (m,)): rows H (m, 3, r) of these points, whose H^T H add up to T.
    """

    whole: Array
    of: Callable[[NDArray[np.int64]], Array]


class Cubature:
    """Conditions on the weights of the points that may be chosen, as normal equations; states may be added to them.

    count: points in all; candidates (n,): those that may be chosen.
    """

    def __init__(self, count: int, candidates: NDArray[np.int64]) -> None:
        self.candidates, self._count = candidates, count
        n = len(candidates)
        self._products, self._wanted, self._square, self._states = np.zeros((n, n)), np.zeros(n), 0.0, 0
        self._of_tangents, self._wanted_of_tangents, self._square_of_tangents = (
            np.zeros((n, n)),
            np.zeros(n),
            0.0,
        )
        self._allowed_of_tangents = 0.0
        self._taken = np.zeros(0, np.int64)

    def add(self, contributions: Sequence[Contributions], totals: Sequence[Array]) -> None:
        """Residuals of states; totals: what all points add to each (r,)."""
        for first in range(0, len(contributions), _STATES):
            some = contributions[first : first + _STATES]
            parts = in_threads(lambda state: state.of(self.candidates), some, threads_of_kernels())
            matrix = np.concatenate([part.result().T for part in parts])
            wanted = np.concatenate(totals[first : first + _STATES])
            self._products += products_of_columns(matrix)
            self._wanted += wanted @ matrix
            self._square += float(wanted @ wanted)
        self._states += len(contributions)

    def add_tangent(self, roots: TangentRoots) -> None:
        """The tangent of one state: the squares of its entries add up to the squared error."""
        rows = roots.of(self.candidates)
        modes = rows.shape[2]
        flat = np.ascontiguousarray(rows.reshape(-1, modes))

        def of(first: int) -> Array:
            some = flat[3 * first : 3 * (first + _POINTS)]
            squares = (some @ flat.T) ** 2
            return np.asarray(squares.reshape(-1, 3, len(rows), 3).sum(axis=(1, 3)))

        firsts = range(0, len(rows), _POINTS)
        for first, part in zip(firsts, in_threads(of, firsts, threads_of_kernels()), strict=True):
            self._of_tangents[first : first + _POINTS] += part.result()
        self._wanted_of_tangents += np.einsum("pij,pij->p", rows @ roots.whole, rows)
        self._square_of_tangents += float((roots.whole**2).sum())
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


def summed(
    contributions: Sequence[Contributions], tell: Callable[[int], None] = lambda done: None
) -> tuple[list[Array], Array]:
    """What all points add to the residuals of each state (r,), and the root of the sum of the squares of what each
    point adds (p,), about. tell(k) is called when k states have been asked."""
    totals: list[Array] = []
    squares = np.zeros(0)
    for outcome in in_threads(lambda state: state.summed(), contributions, threads_of_kernels()):
        total, sizes = outcome.result()
        totals.append(total)
        squares = sizes**2 if outcome.index == 0 else squares + sizes**2
        tell(outcome.index + 1)
    return totals, np.sqrt(squares)

"""Hyper-reduction: few sample points with positive weights that integrate the projected law as all points do.

Empirical cubature: what the points add to the residuals of the solved states is matched by non-negative least squares
(Lawson and Hanson), whose solution is sparse. Positive weights keep the reduced functional convex. Farhat, Avery,
Chapman and Cortial, Int. J. Numer. Meth. Engng 98 (2014) 625; Hernandez, Caicedo and Ferrer, Comput. Methods Appl.
Mech. Engrg 313 (2017) 687. There the residuals are compressed to about as many conditions as there will be points. Then
the fit meets these few far better than the residuals themselves: m points fitted to k random combinations of them leave
about 1 / (1 - m / k)^2 of the error that the fit states. Here every residual of every state is a condition, at the
points that the fit may choose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.maps.training.least_squares import sparse_nonnegative
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.records import Record
from fieldmap.typing import Array

# Points from which the fit may choose, per point that it may take, and at least; drawn by what they add.
_CANDIDATES_PER_POINT, _FEWEST_CANDIDATES = 4, 4000
# How well the volume is met, as a share.
_VOLUME = 1e-3


@dataclass(frozen=True, repr=False)
class Contributions(Record):
    """What each of p points adds to the r residuals of a state.

    summed(): what all points add (r,), and about how large what each point adds is (p,); of(points (m,)): what these
    points add (m, r). Both are called from several threads.
    """

    summed: Callable[[], tuple[Array, Array]]
    of: Callable[[NDArray[np.int64]], Array]


def empirical_cubature(
    contributions: Sequence[Contributions],
    most: int,
    tolerance: float = 1e-6,
    seed: int = 0,
    tell: Callable[[int], None] = lambda done: None,
) -> tuple[NDArray[np.int64], Array]:
    """Numbers (m,) of the chosen points, at most `most`, and factors (m,) > 0 on their own weights.

    contributions: of the states. tolerance: length of what the chosen points' residuals of a state are off, root mean
    square over the states, in their unit. It is met unless that takes more points; the volume, the sum over points
    without any law, is met to `_VOLUME`. tell(k) is called when k states have been asked.
    """
    wanted, importance = _sums(contributions, tell)
    count = len(importance)
    # Points that matter for the volume alone must be there to choose from.
    importance = importance + 0.1 * importance.mean()
    share = importance / importance.sum()
    choice = min(count, max(_FEWEST_CANDIDATES, _CANDIDATES_PER_POINT * most))
    candidates = np.sort(np.random.default_rng(seed).choice(count, choice, replace=False, p=share))
    parts = in_threads(lambda state: state.of(candidates), contributions, threads_of_kernels())
    matrix = np.concatenate([part.result().T for part in parts])
    allowed = tolerance * np.sqrt(len(contributions))
    # The volume is off by its share where all that is allowed is spent on it.
    volume = allowed / (_VOLUME * count)
    matrix = np.vstack([matrix, np.full(choice, volume)])
    wanted = np.append(wanted, volume * count)
    factors = sparse_nonnegative(matrix, wanted, allowed / float(np.linalg.norm(wanted)), most)
    chosen = np.flatnonzero(factors > 0)
    return candidates[chosen], factors[chosen]


def _sums(contributions: Sequence[Contributions], tell: Callable[[int], None]) -> tuple[Array, Array]:
    """What all points add to the residuals of all states, one after the other, and the root of the sum of the squares
    of what each point adds, about."""
    totals: list[Array] = []
    squares = np.zeros(0)
    for outcome in in_threads(lambda state: state.summed(), contributions, threads_of_kernels()):
        total, sizes = outcome.result()
        totals.append(total)
        squares = sizes**2 if outcome.index == 0 else squares + sizes**2
        tell(outcome.index + 1)
    return np.concatenate(totals), np.sqrt(squares)

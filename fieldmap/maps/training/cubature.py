"""Hyper-reduction: few sample points with positive weights that integrate the projected law as all points do.

Empirical cubature: the contributions of the points to the residuals of the solved states, compressed by random
combinations and a singular value decomposition, are matched by non-negative least squares (Lawson and Hanson), whose
solution is sparse. Positive weights keep the reduced functional convex. Farhat, Avery, Chapman and Cortial, Int. J.
Numer. Meth. Engng 98 (2014) 625; Hernandez, Caicedo and Ferrer, Comput. Methods Appl. Mech. Engrg 313 (2017) 687.
There every singular vector is one condition, whatever its singular value; here each counts by it, so that what is left
is the error of the states' residuals, and the number of points follows the wanted one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldmap.maps.training.least_squares import sparse_nonnegative
from fieldmap.parallel import in_threads, threads_of_kernels
from fieldmap.typing import Array

# Points from which the fit may choose, per condition, and at least; drawn by their share in the conditions.
_CANDIDATES_PER_CONDITION, _FEWEST_CANDIDATES = 12, 4000
# Random combinations beyond the conditions: what a randomised range finder wants (Halko et al., SIAM Review 2011).
_OVERSAMPLING = 20
# Random projections that tell the lengths of rows.
_PROJECTIONS = 40
# How well the volume is met, as a share.
_VOLUME = 1e-3
# Parts of the points whose products are summed.
_PARTS = 8
# Eigenvalues of a Gram matrix below this share of the largest are rounding.
_ROUNDING = 1e-13
_GOLDEN = (5**0.5 - 1.0) / 2.0


@dataclass(frozen=True)
class Contributions:
    """What each of p points adds to the residuals (r,) of a state.

    times(combine (r, k)): its product (p, k) with `combine`; it is called from several threads.
    """

    residuals: int
    times: Callable[[Array], Array]


def empirical_cubature(
    contributions: Sequence[Contributions],
    conditions: int,
    tolerance: float = 1e-6,
    seed: int = 0,
    tell: Callable[[int], None] = lambda done: None,
) -> tuple[NDArray[np.int64], Array]:
    """Numbers (m,) of the chosen points and factors (m,) > 0 on their own weights; m is at most `conditions` + 1.

    contributions: of the states. tolerance: length of what the chosen points' residuals of a state are off, root mean
    square over the states, in their unit. It is met unless that takes more points; the volume, the sum over points
    without any law, is met to `_VOLUME`. tell(k) is called when k states have been asked.
    """
    random = np.random.default_rng(seed)
    sketch = _sketch(contributions, conditions + _OVERSAMPLING, seed, tell)
    combined, lengths = _combinations(sketch, conditions)
    count = len(sketch)
    # Squares of what random combinations are off add up to those of the states' residuals.
    allowed = tolerance * np.sqrt(len(contributions))
    importance = _importance(sketch, combined, random)
    # Points that matter for the volume alone must be there to choose from.
    importance = importance + importance.mean() / len(lengths)
    most = min(count, max(_FEWEST_CANDIDATES, _CANDIDATES_PER_CONDITION * len(lengths)))
    candidates = random.choice(count, most, replace=False, p=importance / importance.sum())
    matrix = (sketch[candidates] @ combined) * lengths
    wanted = (np.ones(count) @ sketch @ combined) * lengths
    volume = allowed / (_VOLUME * count)
    matrix = np.column_stack([matrix, np.full(len(matrix), volume)])
    wanted = np.append(wanted, volume * count)
    share = allowed / float(np.linalg.norm(wanted))
    factors = sparse_nonnegative(np.ascontiguousarray(matrix.T), wanted, share)
    chosen = np.flatnonzero(factors > 0)
    order = np.argsort(candidates[chosen])
    return candidates[chosen][order], factors[chosen][order]


def _combinations(sketch: Array, count: int) -> tuple[Array, Array]:
    """Combinations (c, k) of the columns of a tall matrix (p, c) that are its first `count` left singular vectors, less
    those that are rounding, by the eigenvectors of its Gram matrix; and the singular values (k,)."""
    values, vectors = np.linalg.eigh(_gram(sketch))
    order = np.argsort(values)[::-1][:count]
    order = order[values[order] > _ROUNDING * values[order[0]]]
    lengths = np.sqrt(values[order])
    return np.asarray(vectors[:, order] / lengths), lengths


def _gram(tall: Array) -> Array:
    """tall^T tall (c, c), in parts that do not depend on the number of threads."""
    parts = np.array_split(tall, _PARTS)
    products = in_threads(lambda part: part.T @ part, parts, threads_of_kernels())
    return np.asarray(sum(outcome.result() for outcome in products))


def _importance(sketch: Array, combined: Array, random: np.random.Generator) -> Array:
    """About the squared lengths (p,) of the rows of sketch @ combined, by random projections (Drineas, Magdon-Ismail,
    Mahoney and Woodruff, J. Mach. Learn. Res. 13 (2012) 3475)."""
    mixed = combined @ random.standard_normal((combined.shape[1], _PROJECTIONS)) / np.sqrt(_PROJECTIONS)
    return np.asarray(((sketch @ mixed) ** 2).sum(axis=1))


def _sketch(
    contributions: Sequence[Contributions], columns: int, seed: int, tell: Callable[[int], None]
) -> Array:
    """Random combinations (p, columns) of all contributions. Those of one state go to some successive columns only, as
    many as they are themselves: as good a range for a fraction of the products."""

    def mixed(number: int) -> Array:
        count = contributions[number].residuals
        few = min(columns, count)
        random = np.random.default_rng((seed, number))
        return contributions[number].times(random.standard_normal((count, few)) / np.sqrt(few))

    total = np.empty((0, columns))
    for outcome in in_threads(mixed, range(len(contributions)), threads_of_kernels()):
        number, part = outcome.index, outcome.result()
        if number == 0:
            total = np.zeros((len(part), columns))
        # Every column gets about as many states: successive ones lie a golden section apart.
        first = int(columns * (number * _GOLDEN % 1.0))
        end = min(first + part.shape[1], columns)
        total[:, first:end] += part[:, : end - first]
        total[:, : first + part.shape[1] - end] += part[:, end - first :]
        tell(number + 1)
    return total

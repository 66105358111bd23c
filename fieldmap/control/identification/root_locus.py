"""Closed-loop poles over the controller's gain, each followed along its branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_signal
from fieldmap.control.linear_models import transfer_function
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class RootLocus(Record):
    """gains (n,); poles (n, order): column k is one branch."""

    gains: Array
    poles: NDArray[np.complexfloating[Any]]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether all poles lie inside the unit circle, per gain (n,)."""
        return np.all(np.abs(self.poles) < 1.0, axis=1)


def root_locus(
    plant: tuple[ArrayLike, ArrayLike],
    controller: tuple[ArrayLike, ArrayLike],
    gains: ArrayLike,
    *,
    steps: int = 64,
) -> RootLocus:
    """Roots of 1 + gain * C P = 0 in q for these gains, which must rise (or fall).

    plant, controller: numerator and denominator; the controller at gain 1 with its sign. Between two gains `steps`
    more are put in, and poles are matched from one to the next so that the sum of their moves is least: branches stay
    apart unless two meet, where they may be exchanged as in every root locus. Raises InputError.

    >>> locus = root_locus(([1.0], [1.0, -1.0]), ([1.0], [1.0]), [0.5, 1.5, 2.5])  # an integrator
    >>> locus.poles.real.ravel().tolist(), locus.stable.tolist()
    ([0.5, -0.5, -1.5], [True, True, False])
    """
    top, bottom = (
        np.polymul(a, b)
        for a, b in zip(transfer_function(*plant), transfer_function(*controller), strict=True)
    )
    wanted = np.atleast_1d(check_signal("root_locus(gains)", gains))
    moves = np.diff(wanted)
    if wanted.ndim != 1 or not wanted.size or not ((moves > 0).all() or (moves < 0).all()):
        raise InputError(
            Problem("root_locus(gains)", "must rise, or fall", f"{wanted.tolist()}", "sort the gains")
        )
    if top.size > bottom.size:
        raise InputError(
            Problem("root_locus", "must be proper", "more zeros than poles", "add the controller's poles")
        )
    poles = [np.sort_complex(np.roots(np.polyadd(bottom, wanted[0] * top)))]
    between = [np.linspace(start, end, steps + 2)[1:] for start, end in pairwise(wanted)]
    found = iter(_roots(bottom, top, np.concatenate([np.empty(0), *between])))
    for each in between:
        branch = poles[-1]
        for _ in each:
            branch = _matched(branch, next(found))
        poles.append(branch)
    return RootLocus(wanted, np.array(poles, dtype=complex))


def _roots(bottom: NDArray[Any], top: NDArray[Any], gains: Array) -> Sequence[NDArray[Any]]:
    """np.roots of bottom + gain * top for every gain: eigenvalues of all companion matrices in one call."""
    each = np.pad(top, (bottom.size - top.size, 0)) * gains[:, None] + bottom
    if bottom.size < 3 or not (each[:, 0] != 0.0).all() or not (each[:, -1] != 0.0).all():
        return [np.roots(one) for one in each]
    companions = np.zeros((gains.size, bottom.size - 1, bottom.size - 1))
    companions[:, 1:, :-1] = np.eye(bottom.size - 2)
    companions[:, 0] = -each[:, 1:] / each[:, :1]
    return list(np.linalg.eigvals(companions))


def _matched(before: NDArray[Any], after: NDArray[Any]) -> NDArray[Any]:
    if after.size < before.size:  # the leading coefficient vanished: a pole at infinity
        after = np.concatenate([after, np.full(before.size - after.size, 1e300)])
    order = scipy.optimize.linear_sum_assignment(np.minimum(np.abs(before[:, None] - after[None, :]), 1e6))[1]
    return after[order]

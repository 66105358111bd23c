"""Where searches begin for a force on soft iron, which is of second order in the currents: docs/theory/wrench.md (11).

The second derivative of what is wanted has directions along which currents give most of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from fieldmap.lookup.inverse_goal import Goal
from fieldmap.typing import Array

_SMALL = 1e-3  # currents, of the typical ones, at which soft iron is still linear
_NO_SLOPE = 1e-9  # of what typical currents give: rounding
_ASIDE = (0.0, 1.0, -1.0)  # of the wanted force: what is tried beside it along each other row
_EIGENVECTORS = 2
_RESCALINGS = 12


def starts_on_soft_iron(goal: Goal, scale: float) -> Iterator[Array]:
    """Currents (n,), A, along the strongest directions of the second derivative of the demand, and of the demand with
    more or less beside it, as long as it takes.

    Both ways unless only the square of the currents counts. scale: a current, A, of the usual size.
    """
    of, units, size = goal.variables, np.eye(len(goal.variables.cost)), _SMALL * scale
    none = of.within(np.zeros(len(units)))
    idle = goal.about(none)[1]
    # (n, r, n): of each row, by two currents.
    bends = np.array([(goal.about(none + size * unit)[1] - idle) / size for unit in units])
    lengths = np.abs(bends).max(axis=(0, 2))
    even = bool((np.abs(idle).max(axis=1) <= _NO_SLOPE * scale * lengths).all())
    if not even:
        yield none
    per_length = np.where(lengths > 0.0, 1.0 / np.maximum(lengths, 1e-300), 0.0)
    wanted = goal.demand.values * per_length
    if not wanted.any():
        yield none
        return
    wanted /= np.abs(wanted).max()
    main = int(np.argmax(np.abs(wanted)))
    ways = (1.0,) if even and np.allclose(of.low, -of.high) else (1.0, -1.0)
    others = [row for row in np.flatnonzero(lengths) if row != main][:2]
    for aside in product(_ASIDE, repeat=len(others)):
        share = wanted.copy()
        share[others] += aside
        matrix = np.einsum("r,krn->kn", share * per_length, bends)
        _, vectors = np.linalg.eigh(matrix + matrix.T)
        for vector, way in product(vectors.T[: -_EIGENVECTORS - 1 : -1], ways):
            first = _as_long_as_needed(goal, main, way * vector, scale)
            if first is not None:
                yield first


def _as_long_as_needed(goal: Goal, main: int, along: Array, scale: float) -> Array | None:
    """Currents in this direction that give about the main row of the demand; as many as there are where it takes more,
    None where they give none of it."""
    wanted = float(goal.demand.values[main])
    direction = along / np.abs(along).max()
    currents = goal.variables.within(scale * direction)
    for _ in range(_RESCALINGS):
        given = float(goal.about(currents)[0][main])
        if given * wanted <= 0.0:
            return None
        ratio = math.sqrt(wanted / given)
        following = goal.variables.within(min(ratio, 10.0) * currents)
        if abs(ratio - 1.0) < 0.01 or np.array_equal(following, currents):
            break
        currents = following
    return currents

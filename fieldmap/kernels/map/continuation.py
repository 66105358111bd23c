"""Where a state goes on, from where it was at the parameters asked for before."""

from typing import Any

import numpy as np

from fieldmap.kernels.compilation import njit

# Without counts of references (map_block.PLAIN).
_PLAIN: dict[str, Any] = {"_nrt": False}
# How many of the last steps an extrapolation reaches forward, and how far behind the last but one a third state must
# lie, in those steps.
_REACH, _APART = 2.0, 0.25
# Misses closer than this share of the last step's square are equal: both polynomials follow the path.
_EQUAL = 1e-9


@njit(**_PLAIN)
def _along(place, passed):
    """How far a place (c,) lies from the last one along the last step, times that step's length."""
    last, total = passed.shape[0] - 1, 0.0
    for c in range(place.size):
        total += (place[c] - passed[last, c]) * (passed[last, c] - passed[max(last - 1, 0), c])
    return total


@njit(**_PLAIN)
def _lagrange(nodes, at, first, weights):
    """weights (k,) of values at nodes[first:] for their polynomial's value at `at`; of those before them 0."""
    for j in range(nodes.size):
        weights[j] = 1.0 if j >= first else 0.0
        for m in range(first, nodes.size):
            if j >= first and m != j:
                weights[j] *= (at - nodes[m]) / (nodes[j] - nodes[m])


@njit(**_PLAIN)
def _miss(weights, passed, aim):
    """Square of the distance of the weighted parameters from those aimed at."""
    total = 0.0
    for c in range(aim.size):
        value = -aim[c]
        for j in range(weights.size):
            value += weights[j] * passed[j, c]
        total += value * value
    return total


@njit(**_PLAIN)
def continued(aim, passed, states, weights, nodes, out):
    """out (r,): the state at parameters `aim` (c,), from states (k, r) at parameters `passed` (k, c), newest last.

    Of the polynomials through the last one, two and three states, over how far the parameters went along the last
    step, the one that predicts the parameters themselves best: on a smooth path the highest, after a leap or among
    noise a lower one. weights, nodes (k,): room to work in.
    """
    count, last = passed.shape[0], passed.shape[0] - 1
    length = -_along(passed[max(last - 1, 0)], passed)
    at = min(max(_along(aim, passed) / length, 0.0), _REACH) if length > 0.0 else 0.0
    for j in range(count):
        nodes[j] = _along(passed[j], passed) / max(length, 1e-300)
    best, least = last, np.inf
    for first in range(last, -1, -1):
        if (first < last and length == 0.0) or (
            first < last - 1 and nodes[first] > nodes[first + 1] - _APART
        ):
            break
        _lagrange(nodes, at, first, weights)
        miss = _miss(weights, passed, aim)
        if miss <= least + _EQUAL * length:
            best, least = first, min(miss, least)
    _lagrange(nodes, at, best, weights)
    for i in range(out.size):
        out[i] = 0.0
        for j in range(count):
            out[i] += weights[j] * states[j, i]

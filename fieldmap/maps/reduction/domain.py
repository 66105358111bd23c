"""The currents of a domain that are solved: to train a model and to try it."""

import itertools

import numpy as np
from scipy.stats import qmc

from fieldmap.currents import CurrentDomain
from fieldmap.typing import Array

# Beyond this many corners only the low-discrepancy states are solved.
MOST_CORNERS = 64
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261


def sequence(domain: CurrentDomain, first: int, count: int) -> Array:
    """Currents (count, c), from number `first` on, of a sequence that fills the domain evenly: the middle, then low
    discrepancy (Sobol), denser towards the faces, where a model has neighbours on one side only."""
    d = domain.parametrisation.signal_count
    power = int(np.ceil(np.log2(max(2, first + count))))
    shares = qmc.Sobol(d, seed=_SEED).random_base2(power)
    spread = np.concatenate([np.full((1, d), 0.5), 0.5 - 0.5 * np.cos(np.pi * shares)])
    return domain.at(spread[first : first + count])


def held_out(domain: CurrentDomain, count: int) -> Array:
    """Currents (count, c) at random, uniform over the domain, to try a trained model at."""
    d = domain.parametrisation.signal_count
    return domain.at(np.random.default_rng(_HELD_OUT_SEED).random((count, d)))


def corners(domain: CurrentDomain) -> Array:
    """Currents (m, c) of the corners; none where there are more than 64."""
    d = domain.parametrisation.signal_count
    if 2**d > MOST_CORNERS:
        return domain.at(np.empty((0, d)))
    signs = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
    return domain.at(signs[np.random.default_rng(_ORDER_SEED).permutation(len(signs))])

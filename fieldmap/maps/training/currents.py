"""Currents at which states are solved and models are tried: inside the box of a domain, on its edges and corners."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.typing import Array

# Most corners of the domain. If it has more, as many are drawn at random.
MOST_CORNERS = 256
# Most pairs of signals at the ends of their ranges. If there are more, as many are drawn at random.
_MOST_PAIRS = 128
# Step of a signal, as a share of its range, by which its tangent is multiplied.
REACH = 0.125
# One in so many training states lies on a symmetry plane, where it is its own image.
_ON_MIRROR = 4
# Currents that differ by less than this share of the largest are the same state.
_SAME = 1e-9
# Search for a maximum: number of places from which each round goes on, number of random neighbours of each, and their
# distances in the rounds, as shares of the ranges.
STARTS, _NEIGHBOURS, _WIDTHS = 10, 3, (0.15, 0.05)
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261


def sequence(domain: CurrentDomain, count: int) -> Array:
    """Signals (count, d) that fill the domain evenly: the middle, then a Sobol sequence.

    The sequence is denser towards the faces, because a state there has neighbours on one side only.
    """
    # Imported here: scipy.stats takes a second to load, and only training needs it.
    from scipy.stats import qmc

    d = domain.parametrisation.signal_count
    power = int(np.ceil(np.log2(max(2, count))))
    shares = qmc.Sobol(d, seed=_SEED).random_base2(power)
    spread = np.concatenate([np.full((1, d), 0.5), 0.5 - 0.5 * np.cos(np.pi * shares)])
    return domain.parametrisation.within(domain.lower, domain.upper, spread[:count])


def training_signals(
    domain: CurrentDomain, count: int, images: Sequence[StateImage], off: bool = False
) -> Array:
    """Signals (count, d) of the states to train on.

    They are those of `sequence`, but every fourth state is moved half way to its image by a symmetry of the device.
    There symmetric parts of the iron are magnetised alike, and the field may change sharply when the currents leave
    this plane. The sequence itself has no state in these planes except its middle.

    Parameters
    ----------
    domain
        Of the currents.
    count
        Number of states.
    images
        Symmetries of the device.
    off
        Make the second state the one without currents, if it lies in the domain and is not the first.
    """
    signals = sequence(domain, count)
    without = np.zeros(domain.parametrisation.coil_count)
    if off and count > 1 and domain.holds(without) and domain.middle.any():
        signals[1] = domain.parametrisation.nearest(without).values
    for k in range(_ON_MIRROR - 1, count, _ON_MIRROR):
        own = domain.parametrisation.currents(signals[k])
        others = [image.currents(own) for image in images]
        others = [other for other in others if domain.holds(other) and not is_among(own, other[None]).any()]
        # The reversed currents are an image too. Half way to them the currents are zero, which is no state to train on.
        between = [0.5 * (own + other) for other in others]
        between = [values for values in between if np.linalg.norm(values) > 0.5 * np.linalg.norm(own)]
        if between:
            signals[k] = domain.parametrisation.nearest(between[k // _ON_MIRROR % len(between)]).values
    return signals


def held_out(domain: CurrentDomain, count: int) -> Array:
    """Random currents (count, c), uniform over the domain, at which a trained model is tested."""
    d = domain.parametrisation.signal_count
    return domain.at(np.random.default_rng(_HELD_OUT_SEED).random((count, d)))


def reaches(domain: CurrentDomain, signals: Array, of_coils: bool = False) -> Array:
    """Changes (c, d) of the currents when each of the signals (d,) changes by `REACH` of its range. of_coils: behind
    them (c, c), by as much of the largest current of each coil, where fewer signals set the currents."""
    of = domain.parametrisation
    by_signals = of.derivative(signals) * (REACH * (domain.upper - domain.lower))
    if not of_coils or of.signal_count == of.coil_count:
        return np.asarray(by_signals)
    return np.concatenate([by_signals, REACH * np.diag(domain.largest)], axis=1)


def extreme_signals(domain: CurrentDomain) -> Array:
    """Signals (m, d) at which a model is likely to have its largest errors, in this order:

    - one signal at both ends of its range, half way and a fiftieth of the way to them, the others at rest (`at_rest`);
    - all signals at equal shares of their ranges;
    - two signals at ends of their ranges, the others at rest, which includes opposite coils; at most 128 of these;
    - the corners, at most 256.

    Repeated signals are left out, and signals without currents.
    """
    d, neutral = domain.parametrisation.signal_count, at_rest(domain)

    def moved(ends: Sequence[tuple[int, float]]) -> Array:
        row = neutral.copy()
        for k, share in ends:
            row[k] = share
        return row

    lines = itertools.product(range(d), (1.0, 0.5, 0.02), (0.0, 1.0))
    rows = [moved([(k, neutral[k] + way * (end - neutral[k]))]) for k, way, end in lines]
    rows += [np.full(d, share) for share in (0.25, 0.5, 0.75)]
    pairs = [
        [(pair[0], one), (pair[1], other)]
        for pair, one, other in itertools.product(itertools.combinations(range(d), 2), (0.0, 1.0), (0.0, 1.0))
    ]
    order = np.random.default_rng(_ORDER_SEED).permutation(len(pairs))[:_MOST_PAIRS]
    rows += [moved(pairs[k]) for k in order]
    signals = domain.parametrisation.within(domain.lower, domain.upper, np.array(rows).reshape(-1, d))
    signals = np.concatenate([signals, corner_signals(domain)])
    # Without currents the field is that of magnets and background alone.
    _, first = np.unique(shares_of(domain, signals).round(9), axis=0, return_index=True)
    kept = np.sort(first)
    moving = np.abs(domain.parametrisation.currents(signals[kept])).max(axis=1) > 0.0
    return np.asarray(signals[kept[moving]])


def shares_of(domain: CurrentDomain, signals: Array) -> Array:
    """Shares (m, d) of the ranges at which signals (m, d) lie."""
    return np.asarray((signals - domain.lower) / (domain.upper - domain.lower))


def at_rest(domain: CurrentDomain) -> Array:
    """Shares (d,) of the ranges at which the signals are zero; one half for a range that does not contain zero."""
    inside = (domain.lower <= 0.0) & (domain.upper >= 0.0)
    return np.where(inside, -domain.lower / (domain.upper - domain.lower), 0.5)


def drawn(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Random currents (count, c), every second one nearer to rest: see `drawn_shares`."""
    return domain.at(drawn_shares(domain, count, random))


def drawn_shares(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Random shares (count, d) of the ranges, every second one nearer to rest by a factor of up to a hundred.

    Weak currents need states of their own: the permeability of iron differs in weak fields, and an error that is small
    beside the field of most states may be large beside a weak one.
    """
    shares, rest = random.random((count, len(domain.lower))), at_rest(domain)
    nearer = np.where(np.arange(count) % 2 == 1, 10.0 ** (-2.0 * random.random(count)), 1.0)
    return np.asarray(rest + nearer[:, None] * (shares - rest))


def edge_shares(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Random shares (count, d) of the ranges on edges of the box: all signals but one are at an end of their range."""
    shares = random.integers(0, 2, (count, len(domain.lower))).astype(float)
    shares[np.arange(count), random.integers(0, shares.shape[1], count)] = random.random(count)
    return shares


def corner_signals(domain: CurrentDomain) -> Array:
    """Signals (m, d) of the corners in random order; a random choice of 256 if there are more."""
    d = domain.parametrisation.signal_count
    random = np.random.default_rng(_ORDER_SEED)
    if 2**d <= MOST_CORNERS:
        shares = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
        shares = shares[random.permutation(len(shares))]
    else:
        shares = np.unique(random.integers(0, 2, (4 * MOST_CORNERS, d)), axis=0).astype(float)
        shares = random.permutation(shares)[:MOST_CORNERS]
    return domain.parametrisation.within(domain.lower, domain.upper, shares)


def climbed(
    looks: Callable[[Array], Array],
    domain: CurrentDomain,
    shares: Array,
    random: np.random.Generator,
    tell: Callable[[float], None] = lambda share: None,
    widths: Sequence[float] = _WIDTHS,
) -> tuple[Array, int]:
    """Search the domain for the currents at which a function is largest.

    The search goes on from the `STARTS` best places to random neighbours of each, nearer in each round. Neighbours of
    weak currents are nearer in proportion, because small changes matter there.

    Parameters
    ----------
    looks
        looks(currents (s, c)) gives the values (s,).
    domain
        Of the currents.
    shares
        (s, d), shares of the ranges at which the search begins.
    random
        Generator of the neighbours.
    tell
        Called with the share of the search that is done.
    widths
        Distances of the neighbours, as shares of the ranges, one for each round.

    Returns
    -------
    tuple[Array, int]
        Shares (m, d) of the ranges, the largest value first, and the number of currents that were evaluated.
    """
    rest = at_rest(domain)
    farthest = np.maximum(rest, 1.0 - rest)
    tell(0.0)
    found, looked_at = looks(domain.at(shares)), len(shares)
    best = np.argsort(-found, kind="stable")[:STARTS]
    shares, largest = shares[best], found[best]
    for round_number, width in enumerate(widths):
        tell((round_number + 1) / (len(widths) + 1))
        near = np.repeat(shares, _NEIGHBOURS, axis=0)
        strength = (np.abs(near - rest) / farthest).max(axis=1, keepdims=True)
        near = np.clip(near + width * strength * random.standard_normal(near.shape), 0.0, 1.0)
        found, looked_at = looks(domain.at(near)), looked_at + len(near)
        for k in range(len(shares)):
            own = slice(k * _NEIGHBOURS, (k + 1) * _NEIGHBOURS)
            worst = own.start + int(found[own].argmax())
            if found[worst] > largest[k]:
                shares[k], largest[k] = near[worst], found[worst]
    tell(1.0)
    return shares[np.argsort(-largest, kind="stable")], looked_at


def nearest_of(currents: Array, states: Array) -> int:
    """Index of the state whose currents, a row of `states` (s, c), are nearest to currents (c,)."""
    return int(np.linalg.norm(states - currents, axis=1).argmin())


def is_among(currents: Array, states: Array) -> NDArray[np.bool_]:
    """Mask (s,) of the states whose currents, rows of `states` (s, c), equal currents (c,) up to rounding."""
    return np.asarray(np.abs(states - currents).max(axis=1) <= _SAME * np.abs(states).max(initial=0.0))

"""At which currents states are solved, and models tried: in the box of a domain, on its faces, edges and corners."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from fieldmap.currents import CurrentDomain
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.typing import Array

# Of more corners so many are looked at, at random.
MOST_CORNERS = 256
# Of more pairs of signals at their ends so many are looked at, at random.
_MOST_PAIRS = 128
# Share of a signal's range that a tangent stands for.
REACH = 0.125
# Of the states to train on, one in so many is its own image.
_ON_MIRROR = 4
# Currents that differ by less than this share of the largest are the same state.
_SAME = 1e-9
# The search for the largest of something: from how many of the worst it goes on, to how many neighbours each, and how
# far away as a share of the ranges.
STARTS, _NEIGHBOURS, _WIDTHS = 10, 3, (0.15, 0.05)
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261


def sequence(domain: CurrentDomain, count: int) -> Array:
    """Signals (count, d) of a sequence that fills the domain evenly: the middle, then low discrepancy (Sobol), denser
    towards the faces, where a model has neighbours on one side only."""
    # Here: only who trains a model needs scipy.stats, which takes a second to load.
    from scipy.stats import qmc

    d = domain.parametrisation.signal_count
    power = int(np.ceil(np.log2(max(2, count))))
    shares = qmc.Sobol(d, seed=_SEED).random_base2(power)
    spread = np.concatenate([np.full((1, d), 0.5), 0.5 - 0.5 * np.cos(np.pi * shares)])
    return domain.parametrisation.within(domain.lower, domain.upper, spread[:count])


def training_signals(
    domain: CurrentDomain, count: int, images: Sequence[StateImage], off: bool = False
) -> Array:
    """Signals (count, d) of the states to train on: `sequence`, but every fourth has the currents half way between its
    own and those of an image. There the iron's symmetric parts are magnetised alike, and the field may turn sharply
    when the currents leave that plane; a sequence that fills the box meets no such place but its middle. off: the
    second is that without currents, if the domain has it and the first is another."""
    signals = sequence(domain, count)
    without = np.zeros(domain.parametrisation.coil_count)
    if off and count > 1 and domain.holds(without) and domain.middle.any():
        signals[1] = domain.parametrisation.nearest(without).values
    for k in range(_ON_MIRROR - 1, count, _ON_MIRROR):
        own = domain.parametrisation.currents(signals[k])
        others = [image.currents(own) for image in images]
        others = [other for other in others if domain.holds(other) and not is_among(own, other[None]).any()]
        # The reversed currents are an image too: half way there is no state.
        between = [0.5 * (own + other) for other in others]
        between = [values for values in between if np.linalg.norm(values) > 0.5 * np.linalg.norm(own)]
        if between:
            signals[k] = domain.parametrisation.nearest(between[k // _ON_MIRROR % len(between)]).values
    return signals


def held_out(domain: CurrentDomain, count: int) -> Array:
    """Currents (count, c) at random, uniform over the domain, to try a trained model at."""
    d = domain.parametrisation.signal_count
    return domain.at(np.random.default_rng(_HELD_OUT_SEED).random((count, d)))


def reaches(domain: CurrentDomain, signals: Array) -> Array:
    """Changes (c, d) of the currents about signals (d,): along each, by an eighth of its range."""
    return domain.parametrisation.derivative(signals) * (REACH * (domain.upper - domain.lower))


def extreme_signals(domain: CurrentDomain) -> Array:
    """Signals (m, d) where a model is likely to be worst: lines of one signal alone, the others at rest (`at_rest`), at
    both ends, half way and a fiftieth of the way; all signals at equal shares of their ranges; two signals at their
    ends, with the others at rest, which holds opposite coils and edges; and the corners. In this order; of more than
    128 pairs and 256 corners as many at random."""
    d, neutral = domain.parametrisation.signal_count, at_rest(domain)

    def moved(ends: Sequence[tuple[int, float]]) -> Array:
        row = neutral.copy()
        for k, share in ends:
            row[k] = share
        return row

    lines = itertools.product(range(d), (1.0, 0.5, 0.02), (0.0, 1.0))
    rows = [moved([(k, neutral[k] + way * (end - neutral[k]))]) for k, way, end in lines]
    rows += [np.full(d, share) for share in (0.25, 0.5, 0.75)]
    ends = itertools.product(itertools.combinations(range(d), 2), (0.0, 1.0), (0.0, 1.0))
    pairs = [moved([(pair[0], one), (pair[1], other)]) for pair, one, other in ends]
    order = np.random.default_rng(_ORDER_SEED).permutation(len(pairs))[:_MOST_PAIRS]
    rows += [pairs[k] for k in order]
    signals = domain.parametrisation.within(domain.lower, domain.upper, np.array(rows).reshape(-1, d))
    signals = np.concatenate([signals, corner_signals(domain)])
    # Each once, and none without any currents, whose field is that of magnets and background alone.
    _, first = np.unique(shares_of(domain, signals).round(9), axis=0, return_index=True)
    kept = np.sort(first)
    moving = np.abs(domain.parametrisation.currents(signals[kept])).max(axis=1) > 0.0
    return np.asarray(signals[kept[moving]])


def shares_of(domain: CurrentDomain, signals: Array) -> Array:
    """Shares (m, d) of the ranges at which signals (m, d) lie."""
    return np.asarray((signals - domain.lower) / (domain.upper - domain.lower))


def at_rest(domain: CurrentDomain) -> Array:
    """Shares (d,) of the ranges where the signals are zero, or half where they do not reach it."""
    inside = (domain.lower <= 0.0) & (domain.upper >= 0.0)
    return np.where(inside, -domain.lower / (domain.upper - domain.lower), 0.5)


def drawn(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Currents (count, c) drawn at random, every second one nearer to rest: see `drawn_shares`."""
    return domain.at(drawn_shares(domain, count, random))


def drawn_shares(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Shares (count, d) of the ranges, drawn at random, every second one nearer to rest, by up to a factor of a
    hundred: iron has another permeability in weak fields, and what is small in most states is all there is in these."""
    shares, rest = random.random((count, len(domain.lower))), at_rest(domain)
    nearer = np.where(np.arange(count) % 2 == 1, 10.0 ** (-2.0 * random.random(count)), 1.0)
    return np.asarray(rest + nearer[:, None] * (shares - rest))


def edge_shares(domain: CurrentDomain, count: int, random: np.random.Generator) -> Array:
    """Shares (count, d) of the ranges at random places on edges: all signals but one at an end of their range."""
    shares = random.integers(0, 2, (count, len(domain.lower))).astype(float)
    shares[np.arange(count), random.integers(0, shares.shape[1], count)] = random.random(count)
    return shares


def corner_signals(domain: CurrentDomain) -> Array:
    """Signals (m, d) of the corners, in a random order; of more than 256, as many of them at random."""
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
) -> tuple[Array, int]:
    """Shares (m, d) of the ranges at which looks(currents (s, c)) (s,) is largest, the largest first: from the worst of
    `shares` (s, d) on to random neighbours, nearer each time, and nearer in weak currents, where little changes much;
    and at how many it was looked at."""
    rest = at_rest(domain)
    farthest = np.maximum(rest, 1.0 - rest)
    tell(0.0)
    found, looked_at = looks(domain.at(shares)), len(shares)
    best = np.argsort(-found, kind="stable")[:STARTS]
    shares, largest = shares[best], found[best]
    for round_number, width in enumerate(_WIDTHS):
        tell((round_number + 1) / (len(_WIDTHS) + 1))
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
    """Which of the states' currents (s, c) are nearest to currents (c,)."""
    return int(np.linalg.norm(states - currents, axis=1).argmin())


def is_among(currents: Array, states: Array) -> NDArray[np.bool_]:
    """Which of the states' currents (s, c) are currents (c,), up to rounding."""
    return np.asarray(np.abs(states - currents).max(axis=1) <= _SAME * np.abs(states).max(initial=0.0))

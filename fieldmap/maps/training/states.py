"""The solved states that train a reduced model: their currents, their solution, their images under the symmetry."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from fieldmap.currents import CurrentDomain
from fieldmap.iron import NonlinearSolver
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.parallel import Common, Outcome, WorkerDied, Workers
from fieldmap.records import Record
from fieldmap.store import Checkpoint
from fieldmap.typing import Array

# Of more corners so many are looked at, at random.
MOST_CORNERS = 256
# Of more pairs of signals at their ends so many are looked at, at random.
_MOST_PAIRS = 128
# Share of a signal's range that a tangent stands for.
REACH = 0.125
# Of the states to train on, one in so many is its own image.
_ON_MIRROR = 4
_SEED, _ORDER_SEED, _HELD_OUT_SEED = 3, 7, 20261


def sequence(domain: CurrentDomain, first: int, count: int) -> Array:
    """Signals (count, d), from number `first` on, of a sequence that fills the domain evenly: the middle, then low
    discrepancy (Sobol), denser towards the faces, where a model has neighbours on one side only."""
    # Here: only who trains a model needs scipy.stats, which takes a second to load.
    from scipy.stats import qmc

    d = domain.parametrisation.signal_count
    power = int(np.ceil(np.log2(max(2, first + count))))
    shares = qmc.Sobol(d, seed=_SEED).random_base2(power)
    spread = np.concatenate([np.full((1, d), 0.5), 0.5 - 0.5 * np.cos(np.pi * shares)])
    return domain.parametrisation.within(domain.lower, domain.upper, spread[first : first + count])


def training_signals(
    domain: CurrentDomain, count: int, images: Sequence[StateImage], off: bool = False
) -> Array:
    """Signals (count, d) of the states to train on: `sequence`, but every fourth has the currents half way between its
    own and those of an image. There the iron's symmetric parts are magnetised alike, and the field may turn sharply
    when the currents leave that plane; a sequence that fills the box meets no such place but its middle. off: the
    second is that without currents, if the domain has it and the first is another."""
    signals = sequence(domain, 0, count)
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


def corners(domain: CurrentDomain) -> Array:
    """Currents (m, c) of `corner_signals`."""
    return domain.parametrisation.currents(corner_signals(domain))


def extreme_signals(domain: CurrentDomain) -> Array:
    """Signals (m, d) where a model is likely to be worst: lines of one signal alone, the others at rest (`at_rest`), at
    both ends, half way and a fiftieth of the way; all signals at equal shares of their ranges; two signals at their
    ends, with the others at rest, which holds opposite coils and edges; and the corners. In this order; of more than
    128 pairs and 256 corners as many at random."""
    d = domain.parametrisation.signal_count
    span = domain.upper - domain.lower
    neutral = at_rest(domain)
    rows = []
    for k, way, end in itertools.product(range(d), (1.0, 0.5, 0.02), (0.0, 1.0)):
        rows.append(np.where(np.arange(d) == k, neutral + way * (end - neutral), neutral))
    rows += [np.full(d, share) for share in (0.25, 0.5, 0.75)]
    pairs = []
    for ends in itertools.product(itertools.combinations(range(d), 2), (0.0, 1.0), (0.0, 1.0)):
        row = neutral.copy()
        row[list(ends[0])] = ends[1:]
        pairs.append(row)
    order = np.random.default_rng(_ORDER_SEED).permutation(len(pairs))[:_MOST_PAIRS]
    rows += [pairs[k] for k in order]
    signals = domain.parametrisation.within(domain.lower, domain.upper, np.array(rows).reshape(-1, d))
    signals = np.concatenate([signals, corner_signals(domain)])
    # Each once, and none without any currents, whose field is that of magnets and background alone.
    shares = (signals - domain.lower) / span
    _, first = np.unique(shares.round(9), axis=0, return_index=True)
    kept = np.sort(first)
    moving = np.abs(domain.parametrisation.currents(signals[kept])).max(axis=1) > 0.0
    return np.asarray(signals[kept[moving]])


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


# Currents that differ by less than this share of the largest are the same state.
_SAME = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class Solved(Record):
    """A solved state: its nodal potential (n,); its derivatives along the signals (n, d), each times what `reaches`
    gives; and the air's share S of both, (n, 1 + d). The last two are empty where a state is not to train on."""

    potential: Array
    tangents: Array
    air: Array

    def image(self, of: StateImage) -> "Solved":
        """The state that a symmetry makes of it."""
        return Solved(of.potential(self.potential), of.potential(self.tangents), of.potential(self.air))


class Snapshots:
    """Currents and solved states, in the order in which they came; an image costs no solve, and no memory but that of
    its currents: it is made anew each time it is asked for.

    admits(currents (c,)): whether an image is wanted.
    """

    def __init__(self, solver: NonlinearSolver, admits: Callable[[Array], bool]) -> None:
        self._solver, self._images, self._admits = solver, solver.images, admits
        self._currents: list[Array] = []
        self._states: list[tuple[Solved, StateImage | None]] = []
        self._own: list[bool] = []

    @property
    def solved(self) -> int:
        """How many are no images."""
        return sum(self._own)

    @property
    def own(self) -> tuple[bool, ...]:
        """Which are no images."""
        return tuple(self._own)

    @property
    def currents(self) -> Array:
        """(s, c), A."""
        return np.array(self._currents)

    @property
    def potentials(self) -> Array:
        """Nodal potentials (n, s)."""
        return np.array(
            [of.potential if image is None else image.potential(of.potential) for of, image in self._states]
        ).T

    @property
    def states(self) -> Iterator[Solved]:
        """All of them, images too, one at a time."""
        return (self.state(k) for k in range(len(self._states)))

    def state(self, number: int) -> Solved:
        """One of them."""
        of, image = self._states[number]
        return of if image is None else of.image(image)

    def add(self, currents: Array, state: Solved) -> None:
        """A solved state of currents (c,), and its images."""
        self.put(currents, state, True)
        for image in self._images:
            values = image.currents(currents)
            if self.number(values) is None and self._admits(values):
                self.put(values, state, False, image)

    def put(self, currents: Array, state: Solved, own: bool, image: StateImage | None = None) -> None:
        """One state of currents (c,), or its image, without other images; own: it is no image itself."""
        self._currents.append(currents)
        self._states.append((state, image))
        self._own.append(own)

    def empty(self, admits: Callable[[Array], bool]) -> "Snapshots":
        """No states yet, of the same solver."""
        return Snapshots(self._solver, admits)

    def solved_ones(self) -> "Snapshots":
        """Those that are no images."""
        found = self.empty(nothing)
        for currents, (state, image), own in zip(self._currents, self._states, self._own, strict=True):
            if own:
                found.put(currents, state, True, image)
        return found

    def number(self, currents: Array) -> int | None:
        """Which state has these currents (c,)."""
        if not self._currents:
            return None
        same = is_among(currents, self.currents)
        return int(same.argmax()) if same.any() else None

    def nearest(self, currents: Array) -> Array | None:
        """Potential (n,) of the state nearest to currents (c,) that carries any."""
        if not self._currents:
            return None
        away = np.linalg.norm(self.currents - currents, axis=1)
        best = int(np.where(np.abs(self.currents).max(axis=1) > 0, away, np.inf).argmin())
        return self.state(best).potential if self._currents[best].any() else None


def nearest_of(currents: Array, states: Array) -> int:
    """Which of the states' currents (s, c) are nearest to currents (c,)."""
    return int(np.linalg.norm(states - currents, axis=1).argmin())


def is_among(currents: Array, states: Array) -> NDArray[np.bool_]:
    """Which of the states' currents (s, c) are currents (c,), up to rounding."""
    return np.asarray(np.abs(states - currents).max(axis=1) <= _SAME * np.abs(states).max(initial=0.0))


def one_of(states: Array) -> Callable[[Array], bool]:
    """Whether currents (c,) are among those of the states (s, c)."""
    return lambda currents: bool(is_among(currents, states).any())


def nothing(currents: Array) -> bool:
    """No image."""
    return False


# Not the state's fault: another day, or another machine, and it is solved.
_OF_THE_MACHINE = (WorkerDied, MemoryError, OSError)


@dataclass(frozen=True, eq=False, repr=False)
class Wanted(Record):
    """A state to solve: its number, currents (c,), nodal potential (n,) to begin from, and the directions (c, d) of the
    currents along which its derivatives are wanted, where it is to train on. Where it begins must not depend on which
    others happen to be solved already."""

    number: int
    currents: Array
    start: Array | None = None
    directions: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class TriedState(Record):
    """currents (c,); the state, or the reason why there is none; seconds of the clock and of the processors that it
    took."""

    currents: Array
    state: Solved | str
    seconds: float = 0.0
    processor_seconds: float = 0.0


@dataclass
class SolvedStates:
    """Solves states, or takes them from the checkpoint where they are there already.

    failed: number of the state -> why it could not be solved; count: states that were; computed: how many this run has
    tried, not found; earlier_seconds and
    earlier_processor_seconds: what those from the checkpoint took in the runs that solved them.
    """

    checkpoint: Checkpoint
    solver: Common[NonlinearSolver]
    workers: Workers
    failed: dict[int, str] = field(default_factory=dict)
    count: int = 0
    computed: int = 0
    earlier_seconds: float = 0.0
    earlier_processor_seconds: float = 0.0
    _counted: set[int] = field(default_factory=set)

    def known(self, number: int, currents: Array) -> TriedState | None:
        """The state of this number, or None if it was never tried, or with other currents than these (c,)."""
        piece = self.checkpoint.get(_key(number))
        if piece is None:
            return None
        arrays, about = piece
        if not np.array_equal(arrays["currents"], currents):
            return None
        failed = about["failed"]
        state = Solved(*(arrays[name] for name in _ARRAYS)) if failed is None else str(failed)
        return TriedState(arrays["currents"], state, *map(float, about["costs"]))

    def solve(
        self, wanted: Sequence[Wanted], tolerance: float, tell: Callable[[int], None]
    ) -> list[Solved | None]:
        """Every state, in their order; None where it could not be solved.

        tell(k) is called once k of them are there and others are not.
        """
        found = [self.known(state.number, state.currents) for state in wanted]
        for state, tried in zip(wanted, found, strict=True):
            # Asked for once more, a state of this run is neither earlier nor another.
            if tried is not None and state.number not in self._counted:
                self.earlier_seconds += tried.seconds
                self.earlier_processor_seconds += tried.processor_seconds
        missing = [k for k, tried in enumerate(found) if tried is None]
        items = [(wanted[k].currents, tolerance, wanted[k].start, wanted[k].directions) for k in missing]
        done, begin = len(wanted) - len(missing), monotonic()
        if missing:
            tell(done)
        for outcome in self.workers.map(_solved, items, self.solver, threads=True):
            number = missing[outcome.index]
            found[number] = self._put(wanted[number], outcome, monotonic() - begin)
            done, begin = done + 1, monotonic()
            if done < len(wanted):
                tell(done)
        return [self._state(state, tried) for state, tried in zip(wanted, found, strict=True)]

    def _put(self, state: Wanted, outcome: Outcome[Solved], seconds: float) -> TriedState:
        """seconds: since the state before; of several at a time each counts its share."""
        if isinstance(outcome.error, _OF_THE_MACHINE):
            raise outcome.error
        self.computed += 1
        solved = outcome.reason or outcome.result()
        tried = TriedState(state.currents, solved, seconds, outcome.processor_seconds)
        arrays, failed = {"currents": state.currents}, None
        if isinstance(solved, str):
            failed = solved
        else:
            arrays |= {name: getattr(solved, name) for name in _ARRAYS}
        costs = (tried.seconds, tried.processor_seconds)
        self.checkpoint.put(_key(state.number), arrays, {"failed": failed, "costs": costs})
        return tried

    def _state(self, state: Wanted, tried: TriedState | None) -> Solved | None:
        assert tried is not None
        new = state.number not in self._counted
        self._counted.add(state.number)
        if isinstance(tried.state, str):
            self.failed[state.number] = tried.state
            return None
        self.count += new
        return tried.state


_ARRAYS = tuple(field.name for field in fields(Solved))


def _key(number: int) -> str:
    return f"state {number}"


def _solved(solver: NonlinearSolver, item: tuple[Array, float, Array | None, Array | None]) -> Solved:
    currents, tolerance, start, directions = item
    potential = np.ascontiguousarray(solver.solve(currents, tolerance, start=start).state.potential[:, 0])
    if directions is None:
        nothing = np.zeros((len(potential), 0))
        return Solved(potential, nothing, nothing)
    tangents = solver.sensitivities(currents, potential, directions)
    return Solved(potential, tangents, solver.air(np.column_stack([potential, tangents])))

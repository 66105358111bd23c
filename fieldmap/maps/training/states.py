"""The solved states that train a reduced model: how they are solved and kept, and their images by symmetry."""

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from time import monotonic

import numpy as np

from fieldmap.iron import HysteresisSolver, NonlinearSolver
from fieldmap.iron.solvers.nonlinear import StateImage
from fieldmap.maps.training.currents import is_among
from fieldmap.parallel import Common, Outcome, WorkerDied, Workers
from fieldmap.records import Record
from fieldmap.store import Checkpoint, Piece
from fieldmap.typing import Array

# Errors of the machine, not of the state: a later run, or one on another machine, can solve it.
_OF_THE_MACHINE = (WorkerDied, MemoryError, OSError)
# Names of a solved state's arrays in the checkpoint.
_ARRAYS = ("potential", "tangents", "air")
# Tangents of a state, and the air operator times these, of more bytes than this stay on the disk.
_LARGE = 2**24


@dataclass(frozen=True, eq=False, repr=False)
class Solved(Record):
    """A solved state.

    Attributes
    ----------
    potential : (n,), nodal potential.
    tangents : (n, d), its derivatives along the steps of `reaches`.
    air : (n, 1 + d), the air operator S times the potential and the tangents.

    A state that the model is not trained on has no tangents: then the last two are empty.
    """

    potential: Array
    tangents: Array
    air: Array

    def image(self, of: StateImage) -> "Solved":
        """The image of this state by a symmetry."""
        return Solved(of.potential(self.potential), of.potential(self.tangents), of.potential(self.air))


@dataclass(frozen=True, eq=False, repr=False)
class Stored(Record):
    """A solved state whose tangents stay on the disk, because those of many coils fill the memory.

    Attributes
    ----------
    potential : (n,), nodal potential.
    read : reads the whole state.
    """

    potential: Array
    read: Callable[[], Solved]

    def image(self, of: StateImage) -> Solved:
        """The image of this state by a symmetry."""
        return self.read().image(of)


class Snapshots:
    """Solved states and their currents, in the order in which they were added, with images by symmetry.

    An image takes no solve. Only its currents are stored: the state is computed each time that it is read.

    Parameters
    ----------
    solver
        Knows the symmetries.
    admits
        admits(currents (c,)) says whether an image with these currents is added; no images unless given.
    """

    def __init__(
        self,
        solver: NonlinearSolver | HysteresisSolver,
        admits: Callable[[Array], bool] = lambda currents: False,
    ) -> None:
        self._solver, self._admits = solver, admits
        self._currents: list[Array] = []
        self._states: list[tuple[Solved | Stored, StateImage | None]] = []

    @property
    def own(self) -> tuple[bool, ...]:
        """For each state whether it was solved, and is not an image."""
        return tuple(image is None for _, image in self._states)

    @property
    def solved(self) -> int:
        """Number of states that were solved, images not counted."""
        return sum(self.own)

    @property
    def currents(self) -> Array:
        """Currents (s, c), A."""
        return np.array(self._currents)

    @property
    def potentials(self) -> Array:
        """Nodal potentials (n, s)."""
        return np.array(
            [of.potential if image is None else image.potential(of.potential) for of, image in self._states]
        ).T

    @property
    def states(self) -> Iterator[Solved]:
        """All states, images included, one at a time."""
        return (self.state(k) for k in range(len(self._states)))

    def state(self, number: int) -> Solved:
        """State `number`; an image is computed now, and tangents on the disk are read now."""
        held = self.held(number)
        return held.read() if isinstance(held, Stored) else held

    def held(self, number: int) -> Solved | Stored:
        """State `number` as `add` takes it: tangents on the disk stay there."""
        of, image = self._states[number]
        return of if image is None else of.image(image)

    def add(self, currents: Array, state: Solved | Stored) -> None:
        """Add a solved state of currents (c,), and its images that `admits` allows."""
        self._put(currents, state, None)
        for image in self._solver.images:
            values = image.currents(currents)
            if self.number(values) is None and self._admits(values):
                self._put(values, state, image)

    def _put(self, currents: Array, state: Solved | Stored, image: StateImage | None) -> None:
        self._currents.append(currents)
        self._states.append((state, image))

    def some(self, numbers: Iterable[int]) -> "Snapshots":
        """The states of these numbers. States that are added to the result later get no images."""
        found = Snapshots(self._solver)
        for k in numbers:
            found._put(self._currents[k], *self._states[k])
        return found

    def without(self, known: "Snapshots") -> "Snapshots":
        """The states that are not in `known`."""
        return self.some(k for k, values in enumerate(self._currents) if known.number(values) is None)

    def with_earlier(self, earlier: "Snapshots") -> "Snapshots":
        """These states, and the solved ones of `earlier` that are not among them."""
        both = self.some(range(len(self._currents)))
        for k, own in enumerate(earlier.own):
            if own and both.number(earlier._currents[k]) is None:
                both._put(earlier._currents[k], *earlier._states[k])
        return both

    def number(self, currents: Array) -> int | None:
        """Number of the state with currents (c,); None if there is none."""
        if not self._currents:
            return None
        same = is_among(currents, self.currents)
        return int(same.argmax()) if same.any() else None

    def nearest(self, currents: Array) -> Array | None:
        """Potential (n,) of the nearest state to currents (c,), among states with currents; None if there is none."""
        if not self._currents:
            return None
        away = np.linalg.norm(self.currents - currents, axis=1)
        best = int(np.where(np.abs(self.currents).max(axis=1) > 0, away, np.inf).argmin())
        return self.held(best).potential if self._currents[best].any() else None


@dataclass(frozen=True, eq=False, repr=False)
class Wanted(Record):
    """A state to solve.

    Attributes
    ----------
    number : of the state in the checkpoint.
    currents : (c,), A.
    start : nodal potential (n,) at which the solve begins. It must not depend on which other states are solved already,
        so that a resumed run gives the same bits.
    directions : (c, d), changes of the currents along which tangents are solved, if the model may be trained on it.
    """

    number: int
    currents: Array
    start: Array | None = None
    directions: Array | None = None


@dataclass(frozen=True, eq=False, repr=False)
class TriedState(Record):
    """The outcome of a solve: the state, or the reason of its failure; seconds of wall-clock and of processor time."""

    state: Solved | Stored | str
    seconds: float
    processor_seconds: float


class SolvedStates:
    """Solves states, or takes them from the checkpoint if they are there already.

    Attributes
    ----------
    failed : reasons by number, of the states that could not be solved.
    count : number of solved states.
    computed : number of states that this run tried to solve, those from the checkpoint not counted.
    earlier_seconds, earlier_processor_seconds : time that earlier runs took for the states from the checkpoint.
    """

    def __init__(self, checkpoint: Checkpoint, solver: Common[NonlinearSolver], workers: Workers) -> None:
        self._checkpoint, self._solver, self._workers = checkpoint, solver, workers
        self.failed: dict[int, str] = {}
        self.count = self.computed = 0
        self.earlier_seconds = self.earlier_processor_seconds = 0.0
        self._counted: set[int] = set()

    @property
    def free_disk(self) -> int:
        """Bytes of the disk that states may take, those of earlier runs included."""
        path = self._checkpoint.path
        return shutil.disk_usage(path.parent).free + path.stat().st_size

    def known(self, number: int, currents: Array) -> TriedState | None:
        """The state of this number, or None if it was never tried, or with other currents than these (c,)."""
        piece = self._checkpoint.get(_key(number))
        if piece is None or not np.array_equal(piece.arrays["currents"], currents):
            return None
        failed = piece.about["failed"]
        state = self._without_large(number, _of(piece)) if failed is None else str(failed)
        return TriedState(state, *map(float, piece.about["costs"]))

    def solve(
        self, wanted: Sequence[Wanted], tolerance: float, tell: Callable[[int], None]
    ) -> list[Solved | Stored | None]:
        """Solve states.

        Parameters
        ----------
        wanted
            The states.
        tolerance
            Of the solver.
        tell
            tell(k) is called when k states are done and others are not.

        Returns
        -------
        list[Solved | Stored | None]
            The states in the order of `wanted`; None for one that could not be solved.
        """
        known = (self.known(state.number, state.currents) for state in wanted)
        tried = {k: one for k, one in enumerate(known) if one is not None}
        for k, one in tried.items():
            # A state that this run has counted already does not add to the time of earlier runs.
            if wanted[k].number not in self._counted:
                self.earlier_seconds += one.seconds
                self.earlier_processor_seconds += one.processor_seconds
        missing = [k for k in range(len(wanted)) if k not in tried]
        items = [(wanted[k].currents, tolerance, wanted[k].start, wanted[k].directions) for k in missing]
        begin = monotonic()
        if missing:
            tell(len(tried))
        for outcome in self._workers.map(_solved, items, self._solver, threads=True):
            k = missing[outcome.index]
            tried[k] = self._put(wanted[k], outcome, monotonic() - begin)
            begin = monotonic()
            if len(tried) < len(wanted):
                tell(len(tried))
        return [self._counting(state.number, tried[k].state) for k, state in enumerate(wanted)]

    def _put(self, state: Wanted, outcome: Outcome[Solved], seconds: float) -> TriedState:
        """Store the outcome. seconds: time since the last outcome; states solved in parallel share the time."""
        if isinstance(outcome.error, _OF_THE_MACHINE):
            raise outcome.error
        self.computed += 1
        failed = outcome.reason or None
        solved = {} if failed else {name: getattr(outcome.result(), name) for name in _ARRAYS}
        costs = (seconds, outcome.processor_seconds)
        about = {"failed": failed, "costs": costs}
        self._checkpoint.put(_key(state.number), {"currents": state.currents, **solved}, about)
        return TriedState(failed or self._without_large(state.number, outcome.result()), *costs)

    def _without_large(self, number: int, state: Solved) -> Solved | Stored:
        """A state of the checkpoint; where its tangents are large they are only there."""
        if state.tangents.nbytes + state.air.nbytes <= _LARGE:
            return state

        def read() -> Solved:
            piece = self._checkpoint.get(_key(number))
            assert piece is not None
            return _of(piece)

        return Stored(state.potential, read)

    def _counting(self, number: int, state: Solved | Stored | str) -> Solved | Stored | None:
        new = number not in self._counted
        self._counted.add(number)
        if isinstance(state, str):
            self.failed[number] = state
            return None
        self.count += new
        return state


def _of(piece: Piece) -> Solved:
    return Solved(*(piece.arrays[name] for name in _ARRAYS))


def _key(number: int) -> str:
    return f"state {number}"


def _solved(solver: NonlinearSolver, item: tuple[Array, float, Array | None, Array | None]) -> Solved:
    currents, tolerance, start, directions = item
    potential, air = solver.solve_potential(currents, tolerance, start)
    if directions is None:
        nothing = np.zeros((len(potential), 0))
        return Solved(potential, nothing, nothing)
    tangents = solver.sensitivities(currents, potential, directions)
    return Solved(potential, tangents, np.column_stack([air, solver.air(tangents)]))

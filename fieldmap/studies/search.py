"""The designs of an optimisation, solved once and kept, with values and derivatives in the form that optimisers need.

Variables are scaled to 0 and 1 at their bounds, the objective by its size at the start, limits by their bounds. A
design that cannot be solved has finite values, so that the optimiser takes back the step to it: an objective worse than
all solved ones by its size at the start, and the limits of the last solved design.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from fieldmap.arguments import check
from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError, Infeasible
from fieldmap.iron.sensitivity.adjoint import quantity_of
from fieldmap.iron.sensitivity.quantities import Quantity as FieldQuantity
from fieldmap.parallel import Common, Workers
from fieldmap.plain import plain, plain_fields
from fieldmap.progress import Forecast, rate
from fieldmap.provenance import fingerprint
from fieldmap.records import Record
from fieldmap.store import Checkpoint, checkpoint_path
from fieldmap.studies.design import WITHOUT_SLOPES, DesignProblem, Limit, Number
from fieldmap.studies.number_slopes import Slopes, VariedParameters, exact_slopes
from fieldmap.studies.optimum import Kind, Role, Step
from fieldmap.studies.quantities import Places
from fieldmap.studies.study import CODE
from fieldmap.studies.variant_result import OperatingPoint, SolvedIron, numbers_at, reason
from fieldmap.typing import Array, PathLike, Progress

# Number of successive designs within the tolerance of each other that end the search.
_SAME = 8


@dataclass(frozen=True, eq=False, repr=False)
class Asked(Record):
    """A design to be solved: values (k,) of the variables, on a mesh of a refinement. derive: keys by which exact
    derivatives are wanted."""

    values: Array
    refinement: float
    derive: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Record):
    """A solved design. values: of the variables by key; numbers: by label; slopes: exact derivatives by label and key;
    refused: keys without exact ones, and why. failure: why there are no numbers, or ""."""

    values: Mapping[str, float]
    refinement: float
    numbers: Mapping[str, float]
    slopes: Mapping[str, Mapping[str, float]]
    refused: Mapping[str, str]
    failure: str = ""

    @property
    def solved(self) -> bool:
        """Whether there are numbers."""
        return not self.failure


def evaluate(problem: DesignProblem, asked: Asked) -> Evaluation:
    """Solve a design. A failure is a reason in the result, never an error, so that the search continues."""
    named = problem.named(asked.values)
    try:
        numbers, slopes = _solved(problem, asked)
    except Exception as error:
        return Evaluation(named, asked.refinement, {}, {}, {}, reason("design", error))
    return Evaluation(named, asked.refinement, numbers, slopes.by, slopes.refused)


def _solved(problem: DesignProblem, asked: Asked) -> tuple[dict[str, float], Slopes]:
    device = device_of(problem.document_at(asked.values))
    iron = SolvedIron(device, replace(problem.iron, refinement=asked.refinement))
    parameters = VariedParameters(device, problem.document, problem.variables, problem.named(asked.values))
    places = problem.places
    numbers: dict[str, float] = {}
    slopes: dict[str, Mapping[str, float]] = {}
    refused: dict[str, str] = {}
    for entry in problem.currents_at(asked.values):
        here = [part for one in problem.numbers for _, part in one.parts if part.currents == entry.name]
        if not here:
            continue
        wanted = {places[one.name][0].group for one in here if one.of is None}
        groups = tuple(group for group in problem.record.groups if group in wanted)
        point = OperatingPoint(device, iron, entry, replace(problem.record, groups=groups))
        numbers |= _numbers(point, here, places)
        if asked.derive:
            try:
                found = exact_slopes(point, here, places, parameters, asked.derive)
            except FieldmapError as error:
                found = Slopes({}, dict.fromkeys(asked.derive, reason("derivative", error)))
            slopes |= found.by
            refused |= found.refused
    parts = {one.label: [(sign, part.label) for sign, part in one.parts] for one in problem.numbers}
    exact = {
        name: {
            key: sum(sign * slopes[at][key] for sign, at in each)
            for key in asked.derive
            if all(key in slopes[at] for _, at in each)
        }
        for name, each in parts.items()
        if all(at in slopes for _, at in each)
    }
    joined = {name: sum(sign * numbers[at] for sign, at in each) for name, each in parts.items()}
    return joined, Slopes(exact, refused)


def _numbers(point: OperatingPoint, here: Iterable[Number], places: Places) -> dict[str, float]:
    values, problems = numbers_at(point)
    found = {}
    for number in here:
        if number.of is None:
            quantity, at = places[number.name]
            if quantity.name not in values:
                received, remedy = " || ".join(problems), "see why it is not"
                raise Infeasible.of(number.label, "must be found", received, remedy)
            value: Any = np.asarray(values[quantity.name])[at] if at else values[quantity.name]
        else:
            state: Any = point.iron.field.at(point.currents)
            if isinstance(number.of, FieldQuantity):
                value = quantity_of(state, number.of)
            else:
                value = number.of(point.device, state)
            value = np.asarray(value, dtype=float).reshape(())
        if not np.isfinite(value):
            raise Infeasible.of(number.label, "must be a finite number", str(value), "see the device")
        found[number.label] = float(value)
    return found


@contextmanager
def searching(
    problem: DesignProblem,
    output: PathLike | None,
    resume: bool,
    workers: int,
    progress: Progress | None,
    scheduler: str | None = None,
) -> Iterator[Designs]:
    """A search by workers; its designs are kept in OUTPUT.kept."""
    keep = (
        nullcontext()
        if output is None
        else Checkpoint(checkpoint_path(output, stays=True), problem_fingerprint(problem), resume)
    )
    with Workers(workers, scheduler) as team, keep as checkpoint:
        yield Designs(problem, team, checkpoint, progress or (lambda message, fraction: None))


def problem_fingerprint(problem: DesignProblem) -> str:
    """Fingerprint of everything that determines the numbers of a design. It does not depend on bounds, start, method
    and limits, so that another search can use the designs of an earlier one."""
    device, record = device_of(problem.document), problem.record
    numbers = [
        f"{one.label} {getattr(one.of, '__qualname__', type(one.of).__name__)}" for one in problem.numbers
    ]
    settings = (
        # All fields, since the repr of a record is shortened.
        [(one.key, [plain_fields(follower) for follower in one.linked]) for one in problem.variables],
        sorted(numbers),
        [plain_fields(one) for one in problem.current_sets],
        plain_fields(replace(problem.iron, refinement=1.0)),
        plain([record.points, record.force_share, record.current_limit, record.box]),
    )
    return fingerprint((*device.texts, *map(repr, settings)), CODE)


class SearchEnded(Exception):  # noqa: N818 - an end, not an error
    """Ends the search before the optimiser does; its text is the reason."""


class Designs:
    """Designs of a problem, solved once. checkpoint: keeps them for later runs, unless it is None."""

    def __init__(
        self, problem: DesignProblem, team: Workers, checkpoint: Checkpoint | None, say: Progress
    ) -> None:
        self.problem, self._team, self._checkpoint = problem, team, checkpoint
        self._expected = problem.solves
        self._forecast = Forecast(say, {"designs": problem.solves}, team.processes)
        self._common = Common.of(problem)
        self.steps: list[Step] = []
        self.solves = self.kept = 0
        self.refused: dict[str, str] = {}
        self.kinds: dict[str, dict[str, Kind]] = {number.label: {} for number in problem.numbers}
        self._known: dict[str, Evaluation] = {}
        # Differences that correct numbers of the search's mesh to those of the finer mesh.
        self.shift: dict[str, float] = {}
        self._low = np.array([one.lower for one in problem.variables])
        self._width = np.array([one.upper for one in problem.variables]) - self._low
        self._scale = 1.0
        self._worst = -np.inf
        self._last: list[Array] = []

    # Designs.

    def values(self, z: Array) -> Array:
        """Values (k,) of the variables at scaled ones."""
        return self._low + np.clip(z, 0.0, 1.0) * self._width

    def scaled(self, found: Evaluation) -> Array:
        """Scaled values (k,) of a design."""
        return (self.problem.values(found.values) - self._low) / self._width

    def at(self, values: Array) -> Evaluation:
        """A design of the search, with exact derivatives where the method uses them."""
        derive = () if self.problem.method in WITHOUT_SLOPES else self.problem.keys
        (found,) = self._solve([values], self.problem.iron.refinement, "step", derive)
        return found

    def checked(self, values: Array, refinement: float) -> Evaluation:
        """A design on another mesh."""
        (found,) = self._solve([values], refinement, "check", ())
        return found

    def sampled(self, designs: list[Array]) -> list[Evaluation]:
        """Designs without derivatives, in the given order."""
        return self._solve(designs, self.problem.iron.refinement, "sample", ())

    def _solve(
        self, designs: list[Array], refinement: float, role: Role, derive: tuple[str, ...]
    ) -> list[Evaluation]:
        derive = tuple(key for key in derive if key not in self.refused)
        names = [self._name(role == "step", refinement, design) for design in designs]
        if role == "difference":
            steps = [self._name(True, refinement, design) for design in designs]
            names = [step if step in self._known else name for step, name in zip(steps, names, strict=True)]
        for name in names:
            piece = self._checkpoint.get(name) if self._checkpoint is not None else None
            if piece is not None and name not in self._known:
                self._known[name] = Evaluation(**piece.about)
                self.kept += 1
                self._note(self._known[name], role, True)
        waiting = [k for k, name in enumerate(names) if name not in self._known]
        if self.solves + self.kept + len(waiting) > self.problem.solves and role != "check":
            raise SearchEnded(f"{self.problem.solves} designs were solved, as many as allowed")
        if role == "step" and waiting:
            self._settled(designs[0])
        asked, untold = [Asked(designs[k], refinement, derive) for k in waiting], deque(waiting)
        for outcome in self._team.map(evaluate, asked, self._common):
            k = waiting[outcome.index]
            found = outcome.value or Evaluation(
                self.problem.named(designs[k]), refinement, {}, {}, {}, outcome.reason or "no result"
            )
            if self._checkpoint is not None:
                self._checkpoint.put(names[k], about=asdict(found))
            self._known[names[k]] = found
            self.solves += 1
            # Designs are noted in the order of `asked`, not in the order in which they are finished.
            while untold and names[untold[0]] in self._known:
                self._note(self._known[names[untold.popleft()]], role, False)
        return [self._known[name] for name in names]

    def _settled(self, design: Array) -> None:
        """End the search if successive designs hardly differ, as may happen if no design meets the limits."""
        self._last = [*self._last[1 - _SAME :], (design - self._low) / self._width]
        if len(self._last) == _SAME and np.ptp(self._last, axis=0).max() < self.problem.tolerance:
            self._last = []
            raise SearchEnded(f"{_SAME} designs in a row hardly differ")

    def expect(self, designs: int) -> None:
        """Set the number of designs that are still to be solved, for the forecast."""
        self._expected = self.solves + self.kept + designs

    def _name(self, derived: bool, refinement: float, design: Array) -> str:
        # Twelve digits, since scaling values back and forth changes them by rounding.
        return json.dumps([derived, refinement, [f"{value:.12g}" for value in design]])

    def _note(self, found: Evaluation, role: Role, kept: bool) -> None:
        self.refused |= found.refused
        feasible = found.solved and self.violation(found) <= self.problem.tolerance
        self.steps.append(
            Step(role, kept, found.refinement, found.values, found.numbers, feasible, found.failure)
        )
        label = self.problem.objective.label
        text = f"{label} {found.numbers[label]:.6g}" if found.solved else "failed"
        pace = rate(self.solves, self._forecast.taken(), "design")
        message = f"design {len(self.steps)}, {role}: {text}{pace}"
        # Designs of an earlier run take no time.
        self._forecast.at("designs", message, self.solves, max(self._expected - self.kept, self.solves))

    # Objective and limits.

    def number(self, found: Evaluation, number: Number) -> float:
        """A number of a design, corrected to the finer mesh if the correction is known."""
        shift = self.shift.get(number.label, 0.0) if self._on_search_mesh(found) else 0.0
        return found.numbers[number.label] + shift

    def excess(self, found: Evaluation, limit: Limit) -> float:
        """Violation of a limit over its scale."""
        return limit.violation(self.number(found, limit.asked)) / limit.scale

    def violation(self, found: Evaluation) -> float:
        """Largest violation over the limits' scales."""
        return max((self.excess(found, limit) for limit in self.problem.limits), default=0.0)

    def begin(self) -> Evaluation:
        """Solve the start of the search. Raises InputError if that fails."""
        found = self.at(self.problem.starts)
        must_hold = "the design at which the search begins must be solved"
        remedy = "begin at a design that can be solved, or correct the device"
        check(found.solved, "optimise", must_hold, found.failure, remedy)
        self._scale = abs(found.numbers[self.problem.objective.label]) or 1.0
        return found

    def objective(self, z: Array) -> float:
        """Scaled objective, to be minimised."""
        found = self.at(self.values(z))
        if not found.solved:
            return self._worst + 1.0
        value = self.problem.sign * self.number(found, self.problem.objective) / self._scale
        self._worst = max(self._worst, value)
        return value

    def objective_slopes(self, z: Array) -> Array:
        """Derivatives (k,) of the objective by the scaled variables."""
        slopes = self.slopes(self.values(z), self.problem.objective)
        return self.problem.sign * slopes * self._width / self._scale

    def limits(self, z: Array) -> Array:
        """Scaled distances (m,) from each bound of each limit; negative where it is violated."""
        return np.array([room for room, _, _ in self._rooms(self._solved_at(z))])

    def limit_slopes(self, z: Array) -> Array:
        """Derivatives (m, k) of the limits by the scaled variables."""
        values, rooms = self.values(z), self._rooms(self._solved_at(z))
        rows = [side * self.slopes(values, number) * self._width for _, side, number in rooms]
        return np.array(rows).reshape(-1, len(values))

    def _solved_at(self, z: Array) -> Evaluation:
        """A design, or the last solved one if it cannot be solved."""
        found = self.at(self.values(z))
        return found if found.solved else self._of_the_search()[-1]

    def _rooms(self, found: Evaluation) -> list[tuple[float, float, Number]]:
        """For each bound: scaled distance from it, derivative of this distance by the number, and the number."""
        rooms = []
        for limit in self.problem.limits:
            value = self.number(found, limit.asked)
            for side, bound in ((1.0, limit.lower), (-1.0, limit.upper)):
                if np.isfinite(bound):
                    rooms.append((side * (value - bound) / limit.scale, side / limit.scale, limit.asked))
        return rooms

    def violations(self, z: Array) -> float:
        """Sum of the squares of the limits' violations, scaled."""
        found = self.at(self.values(z))
        if not found.solved:
            return 1e3
        return float(sum(min(room, 0.0) ** 2 for room, _, _ in self._rooms(found)))

    def violation_slopes(self, z: Array) -> Array:
        """Derivatives (k,) of `violations` by the scaled variables."""
        values = self.values(z)
        found, total = self.at(values), np.zeros(len(values))
        for room, side, number in self._rooms(found) if found.solved else ():
            if room < 0.0:
                total += 2 * room * side * self.slopes(values, number) * self._width
        return total

    # Derivatives.

    def slopes(self, values: Array, number: Number) -> Array:
        """Derivatives (k,) of a number: exact ones where they exist, otherwise differences of designs."""
        found = self.at(values)
        exact = found.slopes.get(number.label, {}) if found.solved else {}
        out = np.zeros(len(values))
        # All at once, so that workers share them.
        sides = [
            side
            for k, key in enumerate(self.problem.keys)
            if key not in exact
            for side in self._sides(values, k)
        ]
        self._solve(sides, self.problem.iron.refinement, "difference", ())
        for k, key in enumerate(self.problem.keys):
            out[k] = exact[key] if key in exact else self._difference(values, k, number)
            self.kinds[number.label][key] = "exact" if key in exact else "differences"
        return out

    def _difference(self, values: Array, k: int, number: Number) -> float:
        """Central difference within the bounds; one-sided where a side cannot be solved, 0 where neither can."""
        sides = self._sides(values, k)
        found = self._solve(sides, self.problem.iron.refinement, "difference", ())
        pairs = [(side[k], one) for side, one in zip(sides, found, strict=True) if one.solved]
        if len(pairs) == 1:
            here = self.at(values)
            pairs += [(values[k], here)] if here.solved else []
        if len(pairs) < 2 or pairs[0][0] == pairs[1][0]:
            return 0.0
        (x0, below), (x1, above) = pairs
        return (above.numbers[number.label] - below.numbers[number.label]) / (x1 - x0)

    def _sides(self, values: Array, k: int) -> list[Array]:
        """The two designs of a central difference by variable k, within the bounds."""
        width, sides = self.problem.variables[k].difference, [values.copy(), values.copy()]
        sides[0][k] = max(values[k] - width, self._low[k])
        sides[1][k] = min(values[k] + width, self._low[k] + self._width[k])
        return sides

    # Results.

    def best(self) -> Evaluation | None:
        """The best design of the search that meets the limits; None if no design does."""
        good = [found for found in self._of_the_search() if self.violation(found) <= self.problem.tolerance]
        sign, objective = self.problem.sign, self.problem.objective
        return min(good, key=lambda found: sign * self.number(found, objective), default=None)

    def nearest(self) -> Evaluation:
        """The design of the search that comes nearest to meeting the limits."""
        return min(self._of_the_search(), key=self.violation)

    def _of_the_search(self) -> list[Evaluation]:
        return [found for found in self._known.values() if found.solved and self._on_search_mesh(found)]

    def _on_search_mesh(self, found: Evaluation) -> bool:
        return found.refinement == self.problem.iron.refinement

"""Unknown numbers of a machine from measurements on it: keys of its device file, fitted on solved fields.

The misfit is the sum of squares of (computed - measured) / deviation over all readings, and over the priors of the
unknowns. Each step of Gauss and Newton, in the trust region of `scipy.optimize.least_squares`, takes derivatives by
differences of whole solves, to one side on the way and central ones for the covariance: the device is read, meshed and
solved anew with every set of values, so that anything the device file holds may be unknown. The covariance of the fit
is (J^T J)^-1, which takes the deviations at their word (J. V. Beck and K. J. Arnold, Parameter Estimation in
Engineering and Science, Wiley 1977, section 7.7).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.field import AnyField, as_field
from fieldmap.iron import NonlinearSolver, solve_linear
from fieldmap.levitation import lift_current
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

Workers = Callable[[Callable[["_Job"], "list[Array]"], "Sequence[_Job]"], Iterable["list[Array]"]]
"""What does the same with many things, as `map` does."""
# Difference for derivatives, as a share of the value where the unknown begins: above what a new mesh changes.
_STEP = 0.01
# Along a combination of unknowns that the readings hold no better than this share of their values they tell nothing.
_UNKNOWN = 1.0
# Unknowns with more than this part in such a combination belong to it.
_PART = 0.2


@dataclass(frozen=True, repr=False)
class Unknown(Record):
    """A number of the device to be found: key path and where the search begins, in the unit of the key.

    lower, upper: bounds. prior: mean and standard deviation that are known from elsewhere. step: difference for the
    derivative, a hundredth of `start` unless given.
    """

    key: str
    start: float
    lower: float = -np.inf
    upper: float = np.inf
    prior: tuple[float, float] | None = None
    step: float | None = None


@runtime_checkable
class Readings(Protocol):
    """Measured numbers and what the machine would show.

    name: of the table; measured (n,), NaN where nothing was read; deviation: their standard deviation, one or (n,).
    """

    @property
    def name(self) -> str: ...
    @property
    def measured(self) -> ArrayLike: ...
    @property
    def deviation(self) -> ArrayLike: ...

    def computed(self, device: Device, field: AnyField) -> Array:
        """The same numbers (n,) of a device and its solved field."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class FieldReadings(Record):
    """Flux densities: measured (n, 3), T, NaN for components that were not read, at points (n, 3), m, with one set of
    currents (c,) or one for each point (n, c), A."""

    name: str
    points: ArrayLike
    currents: ArrayLike
    measured: ArrayLike
    deviation: ArrayLike

    def computed(self, device: Device, field: AnyField) -> Array:
        """B (3 n,)."""
        points, currents = np.asarray(self.points, dtype=float), np.asarray(self.currents, dtype=float)
        if currents.ndim < 2:
            return as_field(field).field(points, currents).ravel()
        rows = [as_field(field).field(x, i) for x, i in zip(points, currents, strict=True)]
        return np.concatenate(rows)


@dataclass(frozen=True, eq=False, repr=False)
class InductanceReadings(Record):
    """Inductances, H: measured (n,) between pairs of coils (n, 2), by number from 0; the same twice: of one coil.

    Of linear iron; saturating iron is taken at its initial permeability.
    """

    name: str
    pairs: ArrayLike
    measured: ArrayLike
    deviation: ArrayLike

    def computed(self, device: Device, field: AnyField) -> Array:
        """Entries (n,) of the inductance matrix."""
        matrix = field.inductance() if hasattr(field, "inductance") else solve_linear(device).inductance()
        first, second = np.asarray(self.pairs, dtype=np.int64).T
        return np.asarray(matrix[first, second])


@dataclass(frozen=True, eq=False, repr=False)
class LiftCurrentReadings(Record):
    """Currents that carry the payload: measured (n,), A, of the common current, with the payload's magnet at positions
    (n, 3), m. shares (c,): currents of the coils per ampere, 1 unless given."""

    name: str
    positions: ArrayLike
    measured: ArrayLike
    deviation: ArrayLike
    shares: ArrayLike | None = None

    def computed(self, device: Device, field: AnyField) -> Array:
        """Lift currents (n,)."""
        first, amperes = 1.0, []
        for position in np.asarray(self.positions, dtype=float):
            first = lift_current(field, device.payload, position, self.shares, first).current
            amperes.append(first)
        return np.array(amperes)


@dataclass(frozen=True, eq=False, repr=False)
class ComputedReadings(Record):
    """Anything that a function computes from the device and its field: places of equilibrium, forces, resistances."""

    name: str
    function: Callable[[Device, AnyField], ArrayLike]
    measured: ArrayLike
    deviation: ArrayLike

    def computed(self, device: Device, field: AnyField) -> Array:
        """The function's numbers (n,)."""
        return np.ravel(np.asarray(self.function(device, field), dtype=float))


@dataclass(frozen=True, eq=False, repr=False)
class ReadingsFit(Record):
    """One table of readings beside the fit: measured, before (with the unknowns where they began), after, and
    uncertainty (n,) of `after` from that of the unknowns. used: whether it was fitted, or is predicted. misfit and
    misfit_before: root mean square over the deviations."""

    name: str
    used: bool
    measured: Array
    before: Array
    after: Array
    uncertainty: Array
    misfit: float
    misfit_before: float


@dataclass(frozen=True, eq=False, repr=False)
class MachineFit(Record):
    """Unknowns found. values: by key path, in the units of the keys; covariance (k, k) and correlation (k, k) in their
    order; indistinct: groups of unknowns of which the readings hold some combination no better than its own size.

    tables: every table of readings, those that were predicted too. device: the machine with these values. solves: how
    many were needed.
    """

    values: Mapping[str, float]
    covariance: Array
    indistinct: tuple[tuple[str, ...], ...]
    misfit: float
    misfit_before: float
    tables: tuple[ReadingsFit, ...]
    device: Device
    solves: int
    assumptions: tuple[str, ...]

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each unknown."""
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def correlation(self) -> Array:
        """Correlation (k, k) of the unknowns."""
        size = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(size, size)


def fit_machine(
    device: PathLike | Device,
    unknowns: Sequence[Unknown],
    readings: Sequence[Readings],
    predict: Sequence[Readings] = (),
    solve: Callable[[Device], AnyField] | None = None,
    on_solve: Callable[[Mapping[str, float]], None] | None = None,
    close: float = 1e-5,
    workers: Workers = map,
) -> MachineFit:
    """Find numbers of a device from measurements.

    device: a file, its name, or made in Python. readings: what is fitted; predict: tables that are not, computed with
    the fit and with error bars from it. solve: the field of a device, `solve_linear` or, where its iron saturates,
    `NonlinearSolver` unless given. on_solve is called with the values of each solve. close: the search ends where all
    unknowns change by less than this share of their values. workers: a function like `map` that computes the
    derivatives' solves, such as the `map` of a pool of processes; readings and `solve` are then pickled.

    Raises InputError for keys that the device lacks, tables without numbers, fewer readings than unknowns; and what
    reading and solving a device with the values that are tried raise.

    Example::

        unknowns = [Unknown("joint.1.gap_mm", 0.1, lower=0.001), Unknown("material.steel.mu_r", 1000.0, lower=1.0)]
        table = LiftCurrentReadings("of 3 May", positions, amperes, deviation=0.02)
        found = fit_machine("my_rig.toml", unknowns, [table], predict=[other])
        print(found.values, found.deviations, found.indistinct)
    """
    work = _Work(device, tuple(unknowns), (*readings, *predict), solve or _solved, on_solve, workers)
    _check(work, len(readings))
    start = np.array([unknown.start for unknown in work.unknowns])
    bounds = np.array([(unknown.lower, unknown.upper) for unknown in work.unknowns]).T
    fitted = range(len(readings))
    used, before = work.rows_of(fitted), work.left(start)

    def residual(x: Array) -> Array:
        return np.concatenate([work.left(x, fitted), work.prior(x)])

    def jacobian(x: Array) -> Array:
        return np.vstack([work.differences(x, bounds, fitted, central=False), work.prior_slopes])

    scale = np.maximum(np.abs(start), work.steps)
    answer = least_squares(residual, start, jacobian, bounds=tuple(bounds), x_scale=scale, xtol=close)
    slopes = work.slopes(answer.x, bounds, fitted)
    covariance, indistinct = _covariance(np.vstack([slopes[used], work.prior_slopes]), answer.x, work)
    values = work.named(answer.x)
    after = work.left(answer.x)
    tables = tuple(
        work.table(number, number < len(readings), before, after, slopes, covariance)
        for number in range(len(work.readings))
    )
    at_bound = [name for name, mask in zip(values, answer.active_mask, strict=True) if mask]
    notes = [f"fitted: {', '.join(values)}; all else as the device has it"]
    notes += [f"the fit ended at the bound of {' and '.join(at_bound)}"] if at_bound else []
    notes += [
        f"prior of {one.key}: {one.prior[0]:g} +- {one.prior[1]:g}" for one in work.unknowns if one.prior
    ]
    return MachineFit(
        values,
        covariance,
        indistinct,
        _root_mean_square(after[used]),
        _root_mean_square(before[used]),
        tables,
        work.device_at(answer.x),
        work.solves,
        tuple(notes),
    )


def _solved(device: Device) -> AnyField:
    if any(device.materials[body.material].saturates for body in device.bodies):
        return NonlinearSolver(device)
    return solve_linear(device)


@dataclass(frozen=True)
class _Job:
    """Tables of one device: what a worker needs."""

    device: PathLike
    values: dict[str, float]
    solve: Callable[[Device], AnyField]
    tables: list[Readings]


def _solve_job(job: _Job) -> list[Array]:
    device = read_device(job.device, job.values)
    field = job.solve(device)
    return [_of_table(table, device, field) for table in job.tables]


def _of_table(table: Readings, device: Device, field: AnyField) -> Array:
    values, wanted = np.ravel(table.computed(device, field)), np.size(table.measured)
    if len(values) != wanted:
        must_hold = f"must give as many numbers as were measured, {wanted}"
        remedy = "let the function return one for each"
        raise InputError(Problem(f"fit_machine, {table.name}", must_hold, str(len(values)), remedy))
    return values


def _point(x: Array) -> bytes:
    return np.ascontiguousarray(x).tobytes()


class _Work:
    """The device with any values of the unknowns; what was computed is kept."""

    def __init__(
        self,
        device: PathLike | Device,
        unknowns: tuple[Unknown, ...],
        readings: tuple[Readings, ...],
        solve: Callable[[Device], AnyField],
        on_solve: Callable[[Mapping[str, float]], None] | None,
        workers: Workers,
    ) -> None:
        self._workers = workers
        self.unknowns, self.readings = unknowns, readings
        self._name = device.to_toml() if isinstance(device, Device) else device
        self._solve, self._on_solve = solve, on_solve
        self._kept: dict[tuple[bytes, int], Array] = {}
        self.solves = 0
        numbers = [np.ravel(np.asarray(table.measured, dtype=float)) for table in readings]
        deviations = [
            np.broadcast_to(np.ravel(np.asarray(table.deviation, dtype=float)), values.shape)
            if np.size(table.deviation) in (1, values.size)
            else np.full(values.shape, np.nan)
            for table, values in zip(readings, numbers, strict=True)
        ]
        self.measured = np.concatenate(numbers) if numbers else np.zeros(0)
        self.deviation = np.concatenate(deviations) if deviations else np.zeros(0)
        self.numbers = np.repeat(np.arange(len(numbers)), [len(values) for values in numbers])
        self.read = np.isfinite(self.measured)

    @property
    def steps(self) -> Array:
        """Differences (k,) for derivatives."""
        return np.array([one.step or _STEP * abs(one.start) or _STEP for one in self.unknowns])

    def named(self, x: Array) -> dict[str, float]:
        """Values (k,) by key path."""
        return {one.key: float(value) for one, value in zip(self.unknowns, x, strict=True)}

    def device_at(self, x: Array) -> Device:
        """The device with these values."""
        return read_device(self._name, self.named(x))

    def rows_of(self, numbers: Sequence[int] | range) -> NDArray[np.bool_]:
        """Which rows of all that were read belong to these tables."""
        return np.isin(self.numbers[self.read], list(numbers))

    def left(self, x: Array, tables: range | None = None) -> Array:
        """(computed - measured) / deviation of everything that was read, or of some tables."""
        tables = range(len(self.readings)) if tables is None else tables
        rows = np.isin(self.numbers, list(tables)) & self.read
        return ((self.computed(x, tables) - self.measured) / self.deviation)[rows]

    def computed(self, x: Array, tables: range) -> Array:
        """All tables (n,) with these values of the unknowns; NaN for those that are not asked for."""
        self.prepare([x], tables)
        values = np.full(len(self.measured), np.nan)
        for number in tables:
            values[self.numbers == number] = self._kept[_point(x), number]
        return values

    def prepare(self, points: Sequence[Array], tables: range) -> None:
        """Solve what is not known yet of tables at several sets of values; more than one device by `workers`."""
        apart = {_point(x): x for x in points}
        missing = [
            (point, number) for point in apart for number in tables if (point, number) not in self._kept
        ]
        # Workers get a table each, one process all tables of a device, which it then solves once.
        groups = [[one] for one in missing]
        if self._workers is map:
            groups = [[one for one in missing if one[0] == point] for point in dict(missing)]
        jobs = [
            _Job(
                self._name,
                self.named(apart[group[0][0]]),
                self._solve,
                [self.readings[number] for _, number in group],
            )
            for group in groups
        ]
        solved = map(_solve_job, jobs) if len(jobs) < 2 else self._workers(_solve_job, jobs)
        for group, job, found in zip(groups, jobs, solved, strict=True):
            self.solves += 1
            self._kept |= dict(zip(group, found, strict=True))
            if self._on_solve is not None:
                self._on_solve(job.values)

    def slopes(self, x: Array, bounds: Array, fitted: range) -> Array:
        """Derivatives (n, k) of what is left by the unknowns: central differences for the tables that are fitted, to
        one side for the others."""
        others = range(fitted.stop, len(self.readings))
        found = np.empty((int(self.read.sum()), len(x)))
        found[self.rows_of(fitted)] = self.differences(x, bounds, fitted, central=True)
        if others:
            found[self.rows_of(others)] = self.differences(x, bounds, others, central=False)
        return found

    def differences(self, x: Array, bounds: Array, tables: range, central: bool) -> Array:
        """Derivatives (n, k) of some tables within the bounds."""
        pairs = []
        for k, step in enumerate(self.steps):
            low, high = x.copy(), x.copy()
            low[k], high[k] = max(x[k] - step, bounds[0, k]), min(x[k] + step, bounds[1, k])
            if not central:
                low, high = (x, high) if high[k] > x[k] else (low, x)
            pairs.append((low, high))
        self.prepare([point for pair in pairs for point in pair], tables)
        columns = [
            (self.left(high, tables) - self.left(low, tables)) / (high[k] - low[k])
            for k, (low, high) in enumerate(pairs)
        ]
        return np.column_stack(columns)

    def prior(self, x: Array) -> Array:
        """(value - mean) / deviation of the unknowns that have a prior."""
        known = [(value, *one.prior) for one, value in zip(self.unknowns, x, strict=True) if one.prior]
        return np.array([(value - mean) / deviation for value, mean, deviation in known])

    @property
    def prior_slopes(self) -> Array:
        """Derivatives of `prior` by the unknowns."""
        every = zip(self.unknowns, np.eye(len(self.unknowns)), strict=True)
        rows = [row / one.prior[1] for one, row in every if one.prior]
        return np.array(rows).reshape(-1, len(self.unknowns))

    def table(
        self, number: int, used: bool, before: Array, after: Array, slopes: Array, covariance: Array
    ) -> ReadingsFit:
        """One table beside the fit."""
        rows = self.rows_of([number])
        measured, deviation = self.measured[self.read][rows], self.deviation[self.read][rows]
        spread = np.einsum("nk,kl,nl->n", slopes[rows], covariance, slopes[rows])
        return ReadingsFit(
            self.readings[number].name,
            used,
            measured,
            measured + deviation * before[rows],
            measured + deviation * after[rows],
            deviation * np.sqrt(np.maximum(spread, 0.0)),
            _root_mean_square(after[rows]),
            _root_mean_square(before[rows]),
        )


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _covariance(slopes: Array, x: Array, work: _Work) -> tuple[Array, tuple[tuple[str, ...], ...]]:
    """(J^T J)^-1, and the unknowns in each combination that the readings do not hold."""
    scale = np.maximum(np.abs(x), work.steps)
    _, size, directions = np.linalg.svd(slopes * scale, full_matrices=False)
    deviation = 1 / np.maximum(size, 1e-12 * max(size[0], 1e-300))
    groups = [
        tuple(one.key for one, part in zip(work.unknowns, row, strict=True) if abs(part) > _PART)
        for row, spread in zip(directions, deviation, strict=True)
        if spread > _UNKNOWN
    ]
    half = scale[:, None] * directions.T * deviation
    return half @ half.T, tuple(groups)


def _check(work: _Work, used: int) -> None:
    problems = []
    names = [unknown.key for unknown in work.unknowns]
    if not names or len(set(names)) < len(names):
        must_hold, remedy = "must name at least one key, each once", "list Unknown(key, start)"
        problems.append(Problem("fit_machine(unknowns)", must_hold, f"{names}", remedy))
    for one in work.unknowns:
        inside = one.lower <= one.start <= one.upper and np.isfinite(one.start)
        prior = one.prior is None or (np.isfinite(one.prior[0]) and one.prior[1] > 0)
        if not (inside and prior and (one.step is None or one.step > 0)):
            must_hold = (
                "start must lie between lower and upper; deviation of the prior and step must be above 0"
            )
            received = f"{one.lower:g}, {one.start:g}, {one.upper:g}; prior {one.prior}, step {one.step}"
            problems.append(Problem(f"fit_machine, {one.key}", must_hold, received, "correct the numbers"))
    bad = np.unique(work.numbers[~(work.deviation > 0)]).tolist()
    for number in bad:
        must_hold = "standard deviations must be above 0: one for all readings, or one for each"
        received = f"{np.asarray(work.readings[number].deviation).tolist()}"[:80]
        problems.append(
            Problem(f"fit_machine, {work.readings[number].name}", must_hold, received, "state them")
        )
    count = int((work.numbers[work.read] < used).sum()) + sum(one.prior is not None for one in work.unknowns)
    if count < len(names):
        must_hold = f"readings and priors must be at least as many as the {len(names)} unknowns"
        remedy = "add readings, or fit fewer unknowns"
        problems.append(Problem("fit_machine(readings)", must_hold, str(count), remedy))
    if not problems:
        try:
            work.device_at(np.array([unknown.start for unknown in work.unknowns]))
        except FieldmapError as error:
            problems += getattr(error, "problems", ())
            if not problems:
                raise
    if problems:
        raise InputError(*problems)

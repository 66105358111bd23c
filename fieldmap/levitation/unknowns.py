"""Unknown parameters fitted to readings by least squares. The readings are computed by a scaled field (`calibrate`), or
by a device that is solved anew (`fieldmap.studies.fit_machine`).

The misfit is the sum of squares of (computed - measured) / deviation over all readings, and over the priors of the
unknowns. Gauss-Newton steps, in the trust region of `scipy.optimize.least_squares`, use one-sided differences for the
derivatives. The covariance is (J^T J)^-1 with central differences; it assumes the stated deviations (J. V. Beck and
K. J. Arnold, Parameter Estimation in Engineering and Science, Wiley 1977, section 7.7).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike
from pydantic import Field

from fieldmap.arguments import raise_all
from fieldmap.errors import Problem
from fieldmap.inputs.declared import Key
from fieldmap.inputs.tables import Number, Positive, Text
from fieldmap.records import Record
from fieldmap.typing import Array

# Default step of derivatives, as a share of the start value: larger than the changes that a new mesh causes.
_STEP = 0.01
# Relative standard deviation above which the readings do not determine a combination of unknowns.
_UNKNOWN = 1.0
# Smallest component of an unknown that belongs to such a combination.
_PART = 0.2
# Smallest singular value over the largest below which the readings do not distinguish the unknowns at all.
_RANK = 1e-6
# Residual of a number that cannot be computed: this many times the measured number, and a hundred deviations more.
_FAR = 3.0


@dataclass(frozen=True, repr=False)
class Unknown(Record):
    """A parameter of the device to be fitted: key path and start value, in the unit of the key.

    lower, upper: bounds. prior: mean and standard deviation that are known from elsewhere. step: difference for the
    derivative, a hundredth of `start` unless given.
    """

    key: Annotated[str, Key(Text, 'key path of the device file, for example "joint.ends.gap_mm"')]
    start: Annotated[float, Key(Number, "where the search begins")]
    lower: Annotated[float, Key(Number | None, "lower bound, if there is one")] = -np.inf
    upper: Annotated[float, Key(Number | None, "upper bound, if there is one")] = np.inf
    prior: Annotated[
        tuple[float, float] | None,
        Key(
            Annotated[list[Number], Field(min_length=2, max_length=2)] | None,
            "mean and standard deviation that are known from elsewhere",
            examples=([1500.0, 300.0],),
        ),
    ] = None
    step: Annotated[
        float | None,
        Key(
            Positive | None,
            "difference for the derivative; a hundredth of start if left out",
            examples=(0.5,),
        ),
    ] = None

    @property
    def difference(self) -> float:
        """Difference for the derivative."""
        return self.step or _STEP * abs(self.start) or _STEP


class Measured(Protocol):
    """Measured numbers (n,), NaN where nothing was read, and their standard deviation, one for all or (n,)."""

    @property
    def name(self) -> str: ...
    @property
    def measured(self) -> ArrayLike: ...
    @property
    def deviation(self) -> ArrayLike: ...


Compute = Callable[[dict[str, float], Sequence[Any]], "list[Array]"]
"""Computes the numbers of tables at values of the unknowns by key; NaN for a number that cannot be computed."""
Workers = Callable[[Callable[[Any], "list[Array]"], "Sequence[Any]"], Iterable["list[Array]"]]
"""A function like `map` that may work in parallel."""


@dataclass(frozen=True, eq=False, repr=False)
class ReadingsFit(Record):
    """One table of readings: measured, before (at the start values), after the fit, and uncertainty (n,), the standard
    deviation of `after` due to the unknowns. used: whether the table was fitted, not predicted. misfit and
    misfit_before: root mean square of the residuals over the deviations."""

    name: str
    used: bool
    measured: Array
    before: Array
    after: Array
    uncertainty: Array
    misfit: float
    misfit_before: float


@dataclass(frozen=True, eq=False, repr=False)
class Found(Record):
    """Result of a fit: values by key; covariance (k, k); indistinct: groups of unknowns with a combination whose
    standard deviation exceeds its size; alike: the unknowns of a combination that the readings do not determine at all.
    misfit and misfit_before: of the fitted tables. solves: number of computations of tables. notes: on the end of the
    fit."""

    values: dict[str, float]
    covariance: Array
    indistinct: tuple[tuple[str, ...], ...]
    alike: tuple[str, ...]
    misfit: float
    misfit_before: float
    tables: tuple[ReadingsFit, ...]
    solves: int
    notes: tuple[str, ...]


def wrong_numbers(one: Unknown) -> Iterator[tuple[str, str, str]]:
    """For each wrong number of an unknown: what must hold, what was received, and the remedy."""
    low, high = one.lower, one.upper
    if not (low <= one.start <= high and low < high and np.isfinite(one.start)):
        received = f"lower {low:g}, start {one.start:g}, upper {high:g}"
        yield "start must lie between lower and upper", received, "correct the numbers"
    if one.prior is not None and not (np.isfinite(one.prior[0]) and one.prior[1] > 0):
        must_hold, remedy = "the deviation of the prior must be above 0", "state its mean and its deviation"
        yield must_hold, f"{one.prior}", remedy
    if one.step is not None and not one.step > 0:
        yield "step must be above 0", f"{one.step:g}", "correct it, or leave it out"


def _mistakes(
    where: str, unknowns: Sequence[Unknown], tables: Sequence[Measured], used: int
) -> Iterator[Problem]:
    """The problems of unknowns and tables; the first `used` tables are fitted."""
    keys = [one.key for one in unknowns]
    if not keys or len(set(keys)) < len(keys):
        must_hold, remedy = "must name at least one key, each once", "list Unknown(key, start)"
        yield Problem(f"{where}(unknowns)", must_hold, f"{keys}", remedy)
    for one in unknowns:
        yield from (Problem(f"{where}, {one.key}", *told) for told in wrong_numbers(one))
    for table in tables:
        size = np.size(table.deviation)
        if size not in (1, np.size(table.measured)) or not (np.asarray(table.deviation) > 0).all():
            must_hold = "standard deviations must be above 0: one for all readings, or one for each"
            received = f"{np.asarray(table.deviation).tolist()}"[:80]
            yield Problem(f"{where}, {table.name}", must_hold, received, "state them")
    count = sum(int(np.isfinite(np.asarray(one.measured, dtype=float)).sum()) for one in tables[:used])
    count += sum(one.prior is not None for one in unknowns)
    if count < len(keys):
        must_hold = f"readings and priors must be at least as many as the {len(keys)} unknowns"
        remedy = "add readings, or fit fewer unknowns"
        yield Problem(f"{where}(readings)", must_hold, f"{count} readings", remedy)


def find_unknowns(
    where: str,
    unknowns: Sequence[Unknown],
    tables: Sequence[Measured],
    used: int,
    compute: Compute,
    on_solve: Callable[[Mapping[str, float]], None] | None = None,
    workers: Workers = map,
    **how: Any,
) -> Found:
    """Fit the first `used` tables, and predict the others. on_solve is called with the values of each solve. workers: a
    function like `map` that computes tables for the derivatives. how: options of `scipy.optimize.least_squares`. Raises
    InputError at `where` for wrong unknowns and tables."""
    raise_all(_mistakes(where, unknowns, tables, used))
    work = _Work(unknowns, tables, compute, on_solve, workers)
    fitted, every = range(used), range(len(tables))
    start = np.array([one.start for one in unknowns])
    before = work.computed(start, every)
    scale = np.maximum(np.abs(start), work.steps)
    priors = [one.prior for one in unknowns]
    known = np.array([prior is not None for prior in priors])
    mean, spread = np.array([prior or (0.0, 1.0) for prior in priors]).T
    prior_slopes = np.diag(1 / spread)[known]

    answer = scipy.optimize.least_squares(
        lambda x: np.concatenate([*work.left(x, fitted), ((x - mean) / spread)[known]]),
        start,
        lambda x: np.concatenate([*work.slopes(x, fitted, central=False), prior_slopes]),
        bounds=tuple(work.bounds),
        **{"x_scale": scale, **how},
    )
    slopes = [
        *work.slopes(answer.x, fitted, central=True),
        *work.slopes(answer.x, range(used, len(tables)), central=False),
    ]
    names = [one.key for one in unknowns]
    typical = np.maximum(np.abs(answer.x), work.steps)
    whole = np.concatenate([*slopes[:used], prior_slopes])
    covariance, indistinct, alike = _covariance(whole, typical, names)
    after = work.computed(answer.x, every)
    beside = tuple(work.table(k, k < used, before[k], after[k], slopes[k], covariance) for k in every)
    counts = [len(one.measured) for one in beside[:used]]
    misfit, misfit_before = (
        _root_mean_square(np.repeat([getattr(one, name) for one in beside[:used]], counts))
        for name in ("misfit", "misfit_before")
    )
    at_bound = [name for name, mask in zip(names, answer.active_mask, strict=True) if mask]
    notes = (f"the fit ended at the bound of {' and '.join(at_bound)}",) if at_bound else ()
    found = work.named(answer.x), covariance, indistinct, alike
    return Found(*found, misfit, misfit_before, beside, work.solves, notes)


def _compute(compute: Compute, job: tuple[dict[str, float], Sequence[Any]]) -> list[Array]:
    return compute(*job)


class _Work:
    """Tables computed at values of the unknowns, with only the numbers that were read. Results are cached."""

    def __init__(
        self,
        unknowns: Sequence[Unknown],
        tables: Sequence[Measured],
        compute: Compute,
        on_solve: Callable[[Mapping[str, float]], None] | None,
        workers: Workers,
    ) -> None:
        self._unknowns, self._tables, self._compute = unknowns, tables, compute
        self._on_solve, self._workers = on_solve, workers
        self._kept: dict[tuple[bytes, int], Array] = {}
        self.solves = 0
        self.steps = np.array([one.difference for one in unknowns])
        self.bounds = np.array([(one.lower, one.upper) for one in unknowns]).T
        measured = [np.ravel(np.asarray(table.measured, dtype=float)) for table in tables]
        self._read = [np.isfinite(values) for values in measured]
        self.measured = [values[read] for values, read in zip(measured, self._read, strict=True)]
        self.deviation = [
            np.broadcast_to(np.ravel(np.asarray(table.deviation, dtype=float)), read.shape)[read]
            for table, read in zip(tables, self._read, strict=True)
        ]

    def named(self, x: Array) -> dict[str, float]:
        """Values (k,) by key."""
        return {one.key: float(value) for one, value in zip(self._unknowns, x, strict=True)}

    def computed(self, x: Array, numbers: Sequence[int]) -> list[Array]:
        """Computed numbers of some tables, for those that were read; NaN where one cannot be computed."""
        self.prepare([x], numbers)
        return [self._kept[x.tobytes(), k] for k in numbers]

    def left(self, x: Array, numbers: Sequence[int]) -> list[Array]:
        """Residuals (computed - measured) / deviation of some tables. A number that cannot be computed has a large one,
        so that the fit turns back."""
        found = []
        for k, values in zip(numbers, self.computed(x, numbers), strict=True):
            off = (values - self.measured[k]) / self.deviation[k]
            far = _FAR * np.abs(self.measured[k] / self.deviation[k]) + 100.0
            found.append(np.where(np.isnan(off), far, off))
        return found

    def prepare(self, points: Sequence[Array], numbers: Sequence[int]) -> None:
        """Compute tables at several sets of values unless they are cached; the workers share several jobs."""
        apart = {x.tobytes(): x for x in points}
        missing = [(point, k) for point in apart for k in numbers if (point, k) not in self._kept]
        # Each worker gets one table. Without workers a job has all tables of one set of values, solved once.
        groups = [[one] for one in missing]
        if self._workers is map:
            groups = [[one for one in missing if one[0] == point] for point in dict(missing)]
        jobs = [(self.named(apart[group[0][0]]), [self._tables[k] for _, k in group]) for group in groups]
        do = partial(_compute, self._compute)
        for group, job, found in zip(
            groups, jobs, (map if len(jobs) < 2 else self._workers)(do, jobs), strict=True
        ):
            self.solves += 1
            self._kept |= {
                place: values[self._read[place[1]]] for place, values in zip(group, found, strict=True)
            }
            if self._on_solve is not None:
                self._on_solve(job[0])

    def slopes(self, x: Array, numbers: Sequence[int], central: bool) -> list[Array]:
        """Derivatives (n, k) of the residuals of each of some tables, by differences within the bounds."""
        pairs = []
        for k, step in enumerate(self.steps):
            low, high = x.copy(), x.copy()
            low[k], high[k] = max(x[k] - step, self.bounds[0, k]), min(x[k] + step, self.bounds[1, k])
            if not central:
                low, high = (x, high) if high[k] > x[k] else (low, x)
            pairs.append((low, high))
        self.prepare([point for pair in pairs for point in pair], numbers)
        columns = [
            [
                (above - below) / (high[k] - low[k])
                for above, below in zip(self.left(high, numbers), self.left(low, numbers), strict=True)
            ]
            for k, (low, high) in enumerate(pairs)
        ]
        return [np.column_stack(table) for table in zip(*columns, strict=True)]

    def table(
        self, k: int, used: bool, before: Array, after: Array, slopes: Array, covariance: Array
    ) -> ReadingsFit:
        """The result of one table."""
        measured, deviation = self.measured[k], self.deviation[k]
        spread = np.einsum("nk,kl,nl->n", slopes, covariance, slopes)
        uncertainty = deviation * np.sqrt(np.maximum(spread, 0.0))
        return ReadingsFit(
            *(self._tables[k].name, used, measured, before, after, uncertainty),
            _root_mean_square((after - measured) / deviation),
            _root_mean_square((before - measured) / deviation),
        )


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _covariance(
    slopes: Array, scale: Array, names: Sequence[str]
) -> tuple[Array, tuple[tuple[str, ...], ...], tuple[str, ...]]:
    """(J^T J)^-1, the unknowns in each combination that the readings do not determine to its own size, and those in the
    one that they do not determine at all. scale (k,): typical values."""
    _, size, directions = np.linalg.svd(slopes * scale, full_matrices=False)
    deviation = 1 / np.maximum(size, 1e-12 * max(size[0], 1e-300))
    parts = [
        tuple(name for name, part in zip(names, row, strict=True) if abs(part) > _PART) for row in directions
    ]
    half = scale[:, None] * directions.T * deviation
    indistinct = tuple(part for part, spread in zip(parts, deviation, strict=True) if spread > _UNKNOWN)
    return half @ half.T, indistinct, parts[-1] if size[-1] <= _RANK * size[0] else ()

"""Uncertainty of a study's numbers due to uncertain numbers of the device: by derivatives, and by random devices.

To first order the variance of a number is the sum of (derivative times standard deviation)^2 over independent numbers
of the device. Derivatives are exact where the adjoint gives them and differences of solved devices otherwise
(`fieldmap.studies.search`). Solved random devices check this sum: they include nonlinear effects and, if bodies change,
the noise of the mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import FieldmapError, Infeasible, InputError, Problem
from fieldmap.iron.sensitivity.changes import Parameters
from fieldmap.iron.sensitivity.quantities import Derivatives
from fieldmap.records import Record
from fieldmap.studies.design import CURRENT, DesignProblem, Number, Search, Variable, number_of
from fieldmap.studies.design_checks import current_sets, design_problem, device_document, given_current
from fieldmap.studies.optimum import Kind
from fieldmap.studies.search import Designs, Evaluation, searching
from fieldmap.studies.study import Linked, setting_words
from fieldmap.typing import Array, PathLike, Progress

_CALLER = "analyse_tolerances"
# Quantiles of the range that holds 95 % of the samples.
_TAILS = (0.025, 0.975)


@dataclass(frozen=True, repr=False)
class Uncertain(Record):
    """A number of the device that is uncertain.

    key: a key path, "parameters.NAME", or "current.NAME", which names one number, or several that are equal and deviate
    together. deviation: standard deviation in the unit of the key. linked: keys that depend on it. step: of
    differences, for a key without exact derivative; the deviation unless given. If bodies change, each device has a
    mesh of its own, and the effect of the step should be large against the noise of the mesh.
    """

    key: str
    deviation: float
    linked: tuple[Linked, ...] = ()
    step: float | None = None


@dataclass(frozen=True, repr=False)
class Sampled(Record):
    """Statistics of random devices: number of solved ones, mean and standard deviation of a number with the standard
    errors of both, and the range that holds 95 % of them."""

    count: int
    mean: float
    mean_error: float
    deviation: float
    deviation_error: float
    range: tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class NumberSpread(Record):
    """A number and its uncertainty, SI units. By key: derivative per unit of the key, its kind ("exact" or
    "differences"), and share of the variance, from 0 to 1. deviation: standard deviation to first order; sampled:
    statistics of random devices, None without samples."""

    number: str
    value: float
    derivatives: Mapping[str, float]
    kinds: Mapping[str, Kind]
    deviation: float
    shares: Mapping[str, float]
    sampled: Sampled | None


@dataclass(frozen=True, eq=False, repr=False)
class ToleranceAnalysis(Record):
    """Uncertainties of numbers of a device. deviations: by key, in its unit; refused: keys without an exact derivative,
    and why; failed: random devices that could not be solved, and why; solves: number of devices that this run solved;
    kept: number of devices from an earlier run."""

    title: str
    deviations: Mapping[str, float]
    numbers: tuple[NumberSpread, ...]
    refused: Mapping[str, str]
    failed: Mapping[str, str]
    solves: int
    kept: int

    def __getitem__(self, number: str) -> NumberSpread:
        """The number of this label. Raises KeyError for an unknown label."""
        return {one.number: one for one in self.numbers}[number]


def analyse_tolerances(
    device: PathLike | Device,
    uncertain: Sequence[Uncertain],
    numbers: Sequence[Number | str | Callable[..., Any]],
    *,
    currents: Any = None,
    saturating: bool | None = None,
    refinement: float = 1.0,
    points: ArrayLike | None = None,
    box: tuple[ArrayLike, ArrayLike] | None = None,
    force_share: float = 0.01,
    samples: int = 0,
    seed: int = 0,
    output: PathLike | None = None,
    resume: bool = True,
    workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> ToleranceAnalysis:
    """Uncertainty of numbers that studies record, and the contribution of each number of the device.

    Parameters
    ----------
    device
        Device file, name of a shipped device, or a device made in Python.
    uncertain
        Independent numbers of the device with their standard deviations.
    numbers, currents, saturating, refinement, points, box, force_share
        As for `optimise`.
    samples
        Number of random, normally distributed devices that are solved in addition (Monte Carlo); 0, or at
        least 2.
    seed
        Seed of the random devices.
    output
        Devices are kept in OUTPUT.kept, and a run that was killed continues from them.
    resume
        Whether the devices of an earlier run are used.
    workers
        Processes that solve the devices of differences and samples: `fieldmap.parallel.Workers`.
    progress
        Called as progress(message, fraction) between steps.
    scheduler
        Address of a dask scheduler whose workers solve.

    Returns
    -------
    ToleranceAnalysis
        The deviation of every number, and the contribution of each number of the device.

    Raises
    ------
    InputError
        For wrong arguments, and if the device itself, or both sides of a difference, cannot be solved.
    Infeasible
        If fewer than two random devices can be solved.

    Examples
    --------
    >>> from fieldmap.studies import Uncertain, analyse_tolerances
    >>> found = analyse_tolerances(
    ...     "loop_and_sphere", [Uncertain("coil.loop.turns", 0.5), Uncertain("current.loop", 0.02)],
    ...     ["flux_density 1 z"], points=[[0, 0, -0.014]], currents=2.0,
    ... )                                                                         # doctest: +SKIP
    >>> found["flux_density 1 z"].shares                                          # doctest: +SKIP
    """
    about = (saturating, refinement, points, box, force_share)
    problem = _problem(uncertain, numbers, samples, device, currents, *about)
    deviations = {one.key: float(one.deviation) for one in uncertain}
    with searching(problem, output, resume, workers, progress, scheduler) as search:
        centre = problem.starts
        nominal = search.at(centre)
        if not nominal.solved:
            remedy = "correct the device, or take another refinement"
            raise InputError.of(_CALLER, "the device must be solved", nominal.failure, remedy)
        slopes = {number.label: search.slopes(centre, number) for number in problem.numbers}
        _check_differences(search, nominal)
        # Exact derivatives needed no differences.
        search.expect(samples)
        draws = np.random.default_rng(seed).standard_normal((samples, len(centre)))
        drawn = search.sampled(list(centre + draws * np.array(list(deviations.values()))))
    solved = [one for one in drawn if one.solved]
    if drawn and len(solved) < 2:
        must_hold, remedy = "at least two random devices must be solved", "see why they fail"
        raise Infeasible.of(_CALLER, must_hold, drawn[0].failure, remedy)
    return ToleranceAnalysis(
        title=f"Tolerances of {device_of(problem.document).name}",
        deviations=deviations,
        numbers=tuple(
            _spread(search, number, nominal, slopes[number.label], deviations, solved)
            for number in problem.numbers
        ),
        refused=search.refused,
        failed={setting_words(one.values): one.failure for one in drawn if not one.solved},
        solves=search.solves,
        kept=search.kept,
    )


def _problem(
    uncertain: Sequence[Uncertain],
    numbers: Sequence[Number | str | Callable[..., Any]],
    samples: int,
    device: PathLike | Device,
    currents: Any,
    *about: Any,
) -> DesignProblem:
    """The analysis as a design problem; its bounds are the device's own values plus and minus one step."""
    problems = list(_mistakes(uncertain, numbers, samples))
    made = device_of(device_document(device))
    sets = current_sets(currents, made, f"{_CALLER}(currents)", problems)
    variables = []
    for one in uncertain:
        try:
            # The checks of the design problem report an unknown current.
            is_current = one.key.startswith(CURRENT)
            own = (
                given_current(one.key, sets, made.coil_names)
                if is_current
                else Parameters(made).value(one.key)
            )
        except FieldmapError as error:
            problems += [replace(problem, where=f"{_CALLER}, {one.key}") for problem in error.problems]
            continue
        step = one.step or one.deviation
        variables.append(Variable(one.key, own - step, own + step, own, one.linked, step))
    if problems:
        raise InputError(*problems)
    objective, *besides = map(number_of, numbers)
    solves = 1 + 2 * len(uncertain) + samples
    search = Search(
        objective=objective,
        sign=1.0,
        variables=tuple(variables),
        solves=solves,
        check_refinement=None,
        besides=tuple(besides),
    )
    return design_problem(_CALLER, search, device, currents, *about)


def _mistakes(uncertain: Sequence[Uncertain], numbers: Sequence[Any], samples: int) -> list[Problem]:
    found = []
    for name, given in (("uncertain", uncertain), ("numbers", numbers)):
        if not given:
            found.append(Problem(f"{_CALLER}({name})", "must name at least one", "none", "name one"))
    if not isinstance(samples, int | np.integer) or samples < 0 or samples == 1:
        must_hold = "must be 0, or at least 2: one sample has no standard deviation"
        found.append(Problem(f"{_CALLER}(samples)", must_hold, f"{samples!r}", "write 0, or 100"))
    for one in uncertain:
        for name, value in (("deviation", one.deviation), ("step", one.step)):
            if value is not None and not (np.isfinite(value) and value > 0):
                where, must_hold = f"{_CALLER}, {one.key}", f"{name} must be above 0"
                found.append(Problem(where, must_hold, f"{value}", "correct it"))
    return found


def _check_differences(search: Designs, nominal: Evaluation) -> None:
    """Raise InputError for numbers of the device whose differences can be solved on neither side."""
    problems = []
    for key, value in nominal.values.items():
        moved = [step for step in search.steps if step.role == "difference" and step.values[key] != value]
        if moved and all(step.failure for step in moved):
            must_hold, remedy = "the device must be solved to one side at least", "give another step"
            problems.append(Problem(f"{_CALLER}, {key}", must_hold, moved[0].failure, remedy))
    if problems:
        raise InputError(*problems)


def _spread(
    search: Designs,
    number: Number,
    nominal: Evaluation,
    slopes: Array,
    deviations: Mapping[str, float],
    solved: Sequence[Evaluation],
) -> NumberSpread:
    value = nominal.numbers[number.label]
    by = dict(zip(deviations, map(float, slopes), strict=True))
    first_order = Derivatives(np.array(value), {key: np.array(slope) for key, slope in by.items()}, 0)
    spread = first_order.spread(deviations)
    return NumberSpread(
        number=number.label,
        value=value,
        derivatives=by,
        kinds=dict(search.kinds[number.label]),
        deviation=float(spread.deviation),
        shares={key: float(share) for key, share in spread.shares.items()},
        sampled=_sampled(np.array([one.numbers[number.label] for one in solved])) if solved else None,
    )


def _sampled(values: Array) -> Sampled:
    """Statistics of samples (n,). The standard error of the deviation assumes a normal distribution."""
    count, deviation = len(values), float(values.std(ddof=1))
    low, high = (float(value) for value in np.quantile(values, _TAILS))
    mean = float(values.mean()), deviation / np.sqrt(count)
    return Sampled(count, *mean, deviation, deviation / np.sqrt(2 * (count - 1)), (low, high))

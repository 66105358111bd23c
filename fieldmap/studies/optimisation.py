"""Design by optimisation: the best values of numbers of a device under limits (`fm.optimise`).

SciPy's optimisers or Optuna's samplers do the search; `fieldmap.studies.search` solves the designs that they ask for,
each once, and keeps them. When the search ends, the best design is solved on a finer mesh. If a limit does not hold
there, the difference between the meshes is added to every number, and the search continues: to first order the limits
then hold for the finer mesh.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from fieldmap.device.model import Device
from fieldmap.device.reader import device_of
from fieldmap.errors import Problem
from fieldmap.extras import require
from fieldmap.store import write_whole
from fieldmap.studies.design import (
    WITHOUT_SLOPES,
    DesignProblem,
    Limit,
    Number,
    Search,
    Variable,
    number_of,
)
from fieldmap.studies.design_checks import design_problem
from fieldmap.studies.optimum import Check, LimitAtOptimum, NoFeasibleDesign, Optimum
from fieldmap.studies.run import checked_output, require_xarray, write_netcdf
from fieldmap.studies.search import Designs, Evaluation, SearchEnded, searching
from fieldmap.typing import Array, PathLike, Progress

# Most repetitions of the search after a limit has failed on the finer mesh.
_CORRECTIONS = 2
# Share of a limit's scale within which it counts as active.
_ACTIVE = 1e-2
# First radius of the trust region of methods without derivatives, as a share of the distance between the bounds.
_FIRST_RADIUS = 0.25
# The same in a repetition, which begins near the best design.
_NEAR_RADIUS = 0.0625


def optimise(
    device: PathLike | Device,
    variables: Sequence[Variable],
    objective: Number | str | Callable[..., Any],
    constraints: Sequence[Limit] = (),
    *,
    currents: Any = None,
    maximise: bool = False,
    saturating: bool | None = None,
    refinement: float = 1.0,
    points: ArrayLike | None = None,
    box: tuple[ArrayLike, ArrayLike] | None = None,
    force_share: float = 0.01,
    method: str = "SLSQP",
    solves: int = 200,
    tolerance: float = 1e-4,
    check_refinement: float | None = 1.4,
    seed: int = 0,
    output: PathLike | None = None,
    resume: bool = True,
    workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> Optimum:
    """Find the values of variables for which a number of the device is smallest, or largest, within limits.

    Parameters
    ----------
    device
        Device file, name of a shipped device, or a device made in Python.
    variables
        The variables, with their bounds.
    objective
        The name of a number that studies record ("equilibrium_area", "power", "flux_density 1 z": docs/studies.md), a
        `Number`, or a function (device, state) -> number.
    constraints
        Numbers and their bounds, SI units.
    currents
        A: one number for all coils, one per coil, `Carrying(position)` for currents that carry the payload, or several
        of these by name; 1 A unless given.
    maximise
        Whether the number is maximised.
    saturating
        Whether the iron saturates; by default as its materials do.
    refinement
        Divides the mesh sizes.
    points
        Points (n, 3), m, for numbers at points.
    box
        Lower and upper corner, m, for "inhomogeneity".
    force_share
        Share of the weight that bounds the equilibrium area.
    method
        "SLSQP" or "trust-constr" (derivatives: exact where the adjoint gives them, differences of solved designs
        otherwise), "COBYQA" (none), or "optuna" (none, for designs with several optima; extra "optuna").
    solves
        Largest number of designs that are solved.
    tolerance
        Relative change at which the search ends, and largest violation of a limit, over its bound, that is accepted.
    check_refinement
        How much finer the mesh of the last check is; None for no check. Without iron there is no check.
    seed
        Seed of Optuna's sampler.
    output
        NetCDF file of the path. A CSV file and the designs solved so far (.kept) have the same name; a run that was
        killed continues from them and solves none twice. They identify Python functions only by their names.
    resume
        Whether the designs of an earlier run are used.
    workers
        Designs solved at a time where derivatives are differences.
    progress
        Called with a message and the share that is done.
    scheduler
        Address of a dask scheduler whose workers solve.

    Returns
    -------
    Optimum
        The best design. A design that cannot be solved is kept as a failure and counts as worse than all others; the
        search continues.

    Raises
    ------
    InputError
        For wrong arguments, and if the start cannot be solved.
    NoFeasibleDesign
        If no design meets the limits, with a problem for each violated limit.
    MissingExtraError
        Without Optuna or xarray.

    Examples
    --------
    >>> import fieldmap as fm
    >>> from fieldmap.studies import Limit, Variable
    >>> best = fm.optimise(
    ...     "loop_and_sphere", [Variable("coil.loop.turns", 50, 400)], "flux_density 1 z", [Limit("power", upper=0.5)],
    ...     maximise=True, points=[[0, 0, -0.014]], check_refinement=None,
    ... )                                                                         # doctest: +SKIP
    >>> best.values                                                               # doctest: +SKIP
    """
    if method == "optuna":
        _require_optuna()
    search = Search(
        objective=number_of(objective),
        sign=-1.0 if maximise else 1.0,
        variables=tuple(variables),
        limits=tuple(constraints),
        method=method,
        solves=solves,
        tolerance=tolerance,
        check_refinement=check_refinement,
        seed=seed,
    )
    about = (device, currents, saturating, refinement, points, box, force_share)
    problem = design_problem("optimise", search, *about)
    return solve_problem(problem, output, resume, workers, progress, scheduler)


def solve_problem(
    problem: DesignProblem,
    output: PathLike | None = None,
    resume: bool = True,
    workers: int = 1,
    progress: Progress | None = None,
    scheduler: str | None = None,
) -> Optimum:
    """Solve a problem of design: see `optimise`.

    Parameters
    ----------
    problem
        The problem.
    output
        NetCDF file of the path; none unless given.
    resume
        Whether the designs of an earlier run are used.
    workers
        Designs solved at a time where derivatives are differences.
    progress
        Called as progress(message, fraction) between steps.
    scheduler
        Address of a dask scheduler whose workers solve.

    Returns
    -------
    Optimum
        The best design.

    Raises
    ------
    InputError and Infeasible
        As for `optimise`.
    """
    if problem.method == "optuna":
        _require_optuna()
    target = None if output is None else checked_output(Path(output))
    if target is not None:
        require_xarray()
    say = progress or (lambda message, fraction: None)
    with searching(problem, target, resume, workers, say, scheduler) as search:
        found = _search(search)
    if target is not None:
        table = target.with_suffix(".csv")
        found = replace(found, written=(target, table))
        write_netcdf(found.data, target)
        write_whole(table, found.csv_text(), "study table")
    say("complete", 1.0)
    return found


def _search(search: Designs) -> Optimum:
    first = search.begin()
    ended = _minimised(search, search.scaled(first))
    best = search.best()
    if best is None:
        ended = _towards_the_limits(search)
        best = search.best()
    if best is None:
        raise _nothing(search)
    check = None
    for _ in range(_CORRECTIONS):
        check, finer = _checked(search, best)
        if check is None or check.failure or check.holds:
            break
        # From here on the numbers are those of the finer mesh, to first order.
        search.shift = {name: finer.numbers[name] - value for name, value in best.numbers.items()}
        ended = _minimised(search, search.scaled(best))
        corrected = search.best()
        if corrected is None or corrected is best:
            break
        best = corrected
    else:
        check, finer = _checked(search, best)
    return _optimum(search, first, best, check, finer, ended)


def _minimised(search: Designs, z: Array) -> str:
    """Let an optimiser search from scaled values, and return why it ended."""
    try:
        return _by_optuna(search, z) if search.problem.method == "optuna" else _by_scipy(search, z)
    except SearchEnded as end:
        return str(end)


def _by_scipy(search: Designs, z: Array) -> str:
    method, tolerance = search.problem.method, search.problem.tolerance
    slopes = {} if method == "COBYQA" else {"jac": search.limit_slopes}
    limits = NonlinearConstraint(search.limits, 0.0, np.inf, **slopes)
    options = {
        "SLSQP": {"ftol": tolerance},
        "trust-constr": {"gtol": tolerance, "xtol": tolerance},
        "COBYQA": _trust_region(search.problem, _NEAR_RADIUS if search.shift else _FIRST_RADIUS),
    }
    with warnings.catch_warnings():
        # A harmless warning about functions that are linear.
        warnings.filterwarnings("ignore", message="delta_grad")
        found = minimize(
            search.objective,
            z,
            jac=search.objective_slopes if slopes else None,
            method=method,
            bounds=Bounds(np.zeros(len(z)), np.ones(len(z)), keep_feasible=method == "trust-constr"),
            constraints=[limits] if search.problem.limits else [],
            options=options[method],
        )
    return str(found.message)


def _trust_region(problem: DesignProblem, radius: float) -> dict[str, float]:
    """First and last radius of COBYQA. Near an optimum the objective changes with the square of the distance."""
    return {"initial_tr_radius": radius, "final_tr_radius": min(problem.tolerance**0.5, 0.5 * radius)}


def _require_optuna() -> ModuleType:
    """The module optuna. Raises MissingExtraError with the command that installs it."""
    return require("optuna", "optuna", "fieldmap.studies.optimise", 'choose another method, such as "COBYQA"')


def _by_optuna(search: Designs, z: Array) -> str:
    """Let Optuna's sampler of tree-structured Parzen estimators choose designs, the first at scaled values z, up to the
    largest number of designs, and return how it ended. It serves problems with several optima; derivatives find only
    the nearest. With the seed of the problem, a resumed run asks for the same designs."""
    optuna = _require_optuna()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    names = [f"z{k}" for k in range(len(z))]

    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=search.problem.seed))
    study.enqueue_trial({name: float(value) for name, value in zip(names, z, strict=True)})

    def objective(trial: Any) -> float:
        here = np.array([trial.suggest_float(name, 0.0, 1.0) for name in names])
        for k, room in enumerate(search.limits(here)):
            trial.set_constraint(f"limit {k}", -room)  # a positive number is a violated limit
        return search.objective(here)

    study.optimize(objective, n_trials=search.problem.solves)
    return f"{len(study.trials)} designs were tried"


def _towards_the_limits(search: Designs) -> str:
    """Search for a design that meets the limits, from the one nearest to meeting them, and continue from there."""
    z = search.scaled(search.nearest())
    how: dict[str, Any] = {"method": "L-BFGS-B", "jac": search.violation_slopes}
    if search.problem.method in WITHOUT_SLOPES:
        how = {"method": "COBYQA", "options": _trust_region(search.problem, _FIRST_RADIUS)}
    try:
        found = minimize(search.violations, z, bounds=[(0.0, 1.0)] * len(z), **how)
    except SearchEnded as end:
        return str(end)
    best = search.best()
    return str(found.message) if best is None else _minimised(search, search.scaled(best))


def _nothing(search: Designs) -> NoFeasibleDesign:
    """The error with the violated limits at the design that is nearest to meeting all."""
    nearest, problem = search.nearest(), search.problem
    where = ", ".join(f"{key} = {value:.6g}" for key, value in nearest.values.items())
    problems = []
    for limit in problem.limits:
        value = search.number(nearest, limit.asked)
        if search.excess(nearest, limit) <= problem.tolerance:
            continue
        side, bound = ("at least", limit.lower) if value < limit.lower else ("at most", limit.upper)
        off, share = abs(value - bound), 100 * abs(value - bound) / limit.scale
        received = (
            f"{value:.6g} where the limits come nearest to holding ({where}): off by {off:.3g}, {share:.3g} %"
        )
        remedy = "loosen this limit, widen the bounds of the variables, or begin elsewhere"
        must_hold = f"must be {side} {bound:g}"
        problems.append(Problem(f"optimise, {limit.asked.label}", must_hold, received, remedy))
    return NoFeasibleDesign(*problems, nearest=nearest.values, path=tuple(search.steps))


def _checked(search: Designs, best: Evaluation) -> tuple[Check | None, Evaluation]:
    """The best design on a finer mesh."""
    problem, times = search.problem, search.problem.check_refinement
    if times is None or not problem.body_names:
        return None, best
    refinement = problem.iron.refinement * times
    finer = search.checked(problem.values(best.values), refinement)
    if not finer.solved:
        return Check(refinement, times, float("nan"), False, finer.failure), finer
    holds = search.violation(finer) <= problem.tolerance
    return Check(refinement, times, finer.numbers[problem.objective.label], holds), finer


def _optimum(
    search: Designs, first: Evaluation, best: Evaluation, check: Check | None, finer: Evaluation, ended: str
) -> Optimum:
    problem, label = search.problem, search.problem.objective.label
    last = finer if check is not None and not check.failure else None
    limits = []
    for limit in problem.limits:
        number, judged = limit.asked.label, last or best
        room = min(abs(judged.numbers[number] - bound) for bound in (limit.lower, limit.upper)) / limit.scale
        finer_value = None if last is None else last.numbers[number]
        holds = search.excess(judged, limit) <= problem.tolerance
        ends = (limit.lower, limit.upper)
        limits.append(
            LimitAtOptimum(number, best.numbers[number], finer_value, *ends, room <= _ACTIVE, holds)
        )
    iron = "saturating" if problem.iron.saturating else "of constant permeability"
    held = [
        f"varied: {', '.join(problem.keys)}; all else as the device has it",
        f"iron {iron}; designs meshed anew, mesh sizes divided by {problem.iron.refinement:g}",
    ]
    if search.shift:
        held.append(
            "limits and objective corrected by the difference of the finer mesh at the design before the last"
        )
    return Optimum(
        title=problem.title,
        values=best.values,
        objective=label,
        value=best.numbers[label],
        start_value=first.numbers[label],
        limits=tuple(limits),
        variables=problem.variables,
        derivatives={
            name: {key: kinds.get(key, "none") for key in problem.keys}
            for name, kinds in search.kinds.items()
        },
        refused=search.refused,
        verified=check,
        path=tuple(search.steps),
        solves=search.solves,
        kept=search.kept,
        ended=ended,
        method=problem.method,
        device=device_of(problem.document_at(problem.values(best.values))),
        start_device=device_of(problem.document_at(problem.values(first.values))),
        maximise=problem.sign < 0,
        assumptions=tuple(held),
    )

"""Designs of a device: `fieldmap study` varies keys, `fieldmap optimise` and `fieldmap fit` find their values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.arguments import raise_all
from fieldmap.cli import options, page
from fieldmap.cli.messages import print_problems, resumable
from fieldmap.errors import FieldmapError, Problem
from fieldmap.progress import Progress
from fieldmap.records import count_of

if TYPE_CHECKING:
    from fieldmap.studies import Fit, LimitAtOptimum, MachineFit, Optimum
    from fieldmap.studies.quantities import Quantity
    from fieldmap.studies.run import StudyRow, StudyRun
    from fieldmap.studies.study import Record

StudyOutput = Annotated[
    Path | None,
    options.output("NetCDF file to write, with CSV and pictures beside it. Default: maps/out/STUDY.nc."),
    options.writes("study"),
]


def study(
    file: options.StudyArgument,
    target: StudyOutput = None,
    resume: options.Resume = True,
    retry: Annotated[bool, typer.Option("--retry")] = False,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    plot: options.Plot = True,
    json: options.Json = False,
) -> None:
    """Solve every variant of a study, and write what is recorded as NetCDF, CSV and a plot.

    Example: fieldmap study pole_disk

    Parameters
    ----------
    retry
        Solve failed variants again.
    """
    from fieldmap.studies import run_study
    from fieldmap.studies.reading import STUDY

    if plot:
        _refuse_picture(STUDY.find(file), target)
    with resumable("study") as progress:
        run = run_study(file, target, resume, retry, workers, progress, scheduler)
    files = [run.path, run.table]
    if plot:
        from fieldmap.plot.studies import save_study_plot

        picture = save_study_plot(run.data, run.path.with_suffix(".png"))
        files += [] if picture is None else [picture]
    page.print_result(run, partial(_study_page, files), json, files=files)
    if len(run.failed) == len(run.study.variants):
        # The printed result already has the reason of each failure.
        received = f"the first because of {next(iter(run.failed.values()))[0]}"
        problem = Problem(str(run.study.path), "some variant must succeed", received, "see the reasons")
        print_problems(FieldmapError(problem))
        raise typer.Exit(FieldmapError.exit_code)


def _refuse_picture(study: Path, target: Path | None) -> None:
    """Raise InputError, before anything is solved, if the plot would replace a picture of another program."""
    from fieldmap.store.output_formats import output_problems
    from fieldmap.studies.run import output_file

    picture = output_file(study, target).with_suffix(".png")
    raise_all(output_problems(str(picture), picture, ["drawn figure"]))


# Head and significant digits of each column; quantities without a head are in the data set only.
_HEADS = {
    "common_current": ("current", 4),
    "equilibrium_x": ("x", 3),
    "equilibrium_y": ("y", 3),
    "stiffness_x": ("k_x", 3),
    "stiffness_z": ("k_z", 3),
    "equilibrium_area": ("area", 3),
    "reach_height": ("reach", 4),
    "reachable_share": ("reachable", 3),
    "largest_flux_density": ("B iron", 3),
    "error_flux_density": ("error", 2),
}
_UNITS = {"N m-1": "N/m", "mm2": "mm^2", "1": ""}


def _study_page(files: list[Path], run: StudyRun) -> Iterator[page.Section]:
    from fieldmap.studies.quantities import recorded

    of, rows = run.study, run.rows()
    summaries = [quantity for quantity in recorded(of.record.groups) if quantity.name in _HEADS]
    shown = [q for q in summaries if any(_cell(q, row) not in ("-", "0") for row in rows)]
    axes = [_with_unit(axis.name, axis.unit) for axis in of.axes] or ["variant"]
    several = len(of.current_sets) > 1
    heads = [_with_unit(_HEADS[quantity.name][0], quantity.printed_unit) for quantity in shown]
    lines = (
        [
            *(value if isinstance(value, str) else f"{value:g}" for value in row.settings.values()),
            *([row.currents] if several else []),
            *(_cell(quantity, row) for quantity in shown),
        ]
        for row in rows
    )
    failed = [("failed", f"{name}: {text}") for name, reasons in run.failed.items() for text in reasons]
    yield page.heading(
        of.title, f"{len(of.variants)} variants of {of.device_document.data.get('name', 'a device')}"
    )
    yield page.table([*axes, *(["currents"] if several else []), *heads], lines, left=len(axes) + several)
    yield page.facts(failed) if failed else None
    yield page.facts(
        [*_limits(of.record), *page.assumption_lines(str(run.data.attrs["assumptions"]).split("\n"))]
    )
    yield page.written(files)


def _with_unit(name: str, unit: str) -> str:
    return f"{name}\n{_UNITS.get(unit, unit)}"


def _cell(quantity: Quantity, row: StudyRow) -> str:
    number = quantity.printed[0] * float(row.numbers[quantity.name])
    # Numbers this small are rounding errors.
    return page.cells([0.0 if abs(number) < 1e-6 else number], f".{_HEADS[quantity.name][1]}g")[0]


def _limits(record: Record) -> Iterator[tuple[str, str]]:
    if "equilibrium_area" in record.groups:
        yield "eq. area", f"horizontal force below {100 * record.force_share:g} % of the weight"
    if record.current_limit is not None and {"reach", "reachable_share"} & set(record.groups):
        yield "reach", f"with at most {record.current_limit:g} A in every coil"


def optimise(
    file: options.StudyArgument,
    target: StudyOutput = None,
    resume: options.Resume = True,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    plot: options.Plot = True,
    json: options.Json = False,
) -> None:
    """Find the best values of a device's keys within limits, and check them on a finer mesh.

    The table `optimise` of the study file states the keys, their limits, and the number to make small or large.

    Example: fieldmap optimise pole_piece
    """
    from fieldmap.studies import read_design_problem, solve_problem
    from fieldmap.studies.reading import STUDY
    from fieldmap.studies.run import output_file

    problem = read_design_problem(file)
    path = output_file(STUDY.find(file), target)
    if plot:
        _refuse_picture(STUDY.find(file), target)
    with resumable("optimise") as progress:
        found = solve_problem(problem, path, resume, workers, progress, scheduler)
    device = str(problem.document.data.get("name", "a device"))
    files = [*found.written, *(_pictures(found, found.written[0]) if plot else ())]
    page.print_result(found, partial(_optimum_page, device, files), json, files=files)


def _pictures(found: Optimum, path: Path) -> Iterator[Path]:
    from fieldmap.plot.optimum import save_before_and_after, save_optimum_plot
    from fieldmap.plot.rendering import can_render

    yield save_optimum_plot(found, path.with_suffix(".png"))
    # The numbers must not be lost on a machine that cannot draw scenes.
    if can_render():
        starts = {one.key: one.start for one in found.variables}
        captions = (_caption("start", starts), _caption("best", found.values))
        target = path.with_name(f"{path.stem}_device.png")
        yield save_before_and_after(found.start_device, found.device, target, captions)


def _caption(title: str, values: Mapping[str, float | None]) -> str:
    """A title and the values of the first four variables, one line each."""
    lines = [f"{key} = {value:.5g}" for key, value in list(values.items())[:4] if value is not None]
    return "\n".join([title, *lines])


def _optimum_page(device: str, files: list[Path], found: Optimum) -> Iterator[page.Section]:
    variables = count_of(len(found.values), "variable", "variables")
    yield page.heading(found.title, f"{variables} of {device}")
    rows = (
        (one.key, f"{one.lower:g}", *page.cells((one.start, found.values[one.key]), ".5g"), f"{one.upper:g}")
        for one in found.variables
    )
    yield page.table(["variable", "lower", "start", "best", "upper"], rows)
    check = found.verified
    finer = None if check is None or check.failure else check.objective
    best = page.cells((found.value, finer), ".5g")
    numbers = [(found.objective, "-", *best, f"{found.start_value:.5g} at the start")]
    numbers += [
        (one.number, _bounds(one), *page.cells((one.value, one.finer), ".5g"), _state(one))
        for one in found.limits
    ]
    yield page.table(["number, SI units", "limit", "best", "finer mesh", ""], numbers, left=2)
    yield page.facts(_search(found))
    yield page.assumed(found.assumptions)
    yield page.written(files)


def _search(found: Optimum) -> Iterator[tuple[str, str]]:
    solved = f"{count_of(found.solves, 'design', 'designs')} solved"
    yield "search", f"{found.method}, {solved}" + (f", {found.kept} kept from before" if found.kept else "")
    yield "ended", found.ended
    yield from _derivatives(found)
    check = found.verified
    if check is not None:
        result = check.failure or ("every limit holds" if check.holds else "a limit does not hold, see above")
        yield "check", f"on a mesh {check.times_finer:g} times finer: {result}"
    for words, why in found.failed.items():
        yield "failed", f"{words}: {why}"


def _derivatives(found: Optimum) -> Iterator[tuple[str, str]]:
    every = {kind for by in found.derivatives.values() for kind in by.values()}
    for number, kind in enumerate(sorted(every - {"none"}, reverse=True)):
        parts = []
        for label, by in found.derivatives.items():
            keys = [key for key, own in by.items() if own == kind]
            parts += [f"{label} by {', '.join(keys)}"] if keys else []
        of = "all" if every == {kind} else "; ".join(parts)
        yield "" if number else "derivatives", f"{kind}: {of}"


def _bounds(limit: LimitAtOptimum) -> str:
    parts = [f">= {limit.lower:g}"] if isfinite(limit.lower) else []
    parts += [f"<= {limit.upper:g}"] if isfinite(limit.upper) else []
    return ", ".join(parts)


def _state(limit: LimitAtOptimum) -> str:
    held = "holds" if limit.holds else "does not hold"
    return f"{held}, active" if limit.active else held


def fit(
    file: Annotated[str, options.file_argument("FIT", "maps", "fits")],
    target: Annotated[
        Path | None, options.output("Device file to write, with the values found."), options.writes("device")
    ] = None,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
    json: options.Json = False,
) -> None:
    """Find unknown numbers of a device from measurements on it: values with their errors, what the readings cannot tell
    apart, and every reading beside what the fitted device gives.

    The whole device is solved some ten times for each unknown.

    Example: fieldmap fit loop_and_sphere -o fitted.toml

    Parameters
    ----------
    file
        Fit file, or the name of a shipped one.
    """
    from fieldmap.studies import read_fit

    asked = read_fit(file)
    if target is not None:
        from fieldmap.store.output_formats import output_problems

        read = (asked.path, asked.device_path)
        raise_all(output_problems("--output", target, ["device"], read))
    with Progress("fit") as progress:
        found = asked.run(_after_each_solve(progress, asked), workers, scheduler)
    if target is not None:
        from fieldmap.store import write_whole

        write_whole(
            target, f"# Written by fieldmap fit {asked.path.name}\n{found.device.to_toml()}", "device"
        )
    page.print_result(found, partial(_fit_page, asked, target), json, file=asked.path, written=target)


def _after_each_solve(
    progress: Callable[[str, float], None], asked: Fit
) -> Callable[[Mapping[str, float]], None]:
    """Function to call after each solve. The number of solves is unknown; about ten per unknown are expected."""
    expected, done = 10 * (len(asked.unknowns) + 1), 0

    def solved(values: Mapping[str, float]) -> None:
        nonlocal done
        done += 1
        words = ", ".join(f"{key} {value:.5g}" for key, value in values.items())
        progress(f"solve {done}: {words}", done / (done + expected))

    return solved


def _fit_page(asked: Fit, target: Path | None, found: MachineFit) -> Iterator[page.Section]:
    yield page.heading(asked.title, f"{asked.device_path.name}, {found.solves} solves")
    starts = {one.key: one.start for one in asked.unknowns}
    values = (
        (key, f"{value:.6g}", f"{found.deviations[key]:.2g}", f"{starts[key]:.6g}")
        for key, value in found.values.items()
    )
    yield page.table(("unknown", "value", "±", "before"), values)
    if len(found.values) > 1:
        rows = zip(found.values, found.correlation, strict=True)
        columns = ("correlation", *(f"({k + 1})" for k in range(len(found.values))))
        yield page.table(columns, ((key, *page.cells(row, ".2f")) for key, row in rows))
    for group in found.indistinct:
        yield page.remark(
            f"The readings cannot tell apart: {', '.join(group)}. A prior or other readings would."
        )
    for one in found.tables:
        unit, size = asked.units[one.name]
        use = "fitted" if one.used else "predicted"
        off = f"off by {one.misfit:.2g} deviations, {one.misfit_before:.2g} before"
        yield page.heading(one.name, f"{use}, {unit}: {off}")
        rows_of = zip(
            asked.labels[one.name], one.measured, one.after, one.uncertainty, one.before, strict=True
        )
        lines = (
            (
                label,
                f"{measured / size:.5g}",
                f"{after / size:.5g}",
                f"{error / size:.2g}",
                f"{before / size:.5g}",
            )
            for label, measured, after, error, before in rows_of
        )
        yield page.table(("", "measured", "computed", "±", "before"), lines)
    yield page.assumed(found.assumptions)
    yield page.written([target]) if target is not None else None

"""`fieldmap map` computes a map; `fieldmap info` and `fieldmap map --summary` print what a map holds."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.text import Text

from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_settings
from fieldmap.cli.messages import resumable
from fieldmap.cli.solve import FORMS_IN_WORDS
from fieldmap.errors import FieldmapError, InputError
from fieldmap.records import count_of

if TYPE_CHECKING:
    from fieldmap.io.map_summary import MapSummary, SensorOfMap
    from fieldmap.levitation.comparison import LiftAtHeight, ShiftBesideMeasured
    from fieldmap.plot.map_pictures import MapPicture
    from fieldmap.studies import ManyMaps
    from fieldmap.typing import PathLike


def make_map(
    recipe: Annotated[str, options.file_argument("RECIPE", "maps")],
    target: Annotated[
        Path | None,
        options.output("Map file to write. Default: maps/out/RECIPE.h5. With --over: the index, NetCDF."),
        options.writes("map", "study"),
    ] = None,
    changes: options.Changes = None,
    resume: options.Resume = True,
    summary: Annotated[bool, typer.Option("--summary")] = False,
    json: options.Json = False,
    pictures: Annotated[bool | None, typer.Option("--pictures/--no-pictures")] = None,
    accept_error: Annotated[bool, typer.Option("--accept-error")] = False,
    over: Annotated[str | None, typer.Option("--over", metavar="STUDY")] = None,
    part: Annotated[str | None, typer.Option("--part", metavar="K/N")] = None,
    workers: options.Workers = 1,
    scheduler: options.Scheduler = None,
) -> None:
    """Compute the map that a recipe describes. A stopped run continues where it was.

    --json prints the summary.

    Example: fieldmap map maps/workspace.toml -o maps/out/workspace.h5 --summary

    Parameters
    ----------
    recipe
        Recipe file, or the name of a shipped recipe.
    summary
        Print a summary of the map when it is done.
    pictures
        Draw the map in two pictures beside it, NAME.png and NAME_3d.png. Default: with --summary.
    accept_error
        Write the map even if the error of its current model is more than twice the recipe's, or its box nearer to iron
        or magnets than the recipe's accuracy allows.
    over
        Study file: make a map for each of its variants, in a folder beside an index of them.
    part
        With --over: only the k-th of n parts of the maps, and no index, as for one task of an array job.
    """
    if over is not None:
        unused = {"--set": changes, "--summary": summary, "--pictures": pictures}
        _make_many(recipe, over, target, resume, accept_error, part, workers, scheduler, json, unused)
        return
    if part is not None:
        raise InputError.of("--part", "goes with --over", part, "name a study: --over STUDY")
    from fieldmap import maps

    settings = parse_settings(changes)
    with resumable("map") as progress:
        path = maps.generate(
            recipe, target, resume, progress, workers, scheduler, changes=settings, accept_error=accept_error
        )
    _tell_what_is_missing(path)
    if summary or json or pictures:
        print_summary(path, json, (summary and not json) if pictures is None else pictures)
    else:
        print(path)


def _make_many(
    recipe: str,
    over: str,
    target: Path | None,
    resume: bool,
    accept_error: bool,
    part: str | None,
    workers: int,
    scheduler: str | None,
    json: bool,
    unused: Mapping[str, object],
) -> None:
    from fieldmap.studies import generate_many

    given = [option for option, value in unused.items() if value]
    if given:
        must_hold = "belongs to a single map"
        raise InputError.of(given[0], must_hold, f"{given[0]} with --over", "leave it out")
    with resumable("maps") as progress:
        made = generate_many(
            recipe,
            over,
            target,
            resume,
            workers,
            progress,
            scheduler,
            accept_error=accept_error,
            part=None if part is None else _part(part),
        )
    if made is not None:
        page.print_result(made, _page_of_many, json, files=[made.path, made.table])
        if len(made.failed) == len(made.study.variants):
            raise typer.Exit(FieldmapError.exit_code)


def _part(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if found is None:
        raise InputError.of("--part", "K/N, two whole numbers", text, "write for example --part 3/20")
    return int(found[1]), int(found[2])


def _page_of_many(made: ManyMaps) -> Iterator[page.Section]:
    total = len(made.study.variants)
    yield page.heading(made.study.title, f"{total - len(made.failed)} of {total} maps")
    yield page.facts([("failed", f"{name}: {reason}") for name, reason in made.failed.items()])
    if len(made.failed) < total:
        worst = made.data[["certified_flux_density", "certified_gradient"]].max()
        flux, slope = 1e6 * float(worst.certified_flux_density), 1e3 * float(worst.certified_gradient)
        yield page.facts([("certificate", f"at most {flux:.3g} uT and {slope:.3g} mT/m, of the worst map")])
    yield page.written([made.path, made.table])


def _tell_what_is_missing(path: Path) -> None:
    """Print failed states, and an accuracy that was not reached."""
    from fieldmap.store import read_info, warn_of_missed_accuracy

    report = read_info(path).provenance.solver_report
    for number, reason in report.get("states_failed", {}).items():
        print(f"state {number} could not be solved and was left out: {reason}", file=sys.stderr)
    warn_of_missed_accuracy(path, report)


def info(source: options.MapArgument, json: options.Json = False) -> None:
    """Print what a map holds: device, grid, field, gradient, lift current, and how accurate it is.

    Example: fieldmap info maps/out/workspace.h5
    """
    print_summary(source, json)


def print_summary(path: PathLike, json: bool, pictures: bool = False) -> None:
    """Open a map and print what it holds.

    Parameters
    ----------
    path : path
        The map.
    json : bool
        Print JSON instead of a page.
    pictures : bool
        Draw the map too, beside its file, and print where the pictures are.
    """
    from fieldmap.io import map_summary

    summary = map_summary.summarise_map(path)
    saved: tuple[MapPicture, ...] = ()
    if pictures:
        from fieldmap.plot.map_pictures import save_map_pictures

        saved = save_map_pictures(summary)
    page.print_result(summary, partial(_page, saved), json, **({"pictures": saved} if saved else {}))


def _page(pictures: Sequence[MapPicture], summary: MapSummary) -> Iterator[page.Section]:
    from fieldmap.io.accuracy_words import accuracy_words

    record = summary.info.provenance
    payload = () if summary.payload is None else summary.payload.assumptions
    yield Group(page.heading(str(summary.path), record.title), page.facts(_facts(summary)))
    yield page.facts(accuracy_words(summary))
    yield _unit_table(summary) if summary.domain is None else None
    yield _lift_table(summary) if summary.lift else None
    for shift in summary.shifts:
        yield _shift_table(shift)
    yield page.assumed((*record.assumptions, *payload, *summary.lift_assumptions))
    yield Text(summary.saturation, style="bold") if summary.saturation else None
    if pictures:
        yield page.facts((one.shows, str(one.path or one.problem)) for one in pictures)


def _facts(summary: MapSummary) -> Iterator[tuple[str, str]]:
    info, record, grid = summary.info, summary.info.provenance, summary.info.grid
    names, solver = info.coil_names, info.provenance.solver_report
    yield "device", f"{record.device_name}, {count_of(len(names), 'coil', 'coils')}: {', '.join(names)}"
    yield "iron", ", ".join(_solver_words(solver))
    if summary.domain is not None:
        yield "currents", _currents(summary)
    if summary.current_limit is not None:
        yield "driver", f"at most {summary.current_limit:g} A per coil"
    if info.fixed_sources:
        yield "no current", _without_currents(summary)
    shape = " x ".join(str(n) for n in grid.shape)
    steps = dict.fromkeys(grid.spacing.round(9).tolist())
    spacing = " x ".join(f"{1e3 * step:g}" for step in steps)
    corners = f"{page.place(grid.lower)} to {page.place(grid.upper)} mm"
    yield "grid", f"{shape} nodes, {spacing} mm apart, from {corners}"
    if summary.domain is not None:
        yield "field", _middle(summary)
    if summary.lift_missing:
        yield "lift current", summary.lift_missing
    for sensor in summary.sensors:
        yield f"sensor {sensor.name}", _sensor(summary, sensor)
    yield "file", f"{summary.size / 1e6:.2f} MB, made {record.created}"
    if summary.domain is not None:
        yield "cost", _cost(solver)
    for number, reason in solver.get("states_failed", {}).items():
        yield f"state {number}", f"not solved: {reason}"


def _cost(solver: Mapping[str, Any]) -> str:
    words = (
        f"{solver['states_solved']} states in {solver['generation_seconds'] / 60:.1f} minutes, "
        f"{solver['generation_processor_seconds'] / 60:.1f} of processor time"
    )
    # Maps of earlier versions, and maps made on Windows, do not record it.
    peak = solver.get("generation_peak_memory_bytes")
    return words if peak is None else f"{words}, {peak / 1e9:.1f} GB of memory"


def _currents(summary: MapSummary) -> str:
    domain, ranges = summary.domain, summary.signal_ranges()
    assert domain is not None
    of = domain.parametrisation
    if of.name == "independent" and len(set(ranges.values())) == 1:
        low, high = next(iter(ranges.values()))
        return f"{low:g} to {high:g} A in every coil, independently"
    if of.name == "independent":
        return ", ".join(f"{name} {low:g} to {high:g} A" for name, (low, high) in ranges.items())
    units = dict(zip(ranges, of.signal_units, strict=True))
    words = [
        f"{name} {low:g} to {high:g}{' A' if units[name] == 'A' else ''}"
        for name, (low, high) in ranges.items()
    ]
    given = of.parameters
    words += [
        f"{name} = {value:g}" for name, value in given.items() if isinstance(value, float) and name != "limit"
    ]
    limit = f"; no coil above {given['limit']:g} A" if "limit" in given else ""
    return f"{of.name}: {', '.join(words)}{limit}"


def _middle(summary: MapSummary) -> str:
    """Words for a map over currents, whose values are at the reference currents."""
    from fieldmap.io.accuracy_words import reference_words

    middle = summary.middle
    flux, slope = 1e3 * middle.Bz[0], 1e3 * middle.dBz_dz[0]
    return f"Bz {flux:.4f} mT, dBz/dz {slope:.3f} mT/m at {page.place(middle.at)} mm with {reference_words(summary)}"


def _sensor(summary: MapSummary, sensor: SensorOfMap) -> str:
    from fieldmap.io.accuracy_words import reference_words

    currents = "1 A in every coil" if summary.domain is None else reference_words(summary)
    axis = ", ".join(f"{x:.3g}" for x in sensor.axis)
    payload = ""
    if sensor.of_payload is not None:
        payload = f", payload at {page.place(summary.middle.at)} mm {1e3 * sensor.of_payload:+.3f} mT"
    at = f"at {page.place(sensor.position)} mm along ({axis})"
    return f"{at}: {1e3 * sensor.of_currents:.3f} mT with {currents}{payload}"


def _without_currents(summary: MapSummary) -> str:
    sources, off = ", ".join(summary.info.fixed_sources), summary.middle.without_currents
    if off is None:
        return f"drives the field of {sources}"
    flux, slope = 1e3 * off[0], 1e3 * off[1]
    return f"drives the field of {sources}: Bz {flux:.4f} mT, dBz/dz {slope:.3f} mT/m in the middle"


def _solver_words(solver: Mapping[str, object]) -> list[str]:
    if solver.get("form") == "coils":
        return [FORMS_IN_WORDS["coils"]]
    words = ["saturating" if "modes" in solver else "linear"]
    if "level_of_histories" in solver:
        words.append("hysteresis")
    if "form" in solver:
        words.append(FORMS_IN_WORDS.get(str(solver["form"]), str(solver["form"])))
    for key, text in (("tetrahedra", "tetrahedra"), ("surface_faces", "surface faces")):
        if key in solver:
            words.append(f"{solver[key]:,} {text}".replace(",", " "))
    # For a reduced model these are the seconds of its mesh alone; the line of the cost has all.
    seconds = solver.get("seconds")
    if isinstance(seconds, Mapping) and "generation_seconds" not in solver:
        words.append(f"{sum(seconds.values()):.0f} s")
    return words


def _unit_table(summary: MapSummary) -> RenderableType:
    middle = summary.middle
    names = (*(f"coil {name}" for name in summary.info.coil_names), "all")
    rows = (
        (name, *page.cells(values, ".4f", 1e3))
        for name, *values in zip(names, middle.Bz, middle.dBz_dz, strict=True)
    )
    return page.table((f"1 A, at {page.place(middle.at)} mm", "Bz, mT", "dBz/dz, mT/m"), rows)


def _lift_table(summary: MapSummary) -> RenderableType:
    payload, fit = summary.payload, summary.force_fit
    assert payload is not None
    title = f"lift {1e3 * payload.mass:.4g} g, "
    title += payload.description if payload.pieces else f"{payload.moment:.3g} A m2"
    title += f" {payload.held().removeprefix('moment ')}"
    if fit is None:
        iron = "A in every coil (linear)" if summary.domain is None else "A in every coil"
        rows = ((f"magnet at z = {1e3 * row.height:.1f} mm", _amperes(row)) for row in summary.lift)
        return page.table((title, iron), rows)
    forced = f"force x {fit.factor:.2f}, A"
    columns = (title, "z, mm", "measured, A", "lift/weight", "ours, A", forced, "off by")
    fitted = (
        (
            f"sensor {row.sensor_mm:g} mm",
            f"{1e3 * row.height:.1f}",
            *page.cells((row.measured, row.lift_share), ".3f"),
            _amperes(row),
            *page.cells((current,), ".3f"),
            "-" if deviation is None else f"{100 * deviation:+.1f} %",
        )
        for row, current, deviation in zip(summary.lift, fit.currents, fit.deviations, strict=True)
    )
    words = (
        f"Measured: {summary.lift_source}. lift/weight is calculated at the measured current. The factor "
        f"{fit.factor:.3f} on the calculated force is fitted to lift/weight by least squares. No other number here "
        "contains it."
    )
    return Group(page.table(columns, fitted), page.remark(words))


def _amperes(row: LiftAtHeight) -> str:
    if row.current is not None:
        return f"{row.current:.3f}"
    return "out of range" if row.beyond is None else f"> {row.beyond:.3g}"


def _shift_table(shift: ShiftBesideMeasured) -> RenderableType:
    rows = (
        (f"measured, {shift.source}", *page.cells(shift.measured, ".2f", 1e3)),
        ("ours, lift constant", *page.cells(shift.constant_lift, ".2f", 1e3)),
        ("ours, level constant", *page.cells(shift.constant_level, ".2f", 1e3)),
    )
    columns = ("x of the magnet, mm, at x signal", *(f"{signal:g}" for signal in shift.signals))
    held = shift.levels[np.isfinite(shift.levels)]
    follows = f" to {held[-1]:.3f} A" if held.size else ""
    words = (
        f"n = {shift.n:g}, sensor {shift.sensor_mm:g} mm, {1e3 * shift.zero:g} mm at signal 0; nothing is fitted. "
        f"Level constant: {shift.level:.3f} A. Lift constant: the level rises{follows}, as under a controller of the "
        "height."
    )
    beyond = " -: out of range." if len(held) < len(shift.signals) else ""
    return Group(page.table(columns, rows), page.remark(words + beyond))

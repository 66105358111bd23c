"""Fields to and from other programs: `fieldmap export` and `fieldmap import`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.arguments import check, raise_all
from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_currents, parse_moment, parse_pairs
from fieldmap.cli.options import option
from fieldmap.errors import InputError, Problem
from fieldmap.histories import HISTORIES
from fieldmap.progress import Progress

if TYPE_CHECKING:
    from fieldmap.interop import MeasuredMap, Measurements
    from fieldmap.io import IronOptions
    from fieldmap.lookup import FieldMap, MapAtCurrents

# Format -> its options.
FORMATS = {
    "c": ("--kind", "--currents", "--outside"),
    "c32": ("--kind", "--currents", "--outside"),
    "csv": ("--currents", "--spacing-mm"),
    "fmu": ("--kind", "--currents", "--outside", "--fmi", "--moment", "--body", "--drive", "--sources"),
    "mag-manip": ("--currents", "--spacing-mm"),
    "vti": ("--currents", "--spacing-mm"),
}
# Format -> its name in `fieldmap.store.output_formats`.
WRITTEN = {
    "c": "map for C",
    "c32": "C header",
    "csv": "table of a field",
    "fmu": "unit of FMI",
    "mag-manip": "field for mag_manip",
    "vti": "VTK image data",
}
_OF_ANY_FIELD = ("csv", "vti")


def export(
    source: Annotated[str, options.file_argument("DEVICE_OR_MAP", "geometry")],
    to: Annotated[str, option("--to", "NAME")],
    target: Annotated[Path, options.output("File to write."), options.writes(*WRITTEN.values())],
    kind: Annotated[str, option("--kind", "NAME")] = "harmonic",
    currents: options.Currents = None,
    history: Annotated[str | None, option("--history", "NAME")] = None,
    level: Annotated[list[str] | None, option("--level", "A[,A...]")] = None,
    spacing_mm: Annotated[float | None, option("--spacing-mm", "MM")] = None,
    outside: Annotated[str, option("--outside", "RULE")] = "nan",
    fmi: Annotated[int | None, option("--fmi", "2|3")] = None,
    moment: options.Moment = None,
    body: Annotated[
        str | None, option("--body", "DEVICE", autocompletion=options.shipped("geometry"))
    ] = None,
    drive: Annotated[
        str | None, option("--drive", "DEVICE", autocompletion=options.shipped("geometry"))
    ] = None,
    sources: Annotated[bool, typer.Option("--sources")] = False,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    json: options.Json = False,
) -> None:
    """Write a map, or the field in the workspace of a device, for other programs.

    --currents fixes the currents; without it the other program sets them. An fmu has a magnet of --moment, by default 1
    A m2 upward. Iron with hysteresis goes with its memory, and c and fmu go on from there.

    Example: fieldmap export maps/out/linear.h5 --to c -o linear.fmap

    Parameters
    ----------
    source
        Map file; for csv and vti also a device file or name, which is solved.
    to
        c: one flat file and its header. c32: constants in single precision and their header. csv: a table. fmu: a unit
        of FMI, compiled here. mag-manip: YAML. vti: VTK image data.
    kind
        For c, c32 and fmu: harmonic (one polynomial per cell) or global (one for the box, a few kB).
    history
        Of iron with hysteresis: shaken or demagnetised. Default: shaken.
    level
        Of iron with hysteresis: currents at which the history ends, A. Default: those of the map's training.
    spacing_mm
        For csv, vti and mag-manip: largest distance between nodes. Default: the map's nodes, for mag-manip as many as
        it needs; a device needs it.
    outside
        For c, c32 and fmu: the result outside the map, nan or clamp.
    fmi
        For fmu: version of FMI. Default: 2.
    body
        For fmu: the payload of this device moves inside, as a rigid body.
    drive
        For fmu: the drive that [driver] of this device names is inside, and inputs are what it is asked for.
    sources
        For fmu: C sources alone, for an importer that compiles them.
    """
    from fieldmap import interop
    from fieldmap.io import existing_map, is_map_file
    from fieldmap.lookup import open_map
    from fieldmap.store.output_formats import output_problems

    given = {
        "--kind": kind != "harmonic",
        "--currents": bool(currents),
        "--spacing-mm": spacing_mm is not None,
        "--outside": outside != "nan",
        "--fmi": fmi is not None,
        "--moment": moment is not None,
        "--body": body is not None,
        "--drive": drive is not None,
        "--sources": sources,
    }
    check(to in FORMATS, "--to", f"must be one of {', '.join(FORMATS)}", to, "choose one of these")
    raise_all(output_problems("--output", target, [WRITTEN[to]]))
    wrong = ", ".join(name for name, there in given.items() if there and name not in FORMATS[to])
    must_hold = "must be a format that has these options"
    check(not wrong, "--to", must_hold, f"{wrong} with {to}", "leave them out")
    iron, settings = options.of_device(changes, mu_r, nonlinear, refinement)
    spacing = None if spacing_mm is None else 1e-3 * spacing_mm
    sampled, files = None, tuple[Path, ...]()
    if not is_map_file(source):
        _require_memory(history is None and not level, source)
        files = (_of_device(source, to, target, currents, spacing, iron, settings),)
    else:
        options.refuse_iron_of_map(iron, settings)
        field = open_map(existing_map(source), kind, outside)
        if history is not None or level:
            _require_memory(field.remembers, source)
            at = parse_currents(level, field.coil_names, "--level") if level else None
            must_hold, remedy = "must come with a history that ends at a level", "leave it out"
            check(at is None or history != "demagnetised", "--level", must_hold, "demagnetised", remedy)
            field = field.memory(HISTORIES[0] if history is None else history, at)
        amperes = parse_currents(currents, field.coil_names) if currents else None
        if to in _OF_ANY_FIELD:
            files = (_writer(to)(field, target, amperes, spacing),)
        elif to == "mag-manip":
            sampled = interop.sample_for_mag_manip(field, spacing, amperes)
            files = (sampled.write(target),)
        elif to == "c" and amperes is None and not field.affine:
            files = interop.write_c_iron_files(field, target)
        else:
            good = to != "c32" or field.affine or amperes is not None
            must_hold = "must come with --currents: single precision cannot solve for the state of the iron"
            remedy = "add --currents A, or write --to c, in double precision"
            check(good, f"{source} --to {to}", must_hold, "no --currents", remedy)
            fixed = field if amperes is None else field.at(amperes)
            if to == "fmu":
                files = (_unit(fixed, target, fmi, moment, body, drive, sources),)
            else:
                write = interop.write_c_files if to == "c" else interop.write_c32_files
                files = write(fixed, target)
    if json:
        page.print_json({"written": files} | ({} if sampled is None else sampled.to_dict()))
        return
    print(*files, sep="\n")
    if sampled is not None:
        print(sampled.summary, file=sys.stderr)


def _require_memory(good: bool, source: str) -> None:
    must_hold, remedy = "must come with a map of iron with hysteresis", "leave out --history and --level"
    check(good, "--history", must_hold, source, remedy)


def _of_device(
    source: str,
    to: str,
    target: Path,
    currents: list[str] | None,
    spacing: float | None,
    iron: IronOptions,
    settings: dict[str, object],
) -> Path:
    from fieldmap.io.answers import require_box

    remedy = "make a map first: fieldmap map RECIPE"
    check(to in _OF_ANY_FIELD, source, f"must be a map file for --to {to}", "a device", remedy)
    must_hold, remedy = "must come with a device, which has no nodes", "add for example --spacing-mm 2"
    check(spacing is not None, "--spacing-mm", must_hold, "none", remedy)
    options.require_currents(iron.nonlinear, currents)
    with Progress("export") as progress:
        found = options.find_named(source, iron, progress, settings)
        require_box(found)
        amperes = parse_currents(currents, found.coil_names) if currents else None
        return _writer(to)(found.field, target, amperes, spacing, found.device_name)


def _writer(to: str) -> Callable[..., Path]:
    if to == "vti":
        from fieldmap.plot.vti import write_vti

        return write_vti
    from fieldmap.interop import write_csv

    return write_csv


def _unit(
    field: FieldMap | MapAtCurrents,
    target: Path,
    fmi: int | None,
    moment: str | None,
    device: str | None,
    driven: str | None,
    sources: bool,
) -> Path:
    """Write the FMU with the magnet of `--moment`, or with the payload of a device inside, and a device's drive."""
    from fieldmap.device import read_device
    from fieldmap.interop import write_fmu

    body = drive = None
    if device is not None:
        payload = read_device(device).payload
        if payload is None or moment is not None:
            must = "must be a device with a [payload], whose moment is that of the unit"
            received = device if payload is None else "--moment as well"
            raise InputError.of("--body", must, received, "choose another, or leave it out")
        from fieldmap.dynamics import body_of_payload

        body = body_of_payload(payload)
    if driven is not None:
        from fieldmap.dynamics import drive_of_device

        drive = drive_of_device(read_device(driven))
        must = 'must be a device whose [driver] has a drive, and not "ideal"'
        check(drive.coupled, "--drive", must, driven, "choose another, or leave it out")
    magnet = parse_moment("1" if moment is None else moment)
    version = 2 if fmi is None else fmi
    return write_fmu(field, target, magnet, body, drive=drive, version=version, binary=not sources)


def import_map(
    source: Annotated[Path, typer.Argument(metavar="READINGS")],
    target: Annotated[Path, options.output("Map file to write (.h5)."), options.writes("map")],
    spacing: Annotated[float, option("--spacing-mm", "MM")] = 5.0,
    currents: Annotated[list[str] | None, option("--currents", "NAME=A[,NAME=A...]")] = None,
    units: options.Units = None,
    degree: Annotated[int | None, option("--degree", "N", min=2)] = None,
    json: options.Json = False,
) -> None:
    """Fit harmonic polynomials to a table of flux densities and write them as a map; print how well they fit.

    Example: fieldmap import readings.csv -o maps/out/measured.h5 --spacing-mm 5

    Parameters
    ----------
    source
        Text with columns x_mm, y_mm, z_mm, I_NAME_A ..., Bx_mT, By_mT, Bz_mT, table of Opera, text of COMSOL, or
        FieldMesh of openPMD.
    spacing
        Largest distance between nodes of the map.
    currents
        Constant currents of coils that have no columns.
    degree
        Degree of the polynomials: lower is smoother. Default: the one that predicts held-out readings best.
    """
    from fieldmap.interop import fit_map, read_measurements
    from fieldmap.store import write_map

    given = [word for text in currents or [] for word in text.split(",")]
    fixed, problems = parse_pairs(given, "--currents", "NAME=A", "coil=1.5")
    unit_of, more = parse_pairs(units, "--unit", "NAME=UNIT", "x=mm")
    problems += more + [
        Problem("--currents", "must be a number of A", f"{name}={value}", "write for example coil=1.5")
        for name, value in fixed.items()
        if not _is_number(value)
    ]
    raise_all(problems)
    amperes = {name: float(value) for name, value in fixed.items()}
    readings = read_measurements(source, amperes, unit_of)
    measured = fit_map(readings, 1e-3 * spacing, degree=degree)
    write_map(target, measured.data)
    shown = partial(_import_page, source, target, readings)
    page.print_result(measured, shown, json, map=target, unread=list(readings.unread))


def _is_number(text: str) -> bool:
    try:
        return isfinite(float(text))
    except ValueError:
        return False


def _import_page(
    source: Path, target: Path, readings: Measurements, measured: MeasuredMap
) -> Iterator[page.Section]:
    report, data, error = measured.report, measured.data, measured.report.standard_error
    held_out = f"{1e6 * report.held_out:.3g} uT rms, {1e6 * report.held_out_worst:.3g} uT at worst"
    at_nodes = f"{1e6 * error.flux_density:.3g} uT, {1e3 * error.gradient:.3g} mT/m at the nodes"
    assumptions = (text.removeprefix("measured: ") for text in data.provenance.assumptions[:2])
    yield page.heading(str(target), f"from {source}")
    yield page.facts(
        [
            ("readings", f"{report.readings}, coils {', '.join(data.coil_names)}"),
            ("nodes", " x ".join(map(str, data.grid.shape))),
            ("degree", f"{report.degree}"),
            ("residual", f"{1e6 * report.residual:.3g} uT rms per component"),
            ("held out", f"{held_out}, of readings predicted without them"),
            ("standard error", f"{at_nodes}, from scatter alone"),
            *((("not read", ", ".join(readings.unread)),) if readings.unread else ()),
            ("assumed", "; ".join(assumptions)),
        ]
    )

"""`fieldmap export`: a map, or the field of a device, for other programs."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import (
    Changes,
    Json,
    MuR,
    Nonlinear,
    Refinement,
    changes_of_device,
    checked_iron,
    devices,
    refuse_iron_of_map,
    require_currents,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from fieldmap.interop import VectorFields
    from fieldmap.io import IronOptions
    from fieldmap.lookup import FieldMap

# Which of these options each format takes; a table on the nodes is the same for every kind.
FORMATS = {
    "c": ("--kind", "--currents", "--outside"),
    "c32": ("--kind", "--currents", "--outside"),
    "csv": ("--currents", "--spacing-mm"),
    "fmu": ("--kind", "--currents", "--outside", "--fmi", "--moment", "--body", "--sources"),
    "mag-manip": ("--currents", "--spacing-mm"),
    "vti": ("--currents", "--spacing-mm"),
}
_OF_ANY_FIELD = ("csv", "vti")


def export(
    source: Annotated[
        str,
        typer.Argument(
            metavar="DEVICE_OR_MAP",
            help="Map file; for csv and vti also a device file or name, which is solved.",
            autocompletion=devices,
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="NAME",
            help="c: one flat file and its header. c32: constants in single precision and their header. csv: a table. "
            "fmu: a unit of FMI, compiled here. mag-manip: YAML. vti: VTK image data.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    kind: Annotated[
        str,
        typer.Option(
            "--kind",
            metavar="NAME",
            help="For c, c32 and fmu: harmonic (one polynomial per cell) or global (one for the box, a few kB).",
        ),
    ] = "harmonic",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents",
            metavar="A[,A...]",
            help="Fixed currents: one per coil, one for all, or NAME=A. Default: set by the program.",
        ),
    ] = None,
    spacing_mm: Annotated[
        float | None,
        typer.Option(
            "--spacing-mm",
            metavar="MM",
            help="For csv, vti and mag-manip: largest distance between nodes. Default: the map's nodes, for mag-manip "
            "as many as it needs; a device needs it.",
        ),
    ] = None,
    outside: Annotated[
        str,
        typer.Option(
            "--outside",
            metavar="RULE",
            help="For c, c32 and fmu: the result outside the map, nan or clamp.",
        ),
    ] = "nan",
    fmi: Annotated[
        int | None, typer.Option("--fmi", metavar="2|3", help="For fmu: version of FMI. Default: 2.")
    ] = None,
    moment: Annotated[
        float | None,
        typer.Option(
            "--moment", metavar="AM2", help="For fmu: of the magnet, along its z, A m^2. Default: 1."
        ),
    ] = None,
    body: Annotated[
        str | None,
        typer.Option(
            "--body",
            metavar="DEVICE",
            help="For fmu: the payload of this device moves inside, as a rigid body.",
            autocompletion=devices,
        ),
    ] = None,
    sources: Annotated[
        bool, typer.Option("--sources", help="For fmu: C sources alone, for an importer that compiles them.")
    ] = False,
    changes: Changes = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    json: Json = False,
) -> None:
    """Write a map, or the field in the workspace of a device, for other programs."""
    from fieldmap.cli.printing import print_json
    from fieldmap.io import is_map_file

    given = {
        "--kind": kind != "harmonic",
        "--currents": bool(currents),
        "--spacing-mm": spacing_mm is not None,
        "--outside": outside != "nan",
        "--fmi": fmi is not None,
        "--moment": moment is not None,
        "--body": body is not None,
        "--sources": sources,
    }
    _check(to, [option for option, there in given.items() if there])
    iron, settings = checked_iron(mu_r, nonlinear, refinement, "auto"), changes_of_device(changes)
    if is_map_file(source):
        refuse_iron_of_map(iron, settings)
    spacing = None if spacing_mm is None else 1e-3 * spacing_mm
    sampled = None
    if to == "mag-manip" and is_map_file(source):
        sampled = _sampled(source, currents, spacing)
        written: tuple[Path, ...] = (sampled.write(output),)
    elif to == "fmu" and is_map_file(source):
        written = (_unit(source, output, currents, (kind, outside), (fmi, moment, body, sources)),)
    elif is_map_file(source):
        written = _of_map(source, to, output, currents, spacing, (kind, outside))
    else:
        written = _of_device(source, iron, to, output, currents, spacing, settings)
    if json:
        print_json({"written": written} | ({} if sampled is None else sampled.to_dict()))
        return
    print(*written, sep="\n")
    if sampled is not None:
        print(sampled.summary, file=sys.stderr)


def _check(to: str, given: list[str]) -> None:
    from fieldmap.errors import InputError, Problem

    if to not in FORMATS:
        raise InputError(Problem("--to", f"must be one of {', '.join(FORMATS)}", to, "choose one of these"))
    wrong = [option for option in given if option not in FORMATS[to]]
    if wrong:
        received = f"{', '.join(wrong)} with {to}"
        raise InputError(
            Problem("--to", "must be a format that has these options", received, "leave them out")
        )


def _sampled(source: str, currents: list[str] | None, spacing: float | None) -> "VectorFields":
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.interop import sample_for_mag_manip
    from fieldmap.io import existing_map
    from fieldmap.lookup import open_map

    opened = open_map(existing_map(source))
    amperes = parse_currents(currents, opened.coil_names) if currents else None
    return sample_for_mag_manip(opened, spacing, amperes)


def _unit(
    source: str,
    output: Path,
    currents: list[str] | None,
    how: tuple[str, str],
    what: tuple[int | None, float | None, str | None, bool],
) -> Path:
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.device import read_device
    from fieldmap.errors import InputError, Problem
    from fieldmap.interop import write_fmu
    from fieldmap.io import existing_map
    from fieldmap.lookup import open_map

    (fmi, moment, device, sources), opened = what, open_map(existing_map(source), *how)
    require_currents(not opened.affine, currents, f"{source} --to fmu")
    body = None
    if device is not None:
        payload = read_device(device).payload
        if payload is None or moment is not None:
            must = "must be a device with a [payload], whose moment is that of the unit"
            received = device if payload is None else "--moment as well"
            raise InputError(Problem("--body", must, received, "choose another, or leave it out"))
        from fieldmap.dynamics import body_of_payload

        body = body_of_payload(payload)
    field = opened.at(parse_currents(currents, opened.coil_names)) if currents else opened
    magnet = (0.0, 0.0, 1.0 if moment is None else moment)
    return write_fmu(field, output, magnet, body, version=2 if fmi is None else fmi, binary=not sources)


def _of_map(
    source: str,
    to: str,
    output: Path,
    currents: list[str] | None,
    spacing: float | None,
    how: tuple[str, str],
) -> tuple[Path, ...]:
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.interop import write_c32_files, write_c_files, write_c_iron_files
    from fieldmap.io import existing_map
    from fieldmap.lookup import open_map

    opened: FieldMap = open_map(existing_map(source), *how)
    amperes = parse_currents(currents, opened.coil_names) if currents else None
    if to == "c" and amperes is None and not opened.affine:
        return write_c_iron_files(opened, output)
    if to in ("c", "c32"):
        require_currents(not opened.affine, currents, f"{source} --to {to}")
        write = write_c_files if to == "c" else write_c32_files
        return write(opened if amperes is None else opened.at(amperes), output)
    return (_writer(to)(opened, output, amperes, spacing),)


def _of_device(
    source: str,
    iron: "IronOptions",
    to: str,
    output: Path,
    currents: list[str] | None,
    spacing: float | None,
    settings: "dict[str, Any]",
) -> tuple[Path, ...]:
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.errors import InputError, Problem
    from fieldmap.io import find_source
    from fieldmap.io.answers import require_box
    from fieldmap.progress import Progress

    if to not in _OF_ANY_FIELD:
        remedy = "make a map first: fieldmap map RECIPE"
        raise InputError(Problem(source, f"must be a map file for --to {to}", "a device", remedy))
    if spacing is None:
        remedy = "add for example --spacing-mm 2"
        raise InputError(
            Problem("--spacing-mm", "must come with a device, which has no nodes", "none", remedy)
        )
    require_currents(iron.nonlinear, currents)
    with Progress("export") as progress:
        found = find_source(source, iron, progress, settings)
        require_box(found)
        amperes = parse_currents(currents, found.coil_names) if currents else None
        return (_writer(to)(found.field, output, amperes, spacing, found.device_name),)


def _writer(to: str) -> "Callable[..., Path]":
    if to == "vti":
        from fieldmap.plot.vti import write_vti

        return write_vti
    from fieldmap.interop import write_csv

    return write_csv

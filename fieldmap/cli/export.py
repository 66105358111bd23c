"""`fieldmap export`: a map for programs that are not Python."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from fieldmap.lookup import FieldAtCurrents, FieldMap


def export(
    source: Annotated[str, typer.Argument(metavar="MAP", help="Map file.")],
    to: Annotated[
        str, typer.Option("--to", metavar="NAME", help="c: one flat file, and its header. mag-manip: YAML.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Where to write.")],
    kind: Annotated[
        str, typer.Option("--kind", metavar="NAME", help="harmonic (per cell) or global (a few kB).")
    ] = "harmonic",
    currents: Annotated[
        list[str] | None,
        typer.Option("--currents", metavar="A[,A...]", help="Fixed: one per coil, or one for all."),
    ] = None,
    outside: Annotated[
        str, typer.Option("--outside", metavar="RULE", help="What a point outside gives: nan or clamp.")
    ] = "nan",
) -> None:
    """Write a map for other programs."""
    from fieldmap.cli.numbers import parse_currents
    from fieldmap.cli.opening import check_map_path
    from fieldmap.errors import InputError, Problem
    from fieldmap.lookup import open_map

    if to not in ("c", "mag-manip"):
        raise InputError(Problem("--to", "must be c or mag-manip", to, "choose one that exists"))
    if to == "mag-manip" and (kind != "harmonic" or currents or outside != "nan"):
        received = "--kind, --currents or --outside with mag-manip"
        raise InputError(Problem("--to", "must be c for these", received, "leave them out"))
    opened = open_map(check_map_path(source), kind, outside)
    field = opened if not currents else opened.at(parse_currents(currents, opened.coil_names))
    for path in _write_c(field, output) if to == "c" else _write_mag_manip(opened, output):
        print(path)


def _write_mag_manip(field: "FieldMap", output: Path) -> tuple[Path]:
    from fieldmap.adapters import write_mag_manip

    return (write_mag_manip(field, output),)


def _write_c(field: "FieldMap | FieldAtCurrents", output: Path) -> tuple[Path, Path]:
    """The map, and the header beside it."""
    from fieldmap.adapters import c_header, write_c_map, write_whole

    path = write_c_map(field, output)
    header = path.with_name(c_header().name)
    write_whole(header, c_header().read_bytes())
    return path, header

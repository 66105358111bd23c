"""`fieldmap export`: a map for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fieldmap.lookup import FieldMap

# What each format takes of --kind, --currents and --outside; a table on the nodes is the same in every form.
FORMATS = {
    "c": ("--kind", "--currents", "--outside"),
    "csv": ("--currents",),
    "mag-manip": (),
    "vti": ("--currents",),
}


def export(
    source: Annotated[str, typer.Argument(metavar="MAP", help="Map file.")],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="NAME",
            help="c: one flat file, and its header. csv: a table. vti: VTK image data. mag-manip: YAML.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Where to write.")],
    kind: Annotated[
        str, typer.Option("--kind", metavar="NAME", help="For c: harmonic (per cell) or global (a few kB).")
    ] = "harmonic",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="Fixed: one per coil, or one for all; else coil by coil."
        ),
    ] = None,
    outside: Annotated[
        str,
        typer.Option("--outside", metavar="RULE", help="For c: what a point outside gives: nan or clamp."),
    ] = "nan",
    json: Json = False,
) -> None:
    """Write a map for other programs."""
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.cli.opening import check_map_path
    from fieldmap.lookup import open_map

    given = {"--kind": kind != "harmonic", "--currents": bool(currents), "--outside": outside != "nan"}
    _check(to, [option for option, there in given.items() if there])
    opened = open_map(check_map_path(source), kind, outside)
    amperes = parse_currents(currents, opened.coil_names) if currents else None
    written = _write(to, opened, output, amperes)
    if json:
        from fieldmap.cli.printing import print_json

        print_json({"written": written})
    else:
        print(*written, sep="\n")


def _check(to: str, given: list[str]) -> None:
    from fieldmap.errors import InputError, Problem

    if to not in FORMATS:
        raise InputError(
            Problem("--to", f"must be one of {', '.join(FORMATS)}", to, "choose one that exists")
        )
    wrong = [option for option in given if option not in FORMATS[to]]
    if wrong:
        received = f"{', '.join(wrong)} with {to}"
        raise InputError(
            Problem("--to", "must be a format that knows these options", received, "leave them out")
        )


def _write(to: str, field: "FieldMap", output: Path, currents: "NDArray | None") -> tuple[Path, ...]:
    if to == "vti":
        from fieldmap.plot.vti import write_vti

        return (write_vti(field, output, currents),)
    if to == "c":
        return _write_c(field, output, currents)
    from fieldmap.interop import write_csv, write_mag_manip

    return (write_csv(field, output, currents) if to == "csv" else write_mag_manip(field, output),)


def _write_c(field: "FieldMap", output: Path, currents: "NDArray | None") -> tuple[Path, Path]:
    """The map, and the header beside it."""
    from fieldmap.interop import c_header, write_c_map, write_whole

    path = write_c_map(field if currents is None else field.at(currents), output)
    header = path.with_name(c_header().name)
    write_whole(header, c_header().read_bytes())
    return path, header

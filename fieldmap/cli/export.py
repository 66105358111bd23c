"""`fieldmap export`: a map for other programs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import Json

if TYPE_CHECKING:
    from fieldmap.lookup import FieldMap
    from fieldmap.typing import Array

# Which of --kind, --currents and --outside each format takes; a table on the nodes is the same for every kind.
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
            help="c: one flat file and its header. csv: a table. vti: VTK image data. mag-manip: YAML.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="Where to write.")],
    kind: Annotated[
        str, typer.Option("--kind", metavar="NAME", help="For c: harmonic (per cell) or global (a few kB).")
    ] = "harmonic",
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents",
            metavar="A[,A...]",
            help="Fixed currents: one per coil, or one for all. Otherwise coil by coil.",
        ),
    ] = None,
    outside: Annotated[
        str,
        typer.Option(
            "--outside", metavar="RULE", help="For c: what a point outside the map gives, nan or clamp."
        ),
    ] = "nan",
    json: Json = False,
) -> None:
    """Write a map for other programs."""
    from fieldmap.cli.arguments import parse_currents
    from fieldmap.cli.printing import print_json
    from fieldmap.io import existing_map
    from fieldmap.lookup import open_map

    given = {"--kind": kind != "harmonic", "--currents": bool(currents), "--outside": outside != "nan"}
    _check(to, [option for option, there in given.items() if there])
    opened = open_map(existing_map(source), kind, outside)
    written = _write(to, opened, output, parse_currents(currents, opened.coil_names) if currents else None)
    if json:
        print_json({"written": written})
    else:
        print(*written, sep="\n")


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


def _write(to: str, field: "FieldMap", output: Path, currents: "Array | None") -> tuple[Path, ...]:
    if to == "vti":
        from fieldmap.plot.vti import write_vti

        return (write_vti(field, output, currents),)
    from fieldmap.interop import write_c_files, write_csv, write_mag_manip

    if to == "c":
        return write_c_files(field if currents is None else field.at(currents), output)
    return (write_csv(field, output, currents) if to == "csv" else write_mag_manip(field, output),)

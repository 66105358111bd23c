"""`fieldmap probe`: field, gradient and force at points, of a device or a map."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldmap.cli.options import At, AtMm, Form, Json, MuR, Nonlinear, Refinement, devices

if TYPE_CHECKING:
    from fieldmap.cli.opening import Source
    from fieldmap.errors import OutsideMapError


def probe(
    source: Annotated[
        str,
        typer.Argument(
            metavar="DEVICE_OR_MAP", help="Device file or name, or map file.", autocompletion=devices
        ),
    ],
    currents: Annotated[
        list[str], typer.Option("--currents", metavar="A[,A...]", help="One per coil, or one for all.")
    ],
    at: At = None,
    at_mm: AtMm = None,
    payload: Annotated[
        bool, typer.Option("--payload", help="Force and torque on the device's payload, moment upward.")
    ] = False,
    moment: Annotated[
        str | None, typer.Option("--moment", metavar="X Y Z", help="Force and torque on this moment, A m2.")
    ] = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Print B, its gradient and, on request, force and torque at points."""
    from fieldmap.cli.arguments import parse_currents, parse_moment, parse_points
    from fieldmap.cli.iron import checked_choice
    from fieldmap.cli.opening import find_source
    from fieldmap.errors import InputError, OutsideMapError, Problem

    points = parse_points(at or [], at_mm or [])
    if not len(points):
        remedy = "add --at X Y Z (m) or --at-mm X Y Z"
        raise InputError(Problem("--at", "must give at least one point", "none", remedy))
    choice = checked_choice(mu_r, nonlinear, refinement, form)
    dipole = None if moment is None else parse_moment(moment)
    found = find_source(source, choice)
    amperes = parse_currents(currents, found.coil_names)
    if payload and dipole is None:
        dipole = _payload_moment(found)
    field, assumptions = found.open(amperes)
    try:
        rows = _rows(field, points, amperes, dipole)
    except OutsideMapError as error:
        raise _in_metres(error, at or []) from None
    if json:
        from fieldmap.cli.printing import print_json

        about = {"source": found.name, "kind": found.kind, "coil_names": found.coil_names}
        answers = [about | row | {"assumptions": assumptions} for row in rows]
        print_json(answers[0] if len(answers) == 1 else answers)
    else:
        _print(found, rows, amperes, assumptions)


def _in_metres(error: "OutsideMapError", at: list[str]) -> "OutsideMapError":
    """What to do on the command line about points outside a map."""
    from dataclasses import replace

    from fieldmap.errors import OutsideMapError

    remedy = "--at is in m, --at-mm in mm" if at else "stay in the box, or make a larger map"
    # The others are about currents.
    problems = (replace(p, remedy=remedy) if p.where == "points" else p for p in error.problems)
    return OutsideMapError(*problems)


def _payload_moment(found: "Source") -> Any:
    import numpy as np

    from fieldmap.errors import InputError, Problem

    if found.payload is None:
        raise InputError(
            Problem(
                found.name,
                "must have a [payload] table for --payload",
                "none",
                "add one, or give --moment X Y Z",
            )
        )
    return np.array([0.0, 0.0, found.payload.moment])


def _rows(field: Any, points: Any, currents: Any, dipole: Any) -> list[dict[str, Any]]:
    import numpy as np

    from fieldmap.levitation import dipole_force

    b, g = field.field(points, currents), field.gradient(points, currents)
    rows = []
    for point, flux_density, gradient in zip(points, b, g, strict=True):
        row = {"at": point, "currents": currents, "B": flux_density, "gradient": gradient}
        if dipole is not None:
            row |= {
                "moment": dipole,
                "force": dipole_force(dipole, gradient),
                "torque": np.cross(dipole, flux_density),
            }
        rows.append(row)
    return rows


def _print(found: "Source", rows: list[dict[str, Any]], currents: Any, assumptions: tuple[str, ...]) -> None:
    from fieldmap.cli.fields import field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading, print_page

    print_page(
        heading(found.name, found.kind),
        field_table(rows, found.coil_names, currents),
        _force_table(rows) if "force" in rows[0] else None,
        facts(assumption_lines(assumptions)),
    )


def _force_table(rows: list[dict[str, Any]]) -> Any:
    from rich.console import Group
    from rich.text import Text

    from fieldmap.cli.printing import place, table, without_noise

    cells = (
        (
            place(row["at"]),
            *(
                f"{1e3 * value:.5g}"
                for value in (*without_noise(row["force"]), *without_noise(row["torque"]))
            ),
        )
        for row in rows
    )
    moment = ", ".join(f"{value:.4g}" for value in rows[0]["moment"])
    columns = ("at", "Fx mN", "Fy mN", "Fz mN", "Tx mN m", "Ty mN m", "Tz mN m")
    return Group(Text(f"Force and torque on a moment of ({moment}) A m2"), table(columns, cells))

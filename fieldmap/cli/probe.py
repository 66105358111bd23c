"""`fieldmap probe`: field, gradient and force at points, of a device or a map."""

from typing import Annotated, Any

import typer


def probe(
    source: Annotated[str, typer.Argument(metavar="DEVICE_OR_MAP", help="Device file or name, or map file.")],
    currents: Annotated[
        list[str], typer.Option("--currents", metavar="A[,A...]", help="One per coil, or one for all.")
    ],
    at: Annotated[
        list[str] | None, typer.Option("--at", metavar="X Y Z", help="Point in m; may be repeated.")
    ] = None,
    at_mm: Annotated[
        list[str] | None, typer.Option("--at-mm", metavar="X Y Z", help="Point in mm; may be repeated.")
    ] = None,
    payload: Annotated[
        bool, typer.Option("--payload", help="Force and torque on the device's payload, moment upward.")
    ] = False,
    moment: Annotated[
        str | None, typer.Option("--moment", metavar="X Y Z", help="Force and torque on this moment, A m2.")
    ] = None,
    mu_r: Annotated[
        float | None, typer.Option("--mu-r", help="Relative permeability of the iron; for a device only.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print B, its gradient and, on request, force and torque at points."""
    from fieldmap.cli.numbers import parse_currents, parse_moment, parse_points
    from fieldmap.cli.opening import open_field
    from fieldmap.cli.solve import check_mu_r
    from fieldmap.errors import InputError, Problem

    points = parse_points(at or [], at_mm or [])
    if not len(points):
        raise InputError(
            Problem("--at", "must give at least one point", "none", "add --at X Y Z (m) or --at-mm X Y Z")
        )
    check_mu_r(mu_r)
    dipole = None if moment is None else parse_moment(moment)
    opened = open_field(source, mu_r)
    amperes = parse_currents(currents, opened.field.coil_names)
    if payload and dipole is None:
        dipole = _payload_moment(opened)
    rows = _rows(opened.field, points, amperes, dipole)
    if json:
        from fieldmap.cli.printing import print_json

        about = {"source": opened.name, "kind": opened.kind, "coil_names": opened.field.coil_names}
        answers = [about | row | {"assumptions": opened.assumptions} for row in rows]
        print_json(answers[0] if len(answers) == 1 else answers)
    else:
        _print(opened, rows, amperes)


def _payload_moment(opened: Any) -> Any:
    import numpy as np

    from fieldmap.errors import InputError, Problem

    if opened.payload is None:
        raise InputError(
            Problem(
                opened.name,
                "must have a [payload] table for --payload",
                "none",
                "add one, or give --moment X Y Z",
            )
        )
    return np.array([0.0, 0.0, opened.payload.moment])


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


def _print(opened: Any, rows: list[dict[str, Any]], currents: Any) -> None:
    from fieldmap.cli.fields import field_table
    from fieldmap.cli.printing import assumption_lines, console, heading, millimetres, table

    out = console()
    out.print(heading(opened.name, opened.kind))
    out.print(field_table(rows, opened.field.coil_names, currents))
    if "force" in rows[0]:
        cells = (
            (
                millimetres(row["at"]),
                *(f"{1e3 * value:.5g}" for value in row["force"]),
                *(f"{1e3 * value:.5g}" for value in row["torque"]),
            )
            for row in rows
        )
        moment = ", ".join(f"{value:.4g}" for value in rows[0]["moment"])
        out.print(f"on a moment ({moment}) A m2")
        out.print(table(("at", "Fx mN", "Fy mN", "Fz mN", "Tx mN m", "Ty mN m", "Tz mN m"), cells))
    out.print(assumption_lines(opened.assumptions))

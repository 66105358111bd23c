"""`fieldmap probe`: field, gradient and force at points, of a device or a map."""

from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import (
    At,
    AtMm,
    Changes,
    DeviceOrMapArgument,
    Form,
    Json,
    MuR,
    Nonlinear,
    PayloadOf,
    Refinement,
    changes_of_device,
    checked_iron,
    find_named,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType

    from fieldmap.cli.printing import Section
    from fieldmap.device.model import Payload
    from fieldmap.errors import OutsideMapError
    from fieldmap.io.answers import Probe
    from fieldmap.lookup import MagneticBody
    from fieldmap.typing import Array


def probe(
    source: DeviceOrMapArgument,
    currents: Annotated[
        list[str],
        typer.Option("--currents", metavar="A[,A...]", help="One per coil, one for all, or NAME=A."),
    ],
    at: At = None,
    at_mm: AtMm = None,
    payload: Annotated[
        bool, typer.Option("--payload", help="Force and torque on the device's payload, moment upward.")
    ] = False,
    payload_of: PayloadOf = None,
    moment: Annotated[
        str | None, typer.Option("--moment", metavar="X Y Z", help="Force and torque on this moment, A m2.")
    ] = None,
    changes: Changes = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Print B, its gradient and, on request, force and torque at points."""
    from fieldmap.cli.arguments import parse_currents, parse_moment, parse_points
    from fieldmap.cli.printing import print_json, print_page
    from fieldmap.errors import InputError, OutsideMapError, Problem
    from fieldmap.io import named_device
    from fieldmap.io.answers import probe as probe_field
    from fieldmap.progress import Progress

    points = parse_points(at or [], at_mm or [])
    if not len(points):
        remedy = "add --at X Y Z (m) or --at-mm X Y Z"
        raise InputError(Problem("--at", "must give at least one point", "none", remedy))
    options, settings = checked_iron(mu_r, nonlinear, refinement, form), changes_of_device(changes)
    dipole: Array | MagneticBody | None = None if moment is None else parse_moment(moment)
    if payload_of is not None:
        _refuse_moment(moment)
        other = named_device(payload_of)
        dipole = payload_moment(other.name, other.payload, "--payload-of")
    with Progress("solving") as progress:
        found = find_named(source, options, progress, settings)
        amperes = parse_currents(currents, found.coil_names)
        if payload and dipole is None:
            dipole = payload_moment(found.name, found.payload, "--payload")
        try:
            answer = probe_field(found, points, amperes, dipole)
        except OutsideMapError as error:
            raise _in_metres(error, at or []) from None
    if json:
        rows = answer.to_dicts()
        print_json(rows[0] if len(rows) == 1 else rows)
    else:
        print_page(*_page(answer))


def _in_metres(error: "OutsideMapError", at: list[str]) -> "OutsideMapError":
    """The error with a remedy for points outside a map that fits the command line."""
    from dataclasses import replace

    from fieldmap.errors import OutsideMapError

    remedy = "--at is in m, --at-mm in mm" if at else "stay in the box, or make a larger map"
    # The others are about currents.
    problems = (replace(p, remedy=remedy) if p.where == "points" else p for p in error.problems)
    return OutsideMapError(*problems)


def _refuse_moment(moment: str | None) -> None:
    from fieldmap.errors import InputError, Problem

    if moment is not None:
        remedy = "leave one of them out"
        raise InputError(Problem("--payload-of", "must not come with --moment", f"--moment {moment}", remedy))


def payload_moment(name: str, payload: "Payload | None", option: str) -> "Array | MagneticBody":
    """What the field acts on: the moment of a payload, upward, or its pieces. Raises InputError for a device without
    one."""
    import numpy as np

    from fieldmap.errors import InputError, Problem

    if payload is None:
        must_hold = f"must have a [payload] table for {option}"
        remedy = "add one, name a device that has one with --payload-of, or give --moment X Y Z"
        raise InputError(Problem(name, must_hold, "none", remedy))
    if payload.pieces:
        from fieldmap.lookup import magnetic_body

        return magnetic_body(payload)
    return np.array([0.0, 0.0, payload.moment])


def _page(answer: "Probe") -> "Iterator[Section]":
    from fieldmap.cli.fields import field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading

    yield heading(answer.source.name, answer.source.kind)
    yield field_table(answer.points, answer.source.coil_names, answer.points[0].currents)
    yield force_table(answer) if answer.points[0].moment is not None else None
    yield facts(assumption_lines(answer.assumptions))


def force_table(answer: "Probe") -> "RenderableType":
    """Force and torque on the moment at each point."""
    import numpy as np
    from rich.console import Group
    from rich.text import Text

    from fieldmap.cli.printing import place, table, without_noise

    cells = []
    for point in answer.points:
        assert point.force is not None
        assert point.torque is not None
        size = 0.0 if point.moment is None else float(np.abs(point.moment).max())
        force = without_noise(point.force, beside=size * float(np.abs(point.gradient).max()))
        torque = without_noise(point.torque, beside=size * float(np.abs(point.B).max()))
        numbers = (*force, *torque)
        cells.append((place(point.at), *(f"{1e3 * value:.5g}" for value in numbers)))
    first = answer.points[0].moment
    assert first is not None
    moment = ", ".join(f"{value:.4g}" for value in without_noise(first))
    columns = ("at", "Fx mN", "Fy mN", "Fz mN", "Tx mN m", "Ty mN m", "Tz mN m")
    return Group(Text(f"Force and torque on a moment of ({moment}) A m2"), table(columns, cells))

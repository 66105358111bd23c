"""`fieldmap currents`: the currents of least power that give a force, a torque or a flux density at a point."""

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

    from fieldmap.cli.printing import Section
    from fieldmap.device.model import Payload
    from fieldmap.io.answers import LeastPower
    from fieldmap.lookup import MagneticBody
    from fieldmap.typing import Array


def currents(
    source: DeviceOrMapArgument,
    at: At = None,
    at_mm: AtMm = None,
    lift: Annotated[
        bool,
        typer.Option(
            "--lift", help="The payload's weight, upward; of three coils or more no force sideways."
        ),
    ] = False,
    force: Annotated[
        str | None, typer.Option("--force", metavar="X Y Z", help="Force, N; nan leaves a component free.")
    ] = None,
    torque: Annotated[
        str | None, typer.Option("--torque", metavar="X Y Z", help="Torque, N m, likewise.")
    ] = None,
    field: Annotated[
        str | None, typer.Option("--field", metavar="X Y Z", help="Flux density, T, likewise.")
    ] = None,
    moment: Annotated[
        str | None,
        typer.Option("--moment", metavar="X Y Z", help="Of a dipole, A m2. Default: the payload, upright."),
    ] = None,
    payload_of: PayloadOf = None,
    limit: Annotated[
        float | None,
        typer.Option("--limit", metavar="A", help="Of every current. Default: the driver's, if it has one."),
    ] = None,
    changes: Changes = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Find the currents of least power that give a force, a torque or a flux density at a point.

    The exit code is 1 if no currents within the limits give it; the message says what can be had.
    """
    from fieldmap.cli.arguments import parse_moment, parse_points, parse_wanted
    from fieldmap.cli.printing import print_result
    from fieldmap.cli.probe import payload_moment
    from fieldmap.io import named_device
    from fieldmap.io.answers import least_power
    from fieldmap.progress import Progress

    points = parse_points(at or [], at_mm or [])
    _check(len(points), lift, force, torque, field, moment, payload_of, limit)
    options, settings = checked_iron(mu_r, nonlinear, refinement, form), changes_of_device(changes)
    units = {"force": (force, "N"), "torque": (torque, "N m"), "field": (field, "T")}
    asked = {
        name: None if text is None else parse_wanted(text, f"--{name}", unit)
        for name, (text, unit) in units.items()
    }
    with Progress("solving") as progress:
        found = find_named(source, options, progress, settings)
        owner = found if payload_of is None else named_device(payload_of)
        on: Array | MagneticBody | None = None if moment is None else parse_moment(moment)
        if on is None and (lift or force or torque):
            on = payload_moment(owner.name, owner.payload, "--payload-of" if payload_of else "a force")
        if lift:
            asked["force"] = _weight(owner.payload, len(found.coil_names))
        driver = None if found.driver is None else found.driver.current_limit
        answer = least_power(found, points[0], on, driver if limit is None else limit, **asked)
    print_result(answer, _page, json)


def _check(
    points: int,
    lift: bool,
    force: str | None,
    torque: str | None,
    field: str | None,
    moment: str | None,
    payload_of: str | None,
    limit: float | None,
) -> None:
    """Raise InputError, before anything is solved, for all that does not fit."""
    from fieldmap.errors import InputError, Problem

    problems = []
    if points != 1:
        remedy = "give one --at X Y Z (m) or --at-mm X Y Z"
        problems.append(Problem("--at", "must give one point", f"{points} points", remedy))
    if not (lift or force or torque or field):
        must_hold = "must have --lift, --force, --torque or --field"
        remedy = "--lift asks for the payload's weight, --force 0 0 0.01 for 10 mN upward"
        problems.append(Problem("currents", must_hold, "none of them", remedy))
    for other, given in (("--force", force), ("--moment", moment)):
        if lift and given:
            remedy = "leave one of them out: --lift is the force that carries the payload"
            problems.append(Problem("--lift", f"must not come with {other}", f"{other} {given}", remedy))
    if moment and payload_of:
        must_hold, remedy = "must not come with --moment", "leave one of them out"
        problems.append(Problem("--payload-of", must_hold, f"--moment {moment}", remedy))
    if limit is not None and not 0.0 < limit < float("inf"):
        problems.append(Problem("--limit", "must be a positive number", f"{limit}", "give amperes"))
    if problems:
        raise InputError(*problems)


def _weight(payload: "Payload | None", coils: int) -> "Array":
    """What lifts; one or two coils cannot be asked for three components."""
    import numpy as np

    from fieldmap.constants import GRAVITY
    from fieldmap.lookup.payload import check_payload

    aside = 0.0 if coils >= 3 else np.nan
    return np.array([aside, aside, check_payload(payload, "--lift", pieces=True).mass * GRAVITY])


def _page(answer: "LeastPower") -> "Iterator[Section]":
    import numpy as np

    from fieldmap.cli.fields import field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading, table, without_noise
    from fieldmap.cli.probe import force_table

    names, amperes = answer.source.coil_names, without_noise(answer.currents)
    columns: tuple[str, ...] = ("coil", "A")
    rows: list[tuple[str, ...]] = [(name, f"{value:.4f}") for name, value in zip(names, amperes, strict=True)]
    if answer.limit is not None:
        columns = (*columns, "of the limit")
        shares = 100 * np.abs(amperes) / answer.limit
        rows = [(*row, f"{share:.0f} %") for row, share in zip(rows, shares, strict=True)]
    yield heading(answer.source.name, answer.source.kind)
    yield facts(_facts(answer))
    yield table(columns, rows)
    yield field_table(answer.given.points)
    yield force_table(answer.given) if answer.given.points[0].moment is not None else None
    yield facts(assumption_lines(answer.given.assumptions))


def _facts(answer: "LeastPower") -> "Iterator[tuple[str, str]]":
    from fieldmap.cli.printing import place

    units = {"force": (1e3, "mN"), "torque": (1e3, "mN m"), "field": (1e3, "mT")}
    for name, values in answer.asked.items():
        factor, unit = units[name]
        parts = ", ".join("free" if value != value else f"{factor * value:.5g}" for value in values)
        yield name, f"({parts}) {unit} at {place(answer.given.points[0].at)}"
    none = "none; --limit sets one"
    yield "limit", none if answer.limit is None else f"{answer.limit:g} A in every coil"
    yield "power", f"least: the squares of the currents sum to {answer.sum_of_squares:.4g} A2"

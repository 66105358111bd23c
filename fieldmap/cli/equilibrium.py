"""`fieldmap equilibrium`: where the payload floats, or the current that carries it at a height."""

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import (
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

    from rich.table import Table

    from fieldmap.cli.printing import Section
    from fieldmap.device.model import Payload
    from fieldmap.io import FieldSource
    from fieldmap.io.answers import Levitation
    from fieldmap.levitation import Equilibrium, LiftCurrent
    from fieldmap.typing import Array


def equilibrium(
    source: DeviceOrMapArgument,
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents",
            metavar="A[,A...]",
            help="One per coil, one for all, or NAME=A: find where the payload floats.",
        ),
    ] = None,
    height_mm: Annotated[
        float | None,
        typer.Option(
            "--height-mm",
            metavar="MM",
            help="z of the magnet's centre (negative: below): find the current that lifts it.",
        ),
    ] = None,
    sensor_mm: Annotated[
        float | None,
        typer.Option(
            "--sensor-mm", metavar="MM", help="The same, as a reading of the vertical sensor, mm downward."
        ),
    ] = None,
    start: Annotated[
        str | None, typer.Option("--start", metavar="X Y Z", help="Where the search begins, m.")
    ] = None,
    moment: Annotated[
        str,
        typer.Option("--moment", metavar="NAME", help="fixed: stays vertical; aligned: follows the field."),
    ] = "fixed",
    payload_of: PayloadOf = None,
    changes: Changes = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Find where the payload floats and how stiffly, or the current that carries it at a height."""
    from fieldmap.cli.arguments import parse_currents, parse_points
    from fieldmap.cli.printing import print_result
    from fieldmap.io import named_device
    from fieldmap.io.answers import floating, lifted
    from fieldmap.lookup.payload import check_payload
    from fieldmap.progress import Progress

    _exactly_one(currents, height_mm, sensor_mm)
    options, settings = checked_iron(mu_r, nonlinear, refinement, form), changes_of_device(changes)
    begin = None if start is None else parse_points([start], [])[0]
    with Progress("solving") as progress:
        found = find_named(source, options, progress, settings)
        amperes = parse_currents(currents, found.coil_names) if currents else None
        payload = check_payload(
            found.payload if payload_of is None else named_device(payload_of).payload,
            "equilibrium",
            pieces=True,
        )
        if amperes is not None:
            _check_search(found, begin, moment)
            answer = floating(found, payload, amperes, begin, moment)
        else:
            height = _height(found, height_mm, sensor_mm, payload)
            answer = lifted(found, payload, height, _tell_state if nonlinear else None)
    print_result(answer, _page, json)


def _check_search(found: "FieldSource", start: "Array | None", moment: str) -> None:
    """Raise InputError, before anything is solved, for a start or a moment that does not fit, by its option."""
    from fieldmap.errors import InputError, Problem
    from fieldmap.io.answers import MOMENTS, require_box
    from fieldmap.levitation.balance import check_position

    if start is not None:
        check_position(require_box(found), start, "--start")
    if moment not in MOMENTS:
        raise InputError(Problem("--moment", "must be fixed or aligned", moment, "choose one"))


def _tell_state(current: float, share: float) -> None:
    print(f"{current:.4f} A per coil lifts {100 * share:.2f} % of the weight", file=sys.stderr)


def _height(
    found: "FieldSource", height_mm: float | None, sensor_mm: float | None, payload: "Payload"
) -> float:
    from fieldmap.device.measured import measured_machine, measured_on

    if height_mm is not None:
        return 1e-3 * height_mm
    frame = measured_on(found.device_name, len(found.coil_names)) or measured_machine()
    return frame.height(float(sensor_mm or 0.0), payload.magnet_offset)


def _exactly_one(currents: list[str] | None, height_mm: float | None, sensor_mm: float | None) -> None:
    from fieldmap.errors import InputError, Problem

    count = sum((bool(currents), height_mm is not None, sensor_mm is not None))
    if count != 1:
        raise InputError(
            Problem(
                "equilibrium",
                "must have exactly one of --currents, --height-mm and --sensor-mm",
                f"{count} of them",
                "--currents asks where the payload floats, the other two ask for the current that lifts it",
            )
        )


def _page(answer: "Levitation") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, table, without_noise
    from fieldmap.levitation import LiftCurrent

    found = answer.found
    special = _lift_rows(answer, found) if isinstance(found, LiftCurrent) else _floating_rows(answer, found)
    stiffness = without_noise(found.stiffness)
    lines = [(axis, *(f"{k:+.4g}" for k in stiffness[i])) for i, axis in enumerate("xyz")]
    yield heading(answer.source.name, answer.source.kind)
    yield facts([*_common_rows(answer), *special])
    yield table(("stiffness, N/m", "x", "y", "z"), lines)
    if isinstance(found, LiftCurrent):
        yield _states_table(answer, found) if found.history else None
    else:
        yield table(("direction (x, y, z)", "stiffness N/m", "stable"), _directions(found))
    yield facts(assumption_lines(answer.assumptions))


def _common_rows(answer: "Levitation") -> "Iterator[tuple[str, str]]":
    from fieldmap.cli.fields import currents_text
    from fieldmap.cli.printing import millimetres, without_noise
    from fieldmap.levitation import GRAVITY

    payload, found = answer.payload, answer.found
    weight = f"{1e3 * payload.mass:.4g} g (weight {1e3 * payload.mass * GRAVITY:.4g} mN)"
    yield "payload", f"{weight}, {payload.description}"
    yield "currents", currents_text(answer.source.coil_names, found.currents)
    yield "magnet's centre", millimetres(found.position)
    if answer.has_sensor:
        offset = f"(magnet_offset {1e3 * payload.magnet_offset:g} mm)"
        yield "sensor reading", f"{answer.reading_mm + 0.0:.3f} mm downward {offset}"
    field = ", ".join(f"{1e3 * value:.4g}" for value in without_noise(found.field))
    yield "field there", f"({field}) mT"


def _floating_rows(answer: "Levitation", found: "Equilibrium") -> "Iterator[tuple[str, str]]":
    import numpy as np

    from fieldmap.cli.printing import millimetres
    from fieldmap.levitation import GRAVITY

    report = found.report
    turned = "induced" if answer.payload.soft else "up" if found.moment[2] > 0 else "down"
    left = np.linalg.norm(found.force_residual) / (answer.payload.mass * GRAVITY)
    trace = found.trace / np.linalg.norm(found.stiffness)
    yield "moment", f"{turned}, {found.angle_to_field:.2f} degrees from the field"
    yield "residual", f"{left:.1e} of the weight; {report.starts} starts, {report.evaluations} field points"
    yield "trace", f"{trace:.1e} of the stiffness (0 for a fixed dipole, below 0 for an aligned one)"
    for point in found.others:
        yield "also at", millimetres(point)


def _lift_rows(answer: "Levitation", found: "LiftCurrent") -> "Iterator[tuple[str, str]]":
    from fieldmap.cli.printing import without_noise

    sideways = ", ".join(f"{1e3 * value:.3g}" for value in without_noise(found.force)[:2])
    each = " in every coil" if len(answer.source.coil_names) > 1 else ""
    yield "lift current", f"{found.current:.4f} A{each}"
    machine, measured, limit = answer.machine, answer.measured_current, answer.current_limit
    if machine is not None and measured is not None:
        ratio = f"this model needs {found.current / measured:.2f} times as much"
        yield "measured", f"{measured:.4f} A{each}, {machine.lift_source}; {ratio}"
    if limit is not None and abs(found.current) > limit:
        yield "driver", f"gives at most {limit:g} A per coil, less than this"
    yield "dF/di", f"{1e3 * found.force_per_ampere[2]:.4g} mN upward per ampere{each}"
    yield "left over", f"sideways force ({sideways}) mN"


def _states_table(answer: "Levitation", found: "LiftCurrent") -> "Table":
    """The states on the way to the lift current."""
    from fieldmap.cli.printing import table
    from fieldmap.levitation import GRAVITY

    weight = answer.payload.mass * GRAVITY
    rows = (
        (f"{current:.4f}", f"{1e3 * lift:.3f}", f"{1e3 * lift / current:.3f}", f"{100 * lift / weight:.2f} %")
        for current, lift in found.history
    )
    return table(("A per coil, states solved", "lift mN", "mN per A", "of the weight"), rows)


def _directions(found: "Equilibrium") -> "Iterator[tuple[str, ...]]":
    from fieldmap.cli.printing import without_noise

    for direction, value, stable in zip(found.directions.T, found.eigenvalues, found.stable, strict=True):
        components = ", ".join(f"{component:+.3f}" for component in without_noise(direction))
        yield f"({components})", f"{value:+.4g}", "yes" if stable else "no"

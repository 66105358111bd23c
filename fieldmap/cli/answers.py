"""Questions to the field of a device or a map: `fieldmap probe`, `fieldmap currents` and `fieldmap equilibrium`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from fieldmap.arguments import check, raise_all
from fieldmap.cli import arguments, options, page
from fieldmap.cli.options import option
from fieldmap.constants import GRAVITY
from fieldmap.errors import InputError, OutsideMapError, Problem
from fieldmap.progress import Progress

if TYPE_CHECKING:
    from fieldmap.device.model import Payload
    from fieldmap.io import FieldSource
    from fieldmap.io.answers import LeastPower, Levitation, Probe
    from fieldmap.levitation import Equilibrium, LiftCurrent
    from fieldmap.typing import Array


def probe(
    source: options.DeviceOrMapArgument,
    currents: Annotated[list[str], options.CURRENTS],
    at: options.At = None,
    at_mm: options.AtMm = None,
    payload: Annotated[bool, typer.Option("--payload")] = False,
    payload_of: options.PayloadOf = None,
    moment: options.Moment = None,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    form: options.Form = "auto",
    json: options.Json = False,
) -> None:
    """Print B and its gradient at points.

    With --payload, --payload-of or --moment, print force and torque on a magnet too.

    Example: fieldmap probe drive_unit --at 0 0 -0.1 --currents 1.5 --payload

    Parameters
    ----------
    payload
        Force and torque on the device's payload, whose moment points as payload.direction says.
    """
    from fieldmap.io import answers

    points = arguments.parse_points(at, at_mm)
    remedy = "add --at X Y Z (m) or --at-mm X Y Z"
    check(len(points) > 0, "--at", "must give at least one point", "none", remedy)
    iron, settings = options.of_device(changes, mu_r, nonlinear, refinement, form)
    raise_all(_both_magnets(moment, payload_of))
    with Progress("solving") as progress:
        found = options.find_named(source, iron, progress, settings)
        magnet = options.magnet_of_options(found, moment, payload_of, "--payload" if payload else "")
        carried = None if moment else options.payload_of_option(found, payload_of)
        turns = carried is not None and not carried.pieces and carried.turning == "free"
        try:
            amperes = arguments.parse_currents(currents, found.coil_names)
            answer = answers.probe(found, points, amperes, magnet, turns)
        except OutsideMapError as error:
            remedy = "--at is in m, --at-mm in mm" if at else "stay in the box, or make a larger map"
            # Other problems concern the currents.
            told = (replace(p, remedy=remedy) if p.where == "points" else p for p in error.problems)
            raise OutsideMapError(*told) from None
    if json:
        rows = answer.to_dicts()
        page.print_json(rows[0] if len(rows) == 1 else rows)
    else:
        page.print_page(*_probe_page(answer))


def _both_magnets(moment: str | None, payload_of: str | None) -> list[Problem]:
    """The problem if both --moment and --payload-of name the magnet."""
    must_hold, received = "must not come with --moment", f"--moment {moment}"
    both = Problem("--payload-of", must_hold, received, "leave one of them out")
    return [both] if moment and payload_of else []


def _probe_page(answer: Probe) -> Iterator[page.Section]:
    yield page.heading(answer.source.name, answer.source.kind)
    yield page.field_table(answer.points, answer.source.coil_names, answer.points[0].currents)
    yield force_table(answer)
    yield page.assumed(answer.assumptions)


def force_table(answer: Probe) -> RenderableType | None:
    """Force and torque on the moment at each point; nothing without a moment."""
    from fieldmap.io.answers import ALONG_FIELD

    first, rows = answer.points[0].moment, []
    if first is None:
        return None
    for point in answer.points:
        assert point.moment is not None
        assert point.force is not None
        assert point.torque is not None
        size = float(np.abs(point.moment).max())
        force = page.without_noise(point.force, beside=size * float(np.abs(point.gradient).max()))
        torque = page.without_noise(point.torque, beside=size * float(np.abs(point.B).max()))
        rows.append((f"{page.place(point.at)} mm", *page.cells((*force, *torque), ".5g", 1e3)))
    moment = ", ".join(page.cells(page.without_noise(first), ".4g"))
    columns = ("at", "Fx mN", "Fy mN", "Fz mN", "Tx mN m", "Ty mN m", "Tz mN m")
    if answer.held == ALONG_FIELD:
        moment = f"{np.linalg.norm(first):.4g}"
    return Group(
        Text(f"Force and torque on a moment of ({moment}) A m2: {answer.held}"), page.table(columns, rows)
    )


def currents(
    source: options.DeviceOrMapArgument,
    at: options.At = None,
    at_mm: options.AtMm = None,
    lift: Annotated[bool, typer.Option("--lift")] = False,
    force: Annotated[str | None, option("--force", "X Y Z")] = None,
    torque: Annotated[str | None, option("--torque", "X Y Z")] = None,
    field: Annotated[str | None, option("--field", "X Y Z")] = None,
    direction: Annotated[str | None, option("--direction", "X Y Z")] = None,
    least_field: Annotated[float, option("--least-field", "T", min=0.0)] = 0.0,
    moment: options.Moment = None,
    payload_of: options.PayloadOf = None,
    limit: options.Limit = None,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    form: options.Form = "auto",
    json: options.Json = False,
) -> None:
    """Find the currents of least power that give a force, a torque or a flux density at a point.

    Force and torque act on the payload, upright, or on --moment. With --direction the magnet follows the field, which
    then points that way; so does --lift of five coils or more for a payload that states turning = "free". The exit code
    is 1 if no currents within the limits give what was asked for; the message says what can be had.

    Example: fieldmap currents eight_coils_bead --at-mm 0 0 0 --lift

    Parameters
    ----------
    lift
        The payload's weight, upward; of three coils or more no force sideways.
    force
        Force, N; nan leaves a component free.
    torque
        Torque, N m; nan leaves a component free.
    field
        Flux density, T; nan leaves a component free.
    direction
        Way in which the flux density points, of whatever size, and the magnet with it.
    least_field
        With --direction: at least this flux density along it.
    """
    from fieldmap.io.answers import least_power, lift_force

    points = arguments.parse_points(at, at_mm)
    given = {
        "force": (force, "N"),
        "torque": (torque, "N m"),
        "field": (field, "T"),
        "direction": (direction, "any unit"),
    }
    asked = {
        name: arguments.parse_wanted(text, f"--{name}", unit)
        for name, (text, unit) in given.items()
        if text is not None
    }
    _check_demand(points, asked, lift, force, moment, payload_of, limit)
    iron, settings = options.of_device(changes, mu_r, nonlinear, refinement, form)
    with Progress("solving") as progress:
        found = options.find_named(source, iron, progress, settings)
        acts = moment or lift or not asked.keys() <= {"field", "direction"}
        magnet = options.magnet_of_options(found, moment, payload_of, "a force") if acts else None
        if lift:
            payload = options.payload_of_option(found, payload_of)
            asked["force"] = lift_force(payload, len(found.coil_names))
            # Five coils for three components of a force and two of a direction.
            steered = payload is not None and not payload.pieces and len(found.coil_names) >= 5
            if payload is not None and steered and payload.turning == "free":
                asked.setdefault("direction", np.sign(payload.moment_vector))
        driver = None if found.driver is None else found.driver.current_limit
        most = driver if limit is None else limit
        answer = least_power(found, points[0], magnet, most, least_field, **asked)
    page.print_result(answer, _currents_page, json)


def _check_demand(
    points: Array,
    asked: Mapping[str, Array],
    lift: bool,
    force: str | None,
    moment: str | None,
    payload_of: str | None,
    limit: float | None,
) -> None:
    """Raise InputError, before anything is solved, for all options that do not fit."""
    problems = []
    if len(points) != 1:
        remedy = "give one --at X Y Z (m) or --at-mm X Y Z"
        problems.append(Problem("--at", "must give one point", f"{len(points)} points", remedy))
    if not (lift or asked):
        must_hold = "must have --lift, --force, --torque, --field or --direction"
        remedy = "--lift asks for the payload's weight, --force 0 0 0.01 for 10 mN upward"
        problems.append(Problem("currents", must_hold, "none of them", remedy))
    if asked and all(np.isnan(values).all() for values in asked.values()):
        where, must_hold = ", ".join(f"--{name}" for name in asked), "must ask for one component or more"
        problems.append(Problem(where, must_hold, "nan for each of them", "give a number for X, Y or Z"))
    for other, given in (("--force", force), ("--moment", moment)):
        if lift and given:
            remedy = "leave one of them out: --lift is the force that carries the payload"
            problems.append(Problem("--lift", f"must not come with {other}", f"{other} {given}", remedy))
    problems += arguments.positive_problems("--limit", limit, "give amperes")
    raise_all([*problems, *_both_magnets(moment, payload_of)])


def _currents_page(answer: LeastPower) -> Iterator[page.Section]:
    amperes = page.without_noise(answer.currents)
    columns: tuple[str, ...] = ("coil", "A")
    rows = [[name, f"{value:.4f}"] for name, value in zip(answer.source.coil_names, amperes, strict=True)]
    if answer.limit is not None:
        columns = (*columns, "of the limit")
        for row, value in zip(rows, amperes, strict=True):
            row.append(f"{100 * abs(value) / answer.limit:.0f} %")
    yield page.heading(answer.source.name, answer.source.kind)
    yield page.facts(_demand(answer))
    yield page.table(columns, rows)
    yield page.field_table(answer.given.points)
    yield force_table(answer.given)
    yield page.assumed(answer.given.assumptions)


def _demand(answer: LeastPower) -> Iterator[tuple[str, str]]:
    units = {"force": "mN", "torque": "mN m", "field": "mT"}
    for name, values in answer.asked.items():
        if name == "direction":
            yield name, f"B along ({', '.join(page.cells(values, '.4g'))})"
            continue
        parts = ", ".join("free" if np.isnan(value) else f"{1e3 * value:.5g}" for value in values)
        yield name, f"({parts}) {units[name]} at {page.place(answer.given.points[0].at)} mm"
    none = "none; --limit sets one"
    yield "limit", none if answer.limit is None else f"{answer.limit:g} A in every coil"
    yield "power", f"least: the squares of the currents sum to {answer.sum_of_squares:.4g} A2"


def equilibrium(
    source: options.DeviceOrMapArgument,
    currents: options.Currents = None,
    height_mm: options.HeightMm = None,
    sensor_mm: Annotated[float | None, option("--sensor-mm", "MM")] = None,
    start: Annotated[str | None, option("--start", "X Y Z")] = None,
    orientation: Annotated[str | None, option("--orientation", "NAME")] = None,
    payload_of: options.PayloadOf = None,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    form: options.Form = "auto",
    json: options.Json = False,
) -> None:
    """Find where the payload floats and how stiffly, or the current that carries it at a height.

    --currents asks for the place where the payload floats. --height-mm or --sensor-mm asks for the current that lifts
    it there.

    Example: fieldmap equilibrium maps/out/workspace.h5 --sensor-mm 5

    Parameters
    ----------
    sensor_mm
        Height as a reading of the vertical sensor, mm downward.
    start
        Where the search begins, m.
    orientation
        fixed: the magnet keeps its direction; aligned: it follows the field. Unless given, aligned if the payload
        states turning = "free", fixed otherwise.
    """
    from fieldmap.io.answers import floating, lifted
    from fieldmap.lookup.payload import check_payload

    count = sum((bool(currents), height_mm is not None, sensor_mm is not None))
    must_hold = "must have exactly one of --currents, --height-mm and --sensor-mm"
    remedy = "--currents asks where the payload floats, the other two ask for the current that lifts it"
    check(count == 1, "equilibrium", must_hold, f"{count} of them", remedy)
    iron, settings = options.of_device(changes, mu_r, nonlinear, refinement, form)
    begin = None if start is None else arguments.parse_points([start], None)[0]
    with Progress("solving") as progress:
        found = options.find_named(source, iron, progress, settings)
        amperes = arguments.parse_currents(currents, found.coil_names) if currents else None
        payload = check_payload(options.payload_of_option(found, payload_of), "equilibrium", pieces=True)
        if amperes is not None:
            _check_search(found, payload, begin, orientation)
            answer = floating(found, payload, amperes, begin, orientation)
        else:
            height = _height(found, height_mm, sensor_mm, payload)
            answer = lifted(found, payload, height, _tell_state if nonlinear else None)
    page.print_result(answer, _equilibrium_page, json)


def _check_search(found: FieldSource, payload: Payload, start: Array | None, orientation: str | None) -> None:
    """Raise InputError, before anything is solved, for a start or an orientation that does not fit."""
    from fieldmap.io.answers import MOMENTS, require_box
    from fieldmap.levitation.places import check_centre

    if start is not None:
        check_centre(require_box(found), payload, start, "--start")
    given = orientation or "fixed"
    check(given in MOMENTS, "--orientation", "must be fixed or aligned", given, "choose one")


def _tell_state(current: float, share: float) -> None:
    print(f"{current:.4f} A per coil lifts {100 * share:.2f} % of the weight", file=sys.stderr)


def _height(found: FieldSource, height_mm: float | None, sensor_mm: float | None, payload: Payload) -> float:
    from fieldmap.device.measured import measured_on

    if height_mm is not None:
        return 1e-3 * height_mm
    machine, must_hold = (
        measured_on(found.device_name, len(found.coil_names)),
        "needs a machine with a measured sensor",
    )
    if machine is None:
        remedy = "give the height of the magnet's centre: --height-mm"
        raise InputError.of("--sensor-mm", must_hold, found.device_name or found.name, remedy)
    return machine.height(float(sensor_mm or 0.0), payload.magnet_offset)


def _equilibrium_page(answer: Levitation) -> Iterator[page.Section]:
    from fieldmap.levitation import LiftCurrent

    found = answer.found
    special = _lift_rows(answer, found) if isinstance(found, LiftCurrent) else _floating_rows(answer, found)
    stiffness = zip("xyz", page.without_noise(found.stiffness), strict=True)
    yield page.heading(answer.source.name, answer.source.kind)
    yield page.facts([*_common_rows(answer), *special])
    yield page.table(
        ("stiffness, N/m", "x", "y", "z"), ((axis, *page.cells(row, "+.4g")) for axis, row in stiffness)
    )
    if isinstance(found, LiftCurrent):
        yield _states_table(answer, found) if found.history else None
    else:
        yield page.table(("direction (x, y, z)", "stiffness N/m", "stable"), _directions(found))
    yield page.assumed(answer.assumptions)


def _common_rows(answer: Levitation) -> Iterator[tuple[str, str]]:
    payload, found = answer.payload, answer.found
    weight = f"{1e3 * payload.mass:.4g} g (weight {1e3 * payload.mass * GRAVITY:.4g} mN)"
    yield "payload", f"{weight}, {payload.description}"
    yield "currents", page.currents_text(answer.source.coil_names, found.currents)
    yield "magnet's centre", _to_a_micrometre(found.position)
    if answer.reading_mm is not None:
        offset = f"(magnet_offset {1e3 * payload.magnet_offset:g} mm)"
        yield "sensor reading", f"{answer.reading_mm:.3f} mm downward {offset}"
    yield "field there", f"({', '.join(page.cells(page.without_noise(found.field), '.4g', 1e3))}) mT"


def _to_a_micrometre(point: Array) -> str:
    return f"({', '.join(page.cells(point, '.3f', 1e3))}) mm"


def _floating_rows(answer: Levitation, found: Equilibrium) -> Iterator[tuple[str, str]]:
    report = found.report
    left = np.linalg.norm(found.force_residual) / (answer.payload.mass * GRAVITY)
    trace = found.trace / np.linalg.norm(found.stiffness)
    held = found.held.removeprefix("moment ")
    yield "moment", f"{held}, {found.angle_to_field:.2f} degrees from the field"
    yield "residual", f"{left:.1e} of the weight; {report.starts} starts, {report.evaluations} field points"
    yield "trace", f"{trace:.1e} of the stiffness (0 for a fixed dipole, below 0 for an aligned one)"
    for point in found.others:
        yield "also at", _to_a_micrometre(point)


def _lift_rows(answer: Levitation, found: LiftCurrent) -> Iterator[tuple[str, str]]:
    sideways = ", ".join(page.cells(page.without_noise(found.force)[:2], ".3g", 1e3))
    each = " in every coil" if len(answer.source.coil_names) > 1 else ""
    yield "moment", found.held.removeprefix("moment ")
    yield "lift current", f"{found.current:.4f} A{each}"
    machine, measured, limit = answer.machine, answer.measured_current, answer.current_limit
    if machine is not None and measured is not None:
        ratio = f"this model needs {found.current / measured:.2f} times as much"
        yield "measured", f"{measured:.4f} A{each}, {machine.lift_source}; {ratio}"
    if limit is not None and abs(found.current) > limit:
        yield "driver", f"gives at most {limit:g} A per coil, less than this"
    yield "dF/di", f"{1e3 * found.force_per_ampere[2]:.4g} mN upward per ampere{each}"
    yield "left over", f"sideways force ({sideways}) mN"


def _states_table(answer: Levitation, found: LiftCurrent) -> Table:
    """The states on the way to the lift current."""
    weight = answer.payload.mass * GRAVITY
    rows = (
        (f"{current:.4f}", *page.cells((lift, lift / current), ".3f", 1e3), f"{100 * lift / weight:.2f} %")
        for current, lift in found.history
    )
    return page.table(("A per coil, states solved", "lift mN", "mN per A", "of the weight"), rows)


def _directions(found: Equilibrium) -> Iterator[tuple[str, ...]]:
    for direction, value, stable in zip(found.directions.T, found.eigenvalues, found.stable, strict=True):
        components = ", ".join(page.cells(page.without_noise(direction), "+.3f"))
        yield f"({components})", f"{value:+.4g}", "yes" if stable else "no"

"""`fieldmap equilibrium`: where the payload floats, or the current that carries it at a height."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from fieldmap.cli.opening import Source


def equilibrium(
    source: Annotated[str, typer.Argument(metavar="MAP_OR_DEVICE", help="Map file, or device file or name.")],
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all: where does it float?"
        ),
    ] = None,
    height_mm: Annotated[
        float | None,
        typer.Option(
            "--height-mm", help="z of the magnet's centre (negative: below): what current lifts it?"
        ),
    ] = None,
    sensor_mm: Annotated[
        float | None,
        typer.Option("--sensor-mm", help="The same, by the thesis's sensor reading, mm downward."),
    ] = None,
    start: Annotated[
        str | None, typer.Option("--start", metavar="X Y Z", help="Where to begin the search, m.")
    ] = None,
    moment: Annotated[
        str, typer.Option("--moment", help="fixed: stays vertical; aligned: follows the field.")
    ] = "fixed",
    payload_of: Annotated[
        str | None, typer.Option("--payload-of", metavar="DEVICE", help="Take the payload from this device.")
    ] = None,
    mu_r: Annotated[
        float | None, typer.Option("--mu-r", help="Relative permeability of the iron; for a device only.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Find where the payload floats and how stiffly, or the current that carries it at a height."""
    from fieldmap.cli.numbers import parse_currents, parse_points
    from fieldmap.cli.opening import find_source, open_device
    from fieldmap.cli.solve import check_mu_r
    from fieldmap.levitation.checks import check_payload

    _exactly_one(currents, height_mm, sensor_mm)
    check_mu_r(mu_r)
    begin = None if start is None else parse_points([start], [])[0]
    found = find_source(source, mu_r)
    amperes = parse_currents(currents, found.coil_names) if currents else None
    payload = found.payload if payload_of is None else open_device(payload_of).payload
    check_payload(payload, "equilibrium")
    field, assumptions = _searchable(found)
    if amperes is not None:
        answer = _balance(field, amperes, payload, begin, moment)
    else:
        answer = _lift(field, payload, height_mm, sensor_mm)
    answer = {"source": found.name, "kind": found.kind, "coil_names": found.coil_names} | answer
    answer["assumptions"] = (*answer["assumptions"], *assumptions)
    if json:
        from fieldmap.cli.printing import print_json

        print_json(answer)
    else:
        _print(answer)


def _exactly_one(*given: Any) -> None:
    from fieldmap.errors import InputError, Problem

    count = sum(bool(value) if isinstance(value, list) else value is not None for value in given)
    if count != 1:
        raise InputError(
            Problem(
                "equilibrium",
                "must have exactly one of --currents, --height-mm and --sensor-mm",
                f"{count} of them",
                "--currents asks where the payload floats, the other two ask for the current that lifts it",
            )
        )


def _searchable(found: Source) -> tuple[Any, tuple[str, ...]]:
    """The field in the box in which an equilibrium is looked for, and its assumptions."""
    from fieldmap.errors import InputError, Problem
    from fieldmap.levitation import DifferencedField

    if found.corners is None:
        remedy = "add a [workspace] table to the device file"
        raise InputError(Problem(found.name, "must have a [workspace] to search", "none", remedy))
    field, assumptions = found.open()
    return (field if found.kind == "map" else DifferencedField(field, *found.corners)), assumptions


def _balance(field: Any, currents: Any, payload: Any, start: Any, moment: str) -> dict[str, Any]:
    from fieldmap.levitation import find_equilibrium, sensor_reading

    found = find_equilibrium(field, currents, payload, start, moment)  # type: ignore[arg-type]
    return _common(payload, found) | {
        "sensor_mm": sensor_reading(found.position[2], payload.magnet_offset),
        "eigenvalues": found.eigenvalues,
        "directions": found.directions.T,
        "stable": found.stable,
        "trace": found.trace,
        "stable_axes": found.stable_axes,
        "moment": found.moment,
        "angle_to_field_deg": found.angle_to_field,
        "others": found.others,
        "force_residual": found.force_residual,
        "report": found.report,
        "assumptions": found.assumptions,
    }


def _lift(field: Any, payload: Any, height_mm: float | None, sensor_mm: float | None) -> dict[str, Any]:
    from fieldmap.levitation import lift_current, magnet_height, sensor_reading

    offset = payload.magnet_offset
    height = 1e-3 * height_mm if height_mm is not None else magnet_height(float(sensor_mm or 0.0), offset)
    lift = lift_current(field, payload, [0.0, 0.0, height])
    return _common(payload, lift) | {
        "sensor_mm": sensor_reading(height, offset),
        "lift_current": lift.current,
        "force": lift.force,
        "force_per_ampere": lift.force_per_ampere,
        "assumptions": lift.assumptions,
    }


def _common(payload: Any, found: Any) -> dict[str, Any]:
    from fieldmap.levitation import GRAVITY

    return {
        "position": found.position,
        "currents": found.currents,
        "mass": payload.mass,
        "weight": payload.mass * GRAVITY,
        "moment_magnitude": payload.moment,
        "magnet_offset": payload.magnet_offset,
        "field": found.field,
        "stiffness": found.stiffness,
    }


def _print(answer: dict[str, Any]) -> None:
    from fieldmap.cli.printing import assumption_lines, facts, heading, print_page, table

    special = _lift_rows(answer) if "lift_current" in answer else _balance_rows(answer)
    lines = [(axis, *(f"{k:+.4g}" for k in answer["stiffness"][i])) for i, axis in enumerate("xyz")]
    directions = None
    if "stable" in answer:
        directions = table(("direction (x, y, z)", "stiffness N/m", "stable"), _directions(answer))
    print_page(
        heading(answer["source"], answer["kind"]),
        facts(_common_rows(answer) + special),
        table(("stiffness, N/m", "x", "y", "z"), lines),
        directions,
        facts(assumption_lines(answer["assumptions"])),
    )


def _common_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    from fieldmap.cli.fields import currents_text
    from fieldmap.cli.printing import millimetres

    mass, weight, moment = 1e3 * answer["mass"], 1e3 * answer["weight"], answer["moment_magnitude"]
    offset = 1e3 * answer["magnet_offset"]
    return [
        ("payload", f"{mass:.4g} g (weight {weight:.4g} mN), moment {moment:.4g} A m2"),
        ("currents", currents_text(answer["coil_names"], answer["currents"])),
        ("magnet's centre", millimetres(answer["position"])),
        (
            "sensor reading",
            f"{answer['sensor_mm']:.3f} mm in the thesis's frame (magnet_offset {offset:g} mm)",
        ),
        ("field there", "(" + ", ".join(f"{1e3 * value:.4g}" for value in answer["field"]) + ") mT"),
    ]


def _balance_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    import numpy as np

    from fieldmap.cli.printing import millimetres

    report, stiffness = answer["report"], np.linalg.norm(answer["stiffness"])
    turned = "up" if answer["moment"][2] > 0 else "down"
    left = np.linalg.norm(answer["force_residual"]) / answer["weight"]
    rows = [
        ("moment", f"{turned}, {answer['angle_to_field_deg']:.2f} degrees from the field"),
        ("residual", f"{left:.1e} of the weight; {report.starts} starts, {report.evaluations} field points"),
        (
            "trace",
            f"{answer['trace'] / stiffness:.1e} of the stiffness (0 for a fixed dipole, below 0 for an aligned one)",
        ),
    ]
    return rows + [("also at", millimetres(point)) for point in answer["others"]]


def _lift_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    sideways = ", ".join(f"{1e3 * value:.3g}" for value in answer["force"][:2])
    return [
        ("lift current", f"{answer['lift_current']:.4f} A in every coil"),
        ("left over", f"sideways force ({sideways}) mN"),
    ]


def _directions(answer: dict[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            "(" + ", ".join(f"{component + 0.0:+.3f}" for component in direction) + ")",
            f"{value:+.4g}",
            "yes" if stable else "no",
        )
        for direction, value, stable in zip(
            answer["directions"], answer["eigenvalues"], answer["stable"], strict=True
        )
    ]

"""`fieldmap equilibrium`: where the payload floats, or the current that carries it at a height."""

from typing import Annotated, Any

import typer


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
    from fieldmap.cli.opening import open_device, open_field
    from fieldmap.cli.solve import check_mu_r

    _exactly_one(currents, height_mm, sensor_mm)
    check_mu_r(mu_r)
    opened = open_field(source, mu_r)
    payload = opened.payload if payload_of is None else open_device(payload_of).payload
    field = _searchable(opened)
    if currents:
        answer = _balance(field, currents, payload, start, moment)
    else:
        answer = _lift(field, payload, height_mm, sensor_mm)
    answer = {"source": opened.name, "kind": opened.kind, "coil_names": field.coil_names} | answer
    answer["assumptions"] = (*answer["assumptions"], *opened.assumptions)
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


def _searchable(opened: Any) -> Any:
    """The field in the box in which an equilibrium is looked for."""
    from fieldmap.errors import InputError, Problem
    from fieldmap.levitation import DifferencedField

    if opened.kind == "map":
        return opened.field
    if opened.corners is None:
        raise InputError(
            Problem(
                opened.name,
                "must have a [workspace] to search",
                "none",
                "add a [workspace] table to the device file",
            )
        )
    return DifferencedField(opened.field, *opened.corners)


def _balance(field: Any, currents: list[str], payload: Any, start: str | None, moment: str) -> dict[str, Any]:
    from fieldmap.cli.numbers import parse_currents, parse_points
    from fieldmap.levitation import find_equilibrium, sensor_reading

    begin = None if start is None else parse_points([start], [])[0]
    amperes = parse_currents(currents, field.coil_names)
    found = find_equilibrium(field, amperes, payload, begin, moment)  # type: ignore[arg-type]
    return _common(payload, found) | {
        "sensor_mm": sensor_reading(found.position[2], payload.magnet_offset),
        "eigenvalues": found.eigenvalues,
        "directions": found.directions.T,
        "stable": found.stable,
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
    from fieldmap.levitation.checks import check_payload

    offset = check_payload(payload, "equilibrium").magnet_offset
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
    from fieldmap.cli.fields import currents_text
    from fieldmap.cli.printing import assumption_lines, console, facts, heading, millimetres, table

    out = console()
    out.print(heading(answer["source"], answer["kind"]))
    rows = [
        (
            "payload",
            f"{1e3 * answer['mass']:.4g} g (weight {1e3 * answer['weight']:.4g} mN), "
            f"moment {answer['moment_magnitude']:.4g} A m2",
        ),
        ("currents", currents_text(answer["coil_names"], answer["currents"])),
        ("magnet's centre", millimetres(answer["position"])),
        (
            "sensor reading",
            f"{answer['sensor_mm']:.3f} mm (magnet_offset {1e3 * answer['magnet_offset']:g} mm)",
        ),
        ("field there", "(" + ", ".join(f"{1e3 * value:.4g}" for value in answer["field"]) + ") mT"),
    ]
    if "lift_current" in answer:
        rows += _lift_rows(answer)
    else:
        rows += _balance_rows(answer)
    out.print(facts(rows))
    lines = [(axis, *(f"{k:+.4g}" for k in answer["stiffness"][i])) for i, axis in enumerate("xyz")]
    out.print(table(("stiffness N/m", "x", "y", "z"), lines))
    if "stable" in answer:
        out.print(table(("direction (x, y, z)", "N/m", "stable"), _directions(answer)))
    out.print(assumption_lines(answer["assumptions"]))


def _balance_rows(answer: dict[str, Any]) -> list[tuple[str, str]]:
    import numpy as np

    from fieldmap.cli.printing import millimetres

    report = answer["report"]
    turned = "up" if answer["moment"][2] > 0 else "down"
    rows = [
        ("moment", f"{turned}, {answer['angle_to_field_deg']:.2f} degrees from the field"),
        (
            "residual",
            f"{np.linalg.norm(answer['force_residual']) / answer['weight']:.1e} of the weight; "
            f"{report.starts} starts, {report.evaluations} field evaluations",
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

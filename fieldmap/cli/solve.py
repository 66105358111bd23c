"""`fieldmap solve`: the field of a device with linear iron, beside the known values of its file."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from fieldmap.device.model import Device, Reference

AXES = {"x": 0, "y": 1, "z": 2}


def solve(
    device: Annotated[str, typer.Argument(help="Device file, or the name of a shipped device.")],
    mu_r: Annotated[
        float | None, typer.Option("--mu-r", help="Relative permeability of all iron; the file's otherwise.")
    ] = None,
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all; 1 A each otherwise."
        ),
    ] = None,
    at: Annotated[
        list[str] | None, typer.Option("--at", metavar="X Y Z", help="Point in m; may be repeated.")
    ] = None,
    at_mm: Annotated[
        list[str] | None, typer.Option("--at-mm", metavar="X Y Z", help="Point in mm; may be repeated.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Solve a device with linear iron; print the solver's report, the field, and the file's known values."""
    from fieldmap.cli.numbers import parse_currents, parse_points
    from fieldmap.cli.opening import open_device, solve_device

    machine = open_device(device)
    amperes = parse_currents(currents or ["1"], machine.coil_names) if machine.coils else None
    points = parse_points(at or [], at_mm or [])
    check_mu_r(mu_r)
    solution = solve_device(machine, mu_r)
    answer = {
        "device": machine.name,
        "title": machine.title,
        "report": dataclasses.asdict(solution.report),
        "currents": amperes,
        "points": _fields(solution, points, amperes),
        "references": compare(machine, solution, mu_r),
    }
    if json:
        from fieldmap.cli.printing import print_json

        print_json(answer)
    else:
        _print(machine, answer)


def check_mu_r(mu_r: float | None) -> None:
    """A permeability that iron can have."""
    from fieldmap.errors import InputError, Problem

    if mu_r is not None and not 0.0 < mu_r < float("inf"):
        raise InputError(
            Problem("--mu-r", "must be a positive number", f"{mu_r}", "give the relative permeability")
        )


def _fields(solution: Any, points: Any, currents: Any) -> list[dict[str, Any]]:
    if not len(points):
        return []
    b, g = solution.field(points, currents), solution.gradient(points, currents)
    return [
        {"at": point, "B": field, "gradient": gradient}
        for point, field, gradient in zip(points, b, g, strict=True)
    ]


def component(quantity: str, field: Any, gradient: Any) -> float:
    """One entry of B (3,) or of its gradient (3, 3) by name: "Bz", "dBz/dx"."""
    if "/" not in quantity:
        return float(field[AXES[quantity[1]]])
    return float(gradient[AXES[quantity[2]], AXES[quantity[5]]])


def compare(device: Device, solution: Any, mu_r: float | None) -> list[dict[str, Any]]:
    """Every known value of the device's file beside ours; `ours` is None where it holds for another mu_r."""
    rows = []
    for reference in device.references:
        ours = None
        if reference.mu_r is None or abs(reference.mu_r - _mu_r(device, mu_r)) <= 1e-9 * reference.mu_r:
            point = reference.at[None, :]
            b = solution.field(point, reference.currents)[0]
            ours = component(reference.quantity, b, solution.gradient(point, reference.currents)[0])
        rows.append(_row(reference, ours))
    return rows


def _row(reference: Reference, ours: float | None) -> dict[str, Any]:
    deviation = None if ours is None else ours / reference.value - 1.0
    return {
        "quantity": reference.quantity,
        "at": reference.at,
        "currents": reference.currents,
        "mu_r": reference.mu_r,
        "reference": reference.value,
        "ours": ours,
        "deviation": deviation,
        "tolerance": reference.tolerance,
        "source": reference.source,
    }


def _mu_r(device: Device, mu_r: float | None) -> float:
    """The one relative permeability of the solve; NaN if the bodies differ, which equals no reference."""
    from fieldmap.device.model import BHTable, LinearMaterial

    if mu_r is not None:
        return mu_r
    values = set()
    for body in device.bodies:
        material = device.materials[body.material]
        if isinstance(material, LinearMaterial):
            values.add(material.mu_r)
        elif isinstance(material, BHTable):
            values.add(material.initial_mu_r)
    return values.pop() if len(values) == 1 else float("nan")


def _print(device: Device, answer: dict[str, Any]) -> None:
    from fieldmap.cli.fields import field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading, print_page

    report = dict(answer["report"])
    assumptions = assumption_lines(report.pop("assumptions"))
    numbers = [(name.replace("_", " "), _shown(name, value)) for name, value in report.items()]
    print_page(
        heading(device.name, device.title),
        facts(numbers + assumptions),
        field_table(answer["points"], device.coil_names, answer["currents"]) if answer["points"] else None,
        _reference_table(answer["references"]) if answer["references"] else None,
    )


def _shown(name: str, value: Any) -> str:
    if name == "seconds" and isinstance(value, dict):
        steps = ", ".join(f"{step} {seconds:.1f}" for step, seconds in value.items())
        return f"{sum(value.values()):.1f}: {steps}"
    if name.endswith("bytes"):
        return f"{value:,}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _reference_table(rows: list[dict[str, Any]]) -> Any:
    from rich.console import Group
    from rich.text import Text

    from fieldmap.cli.printing import millimetres, table

    def cells(row: dict[str, Any]) -> tuple[str, ...]:
        unit = "T/m" if "/" in row["quantity"] else "T"
        if row["ours"] is None:
            verdict = ("", f"needs --mu-r {row['mu_r']:g}", "")
        else:
            known = "" if row["tolerance"] is None else f"{100 * row['tolerance']:.2g} %"
            verdict = (f"{row['ours']:.6g}", f"{100 * row['deviation']:+.3f} %", known)
        return (row["quantity"], millimetres(row["at"]), f"{row['reference']:.6g} {unit}", *verdict)

    columns = ("known value", "at", "reference", "ours", "deviation", "known to")
    sources = dict.fromkeys(row["source"] for row in rows)
    notes = (Text(f" source: {source}", style="dim") for source in sources)
    return Group(table(columns, (cells(row) for row in rows), left=2), *notes)

"""`fieldmap solve`: the field of a device, linear or at given currents, beside the known values of its file."""

import dataclasses
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldmap.cli.options import At, AtMm, DeviceArgument, Form, Json, MuR, Nonlinear, Refinement

if TYPE_CHECKING:
    from fieldmap.device.model import Device


def solve(
    device: DeviceArgument,
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents", metavar="A[,A...]", help="One per coil, or one for all; linear iron: 1 A otherwise."
        ),
    ] = None,
    at: At = None,
    at_mm: AtMm = None,
    mu_r: MuR = None,
    nonlinear: Nonlinear = False,
    refinement: Refinement = 1.0,
    form: Form = "auto",
    json: Json = False,
) -> None:
    """Solve a device: the solver's report, the field at points, and the file's known values beside ours.

    Linear iron unless --nonlinear is given; then also the flux density in every body.
    """
    from fieldmap.cli.iron import checked_choice, require_currents, require_iron
    from fieldmap.cli.numbers import parse_currents, parse_points
    from fieldmap.cli.opening import open_device

    choice = checked_choice(mu_r, nonlinear, refinement, form)
    require_currents(nonlinear, currents)
    machine = open_device(device)
    if nonlinear:
        require_iron(machine)
    amperes = parse_currents(currents or ["1"], machine.coil_names) if machine.coils else None
    answer = _answer(machine, choice, amperes, parse_points(at or [], at_mm or []))
    if json:
        from fieldmap.cli.printing import print_json

        print_json(answer | {"report": dataclasses.asdict(answer["report"])})
    else:
        _print(machine, answer)


def _answer(machine: "Device", choice: Any, currents: Any, points: Any) -> dict[str, Any]:
    from fieldmap.cli.iron import States, solve_device
    from fieldmap.cli.references import compare
    from fieldmap.cli.report_text import body_rows
    from fieldmap.levitation import FixedCurrents

    solution = States(machine, choice)(currents) if choice.nonlinear else solve_device(machine, choice)
    field = FixedCurrents(solution) if choice.nonlinear else solution
    return {
        "device": machine.name,
        "title": machine.title,
        "nonlinear": choice.nonlinear,
        "coil_names": machine.coil_names,
        "report": solution.report,
        "currents": currents,
        "points": _fields(field, points, currents),
        "bodies": body_rows(solution) if choice.nonlinear else [],
        "references": compare(machine, field, choice, currents),
    }


def _fields(field: Any, points: Any, currents: Any) -> list[dict[str, Any]]:
    if not len(points):
        return []
    b, g = field.field(points, currents), field.gradient(points, currents)
    return [
        {"at": point, "B": flux_density, "gradient": gradient}
        for point, flux_density, gradient in zip(points, b, g, strict=True)
    ]


def _print(device: "Device", answer: dict[str, Any]) -> None:
    from fieldmap.cli.fields import currents_text, field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading, print_page
    from fieldmap.cli.references import reference_table
    from fieldmap.cli.report_text import body_table, report_rows

    report, nonlinear = answer["report"], answer["nonlinear"]
    rows = list(report_rows(report, device, nonlinear))
    if nonlinear:
        rows.insert(0, ("currents", currents_text(device.coil_names, answer["currents"])))
    points, bodies, references = answer["points"], answer["bodies"], answer["references"]
    print_page(
        heading(device.name, device.title),
        facts([*rows, *assumption_lines(report.assumptions)]),
        body_table(bodies) if bodies else None,
        field_table(points, device.coil_names, answer["currents"]) if points else None,
        reference_table(references) if references else None,
    )

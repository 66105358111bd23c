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
    tolerance: Annotated[
        float | None,
        typer.Option(
            "--tolerance",
            metavar="NUMBER",
            help="Refine until the estimated error of B in the workspace is below this (linear iron).",
            rich_help_panel="Iron (of a device)",
        ),
    ] = None,
    force: Annotated[
        list[str] | None,
        typer.Option(
            "--force",
            metavar="NAME[,NAME...]",
            help="Force and torque on a body or coil, or on several together; may be repeated.",
        ),
    ] = None,
    section: Annotated[
        list[str] | None,
        typer.Option("--section", metavar="NAME", help="Only this section of the file; may be repeated."),
    ] = None,
    json: Json = False,
) -> None:
    """Solve a device: the solver's report, the field at points, and the file's known values beside ours.

    Linear iron unless --nonlinear is given; then also the flux density in every body. Sections of the device file
    are printed with their mean flux density.
    """
    from fieldmap.cli.arguments import parse_currents, parse_points
    from fieldmap.cli.iron import checked_choice, require_currents, require_iron
    from fieldmap.cli.opening import open_device
    from fieldmap.cli.quantities import checked_groups, checked_sections

    choice = checked_choice(mu_r, nonlinear, refinement, form, tolerance)
    require_currents(nonlinear, currents)
    machine = open_device(device)
    wanted = (checked_groups(machine, force), checked_sections(machine, section))
    if nonlinear:
        require_iron(machine)
    amperes = parse_currents(currents or ["1"], machine.coil_names) if machine.coils else None
    answer = _answer(machine, choice, amperes, parse_points(at or [], at_mm or []), wanted)
    if json:
        from fieldmap.cli.printing import print_json

        print_json(answer | {"report": dataclasses.asdict(answer["report"])})
    else:
        _print(machine, answer)


def _answer(machine: "Device", choice: Any, currents: Any, points: Any, wanted: Any) -> dict[str, Any]:
    from fieldmap.cli.assumptions import beyond_saturation_warnings
    from fieldmap.cli.iron import States, solve_device
    from fieldmap.cli.quantities import force_rows, section_rows
    from fieldmap.cli.references import compare
    from fieldmap.cli.report_text import body_rows
    from fieldmap.field import as_field

    solution = States(machine, choice)(currents) if choice.nonlinear else solve_device(machine, choice)
    field = as_field(solution) if choice.nonlinear else solution
    groups, sections = wanted
    at = None if choice.nonlinear else (() if currents is None else currents)
    return {
        "device": machine.name,
        "title": machine.title,
        "nonlinear": choice.nonlinear,
        "coil_names": machine.coil_names,
        "report": solution.report,
        "currents": currents,
        "points": _fields(field, points, currents),
        "bodies": body_rows(solution) if choice.nonlinear else [],
        "forces": force_rows(solution, groups, at),
        "sections": section_rows(solution, sections, at),
        "references": compare(machine, field, choice, currents),
        "warnings": ()
        if choice.nonlinear or currents is None
        else beyond_saturation_warnings(solution, machine, currents),
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
    from fieldmap.cli.quantities import force_table, section_table
    from fieldmap.cli.references import reference_table
    from fieldmap.cli.report_text import body_table, report_rows

    report, nonlinear = answer["report"], answer["nonlinear"]
    rows = list(report_rows(report, device, nonlinear))
    if nonlinear:
        rows.insert(0, ("currents", currents_text(device.coil_names, answer["currents"])))
    points, bodies, references = answer["points"], answer["bodies"], answer["references"]
    print_page(
        heading(device.name, device.title),
        facts([*rows, *assumption_lines((*report.assumptions, *answer["warnings"]))]),
        body_table(bodies) if bodies else None,
        section_table(answer["sections"]) if answer["sections"] else None,
        force_table(answer["forces"]) if answer["forces"] else None,
        field_table(points, device.coil_names, answer["currents"]) if points else None,
        reference_table(references) if references else None,
    )

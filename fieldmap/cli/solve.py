"""`fieldmap solve`: the field of a device, linear or at given currents, beside the known values of its file."""

from typing import TYPE_CHECKING, Annotated

import typer

from fieldmap.cli.options import (
    At,
    AtMm,
    Changes,
    DeviceArgument,
    Form,
    Json,
    MuR,
    Nonlinear,
    Refinement,
    changes_of_device,
    checked_iron,
    require_currents,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import RenderableType
    from rich.table import Table

    from fieldmap.cli.printing import Section
    from fieldmap.iron.summary import DesignFigures, ReferenceComparison, SolutionSummary


def solve(
    device: DeviceArgument,
    currents: Annotated[
        list[str] | None,
        typer.Option(
            "--currents",
            metavar="A[,A...]",
            help="One per coil, one for all, or NAME=A. Default for linear iron: 1 A.",
        ),
    ] = None,
    at: At = None,
    at_mm: AtMm = None,
    changes: Changes = None,
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
    design: Annotated[
        bool,
        typer.Option(
            "--design",
            help="Windings (power, current density, time constant), inductances, forces on all coils and iron.",
        ),
    ] = False,
    thermal_resistance: Annotated[
        float | None,
        typer.Option(
            "--thermal-resistance",
            metavar="K/W",
            help="Of each winding to its surroundings, for the rise of its temperature; with --design.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Solve a device: the solver's report, the field at points, and the file's known values beside ours.

    Iron is linear unless --nonlinear is given, which also prints the flux density in every body. Sections of the
    device file are printed with their mean flux density. --design prints what a designer asks of the machine.
    """
    from fieldmap.cli.arguments import parse_currents, parse_points
    from fieldmap.cli.printing import print_result
    from fieldmap.errors import InputError, Problem
    from fieldmap.io import named_device, solve_device
    from fieldmap.iron.materials import require_soft_bodies
    from fieldmap.iron.summary import checked_groups, named_sections, summarise_solution
    from fieldmap.progress import Progress

    options = checked_iron(mu_r, nonlinear, refinement, form, tolerance)
    require_currents(nonlinear, currents)
    machine = named_device(device, changes_of_device(changes))
    if nonlinear:
        require_soft_bodies(machine)
    points = parse_points(at or [], at_mm or [])
    amperes = parse_currents(currents or ["1"], machine.coil_names) if machine.coils else None
    if thermal_resistance is not None and not design:
        must = "must come with --design"
        raise InputError(Problem("--thermal-resistance", must, "without", "add --design, or leave it out"))
    if design and amperes is None:
        raise InputError(Problem("--design", "must be a device with coils", device, "leave it out"))
    groups = [[name.strip() for name in text.split(",") if name.strip()] for text in force or []]
    checked_groups(machine, groups, "--force")
    sections = named_sections(machine, section, "--section") if section else None
    with Progress("solving", compiles=True) as progress:
        solved = solve_device(machine, options, progress)
        if design:
            assert amperes is not None
            from fieldmap.iron.summary import design_figures

            figures = design_figures(machine, amperes, solved, thermal_resistance)
            print_result(figures, _design_page, json)
            return
        summary = summarise_solution(machine, solved, amperes, points, groups, sections, mu_r)
    print_result(summary, _page, json)


def _page(summary: "SolutionSummary") -> "Iterator[Section]":
    from fieldmap.cli.fields import currents_text, field_table
    from fieldmap.cli.printing import assumption_lines, facts, heading

    device, names = summary.device, summary.device.coil_names
    currents = () if summary.currents is None else summary.currents
    rows = list(_report(summary))
    if summary.nonlinear:
        rows.insert(0, ("currents", currents_text(names, currents)))
    yield heading(device.name, device.title)
    yield facts([*rows, *assumption_lines((*summary.report.assumptions, *summary.warnings))])
    yield _body_table(summary) if summary.bodies else None
    yield _section_table(summary) if summary.sections else None
    yield _force_table(summary) if summary.forces else None
    yield field_table(summary.points, names, currents) if summary.points else None
    yield _reference_table(summary) if summary.references else None


def _design_page(figures: "DesignFigures") -> "Iterator[Section]":
    from fieldmap.cli.printing import assumption_lines, facts, heading, table, without_noise

    yield heading(figures.device, f"{figures.power:.4g} W in all windings")
    rows = (
        (
            one.coil,
            f"{one.current:.4g}",
            f"{one.resistance:.4g}" + ("" if one.resistance_is_stated else " (copper)"),
            f"{one.power:.4g}",
            f"{1e-6 * one.current_density:.3g}",
            f"{1e3 * one.inductance:.4g}",
            f"{1e3 * one.time_constant:.4g}",
            "-" if one.temperature_rise is None else f"{one.temperature_rise:.4g}",
        )
        for one in figures.windings
    )
    yield table(("winding", "A", "ohm", "W", "A/mm2", "dL/di mH", "L/R ms", "rise K"), rows)
    names = [one.coil for one in figures.windings]
    matrix = (
        (name, *(f"{1e3 * value:.4g}" for value in row))
        for name, row in zip(names, without_noise(figures.inductance), strict=True)
    )
    yield table(("mH", *names), matrix)
    groups = (*figures.coil_forces, *figures.iron_forces)
    largest = max((float(abs(group.force).max()) for group in groups), default=0.0)
    forces = (
        (", ".join(group.names), *(f"{value:.4g}" for value in without_noise(group.force, beside=largest)))
        for group in groups
    )
    yield table(("force on", "Fx N", "Fy N", "Fz N"), forces)
    bodies = (
        (body.body, f"{body.mean_magnitude:.3f}", f"{body.largest_magnitude:.3f}") for body in figures.bodies
    )
    yield table(("in the iron, T", "mean |B|", "largest |B|"), bodies) if figures.bodies else None
    yield facts(assumption_lines(figures.assumptions))


FORMS_IN_WORDS = {
    "potential": "second-order potential form",
    "flux": "second-order flux form",
    "surface": "surface form, no mesh of the volume",
    "coils": "none: coils alone",
}


def _report(summary: "SolutionSummary") -> "Iterator[tuple[str, str]]":
    from fieldmap.iron.notes import law_range
    from fieldmap.records import count_of

    report = summary.report
    words = FORMS_IN_WORDS.get(report.form, report.form)
    if report.form == "coils":
        yield "iron", words
        return
    yield "iron", f"{'nonlinear' if summary.nonlinear else 'linear'}, {words}"
    pieces = count_of(report.magnetic_bodies, "magnetic body", "magnetic bodies")
    sizes = f"{report.surface_faces:,} surface faces"
    if report.tetrahedra:
        sizes = f"{report.tetrahedra:,} tetrahedra, {sizes}"
    yield "mesh", f"{sizes}, {report.unknowns:,} unknowns, {pieces}"
    yield "symmetry", report.symmetry
    steps = "Newton steps" if summary.nonlinear else "iterations"
    residual = f"a residual of {report.residual:.1e}{report.steps_text}"
    yield "solution", f"{report.iterations} {steps} to {residual}"
    if report.error is not None:
        yield "error", str(report.error)
    if report.refinement:
        meshes = (f"{100 * error:.2g} % at {faces:,}" for faces, error in report.refinement)
        yield "refinement", f"estimates of B: {', '.join(meshes)} surface faces"
    if report.tolerance is not None:
        yield "tolerance", str(report.tolerance)
    yield "matrix", f"{report.matrix_bytes / 1e6:,.0f} MB, {report.storage or 'none'}"
    seconds = ", ".join(f"{step} {seconds:.1f}" for step, seconds in report.seconds.items())
    yield "seconds", f"{report.total_seconds:.1f}: {seconds}"
    if summary.nonlinear:
        yield "B-H law", law_range(report, summary.device)


def _body_table(summary: "SolutionSummary") -> "Table":
    from fieldmap.cli.printing import table

    cells = (
        (
            body.body,
            f"{body.mean_magnitude:.3f}",
            f"{body.largest_magnitude:.3f}",
            *(f"{round(float(value), 3) + 0.0:.3f}" for value in body.mean),
        )
        for body in summary.bodies
    )
    return table(("in the iron, T", "mean |B|", "largest |B|", "mean Bx", "mean By", "mean Bz"), cells)


def _section_table(summary: "SolutionSummary") -> "Table":
    from fieldmap.cli.printing import table, without_noise

    # Beside 1 T across the section.
    cells = (
        (
            section.section,
            f"{section.flux_density:.5f}",
            f"{1e6 * float(without_noise(section.flux, beside=section.area)):.5g}",
            f"{1e6 * section.area:.5g}",
        )
        for section in summary.sections
    )
    return table(("section", "mean B along its normal, T", "flux uWb", "area mm2"), cells)


def _force_table(summary: "SolutionSummary") -> "Table":
    from fieldmap.cli.printing import table, without_noise

    largest = max((float(abs(group.force).max()) for group in summary.forces), default=0.0)
    cells = (
        (
            ", ".join(group.names),
            *(f"{1e3 * value:.5g}" for value in without_noise(group.force, beside=largest)),
            # Beside the largest force at a lever of 1 mm.
            *(f"{1e3 * value:.5g}" for value in without_noise(group.torque, beside=1e-3 * largest)),
        )
        for group in summary.forces
    )
    return table(("force on", "Fx mN", "Fy", "Fz", "torque Tx mN m", "Ty", "Tz"), cells)


def _reference_table(summary: "SolutionSummary") -> "RenderableType":
    """The known values that hold, ours, and their sources; of the others, how many and what they need."""
    from collections import Counter

    from rich.console import Group, RenderableType
    from rich.text import Text

    from fieldmap.cli.printing import table

    compared = [one for one in summary.references if one.ours is not None]
    parts: list[RenderableType] = []
    if compared:
        columns = ("known value", "at, mm", "reference", "ours", "deviation", "known to")
        parts.append(table(columns, (_reference(one) for one in compared), left=2))
        parts += [
            Text(f" source: {source}", style="dim") for source in dict.fromkeys(o.source for o in compared)
        ]
    for why_not, count in Counter(one.why_not for one in summary.references if one.why_not).items():
        values = "1 known value of the file holds" if count == 1 else f"{count} known values of the file hold"
        parts.append(Text(f" Not compared: {values} for {why_not}."))
    return Group(*parts)


def _reference(one: "ReferenceComparison") -> tuple[str, ...]:
    from fieldmap.cli.printing import place

    unit = "T/m" if "/" in one.quantity else "T"
    known = "" if one.tolerance is None else f"{100 * one.tolerance:.2g} %"
    ours = (f"{one.ours:.6g}", f"{100 * (one.deviation or 0.0):+.3f} %", known)
    return (one.quantity, place(one.at).removesuffix(" mm"), f"{one.reference:.6g} {unit}", *ours)

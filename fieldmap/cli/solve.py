"""`fieldmap solve`: the field of a device, linear or at given currents, and the known values of its file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from fieldmap.arguments import check
from fieldmap.cli import options, page
from fieldmap.cli.arguments import parse_currents, parse_points, parse_settings
from fieldmap.cli.options import option
from fieldmap.progress import Progress
from fieldmap.records import count_of

if TYPE_CHECKING:
    from fieldmap.iron.summary import BodyFlux, DesignFigures, ReferenceComparison, SolutionSummary


def solve(
    device: options.DeviceArgument,
    currents: options.Currents = None,
    at: options.At = None,
    at_mm: options.AtMm = None,
    changes: options.Changes = None,
    mu_r: options.MuR = None,
    nonlinear: options.Nonlinear = False,
    refinement: options.Refinement = 1.0,
    form: options.Form = "auto",
    tolerance: options.Tolerance = None,
    force: Annotated[list[str] | None, option("--force", "NAME[,NAME...]")] = None,
    section: Annotated[list[str] | None, option("--section", "NAME")] = None,
    design: Annotated[bool, typer.Option("--design")] = False,
    thermal_resistance: Annotated[float | None, option("--thermal-resistance", "K/W")] = None,
    json: options.Json = False,
) -> None:
    """Solve a device: the solver's report, the field at points, and the file's known values beside ours.

    Iron is linear unless --nonlinear is given, which also prints the flux density in every body. Without --currents
    every coil of a device with linear iron carries 1 A. Sections of the device file are printed with their mean flux
    density. --design prints the figures of a design.

    Example: fieldmap solve loop_and_sphere

    Parameters
    ----------
    force
        Force and torque on a body or coil, or on several together; may be repeated.
    section
        Only this section of the file; may be repeated.
    design
        Windings (power, current density, time constant), inductances, forces on all coils and iron.
    thermal_resistance
        Of each winding to its surroundings, for the rise of its temperature; with --design.
    """
    from fieldmap.io import named_device, solve_device
    from fieldmap.iron.materials import require_soft_bodies
    from fieldmap.iron.summary import checked_groups, design_figures, named_sections, summarise_solution

    iron = options.checked_iron(mu_r, nonlinear, refinement, form, tolerance)
    options.require_currents(nonlinear, currents)
    machine = named_device(device, parse_settings(changes))
    if nonlinear:
        require_soft_bodies(machine)
    points = parse_points(at, at_mm)
    amperes = parse_currents(currents or ["1"], machine.coil_names) if machine.coils else None
    without = design or thermal_resistance is None
    remedy = "add --design, or leave it out"
    check(without, "--thermal-resistance", "must come with --design", "without", remedy)
    of_coils = not design or amperes is not None
    check(of_coils, "--design", "must be a device with coils", device, "leave it out")
    groups = [[name.strip() for name in text.split(",") if name.strip()] for text in force or []]
    checked_groups(machine, groups, "--force")
    sections = named_sections(machine, section, "--section") if section else None
    with Progress("solving", compiles=True) as progress:
        solved = solve_device(machine, iron, progress)
        if design:
            assert amperes is not None
            page.print_result(
                design_figures(machine, amperes, solved, thermal_resistance), _design_page, json
            )
            return
        summary = summarise_solution(machine, solved, amperes, points, groups, sections, mu_r)
    page.print_result(summary, _page, json)


def _page(summary: SolutionSummary) -> Iterator[page.Section]:
    device, names = summary.device, summary.device.coil_names
    currents = () if summary.currents is None else summary.currents
    rows = list(_report(summary))
    if summary.nonlinear:
        rows.insert(0, ("currents", page.currents_text(names, currents)))
    yield page.heading(device.name, device.title)
    yield page.facts([*rows, *page.assumption_lines((*summary.report.assumptions, *summary.warnings))])
    if summary.bodies:
        yield _body_table(summary.bodies, ("mean Bx", "mean By", "mean Bz"))
    yield _section_table(summary) if summary.sections else None
    yield _force_table(summary) if summary.forces else None
    yield page.field_table(summary.points, names, currents) if summary.points else None
    yield _reference_table(summary) if summary.references else None


def _design_page(figures: DesignFigures) -> Iterator[page.Section]:
    yield page.heading(figures.device, f"{figures.power:.4g} W in all windings")
    rows = (
        (
            one.coil,
            f"{one.current:.4g}",
            f"{one.resistance:.4g}" + ("" if one.resistance_is_stated else " (copper)"),
            f"{one.power:.4g}",
            f"{1e-6 * one.current_density:.3g}",
            *page.cells((one.inductance, one.time_constant), ".4g", 1e3),
            *page.cells((one.temperature_rise,), ".4g"),
        )
        for one in figures.windings
    )
    yield page.table(("winding", "A", "ohm", "W", "A/mm2", "dL/di mH", "L/R ms", "rise K"), rows)
    names = [one.coil for one in figures.windings]
    matrix = zip(names, page.without_noise(figures.inductance), strict=True)
    yield page.table(("mH", *names), ((name, *page.cells(row, ".4g", 1e3)) for name, row in matrix))
    groups = (*figures.coil_forces, *figures.iron_forces)
    largest = max((float(abs(group.force).max()) for group in groups), default=0.0)
    forces = (
        (", ".join(group.names), *page.cells(page.without_noise(group.force, beside=largest), ".4g"))
        for group in groups
    )
    yield page.table(("force on", "Fx N", "Fy N", "Fz N"), forces)
    yield _body_table(figures.bodies) if figures.bodies else None
    yield page.assumed(figures.assumptions)


FORMS_IN_WORDS = {
    "potential": "second-order potential form",
    "flux": "second-order flux form",
    "surface": "surface form, no mesh of the volume",
    "coils": "none: coils alone",
}


def _report(summary: SolutionSummary) -> Iterator[tuple[str, str]]:
    from fieldmap.iron.notes import law_range

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
    yield (
        "solution",
        f"{report.iterations} {steps} to a residual of {report.residual:.1e}{report.steps_text}",
    )
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


def _body_table(bodies: Iterable[BodyFlux], components: tuple[str, ...] = ()) -> Table:
    """Flux density in each body, with the components of its mean if `components` gives their heads."""
    rows = (
        (
            body.body,
            *page.cells((body.mean_magnitude, body.largest_magnitude), ".3f"),
            *(page.cells(body.mean, ".3f") if components else ()),
        )
        for body in bodies
    )
    return page.table(("in the iron, T", "mean |B|", "largest |B|", *components), rows)


def _section_table(summary: SolutionSummary) -> Table:
    rows = (
        (
            section.section,
            f"{section.flux_density:.5f}",
            "" if section.error is None else f"{section.error / section.area:.1g}",
            # Rounding errors are relative to a flux density of 1 T across the section.
            *page.cells((page.without_noise(section.flux, beside=section.area), section.area), ".5g", 1e6),
        )
        for section in summary.sections
    )
    return page.table(("section", "mean B along its normal, T", "error T", "flux uWb", "area mm2"), rows)


def _force_table(summary: SolutionSummary) -> Table:
    largest = max((float(abs(group.force).max()) for group in summary.forces), default=0.0)
    rows = (
        (
            ", ".join(group.names),
            *page.cells(page.without_noise(group.force, beside=largest), ".5g", 1e3),
            # Rounding errors are relative to the torque of the largest force at a lever of 1 mm.
            *page.cells(page.without_noise(group.torque, beside=1e-3 * largest), ".5g", 1e3),
        )
        for group in summary.forces
    )
    return page.table(("force on", "Fx mN", "Fy", "Fz", "torque Tx mN m", "Ty", "Tz"), rows)


def _reference_table(summary: SolutionSummary) -> RenderableType:
    """The known values that apply, our values, and sources; and for the others their number and conditions."""
    compared = [one for one in summary.references if one.ours is not None]
    parts: list[RenderableType] = []
    if compared:
        columns = ("known value", "at, mm", "reference", "ours", "deviation", "known to")
        parts.append(page.table(columns, (_reference(one) for one in compared), left=2))
        sources = dict.fromkeys(one.source for one in compared)
        parts += [Text(f" source: {source}", style="dim") for source in sources]
    for why_not, count in Counter(one.why_not for one in summary.references if one.why_not).items():
        values = "1 known value of the file holds" if count == 1 else f"{count} known values of the file hold"
        parts.append(Text(f" Not compared: {values} for {why_not}."))
    return Group(*parts)


def _reference(one: ReferenceComparison) -> tuple[str, ...]:
    unit = "T/m" if "/" in one.quantity else "T"
    known = "" if one.tolerance is None else f"{100 * one.tolerance:.2g} %"
    ours = (f"{one.ours:.6g}", f"{100 * (one.deviation or 0.0):+.3f} %", known)
    return (one.quantity, page.place(one.at), f"{one.reference:.6g} {unit}", *ours)

"""A device with linear iron, solved for one ampere in every coil, and for its magnets and background."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldmap.arguments import raise_all
from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.bh_law import Magnetisation, straight_laws
from fieldmap.iron.elements.flux_form import FluxForm
from fieldmap.iron.elements.potential_form import ConvexForm, Magnetised, PotentialForm, linkage_and_coenergy
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.materials import BodyProperties, body_properties, device_notes
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import AssembledIron, assemble
from fieldmap.iron.operators.mutual import face_images
from fieldmap.iron.reaction import (
    TOLERANCE,
    DipoleAnswers,
    Image,
    ReactionFields,
    answers_to_sensors,
    reaction_fields,
)
from fieldmap.iron.report import Progress, SolverReport, Stages, report_of
from fieldmap.iron.sensitivity.adjoint import Origin
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.solvers.shared import SharedSolves, windings
from fieldmap.typing import Array, PathLike

_FORM_CLASSES: dict[str, type[PotentialForm] | type[FluxForm]] = {
    "potential": PotentialForm,
    "flux": FluxForm,
}
FORMS = ("auto", *_FORM_CLASSES, "surface")
"""The values of `form` in `solve_linear`."""
# The algebraic error is kept this far below the requested one.
_RESIDUAL_PER_TOLERANCE = 1e-4


def solve_linear(
    device: Device | PathLike,
    mu_r: float | None = None,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
    refinement: float = 1.0,
    form: str = "auto",
    symmetry: str = "auto",
) -> LinearSolution:
    """Solve a device with iron of constant permeability, once per coil, and once for the remanence of magnets and the
    background. Methods: docs/theory/iron_elements.md.

    Parameters
    ----------
    device
        The machine, its file, or the name of a shipped one.
    mu_r
        Relative permeability of all soft iron; None: the device's own, for a B-H table its initial slope.
    tolerance
        Bounds the algebraic error (the residual is 1e-4 of it). The mesh error is set by the mesh sizes of
        the device file and by `refinement`.
    progress
        progress(message, fraction) is called between steps.
    refinement
        Divides the mesh sizes.
    form
        "potential" (second order; every mu_r >= 1), "flux" (second order; any mu_r, flux barriers too), or
        "auto": potential where it may be used. Inductances of closed magnetic circuits err to opposite sides.
        "surface" needs no mesh of the volume and takes any mu_r; its dense matrices allow a few thousand faces.
    symmetry
        "auto" uses the mirror planes of the iron, "workspace" only planes that map the workspace onto itself,
        "none" does not look for them.

    Returns
    -------
    LinearSolution
        The fields per ampere of every coil, and the field of magnets and background.

    Raises
    ------
    GeometryError
        If bodies, windings and workspace do not fit together.
    InputError
        For bad arguments.
    NotConverged
        With the residual history.

    Examples
    --------
    >>> import fieldmap as fm
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"), mu_r=1000.0)
    >>> unit.report.magnetic_bodies, unit.report.residual < 1e-7
    (1, True)
    """
    device = read_device(device)
    check_arguments("solve_linear", tolerance, refinement, form)
    stages = Stages(progress)
    stages.next("checking the geometry", 0.0)
    check_geometry(device)
    return solve_linear_and_reaction(device, mu_r, tolerance, stages, refinement, form, symmetry)[0]


def solve_linear_and_reaction(
    device: Device,
    mu_r: float | None = None,
    tolerance: float = 1e-3,
    stages: Stages | None = None,
    refinement: float = 1.0,
    form: str = "auto",
    symmetry: str = "auto",
    box: tuple[Array, Array] | None = None,
    shared: SharedSolves | None = None,
) -> tuple[LinearSolution, ReactionFields | None, DipoleAnswers | None]:
    """`solve_linear`, and on the same mesh the iron's reaction to magnets in a box and its answers to the sensors.

    Parameters
    ----------
    device
        A device that passed `check_geometry`.
    mu_r, tolerance, refinement, form, symmetry
        As for `solve_linear`.
    stages
        Reports progress.
    box
        Lower and upper corner (3,) of the workspace, m, or None for no reaction.
    shared
        Results of solves of devices with the same iron, which this solve uses and adds to. The solution then has no
        field inside the iron.

    Returns
    -------
    tuple[LinearSolution, ReactionFields | None, DipoleAnswers | None]
        The solution; the reaction, None without a box; the answers, None without sensors. Both are None without iron
        and in the surface form.

    Raises
    ------
    GeometryError, InputError, NotConverged
        As `solve_linear`.
    """
    stages = stages or Stages(None)
    properties = body_properties(device, mu_r)
    origin = Origin(device, True, mu_r)
    if not device.bodies:
        stages.done()
        return replace(coils_alone(device, stages.seconds), origin=origin), None, None
    require_source(device, properties)
    form = chosen_form(form, properties)
    if form == "surface":
        from fieldmap.iron.solvers.surface import solve_by_surface

        by_surface = solve_by_surface(
            device, properties, tolerance * _RESIDUAL_PER_TOLERANCE, refinement, stages
        )
        return replace(by_surface, origin=origin), None, None
    stages.next("meshing the iron", 0.02)
    mesh = generate_mesh(device, refinement, symmetry)
    stages.next("mutual potentials of the faces", 0.1)
    once = shared or SharedSolves()
    iron = once.operator(mesh, "iron", lambda: assemble(mesh))
    stages.next("coil fields and solution", 0.5)
    problem = once.operator(mesh, form, lambda: form_on(iron, form))
    of_elements = properties.on(mesh)
    of_iron = (form, of_elements.mu_r, of_elements.remanence, tolerance)

    def solved_once() -> LinearSolution:
        found = solved_in_form(device, problem, properties, tolerance, stages)
        return found if shared is None else charges_alone(found)

    solved = once.solve((*of_iron, device.background, windings(device.coils)), solved_once)
    assert solved.state is not None  # there is iron
    notes = properties.assumptions + geometry_notes(device)
    report = report_of(problem, solved.state, stages.seconds, notes)
    about = (solved.has_remanence, report, solved.iron_linkage, device.sections, device.bounds)
    solution = LinearSolution(device.coils, solved.mesh, solved.state, *about, device.background, origin)
    reaction = None
    if box is not None:
        stages.next("reaction of the iron to magnets in the workspace", 0.9)
        reaction = once.solve(
            (*of_iron, box),
            lambda: reaction_fields(
                _magnetised(problem, properties), iron.surface, box, images=images_of(iron)
            ),
        )
    answers = None
    if device.sensors:
        answers = once.solve(
            (*of_iron, device.sensors),
            lambda: answers_to_sensors(_magnetised(problem, properties), iron.surface, device.sensors),
        )
    stages.done()
    return solution, reaction, answers


def charges_alone(solution: LinearSolution) -> LinearSolution:
    """The part of a solution that the field in the air needs, to save memory."""
    state = solution.state
    assert state is not None  # there is iron
    alone = IronState(
        state.faces, state.density, state.flux_density[:, :0], state.iterations, state.residuals
    )
    return replace(solution, mesh=None, state=alone)


def _magnetised(problem: ConvexForm, properties: BodyProperties) -> Magnetised:
    """The charge densities of this iron in given fields."""
    body = problem.iron.mesh.body
    laws = straight_laws(properties.on(problem.iron.mesh).mu_r)
    material = Magnetisation(body, laws, np.zeros((1, len(body), 3)))
    tangent = problem.tangent(np.zeros(problem.elements.count), problem.elements.no_field(), material)
    return problem.magnetised(tangent, material, TOLERANCE)


def images_of(iron: AssembledIron) -> list[Image]:
    """The operations that map iron without currents onto itself, but for the identity."""
    symmetry, topology = iron.mesh.symmetry, iron.topology
    if symmetry is None:
        return []
    faces = face_images(symmetry, topology.nodes[topology.surface])
    moves = zip(symmetry.group.operations, faces, strict=True)
    return [
        Image(one.matrix, one.offset, of) for one, of in moves if not np.array_equal(one.matrix, np.eye(3))
    ]


def form_on(iron: AssembledIron, form: str) -> ConvexForm:
    """The potential or the flux form on a mesh."""
    return _FORM_CLASSES[form](iron)


def solved_in_form(
    device: Device, problem: ConvexForm, properties: BodyProperties, tolerance: float, stages: Stages
) -> LinearSolution:
    """One form on one mesh."""
    elements, mesh, background = problem.elements, problem.iron.mesh, device.background
    of_elements, sources = properties.on(mesh), len(device.coils)
    has_remanence = bool(properties.remanence.any())
    field, remanence = elements.unit_fields(device.coils, mesh), np.zeros((sources, len(mesh.body), 3))
    if has_remanence or background is not None:
        # Magnets and background together are one more source, without a coil.
        constant = elements.no_field()
        if background is not None:
            constant = elements.coil_field(lambda x: background.field(x)[None])
        field = elements.joined(field, constant)
        remanence = np.concatenate([remanence, of_elements.remanence[mesh.body][None]])
    material = Magnetisation(mesh.body, straight_laws(of_elements.mu_r), remanence)
    solved = problem.solve_linear(material, field, tolerance * _RESIDUAL_PER_TOLERANCE)
    strength = elements.strength_at_points(solved.potential, field, material)
    coils = elements.coil_field_at_points(field)
    linkage, _ = linkage_and_coenergy(elements.volume, material, strength, coils, coils[:sources])
    assumptions = properties.assumptions + geometry_notes(device)
    report = report_of(problem, solved.iron, stages.seconds, assumptions)
    about = (device.sections, device.bounds, background)
    return LinearSolution(device.coils, mesh, solved.iron, has_remanence, report, linkage, *about)


def chosen_form(form: str, properties: BodyProperties) -> str:
    """The form; for "auto" the form chosen by the materials. Raises InputError where a form may not be used."""
    weakest = properties.weakest
    if form == "auto":
        return "potential" if weakest >= 1 else "flux"
    if form == "potential" and weakest < 1:
        must_hold = "the potential form needs mu_r >= 1 in every body and joint"
        remedy = 'use form="flux" or form="auto"'
        raise InputError.of("solve_linear, form", must_hold, f"mu_r = {weakest:g}", remedy)
    return form


def check_arguments(where: str, tolerance: float, refinement: float = 1.0, form: str = "auto") -> None:
    """Raise InputError for arguments of a solver out of their range."""
    wanted = (
        ("tolerance", tolerance, "must lie between 0 and 1", "try 1e-3", 0 < tolerance < 1),
        ("refinement", refinement, "must be a finite number > 0", "try 1.0", 0 < refinement < np.inf),
        ("form", form, f"must be one of {', '.join(FORMS)}", 'try "auto"', form in FORMS),
    )
    raise_all(
        Problem(f"{where}, {name}", must_hold, repr(value), remedy)
        for name, value, must_hold, remedy, right in wanted
        if not right
    )


def require_source(device: Device, properties: BodyProperties) -> None:
    """Raise InputError for iron that nothing magnetises: no coils, no permanent magnets, no background."""
    if not device.coils and not properties.remanence.any() and device.background is None:
        must_hold = (
            "must have a source of field: a coil, a body that is a permanent magnet, or a [background]"
        )
        raise InputError.of(f"device '{device.name}'", must_hold, "soft iron alone", "add a coil or a magnet")


def coils_alone(device: Device, seconds: dict[str, float]) -> LinearSolution:
    """The solution of a device without iron."""
    alone = "no iron: the field of the coils alone"
    none = (alone if device.background is None else f"{alone}, in a background", *device_notes(device))
    report = SolverReport("coils", 0, 0, 0, 0, 0, 0, 0.0, 0, seconds, none)
    about = (device.sections, device.bounds, device.background)
    return LinearSolution(device.coils, None, None, False, report, None, *about)

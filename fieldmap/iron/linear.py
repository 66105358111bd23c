"""The public door: a device with linear iron, solved for one ampere in every coil."""

import numpy as np
from numpy.typing import NDArray

from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.assembled import AssembledIron, assemble
from fieldmap.iron.bh_law import LawTables
from fieldmap.iron.flux_form import FluxForm
from fieldmap.iron.geometry_checks import check_geometry, geometry_notes
from fieldmap.iron.mesh import generate_mesh
from fieldmap.iron.nodal_elements import CoilField
from fieldmap.iron.permeability import BodyProperties, body_properties
from fieldmap.iron.potential_form import Magnetisation, PotentialForm
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.stages import Progress, Stages
from fieldmap.iron.state import IronState
from fieldmap.sources import unit_flux_density

Array = NDArray[np.float64]
FORMS = ("auto", "potential", "flux")
# The algebraic error is kept this far below the requested one.
_RESIDUAL_PER_TOLERANCE = 1e-4


def solve_linear(
    device: Device,
    mu_r: float | None = None,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
    refinement: float = 1.0,
    form: str = "auto",
) -> LinearSolution:
    """Solve a device with iron of constant permeability, once per coil (and once for its magnets' remanence).

    mu_r: relative permeability of all soft iron; None: the device file's own, for a B-H table its initial slope.
    tolerance: bounds the algebraic error (the residual is 1e-4 of it); the mesh error is set by the mesh sizes of
    the device file and by `refinement`, which divides them. progress(message, fraction) is called between steps.
    form: "potential" (second order; every mu_r >= 1), "flux" (lowest order; any mu_r, flux barriers too), or "auto":
    potential where it may be used. The two err to opposite sides in closed magnetic circuits. Methods:
    docs/theory/iron.md. Raises GeometryError if bodies, windings and workspace do not fit together, InputError for
    bad arguments, NotConverged with the residual history.

    >>> import fieldmap as fm
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"), mu_r=1000.0)
    >>> unit.report.magnetic_bodies, unit.report.residual < 1e-7
    (1, True)
    """
    _check_arguments(tolerance, refinement, form)
    stages = Stages(progress)
    stages.next("checking the geometry", 0.0)
    check_geometry(device)
    properties = body_properties(device, mu_r)
    if not device.bodies:
        stages.done()
        return _coils_alone(device, stages.seconds)
    form = _chosen_form(form, properties)
    stages.next("meshing the iron", 0.02)
    mesh = generate_mesh(device, refinement)
    stages.next("mutual potentials of the faces", 0.1)
    iron = assemble(mesh)
    stages.next("coil fields and solution", 0.5)
    solver = _solve_potential if form == "potential" else _solve_flux
    state, unknowns = solver(device, iron, properties, tolerance * _RESIDUAL_PER_TOLERANCE)
    stages.done()
    report = SolverReport(
        form=form,
        tetrahedra=len(mesh.tets),
        surface_faces=len(iron.surface.areas),
        charged_faces=len(state.faces.areas),
        unknowns=unknowns,
        magnetic_bodies=iron.magnetic_bodies,
        iterations=state.iterations,
        residual=state.residuals[-1],
        matrix_bytes=iron.mutual.bytes,
        seconds=stages.seconds,
        assumptions=properties.assumptions + geometry_notes(device),
    )
    return LinearSolution(device.coils, mesh, state, bool(properties.remanence.any()), report)


def _solve_flux(
    device: Device, iron: AssembledIron, properties: BodyProperties, tolerance: float
) -> tuple[IronState, int]:
    problem, body = FluxForm(iron), iron.mesh.body
    load = problem.elements.load(lambda x: np.stack([unit_flux_density(coil, x) for coil in device.coils]))
    remanence = properties.remanence[body] if properties.remanence.any() else None
    return problem.solve(properties.mu_r[body], load, remanence, tolerance), len(iron.topology.nodes)


def _solve_potential(
    device: Device, iron: AssembledIron, properties: BodyProperties, tolerance: float
) -> tuple[IronState, int]:
    problem, body = PotentialForm(iron), iron.mesh.body
    elements = problem.elements
    field = elements.coil_field(lambda x: np.stack([unit_flux_density(coil, x) for coil in device.coils]))
    remanence = np.zeros((len(field.bubble), len(body), 3))
    if properties.remanence.any():
        # The remanence is a source of its own, without any coil.
        field = CoilField(*(np.concatenate([part, 0 * part[:1]]) for part in (field.constant, field.bubble)))
        remanence = np.concatenate([remanence, properties.remanence[body][None]])
    material = Magnetisation(body, _straight_laws(properties.mu_r), remanence)
    return problem.solve_linear(material, field, tolerance).iron, elements.count


def _straight_laws(mu_r: Array) -> LawTables:
    """One straight law per body."""
    count = len(mu_r)
    coefficients = np.zeros((count, 4))
    coefficients[:, 2] = mu_r
    return LawTables(np.arange(count + 1), np.zeros(count), coefficients, np.full((2, count), np.inf))


def _chosen_form(form: str, properties: BodyProperties) -> str:
    weakest = float(properties.mu_r.min())
    if form == "auto":
        return "potential" if weakest >= 1 else "flux"
    if form == "potential" and weakest < 1:
        raise InputError(
            Problem(
                "solve_linear, form",
                "the potential form needs mu_r >= 1 in every body",
                f"mu_r = {weakest:g}",
                'use form="flux" or form="auto"',
            )
        )
    return form


def _check_arguments(tolerance: float, refinement: float, form: str) -> None:
    problems = []
    if not (np.isfinite(tolerance) and 0 < tolerance < 1):
        problems.append(
            Problem("solve_linear, tolerance", "must lie between 0 and 1", repr(tolerance), "try 1e-3")
        )
    if not (np.isfinite(refinement) and refinement > 0):
        problems.append(
            Problem("solve_linear, refinement", "must be a finite number > 0", repr(refinement), "try 1.0")
        )
    if form not in FORMS:
        problems.append(
            Problem("solve_linear, form", f"must be one of {', '.join(FORMS)}", repr(form), 'try "auto"')
        )
    if problems:
        raise InputError(*problems)


def _coils_alone(device: Device, seconds: dict[str, float]) -> LinearSolution:
    none = ("no iron: the field of the coils alone",)
    report = SolverReport("coils", 0, 0, 0, 0, 0, 0, 0.0, 0, seconds, none)
    return LinearSolution(device.coils, None, None, False, report)

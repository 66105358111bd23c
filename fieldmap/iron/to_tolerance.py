"""The public door to linear iron on a mesh that is refined until the estimated error is small enough."""

from dataclasses import replace

from fieldmap.device.model import Device
from fieldmap.errors import NotConverged, Problem
from fieldmap.iron.cad.geometry_checks import check_geometry
from fieldmap.iron.error_estimate import estimate_error, workspace_surface
from fieldmap.iron.forms.permeability import body_properties
from fieldmap.iron.linear import check_arguments, chosen_form, coils_alone, solved_in_form
from fieldmap.iron.meshing.mesh import generate_mesh
from fieldmap.iron.operators.assembled import assemble, fits_into_memory
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.stages import Progress, Stages

# Mesh sizes of the file are divided by these in turn; each step about doubles the number of faces.
_REFINEMENTS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)


def solve_to_tolerance(
    device: Device,
    tolerance: float = 1e-3,
    mu_r: float | None = None,
    progress: Progress | None = None,
    gradient_tolerance: float | None = None,
) -> LinearSolution:
    """Refine until the estimated error in the workspace is within the tolerance; `report.error` tells it.

    tolerance: of the flux density, relative to its largest value in the workspace for each coil;
    gradient_tolerance: of the gradient, 3 x tolerance if None. Meshes grow by a factor of about two in faces; the
    estimate compares the last two of them, and both forms on the last (`fieldmap.iron.error_estimate`). Raises
    NotConverged with the estimates so far when the next mesh would not fit into memory, otherwise as `solve_linear`.
    """
    check_arguments(tolerance, 1.0, "auto")
    check_geometry(device)
    points = workspace_surface(device)
    properties = body_properties(device, mu_r)
    if not device.bodies:
        return coils_alone(device, {})
    limit = 3 * tolerance if gradient_tolerance is None else gradient_tolerance
    stages, coarser, history = Stages(progress), None, []
    form = chosen_form("auto", properties)
    for level, refinement in enumerate(_REFINEMENTS):
        stages.next(f"refinement {refinement:g}", level / len(_REFINEMENTS))
        mesh = generate_mesh(device, refinement)
        if not fits_into_memory(mesh):
            break
        iron = assemble(mesh)
        solution = solved_in_form(device, iron, properties, tolerance, form, stages)
        if coarser is not None:
            other = "flux" if form == "potential" else ("potential" if properties.mu_r.min() >= 1 else None)
            complement = (
                None if other is None else solved_in_form(device, iron, properties, tolerance, other, stages)
            )
            error = estimate_error(points, solution, coarser, complement)
            history.append(error.flux_density)
            if error.flux_density <= tolerance and error.gradient <= limit:
                stages.done(str(error))
                return replace(solution, report=replace(solution.report, error=error))
        coarser = solution
    raise NotConverged(
        Problem(
            f"device '{device.name}'",
            f"the estimated error must fall to {tolerance:g} (gradient {limit:g}) on a mesh that fits into memory",
            ", ".join(f"{value:.2g}" for value in history) or "no estimate",
            "loosen the tolerance, or give the bodies that matter smaller mesh sizes and the others larger ones",
        ),
        residuals=tuple(history),
    )

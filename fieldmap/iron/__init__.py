"""Soft iron in the field of coils: mesh, volume integral equation, solution."""

from fieldmap.extras import needs

# Its modules need scipy throughout: where it is missing, this is told here for all of them.
with needs("make", "fieldmap.iron"):
    import scipy

    del scipy

from fieldmap.device.model import Section
from fieldmap.iron.beyond_saturation import BodyBeyondSaturation, bodies_beyond_saturation
from fieldmap.iron.design import DesignFigures, design_figures
from fieldmap.iron.error.tolerance import Tolerance, ToleranceReport
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.mesh.mesh import IronMesh, generate_mesh
from fieldmap.iron.quantities.sections import SectionFlux
from fieldmap.iron.report import SolverReport
from fieldmap.iron.sensitivity.derivatives import Derivatives, Spread
from fieldmap.iron.sensitivity.quantities import (
    DipoleForce,
    FieldFunction,
    FluxDensityAt,
    FluxLinkage,
    GradientAt,
    Quantity,
)
from fieldmap.iron.solution import LinearSolution, LinearState, NonlinearSolution, SolvedState
from fieldmap.iron.solvers.hysteresis import HysteresisSolver, HystereticState, IronMemory, Pinning
from fieldmap.iron.solvers.linear import solve_linear
from fieldmap.iron.solvers.nonlinear import NonlinearSolver, solve
from fieldmap.iron.solvers.to_tolerance import solve_to_tolerance

__all__ = [
    "BodyBeyondSaturation",
    "Derivatives",
    "DesignFigures",
    "DipoleForce",
    "FieldFunction",
    "FluxDensityAt",
    "FluxLinkage",
    "GradientAt",
    "HysteresisSolver",
    "HystereticState",
    "IronMemory",
    "IronMesh",
    "LinearSolution",
    "LinearState",
    "NonlinearSolution",
    "NonlinearSolver",
    "Pinning",
    "Quantity",
    "Section",
    "SectionFlux",
    "SolvedState",
    "SolverReport",
    "Spread",
    "Tolerance",
    "ToleranceReport",
    "bodies_beyond_saturation",
    "check_geometry",
    "design_figures",
    "generate_mesh",
    "geometry_notes",
    "solve",
    "solve_linear",
    "solve_to_tolerance",
]

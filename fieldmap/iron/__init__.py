"""Soft iron in the field of coils: mesh, volume integral equation, solution."""

from fieldmap.extras import needs

# All modules of this package need scipy. Without scipy, this import raises one error for all of them.
with needs("make", "fieldmap.iron"):
    import scipy

    del scipy

from fieldmap.device.model import Section
from fieldmap.iron.error import Tolerance, ToleranceReport
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.mesh.mesh import IronMesh, generate_mesh
from fieldmap.iron.notes import BodyBeyondSaturation, bodies_beyond_saturation
from fieldmap.iron.report import SolverReport
from fieldmap.iron.sections import SectionFlux
from fieldmap.iron.sensitivity.quantities import (
    Derivatives,
    DipoleForce,
    FieldFunction,
    FluxDensityAt,
    FluxLinkage,
    GradientAt,
    Quantity,
    Spread,
)
from fieldmap.iron.solution import LinearSolution, LinearState, NonlinearSolution, SolvedState
from fieldmap.iron.solvers.hysteresis import HysteresisSolver, HystereticState, IronMemory, Pinning
from fieldmap.iron.solvers.linear import solve_linear
from fieldmap.iron.solvers.nonlinear import NonlinearSolver, solve
from fieldmap.iron.solvers.to_tolerance import solve_to_tolerance
from fieldmap.iron.summary import DesignFigures, design_figures

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

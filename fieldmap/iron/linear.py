"""The public door: a device with linear iron, solved for one ampere in every coil."""

import time
from collections.abc import Callable

import numpy as np

from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.iron.geometry_checks import check_geometry, geometry_notes
from fieldmap.iron.mesh import generate_mesh
from fieldmap.iron.permeability import body_properties
from fieldmap.iron.problem import LinearProblem
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solution import LinearSolution
from fieldmap.sources import unit_flux_density

Progress = Callable[[str, float], None]
# The algebraic error is kept this far below the requested one.
_RESIDUAL_PER_TOLERANCE = 1e-4


class _Stages:
    """Tells progress and takes the time of each step."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._start = time.perf_counter()
        self._name = ""
        self.seconds: dict[str, float] = {}

    def next(self, name: str, fraction: float) -> None:
        """End the current step and begin another."""
        now = time.perf_counter()
        if self._name:
            self.seconds[self._name] = now - self._start
        self._start, self._name = now, name
        if self._progress is not None:
            self._progress(name or "solved", fraction)


def solve_linear(
    device: Device,
    mu_r: float | None = None,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
    refinement: float = 1.0,
) -> LinearSolution:
    """Solve a device with iron of constant permeability, once per coil (and once for its magnets' remanence).

    mu_r: relative permeability of all soft iron; None: the device file's own, for a B-H table its initial slope.
    tolerance: bounds the algebraic error (GMRES stops at 1e-4 of it); the mesh error is set by the mesh sizes of
    the device file and by `refinement`, which divides them. progress(message, fraction) is called between steps.
    Method: facet volume integral, see docs/theory/iron.md. Raises GeometryError if bodies, windings and workspace do
    not fit together, InputError for bad arguments, NotConverged with the residual history.

    >>> import fieldmap as fm                                                    # doctest: +SKIP
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"))                # doctest: +SKIP
    """
    _check_arguments(tolerance, refinement)
    stages = _Stages(progress)
    stages.next("checking the geometry", 0.0)
    check_geometry(device)
    properties = body_properties(device, mu_r)
    if not device.bodies:
        stages.next("", 1.0)
        return _coils_alone(device, stages.seconds)
    stages.next("meshing the iron", 0.02)
    mesh = generate_mesh(device, refinement)
    stages.next("assembling the mutual potentials", 0.1)
    problem = LinearProblem(mesh)
    stages.next("field of the coils in the iron", 0.35)
    load = problem.elements.load(
        lambda points: np.stack([unit_flux_density(c, points) for c in device.coils])
    )
    stages.next("solving", 0.55)
    element_remanence = properties.remanence[mesh.body] if properties.remanence.any() else None
    state = problem.solve(
        properties.mu_r[mesh.body], load, element_remanence, tolerance * _RESIDUAL_PER_TOLERANCE
    )
    stages.next("", 1.0)
    report = SolverReport(
        tetrahedra=len(mesh.tets),
        surface_faces=len(problem.surface.areas),
        charged_faces=len(state.faces.areas),
        magnetic_bodies=int(problem.topology.group_of_tet.max()) + 1,
        iterations=state.iterations,
        residual=state.residuals[-1],
        matrix_bytes=problem.potential.nbytes,
        seconds=stages.seconds,
        assumptions=properties.assumptions + geometry_notes(device),
    )
    return LinearSolution(device.coils, mesh, state, element_remanence is not None, report)


def _check_arguments(tolerance: float, refinement: float) -> None:
    problems = []
    if not (np.isfinite(tolerance) and 0 < tolerance < 1):
        problems.append(
            Problem("solve_linear, tolerance", "must lie between 0 and 1", repr(tolerance), "try 1e-3")
        )
    if not (np.isfinite(refinement) and refinement > 0):
        problems.append(
            Problem("solve_linear, refinement", "must be a finite number > 0", repr(refinement), "try 1.0")
        )
    if problems:
        raise InputError(*problems)


def _coils_alone(device: Device, seconds: dict[str, float]) -> LinearSolution:
    report = SolverReport(0, 0, 0, 0, 0, 0.0, 0, seconds, ("no iron: the field of the coils alone",))
    return LinearSolution(device.coils, None, None, False, report)

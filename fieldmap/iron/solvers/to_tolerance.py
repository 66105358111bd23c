"""Linear iron on a mesh that is refined until the estimated error is small enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error.estimate import ErrorEstimate, estimate_error, workspace_surface
from fieldmap.iron.error.refinement import (
    FaceShares,
    WorkspaceDipoles,
    element_indicators,
    face_indicators,
    next_sizes,
)
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.materials import BodyProperties, body_properties
from fieldmap.iron.mesh.local_sizes import LocalSizes
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.operators.assembled import AssembledIron, assemble, fits_into_memory
from fieldmap.iron.report import Progress, Stages
from fieldmap.iron.sensitivity.origin import Origin
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.solvers.linear import (
    check_arguments,
    chosen_form,
    coils_alone,
    form_on,
    require_source,
    solved_in_form,
)
from fieldmap.records import Record
from fieldmap.typing import Array, PathLike

# Meshes are nowhere coarser than the sizes of the device file divided by this; the first is just that.
START = 0.7
_MOST_LEVELS = 8


def solve_to_tolerance(
    device: Device | PathLike,
    tolerance: float = 1e-3,
    mu_r: float | None = None,
    progress: Progress | None = None,
    gradient_tolerance: float | None = None,
) -> LinearSolution:
    """Refine until the estimated error in the workspace is within the tolerance; `report.error` tells it.

    tolerance: of the flux density, relative to its largest value in the workspace, for each coil and for the permanent
    magnets; gradient_tolerance: of the gradient, 3 x tolerance if None. Elements get smaller where the field in the
    workspace depends on it (`fieldmap.iron.error`); the estimate compares the last two meshes and both forms on the
    last, and adds up what flat faces of constant charge leave out (`fieldmap.iron.error.estimate`);
    `report.refinement` tells the faces and estimates of all meshes. Raises NotConverged with the estimates so far when
    the next mesh would not fit into memory, otherwise as `solve_linear`.
    """
    device = read_device(device)
    check_arguments(tolerance, 1.0, "auto")
    _require_shapes(device)
    check_geometry(device)
    points = workspace_surface(device)
    properties = body_properties(device, mu_r)
    if not device.bodies:
        return coils_alone(device, {})
    require_source(device, properties)
    limit = 3 * tolerance if gradient_tolerance is None else gradient_tolerance
    stages, history, sizes = Stages(progress), [], None
    coarser: LinearSolution | None = None
    for number in range(_MOST_LEVELS):
        stages.next(f"mesh {number + 1}", number / _MOST_LEVELS)
        mesh = generate_mesh(device, START, local=sizes)
        if not fits_into_memory(mesh):
            break
        iron = assemble(mesh)
        level = Level.solved(device, iron, properties, points, tolerance, stages)
        if coarser is not None:
            shares = level.face_shares.total
            growth = len(iron.surface.areas) / coarser.report.surface_faces - 1
            error = estimate_error(points, level.solution, coarser, level.complement, shares, growth)
            history.append((len(iron.surface.areas), error))
            if error.flux_density <= tolerance and error.gradient <= limit:
                stages.done(str(error))
                return replace(_with_error(level.solution, error, history), origin=Origin(device, True, mu_r))
        so_far = f"{history[-1][1].flux_density:.2g} at" if history else "none yet at"
        message = f"estimate {so_far} {len(iron.surface.areas)} faces; where they must be smaller"
        stages.next(message, (number + 0.7) / _MOST_LEVELS)
        sizes, coarser = level.next_sizes(min(tolerance, limit / 3)), level.solution
    raise _not_converged(device, tolerance, limit, history)


def _require_shapes(device: Device) -> None:
    own = [body.name for body in device.bodies if body.has_own_mesh]
    if own:
        must_hold = "elements are chosen for bodies of shapes; a mesh of your own is used as it is"
        remedy = "solve_linear at refinement 1 and 2 shows the error of such a mesh"
        where = f"device '{device.name}', body '{own[0]}'"
        raise InputError(Problem(where, must_hold, "a mesh", remedy))


def _not_converged(
    device: Device, tolerance: float, limit: float, history: list[tuple[int, ErrorEstimate]]
) -> NotConverged:
    return NotConverged(
        Problem(
            f"device '{device.name}'",
            f"the estimated error must fall to {tolerance:g} (gradient {limit:g}) on a mesh that fits into memory",
            ", ".join(f"{error.flux_density:.2g}" for _, error in history) or "no estimate",
            "loosen the tolerance, or give the bodies that matter smaller mesh sizes and the others larger ones",
        ),
        residuals=tuple(error.flux_density for _, error in history),
    )


def _with_error(
    solution: LinearSolution, error: ErrorEstimate, history: list[tuple[int, ErrorEstimate]]
) -> LinearSolution:
    refinement = tuple((faces, estimate.flux_density) for faces, estimate in history)
    return replace(solution, report=replace(solution.report, error=error, refinement=refinement))


@dataclass(frozen=True, eq=False, repr=False)
class Level(Record):
    """One mesh, solved: shares in the error, and sizes for the next mesh.

    forms, solutions: the chosen form first, then the complementary one, where it may be used; points (n, 3): of the
    air, where errors count."""

    properties: BodyProperties
    points: Array
    forms: tuple[ConvexForm[Any], ...]
    solutions: tuple[LinearSolution, ...]

    @classmethod
    def solved(
        cls,
        device: Device,
        iron: AssembledIron,
        properties: BodyProperties,
        points: Array,
        tolerance: float,
        stages: Stages,
    ) -> Level:
        """Solve for all sources in both forms, or in the flux form alone where there are flux barriers."""
        names = ("potential", "flux") if chosen_form("auto", properties) == "potential" else ("flux",)
        forms = tuple(form_on(iron, name) for name in names)
        solutions = tuple(solved_in_form(device, form, properties, tolerance, stages) for form in forms)
        return cls(properties, points, forms, solutions)

    @property
    def solution(self) -> LinearSolution:
        """In the chosen form."""
        return self.solutions[0]

    @property
    def complement(self) -> LinearSolution | None:
        """In the other."""
        return self.solutions[1] if len(self.solutions) == 2 else None

    @cached_property
    def face_shares(self) -> FaceShares:
        """What the charges on the surface share in the error of B."""
        iron, state = self.forms[0].iron, self._states[0]
        triangles = iron.topology.nodes[iron.topology.surface]
        return face_indicators(
            iron.surface, triangles, state.density, self._dual.density, self._size, self._fixed
        )

    @property
    def _fixed(self) -> Array:
        """Remanence times the dipoles' flux density (c, k, s), T^2, below each face; 0 for coils."""
        iron = self.forms[0].iron
        below = iron.topology.owner[iron.topology.surface, 0]
        remanence = self.properties.on(iron.mesh).remanence[iron.mesh.body[below]]
        work = np.einsum("sd,ksd->ks", remanence, self._dual.flux_density[:, below])
        fixed = np.zeros((len(self._size), *work.shape))
        if self.solution.has_remanence:
            fixed[-1] = work
        return fixed

    def next_sizes(self, tolerance: float) -> LocalSizes:
        """Element sizes for the next mesh."""
        iron = self.forms[0].iron
        elements = np.zeros(len(iron.mesh.tets))
        if self.complement is not None:
            other = self._dipoles.magnetise(self.forms[1], self.properties)
            mu_r, volume = self.properties.on(iron.mesh).mu_r[iron.mesh.body], self.forms[0].elements.volume
            elements = element_indicators(volume, mu_r, self._states, (self._dual, other), self._size)
        return next_sizes(iron.mesh, iron.topology, iron.surface, self.face_shares, elements, tolerance)

    @cached_property
    def _dipoles(self) -> WorkspaceDipoles:
        return WorkspaceDipoles.near_iron(self.points, self.forms[0].iron.surface)

    @cached_property
    def _dual(self) -> IronState:
        return self._dipoles.magnetise(self.forms[0], self.properties)

    @cached_property
    def _size(self) -> Array:
        """Largest flux density (c,) of every source: of each coil, and of what no current drives."""
        fields = self.solution.source_fields(self.points)[0]
        return np.maximum(np.linalg.norm(fields, axis=2).max(axis=1), 1e-300)

    @property
    def _states(self) -> tuple[IronState, ...]:
        return tuple(solution.state for solution in self.solutions if solution.state is not None)

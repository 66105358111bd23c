"""Linear iron on a mesh that is refined until the estimated error is small enough.

Each next mesh is meant to divide the error by a factor of 1.5 at least. It is refined where, by the shares of faces and
elements in the error, this costs least. The run ends when the estimate is within the tolerance, when three meshes in a
row were not better than the best one by a tenth, when the next mesh does not fit into memory, or after a stated number
of meshes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem, ToleranceNotReached
from fieldmap.iron.elements.potential_form import ConvexForm
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.error import (
    ErrorEstimate,
    ErrorShare,
    ExpectedCost,
    LargestError,
    MeshStep,
    Tolerance,
    ToleranceReport,
    estimate_error,
    expected_cost,
    faces_within,
    workspace_surface,
)
from fieldmap.iron.geometry.checks import check_geometry
from fieldmap.iron.materials import BodyProperties, body_properties
from fieldmap.iron.mesh.mesh import generate_mesh
from fieldmap.iron.mesh.mesher import LocalSizes
from fieldmap.iron.operators.assembled import AssembledIron, assemble, expected_bytes, fits_into_memory
from fieldmap.iron.report import Progress, Stages
from fieldmap.iron.sensitivity.adjoint import Origin
from fieldmap.iron.solution import LinearSolution
from fieldmap.iron.solvers import linear
from fieldmap.iron.solvers.refinement import (
    FaceShares,
    WorkspaceDipoles,
    element_indicators,
    expected_growth,
    face_indicators,
    next_sizes,
)
from fieldmap.records import Record
from fieldmap.typing import Array, Index, PathLike

# No mesh is coarser anywhere than the sizes of the device file divided by this. The first mesh has exactly these sizes.
START = 0.7
MOST_MESHES = 10
# The next mesh must divide the error by the first factor or more. The one after the first mesh must reach the second
# factor: the first mesh has no estimate, and its shares may be too small.
_LEAST_REDUCTION, _LEAST_FROM_FIRST = 1.5, 2.0
# Least number of surface faces of the next mesh over the present one: meshes that hardly differ show little of their
# error.
_LEAST_GROWTH = 2.0
# The next mesh aims below the tolerance by this factor, so that it need not meet its aim exactly.
_MARGIN = 1.6
# A source that may have any error counts less than others by this factor.
_UNASKED = 1e6
# Estimates have to fall to this part of the best within `_PATIENCE` meshes.
_BETTER, _PATIENCE = 0.9, 3


def solve_to_tolerance(
    device: Device | PathLike,
    tolerance: float | Tolerance = 1e-3,
    mu_r: float | None = None,
    progress: Progress | None = None,
    gradient_tolerance: float | None = None,
    most_meshes: int = MOST_MESHES,
) -> LinearSolution:
    """Refine until the estimated error in the workspace is within the tolerance; `report.error` holds the estimate.

    Elements get smaller where this reduces the error of the field in the workspace most. The estimate is the larger of
    half the gap between both forms and the change between the last two meshes. For B the summed errors of all faces
    limit this change (`fieldmap.iron.error`).

    Parameters
    ----------
    device
        The machine, its file, or the name of a shipped one.
    tolerance
        Allowed error of the flux density, relative to its largest value in the workspace, for each coil and for
        the magnets and background; or a `Tolerance` for each quantity, relative or absolute.
    mu_r
        Relative permeability of all soft iron; None: the device's own.
    progress
        progress(message, fraction) is called between steps.
    gradient_tolerance
        Allowed error of the gradient, relative to the larger of its largest value and of |B| over a length
        (`fieldmap.iron.error`); 3 x tolerance if None.
    most_meshes
        Most meshes of the run, 2 or more.

    Returns
    -------
    LinearSolution
        The solution on the last mesh. `report.tolerance` says how the run went: all meshes, the place of the
        largest error, the share of every body.

    Raises
    ------
    ToleranceNotReached
        With the best solution and the same report, when the estimate falls no further, when the next mesh would not fit
        into memory, and after `most_meshes`. Its text says which part of which body would have to be refined and what
        that would cost.
    GeometryError, InputError, NotConverged
        As `solve_linear`.

    Examples
    --------
    >>> import fieldmap as fm
    >>> device = fm.read_device("sphere_in_field", {"body.sphere.mesh_size_mm": 3.0})
    >>> solution = fm.solve_to_tolerance(device, 0.02)
    >>> solution.report.error.flux_density < 0.02, solution.report.tolerance.ended
    (True, 'reached')
    >>> print(solution.report.error.worst("B").source)
    the background
    """
    device = read_device(device)
    if not isinstance(tolerance, Tolerance):
        linear.check_arguments("solve_linear", tolerance)
    asked = Tolerance.of(tolerance, gradient_tolerance)
    _check(device, asked, most_meshes)
    check_geometry(device)
    points = workspace_surface(device)
    properties = body_properties(device, mu_r)
    if not device.bodies:
        return linear.coils_alone(device, {})
    linear.require_source(device, properties)
    run = _Run(device, asked, points, properties, most_meshes, Stages(progress))
    return replace(run.solution(), origin=Origin(device, True, mu_r))


def _check(device: Device, asked: Tolerance, most_meshes: int) -> None:
    """Raise InputError for arguments that do not fit the device."""
    if most_meshes < 2:
        must_hold = "must be 2 or more, because the estimate compares two"
        remedy = f"try {MOST_MESHES}"
        raise InputError.of("solve_to_tolerance, most_meshes", must_hold, repr(most_meshes), remedy)
    if asked.currents is not None and len(asked.currents) != len(device.coils):
        must_hold = f"must have one entry for each of the {len(device.coils)} coils"
        raise InputError.of("Tolerance, currents", must_hold, repr(asked.currents), "in their order")
    own = [body.name for body in device.bodies if body.has_own_mesh]
    if own:
        must_hold = "elements are chosen for bodies of shapes; a mesh of your own is used as it is"
        remedy = "solve_linear at refinement 1 and 2 shows the error of such a mesh"
        raise InputError.of(f"device '{device.name}', body '{own[0]}'", must_hold, "a mesh", remedy)


@dataclass(eq=False)
class _Run:
    """The meshes of one device, each made from the error shares of the mesh before, and their results."""

    device: Device
    asked: Tolerance
    points: Array
    properties: BodyProperties
    most_meshes: int
    stages: Stages
    steps: list[MeshStep] = field(default_factory=list)
    best: tuple[float, LinearSolution, ErrorEstimate] | None = None
    without_progress: int = 0

    def solution(self) -> LinearSolution:
        """The first solution within the tolerance. Raises ToleranceNotReached."""
        level: Level | None = None
        sizes: LocalSizes | None = None
        for number in range(self.most_meshes):
            self.stages.next(f"mesh {number + 1}", number / self.most_meshes)
            begin = time.perf_counter()
            mesh = generate_mesh(self.device, START, "workspace", local=sizes)
            if not fits_into_memory(mesh):
                raise self._not_reached("memory", level, sizes)
            coarser = None if level is None else level.solution
            # Matrices of the mesh before are large, and nothing needs them any more.
            level = None
            solving = (self.asked.solving, self.stages, self.asked)
            level = Level.solved(self.device, assemble(mesh), self.properties, self.points, *solving)
            report = level.solution.report
            reduction, so_far = max(_LEAST_FROM_FIRST, _MARGIN * level.own_excess), "none yet"
            estimates: tuple[float, ...] = ()
            if coarser is not None:
                growth = report.surface_faces / coarser.report.surface_faces - 1
                ours = (level.solution, coarser, level.complement, level.relative_shares, growth)
                error = estimate_error(self.points, *ours)
                excess = self.asked.excess(error, len(self.device.coils))
                reduction, so_far = max(_LEAST_REDUCTION, _MARGIN * excess), f"{error.flux_density:.2g}"
                estimates = error.flux_density, error.gradient, excess
                self._keep(level.solution, error, excess)
            counts = (report.surface_faces, report.tetrahedra, report.matrix_bytes)
            self.steps.append(MeshStep(*counts, time.perf_counter() - begin, *estimates))
            if coarser is not None and excess <= 1.0:
                self.stages.done(str(error))
                return self._answer(self._report("reached", level, None))
            what = f"estimate {so_far} at {report.surface_faces} faces; where they must be smaller"
            self.stages.next(what, (number + 0.7) / self.most_meshes)
            sizes = level.next_sizes(reduction)
            if self.without_progress >= _PATIENCE:
                raise self._not_reached("stalled", level, sizes)
        raise self._not_reached("meshes", level, sizes)

    def _keep(self, solution: LinearSolution, error: ErrorEstimate, excess: float) -> None:
        better = self.best is None or excess < _BETTER * self.best[0]
        self.without_progress = 0 if better else self.without_progress + 1
        if self.best is None or excess < self.best[0]:
            self.best = excess, solution, error

    def _report(self, ended: str, level: Level, sizes: LocalSizes | None) -> ToleranceReport:
        """sizes: of the next mesh, where one would follow."""
        worst = None if self.best is None else self.asked.worst(self.best[2], len(self.device.coils))
        largest, following, whole = None if worst is None else worst[0], None, None
        if sizes is not None:
            last, growth = self.steps[-1], level.growth(sizes)
            following = self._cost(level, growth[0] * last.faces, growth[1] * last.tetrahedra)
            enough = faces_within(self.steps)
            if enough is not None:
                whole = self._cost(level, enough, last.tetrahedra * (enough / last.faces) ** 1.5)
        shares = level.shares_of_bodies(sizes)
        return ToleranceReport(self.asked, ended, tuple(self.steps), largest, shares, following, whole)

    def _cost(self, level: Level, faces: float, tetrahedra: float) -> ExpectedCost:
        return expected_cost(self.steps, faces, tetrahedra, expected_bytes(faces, level.operations))

    def _answer(self, report: ToleranceReport) -> LinearSolution:
        """The best solution with its estimate and the report of the run."""
        assert self.best is not None
        _, solution, error = self.best
        steps = tuple((step.faces, step.flux_density) for step in self.steps if step.flux_density is not None)
        told = replace(solution.report, error=error, refinement=steps, tolerance=report)
        return replace(solution, report=told)

    def _not_reached(self, ended: str, level: Level | None, sizes: LocalSizes | None) -> ToleranceNotReached:
        must_hold = f"the estimated error must fall to {self.asked}"
        where = f"device '{self.device.name}'"
        if level is None:
            must_hold = f"{must_hold} on a mesh that fits into memory"
            remedy = "give the bodies larger mesh sizes"
            return ToleranceNotReached.of(where, must_hold, "no estimate", remedy)
        report = self._report(ended, level, sizes)
        estimates = tuple(step.flux_density for step in self.steps if step.flux_density is not None)
        remedy = "loosen the tolerance, allow an absolute error, or give that part smaller mesh sizes and others larger"
        best = None if self.best is None else self._answer(report)
        problem = Problem(where, must_hold, "no estimate" if best is None else f"{report!s}", remedy)
        return ToleranceNotReached(problem, residuals=estimates, report=report, solution=best)


@dataclass(frozen=True, eq=False, repr=False)
class Level(Record):
    """One mesh, solved: shares in the error, and sizes for the next mesh.

    forms, solutions: the chosen form first, then the complementary one, where it may be used; points (n, 3): of the
    air, where errors count; asked: the errors allowed there."""

    properties: BodyProperties
    points: Array
    forms: tuple[ConvexForm, ...]
    solutions: tuple[LinearSolution, ...]
    asked: Tolerance

    @classmethod
    def solved(
        cls,
        device: Device,
        iron: AssembledIron,
        properties: BodyProperties,
        points: Array,
        tolerance: float,
        stages: Stages,
        asked: Tolerance,
    ) -> Level:
        """Solve for all sources in both forms, or in the flux form alone where a mu_r is below 1."""
        names = ("potential", "flux") if linear.chosen_form("auto", properties) == "potential" else ("flux",)
        forms = tuple(linear.form_on(iron, name) for name in names)
        solutions = tuple(
            linear.solved_in_form(device, form, properties, tolerance, stages) for form in forms
        )
        return cls(properties, points, forms, solutions, asked)

    @property
    def solution(self) -> LinearSolution:
        """The solution in the chosen form."""
        return self.solutions[0]

    @property
    def complement(self) -> LinearSolution | None:
        """The solution in the other form."""
        return self.solutions[1] if len(self.solutions) == 2 else None

    @property
    def operations(self) -> int:
        """Number of operations of the mesh's symmetry."""
        symmetry = self._iron.mesh.symmetry
        return 1 if symmetry is None else symmetry.group.order

    @property
    def _iron(self) -> AssembledIron:
        return self.forms[0].iron

    @property
    def _below(self) -> Index:
        """The tetrahedra (s,) below the surface faces."""
        return self._iron.topology.owner[self._iron.topology.surface, 0]

    @cached_property
    def face_shares(self) -> FaceShares:
        """Shares of the surface faces' charges in the error of B."""
        iron, state = self._iron, self._states[0]
        triangles = iron.topology.nodes[iron.topology.surface]
        return face_indicators(
            iron.surface, triangles, state.density, self._dual.density, self._size, self._fixed, self.points
        )

    @property
    def relative_shares(self) -> Array:
        """Sums (c,) of the shares of all faces in the error of B, relative to the largest |B| of each source."""
        return self.face_shares.totals * self._size / self._largest

    @property
    def own_excess(self) -> float:
        """Estimated error over the allowed one, from this mesh alone: by the shares of its faces and by the gap."""
        error = estimate_error(self.points, self.solution, None, self.complement)
        coils = len(self.solution.coils)
        shares = np.divide(self.face_shares.totals * self._size, self._allowed)
        return max(float(shares.max(initial=0.0)), self.asked.excess(error, coils))

    @property
    def _fixed(self) -> Array:
        """Remanence times flux density of each workspace dipole (c, k, s), T^2, below each face; 0 for coils."""
        mesh, below = self._iron.mesh, self._below
        remanence = self.properties.on(mesh).remanence[mesh.body[below]]
        work = np.einsum("sd,ksd->ks", remanence, self._dual.flux_density[:, below])
        fixed = np.zeros((len(self._size), *work.shape))
        if self.solution.has_remanence:
            fixed[-1] = work
        return fixed

    def next_sizes(self, reduction: float) -> LocalSizes:
        """Element sizes for the next mesh, which is to divide the error by `reduction`, 4 at most."""
        return next_sizes(self._iron, self.face_shares, self.element_shares, reduction, _LEAST_GROWTH)

    @cached_property
    def element_shares(self) -> Array:
        """Shares of the elements (e,) in the error of B; 0 with one form alone."""
        iron = self._iron
        if self.complement is None:
            return np.zeros(len(iron.mesh.tets))
        other = self._dipoles.magnetise(self.forms[1], self.properties)
        mu_r, volume = self.properties.on(iron.mesh).mu_r[iron.mesh.body], self.forms[0].elements.volume
        return element_indicators(volume, mu_r, self._states, (self._dual, other), self._size)

    def growth(self, sizes: LocalSizes) -> tuple[float, float]:
        """Expected ratios of surface faces and of tetrahedra, of the next mesh to this one."""
        return expected_growth(self._iron, self.face_shares.at_edge, sizes)

    def shares_of_bodies(self, sizes: LocalSizes | None = None) -> tuple[ErrorShare, ...]:
        """Shares of the bodies in the error of B, the largest first; sizes: of the next mesh."""
        iron, cells, below = self._iron, self._iron.mesh.cells, self._below
        assert cells is not None
        own = self.face_shares.across + self.face_shares.rest
        count = len(cells.sizes)
        of_cell = np.bincount(cells.number[below], own, count)
        of_cell += np.bincount(cells.number, self.element_shares, count)
        body = np.zeros(count, np.int64)
        body[cells.number] = iron.mesh.body
        at_edge = np.bincount(cells.number[below], np.where(self.face_shares.at_edge, own, 0.0), count)
        whole, shares = max(float(of_cell.sum()), 1e-300), []
        for number, name in enumerate(iron.mesh.body_names):
            mine = np.where(body == number, of_cell, -1.0)
            worst = int(mine.argmax())
            if mine[worst] <= 0:
                continue
            x, y, z = (float(value) for value in cells.centres[worst])
            size, layer = float(cells.sizes[worst]), None
            wanted = size if sizes is None else float(sizes.sizes[worst])
            if sizes is not None and at_edge[worst] > 0.5 * of_cell[worst]:
                layer = float(sizes.first_layer(cells.centres[worst : worst + 1])[0])
            share = float(of_cell[body == number].sum()) / whole
            shares.append(ErrorShare(name, share, (x, y, z), size, wanted, layer))
        return tuple(sorted(shares, key=lambda one: -one.share))

    @cached_property
    def _dipoles(self) -> WorkspaceDipoles:
        return WorkspaceDipoles.near_iron(self.points, self._iron.surface)

    @cached_property
    def _dual(self) -> IronState:
        return self._dipoles.magnetise(self.forms[0], self.properties)

    @cached_property
    def _largest(self) -> Array:
        """Largest flux density (c,), T, of every source: each coil, and the magnets and background."""
        fields = self.solution.source_fields(self.points)[0]
        return np.maximum(np.linalg.norm(fields, axis=2).max(axis=1), 1e-300)

    @property
    def _allowed(self) -> Array:
        """Allowed errors of B (c,), T; inf where B may have any."""
        # The allowed error does not depend on the place.
        errors = (
            LargestError("B", name, (0, 0, 0), 0.0, float(size))
            for name, size in zip(self.solution.sources, self._largest, strict=True)
        )
        coils = len(self.solution.coils)
        return np.array([self.asked.allowed(one, number, coils) for number, one in enumerate(errors)])

    @cached_property
    def _size(self) -> Array:
        """The scale (c,) of the shares, T: largest |B| of each source, times its allowed relative error over the
        smallest allowed relative error of all sources."""
        relative = self._allowed / self._largest
        if not np.isfinite(relative).any():
            return self._largest
        return self._largest * np.minimum(relative / relative.min(), _UNASKED)

    @property
    def _states(self) -> tuple[IronState, ...]:
        return tuple(solution.state for solution in self.solutions if solution.state is not None)

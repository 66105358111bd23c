"""The public door to saturating iron: one state of the device at given currents."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import (
    Coil,
    Device,
    FluxBarrier,
    LinearMaterial,
    PermanentMagnet,
    SaturatingMaterial,
    Section,
)
from fieldmap.errors import InputError, Problem
from fieldmap.iron.cad.geometry_checks import check_geometry, geometry_notes
from fieldmap.iron.continuation import Sources, solve_with_continuation
from fieldmap.iron.error_estimate import ErrorEstimate, workspace_surface
from fieldmap.iron.forms.bh_law import law_tables, law_words
from fieldmap.iron.forms.element_fields import PotentialField
from fieldmap.iron.forms.nodal_elements import CoilField
from fieldmap.iron.forms.potential_form import Magnetisation, PotentialForm, PotentialState
from fieldmap.iron.galerkin import GalerkinModel, project
from fieldmap.iron.meshing.mesh import IronMesh, generate_mesh
from fieldmap.iron.nonlinear_error import Complement, state_error
from fieldmap.iron.operators.assembled import assemble
from fieldmap.iron.operators.surface import ChargedFaces
from fieldmap.iron.quantities.air import checked_currents, checked_points, mean_over_body, refuse_inside
from fieldmap.iron.quantities.differential_inductance import iron_differential_inductance
from fieldmap.iron.quantities.forces import Magnetised, force_and_torque
from fieldmap.iron.quantities.inside import containing_element
from fieldmap.iron.quantities.linkage import linkage_and_coenergy
from fieldmap.iron.quantities.magpylib_export import as_magpylib
from fieldmap.iron.quantities.sections import SectionFlux, named_section, section_flux
from fieldmap.iron.report import SolverReport
from fieldmap.iron.stages import Progress, Stages
from fieldmap.sources import unit_flux_densities, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance

Array = NDArray[np.float64]
# Newton stops when its residual, in the energy norm, is this fraction of the requested tolerance.
_RESIDUAL_PER_TOLERANCE = 1e-3
# The gap between the forms is not asked for more than two digits.
_RESIDUAL_OF_COMPLEMENT = 1e-2
# Ratio of the mesh sizes of a state and of the one that it is compared with.
_COARSER = 1.4
_LINEAR_INSTEAD = "solve it with linear iron: leave --nonlinear out, or in Python call fieldmap.solve_linear"


@dataclass(frozen=True, eq=False)
class NonlinearSolution:
    """Coils and saturating iron at fixed currents. Fields in T, gradients in T/m, points (n, 3) or (3,) in m.

    iron_linkage (c,) in Wb and iron_coenergy in J: what the iron adds to the coils' flux linkages and to the
    co-energy of their field. Forces, linkages and energies: docs/theory/forces.md.
    """

    coils: tuple[Coil, ...]
    currents: Array
    mesh: IronMesh
    state: PotentialState
    report: SolverReport
    iron_linkage: Array
    iron_coenergy: float
    sections: tuple[Section, ...] = ()

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    def field(self, points: ArrayLike) -> Array:
        """Flux density (n, 3) or (3,); inside the iron the mean of the element. Raises InputError for bad points."""
        x, single = checked_points(points)
        b = self.state.iron.faces.field(x, self.state.iron.density)[0]
        for coil, current in zip(self.coils, self.currents, strict=True):
            b += current * unit_flux_density(coil, x)
        element = containing_element(self.mesh, x)
        inside = element >= 0
        b[inside] = self.state.iron.flux_density[0, element[inside]]
        return b[0] if single else b

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient dB_i/dx_j (n, 3, 3) or (3, 3), outside the iron. Raises InputError for points inside it."""
        x, single = checked_points(points)
        refuse_inside(self.mesh, x)
        g = self.state.iron.faces.field_and_gradient(x, self.state.iron.density)[1][0]
        for coil, current in zip(self.coils, self.currents, strict=True):
            g += current * unit_flux_density_and_gradient(coil, x)[1]
        return g[0] if single else g

    def flux_density(self, body: str) -> Array:
        """Mean flux density (3,) in T over the volume of a named body. Raises InputError for an unknown name."""
        return mean_over_body(self.mesh, body, self.state.iron.flux_density[0])

    def section_flux(self, section: str | Section) -> SectionFlux:
        """Flux, area and mean normal flux density of a section of the device file, or of any plane.

        The field inside each element is integrated over what the plane cuts out of it. Raises InputError for an
        unknown name, and for a plane that cuts no iron.
        """
        found = named_section(self.sections, section)
        return section_flux(self.mesh, self.state.iron, found, np.ones(1))

    def section_flux_density(self, section: str | Section) -> float:
        """Mean flux density in T along the normal of a section; see `section_flux`."""
        return self.section_flux(section).flux_density

    def force_on(self, name: str | Sequence[str]) -> Array:
        """Force (3,) in N on a body or coil, or on several together.

        Bodies that touch have a force only together: name them all. Raises InputError otherwise and for unknown
        names.
        """
        return force_and_torque(self._magnetised, name, np.zeros(3))[0]

    def torque_on(self, name: str | Sequence[str], about: ArrayLike) -> Array:
        """Torque (3,) in N m about a point (3,) in m; otherwise as `force_on`."""
        return force_and_torque(self._magnetised, name, about)[1]

    def flux_linkage(self) -> Array:
        """Flux linkages (c,) of the coils in Wb, all turns."""
        return self._air_inductance @ self.currents + self.iron_linkage

    def coenergy(self) -> float:
        """Co-energy in J: its derivative by a current is that coil's linkage, by a displacement the force.

        With permanent magnets it contains a constant, that of the magnets without currents.
        """
        return float(0.5 * self.currents @ self._air_inductance @ self.currents) + self.iron_coenergy

    def energy(self) -> float:
        """Field energy in J, iron included: sum of currents x linkages, less the co-energy."""
        return float(self.currents @ self.flux_linkage()) - self.coenergy()

    def as_magpylib(self) -> Any:
        """The state as a magpylib Collection: iron as tetrahedra of constant polarisation, coils as current sheets.

        Its getB in the air differs from `field` by the iron's discretisation.
        """
        return as_magpylib(self.coils, self.currents, self.mesh, self.state.iron, np.ones(1))

    @cached_property
    def _air_inductance(self) -> Array:
        return bare_inductance(self.coils)

    @property
    def _magnetised(self) -> Magnetised:
        iron = self.state.iron
        return Magnetised(self.coils, self.currents, self.mesh, iron.faces, iron.density[0])


class NonlinearSolver:
    """A device meshed and assembled once, for any number of current states.

    refinement divides the mesh sizes of the device file; symmetry: "auto" uses the mirror planes of the iron, "none"
    does not look for them. Raises GeometryError and InputError like `solve`.
    """

    def __init__(
        self,
        device: Device,
        refinement: float = 1.0,
        progress: Progress | None = None,
        symmetry: str = "none",
    ) -> None:
        self.device = device
        self._progress, self._refinement, self._symmetry = progress, refinement, symmetry
        _require_soft_bodies(device)
        stages = Stages(progress)
        stages.next("checking the geometry", 0.0)
        check_geometry(device)
        stages.next("meshing the iron", 0.02)
        mesh = generate_mesh(device, refinement, symmetry)
        stages.next("mutual potentials of the faces", 0.1)
        self._iron = assemble(mesh)
        stages.next("air operator", 0.4)
        self._form = PotentialForm(self._iron)
        stages.next("field of the coils in the iron", 0.5)
        coils = device.coils
        self._unit = self._form.elements.coil_field(lambda x: unit_flux_densities(coils, x))
        stages.done("assembled")
        self._seconds = stages.seconds
        materials = [device.materials[body.material] for body in device.bodies]
        remanence = [m.remanence if isinstance(m, PermanentMagnet) else np.zeros(3) for m in materials]
        self._material = Magnetisation(mesh.body, law_tables(materials), np.array(remanence)[mesh.body][None])

    def solve(
        self,
        currents: ArrayLike,
        tolerance: float = 1e-3,
        start: "NonlinearSolution | Array | None" = None,
    ) -> NonlinearSolution:
        """The state at currents (c,) in A, from `start` (a neighbouring state of this solver, or its nodal potential
        (n,)) or from zero.

        Where Newton's method fails, the state is approached in steps of the currents; `report.continuation` names
        them. Raises InputError for bad arguments, NotConverged with the residual history once that has failed too.
        """
        values = checked_currents(currents, self.device.coil_names)
        if not (np.isfinite(tolerance) and 0 < tolerance < 1):
            raise InputError(
                Problem("solve, tolerance", "must lie between 0 and 1", repr(tolerance), "try 1e-3")
            )
        field = self._coil_field(values)
        stages = Stages(self._progress)
        stages.next("Newton iteration", 0.6)
        begin = start.state.potential if isinstance(start, NonlinearSolution) else start
        begin = begin if begin is None else begin.reshape(-1, 1)
        sources = Sources(self._material, field)
        residual = tolerance * _RESIDUAL_PER_TOLERANCE
        state, shares = solve_with_continuation(self._form, sources, residual, begin)
        stages.done()
        report = self._report(
            state, {**({} if start is not None else self._seconds), **stages.seconds}, shares
        )
        elements, material = self._form.elements, self._material
        linkage, coenergy = linkage_and_coenergy(
            elements.volume,
            material,
            elements.strength_at_points(state.potential, field, material),
            elements.coil_field_at_points(field),
            elements.coil_field_at_points(self._unit),
        )
        return NonlinearSolution(
            self.device.coils,
            values,
            self._iron.mesh,
            state,
            report,
            linkage[:, 0],
            float(coenergy[0]),
            self.device.sections,
        )

    @property
    def surface(self) -> ChargedFaces:
        """The charged faces, whose densities are those of the states and of the modes of `project`."""
        return self._iron.surface

    @property
    def unknowns(self) -> int:
        """Number of nodes."""
        return self._form.elements.count

    def project(self, basis: Array) -> GalerkinModel:
        """The iron on nodal potentials `basis` (n, r), such as combinations of `NonlinearSolution.state.potential`."""
        return project(self._form, self._material, self._unit, basis)

    def charge_density(self, potential: Array) -> Array:
        """Charge (k, s) per area of `surface`, T, for nodal potentials (n, k)."""
        return self._form.charge_density(potential)

    def energy_operator(self, currents: Array, potential: Array) -> Callable[[Array], Array]:
        """The tangent at a state, iron and air, on nodal potentials (n, k): symmetric and positive."""
        tangent = self._form.tangent(self._material, self._coil_field(currents), potential)
        return lambda values: tangent @ values + self._form.air(values)

    def _coil_field(self, currents: Array) -> CoilField:
        constant = np.einsum("c,ced->ed", currents, self._unit.constant)
        return CoilField(constant[None], (currents @ self._unit.bubble)[None])

    def differential_inductance(self, state: NonlinearSolution, tolerance: float = 1e-8) -> Array:
        """Derivatives (c, c) in H of the flux linkages by the currents at a state of this solver; symmetric.

        Where the iron saturates it is less than linkage per current. tolerance: of the linear solve. Raises
        InputError for a state of another solver, NotConverged.
        """
        inside = state.state.iron.inside
        if not isinstance(inside, PotentialField) or inside.elements is not self._form.elements:
            remedy = "pass what this solver's own solve returned"
            raise InputError(
                Problem("differential_inductance, state", "must be a state of this solver", "another", remedy)
            )
        added = iron_differential_inductance(self._form, self._material, inside, self._unit, tolerance)
        return bare_inductance(self.device.coils) + added

    def estimate_error(self, solution: NonlinearSolution, tolerance: float = 1e-3) -> ErrorEstimate:
        """How far a state of this solver is from the truth in the workspace (`fieldmap.iron.error_estimate`).

        Solves it again in the flux form, from the potential found, and on a mesh 1.4 times coarser; both are kept for
        further states. Raises InputError if the device has no workspace, NotConverged as `solve`.
        """
        workspace_surface(self.device)
        stages, field = Stages(self._progress), self._coil_field(solution.currents)
        stages.next("flux form", 0.3)
        residual = tolerance * _RESIDUAL_OF_COMPLEMENT
        complement = self._complement.solve(self._material, field, solution.state.potential, residual)
        stages.next("coarser mesh", 0.6)
        coarser = self._coarser.solve(solution.currents, tolerance).state.iron
        stages.done("error estimated")
        return state_error(self.device, solution.currents, solution.state.iron, coarser, complement)

    @cached_property
    def _complement(self) -> Complement:
        return Complement(self._iron)

    @cached_property
    def _coarser(self) -> "NonlinearSolver":
        return NonlinearSolver(self.device, self._refinement / _COARSER, symmetry=self._symmetry)

    def _report(
        self, state: PotentialState, seconds: dict[str, float], shares: tuple[float, ...]
    ) -> SolverReport:
        low, high = self._material.tables.range_h[:, self._material.law]
        largest = state.largest_h[0]
        return SolverReport(
            form="potential",
            tetrahedra=len(self._iron.mesh.tets),
            surface_faces=len(self._iron.surface.areas),
            charged_faces=len(self._iron.surface.areas),
            unknowns=self._form.elements.count,
            magnetic_bodies=self._iron.magnetic_bodies,
            iterations=state.iron.iterations,
            residual=state.iron.residuals[-1],
            matrix_bytes=self._iron.mutual.bytes,
            storage=self._iron.mutual.storage,
            seconds=seconds,
            assumptions=_assumptions(self.device) + geometry_notes(self.device),
            symmetry=self._iron.symmetry,
            largest_flux_density=float(np.linalg.norm(state.iron.flux_density[0], axis=1).max()),
            beyond_table=int((largest > high).sum()),
            below_table=int((largest < np.where(np.isfinite(low), low, 0.0)).sum()),
            continuation=shares,
        )


def solve(
    device: Device,
    currents: ArrayLike,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
    refinement: float = 1.0,
    estimate: bool = False,
) -> NonlinearSolution:
    """Solve a device with nonlinear iron at currents (c,) in A.

    Second-order potential form, Newton's method with exact line search (docs/theory/iron.md). tolerance bounds the
    algebraic error; the mesh error is set by the mesh sizes of the device file and `refinement`. With `estimate`,
    `report.error` tells how far the field in the workspace is from the truth, see `NonlinearSolver.estimate_error`;
    that takes about as long again. For many currents make a `NonlinearSolver` once. Raises GeometryError if bodies,
    windings and workspace do not fit together, InputError for bad arguments or a body without a B(H) law,
    NotConverged with the residual history.

    >>> import fieldmap as fm
    >>> state = fm.solve(fm.read_device("loop_and_sphere"), currents=[1.0])
    >>> print(f"{1e3 * state.field([0.0, 0.0, -0.014])[2]:.2f} mT")
    1.01 mT
    """
    if estimate:
        workspace_surface(device)
    solver = NonlinearSolver(device, refinement, progress)
    solution = solver.solve(currents, tolerance)
    error = solver.estimate_error(solution, tolerance) if estimate else None
    return replace(solution, report=replace(solution.report, error=error))


def _require_soft_bodies(device: Device) -> None:
    if not device.bodies:
        raise InputError(
            Problem(
                f"device '{device.name}'",
                "there must be iron for a nonlinear solve",
                "no bodies",
                _LINEAR_INSTEAD,
            )
        )
    problems = []
    for body in device.bodies:
        material = device.materials[body.material]
        given = ""
        if isinstance(material, FluxBarrier):
            given = "an ideal flux barrier"
        elif not isinstance(material, SaturatingMaterial) and material.mu_r < 1:
            given = f"mu_r = {material.mu_r:g}"
        if given:
            where = f"device '{device.name}', body '{body.name}'"
            problems.append(
                Problem(where, "a nonlinear solve needs mu_r >= 1 in every body", given, _LINEAR_INSTEAD)
            )
    if problems:
        raise InputError(*problems)


def _assumptions(device: Device) -> tuple[str, ...]:
    used = dict.fromkeys(body.material for body in device.bodies)
    notes = []
    for name in used:
        material = device.materials[name]
        if isinstance(material, SaturatingMaterial):
            notes.append(f"iron '{name}': {law_words(material)}; no hysteresis")
        elif isinstance(material, PermanentMagnet):
            notes.append(f"magnet '{name}': constant mu_r = {material.mu_r:g}")
        elif isinstance(material, LinearMaterial):
            notes.append(f"iron '{name}': linear, mu_r = {material.mu_r:g}")
    return tuple(notes)

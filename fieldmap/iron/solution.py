"""Solved iron: the linear solution, a field for any currents, and states of coils and iron at fixed currents.

Every state has the same interface, whether the iron is linear (`LinearSolution.at`), saturates (`NonlinearSolver.at`)
or has hysteresis (`HysteresisSolver.step`): fields, flux densities, forces, section fluxes, flux linkages. Fields in T,
gradients G[..., i, j] = dB_i/dx_j in T/m, points (n, 3) or (3,) in m, global frame.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Coil, Section
from fieldmap.errors import InputError, Problem
from fieldmap.field import BaseField, BaseFieldAtCurrents, Bounds, Currents, coil_currents
from fieldmap.iron.elements.potential_form import PotentialState
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.quantities.air import checked_points, containing_element, mean_over_body, refuse_inside
from fieldmap.iron.quantities.forces import Magnetised, force_and_torque
from fieldmap.iron.quantities.magpylib_export import as_magpylib
from fieldmap.iron.quantities.sections import SectionFlux, named_section, section_flux
from fieldmap.iron.report import SolverReport
from fieldmap.records import card, shortened
from fieldmap.sources import unit_flux_densities, unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance
from fieldmap.typing import Array, Index


@dataclass(frozen=True, eq=False, repr=False)
class SolvedState(BaseFieldAtCurrents):
    """Coils and iron at fixed currents (c,) in A; what all states have in common.

    iron: charges and flux densities of one or several sources, its columns, None where there is no iron; weights
    (columns,): their shares in this state. bounds: the box around the workspace.
    """

    coils: tuple[Coil, ...]
    currents: Array
    mesh: IronMesh | None
    iron: IronState | None
    weights: Array
    report: SolverReport
    sections: tuple[Section, ...]
    bounds: Bounds | None = field(default=None, kw_only=True)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the state rests on."""
        return self.report.assumptions

    def __repr__(self) -> str:
        return shortened(f"<{type(self).__name__} at {self.currents.tolist()} A: {self.report}>")

    def _repr_html_(self) -> str:
        amperes = ", ".join(f"{i:g}" for i in self.currents)
        return card(f"{type(self).__name__} at {amperes} A", self.report.card_rows())

    def field(self, points: ArrayLike) -> Array:
        """Flux density (n, 3) or (3,); inside the iron the mean of the element. Raises InputError for bad points."""
        x, single = checked_points(points)
        b = self._field_of_charges(x)
        if self.mesh is not None and self.iron is not None:
            element = containing_element(self.mesh, x)
            inside = element >= 0
            b[inside] = self._mean_in(element[inside])
        return b[0] if single else b

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient dB_i/dx_j (n, 3, 3) or (3, 3), outside the iron. Raises InputError for points inside it."""
        x, single = checked_points(points)
        refuse_inside(self.mesh, x)
        g = self._gradient_of_charges(x)
        return g[0] if single else g

    @cached_property
    def element_flux_density(self) -> Array:
        """Mean flux density (e, 3) in T of every element of the iron."""
        return self._mean_in(slice(None))

    @property
    def largest_flux_density(self) -> float:
        """Largest of the elements' flux densities, T; NaN without iron."""
        size = np.linalg.norm(self.element_flux_density, axis=1)
        return float(size.max()) if len(size) else float("nan")

    def flux_density(self, body: str) -> Array:
        """Mean flux density (3,) in T over the volume of a named body. Raises InputError for an unknown name."""
        return mean_over_body(self.mesh, body, self.element_flux_density)

    def section_flux(self, section: str | Section) -> SectionFlux:
        """Flux, area and mean normal flux density of a section of the device file, or of any plane.

        The field inside each element is integrated over what the plane cuts out of it. Raises InputError for an
        unknown name, and for a plane that cuts no iron.
        """
        return section_flux(self.mesh, self.iron, named_section(self.sections, section), self.weights)

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
        """Flux linkages (c,) of the coils in Wb, all turns; the share of permanent magnets included."""
        return self._air_inductance @ self.currents + self._iron_linkage

    def as_magpylib(self) -> Any:
        """The state as a magpylib Collection: iron as tetrahedra of constant polarisation, coils as current sheets.

        Its getB in the air differs from `field` by the iron's discretisation. Raises InputError for a solution that
        was read back from a file.
        """
        return as_magpylib(self.coils, self.currents, self.mesh, self.iron, self.weights)

    @abstractmethod
    def _field_of_charges(self, x: Array) -> Array:
        """B (n, 3) of coils and surface charges: the field in the air."""

    @abstractmethod
    def _gradient_of_charges(self, x: Array) -> Array:
        """Its gradient (n, 3, 3)."""

    @property
    @abstractmethod
    def _iron_linkage(self) -> Array:
        """What the iron adds to the flux linkages (c,), Wb."""

    @cached_property
    def _air_inductance(self) -> Array:
        return bare_inductance(self.coils)

    def _mean_in(self, element: Index | slice) -> Array:
        if self.iron is None:
            return np.zeros((0, 3))
        return np.einsum("c,ced->ed", self.weights, self.iron.flux_density[:, element])

    @property
    def _magnetised(self) -> Magnetised:
        iron = self.iron
        if iron is None:
            return Magnetised(self.coils, self.currents)
        return Magnetised(self.coils, self.currents, self.mesh, iron.faces, self.weights @ iron.density)


@dataclass(frozen=True, eq=False, repr=False)
class LinearSolution(BaseField):
    """Coils and linear iron, solved once per coil; any currents by superposition.

    `at(currents)` is the state at these currents; `field` to `energy` with currents are short for its methods. The
    remanence of permanent magnets, if any, adds a field that no current changes. Currents: (c,) in A, one number for
    all coils, or a mapping by name. Forces, inductances and energy: docs/theory/forces.md.

    >>> import fieldmap as fm
    >>> unit = fm.solve_linear(fm.read_device("loop_and_sphere"))
    >>> field = unit.field([0.0, 0.0, -0.014], currents=[1.0])
    >>> print(f"{1e3 * field[2]:.2f} mT; closed form 1.007 mT")
    1.01 mT; closed form 1.007 mT
    """

    coils: tuple[Coil, ...]
    mesh: IronMesh | None
    state: IronState | None
    has_remanence: bool
    report: SolverReport
    iron_linkage: Array | None = None
    sections: tuple[Section, ...] = ()
    bounds: Bounds | None = None

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    def __repr__(self) -> str:
        return shortened(f"<LinearSolution of {len(self.coils)} coils: {self.report}>")

    def _repr_html_(self) -> str:
        return card(f"LinearSolution of {len(self.coils)} coils", self.report.card_rows())

    @property
    def proportional(self) -> bool:
        """Unless permanent magnets add a field of their own."""
        return not self.has_remanence

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the solution rests on."""
        return self.report.assumptions

    @property
    def sources(self) -> tuple[str, ...]:
        """What each column of `source_fields` is the field of."""
        coils = tuple(f"1 A in coil '{name}'" for name in self.coil_names)
        return (*coils, "the permanent magnets") if self.has_remanence else coils

    def at(self, currents: Currents) -> "LinearState":
        """The state at these currents. Raises InputError for currents that do not fit the coils."""
        amperes = np.array(coil_currents(currents, self.coil_names))
        weights = np.append(amperes, 1.0) if self.has_remanence else amperes
        about = (self.coils, amperes, self.mesh, self.state, weights, self.report, self.sections)
        return LinearState(*about, self, bounds=self.bounds)

    def unit_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Total field (c, n, 3) in T/A and gradient (c, n, 3, 3) in T/(m A) of 1 A in each coil, outside the iron.

        Without the field of permanent magnets. Raises InputError for points that are not (n, 3) or not finite, and
        for points inside the iron, where the gradient is not defined by the solver.
        """
        b, g = self.source_fields(points)
        return b[: len(self.coils)], g[: len(self.coils)]

    def source_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Fields (s, n, 3) and gradients (s, n, 3, 3) of `sources`: `unit_fields`, then those of permanent magnets."""
        x, _ = checked_points(points)
        refuse_inside(self.mesh, x)
        return self._fields_and_gradients(x)

    def remanent_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Field (n, 3) and gradient (n, 3, 3) of the permanent magnets with all currents off, outside the iron."""
        x, _ = checked_points(points)
        refuse_inside(self.mesh, x)
        if not self.has_remanence:
            return np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
        b, g = self._fields_and_gradients(x)
        return b[-1], g[-1]

    def inductance(self) -> Array:
        """Inductance matrix (c, c) in H of the coils in their iron; symmetric up to the solver's tolerance.

        Raises InputError for a solution that was stored without its linkages.
        """
        return self._air_inductance + self._iron_linkages()[:, : len(self.coils)]

    def field(self, points: ArrayLike, currents: Currents) -> Array:
        """Flux density (n, 3) at points (n, 3), or (3,) at (3,); see `SolvedState.field`."""
        return self.at(currents).field(points)

    def gradient(self, points: ArrayLike, currents: Currents) -> Array:
        """Gradient (n, 3, 3) at points (n, 3), or (3, 3) at (3,); see `SolvedState.gradient`."""
        return self.at(currents).gradient(points)

    def flux_density(self, body: str, currents: Currents) -> Array:
        """See `SolvedState.flux_density`."""
        return self.at(currents).flux_density(body)

    def section_flux(self, section: str | Section, currents: Currents) -> SectionFlux:
        """See `SolvedState.section_flux`."""
        return self.at(currents).section_flux(section)

    def section_flux_density(self, section: str | Section, currents: Currents) -> float:
        """See `SolvedState.section_flux_density`."""
        return self.at(currents).section_flux_density(section)

    def force_on(self, name: str | Sequence[str], currents: Currents) -> Array:
        """See `SolvedState.force_on`."""
        return self.at(currents).force_on(name)

    def torque_on(self, name: str | Sequence[str], currents: Currents, about: ArrayLike) -> Array:
        """See `SolvedState.torque_on`."""
        return self.at(currents).torque_on(name, about)

    def flux_linkage(self, currents: Currents) -> Array:
        """See `SolvedState.flux_linkage`."""
        return self.at(currents).flux_linkage()

    def energy(self, currents: Currents) -> float:
        """See `LinearState.energy`."""
        return self.at(currents).energy()

    def as_magpylib(self, currents: Currents) -> Any:
        """See `SolvedState.as_magpylib`."""
        return self.at(currents).as_magpylib()

    @cached_property
    def _air_inductance(self) -> Array:
        return bare_inductance(self.coils)

    def _iron_linkages(self) -> Array:
        """Flux linkages (c, columns) that the iron adds."""
        if self.iron_linkage is None and self.state is not None:
            received = "a solution read back without them"
            raise InputError(
                Problem(
                    "inductance", "the iron's flux linkages are needed", received, "solve the device again"
                )
            )
        columns = len(self.coils) + self.has_remanence
        return np.zeros((len(self.coils), columns)) if self.iron_linkage is None else self.iron_linkage

    def _fields(self, x: Array) -> Array:
        """Field (columns, n, 3) of every column, coils, then remanence, outside the iron."""
        b = np.zeros((len(self.coils) + self.has_remanence, len(x), 3))
        b[: len(self.coils)] = unit_flux_densities(self.coils, x)
        if self.state is not None:
            b += self.state.faces.field(x, self.state.density)
        return b

    def _fields_and_gradients(self, x: Array) -> tuple[Array, Array]:
        columns = len(self.coils) + self.has_remanence
        b, g = np.zeros((columns, len(x), 3)), np.zeros((columns, len(x), 3, 3))
        for k, coil in enumerate(self.coils):
            b[k], g[k] = unit_flux_density_and_gradient(coil, x)
        if self.state is not None:
            iron_b, iron_g = self.state.faces.field_and_gradient(x, self.state.density)
            b += iron_b
            g += iron_g
        return b, g


@dataclass(frozen=True, eq=False, repr=False)
class LinearState(SolvedState):
    """A linear solution at currents (c,) in A. Columns of the iron: 1 A in each coil, and the remanence if any."""

    solution: LinearSolution

    def energy(self) -> float:
        """Energy in J that the currents have put into the field: half the sum of I L I."""
        return float(0.5 * self.currents @ self.solution.inductance() @ self.currents)

    def coenergy(self) -> float:
        """Co-energy in J: its derivative by a current is that coil's linkage. That of the magnets alone is left out."""
        own = self.currents @ self.solution.inductance() @ self.currents
        return float(self.currents @ self.flux_linkage() - 0.5 * own)

    @cached_property
    def _air_inductance(self) -> Array:
        return self.solution._air_inductance

    @property
    def _iron_linkage(self) -> Array:
        return self.solution._iron_linkages() @ self.weights

    def _field_of_charges(self, x: Array) -> Array:
        return np.einsum("c,cnd->nd", self.weights, self.solution._fields(x))

    def _gradient_of_charges(self, x: Array) -> Array:
        return np.einsum("c,cnij->nij", self.weights, self.solution._fields_and_gradients(x)[1])


@dataclass(frozen=True, eq=False, repr=False)
class PotentialSolution(SolvedState):
    """Coils and iron at currents (c,) in A, solved for these in the potential form: one column.

    state: nodal potential and largest field strengths. iron_linkage (c,) in Wb: what the iron adds to the linkages.
    """

    state: PotentialState
    iron_linkage: Array

    @property
    def _iron_linkage(self) -> Array:
        return self.iron_linkage

    def _field_of_charges(self, x: Array) -> Array:
        iron = self.state.iron
        b = iron.faces.field(x, iron.density)[0]
        for coil, current in zip(self.coils, self.currents, strict=True):
            b += current * unit_flux_density(coil, x)
        return b

    def _gradient_of_charges(self, x: Array) -> Array:
        iron = self.state.iron
        g = iron.faces.field_and_gradient(x, iron.density)[1][0]
        for coil, current in zip(self.coils, self.currents, strict=True):
            g += current * unit_flux_density_and_gradient(coil, x)[1]
        return g


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearSolution(PotentialSolution):
    """Coils and saturating iron at currents (c,) in A.

    iron_coenergy in J: what the iron adds to the co-energy of the coils' field. Forces, linkages and energies:
    docs/theory/forces.md.
    """

    iron_coenergy: float

    def coenergy(self) -> float:
        """Co-energy in J: its derivative by a current is that coil's linkage, by a displacement the force.

        With permanent magnets it contains a constant, that of the magnets without currents.
        """
        return float(0.5 * self.currents @ self._air_inductance @ self.currents) + self.iron_coenergy

    def energy(self) -> float:
        """Field energy in J, iron included: sum of currents x linkages, less the co-energy."""
        return float(self.currents @ self.flux_linkage()) - self.coenergy()

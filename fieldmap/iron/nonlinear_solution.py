"""Coils and iron at fixed currents: the fields that every solved state has."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Coil, Section
from fieldmap.iron.elements.potential_form import PotentialState
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.quantities.air import checked_points, containing_element, mean_over_body, refuse_inside
from fieldmap.iron.quantities.forces import Magnetised, force_and_torque
from fieldmap.iron.quantities.magpylib_export import as_magpylib
from fieldmap.iron.quantities.sections import SectionFlux, named_section, section_flux
from fieldmap.iron.report import SolverReport
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class SolvedState:
    """Coils and iron at currents (c,) in A. Fields in T, gradients in T/m, points (n, 3) or (3,) in m."""

    coils: tuple[Coil, ...]
    currents: Array
    mesh: IronMesh
    state: PotentialState

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


@dataclass(frozen=True, eq=False)
class NonlinearSolution(SolvedState):
    """Coils and saturating iron at currents (c,) in A. Fields in T, gradients in T/m, points (n, 3) or (3,) in m.

    iron_linkage (c,) in Wb and iron_coenergy in J: what the iron adds to the coils' flux linkages and to the
    co-energy of their field. Forces, linkages and energies: docs/theory/forces.md.
    """

    report: SolverReport
    iron_linkage: Array
    iron_coenergy: float
    sections: tuple[Section, ...] = ()

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

"""One state of a device with saturating iron: its fields, forces, fluxes and linkages."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import Section
from fieldmap.iron.quantities.forces import Magnetised, force_and_torque
from fieldmap.iron.quantities.magpylib_export import as_magpylib
from fieldmap.iron.quantities.sections import SectionFlux, named_section, section_flux
from fieldmap.iron.report import SolverReport
from fieldmap.iron.solved_state import SolvedState
from fieldmap.sources.inductance import bare_inductance

Array = NDArray[np.float64]


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

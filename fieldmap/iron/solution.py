"""The device with linear iron, solved: total flux density and its gradient for any currents."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Coil, Section
from fieldmap.errors import InputError, Problem
from fieldmap.iron.elements.state import IronState
from fieldmap.iron.mesh.mesh import IronMesh
from fieldmap.iron.quantities.air import (
    checked_currents,
    checked_points,
    containing_element,
    mean_over_body,
    refuse_inside,
)
from fieldmap.iron.quantities.forces import Magnetised, force_and_torque
from fieldmap.iron.quantities.magpylib_export import as_magpylib
from fieldmap.iron.quantities.sections import SectionFlux, named_section, section_flux
from fieldmap.iron.report import SolverReport
from fieldmap.sources import unit_flux_densities, unit_flux_density_and_gradient
from fieldmap.sources.inductance import bare_inductance
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Coils and linear iron, solved once per coil; any currents by superposition.

    Fields in T, gradients G[..., i, j] = dB_i/dx_j in T/m, points (n, 3) or (3,) in m, global frame. The remanence
    of permanent magnets, if any, adds a field that no current changes. Forces, inductances and energy:
    docs/theory/forces.md.

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

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return tuple(coil.name for coil in self.coils)

    @property
    def sources(self) -> tuple[str, ...]:
        """What each column of `unit_fields` is the field of."""
        return tuple(f"1 A in coil '{name}'" for name in self.coil_names)

    def unit_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Total field (c, n, 3) in T/A and gradient (c, n, 3, 3) in T/(m A) of 1 A in each coil, outside the iron.

        Without the field of permanent magnets. Raises InputError for points that are not (n, 3) or not finite, and
        for points inside the iron, where the gradient is not defined by the solver.
        """
        x, _ = checked_points(points)
        refuse_inside(self.mesh, x)
        b, g = self._air_fields(x)
        return b[: len(self.coils)], g[: len(self.coils)]

    def remanent_fields(self, points: ArrayLike) -> tuple[Array, Array]:
        """Field (n, 3) and gradient (n, 3, 3) of the permanent magnets with all currents off, outside the iron."""
        x, _ = checked_points(points)
        refuse_inside(self.mesh, x)
        if not self.has_remanence:
            return np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
        b, g = self._air_fields(x)
        return b[-1], g[-1]

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Flux density (n, 3) at points (n, 3), or (3,) at (3,), for currents (c,) in A.

        Inside the iron it is the mean flux density of the element. Raises InputError as `unit_fields` does, and for
        a wrong number of currents.
        """
        x, single = checked_points(points)
        weights = self._weights(currents)
        b = np.einsum("c,cnd->nd", weights, self._columns(x))
        if self.mesh is not None and self.state is not None:
            element = containing_element(self.mesh, x)
            inside = element >= 0
            b[inside] = np.einsum("c,cnd->nd", weights, self.state.flux_density[:, element[inside]])
        return b[0] if single else b

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Gradient (n, 3, 3) at points (n, 3), or (3, 3) at (3,), for currents (c,) in A; outside the iron only."""
        x, single = checked_points(points)
        weights = self._weights(currents)
        refuse_inside(self.mesh, x)
        g = np.einsum("c,cnij->nij", weights, self._air_fields(x)[1])
        return g[0] if single else g

    def flux_density(self, body: str, currents: ArrayLike) -> Array:
        """Mean flux density (3,) in T over the volume of a named body, for currents (c,) in A."""
        weights = self._weights(currents)
        columns = self.state.flux_density if self.state is not None else np.zeros((len(weights), 0, 3))
        return mean_over_body(self.mesh, body, np.einsum("c,ced->ed", weights, columns))

    def section_flux(self, section: str | Section, currents: ArrayLike) -> SectionFlux:
        """Flux, area and mean normal flux density of a section of the device file, or of any plane, for currents (c,).

        The field inside each element is integrated over what the plane cuts out of it. Raises InputError for an
        unknown name, and for a plane that cuts no iron.
        """
        weights = self._weights(currents)
        return section_flux(self.mesh, self.state, named_section(self.sections, section), weights)

    def section_flux_density(self, section: str | Section, currents: ArrayLike) -> float:
        """Mean flux density in T along the normal of a section; see `section_flux`."""
        return self.section_flux(section, currents).flux_density

    def force_on(self, name: str | Sequence[str], currents: ArrayLike) -> Array:
        """Force (3,) in N on a body or coil, or on several together, for currents (c,) in A.

        Bodies that touch have a force only together: name them all. Raises InputError otherwise, for unknown names
        and for a wrong number of currents.
        """
        return force_and_torque(self._magnetised(currents), name, np.zeros(3))[0]

    def torque_on(self, name: str | Sequence[str], currents: ArrayLike, about: ArrayLike) -> Array:
        """Torque (3,) in N m about a point (3,) in m; otherwise as `force_on`."""
        return force_and_torque(self._magnetised(currents), name, about)[1]

    def inductance(self) -> Array:
        """Inductance matrix (c, c) in H of the coils in their iron; symmetric up to the solver's tolerance.

        Raises InputError for a solution that was stored without its linkages.
        """
        return self._air_inductance + self._iron_linkages()[:, : len(self.coils)]

    def flux_linkage(self, currents: ArrayLike) -> Array:
        """Flux linkages (c,) in Wb (all turns) for currents (c,) in A, the permanent magnets' share included."""
        weights = self._weights(currents)
        return self._air_inductance @ weights[: len(self.coils)] + self._iron_linkages() @ weights

    def energy(self, currents: ArrayLike) -> float:
        """Energy in J that the currents (c,) in A have put into the field: half the sum of I L I."""
        values = checked_currents(currents, self.coil_names)
        return float(0.5 * values @ self.inductance() @ values)

    def as_magpylib(self, currents: ArrayLike) -> Any:
        """A magpylib Collection at currents (c,): iron as tetrahedra of constant polarisation, coils as current sheets.

        Its getB in the air differs from `field` by the iron's discretisation. Raises InputError for a wrong number of
        currents, and for a solution that was read back from a file.
        """
        values = checked_currents(currents, self.coil_names)
        return as_magpylib(self.coils, values, self.mesh, self.state, self._weights(values))

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

    def _magnetised(self, currents: ArrayLike) -> Magnetised:
        values, state = checked_currents(currents, self.coil_names), self.state
        if state is None:
            return Magnetised(self.coils, values)
        return Magnetised(self.coils, values, self.mesh, state.faces, self._weights(values) @ state.density)

    def _weights(self, currents: ArrayLike) -> Array:
        values = checked_currents(currents, self.coil_names)
        return np.append(values, 1.0) if self.has_remanence else values

    def _columns(self, x: Array) -> Array:
        """Field (c, n, 3) of every column: coils, then remanence."""
        b = np.zeros((len(self.coils) + self.has_remanence, len(x), 3))
        b[: len(self.coils)] = unit_flux_densities(self.coils, x)
        if self.state is not None:
            b += self.state.faces.field(x, self.state.density)
        return b

    def _air_fields(self, x: Array) -> tuple[Array, Array]:
        columns = len(self.coils) + self.has_remanence
        b, g = np.zeros((columns, len(x), 3)), np.zeros((columns, len(x), 3, 3))
        for k, coil in enumerate(self.coils):
            b[k], g[k] = unit_flux_density_and_gradient(coil, x)
        if self.state is not None:
            iron_b, iron_g = self.state.faces.field_and_gradient(x, self.state.density)
            b += iron_b
            g += iron_g
        return b, g

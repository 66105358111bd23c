"""Coils and iron at fixed currents: the fields that every solved state has."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.device.model import Coil
from fieldmap.iron.forms.potential_form import PotentialState
from fieldmap.iron.meshing.mesh import IronMesh
from fieldmap.iron.quantities.air import checked_points, mean_over_body, refuse_inside
from fieldmap.iron.quantities.inside import containing_element
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient

Array = NDArray[np.float64]


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

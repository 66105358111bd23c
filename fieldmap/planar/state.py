"""A planar device with saturating iron, solved at one set of currents."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.errors import InputError, Problem
from fieldmap.planar.boundary_operator import BoundaryOperator
from fieldmap.planar.conductors import complex_points
from fieldmap.planar.iron_energy import IronTriangles
from fieldmap.planar.model import PlanarDevice
from fieldmap.planar.plane_geometry import inside
from fieldmap.planar.solution import (
    PlanarReport,
    as_field,
    as_gradient,
    checked_currents,
    conductor_derivatives,
    field_places,
    harmonic_derivatives,
)
from fieldmap.typing import Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class PlanarState:
    """Field of saturating iron at fixed currents (n_coils,), A.

    reaction: what iron and walls add to the conductors' vector potential, at the nodes of the air's operator, T m.
    iron and potential: the triangles and the total vector potential at their points.
    """

    device: PlanarDevice
    currents: Array
    air: BoundaryOperator
    reaction: Array
    iron: IronTriangles
    potential: Array
    report: PlanarReport

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.device.coil_names

    def field(self, points: ArrayLike) -> Array:
        """Flux density (n, 2) of (B_x, B_z) in T at points (n, 2) of (x, z) in m, outside iron and conductors."""
        return as_field(self.derivatives(points)[0])

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient (n, 2, 2), G[i, j] = dB_i/dx_j in T/m, at points as in `field`."""
        return as_gradient(self.derivatives(points)[1])

    def derivatives(self, points: ArrayLike, currents: ArrayLike | None = None) -> Complex:
        """f = B_x - i B_z and its first two derivatives (3, n) by x + i z.

        currents: may be given again, as for linear iron; InputError if they are others. Also for points in iron, in
        conductors or outside the walls.
        """
        if currents is not None and not np.array_equal(
            checked_currents(self.device, currents), self.currents
        ):
            raise InputError(
                Problem("PlanarState(currents)", "those it was solved at", f"{currents}", "solve again")
            )
        places = field_places(self.device, points)
        for body in self.device.bodies:
            if inside(places, complex_points(body.corners)).any():
                must = "points outside the iron; iron_flux_density has the field inside"
                raise InputError(Problem("PlanarState(points)", must, f"points in {body.name}", "move them"))
        total = conductor_derivatives(self.device, self.currents, places)
        return np.asarray(-1j * (total + harmonic_derivatives(self.air, self.reaction, places)))

    def iron_flux_density(self, body: str) -> tuple[Array, Array]:
        """Middles (t, 2) in m of a body's triangles, and the flux density (t, 2) of (B_x, B_z) in T in them."""
        names = [known.name for known in self.device.bodies]
        if body not in names:
            raise InputError(
                Problem("PlanarState(body)", f"one of {', '.join(names)}", f"{body!r}", "choose one of them")
            )
        mine = self.iron.body == names.index(body)
        middle = self.iron.points[self.iron.triangles[mine]].mean(axis=1)
        gradient = self.iron.gradient(self.potential)[mine]
        return np.column_stack([middle.real, middle.imag]), np.column_stack([-gradient.imag, gradient.real])

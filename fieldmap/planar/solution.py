"""A solved planar device: field and derivatives at any point, for any currents."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.kernels.plane import segment_derivatives
from fieldmap.planar.boundary_operator import BoundaryOperator
from fieldmap.planar.conductors import coil_derivatives, complex_points, rectangle, wires
from fieldmap.planar.model import PlanarDevice, RoundWire
from fieldmap.planar.plane_geometry import inside

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class PlanarReport:
    """What a solution cost and rests on: panels on iron and walls, unknowns, seconds, assumptions."""

    iron_panels: int
    wall_panels: int
    unknowns: int
    seconds: float
    assumptions: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Region:
    """A domain, its boundary operator and its boundary values per ampere of each coil (nodes, coils)."""

    polygon: Complex | None
    operator: BoundaryOperator
    values: Array


@dataclass(frozen=True, eq=False)
class PlanarSolution:
    """Linear in the currents. `regions` are the bodies in their order, `air` is the rest."""

    device: PlanarDevice
    regions: tuple[Region, ...]
    air: Region
    report: PlanarReport

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.device.coil_names

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Flux density (n, 2) of (B_x, B_z) in T at points (n, 2) of (x, z) in m; currents (n_coils,) in A.

        Anywhere but inside a conductor and outside the walls, where InputError is raised.
        """
        first, _, _ = self.derivatives(points, currents)
        return np.column_stack([first.real, -first.imag])

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """Gradient (n, 2, 2), G[i, j] = dB_i/dx_j in T/m: symmetric, without trace. Arguments as in `field`."""
        _, second, _ = self.derivatives(points, currents)
        return np.stack([second.real, -second.imag, -second.imag, -second.real], axis=-1).reshape(-1, 2, 2)

    def derivatives(self, points: ArrayLike, currents: ArrayLike) -> Complex:
        """f = B_x - i B_z and its first two derivatives (3, n) by x + i z: d2Bz/dx2 = -Im f''."""
        places = self._places(points)
        amperes = self._amperes(currents)
        total = np.zeros((3, len(places)), dtype=complex)
        for coil, ampere in zip(self.device.coils, amperes, strict=True):
            total += ampere * coil_derivatives(coil, places)
        outside = np.ones(len(places), dtype=bool)
        for region in self.regions:
            assert region.polygon is not None
            mine = inside(places, region.polygon)
            outside &= ~mine
            total[:, mine] += _derivatives(region, places[mine], amperes)
        if self.air.operator.panels.size:
            total[:, outside] += _derivatives(self.air, places[outside], amperes)
        return -1j * total

    def _places(self, points: ArrayLike) -> Complex:
        """Points as complex numbers; InputError for those without a field."""
        array = check_signal("PlanarSolution(points)", points, 2).reshape(-1, 2)
        places = complex_points(array)
        for coil in self.device.coils:
            for centre in wires(coil)[0]:
                if isinstance(coil.wire, RoundWire):
                    bad = np.abs(places - centre) < coil.wire.radius * (1 - 1e-9)
                else:
                    bad = inside(places, rectangle(centre, coil.wire))
                _refuse(array, bad, f"outside the conductors of coil {coil.name}", "move the point")
        if self.device.walls is not None:
            beyond = ~inside(places, complex_points(self.device.walls))
            _refuse(array, beyond, "inside the walls", "move the point, or widen the walls")
        return places

    def _amperes(self, currents: ArrayLike) -> Array:
        count = len(self.device.coils)
        return check_signal("PlanarSolution(currents)", currents, count).reshape(count)


def _derivatives(region: Region, places: Complex, amperes: Array) -> Complex:
    """Complex derivatives (3, n) of a region's own harmonic part."""
    operator = region.operator
    densities = operator.densities(region.values @ amperes)
    return segment_derivatives(places, operator.starts, operator.ends, densities)


def _refuse(points: Array, bad: NDArray[np.bool_], must: str, remedy: str) -> None:
    if bad.any():
        x, z = 1e3 * points[int(np.flatnonzero(bad)[0])]
        received = f"({x:g}, {z:g}) mm ({int(bad.sum())} such)"
        raise InputError(Problem("PlanarSolution(points)", f"must lie {must}", received, remedy))

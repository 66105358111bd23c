"""Solved planar devices: the field at fixed currents, and the solution that is linear in them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_signal
from fieldmap.errors import InputError
from fieldmap.field import Currents, coil_currents
from fieldmap.kernels.iron.plane import segment_derivatives
from fieldmap.planar.boundary_operator import BoundaryOperator
from fieldmap.planar.conductors import coil_derivatives, complex_points, rectangle, wires
from fieldmap.planar.geometry import inside
from fieldmap.planar.model import PlanarDevice, RoundWire
from fieldmap.records import Record
from fieldmap.typing import Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True, repr=False)
class PlanarReport(Record):
    """Cost and assumptions of a solution: panels on iron and walls, unknowns, seconds of this process, assumptions.

    residuals: of Newton's steps, relative; empty where the iron is linear.
    """

    iron_panels: int
    wall_panels: int
    unknowns: int
    seconds: float
    assumptions: tuple[str, ...]
    residuals: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class PlanarFieldAtCurrents(Record, ABC):
    """Field of a planar device at fixed currents (n_coils,), A; points (n, 2) of (x, z) in m."""

    device: PlanarDevice
    currents: Array

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return self.device.coil_names

    @abstractmethod
    def derivatives(self, points: ArrayLike) -> Complex:
        """f = B_x - i B_z and its first two derivatives by x + i z: d2Bz/dx2 = -Im f''.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.

        Returns
        -------
        Complex
            Derivatives (3, n), T, T/m and T/m^2.

        Raises
        ------
        InputError
            For points in a conductor or outside the walls.
        """

    def field(self, points: ArrayLike) -> Array:
        """Flux density, where `derivatives` has a value.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.

        Returns
        -------
        Array
            (B_x, B_z) (n, 2), T.

        Raises
        ------
        InputError
            As for `derivatives`.
        """
        return as_field(self.derivatives(points)[0])

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the flux density: symmetric, without trace.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.

        Returns
        -------
        Array
            G (n, 2, 2), G[i, j] = dB_i/dx_j, T/m.

        Raises
        ------
        InputError
            As for `derivatives`.
        """
        return as_gradient(self.derivatives(points)[1])


@dataclass(frozen=True, eq=False, repr=False)
class Region(Record):
    """A domain, its boundary operator and its boundary values per ampere of each coil (nodes, coils)."""

    polygon: Complex | None
    operator: BoundaryOperator
    values: Array


@dataclass(frozen=True, eq=False, repr=False)
class PlanarSolution(Record):
    """Linear in the currents. `regions` are the bodies in their order, `air` is the rest.

    Currents: (n_coils,) in A, one number for all coils, or a mapping by name.
    """

    device: PlanarDevice
    regions: tuple[Region, ...]
    air: Region
    report: PlanarReport

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return self.device.coil_names

    def at(self, currents: Currents) -> LinearPlanarState:
        """The field at these currents.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        LinearPlanarState
            The field as a function of points.

        Raises
        ------
        InputError
            For currents that do not fit the coils.
        """
        return LinearPlanarState(self.device, planar_currents(self.device, currents), self)

    def field(self, points: ArrayLike, currents: Currents) -> Array:
        """Flux density anywhere but inside a conductor and outside the walls.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            (B_x, B_z) (n, 2), T.

        Raises
        ------
        InputError
            For points without a field.
        """
        return self.at(currents).field(points)

    def gradient(self, points: ArrayLike, currents: Currents) -> Array:
        """Gradient of the flux density: symmetric, without trace.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            G (n, 2, 2), G[i, j] = dB_i/dx_j, T/m.

        Raises
        ------
        InputError
            As for `field`.
        """
        return self.at(currents).gradient(points)

    def derivatives(self, points: ArrayLike, currents: Currents) -> Complex:
        """f = B_x - i B_z and its first two derivatives by x + i z: d2Bz/dx2 = -Im f''.

        Parameters
        ----------
        points
            Positions (n, 2) of (x, z), m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Complex
            Derivatives (3, n), T, T/m and T/m^2.

        Raises
        ------
        InputError
            As for `field`.
        """
        return self.at(currents).derivatives(points)


@dataclass(frozen=True, eq=False, repr=False)
class LinearPlanarState(PlanarFieldAtCurrents):
    """A planar device with linear iron at fixed currents."""

    solution: PlanarSolution

    def derivatives(self, points: ArrayLike) -> Complex:
        """f = B_x - i B_z and its first two derivatives (3, n) by x + i z, inside the iron too."""
        places, amperes, air = field_places(self.device, points), self.currents, self.solution.air
        total = conductor_derivatives(self.device, amperes, places)
        outside = np.ones(len(places), dtype=bool)
        for region in self.solution.regions:
            assert region.polygon is not None
            mine = inside(places, region.polygon)
            outside &= ~mine
            total[:, mine] += harmonic_derivatives(region.operator, region.values @ amperes, places[mine])
        total[:, outside] += harmonic_derivatives(air.operator, air.values @ amperes, places[outside])
        return -1j * total


def as_field(f: Complex) -> Array:
    """Field (n, 2) of (B_x, B_z) from f = B_x - i B_z."""
    return np.column_stack([f.real, -f.imag])


def as_gradient(slope: Complex) -> Array:
    """Gradient (n, 2, 2), G[i, j] = dB_i/dx_j, from f'."""
    return np.stack([slope.real, -slope.imag, -slope.imag, -slope.real], axis=-1).reshape(-1, 2, 2)


def field_places(device: PlanarDevice, points: ArrayLike) -> Complex:
    """Points (n, 2) as complex numbers. Raises InputError for points in a conductor or outside the walls."""
    array = check_signal("planar field(points)", points, 2).reshape(-1, 2)
    places = complex_points(array)
    for coil in device.coils:
        for centre in wires(coil)[0]:
            if isinstance(coil.wire, RoundWire):
                bad = np.abs(places - centre) < coil.wire.radius * (1 - 1e-9)
            else:
                bad = inside(places, rectangle(centre, coil.wire))
            _refuse(array, bad, f"outside the conductors of coil {coil.name}", "move the point")
    if device.walls is not None:
        beyond = ~inside(places, complex_points(device.walls))
        _refuse(array, beyond, "inside the walls", "move the point, or widen the walls")
    return places


def planar_currents(device: PlanarDevice, currents: Currents) -> Array:
    """A copy of the currents (n_coils,) in A. Raises InputError for currents that do not fit the coils."""
    return np.array(coil_currents(currents, device.coil_names))


def conductor_derivatives(device: PlanarDevice, amperes: Array, places: Complex) -> Complex:
    """First three derivatives (3, n) of the conductors' complex potential."""
    total = np.zeros((3, len(places)), dtype=complex)
    for coil, ampere in zip(device.coils, amperes, strict=True):
        total += ampere * coil_derivatives(coil, places)
    return total


def harmonic_derivatives(operator: BoundaryOperator, values: Array, places: Complex) -> Complex:
    """First three derivatives (3, n) of the harmonic function with these boundary values (nodes,), at places inside."""
    if not operator.panels.size:
        return np.zeros((3, len(places)), dtype=complex)
    return segment_derivatives(places, operator.starts, operator.ends, operator.densities(values))


def _refuse(points: Array, bad: NDArray[np.bool_], must: str, remedy: str) -> None:
    if bad.any():
        x, z = 1e3 * points[int(np.flatnonzero(bad)[0])]
        received = f"({x:g}, {z:g}) mm ({int(bad.sum())} such)"
        raise InputError.of("planar field(points)", f"must lie {must}", received, remedy)

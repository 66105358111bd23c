"""The drive unit with saturating iron: solved states, and interpolation along rays of currents, for S11 to S15."""

from abc import abstractmethod
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device import Device, Payload, read_device
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.field import Bounds, Field, FieldLike
from fieldmap.iron import NonlinearSolution, NonlinearSolver
from fieldmap.levitation import GRAVITY
from fieldmap.lookup import FieldMap, interpolate
from fieldmap.provenance import fingerprint
from fieldmap.store import Grid, MapData
from fieldmap.thesis import detail
from fieldmap.thesis.detail import FOLDER
from fieldmap.thesis.kept import Kept
from fieldmap.thesis.vertical_sensor import magnet_height
from fieldmap.typing import Array

DEVICE = "drive_unit"
PACKAGES = ("kernels", "inputs", "device", "field", "currents", "sources", "iron")
"""Packages and modules with code that a state depends on."""
FILE = "thesis_states_{:g}.cache"
TOLERANCE = 1e-3
SPACING = 4e-3
LOWER, UPPER = np.array([-16e-3, -16e-3, -132e-3]), np.array([16e-3, 16e-3, -84e-3])
"""The box around the magnet's positions in chapters 6 and 7, for any h from 7 to 25 mm."""


class WeightedStates(Field):
    """A field of the drive unit as a weighted sum of states. A state is a map with one "coil", to be used at 1 A."""

    @property
    def bounds(self) -> Bounds:
        """The box, m."""
        return LOWER, UPPER

    @abstractmethod
    def shares(self, currents: Array) -> list[tuple[float, FieldMap]]:
        """Weights and states at currents (6,), A."""

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self._sum("field", points, currents)

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self._sum("gradient", points, currents)

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self._sum("second_gradient", points, currents)

    def _sum(self, what: str, points: ArrayLike, currents: ArrayLike) -> Array:
        weights, states = zip(*self.shares(np.asarray(currents, dtype=float)), strict=True)
        return np.tensordot(weights, [getattr(state, what)(points, [1.0]) for state in states], axes=1)


class UnitStates(WeightedStates):
    """The drive unit at any currents: a field that solves a state for each new set of currents.

    refinement divides the mesh sizes of the device file. folder: where solved states are cached (None: in memory
    only), for the same device, refinement, tolerance, libraries and code of the packages that solve. Values of the
    solver at the nodes of a grid of 4 mm are interpolated by harmonic polynomials.
    """

    def __init__(self, refinement: float = 1.0, folder: Path | None = FOLDER) -> None:
        self.refinement, self._folder = refinement, folder
        # Maps, not states: `NonlinearSolver.at` would hold every solved state in memory, and a cached file holds no
        # state. A solve starts from the state that was solved last, as the cached ones did.
        self._fields: dict[str, FieldMap] = {}
        self._last: NonlinearSolution | None = None
        self.solved = 0

    @cached_property
    def device(self) -> Device:
        """The drive unit."""
        return read_device(DEVICE)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.device.coil_names

    def shares(self, currents: Array) -> list[tuple[float, FieldMap]]:
        """The state at these currents, solved if it is not cached."""
        key = str((np.round(currents, 9) + 0.0).tolist())
        if key not in self._fields:
            nodes = self._kept.arrays(key, lambda: self._solve(currents))
            self._fields[key] = harmonic_map(_grid(), ("state",), **nodes)
        return [(1.0, self._fields[key])]

    @cached_property
    def _kept(self) -> Kept:
        numbers = (self.refinement, TOLERANCE, SPACING, *LOWER, *UPPER)
        mark = fingerprint((*self.device.texts, repr(numbers)), PACKAGES)
        return Kept(None if self._folder is None else self._folder / FILE.format(self.refinement), mark)

    @cached_property
    def _solver(self) -> NonlinearSolver:
        return NonlinearSolver(self.device, refinement=self.refinement)

    def _solve(self, currents: Array) -> dict[str, Array]:
        self._last = self._solver.solve(currents, TOLERANCE, start=self._last)
        self.solved += 1
        points = _grid().points()
        return {"flux_density": self._last.field(points), "gradient": self._last.gradient(points)}


def harmonic_map(grid: Grid, names: tuple[str, ...], flux_density: Array, gradient: Array) -> FieldMap:
    """A map of values per ampere, T and T/m, at the nodes of a grid, interpolated by harmonic polynomials."""
    shape = (len(names), *grid.shape)
    flux, slope = flux_density.reshape(*shape, 3), gradient.reshape(*shape, 3, 3)
    data = MapData(grid, names, np.ones(len(names)), flux_density=flux, gradient=slope)
    return interpolate(data, kind="harmonic")


def _grid() -> Grid:
    shape = np.rint((UPPER - LOWER) / SPACING).astype(int) + 1
    return Grid(LOWER, np.full(3, SPACING), tuple(int(k) for k in shape))  # type: ignore[arg-type]


PANELS = ((1.0, 1.558, 2.2), (1.558, 2.2, 3.0), (3.0, 3.6, 4.3), (3.6, 4.3, 5.2))
"""Mean currents, A, at which states on a ray are solved: three per parabola. `_ENDS` are the mean currents at which
the next panel takes over; 1.558 A is (7-18) at z_s = 10 mm."""
_ENDS = np.array([1.558, 3.0, 4.3, 5.2])


class UnitRays(WeightedStates):
    """A field of the drive unit for currents in any proportion with a mean of 1.0 to 5.2 A.

    States are interpolated along the ray of proportional currents. Raises OutsideMapError for other means.
    """

    def __init__(self, states: UnitStates) -> None:
        self.states = states

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.states.coil_names

    def shares(self, currents: Array) -> list[tuple[float, FieldMap]]:
        """The states on the ray of these currents, with the weights of the parabola through them."""
        mean = float(currents.mean())
        levels = _panel(mean)
        return [
            (weight, self.states.shares(currents * (level / mean))[0][1])
            for level, weight in zip(levels, _lagrange(levels, mean), strict=True)
            if weight != 0.0
        ]


@detail.cached
def unit_states() -> UnitStates:
    """States of the unit on the shipped mesh, or on the coarse mesh of a quick look, cached in maps/out."""
    return UnitStates(refinement=detail.refinement(1.0))


@detail.cached
def unit_rays() -> UnitRays:
    """The unit for any currents."""
    return UnitRays(unit_states())


def payload() -> Payload:
    """The microrobot as a point dipole, as in the thesis (2-11)."""
    return as_dipole(unit_states().device)


def as_dipole(device: Device) -> Payload:
    """The payload of a device with its magnet as a point dipole."""
    assert device.payload is not None
    return replace(device.payload, volume_level=1)


def lift_share(field: FieldLike, z_s: float, h: float, currents: float | Array) -> float:
    """Lift over weight on the axis at currents (6,), A, or one current in all coils; z_s and h in mm."""
    point = np.array([[0.0, 0.0, magnet_height(z_s, 1e-3 * h)]])
    carried = payload()
    force = carried.moment * field.gradient(point, np.full(6, currents))[0, 2, 2]
    return float(force / (carried.mass * GRAVITY))


def _panel(mean: float) -> Array:
    """The three levels for the interpolation of a mean current."""
    if not PANELS[0][0] - 1e-9 <= mean <= PANELS[-1][-1] + 1e-9:
        must = f"must lie within {PANELS[0][0]:g} to {PANELS[-1][-1]:g} A"
        raise OutsideMapError(Problem("mean current", must, f"{mean:g} A", "ask for another level"))
    return np.array(PANELS[int(np.searchsorted(_ENDS, mean - 1e-9))])


def _lagrange(levels: Array, mean: float) -> Array:
    """Weights of the parabola through three levels; at a level its weight is exactly 1."""
    if (near := np.abs(levels - mean) < 1e-9).any():
        return near.astype(float)
    return np.array([np.prod([(mean - b) / (a - b) for b in levels if b != a]) for a in levels])

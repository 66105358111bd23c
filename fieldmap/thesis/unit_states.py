"""States of the drive unit with saturating iron, one for each set of currents: solved once, kept in a file."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device import read_device
from fieldmap.device.model import Device
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import FieldMap, interpolate
from fieldmap.maps.generation import OUTPUT_FOLDER
from fieldmap.provenance import fingerprint
from fieldmap.store import Grid, KeptState, MapData, StateArchive
from fieldmap.typing import Array

DEVICE = "drive_unit"
ROOMS = ("kernels", "device", "sources", "iron")
"""Rooms whose code decides a state."""
FILE = "thesis_states.h5"
TOLERANCE = 1e-3
SPACING = 4e-3
LOWER, UPPER = np.array([-16e-3, -16e-3, -132e-3]), np.array([16e-3, 16e-3, -84e-3])
"""The box around the magnet's places in chapters 6 and 7, for any h from 7 to 25 mm."""
_NEGLIGIBLE = 1e-9
"""Two sets of currents that differ by less than this, A, are one."""


class UnitStates:
    """The drive unit at any currents: a `LevitationField` that solves a state for each new set of them.

    refinement divides the mesh sizes of the device file. folder: where solved states are kept (None: in memory only),
    for the same device, refinement, tolerance, libraries and code of the rooms that solve.
    Fields are taken from the solver at the nodes of a grid of 4 mm and interpolated by harmonic polynomials.
    """

    def __init__(self, refinement: float = 1.0, folder: Path | None = OUTPUT_FOLDER) -> None:
        self.refinement, self._folder = refinement, folder
        self._fields: list[tuple[Array, FieldMap]] = []
        self._read = folder is None
        self._last: object | None = None
        self.solved = 0

    @cached_property
    def device(self) -> Device:
        """The drive unit."""
        return read_device(DEVICE)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in current order."""
        return self.device.coil_names

    @property
    def lower(self) -> Array:
        """Lower corner of the box, m."""
        return LOWER

    @property
    def upper(self) -> Array:
        """Upper corner of the box, m."""
        return UPPER

    def field(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self.at(currents).field(points, [1.0])

    def gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self.at(currents).gradient(points, [1.0])

    def second_gradient(self, points: ArrayLike, currents: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self.at(currents).second_gradient(points, [1.0])

    def at(self, currents: ArrayLike) -> FieldMap:
        """The field of one state (n_coils,) in A: a map of one "coil", to be taken at 1."""
        amperes = np.asarray(currents, dtype=float)
        if not self._read:
            self._archive(self._recall)
            self._read = True
        for known, kept in self._fields:
            if np.abs(known - amperes).max() < _NEGLIGIBLE:
                return kept
        nodes = self._solve(amperes)
        if self._folder is not None:
            number = len(self._fields)
            self._archive(lambda archive: archive.put(number, KeptState(amperes, nodes)))
        return self._keep(amperes, nodes)

    def knows(self, currents: ArrayLike) -> bool:
        """Whether the state is at hand already."""
        return any(np.abs(known - np.asarray(currents)).max() < _NEGLIGIBLE for known, _ in self._fields)

    def _recall(self, archive: StateArchive) -> None:
        while (state := archive.get(len(self._fields))) is not None and not isinstance(state.values, str):
            self._keep(state.currents, state.values)

    def _archive(self, action: Callable[[StateArchive], object]) -> None:
        assert self._folder is not None
        with StateArchive(
            self._folder / FILE.replace(".h5", f"_{self.refinement:g}.h5"), self._fingerprint
        ) as archive:
            action(archive)

    def _keep(self, currents: Array, nodes: Array) -> FieldMap:
        shape = (1, *_grid().shape)
        flux, slope = nodes[: 3 * _grid().size], nodes[3 * _grid().size :]
        data = MapData(
            _grid(),
            ("state",),
            np.ones(1),
            flux_density=flux.reshape(*shape, 3),
            gradient=slope.reshape(*shape, 3, 3),
        )
        kept = interpolate(data, kind="harmonic")
        self._fields.append((currents, kept))
        return kept

    @cached_property
    def _solver(self) -> NonlinearSolver:
        return NonlinearSolver(self.device, refinement=self.refinement)

    def _solve(self, currents: Array) -> Array:
        state = self._solver.solve(currents, TOLERANCE, start=self._last)  # type: ignore[arg-type]
        self._last = state
        self.solved += 1
        points = _grid().points()
        return np.concatenate([state.field(points).ravel(), state.gradient(points).ravel()])

    @property
    def _fingerprint(self) -> str:
        numbers = (self.refinement, TOLERANCE, SPACING, *LOWER, *UPPER)
        return fingerprint((*self.device.texts, repr(numbers)), ROOMS)


def _grid() -> Grid:
    shape = np.rint((UPPER - LOWER) / SPACING).astype(int) + 1
    return Grid(LOWER, np.full(3, SPACING), tuple(int(k) for k in shape))  # type: ignore[arg-type]

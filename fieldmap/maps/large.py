"""Lookups of a large map: polynomials in cells as large as its accuracy allows, made and measured a slab at a time.

A field is smooth over several spacings of a fine grid. So a cell of the lookup spans several cells of the grid along
each axis, as long as its polynomial agrees with the values at the nodes to a hundredth of the solver's tolerance. The
map states the largest difference at any node.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fieldmap.core import CoreMap
from fieldmap.device.model import Device
from fieldmap.errors import InputError, RecipeError
from fieldmap.inputs.document import AtKey
from fieldmap.interpolants import Form, cell_form, global_form
from fieldmap.interpolants.form import plane_potential, running_potential
from fieldmap.interpolants.harmonic_cells import NAME, SIZE, CellFit
from fieldmap.maps.error_bound import UnitFields, bounds_of_forms, difference_to_solver, sample_points
from fieldmap.sources import unit_flux_density_and_gradient
from fieldmap.store import FieldError, Grid, LargeMap, LargeMapWriter, MapData
from fieldmap.store.large_map import bytes_of_numbers, free_space
from fieldmap.typing import Array

STEPS = (8, 4, 2, 1)
"""Numbers of grid cells that a cell of the lookup may span along each axis. The number of grid cells of a large map is
a multiple of the first."""
SHARE = 1e-2
"""Largest difference from the values at the nodes, as a share of the solver's tolerance times the largest field."""
# Bytes of values at the nodes that are in memory at a time, in each of a few arrays.
_AT_A_TIME = 1 << 26
# Fewest cells along each axis of the grid to which the polynomial of the whole box is fitted.
_OF_WHOLE = 12
# Points at which the time of the coils' fields is measured.
_TRIED = 100


def before_the_start(device: Device, grid: Grid, fields: int, target: Path) -> str:
    """Size and duration of a large map, in words.

    Parameters
    ----------
    device
        The device.
    grid
        Grid of the map.
    fields
        Number of fields of the map.
    target
        Path of the map.

    Returns
    -------
    str
        Nodes, size of the file, and the time that the fields of the coils alone take on one processor.

    Raises
    ------
    RecipeError
        If the disk has no room for the map.
    """
    size = bytes_of_numbers(grid, fields) + 8 * grid.size * fields * SIZE // STEPS[1] ** 3
    needed, free = size - LargeMapWriter.written(target), free_space(target)
    if needed > free:
        must_hold = (
            f"must make a map for which its disk has room: {needed / 1e9:.1f} GB for {grid.size} nodes"
        )
        remedy = "take a larger spacing or a smaller box (lengths are in mm), or another disk"
        raise RecipeError(AtKey("spacing_mm", must_hold, f"{free / 1e9:.1f} GB free", remedy))
    points = grid.points(0, 1)[:_TRIED]
    for coil in device.coils:
        unit_flux_density_and_gradient(coil, points[:2])  # compiles the kernels, which is not timed
    begin = perf_counter()
    for coil in device.coils:
        unit_flux_density_and_gradient(coil, points)
    minutes = (perf_counter() - begin) / len(points) * grid.size / 60.0
    file = f"{grid.size} nodes, {fields} fields: a file of {size / 1e9:.1f} GB"
    return f"{file}; the fields of the coils alone take {minutes:.0f} minutes of one processor"


def make_cells(writer: LargeMapWriter, tolerance: float, say: Callable[[str], None]) -> tuple[int, Form]:
    """Write the polynomials of the lookup into the file of a large map all of whose parts are written.

    Parameters
    ----------
    writer
        Writer of the map.
    tolerance
        Tolerance of the solver.
    say
        Called with a message about the chosen cells.

    Returns
    -------
    tuple[int, Form]
        Number of grid cells that a cell spans along each axis, and the form with its misfit at all nodes.

    Raises
    ------
    FieldmapError
        If the disk has no room.
    """
    grid, most = writer.info.grid, SHARE * tolerance * writer.largest
    steps = [one for one in STEPS if all((n - 1) % one == 0 and n > one for n in grid.shape)]
    chosen, found = steps[0], np.full(2, np.inf)
    for step in steps:
        smaller = _Cells(writer, step).tried()
        # If half the size helps little, the values at the nodes are not smooth enough for any cell.
        if (smaller > found / 2).all():
            break
        chosen, found = step, smaller
        if (found <= most).all():
            break
    say(f"polynomials in cells of {chosen} x {chosen} x {chosen}")
    misfit = _Cells(writer, chosen).make()
    block = writer.coefficients()
    return chosen, Form(NAME, block, block, misfit)


def certified(
    writer: LargeMapWriter,
    every: int,
    cells: Form,
    of_iron: Mapping[str, Any],
    unit_fields: UnitFields,
    largest_weights: Array,
) -> tuple[LargeMap, FieldError, Mapping[str, FieldError]]:
    """A large map without the values at its nodes, and the differences between its lookups and the solver.

    Parameters
    ----------
    writer
        Writer of the map.
    every, cells
        Results of `make_cells`.
    of_iron
        Reaction, linkages and sensors of the map, on the grid of the lookup.
    unit_fields
        Evaluates the solver's fields.
    largest_weights
        Weights (n_fields,) up to which the bounds hold.

    Returns
    -------
    tuple[LargeMap, FieldError, Mapping[str, FieldError]]
        The map; the largest difference between its cells and the solver at sampled points; bounds by kind of lookup,
        empty if no single polynomial fits the whole box.
    """
    info, reaction = writer.info, of_iron["reaction"]
    grid, whole = info.grid.every(every), _whole_form(writer)
    error = difference_to_solver(cells, info.field_scale, sample_points(grid), unit_fields)
    bounds = {} if whole is None else bounds_of_forms(cells, whole, grid, unit_fields, largest_weights)
    forms = [form for form in (cells, whole) if form is not None]
    data = LargeMap(
        **vars(info),
        every=every,
        blocks={form.kind: form.unit for form in forms},
        misfits={form.kind: form.misfit for form in forms if form.misfit is not None},
        reaction_cells=None if reaction is None else cell_form(reaction.on(grid), "raise").unit,
        **of_iron,
    )
    return data, FieldError(*map(float, error)), bounds


def _whole_form(writer: LargeMapWriter) -> Form | None:
    """The polynomial of the whole box, fitted to a part of the nodes; None if it does not fit the field."""
    grid = writer.info.grid
    steps = [one for one in STEPS if all((n - 1) % one == 0 and n > _OF_WHOLE * one for n in grid.shape)]
    step = steps[0] if steps else 1
    about: dict[str, Any] = vars(writer.info) | {"grid": grid.every(step)}
    shape = len(writer.info.field_names), *about["grid"].shape
    flux, gradient = np.empty((*shape, 3)), np.empty((*shape, 3, 3))
    for i in range(shape[1]):
        flux[:, i], gradient[:, i] = _every(writer.read(i * step), step)
    try:
        return global_form(MapData(**about, flux_density=flux, gradient=gradient), "raise")
    except InputError:
        return None


def _every(pair: tuple[Array, Array], step: int) -> tuple[Array, Array]:
    """Copies of flux density and gradient at every step-th node of a plane."""
    flux, gradient = (values[:, ::step, ::step].copy() for values in pair)
    return flux, gradient


class _Cells:
    """The cells of one size."""

    def __init__(self, writer: LargeMapWriter, step: int) -> None:
        self._writer, self._step = writer, step
        self._fine, self._grid = writer.info.grid, writer.info.grid.every(step)
        self._scale = writer.info.field_scale
        self._fields = len(self._scale)
        self._fit = CellFit(self._grid)
        _, cy, _ = (n - 1 for n in self._grid.shape)
        rows = max(1, _AT_A_TIME // (96 * self._fields * step * self._fine.shape[2]))
        self._rows = [(first, min(first + rows, cy)) for first in range(0, cy, rows)]

    def make(self) -> FieldError:
        """Write the coefficients, and return their largest difference from the values at any node."""
        cx, cy, cz = (n - 1 for n in self._grid.shape)
        size = cz * self._fields * SIZE
        start = self._fit.header(self._fields, "raise")
        self._writer.allocate(NAME, len(start) + cx * cy * size)
        self._writer.put_coefficients(0, start)
        along_x, middle = self._potentials()
        worst, far = np.zeros(2), self._potential_of(0, along_x) - middle
        for i in range(cx):
            near, far = far, self._potential_of(i + 1, along_x) - middle
            for first, last in self._rows:
                coefficients = self._of_rows(i, first, last, np.stack([near, far], axis=1))
                self._writer.put_coefficients(len(start) + (i * cy + first) * size, coefficients.ravel())
                worst = np.maximum(worst, self._difference(i, first, last, coefficients))
        return FieldError(*map(float, worst))

    def tried(self) -> Array:
        """Largest difference (2,) from the values at the nodes in the first, the middle and the last slab. On the
        surface of the box the field is largest and least smooth."""
        _, ny, nz = self._grid.shape
        none, cx, worst = np.zeros((self._fields, 2, ny, nz)), self._grid.shape[0] - 1, np.zeros(2)
        for i in {0, cx // 2, cx - 1}:
            for first, last in self._rows:
                coefficients = self._of_rows(i, first, last, none)
                worst = np.maximum(worst, self._difference(i, first, last, coefficients))
        return worst

    def _potentials(self) -> tuple[Array, Array]:
        """Potentials (n_fields, nx) at the first node of each plane, and (n_fields, 1, 1) at the middle node."""
        firsts = [self._writer.read(i * self._step, 0, 1) for i in range(self._grid.shape[0])]
        value = np.stack([flux[:, 0, 0, 0] for flux, _ in firsts], axis=1)
        slope = np.stack([gradient[:, 0, 0, 0, 0] for _, gradient in firsts], axis=1)
        along_x = running_potential(value, slope, self._grid.spacing[0])
        nx, ny, nz = (n // 2 for n in self._grid.shape)
        return along_x, self._potential_of(nx, along_x)[:, ny : ny + 1, nz : nz + 1]

    def _potential_of(self, i: int, along_x: Array) -> Array:
        """Potential (n_fields, ny, nz) in a plane."""
        plane = self._writer.read(i * self._step)
        return plane_potential(along_x[:, i], *_every(plane, self._step), self._grid.spacing)

    def _of_rows(self, i: int, first: int, last: int, potential: Array) -> Array:
        """Coefficients of rows of cells between planes i and i + 1."""
        e = self._step
        pairs = [_every(self._writer.read(p * e, first * e, last * e + 1), e) for p in (i, i + 1)]
        flux, gradient = (np.stack(arrays, axis=1) for arrays in zip(*pairs, strict=True))
        return self._fit.slab(flux, gradient, potential[:, :, first : last + 1])[0]

    def _difference(self, i: int, first: int, last: int, coefficients: Array) -> Array:
        """Largest difference (2,) of these polynomials from the values at all nodes of their cells."""
        e, (x, y, z) = self._step, self._fine.axes
        h, lower = self._grid.spacing, self._grid.lower + self._grid.spacing * [i, first, 0]
        cells = Grid(lower, h, (2, last - first + 1, self._grid.shape[2]))
        core = CoreMap(np.concatenate([self._fit.header(self._fields, "clamp", cells), coefficients.ravel()]))
        rows = y[first * e : last * e + 1]

        def of_plane(plane: int) -> Array:
            flux, gradient = self._writer.read(plane, first * e, last * e + 1)
            mesh = np.meshgrid(x[plane : plane + 1], rows, z, indexing="ij")
            points = np.stack([axis.ravel() for axis in mesh], axis=1)
            ours, slopes = (np.empty((len(points), self._fields, *tail)) for tail in ((3,), (3, 3)))
            core.each_field(points, ours, slopes)
            total = np.zeros((2, len(points)))
            for k, scale in enumerate(self._scale):
                total[0] += scale * np.linalg.norm(ours[:, k] - flux[k].reshape(-1, 3), axis=1)
                total[1] += scale * np.linalg.norm(slopes[:, k] - gradient[k].reshape(-1, 3, 3), axis=(1, 2))
            return total.max(axis=1)

        return np.max([of_plane(plane) for plane in range(i * e, (i + 1) * e + 1)], axis=0)

"""Maps for mag_manip (ETH Zurich, Tesla_core): writer and reader of the YAML of its linear model on vector fields.

    name: TITLE
    vfields:
      coil_00:  {dim_x, dim_y, dim_z, min_x, max_x, ..., data: [[Bx, By, Bz], ...]}     T at 1 A, z fastest

Behaviour of its reader (`ForwardModelLinearVField`), from the source of Tesla_core 4.0.1 (mag_control/mag_manip) and
confirmed in the wheel mag_manip 3.0.0:

- It takes node (i, j, k) from `i dim_x dim_y + j dim_y + k` (interpolate_regular.h:325). The data are in the order
  that its documentation asks for only where the three counts are equal, so a map is resampled to equal counts.
- It interpolates by cubics whose slopes at the nodes are central differences, one-sided ones in the outermost nodes
  (interpolate_tricubic.cpp:50, interpolate_regular.cpp:58). The error of the outermost cells falls only with the
  square of the spacing; the number of nodes keeps it small.
- It sorts the coils' keys as texts (forward_model_linear_vfield.cpp:126), so coils are numbered in the order of
  currents; a comment has their names.
- Numbers of the file become single precision. A point on or beyond the rounded faces is an error
  (interpolate_regular.h:153, interpolate_regular.cpp:77), so the faces are rounded outwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldmap.errors import InputError, MapFileError
from fieldmap.extras import require
from fieldmap.field import coil_currents
from fieldmap.file_contents import read_text
from fieldmap.interop.measured_map import MeasuredMap, fit_map
from fieldmap.interop.readings import Measurements
from fieldmap.interop.sampling import sample_grid
from fieldmap.lookup import FieldMap
from fieldmap.records import Record
from fieldmap.store import Grid
from fieldmap.store.whole_files import write_whole
from fieldmap.typing import Array, PathLike

ACCURACY = 1e-4
"""Without a given spacing: largest error of B by the reader's interpolation, as a share of the largest B."""

MOST_NODES = 49
"""Without a given spacing: largest number of nodes per direction. The wheel reads six such coils in over a minute."""

MOST_COILS = 100
"""Largest number of coils that are read."""

Cells = NDArray[np.int64]

_AXES = "xyz"
_POINTS = 1000
# Exceptions while reading a file that is not such a model.
_NO_MODEL = (OSError, LookupError, TypeError, ValueError, AttributeError, OverflowError, RecursionError)
# Relative margin of the faces, so that the box is inside in single precision and with the reader's rounded step.
_ROUNDING = 4e-7


@dataclass(frozen=True, eq=False, repr=False)
class VectorFields(Record):
    """A map sampled for mag_manip.

    flux_density (count, count, count, n_coils, 3), T at 1 A of each coil, on equally spaced nodes from lower to upper
    (3,), m; at fixed currents one field of all coils, named by these currents. map_nodes: of the map along x, y and
    z. flux_error, gradient_error: largest error of the reader's interpolation at 1000 points of the box, with two
    thirds of each coordinate in outermost cells, as a share of the largest value of the same coil there.
    """

    title: str
    coil_names: tuple[str, ...]
    lower: Array
    upper: Array
    flux_density: Array
    map_nodes: tuple[int, int, int]
    flux_error: float
    gradient_error: float

    @property
    def count(self) -> int:
        """Nodes in each direction."""
        return len(self.flux_density)

    @property
    def summary(self) -> str:
        """The resampling of the map, and the error of the reader, in words."""
        before = " x ".join(map(str, self.map_nodes))
        return (
            f"{before} nodes resampled to {self.count} in each direction, because mag_manip reads equal counts only; "
            f"its tricubic interpolation changes B by up to {self.flux_error:.1e} and the gradient by up to "
            f"{self.gradient_error:.1e} of the largest"
        )

    def to_dict(self) -> dict[str, Any]:
        """Nodes of the map and of the file in each direction, and the reader's errors."""
        return {
            "map_nodes": list(self.map_nodes),
            "nodes": [self.count] * 3,
            "flux_error": self.flux_error,
            "gradient_error": self.gradient_error,
        }

    def write(self, path: PathLike) -> Path:
        """Write the file, complete or not at all.

        Parameters
        ----------
        path
            Path of the file.

        Returns
        -------
        Path
            The path.

        Raises
        ------
        InputError
            For a path that cannot be written.
        """
        lines = [
            f"# coils in current order: {_plain(', '.join(self.coil_names))}",
            f"# {self.summary}",
            f'name: "{_plain(self.title)}"',
            "vfields:",
        ]
        digits = max(2, len(str(len(self.coil_names) - 1)))
        for k in range(len(self.coil_names)):
            lines += [f"  coil_{k:0{digits}d}:", "    data:"]
            data = self.flux_density[..., k, :].reshape(-1, 3).tolist()
            lines += [f"    - [{x:.9g}, {y:.9g}, {z:.9g}]" for x, y, z in data]
            for axis, low, high in zip(_AXES, self.lower.tolist(), self.upper.tolist(), strict=True):
                sides = f"dim_{axis}: {self.count}", f"min_{axis}: {low:.9g}", f"max_{axis}: {high:.9g}"
                lines += [f"    {side}" for side in sides]
        return write_whole(path, "\n".join(lines) + "\n", "field for mag_manip")


def write_mag_manip(
    field: FieldMap, path: PathLike, spacing: float | None = None, currents: object = None
) -> Path:
    """Write a map for mag_manip, on the nodes of `sample_for_mag_manip`.

    Parameters
    ----------
    field
        The map.
    path
        Path of the file.
    spacing
        As for `sample_for_mag_manip`.
    currents
        As for `sample_for_mag_manip`.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        For a map of saturating iron without currents, because mag_manip superposes coils; for a map with a field that
        no current drives, which mag_manip cannot hold; for invalid currents, and for a spacing that is not positive.
    """
    return sample_for_mag_manip(field, spacing, currents).write(path)


def sample_for_mag_manip(
    field: FieldMap, spacing: float | None = None, currents: object = None
) -> VectorFields:
    """Sample a map over its whole box on equal numbers of nodes in the three directions.

    The number is at least the largest number of nodes of the map, and large enough that the reader's interpolation
    keeps `ACCURACY`, up to `MOST_NODES`.

    Parameters
    ----------
    field
        The map.
    spacing
        Largest distance of the nodes, m, which then sets their number.
    currents
        Currents (n_coils,), A, of a single field, for which the program's current is a factor.

    Returns
    -------
    VectorFields
        The fields on the nodes.

    Raises
    ------
    InputError
        As for `write_mag_manip`.
    """
    if field.fixed_sources:
        must_hold = "must be a map of coils alone: mag_manip gives no field at zero currents"
        received = f"a field that no current drives, of {', '.join(field.fixed_sources)}"
        remedy = "add that field yourself, and write a map of the device without it"
        raise InputError.of("sample_for_mag_manip(field)", must_hold, received, remedy)
    if currents is None and not field.proportional:
        must_hold = "must be given for a map of saturating iron: mag_manip adds the fields of coils"
        remedy = "give currents, or --currents on the command line"
        raise InputError.of("sample_for_mag_manip(currents)", must_hold, "none", remedy)
    count = max(sample_grid(field, spacing).shape)
    source = _Source(tuple(field.coil_names), field.unit_field, field.unit_gradient)
    if currents is not None:
        amperes = coil_currents(currents, field.coil_names)
        fixed, pairs = field.at(amperes), zip(field.coil_names, amperes.tolist(), strict=True)
        name = ", ".join(f"{value:.9g} A in coil {coil}" for coil, value in pairs)
        source = _Source((name,), lambda x: fixed.field(x)[:, None], lambda x: fixed.gradient(x)[:, None])
    sampled = _sample(field, source, count)
    while spacing is None and sampled.flux_error > ACCURACY and count < MOST_NODES:
        # The outermost cells, where the error is largest, converge with the square of the spacing.
        wanted = 1 + int(np.ceil((count - 1) * np.sqrt(sampled.flux_error / ACCURACY)))
        count = min(max(wanted, count + 1), MOST_NODES)
        sampled = _sample(field, source, count)
    return sampled


class _Source(NamedTuple):
    """The fields to write: their names, B (n, n_fields, 3) and gradient (n, n_fields, 3, 3) at points (n, 3)."""

    names: tuple[str, ...]
    field: Callable[[Array], Array]
    gradient: Callable[[Array], Array]


def _sample(field: FieldMap, source: _Source, count: int) -> VectorFields:
    room = _ROUNDING * np.maximum(np.abs(field.lower), np.abs(field.upper))
    lower, upper = np.array([field.lower - room, field.upper + room], np.float32).astype(np.float64)
    grid = Grid(lower, (upper - lower) / (count - 1), (count, count, count))
    flux = source.field(np.clip(grid.points(), field.lower, field.upper))
    flux = flux.reshape(count, count, count, -1, 3)
    cells, shares = _places(count)
    points = np.clip(grid.lower + (cells + shares) * grid.spacing, field.lower, field.upper)
    read, slope = _tricubic(flux, cells, shares)
    errors = _share(read, source.field(points)), _share(slope / grid.spacing, source.gradient(points))
    title = field.info.provenance.title or "fieldmap"
    return VectorFields(title, source.names, lower, upper, flux, field.info.grid.shape, *errors)


def _places(count: int) -> tuple[Cells, Array]:
    """Cells (n, 3) and positions in them, 0 to 1; a third of each coordinate in the first, the last and any cell."""
    rng = np.random.default_rng(0)
    any_cell = rng.integers(0, count - 1, (_POINTS, 3))
    which = rng.integers(0, 3, any_cell.shape)
    cells = np.where(which == 0, 0, np.where(which == 1, count - 2, any_cell))
    return cells, rng.random(any_cell.shape)


def _tricubic(flux: Array, cells: Cells, shares: Array) -> tuple[Array, Array]:
    """The reader's interpolation: B (n, n_coils, 3), and derivatives (n, n_coils, 3, 3) by position in the cells."""
    count = len(flux)
    value, slope = _weights(cells, shares, count)
    nodes = np.clip(cells[:, None] + np.arange(-1, 3)[:, None], 0, count - 1)
    near = flux[nodes[:, :, None, None, 0], nodes[:, None, :, None, 1], nodes[:, None, None, :, 2]]

    def summed(x: Array, y: Array, z: Array) -> Array:
        found: Array = np.einsum("pi,pj,pk,pijkcb->pcb", x, y, z, near, optimize=True)
        return found

    x, y, z = np.moveaxis(value, 1, 0)
    dx, dy, dz = np.moveaxis(slope, 1, 0)
    derivatives = (summed(dx, y, z), summed(x, dy, z), summed(x, y, dz))
    return summed(x, y, z), np.stack(derivatives, axis=-1)


def _weights(cells: Cells, shares: Array, count: int) -> tuple[Array, Array]:
    """Weights (n, 3, 4) of the nodes -1, 0, 1 and 2 of a cell, and their derivatives by position.

    The tricubic of Lekien and Marsden (2005) with differences of products as its derivatives is the product of three
    cubic Hermite interpolations, each with the differences of its own direction as slopes.
    """
    t = shares
    cubics = (2 * t**3 - 3 * t**2 + 1, 3 * t**2 - 2 * t**3, t**3 - 2 * t**2 + t, t**3 - t**2)
    slopes = (6 * t**2 - 6 * t, 6 * t - 6 * t**2, 3 * t**2 - 4 * t + 1, 3 * t**2 - 2 * t)
    hermite, change = np.stack(cubics, axis=-1), np.stack(slopes, axis=-1)
    from_values = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0]])
    first = np.where((cells == 0)[..., None], [0, -1.0, 1, 0], [-0.5, 0, 0.5, 0])
    last = np.where((cells == count - 2)[..., None], [0, -1.0, 1, 0], [0, -0.5, 0, 0.5])
    parts = np.stack([*np.broadcast_to(from_values[:, None, None], (2, *first.shape)), first, last], axis=-2)
    value, slope = (np.einsum("paf,pafn->pan", factors, parts) for factors in (hermite, change))
    return value, slope


def _share(read: Array, exact: Array) -> float:
    """Largest difference of a coil divided by its largest value, for the worst coil; both (n, n_coils, ...)."""
    points, coils = exact.shape[:2]
    off, size = (
        np.linalg.norm(part.reshape(points, coils, -1), axis=-1).max(axis=0) for part in (read - exact, exact)
    )
    return float(np.max(off / np.where(size > 0, size, 1.0)))


def read_mag_manip(path: PathLike, spacing: float | None = None) -> MeasuredMap:
    """Read a map from a mag_manip file of vector fields.

    Harmonic polynomials are fitted as to measured readings, so fields and gradients have no curl and divergence; the
    report states the error. Coils have the names and the order of the file.

    Parameters
    ----------
    path
        Path of the file.
    spacing
        Largest distance of the map's nodes, m.

    Returns
    -------
    MeasuredMap
        The map.

    Raises
    ------
    MapFileError
        If the file is not such a model.
    FieldmapError
        If PyYAML is not installed.
    """
    yaml = require("yaml", "mag-manip", "read_mag_manip")
    source = Path(path)
    text = read_text(source, MapFileError)
    try:
        content = yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        fields = content["vfields"]
        if not 0 < len(fields) <= MOST_COILS:
            raise ValueError(f"{len(fields)} vfields, where 1 to {MOST_COILS} are read")
        coils = {str(key): _coil(value) for key, value in sorted(fields.items())}
    except (*_NO_MODEL, yaml.YAMLError) as error:
        must_hold = "must be a mag_manip file with vfields: dim_, min_, max_ of x, y, z, and data"
        received = " ".join(str(error).split())[:80] or type(error).__name__
        raise MapFileError.of(str(source), must_hold, received, "check the file") from None
    grids, flux = zip(*coils.values(), strict=True)
    points = [grid.points() for grid in grids]
    currents = np.repeat(np.eye(len(coils)), [len(part) for part in points], axis=0)
    readings = Measurements(tuple(coils), np.concatenate(points), currents, np.concatenate(flux))
    step = min(float(np.min(grid.spacing)) for grid in grids)
    return fit_map(readings, step if spacing is None else spacing)


def _coil(entry: dict[str, Any]) -> tuple[Grid, np.ndarray]:
    low, high = (np.array([float(entry[f"{end}_{axis}"]) for axis in _AXES]) for end in ("min", "max"))
    nx, ny, nz = (int(entry[f"dim_{axis}"]) for axis in _AXES)
    shape = (nx, ny, nz)
    if min(shape) < 2 or not np.isfinite([low, high]).all():
        raise ValueError(f"{nx}, {ny}, {nz} nodes from {low} to {high}")
    data = entry["data"]
    # This check comes before any array is made, because YAML aliases let a small file expand to 1e9 numbers.
    if not isinstance(data, list) or len(data) != nx * ny * nz or not all(map(_is_vector, data)):
        raise ValueError(f"data that are not {nx * ny * nz} times three numbers")
    return Grid(low, (high - low) / (np.array(shape) - 1), shape), np.array(data, dtype=np.float64)


def _is_vector(row: Any) -> bool:
    return isinstance(row, list) and len(row) == 3 and all(isinstance(one, int | float) for one in row)


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() and c not in '"\\' else " " for c in text)

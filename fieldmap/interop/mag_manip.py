"""Maps for mag_manip (ETH Zurich, Tesla_core): the YAML of its linear model on vector fields, and the way back.

    name: TITLE
    vfields:
      coil_00:  {dim_x, dim_y, dim_z, min_x, max_x, ..., data: [[Bx, By, Bz], ...]}     T at 1 A, z fastest

The reader sorts the keys as texts, so coils are numbered in current order; their names stand in a comment. Numbers are
single precision there, gradients are differences, and nothing makes them curl-free: the program loses what the map has.
"""

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.errors import MapFileError, Problem
from fieldmap.interop.measured_map import MeasuredMap, fit_map
from fieldmap.interop.measurements import Measurements
from fieldmap.interop.sampling import sample_grid
from fieldmap.lookup import FieldMap
from fieldmap.store import Grid
from fieldmap.store.whole_files import write_whole

_AXES = "xyz"


def write_mag_manip(field: FieldMap, path: str | PathLike[str], spacing: float | None = None) -> Path:
    """Write a map for mag_manip, on the map's own nodes or on new ones at most `spacing` (m) apart.

    Raises InputError for a map of saturating iron, which that model cannot hold, or a spacing that is not positive.
    """
    grid = sample_grid(field, spacing)
    # Rounding must not put the outermost nodes outside.
    flux = field.unit_field(np.clip(grid.points(), field.lower, field.upper))
    title = field.info.provenance.title or "fieldmap"
    lines = [
        f"# coils in current order: {', '.join(field.coil_names)}",
        f'name: "{_plain(title)}"',
        "vfields:",
    ]
    digits = max(2, len(str(len(field.coil_names) - 1)))
    for k in range(len(field.coil_names)):
        lines += [f"  coil_{k:0{digits}d}:", "    data:"]
        lines += [f"    - [{x:.9g}, {y:.9g}, {z:.9g}]" for x, y, z in flux[:, k]]
        for a, axis in enumerate(_AXES):
            lines += [f"    dim_{axis}: {grid.shape[a]}"]
            lines += [
                f"    min_{axis}: {float(field.lower[a]):.9g}",
                f"    max_{axis}: {float(field.upper[a]):.9g}",
            ]
    target = Path(path)
    write_whole(target, ("\n".join(lines) + "\n").encode())
    return target


def read_mag_manip(path: str | PathLike[str], spacing: float | None = None) -> MeasuredMap:
    """A map from a mag_manip file of vector fields (needs PyYAML), its nodes at most `spacing` (m) apart.

    Harmonic polynomials are fitted to its numbers as to measured ones, which restores gradients free of curl and
    divergence; the report says how well. Coils are named as in the file, in its order of currents. Raises MapFileError
    if the file is no such model.
    """
    import yaml

    source = Path(path)
    try:
        with source.open(encoding="utf-8") as stream:
            content = yaml.load(stream, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        coils = {str(key): _coil(value) for key, value in sorted(content["vfields"].items())}
    except (
        OSError,
        UnicodeDecodeError,
        yaml.YAMLError,
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
    ) as error:
        must_hold = "must be a mag_manip file with vfields: dim_, min_, max_ of x, y, z, and data"
        raise MapFileError(Problem(str(source), must_hold, str(error)[:80], "check the file")) from None
    count = len(coils)
    points = [grid.points() for grid, _ in coils.values()]
    currents = np.repeat(np.eye(count), [len(part) for part in points], axis=0)
    flux = np.concatenate([part for _, part in coils.values()])
    where = np.concatenate(points)
    step = min(float(np.min(grid.spacing)) for grid, _ in coils.values())
    return fit_map(Measurements(tuple(coils), where, currents, flux), step if spacing is None else spacing)


def _coil(entry: dict[str, Any]) -> tuple[Grid, np.ndarray]:
    low, high = (np.array([float(entry[f"{end}_{axis}"]) for axis in _AXES]) for end in ("min", "max"))
    nx, ny, nz = (int(entry[f"dim_{axis}"]) for axis in _AXES)
    shape = (nx, ny, nz)
    grid = Grid(low, (high - low) / (np.array(shape) - 1), shape)
    flux = np.array(entry["data"], dtype=np.float64)
    if flux.shape != (grid.size, 3):
        raise ValueError(f"data of shape {flux.shape} for {grid.size} nodes")
    return grid, flux


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() and c not in '"\\' else " " for c in text)

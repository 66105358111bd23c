"""Static fields of other programs in HDF5, on a rectangular grid: `FieldMesh` of openPMD-beamphysics.

Standard: openPMD 1.1 with its extension BeamPhysics, external fields (doi:10.5281/zenodo.1167843).
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import MapFileError
from fieldmap.store.map_format import UNREADABLE
from fieldmap.typing import Array

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MOST_NODES = 5_000_000


def is_hdf5(path: Path) -> bool:
    """Whether a file begins with the signature of HDF5; False if it cannot be read."""
    try:
        with path.open("rb") as stream:
            return stream.read(len(_SIGNATURE)) == _SIGNATURE
    except OSError:
        return False


def read_field_mesh(path: Path) -> tuple[Array, Array]:
    """Points (n, 3), m, and flux density (n, 3), T, of the only external field of a file.

    Raises MapFileError for a file without one or with several, for a field that is not static or not on a rectangular
    grid, and for a damaged file.
    """
    try:
        with h5py.File(path, "r") as file:
            return _read(path, file)
    except MapFileError:
        raise
    except (*UNREADABLE, MemoryError) as error:
        must, remedy = "must be an undamaged external field of openPMD", "write it again"
        raise MapFileError.of(str(path), must, str(error).partition("\n")[0], remedy) from error


def _read(path: Path, file: h5py.File) -> tuple[Array, Array]:
    fields = _fields(file)
    must, remedy = "must hold one external field of openPMD (FieldMesh)", "write one field into each file"
    _check(len(fields) == 1, path, must, f"{len(fields)} fields", remedy)
    field = file[fields[0]]
    geometry, harmonic = _text(field.attrs.get("gridGeometry", "")), int(field.attrs.get("harmonic", 0))
    must, remedy = "must be a static field on a rectangular grid", "resample it on x, y and z"
    labels = [_text(label) for label in field.attrs.get("axisLabels", ())]
    static = geometry == "rectangular" and harmonic == 0 and labels == ["x", "y", "z"]
    _check(static, path, must, f"{geometry or 'no'} geometry, axes {labels}, harmonic {harmonic}", remedy)
    lower, spacing, shape = (
        np.asarray(field.attrs[name]) for name in ("gridOriginOffset", "gridSpacing", "gridSize")
    )
    must = f"must have at most {MOST_NODES} nodes"
    _check(0 < np.prod(shape.astype(float)) <= MOST_NODES, path, must, f"{shape.tolist()}", "resample it")
    axes = [start + step * np.arange(count) for start, step, count in zip(lower, spacing, shape, strict=True)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    scale = float(field.attrs.get("fieldScale", 1.0))
    parts = [
        scale * _component(field["magneticField"][axis], tuple(shape.tolist())).ravel() for axis in "xyz"
    ]
    return points, np.stack(parts, axis=1)


def _fields(file: h5py.File) -> list[str]:
    place = _text(file.attrs.get("externalFieldPath", ""))
    if not place:
        return [f"/{name}" for name in file if "magneticField" in file[name]]
    before, sign, _ = place.partition("%T")
    return [f"{before}{name}" for name in file[before]] if sign else [place]


def _component(data: Any, shape: tuple[int, ...]) -> Array:
    """A component in T. A constant component is stored as an attribute; numbers may be complex."""
    values = data[()] if isinstance(data, h5py.Dataset) else np.full(shape, data.attrs["value"])
    if values.shape != shape:
        raise ValueError(f"a component of shape {values.shape} on a grid of {shape}")
    return np.real(values) * float(data.attrs.get("unitSI", 1.0))


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _check(holds: bool, path: Path, must: str, received: str, remedy: str) -> None:
    if not holds:
        raise MapFileError.of(str(path), must, received, remedy)

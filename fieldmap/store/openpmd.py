"""The part of a map file that follows the openPMD 1.1 standard, for other programs.

Standard: openPMD 1.1.0 (doi:10.5281/zenodo.1167843); external fields as openPMD-beamphysics reads them.
All strings are of fixed length.
"""

from typing import Any

import h5py
import numpy as np

from fieldmap.store.map_data import NO_CURRENT, Grid, MapData, MapInfo
from fieldmap.store.map_format import FLUX_DENSITY, QUANTITIES, Quantity, planes_per_chunk, record_names
from fieldmap.typing import Array


def write_openpmd(file: h5py.File, map_data: MapInfo) -> None:
    """Write every field at its reference current, their sum, and all groups and attributes. For a description without
    numbers the data sets are only allocated, each contiguous."""
    grid = map_data.grid
    _write_root(file, map_data)
    iteration = file.create_group("/data/0")
    iteration.attrs.update(time=np.float64(0), dt=np.float64(0), timeUnitSI=np.float64(1))
    comment = "total, every coil at its reference current"
    total = _total(map_data) if isinstance(map_data, MapData) else None
    record = _write_record(file, FLUX_DENSITY, "", grid, comment, total)
    record.attrs["referenceCurrent"] = map_data.reference_current
    names = record_names(map_data.field_names)
    for number, (name, part, scale) in enumerate(
        zip(map_data.field_names, names, map_data.field_scale, strict=True)
    ):
        for quantity in QUANTITIES:
            values = None
            if isinstance(map_data, MapData):
                values = getattr(map_data, quantity.name)[number].reshape(
                    *grid.shape, len(quantity.components)
                )
            comment = quantity.comment.format(_source(map_data, name, scale))
            record = _write_record(file, quantity, part, grid, comment, values, scale)
            _describe(record.id, **of_source(name, scale))
    for number, (name, part) in enumerate(zip(map_data.field_names, names, strict=True), start=1):
        _link_external_field(file, number, part, grid, "none" if name == NO_CURRENT else f"I_{part}")


def _total(map_data: MapData) -> Array:
    """(nx, ny, nz, 3): the sum of the fields at their reference currents, T."""
    total = np.zeros((*map_data.grid.shape, 3))
    each = zip(map_data.reference_weights, map_data.field_scale, map_data.flux_density, strict=True)
    for weight, scale, flux in each:
        total += weight * (flux * scale)
    return total


def _source(info: MapInfo, name: str, scale: float) -> str:
    if name == NO_CURRENT:
        return f"what no current drives: {', '.join(info.fixed_sources)}"
    if name not in info.coil_names:
        return f"saturating iron, {name} at weight 1"
    without = "" if info.reduced_model is None else ", without iron"
    return f'coil "{name}" alone at {scale:g} A{without}'


def fixed(text: str) -> np.bytes_:
    """A text as a string of fixed length, at least one byte long, because HDF5 has no empty ones."""
    return np.bytes_(text.encode() or b" ")


def _write_root(file: h5py.File, info: MapInfo) -> None:
    versions = info.provenance.versions
    texts = {
        "openPMD": "1.1.0",
        "basePath": "/data/%T/",
        "meshesPath": "meshes/",
        "iterationEncoding": "groupBased",
        "iterationFormat": "/data/%T/",
        "author": "fieldmap",
        "software": "fieldmap",
        "softwareVersion": versions.get("fieldmap", "unknown"),
        "softwareDependencies": "; ".join(f"{name} {version}" for name, version in versions.items()),
        "date": info.provenance.created,
        "comment": info.provenance.title,
        "externalFieldPath": "/ExternalFieldPath/%T/",
    }
    for key, text in texts.items():
        file.attrs[key] = fixed(text)
    file.attrs["openPMDextension"] = np.uint32(0)


def on_grid(grid: Grid) -> dict[str, Any]:
    """Attributes of a record that give the positions of its nodes."""
    return {"gridSpacing": grid.spacing, "gridGlobalOffset": grid.lower}


def of_source(name: str, scale: float) -> dict[str, Any]:
    """Attributes of a record that give its source and the current, A."""
    return {"coilName": fixed(name), "referenceCurrent": np.float64(scale)}


def of_record(unit: Array) -> dict[str, Any]:
    """The other attributes that openPMD prescribes for a record."""
    return {
        "geometry": fixed("cartesian"),
        "dataOrder": fixed("C"),
        "axisLabels": np.array([b"x", b"y", b"z"]),
        "gridUnitSI": np.float64(1),
        "unitDimension": unit,
        "timeOffset": np.float64(0),
    }


def of_component(unit: Array) -> dict[str, Any]:
    """Attributes that openPMD prescribes for a component of a record."""
    return {"unitSI": np.float64(1), "position": np.zeros(3), "unitDimension": unit}


def _write_record(
    file: h5py.File,
    quantity: Quantity,
    field: str,
    grid: Grid,
    comment: str,
    values: Array | None,
    scale: float = 1.0,
) -> h5py.Group:
    """Write a record with its attributes. values (nx, ny, nz, n components) are multiplied by scale; None only
    allocates the data sets."""
    record = file.create_group(quantity.path(field))
    _describe(record.id, **of_record(quantity.unit), **on_grid(grid), comment=fixed(comment))
    # The low-level calls of HDF5 are used, because the high-level ones of h5py take longer than the writing.
    kind, space = h5py.h5t.IEEE_F64LE, h5py.h5s.create_simple(grid.shape)
    created = in_one_piece() if values is None else _storage(grid)
    for c, component in enumerate(quantity.components):
        data = h5py.h5d.create(record.id, component.encode(), kind, space, dcpl=created)
        if values is not None:
            data.write(h5py.h5s.ALL, h5py.h5s.ALL, values[..., c] * scale)
        _describe(data, **of_component(quantity.unit))
    return record


def _storage(grid: Grid) -> h5py.h5p.PropDCID:
    """Properties of a component's data set: chunks with checksums, NaN for a missing chunk, no time stamp."""
    created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    created.set_chunk((planes_per_chunk(grid), *grid.shape[1:]))
    created.set_fletcher32()
    created.set_fill_value(np.array(np.nan))
    created.set_obj_track_times(False)
    return created


def in_one_piece() -> h5py.h5p.PropDCID:
    """Properties of a data set of a large map: contiguous, and allocated when it is created."""
    created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    created.set_layout(h5py.h5d.CONTIGUOUS)
    created.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    created.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    created.set_obj_track_times(False)
    return created


def _describe(target: h5py.h5g.GroupID | h5py.h5d.DatasetID, **attributes: Any) -> None:
    """Write new attributes: arrays, numbers, texts of fixed length."""
    for name, value in attributes.items():
        values = np.asarray(value)
        kind = h5py.h5t.py_create(values.dtype)
        space = h5py.h5s.create_simple(values.shape)
        h5py.h5a.create(target, name.encode(), kind, space).write(values, mtype=kind)


def _link_external_field(file: h5py.File, number: int, record: str, grid: Grid, master: str) -> None:
    """Write the entry that `FieldMesh` of openPMD-beamphysics reads: attributes and a soft link to the numbers."""
    group = file.create_group(f"/ExternalFieldPath/{number}")
    _describe(
        group.id,
        eleAnchorPt=fixed("beginning"),
        gridGeometry=fixed("rectangular"),
        axisLabels=np.array([b"x", b"y", b"z"]),
        gridLowerBound=np.zeros(3, dtype=np.int64),
        gridOriginOffset=grid.lower,
        gridSpacing=grid.spacing,
        gridSize=np.array(grid.shape, dtype=np.int64),
        harmonic=np.int64(0),
        fieldScale=np.float64(1),
        masterParameter=fixed(master),
    )
    group["magneticField"] = h5py.SoftLink(FLUX_DENSITY.path(record))

"""The part of a map file that follows the openPMD 1.1 standard, for other programs.

Standard: openPMD 1.1.0 (doi:10.5281/zenodo.1167843); external fields as openPMD-beamphysics reads them.
All strings are of fixed length.
"""

from collections.abc import Sequence
from typing import Any

import h5py
import numpy as np

from fieldmap.store.map_data import NO_CURRENT, Grid, MapData, MapInfo
from fieldmap.store.map_format import MESHES, TENSOR, VECTOR, planes_per_chunk, record_names
from fieldmap.typing import Array

# Powers of length, mass, time, current, temperature, amount, luminous intensity.
TESLA = np.array([0.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0])
TESLA_PER_METRE = np.array([-1.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0])


def write_openpmd(file: h5py.File, map_data: MapData) -> None:
    """Write every field at its reference current and their sum, with all groups and attributes around them."""
    grid = map_data.grid
    _write_root(file, map_data)
    iteration = file.create_group("/data/0")
    iteration.attrs.update(time=np.float64(0), dt=np.float64(0), timeUnitSI=np.float64(1))
    comment = "total, every coil at its reference current"
    record = _write_record(file, "B", VECTOR, TESLA, grid, comment, _total(map_data))
    record.attrs["referenceCurrent"] = map_data.reference_current
    names = record_names(map_data.field_names)
    each = zip(
        map_data.field_names,
        names,
        map_data.field_scale,
        map_data.flux_density,
        map_data.gradient.reshape(*map_data.gradient.shape[:-2], 9),
        strict=True,
    )
    for name, part, scale, flux, tensor in each:
        of = _source(map_data, name, scale)
        comment = f"flux density of {of}"
        pair = [_write_record(file, f"B_{part}", VECTOR, TESLA, grid, comment, flux, scale)]
        comment = f"gradient of the flux density of {of}; component xy is dB_x/dy"
        pair += [_write_record(file, f"gradB_{part}", TENSOR, TESLA_PER_METRE, grid, comment, tensor, scale)]
        for record in pair:
            _describe(record.id, coilName=fixed(name), referenceCurrent=np.float64(scale))
    for number, part in enumerate(names, start=1):
        driven = map_data.field_names[number - 1] != NO_CURRENT
        _link_external_field(file, number, part, grid, f"I_{part}" if driven else "none")


def _total(map_data: MapData) -> Array:
    """(nx, ny, nz, 3): the sum of the fields at their reference currents, T."""
    total = np.zeros((*map_data.grid.shape, 3))
    for weight, scale, flux in zip(
        map_data.reference_weights, map_data.field_scale, map_data.flux_density, strict=True
    ):
        total += weight * (flux * scale)
    return total


def _source(info: MapInfo, name: str, scale: float) -> str:
    if info.constant_field and name == NO_CURRENT:
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


def _write_record(
    file: h5py.File,
    name: str,
    components: Sequence[str],
    unit: np.ndarray,
    grid: Grid,
    comment: str,
    values: Array,
    scale: float = 1.0,
) -> h5py.Group:
    """Write a record with its attributes. values (nx, ny, nz, n components) are multiplied by scale."""
    record = file.create_group(f"{MESHES}/{name}")
    _describe(
        record.id,
        geometry=fixed("cartesian"),
        dataOrder=fixed("C"),
        axisLabels=np.array([b"x", b"y", b"z"]),
        gridSpacing=grid.spacing,
        gridGlobalOffset=grid.lower,
        gridUnitSI=np.float64(1),
        unitDimension=unit,
        timeOffset=np.float64(0),
        comment=fixed(comment),
    )
    # The low-level calls of HDF5 are used, because the high-level ones of h5py take longer than the writing.
    kind, space, created = h5py.h5t.IEEE_F64LE, h5py.h5s.create_simple(grid.shape), _storage(grid)
    for c, component in enumerate(components):
        data = h5py.h5d.create(record.id, component.encode(), kind, space, dcpl=created)
        data.write(h5py.h5s.ALL, h5py.h5s.ALL, values[..., c] * scale)
        _describe(data, unitSI=np.float64(1), position=np.zeros(3), unitDimension=unit)
    return record


def _storage(grid: Grid) -> h5py.h5p.PropDCID:
    """Properties of a component's data set: chunks with checksums, NaN for a missing chunk, no time stamp."""
    created = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    created.set_chunk((planes_per_chunk(grid), *grid.shape[1:]))
    created.set_fletcher32()
    created.set_fill_value(np.array(np.nan))
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
    group["magneticField"] = h5py.SoftLink(f"{MESHES}/B_{record}")

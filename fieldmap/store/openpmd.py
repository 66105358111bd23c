"""The part of a map file that any openPMD 1.1 reader understands, without its numbers.

Standard: openPMD 1.1.0 (doi:10.5281/zenodo.1167843); external fields as openPMD-beamphysics reads them.
All strings are of fixed length.
"""

from collections.abc import Sequence

import h5py
import numpy as np

from fieldmap.store.grid import Grid
from fieldmap.store.map_data import NO_CURRENT, MapInfo
from fieldmap.store.map_format import MESHES, TENSOR, VECTOR, planes_per_chunk, record_names

# Powers of length, mass, time, current, temperature, amount, luminous intensity.
TESLA = np.array([0.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0])
TESLA_PER_METRE = np.array([-1.0, 1.0, -2.0, -1.0, 0.0, 0.0, 0.0])


def create_skeleton(file: h5py.File, info: MapInfo) -> None:
    """Write all groups, attributes and data sets of a map; every number is NaN so far."""
    planes = planes_per_chunk(info.grid)
    _write_root(file, info)
    iteration = file.create_group("/data/0")
    iteration.attrs.update(time=np.float64(0), dt=np.float64(0), timeUnitSI=np.float64(1))
    _create_record(file, "B", VECTOR, TESLA, info.grid, planes, "total, every coil at its reference current")
    file[f"{MESHES}/B"].attrs["referenceCurrent"] = info.reference_current
    records = record_names(info.field_names)
    for name, record, scale in zip(info.field_names, records, info.field_scale, strict=True):
        of = _source(info, name, scale)
        _create_record(file, f"B_{record}", VECTOR, TESLA, info.grid, planes, f"flux density of {of}")
        comment = f"gradient of the flux density of {of}; component xy is dB_x/dy"
        _create_record(file, f"gradB_{record}", TENSOR, TESLA_PER_METRE, info.grid, planes, comment)
        for path in (f"{MESHES}/B_{record}", f"{MESHES}/gradB_{record}"):
            file[path].attrs.update(coilName=fixed(name), referenceCurrent=np.float64(scale))
    for number, record in enumerate(records, start=1):
        driven = info.field_names[number - 1] != NO_CURRENT
        _link_external_field(file, number, record, info.grid, f"I_{record}" if driven else "none")


def _source(info: MapInfo, name: str, scale: float) -> str:
    if info.constant_field and name == NO_CURRENT:
        return f"what no current drives: {', '.join(info.fixed_sources)}"
    if name not in info.coil_names:
        return f"saturating iron, {name} at weight 1"
    without = "" if info.reduced_model is None else ", without iron"
    return f'coil "{name}" alone at {scale:g} A{without}'


def fixed(text: str) -> np.bytes_:
    """Text as a string of fixed length; at least one byte, which HDF5 wants."""
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


def _create_record(
    file: h5py.File,
    name: str,
    components: Sequence[str],
    unit: np.ndarray,
    grid: Grid,
    planes: int,
    comment: str,
) -> None:
    record = file.create_group(f"{MESHES}/{name}")
    record.attrs.update(
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
    # By chunks: h5py writes a number that is given for a whole data set row by row, which takes most of the time.
    nothing = np.full((planes, *grid.shape[1:]), np.nan)
    for component in components:
        data = record.create_dataset(
            component,
            shape=grid.shape,
            dtype="<f8",
            chunks=(planes, *grid.shape[1:]),
            fletcher32=True,
            fillvalue=np.nan,
        )
        # Allocated now: the numbers lie beside what describes them, not all of them behind all descriptions.
        for first in range(0, grid.shape[0], planes):
            data[first : first + planes] = nothing[: grid.shape[0] - first]
        data.attrs.update(unitSI=np.float64(1), position=np.zeros(3), unitDimension=unit)


def _link_external_field(file: h5py.File, number: int, record: str, grid: Grid, master: str) -> None:
    """Entry that openPMD-beamphysics FieldMesh reads: attributes, and a soft link to the numbers."""
    group = file.create_group(f"/ExternalFieldPath/{number}")
    group.attrs.update(
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

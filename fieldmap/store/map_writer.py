"""Writer of map files: from memory, or from chunks of nodes that survive a killed run.

Chunks lie in a `Checkpoint`, TARGET.partial, until the map is complete. The file is written under another name and then
renamed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import MapFileError
from fieldmap.store.checkpoint import Checkpoint, checkpoint_path
from fieldmap.store.map_data import (
    FieldError,
    LargeMap,
    MapData,
    MapInfo,
    StoredFields,
    StoredLinkage,
    StoredReaction,
    StoredSensors,
)
from fieldmap.store.map_format import (
    DIVISION_EXPONENT,
    LINKAGE,
    LOOKUP,
    LOOKUP_REACTION,
    LOOKUP_SENSORS,
    OWN,
    PARAMETRISATION,
    REACTION,
    REACTION_CELLS,
    REDUCED_MODEL,
    REPELLED,
    SENSORS,
    Chunk,
    chunks_of,
    format_of,
    header_of,
    report_of,
    to_json,
    write_text,
)
from fieldmap.store.openpmd import fixed, write_openpmd
from fieldmap.store.reduced_model import ARRAYS, INTEGER, OPTIONAL, ReducedModel
from fieldmap.store.seal import seal_map
from fieldmap.store.whole_files import disk_errors, sync_folder, whole_file
from fieldmap.typing import Array, PathLike

# Largest values, T and T/m. Nodes on edges and wires have larger ones, which only rounding keeps finite.
_SINGULAR = 1e15
# Keys of the header that are not part of the fingerprint of a checkpoint: they have no influence on the numbers of the
# map, or are known only during the run.
_FREE_KEYS = ("created", "title", "record_names")
_CALLED = {
    "recipe_sha256": "recipe",
    "device_sha256": "device file",
    "fingerprint": "fingerprint of device, settings and versions",
    "lower_m": "lower corner",
    "spacing_m": "spacing",
    "reference_current_A": "reference current",
}


def write_map(target: PathLike, data: MapData) -> Path:
    """Write a map from memory. An existing file is replaced in one step.

    Parameters
    ----------
    target
        Path of the file.
    data
        The map.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    MapFileError
        If a number is not finite.
    InputError
        If the file cannot be written.
    FieldmapError
        If the disk is full.
    """
    path = Path(target)
    for chunk in chunks_of(data.grid):
        planes = slice(chunk.first, chunk.last)
        check_finite(path, chunk, data.flux_density[:, planes], data.gradient[:, planes])
    with whole_file(path, "map") as partial:
        file = h5py.File(partial, "w")
        with disk_errors(path):
            with file:
                _write(file, data)
            seal_map(partial)
    sync_folder(path.parent)
    return path


def _write(file: h5py.File, data: MapData) -> None:
    write_openpmd(file, data)
    write_own(file, data)
    _write_reaction(file, data.reaction, REACTION)
    _write_sensors(file, data.sensors, SENSORS)


def write_own(file: h5py.File, data: MapData | LargeMap) -> None:
    """Write the description of a map that is complete, its reduced model and its linkages."""
    own = file.require_group(OWN)
    own.attrs["format_version"] = np.int64(format_of(data))
    write_text(file, "header", to_json(header_of(data)))
    write_text(file, "recipe", data.provenance.recipe_text)
    write_text(file, "device", data.provenance.device_text)
    _write_reduced_model(file, data.reduced_model)
    _write_linkage(file, data.linkage)
    completion = own.create_group("completion")
    completion.attrs["complete"] = np.uint8(1)
    completion["chunks"] = np.ones(len(chunks_of(data.grid)), dtype=np.uint8)
    write_text(file, "report", to_json(report_of(data)))


def write_lookup(file: h5py.File, data: LargeMap) -> None:
    """Write the data for lookups of a large map, except the coefficients of its cells, which are in the file."""
    group = file[LOOKUP]
    group.attrs["every"] = np.int64(data.every)
    for kind, misfit in data.misfits.items():
        if kind not in group:
            group.create_dataset(kind, data=data.blocks[kind])
        group[kind].attrs["misfit"] = [misfit.flux_density, misfit.gradient]
    if data.reaction_cells is not None:
        group.create_dataset(REACTION_CELLS, data=data.reaction_cells)
    _write_reaction(file, data.reaction, LOOKUP_REACTION)
    _write_sensors(file, data.sensors, LOOKUP_SENSORS)


def _write_reduced_model(file: h5py.File, model: ReducedModel | None) -> None:
    """Write one array for each field of the model, with a checksum; nothing if there is no model."""
    if model is None:
        return
    group = file.create_group(REDUCED_MODEL)
    group.attrs[PARAMETRISATION] = fixed(model.parametrisation.to_json())
    for name in (*ARRAYS, DIVISION_EXPONENT):
        values = getattr(model, name)
        if name in OPTIONAL and not values.size:
            continue
        # HDF5 returns the fill value for a missing block. No number of a model has this value, so a loss is noticed.
        missing = -1 if name in INTEGER else np.nan
        checked = {"fletcher32": True, "fillvalue": missing} if values.size else {}
        group.create_dataset(name, data=values, **checked)


def _write_reaction(file: h5py.File, reaction: StoredReaction | None, path: str) -> None:
    """Write the fields of the reaction with checksums; nothing if there is none."""
    if reaction is None:
        return
    group = file.create_group(path)
    group.attrs[REPELLED] = np.int64(reaction.repelled)
    _write_fields(group, reaction)


def _write_sensors(file: h5py.File, sensors: StoredSensors | None, path: str) -> None:
    """Write the field sensors with checksums; nothing if there are none."""
    if sensors is None:
        return
    group = file.create_group(path)
    group.attrs["names"] = fixed(json.dumps(sensors.names))
    for name in ("positions", "axes", "shares"):
        group.create_dataset(name, data=getattr(sensors, name), fletcher32=True, fillvalue=np.nan)
    if sensors.answers is not None:
        _write_fields(group.create_group("answers"), sensors.answers)


def _write_fields(group: h5py.Group, fields: StoredFields) -> None:
    for name in ("flux_density", "gradient"):
        values = getattr(fields, name).astype(np.float32)
        group.create_dataset(name, data=values, fletcher32=True, fillvalue=np.nan)


def _write_linkage(file: h5py.File, linkage: StoredLinkage | None) -> None:
    """Write the flux linkages with checksums; nothing if there are none."""
    if linkage is None or not linkage.constant.size:
        return
    group = file.create_group(LINKAGE)
    for name, values in vars(linkage).items():
        group.create_dataset(name, data=values, fletcher32=True, fillvalue=np.nan)


class MapWriter:
    """The chunks of an unfinished map, in a checkpoint. A context manager; leaving it without `finish` keeps the
    chunks.

    Attributes
    ----------
    target : path of the map file.
    checkpoint : holds the chunks.
    info : description of the map.
    chunks : all chunks of the map.
    resumed : number of chunks that an earlier run has written.
    """

    def __init__(self, target: Path, info: MapInfo, checkpoint: Checkpoint) -> None:
        self.target = target
        self.checkpoint = checkpoint
        self.info = info
        self.chunks = chunks_of(info.grid)
        self.resumed = len(self.chunks) - len(self.missing)

    def __enter__(self) -> MapWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.checkpoint.close()

    def discard(self) -> None:
        """Delete the checkpoint."""
        self.checkpoint.remove()

    @property
    def note(self) -> str:
        """Reason why an existing checkpoint was not used, or ""."""
        return self.checkpoint.note

    @property
    def missing(self) -> tuple[Chunk, ...]:
        """Chunks still to be written."""
        return tuple(chunk for chunk in self.chunks if chunk_key(chunk) not in self.checkpoint)

    def write(self, chunk: Chunk, flux_density: Array, gradient: Array) -> None:
        """Add a chunk to the checkpoint.

        Parameters
        ----------
        chunk
            The chunk.
        flux_density
            (n_fields, planes, ny, nz, 3), T/A for coils.
        gradient
            (n_fields, planes, ny, nz, 3, 3), T/(m A) for coils.

        Raises
        ------
        MapFileError
            If a number is not finite.
        FieldmapError
            If the disk is full.
        """
        check_finite(self.target, chunk, flux_density, gradient)
        self.checkpoint.put(chunk_key(chunk), {"flux_density": flux_density, "gradient": gradient})

    def read(self, chunk: Chunk) -> tuple[Array, Array]:
        """The arrays that `write` stored for a chunk.

        Parameters
        ----------
        chunk
            The chunk.

        Returns
        -------
        tuple[Array, Array]
            Flux density and gradient, as for `write`.

        Raises
        ------
        KeyError
            If it is missing.
        """
        piece = self.checkpoint.get(chunk_key(chunk))
        if piece is None:
            raise KeyError(chunk)
        return piece.arrays["flux_density"], piece.arrays["gradient"]

    def data(self) -> MapData:
        """The map of all chunks. Raises ValueError if one is missing."""
        if self.missing:
            raise ValueError(f"{len(self.missing)} of {len(self.chunks)} chunks are not written yet")
        parts = [self.read(chunk) for chunk in self.chunks]
        flux, gradient = (np.concatenate(arrays, axis=1) for arrays in zip(*parts, strict=True))
        return MapData(**{**vars(self.info), "flux_density": flux, "gradient": gradient})

    def finish(
        self,
        solver_report: Mapping[str, Any],
        assumptions: tuple[str, ...] = (),
        interpolation_error: FieldError | None = None,
        error_bounds: Mapping[str, FieldError] = MappingProxyType({}),
        data: MapData | None = None,
    ) -> Path:
        """Write the map file and remove the checkpoint.

        Parameters
        ----------
        solver_report, assumptions, interpolation_error, error_bounds
            As in `Provenance` and `MapInfo`.
        data
            The map, if it is in memory already; it is read from the chunks unless given.

        Returns
        -------
        Path
            The path.
        """
        whole = self.data() if data is None else data
        source = replace(self.info.provenance, solver_report=solver_report, assumptions=tuple(assumptions))
        path = write_map(
            self.target,
            replace(
                whole, provenance=source, interpolation_error=interpolation_error, error_bounds=error_bounds
            ),
        )
        self.checkpoint.remove()
        return path


def open_writer(target: PathLike, info: MapInfo, resume: bool = True) -> MapWriter:
    """Open the checkpoint of a map, with the chunks that an earlier run has written, if any.

    Earlier chunks are used only if fingerprint, grid, coils and reference currents are those of `info`. Otherwise
    `note` of the result gives the reason.

    Parameters
    ----------
    target
        Path of the map file.
    info
        Description of the map.
    resume
        False to begin without earlier chunks.

    Raises
    ------
    InputError
        If the checkpoint cannot be written, or another run has it open.
    """
    path = Path(target)
    return MapWriter(path, info, Checkpoint(checkpoint_path(path), what_decides(info), resume))


def what_decides(info: MapInfo) -> dict[str, str]:
    """Fingerprint of a map's checkpoint: the inputs that determine its numbers, as texts by name."""
    return {
        _CALLED.get(key, key.replace("_", " ")): json.dumps(value)
        for key, value in header_of(info).items()
        if key not in _FREE_KEYS
    }


def chunk_key(chunk: Chunk) -> str:
    """Key of a part of a map in its checkpoint."""
    return f"chunk {chunk.number}"


def check_finite(target: Path, chunk: Chunk, flux_density: Array, gradient: Array) -> None:
    """Raise MapFileError for a number of a part that is not finite, or is larger than `_SINGULAR`."""
    # This is False for NaN too.
    if all(np.abs(values).max() <= _SINGULAR for values in (flux_density, gradient)):
        return
    raise MapFileError.of(
        f"{target.name}, x-planes {chunk.first} to {chunk.last - 1}",
        "flux density and gradient must be finite at every node",
        f"NaN, infinity or more than {_SINGULAR:g} from the solver",
        "move the box away from wires and from edges of magnets and iron, where the field is singular",
    )

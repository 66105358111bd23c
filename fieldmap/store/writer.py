"""Write a map piece by piece, so that a killed run leaves a file that can be resumed.

Everything is written to TARGET.partial and moved to TARGET in one step at the end. Order on disk: the numbers
of a chunk, then its flag; the structure of the file does not change while chunks are written. So after a kill
at any moment either the flag is missing, or the chunk is whole.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import FieldmapError, Problem
from fieldmap.store.grid import Array
from fieldmap.store.map_data import FieldError, MapData, MapInfo
from fieldmap.store.names import MESHES, OWN, VECTOR, component_paths, record_names
from fieldmap.store.partial import (
    UNREADABLE,
    Chunk,
    begin,
    chunks_of,
    disk_errors,
    partial_path,
    reopen,
    sync_folder,
    to_disk,
)
from fieldmap.store.record import read_text, report_of, to_json, write_text
from fieldmap.store.seal import seal_map


class MapWriter:
    """An open partial map file. Use as a context manager; leaving without `finish` keeps the partial file.

    note: why a partial file that was there is not used, or "". resumed: chunks found done at opening.
    """

    def __init__(self, file: h5py.File, target: Path, info: MapInfo, note: str) -> None:
        self._file = file
        self._target = target
        self.info = info
        self.note = note
        self.chunks = chunks_of(info.grid)
        self._paths = [component_paths(record) for record in record_names(info.field_names)]
        self.resumed = len(self.chunks) - len(self.missing)

    def __enter__(self) -> "MapWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the partial file, as it is."""
        if self._file:
            self._file.close()

    def discard(self) -> None:
        """Close and delete the partial file, unless it already holds finished chunks."""
        keep = len(self.missing) < len(self.chunks)
        self.close()
        if not keep:
            partial_path(self._target).unlink(missing_ok=True)

    @property
    def missing(self) -> tuple[Chunk, ...]:
        """Chunks still to be written."""
        done = self._file[f"{OWN}/completion/chunks"][()]
        return tuple(chunk for chunk in self.chunks if not done[chunk.number])

    def write(self, chunk: Chunk, flux_density: Array, gradient: Array) -> None:
        """Store a chunk: (n_fields, planes, ny, nz, 3) in T/A and (n_fields, planes, ny, nz, 3, 3) in T/(m A).

        Raises FieldmapError if a number is not finite or the disk is full.
        """
        if not (np.isfinite(flux_density).all() and np.isfinite(gradient).all()):
            raise FieldmapError(_not_finite(self._target, chunk))
        tensor = gradient.reshape(*gradient.shape[:-2], 9)
        with disk_errors(self._target):
            for number, (paths, scale) in enumerate(zip(self._paths, self.info.field_scale, strict=True)):
                for values, where in ((flux_density, paths["flux_density"]), (tensor, paths["gradient"])):
                    for c, path in enumerate(where):
                        self._file[path][chunk.first : chunk.last] = values[number, ..., c] * scale
            to_disk(self._file)
            self._file[f"{OWN}/completion/chunks"][chunk.number] = 1
            to_disk(self._file)

    def save_state(self, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> None:
        """Keep a solver's result in the partial file, so that resuming need not solve again."""
        with disk_errors(self._target):
            if f"{OWN}/state" in self._file:
                del self._file[f"{OWN}/state"]
            group = self._file.create_group(f"{OWN}/state")
            for name, values in arrays.items():
                array = np.asarray(values)
                group.create_dataset(name, data=array, fletcher32=bool(array.ndim and array.size) or None)
            write_text(self._file, "state_about", to_json(about))
            to_disk(self._file)
            group.attrs["complete"] = np.uint8(1)
            to_disk(self._file)

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]] | None:
        """What `save_state` kept, or None."""
        try:
            group = self._file[f"{OWN}/state"]
            if group.attrs["complete"] != 1:
                return None
            arrays = {name: group[name][()] for name in group}
            return arrays, json.loads(read_text(self._file[f"{OWN}/state_about"]))
        except UNREADABLE:
            return None

    def read(self, chunk: Chunk) -> tuple[Array, Array]:
        """What `write` stored for a chunk, per ampere."""
        flux: list[Array] = []
        tensor: list[Array] = []
        for paths, scale in zip(self._paths, self.info.field_scale, strict=True):
            for values, where in ((flux, paths["flux_density"]), (tensor, paths["gradient"])):
                parts = [self._file[path][chunk.first : chunk.last] for path in where]
                values.append(np.stack(parts, axis=-1) / scale)
        gradient = np.array(tensor)
        return np.array(flux), gradient.reshape(*gradient.shape[:-1], 3, 3)

    def finish(
        self,
        solver_report: Mapping[str, Any],
        assumptions: tuple[str, ...] = (),
        interpolation_error: FieldError | None = None,
        error_bounds: Mapping[str, FieldError] = MappingProxyType({}),
    ) -> Path:
        """Complete the file and move it to its name. All chunks must be written. Returns the path."""
        if self.missing:
            raise ValueError(f"finish: {len(self.missing)} of {len(self.chunks)} chunks are not written yet")
        info = replace(
            self.info,
            provenance=replace(
                self.info.provenance, solver_report=solver_report, assumptions=tuple(assumptions)
            ),
            interpolation_error=interpolation_error,
            error_bounds=error_bounds,
        )
        with disk_errors(self._target):
            self._write_total()
            for name in ("state", "state_about"):
                if f"{OWN}/{name}" in self._file:
                    del self._file[f"{OWN}/{name}"]
            write_text(self._file, "report", to_json(report_of(info)))
            to_disk(self._file)
            self._file[f"{OWN}/completion"].attrs["complete"] = np.uint8(1)
            to_disk(self._file)
            self._file.close()
            seal_map(partial_path(self._target))
            os.replace(partial_path(self._target), self._target)
            sync_folder(self._target.parent)
        return self._target

    def _write_total(self) -> None:
        weighted = list(zip(record_names(self.info.field_names), self.info.reference_weights, strict=True))
        for chunk in self.chunks:
            for c in VECTOR:
                total = np.zeros((chunk.last - chunk.first, *self.info.grid.shape[1:]))
                for record, weight in weighted:
                    total += weight * self._file[f"{MESHES}/B_{record}/{c}"][chunk.first : chunk.last]
                self._file[f"{MESHES}/B/{c}"][chunk.first : chunk.last] = total


def open_writer(target: str | os.PathLike[str], info: MapInfo, resume: bool = True) -> MapWriter:
    """Open the partial file of `target`, or begin one.

    A partial file is resumed only if its fingerprint, grid, coils and reference currents are those of `info`;
    otherwise it is begun anew and `note` says why. Raises InputError if the place cannot be written to or
    another run is writing there.
    """
    path = Path(target)
    partial = partial_path(path)
    file, note = reopen(partial, info, resume) if partial.exists() else (None, "")
    if file is None:
        file = begin(partial, info)
    return MapWriter(file, path, info, note)


def write_map(target: str | os.PathLike[str], data: MapData) -> Path:
    """Write a whole map from memory. Replaces an existing file in one step; returns the path."""
    with open_writer(target, data, resume=False) as writer:
        for chunk in writer.chunks:
            planes = slice(chunk.first, chunk.last)
            writer.write(chunk, data.flux_density[:, planes], data.gradient[:, planes])
        source = data.provenance
        return writer.finish(
            source.solver_report, source.assumptions, data.interpolation_error, data.error_bounds
        )


def _not_finite(target: Path, chunk: Chunk) -> Problem:
    return Problem(
        f"{target.name}, x-planes {chunk.first} to {chunk.last - 1}",
        "flux density and gradient are finite at every node",
        "NaN or infinity from the solver",
        "move the box away from edges of iron and windings, where a field can be singular",
    )

"""The unfinished file of a large map: numbers are written to their final places, a part of the map at a time.

The file has the layout of every map. Each data set of a field is contiguous, so its place is known before its numbers,
and only one part is in memory. The checkpoint of the map holds the SHA-256 of each part, the places of the data sets,
and all other bytes of the new file, so that bytes that a killed run left between them do no harm.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from io import FileIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import FieldmapError
from fieldmap.store.checkpoint import SUFFIX, Checkpoint
from fieldmap.store.map_data import FieldError, Grid, LargeMap, MapInfo, MappedNumbers
from fieldmap.store.map_format import FLUX_DENSITY, LOOKUP, QUANTITIES, Chunk, chunks_of, record_names
from fieldmap.store.map_writer import check_finite, chunk_key, write_lookup, write_own
from fieldmap.store.openpmd import in_one_piece, write_openpmd
from fieldmap.store.seal import others, seal_map
from fieldmap.store.whole_files import disk_errors, sync_folder
from fieldmap.typing import Array

LARGE = 1 << 29
"""Bytes of numbers above which a map is made as a large one."""
LARGEST_VERIFIED = 1 << 29
"""Most bytes of coefficients that are verified when a map is opened: a third of a second."""
# Memory-mapped numbers must lie at multiples of their size.
_ALIGNED = {"alignment_threshold": 4096, "alignment_interval": 4096}
_LAYOUT = "places of the numbers"
# Numbers per node in a file: three components of the total, and twelve of each field.
_TOTAL, _FIELD = 3, 12


def bytes_of_numbers(grid: Grid, fields: int) -> int:
    """Bytes that the numbers at the nodes fill in a map file.

    Parameters
    ----------
    grid
        Grid of the nodes.
    fields
        Number of fields.

    Returns
    -------
    int
        The bytes.
    """
    return 8 * grid.size * (_TOTAL + _FIELD * fields)


def free_space(target: Path) -> int:
    """Free bytes on the disk of a file that may not exist yet.

    Parameters
    ----------
    target
        Path of the file.

    Returns
    -------
    int
        The bytes.
    """
    return shutil.disk_usage(next(one for one in target.absolute().parents if one.is_dir())).free


class LargeMapWriter:
    """Writes the parts of a large map into a file next to the target.

    Attributes
    ----------
    target : path of the map file.
    checkpoint : records which parts are written.
    info : description of the map; its fields must be known before the first part.
    chunks : all parts of the map.
    """

    def __init__(self, target: Path, info: MapInfo, checkpoint: Checkpoint) -> None:
        self.target, self.checkpoint, self.info = target, checkpoint, info
        self.chunks = chunks_of(info.grid)
        self.path = _path_of_numbers(target)
        self._block = (0, 0)

    def __enter__(self) -> LargeMapWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @staticmethod
    def written(target: Path) -> int:
        """Bytes on the disk of the parts of a map that an earlier run has written; 0 if the system does not tell.

        Parameters
        ----------
        target
            Path of the map.

        Returns
        -------
        int
            The bytes.
        """
        path = _path_of_numbers(target)
        return 512 * getattr(path.stat(), "st_blocks", 0) if path.is_file() else 0

    @cached_property
    def missing(self) -> tuple[Chunk, ...]:
        """Parts that were missing when this was first called. Parts of an earlier run are verified."""
        return tuple(chunk for chunk in self.chunks if not self._is_there(chunk))

    @property
    def resumed(self) -> int:
        """Number of parts that an earlier run has written."""
        return len(self.chunks) - len(self.missing)

    def write(self, chunk: Chunk, flux_density: Array, gradient: Array) -> None:
        """Write a part to its places. It is on the disk when this returns. The errors are those of `MapWriter.write`.

        Parameters
        ----------
        chunk, flux_density, gradient
            As of `MapWriter.write`.
        """
        check_finite(self.target, chunk, flux_density, gradient)
        digest, total = hashlib.sha256(), np.zeros(flux_density.shape[1:])
        sizes = np.zeros((2, *flux_density.shape[1:4]))
        offsets = iter(self._offsets[_TOTAL:])
        begin = chunk.first * self._of_plane
        with disk_errors(self.target):
            for weight, scale, *each in zip(
                self.info.reference_weights, self.info.field_scale, flux_density, gradient, strict=True
            ):
                flux, slope = (values * scale for values in each)
                total += weight * flux
                sizes += np.linalg.norm(flux, axis=-1), np.linalg.norm(slope, axis=(-2, -1))
                for values in (flux, slope.reshape(*slope.shape[:3], 9)):
                    for component in np.moveaxis(values, -1, 0):
                        digest.update(self._put(next(offsets) + begin, component))
            for offset, component in zip(self._offsets, np.moveaxis(total, -1, 0), strict=False):
                digest.update(self._put(offset + begin, component))
            os.fsync(self._file.fileno())
        largest = sizes.reshape(2, -1).max(axis=1).tolist()
        self.checkpoint.put(chunk_key(chunk), about={"sha256": digest.hexdigest(), "largest": largest})

    @property
    def largest(self) -> Array:
        """Largest sum (2,) over the fields of the norms of B, T, and gradient, T/m, at the reference currents."""
        return np.max([self._about(chunk)["largest"] for chunk in self.chunks], axis=0)

    def read(self, plane: int, first: int = 0, last: int | None = None) -> tuple[Array, Array]:
        """Values at nodes of one x-plane of the grid.

        Parameters
        ----------
        plane
            Number of the plane.
        first, last
            Rows of nodes along z, first <= row < last; all rows unless given.

        Returns
        -------
        tuple[Array, Array]
            Flux density (n_fields, rows, nz, 3), T/A for coils, and gradient (n_fields, rows, nz, 3, 3), T/(m A).
        """
        _, ny, nz = self.info.grid.shape
        rows = (ny if last is None else last) - first
        scale = self.info.field_scale
        values = np.empty((len(scale), rows, nz, _FIELD))
        begin = plane * self._of_plane + 8 * first * nz
        for number, offset in enumerate(self._offsets[_TOTAL:]):
            field, component = divmod(number, _FIELD)
            values[field, ..., component] = self._get(offset + begin, rows * nz).reshape(rows, nz)
        values /= scale[:, None, None, None]
        return values[..., :3], values[..., 3:].reshape(len(scale), rows, nz, 3, 3)

    def allocate(self, kind: str, count: int) -> None:
        """Allocate the coefficients of lookups in the file, in place of an earlier allocation.

        Parameters
        ----------
        kind
            Name of the interpolant.
        count
            Number of coefficients.

        Raises
        ------
        FieldmapError
            If the disk has no room for them.
        """
        self._restore()
        if 8 * count > (free := free_space(self.target)):
            must_hold = (
                f"must lie on a disk with {8 * count / 1e9:.1f} GB free for the coefficients of its lookups"
            )
            remedy = "free space on the disk, then run again: finished parts are there"
            raise FieldmapError.of(str(self.target), must_hold, f"{free / 1e9:.1f} GB", remedy)
        with disk_errors(self.target), h5py.File(self.path, "r+", **_ALIGNED) as file:
            space = h5py.h5s.create_simple((count,))
            group = file.create_group(LOOKUP)
            data = h5py.h5d.create(group.id, kind.encode(), h5py.h5t.IEEE_F64LE, space, dcpl=in_one_piece())
            self._block = data.get_offset(), count

    def put_coefficients(self, first: int, values: Array) -> None:
        """Write coefficients.

        Parameters
        ----------
        first
            Index of the first one in the block of `allocate`.
        values
            The coefficients (n,).
        """
        with disk_errors(self.target):
            self._put(self._block[0] + 8 * first, values)

    def coefficients(self) -> Array:
        """The coefficients, memory-mapped."""
        return MappedNumbers.at(str(self.path), *self._block)

    def finish(
        self,
        solver_report: Mapping[str, Any],
        assumptions: tuple[str, ...],
        interpolation_error: FieldError | None,
        error_bounds: Mapping[str, FieldError],
        data: LargeMap,
    ) -> Path:
        """Complete the file, give it its name, and remove the checkpoint.

        Parameters
        ----------
        solver_report, assumptions, interpolation_error, error_bounds
            As in `Provenance` and `MapInfo`.
        data
            The map, without the numbers that were written already.

        Returns
        -------
        Path
            The path.
        """
        source = replace(data.provenance, solver_report=solver_report, assumptions=tuple(assumptions))
        data = replace(
            data, provenance=source, interpolation_error=interpolation_error, error_bounds=error_bounds
        )
        numbers = list(self._places)
        offset, count = self._block
        if 8 * count > LARGEST_VERIFIED:
            numbers.append((offset, 8 * count))
        with disk_errors(self.target):
            with h5py.File(self.path, "r+", **_ALIGNED) as file:
                write_own(file, data)
                write_lookup(file, data)
            seal_map(self.path, sorted(numbers))
            self.close()
            os.replace(self.path, self.target)
        sync_folder(self.target.parent)
        self.checkpoint.remove()
        return self.target

    def close(self) -> None:
        """Close the file of the numbers, which stays for another run."""
        if "_file" in self.__dict__:
            self._file.close()
            del self._file

    def discard(self) -> None:
        """Delete what was written, and the checkpoint."""
        self.close()
        self.path.unlink(missing_ok=True)
        self.checkpoint.remove()

    @property
    def _of_plane(self) -> int:
        """Bytes of one component at the nodes of an x-plane."""
        _, ny, nz = self.info.grid.shape
        return 8 * ny * nz

    @cached_property
    def _file(self) -> FileIO:
        return FileIO(self.path, "r+")

    @cached_property
    def _offsets(self) -> tuple[int, ...]:
        """Offsets of the data sets: the components of the total, then the components of each field."""
        piece = self.checkpoint.get(_LAYOUT)
        if piece is None or not self.path.is_file():
            self._make()
            piece = self.checkpoint.get(_LAYOUT)
        assert piece is not None
        return tuple(piece.about["offsets"])

    @property
    def _places(self) -> list[tuple[int, int]]:
        return [(offset, 8 * self.info.grid.size) for offset in sorted(self._offsets)]

    def _make(self) -> None:
        """Make the file with its openPMD part, in which the numbers are only allocated."""
        plain = MapInfo(**{name: getattr(self.info, name) for name in MapInfo.__dataclass_fields__})
        records = [
            (FLUX_DENSITY, ""),
            *((q, name) for name in record_names(plain.field_names) for q in QUANTITIES),
        ]
        paths = [f"{q.path(name)}/{component}" for q, name in records for component in q.components]
        with disk_errors(self.target):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with h5py.File(self.path, "w", **_ALIGNED) as file:
                write_openpmd(file, plain)
                offsets = [file[path].id.get_offset() for path in paths]
            length = self.path.stat().st_size
            size = 8 * plain.grid.size
            with self.path.open("rb") as file:
                kept = b""
                for offset, count in others([(at, size) for at in sorted(offsets)], length):
                    file.seek(offset)
                    kept += file.read(count)
        between = {"between": np.frombuffer(kept, np.uint8)}
        self.checkpoint.put(_LAYOUT, between, {"offsets": offsets, "length": length})

    def _restore(self) -> None:
        """Restore all bytes except the numbers to the state after `_make`."""
        piece = self.checkpoint.get(_LAYOUT)
        assert piece is not None
        length, left = int(piece.about["length"]), memoryview(piece.arrays["between"].tobytes())
        with disk_errors(self.target):
            self._file.truncate(length)
            for offset, count in others(self._places, length):
                self._put(offset, left[:count])
                left = left[count:]

    def _about(self, chunk: Chunk) -> dict[str, Any]:
        piece = self.checkpoint.get(chunk_key(chunk))
        return {} if piece is None else piece.about

    def _is_there(self, chunk: Chunk) -> bool:
        """Whether the part was written, and its bytes in the file are unchanged."""
        offsets = self._offsets
        about, begin = self._about(chunk), chunk.first * self._of_plane
        if not about:
            return False
        digest, count = hashlib.sha256(), (chunk.last - chunk.first) * self._of_plane // 8
        for offset in (*offsets[_TOTAL:], *offsets[:_TOTAL]):
            digest.update(self._get(offset + begin, count).data)
        return digest.hexdigest() == about["sha256"]

    def _put(self, offset: int, values: Array | memoryview) -> memoryview:
        """Write bytes, or numbers as float64, at an offset of the file. Returns the written bytes."""
        raw = values if isinstance(values, memoryview) else memoryview(values.astype("<f8").tobytes())
        self._file.seek(offset)
        left = raw
        while left:
            left = left[self._file.write(left) :]
        return raw

    def _get(self, offset: int, count: int) -> Array:
        self._file.seek(offset)
        raw = b""
        while len(raw) < 8 * count and (more := self._file.read(8 * count - len(raw))):
            raw += more
        return np.frombuffer(raw.ljust(8 * count, b"\0"), "<f8")


def _path_of_numbers(target: Path) -> Path:
    return target.with_name(f"{target.name}.numbers{SUFFIX}")

"""The partial file of a map being made: begun, found again after a kill, brought safely to disk."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.store.grid import Grid
from fieldmap.store.map_data import MapInfo
from fieldmap.store.names import FORMAT_VERSION, OWN, component_paths, record_names
from fieldmap.store.openpmd import create_skeleton
from fieldmap.store.record import header_of, read_text, to_json, write_text
from fieldmap.store.reduced_model_file import write_reduced_model

# Nodes per chunk: few enough that a killed run loses little, enough that a solver works on many at once.
NODES_PER_CHUNK = 1000
PARTIAL_SUFFIX = ".partial"
# What h5py raises on a file that is not as it should be.
UNREADABLE = (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError)
# Keys of the header in which two runs may differ and still make the same numbers.
FREE_KEYS = ("created", "title")


@dataclass(frozen=True)
class Chunk:
    """The x-planes first <= i < last of the grid."""

    number: int
    first: int
    last: int


def planes_per_chunk(grid: Grid) -> int:
    """How many x-planes are written at a time: depends on the grid alone, so that a resumed run fits."""
    nx, ny, nz = grid.shape
    most = max(1, min(nx, NODES_PER_CHUNK // (ny * nz)))
    return -(-nx // -(-nx // most))  # the same number of chunks, as equal as can be


def chunks_of(grid: Grid) -> tuple[Chunk, ...]:
    """All chunks of a grid, in order."""
    planes = planes_per_chunk(grid)
    starts = range(0, grid.shape[0], planes)
    return tuple(Chunk(n, first, min(first + planes, grid.shape[0])) for n, first in enumerate(starts))


def partial_path(target: Path) -> Path:
    """Where a map is kept while it is being made."""
    return target.with_name(target.name + PARTIAL_SUFFIX)


def begin(partial: Path, info: MapInfo) -> h5py.File:
    """A new partial file: complete structure, every number NaN, no chunk flagged."""
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        file = h5py.File(partial, "x")
    except OSError as error:
        raise InputError(_cannot_write(partial, error)) from error
    with disk_errors(partial):
        create_skeleton(file, info, planes_per_chunk(info.grid))
        own = file.create_group(OWN)
        own.attrs["format_version"] = np.int64(FORMAT_VERSION)
        write_text(file, "header", to_json(header_of(info, planes_per_chunk(info.grid))))
        write_text(file, "recipe", info.provenance.recipe_text)
        write_text(file, "device", info.provenance.device_text)
        write_reduced_model(file, info.reduced_model)
        completion = own.create_group("completion")
        completion.attrs["complete"] = np.uint8(0)
        completion["chunks"] = np.zeros(len(chunks_of(info.grid)), dtype=np.uint8)
        to_disk(file)
    return file


def reopen(partial: Path, info: MapInfo, resume: bool) -> tuple[h5py.File | None, str]:
    """The partial file if it can be resumed, unreadable chunks unflagged; else None and why not."""
    try:
        file = h5py.File(partial, "r+")
    except BlockingIOError as error:
        raise InputError(_cannot_write(partial, error)) from error
    except OSError:
        return None, f"{partial.name} cannot be read: begun anew"
    reason = ""
    try:
        reason = _why_not(file, info) if resume else "begun anew, as asked"
        if not reason:
            damaged = _unflag_damaged(file, info)
            return file, f"{damaged} damaged chunks are computed again" if damaged else ""
    except UNREADABLE:
        reason = "damaged, begun anew"
    file.close()
    return None, f"{partial.name}: {reason}"


def _why_not(file: h5py.File, info: MapInfo) -> str:
    """Why this file cannot be resumed for `info`, or ""."""
    there = json.loads(read_text(file[f"{OWN}/header"]))
    wanted = json.loads(to_json(header_of(info, planes_per_chunk(info.grid))))
    keys = [key for key in wanted if key not in FREE_KEYS and there.get(key) != wanted[key]]
    if keys:
        return f"made with another {', '.join(_readable(key) for key in keys)}, begun anew"
    return ""


def _readable(key: str) -> str:
    names = {
        "recipe_sha256": "recipe",
        "device_sha256": "device file",
        "fingerprint": "fingerprint of device, settings and versions",
        "lower_m": "lower corner",
        "spacing_m": "spacing",
        "reference_current_A": "reference current",
    }
    return names.get(key, key.replace("_", " "))


def _unflag_damaged(file: h5py.File, info: MapInfo) -> int:
    """Unflag every chunk of which a number cannot be read back or is not finite; how many."""
    flags = file[f"{OWN}/completion/chunks"]
    flagged = flags[()]
    records = [component_paths(record) for record in record_names(info.field_names)]
    paths = [path for record in records for group in record.values() for path in group]
    damaged = [c for c in chunks_of(info.grid) if flagged[c.number] and not _sound(file, paths, c)]
    for chunk in damaged:
        flags[chunk.number] = 0
    to_disk(file)
    return len(damaged)


def _sound(file: h5py.File, paths: list[str], chunk: Chunk) -> bool:
    try:
        return all(bool(np.isfinite(file[path][chunk.first : chunk.last]).all()) for path in paths)
    except OSError:  # the checksum of a chunk is wrong
        return False


def to_disk(file: h5py.File) -> None:
    """Everything written so far is on the disk when this returns, not only with the operating system."""
    file.flush()
    handle = os.open(file.filename, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Bring a renaming to disk; where folders cannot be opened, the operating system does it in its time."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn a failure to write into an error that says what to do."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        remedy = "free space on the disk or write elsewhere, then run again: finished parts are kept"
        raise FieldmapError(Problem(str(path), "can be written", _first_line(error), remedy)) from error


def _cannot_write(partial: Path, error: OSError) -> Problem:
    if isinstance(error, BlockingIOError):
        return Problem(
            str(partial),
            "one run writes a map at a time",
            "a file that another run has open",
            "wait for that run or end it, or choose another output",
        )
    remedy = "choose a folder that exists and that you may write to"
    return Problem(str(partial), "a file that can be written", _first_line(error), remedy)


def _first_line(error: BaseException) -> Any:
    return str(error).splitlines()[0] if str(error) else type(error).__name__

"""Read a map file, believing nothing: complete, undamaged, self-contained, and saying one thing only."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.errors import InputError, MapFileError, Problem
from fieldmap.store.grid import Array, Grid
from fieldmap.store.map_data import MapData, MapInfo
from fieldmap.store.names import FORMAT_VERSION, OWN, component_paths, record_names
from fieldmap.store.openpmd import fixed
from fieldmap.store.partial import PARTIAL_SUFFIX, UNREADABLE
from fieldmap.store.record import info_from, read_text, sha256
from fieldmap.store.reduced_model_file import REDUCED_MODEL, read_reduced_model
from fieldmap.store.seal import REMAKE, check_seal
from fieldmap.store.trust import Refused, hard, is_hard, stored


def read_map(path: str | os.PathLike[str]) -> MapData:
    """The map in the file at `path`, with all of its numbers, per ampere of coil current.

    Raises MapFileError if the file is missing, not byte for byte what was sealed when it was finished, not written by
    fieldmap or by another version, not complete, holds numbers that are not finite, or would take its numbers from
    another file. Links are not followed, and no memory is asked for that the file does not fill.
    """
    with opened_map(path) as file:
        info, records = read_header(file)
        paths = [component_paths(record) for record in records]
        for name, scale, each in zip(info.field_names, info.field_scale, paths, strict=True):
            for components in each.values():
                check_record(file, components[0].rpartition("/")[0], info.grid, name, scale)
        flux = _components(file, [p["flux_density"] for p in paths], info, (3,))
        gradient = _components(file, [p["gradient"] for p in paths], info, (3, 3))
        return MapData(**_fields(info), flux_density=flux, gradient=gradient)


def read_info(path: str | os.PathLike[str]) -> MapInfo:
    """All of a map but its numbers: grid, coils, provenance, errors. Raises MapFileError as `read_map` does,
    but does not look at the numbers."""
    with opened_map(path) as file:
        return read_header(file)[0]


@contextmanager
def opened_map(path: str | os.PathLike[str]) -> Iterator[h5py.File]:
    """The file, its seal verified before HDF5 opens it; whatever is wrong inside the block becomes a MapFileError."""
    where = str(path)
    if not Path(path).is_file():
        raise MapFileError(Problem(where, "an existing map file", "no such file", REMAKE))
    try:
        if Path(path).name.endswith(PARTIAL_SUFFIX):
            remedy = "go on with it: fieldmap map RECIPE --resume"
            raise Refused("a complete map", "the file of a run that has not finished", remedy)
        check_seal(path)
        with h5py.File(path, "r") as file:
            yield file
    except Refused as refusal:
        raise MapFileError(Problem(where, *refusal.args)) from None
    except MapFileError:
        raise
    except InputError as error:
        raise MapFileError(
            *(Problem(where, f"{p.where}: {p.must_hold}", p.received, REMAKE) for p in error.problems)
        ) from error
    except PermissionError as error:
        remedy = "give yourself the right to read it"
        raise MapFileError(Problem(where, "a file that can be read", "no permission", remedy)) from error
    except (*UNREADABLE, MemoryError) as error:
        received = f"a damaged or foreign file ({str(error).splitlines()[0] if str(error) else 'no text'})"
        raise MapFileError(Problem(where, "an undamaged map file", received, REMAKE)) from error


def read_header(file: h5py.File) -> tuple[MapInfo, tuple[str, ...]]:
    """Description of the map and the names of its records."""
    if not is_hard(file, OWN.strip("/")):
        raise Refused("a map written by fieldmap", "an HDF5 file without the group /fieldmap", REMAKE)
    version = int(hard(file, OWN).attrs["format_version"])
    if version != FORMAT_VERSION:
        remedy = "install the version of fieldmap that wrote it, or make the map again"
        raise Refused(f"file format {FORMAT_VERSION}", f"format {version}", remedy)
    completion = hard(file, f"{OWN}/completion")
    if completion.attrs["complete"] != 1:
        done = stored(file, f"{OWN}/completion/chunks", "u")[()]
        received = f"{int(np.count_nonzero(done))} of {done.size} parts"
        raise Refused("a complete map", received, "go on with it: fieldmap map RECIPE --resume")
    names = ("header", "report", "recipe", "device")
    texts = {name: read_text(stored(file, f"{OWN}/{name}", "S")) for name in names}
    header = json.loads(texts["header"])
    for name in ("recipe", "device"):
        if header[f"{name}_sha256"] != sha256(texts[name]):
            raise Refused(f"the {name} it was made from", f"a {name} text with another hash", REMAKE)
    model = read_reduced_model(file) if is_hard(hard(file, OWN), REDUCED_MODEL.rpartition("/")[2]) else None
    info = info_from(header, json.loads(texts["report"]), texts["recipe"], texts["device"], model)
    records = record_names(info.field_names)
    if header["record_names"] != list(records):
        raise Refused(f"the records {', '.join(records)}", str(header["record_names"])[:200], REMAKE)
    return info, records


def _components(file: h5py.File, paths: list[list[str]], info: MapInfo, tail: tuple[int, ...]) -> Array:
    """(n_fields, nx, ny, nz, *tail) per ampere, or at weight 1."""
    for components in paths:
        for path in components:
            check_numbers(file, path, info.grid)
    needed = len(paths) * int(np.prod(tail)) * info.grid.size * 8
    if needed > file.id.get_filesize():
        received = f"a file of {file.id.get_filesize()} bytes"
        raise Refused(f"{needed} bytes of numbers, each stored once", received, REMAKE)
    values = np.empty((len(paths), *info.grid.shape, int(np.prod(tail))))
    for number, (components, scale) in enumerate(zip(paths, info.field_scale, strict=True)):
        for c, path in enumerate(components):
            values[number, ..., c] = read_numbers(file, path, info.grid)
        values[number] /= scale
    return values.reshape(len(paths), *info.grid.shape, *tail)


def check_record(file: h5py.File, path: str, grid: Grid, name: str = "", scale: float = 1.0) -> None:
    """Grid, coil and reference current that other readers see must be those that we read. name: of the field; "" for
    the total, which has none."""
    at = hard(file, path).attrs
    same = np.array_equal(at["gridSpacing"], grid.spacing)
    if not (same and np.array_equal(at["gridGlobalOffset"], grid.lower)):
        raise Refused(f"{path} on the map's grid", "another spacing or corner", REMAKE)
    if name and (bytes(at["coilName"]) != bytes(fixed(name)) or at["referenceCurrent"] != scale):
        raise Refused(f"{path} of {name!r} at {scale:g} A", "another coil or current", REMAKE)


def check_numbers(file: h5py.File, path: str, grid: Grid) -> h5py.Dataset:
    """A data set with one float64 for every node, without reading it."""
    data = stored(file, path, "f")
    if data.shape != grid.shape or data.dtype != np.float64:
        raise Refused(f"{path}: float64 numbers of shape {grid.shape}", f"{data.shape}, {data.dtype}", REMAKE)
    return data


def read_numbers(file: h5py.File, path: str, grid: Grid) -> Array:
    """One component at every node, finite."""
    values = check_numbers(file, path, grid)[()]
    if not np.isfinite(values).all():
        raise Refused(f"{path}: finite numbers", "NaN or infinity", REMAKE)
    return values


def _fields(info: MapInfo) -> dict[str, Any]:
    return {name: getattr(info, name) for name in MapInfo.__dataclass_fields__}

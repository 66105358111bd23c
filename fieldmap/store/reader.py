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
from fieldmap.store.names import FORMAT_VERSION, OWN, component_paths
from fieldmap.store.partial import UNREADABLE
from fieldmap.store.record import info_from, read_text, sha256
from fieldmap.store.reduced_model_file import REDUCED_MODEL, read_reduced_model

REMAKE = "make the map again: fieldmap map RECIPE"


def read_map(path: str | os.PathLike[str]) -> MapData:
    """The map in the file at `path`, with all of its numbers, per ampere of coil current.

    Raises MapFileError if the file is missing, no HDF5 file, not written by fieldmap or by a newer version,
    not complete, damaged (checksums, hashes), holds numbers that are not finite, or would take its numbers
    from another file. Links are not followed.
    """
    with _opened(path) as file:
        info, records = _header(file)
        paths = [component_paths(record) for record in records]
        flux = _components(file, [p["flux_density"] for p in paths], info, (3,))
        gradient = _components(file, [p["gradient"] for p in paths], info, (3, 3))
        return MapData(**_fields(info), flux_density=flux, gradient=gradient)


def read_info(path: str | os.PathLike[str]) -> MapInfo:
    """All of a map but its numbers: grid, coils, provenance, errors. Raises MapFileError as `read_map` does,
    but does not look at the numbers."""
    with _opened(path) as file:
        return _header(file)[0]


class _Refused(Exception):  # noqa: N818 - internal, turned into MapFileError below
    """A check failed: what must hold, what was found, remedy."""


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[h5py.File]:
    where = str(path)
    if not Path(path).is_file():
        raise MapFileError(Problem(where, "an existing map file", "no such file", REMAKE))
    try:
        with h5py.File(path, "r") as file:
            yield file
    except _Refused as refusal:
        raise MapFileError(Problem(where, *refusal.args)) from None
    except InputError as error:
        raise MapFileError(
            *(Problem(where, p.must_hold, p.received, REMAKE) for p in error.problems)
        ) from error
    except PermissionError as error:
        remedy = "give yourself the right to read it"
        raise MapFileError(Problem(where, "a file that can be read", "no permission", remedy)) from error
    except (*UNREADABLE, MemoryError) as error:
        received = f"a damaged or foreign file ({str(error).splitlines()[0] if str(error) else 'no text'})"
        raise MapFileError(Problem(where, "an undamaged map file", received, REMAKE)) from error


def _header(file: h5py.File) -> tuple[MapInfo, tuple[str, ...]]:
    """Description of the map and the names of its records."""
    if OWN.strip("/") not in file:
        raise _Refused("a map written by fieldmap", "an HDF5 file without the group /fieldmap", REMAKE)
    version = int(_at(file, OWN).attrs["format_version"])
    if version != FORMAT_VERSION:
        remedy = "install the version of fieldmap that wrote it, or make the map again"
        raise _Refused(f"file format {FORMAT_VERSION}", f"format {version}", remedy)
    completion = _at(file, f"{OWN}/completion")
    if completion.attrs["complete"] != 1:
        done = _at(file, f"{OWN}/completion/chunks")[()]
        received = f"{int(done.sum())} of {done.size} parts"
        raise _Refused("a complete map", received, "go on with it: fieldmap map RECIPE --resume")
    texts = {name: read_text(_at(file, f"{OWN}/{name}")) for name in ("header", "report", "recipe", "device")}
    header = json.loads(texts["header"])
    for name in ("recipe", "device"):
        if header[f"{name}_sha256"] != sha256(texts[name]):
            raise _Refused(f"the {name} it was made from", f"a {name} text with another hash", REMAKE)
    model = read_reduced_model(_at(file, REDUCED_MODEL)) if REDUCED_MODEL.strip("/") in file else None
    info = info_from(header, json.loads(texts["report"]), texts["recipe"], texts["device"], model)
    if len(header["record_names"]) != len(info.field_names):
        raise _Refused("one record for every field", f"{len(header['record_names'])} records", REMAKE)
    return info, tuple(header["record_names"])


def _components(file: h5py.File, paths: list[list[str]], info: MapInfo, tail: tuple[int, ...]) -> Array:
    """(n_fields, nx, ny, nz, *tail) per ampere, or at weight 1."""
    n_components = int(np.prod(tail))
    values = np.empty((len(paths), *info.grid.shape, n_components))
    for number, (components, scale) in enumerate(zip(paths, info.field_scale, strict=True)):
        _check_record(_at(file, components[0].rpartition("/")[0]), info.grid)
        for c, path in enumerate(components):
            values[number, ..., c] = _numbers(file, path, info.grid)
        values[number] /= scale
    return values.reshape(len(paths), *info.grid.shape, *tail)


def _check_record(record: h5py.Group, grid: Grid) -> None:
    """The grid that other readers see must be the one that we read."""
    same = np.array_equal(record.attrs["gridSpacing"], grid.spacing)
    if not (same and np.array_equal(record.attrs["gridGlobalOffset"], grid.lower)):
        raise _Refused(f"{record.name} on the map's grid", "another spacing or corner", REMAKE)


def _numbers(file: h5py.File, path: str, grid: Grid) -> Array:
    data = _at(file, path)
    if not isinstance(data, h5py.Dataset) or data.shape != grid.shape or data.dtype != np.float64:
        shape = getattr(data, "shape", "no data set")
        raise _Refused(f"{path}: float64 numbers of shape {grid.shape}", f"{shape}", REMAKE)
    if data.is_virtual or data.external:
        raise _Refused(f"{path} inside the file", "numbers kept in another file", REMAKE)
    values = data[()]
    if not np.isfinite(values).all():
        raise _Refused(f"{path}: finite numbers", "NaN or infinity", REMAKE)
    return values


def _at(file: h5py.File, path: str) -> h5py.Group | h5py.Dataset:
    """The object at a path of hard links: nothing is taken from elsewhere."""
    here: h5py.Group | h5py.Dataset = file
    for name in path.strip("/").split("/"):
        if not isinstance(here.get(name, getlink=True), h5py.HardLink):
            raise _Refused(f"{path} inside the file", f"a link at {here.name}", REMAKE)
        here = here[name]
    return here


def _fields(info: MapInfo) -> dict[str, Any]:
    return {name: getattr(info, name) for name in MapInfo.__dataclass_fields__}

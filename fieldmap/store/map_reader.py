"""Reader of map files. It trusts nothing in a file that it has not checked.

A file must be complete and undamaged, must not refer to other files, and must not contradict itself. Only objects at
hard links are read, and only arrays whose bytes are all in the file. This is checked before memory is allocated or a
number is read.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from fieldmap.currents import CurrentParametrisation, LiftAndDirections, parametrisation_from_json
from fieldmap.errors import InputError, MapFileError, Problem
from fieldmap.file_contents import file_in_words, head_of
from fieldmap.shipped import is_file, shipped_file
from fieldmap.store.checkpoint import SUFFIX
from fieldmap.store.map_data import (
    REACTION_FIELDS,
    FieldError,
    Grid,
    LargeMap,
    MapData,
    MapInfo,
    MappedNumbers,
    StoredFields,
    StoredLinkage,
    StoredReaction,
    StoredSensors,
)
from fieldmap.store.map_format import (
    DIVISION_EXPONENT,
    LINKAGE,
    LOOKUP,
    OWN,
    PARAMETRISATION,
    QUANTITIES,
    REACTION_CELLS,
    REDUCED_MODEL,
    REPELLED,
    UNREADABLE,
    VERSIONS,
    Quantity,
    format_of,
    info_from,
    read_text,
    record_names,
    sha256,
)
from fieldmap.store.openpmd import of_source, on_grid
from fieldmap.store.reduced_model import ARRAYS, OPTIONAL, ReducedModel, parametrisation_of
from fieldmap.store.seal import REMAKE, check_seal, is_sealed
from fieldmap.typing import Array

_NAMES = {
    "f": "float64 numbers",
    "fi": "numbers",
    "fiu": "numbers",
    "u": "flags",
    "S": "text of fixed length",
}


class Refused(Exception):  # noqa: N818 - internal, turned into MapFileError by the reader
    """A check failed: what must hold, what was found, remedy."""


def hard(file: h5py.Group, path: str) -> h5py.Group | h5py.Dataset:
    """Open the object at a path. Every link of the path must be hard; otherwise it could lead to another file.

    Raises Refused if one is not.
    """
    # The check goes from the root on, so that no link is followed before it is known to be hard. Only the last object
    # is opened: opening all groups on the way, for every array, would take most of the time of reading a map.
    names = path.strip("/").split("/")
    for depth in range(len(names)):
        if not is_hard(file, "/".join(names[: depth + 1])):
            at = "/" + "/".join(names[:depth])
            raise Refused(f"{path} inside the file", f"a link, or nothing, at {at}", REMAKE)
    found = h5py.h5o.open(file.id, path.encode())
    if isinstance(found, h5py.h5g.GroupID):
        return h5py.Group(found)
    return h5py.Dataset(found) if isinstance(found, h5py.h5d.DatasetID) else h5py.Datatype(found)


def is_hard(file: h5py.Group, path: str) -> bool:
    """Whether the last link of a path is a hard link of an existing object. The earlier links must be known to be hard.
    The last one is not followed."""
    links, name = file.id.links, path.encode()
    try:
        return bool(links.exists(name)) and links.get_info(name).type == h5py.h5l.TYPE_HARD
    except RuntimeError:
        # A data set lies where a group should be.
        return False


def stored(file: h5py.Group, path: str, kinds: str) -> h5py.Dataset:
    """Open the data set at a path of hard links, if all of its bytes lie in this file.

    Parameters
    ----------
    file
        Open file.
    path
        Path of the data set.
    kinds
        Allowed kinds of numpy types, a key of `_NAMES`.

    Raises
    ------
    Refused
        For another type, numbers in other files, filters other than checksums (a few bytes could declare any size),
        arrays larger than their stored bytes, and data sets with a second name (one component could be given as
        another).
    """
    data = hard(file, path)
    if not isinstance(data, h5py.Dataset) or (dtype := data.dtype).kind not in kinds:
        there = isinstance(data, h5py.Dataset)
        received = f"shape {data.shape}, {data.dtype}" if there else "no data set"
        raise Refused(f"{path}: {_NAMES[kinds]}", received, REMAKE)
    created = data.id.get_create_plist()
    if data.is_virtual or data.external:
        raise Refused(f"{path} inside the file", "numbers kept in another file", REMAKE)
    if h5py.h5o.get_info(data.id).rc != 1:
        raise Refused(f"{path}: numbers of its own", "numbers that have another name as well", REMAKE)
    filters = {created.get_filter(k)[0] for k in range(created.get_nfilters())}
    if not filters <= {h5py.h5z.FILTER_FLETCHER32}:
        raise Refused(
            f"{path}: stored as it is, with checksums at most", "a compressed or filtered array", REMAKE
        )
    if data.shape is None or data.size * dtype.itemsize > data.id.get_storage_size():
        received = f"shape {data.shape} with {data.id.get_storage_size()} bytes stored"
        raise Refused(f"{path}: all of its numbers stored", received, REMAKE)
    return data


def read_map(path: str | os.PathLike[str]) -> MapData:
    """Read a map file with all of its numbers.

    Links are not followed, and no more memory is allocated than the file fills.

    Parameters
    ----------
    path
        Path of the file, or the name of a shipped map, such as "sample".

    Returns
    -------
    MapData
        The map; fields of coils are per ampere.

    Raises
    ------
    MapFileError
        If the file is missing, incomplete, or different from its seal; if it was not written by fieldmap, or by a
        version with another format; if a number is not finite or lies in another file.
    """
    with opened_map(path) as file:
        return _read_numbers_of(file)


def read_for_lookup(path: str | os.PathLike[str]) -> MapData | LargeMap:
    """Read a map for lookups: a large map with memory-mapped coefficients, any other map with all of its numbers.

    The numbers at the nodes of a large map are not verified; `check_map` and `read_map` verify them.

    Parameters
    ----------
    path
        As in `read_map`.

    Returns
    -------
    MapData | LargeMap
        The map.

    Raises
    ------
    MapFileError
        As in `read_map`.
    """
    with opened_map(path, numbers=False) as file:
        return _read_large(file) if _is_large(file) else _read_numbers_of(file)


def _is_large(file: h5py.File) -> bool:
    return is_hard(file, OWN.strip("/")) and is_hard(file, LOOKUP.strip("/"))


def _read_numbers_of(file: h5py.File) -> MapData:
    info, records = read_header(file)
    for number, (name, record) in enumerate(zip(info.field_names, records, strict=True)):
        wanted = on_grid(info.grid) | of_source(name, info.field_scale[number])
        for quantity in QUANTITIES:
            check_attributes(file, quantity.path(record), wanted)
    arrays = {quantity.name: _values(file, quantity, records, info) for quantity in QUANTITIES}
    return MapData(**vars(info), **arrays, **_of_iron(file, info.grid, OWN))


def _read_large(file: h5py.File) -> LargeMap:
    info, _ = read_header(file)
    group = hard(file, LOOKUP)
    every = int(group.attrs["every"])
    if every < 1 or any((n - 1) % every for n in info.grid.shape):
        raise Refused(f"{LOOKUP}, every: a divisor of the cells along each axis", f"{every}", REMAKE)
    blocks, misfits = {}, {}
    for kind in group:
        if not isinstance(hard(file, f"{LOOKUP}/{kind}"), h5py.Dataset):
            continue
        data = stored(file, f"{LOOKUP}/{kind}", "f")
        offset = data.id.get_offset()
        if data.dtype != np.dtype("<f8") or data.ndim != 1 or offset is None or offset % 8:
            received = f"{data.shape}, {data.dtype}, from byte {offset} of the file"
            raise Refused(
                f"{data.name}: float64 numbers in one piece at a multiple of 8 bytes", received, REMAKE
            )
        blocks[kind] = MappedNumbers.at(file.filename, offset, data.size)
        if kind != REACTION_CELLS:
            misfits[kind] = FieldError(*(float(one) for one in data.attrs["misfit"]))
    of_iron = _of_iron(file, info.grid.every(every), LOOKUP)
    reaction = blocks.pop(REACTION_CELLS, None)
    return LargeMap(
        **vars(info), every=every, blocks=blocks, misfits=misfits, reaction_cells=reaction, **of_iron
    )


def _of_iron(file: h5py.File, grid: Grid, under: str) -> dict[str, Any]:
    """Reaction, linkages and sensors of a map, None if the file has none; their fields lie on `grid`."""
    reaction, sensors = f"{under}/reaction", f"{under}/sensors"
    return {
        "reaction": _read_reaction(file, grid, reaction) if is_hard(file, reaction.strip("/")) else None,
        "linkage": _read_linkage(file) if is_hard(file, LINKAGE.strip("/")) else None,
        "sensors": _read_sensors(file, grid, sensors) if is_hard(file, sensors.strip("/")) else None,
    }


def read_info(path: str | os.PathLike[str]) -> MapInfo:
    """Read the description of a map: grid, coils, provenance, errors. The arrays are not read.

    Parameters
    ----------
    path
        As in `read_map`.

    Raises
    ------
    MapFileError
        As in `read_map`, except for errors of the arrays.
    """
    with opened_map(path, numbers=False) as file:
        return read_header(file)[0]


def map_path(path: str | os.PathLike[str]) -> Path:
    """The path of a map file.

    Parameters
    ----------
    path
        A path, or the name of a shipped map.

    Returns
    -------
    Path
        The path itself; or the shipped map of a name without folder and ending, unless there is such a file.
    """
    given = Path(path)
    if is_file(given) or given.name != os.fspath(path) or given.suffix:
        return given
    return shipped_file("maps", f"{given}.h5") or given


@contextmanager
def opened_map(path: str | os.PathLike[str], numbers: bool = True) -> Iterator[h5py.File]:
    """Open a map file after its seal was verified. numbers: False leaves out the numbers of a large map. Errors inside
    the block become MapFileError."""
    where, path = os.fspath(path), map_path(path)
    if not is_file(path):
        raise MapFileError.of(where, "an existing map file", "no such file", REMAKE)
    try:
        if path.name.endswith(SUFFIX):
            remedy = "go on with it: fieldmap map RECIPE --resume"
            raise Refused("a complete map", "the file of a run that has not finished", remedy)
        if not head_of(path).startswith(b"\x89HDF") and not is_sealed(path):
            raise Refused("an HDF5 file that fieldmap has written", file_in_words(path), REMAKE)
        check_seal(path, numbers=numbers)
        with h5py.File(path, "r") as file:
            yield file
    except Refused as refusal:
        raise MapFileError.of(where, *refusal.args) from None
    except MapFileError:
        raise
    except InputError as error:
        raise MapFileError(
            *(Problem(where, f"{p.where}: {p.must_hold}", p.received, REMAKE) for p in error.problems)
        ) from error
    except PermissionError as error:
        remedy = "give yourself the right to read it"
        raise MapFileError.of(where, "a file that can be read", "no permission", remedy) from error
    except (*UNREADABLE, MemoryError) as error:
        received = f"a damaged or foreign file ({str(error).splitlines()[0] if str(error) else 'no text'})"
        raise MapFileError.of(where, "an undamaged map file", received, REMAKE) from error


def read_header(file: h5py.File) -> tuple[MapInfo, tuple[str, ...]]:
    """Read the description of a map and the names of its records. Raises Refused."""
    if not is_hard(file, OWN.strip("/")):
        raise Refused("a map written by fieldmap", "an HDF5 file without the group /fieldmap", REMAKE)
    version = int(hard(file, OWN).attrs["format_version"])
    if version not in VERSIONS:
        remedy = "install the version of fieldmap that wrote it, or make the map again"
        must_hold = f"file format {', '.join(map(str, VERSIONS))}"
        raise Refused(must_hold, f"format {version}", remedy)
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
    model = _read_reduced_model(file) if is_hard(file, REDUCED_MODEL.strip("/")) else None
    info = info_from(header, json.loads(texts["report"]), texts["recipe"], texts["device"], model)
    if version != format_of(info) or version != header["format"]:
        must_hold = f"file format {format_of(info)}, by its fields and its iron"
        raise Refused(must_hold, f"format {version}, and {header['format']} in its header", REMAKE)
    records = record_names(info.field_names)
    if header["record_names"] != list(records):
        raise Refused(f"the records {', '.join(records)}", str(header["record_names"])[:200], REMAKE)
    return info, records


def _read_reduced_model(file: h5py.File) -> ReducedModel:
    """Read the model of a map of saturating iron. Raises Refused, ValueError or InputError if the arrays do not fit."""
    group = hard(file, REDUCED_MODEL)
    # `in` on a data set would read its numbers, possibly from another file.
    if not isinstance(group, h5py.Group):
        raise Refused(f"{REDUCED_MODEL}: a group", "numbers", REMAKE)
    there = [name for name in ARRAYS if name not in OPTIONAL or name in group]
    arrays = {name: np.ascontiguousarray(stored(file, f"{REDUCED_MODEL}/{name}", "fi")[()]) for name in there}
    return ReducedModel(**arrays, parametrisation=_parametrisation(file, len(arrays["source"].T)))


def _read_reaction(file: h5py.File, grid: Grid, path: str) -> StoredReaction:
    """Read the fields of the iron's reaction to magnets. Raises Refused."""
    repelled, read = int(hard(file, path).attrs[REPELLED]), _read_fields(file, path, grid)
    count = len(read["flux_density"])
    if not (0 <= repelled <= count and 1 <= count <= REACTION_FIELDS):
        must_hold = f"{path}: 1 to {REACTION_FIELDS} fields"
        raise Refused(must_hold, f"{count}, {repelled} of them negative", REMAKE)
    return StoredReaction(**read, repelled=repelled)


def _read_linkage(file: h5py.File) -> StoredLinkage:
    """Read the flux linkages of the coils. Raises Refused, or InputError if they do not fit."""
    names = ("inductance", "constant")
    return StoredLinkage(*(_finite(stored(file, f"{LINKAGE}/{name}", "f")) for name in names))


def _read_sensors(file: h5py.File, grid: Grid, path: str) -> StoredSensors:
    """Read the field sensors. Raises Refused, ValueError or InputError if the arrays do not fit."""
    names = json.loads(bytes(hard(file, path).attrs["names"]).decode())
    of_each = {name: _finite(stored(file, f"{path}/{name}", "f")) for name in ("positions", "axes", "shares")}
    answers = None
    if is_hard(file, f"{path}/answers".strip("/")):
        answers = StoredFields(**_read_fields(file, f"{path}/answers", grid))
    return StoredSensors(tuple(map(str, names)), **of_each, answers=answers)


def _read_fields(file: h5py.File, path: str, grid: Grid) -> dict[str, Array]:
    """Read flux densities and gradients of fields of iron. Raises Refused."""
    read: dict[str, Array] = {}
    for name, tail in (("flux_density", (3,)), ("gradient", (3, 3))):
        data = stored(file, f"{path}/{name}", "f")
        count = len(read.get("flux_density", data))
        if data.shape != (wanted := (count, *grid.shape, *tail)):
            raise Refused(f"{path}/{name}: shape {wanted}", f"{data.shape}", REMAKE)
        read[name] = _finite(data).astype(np.float64)
    return read


def _parametrisation(file: h5py.File, coils: int) -> CurrentParametrisation:
    """Read the parametrisation of the currents, in the present or the older form. If a file has both, they must
    agree."""
    exponent = stored(file, f"{REDUCED_MODEL}/{DIVISION_EXPONENT}", "fi")[()]
    stated = hard(file, REDUCED_MODEL).attrs.get(PARAMETRISATION)
    older = parametrisation_of(exponent, coils)
    if stated is None:
        return older
    named = parametrisation_from_json(bytes(stated).decode())
    # The older form has no limit of the currents.
    without = replace(named, limit=None) if isinstance(named, LiftAndDirections) else named
    if exponent.size and without != older:
        raise Refused(f"one parametrisation of the currents, {named}", f"{older} as well", REMAKE)
    return named


def _values(file: h5py.File, quantity: Quantity, records: tuple[str, ...], info: MapInfo) -> Array:
    """Read a quantity of all fields (n_fields, nx, ny, nz, *tail), per ampere for coils, at weight 1 for others."""
    checked = [
        [check_numbers(file, f"{quantity.path(record)}/{c}", info.grid) for c in quantity.components]
        for record in records
    ]
    needed = sum(data.id.get_storage_size() for components in checked for data in components)
    if needed > file.id.get_filesize():
        received = f"a file of {file.id.get_filesize()} bytes"
        raise Refused(f"{needed} bytes of numbers, each stored once", received, REMAKE)
    values = np.empty((len(records), *info.grid.shape, len(quantity.components)))
    for number, (components, scale) in enumerate(zip(checked, info.field_scale, strict=True)):
        for c, data in enumerate(components):
            values[number, ..., c] = _finite(data)
        values[number] /= scale
    return values.reshape(*values.shape[:4], *quantity.tail)


def check_attributes(file: h5py.File, path: str, wanted: Mapping[str, Any]) -> None:
    """Check attributes for other programs. Raises Refused."""
    attributes = hard(file, path).attrs
    for name, value in wanted.items():
        if not np.array_equal(attributes[name], value):
            raise Refused(f"{path}, {name}: {value}", repr(attributes[name]), REMAKE)


def check_numbers(file: h5py.File, path: str, grid: Grid) -> h5py.Dataset:
    """Open a data set with one float64 for every node, without reading it. Raises Refused."""
    data = stored(file, path, "f")
    if data.shape != grid.shape or data.dtype != np.float64:
        raise Refused(f"{path}: float64 numbers of shape {grid.shape}", f"{data.shape}, {data.dtype}", REMAKE)
    return data


def read_numbers(file: h5py.File, path: str, grid: Grid, planes: slice) -> Array:
    """Read one component at the nodes of some x-planes. Raises Refused if a number is not finite."""
    return _finite(check_numbers(file, path, grid), planes)


def _finite(data: h5py.Dataset, planes: slice | tuple[()] = ()) -> Array:
    values = data[planes]
    if not np.isfinite(values).all():
        raise Refused(f"{data.name}: finite numbers", "NaN or infinity", REMAKE)
    return values

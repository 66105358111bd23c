"""The maps of `generate_many` as one xarray data set, read from their files on access."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldmap.arguments import check
from fieldmap.lookup import open_map
from fieldmap.studies.run import require_xarray
from fieldmap.typing import Array, PathLike

if TYPE_CHECKING:
    import xarray


def open_maps(index: PathLike, currents: Any = None) -> xarray.Dataset:
    """The index of many maps, with their fields at the nodes as variables that are read map by map.

    A selection reads only its own maps, one at a time, and keeps only the last one. The axes of the variants are those
    of the study's own data set, so that `xarray.merge` can join the two.

    Parameters
    ----------
    index
        The NetCDF file that `generate_many` wrote.
    currents
        As for `FieldMap.to_xarray`: currents of all maps, or None for the fields per ampere of linear iron.

    Returns
    -------
    xarray.Dataset
        The index, and the variables of `FieldMap.to_xarray` with the axes of the variants before theirs; NaN where
        there is no map. The attribute `certified_error` is left out, as the index has it for each map.

    Raises
    ------
    FieldmapError
        If xarray or h5netcdf is missing.
    InputError
        If there is no such file or no map, or if the maps have different nodes.
    """
    module, index = require_xarray(), Path(index)
    remedy = "give the .nc file that fieldmap map --over wrote"
    check(index.is_file(), str(index), "must be the index of many maps", "no such file", remedy)
    with module.open_dataset(index, engine="h5netcdf") as stored:
        data: xarray.Dataset = stored.load()
    files = np.where(data.problem == "", data.map_file, "")
    there = files[files != ""]
    check(len(there) > 0, str(index), "must name at least one map", "none", "see its variable problem")
    for of_grid in ("nodes", "lower", "spacing"):
        values = data[of_grid].values[files != ""]
        must_hold = "the maps of one data set must have the same nodes"
        remedy = "open them one by one with fieldmap.open_map"
        check(bool((values == values[0]).all()), f"{index}: {of_grid}", must_hold, "different ones", remedy)
    maps = _Maps(index.parent, files, currents)
    pattern = maps.at(str(there[0]))
    fields = [str(name) for name in pattern.data_vars if "x" in pattern[name].dims]
    found = data.assign_coords({name: pattern[name] for name in pattern.coords})
    for name in fields:
        one = pattern[name]
        about = {key: value for key, value in one.attrs.items() if key != "certified_error"}
        lazy = module.core.indexing.LazilyIndexedArray(_array_of(maps, name, one))
        found[name] = ((*data.problem.dims, *one.dims), lazy, about)
    return found


class _Maps:
    """The maps of an index; the last one is cached, because its fields are read one after the other."""

    def __init__(self, folder: Path, files: Array, currents: Any) -> None:
        self.files = files
        self._folder, self._currents = folder, currents
        self._last: tuple[str, Any] = ("", None)

    def at(self, file: str) -> xarray.Dataset:
        """The data set of one map."""
        if self._last[0] != file:
            self._last = (file, open_map(self._folder / file).to_xarray(self._currents))
        opened: xarray.Dataset = self._last[1]
        return opened


def _array_of(maps: _Maps, name: str, pattern: xarray.DataArray) -> Any:
    """One field of all maps as an array of xarray's backends."""
    from xarray.backends import BackendArray
    from xarray.core import indexing

    leading = maps.files.ndim

    class FieldOfMaps(BackendArray):
        shape = (*maps.files.shape, *pattern.shape)
        dtype = pattern.dtype

        def __getitem__(self, key: Any) -> Any:
            support = indexing.IndexingSupport.OUTER
            return indexing.explicit_indexing_adapter(key, self.shape, support, self._read)

        def _read(self, key: tuple[Any, ...]) -> Array:
            places = np.arange(maps.files.size).reshape(maps.files.shape)
            wanted = _outer(places, key[:leading])
            read = [self._of(maps.files.flat[place], key[leading:]) for place in wanted.flat]
            return np.reshape(read, (*wanted.shape, *np.shape(read)[1:]))

        def _of(self, file: str, key: tuple[Any, ...]) -> Array:
            values = maps.at(file)[name].values if file else np.full(pattern.shape, np.nan)
            return _outer(values, key)

    return FieldOfMaps()


def _outer(values: Any, key: tuple[Any, ...]) -> Any:
    """values[key], each entry of the key along its own axis."""
    for axis, one in reversed(list(enumerate(key))):
        values = values[(slice(None),) * axis + (one,)]
    return values

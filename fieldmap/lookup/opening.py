"""From a map file, or a map in memory, to something that can be asked for a field."""

from os import PathLike

from fieldmap.errors import InputError, Problem
from fieldmap.lookup.field_map import FieldMap
from fieldmap.store import MapData, read_map

KINDS = ("hermite",)


def open_map(path: str | PathLike[str], kind: str = "hermite", outside: str = "raise") -> FieldMap:
    """Read and check the map file at `path` and make it ready for lookups.

    kind: "hermite", the tricubic Hermite interpolant. outside: what a point outside the map's box gives,
    "raise" (OutsideMapError) or "nan". Raises MapFileError if the file is no complete, undamaged map and
    InputError for an unknown kind or outside rule.

    >>> m = open_map("maps/out/workspace.h5")                                     # doctest: +SKIP
    >>> m.field([0, 0, -0.09], currents=[1, 1, 1, 1, 1, 1])                       # doctest: +SKIP
    """
    _check_kind(kind)
    return interpolate(read_map(path), kind, outside)


def interpolate(data: MapData, kind: str = "hermite", outside: str = "raise") -> FieldMap:
    """A map in memory made ready for lookups; kind and outside as in `open_map`."""
    _check_kind(kind)
    return FieldMap(data, outside)


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        allowed = " or ".join(f'"{name}"' for name in KINDS)
        raise InputError(Problem("open_map, kind", f"is {allowed}", repr(kind), "choose a kind that exists"))

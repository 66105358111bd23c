"""The maps that rows need: where they lie, and what to do where they do not."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any

from fieldmap.errors import FieldmapError, Problem
from fieldmap.thesis import detail

FOLDER = Path("maps/out")
"""Where `fieldmap map RECIPE` puts a map, in the current folder."""
WAIT = 60.0
"""Seconds for which a run waits for a file of finished work that another one reads or writes at this moment."""


class MapMissing(FieldmapError):  # noqa: N818 - reads as the outcome it is
    """A row's map has not been made; `command` makes it."""

    def __init__(self, recipe: str, path: Path) -> None:
        self.command = f"fieldmap map {recipe}"
        super().__init__(
            Problem(
                str(path), "must be the map that this row needs", "no such file", f"make it: {self.command}"
            )
        )


_FOLDER: ContextVar[Path] = ContextVar("folder of the maps", default=FOLDER)


@contextmanager
def maps_in(folder: Path) -> Iterator[Path]:
    """Look for maps in this folder inside the block."""
    token = _FOLDER.set(folder)
    try:
        yield folder
    finally:
        _FOLDER.reset(token)


def file_of(recipe: str, folder: Path | None = None) -> Path:
    """Where the map lies that stands for a recipe's at the present detail; folder: that of `maps_in` unless given."""
    return (_FOLDER.get() if folder is None else folder) / f"{detail.current().map_name(recipe)}.h5"


def map_path(recipe: str, folder: Path | None = None) -> Path:
    """The file of a recipe's map. Raises MapMissing where it has not been made."""
    path = file_of(recipe, folder)
    if not path.is_file():
        raise MapMissing(detail.current().map_name(recipe), path)
    return path


def available_map(recipe: str, folder: Path | None = None) -> Any:
    """The opened map (FieldMap), read once. Raises MapMissing where it has not been made."""
    path = map_path(recipe, folder).resolve()
    return _open(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _open(path: Path, changed: int) -> Any:
    from fieldmap.lookup import open_map

    return open_map(path)

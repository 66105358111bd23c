"""The maps that rows need: where they lie, and what to do where they do not."""

from functools import lru_cache
from pathlib import Path
from typing import Any

from fieldmap.errors import FieldmapError, Problem

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


def map_path(recipe: str, folder: Path = FOLDER) -> Path:
    """The file of a recipe's map. Raises MapMissing where it has not been made."""
    path = folder / f"{recipe}.h5"
    if not path.is_file():
        raise MapMissing(recipe, path)
    return path


def available_map(recipe: str, folder: Path = FOLDER) -> Any:
    """The opened map (FieldMap), read once. Raises MapMissing where it has not been made."""
    path = map_path(recipe, folder).resolve()
    return _open(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _open(path: Path, changed: int) -> Any:
    from fieldmap.lookup import open_map

    return open_map(path)

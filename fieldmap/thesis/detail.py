"""Detail of a computation: full meshes and maps as the rows state them, or coarse ones for a quick look.

A part takes its mesh size from `refinement`, caches with `cached`, and takes the name of its map from
`Detail.map_name`, so that full and quick results never mix.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, lru_cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from fieldmap.errors import FieldmapError, Problem
from fieldmap.records import Record

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
FOLDER = Path("maps/out")
"""Where `fieldmap map RECIPE` writes a map, in the current folder."""
COARSE, COARSEST = 0.4, 0.25
"""A quick computation multiplies the refinement of a row by COARSE, but not below COARSEST."""


@dataclass(frozen=True, repr=False)
class Detail(Record):
    """name: "full" or "quick". option: the command-line option for it, with a leading space."""

    name: str
    option: str = ""

    @property
    def is_quick(self) -> bool:
        """Whether meshes and maps are coarser than the rows state."""
        return self.name == "quick"

    def map_name(self, recipe: str) -> str:
        """Recipe of the map to use for `recipe` at this detail; "" for "".

        >>> QUICK.map_name("division"), FULL.map_name("division"), QUICK.map_name("")
        ('division_quick', 'division', '')
        """
        return f"{recipe}_quick" if recipe and self.is_quick else recipe


FULL = Detail("full")
QUICK = Detail("quick", " --quick")
_CURRENT: ContextVar[Detail] = ContextVar("detail", default=FULL)


def current() -> Detail:
    """The detail that rows are computed with now."""
    return _CURRENT.get()


@contextmanager
def _inside(variable: ContextVar[Result], value: Result) -> Iterator[Result]:
    """A variable has this value inside the block."""
    token = variable.set(value)
    try:
        yield value
    finally:
        variable.reset(token)


def at(detail: Detail) -> AbstractContextManager[Detail]:
    """Compute rows with this detail inside the block."""
    return _inside(_CURRENT, detail)


def refinement(usual: float) -> float:
    """Divisor of mesh sizes at the present detail, where a part states `usual`. Finer meshes stay finer than others.

    >>> with at(QUICK):
    ...     [refinement(usual) for usual in (1.0, 1.3, 0.5, 0.3)]
    [0.4, 0.52, 0.25, 0.25]
    """
    return round(min(usual, max(COARSE * usual, COARSEST)), 6) if current().is_quick else usual


def fewer(count: int) -> int:
    """A number of items at the present detail, where a part states `count`; at least three, or `count` if smaller.

    >>> with at(QUICK):
    ...     [fewer(count) for count in (10, 5, 2)]
    [4, 3, 2]
    """
    return min(count, max(round(COARSE * count), 3)) if current().is_quick else count


def cached(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """`functools.cache` for functions that depend on the detail, with separate results for each detail."""

    @cache
    def of_detail(_: Detail, *arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        return function(*arguments, **named)

    @wraps(function)
    def call(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        return of_detail(current(), *arguments, **named)  # type: ignore[arg-type]

    call.cache_clear = of_detail.cache_clear  # type: ignore[attr-defined]
    return call


class MapMissing(FieldmapError):  # noqa: N818 - reads as the outcome it is
    """A row's map has not been made; `command` makes it."""

    def __init__(self, recipe: str, path: Path) -> None:
        self.command = f"fieldmap map {recipe}"
        must_hold = "must be the map that this row needs"
        super().__init__(Problem(str(path), must_hold, "no such file", f"make it: {self.command}"))


_FOLDER: ContextVar[Path] = ContextVar("folder of the maps", default=FOLDER)


def maps_in(folder: Path) -> AbstractContextManager[Path]:
    """Look for maps in this folder inside the block."""
    return _inside(_FOLDER, folder)


def file_of(recipe: str, folder: Path | None = None) -> Path:
    """Path of a recipe's map at the present detail. folder: by default the folder of `maps_in`."""
    return (_FOLDER.get() if folder is None else folder) / f"{current().map_name(recipe)}.h5"


def map_path(recipe: str, folder: Path | None = None) -> Path:
    """The file of a recipe's map. Raises MapMissing if the map has not been made."""
    path = file_of(recipe, folder)
    if not path.is_file():
        raise MapMissing(current().map_name(recipe), path)
    return path


def available_map(recipe: str, outside_currents: str = "raise") -> Any:
    """The opened map (FieldMap), read once. Raises MapMissing if the map has not been made."""
    path = map_path(recipe).resolve()
    return _open(path, path.stat().st_mtime_ns, outside_currents)


@lru_cache(maxsize=3)
def _open(path: Path, changed: int, outside_currents: str) -> Any:
    from fieldmap.lookup import open_map

    return open_map(path, outside_currents=outside_currents)

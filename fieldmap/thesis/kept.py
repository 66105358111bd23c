"""Caches in files: solved states and runs of the unit in the folder of the maps, finished parts in a report's folder.

A cached result is valid only under its fingerprint. The fingerprint of a part covers the package's code (except `plot`
and `cli`, which no part imports), the device files, the scenarios, the part's data, its map, and the versions of the
numerical libraries.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap import provenance
from fieldmap.curves import Curves, Series
from fieldmap.records import Record
from fieldmap.shipped import PACKAGE, shipped_folder
from fieldmap.store import Checkpoint
from fieldmap.store.checkpoint import Piece
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Comparison, PartResult, attempt_part
from fieldmap.thesis.detail import FOLDER, file_of
from fieldmap.thesis.printed import data_files, read_part
from fieldmap.typing import Array

WAIT = 60.0
"""Longest wait, s, for a file that another run is reading or writing."""
_FINISHED = "finished.kept"
_WITHOUT_INFLUENCE = ("plot", "cli", "shipped")


@dataclass(frozen=True, repr=False)
class Kept(Record):
    """Cached results in one file, which is open only during a read or write so that other runs may use it.

    path: None for no cache. fingerprint: valid for all results; a file with another fingerprint is replaced.
    """

    path: Path | None
    fingerprint: str

    def get(self, key: str) -> Piece | None:
        """The result of this key, or None."""
        if self.path is None:
            return None
        with Checkpoint(self.path, self.fingerprint, wait=WAIT) as checkpoint:
            return checkpoint.get(key)

    def put(self, key: str, arrays: Mapping[str, Array] | None = None, about: Any = None) -> None:
        """Write a result."""
        if self.path is not None:
            with Checkpoint(self.path, self.fingerprint, wait=WAIT) as checkpoint:
                checkpoint.put(key, arrays, about)

    def arrays(self, key: str, compute: Callable[[], dict[str, Array]]) -> dict[str, Array]:
        """The arrays of this key; computed and written if there are none."""
        piece = self.get(key)
        if piece is not None:
            return piece.arrays
        found = compute()
        self.put(key, found)
        return found


def finished_parts(folder: Path) -> Kept:
    """The parts of a report, each stored with its own fingerprint."""
    return Kept(folder / _FINISHED, "parts of the thesis, 1")


def cached_parts(folder: Path, maps: Path = FOLDER) -> Callable[[str], PartResult]:
    """`attempt_part` with a cache: it reads parts with an unchanged fingerprint from the folder and writes new ones."""

    def attempt(part: str) -> PartResult:
        try:
            mark = fingerprint(part, maps)
        except OSError:
            mark = ""
        finished = _finished_part(folder, part, mark)
        if finished is not None:
            return finished
        result = attempt_part(part, maps)
        if mark and result.state == "done":
            plain = json.loads(json.dumps(asdict(result), default=_list_or_dict))
            finished_parts(folder).put(_key(part), about={"fingerprint": mark, "result": plain})
        return result

    return attempt


def fingerprint(part: str, maps: Path = FOLDER) -> str:
    """Fingerprint of everything that decides the numbers of a part, 64 hexadecimal digits; "" if its map is missing."""
    printed = read_part(part)
    settings = [*(path.read_text(encoding="utf-8") for path in data_files(part)), *_shipped()]
    settings.append(detail.current().name)
    if printed.map:
        path = file_of(printed.map, maps)
        if not path.is_file():
            return ""
        settings.append(_of_a_map(path.resolve(), path.stat().st_mtime_ns))
    code = sorted({path.stem for path in PACKAGE.iterdir() if path.is_dir() or path.suffix == ".py"})
    return provenance.fingerprint(settings, [name for name in code if name not in _WITHOUT_INFLUENCE])


def _finished_part(folder: Path, part: str, mark: str) -> PartResult | None:
    """The finished part with this fingerprint in a report's folder, or None."""
    piece = finished_parts(folder).get(_key(part)) if mark else None
    if piece is None or piece.about["fingerprint"] != mark:
        return None
    plain = piece.about["result"]
    numbers = [Comparison(**{**c, "assumptions": tuple(c["assumptions"])}) for c in plain["comparisons"]]
    curves = [Curves(**{**c, "series": tuple(Series(**s) for s in c["series"])}) for c in plain["curves"]]
    return PartResult(**{**plain, "comparisons": tuple(numbers), "curves": tuple(curves)})


def is_finished(folder: Path, part: str, maps: Path = FOLDER) -> bool:
    """Whether a report in this folder would read the part from the cache."""
    if not (folder / _FINISHED).is_file():
        return False
    return _finished_part(folder, part, fingerprint(part, maps)) is not None


def _key(part: str) -> str:
    """Key of a part; quick results have a key of their own."""
    return part + (" quick" if detail.current().is_quick else "")


@cache
def _shipped() -> list[str]:
    """Every device and scenario that a part may read."""
    folders = (shipped_folder("geometry"), shipped_folder("maps") / "scenarios")
    paths = [path for folder in folders for path in sorted(folder.rglob("*.toml"))]
    return [f"{path.name}\n{path.read_text(encoding='utf-8')}" for path in paths]


@cache
def _of_a_map(path: Path, changed: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _list_or_dict(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else dict(value)

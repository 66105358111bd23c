"""The variants that are done, kept on disk one line each, so that a run that was killed goes on.

The first line names the study's fingerprint, each further one holds a variant. A line is on the disk before the next
variant counts as begun; a last line that a kill has cut is dropped. JSON gives numbers back as they were.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any, TextIO

from fieldmap.errors import InputError, Problem
from fieldmap.studies.summary import Row, VariantResult

SUFFIX = ".partial"


def journal_path(target: Path) -> Path:
    """Where the variants of a study are kept while it runs."""
    return target.with_name(target.name + SUFFIX)


class Journal:
    """The lines of one study; a context manager that closes the file."""

    def __init__(self, target: Path, fingerprint: str, resume: bool, retry: bool) -> None:
        """Variants of an earlier run are in `done` if it was the same study. retry: those that failed are left out."""
        self.path = journal_path(target)
        self.done: dict[int, VariantResult] = {}
        header = {"fieldmap_study": 1, "fingerprint": fingerprint}
        if resume:
            self.done = _read(self.path, header)
        if retry:
            self.done = {
                k: result for k, result in self.done.items() if not any(r.problems for r in result.rows)
            }
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._begin(header)
            self._file: TextIO = self.path.open("a", encoding="utf-8", newline="\n")
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError(
                Problem(
                    str(target), "must be a place that can be written", reason, "choose another with --output"
                )
            ) from None

    def _begin(self, header: dict[str, Any]) -> None:
        """The file anew, with the lines that are kept; complete or not there."""
        lines = [json.dumps(header)]
        lines += [_line(number, result) for number, result in sorted(self.done.items())]
        fresh = self.path.with_name(f"{self.path.name}.{os.getpid()}")
        fresh.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
        os.replace(fresh, self.path)

    def keep(self, number: int, result: VariantResult) -> None:
        """Add a variant; it is on the disk when this returns."""
        self._file.write(_line(number, result) + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.done[number] = result

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _line(number: int, result: VariantResult) -> str:
    return json.dumps({"variant": number, **asdict(result)})


def _read(path: Path, header: dict[str, Any]) -> dict[int, VariantResult]:
    """The variants of an earlier run of the same study; none if it was another one, or the file is none of ours."""
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
        if json.loads(lines[0]) != header:
            return {}
    except (OSError, ValueError):
        return {}
    done = {}
    for line in lines[1:-1]:  # what follows the last line's end was cut by a kill
        try:
            entry = json.loads(line)
            rows = tuple(Row(row["numbers"], tuple(row["problems"])) for row in entry["rows"])
            done[int(entry["variant"])] = VariantResult(rows, tuple(entry["assumptions"]))
        except (ValueError, KeyError, TypeError):
            return done
    return done

"""Errors as a reader wants them: each problem with where, what must hold, what was received, and the
remedy."""

import re
import shutil
import sys
import textwrap
from pathlib import Path

from fieldmap.cli.log import LOG
from fieldmap.errors import FieldmapError, Problem

_INDENT = 10
_WIDEST = 100
_LINE_OF_FILE = re.compile(r"(?P<file>.+\.toml):(?P<line>\d+)(: |$)")


def print_problems(error: FieldmapError) -> None:
    """Print every problem of an error on stderr, and how many there are."""
    for problem in error.problems:
        LOG.error("%s", problem)
        print(_problem_text(problem), file=sys.stderr)
    count = len(error.problems)
    if count:
        print(f"{count} problem{'s' if count > 1 else ''} found.", file=sys.stderr)
    else:
        print(f"error: {error}", file=sys.stderr)


def _problem_text(problem: Problem) -> str:
    return "\n".join(
        (
            _entry("error", problem.where, bold=True),
            *(_entry("", line) for line in _as_written(problem.where)),
            _entry("", problem.must_hold),
            _entry("received", problem.received),
            _entry("remedy", problem.remedy),
            "",
        )
    )


def _as_written(where: str) -> list[str]:
    """The line of the file at which a problem points, with its number; nothing if it points at none."""
    found = _LINE_OF_FILE.match(where)
    try:
        lines = Path(found["file"]).read_text(encoding="utf-8").splitlines() if found else []
    except (OSError, UnicodeDecodeError):
        return []
    number = int(found["line"]) if found else 0
    return [f"{number} | {lines[number - 1].strip()}"] if 0 < number <= len(lines) else []


def _entry(label: str, text: str, bold: bool = False) -> str:
    head = f"{label:<{_INDENT}}"
    # A program that reads stderr gets each entry on one line and no colour; people get long lines folded.
    if not sys.stderr.isatty():
        return head + str(text)
    width, space = min(shutil.get_terminal_size().columns, _WIDEST), " " * _INDENT
    folded = textwrap.fill(
        str(text), width=width, initial_indent=space, subsequent_indent=space, break_long_words=False
    )[_INDENT:]
    return f"\x1b[1;31m{head}\x1b[0m\x1b[1m{folded}\x1b[0m" if bold else f"\x1b[2m{head}\x1b[0m{folded}"

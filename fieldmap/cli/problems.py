"""How errors are printed: for people on stderr, for programs on stdout."""

import re
import shutil
import sys
import textwrap
from json import dumps
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


def print_as_json(error: FieldmapError) -> None:
    """Print an error on stdout for programs, where they look for the result: its name, exit code and problems, and what
    can be had in the place of what was asked for, where that is known (`fieldmap.errors.Infeasible`), or what was
    reached (`fieldmap.errors.MapErrorTooLarge`)."""
    # Not by `fieldmap.cli.printing`: the error may be that rich is missing.
    from fieldmap.plain import plain

    about = {"error": type(error).__name__, "message": str(error), "exit_code": error.exit_code}
    names = ("reachable", "share", "binding", "reached", "part")
    had = {name: getattr(error, name) for name in names if hasattr(error, name)}
    print(dumps(plain(about | {"problems": error.problems} | had), indent=2, allow_nan=False))


def _problem_text(problem: Problem) -> str:
    return "\n".join(
        (
            _entry("error", problem.where, bold=True),
            *(_entry("", line) for line in _line_of_file(problem.where)),
            _entry("", problem.must_hold),
            _entry("received", problem.received),
            _entry("remedy", problem.remedy),
            "",
        )
    )


def _line_of_file(where: str) -> list[str]:
    """The line of the file to which a problem points, with its number; nothing if it points to none."""
    found = _LINE_OF_FILE.match(where)
    try:
        lines = Path(found["file"]).read_text(encoding="utf-8").splitlines() if found else []
    except (OSError, UnicodeDecodeError):
        return []
    number = int(found["line"]) if found else 0
    return [f"{number} | {lines[number - 1].strip()}"] if 0 < number <= len(lines) else []


def _entry(label: str, text: str, bold: bool = False) -> str:
    head = f"{label:<{_INDENT}}"
    # Programs that read stderr get each entry on one line without colour; people get long lines folded.
    if not sys.stderr.isatty():
        return head + str(text)
    width, space = min(shutil.get_terminal_size().columns, _WIDEST), " " * _INDENT
    folded = textwrap.fill(
        str(text), width=width, initial_indent=space, subsequent_indent=space, break_long_words=False
    )[_INDENT:]
    return f"\x1b[1;31m{head}\x1b[0m\x1b[1m{folded}\x1b[0m" if bold else f"\x1b[2m{head}\x1b[0m{folded}"

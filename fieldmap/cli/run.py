"""Run one command line: options that may stand anywhere, exit codes, and how errors are printed."""

import re
import shutil
import sys
import textwrap
import time
from pathlib import Path

from fieldmap.cli.arguments import join_lists
from fieldmap.cli.log import LOG, begin_log, close_log
from fieldmap.errors import FieldmapError, Problem
from fieldmap.extras import require

INTERRUPTED = 130
_ANYWHERE = ("--quiet", "-q", "--verbose", "-v")
_INDENT = 10
_WIDEST = 100
_LINE_OF_FILE = re.compile(r"(?P<file>.+\.toml):(?P<line>\d+)(: |$)")


def run(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit code. A FieldmapError is printed, never a traceback."""
    given = sys.argv[1:] if argv is None else argv
    words = common_first(join_lists(given))
    begin = time.monotonic()
    begin_log(given)
    try:
        code = _run(words)
        LOG.info("exit code %d after %.1f s", code, time.monotonic() - begin)
    except BaseException:
        LOG.exception("unexpected error")
        raise
    finally:
        close_log()
    return code


def common_first(words: list[str]) -> list[str]:
    """Move the options that every command knows in front of its name, where the program looks for them.

    >>> common_first(["map", "quick", "-q", "--log", "map.log"])
    ['-q', '--log', 'map.log', 'map', 'quick']
    """
    first: list[str] = []
    rest: list[str] = []
    words = list(words)
    while words:
        word = words.pop(0)
        if word in _ANYWHERE or word.startswith("--log="):
            first.append(word)
        elif word == "--log" and words:
            first += [word, words.pop(0)]
        else:
            rest.append(word)
    return first + rest


def _run(words: list[str]) -> int:
    code = 0
    try:
        for library in ("typer", "rich"):
            require(library, "cli", "the command fieldmap", "call the functions of the package from Python")
        from fieldmap.cli.application import application

        application().main(args=words, prog_name="fieldmap")
    except SystemExit as done:
        code = done.code if isinstance(done.code, int) else int(done.code is not None)
    except FieldmapError as error:
        print_problems(error)
        code = error.exit_code
        if "--json" in words:
            print_as_json(error)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except OSError as error:
        LOG.error("%s", error)
        print(f"error: {error}", file=sys.stderr)
        code = 1
    if code == INTERRUPTED:
        print("interrupted", file=sys.stderr)
    return code


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
    can be had in the place of what was asked for, where that is known (`fieldmap.errors.Infeasible`)."""
    from fieldmap.cli.printing import print_json

    about = {"error": type(error).__name__, "message": str(error), "exit_code": error.exit_code}
    had = {name: getattr(error, name) for name in ("reachable", "share", "binding") if hasattr(error, name)}
    print_json(about | {"problems": error.problems} | had)


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

"""Output of a command on stderr and in its log: problems, warnings of maps, and every step."""

import logging
import re
import shlex
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from json import dumps
from pathlib import Path
from typing import TextIO

from fieldmap.arguments import raise_all
from fieldmap.errors import FieldmapError, InputError, MapAccuracyWarning, UnusualValueWarning
from fieldmap.file_contents import read_text
from fieldmap.progress import Progress
from fieldmap.records import count_of

LOG = logging.getLogger("fieldmap")
# Without this handler, logging itself would print an error a second time.
LOG.addHandler(logging.NullHandler())
# Waiting for workers is reported without a log, too.
logging.getLogger("fieldmap.parallel").addHandler(logging.lastResort or logging.NullHandler())
_STYLE = logging.Formatter("%(asctime)s %(levelname)-7s %(message)s")
_INDENT = 10
_WIDEST = 100
_LINE_OF_FILE = re.compile(r"(?P<file>.+\.toml):(?P<line>\d+)(: |$)")
_words: list[str] = []


def begin_log(words: list[str]) -> None:
    """Remember the command line, which is the first line of a log."""
    _words[:] = words


def log_to_file(path: Path) -> None:
    """Append later messages to a file. Raises InputError if it cannot be written or is not a log."""
    from fieldmap.store.output_formats import output_problems

    raise_all(output_problems("--log", path, ["log"]))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _log_to(logging.FileHandler(path, encoding="utf-8"))
    except OSError as error:
        must, received = "must be a file that can be written", f"{path}: {error.strerror}"
        raise InputError.of("--log", must, received, "name another") from None


def log_to_stderr() -> None:
    """Write later messages to stderr."""
    _log_to(logging.StreamHandler(sys.stderr))


def close_log() -> None:
    """Close the logs of `log_to_file` and `log_to_stderr`."""
    for handler in LOG.handlers[1:]:
        LOG.removeHandler(handler)
        handler.close()
    logging.captureWarnings(False)
    logging.getLogger("py.warnings").handlers.clear()


def _log_to(handler: logging.Handler) -> None:
    handler.setFormatter(_STYLE)
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(handler)
    LOG.info("fieldmap %s", shlex.join(_words))


@contextmanager
def resumable(title: str) -> Iterator[Progress]:
    """Progress of work that can be continued by the same command; an interruption prints a message that says so."""
    try:
        with Progress(title, compiles=True, timed=True) as progress:
            yield progress
    except KeyboardInterrupt:
        print("the same command continues from here; --fresh begins anew", file=sys.stderr)
        raise


@contextmanager
def map_warnings_as_lines() -> Iterator[None]:
    """Context in which warnings of the package are printed as one line, once for each text, and logged; other warnings
    are not changed."""
    ours = (MapAccuracyWarning, UnusualValueWarning)
    with warnings.catch_warnings():
        for category in ours:
            warnings.simplefilter("always", category)
        others, printed = warnings.showwarning, set[str]()

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, ours):
                others(message, category, filename, lineno, file, line)
            elif (text := str(message)) not in printed:
                printed.add(text)
                LOG.warning("%s", text)
                print(f"warning: {text}", file=sys.stderr)

        warnings.showwarning = show
        yield


def print_problems(error: FieldmapError) -> None:
    """Print every problem of an error on stderr, and how many there are."""
    for problem in error.problems:
        LOG.error("%s", problem)
        print(_entry("error", problem.where, bold=True), file=sys.stderr)
        rest = [*_line_of_file(problem.where), problem.must_hold]
        entries = [*(("", line) for line in rest), ("received", problem.received), ("remedy", problem.remedy)]
        print(*(_entry(*entry) for entry in entries), "", sep="\n", file=sys.stderr)
    count = len(error.problems)
    found = f"{count_of(count, 'problem', 'problems')} found." if count else f"error: {error}"
    print(found, file=sys.stderr)


def print_as_json(error: FieldmapError) -> None:
    """Print an error on stdout, where programs look for the result.

    The object has the error's name, exit code and problems, and if known also the reachable result
    (`fieldmap.errors.Infeasible`) or the reached accuracy (`MapErrorTooLarge`).
    """
    # Without `fieldmap.cli.page`, because the error may be that rich is missing.
    from fieldmap.plain import plain

    about = {"error": type(error).__name__, "message": str(error), "exit_code": error.exit_code}
    names = ("reachable", "share", "binding", "reached", "part")
    had = {name: getattr(error, name) for name in names if hasattr(error, name)}
    print(dumps(plain(about | {"problems": error.problems} | had), indent=2, allow_nan=False))


def _line_of_file(where: str) -> list[str]:
    """The line of the file to which a problem points, with its number; nothing if it points to none."""
    found = _LINE_OF_FILE.match(where)
    if found is None:
        return []
    try:
        lines = read_text(found["file"]).splitlines()
    except InputError:
        return []
    number = int(found["line"])
    return [f"{number} | {lines[number - 1].strip()}"] if 0 < number <= len(lines) else []


def _entry(label: str, text: str, bold: bool = False) -> str:
    head = f"{label:<{_INDENT}}"
    # Without a terminal each entry is one line without colour, for programs; a terminal folds long lines.
    if not sys.stderr.isatty():
        return head + str(text)
    width, space = min(shutil.get_terminal_size().columns, _WIDEST), " " * _INDENT
    folded = textwrap.fill(
        str(text), width=width, initial_indent=space, subsequent_indent=space, break_long_words=False
    )[_INDENT:]
    return f"\x1b[1;31m{head}\x1b[0m\x1b[1m{folded}\x1b[0m" if bold else f"\x1b[2m{head}\x1b[0m{folded}"

"""What a command did and when, to a file (--log FILE) or on stderr (--verbose)."""

import logging
import shlex
import sys
from pathlib import Path

from fieldmap.errors import InputError, Problem

LOG = logging.getLogger("fieldmap")
# Without it an error that nobody asked to log would be printed twice.
LOG.addHandler(logging.NullHandler())
_words: list[str] = []
_STYLE = logging.Formatter("%(asctime)s %(levelname)-7s %(message)s")


def begin_log(words: list[str]) -> None:
    """Remember the command: its first line, should it want a log."""
    _words[:] = words


def log_to_file(path: Path) -> None:
    """Write what follows to the end of a file; InputError if it cannot be written, or is a table."""
    if path.suffix.lower() == ".csv":
        must, remedy = (
            "must be a text file for lines about what is done",
            "a log of a rig goes behind --measured",
        )
        raise InputError(Problem("--log", must, str(path), remedy))
    try:
        _add(logging.FileHandler(path, encoding="utf-8"))
    except OSError as error:
        problem = Problem(
            "--log", "must be a file that can be written", f"{path}: {error.strerror}", "name another"
        )
        raise InputError(problem) from None


def log_to_stderr() -> None:
    """Write what follows to stderr."""
    _add(logging.StreamHandler(sys.stderr))


def close_log() -> None:
    """End what `log_to_file` and `log_to_stderr` began."""
    for handler in LOG.handlers[1:]:
        LOG.removeHandler(handler)
        handler.close()
    logging.captureWarnings(False)
    logging.getLogger("py.warnings").handlers.clear()


def _add(handler: logging.Handler) -> None:
    handler.setFormatter(_STYLE)
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(handler)
    LOG.info("fieldmap %s", shlex.join(_words))

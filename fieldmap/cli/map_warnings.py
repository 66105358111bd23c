"""How a command says that a map which it opens is less accurate than was asked for: one plain line on stderr."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

from fieldmap.cli.log import LOG
from fieldmap.errors import MapAccuracyWarning


@contextmanager
def map_warnings_as_lines() -> Iterator[None]:
    """Inside, a MapAccuracyWarning is printed as one line, once for each map, and logged; others are as before."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", MapAccuracyWarning)
        others, told = warnings.showwarning, set[str]()

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, MapAccuracyWarning):
                others(message, category, filename, lineno, file, line)
            elif (text := str(message)) not in told:
                told.add(text)
                LOG.warning("%s", text)
                print(f"warning: {text}", file=sys.stderr)

        warnings.showwarning = show
        yield

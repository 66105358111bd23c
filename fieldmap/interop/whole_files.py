"""Files that appear complete or not at all."""

import os
from pathlib import Path

from fieldmap.errors import InputError, Problem


def write_whole(path: Path, content: bytes) -> None:
    """Write to a name of its own beside `path`, then rename. Raises InputError if the place cannot be written."""
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        partial.write_bytes(content)
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        problem = Problem(
            str(path), "must be a place that can be written", error.strerror or str(error), "choose another"
        )
        raise InputError(problem) from None

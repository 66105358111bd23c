"""Files that appear under their names complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from fieldmap.arguments import raise_all
from fieldmap.errors import FieldmapError, InputError
from fieldmap.store.output_formats import output_problems
from fieldmap.typing import PathLike


@contextmanager
def whole_file(path: PathLike, kind: str, *others: str) -> Iterator[Path]:
    """Give a temporary path; the file written there gets its name `path` at the end of the block.

    An error in the block deletes the file. A killed process leaves it in a hidden folder, where no pattern such as
    ``*.h5`` finds it.

    Parameters
    ----------
    path
        Path of the file. Its folder is made.
    kind, *others
        Names of the formats that it may have (`fieldmap.store.output_formats`).

    Yields
    ------
    Path
        The same name in a hidden folder next to it.

    Raises
    ------
    InputError
        If the place cannot be written, has another ending, or holds a file of another origin.
    """
    target = Path(path)
    raise_all(output_problems(str(target), target, (kind, *others)))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(".part", ".", target.parent, ignore_cleanup_errors=True) as folder:
            partial = Path(folder, target.name)
            yield partial
            os.replace(partial, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError.of(
            str(target), "must be a place that can be written", reason, "choose another"
        ) from None


def write_whole(path: PathLike, content: bytes | str, kind: str) -> Path:
    """Write a file from memory, complete or not at all, and return its path.

    Parameters
    ----------
    path
        Path of the file.
    content
        Bytes, or a text that is written as UTF-8.
    kind
        Name of its format, as for `whole_file`.

    Returns
    -------
    Path
        The path.

    Raises
    ------
    InputError
        As `whole_file`.
    """
    with whole_file(path, kind) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)
    return Path(path)


@contextmanager
def disk_errors(path: PathLike) -> Iterator[None]:
    """Turn an OSError or RuntimeError of writing into a FieldmapError with a remedy."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]
        remedy = "free space on the disk or write elsewhere, then run again: finished parts are there"
        raise FieldmapError.of(
            os.fspath(path), "must be a file that can be written", reason, remedy
        ) from error


def sync_folder(folder: Path) -> None:
    """Flush a renaming in a folder to the disk, on systems that can open folders."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

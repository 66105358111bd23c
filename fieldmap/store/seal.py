"""The seal of a finished map file: its length and SHA-256, appended to it, and checked before HDF5 opens the file.

HDF5 has checksums for the numbers of a file, but not for its structure. A wrong byte in the structure can make a reader
read anything. So a file is opened only if all of its bytes are those that were written. Other programs ignore the seal,
because they do not read beyond the end of the HDF5 data. A program that changes the file cuts the seal off.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import BinaryIO

from fieldmap.errors import MapFileError

_SEAL = re.compile(rb"\n# sealed by fieldmap: ([0-9a-f]{16}) ([0-9a-f]{64})\n")
SEAL_LENGTH = 105
REMAKE = "make the map again: fieldmap map RECIPE"


def seal_map(path: str | os.PathLike[str]) -> None:
    """Seal a file as it is now. An earlier seal is replaced.

    Use this for a map that another program has changed on purpose.

    Parameters
    ----------
    path
        Of the file.

    Raises
    ------
    MapFileError
        If there is no such file, or it may not be written.
    OSError
        If the disk is full.
    """
    try:
        with Path(path).open("r+b") as stream:
            _write_seal(stream)
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        must_hold, remedy = (
            "must be a file that can be read and written",
            "check the path and its permissions",
        )
        raise MapFileError.of(os.fspath(path), must_hold, error.strerror or str(error), remedy) from None


def is_sealed(path: str | os.PathLike[str]) -> bool:
    """Whether there is a seal at the end of a file, valid or not. Raises OSError if the file cannot be read."""
    with Path(path).open("rb") as stream:
        return _read_seal(stream, _length(stream)) is not None


def check_seal(path: str | os.PathLike[str], remedy: str = REMAKE) -> None:
    """Check the seal of a file.

    Parameters
    ----------
    path
        Of the file.
    remedy
        For the message, as an alternative to copying the file again.

    Raises
    ------
    MapFileError
        If the file was changed, cut off, or never finished.
    OSError
        If it cannot be read.
    """
    with Path(path).open("rb") as stream:
        length = _length(stream)
        seal = _read_seal(stream, length)
        if seal is None:
            received = (
                "a file without seal at its end: cut off, damaged, foreign, or changed by another program"
            )
            raise _refused(path, "an undamaged map file", received, remedy)
        sealed_length, sealed_digest = seal
        if sealed_length != length - SEAL_LENGTH:
            received = f"{length - SEAL_LENGTH} bytes, where {sealed_length} were sealed: a damaged file"
            raise _refused(path, "an undamaged file", received, remedy)
        if _digest(stream, sealed_length) != sealed_digest:
            raise _refused(
                path, "an undamaged file", "a damaged file: its SHA-256 is not that of its seal", remedy
            )


def _write_seal(stream: BinaryIO) -> None:
    length = _length(stream)
    if _read_seal(stream, length) is not None:
        length -= SEAL_LENGTH
    digest = _digest(stream, length)
    stream.truncate(length)
    stream.seek(length)
    stream.write(f"\n# sealed by fieldmap: {length:016x} {digest}\n".encode())
    stream.flush()
    os.fsync(stream.fileno())


def _length(stream: BinaryIO) -> int:
    return stream.seek(0, os.SEEK_END)


def _read_seal(stream: BinaryIO, length: int) -> tuple[int, str] | None:
    """Length and digest that a seal at the end of the file states, or None."""
    if length < SEAL_LENGTH:
        return None
    stream.seek(length - SEAL_LENGTH)
    told = _SEAL.fullmatch(stream.read(SEAL_LENGTH))
    return None if told is None else (int(told[1], 16), told[2].decode())


def _digest(stream: BinaryIO, length: int) -> str:
    """SHA-256 of the first `length` bytes."""
    stream.seek(0)
    total, left = hashlib.sha256(), length
    while block := stream.read(min(left, 1 << 20)):
        total.update(block)
        left -= len(block)
    return total.hexdigest()


def _refused(path: str | os.PathLike[str], must_hold: str, received: str, remedy: str) -> MapFileError:
    return MapFileError.of(os.fspath(path), must_hold, received, f"copy it again, or {remedy}")

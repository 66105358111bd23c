"""The seal of a finished map file: its length and SHA-256, appended to it, and checked before HDF5 opens the file.

HDF5 has checksums for the numbers of a file, but not for its structure. A wrong byte in the structure can make a reader
read anything. So a file is opened only if all of its bytes are those that were written. Other programs ignore the seal,
because they do not read beyond the end of the HDF5 data. A program that changes the file cuts the seal off.

A large map has a second seal before the first: the places of its numbers, and the SHA-256 of all other bytes. It
suffices for a reader that opens the file without reading those numbers.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import BinaryIO, TypeAlias

from fieldmap.errors import MapFileError

_SEAL = re.compile(rb"\n# sealed by fieldmap: ([0-9a-f]{16}) ([0-9a-f]{64})\n")
SEAL_LENGTH = 105
# After a list of the places of numbers: offset of the list, and SHA-256 of all bytes before this line but the numbers.
_SECOND = re.compile(rb"\n# without numbers: ([0-9a-f]{16}) ([0-9a-f]{64})\n")
_SECOND_LENGTH = 102
_BLOCK = 1 << 20

Places: TypeAlias = Sequence[tuple[int, int]]
"""Offset and length, bytes, of ranges in a file."""
REMAKE = "make the map again: fieldmap map RECIPE"


def seal_map(path: str | os.PathLike[str], numbers: Places = ()) -> None:
    """Seal a file as it is now. An earlier seal is replaced.

    Use this for a map that another program has changed on purpose.

    Parameters
    ----------
    path
        Path of the file.
    numbers
        Places of numbers that need not be verified to open the file, ascending.

    Raises
    ------
    MapFileError
        If there is no such file, or it may not be written.
    OSError
        If the disk is full.
    """
    try:
        with Path(path).open("r+b") as stream:
            _write_seal(stream, numbers)
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


def check_seal(path: str | os.PathLike[str], remedy: str = REMAKE, numbers: bool = True) -> None:
    """Check the seal of a file.

    Parameters
    ----------
    path
        Path of the file.
    remedy
        For the message, as an alternative to copying the file again.
    numbers
        False to leave out the numbers of a large map, which are nearly all of its bytes.

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
        second = None if numbers else _read_second(stream, sealed_length)
        if second is not None:
            places, sealed_digest = second
            found = _digest(stream, sealed_length - _SECOND_LENGTH, places)
        else:
            found = _digest(stream, sealed_length)
        if found != sealed_digest:
            raise _refused(
                path, "an undamaged file", "a damaged file: its SHA-256 is not that of its seal", remedy
            )


def _write_seal(stream: BinaryIO, numbers: Places) -> None:
    length = _length(stream)
    if _read_seal(stream, length) is not None:
        length -= SEAL_LENGTH
    if (found := _find(_SECOND, _SECOND_LENGTH, stream, length)) is not None:
        length = int(found[1], 16)
    stream.truncate(length)
    if numbers:
        stream.seek(length)
        stream.write(json.dumps(list(numbers)).encode())
        digest = _digest(stream, _length(stream), numbers)
        stream.write(f"\n# without numbers: {length:016x} {digest}\n".encode())
        length = _length(stream)
    digest = _digest(stream, length)
    stream.seek(length)
    stream.write(f"\n# sealed by fieldmap: {length:016x} {digest}\n".encode())
    stream.flush()
    os.fsync(stream.fileno())


def _length(stream: BinaryIO) -> int:
    return stream.seek(0, os.SEEK_END)


def _find(line: re.Pattern[bytes], size: int, stream: BinaryIO, length: int) -> re.Match[bytes] | None:
    """The line in the last `size` of the first `length` bytes, or None."""
    if length < size:
        return None
    stream.seek(length - size)
    return line.fullmatch(stream.read(size))


def _read_seal(stream: BinaryIO, length: int) -> tuple[int, str] | None:
    """Length and digest that a seal at the end of the file states, or None."""
    told = _find(_SEAL, SEAL_LENGTH, stream, length)
    return None if told is None else (int(told[1], 16), told[2].decode())


def _read_second(stream: BinaryIO, length: int) -> tuple[Places, str] | None:
    """Places of numbers and digest that the second seal before the end `length` states, or None.

    Raises ValueError or TypeError if the places are no list of ranges.
    """
    told = _find(_SECOND, _SECOND_LENGTH, stream, length)
    if told is None:
        return None
    begin = int(told[1], 16)
    stream.seek(begin)
    places = json.loads(stream.read(max(0, length - _SECOND_LENGTH - begin)))
    return [(int(offset), int(size)) for offset, size in places], told[2].decode()


def _digest(stream: BinaryIO, length: int, without: Places = ()) -> str:
    """SHA-256 of the first `length` bytes, except the bytes at some places."""
    total = hashlib.sha256()
    for offset, size in others(without, length):
        stream.seek(offset)
        while size > 0 and (block := stream.read(min(size, _BLOCK))):
            total.update(block)
            size -= len(block)
    return total.hexdigest()


def others(places: Iterable[tuple[int, int]], length: int) -> Iterable[tuple[int, int]]:
    """Offset and length of the ranges between ascending places, up to `length`."""
    begin = 0
    for offset, size in [*places, (length, 0)]:
        if offset > begin:
            yield begin, offset - begin
        begin = max(begin, offset + size)


def _refused(path: str | os.PathLike[str], must_hold: str, received: str, remedy: str) -> MapFileError:
    return MapFileError.of(os.fspath(path), must_hold, received, f"copy it again, or {remedy}")

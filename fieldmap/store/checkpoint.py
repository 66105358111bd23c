"""Checkpoints: finished pieces of long work in one file. A run that was killed is resumed from them.

All long work uses them: the parts of a map and the states that train it, the variants of a study, the parts of a
report. For example::

    with Checkpoint(target.with_name("report.partial"), fingerprint(settings, packages)) as checkpoint:
        for name in parts:
            piece = checkpoint.get(name)
            if piece is None:
                checkpoint.put(name, arrays={"field": compute(name)}, about={"seconds": 12.0})
    checkpoint.remove()     # once the result that the pieces are for is written

A file begins with a line of JSON that holds the fingerprint. Pieces are appended. Each has a line with the SHA-256 of
the following bytes and their lengths, a header (JSON with key, `about`, and names, types and shapes of the arrays), and
the bytes of the arrays. A piece is on the disk before `put` returns. An incomplete piece, or one with a wrong SHA-256,
is ignored.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fieldmap.errors import InputError, Problem
from fieldmap.file_contents import file_in_words
from fieldmap.records import tuple_line
from fieldmap.store.whole_files import disk_errors
from fieldmap.typing import PathLike

FORMAT = 1
SUFFIX, KEPT = ".partial", ".kept"
# First line of a piece, and its length in bytes: SHA-256, length of the header, length of the arrays.
_FIRST_LINE = re.compile(rb"([0-9a-f]{64}) ([0-9a-f]{16}) ([0-9a-f]{16})\n")
_PREFIX = 99
# Seconds between attempts to lock a file that another run has open.
_PAUSE = 0.05
# Byte that is locked on Windows: the largest offset of a 32-bit call.
_LOCKED_BYTE = 0x7FFFFFFE
_BEGINNING = b'{"fieldmap_checkpoint": '


class Piece(NamedTuple):
    """The contents of a piece: arrays by name, and plain JSON."""

    arrays: dict[str, NDArray[Any]]
    about: dict[str, Any]

    def __repr__(self) -> str:
        return tuple_line(self)


class _Place(NamedTuple):
    begin: int
    header: int
    payload: int


def checkpoint_path(target: PathLike, stays: bool = False) -> Path:
    """Where the work on a file is kept while it is being made.

    Parameters
    ----------
    target
        The file.
    stays
        Whether later runs use the pieces after the file is complete: variants of a study, designs of a search.

    Returns
    -------
    Path
        Path of the checkpoint.
    """
    return Path(target).with_name(Path(target).name + (KEPT if stays else SUFFIX))


class Checkpoint:
    """Pieces of work by key. A context manager that closes the file.

    An existing file is used only if its fingerprint is the same. A file with another fingerprint is emptied, and so is
    one whose first line is damaged. The attribute `note` says why a file was emptied, or is "".

    Parameters
    ----------
    path
        Path of the file, which is made with its folder if it does not exist.
    fingerprint
        All inputs that determine the pieces, as one text or as texts by name.
    resume
        False to empty any existing file.
    wait
        Seconds to wait for another run that has the file open.

    Raises
    ------
    InputError
        If the file cannot be written, is one of another origin, or another run still has it open (on systems with file
        locks).
    """

    def __init__(
        self, path: PathLike, fingerprint: str | Mapping[str, str], resume: bool = True, wait: float = 0.0
    ) -> None:
        self.path = Path(path)
        decides = {"fingerprint": fingerprint} if isinstance(fingerprint, str) else dict(fingerprint)
        self._places: dict[str, _Place] = {}
        self.note = ""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = _opened(self.path, wait)
        except OSError as error:
            raise InputError(_cannot_write(self.path, error)) from error
        try:
            found = os.fstat(self._file.fileno()).st_size
            if found:
                self._refuse_foreign()
                self.note = self._find(decides) if resume else "begun anew, as asked"
            if self.note or not found:
                self._begin(decides)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __contains__(self, key: str) -> bool:
        return key in self._places

    def __iter__(self) -> Iterator[str]:
        """Keys in the order in which the pieces were added."""
        return iter(tuple(self._places))

    def __len__(self) -> int:
        return len(self._places)

    def get(self, key: str) -> Piece | None:
        """The piece of a key.

        Parameters
        ----------
        key
            The key.

        Returns
        -------
        Piece | None
            The piece, or None. Arrays have the bits, types and shapes that they were given with.
        """
        place = self._places.get(key)
        if place is None:
            return None
        self._file.seek(place.begin + _PREFIX)
        header = json.loads(_read(self._file, place.header))
        arrays = {}
        for name, dtype, shape in header["arrays"]:
            values = np.empty(shape, np.dtype(dtype))
            raw = _read(self._file, values.nbytes)
            arrays[name] = np.frombuffer(raw, values.dtype).reshape(shape).copy()
        return Piece(arrays, header["about"])

    def put(
        self,
        key: str,
        arrays: Mapping[str, NDArray[Any]] | None = None,
        about: Mapping[str, Any] | None = None,
    ) -> None:
        """Add a piece, or replace the one of the same key. It is on the disk when this returns.

        Parameters
        ----------
        key
            Key of the piece.
        arrays
            Arrays by name.
        about
            Plain JSON.

        Raises
        ------
        FieldmapError
            If the disk is full. Earlier pieces remain.
        """
        contents = {name: np.asarray(values) for name, values in (arrays or {}).items()}
        shapes = [[name, values.dtype.str, list(values.shape)] for name, values in contents.items()]
        header = json.dumps({"key": key, "about": dict(about or {}), "arrays": shapes}).encode()
        payload = b"".join(values.tobytes() for values in contents.values())
        digest = hashlib.sha256(header + payload).hexdigest()
        prefix = f"{digest} {len(header):016x} {len(payload):016x}\n".encode()
        begin = self._file.seek(0, os.SEEK_END)
        with disk_errors(self.path):
            try:
                self._append(prefix + header + payload + b"\n")
            except OSError:
                with suppress(OSError):
                    self._file.truncate(begin)
                raise
        self._places.pop(key, None)
        self._places[key] = _Place(begin, len(header), len(payload))

    def close(self) -> None:
        """Close the file; its pieces remain for another run."""
        self._file.close()

    def remove(self) -> None:
        """Close and delete the file, after the work is complete."""
        # The file is deleted while it is locked, so that no other run opens it first. Windows cannot delete open files.
        try:
            self.path.unlink(missing_ok=True)
        except PermissionError:
            self.close()
            self.path.unlink()
        self.close()

    def _begin(self, decides: Mapping[str, str]) -> None:
        self._places.clear()
        with disk_errors(self.path):
            self._file.truncate(0)
            first_line = {"fieldmap_checkpoint": FORMAT, "fingerprint": dict(decides)}
            self._append(json.dumps(first_line).encode() + b"\n")

    def _refuse_foreign(self) -> None:
        """Raise InputError for a file that does not begin as a checkpoint, nor as the torn beginning of one."""
        self._file.seek(0)
        begin = _read(self._file, len(_BEGINNING))
        if not _BEGINNING.startswith(begin):
            must_hold = "must not replace a file of another origin: it may replace a checkpoint"
            remedy = "move that file away, or give the output another name"
            raise InputError.of(str(self.path), must_hold, file_in_words(self.path), remedy)

    def _find(self, decides: Mapping[str, str]) -> str:
        """Find the pieces, and cut off the bytes after the last complete one.

        Returns the reason if the file cannot be used, otherwise "".
        """
        self._file.seek(0)
        try:
            line = self._file.readline()
            there = json.loads(line)["fingerprint"]
            changed = [name for name in decides if there.get(name) != decides[name]]
        except (ValueError, KeyError, TypeError, AttributeError):
            return "damaged, begun anew"
        if not line.endswith(b"\n"):
            return "damaged, begun anew"
        if there != decides:
            return f"made with another {', '.join(changed) or 'fingerprint'}, begun anew"
        end = self._file.tell()
        while (piece := _next_piece(self._file)) is not None:
            key, place = piece
            if key:
                self._places.pop(key, None)
                self._places[key] = place
            end = self._file.tell()
        self._file.truncate(end)
        return ""

    def _append(self, content: bytes) -> None:
        """Write at the end and flush to the disk (fsync)."""
        left = memoryview(content)
        while left:
            left = left[self._file.write(left) :]
        os.fsync(self._file.fileno())


def _read(file: FileIO, count: int) -> bytes:
    """The next `count` bytes; fewer only at the end of the file. One read call may return less than asked for."""
    content = b""
    while more := file.read(count - len(content)):
        content += more
    return content


def _next_piece(file: FileIO) -> tuple[str, _Place] | None:
    """Read the piece at the present position, and move to its end.

    Returns its key and place; an empty key if its SHA-256 is wrong; None if no complete piece follows.
    """
    begin = file.tell()
    told = _FIRST_LINE.fullmatch(_read(file, _PREFIX))
    if told is None:
        return None
    place = _Place(begin, int(told[2], 16), int(told[3], 16))
    length = place.header + place.payload
    # A newline ends the piece.
    if length >= os.fstat(file.fileno()).st_size - file.tell():
        return None
    contents = _read(file, length)
    file.seek(1, os.SEEK_CUR)
    if hashlib.sha256(contents).hexdigest().encode() != told[1]:
        return "", place
    return str(json.loads(contents[: place.header])["key"]), place


def _opened(path: Path, wait: float) -> FileIO:
    """Open the file, or make it, and lock it for this process if the system has file locks."""
    until = time.monotonic() + wait
    while True:
        # The file has no buffer: on closing, a buffer would again write the bytes that a full disk refused.
        file = FileIO(path, "a+")
        try:
            _lock(file)
            # Another run may have deleted the file between opening and locking.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                    return file
        except BlockingIOError:
            if time.monotonic() >= until:
                file.close()
                raise
            time.sleep(_PAUSE)
        except BaseException:
            file.close()
            raise
        file.close()


def _lock(file: FileIO) -> None:
    """Lock the file. Raises BlockingIOError if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        # On Windows locked bytes cannot be read either. So one byte is locked, beyond all pieces.
        place = file.tell()
        file.seek(_LOCKED_BYTE)
        try:
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(str(error)) from None
        finally:
            file.seek(place)
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        pass  # a file system without locks


def _cannot_write(path: Path, error: OSError) -> Problem:
    if isinstance(error, BlockingIOError):
        received, remedy = "a file that another run has open", "wait for that run or end it"
        return Problem(str(path), "must be written by one run at a time", received, remedy)
    remedy = "choose a folder that exists and that you may write to"
    return Problem(str(path), "must be a file that can be written", error.strerror or str(error), remedy)

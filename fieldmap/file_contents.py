"""The text of a file, and a description of its content for messages."""

import codecs
import re
from pathlib import Path

from fieldmap.errors import InputError
from fieldmap.typing import PathLike

_HEAD = 1 << 24
_BINARY = "a binary file"
_KINDS = (
    (rb"\A\x89HDF", "an HDF5 file"),
    (rb"\A\x89PNG|\A\xff\xd8\xff|\AGIF8", "a picture"),
    (rb"\APK", "a zip archive"),
    (rb"\A%PDF", "a PDF document"),
    (rb"\A(CDF|\x7fELF|\x1f\x8b)|(?s:\A(?!\xff\xfe|\xfe\xff).*\x00)", _BINARY),
)


def head_of(path: PathLike) -> bytes:
    """The first 16 MiB of a file. Raises OSError."""
    with Path(path).open("rb") as stream:
        return stream.read(_HEAD)


def file_in_words(path: PathLike) -> str:
    """Describe the kind of a file by its first bytes, and a text by its first line.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    str
        Such as "a picture", or "a text that begins with 'time,x'".
    """
    try:
        head = head_of(path)
    except OSError as error:
        return f"unreadable: {error.strerror}"
    return _in_words(head)


def _in_words(head: bytes) -> str:
    if not head:
        return "an empty file"
    for pattern, words in _KINDS:
        if re.search(pattern, head):
            return words
    text = head.decode("utf-16" if head.startswith(_UTF_16) else "utf-8", "replace")
    lines = text.lstrip(chr(0xFEFF)).splitlines()
    return f"a text that begins with {lines[0].strip()[:40]!r}" if lines else "a file without a text"


_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: PathLike, error: type[InputError] = InputError, otherwise: str = "") -> str:
    """The text of a file in UTF-8, or in UTF-16 with a byte order mark (BOM). Line ends stay as they are.

    Parameters
    ----------
    path
        The file.
    error
        Class of the error.
    otherwise
        Encoding of a text that is not UTF-8, such as "latin-1"; none by default.

    Returns
    -------
    str
        The text without the BOM.

    Raises
    ------
    InputError
        For a file that cannot be read or decoded.
    """
    try:
        content = Path(path).read_bytes()
    except OSError as unreadable:
        received = unreadable.strerror or str(unreadable)
        remedy = "check the path and its permissions"
        raise error.of(str(path), "must be a file that can be read", received, remedy) from None
    marked = content.startswith(_UTF_16)
    received = _in_words(content[:_HEAD])
    if received == _BINARY:
        received += ", or UTF-16 without the mark at its beginning (BOM)"
    if marked or b"\0" not in content:
        try:
            return content.decode("utf-16" if marked else "utf-8-sig")
        except UnicodeDecodeError as wrong:
            if otherwise and not marked:
                return content.decode(otherwise)
            line = content.count(b"\n", 0, wrong.start) + 1
            received += f", with a byte in line {line} that is not of this encoding"
    raise error.of(str(path), "must be a text in UTF-8", received, "save it as text in UTF-8")

"""Three sorts of mistakes: in bytes and characters, in the structure, and in references to other files."""

import copy
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from validation.corruption import BYTES
from validation.fuzzing.case import Generator

NUMBERS = (
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, 1e-30, 1e30, 0, 0.0, -0.0, -1, 1, 2),
    *(10**400, -(10**400), 2**63, 2**70, 1e18, 1e9, 0.1, 999_999_999),
)
OTHERS = (
    *("text", "", "= 1/0", "= 9**9**9", "= pi*(1", "{k}", "\x00", "\u202e", "x" * 3000, True, False),
    *([], {}, [[1, 2], [3]], [{"name": "x"}, 1], {"a": {"b": 1}}, [1.0] * 500, [[[[[[1]]]]]], [None] * 0),
)
KEYS = ("colour", "radius_m", "name ", "x" * 5000, "ключ", "", "format", "__class__", "a.b")
ALPHABET = (
    "\x00", "\n", "\r", "\t", "\ufeff", "\u2028", '"', '"""', "'", "\\", "\\u12", "=", "[", "]]", "{", "#",
    ",", ";", ".", "-", "+", "e999", "nan", "inf", "0x", "1_0", "1e5", "(" * 300, "[" * 3000, "9" * 5000,
    "∞", "é", "!!python/object/apply:os.system ['true']", "&a [*a]", "<<: *a", "%s%n", "=cmd|' /C calc'!A0",
    "vertex", "*",
)  # fmt: skip


def bytes_of(raw: bytes, rng: Generator) -> tuple[str, bytes]:
    """Damage as by disks, copies and transfers. Returns a description and the bytes."""
    change = BYTES[int(rng.integers(len(BYTES)))]
    if len(raw) < 1100:
        change = BYTES[int(rng.integers(4))]
    if len(raw) < 8:
        return "nothing left", b""
    return change.__name__, bytes(change(bytearray(raw), rng))


def characters(text: str, rng: Generator) -> tuple[str, str]:
    """One to three typing errors. Returns a description and the text."""
    done = []
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, len(text) + 1))
        length = int(rng.integers(1, 40))
        what = str(rng.choice(["insert", "replace", "delete", "double", "lines", "digit", "end"]))
        piece = ALPHABET[int(rng.integers(len(ALPHABET)))]
        if what == "insert":
            text = text[:at] + piece + text[at:]
        elif what == "replace":
            text = text[:at] + piece + text[at + 1 :]
        elif what == "delete":
            text = text[:at] + text[at + length :]
        elif what == "double":
            text = text[: at + length] + text[at:]
        elif what == "lines":
            lines = text.split("\n")
            i, j = (int(k) for k in rng.integers(0, len(lines), 2))
            lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
        elif what == "digit":
            digits = [k for k, letter in enumerate(text) if letter.isdigit()]
            if digits:
                k = digits[int(rng.integers(len(digits)))]
                text = (
                    text[:k] + str(rng.choice(["-", "e", "9", "0", ".", "nan", "1e308", "x"])) + text[k + 1 :]
                )
        else:
            text = text[:at]
        done.append(what)
    return " and ".join(done), text


def places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Every place of the data: (table or array, key)."""
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in entries:
        yield data, key
        yield from places(value)


def structure(data: Any, rng: Generator) -> tuple[str, Any]:
    """The data with one to three mistakes in its values, lengths and keys."""
    data, done = copy.deepcopy(data), []
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        there = list(places(data))
        if not there:
            break
        table, key = there[int(rng.integers(len(there)))]
        done.append(_one_mistake(table, key, rng))
    return " and ".join(done), data


def _one_mistake(table: Any, key: Any, rng: Generator) -> str:
    value = table[key]
    what = str(rng.choice(["drop", "double", "retype", "number", "negative", "key", "shorter", "scale"]))
    if what == "drop":
        del table[key]
    elif what == "double" and isinstance(value, list):
        value += copy.deepcopy(value)
    elif what == "double" and isinstance(table, list):
        table.append(copy.deepcopy(value))
    elif what == "shorter" and isinstance(value, list) and value:
        value.pop()
    elif what == "negative" and isinstance(value, int | float):
        table[key] = -value
    elif what == "scale" and isinstance(value, int | float) and not isinstance(value, bool):
        table[key] = value * float(rng.choice([1e-6, 1e-3, 0.5, 2.0, 1e3, 1e6]))
    elif what == "key" and isinstance(table, dict):
        table[KEYS[int(rng.integers(len(KEYS)))]] = table.pop(key)
    elif what in ("number", "negative", "scale"):
        table[key] = NUMBERS[int(rng.integers(len(NUMBERS)))]
        what = f"{table[key]!s:.20}"
    else:
        table[key] = copy.deepcopy(OTHERS[int(rng.integers(len(OTHERS)))])
        what = f"{table[key]!s:.20}"
    return f"{what} at {key!s:.30}"


def strange_places(folder: Path) -> tuple[str, ...]:
    """Paths that a file might name but should not: missing files, folders, devices, pipes, loops, secrets, no paths."""
    pipe, loop, secret = folder / "pipe", folder / "loop", decoys(folder) / "secret.toml"
    if hasattr(os, "mkfifo") and not pipe.exists():
        os.mkfifo(pipe)
    if not loop.is_symlink():
        loop.symlink_to(loop)
    return (
        *(
            "missing.toml",
            ".",
            "..",
            "/",
            "",
            " ",
            "\x00",
            "x" * 5000,
            "a/" * 2000,
            "~root",
            "file:///etc/passwd",
        ),
        *(
            str(folder),
            str(pipe),
            str(loop),
            str(secret),
            "/dev/null",
            "/dev/zero",
            "/dev/stdin",
            "/proc/self/mem",
        ),
        *(
            "/etc/passwd",
            "../" * 30 + "etc/passwd",
            "input.toml",
            "input.h5",
            "con",
            "-",
            "*",
            "|true",
            "$(true)",
        ),
    )


def decoys(folder: Path) -> Path:
    """Make a folder next to the inputs with files that nothing may read."""
    there = folder / "decoys"
    if not there.exists():
        there.mkdir()
        (there / "secret.toml").write_text("password = 1\n")
        (there / "other.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(400))
    return there


def other_files(data: Any, rng: Generator, paths: tuple[str, ...], keys: tuple[str, ...]) -> tuple[str, Any]:
    """The data with a strange path instead of the name of a file or of any text."""
    data = copy.deepcopy(data)
    texts = [(table, key) for table, key in places(data) if isinstance(table[key], str)]
    named = [place for place in texts if place[1] in keys]
    chosen = named if named and rng.random() < 0.8 else texts
    if not chosen:
        return "nothing", data
    table, key = chosen[int(rng.integers(len(chosen)))]
    table[key] = paths[int(rng.integers(len(paths)))]
    return f"path {table[key]!r:.40} at {key!s:.30}", data


Way = Callable[[Generator], tuple[str, bytes]]


def any_way(ways: tuple[Way, ...], rng: Generator, number: int) -> tuple[str, bytes]:
    """Use the ways in turn. Returns a description and the bytes to write."""
    return ways[number % len(ways)](rng)

"""Line numbers of the keys of a TOML file. tomllib gives none, so the text is scanned once more.

Only called on text that tomllib has accepted: the scan need not find errors, only statements. Keys inside
inline tables and entries of arrays are not indexed; they take the line of the key that holds them.
"""

import re
import tomllib
from typing import Any

from fieldmap.inputs.key_paths import Location, Step

# Keys as nearly all are, which need no parser: letters, digits, underscores and dashes, with dots between.
_BARE = re.compile(r"[A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)*")
_SOMETHING = re.compile(r"\S")
# What ends a run of characters that mean nothing to the scan.
_SPECIAL = re.compile(r"[\n=\"'#\[\]{}]")


def line_numbers(text: str) -> dict[Location, int]:
    """Line (from 1) of every table header and every key, by location.

    >>> line_numbers('name = "x"\\n[[coil]]\\nturns = 5\\n')
    {('name',): 1, ('coil', 0): 2, ('coil',): 2, ('coil', 0, 'turns'): 3}
    """
    lines: dict[Location, int] = {}
    counts: dict[Location, int] = {}
    table: Location = ()
    line, counted = 1, 0
    for start, statement in _statements(text):
        line += text.count("\n", counted, start)
        counted = start
        if statement.startswith("["):
            table = _header(statement, counts)
            lines.setdefault(table, line)
            # The array that an entry belongs to has the line of its first entry.
            lines.setdefault(table[:-1] if isinstance(table[-1], int) else table, line)
        else:
            for length in range(1, len(key := _key_steps(statement)) + 1):
                lines.setdefault((*table, *key[:length]), line)
    return lines


def nearest_line(lines: dict[Location, int], location: Location) -> int | None:
    """Line of the location, or of the closest thing around it."""
    for length in range(len(location), 0, -1):
        if location[:length] in lines:
            return lines[location[:length]]
    return None


def _header(statement: str, counts: dict[Location, int]) -> Location:
    """Location of a [table] or [[table]]; `counts` remembers how often each array of tables came."""
    steps = _bare_steps(statement.strip("[] \t")) or _steps(tomllib.loads(statement))
    location: Location = ()
    for k, step in enumerate(steps):
        location = (*location, step)
        last = k == len(steps) - 1
        if last and statement.startswith("[["):
            counts[location] = counts.get(location, 0) + 1
        if location in counts:
            location = (*location, counts[location] - 1)
    return location


def _key_steps(statement: str) -> tuple[Step, ...]:
    """Steps of the key of `key = value`; a quoted one by tomllib itself, with a value that it surely accepts."""
    end = _find(statement, 0, "=")
    return _bare_steps(statement[:end].strip(" \t")) or _steps(tomllib.loads(statement[:end] + "= 0"))


def _bare_steps(key: str) -> tuple[str, ...]:
    """Steps of a dotted key without quotes and spaces; none of any other."""
    return tuple(key.split(".")) if _BARE.fullmatch(key) else ()


def _steps(nested: Any) -> tuple[str, ...]:
    steps: list[str] = []
    while True:
        if isinstance(nested, list):
            nested = nested[0]
        if not isinstance(nested, dict) or not nested:
            return tuple(steps)
        (step,) = nested
        steps.append(step)
        nested = nested[step]


def _statements(text: str) -> list[tuple[int, str]]:
    """(position, text) of every header and every key = value, comments and blank lines left out."""
    statements = []
    position = 0
    while something := _SOMETHING.search(text, position):
        position = something.start()
        end = _find(text, position, "\n")
        if text[position] != "#":
            statements.append((position, text[position:end]))
        position = end + 1
    return statements


def _find(text: str, position: int, wanted: str) -> int:
    """Position of the next `wanted` outside strings, comments and brackets, or the text's end."""
    depth = 0
    while special := _SPECIAL.search(text, position):
        position = special.start()
        character = special[0]
        if character == wanted and depth == 0:
            return position
        if character in "\"'":
            position = _string_end(text, position)
            continue
        if character == "#":
            position = _line_end(text, position)
            continue
        depth += (character in "[{") - (character in "]}")
        position += 1
    return len(text)


def _line_end(text: str, position: int) -> int:
    end = text.find("\n", position)
    return len(text) if end < 0 else end


def _string_end(text: str, position: int) -> int:
    """Position after the string that begins here."""
    quote = text[position]
    fence = quote * 3 if text.startswith(quote * 3, position) else quote
    position += len(fence)
    while not text.startswith(fence, position):
        position += 2 if quote == '"' and text[position] == "\\" else 1
    position += len(fence)
    while len(fence) == 3 and position < len(text) and text[position] == quote:  # """a quote at the end""""
        position += 1
    return position

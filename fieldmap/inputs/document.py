"""A TOML file as read: text, data, and problems with their lines."""

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from fieldmap.errors import FieldmapError, InputError, Problem
from fieldmap.file_contents import read_text
from fieldmap.inputs.explain import explain, without_tags
from fieldmap.inputs.findings import Finding, shown
from fieldmap.inputs.key_paths import Location, Step, dotted
from fieldmap.records import Record


@dataclass(frozen=True, repr=False)
class AtKey(Problem):
    """A problem at a key path, from code that does not know the file; `Document.placing` adds file and line."""


@dataclass(frozen=True, repr=False)
class Document(Record):
    """A parsed TOML file; `data` and `text` as read.

    After short forms (repetition, arithmetic, other files) were written out: raw: the document as read; origins: for
    locations of the data, the document and location from which they come; computed: the expression of each computed
    number. changes: values by key path in place of those of the file; stated: the values of the file, by the same key
    paths. alone: whether the text comes from another file, such as a map; only shipped files that it names are then
    read.
    """

    path: Path
    text: str
    data: dict[str, Any]
    raw: "Document | None" = None
    origins: Mapping[Location, tuple["Document", Location]] = field(default_factory=dict)
    computed: Mapping[Location, str] = field(default_factory=dict)
    changes: Mapping[str, Any] = field(default_factory=dict)
    stated: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    alone: bool = False

    def problems(self, findings: list[Finding]) -> list[Problem]:
        """The problems of findings, with file and line, in the order of lines."""
        lines: dict[Path, dict[Location, int]] = {}
        placed = []
        for finding in findings:
            document, location = self.origin(finding.location)
            if document.path not in lines:
                lines[document.path] = line_numbers(document.text)
            line = nearest_line(lines[document.path], location) or 0
            placed.append((document.path != self.path, str(document.path), line, finding))
        placed.sort(key=lambda place: place[:3])
        return [self._problem(path, line, finding) for _, path, line, finding in placed]

    def origin(self, location: Location) -> tuple["Document", Location]:
        """The document in which a location of the data was written, and where."""
        for length in range(len(location), 0, -1):
            if location[:length] in self.origins:
                document, start = self.origins[location[:length]]
                return document, (*start, *location[length:])
        return self, location

    def problem(self, key: str, must_hold: str, received: str, remedy: str) -> Problem:
        """One problem at a dotted key of the file; of the whole file if the key is ""."""
        line = nearest_line(line_numbers(self.text), tuple(key.split("."))) if key else None
        place = f"{self.path}:{line}" if line else str(self.path)
        return Problem(f"{place}: {key}" if key else place, must_hold, received, remedy)

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Give problems at keys (`AtKey`) that are raised in this block the lines of this file."""
        try:
            yield
        except FieldmapError as error:
            if not any(isinstance(problem, AtKey) for problem in error.problems):
                raise
            placed = [
                self.problem(one.where, one.must_hold, one.received, one.remedy)
                if isinstance(one, AtKey)
                else one
                for one in error.problems
            ]
            told = type(error)(*placed)
            # Other attributes of the error, such as the history of a solver, are kept.
            vars(told).update({name: value for name, value in vars(error).items() if name != "problems"})
            raise told from None

    def _problem(self, file: str, line: int, finding: Finding) -> Problem:
        place = f"{file}:{line}" if line else file
        path = dotted(self.data, finding.location)
        where = f"{place}: {path}" if path else place
        text = self.computed.get(finding.location)
        received = finding.received if text is None else f'{finding.received}, from "{text}"'
        return Problem(where, finding.must_hold, received, finding.remedy)


def parse(path: Path, error: type[InputError]) -> Document:
    """Parse a TOML file. Raises `error` if it cannot be read, with line and column of the first syntax error."""
    return parsed(path, read_text(path, error), error)


def parsed(path: Path, text: str, error: type[InputError]) -> Document:
    """Parse a text as the document of a path. Raises `error` if it is no TOML."""
    text = text.replace("\r\n", "\n")
    try:
        return Document(path, text, tomllib.loads(text))
    except RecursionError:
        received = "arrays or tables hundreds of levels deep"
        raise error.of(str(path), "must be valid TOML", received, "write them flat") from None
    except tomllib.TOMLDecodeError as wrong:
        raise error(_syntax_problem(path, text, str(wrong))) from wrong
    except ValueError:
        # Python limits the digits of a whole number.
        long = re.search(rf"[\d_]{{{sys.get_int_max_str_digits() or 1}}}", text)
        where = str(path) if long is None else f"{path}:{text.count(chr(10), 0, long.start()) + 1}"
        must_hold, received = "the file must be valid TOML", "a whole number of thousands of digits"
        raise error.of(where, must_hold, received, "write it with fewer digits") from None


def _syntax_problem(path: Path, text: str, message: str) -> Problem:
    where, received = str(path), message
    if found := re.search(r"at line (\d+), column (\d+)", message):
        line = int(found[1])
        where = f"{path}:{line}:{found[2]}"
        received = f"{message.split(' (at ')[0]}, in the line {shown(text.splitlines()[line - 1].strip())}"
    remedy = "correct the line; texts have quotes, a table begins with [name], a repeated one with [[name]]"
    return Problem(where, "the file must be valid TOML", received, remedy)


def schema_findings(root: type[BaseModel], data: dict[str, Any]) -> list[Finding]:
    """Everything that the schema finds wrong in the data."""
    try:
        root.model_validate(data)
    except ValidationError as error:
        return [explain(detail, root, data) for detail in _of_the_right_type(error, data)]
    return []


def _of_the_right_type(error: ValidationError, data: dict[str, Any]) -> list[ErrorDetails]:
    """The errors without those about a wrong type in a union, unless the value fits no type of the union."""
    found: dict[Location, list[ErrorDetails]] = {}
    for detail in error.errors(include_url=False):
        found.setdefault(without_tags(data, detail["loc"]), []).append(detail)
    chosen = []
    for location, details in found.items():
        others = [detail for detail in details if not detail["type"].endswith("_type")]
        below = any(len(one) > len(location) > 0 and one[: len(location)] == location for one in found)
        chosen += others or ([] if below else details[:1])
    return chosen


# ---- line numbers ----
#
# tomllib gives none, so a text that it has accepted is scanned once more: the scan need not find errors, only
# statements. Keys inside inline tables and entries of arrays are not indexed; they take the line of the key that holds
# them.

# Keys without quotes: letters, digits, underscores and dashes, with dots between. They need no parser.
_BARE = re.compile(r"[A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)*")
_SOMETHING = re.compile(r"\S")
# Characters that matter to the scan.
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
    """Line of the location, or of the innermost table or key that holds it."""
    for length in range(len(location), 0, -1):
        if location[:length] in lines:
            return lines[location[:length]]
    return None


def _header(statement: str, counts: dict[Location, int]) -> Location:
    """Location of a [table] or [[table]]. counts: number of entries of each array of tables so far."""
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
    """Steps of the key of `key = value`. tomllib parses a quoted key, with the value 0."""
    end = _find(statement, 0, "=")
    return _bare_steps(statement[:end].strip(" \t")) or _steps(tomllib.loads(statement[:end] + "= 0"))


def _bare_steps(key: str) -> tuple[str, ...]:
    """Steps of a dotted key without quotes and spaces; empty for any other key."""
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

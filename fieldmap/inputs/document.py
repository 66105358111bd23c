"""A TOML file as read: its text and data, and what is wrong in it, tied to its lines."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from fieldmap.errors import DeviceFileError, FieldmapError, Problem
from fieldmap.inputs.explain import explain
from fieldmap.inputs.findings import Finding, closest, one_of, shown
from fieldmap.inputs.key_paths import dotted
from fieldmap.inputs.toml_lines import line_numbers, nearest_line
from fieldmap.shipped import shipped_file, shipped_names

_HDF5 = b"\x89HDF\r\n\x1a\n"


@dataclass(frozen=True)
class Document:
    """A parsed TOML file; `data` and `text` as read."""

    path: Path
    text: str
    data: dict[str, Any]

    def problems(self, findings: list[Finding]) -> list[Problem]:
        """Tie findings to this file, in the order of its lines."""
        if not findings:
            return []
        lines = line_numbers(self.text)
        placed = [(nearest_line(lines, finding.location) or 0, finding) for finding in findings]
        placed.sort(key=lambda pair: pair[0])
        return [self._problem(line, finding) for line, finding in placed]

    def _problem(self, line: int, finding: Finding) -> Problem:
        place = f"{self.path}:{line}" if line else str(self.path)
        path = dotted(self.data, finding.location)
        where = f"{place}: {path}" if path else place
        return Problem(where, finding.must_hold, finding.received, finding.remedy)


def find_device_file(path_or_name: str | Path) -> Path:
    """The file at a path, or the shipped one of that name; DeviceFileError if there is neither."""
    return find_input_file(path_or_name, "device", DeviceFileError, "geometry")


def load_document(path: Path) -> Document:
    """Parse a TOML file; the first syntax error ends the reading, with line and column."""
    try:
        content = path.read_bytes()
        if content.startswith(_HDF5):
            remedy = "name the text file (.toml) here"
            received = "an HDF5 file, such as a map"
            raise DeviceFileError(Problem(str(path), "must be a text file (TOML)", received, remedy))
        text = content.decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        remedy = "check the path and its permissions, and save the file as UTF-8 text"
        raise DeviceFileError(
            Problem(str(path), "must be readable UTF-8 text", str(error), remedy)
        ) from error
    text = text.replace("\r\n", "\n")
    try:
        return Document(path, text, tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise DeviceFileError(_syntax_problem(path, text, str(error))) from error


def _syntax_problem(path: Path, text: str, message: str) -> Problem:
    where, received = str(path), message
    if found := re.search(r"at line (\d+), column (\d+)", message):
        line = int(found[1])
        where = f"{path}:{line}:{found[2]}"
        received = f"{message.split(' (at ')[0]}, in the line {shown(text.splitlines()[line - 1].strip())}"
    remedy = (
        "correct the line; texts stand in quotes, a table begins with [name], a repeated one with [[name]]"
    )
    return Problem(where, "the file must be valid TOML", received, remedy)


def schema_findings(root: type[BaseModel], data: dict[str, Any]) -> list[Finding]:
    """Everything that the schema finds wrong in the data."""
    try:
        root.model_validate(data)
    except ValidationError as error:
        return [explain(detail, root, data) for detail in error.errors(include_url=False)]
    return []


# Keys that only this kind of file has, and the command that takes it.
_KINDS = {
    "device": ({"coil", "body", "material", "payload", "driver", "workspace"}, "check"),
    "recipe": ({"spacing_mm", "box"}, "map"),
    "scenario": ({"control", "duration_s", "sensors", "start"}, "simulate"),
    "study": ({"vary", "variant"}, "study"),
}


def kind_of(data: dict[str, Any]) -> str | None:
    """Device, recipe, scenario or study; None for data that has keys of no kind, or of several.

    >>> kind_of({"format": 1, "coil": []}), kind_of({"format": 1})
    ('device', None)
    """
    found = [kind for kind, (keys, _) in _KINDS.items() if keys & data.keys()]
    return found[0] if len(found) == 1 else None


def wrong_kind(path: Path, data: dict[str, Any], wanted: str) -> Problem | None:
    """What is wrong with a file that is clearly of another kind than the wanted one; None for any other."""
    found = kind_of(data)
    if found is None or found == wanted:
        return None
    keys, command = _KINDS[found]
    key = next(key for key in data if key in keys)
    remedy = f"`fieldmap {command}` takes it"
    if wanted == "recipe" and found == "device":
        remedy += f'; a recipe names it (device = "{path.name}") and how fine the map shall be (spacing_mm)'
    return Problem(str(path), f"must be a {wanted} file", f'a {found} file, by its key "{key}"', remedy)


def load_input_file(path: Path, what: str, error: type[FieldmapError]) -> Document:
    """The file, parsed; `error` if it cannot be read, or is clearly of another kind than `what`."""
    try:
        document = load_document(path)
    except DeviceFileError as unreadable:
        raise error(*unreadable.problems) from None
    wrong = wrong_kind(path, document.data, what)
    if wrong is not None:
        raise error(wrong)
    return document


def find_input_file(
    path_or_name: str | Path, what: str, error: type[FieldmapError], kind: str, subfolder: str = ""
) -> Path:
    """The file at a path, or the shipped one of that name; `error` if there is neither.

    what: "device", "recipe", ...: which file it is to be. kind, subfolder: where the shipped ones lie.
    """
    path = Path(path_or_name)
    if path.is_file():
        return path
    shipped = shipped_file(kind, str(Path(subfolder) / path_or_name))
    if shipped is not None:
        return shipped
    names = [Path(name).name for name in shipped_names(kind, subfolder)]
    guess = closest(path.stem, names)
    remedy = f'did you mean "{guess}"?' if guess else f"give a path, or one of {one_of(names)}"
    must_hold = f"must be a {what} file or the name of a shipped {what}"
    raise error(Problem(str(path_or_name), must_hold, "no such file", remedy))

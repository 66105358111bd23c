"""A TOML file as read: its text and data, and what is wrong in it, tied to its lines."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from fieldmap.device.explain import explain
from fieldmap.device.findings import Finding, shown
from fieldmap.device.input_files import find_input_file
from fieldmap.device.key_paths import dotted
from fieldmap.device.toml_lines import line_numbers, nearest_line
from fieldmap.errors import DeviceFileError, Problem

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

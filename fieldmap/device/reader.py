"""Read a device file, check all of it, and make the frozen Device in SI units."""

import hashlib
import os
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from fieldmap.device.cross_checks import cross_findings
from fieldmap.device.explain import REQUIRED, explain
from fieldmap.device.findings import Finding, closest, one_of, shown
from fieldmap.device.key_paths import dotted
from fieldmap.device.model import Device, StepFile
from fieldmap.device.schema import DeviceFile, MaterialFile
from fieldmap.device.schema.materials import Curves, require_room_to_saturate
from fieldmap.device.toml_lines import line_numbers, nearest_line
from fieldmap.errors import DeviceFileError, Problem
from fieldmap.shipped import shipped_file, shipped_names


def read_device(path_or_name: str | Path) -> Device:
    """Read and check a device file.

    path_or_name: path of a TOML file, or the name of a shipped device ("drive_unit"). The format is described
    in docs/device_files.md. Lengths come out in m, the frame is right-handed with z up.

    Raises DeviceFileError with one Problem for every error of the file: file, line and key path; what must
    hold; what was received; the remedy.

    >>> device = read_device("drive_unit")
    >>> device.coil_names
    ('1', '2', '3', '4', '5', '6')
    """
    path = _find(path_or_name)
    document = _load(path)
    curves, included, problems = _material_files(document)
    findings = _schema_findings(DeviceFile, document.data)
    missing = {dotted(document.data, found.location) for found in findings if found.must_hold == REQUIRED}
    findings += cross_findings(document.data, path.parent, missing)
    if not findings and not problems:
        findings += _curves_that_cannot_saturate(document.data, curves)
    problems = [*document.problems(findings), *problems]
    if problems:
        raise DeviceFileError(*problems)
    return _build(DeviceFile.model_validate(document.data), document, curves, included)


@dataclass(frozen=True)
class _Document:
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


def _find(path_or_name: str | Path) -> Path:
    path = Path(path_or_name)
    if path.is_file():
        return path
    shipped = shipped_file("geometry", str(path_or_name))
    if shipped is not None:
        return shipped
    names = shipped_names("geometry")
    guess = closest(path.stem, names)
    remedy = f'did you mean "{guess}"?' if guess else f"give a path, or one of {one_of(names)}"
    raise DeviceFileError(
        Problem(
            str(path_or_name), "must be a device file or the name of a shipped device", "no such file", remedy
        )
    )


def _load(path: Path) -> _Document:
    """Parse a TOML file; the first syntax error ends the reading, with line and column."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        remedy = "check the path and its permissions, and save the file as UTF-8 text"
        raise DeviceFileError(
            Problem(str(path), "must be readable UTF-8 text", str(error), remedy)
        ) from error
    text = text.replace("\r\n", "\n")
    try:
        return _Document(path, text, tomllib.loads(text))
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


def _schema_findings(root: type[BaseModel], data: dict[str, Any]) -> list[Finding]:
    try:
        root.model_validate(data)
    except ValidationError as error:
        return [explain(detail, root, data) for detail in error.errors(include_url=False)]
    return []


def _material_files(device: _Document) -> tuple[Curves, dict[str, str], list[Problem]]:
    """Read every B-H file that the device file names: curves and texts by that name, and what is wrong."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    texts: dict[str, str] = {}
    problems: list[Problem] = []
    for material, file in _named_files(device.data):
        path = _beside_or_shipped(device.path.parent, file)
        if path is None:
            problems += device.problems([_no_such_file(material, file)])
            continue
        try:
            document = _load(path)
        except DeviceFileError as error:
            problems += error.problems
            continue
        findings = _schema_findings(MaterialFile, document.data)
        problems += document.problems(findings)
        texts[file] = document.text
        if not findings:
            contents = MaterialFile.model_validate(document.data)
            curves[file] = contents.H_A_per_m, contents.B_T
    return curves, texts, problems


def _no_such_file(material: str, file: str) -> Finding:
    return Finding(
        ("material", material, "file"),
        "the material file must exist, beside the device file or among the shipped ones",
        shown(file),
        f"correct the path; shipped are {one_of(shipped_names('geometry', 'materials'))}",
    )


def _curves_that_cannot_saturate(data: dict[str, Any], curves: Curves) -> list[Finding]:
    """The rule of `require_room_to_saturate` for curves from files of their own."""
    found = []
    for material, file in _named_files(data):
        saturation = data["material"][material].get("saturation_polarisation_T")
        if saturation is None:
            continue
        try:
            require_room_to_saturate(*curves[file], saturation)
        except PydanticCustomError as error:
            told = error.context or {}
            place = ("material", material, "saturation_polarisation_T")
            found.append(Finding(place, told["must_hold"], told["received"], told["remedy"]))
    return found


def _named_files(data: dict[str, Any]) -> list[tuple[str, str]]:
    materials = data.get("material")
    if not isinstance(materials, dict):
        return []
    tables = [(name, table) for name, table in materials.items() if isinstance(table, dict)]
    files = [(name, table.get("file")) for name, table in tables if table.get("kind") == "bh_table"]
    return [(name, file) for name, file in files if isinstance(file, str)]


def _beside_or_shipped(folder: Path, file: str) -> Path | None:
    beside = folder / file
    return beside if beside.is_file() else shipped_file("geometry", file)


def _build(contents: DeviceFile, document: _Document, curves: Curves, included: dict[str, str]) -> Device:
    folder = document.path.parent
    bodies = tuple(body.to_model(folder) for body in contents.body)
    materials = {name: table.to_model(name, curves) for name, table in contents.material.items()}
    solids = {part.shape.path for body in bodies for part in body.parts if isinstance(part.shape, StepFile)}
    included = included | {os.path.relpath(path, folder): _digest(path) for path in sorted(solids)}
    return Device(
        name=contents.name,
        title=contents.title,
        coils=tuple(coil.to_model() for coil in contents.coil),
        bodies=bodies,
        materials=MappingProxyType(materials),
        payload=contents.payload.to_model() if contents.payload else None,
        driver=contents.driver.to_model() if contents.driver else None,
        workspace=contents.workspace.to_model() if contents.workspace else None,
        references=tuple(reference.to_model() for reference in contents.reference),
        sections=tuple(section.to_model() for section in contents.section),
        provenance=MappingProxyType(dict(contents.provenance)),
        source=document.path,
        text=document.text,
        included=MappingProxyType(included),
    )


def _digest(path: Path) -> str:
    return "sha256:" + hashlib.sha256(path.read_bytes()).hexdigest()

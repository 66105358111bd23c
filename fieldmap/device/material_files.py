"""The files of measured B-H curves that a device file names."""

from pathlib import Path
from typing import Any

from pydantic_core import PydanticCustomError

from fieldmap.device.document import Document, load_document, schema_findings
from fieldmap.device.findings import Finding, one_of, shown
from fieldmap.device.schema import MaterialFile
from fieldmap.device.schema.materials import Curves, require_room_to_saturate
from fieldmap.errors import DeviceFileError, Problem
from fieldmap.shipped import shipped_file, shipped_names


def material_files(device: Document) -> tuple[Curves, dict[str, str], list[Problem]]:
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
            document = load_document(path)
        except DeviceFileError as error:
            problems += error.problems
            continue
        findings = schema_findings(MaterialFile, document.data)
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


def curves_that_cannot_saturate(data: dict[str, Any], curves: Curves) -> list[Finding]:
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

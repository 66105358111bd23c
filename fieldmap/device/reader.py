"""Read a device file and the material files that it names, check all of it, and make the frozen Device in SI units."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel
from pydantic_core import PydanticCustomError

from fieldmap.device.changes import with_changes
from fieldmap.device.cross_checks import cross_findings
from fieldmap.device.data_sheet import data_sheet
from fieldmap.device.materials import Curves, Material, SaturatingMaterial, material_of, named_file
from fieldmap.device.materials.bh_table import BHTableFromFileKeys, require_room_to_saturate
from fieldmap.device.model import CHANGED, Device, hashes_of_files
from fieldmap.device.schema import DEVICE, MATERIAL, DeviceFile
from fieldmap.device.shapes import ShapeOfFile
from fieldmap.device.toml_text import toml_text
from fieldmap.errors import DeviceFileError, InputError, Problem
from fieldmap.file_contents import read_text
from fieldmap.inputs.declared import fields_of, record_of
from fieldmap.inputs.document import Document, parsed, schema_findings
from fieldmap.inputs.explain import REQUIRED
from fieldmap.inputs.findings import Finding, changed_in_words, one_of, shown
from fieldmap.inputs.key_paths import dotted
from fieldmap.inputs.tables import Table
from fieldmap.records import FrozenDict
from fieldmap.shipped import is_file, shipped_file, shipped_names
from fieldmap.typing import PathLike

TEXT = "device text"
"""Stands for the path of a device that was given as a text."""


def material_files(device: Document) -> tuple[Curves, dict[str, str], list[Problem]]:
    """Curves and texts of the B-H files that the device file names, by file name, and the problems found."""
    curves: dict[str, tuple[list[float], list[float]]] = {}
    texts: dict[str, str] = {}
    problems: list[Problem] = []
    for material, file in _named_files(device.data):
        beside = device.path.parent / file
        path = beside if not device.alone and is_file(beside) else shipped_file("geometry", file)
        if path is None:
            must_hold = "the material file must exist, beside the device file or among the shipped ones"
            remedy = f"correct the path; shipped are {one_of(shipped_names('geometry', 'materials'))}"
            wrong = Finding(("material", material, "file"), must_hold, shown(file), remedy)
            problems += device.problems([wrong])
            continue
        try:
            contents, texts[file] = _material_file(path)
        except DeviceFileError as error:
            problems += error.problems
        else:
            curves[file] = contents.H_A_per_m, contents.B_T
    return curves, texts, problems


def _material_file(path: Path) -> tuple[Any, str]:
    """The keys of a material file, or of a data sheet (text of columns), and the text. Raises DeviceFileError."""
    if path.suffix.lower() == ".toml":
        document = MATERIAL.load(path)
        return MATERIAL.contents(document), document.text
    try:
        return data_sheet(path), read_text(path, otherwise="latin-1")
    except InputError as error:
        raise DeviceFileError(*error.problems) from None


def _curves_that_do_not_fit(materials: Mapping[str, Table], curves: Curves) -> list[Finding]:
    """Findings where a curve in a separate file contradicts the keys of the table that names the file."""
    found = []
    for name, keys in materials.items():
        if isinstance(keys, BHTableFromFileKeys) and keys.saturation_polarisation_T is not None:
            try:
                require_room_to_saturate(*curves[keys.file], keys.saturation_polarisation_T)
            except PydanticCustomError as error:
                told = error.context or {}
                place = ("material", name, "saturation_polarisation_T")
                found.append(Finding(place, told["must_hold"], told["received"], told["remedy"]))
    return found


def _named_files(data: dict[str, Any]) -> list[tuple[str, str]]:
    """Materials and the files that they name."""
    materials = data.get("material")
    tables = materials.items() if isinstance(materials, dict) else ()
    named = [(name, named_file(table)) for name, table in tables if isinstance(table, dict)]
    return [(name, file) for name, file in named if file is not None]


_File = TypeVar("_File", bound=BaseModel)


def read_device(path_or_name: PathLike | Device, changes: Mapping[str, Any] | None = None) -> Device:
    """Read and check a device file.

    The format is described in docs/device_files.md. Lengths come out in m, the frame is right-handed with z
    up.

    Parameters
    ----------
    path_or_name
        Path of a TOML file, the name of a shipped device ("drive_unit"), or the text of a device file (of
        more than one line).
    changes
        Values by key path in place of those of the file, such as {"parameters.gap": 120.0,
        "coil.*.turns": 900}, in the units of the keys; values that depend on a parameter are computed anew.
        Keys that the file lacks are refused.

    Returns
    -------
    Device
        The device.

    Raises
    ------
    DeviceFileError
        With one Problem for every error of the file: file, line and key path; what must hold; what was
        received; the remedy.

    Examples
    --------
    >>> device = read_device("drive_unit")
    >>> device.coil_names
    ('1', '2', '3', '4', '5', '6')
    >>> read_device("drive_unit", {"parameters.gap": 120.0}).bodies[-1].parts[0].placement.position.tolist()
    [0.0, 0.0, -0.126]
    """
    if isinstance(changes, Mapping) and not changes:
        changes = None
    if isinstance(path_or_name, Device):
        if changes is not None:
            must_hold, remedy = "must be a file or a name where keys are changed", "write device.replace(...)"
            raise DeviceFileError.of("read_device", must_hold, "a device", remedy)
        return path_or_name
    if isinstance(path_or_name, str) and "\n" in path_or_name:
        document = DEVICE.prepared(parsed(Path(TEXT), path_or_name, DeviceFileError))
    elif isinstance(path_or_name, str | os.PathLike):
        document = DEVICE.load(DEVICE.find(path_or_name))
    else:
        must_hold = "must be the path or text of a device file, or the name of a shipped device"
        remedy = 'write for instance read_device("machine.toml")'
        raise DeviceFileError.of("read_device", must_hold, type(path_or_name).__name__, remedy)
    return device_of(document if changes is None else with_changes(document, changes))


def material(
    path_or_name: PathLike,
    above: str = "slope mu0",
    saturation: float | None = None,
    name: str | None = None,
) -> SaturatingMaterial:
    """A measured B-H curve from a material file, or from the table of a data sheet.

    Parameters
    ----------
    path_or_name
        Path of the material file (.toml), or the name of a shipped one ("steel_a3"). Any other file, such as
        "steel.csv", is a table of H and B: a line of names such as `H (kA/m);B (T)`, or none for H in A/m and
        B in T.
    above
        Law past its last point: "slope mu0", or "towards saturation". Below the first point it is a straight
        line to the origin.
    saturation
        Saturation polarisation, T, for "towards saturation".
    name
        Name of the material; by default the name in the file. A device may rename its materials.

    Returns
    -------
    SaturatingMaterial
        The material.

    Raises
    ------
    DeviceFileError
        As for `read_device`.

    Examples
    --------
    >>> material("steel_a3").name
    'steel_a3'
    """
    path = MATERIAL.find(path_or_name)
    contents, _ = _material_file(path)
    if name is not None and not isinstance(name, str):
        must_hold, remedy = "must be a text", 'write for instance name="steel"'
        raise DeviceFileError.of("material(name)", must_hold, type(name).__name__, remedy)
    made: SaturatingMaterial = record_of(
        contents, name=name or getattr(contents, "name", path.stem), above=above, saturation=saturation
    )
    return made


def device_of(document: Document, written: bool = True) -> Device:
    """The device of a parsed file, or of its data after some keys were changed.

    Paths in it are relative to `document.path`. written: whether `Device.text` is filled, which takes as long as the
    rest if keys were changed. Raises DeviceFileError with one Problem for every error.
    """
    DEVICE.refuse_other_kinds(document)
    contents, curves, included = checked_contents(document, DeviceFile)
    return _build(contents, document, curves, included, complete_text(document) if written else "")


def recorded_device(text: str, solids: bool = False) -> Device:
    """The device in the text that a map records, without its iron: coils, payload, driver and workspace.

    Pieces of soft iron in the payload get their materials if the curves are in the text or in shipped files, and keep
    the names of the materials otherwise; no other file is read. solids: with the shapes of its iron, for pictures;
    bodies from other files and all materials are left out. Raises DeviceFileError for a text that is no device.
    """
    document = parsed(Path("device recorded in the map"), text, DeviceFileError)
    document = DEVICE.prepared(replace(document, alone=True))
    contents = DEVICE.contents(document)
    bodies = map(record_of, contents.body) if solids else ()
    values = fields_of(
        contents,
        bodies=tuple(
            one for one in bodies if not any(isinstance(part.shape, ShapeOfFile) for part in one.parts)
        ),
        materials=FrozenDict(),
        references=(),
        sections=(),
        joints=(),
        provenance=FrozenDict(),
    )
    if values["payload"] is not None:
        values["payload"] = values["payload"].with_materials(_available_materials(document, contents))
    return Device.unchecked(**values, text=text)


def _available_materials(document: Document, contents: DeviceFile) -> dict[str, Material]:
    """Materials of a recorded device, except those with a curve in a missing file."""
    curves, _, _ = material_files(document)
    files = dict(_named_files(document.data))
    return {
        name: material_of(table, name, curves)
        for name, table in contents.material.items()
        if name not in files or files[name] in curves
    }


def checked_contents(document: Document, root: type[_File]) -> tuple[_File, Curves, dict[str, str]]:
    """The document as an instance of its schema, with the curves and texts of the material files that it names.

    Raises DeviceFileError with one Problem for every error.
    """
    curves, included, problems = material_files(document)
    findings = schema_findings(root, document.data)
    missing = {dotted(document.data, found.location) for found in findings if found.must_hold == REQUIRED}
    findings += cross_findings(document.data, document.path.parent, missing)
    contents = None
    if not findings and not problems:
        contents = root.model_validate(document.data)
        findings += _curves_that_do_not_fit(contents.material, curves)  # type: ignore[attr-defined]
    problems = [*document.problems(findings), *problems]
    if problems or contents is None:
        raise DeviceFileError(*problems)
    return contents, curves, included


def _build(
    contents: DeviceFile, document: Document, curves: Curves, included: dict[str, str], text: str
) -> Device:
    folder = document.path.parent
    materials = {name: material_of(table, name, curves) for name, table in contents.material.items()}
    values = fields_of(contents, folder, materials=FrozenDict(materials))
    if values["payload"] is not None:
        values["payload"] = values["payload"].with_materials(materials)
    return Device.unchecked(
        **values,
        source=None if document.path == Path(TEXT) else document.path,
        text=text,
        included=FrozenDict(included | hashes_of_files(values["bodies"], folder)),
    )


def complete_text(document: Document) -> str:
    """The text of a device file; written out in full if the file includes others or keys were changed."""
    if document.changes:
        words = changed_in_words(document.path.name, document.changes, document.stated)
        return f"{CHANGED}{words}.\n" + toml_text(document.data)
    if document.raw is None or "include" not in document.raw.data:
        return document.text
    return f"# {document.path.name}, with the files that it includes.\n" + toml_text(document.data)

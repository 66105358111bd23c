"""Rules that tie one table of a device file to another.

The rules read the raw data, and therefore also apply to a file in which the schema has found other errors.
"""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from fieldmap.device.drives import lacking
from fieldmap.device.materials import keys_of_table
from fieldmap.device.shapes import SHAPE_KEYS, ShapeOfFile
from fieldmap.inputs.findings import Finding, meant, one_of, shown
from fieldmap.inputs.key_paths import dotted, matches, tables
from fieldmap.records import count_of
from fieldmap.shipped import is_file


def cross_findings(data: dict[str, Any], folder: Path, missing: set[str]) -> list[Finding]:
    """Everything wrong between the tables of a device file in `folder`.

    missing: dotted paths of required keys that are known to be missing; `provenance` may name them.
    """
    found = [
        finding for key in ("body", "coil", "section", "sensor") for finding in _duplicate_names(data, key)
    ]
    found += [*_unknown_materials(data), *_pieces_of_no_iron(data)]
    found += _names_of_no_body(data, "section", "bodies", patterns=False)
    found += _names_of_no_body(data, "joint", "between", patterns=True)
    found += [*_numbers_of_currents(data), *_sources_of_nothing(data, missing), *_drives_without(data)]
    return [*found, *_missing_files(data, folder), *_nothing_to_compute(data)]


def _duplicate_names(data: dict[str, Any], key: str) -> Iterator[Finding]:
    first: dict[str, int] = {}
    for location, table in tables(data, key):
        name, number = table.get("name"), int(location[1]) + 1
        if isinstance(name, str) and first.setdefault(name, number) != number:
            received = f'"{name}" for {key} {first[name]} and {key} {number}'
            yield Finding((*location, "name"), f"every {key} needs a name of its own", received, "rename one")


def _unknown_materials(data: dict[str, Any]) -> Iterator[Finding]:
    """One finding for each unknown name, at the first body or piece of the payload that has it."""
    known = list(data["material"]) if isinstance(data.get("material"), dict) else []
    unknown: dict[str, list[tuple[str | int, ...]]] = {}
    for location, table in [*tables(data, "body"), *_pieces(data)]:
        name = table.get("material")
        if isinstance(name, str) and name not in known:
            unknown.setdefault(name, []).append((*location, "material"))
    for name, places in unknown.items():
        remedy = meant(name, known, f"add a [material.{name}] table")
        allowed = f"material must be one of the file's materials: {one_of(known) or 'there are none'}"
        others = (
            f", here and in {count_of(len(places) - 1, 'more body', 'more bodies')}" if places[1:] else ""
        )
        yield Finding(places[0], allowed, shown(name) + others, remedy)


def _pieces(data: dict[str, Any]) -> Iterator[tuple[tuple[str | int, ...], dict[str, Any]]]:
    payload = data.get("payload")
    for location, piece in tables(payload, "piece") if isinstance(payload, dict) else ():
        yield ("payload", *location), piece


def _pieces_of_no_iron(data: dict[str, Any]) -> Iterator[Finding]:
    """Soft pieces of the payload whose material is a magnet or lets no flux pass."""
    materials = data.get("material")
    for location, table in _pieces(data):
        name = table.get("material")
        material = materials.get(name) if isinstance(materials, dict) and isinstance(name, str) else None
        keys = keys_of_table(material) if isinstance(material, dict) else None
        if keys is not None and keys.makes.role != "iron":
            remedy = 'name another material, or give the piece the shape of a magnet, such as "sphere"'
            must_hold = "the material of a soft piece must be soft iron"
            yield Finding((*location, "material"), must_hold, f'"{name}", a {keys.makes.role}', remedy)


def _names_of_no_body(data: dict[str, Any], array: str, key: str, patterns: bool) -> Iterator[Finding]:
    """Names in a list of sections or joints that no body has. patterns: whether * and ? are wildcards."""
    known = [name for _, table in tables(data, "body") if isinstance(name := table.get("name"), str)]
    for location, table in tables(data, array):
        names = table.get(key)
        for k, name in enumerate(names if isinstance(names, list) else []):
            if not isinstance(name, str) or name in known:
                continue
            if patterns and any(fnmatchcase(one, name) for one in known):
                continue
            remedy = meant(name, known, "name a [[body]] of this file")
            must = "must name bodies" if patterns else "must be bodies"
            allowed = f"{key} {must} of the file: {one_of(known) or 'there are none'}"
            yield Finding((*location, key, k), allowed, shown(name), remedy)


def _numbers_of_currents(data: dict[str, Any]) -> Iterator[Finding]:
    coils = data.get("coil", [])
    for location, table in tables(data, "reference"):
        currents = table.get("currents_A")
        if isinstance(coils, list) and isinstance(currents, list) and len(currents) != len(coils):
            yield Finding(
                (*location, "currents_A"),
                f"one current for each of the {len(coils)} coils",
                f"{len(currents)} currents",
                "list one number for each [[coil]], in the order of the file (0 for a coil that is off)",
            )


def _drives_without(data: dict[str, Any]) -> Iterator[Finding]:
    """A finding where the file lacks something that the drive of the coils needs."""
    driver = data.get("driver")
    if isinstance(driver, dict):
        chosen = {
            "mode": driver.get("drive"),
            "controller": driver.get("controller"),
            "bridge": driver.get("bridge"),
        }
        without = [
            str(coil.get("name")) for _, coil in tables(data, "coil") if not coil.get("resistance_ohm")
        ]
        problem = lacking(chosen, driver.get("supply_voltage_V"), without)
        if problem is not None:
            key, *about = problem
            yield Finding(("driver", key), *about)


def _sources_of_nothing(data: dict[str, Any], missing: set[str]) -> Iterator[Finding]:
    provenance = data.get("provenance")
    if not isinstance(provenance, dict):
        return
    paths: list[str] | None = None
    for path, text in provenance.items():
        if isinstance(text, str) and path not in missing and not matches(data, path):
            paths = all_paths(data) if paths is None else paths
            remedy = meant(path, paths, "correct the path or remove the line")
            yield Finding(("provenance", path), "the key path must exist in this file", shown(path), remedy)


def all_paths(data: dict[str, Any]) -> list[str]:
    """Dotted paths of all keys, for a guess at what was meant."""
    paths: list[str] = []
    waiting: list[tuple[str | int, ...]] = [()]
    while waiting:
        location = waiting.pop()
        here: Any = data
        for step in location:
            here = here[step]
        entries = list(here) if isinstance(here, dict) else range(len(here)) if isinstance(here, list) else []
        below = [(*location, entry) for entry in entries if (location or entry != "provenance")]
        waiting += below
        paths += [dotted(data, entry) for entry in below]
    return paths


def _missing_files(data: dict[str, Any], folder: Path) -> Iterator[Finding]:
    for location, body in tables(data, "body"):
        for part_location, part in [(location, body), *_parts(location, body)]:
            name, keys = part.get("file"), SHAPE_KEYS.get(str(part.get("shape")))
            if keys is None or not issubclass(keys.makes, ShapeOfFile):
                continue
            if isinstance(name, str) and not is_file(folder / name):
                yield Finding(
                    (*part_location, "file"),
                    f"the {keys.makes.program} file must exist; its path is relative to the device file",
                    shown(name),
                    f"put the file at {folder / name} or correct the path",
                )


def _parts(location: tuple[str | int, ...], body: dict[str, Any]) -> Iterator[tuple[Any, dict[str, Any]]]:
    for (key, k), part in tables(body, "part"):
        yield (*location, key, k), part


def _nothing_to_compute(data: dict[str, Any]) -> Iterator[Finding]:
    if not (data.get("coil") or data.get("body") or data.get("background")):
        must_hold = "a device has at least one [[coil]] or [[body]], or a [background]"
        yield Finding((), must_hold, "none of them", "add a [[coil]] table")

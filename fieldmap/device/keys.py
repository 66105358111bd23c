"""A machine made in Python as the data of a device file, and what is wrong with it.

The rules are those of files: the data are checked by the schema and the rules between tables, and each finding is told
at the path of the attribute.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from fieldmap.device import parts as model
from fieldmap.device import payload as carried
from fieldmap.device.air_sources import AirSource, AirSourceKeys
from fieldmap.device.background import Background
from fieldmap.device.coils import COIL_KEYS, Coil
from fieldmap.device.cross_checks import cross_findings
from fieldmap.device.made import Made
from fieldmap.device.materials import MATERIAL_KEYS, Material
from fieldmap.device.placement import Placement, in_unit, rotation_angles
from fieldmap.device.schema import DeviceFile
from fieldmap.device.schema.bodies import SHAPE_KEYS, BodyKeys
from fieldmap.device.schema.file import BackgroundKeys, DriverKeys, JointKeys, SectionKeys
from fieldmap.device.schema.payload import (
    MAGNET_KEYS,
    PIECE_KEYS,
    PayloadWithMagnet,
    PayloadWithMoment,
    PayloadWithPieces,
)
from fieldmap.device.schema.workspace import (
    WORKSPACE_KEYS,
    FluxDensityReference,
    GradientReference,
)
from fieldmap.errors import InputError, Problem
from fieldmap.inputs.document import schema_findings
from fieldmap.inputs.explain import REQUIRED
from fieldmap.inputs.findings import Finding, shown
from fieldmap.inputs.key_paths import Location, dotted, value_at
from fieldmap.inputs.tables import UNITS, Table
from fieldmap.typing import Array

_UNIT = re.compile(r"^(.+?)_(" + "|".join(sorted(UNITS, key=len, reverse=True)) + ")$")
_KEY_IN_TEXT = re.compile(r"\b([a-z]\w*?)_(mm|g_mm2|g|mH|mT_per_m|mT)\b((?:/2)? = [-\d.e+]+)?")
_BOUND = re.compile(r"^must be (greater than|at least|less than|at most) [-\d.e+]+$")
_ROTATION = "must be a rotation matrix (3, 3): orthonormal, with determinant 1"


@dataclass
class DeviceData:
    """Data of a device file, and where they come from: paths of attributes by location. findings: what cannot be
    written as data at all. unwritten: coils and materials of classes that have no keys."""

    data: dict[str, Any] = field(default_factory=dict)
    paths: dict[Location, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    unwritten: list[str] = field(default_factory=list)

    def refuse(self, location: Location, path: str, must_hold: str, value: object) -> None:
        """A value of a type that the data of a file cannot hold."""
        self.paths[location] = path
        received = shown(value) if isinstance(value, str | bool | int | float) else type(value).__name__
        self.findings.append(Finding(location, must_hold, received, "see help(fieldmap.Device)"))

    def table(self, thing: object, keys: type[BaseModel], location: Location, path: str) -> dict[str, Any]:
        """The keys of a thing: each is the attribute of its name, in its unit."""
        data: dict[str, Any] = {}
        for key, about in keys.model_fields.items():
            fixed: tuple[Any, ...] = get_args(about.annotation) if key in ("kind", "shape") else ()
            attribute, unit = attribute_of(keys, key)
            if fixed:
                data[key] = fixed[0]
            elif hasattr(thing, attribute):
                self.paths[(*location, key)] = f"{path}.{attribute}"
                value = _in_unit(getattr(thing, attribute), unit)
                if isinstance(value, list) and value and isinstance(value[0], AirSource):
                    value = self.sources(value, (*location, key), f"{path}.{attribute}")
                if value is not None and (type(value), value) != (type(about.default), about.default):
                    data[key] = value
        return data

    def sources(self, sources: list[Any], location: Location, path: str) -> list[dict[str, Any]]:
        """Tables of currents and magnets of magpylib's kinds."""
        tables = []
        for k, source in enumerate(sources):
            place: Location = (*location, k)
            table = self.table(source, AirSourceKeys, place, f"{path}[{k}]")
            tables.append(table | self.placement(source.placement, place, f"{path}[{k}].placement"))
        return tables

    def placement(self, place: object, location: Location, path: str) -> dict[str, Any]:
        """position_mm and rotation_deg."""
        if not isinstance(place, Placement):
            self.refuse((*location, "position_mm"), path, "must be a Placement", place)
            return {}
        self.paths[(*location, "position_mm")] = f"{path}.position"
        self.paths[(*location, "rotation_deg")] = f"{path}.rotation"
        position = _in_unit(place.position, 1e-3)
        data = {} if position == [0.0, 0.0, 0.0] else {"position_mm": position}
        rotation = _matrix(place.rotation)
        if rotation is None:
            received = shown(np.asarray(place.rotation, dtype=object).tolist())
            remedy = "use fieldmap.placed(position, rotation_deg), or turned(axis, angle_deg)"
            self.findings.append(Finding((*location, "rotation_deg"), _ROTATION, received, remedy))
        elif not np.array_equal(rotation, np.eye(3)):
            data["rotation_deg"] = rotation_angles(rotation)
        return data


def attribute_of(keys: type[BaseModel], key: str) -> tuple[str, float]:
    """The attribute that a key becomes, and the SI value of its unit.

    >>> attribute_of(DriverKeys, "gain_A_per_V"), attribute_of(SectionKeys, "centre_mm")
    (('gain', 1.0), ('origin', 0.001))
    """
    if key in getattr(keys, "declared", {}):
        return keys.declared[key]  # type: ignore[attr-defined,no-any-return]
    found = _UNIT.match(key)
    plain, unit = (found[1], UNITS[found[2]]) if found else (key, 1.0)
    return plain, unit


def device_data(device: Any, whole: bool = True) -> DeviceData:
    """The data of a device, whatever its values are. whole: with what a file says about the machine, too: sections,
    known values and where numbers come from."""
    made = DeviceData(
        paths={(key,): f"{key}s" for key in ("coil", "joint", "section", "reference", "material")}
    )
    made.paths.update({("body",): "bodies", ("title",): "title", ("name",): "name"})
    untitled = isinstance(device.title, str) and not device.title and isinstance(device.name, str)
    title = device.name if untitled else device.title
    made.data = {"format": 1, "name": device.name, "title": title}
    _materials(made, device.materials)
    tables = [_body(made, body, k) for k, body in enumerate(device.bodies)]
    made.data |= {"body": tables} if tables else {}
    joints = [
        _of_kind(made, joint, {model.Joint: JointKeys}, ("joint", k), f"joints[{k}]")
        for k, joint in enumerate(device.joints)
    ]
    made.data |= {"joint": joints} if joints else {}
    _coils(made, device.coils)
    if device.payload is not None:
        made.data["payload"] = _payload(made, device.payload, device.materials)
    singles: tuple[tuple[str, object, Mapping[type, type[Table]]], ...] = (
        ("background", device.background, {Background: BackgroundKeys}),
        ("driver", device.driver, {model.Driver: DriverKeys}),
        ("workspace", device.workspace, WORKSPACE_KEYS),
    )
    for key, thing, kinds in singles:
        if getattr(thing, "unwritten", False):
            made.unwritten.append(key)
        elif thing is not None:
            made.data[key] = _of_kind(made, thing, kinds, (key,), key)
    if whole:
        _sections_and_references(made, device)
    if whole and device.provenance:
        made.data["provenance"] = dict(device.provenance)
        made.paths[("provenance",)] = "provenance"
    return made


def _of_kind(
    made: DeviceData, thing: object, kinds: Mapping[type, type[Table]], location: Location, path: str
) -> dict[str, Any]:
    """The table of a thing that is of one of several classes."""
    keys = kinds.get(type(thing))
    made.paths[location] = path
    if keys is None:
        made.refuse(location, path, f"must be one of {', '.join(kind.__name__ for kind in kinds)}", thing)
        return {}
    return made.table(thing, keys, location, path)


def _materials(made: DeviceData, materials: Mapping[str, Material]) -> None:
    tables: dict[str, Any] = {}
    for name, material in materials.items():
        location, path = ("material", name), f"materials[{name!r}]"
        if not isinstance(material, Material):
            made.refuse(
                location, path, f"must be fieldmap.material(...) or one of {_classes(Material)}", material
            )
            continue
        keys = MATERIAL_KEYS.get(getattr(material, "kind", ""))
        if keys is None or keys.makes is not type(material):
            made.unwritten.append(name)
            tables[str(name)] = {"kind": "linear", "mu_r": 1.0}
            continue
        tables[name] = made.table(material, keys, location, path)
    made.data |= {"material": tables} if tables else {}


def _classes(base: type[Made]) -> str:
    """The classes that one can make objects of."""
    found, waiting = [], [base]
    while waiting:
        cls = waiting.pop()
        waiting += cls.__subclasses__()
        if cls.__module__.startswith("fieldmap.") and not getattr(cls, "__abstractmethods__", ()):
            found.append(cls.__name__)
    return ", ".join(sorted(found))


def _body(made: DeviceData, body: object, k: int) -> dict[str, Any]:
    location: Location = ("body", k)
    path = f"bodies[{k}]"
    made.paths[location] = path
    if not isinstance(body, model.Body):
        made.refuse(location, path, "must be a Body", body)
        return {}
    own = made.table(body, BodyKeys, location, path)
    parts = body.parts
    single = len(parts) == 1 and isinstance(parts[0], model.Part) and parts[0].operation == "add"
    if single:
        return own | _part(made, parts[0], location, f"{path}.parts[0]")
    made.paths[(*location, "part")] = f"{path}.parts"
    tables = []
    for i, part in enumerate(parts):
        place: Location = (*location, "part", i)
        if not isinstance(part, model.Part):
            made.refuse(place, f"{path}.parts[{i}]", f"must be a Part or one of {_SHAPES}", part)
            continue
        made.paths[(*place, "operation")] = f"{path}.parts[{i}].operation"
        how = {} if part.operation == "add" else {"operation": part.operation}
        tables.append(how | _part(made, part, place, f"{path}.parts[{i}]"))
    return own | {"part": tables}


_SHAPES = ", ".join(shape.__name__ for shape in SHAPE_KEYS)


def _part(made: DeviceData, part: model.Part, location: Location, path: str) -> dict[str, Any]:
    keys = SHAPE_KEYS.get(type(part.shape))
    if keys is None:
        made.refuse((*location, "shape"), f"{path}.shape", f"must be one of {_SHAPES}", part.shape)
        return {}
    shape = made.table(part.shape, keys, location, f"{path}.shape")
    return shape | made.placement(part.placement, location, f"{path}.placement")


def _coils(made: DeviceData, coils: Sequence[Coil]) -> None:
    tables: list[dict[str, Any]] = []
    for k, coil in enumerate(coils):
        location, path = ("coil", len(tables)), f"coils[{k}]"
        made.paths[location] = path
        if not isinstance(coil, Coil):
            made.refuse(location, path, f"must be one of {_classes(Coil)}", coil)
            continue
        keys = COIL_KEYS.get(getattr(coil, "kind", ""))
        if keys is None or getattr(coil, "unwritten", False):
            made.unwritten.append(coil.name)
            continue
        table = made.table(coil, keys, location, path)
        tables.append(table | made.placement(coil.placement, location, f"{path}.placement"))
    made.data |= {"coil": tables} if tables else {}


def _payload(made: DeviceData, payload: object, materials: Mapping[str, Material]) -> dict[str, Any]:
    made.paths[("payload",)] = "payload"
    if not isinstance(payload, carried.Payload):
        made.refuse(("payload",), "payload", "must be a Payload", payload)
        return {}
    if payload.pieces != ():
        return _payload_of_pieces(made, payload, materials)
    if payload.magnet is None:
        return made.table(payload, PayloadWithMoment, ("payload",), "payload")
    table = made.table(payload, PayloadWithMagnet, ("payload",), "payload")
    table["magnet"] = _of_kind(made, payload.magnet, MAGNET_KEYS, ("payload", "magnet"), "payload.magnet")
    _check_moment(made, payload, "the magnet", magnet=payload.magnet)
    return table


def _check_moment(made: DeviceData, payload: carried.Payload, whose: str, **magnets: Any) -> None:
    """A moment that is given beside magnets must be theirs."""
    try:
        moment = carried.Payload(mass=1.0, **magnets).moment
        agree = abs(payload.moment - moment) <= 1e-9 * abs(moment)
    except (TypeError, ValueError, AttributeError, OverflowError):
        return  # told at the magnet
    if not agree:
        must_hold = f"must be that of {whose}, {moment:.6g}: volume times remanence over mu0"
        place: Location = ("payload", "moment_A_m2")
        made.paths[place] = "payload.moment"
        remedy = f"leave the moment out, or {whose}"
        made.findings.append(Finding(place, must_hold, shown(payload.moment), remedy))


def _payload_of_pieces(
    made: DeviceData, payload: carried.Payload, materials: Mapping[str, Material]
) -> dict[str, Any]:
    table = made.table(payload, PayloadWithPieces, ("payload",), "payload")
    made.paths[("payload", "piece")] = "payload.pieces"
    if payload.magnet is not None:
        made.refuse(("payload", "magnet"), "payload.magnet", "must be one of the pieces", payload.magnet)
    if not isinstance(payload.pieces, tuple):
        made.refuse(("payload", "piece"), "payload.pieces", "must be a sequence", payload.pieces)
        return table
    pieces = []
    for k, piece in enumerate(payload.pieces):
        location: Location = ("payload", "piece", k)
        path = f"payload.pieces[{k}]"
        if not isinstance(piece, carried.PayloadPiece):
            made.refuse(location, path, "must be a PayloadPiece, or a magnet or soft body", piece)
            continue
        data = _of_kind(made, piece.shape, PIECE_KEYS, location, f"{path}.shape")
        if isinstance(piece.shape, carried.SoftBody):
            data |= _material_of_piece(made, piece.shape.material, materials, location, path)
        pieces.append(data | made.placement(piece.placement, location, f"{path}.placement"))
    _check_moment(made, payload, "the magnets among the pieces", pieces=payload.pieces)
    return table | {"piece": pieces}


def _material_of_piece(
    made: DeviceData, material: object, materials: Mapping[str, Material], location: Location, path: str
) -> dict[str, Any]:
    """The name that stands for a material of its own, which must be the device's of that name."""
    if material is None:
        return {}
    if not isinstance(material, Material):
        return {"material": material}
    known = materials.get(material.name)
    keys = MATERIAL_KEYS.get(getattr(material, "kind", ""))
    if keys is not None and known is not material:
        one, other = (DeviceData().table(m, keys, (), "") for m in (material, known))
        if one != other:
            made.paths[(*location, "material")] = f"{path}.shape.material"
            must_hold = "must be the material that the device has by this name"
            remedy = "give one of the two another name"
            received = f'another material called "{material.name}"'
            made.findings.append(Finding((*location, "material"), must_hold, received, remedy))
    return {"material": material.name}


def _sections_and_references(made: DeviceData, device: Any) -> None:
    kinds: dict[str, Any] = {"section": {model.Section: SectionKeys}}
    for key, things in (("section", device.sections), ("reference", device.references)):
        tables = []
        for k, thing in enumerate(things):
            if key == "reference":
                gradient = str(getattr(thing, "quantity", "")).startswith("d")
                kinds[key] = {model.Reference: GradientReference if gradient else FluxDensityReference}
            table = _of_kind(made, thing, kinds[key], (key, k), f"{key}s[{k}]")
            if key == "reference" and isinstance(thing, model.Reference):
                table["quantity"] = thing.quantity
                made.paths[(key, k, "quantity")] = f"references[{k}].quantity"
            tables.append(table)
        made.data |= {key: tables} if tables else {}


# ---- values ----


def _in_unit(value: Any, unit: float) -> Any:
    """A value in the unit of its key, as plain data; what is no number stays as it is."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_in_unit(one, unit) for one in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, int | float) and not isinstance(value, bool) and unit != 1.0:
        try:
            number = float(value)
        except OverflowError:
            return float("inf")
        return in_unit(number, unit) if np.isfinite(number) else number
    return value


def _matrix(rotation: Any) -> Array | None:
    """A rotation matrix; None for anything else."""
    try:
        matrix = np.asarray(rotation, dtype=float)
    except (TypeError, ValueError):
        return None
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or np.abs(matrix).max() > 2.0:
        return None
    orthonormal = np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-9
    return matrix if orthonormal and np.linalg.det(matrix) > 0.0 else None


# ---- what is wrong ----


def checked_data(device: Any) -> DeviceData:
    """The data of a device. Raises InputError with one Problem for everything that is wrong with it."""
    # Of a device that was read, and of which some parts were replaced, the text speaks of those that it had.
    read = bool(device.text)
    made = device_data(device, whole=not read)
    findings = list(made.findings)
    if not findings:
        findings = schema_findings(DeviceFile, made.data)
        missing = {dotted(made.data, one.location) for one in findings if one.must_hold == REQUIRED}
        findings += [
            one
            for one in cross_findings(made.data, Path(), missing)
            if not (made.unwritten and one.location[:1] in ((), ("reference",)))
            and not (read and not device.materials and one.location[-1:] == ("material",))
        ]
    if findings:
        raise InputError(*(_problem(made, finding) for finding in findings))
    return made


def _problem(made: DeviceData, finding: Finding) -> Problem:
    location = finding.location
    path, unit = _attribute_path(made, location), ""
    where = f'Device "{made.data["name"]}"'
    if len(location) > 1 and location[0] in ("body", "coil", "section", "material"):
        name = value_at(made.data, (*location[:2], "name")) if location[0] != "material" else location[1]
        where += f', {location[0]} "{name}"' if isinstance(name, str) else ""
    keys = [step for step in location if isinstance(step, str)]
    if keys and (found := _UNIT.match(keys[-1])) and UNITS[found[2]] != 1.0:
        unit = " " + found[2].replace("g_mm2", "g mm^2")
    if location and location[0] == "provenance":  # about keys of the text
        return Problem(f"{where}: {path}", finding.must_hold, finding.received, finding.remedy)
    number = re.fullmatch(r"-?\d[\d.e+-]*", finding.received)
    return Problem(
        f"{where}: {path}" if path else where,
        _in_code(finding.must_hold) + (unit if _BOUND.match(finding.must_hold) else ""),
        _in_code(finding.received) + (unit if number else ""),
        _in_code(finding.remedy).replace(
            "its unit is the last part of the key",
            "lengths are in m, masses in kg, all else in SI units as well",
        ),
    )


def _in_code(text: str) -> str:
    """A text about keys, for attributes: numbers in the unit of the key keep it."""

    def attribute(found: re.Match[str]) -> str:
        unit = found[2].replace("g_mm2", "g mm^2")
        return f"{found[1]}{found[3]} {unit}" if found[3] else found[1]

    return _KEY_IN_TEXT.sub(attribute, text)


def _attribute_path(made: DeviceData, location: Location) -> str:
    for length in range(len(location), 0, -1):
        if location[:length] in made.paths:
            path, rest = made.paths[location[:length]], location[length:]
            break
    else:
        path, rest = "", location
    for step in rest:
        if isinstance(step, int):
            path += f"[{step}]"
        elif path == "provenance":
            path += f"[{step!r}]"
        else:
            attribute = attribute_of(Table, step)[0]
            path += f".{attribute}" if path else attribute
    return path

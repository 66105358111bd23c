"""The Python twin of the data of a device file: the same machine by constructor calls, mistakes included."""

import re
from typing import get_args

import numpy as np

import fieldmap as fm
from fieldmap.device.coils import COIL_KEYS
from fieldmap.device.materials import MATERIAL_KEYS
from fieldmap.device.model import Workspace
from fieldmap.device.payload import Magnet
from fieldmap.device.shapes import SHAPE_KEYS
from fieldmap.inputs.tables import UNITS

UNIT = re.compile(rf"^(.+?)_({'|'.join(sorted(UNITS, key=len, reverse=True))})$")
OTHER_NAMES = {
    "H_A_per_m": "h",
    "B_T": "b",
    "centre_mm": "origin",
    "saturation_polarisation_T": "saturation",
    "unit_mm": "scale",
    "file": "path",
}
SHAPES, COILS, MATERIALS = (
    {kind: keys.makes for kind, keys in tables.items()} for tables in (SHAPE_KEYS, COIL_KEYS, MATERIAL_KEYS)
)
MAGNETS, WORKSPACES = ({one.kind: one for one in get_args(union)} for union in (Magnet, Workspace))
BODY = ("name", "material", "mesh_size_mm", "edge_size_mm")


def attribute(key):
    found = UNIT.match(key)
    return OTHER_NAMES.get(key, found[1] if found else key)


def si(value, unit):
    if isinstance(value, list):
        return [si(one, unit) for one in value]
    if unit == 1.0 or isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return float(value) * unit if abs(value) < 1e300 else value


def arguments(table, *leave_out):
    units = {key: UNITS[found[2]] if (found := UNIT.match(key)) else 1.0 for key in table}
    return {attribute(key): si(value, units[key]) for key, value in table.items() if key not in leave_out}


def one_of(classes, table, key, *leave_out, **more):
    """An object of the class that the table names, or, if no such class exists, the value that a user would pass."""
    if not isinstance(table, dict) or not isinstance(table.get(key), str) or table[key] not in classes:
        return table.get(key) if isinstance(table, dict) else table
    return classes[table[key]](**arguments(table, key, "position_mm", "rotation_deg", *leave_out), **more)


def placement(table):
    position = si(table["position_mm"], 1e-3) if "position_mm" in table else np.zeros(3)
    if "rotation_deg" not in table:
        return fm.Placement(position)
    return fm.Placement(position, fm.placed(rotation_deg=table["rotation_deg"]).rotation)


def single(make):
    return lambda table: make(table) if isinstance(table, dict) else table


def several(make):
    return lambda tables: list(map(single(make), tables)) if isinstance(tables, list) else tables


def part(table, *own):
    more = {"operation": table["operation"]} if "operation" in table else {}
    return fm.Part(one_of(SHAPES, table, "shape", "operation", *own), placement(table), **more)


def body(table):
    own = arguments({key: value for key, value in table.items() if key in BODY})
    if "part" not in table:
        return fm.Body(**own, parts=part(table, *BODY))
    return fm.Body(**own, parts=several(part)(table["part"]), **arguments(table, *BODY, "part"))


def payload(table):
    more = {} if table.get("magnet") is None else {"magnet": one_of(MAGNETS, table["magnet"], "shape")}
    return fm.Payload(**arguments(table, "magnet"), **more)


MADE = {
    "material": (
        "materials",
        single(
            lambda tables: {name: one_of(MATERIALS, one, "kind", name=name) for name, one in tables.items()}
        ),
    ),
    "body": ("bodies", several(body)),
    "coil": ("coils", several(lambda table: one_of(COILS, table, "kind", placement=placement(table)))),
    "payload": ("payload", single(payload)),
    "driver": ("driver", single(lambda table: fm.Driver(**arguments(table)))),
    "workspace": ("workspace", lambda table: one_of(WORKSPACES, table, "shape")),
    "section": ("sections", several(lambda table: fm.Section(**arguments(table)))),
    "sensor": ("sensors", several(lambda table: fm.FieldSensor(**arguments(table)))),
    "reference": ("references", several(lambda table: fm.Reference(**arguments(table)))),
}


def made_in_code(data):
    """The device; errors of the constructors pass through."""
    given = {"coils": []}
    for key, value in data.items():
        name, make = MADE.get(key, (key, None))
        given[name] = value if make is None else make(value)
    given.pop("format", None)
    return fm.Device(**given)

"""The Python twin of the data of a device file: the same machine by calls of constructors, mistakes included."""

import re

import numpy as np

import fieldmap as fm

UNITS = {"mm": 1e-3, "mH": 1e-3, "g": 1e-3, "g_mm2": 1e-9}
UNIT = re.compile(
    r"^(.+?)_(T_per_m|A_per_m|A_per_V|A_m2|g_mm2|N_s_per_m|mm|mH|ohm|deg|g|T|A|V)$",
)
OTHER_NAMES = {
    "H_A_per_m": "h",
    "B_T": "b",
    "centre_mm": "origin",
    "saturation_polarisation_T": "saturation",
    "unit_mm": "scale",
    "file": "path",
}
SHAPES = {
    "cylinder": fm.Cylinder,
    "ring": fm.Ring,
    "box": fm.Box,
    "sphere": fm.Sphere,
    "extruded_polygon": fm.ExtrudedPolygon,
    "revolved_profile": fm.RevolvedProfile,
    "step_file": fm.StepFile,
}
COILS = {"circular": fm.CircularCoil, "rounded_rectangle": fm.RoundedRectangleCoil, "path": fm.PathCoil}
MATERIALS = {
    "linear": fm.LinearMaterial,
    "bh_table": fm.BHTable,
    "froehlich": fm.Froehlich,
    "arctangent": fm.Arctangent,
    "marrocco": fm.Marrocco,
    "flux_barrier": fm.FluxBarrier,
    "permanent_magnet": fm.PermanentMagnet,
}
MAGNETS = {"cylinder": fm.MagnetCylinder, "sphere": fm.MagnetSphere, "block": fm.MagnetBlock}
WORKSPACES = {"box": fm.WorkspaceBox, "cylinder": fm.WorkspaceCylinder}
PLACE = ("position_mm", "rotation_deg")


def attribute(key):
    found = UNIT.match(key)
    return OTHER_NAMES.get(key, found[1] if found else key)


def si(key, value):
    found = UNIT.match(key)
    unit = UNITS.get(found[2], 1.0) if found else 1.0
    return scaled(value, unit)


def scaled(value, unit):
    if isinstance(value, list):
        return [scaled(one, unit) for one in value]
    if unit == 1.0 or isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return float(value) * unit if abs(value) < 1e300 else value


def arguments(table, leave_out=()):
    return {attribute(key): si(key, value) for key, value in table.items() if key not in leave_out}


def one_of(classes, table, key, **more):
    """An object of the class that the table chooses; where there is none, what a user would put in its place."""
    if not isinstance(table, dict):
        return table
    if not isinstance(table.get(key), str) or table.get(key) not in classes:
        return table.get(key)
    return classes[table[key]](**arguments(table, (key, *PLACE, *more.pop("leave_out", ()))), **more)


def placement(table):
    position = np.zeros(3)
    if "position_mm" in table:
        position = si("position_mm", table["position_mm"])
    if "rotation_deg" not in table:
        return fm.Placement(position)
    return fm.Placement(position, fm.placed(rotation_deg=table["rotation_deg"]).rotation)


def part(table, own=()):
    if not isinstance(table, dict):
        return table
    shape = one_of(SHAPES, table, "shape", leave_out=("operation", *own))
    more = {"operation": table["operation"]} if "operation" in table else {}
    return fm.Part(shape, placement(table), **more)


BODY = ("name", "material", "mesh_size_mm", "edge_size_mm")


def body(table):
    if not isinstance(table, dict):
        return table
    own = arguments({key: value for key, value in table.items() if key in BODY})
    if "part" in table:
        stray = {key: value for key, value in table.items() if key not in (*BODY, "part")}
        parts = table["part"]
        parts = [part(one) for one in parts] if isinstance(parts, list) else parts
        return fm.Body(**own, parts=parts, **arguments(stray))
    return fm.Body(**own, parts=part(table, BODY))


def coil(table):
    if not isinstance(table, dict):
        return table
    return one_of(COILS, table, "kind", placement=placement(table))


def section_or_reference(cls, table):
    if not isinstance(table, dict):
        return table
    return cls(**arguments(table))


def single(table, make):
    return make(table) if isinstance(table, dict) else table


def several(tables, make):
    return [make(table) for table in tables] if isinstance(tables, list) else tables


def payload(table):
    magnet = table.get("magnet")
    more = {} if magnet is None else {"magnet": one_of(MAGNETS, magnet, "shape")}
    return fm.Payload(**arguments(table, ("magnet",)), **more)


def made_in_code(data):
    """The device. Raises whatever the constructors raise."""
    known = {
        "name": lambda value: {"name": value},
        "title": lambda value: {"title": value},
        "format": lambda value: {},
        "material": lambda value: {
            "materials": {name: one_of(MATERIALS, table, "kind", name=name) for name, table in value.items()}
            if isinstance(value, dict)
            else value
        },
        "body": lambda value: {"bodies": several(value, body)},
        "coil": lambda value: {"coils": several(value, coil)},
        "payload": lambda value: {"payload": single(value, payload)},
        "driver": lambda value: {"driver": single(value, lambda table: fm.Driver(**arguments(table)))},
        "workspace": lambda value: {"workspace": one_of(WORKSPACES, value, "shape")},
        "section": lambda value: {
            "sections": several(value, lambda table: section_or_reference(fm.Section, table))
        },
        "reference": lambda value: {
            "references": several(value, lambda table: section_or_reference(fm.Reference, table))
        },
        "provenance": lambda value: {"provenance": value},
    }
    given = {}
    for key, value in data.items():
        given |= known[key](value) if key in known else {key: value}
    given.setdefault("coils", [])
    return fm.Device(**given)

"""Every key with a unit, in every kind of file, is read in SI units; each gets a different number."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from pydantic import BaseModel

from fieldmap.dynamics.machine import ChainKeys
from fieldmap.inputs.declared import fields_of
from fieldmap.io.json_schema import FILE_KINDS
from fieldmap.planar import read_planar_device

SI = {
    "_mm": 0.001,
    "_mm_per_s": 0.001,
    "_mm_per_V": 0.001,
    "_ms": 0.001,
    "_mN": 0.001,
    "_g": 0.001,
    "_mH": 0.001,
    "_mT": 0.001,
    "_mT_per_m": 0.001,
    "_g_mm2": 0.000000001,
    **dict.fromkeys(
        ("_T", "_T_per_m", "_A", "_A_per_m", "_A_per_V", "_A_m2", "_V", "_ohm", "_s", "_Hz"), 1.0
    ),
    **dict.fromkeys(("_rad_per_s", "_m_per_s2", "_N_s_per_m", "_N_s2_per_m2", "_N_m_s", "_N_m_s2"), 1.0),
    "_S_per_m": 1.0,
    # For a cylinder's segment, with angles as in magpylib. Other angles are in `MADE`.
    "angles_deg": 1.0,
}
MADE = {
    # Corners are counter-clockwise, and points of a record become an array.
    "points_mm": ([[3.0, 5.0], [7.0, 5.0], [3.0, 11.0]], [[0.003, 0.005], [0.007, 0.005], [0.003, 0.011]]),
    "corners_mm": ([[3.0, 5.0], [7.0, 5.0], [3.0, 11.0]], [[0.003, 0.005], [0.007, 0.005], [0.003, 0.011]]),
    "rotation_deg": ([0.0, 0.0, 30.0], [[0.75**0.5, -0.5, 0.0], [0.5, 0.75**0.5, 0.0], [0.0, 0.0, 1.0]]),
    "lean_deg": (18.0, math.pi / 10),
}
"""Keys whose values are more than scaled: what stands in the file, and what it means."""
BY_HAND = {
    ("PlanarCoilKeys", "wire_diameter_mm"),
    ("PlanarCoilKeys", "wire_size_mm"),
    ("WallKeys", "lower_mm"),
    ("WallKeys", "upper_mm"),
    ("PlanarPayloadKeys", "moment_A_m2"),
    ("SensorsKeys", "angle_deg"),
    ("SensorsKeys", "step_mm"),
    ("SensorsKeys", "input_range_V"),
    ("SensorsKeys", "mm_per_V"),
    ("SensorsKeys", "input_noise_V"),
}
"""Keys that no declaration turns into a field of a record: each in a test below."""


def tables_of(annotation, found):
    """The tables in an annotation, and recursively in their fields."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation not in found:
            found[annotation] = None
            for field in annotation.model_fields.values():
                tables_of(field.annotation, found)
    else:
        for part in get_args(annotation):
            tables_of(part, found)
    return found


def declared_by(table):
    """Tables that make a record, with their attributes by key: the table itself and the tables beside it."""
    yield table, {key: one.attribute for key, one in table.declared.items()}
    for part in table.beside.values():
        yield from declared_by(part)


def read_alone(table, key, attribute, written):
    """The attribute's value from its key alone, without the record's other keys."""
    alone = SimpleNamespace(declared={key: table.declared[key]}, beside={}, makes=table.makes)
    plain = type("Plain", (table,), {"also_makes": lambda self: {}})
    return fields_of(plain.model_construct(**{key: written}), Path(), alone)[attribute]


TABLES = list({table: None for kind in FILE_KINDS for table in tables_of(kind.schema, {})})
# Longest first, because _mm_per_s also ends in _s.
ENDS = sorted([*SI, "_deg"], key=len, reverse=True)
WITH_UNIT = {
    (table, key): end
    for table in TABLES
    for key in table.model_fields
    for end in [next((end for end in ENDS if f"_{key}".endswith(end)), None)]
    if end is not None
}


def test_every_key_is_read_in_its_unit():
    by_hand, number = set(), 1.0
    for (table, key), end in WITH_UNIT.items():
        owners = [(part, names[key]) for part, names in declared_by(table) if key in names]
        if not owners:
            by_hand.add((table.__name__, key))
            continue
        ((part, attribute),) = owners
        number += 2.0
        written, expected = MADE.get(key, (number, None))
        if expected is None:
            expected = SI["angles_deg" if key == "angles_deg" else end] * number
        read = read_alone(part, key, attribute, written)
        where = f"{table.__name__}.{key}"
        np.testing.assert_allclose(np.ravel(read), np.ravel(expected), rtol=1e-12, atol=1e-15, err_msg=where)
        if key not in MADE:
            several = read_alone(part, key, attribute, [number, 2 * number])
            np.testing.assert_allclose(several, [expected, 2 * expected], rtol=1e-12, err_msg=where)
    assert by_hand == BY_HAND
    assert len(WITH_UNIT) > 250


PLANE = """
format = 1
space = "plane"
name = "pair"
title = "a pair"
walls = { lower_mm = [-90.0, -80.0], upper_mm = [70.0, 60.0] }
payload = { moment_A_m2 = 0.7 }
[[coil]]
name = "round"
into_page_mm = [[11.0, 13.0]]
out_of_page_mm = [[-11.0, 13.0]]
wire_diameter_mm = 1.4
[[coil]]
name = "flat"
into_page_mm = [[17.0, 19.0]]
out_of_page_mm = [[-17.0, 19.0]]
wire_size_mm = [2.2, 3.4]
"""


def test_a_planar_device_in_si_units(tmp_path):
    (tmp_path / "pair.toml").write_text(PLANE)
    device = read_planar_device(tmp_path / "pair.toml")
    corners = [[-0.09, -0.08], [0.07, -0.08], [0.07, 0.06], [-0.09, 0.06]]
    assert device.walls == pytest.approx(np.array(corners), rel=1e-12)
    assert device.moment == 0.7
    round_one, flat = (coil.wire for coil in device.coils)
    assert round_one.radius == pytest.approx(0.0007, rel=1e-12)
    assert (flat.width, flat.height) == pytest.approx((0.0022, 0.0034), rel=1e-12)


def test_a_measuring_chain_in_si_units():
    keys = ChainKeys(
        angle_deg=45.0, step_mm=0.006, input_bits=12, input_range_V=5.0, mm_per_V=3.0, input_noise_V=0.007
    )
    made = keys.also_makes()
    assert made["frame"].angle == pytest.approx(math.pi / 4, rel=1e-12)
    assert made["voltage_noise"] == 0.007
    rig = made["rigs"][0]
    # 3 mm are 1 V, so the step of 0.006 mm is 2 mV.
    assert rig.micrometer.voltage_step * rig.micrometer.scale == pytest.approx(6e-6, rel=1e-12)
    assert rig.micrometer.scale == pytest.approx(0.003, rel=1e-12)
    assert rig.input.range == 5.0

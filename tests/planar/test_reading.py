import json
import re
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import DeviceFileError, GeometryError
from fieldmap.io.json_schema import schema_text
from fieldmap.planar import RectangularWire, RoundWire, read_planar_device, solve_planar
from fieldmap.planar.device_file import (
    PlanarBodyKeys,
    PlanarCoilKeys,
    PlanarFile,
    PlanarPayloadKeys,
    WallKeys,
)
from fieldmap.shipped import shipped_file, shipped_folder

NAMES = ["planar_drive_unit", "planar_drive_unit_8mm"]
TEXT = shipped_file("geometry", NAMES[0]).read_text()
EDITS = [
    ('space = "plane"', 'space = "space"', "space", "space"),
    ('material = "iron"', 'material = "irn"', "body.iron.material", "irn"),
    ("[170, 0], [170, 190]", "[170, 0], [-170, 190]", "body.iron.corners_mm", ""),
    ("wire_diameter_mm = 18.0", "wire_diameter_mm = -18.0", "coil.left.wire_diameter_mm", "-18"),
    ("wire_diameter_mm = 18.0", "", "coil.left.wire_size_mm", "neither"),
    (
        "wire_diameter_mm = 18.0",
        "wire_diameter_mm = 18.0\nwire_size_mm = [1, 2]",
        "coil.left.wire_size_mm",
        "both",
    ),
    ("upper_mm = [250, 250]", "upper_mm = [250, -250]", "walls.upper_mm", "-250"),
    ("mu_r = 4000.0", "mu_r = 0", "material.iron.mu_r", "0"),
    ("wire_diameter_mm = 18.0", "wire_diameter_mm = 18.0\nturns = 5", "coil.left.turns", "turns"),
]
# Change and expected messages: each conductor that cuts iron, or the body that touches the walls.
MISFITS = [
    ("wire_diameter_mm = 18.0", "wire_diameter_mm = 19.0", ["coil left"] * 10),
    ("lower_mm = [-250, -250]", "lower_mm = [-150, -250]", ["body iron", *["coil left"] * 5]),
    ("lower_mm = [-250, -250]", "lower_mm = [-170, -250]", ["body iron", *["coil left"] * 5]),
    ("[-121, 109], ", "[-150, 145], ", ["coil left"]),
]


@pytest.mark.parametrize("name", NAMES)
def test_shipped_files(name):
    device = read_planar_device(name)
    assert device.name == name
    assert np.ptp(device.walls, axis=0) == pytest.approx([0.5, 0.5])
    low, high = device.bodies[0].corners.min(axis=0), device.bodies[0].corners.max(axis=0)
    assert high - low == pytest.approx([0.34, 0.09 + (0.008 if "8mm" in name else 0.1)])
    for coil, centre in zip(device.coils, (-0.15, 0.15), strict=True):
        assert isinstance(coil.wire, RoundWire)
        assert coil.wire.radius == pytest.approx(0.009)
        assert len(coil.into_page) == len(coil.out_of_page) == 5
        assert coil.into_page[:, 0] - centre == pytest.approx(np.full(5, 0.029))
        assert coil.out_of_page[:, 0] - centre == pytest.approx(np.full(5, -0.029))


@pytest.mark.parametrize(("old", "new", "path", "received"), EDITS)
def test_one_mistake_gives_one_message(old, new, path, received, tmp_path):
    file = tmp_path / "machine.toml"
    text = TEXT[: TEXT.index("[provenance]")]
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(DeviceFileError) as caught:
        read_planar_device(file)
    (problem,) = caught.value.problems
    assert problem.where.endswith(path)
    assert received in problem.received


@pytest.mark.parametrize(("old", "new", "parts"), MISFITS)
def test_what_does_not_fit_together(old, new, parts, tmp_path):
    file = tmp_path / "machine.toml"
    assert old in TEXT
    file.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(GeometryError) as caught:
        read_planar_device(file)
    found = [re.search(r"(coil|body) \w+", problem.where)[0] for problem in caught.value.problems]
    assert sorted(found) == parts


def test_overlapping_bodies(build, rectangle):
    for second in (
        rectangle(0.05, 0.05, 0.2, 0.2),
        rectangle(0.02, 0.02, 0.05, 0.05),
        rectangle(0, 0, 0.1, 0.1),
    ):
        device = build({"one": rectangle(0, 0, 0.1, 0.1), "two": second}, [([[0.5, 0.5]], [])])
        with pytest.raises(GeometryError) as caught:
            solve_planar(device)
        (problem,) = caught.value.problems
        assert {"one", "two"} <= set(problem.where.split())


def test_clockwise_corners(build, rectangle):
    device = build({"one": rectangle(0, 0, 0.1, 0.1)[::-1]}, [([[0.5, 0.5]], [])])
    with pytest.raises(GeometryError) as caught:
        solve_planar(device)
    (problem,) = caught.value.problems
    assert problem.where.endswith("body one")


def test_rectangular_conductors(tmp_path):
    file = tmp_path / "machine.toml"
    file.write_text(
        TEXT.replace("wire_diameter_mm = 18.0", "wire_size_mm = [18.0, 17.0]").replace(
            '"coil.*.wire_diameter_mm"', '"coil.*.wire_size_mm"'
        )
    )
    wire = read_planar_device(file).coils[0].wire
    assert isinstance(wire, RectangularWire)
    assert (wire.width, wire.height) == pytest.approx((0.018, 0.017))


def test_the_reader_of_three_dimensions_says_where_to_go():
    with pytest.raises(DeviceFileError, match="read_planar_device"):
        read_device(NAMES[0])


def test_schema_for_editors_is_in_step_and_accepts_the_shipped_files():
    text = (shipped_folder("geometry") / "planar.schema.json").read_text(encoding="utf-8")
    assert text == schema_text(PlanarFile)
    for name in NAMES:
        jsonschema.validate(tomllib.loads(shipped_file("geometry", name).read_text()), json.loads(text))


def test_the_example_of_the_page_is_a_device_file(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "planar.md").read_text()
    file = tmp_path / "bar.toml"
    file.write_text(re.search(r"```toml\n(.*?)```", page, re.DOTALL)[1])
    device = read_planar_device(file)
    assert device.moment == 0.8
    assert solve_planar(device, 0.01).field([[0.1, 0.0]], [1.0]).shape == (1, 2)
    written = set(re.findall(r"(\w+) =", page))
    for table in (PlanarFile, PlanarBodyKeys, PlanarCoilKeys, WallKeys, PlanarPayloadKeys):
        known = set(table.model_fields) - {"body", "coil", "walls", "payload", "provenance"}
        assert known - written == set()

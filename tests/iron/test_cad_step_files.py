"""STEP files: a shape that the CAD kernel has written is read back with the size and place that the scale states."""

from pathlib import Path

import numpy as np
import pytest
from netgen import occ

from fieldmap.device.model import Body, Device, Part, Placement, StepFile
from fieldmap.errors import GeometryError
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.geometry.shapes import declared_step_unit
from fieldmap.iron.geometry.solids import body_solid

MILLIMETRE = "SI_UNIT(.MILLI.,.METRE.)"


def block(x: float = 0.0, size: float = 10.0) -> occ.TopoDS_Shape:
    return occ.Box(occ.Pnt(x, 0.0, 0.0), occ.Pnt(x + size, size, size))


def device(path: Path, scale: float = 1e-3, position: tuple[float, float, float] = (0, 0, 0)) -> Device:
    part = Part(StepFile(path, scale), Placement(np.array(position, dtype=float)))
    body = Body("part", "iron", (part,), 0.005)
    return Device.unchecked(name="d", coils=(), bodies=(body,), source=Path("d.toml"))


@pytest.fixture
def step(tmp_path):
    """Write a shape; `unit` replaces the file's unit entry without touching its numbers."""

    def write(shape: occ.TopoDS_Shape, unit: str = MILLIMETRE) -> Path:
        path = tmp_path / "part.step"
        shape.WriteStep(str(path))
        path.write_text(path.read_text().replace(MILLIMETRE, unit))
        return path

    return write


@pytest.mark.usefixtures("read_at_once")
def test_a_cylinder_comes_back_with_its_volume_and_place(step):
    path = step(occ.Cylinder(occ.Pnt(0, 0, 5), occ.Z, 10, 40))
    solid = body_solid(device(path, position=(0.1, 0.0, 0.0)).bodies[0])
    assert solid.mass == pytest.approx(np.pi * 100 * 40, rel=1e-9)
    assert (solid.center.x, solid.center.y, solid.center.z) == pytest.approx((100, 0, 25), abs=1e-9)
    assert [piece.name for piece in solid.solids] == ["part"]


@pytest.mark.usefixtures("read_at_once")
@pytest.mark.parametrize(
    ("unit", "scale"),
    [
        (MILLIMETRE, 1e-3),
        ("SI_UNIT($,.METRE.)", 1e-3),
        ("SI_UNIT(.CENTI.,.METRE.)", 1e-2),
        (MILLIMETRE, 2.54e-2),
    ],
)
def test_numbers_in_the_file_times_the_scale_are_metres_whatever_unit_it_declares(step, unit, scale):
    solid = body_solid(device(step(block(), unit), scale).bodies[0])
    assert solid.mass == pytest.approx((10 * scale * 1e3) ** 3, rel=1e-9)


@pytest.mark.usefixtures("read_at_once")
def test_a_unit_that_differs_from_the_scale_is_noted(step):
    assert geometry_notes(device(step(block()))) == ()
    (note,) = geometry_notes(device(step(block(), "SI_UNIT($,.METRE.)")))
    for said in ("'part'", "part.step", " 1 m", " 0.001 m"):
        assert said in note


def test_an_inch_is_found_beside_the_unit_that_defines_it(tmp_path):
    path = tmp_path / "inch.step"
    path.write_text(
        "ISO-10303-21;\n#1=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n"
        "#2=(CONVERSION_BASED_UNIT('INCH',#3)LENGTH_UNIT()NAMED_UNIT(#4));\nEND-ISO-10303-21;\n"
    )
    assert declared_step_unit(path) == 0.0254


@pytest.mark.parametrize(
    ("units", "metres"),
    [
        (["SI_UNIT($,.METRE.)"], 1.0),
        (["SI_UNIT ( .KILO. , .METRE. )"], 1e3),
        (["SI_UNIT(.DECI.,.METRE.)"], 0.1),
        (["SI_UNIT(.CENTI.,.METRE.)"], 0.01),
        (["SI_UNIT(.MILLI.,.METRE.)"], 1e-3),
        (["SI_UNIT(.MICRO.,.METRE.)"], 1e-6),
        (["CONVERSION_BASED_UNIT('FOOT',#3)"], 0.3048),
        (["CONVERSION_BASED_UNIT( 'inch',#3)"], 0.0254),
        (["SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.MILLI.,.METRE.)"], 1e-3),
        ([], None),
    ],
)
def test_every_unit_that_a_file_may_declare(tmp_path, units, metres):
    path = tmp_path / "some.step"
    path.write_text("".join(f"#1=(LENGTH_UNIT()NAMED_UNIT(*){unit});\n" for unit in units))
    assert declared_step_unit(path) == metres


@pytest.mark.parametrize(
    "units", [["SI_UNIT(.NANO.,.METRE.)"], ["SI_UNIT($,.METRE.)", "SI_UNIT(.MILLI.,.METRE.)"]]
)
def test_units_that_are_unknown_or_several_are_refused(tmp_path, units):
    path = tmp_path / "some.step"
    path.write_text("".join(f"#1=(LENGTH_UNIT()NAMED_UNIT(*){unit});\n" for unit in units))
    with pytest.raises(ValueError, match="one known length unit"):
        declared_step_unit(path)


def test_touching_and_overlapping_solids_of_one_file_are_joined(step):
    path = step(occ.Compound([block(), block(10.0), block(25.0)]))
    solid = body_solid(device(path).bodies[0])
    assert len(solid.solids) == 2
    assert solid.mass == pytest.approx(3000.0)
    (note,) = geometry_notes(device(path))
    assert "'part' is in 2 " in note


def refusal(path: Path, scale: float = 1e-3) -> str:
    with pytest.raises(GeometryError) as caught:
        check_geometry(device(path, scale))
    (problem,) = caught.value.problems
    assert problem.where.startswith("d.toml: body 'part'")
    return str(problem)


def test_files_without_a_readable_solid_are_refused(step, tmp_path):
    assert "absent.step" in refusal(tmp_path / "absent.step")
    path = step(block())
    assert "scale" in refusal(path, 0.0)
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    assert "whole" in refusal(path)
    path.write_text("hello")
    assert "whole" in refusal(path)
    path.write_text(whole.replace(MILLIMETRE, "SI_UNIT(.FEMTO.,.METRE.)"))
    assert "length unit" in refusal(path)
    assert "no solid" in refusal(step(block().faces[0]))


def test_a_file_that_the_kernel_cannot_read_is_refused(tmp_path):
    path = tmp_path / "nonsense.step"
    path.write_text("ISO-10303-21;\nwhatever;\nEND-ISO-10303-21;\n")
    assert "read" in refusal(path)


@pytest.mark.usefixtures("read_at_once")
def test_a_surface_that_crosses_itself_is_refused(step):
    # A bow tie with unequal wings: the kernel's volume integral is their difference, not zero.
    corners = [(0, 0), (10, 10), (10, 0), (0, 14)]
    sides = [occ.Segment(occ.Pnt(*corners[i - 1], 0), occ.Pnt(*corners[i], 0)) for i in range(4)]
    bow_tie = occ.Prism(occ.Face(occ.Wire(sides)), occ.Vec(0, 0, 5))
    assert bow_tie.mass > 1.0
    assert "crosses itself" in refusal(step(bow_tie))

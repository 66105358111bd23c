"""Bodies and their contacts: refused geometries with the numbers of each problem, and sound geometries."""

import re
from pathlib import Path

import numpy as np
import pytest

from fieldmap.device.model import Body, Box, Cylinder, Device, Part, Placement, RevolvedProfile, Ring, Sphere
from fieldmap.errors import GeometryError, Problem
from fieldmap.iron.geometry.checks import check_geometry, geometry_notes
from fieldmap.iron.geometry.contacts import bounds_nearer_than
from fieldmap.iron.geometry.solids import body_solid

CUBE = Box((0.010, 0.010, 0.010))


def body(name: str, shape, x: float = 0, y: float = 0, z: float = 0, rotation=None) -> Body:
    placement = Placement(np.array([x, y, z]) * 1e-3, np.eye(3) if rotation is None else rotation)
    return Body(name, "iron", (Part(shape, placement),), mesh_size=0.005)


def device(*bodies: Body) -> Device:
    return Device.unchecked(name="d", title="", coils=(), bodies=bodies, source=Path("d.toml"))


def problems(*bodies: Body) -> tuple[Problem, ...]:
    """The problems of a device; () where it is sound."""
    try:
        check_geometry(device(*bodies))
    except GeometryError as error:
        return error.problems
    return ()


# ---- sound ----


@pytest.mark.parametrize(
    "bodies",
    [
        (),
        (body("a", CUBE),),
        (body("a", CUBE), body("b", CUBE, 10)),
        (body("a", CUBE), body("b", CUBE, 10, 3, 4)),
        (body("disk", Cylinder(0.066, 0.006)), body("core", Cylinder(0.01, 0.04), 44, 0, 6)),
        (body("tube", Ring(0.01, 0.02, 0.03)), body("rod", Cylinder(0.01, 0.03))),
        (body("a", CUBE), body("b", CUBE, 10, 10), body("c", CUBE, 10, 0)),
        (body("a", CUBE), body("b", CUBE, 10.002)),
        (body("shell", Ring(0.01, 0.02, 0.03)), body("ball", Sphere(0.009), 0, 0, 15)),
    ],
    ids=[
        "coils alone",
        "one body",
        "face on face",
        "part of a face",
        "core on disk",
        "rod in tube",
        "edge contact made sound by a third body",
        "gap of two micrometres",
        "ball inside a tube",
    ],
)
def test_sound_devices_pass_without_notes(bodies):
    assert problems(*bodies) == ()
    assert geometry_notes(device(*bodies)) == ()


def test_contact_survives_the_rounding_of_decimal_coordinates():
    # 0.1 + 0.2 is not 0.3: the faces are 5.6e-14 mm apart, which is contact.
    stack = (body("a", Box((0.01, 0.01, 0.3))), body("b", CUBE, z=(0.1 + 0.2) * 1e3))
    assert stack[1].parts[0].placement.position[2] != 0.3
    assert problems(*stack) == ()


# ---- overlap ----


def named(problem):
    """The quoted names in the place of a problem."""
    return re.findall(r"'([^']*)'", problem.where)


def cut_away():
    return Body("gone", "iron", (Part(CUBE), Part(Box((0.02, 0.02, 0.02)), operation="cut")), 0.005)


CONE = RevolvedProfile(np.array([[0, 0], [0.005, 0.01], [0, 0.01]]))
CROSS = Body("cross", "iron", (Part(CUBE), Part(CUBE, Placement(np.array([0.01, 0.01, 0])))), 0.005)
BALLS = body("a", Sphere(0.01)), body("b", Sphere(0.01))
REFUSED = {
    "overlap": (
        (body("a", CUBE), body("b", CUBE, 8, 6, 1), body("far", CUBE, 100)),
        ["72 mm^3", "x 3 to 5", "y 1 to 5", "z 1 to 10 mm"],
    ),
    "one inside another": (
        (body("a", Box((0.03, 0.03, 0.03))), body("b", Sphere(0.005), 0, 0, 15)),
        [f"{4 / 3 * np.pi * 125:.4g} mm^3"],
    ),
    "two in one place": (BALLS, [f"{axis} -10 to 10" for axis in "xyz"]),
    **{
        f"overlap of {depth:g} mm": (
            (body("a", CUBE), body("b", CUBE, 10 - depth)),
            [f"{100 * depth:.4g} mm^3"],
        )
        for depth in (1e-6, 1e-5, 1e-3)
    },
    "cut away": ((cut_away(), body("b", CUBE, 50)), ["0 mm^3"]),
    "no thickness": ((body("foil", Box((0.01, 0.01, 0.0))),), ["0.0"]),
    "contact along an edge": ((body("a", CUBE), body("b", CUBE, 10, 10)), ["edge", "(5, 5, 5) mm"]),
    "contact with itself": ((CROSS,), ["edge"]),
    "cone on its tip": ((body("a", CUBE), body("b", CONE, 0, 0, 10)), ["point", "(0, 0, 10) mm"]),
    **{
        f"gap of {gap:g} mm": ((body("a", CUBE), body("b", CUBE, 10 + gap)), [f"{gap:.3g} mm"])
        for gap in (1e-6, 1e-4, 9e-4)
    },
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_named_with_volume_place_or_width(case):
    bodies, said = REFUSED[case]
    (problem,) = problems(*bodies)
    assert problem.where.startswith("d.toml: ")
    alone = case in ("cut away", "no thickness", "contact with itself")
    assert named(problem) == ([bodies[0].name] if alone else ["a", "b"])
    assert problem.where.endswith("part 1") == (case == "no thickness")
    for words in said:
        assert words in problem.received
    assert ("0.001 mm" in problem.must_hold) == case.startswith("gap")


def test_a_body_cut_in_two_is_allowed_and_noted():
    slot = Part(Box((0.002, 0.02, 0.02)), operation="cut")
    pieces = Body("split", "iron", (Part(CUBE), slot), 0.005)
    assert problems(pieces) == ()
    (note,) = geometry_notes(device(pieces))
    assert "'split' is in 2 " in note


# ---- contact that is no contact ----

ON_EDGE = np.array([[1, 0, 1], [0, np.sqrt(2), 0], [-1, 0, 1]]) / np.sqrt(2)
LYING = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def on_tip() -> np.ndarray:
    """Rotation that stands a cube on its corner: the space diagonal becomes the z axis."""
    z = np.ones(3) / np.sqrt(3)
    x = np.array([1, -1, 0]) / np.sqrt(2)
    return np.array([x, np.cross(z, x), z])


@pytest.mark.parametrize(
    ("second", "kind"),
    [
        (body("b", CUBE, 10, 10), "edge"),
        (body("b", CUBE, 10, 10, 10), "point"),
        (body("b", CUBE, 10, 0, 10), "edge"),
        (body("b", Cylinder(0.01, 0.01), 15), "along"),
        (body("b", Cylinder(0.002, 0.008), 0, 4, 12, LYING), "along"),
        (body("b", Sphere(0.01), 0, 0, 20), "only"),
        (body("b", Box((0.002, 0.002, 0.002)), 0, 0, 10 + 1 / np.sqrt(2), ON_EDGE), "along"),
        (body("b", Box((0.004, 0.004, 0.004)), 0, 0, 10 + 4 / np.sqrt(3), on_tip()), "only"),
    ],
    ids=[
        "edges",
        "corners",
        "edge above",
        "rod beside",
        "rod lying",
        "ball on face",
        "box on edge",
        "box on tip",
    ],
)
def test_contact_without_a_common_face_is_refused(second, kind):
    found = problems(body("a", CUBE), second)
    assert len(found) == 1, found
    assert "'a' and 'b'" in found[0].where
    assert kind in found[0].must_hold


def test_the_place_of_a_round_contact_lies_on_it():
    # A ball that fills a tube touches it along its equator, and the equator's centre is no point of contact.
    (problem,) = problems(body("tube", Ring(0.01, 0.02, 0.04)), body("ball", Sphere(0.01), 0, 0, 20))
    x, y, z = (float(text) for text in problem.received.split("(")[1].split(")")[0].split(","))
    assert np.hypot(x, y) == pytest.approx(10, abs=1e-5)
    assert z == pytest.approx(20, abs=1e-5)


def test_edge_contact_between_bodies_that_both_stand_on_a_third_is_refused():
    (problem,) = problems(
        body("plate", Box((0.1, 0.1, 0.01)), 0, 0, -10), body("a", CUBE), body("b", CUBE, 10, 10)
    )
    assert "'a' and 'b'" in problem.where
    assert "edge" in problem.received
    # Body 'b' touches body 'a' along two edges.
    beside = tuple(Part(CUBE, Placement(1e-3 * np.array([x, x, 0.0]))) for x in (-10, 10))
    plate = body("plate", Box((0.1, 0.1, 0.01)), 0, 0, -10)
    (problem,) = problems(plate, body("a", CUBE), Body("b", "iron", beside, 0.005))
    assert problem.received.startswith("contact along an edge at (-5, -5, ")
    assert problem.received.endswith(" mm and 1 more places")


# ---- everything at once ----


def test_all_problems_come_in_one_error():
    found = problems(
        body("a", CUBE),
        body("overlaps a", CUBE, 9),
        body("no height", Cylinder(0.01, 0.0), 100),
        body("no height either", Cylinder(0.01, 0.0), 200),
    )
    assert [named(problem) for problem in found] == [["no height"], ["no height either"], ["a", "overlaps a"]]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1, -1])
def test_boxes_around_solids_are_as_far_apart_as_they_are(axis, sign):
    """Two cubes of 10 mm, 2 mm apart along one axis and overlapping along the others; and one inside the other."""
    place = np.array([3.0, -2.0, 4.0])
    place[axis] = sign * 12.0
    one, other = (body_solid(body("a", CUBE)), body_solid(body("b", CUBE, *place)))
    for a, b in ((one, other), (other, one)):
        assert bounds_nearer_than(a, b, 2.001)
        assert not bounds_nearer_than(a, b, 1.999)
    assert bounds_nearer_than(one, body_solid(body("c", Box((0.001,) * 3), 0, 0, 5)), 0.0)


def test_a_device_without_a_file_is_called_by_its_name():
    with pytest.raises(GeometryError) as caught:
        check_geometry(
            Device.unchecked(name="made in code", coils=(), bodies=(body("a", CUBE), body("b", CUBE, 1)))
        )
    assert named(caught.value.problems[0]) == ["made in code", "a", "b"]

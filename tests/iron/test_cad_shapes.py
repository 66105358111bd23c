"""Shapes as CAD solids against closed-form volumes and centroids, their placement against R x + p."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import GeometryError
from fieldmap.iron.geometry import shapes
from fieldmap.iron.geometry.solids import body_solid

TRIANGLE = np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.06]])
L_SHAPE = np.array([[0, 0], [0.03, 0], [0.03, 0.01], [0.01, 0.01], [0.01, 0.04], [0, 0.04]])
CONE = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.03]])
TORUS_OF_SQUARE = np.array([[0.04, -0.01], [0.06, -0.01], [0.06, 0.01], [0.04, 0.01]])
POT_WITH_HOLE = np.array(
    [[0, -0.01], [0.01, -0.01], [0.01, 0.03], [0, 0.03], [0, 0.02], [0.005, 0.01], [0, 0]], dtype=float
)


def body(*parts: fm.Part) -> fm.Body:
    return fm.Body("piece", "iron", parts, mesh_size=0.005)


def turned(axis: tuple[float, float, float], degrees: float) -> np.ndarray:
    """Rotation matrix of Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.deg2rad(degrees)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


TETRAHEDRON = 0.01 * np.vstack([np.zeros(3), np.eye(3)])
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])

CASES = [
    (fm.TriangleSurface(TETRAHEDRON, FACES), 0.01**3 / 6, (0.0025, 0.0025, 0.0025)),
    (fm.Cylinder(0.02, 0.05), np.pi * 0.02**2 * 0.05, (0, 0, 0.025)),
    (fm.Ring(0.01, 0.02, 0.05), np.pi * (0.02**2 - 0.01**2) * 0.05, (0, 0, 0.025)),
    (fm.Box((0.01, 0.02, 0.04)), 0.01 * 0.02 * 0.04, (0, 0, 0.02)),
    (fm.Sphere(0.02), 4 / 3 * np.pi * 0.02**3, (0, 0, 0)),
    (fm.ExtrudedPolygon(TRIANGLE, 0.02), 0.5 * 0.03 * 0.06 * 0.02, (0.01, 0.02, 0.01)),
    (fm.ExtrudedPolygon(TRIANGLE[::-1], 0.02), 0.5 * 0.03 * 0.06 * 0.02, (0.01, 0.02, 0.01)),
    (fm.ExtrudedPolygon(L_SHAPE, 0.01), (0.03 * 0.01 + 0.01 * 0.03) * 0.01, (0.01, 0.015, 0.005)),
    (fm.RevolvedProfile(CONE), np.pi * 0.02**2 * 0.03 / 3, (0, 0, 0.03 / 4)),
    (fm.RevolvedProfile(CONE[::-1]), np.pi * 0.02**2 * 0.03 / 3, (0, 0, 0.03 / 4)),
    (fm.RevolvedProfile(TORUS_OF_SQUARE), 2 * np.pi * 0.05 * 0.02**2, (0, 0, 0)),
]


@pytest.mark.parametrize(("shape", "volume", "centroid"), CASES, ids=lambda x: type(x).__name__)
def test_volume_and_centroid_are_those_of_the_formula(shape, volume, centroid):
    solid = body_solid(body(fm.Part(shape)))
    assert solid.mass == pytest.approx(volume * 1e9, rel=1e-9)
    c = solid.center
    assert (c.x, c.y, c.z) == pytest.approx(np.array(centroid) * 1e3, abs=1e-8)


def test_a_revolved_profile_may_leave_the_axis_and_come_back():
    # Pappus: 2 pi times the first moment of the profile's area about the axis, by the shoelace formula.
    x, y = POT_WITH_HOLE.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    moment = np.sum((x + np.roll(x, -1)) * cross) / 6
    assert body_solid(body(fm.Part(fm.RevolvedProfile(POT_WITH_HOLE)))).mass == pytest.approx(
        2 * np.pi * moment * 1e9, rel=1e-9
    )


def test_curved_surfaces_stay_curved():
    solid = body_solid(body(fm.Part(fm.Cylinder(0.02, 0.05))))
    # A mantle, a lid and a base; as a polygon it would have many sides.
    assert len(solid.faces) == 3
    assert sum(face.mass for face in solid.faces) == pytest.approx(2 * np.pi * 20 * (20 + 50), rel=1e-9)


@pytest.mark.parametrize(
    "rotation",
    [np.eye(3), turned((0, 0, 1), 30), turned((1, 0, 0), 90), turned((0, 1, 0), 180), turned((1, 2, 3), 77)],
)
def test_placement_takes_each_corner_to_rotation_times_local_plus_position(rotation):
    position = np.array([0.1, -0.2, 0.3])
    a, b, c = 0.01, 0.02, 0.04
    local = np.array([[x, y, z] for x in (-a / 2, a / 2) for y in (-b / 2, b / 2) for z in (0, c)])
    expected = (local @ rotation.T + position) * 1e3
    solid = body_solid(body(fm.Part(fm.Box((a, b, c)), fm.Placement(position, rotation))))
    corners = [vertex.p for vertex in set(solid.vertices)]
    found = np.array([(p.x, p.y, p.z) for p in corners])
    assert len(found) == 8
    nearest = np.linalg.norm(found[:, None] - expected[None], axis=2).min(axis=0)
    assert nearest.max() < 1e-9


def test_every_solid_carries_its_name_and_mesh_size_in_millimetres():
    solid = body_solid(
        body(fm.Part(fm.Sphere(0.01)), fm.Part(fm.Sphere(0.01), fm.Placement(np.array([0.1, 0, 0]))))
    )
    assert [(piece.name, piece.maxh) for piece in solid.solids] == [("piece", 5.0), ("piece", 5.0)]


# ---- boolean parts ----


BLOCK = fm.Box((0.02, 0.02, 0.02))
HOLE = fm.Part(fm.Cylinder(0.005, 0.02), fm.Placement(np.array([0.01, 0.0, -0.005])), "cut")


@pytest.mark.parametrize(
    ("parts", "volume"),
    [
        ((fm.Part(BLOCK), fm.Part(BLOCK, fm.Placement(np.array([0.01, 0.0, 0.0])))), 1.5 * 8000),
        ((fm.Part(fm.Box((0.04, 0.04, 0.01))), HOLE), 16000 - np.pi * 25 * 10),
        ((fm.Part(BLOCK), fm.Part(BLOCK, operation="cut"), fm.Part(BLOCK)), 8000),
        ((fm.Part(BLOCK), fm.Part(BLOCK), fm.Part(BLOCK, operation="cut")), 0.0),
    ],
    ids=["what overlaps counts once", "a cut", "cut, then filled", "filled, then cut"],
)
def test_parts_are_added_and_cut_in_order(parts, volume):
    assert body_solid(body(*parts)).mass == pytest.approx(volume, rel=1e-9)


def test_added_parts_leave_no_edges_between_them():
    # Three boxes in a row make one box: six faces, twelve edges (each seen from two faces).
    row = [fm.Part(fm.Box((0.01, 0.01, 0.01)), fm.Placement(np.array([0.01 * i, 0, 0]))) for i in range(3)]
    solid = body_solid(body(*row))
    assert (len(solid.solids), len(solid.faces), len(set(solid.edges)), len(set(solid.vertices))) == (
        1,
        6,
        12,
        8,
    )


# ---- what cannot be built ----


@pytest.mark.parametrize(
    ("shape", "fragment"),
    [
        (fm.Cylinder(0.01, 0.0), "height = 0.0 m"),
        (fm.Cylinder(-0.01, 0.01), "radius = -0.01 m"),
        (fm.Cylinder(float("nan"), 0.01), "radius = nan m"),
        (fm.Box((0.01, -0.01, 0.01)), "(0.01, -0.01, 0.01) m"),
        (fm.Sphere(0.0), "radius = 0.0 m"),
        (fm.Ring(0.02, 0.01, 0.01), "inner radius 0.02 m"),
        (fm.ExtrudedPolygon(TRIANGLE[:2], 0.01), "polygon"),
        (fm.ExtrudedPolygon(np.array([[0, 0], [1, 1], [1, 0], [0, 1.5]]) * 0.01, 0.01), "meets"),
        (fm.ExtrudedPolygon(TRIANGLE * np.nan, 0.01), "finite"),
        (fm.RevolvedProfile(CONE - [0.001, 0.0]), "-1 mm"),
        (fm.RevolvedProfile(np.array([[0, 0], [0.01, -0.01], [0.01, 0.01]])), "axis"),
        (fm.TriangleSurface(TETRAHEDRON, FACES[:3]), "open edge between points 0 and 1"),
        (fm.TriangleSurface(TETRAHEDRON, FACES[:, ::-1]), "enclosed volume of -1.667e-07"),
        (
            fm.TriangleSurface(np.vstack([TETRAHEDRON, TETRAHEDRON + 0.002]), np.vstack([FACES, FACES + 4])),
            "triangles 0 and ",
        ),
    ],
)
def test_what_cannot_be_built_is_named(shape, fragment):
    with pytest.raises(GeometryError) as caught:
        body_solid(body(fm.Part(shape)), "unit.toml")
    (problem,) = caught.value.problems
    assert problem.where.startswith("unit.toml: ")
    assert "'piece'" in problem.where
    assert fragment in problem.received
    assert caught.value.exit_code == 2


def test_a_body_must_begin_with_something_to_cut_from():
    for parts, where in (
        ([fm.Part(fm.Sphere(0.01), operation="cut")], "body 'piece', part 1"),
        ([], "body 'piece'"),
    ):
        with pytest.raises(GeometryError) as caught:
            body_solid(body(*parts))
        assert caught.value.problems[0].where == where


def test_a_place_that_is_not_a_number_is_refused():
    with pytest.raises(GeometryError, match="position"):
        body_solid(body(fm.Part(fm.Sphere(0.01), fm.Placement(np.array([np.nan, 0, 0])))))


def test_a_ring_is_full_without_a_bore_and_no_other_bore_is_none():
    full = np.pi * 5.0**2 * 10.0
    assert shapes.ring(0.0, 5e-3, 0.0, 1e-2).mass == pytest.approx(full, rel=1e-9)
    assert shapes.ring(3e-3, 5e-3, 0.0, 1e-2).mass == pytest.approx(full * (1 - 0.36), rel=1e-9)
    for inner in (-1e-3, 5e-3, 6e-3):
        with pytest.raises(ValueError, match="inner radius"):
            shapes.ring(inner, 5e-3, 0.0, 1e-2)

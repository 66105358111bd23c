"""Closed surfaces of triangles as bodies: STL files, and messages for surfaces that bound no solid."""

import struct

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import fieldmap as fm
from fieldmap.device.surfaces import crossing_triangles, enclosed_volume, read_stl, surface_fault
from fieldmap.errors import GeometryError, InputError
from fieldmap.iron import check_geometry
from fieldmap.iron.geometry.solids import body_solid

CORNERS = np.array([[x, y, z] for x in (-5.0, 5.0) for y in (-6.0, 6.0) for z in (0.0, 8.0)])
FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)
IRON = {"iron": fm.LinearMaterial("iron", 500.0)}
COIL = fm.CircularCoil("coil", 0.012, 0.016, 0.006, 200.0).moved([0, 0, 0.004])


def write_binary(path, corners):
    records = b"".join(struct.pack("<12fH", 0, 0, 0, *corner.ravel(), 0) for corner in corners)
    path.write_bytes(b"a cube".ljust(80) + struct.pack("<I", len(corners)) + records)


def write_text(path, corners):
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x:.9e} {y:.9e} {z:.9e}\n" for x, y, z in corner)
        + " endloop\nendfacet\n"
        for corner in corners
    )
    path.write_text(f"solid cube\n{facets}endsolid cube\n")


def machine(shape):
    return fm.Device("machine", "", (COIL,), (fm.Body("block", "iron", shape, 0.003, 0.001),), IRON)


@pytest.mark.parametrize("write", [write_binary, write_text])
def test_an_stl_file_gives_its_corners_once(write, tmp_path):
    write(tmp_path / "cube.stl", CORNERS[FACES])
    points, triangles = read_stl(tmp_path / "cube.stl")
    assert len(points) == 8
    assert np.array_equal(points[triangles], CORNERS[FACES])
    assert enclosed_volume(points, triangles) == pytest.approx(960.0)
    assert surface_fault(points, triangles) is None
    assert crossing_triangles(points, triangles) is None


def test_a_cube_from_stl_is_the_box(tmp_path):
    """It is the same solid, so the mesh is the same."""
    write_binary(tmp_path / "cube.stl", CORNERS[FACES])
    surface = fm.TriangleSurface.from_stl(tmp_path / "cube.stl")
    points = np.array([[0.0, 0.0, -0.003], [0.009, 0.001, 0.004], [0.0, 0.02, 0.01]])
    ours, box = (
        fm.solve_linear(machine(s)).field(points, 1.0) for s in (surface, fm.Box((0.01, 0.012, 0.008)))
    )
    assert np.abs(ours - box).max() < 1e-3 * np.abs(box).max()


def test_in_a_file_moved_and_mirrored(tmp_path):
    surface = fm.TriangleSurface(1e-3 * CORNERS, FACES)
    device = machine(surface)
    (tmp_path / "machine.toml").write_text(device.to_toml())
    read = fm.read_device(tmp_path / "machine.toml").bodies[0]
    assert np.array_equal(read.parts[0].shape.points, surface.points)
    assert np.array_equal(read.parts[0].shape.triangles, FACES)
    body = device.bodies[0].moved([0.01, 0.0, 0.0])
    assert 1e-9 * body_solid(body.mirrored("x")).mass == pytest.approx(960e-9)
    assert body_solid(body.mirrored("x")).center[0] == pytest.approx(-10.0)


def test_a_rounded_surface_has_its_volume():
    ball = np.random.default_rng(0).normal(size=(120, 3))
    ball *= 0.01 / np.linalg.norm(ball, axis=1, keepdims=True)
    hull = ConvexHull(ball)
    outward = np.einsum(
        "kd,kd->k", np.cross(*np.diff(ball[hull.simplices], axis=1).transpose(1, 0, 2)), hull.equations[:, :3]
    )
    triangles = np.where(outward[:, None] > 0, hull.simplices, hull.simplices[:, ::-1])
    solid = body_solid(fm.Body("ball", "iron", fm.TriangleSurface(ball, triangles), 0.005))
    assert 1e-9 * solid.mass == pytest.approx(hull.volume, rel=1e-9)


@pytest.mark.parametrize(
    ("triangles", "received"),
    [
        (FACES[1:], "an open edge between points 0 and 1 (3 in all)"),
        (FACES[:, ::-1], "an enclosed volume of -960"),
        (
            np.vstack([FACES[:1, ::-1], FACES[1:]]),
            "two triangles that run the same way from point 0 to 3 (3 in all)",
        ),
        (np.vstack([FACES, [0, 1, 8]]), "[0, 1, 8]"),
        (np.vstack([FACES, [0, 1, 1]]), "point 1 twice"),
    ],
    ids=["open", "inside out", "one turned", "no such corner", "no triangle"],
)
def test_what_bounds_no_solid_is_told(triangles, received):
    assert surface_fault(CORNERS, triangles)[1] == received
    with pytest.raises(InputError) as caught:
        machine(fm.TriangleSurface(1e-3 * CORNERS, triangles))
    problem = caught.value.problems[0]
    assert problem.where.startswith('Device "machine", body "block"')
    assert problem.received == received


def test_a_surface_that_cuts_itself_is_told():
    """A corner of the block is pulled through the face opposite of it."""
    corners = CORNERS.copy()
    corners[0] = [12.0, 1.0, 5.0]
    assert surface_fault(corners, FACES) is None
    one, other = crossing_triangles(corners, FACES)
    assert 0 in FACES[one] or 0 in FACES[other]
    with pytest.raises(GeometryError) as caught:
        check_geometry(machine(fm.TriangleSurface(1e-3 * corners, FACES)))
    assert "block" in caught.value.problems[0].where


def cubes(*sizes_places_signs):
    """Corners (m, 3, 3) of triangles of cubes: half an edge, centre on x, 1 for outward and -1 for inward."""
    unit = (CORNERS - [0, 0, 4.0]) / [5.0, 6.0, 4.0]
    return np.concatenate(
        [(half * unit + [x, 0, 0])[FACES[:, ::sign]] for half, x, sign in sizes_places_signs]
    )


@pytest.mark.parametrize(
    ("shells", "volume"),
    [
        ([(10, 0, 1), (5, 0, -1)], 8000 - 1000),
        ([(10, 0, 1), (6, 0, -1), (3, 0, 1)], 8000 - 1728 + 216),
        ([(5, 0, 1), (5, 20, 1)], 2000),
        ([(10, 0, 1), (4, 14, 1)], 8512),
    ],
    ids=["hollow", "island", "two", "touching"],
)
def test_shells_that_bound_a_solid(tmp_path, shells, volume):
    write_binary(tmp_path / "cubes.stl", cubes(*shells))
    surface = fm.TriangleSurface.from_stl(tmp_path / "cubes.stl")
    assert body_solid(fm.Body("cubes", "iron", surface, 0.005)).mass == pytest.approx(volume)


@pytest.mark.parametrize(
    ("shells", "words"),
    [
        (
            [(10, 0, 1), (5, 0, 1)],
            "2 of 2 (12 triangles from 12, (-5, -5, -5) to (5, 5, 5)) in shell 1 faces outward",
        ),
        (
            [(10, 0, 1), (6, 0, -1), (3, 0, -1)],
            "3 of 3 (12 triangles from 24, (-3, -3, -3) to (3, 3, 3)) in shell 1",
        ),
        (
            [(10, 0, 1), (5, 30, -1)],
            "shell 2 of 2 (12 triangles from 12, (25, -5, -5) to (35, 5, 5)) faces inward",
        ),
    ],
    ids=["both outward", "island inward", "beside and inward"],
)
def test_shells_that_face_the_wrong_way_are_named(tmp_path, shells, words):
    write_binary(tmp_path / "cubes.stl", cubes(*shells))
    with pytest.raises(InputError) as caught:
        fm.TriangleSurface.from_stl(tmp_path / "cubes.stl")
    (problem,) = caught.value.problems
    assert problem.where == str(tmp_path / "cubes.stl")
    assert words in problem.received
    # A device made of the triangles gives the same problem.
    points, triangles = read_stl(tmp_path / "cubes.stl")
    with pytest.raises(InputError) as caught:
        machine(fm.TriangleSurface(1e-3 * points, triangles))
    assert 'body "block"' in caught.value.problems[0].where


def test_shells_that_cut_each_other_are_named(tmp_path):
    corners = cubes((10, 0, 1), (8, 7, 1))
    corners[12:] += [0.0, 5.0, 6.0]
    write_binary(tmp_path / "cubes.stl", corners)
    with pytest.raises(InputError) as caught:
        fm.TriangleSurface.from_stl(tmp_path / "cubes.stl")
    assert "shell 1 of 2" in caught.value.problems[0].received
    assert "shell 2 of 2" in caught.value.problems[0].received
    # With faces in common planes no edge goes through a triangle; the kernel finds the volume that counts twice.
    write_binary(tmp_path / "cubes.stl", cubes((10, 0, 1), (10, 7, 1)))
    with pytest.raises(GeometryError) as caught:
        check_geometry(machine(fm.TriangleSurface.from_stl(tmp_path / "cubes.stl")))
    assert "10800 mm^3 in place of 16000 mm^3" in caught.value.problems[0].received
    assert "2 shells overlap" in caught.value.problems[0].received


@pytest.mark.parametrize("data", [b"", b"solid nothing\nendsolid", b"\0" * 90, b"solid x\nvertex 1 2 a\n"])
def test_no_stl_file(data, tmp_path):
    (tmp_path / "no.stl").write_bytes(data)
    with pytest.raises(InputError) as caught:
        fm.TriangleSurface.from_stl(tmp_path / "no.stl")
    assert caught.value.problems[0].where == str(tmp_path / "no.stl")
    with pytest.raises(InputError):
        fm.TriangleSurface.from_stl(tmp_path / "not there.stl")

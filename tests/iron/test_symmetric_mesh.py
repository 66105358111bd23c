"""Meshes copied from one chamber: the group maps them onto themselves, and they fill the bodies without a crack."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device.model import (
    Body,
    Box,
    Cylinder,
    Device,
    LinearMaterial,
    Part,
    Placement,
    Sphere,
    WorkspaceBox,
)
from fieldmap.errors import InputError
from fieldmap.iron.mesh.chamber import ChamberCopies, on_walls
from fieldmap.iron.mesh.mesh import generate_mesh, volumes
from fieldmap.iron.mesh.mesher import LocalSizes
from fieldmap.iron.topology import build_faces

IRON = {"iron": LinearMaterial("iron", 100.0)}


def about_z(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def body(shape, at=(0.0, 0.0, 0.0), size=0.01, turned=0.0, name="b", edge=None):
    return Body(name, "iron", (Part(shape, Placement(np.array(at), about_z(turned))),), size, edge)


def device(*bodies):
    return Device.unchecked(name="d", coils=(), bodies=bodies, materials=IRON)


def plate_with_posts(count, turned=0.0, edge=None):
    """A round plate with square posts on it: C_nv for each number of posts."""
    posts = [
        body(
            Box((0.006, 0.006, 0.015)),
            at=about_z(360 * k / count + turned) @ [0.015, 0, 0.005],
            turned=360 * k / count + turned,
            size=0.005,
            name=f"post {k}",
            edge=edge,
        )
        for k in range(count)
    ]
    return device(body(Cylinder(0.024, 0.005), size=0.008, name="plate", edge=edge), *posts)


CASES = {
    "one mirror": (
        device(body(Box((0.02, 0.02, 0.01))), body(Box((0.01, 0.02, 0.02)), at=(0.01, 0, 0.01), name="c")),
        2,
    ),
    "box": (device(body(Box((0.03, 0.02, 0.01)), edge=1e-3)), 8),
    "box on its edge": (
        device(body(Box((0.02, 0.02, 0.03)), at=(0.1, 0.2, 0.3), turned=30.0, edge=1e-3)),
        16,
    ),
    "three posts": (plate_with_posts(3, edge=1e-3), 6),
    "five posts, turned": (plate_with_posts(5, turned=11.0), 10),
    "six posts": (plate_with_posts(6), 12),
    "two apart": (
        device(body(Box((0.01,) * 3), at=(0.02, 0, 0)), body(Box((0.01,) * 3), at=(-0.02, 0, 0), name="c")),
        16,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_every_operation_maps_the_mesh_onto_itself(case):
    machine, order = CASES[case]
    mesh = generate_mesh(machine, symmetry="auto")
    group = mesh.symmetry.group
    # In these cases the mirrors generate the whole group.
    assert group.order == order
    size = np.abs(mesh.points - group.centre).max()
    keys = {tuple(row) for row in np.column_stack([np.sort(mesh.tets, axis=1), mesh.body])}
    for operation, images in zip(group.operations, mesh.symmetry.node_images, strict=True):
        assert sorted(images) == list(range(len(mesh.points)))
        moved = (mesh.points - group.centre) @ operation.matrix.T + group.centre
        assert np.abs(moved - mesh.points[images]).max() <= 2e-15 * max(size, np.abs(mesh.points).max())
        moved_body = np.array(operation.bodies)[mesh.body]
        assert {
            tuple(row) for row in np.column_stack([np.sort(images[mesh.tets], axis=1), moved_body])
        } == keys


@pytest.mark.parametrize("case", CASES)
def test_no_cracks_no_doubles_and_the_same_bodies(case):
    """Volume per body and outer surface are those of the mesh of the whole: a crack would add surface."""
    machine, _ = CASES[case]
    whole, mesh = (generate_mesh(machine, symmetry=word) for word in ("none", "auto"))
    assert whole.symmetry is None
    volume = volumes(mesh.points, mesh.tets)
    assert volume.min() > 0
    apart = np.linalg.norm(np.diff(mesh.points[np.lexsort(mesh.points.T)], axis=0), axis=1)
    assert apart.min() > 1e-6
    surfaces = []
    for each in (whole, mesh):
        faces = build_faces(each.points, each.tets)
        a, b, c = (each.points[faces.nodes[faces.surface][:, k]] for k in range(3))
        surfaces.append(
            (faces.group_of_tet.max(), 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        )
    round_plate = len(machine.bodies) > 2
    assert surfaces[1] == pytest.approx(surfaces[0], rel=3e-3 if round_plate else 1e-12)
    reference = volumes(whole.points, whole.tets)
    for k in range(len(machine.bodies)):
        rel = 3e-3 if round_plate and k == 0 else 1e-12
        assert volume[mesh.body == k].sum() == pytest.approx(reference[whole.body == k].sum(), rel=rel)


def test_layers_grow_at_sharp_edges_in_mirror_planes_and_nowhere_else():
    """A box on its edge: mirror planes run through edges and through faces."""
    shape = Box((0.02, 0.02, 0.03))
    plain = generate_mesh(device(body(shape, turned=45.0)), symmetry="auto")
    graded = generate_mesh(device(body(shape, turned=45.0, edge=1e-3)), symmetry="auto")
    assert len(plain.points) < len(graded.points)
    new = graded.points[~np.isin(np.round(graded.points, 9), np.round(plain.points, 9)).all(axis=1)]
    local = np.abs(new @ about_z(45.0)) * [1, 1, 0] + np.abs(new - [0, 0, 0.015]) * [0, 0, 1]
    # Distance to the nearest of the twelve edges: two of the three distances to the faces.
    gap = np.sort(np.array([0.01, 0.01, 0.015]) - local, axis=1)
    near = np.linalg.norm(gap[:, :2], axis=1)
    assert near.min() < 2e-3
    upright = np.linalg.norm(gap[:, :2], axis=1)[np.abs(new[:, 0]) < 1e-12]
    assert upright.min() < 2e-3  # the edge in the plane x = 0


@pytest.mark.parametrize("refinement", [0.5, 1.0])
def test_mirror_planes_through_round_bodies_make_no_sharp_edges(refinement):
    sphere = [
        generate_mesh(device(body(Sphere(0.02), edge=edge)), refinement, symmetry="auto")
        for edge in (None, 1e-4)
    ]
    assert sphere[0].symmetry is not None
    assert len(sphere[0].tets) == len(sphere[1].tets)


@pytest.mark.parametrize(
    ("lower", "upper", "order"),
    [
        ((-0.01, -0.01, 0.03), (0.01, 0.01, 0.04), 8),  # C4v: nothing maps the box above to one below
        ((-0.01, -0.02, 0.03), (0.01, 0.02, 0.04), 4),  # C2v: a rectangle has no diagonal mirrors
        ((0.0, -0.02, 0.03), (0.01, 0.02, 0.04), 2),
        ((-0.01, -0.01, -0.005), (0.01, 0.01, 0.015), 16),  # D4h: round the middle of the iron
        ((0.0, 0.01, 0.03), (0.01, 0.02, 0.05), 1),
    ],
)
def test_operations_that_keep_the_workspace(lower, upper, order):
    """A square block. Small elements near the workspace then need no copies elsewhere."""
    block = device(body(Box((0.04, 0.04, 0.01)), size=0.02))
    space = WorkspaceBox(np.array(lower), np.array(upper))
    mesh = generate_mesh(Device.unchecked(**vars(block) | {"workspace": space}), symmetry="workspace")
    assert (1 if mesh.symmetry is None else mesh.symmetry.group.order) == order


def test_sizes_at_a_place_hold_in_all_copies():
    """Small elements and thin layers at one corner of a box come back at the images of this corner. Each tetrahedron
    lies in the mesher's cell of its number, in its own copy of the chamber."""
    box = device(body(Box((0.03, 0.02, 0.01)), edge=1e-3))
    corner = np.array([[0.015, 0.01, 0.01], [0.0, 0.0, 0.005]])
    sizes = np.array([0.001, 0.01])
    mesh = generate_mesh(
        box, symmetry="auto", local=LocalSizes(corner, sizes, corner, np.array([2e-4, 1e-3]))
    )
    assert mesh.symmetry.group.order == 8
    cells, volume = mesh.cells, volumes(mesh.points, mesh.tets)
    within = np.bincount(cells.number, volume, len(cells.sizes))
    assert within.min() > 0
    centroids = np.zeros_like(cells.centres)
    np.add.at(centroids, cells.number, volume[:, None] * mesh.points[mesh.tets].mean(axis=1))
    # The centre of a cell is the centroid of its tetrahedra, unless nodes moved onto round faces.
    assert np.abs(centroids / within[:, None] - cells.centres).max() < 1e-12
    small = cells.centres[cells.sizes < 0.0015]
    sides = np.sign(small - [0, 0, 0.005])
    assert sorted(map(tuple, np.unique(sides, axis=0).tolist())) == sorted(product((-1.0, 1.0), repeat=3))
    assert len(small) == 8 * (sides == 1).all(axis=1).sum()


def test_another_word_is_refused():
    with pytest.raises(InputError, match="symmetry"):
        generate_mesh(CASES["box"][0], symmetry="mirror")


def test_points_in_walls_are_moved_onto_them_and_no_others():
    """Walls at 60 degrees about (1, 2, 3): points within the tolerance of one, of both, of none."""
    walls = np.array([[0.0, 1.0, 0.0], [np.sqrt(0.75), -0.5, 0.0]])
    centre = np.array([1.0, 2.0, 3.0])
    chamber = SimpleNamespace(walls=walls, group=SimpleNamespace(centre=centre, tolerance=1e-3))
    along = np.array([0.5, np.sqrt(0.75), 0.0])
    exact = np.array([[0.7, 0.0, 0.2], [0.0, 0.0, -0.4], [0.3, 0.2, 0.0]])
    off = np.array([[0.0, 9e-4, 0.0], [4e-4, -3e-4, 0.0], [0.0, 0.0, 0.0]])
    points = centre + exact + off
    points = np.vstack([points, centre + along * 0.5 + 5e-4 * walls[1], centre + [0.7, 1.1e-3, 0.0]])
    on_wall = on_walls(chamber, points)
    assert on_wall.tolist() == [[True, False], [True, True], [False, False], [False, True], [False, False]]
    moved = ChamberCopies.onto_walls(SimpleNamespace(_chamber=chamber, _on_wall=on_wall), points)
    expected = np.vstack([centre + exact, centre + along * 0.5, points[4]])
    expected[2] = points[2]
    np.testing.assert_allclose(moved, expected, atol=1e-15)
    np.testing.assert_allclose(points[0], centre + exact[0] + off[0], atol=1e-15)

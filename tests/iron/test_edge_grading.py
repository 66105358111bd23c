"""Edge grading keeps the body, conforms, and reaches the requested layer."""

from itertools import permutations

import numpy as np
import pytest

from fieldmap.device.model import Body, Box, Cylinder, Device, LinearMaterial, Part, Sphere, placed
from fieldmap.iron.mesh.edge_grading import _split_prism, _split_quadrilateral, grade_edges, sharp_edges
from fieldmap.iron.mesh.mesh import _first_layers, generate_mesh, volumes
from fieldmap.iron.topology import build_faces


def device(shape, size, edge=None):
    body = Body("block", "iron", (Part(shape),), size, edge)
    return Device("d", "", (), (body,), {"iron": LinearMaterial("iron", 100.0)})


@pytest.mark.parametrize("shape", [Box((0.02, 0.03, 0.01)), Cylinder(0.02, 0.006)])
@pytest.mark.parametrize("layer", [2e-3, 5e-4, 1e-4])
def test_volume_and_surface_are_unchanged(shape, layer):
    # Meshed whole: a mirror plane half way up the cylinder makes elements as thin as the thickest layer.
    plain, graded = (generate_mesh(device(shape, 0.008, edge), symmetry="none") for edge in (None, layer))
    assert len(graded.tets) > len(plain.tets)
    volume = volumes(graded.points, graded.tets)
    assert volume.min() > 0
    assert volume.sum() == pytest.approx(volumes(plain.points, plain.tets).sum(), rel=1e-12)
    assert surface_area(graded) == pytest.approx(surface_area(plain), rel=1e-12)


def surface_area(mesh):
    faces = build_faces(mesh.points, mesh.tets)
    a, b, c = (mesh.points[faces.nodes[faces.surface][:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


@pytest.mark.parametrize("layer", [1e-3, 2e-4])
def test_mesh_conforms_and_is_closed(layer):
    mesh = generate_mesh(device(Box((0.02, 0.03, 0.01)), 0.008, layer))
    faces = build_faces(mesh.points, mesh.tets)
    # A hanging node would leave unmatched faces inside, so that the surface is larger than the box's.
    assert surface_area(mesh) == pytest.approx(2 * (0.02 * 0.03 + 0.02 * 0.01 + 0.03 * 0.01), rel=1e-9)
    sides = np.sort(faces.nodes[faces.surface][:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=1)
    _, count = np.unique(sides, axis=0, return_counts=True)
    assert (count == 2).all()


@pytest.mark.parametrize("layer", [1e-3, 2e-4])
def test_first_layer_is_as_thin_as_asked(layer):
    mesh = generate_mesh(device(Box((0.02, 0.03, 0.01)), 0.008, layer))
    on_side = np.isclose(np.abs(mesh.points[:, :2]), [0.01, 0.015]).sum(axis=1)
    on_end = np.isclose(mesh.points[:, 2], 0) | np.isclose(mesh.points[:, 2], 0.01)
    on_edge = on_side + on_end >= 2
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    ends = np.unique(np.sort(mesh.tets[:, pairs].reshape(-1, 2), axis=1), axis=0)
    leaving = ends[on_edge[ends[:, 0]] ^ on_edge[ends[:, 1]]]
    start = np.where(on_edge[leaving[:, 0]], leaving[:, 0], leaving[:, 1])
    length = np.linalg.norm(np.diff(mesh.points[leaving], axis=1)[:, 0], axis=1)
    height = np.full(len(mesh.points), np.inf)
    np.minimum.at(height, start, length)
    assert np.median(height[on_edge]) < 1.6 * layer


def test_a_sphere_has_no_sharp_edges():
    plain, asked = generate_mesh(device(Sphere(0.02), 0.01)), generate_mesh(device(Sphere(0.02), 0.01, 1e-4))
    assert len(asked.tets) == len(plain.tets)


def test_one_tetrahedron_with_one_sharp_edge():
    """A single cut by hand: the element becomes two prisms, that is six tetrahedra."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0, 1]])
    tets = np.array([[0, 1, 2, 3]])
    new_points, new_tets, parent = grade_edges(points, tets, np.array([[0, 1]]), np.array([0.5]), 0.4)
    assert len(new_tets) == 6
    assert len(new_points) == 8
    assert (parent == 0).all()
    assert np.abs(volumes(new_points, new_tets)).sum() == pytest.approx(1 / 6)


def test_all_edges_of_a_single_tetrahedron_are_sharp():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    tets = np.array([[0, 1, 2, 3]])
    every = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
    ends = np.sort(every, axis=1)
    sharp = sharp_edges(points, tets, every, (ends, points[ends].mean(axis=1)))
    assert sharp.tolist() == every.tolist()
    new_points, new_tets, _ = grade_edges(points, tets, sharp, np.array([0.05]), 0.4)
    volume = np.abs(volumes(new_points, new_tets))
    assert volume.sum() == pytest.approx(1 / 6)
    assert volume.min() > 0


def test_layers_fall_with_the_square_of_the_refinement():
    """Two bodies, and one of them asks for no layer."""
    bodies = (
        Body("a", "iron", (Part(Sphere(0.01)),), 0.005, 9e-4),
        Body("b", "iron", (Part(Sphere(0.01)),), 0.005),
    )
    both = Device.unchecked(name="d", bodies=bodies, materials={"iron": LinearMaterial("iron", 100.0)})
    of_each = np.zeros((2, 3)), np.array([0, 1]), None
    assert _first_layers(both, 1.0, *of_each).tolist() == [9e-4, np.inf]
    assert _first_layers(both, 3.0, *of_each) == pytest.approx([1e-4, np.inf])


def test_outlines_of_bodies_enclose_their_volumes():
    """Faces between two bodies belong to both outlines, each with outward normals."""
    bodies = tuple(
        Body(name, "iron", (Part(Box((0.02, 0.03, height)), placed((0, 0, z))),), 0.01)
        for name, height, z in (("low", 0.01, 0.0), ("high", 0.02, 0.01))
    )
    mesh = generate_mesh(Device("d", "", (), bodies, {"iron": LinearMaterial("iron", 100.0)}))
    low, high = mesh.outlines()
    assert (low.name, high.name) == ("low", "high")
    for outline, height in ((low, 0.01), (high, 0.02)):
        a, b, c = np.moveaxis(outline.points[outline.triangles], 1, 0)
        assert np.einsum("kd,kd->", a, np.cross(b, c)) / 6 == pytest.approx(6e-4 * height, rel=1e-9)
        sides = outline.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        assert set(map(tuple, sides.tolist())) == set(map(tuple, sides[:, ::-1].tolist()))
        assert len(np.unique(outline.triangles)) == len(outline.points)


def test_a_prism_of_any_numbering_is_three_tetrahedra_that_cut_each_side_at_its_first_vertex():
    """All 720 of them: neighbours agree on the diagonal of a common side without being asked."""
    prisms = np.array(list(permutations(range(6))))
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
    tets = _split_prism(prisms).reshape(len(prisms), 3, 4)
    for prism, parts in zip(prisms, tets, strict=True):
        place = np.argsort(prism)
        x = corners[place[parts]]
        sizes = np.abs(np.linalg.det(x[:, 1:] - x[:, :1])) / 6
        np.testing.assert_allclose(sizes, 1 / 6, rtol=1e-12)
        for side in ([0, 1, 4, 3], [1, 2, 5, 4], [2, 0, 3, 5]):
            numbers = prism[side]
            k = int(numbers.argmin())
            cut, uncut = ({int(numbers[i]), int(numbers[i - 2])} for i in (k, k - 1))
            joined = [[pair <= set(map(int, part)) for part in parts] for pair in (cut, uncut)]
            assert [any(each) for each in joined] == [True, False]


def test_a_quadrilateral_is_cut_along_its_shorter_diagonal():
    points = np.array([[0.0, 0, 0], [3, 0, 0], [2, 1, 0], [0, 1, 0]])
    for corners, first, second in (
        ([0, 1, 2, 3], [0, 1, 2], [0, 2, 3]),
        ([1, 2, 3, 0], [1, 2, 0], [2, 3, 0]),
    ):
        assert _split_quadrilateral(points, np.array([corners])).tolist() == [first, second]

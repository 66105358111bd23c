"""Double layers on triangles against quadrature, and constants on closed surfaces."""

import numpy as np
import pytest

from fieldmap.iron.mesh.charged_faces import NEAR_RADII, ChargedFaces
from fieldmap.kernels.iron.containment import solid_angle_sums
from fieldmap.kernels.iron.double_layer import double_layer, linear_double_layer
from fieldmap.kernels.simplex_rules import triangle_rule

TETRAHEDRON = np.vstack([np.zeros(3), np.diag([1.0, 0.8, 1.3])])
SIDES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def by_quadrature(x, corners, normal, area):
    barycentric, weights = triangle_rule(24)
    step = x - barycentric @ corners
    kernel = (step @ normal) / np.linalg.norm(step, axis=1) ** 3
    return area * (weights * kernel) @ barycentric


def fill(faces, nodes, matrix):
    of_points = np.ascontiguousarray(np.repeat(faces.normals, 3, axis=0).T)
    geometry = faces.kernel_geometry(), nodes, faces.far_points(), of_points, NEAR_RADII
    double_layer(0, len(matrix), *geometry, matrix)


@pytest.mark.parametrize("x", [[0.2, 0.3, 0.7], [1.5, -0.4, -0.6], [0.3, 0.2, -4.0]])
def test_each_corner_against_quadrature(x):
    faces = ChargedFaces.from_nodes(TETRAHEDRON, SIDES[3:])
    corners, normal, area = faces.corners[0], faces.normals[0], faces.areas[0]
    ours = linear_double_layer(*x, corners, normal, area)
    assert ours == pytest.approx(by_quadrature(np.array(x), corners, normal, area), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("gap", [0.9, 2.5, 9.0])
def test_near_and_far_pairs_against_quadrature(gap):
    points = np.vstack([TETRAHEDRON[:3], TETRAHEDRON[:3] @ np.diag([0.7, 1.1, 1]) + [0.1, 0.2, gap]])
    points[4, 2] += 0.3
    nodes = np.array([[0, 2, 1], [3, 4, 5]])
    faces = ChargedFaces.from_nodes(points, nodes)
    matrix = np.zeros((2, 6))
    fill(faces, nodes, matrix)
    barycentric, weights = triangle_rule(16)
    for one, other in ((0, 1), (1, 0)):
        exact = sum(
            w * by_quadrature(p @ faces.corners[one], *(each[other] for each in geometry(faces)))
            for p, w in zip(barycentric, weights, strict=True)
        )
        assert matrix[one, nodes[other]] == pytest.approx(exact / (4 * np.pi), rel=5e-3)
        assert (matrix[one, nodes[one]] == 0).all()


def geometry(faces):
    return faces.corners, faces.normals, faces.areas


def test_constants_on_a_closed_surface():
    faces = ChargedFaces.from_nodes(TETRAHEDRON, SIDES)
    matrix = np.zeros((4, 4))
    fill(faces, SIDES, matrix)
    assert matrix.sum(axis=1) == pytest.approx(np.full(4, -0.5), abs=1e-12)


def test_solid_angles_tell_inside_from_outside():
    faces = ChargedFaces.from_nodes(TETRAHEDRON, SIDES)
    points = np.array(
        [[0.1, 0.1, 0.1], [0.3, 0.2, 0.2], [1.0, 1.0, 1.0], [0.2, 0.2, -0.05], [9.0, -20.0, 5.0]]
    )
    found = np.empty(len(points))
    solid_angle_sums(0, len(points), points, *geometry(faces), faces.centres, faces.radii, found)
    assert found == pytest.approx([-1, -1, 0, 0, 0], abs=1e-2)

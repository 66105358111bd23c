"""Derivatives by the corners of charged triangles, against central differences."""

import numpy as np
import pytest
from numba.core import config
from scipy.spatial import ConvexHull

from fieldmap.iron.mesh.chamber import MeshSymmetry
from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.iron.sensitivity.by_nodes import mutual_gradient
from fieldmap.iron.symmetry import Operation, SymmetryGroup
from fieldmap.kernels.iron.mutual_gradient import close_gradient

STEP = 1e-6
# Nodes on a ball. Without compilation the pairs of many triangles take seconds.
NODES, NODES_OF_SIX = (5, 5) if config.DISABLE_JIT else (40, 20)
BETWEEN_RULES = 1e-5 if config.DISABLE_JIT else 1e-6


@pytest.fixture(scope="module")
def balls():
    """Nodes (p, 3) and triangles (n, 3) of two balls, with close and far pairs."""
    points = np.random.default_rng(0).normal(size=(NODES, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    triangles = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    inward = np.einsum("nd,nd->n", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    other = 0.3 * points + [5.0, 0.0, 0.0]
    return np.concatenate([points, other]), np.concatenate([triangles, triangles + NODES])


def sides(balls, velocity):
    points, triangles = balls
    return [ChargedFaces.from_nodes(points + side * STEP * velocity, triangles) for side in (1, -1)]


@pytest.mark.parametrize("moving", ["all", "one ball"])
def test_mutual_potentials(balls, moving):
    points, triangles = balls
    random = np.random.default_rng(1)
    charge, others = random.normal(size=len(triangles)), random.normal(size=(2, len(triangles)))
    velocity = random.normal(size=points.shape)
    if moving == "one ball":
        velocity[NODES:] = 0.0
    chosen = (velocity[triangles] != 0).any(axis=(1, 2))
    faces = ChargedFaces.from_nodes(points, triangles)
    by_nodes = mutual_gradient(faces, triangles, len(points), charge, others, chosen)
    ahead, behind = (others @ (side.mutual_potential() @ charge) for side in sides(balls, velocity))
    expected = (ahead - behind) / (2 * STEP)
    np.testing.assert_allclose(np.einsum("knd,nd->k", by_nodes, velocity), expected, rtol=3e-6)


@pytest.fixture(scope="module")
def star():
    """Three balls and their mirror images about an axis: points (p, 3), triangles (n, 3) and the symmetry."""
    cosine, sine = -0.5, np.sqrt(0.75)
    turn, mirror = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]]), np.diag([1.0, -1.0, 1.0])
    matrices = [np.linalg.matrix_power(turn, k) @ side for side in (np.eye(3), mirror) for k in range(3)]
    random = np.random.default_rng(3).normal(size=(NODES_OF_SIX, 3))
    ball = random / np.linalg.norm(random, axis=1)[:, None]
    triangles = ConvexHull(ball).simplices.astype(np.int64)
    ball = 0.5 * ball + [2.0, 0.8, 0.3]
    points = np.concatenate([ball @ matrix.T for matrix in matrices])
    # Index of the product of two operations.
    number = lambda m: int(np.argmin([np.abs(m - other).max() for other in matrices]))  # noqa: E731
    table = [[number(a @ b) for b in matrices] for a in matrices]
    places = np.array([[NODES_OF_SIX * b + p for b in row for p in range(NODES_OF_SIX)] for row in table])
    operations = tuple(Operation(m, np.zeros(3), (), None, (), True) for m in matrices)
    # In column order, like the nodes of meshes.
    symmetry = MeshSymmetry(SymmetryGroup(operations, np.zeros(3), 1e-9), np.asfortranarray(places))
    return points, np.concatenate([triangles + NODES_OF_SIX * k for k in range(6)]), symmetry


@pytest.mark.parametrize("moving", ["all", "one ball"])
def test_one_chamber_stands_for_all(star, moving):
    """For charges and movements that do not have the symmetry."""
    points, triangles, symmetry = star
    random = np.random.default_rng(4)
    charge, others = random.normal(size=len(triangles)), random.normal(size=(2, len(triangles)))
    velocity = random.normal(size=points.shape)
    if moving == "one ball":
        velocity[NODES_OF_SIX : 4 * NODES_OF_SIX] = velocity[5 * NODES_OF_SIX :] = 0.0
    chosen = (velocity[triangles] != 0).any(axis=(1, 2))
    faces = ChargedFaces.from_nodes(points, triangles)
    found, whole = (
        np.einsum(
            "knd,nd->k",
            mutual_gradient(faces, triangles, len(points), charge, others, chosen, used),
            velocity,
        )
        for used in (symmetry, None)
    )
    # For two faces of equal size rounding decides which one gets the outer rule.
    np.testing.assert_allclose(found, whole, rtol=BETWEEN_RULES)
    ahead, behind = (
        others @ (side.mutual_potential() @ charge) for side in sides((points, triangles), velocity)
    )
    np.testing.assert_allclose(found, (ahead - behind) / (2 * STEP), rtol=3 * BETWEEN_RULES)
    # One compiled kernel serves with and without symmetry.
    assert config.DISABLE_JIT or len(close_gradient.signatures) == 1


def test_potentials_within_one_ball_do_not_follow_its_movement(balls):
    """The self-potentials of triangles and touching pairs, whose fields jump."""
    points, triangles = balls
    ball = triangles[triangles.max(axis=1) < NODES]
    faces, ones = ChargedFaces.from_nodes(points[:NODES], ball), np.ones(len(ball))
    by_nodes = mutual_gradient(faces, ball, NODES, ones, ones[None], ones > 0)[0]
    size = np.abs(by_nodes).sum()
    assert np.abs(by_nodes.sum(axis=0)).max() < 1e-13 * size
    # Potentials fall when the ball is scaled up.
    potential = ones @ faces.mutual_potential() @ ones
    assert np.sum(by_nodes * points[:NODES]) == pytest.approx(-potential, rel=1e-10)


def test_sums_of_field_and_gradient_at_points(balls):
    points, triangles = balls
    random = np.random.default_rng(2)
    at = np.concatenate([1.3 * points[:3], [[9.0, 3.0, 2.0]]])
    by_field, by_gradient = random.normal(size=(2, len(at), 3)), random.normal(size=(2, len(at), 3, 3))
    charge, velocity = random.normal(size=len(triangles)), random.normal(size=points.shape)
    faces, every = ChargedFaces.from_nodes(points, triangles), np.ones(len(triangles), bool)
    by_corners = faces.gradient(at, by_field, by_gradient, charge, every)
    ahead, behind = (
        side.weights(at, by_field, by_gradient) @ (charge / side.areas) for side in sides(balls, velocity)
    )
    found = np.einsum("nkcd,ncd->k", by_corners, velocity[triangles])
    np.testing.assert_allclose(found, (ahead - behind) / (2 * STEP), rtol=1e-6)

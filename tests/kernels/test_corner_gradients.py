"""Derivatives by the corners of charged triangles: against central differences of what they are derivatives of."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fieldmap.iron.operators.surface import ChargedFaces

STEP = 1e-6


@pytest.fixture(scope="module")
def balls():
    """Nodes (p, 3) and triangles (n, 3) of two balls, close and far pairs among them."""
    points = np.random.default_rng(0).normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    triangles = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    inward = np.einsum("nd,nd->n", np.cross(b - a, c - a), a) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    other = 0.3 * points + [5.0, 0.0, 0.0]
    return np.concatenate([points, other]), np.concatenate([triangles, triangles + 40])


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
        velocity[40:] = 0.0
    chosen = (velocity[triangles] != 0).any(axis=(1, 2))
    faces = ChargedFaces.from_nodes(points, triangles)
    by_nodes = faces.mutual_gradient(triangles, len(points), charge, others, chosen)
    ahead, behind = (others @ (side.mutual_potential() @ charge) for side in sides(balls, velocity))
    expected = (ahead - behind) / (2 * STEP)
    np.testing.assert_allclose(np.einsum("knd,nd->k", by_nodes, velocity), expected, rtol=3e-6)


def test_potentials_within_one_ball_do_not_follow_its_movement(balls):
    """The triangles' own pairs and those that touch, whose fields jump."""
    points, triangles = balls
    ball = triangles[triangles.max(axis=1) < 40]
    faces, ones = ChargedFaces.from_nodes(points[:40], ball), np.ones(len(ball))
    by_nodes = faces.mutual_gradient(ball, 40, ones, ones[None], ones > 0)[0]
    size = np.abs(by_nodes).sum()
    assert np.abs(by_nodes.sum(axis=0)).max() < 1e-13 * size
    # Scaled up, potentials fall.
    potential = ones @ faces.mutual_potential() @ ones
    assert np.sum(by_nodes * points[:40]) == pytest.approx(-potential, rel=1e-10)


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

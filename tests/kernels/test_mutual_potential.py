"""The dense matrix against closed forms and direct quadrature."""

import numpy as np
import pytest

from fieldmap.iron.mesh.charged_faces import ChargedFaces
from fieldmap.kernels.simplex_rules import triangle_rule


def faces_of(points, nodes):
    return ChargedFaces.from_nodes(np.asarray(points, float), np.asarray(nodes))


def square(n):
    """Unit square of 2 n^2 triangles."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    nodes = []
    for i in range(n):
        for j in range(n):
            a = i * (n + 1) + j
            b = a + n + 1
            nodes += [[a, b, a + 1], [b, b + 1, a + 1]]
    return points, np.array(nodes)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_self_potential_of_a_unit_square(n):
    # int int dS dS'/R = 4 ln(1 + sqrt 2) - (4/3)(sqrt 2 - 1), e.g. Durand, Electrostatique I (1964).
    exact = 4 * np.log(1 + np.sqrt(2)) - 4 / 3 * (np.sqrt(2) - 1)
    faces = faces_of(*square(n))
    total = faces.areas @ faces.mutual_potential() @ faces.areas * 4 * np.pi
    # The outer integral is a 25-point rule over an integrand with a kink at the border.
    assert total == pytest.approx(exact, rel=4e-4)


def test_symmetric_and_positive_definite():
    matrix = faces_of(*square(3)).mutual_potential()
    assert (matrix == matrix.T).all()
    assert np.linalg.eigvalsh(matrix).min() > 0


@pytest.mark.parametrize("gap", [1.1, 3.0, 12.0])
def test_pairs_at_any_distance_against_quadrature(gap):
    """Near (closed form) and far (point charges) branches agree with a fine product rule."""
    one = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0.3, 0]])
    two = np.array([[0.1, 0, 0], [0.9, 0.2, 0.1], [0.2, 0.8, 0.4]]) + [0, 0, gap]
    matrix = faces_of(np.vstack([one, two]), [[0, 1, 2], [3, 4, 5]]).mutual_potential()
    barycentric, weights = triangle_rule(20)
    distance = np.linalg.norm((barycentric @ one)[:, None] - (barycentric @ two)[None], axis=2)
    exact = weights @ (1 / distance) @ weights / (4 * np.pi)
    assert matrix[0, 1] == pytest.approx(exact, rel=2e-4)


def test_scales_with_inverse_length():
    points, nodes = square(2)
    small, large = faces_of(points, nodes), faces_of(10 * points, nodes)
    assert large.mutual_potential() * 10 == pytest.approx(small.mutual_potential(), rel=1e-3)


@pytest.mark.parametrize("size", [1e-6, 1.0])
def test_far_pairs_are_the_sum_over_their_points_to_thirteen_digits(size):
    """Sums over three points per triangle, with inverse distances from single precision and a correction."""
    rng = np.random.default_rng(5)
    centres = size * 40 * rng.permutation(40)[:, None] * [1.0, 0.3, 0.2]
    points = (centres[:, None] + size * rng.random((40, 3, 3))).reshape(-1, 3)
    faces = faces_of(points, np.arange(120).reshape(40, 3))
    at = faces.rule_points(2)[0]
    off = ~np.eye(40, dtype=bool)
    distance = np.linalg.norm(at[:, None, :, None] - at[None, :, None, :], axis=-1)[off]
    exact = (1 / distance).mean(axis=(1, 2)) / (4 * np.pi)
    np.testing.assert_allclose(faces.mutual_potential()[off], exact, rtol=2e-13)

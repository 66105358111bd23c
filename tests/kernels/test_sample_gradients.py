"""Gradients of quadratic elements at the points where the law is evaluated."""

import numpy as np

from fieldmap.kernels.iron.quadratic_potential import sample_gradients


def test_gradients_of_a_quadratic_function_are_exact():
    corners = np.array([[0.0, 0, 0], [1, 0.1, 0], [0.2, 1, 0], [0.1, 0.3, 1]])
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    points = np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in pairs]])
    matrix = np.array([[1.0, 0.5, -1], [0.5, 2, 0.3], [-1, 0.3, -3]])
    linear = np.array([0.4, -0.2, 0.7])
    values = np.einsum("ni,ij,nj->n", points, matrix, points) + points @ linear
    inverse = np.linalg.inv(corners[1:] - corners[0]).T
    barycentric = np.ascontiguousarray(np.concatenate([-inverse.sum(axis=0, keepdims=True), inverse]))
    near = (5.0 - np.sqrt(5.0)) / 20.0
    where = near * corners.sum(axis=0) + (1.0 - 4.0 * near) * corners
    got, both = np.empty((1, 4, 3, 2)), np.stack([values, 2 * values], axis=1)
    sample_gradients(0, 1, both, np.arange(10)[None], barycentric[None], got)
    expected = 2 * where @ matrix + linear
    np.testing.assert_allclose(got[0, :, :, 0], expected, atol=1e-13)
    np.testing.assert_allclose(got[0, :, :, 1], 2 * expected, atol=1e-13)

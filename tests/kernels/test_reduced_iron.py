"""The reduced Newton iteration against equations written out in numpy with another representation of the law."""

import numpy as np
import pytest

from fieldmap.kernels.reduced_iron import newton
from fieldmap.kernels.sample_gradients import sample_gradients

POINTS, MODES = 30, 4
# b = 2000 h up to 1 mT, then slope 1: as one table.
OFFSET = np.array([0, 2])
KNOTS = np.array([0.0, 1e-3])
COEFFICIENTS = np.array([[0.0, 0.0, 2000.0, 0.0], [0.0, 0.0, 1.0, 2.0]])


def law(h):
    return np.where(h < 1e-3, 2000.0 * h, 2.0 + (h - 1e-3))


@pytest.fixture
def problem():
    random = np.random.default_rng(4)
    gradients = random.standard_normal((3 * POINTS, MODES))
    square = random.standard_normal((MODES, MODES))
    return {
        "source": random.standard_normal(3 * POINTS),
        "gradients": gradients,
        "weights": random.random(POINTS) + 0.1,
        "air": square @ square.T + np.eye(MODES),
        "constant": random.standard_normal(MODES),
    }


def residual(problem, amplitude, scale):
    h = (scale * problem["source"] - problem["gradients"] @ amplitude).reshape(POINTS, 3)
    size = np.linalg.norm(h, axis=1)
    magnetisation = (problem["weights"] * (law(size) / size - 1))[:, None] * h
    inner = magnetisation.ravel() @ problem["gradients"]
    return inner + problem["constant"] - problem["air"] @ amplitude


def solved(problem, scale, start=None, limit=80):
    arguments = (problem["gradients"], problem["weights"], np.zeros(POINTS, np.int64))
    laws = (OFFSET, KNOTS, COEFFICIENTS)
    begin = np.zeros(MODES) if start is None else start
    air = (problem["air"], problem["constant"])
    return newton(scale * problem["source"], *arguments, *laws, *air, begin, 1e-9, limit)


@pytest.mark.parametrize("scale", [0.0, 1e-4, 1e-2, 1.0, 100.0])
def test_the_residual_vanishes_from_linear_iron_to_deep_saturation(problem, scale):
    amplitude, _, decrement = solved(problem, scale)
    assert decrement < 1e-9
    size = np.abs(problem["gradients"]).sum() * 2.0 + np.abs(problem["constant"]).max()
    assert np.abs(residual(problem, amplitude, scale)).max() < 1e-9 * size


def test_the_solution_does_not_depend_on_the_start(problem):
    first = solved(problem, 0.3)[0]
    far = solved(problem, 0.3, start=50.0 * np.arange(1.0, MODES + 1))[0]
    np.testing.assert_allclose(far, first, rtol=1e-9, atol=1e-9 * np.abs(first).max())


def test_too_few_steps_are_told(problem):
    assert solved(problem, 1.0, limit=1)[2] > 1e-9


def test_gradients_of_a_quadratic_function_are_exact():
    corners = np.array([[0.0, 0, 0], [1, 0.1, 0], [0.2, 1, 0], [0.1, 0.3, 1]])
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    points = np.concatenate([corners, [(corners[a] + corners[b]) / 2 for a, b in pairs]])
    matrix = np.array([[1.0, 0.5, -1], [0.5, 2, 0.3], [-1, 0.3, -3]])
    linear = np.array([0.4, -0.2, 0.7])
    values = np.einsum("ni,ij,nj->n", points, matrix, points) + points @ linear
    inverse = np.linalg.inv(corners[1:] - corners[0]).T
    barycentric = np.concatenate([-inverse.sum(axis=0, keepdims=True), inverse])
    near = (5.0 - np.sqrt(5.0)) / 20.0
    where = near * corners.sum(axis=0) + (1.0 - 4.0 * near) * corners
    got = sample_gradients(np.stack([values, 2 * values], axis=1), np.arange(10)[None], barycentric[None])
    expected = 2 * where @ matrix + linear
    np.testing.assert_allclose(got[0, :, :, 0], expected, atol=1e-13)
    np.testing.assert_allclose(got[0, :, :, 1], 2 * expected, atol=1e-13)

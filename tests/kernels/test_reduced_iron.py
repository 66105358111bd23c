"""The reduced Newton iteration against equations written out in numpy with another representation of the law."""

import numpy as np
import pytest

from fieldmap.kernels.iron.reduced_iron import newton, sensitivities
from fieldmap.kernels.iron.sample_gradients import sample_gradients

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


def solved(problem, scale, start=None, limit=80, factor=None):
    begin = np.zeros(MODES) if start is None else start
    tangent = np.zeros((MODES, MODES)) if factor is None else factor
    return newton(scale * problem["source"], *iron(problem), begin, tangent, 1e-9, limit)


def iron(problem):
    gradients = problem["gradients"]
    laws = (problem["weights"], np.zeros(POINTS, np.int64), OFFSET, KNOTS, COEFFICIENTS)
    return gradients, gradients.astype(np.float32), *laws, problem["air"], problem["constant"]


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


def test_a_tangent_from_elsewhere_changes_the_way_and_not_the_result(problem):
    far = np.zeros((MODES, MODES))
    solved(problem, 1e-4, factor=far)
    assert far[0, 0] > 0
    # Linear iron is a thousand times stiffer than saturated: steps with its tangent are small, and prove nothing.
    start = solved(problem, 0.29)[0]
    truth = solved(problem, 0.3)[0]
    np.testing.assert_allclose(solved(problem, 0.3, start=start, factor=far)[0], truth, rtol=1e-8)
    steps_anew = solved(problem, 0.3, start=start)[1]
    near = np.zeros((MODES, MODES))
    solved(problem, 0.29, factor=near)
    found, steps, _ = solved(problem, 0.3, start=start, factor=near)
    np.testing.assert_allclose(found, truth, rtol=1e-8)
    assert steps <= steps_anew + 3


def test_sensitivities_are_the_derivatives_of_the_solution(problem):
    unit = np.stack([problem["source"], np.random.default_rng(8).standard_normal(3 * POINTS)], axis=1)

    def amplitude(currents):
        return solved(problem | {"source": unit @ currents}, 1.0)[0]

    where = np.array([[0.3, 0.1], [2e-4, 1e-4]])
    known = np.array([amplitude(currents) for currents in where])
    found, _ = sensitivities(unit @ where.T, *iron(problem)[:-1], known, unit)
    for state, currents in enumerate(where):
        for coil in range(2):
            step = 1e-4 * np.eye(2)[coil] * np.abs(currents).max()
            slope = (amplitude(currents + step) - amplitude(currents - step)) / (2 * step[coil])
            np.testing.assert_allclose(
                found[state, :, coil], slope, rtol=1e-3, atol=1e-3 * np.abs(slope).max()
            )


def test_without_currents_the_iron_is_left_without_field(problem):
    """However far the start: the solution is zero, and nothing is small beside it."""
    start, factor = solved(problem | {"constant": np.zeros(MODES)}, 0.3)[0], np.zeros((MODES, MODES))
    solved(problem, 0.3, factor=factor)
    found, _, decrement = solved(problem | {"constant": np.zeros(MODES)}, 0.0, start=start, factor=factor)
    assert decrement < 1e-9
    assert np.abs(found).max() < 1e-10 * np.abs(start).max()


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
    barycentric = np.ascontiguousarray(np.concatenate([-inverse.sum(axis=0, keepdims=True), inverse]))
    near = (5.0 - np.sqrt(5.0)) / 20.0
    where = near * corners.sum(axis=0) + (1.0 - 4.0 * near) * corners
    got, both = np.empty((1, 4, 3, 2)), np.stack([values, 2 * values], axis=1)
    sample_gradients(0, 1, both, np.arange(10)[None], barycentric[None], got)
    expected = 2 * where @ matrix + linear
    np.testing.assert_allclose(got[0, :, :, 0], expected, atol=1e-13)
    np.testing.assert_allclose(got[0, :, :, 1], 2 * expected, atol=1e-13)

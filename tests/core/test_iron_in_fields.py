"""Solves of a model without coils, in fields at its points, against the equation in numpy with its own law."""

import numpy as np
import pytest

from fieldmap.core.iron import FOUND, MOST_STEPS, NOT_CONVERGED, NOT_FINITE, CoreIron
from fieldmap.core.iron_numbers import numbers_without_fields

POINTS, MODES = 30, 4
# b = 2000 h up to 1 mT, then slope 1.
TABLES = np.array([0, 2]), np.array([0.0, 1e-3]), np.array([[0.0, 0.0, 2000.0, 0.0], [0.0, 0.0, 1.0, 2.0]])


def law(h):
    return np.where(h < 1e-3, 2000.0 * h, 2.0 + (h - 1e-3))


class Problem:
    """Random iron in a random field; gradients are rounded to single precision."""

    def __init__(self, points=POINTS, of_constant=1.0):
        random = np.random.default_rng(4)
        self.source = random.standard_normal(3 * points)
        self.gradients = random.standard_normal((3 * points, MODES)).astype(np.float32).astype(float)
        square = random.standard_normal((MODES, MODES))
        self.weights = random.random(points) + 0.1
        self.air = square @ square.T + np.eye(MODES)
        self.constant = of_constant * random.standard_normal(MODES)
        laws = self.weights, np.zeros(points, np.int64), TABLES
        nothing = np.zeros(0)
        iron = self.gradients, *laws, self.air, self.constant
        numbers = numbers_without_fields(
            np.zeros((len(self.gradients), 0)), nothing, *iron, np.zeros((0, 0)), nothing
        )
        self.core = CoreIron(numbers)

    def magnetised(self, amplitudes, scale):
        """Field (p, 3), its size, and b / h - 1."""
        h = (scale * self.source - self.gradients @ amplitudes).reshape(-1, 3)
        size = np.linalg.norm(h, axis=1)
        return h, size, law(size) / size - 1.0

    def residual(self, amplitudes, scale):
        h, _, m = self.magnetised(amplitudes, scale)
        inner = ((self.weights * m)[:, None] * h).ravel() @ self.gradients
        return inner + self.constant - self.air @ amplitudes

    def left(self, amplitudes, scale):
        """Relative error of the amplitudes in the energy norm."""
        h, size, m = self.magnetised(amplitudes, scale)
        slope = np.where(size < 1e-3, 2000.0, 1.0)
        radial = np.einsum("pi,pir->pr", h, self.gradients.reshape(-1, 3, MODES)) / size[:, None]
        tangent = self.air + (radial.T * (self.weights * (slope - 1.0 - m))) @ radial
        tangent += (self.gradients.T * np.repeat(self.weights * m, 3)) @ self.gradients
        rest = self.residual(amplitudes, scale)
        return np.sqrt(rest @ np.linalg.solve(tangent, rest) / (amplitudes @ tangent @ amplitudes))

    def solved(self, scale, start=None, tolerance=1e-9):
        """Amplitudes, status and number of steps."""
        found, state = np.zeros(MODES) if start is None else np.array(start), self.core.state()
        status = state.solve_in(scale * self.source, found, tolerance=tolerance)
        return found, status, state.steps


@pytest.fixture
def problem(library):
    return Problem()


@pytest.mark.parametrize("scale", [1e-4, 1e-2, 1.0, 100.0])
def test_the_equation_holds_from_linear_iron_to_deep_saturation(problem, scale):
    found, status, _ = problem.solved(scale)
    assert status == FOUND
    size = np.abs(problem.gradients).sum() * 2.0 + np.abs(problem.constant).max()
    assert np.abs(problem.residual(found, scale)).max() < 1e-9 * size
    assert problem.left(found, scale) < 1e-9


def test_the_solution_does_not_depend_on_the_start(problem):
    first, far = problem.solved(0.3)[0], problem.solved(0.3, 50.0 * np.arange(1.0, MODES + 1))[0]
    np.testing.assert_allclose(far, first, rtol=1e-9, atol=1e-9 * np.abs(first).max())


def test_a_state_that_solved_elsewhere_finds_the_same(problem):
    state, found = problem.core.state(), np.zeros(MODES)
    for scale in (1e-4, 100.0, 0.3):
        assert state.solve_in(scale * problem.source, found, tolerance=1e-9) == FOUND
    np.testing.assert_allclose(found, problem.solved(0.3)[0], rtol=1e-8)


def test_without_a_field_the_iron_is_left_without_one(problem):
    """The solution is zero from any start, and no other size is left to compare with."""
    free = Problem(of_constant=0.0)
    start = free.solved(0.3)[0]
    found, status, _ = free.solved(0.0, start)
    assert status == FOUND
    assert np.abs(found).max() < 1e-10 * np.abs(start).max()


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
def test_the_tolerance_is_reached_however_many_points_there_are(tolerance):
    many = Problem(points=60_000)
    found, status, _ = many.solved(0.3, 5.0 * np.arange(1.0, MODES + 1), tolerance)
    assert status == FOUND
    assert many.left(found, 0.3) < tolerance


def test_a_solve_that_does_not_end_gives_the_amplitudes_after_its_last_step(problem):
    found, status, steps = problem.solved(0.3, tolerance=0.0)
    assert (status, steps) == (NOT_CONVERGED, MOST_STEPS)
    # Steps in single precision are not corrected before they are near the tolerance.
    assert problem.left(found, 0.3) < 1e-6


def test_no_number_gives_none(problem):
    good = problem.source.copy()
    for applied, start in ((np.where(np.arange(good.size) == 7, np.nan, good), 0.0), (good, np.inf)):
        state, found = problem.core.state(), np.full(MODES, start)
        assert state.solve_in(applied, found, tolerance=1e-9) == NOT_FINITE
        assert np.isnan(found).all()
        assert state.steps == 0
        # The state is as usable as before.
        assert state.solve_in(good, np.zeros(MODES), tolerance=1e-9) == FOUND


def test_arrays_that_do_not_fit_are_refused(problem):
    state, found = problem.core.state(), np.zeros(MODES)
    for applied, amplitudes in (
        (problem.source[:-1], found),
        (problem.source.astype(np.float32), found),
        (problem.source, found[:-1]),
        (problem.source, found.tolist()),
    ):
        with pytest.raises(TypeError):
            state.solve_in(applied, amplitudes, tolerance=1e-9)

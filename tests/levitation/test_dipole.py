import numpy as np
import pytest

from fieldmap.levitation.balance import aligned_turning, dipole_force, dipole_stiffness

MOMENT = np.array([0.1, -0.3, 0.8])
POINT = np.array([[0.004, -0.003, 0.021]])
COEFFICIENTS = (0.02, 0.3, -1.5, 9.0)
CURRENT = np.array([1.7])


def test_force_is_the_gradient_of_the_energy_of_a_fixed_dipole(axisymmetric):
    source = axisymmetric(COEFFICIENTS)
    h = 1e-5
    ahead = source.field(POINT + h * np.eye(3), CURRENT) @ MOMENT
    behind = source.field(POINT - h * np.eye(3), CURRENT) @ MOMENT
    force = dipole_force(MOMENT, source.gradient(POINT, CURRENT)[0])
    np.testing.assert_allclose(force, (ahead - behind) / (2 * h), rtol=1e-8)


def test_fixed_stiffness_taylor(axisymmetric):
    """Halving the step must quarter the error of F(x) - K dx."""
    source = axisymmetric(COEFFICIENTS)
    stiffness = dipole_stiffness(MOMENT, source.second_gradient(POINT, CURRENT)[0])
    step = np.array([1e-3, -2e-3, 1.5e-3])

    def error(scale):
        there, here = (
            dipole_force(MOMENT, source.gradient(at, CURRENT)[0]) for at in (POINT + scale * step, POINT)
        )
        return np.linalg.norm(there - here + stiffness @ step * scale)

    assert error(0.5) / error(1.0) == pytest.approx(0.25, rel=0.05)


def aligned_stiffness(magnitude, b, g, h):
    moment = magnitude * b / np.linalg.norm(b)
    return dipole_stiffness(moment, h) - g.T @ aligned_turning(moment, b, g)


def test_aligned_stiffness_taylor(axisymmetric):
    """Against grad |B| by differences of |B| alone."""
    source, magnitude = axisymmetric(COEFFICIENTS), 0.8
    stiffness = aligned_stiffness(
        magnitude, *(f(POINT, CURRENT)[0] for f in (source.field, source.gradient, source.second_gradient))
    )

    def energy(x):
        return -magnitude * np.linalg.norm(source.field(x[None, :], CURRENT)[0])

    h = 2e-4
    signs = [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]
    numeric = [
        [
            sum(sign * energy(POINT[0] + i * a + j * b) for i, j, sign in signs) / (4 * h * h)
            for b in h * np.eye(3)
        ]
        for a in h * np.eye(3)
    ]
    np.testing.assert_allclose(stiffness, numeric, rtol=1e-4, atol=1e-5 * np.max(np.abs(numeric)))


def test_earnshaw(axisymmetric):
    """A fixed dipole has trace 0; one that follows the field never has a positive trace."""
    source = axisymmetric(COEFFICIENTS)
    rng = np.random.default_rng(3)
    for point in rng.uniform(-0.02, 0.02, (20, 3)):
        b, g, h = (
            f(point[None, :], CURRENT)[0] for f in (source.field, source.gradient, source.second_gradient)
        )
        fixed = dipole_stiffness(MOMENT, h)
        assert abs(np.trace(fixed)) < 1e-12 * np.linalg.norm(fixed)
        aligned = aligned_stiffness(0.8, b, g, h)
        assert np.trace(aligned) < -1e-6 * np.linalg.norm(aligned)

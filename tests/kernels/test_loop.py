import numpy as np
import pytest

from fieldmap.constants import MU0
from fieldmap.kernels.coils.loop import loop_flux_density, loop_flux_density_and_gradient

RADIUS = 0.02


def quadrature(points, radius, steps=4000):
    """Biot-Savart's law by equal steps (the trapezoidal rule, exact to rounding for a periodic integrand)."""
    angle = 2 * np.pi * np.arange(steps) / steps
    wire = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    element = 2 * np.pi * radius / steps * np.stack([-np.sin(angle), np.cos(angle), 0 * angle], -1)
    r = points[:, None, :] - wire
    kernel = np.cross(np.broadcast_to(element, r.shape), r) / np.linalg.norm(r, axis=2)[..., None] ** 3
    return MU0 / (4 * np.pi) * kernel.sum(axis=1)


def test_on_the_axis_closed_form():
    z = np.linspace(-0.3, 0.3, 9)
    points = np.column_stack([0 * z, 0 * z, z])
    field, gradient = loop_flux_density_and_gradient(points, RADIUS)
    r2 = RADIUS**2 + z**2
    np.testing.assert_allclose(field[:, 2], MU0 * RADIUS**2 / (2 * r2**1.5), rtol=2e-15)
    np.testing.assert_allclose(gradient[:, 2, 2], -1.5 * MU0 * RADIUS**2 * z / r2**2.5, rtol=4e-15)
    np.testing.assert_allclose(gradient[:, 0, 0], -gradient[:, 2, 2] / 2, rtol=4e-15)
    np.testing.assert_array_equal(field[:, :2], 0)


def test_equals_quadrature_near_the_axis_near_the_wire_and_far_away():
    points = np.array(
        [
            [1e-9, 0, 0.01],
            [1e-4, 2e-4, -0.03],
            [0.019, 0, 0.0],
            [0, -0.0212, 0.0005],
            [0.05, 0.04, 0.03],
            [0.5, 0.5, -2],
        ]
    )
    np.testing.assert_allclose(
        loop_flux_density(points, RADIUS), quadrature(points, RADIUS), rtol=2e-12, atol=1e-19
    )


def test_near_the_axis_no_digit_is_lost():
    """B_rho = -(rho/2) dBz/dz + O(rho^3), so B_rho / rho must be relatively accurate down to its limit."""
    z = 0.013
    rho = 10.0 ** -np.arange(5, 13)
    points = np.column_stack([rho, 0 * rho, 0 * rho + z])
    field, gradient = loop_flux_density_and_gradient(points, RADIUS)
    limit = 0.75 * MU0 * RADIUS**2 * z / (RADIUS**2 + z**2) ** 2.5
    np.testing.assert_allclose(field[:, 0] / rho, limit, rtol=1e-6)
    np.testing.assert_allclose((field[:, 0] / rho)[4:], limit, rtol=1e-13)
    slope = gradient[:, 2, 0] / rho
    np.testing.assert_allclose(slope[4:], slope[-1], rtol=1e-13)


def test_far_away_the_dipole_is_approached_with_slope_two():
    direction = np.array([0.48, -0.36, 0.8])
    moment = np.pi * RADIUS**2
    distances = 10.0 ** np.arange(0, 5)
    points = distances[:, None] * direction
    dipole = MU0 / (4 * np.pi) * moment * (3 * direction[2] * direction - [0, 0, 1]) / distances[:, None] ** 3
    error = np.linalg.norm(loop_flux_density(points, RADIUS) - dipole, axis=1) / np.linalg.norm(
        dipole, axis=1
    )
    np.testing.assert_allclose(np.log10(error[:3] / error[1:4]), 2, atol=0.01)
    assert error[4] < 1e-11


@pytest.mark.parametrize("count", [0, 1, 63, 64, 65, 130])
def test_every_point_of_every_block_is_written(count):
    points = np.random.default_rng(1).normal(size=(count, 3)) * 0.05
    field, gradient = loop_flux_density_and_gradient(points, RADIUS)
    for i in range(0, count, 16):
        one = loop_flux_density_and_gradient(points[i : i + 1], RADIUS)
        np.testing.assert_allclose(field[i], one[0][0], rtol=1e-14)
        np.testing.assert_allclose(gradient[i], one[1][0], rtol=1e-14, atol=1e-20)
    assert field.shape == (count, 3)

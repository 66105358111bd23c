"""Coils against quadrature of Biot-Savart's law and against magpylib."""

import numpy as np
import pytest

from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.magpylib_objects import magpylib_coil


def relative(a, b):
    return np.linalg.norm(a - b, axis=1) / np.linalg.norm(b, axis=1)


def test_field_equals_quadrature_of_eq_2_6(simple_coil, near_and_far, biot_savart):
    points = near_and_far(simple_coil)
    assert relative(unit_flux_density(simple_coil, points), biot_savart(simple_coil, points)).max() < 1e-9


def test_quadrature_itself_has_converged(simple_coil, near_and_far, biot_savart):
    points = near_and_far(simple_coil)[:3]
    coarse, fine = biot_savart(simple_coil, points, 10), biot_savart(simple_coil, points, 14)
    assert relative(coarse, fine).max() < 1e-10


def test_every_coil_equals_its_magpylib_twin(coil):
    """To 1e-9 at most points; magpylib's CylinderSegment is off by up to 1e-7 at single points (see the next test)."""
    local = np.random.default_rng(4).uniform(-0.03, 0.03, (60, 3)) - [0, 0, 0.06]
    points = local @ coil.placement.rotation.T + coil.placement.position
    error = relative(unit_flux_density(coil, points), magpylib_coil(coil, shells=10).getB(points))
    assert np.median(error) < 1e-9
    assert error.max() < 1e-7


def test_where_magpylib_strays_quadrature_agrees_with_us(simple_coil, biot_savart):
    points = np.random.default_rng(5).uniform(-0.06, 0.06, (200, 3)) - [0, 0, 0.12]
    ours = unit_flux_density(simple_coil, points)
    error = relative(ours, magpylib_coil(simple_coil, shells=6).getB(points))
    worst = np.argsort(error)[-3:]
    assert relative(ours[worst], biot_savart(simple_coil, points[worst])).max() < 1e-10


def test_current_scales_the_magpylib_twin(simple_coil):
    points = np.array([[0.0, 0.0, -0.1]])
    one, two = magpylib_coil(simple_coil).getB(points), magpylib_coil(simple_coil, current=-2.0).getB(points)
    np.testing.assert_allclose(two, -2 * one, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("digits", [6.0, 8.0, 10.0, 12.0])
def test_digits_are_delivered(coil, near_and_far, digits):
    points = near_and_far(coil)
    best, best_gradient = unit_flux_density_and_gradient(coil, points, digits=14)
    field, gradient = unit_flux_density_and_gradient(coil, points, digits=digits)
    allowed = 3 * 10.0**-digits
    assert relative(field, best).max() < allowed
    size = np.linalg.norm(best_gradient, axis=(1, 2))
    assert (np.linalg.norm(gradient - best_gradient, axis=(1, 2)) / size).max() < 30 * allowed

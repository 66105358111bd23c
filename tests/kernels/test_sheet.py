import numpy as np
import pytest

from fieldmap.constants import MU0
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.kernels.coils.sheet import sheet_flux_density, sheet_flux_density_and_gradient

RADIUS, HEIGHT = 0.02, 0.05


def stack_of_loops(points, radius, height, order=40):
    nodes, weights = np.polynomial.legendre.leggauss(order)
    field, gradient = 0, 0
    for node, weight in zip(nodes, weights / 2, strict=True):
        one, two = loop_flux_density_and_gradient(points - [0, 0, node * height / 2], radius)
        field, gradient = field + weight * one, gradient + weight * two
    return field, gradient


def relative(a, b):
    axes = tuple(range(1, a.ndim))
    return (np.sqrt(np.sum((a - b) ** 2, axis=axes)) / np.sqrt(np.sum(b**2, axis=axes))).max()


def test_on_the_axis_closed_form():
    z = np.array([-0.2, -0.03, 0.0, 0.01, 0.025, 0.1, 0.4])
    points = np.column_stack([0 * z, 0 * z, z])
    field = sheet_flux_density(points, RADIUS, HEIGHT)
    ends = [(z + s * HEIGHT / 2) / np.hypot(RADIUS, z + s * HEIGHT / 2) for s in (1, -1)]
    np.testing.assert_allclose(field[:, 2], MU0 / (2 * HEIGHT) * (ends[0] - ends[1]), rtol=1e-12)


def test_is_a_stack_of_loops():
    points = np.array(
        [[0.001, 0.0, 0.01], [0.012, 0.01, -0.01], [0.01, 0.03, 0.02], [0.02, 0.0, 0.04], [0.1, 0.2, 0.1]]
    )
    field, gradient = sheet_flux_density_and_gradient(points, RADIUS, HEIGHT)
    reference, reference_gradient = stack_of_loops(points, RADIUS, HEIGHT, order=160)
    assert relative(field, reference) < 1e-11
    assert relative(gradient, reference_gradient) < 1e-9


@pytest.mark.parametrize(("radius", "height"), [(0.02, 0.001), (0.02, 0.05), (0.002, 0.3)])
def test_closed_form_and_loops_far_away_join_smoothly(radius, height):
    """Across the distances where the kernel changes its formula, against many loops."""
    distance = 10.0 ** np.linspace(-0.5, 2, 24)
    points = distance[:, None] * np.array([0.6, 0.0, 0.8])
    field, gradient = sheet_flux_density_and_gradient(points, radius, height)
    reference, reference_gradient = stack_of_loops(points, radius, height)
    assert relative(field, reference) < 3e-12
    assert relative(gradient, reference_gradient) < 3e-12


def test_axial_field_jumps_by_the_surface_current():
    z = np.array([-0.01, 0.0, 0.02])
    inside, on, outside = (
        sheet_flux_density(np.column_stack([0 * z + r, 0 * z, z]), RADIUS, HEIGHT)
        for r in (RADIUS * (1 - 1e-10), RADIUS, RADIUS * (1 + 1e-10))
    )
    np.testing.assert_allclose(inside[:, 2] - outside[:, 2], MU0 / HEIGHT, rtol=1e-7)
    np.testing.assert_allclose(on[:, 2], (inside[:, 2] + outside[:, 2]) / 2, rtol=1e-7)

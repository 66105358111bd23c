from itertools import pairwise

import numpy as np
import pytest

from fieldmap.constants import MU0
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.kernels.coils.ring import ring_flux_density, ring_flux_density_and_gradient
from fieldmap.kernels.coils.sheet import sheet_flux_density_and_gradient

INNER, OUTER, HEIGHT = 0.011, 0.021, 0.039


def shells(points, order, low=INNER, high=OUTER):
    """A thick coil as Gauss-Legendre sheets between two radii, per ampere-turn of the whole coil."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    field, gradient = 0, 0
    for node, weight in zip(nodes, weights, strict=True):
        radius = (low + high + node * (high - low)) / 2
        share = weight * (high - low) / 2 / (OUTER - INNER)
        one, two = sheet_flux_density_and_gradient(points, radius, HEIGHT)
        field, gradient = field + share * one, gradient + share * two
    return field, gradient


def relative(a, b):
    axes = tuple(range(1, a.ndim))
    return (np.sqrt(np.sum((a - b) ** 2, axis=axes)) / np.sqrt(np.sum(b**2, axis=axes))).max()


def test_on_the_axis_closed_form():
    """mu0 J/2 sum of h ln((r2 + R2)/(r1 + R1)): the field of a thick solenoid on its axis."""
    z = np.array([-0.1, 0.0, 0.012, 0.0195, 0.05])
    field = ring_flux_density(np.column_stack([0 * z, 0 * z, z]), INNER, OUTER, HEIGHT, 14.0)
    total = 0
    for sign in (1, -1):
        h = z + sign * HEIGHT / 2
        total += sign * h * np.log((OUTER + np.hypot(OUTER, h)) / (INNER + np.hypot(INNER, h)))
    expected = MU0 / (2 * (OUTER - INNER) * HEIGHT) * total
    np.testing.assert_allclose(field[:, 2], expected, rtol=1e-12)
    np.testing.assert_array_equal(field[:, :2], 0)


def test_one_millimetre_from_the_winding_and_in_the_workspace():
    points = np.array(
        [[0.010, 0.0, 0.015], [0.006, -0.008, -0.0195], [0.0, 0.022, 0.003], [0.03, 0.01, -0.08]]
    )
    field, gradient = ring_flux_density_and_gradient(points, INNER, OUTER, HEIGHT, 10.0)
    reference, reference_gradient = shells(points, 40)
    assert relative(field, reference) < 1e-10
    assert relative(gradient, reference_gradient) < 1e-9


def test_inside_the_winding():
    """Shells inside and outside the point's radius, with panels that shrink towards it, where the integrand jumps."""
    radius = 0.0153
    points = np.array([[radius, 0.0, 0.004]])
    steps = 0.25 ** np.arange(0, 14)
    edges = np.concatenate(
        [radius - (radius - INNER) * steps, [radius], (radius + (OUTER - radius) * steps)[::-1]]
    )
    reference = sum(shells(points, 10, low, high)[0] for low, high in pairwise(edges))
    assert relative(ring_flux_density(points, INNER, OUTER, HEIGHT, 10.0), reference) < 1e-9


@pytest.mark.parametrize("distance", [0.08, 0.09, 0.093, 0.1, 0.2])
def test_filaments_take_over_without_a_step(distance):
    """For twelve digits the transition is at 0.091 m."""
    points = distance * np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
    field, gradient = ring_flux_density_and_gradient(points, INNER, OUTER, HEIGHT, 12.0)
    reference, reference_gradient = shells(points, 16)
    assert relative(field, reference) < 1e-11
    assert relative(gradient, reference_gradient) < 1e-11


@pytest.mark.parametrize(
    ("inner", "outer", "height"),
    [(0.01, 0.02, 1.0), (0.01, 0.011, 0.1), (0.1, 0.101, 0.001), (0.01, 0.02, 0.0005)],
    ids=["rod", "tube", "hoop", "disk"],
)
def test_odd_shapes_keep_their_digits_at_all_distances(inner, outer, height):
    size = np.hypot(outer, height / 2)
    points = size * np.array([1.5, 3.0, 5.0, 8.0, 20.0])[:, None] * np.array([0.6, 0.0, 0.8])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    nodes_r, weights_r = np.polynomial.legendre.leggauss(8)
    reference, reference_gradient = 0, 0
    for node, weight in zip(nodes, weights / 2, strict=True):
        for node_r, weight_r in zip(nodes_r, weights_r / 2, strict=True):
            radius = (inner + outer + node_r * (outer - inner)) / 2
            one, two = loop_flux_density_and_gradient(points - [0, 0, node * height / 2], radius)
            reference = reference + weight * weight_r * one
            reference_gradient = reference_gradient + weight * weight_r * two
    field, gradient = ring_flux_density_and_gradient(points, inner, outer, height, 10.0)
    assert relative(field, reference) < 2e-10
    assert relative(gradient, reference_gradient) < 1e-9


def test_no_hole_and_the_axis_of_it():
    points = np.array([[0.0, 0.0, 0.03], [0.004, 0.003, -0.04]])
    field = ring_flux_density(points, 0.0, 0.02, 0.01, 10.0)
    assert np.all(np.isfinite(field))
    h = [0.035, 0.025]
    expected = MU0 / (2 * 0.02 * 0.01) * (h[0] * np.arcsinh(0.02 / h[0]) - h[1] * np.arcsinh(0.02 / h[1]))
    assert field[0, 2] == pytest.approx(expected, rel=1e-10)

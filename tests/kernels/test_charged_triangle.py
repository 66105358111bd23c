"""Charged triangles against magpylib, quadrature, finite differences and limits."""

import magpylib
import numpy as np
import pytest

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.iron.charged_triangle import (
    triangle_potential,
    triangles_field,
    triangles_field_and_gradient,
)
from fieldmap.kernels.simplex_rules import triangle_rule

RNG = np.random.default_rng(7)
CORNERS = RNG.normal(size=(1, 3, 3))
CROSS = np.cross(CORNERS[:, 1] - CORNERS[:, 0], CORNERS[:, 2] - CORNERS[:, 0])
AREA = 0.5 * np.linalg.norm(CROSS)
NORMALS = CROSS / (2 * AREA)
ONE = np.ones(1)
POINTS = RNG.normal(size=(12, 3)) * 1.5


@njit
def potentials(points, corners, normal):
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = triangle_potential(points[i, 0], points[i, 1], points[i, 2], corners, normal)
    return out


def potential(points):
    return potentials(points, CORNERS[0], NORMALS[0])


def field(points):
    return triangles_field(points, CORNERS, NORMALS, ONE)


def test_field_is_that_of_a_charged_triangle_in_magpylib():
    # magpylib's triangle carries the surface charge J.n; its B outside a body is the field of that charge.
    theirs = magpylib.misc.Triangle(vertices=CORNERS[0], polarization=NORMALS[0]).getB(POINTS)
    assert field(POINTS) == pytest.approx(4 * np.pi * theirs, rel=1e-12, abs=1e-13)


def test_potential_is_the_integral_of_inverse_distance():
    barycentric, weights = triangle_rule(40)
    where = barycentric @ CORNERS[0]
    far = POINTS * 2.5
    distance = np.linalg.norm(far[:, None] - where, axis=2)
    assert potential(far) == pytest.approx(AREA * (weights / distance).sum(axis=1), rel=1e-10)


def test_field_and_gradient_kernel_repeats_the_field():
    both, gradient = triangles_field_and_gradient(POINTS, CORNERS, NORMALS, ONE)
    assert both == pytest.approx(field(POINTS), rel=1e-12, abs=1e-14)
    size = np.abs(gradient).max()
    assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-12 * size
    assert (gradient == np.swapaxes(gradient, 1, 2)).all()


@pytest.mark.parametrize("axis", range(3))
def test_taylor_of_potential_and_field(axis):
    """The remainder of the first-order Taylor polynomial falls with the square of the step."""
    step = np.eye(3)[axis]
    gradient = triangles_field_and_gradient(POINTS, CORNERS, NORMALS, ONE)[1][:, :, axis]
    steps = np.array([1e-2, 5e-3, 2.5e-3])
    of_potential = [
        np.abs(potential(POINTS + h * step) - potential(POINTS) + h * field(POINTS)[:, axis]) for h in steps
    ]
    of_field = [np.abs(field(POINTS + h * step) - field(POINTS) - h * gradient) for h in steps]
    for remainder in (of_potential, of_field):
        size = np.array([r.max() for r in remainder])
        slopes = np.log2(size[:-1] / size[1:])
        assert (slopes > 1.8).all()


def test_far_away_it_is_a_point_charge():
    centre = CORNERS[0].mean(axis=0)
    for distance, bound in ((10.0, 2e-2), (100.0, 2e-4)):
        x = centre + distance * np.array([[0.6, 0.0, 0.8]])
        point_charge = AREA * (x - centre) / distance**3
        assert np.abs(field(x) - point_charge).max() < bound * np.abs(point_charge).max()


def test_solid_angle_jumps_by_four_pi_through_the_face():
    centre = CORNERS[0].mean(axis=0)[None]
    above, below = (field(centre + side * 1e-9 * NORMALS) @ NORMALS[0] for side in (1, -1))
    assert above - below == pytest.approx([4 * np.pi], rel=1e-7)


def test_finite_on_corners_and_edges():
    places = np.concatenate([CORNERS[0], [0.5 * (CORNERS[0, 0] + CORNERS[0, 1])]])
    assert np.isfinite(potential(places)).all()

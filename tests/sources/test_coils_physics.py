"""Properties of any coil's field: Maxwell's equations, symmetry, scaling, far field."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap.device.model import CircularCoil, PathCoil, Placement, RoundedRectangleCoil
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient

MU0 = 1.25663706127e-6


def test_central_difference_of_each_point_equals_gradient(coil, near_and_far):
    points = near_and_far(coil)
    gradient = unit_flux_density_and_gradient(coil, points, digits=14)[1]
    h = 2e-5
    numeric = np.stack(
        [
            8 * (unit_flux_density(coil, points + h * e, 14) - unit_flux_density(coil, points - h * e, 14))
            - (
                unit_flux_density(coil, points + 2 * h * e, 14)
                - unit_flux_density(coil, points - 2 * h * e, 14)
            )
            for e in np.eye(3)
        ],
        axis=-1,
    ) / (12 * h)
    size = np.linalg.norm(gradient, axis=(1, 2))
    assert (np.linalg.norm(numeric - gradient, axis=(1, 2)) / size).max() < 1e-6


def test_field_is_the_same_with_and_without_gradient(coil, near_and_far):
    points = near_and_far(coil)
    with_gradient = unit_flux_density_and_gradient(coil, points)[0]
    np.testing.assert_array_equal(with_gradient, unit_flux_density(coil, points))


def test_gradient_is_symmetric_and_trace_free_outside(coil, near_and_far):
    gradient = unit_flux_density_and_gradient(coil, near_and_far(coil))[1]
    size = np.linalg.norm(gradient, axis=(1, 2))
    assert (np.linalg.norm(gradient - gradient.swapaxes(1, 2), axis=(1, 2)) / size).max() < 1e-10
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) / size).max() < 1e-12


def curl(gradient):
    return np.stack(
        [
            gradient[:, 2, 1] - gradient[:, 1, 2],
            gradient[:, 0, 2] - gradient[:, 2, 0],
            gradient[:, 1, 0] - gradient[:, 0, 1],
        ],
        axis=-1,
    )


@pytest.mark.parametrize(
    ("coil", "point", "direction"),
    [
        (CircularCoil("c", 0.011, 0.021, 0.039, 840.0), [0.012, 0.009, 0.01], [-0.6, 0.8, 0]),
        (RoundedRectangleCoil("r", 0.03, 0.02, 0.006, 0.008, 0.02, 640.0), [0.03, 0.004, -0.003], [0, 1, 0]),
        (
            RoundedRectangleCoil("r", 0.03, 0.02, 0.006, 0.008, 0.02, 640.0, -1),
            [0.024 + 0.0036, 0.014 + 0.0048, 0.002],
            [0.8, -0.6, 0],
        ),
        (
            PathCoil(
                "p",
                np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.03], [0.03, 0.07], [0, 0.07]]),
                0.006,
                0.008,
                0.02,
                640.0,
            ),
            [0.036 - 0.0036, 0.036 - 0.0048, 0.0],
            [-0.8, 0.6, 0],
        ),
    ],
    ids=["circular", "bar", "corner", "corner to the right"],
)
def test_numeric_curl_inside_the_winding_is_mu0_j(coil, point, direction):
    """Curl and divergence from differences of the field, because the gradient may be trace-free by construction."""
    width = coil.outer_radius - coil.inner_radius if isinstance(coil, CircularCoil) else coil.thickness
    density = coil.turns / (width * coil.height)
    h = 1e-5
    point = np.array([point])
    numeric = np.stack(
        [
            (unit_flux_density(coil, point + h * e, 14) - unit_flux_density(coil, point - h * e, 14))
            / (2 * h)
            for e in np.eye(3)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(
        curl(numeric)[0], MU0 * density * np.array(direction), atol=1e-6 * MU0 * density
    )
    assert abs(np.trace(numeric[0])) < 1e-6 * MU0 * density
    gradient = unit_flux_density_and_gradient(coil, point, 14)[1]
    np.testing.assert_allclose(gradient, numeric, atol=1e-6 * MU0 * density)


def test_circulation_around_the_winding_is_the_current_through_it():
    """Ampere's law in integral form, far from any singularity, exact for a periodic integrand."""
    coil = RoundedRectangleCoil("r", 0.03, 0.02, 0.006, 0.008, 0.02, 640.0)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    points = np.column_stack([0.03 + 0.012 * np.cos(angle), 0 * angle, 0.018 * np.sin(angle)])
    tangents = np.column_stack([-0.012 * np.sin(angle), 0 * angle, 0.018 * np.cos(angle)])
    circulation = np.sum(unit_flux_density(coil, points) * tangents) * 2 * np.pi / 200
    # the contour turns from x to z, right-handed about -y, and the current flows along +y there
    assert circulation == pytest.approx(-MU0 * 640, rel=1e-9)


def test_far_field_is_the_dipole_with_slope_two(simple_coil):
    """|B - B_dipole| / |B| falls as (size / distance)^2 for coils whose centroid of area is the local origin."""
    coil = simple_coil
    area = {
        "circular": np.pi * (0.016**2 + 0.010**2 / 12),
        "rounded square": rounded_area(0.016, 0.016, 0.015, 0.010),
        "oblong": rounded_area(0.03, 0.02, 0.006, 0.008),
    }[coil.name]
    moment = coil.turns * coil.polarity * area * coil.placement.rotation[:, 2]
    direction = np.array([0.36, 0.48, -0.8])
    error = []
    for distance in (0.5, 1.0, 2.0, 4.0):
        field = unit_flux_density(coil, coil.placement.position + distance * direction, 14)[0]
        dipole = dipole_field(moment, distance * direction)
        error.append(np.linalg.norm(field - dipole) / np.linalg.norm(dipole))
    slopes = np.log2(np.array(error[:-1]) / error[1:])
    np.testing.assert_allclose(slopes, 2, atol=0.05)
    assert error[-1] < 1e-3


def dipole_field(moment, r):
    distance = np.linalg.norm(r)
    return MU0 / (4 * np.pi) * (3 * r * (moment @ r) / distance**5 - moment / distance**3)


def rounded_area(x, y, radius, thickness):
    """Mean over the thickness of the area inside a rounded rectangle, exact because the area is quadratic in it."""
    mean_square = radius**2 + thickness**2 / 12
    return 4 * ((x - radius) * (y - radius) + (x + y - 2 * radius) * radius) + np.pi * mean_square


def test_path_far_field_has_the_moment_of_its_area():
    """An L of two rectangles; a rounding changes the area by (1 - pi/4) r^2 per corner."""
    corners = np.array([[0, 0], [0.06, 0], [0.06, 0.03], [0.03, 0.03], [0.03, 0.07], [0, 0.07]])
    coil = PathCoil("angle", corners, 0.006, 0.008, 0.01, 50.0)
    square = 0.006**2
    # five corners to the left and one to the right; the mean of r^2 across the thickness t is r^2 + t^2/12
    sharp = 0.06 * 0.03 + 0.03 * 0.04
    area = sharp - 4 * (1 - np.pi / 4) * square + np.pi * 0.008**2 / 12
    direction = np.array([0.36, 0.48, -0.8])
    distance = 2e4
    field = unit_flux_density(coil, distance * direction, 14)[0]
    np.testing.assert_allclose(
        field, dipole_field(np.array([0, 0, 50.0 * area]), distance * direction), rtol=2e-5
    )


def test_field_scales_inversely_with_size(coil, near_and_far):
    factor = 3.7
    points = near_and_far(coil)
    numbers = {"name", "turns", "polarity", "placement", "resistance", "inductance"}
    lengths = {field.name for field in dataclasses.fields(coil)} - numbers
    scaled = {name: factor * getattr(coil, name) for name in lengths}
    placement = Placement(factor * coil.placement.position, coil.placement.rotation)
    larger = dataclasses.replace(coil, placement=placement, **scaled)
    field, gradient = unit_flux_density_and_gradient(coil, points)
    field_larger, gradient_larger = unit_flux_density_and_gradient(larger, factor * points)
    np.testing.assert_allclose(factor * field_larger, field, rtol=1e-9, atol=1e-9 * np.abs(field).max())
    np.testing.assert_allclose(
        factor**2 * gradient_larger, gradient, rtol=1e-9, atol=1e-9 * np.abs(gradient).max()
    )


def test_turns_and_polarity_multiply(coil, near_and_far):
    points = near_and_far(coil)
    other = dataclasses.replace(coil, turns=2.5 * coil.turns, polarity=-coil.polarity)
    for ours, theirs in zip(
        unit_flux_density_and_gradient(other, points),
        unit_flux_density_and_gradient(coil, points),
        strict=True,
    ):
        np.testing.assert_allclose(ours, -2.5 * theirs, rtol=1e-13)


def test_moving_and_turning_the_coil_moves_and_turns_its_field(coil, near_and_far):
    turn = Rotation.from_rotvec([0.4, -1.1, 0.3]).as_matrix()
    shift = np.array([0.2, -0.1, 0.05])
    points = near_and_far(coil)
    old = coil.placement
    moved = dataclasses.replace(coil, placement=Placement(turn @ old.position + shift, turn @ old.rotation))
    field, gradient = unit_flux_density_and_gradient(coil, points)
    field_moved, gradient_moved = unit_flux_density_and_gradient(moved, points @ turn.T + shift)
    np.testing.assert_allclose(field_moved, field @ turn.T, atol=1e-9 * np.abs(field).max())
    np.testing.assert_allclose(gradient_moved, turn @ gradient @ turn.T, atol=1e-9 * np.abs(gradient).max())


def test_rounded_square_has_fourfold_symmetry_and_mirrors():
    coil = RoundedRectangleCoil("s", 0.016, 0.016, 0.015, 0.010, 0.039, 840.0)
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (20, 3))
    field = unit_flux_density(coil, points)
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_allclose(unit_flux_density(coil, points @ quarter.T), field @ quarter.T, atol=1e-12)
    # a mirror reverses the axial vector B: B'(Mx) = det(M) M B(x), with the current reversed
    mirror = np.diag([-1.0, 1, 1])
    np.testing.assert_allclose(unit_flux_density(coil, points @ mirror), field @ mirror, atol=1e-12)
    upside = np.diag([1.0, 1, -1])
    np.testing.assert_allclose(unit_flux_density(coil, points @ upside), -field @ upside, atol=1e-12)


def test_rounded_square_without_straight_parts_is_the_circular_coil(near_and_far):
    """Two implementations: arcs of a path, and the circular winding about its own axis."""
    circular = CircularCoil("c", 0.011, 0.021, 0.039, 840.0)
    rounded = RoundedRectangleCoil("s", 0.016, 0.016, 0.016, 0.010, 0.039, 840.0)
    inside = [[0.012, 0.009, 0.01], [0.0, 0.0111, -0.019], [0.0, -0.016, 0.0194]]
    points = np.vstack([near_and_far(circular), inside, [[0.4, 0.3, 0.1], [3.0, 0, 1.0]]])
    for one, two in zip(
        unit_flux_density_and_gradient(circular, points),
        unit_flux_density_and_gradient(rounded, points),
        strict=True,
    ):
        size = np.abs(one).reshape(len(points), -1).max(axis=1)
        assert (np.abs(one - two).reshape(len(points), -1).max(axis=1) / size).max() < 1e-9


def test_splitting_the_height_changes_nothing(near_and_far):
    """For two half coils on top of each other the upper end of one cancels the lower end of the other."""
    whole = RoundedRectangleCoil("w", 0.016, 0.016, 0.015, 0.010, 0.039, 840.0)
    halves = [
        dataclasses.replace(
            whole, height=0.0195, turns=420.0, placement=Placement(np.array([0, 0, z]), np.eye(3))
        )
        for z in (-0.00975, 0.00975)
    ]
    points = near_and_far(whole)
    total = sum(unit_flux_density(half, points, 12) for half in halves)
    np.testing.assert_allclose(total, unit_flux_density(whole, points, 12), rtol=1e-9, atol=1e-13)


def test_reversed_corner_order_reverses_the_field():
    corners = np.array([[0, 0], [0.06, 0], [0.03, 0.05]])
    points = np.random.default_rng(2).uniform(-0.1, 0.1, (10, 3))
    one = unit_flux_density(PathCoil("a", corners, 0.006, 0.008, 0.01, 50.0), points)
    two = unit_flux_density(PathCoil("b", corners[::-1], 0.006, 0.008, 0.01, 50.0), points)
    np.testing.assert_allclose(two, -one, rtol=1e-9, atol=1e-14)

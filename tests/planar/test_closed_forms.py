"""Against image solutions, quadrature and laws that the solver does not use."""

import numpy as np
import pytest

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.device.model import FluxBarrier, LinearMaterial
from fieldmap.planar import RectangularWire, RoundWire, solve_planar

POINTS = np.array([[0.15, 0.02], [-0.12, 0.2], [0.02, -0.3], [0.3, 0.3]])


def line_currents(points, currents):
    """B_x - i B_z of line currents (place, ampere into the page)."""
    z = points[:, 0] + 1j * points[:, 1]
    return sum(1j * MU0_OVER_2PI * ampere / (z - place) for place, ampere in currents)


def as_complex(field):
    return field[:, 0] - 1j * field[:, 1]


@pytest.mark.parametrize("mu_r", [1e-3, 1.5, 10.0, 4000.0, 1e6])
def test_line_current_beside_a_cylinder_converges_to_its_images(mu_r, build, circle):
    """Outside: the current, its image at R^2/d, and the opposite image on the axis. Inside: one stronger current."""
    radius, d, ampere = 0.1, 0.16, 100.0
    k = (mu_r - 1) / (mu_r + 1)
    inside = np.array([[0.03, 0.02], [-0.05, 0.0], [0.0, -0.06]])
    outer = line_currents(POINTS, [(d, ampere), (radius**2 / d, k * ampere), (0.0, -k * ampere)])
    inner = line_currents(inside, [(d, 2 * mu_r / (mu_r + 1) * ampere)])
    errors = []
    for count in (16, 32, 64):
        unit = solve_planar(build({"rod": circle(count, radius)}, [([[d, 0.0]], [])], mu_r), size=1.0)
        outside = np.abs(as_complex(unit.field(POINTS, [ampere])) - outer).max() / np.abs(outer).max()
        within = np.abs(as_complex(unit.field(inside, [ampere])) - inner).max() / np.abs(inner).max()
        errors.append([outside, within])
    errors = np.array(errors)
    assert errors[-1, 0] < 5e-6
    assert errors[-1, 1] < 1e-3
    assert np.all(np.log2(errors[:-1] / errors[1:]) > [2.5, 1.3])


def box_images(points, place, width, height, ampere, rings):
    """Direct sum over a current's images in the walls of a box [0, width] x [0, height]; a wall reverses the sign."""
    total = 0
    for m in range(-rings, rings + 1):
        for n in range(-rings, rings + 1):
            shift = 2 * m * width + 2j * n * height
            group = [(place, 1), (-np.conj(place), -1), (np.conj(place), -1), (-place, 1)]
            total = total + line_currents(points, [(q + shift, sign * ampere) for q, sign in group])
    return total


def test_current_in_a_box_has_the_images_of_its_walls(build, rectangle):
    width, height, place = 0.5, 0.4, 0.2 + 0.13j
    points = np.array([[0.1, 0.3], [0.35, 0.1], [0.4, 0.35], [0.24, 0.2]])
    expected = box_images(points, place, width, height, 10.0, 40)
    errors = []
    for size in (0.1, 0.05, 0.025):
        device = build({}, [([[place.real, place.imag]], [])], walls=rectangle(0, 0, width, height))
        found = as_complex(solve_planar(device, size=size).field(points, [10.0]))
        errors.append(np.abs(found - expected).max() / np.abs(expected).max())
    assert errors[-1] < 1e-3
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 1.5)


def test_bars_without_permeability_are_walls(build, rectangle):
    """Four touching bars around a current and an iron bar, against exact walls at their inner faces."""
    a, t = 0.25, 0.05
    bars = {
        "left": rectangle(-a - t, -a - t, -a, a + t),
        "right": rectangle(a, -a - t, a + t, a + t),
        "bottom": rectangle(-a, -a - t, a, -a),
        "top": rectangle(-a, a, a, a + t),
    }
    iron = {"iron": rectangle(-0.1, 0.0, 0.1, 0.05)}
    wires = [([[0.05, 0.1]], [[-0.05, 0.1]])]
    materials = {"iron": LinearMaterial("iron", 500.0), "bar": FluxBarrier("bar")}
    framed = solve_planar(build(iron | bars, wires, materials=materials), size=0.03)
    walled = solve_planar(build(iron, wires, 500.0, walls=rectangle(-a, -a, a, a)), size=0.03)
    points = np.array([[0.0, -0.1], [0.15, 0.1], [-0.2, -0.2], [0.1, -0.05]])
    one, other = framed.field(points, [100.0]), walled.field(points, [100.0])
    np.testing.assert_allclose(one, other, rtol=0, atol=2e-3 * np.abs(other).max())


def test_rectangular_conductor_is_that_of_quadrature(build):
    wire = RectangularWire(0.02, 0.05)
    unit = solve_planar(build({}, [([[0.01, 0.02]], [])], wire=wire))
    nodes, weights = np.polynomial.legendre.leggauss(30)
    share = 0.25 * weights[:, None] * weights
    x, z = 0.01 + 0.01 * nodes[:, None] + 0 * nodes, 0.02 + 0.025 * nodes + 0 * nodes[:, None]
    spots = [(a + 1j * b, s) for a, b, s in zip(x.ravel(), z.ravel(), share.ravel(), strict=True)]
    np.testing.assert_allclose(
        as_complex(unit.field(POINTS, [1.0])), line_currents(POINTS, spots), rtol=1e-10
    )


def test_round_and_rectangular_conductors_magnetise_alike_from_afar(build, rectangle):
    """Two sections of equal second moments have the same field up to fourth order in their size."""
    side = 0.012
    radius = side / np.sqrt(3.0)
    fields = [
        solve_planar(
            build({"iron": rectangle(-0.1, 0, 0.1, 0.05)}, [([[0.0, 0.15]], [])], wire=wire), size=0.01
        ).field(POINTS, [1.0])
        for wire in (RoundWire(radius), RectangularWire(side, side))
    ]
    np.testing.assert_allclose(*fields, rtol=1e-5)


def test_without_contrast_iron_is_not_there(build, rectangle):
    unit = solve_planar(build({"air": rectangle(-0.1, 0, 0.1, 0.05)}, [([[0.0, 0.15]], [])], mu_r=1.0))
    expected = line_currents(POINTS, [(0.15j, 3.0)])
    np.testing.assert_allclose(as_complex(unit.field(POINTS, [3.0])), expected, rtol=1e-12)


def test_one_polygon_or_two_that_touch(build, rectangle):
    """An L as one polygon, and as two whose common edge ends in the middle of an edge."""
    ell = np.array([[0, 0], [0.3, 0], [0.3, 0.1], [0.1, 0.1], [0.1, 0.3], [0, 0.3]])
    wires = [([[0.2, 0.2]], [[-0.1, 0.1]])]
    one = solve_planar(build({"ell": ell}, wires, 4000.0), size=0.01)
    parts = {"foot": rectangle(0, 0, 0.3, 0.1), "leg": rectangle(0, 0.1, 0.1, 0.3)}
    two = solve_planar(build(parts, wires, 4000.0), size=0.01)
    points = np.array([[0.2, -0.1], [0.4, 0.2], [0.25, 0.3], [-0.1, 0.3]])
    a, b = one.field(points, [1.0]), two.field(points, [1.0])
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-3 * np.abs(a).max())


def test_both_continuity_conditions_across_the_iron_s_face(build, rectangle):
    """Normal B and tangential H are continuous at the lower face of a bar."""
    mu_r, step = 20.0, 1e-6
    unit = solve_planar(build({"bar": rectangle(-0.1, 0, 0.1, 0.05)}, [([[0.03, 0.1]], [])], mu_r), size=4e-3)
    x = np.linspace(-0.06, 0.06, 7)
    iron = unit.field(np.column_stack([x, np.full(7, step)]), [1.0])
    air = unit.field(np.column_stack([x, np.full(7, -step)]), [1.0])
    scale = np.abs(iron).max()
    np.testing.assert_allclose(iron[:, 1], air[:, 1], rtol=0, atol=5e-3 * scale)
    np.testing.assert_allclose(iron[:, 0] / mu_r, air[:, 0], rtol=0, atol=5e-3 * scale)


def test_fields_of_similar_machines_are_inverse_to_their_size(build, rectangle):
    wires = np.array([[0.05, 0.1]])
    units = [
        solve_planar(
            build(
                {"bar": s * rectangle(-0.1, 0, 0.1, 0.05)},
                [(s * wires, [])],
                walls=s * rectangle(-0.3, -0.3, 0.3, 0.3),
            ),
            size=0.0213 * s,
        )
        for s in (1.0, 250.0)
    ]
    points = np.array([[0.0, -0.1], [0.2, 0.1]])
    small, large = (u.field(s * points, [1.0]) for u, s in zip(units, (1.0, 250.0), strict=True))
    np.testing.assert_allclose(250.0 * large, small, rtol=1e-8)


def test_currents_superpose_and_derivatives_are_derivatives(build, rectangle):
    device = build(
        {"bar": rectangle(-0.1, 0, 0.1, 0.05)},
        [([[0.05, 0.1]], []), ([[-0.05, 0.1]], [[0.0, 0.15]])],
        walls=rectangle(-0.3, -0.3, 0.3, 0.3),
    )
    unit = solve_planar(device)
    inside = np.array([[0.0, -0.1], [0.2, 0.1], [0.02, 0.02]])
    both = 3 * unit.field(inside, [1.0, 0.0]) - 2 * unit.field(inside, [0.0, 1.0])
    np.testing.assert_allclose(unit.field(inside, [3.0, -2.0]), both, rtol=1e-12)
    gradient = unit.gradient(inside, [3.0, -2.0])
    np.testing.assert_allclose(gradient, np.swapaxes(gradient, 1, 2), rtol=1e-12)
    np.testing.assert_allclose(gradient[:, 0, 0], -gradient[:, 1, 1], rtol=1e-12)
    for axis in (0, 1):
        errors = []
        for h in (2e-4, 1e-4):
            moved = inside + h * np.eye(2)[axis]
            linear = unit.field(inside, [3.0, -2.0]) + h * gradient[:, :, axis]
            errors.append(np.abs(unit.field(moved, [3.0, -2.0]) - linear).max())
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_no_flux_passes_the_walls(build, rectangle):
    device = build(
        {"bar": rectangle(-0.1, 0, 0.1, 0.05)}, [([[0.05, 0.1]], [])], walls=rectangle(-0.2, -0.2, 0.2, 0.2)
    )
    x = np.linspace(-0.15, 0.15, 7)
    through = []
    for size in (1e-2, 5e-3, 2.5e-3):
        field = solve_planar(device, size).field(np.column_stack([x, np.full(7, -0.2 + 1e-6)]), [1.0])
        through.append(np.abs(field[:, 1]).max() / np.abs(field[:, 0]).max())
    # The points are at ends of panels, where the slope of the linear potential has one order less.
    assert through[-1] < 2.5e-2
    assert np.all(np.log2(np.divide(through[:-1], through[1:])) > 0.9)


def half_ring(count, inner, outer, side):
    """Half of a regular ring on one side in x; `count` edges on each arc, with the areas of circles."""
    t = np.pi / count
    scale = np.sqrt(t / np.sin(t))
    angle = np.linspace(0, np.pi, count + 1) - np.pi / 2 + (0 if side > 0 else np.pi)
    arc = np.column_stack([np.cos(angle), np.sin(angle)]) * scale
    return np.concatenate([outer * arc, inner * arc[::-1]])


def test_a_closed_shell_of_two_halves_shields_as_its_series_says(build):
    """In a cylindrical shell a uniform field is reduced by 4 mu / ((mu + 1)^2 - (a/b)^2 (mu - 1)^2)."""
    inner, outer, mu_r, far = 0.08, 0.1, 200.0, 50.0
    expected = 4 * mu_r / ((mu_r + 1) ** 2 - (inner / outer) ** 2 * (mu_r - 1) ** 2)
    points = np.array([[0.0, 0.0], [0.03, 0.04], [-0.05, 0.01]])
    applied = line_currents(points, [(1j * far, 1.0), (-1j * far, -1.0)])
    errors = []
    for count in (16, 32):
        halves = {"right": half_ring(count, inner, outer, 1), "left": half_ring(count, inner, outer, -1)}
        device = build(halves, [([[0.0, far]], [[0.0, -far]])], mu_r)
        found = as_complex(solve_planar(device, size=1.0).field(points, [1.0])) / applied
        errors.append(np.abs(found - expected).max() / expected)
    assert errors[1] < 1e-2
    assert errors[1] < 0.5 * errors[0]


def test_conductors_may_touch_the_iron(build, rectangle):
    """Touching the face or just above it: the same field."""
    for wire in (RectangularWire(0.03, 0.02), RoundWire(0.01)):
        fields = [
            solve_planar(
                build({"bar": rectangle(-0.1, 0, 0.1, 0.05)}, [([[0.01, 0.06 + gap]], [])], wire=wire),
                size=0.008,
            ).field(POINTS, [1.0])
            for gap in (0.0, 1e-6)
        ]
        np.testing.assert_allclose(*fields, rtol=0, atol=3e-4 * np.abs(fields[0]).max())

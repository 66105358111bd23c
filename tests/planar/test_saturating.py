"""Saturating iron in the plane: a closed form, the linear model, forces from energy, and Newton's convergence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap.constants import MU0_OVER_2PI
from fieldmap.device import read_device
from fieldmap.device.model import Arctangent, FluxBarrier, Froehlich, LinearMaterial
from fieldmap.errors import GeometryError, InputError, NotConverged
from fieldmap.iron.elements.bh_law import law_tables
from fieldmap.planar import read_planar_device, solve_planar, solve_planar_state, stationary_points
from fieldmap.planar.mesh import make_outline, triangulate
from fieldmap.planar.saturating import field_strength, iron_triangles

FROEHLICH = Froehlich("iron", 500.0, 2.0)
POINTS = np.array([[0.2, 0.05], [0.0, -0.15], [-0.1, 0.12]])


def in_uniform_field(build, circle, law, applied, count):
    """A cylinder between distant opposite currents that apply this flux density (T), along -x, at its centre."""
    far = 100.0
    device = build({"rod": circle(count, 0.1)}, [([[0.0, far]], [[0.0, -far]])], materials={"iron": law})
    return device, [applied * far / (2 * MU0_OVER_2PI)]


def strength_inside(law, applied):
    """mu0 H inside a cylinder, T, from b(h) + h = 2 h0."""
    tables, first = law_tables([law]), np.zeros(1, dtype=np.int64)
    return brentq(
        lambda h: tables.flux_density(np.array([h]), first)[0][0] + h - 2 * applied,
        0.0,
        2 * applied,
        xtol=1e-15,
    )


@pytest.mark.parametrize(
    "law", [FROEHLICH, Arctangent("iron", 1000.0, 2.1), read_device("drive_unit").materials["steel"]]
)
@pytest.mark.parametrize("applied", [0.05, 1.0, 3.0])
def test_cylinder_in_a_uniform_field(law, applied, build, circle):
    """b and h inside are uniform with b + h = 2 h0 (demagnetising factor 1/2); outside is the dipole field of b - h."""
    h = strength_inside(law, applied)
    b = 2 * applied - h
    device, currents = in_uniform_field(build, circle, law, applied, 64)
    state = solve_planar_state(device, currents, size=0.02)
    middles, inside = state.iron_flux_density("rod")
    inside = inside[np.hypot(*middles.T) < 0.08]  # beyond, the polygon's corners have an effect
    np.testing.assert_allclose(inside, np.broadcast_to([-b, 0.0], inside.shape), atol=4e-3 * b)
    zeta = POINTS[:, 0] + 1j * POINTS[:, 1]
    dipole = -0.5 * (b - h) * 0.1**2 / zeta**2
    total = state.derivatives(POINTS)[0]
    np.testing.assert_allclose(total, -applied + dipole, atol=4e-3 * applied)


def test_cylinder_converges(build, circle):
    applied, errors = 1.2, []
    zeta = POINTS[:, 0] + 1j * POINTS[:, 1]
    exact = -applied - (applied - strength_inside(FROEHLICH, applied)) * 0.1**2 / zeta**2
    for count in (16, 32, 64):
        device, currents = in_uniform_field(build, circle, FROEHLICH, applied, count)
        found = solve_planar_state(device, currents, size=1.6 / count).derivatives(POINTS)[0]
        errors.append(np.abs(found - exact).max())
    assert errors[-1] < 1e-3
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 1.3)


def test_iron_of_constant_permeability_is_that_of_the_linear_model():
    device = read_planar_device("planar_drive_unit")
    currents = [800.0, 1200.0]
    state, unit = solve_planar_state(device, currents, 0.01), solve_planar(device, 0.01)
    assert len(state.report.residuals) == 2
    points = [[0.0, -0.1], [0.1, -0.07], [0.0, -0.2], [0.0, 0.15]]
    expected = unit.field(points, currents)
    np.testing.assert_allclose(state.field(points), expected, rtol=0, atol=1e-4 * np.abs(expected).max())
    one = stationary_points(state, currents, -0.07, -0.165, 0.165)
    other = stationary_points(unit, currents, -0.07, -0.165, 0.165)
    np.testing.assert_allclose([p.x for p in one], [p.x for p in other], atol=1e-4)
    middles, inside = state.iron_flux_density("iron")
    deep = np.abs(middles[:, 0]) < 0.1
    scale = np.abs(inside).max()
    np.testing.assert_allclose(inside[deep], unit.field(middles[deep], currents), rtol=0, atol=0.02 * scale)


def test_weak_currents_do_not_saturate_and_strong_ones_do():
    device = read_planar_device("planar_drive_unit")
    steel = replace(device, materials={"iron": FROEHLICH})
    linear = solve_planar(device, 0.02, mu_r=500.0)
    point = [[0.0, -0.1]]
    ratios = []
    for current in (1.0, 3e4, 1e6):
        pair = [current, current]
        field = solve_planar_state(steel, pair, 0.02).gradient(point)[0, 1, 1]
        ratios.append(field / linear.gradient(point, pair)[0, 1, 1])
    assert ratios[0] == pytest.approx(1.0, abs=1e-2)
    assert 0.05 < abs(ratios[1] - 1) < abs(ratios[2] - 1)


def test_newton_converges_quadratically_from_nothing(build, rectangle):
    device = replace(read_planar_device("planar_drive_unit"), materials={"iron": FROEHLICH})
    residuals = solve_planar_state(device, [3e4, 1e4], 0.03, tolerance=1e-12).report.residuals
    assert len(residuals) < 25
    last = np.log10(residuals[-3:])
    assert last[2] < 1.5 * last[1] or residuals[-1] < 1e-13
    bar = build({"bar": rectangle(0, 0, 0.1, 0.05)}, [([[0.2, 0.2]], [])], materials={"iron": FROEHLICH})
    with pytest.raises(NotConverged):
        solve_planar_state(bar, [3e4], 0.05, tolerance=0.0)


def test_elements_have_the_size_that_is_asked_for(build, rectangle):
    bar = build({"bar": rectangle(0, 0, 0.1, 0.05)}, [([[0.2, 0.2]], [])], materials={"iron": FROEHLICH})
    coarse, fine, again = (solve_planar_state(bar, [3e4], size).report for size in (0.02, 0.01, 0.02))
    assert 1.5 < fine.iron_panels / coarse.iron_panels < 2.5
    assert again.iron_panels == coarse.iron_panels


def test_energy_derivatives_by_taylor(build, rectangle):
    device = build({"bar": rectangle(0, 0, 0.1, 0.05)}, [([[0.2, 0.2]], [])])
    iron = iron_triangles(make_outline(device, 0.02, 2), law_tables([FROEHLICH]), 0.02)
    random = np.random.default_rng(3)
    u, step = (0.05 * random.standard_normal(len(iron.points)) for _ in range(2))
    first, second = iron.derivatives(u)
    errors = []
    for share in (1e-3, 5e-4):
        linear = iron.energy(u) + share * first @ step
        full = linear + 0.5 * share**2 * step @ (second @ step)
        moved = iron.energy(u + share * step)
        errors.append([abs(moved - linear), abs(moved - full)])
    slopes = np.log2(np.divide(*errors))
    assert slopes[0] == pytest.approx(2.0, abs=0.1)
    assert slopes[1] == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize("law", [FROEHLICH, LinearMaterial("a", 4000.0), LinearMaterial("b", 0.5)])
def test_h_of_b_turns_b_of_h_around(law):
    tables = law_tables([law])
    b = np.concatenate([[0.0], np.geomspace(1e-6, 50.0, 200)])
    law_number = np.zeros(len(b), dtype=np.int64)
    h, energy, slope = field_strength(tables, law_number, b)
    np.testing.assert_allclose(tables.flux_density(h, law_number)[0], b, rtol=1e-9, atol=1e-15)
    step = 1e-4 * b[1:]
    ahead, behind = (field_strength(tables, law_number[1:], b[1:] + s) for s in (step, -step))
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * step), h[1:], rtol=1e-3)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), slope[1:], rtol=1e-2)
    assert np.all(energy >= 0)


def test_triangles_fill_the_polygon_and_are_well_shaped():
    corners = np.array([0, 0.3, 0.3 + 0.1j, 0.1 + 0.1j, 0.1 + 0.3j, 0.3j])
    ends = np.roll(corners, -1)
    t = np.linspace(0, 1, 20, endpoint=False)
    t = t**2 / (t**2 + (1 - t) ** 2)
    ring = np.concatenate([a + (b - a) * t for a, b in zip(corners, ends, strict=True)])
    points, triangles = triangulate(ring, 0.02)
    a, b, c = points[triangles].T
    area = 0.5 * ((b - a).conj() * (c - a)).imag
    assert area.min() > 0
    assert area.sum() == pytest.approx(0.05, rel=1e-12)
    sides = np.abs(b - a) ** 2 + np.abs(c - b) ** 2 + np.abs(a - c) ** 2
    assert (4 * np.sqrt(3) * area / sides).min() > 0.2
    np.testing.assert_array_equal(points[: len(ring)], ring)


def where(error):
    (problem,) = error.value.problems
    return problem.where


def test_what_cannot_be_solved(build):
    device = read_planar_device("planar_drive_unit")
    with pytest.raises(InputError) as caught:
        solve_planar_state(replace(device, materials={"iron": FluxBarrier("iron")}), [1.0, 1.0])
    assert where(caught) == "solve_planar_state, body iron"
    with pytest.raises(InputError) as caught:
        solve_planar_state(build({}, [([[0.0, 0.0]], [])]), [1.0])
    assert where(caught) == "solve_planar_state"
    slit = np.array([0, 1, 1 + 1j, 1j, 0.51j, 0.9 + 0.51j, 0.9 + 0.49j, 0.45 + 0.49j, 0.49j])
    with pytest.raises(GeometryError) as caught:
        triangulate(slit, 0.1)
    assert "edge" in where(caught)


def test_what_a_state_cannot_be_asked():
    state = solve_planar_state(read_planar_device("planar_drive_unit"), [1.0, 1.0], 0.03)
    assert state.at([1.0, 1.0]) is state.at(1.0) is state
    with pytest.raises(InputError) as caught:
        state.field([[0.0, 0.05]])
    assert where(caught) == "PlanarState(points)"
    for ask in (state.at, lambda currents: state.derivatives([[0.0, -0.1]], currents)):
        with pytest.raises(InputError) as caught:
            ask([2.0, 1.0])
        assert where(caught) == "PlanarState(currents)"
    with pytest.raises(InputError) as caught:
        state.iron_flux_density("steel")
    assert where(caught) == "PlanarState(body)"

"""S4: bands of the levitated sphere, its convergence, and the difference of the two windings."""

from functools import cache

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.sources import unit_flux_densities
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.single_electromagnet import (
    CURRENTS,
    EXACT,
    SIMPLIFIED,
    axis_curves,
    levitation_depth,
    solved,
)
from tests.computed_parts import assert_drawn, computed, numbers


@cache
def row():
    return {n.name: n for n in numbers("S4")}


def test_the_sphere_levitates_44_to_45_mm_below_the_core():
    for name in ("depth_exact", "depth_simplified"):
        assert 44.0 < row()[name].ours < 45.0
        assert any("open space" in text for text in row()[name].assumptions)


def test_the_simplified_winding_levitates_it_within_a_third_of_a_millimetre():
    assert abs(row()["depth_exact"].ours - row()["depth_simplified"].ours) < 0.3
    assert row()["difference_of_the_windings"].ours < 1.0


def test_the_sphere_is_marked_where_force_and_weight_cross():
    force, weight, mark, _ = computed("S4_levitation").curves[2].series
    assert np.interp(mark.x[0], force.x, force.y) == pytest.approx(mark.y[0], rel=1e-5)
    assert weight.y[0] == mark.y[0]
    assert 44 < mark.x[0] < 45


def test_converged_to_a_tenth_of_a_millimetre():
    depths = [levitation_depth(EXACT, refinement) for refinement in (1.0, 1.5)]
    assert abs(depths[1] - depths[0]) < 1e-4 / 4


def test_force_is_the_gradient_of_the_field_and_balances_the_weight():
    depth = levitation_depth(EXACT) + 1e-4 * np.array([-1.0, 0.0, 1.0])
    flux, gradient = axis_curves(EXACT, depth)
    assert gradient[1] == pytest.approx((flux[0] - flux[2]) / 2e-4, rel=1e-4)
    # Volume 5.24e-10 m^3 at 7400 kg/m^3, Table 2-2.
    force = read_device(EXACT).payload.moment * gradient[1]
    assert force == pytest.approx(np.pi / 6 * 1e-9 * 7400 * 9.80665, rel=2e-3)


def test_square_wires_stand_for_round_ones():
    """Against filaments spread over the round section, on the axis, on the core's face and 0.5 mm from a wire."""
    coils = read_device(SIMPLIFIED).coils
    points = np.array([[0.0, 0.0, -0.02], [0.0, 0.0, 0.045], [0.0199, 0.0, 0.009], [0.0199, 0.0, 0.018]])
    squares = np.tensordot(CURRENTS[SIMPLIFIED], unit_flux_densities(coils, points), axes=1)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    rounds = np.zeros((4, 3))
    for middle in 0.009 + 0.018 * np.arange(5):
        for node, weight in zip(nodes, weights, strict=True):
            radius = 0.0045 * (1 + node)
            for angle in 2 * np.pi * (np.arange(48) + 0.5) / 48:
                share = 100 * weight * 0.0045 * radius * 2 * np.pi / 48 / (np.pi * 0.009**2)
                a, z = 0.0295 + radius * np.cos(angle), middle + radius * np.sin(angle)
                rounds += share * loop_flux_density_and_gradient(points - [0, 0, z], a)[0]
    scale = np.linalg.norm(rounds, axis=1)
    error = np.linalg.norm(squares - rounds, axis=1) / scale
    assert error[:2].max() < 2e-4
    assert error.max() < 0.1


def test_figures_2_4_to_2_6():
    """B_z and dB_z/dz below the core, at 1 A in 500 turns and 100 A in 5; force and weight of a sphere of 1 mm,
    Table 2-2: remanence 1.3 T, 7400 kg/m^3."""
    part = computed("S4_levitation")
    given = read_part("S4_levitation").inputs
    far, near = 1e-3 * np.linspace(given["near_mm"], given["far_mm"], 200), 1e-3 * np.linspace(30, 60, 120)

    def at(name, depth, what):
        points = np.column_stack([np.zeros((len(depth), 2)), -depth])
        return getattr(solved(name, 1.5), what)(points, {EXACT: [1.0], SIMPLIFIED: [100.0] * 5}[name])

    exact, other = (at(name, far, "field")[:, 2] for name in (EXACT, SIMPLIFIED))
    slope = at(EXACT, far, "gradient")[:, 2, 2]
    sphere, device = np.pi / 6 * 1e-9, read_device(EXACT).payload
    moment = device.moment
    force, weight = 1e3 * moment * at(EXACT, near, "gradient")[:, 2, 2], 1e3 * device.mass * 9.80665
    assert weight == pytest.approx(1e3 * 7400 * sphere * 9.80665, rel=2e-3)
    labels = "depth below the core (mm)"
    flux, rise, lift = part.curves
    names = ("500 turns, 1 A", "5 turns, 100 A")
    lines = [(name, "ours", 1e3 * far, 1e3 * one) for name, one in zip(names, (exact, other), strict=True)]
    assert_drawn(flux, (labels, "$B_z$ (mT)"), lines)
    assert_drawn(rise, (labels, r"$\partial B_z/\partial z$ (T/m)"), [(names[0], "ours", 1e3 * far, slope)])
    assert (flux.log_y, rise.log_y, lift.log_y) == (False, True, False)
    place = {n.name: n.ours for n in part.comparisons}
    marks = ((f"balance at {place['depth_exact']:.1f} mm", "ours", [place["depth_exact"]], [weight]),
             ("the thesis's 44 mm", "published", [44.0], [weight]))  # fmt: skip
    lines = [
        ("magnetic force", "ours", 1e3 * near, force),
        ("weight", "ours", [30.0, 60.0], [weight] * 2),
        *marks,
    ]
    assert_drawn(lift, (labels, "force (mN)"), lines)
    # The largest over 80 places.
    few = 1e-3 * np.linspace(given["near_mm"], given["far_mm"], 80)
    ratio = at(SIMPLIFIED, few, "field")[:, 2] / at(EXACT, few, "field")[:, 2]
    assert place["difference_of_the_windings"] == pytest.approx(100 * np.abs(ratio - 1).max())
    assert part.comparisons[0].assumptions[0] in solved(EXACT, 1.5).report.assumptions

"""S9, S10: bands of the fitted constants, and what adding formulas does to their error."""

import numpy as np
import pytest

from fieldmap.planar import read_planar_device, solve_planar
from fieldmap.thesis.planar_force import (
    DEPTHS,
    constants,
    force,
    grid,
    horizontal_fit,
    superposition_error,
    vertical_fit,
)
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.spatial_force import added_errors, fitted, places, unit_forces
from tests.computed_parts import numbers

LINE = (0.125,)


def row(name):
    return {n.name: n for n in numbers(name)}


@pytest.mark.parametrize(("name", "band"), [("L0", 0.2), ("b", 0.2), ("c", 0.1)])
def test_constants_of_table_4_2(name, band):
    assert abs(row("S9")[name].deviation) < band


@pytest.mark.parametrize("factor", [2.0, 0.1])
def test_constants_follow_the_nominal_current(factor):
    """The iron is linear: -L0 I^2 / (2 b ...) + c is proportional to I, as are the errors; b is a length."""
    inputs = read_part("S9_constants").inputs
    once, other = (
        constants(inputs | {"nominal_current_A": factor * inputs["nominal_current_A"]} | more)
        for factor, more in (
            (1.0, {}),
            (factor, {"L0_H": inputs["L0_H"] / factor, "c_N": inputs["c_N"] * factor}),
        )
    )
    for name, power in (("L0", -1), ("b", 0), ("c", 1)):
        assert other.numbers[name].value == pytest.approx(once.numbers[name].value * factor**power, rel=1e-6)
    for name in ("rms_N", "printed_rms_N"):
        assert other.facts[name] == pytest.approx(factor * once.facts[name], rel=1e-6)


def test_the_formulas_equilibrium_at_three_to_one_is_not_the_force_s():
    """Independent finite elements put it at -33 mm; arithmetic on the printed constants gives +0.79 mm."""
    assert row("S9")["equilibrium"].ours == pytest.approx(-33.0, abs=0.5)
    assert row("S9")["equilibrium"].thesis == 0.79
    assert -15 < row("S9")["equilibrium_of_refitted"].ours < -5


def test_force_is_the_moment_times_the_gradient_and_superposes():
    x, z = grid(LINE)
    unit = solve_planar(read_planar_device("planar_drive_unit_8mm"))
    h = 1e-5
    ahead, behind = (unit.field(np.column_stack([x + s, -z]), [1e6, 0.0])[:, 1] for s in (h, -h))
    np.testing.assert_allclose(
        force((1.0, 0.0), x, z)[:, 0], 0.015625 * (ahead - behind) / (2 * h), atol=1e-6
    )
    both = force((1.5, 0.5), x, z)
    np.testing.assert_allclose(
        both, 1.5 * force((1.0, 0.0), x, z) + 0.5 * force((0.0, 1.0), x, z), atol=1e-12
    )


def test_real_iron_would_turn_the_lift_around():
    """The lift at 1e6 A with the curve of A-3, against linear iron: reversed, whatever the law (67 T in the plate)."""
    words = next(text for text in row("S9")["equilibrium"].assumptions if "B-H curve" in text)
    assert float(words.split(" times")[0].split()[-1]) == pytest.approx(-1.26, abs=0.02)


def test_absolute_errors_grow_with_a_second_magnet_and_relative_ones_do_not():
    fit = horizontal_fit(LINE, 0.22).formula
    one, equal, unequal = (superposition_error(fit, pair, LINE) for pair in ((1, 0), (1, 1), (1.5, 0.5)))
    assert one.rms < equal.rms < unequal.rms < 1.6 * one.rms
    assert max(equal.whole, unequal.whole) < one.whole < 0.2
    # The formula already misses two thirds of the force in the middle, with one magnet.
    assert 0.5 < one.middle < 0.8
    one, equal = (superposition_error(vertical_fit().formula, pair, DEPTHS) for pair in ((1, 0), (1, 1)))
    assert equal.rms / one.rms == pytest.approx(np.sqrt(2), rel=0.1)


def test_constants_of_table_4_3_in_their_bands():
    assert abs(row("S10")["b[0]"].deviation) < 0.1
    assert row("S10")["L0[0]"].ours < row("S10")["L0[0]"].thesis
    assert row("S10")["c[0]"].ours < 0 < row("S10")["c[0]"].thesis
    assert row("S10")["c[1]"].ours < 0 < row("S10")["c[1]"].thesis
    assert row("S10")["d"].ours == pytest.approx(100.0)


def test_six_magnets_double_the_error_of_one():
    errors = added_errors(0.09, 0.03)
    assert [len(error.currents) for error in errors] == [1, 2, 6]
    assert errors[0].rms < errors[1].rms < errors[2].rms
    assert 1.7 < errors[2].rms / errors[0].rms < 2.8
    assert max(error.whole for error in errors) < 0.12


def test_the_term_in_y_has_the_wrong_sign():
    """Off the axis the pull weakens while (4-9) can only strengthen it, the offset being negative."""
    x = places(0.03)
    on, off = (unit_forces(0.09, 0.03, y)[1][np.abs(x) < 0.02] for y in (0.0, 0.03))
    assert np.all(off > on)
    with_y = fitted("2", 0.09, 0.03, 5e-3, 1, np.array([0.0, 0.01, 0.02, 0.03]))
    assert with_y.rms > 1.5 * added_errors(0.09, 0.03)[0].rms

"""S9, S10: bands of the fitted constants, and the error of summed formulas."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.planar import read_planar_device, solve_planar
from fieldmap.thesis import planar_force, spatial_force
from fieldmap.thesis.force_formulas import HorizontalForce
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
from tests.computed_parts import assert_drawn, computed, numbers

LINE = (0.125,)


def row(name):
    return {n.name: n for n in numbers(name)}


@pytest.mark.parametrize(("name", "band"), [("L0", 0.2), ("b", 0.2), ("c", 0.1)])
def test_constants_of_table_4_2(name, band):
    assert abs(row("S9")[name].deviation) < band


@pytest.mark.parametrize("factor", [2.0, 0.1])
def test_constants_follow_the_nominal_current(factor):
    """The iron is linear: -L0 I^2 / (2 b ...) + c and the errors are proportional to I; b is a length."""
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
    """Independent finite elements give -33 mm; arithmetic on the printed constants gives +0.79 mm."""
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
    """The lift at 1e6 A with A-3's curve over the lift of linear iron is negative (67 T in the plate)."""
    words = next(text for text in row("S9")["equilibrium"].assumptions if "B-H curve" in text)
    assert float(words.split(" times")[0].split()[-1]) == pytest.approx(-1.26, abs=0.02)


def test_absolute_errors_grow_with_a_second_magnet_and_relative_ones_do_not():
    fit = horizontal_fit(LINE, 0.22).formula
    one, equal, unequal = (superposition_error(fit, pair, LINE) for pair in ((1, 0), (1, 1), (1.5, 0.5)))
    assert one.rms < equal.rms < unequal.rms < 1.6 * one.rms
    assert max(equal.whole, unequal.whole) < one.whole < 0.2
    # With one magnet the error in the middle is already two thirds of the force.
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
    """Off the axis the attraction weakens, but (4-9) can only strengthen it, because the offset is negative."""
    x = places(0.03)
    on, off = (unit_forces(0.09, 0.03, y)[1][np.abs(x) < 0.02] for y in (0.0, 0.03))
    assert np.all(off > on)
    with_y = fitted("2", 0.09, 0.03, 5e-3, 1, np.array([0.0, 0.01, 0.02, 0.03]))
    assert with_y.rms > 1.5 * added_errors(0.09, 0.03)[0].rms


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def of_left(x, z, currents=(1.0, 0.0)):
    """Horizontal and vertical force, N: moment of Table 4-1's magnet times the gradient of the field at 1e6 A."""
    solved = planar_force.unit()
    gradient = solved.gradient(np.column_stack([x, -z]), 1e6 * np.array(currents))
    return 0.015625 * gradient[:, 1, 0], 0.015625 * gradient[:, 1, 1]


def test_what_is_said_of_the_constants():
    """Errors of (4-7) on the line 125 mm deep, at 61 places within 150 mm, with our constants and Table 4-2's."""
    inputs = read_part("S9_constants").inputs
    answers = constants(inputs)
    x = np.linspace(-0.15, 0.15, 61)
    z, (exact, _) = np.full(61, 0.125), of_left(x, np.full(61, 0.125))
    printed = HorizontalForce(-2e-13, 0.22, 0.05, -0.08, x0=-0.17, nominal_current=1e6)
    ours = HorizontalForce(
        *(answers.numbers["L0"].value, 0.22), *(answers.numbers[name].value for name in "bc"), -0.17, 1e6
    )
    facts = {
        "half_width_mm": 150.0,
        "rms_N": rms(ours(x, z, 1e6) - exact),
        "printed_rms_N": rms(printed(x, z, 1e6) - exact),
    }
    assert answers.facts == pytest.approx(facts, rel=1e-6)
    x = np.linspace(-0.15, 0.15, 200)
    z = np.full(200, 0.125)
    for figure, pair, title in zip(
        answers.curves, ((1.0, 0.0), (1.5, 0.5)), ("4-5: left", "4-7: currents 3:1"), strict=True
    ):
        assert figure.title.startswith(f"Fig. {title}")
        assert figure.remark == "125 mm below the pole piece."
        lines = [("computed", "ours", 1e3 * x, of_left(x, z, pair)[0])]
        for name, kind, one in (("our constants", "ours", ours), ("Table 4-2", "published", printed)):
            y = one(x, z, 1e6 * pair[0]) + one.mirrored()(x, z, 1e6 * pair[1])
            lines.append((f"(4-7), {name}", kind, 1e3 * x, y))
        assert_drawn(figure, ("x (mm)", "$F_x$ (N)"), lines)
        size = np.ptp(lines[0][3])
        off = [100 * np.abs(line[3] - lines[0][3]).max() / size for line in lines[1:]]
        assert [float(one) for one in re.findall(r"([\d.]+) %", figure.message)] == pytest.approx(
            off, rel=0.05
        )


@pytest.mark.parametrize(("ratio", "depth_mm"), [(3.0, 125.0), (2.0, 110.0)])
def test_what_is_said_of_two_magnets(ratio, depth_mm, monkeypatch):
    """Places without force; errors with one magnet, with two at 1:1 and at the ratio; the lift in saturating iron of
    A-3's steel relative to linear iron, with a stand-in that lifts 2 T/m."""
    asked = []
    steel = read_device("drive_unit_a3").materials["steel"].to_dict()

    def saturating(device, amperes):
        asked.append((device.materials["iron"].to_dict() == steel, tuple(amperes)))
        lift = {-1e-3 * depth_mm: 2.0}
        return SimpleNamespace(gradient=lambda at: np.array([[[9.0, 9.0], [9.0, lift[at[0][1]]]]]))

    monkeypatch.setattr(planar_force.planar, "solve_planar_state", saturating)
    answers = planar_force.superposition({"ratio": ratio, "depth_mm": depth_mm, "a_m": 0.3})
    pair, depth = (0.5 * ratio, 0.5), 1e-3 * depth_mm
    at = 1e-3 * answers.numbers["equilibrium"].value + np.array([-1e-4, 0.0, 1e-4])
    beside, middle, other = of_left(at, np.full(3, depth), pair)[0]
    assert abs(middle) < 1e-5 * abs(other - beside)
    assert asked == [(True, pytest.approx(1e6 * np.array(pair)))]
    fit = horizontal_fit((depth,), 0.3).formula
    place = 1e-3 * answers.numbers["equilibrium_of_refitted"].value
    left, right = fit(place, depth, 1e6 * pair[0]), fit.mirrored()(place, depth, 1e6 * pair[1])
    assert left + right == pytest.approx(0.0, abs=1e-9 * abs(left))
    lift = of_left(np.zeros(1), np.full(1, depth), pair)[1][0] / 0.015625
    assert answers.facts["saturating_share"] == pytest.approx(2.0 / lift)
    upright = vertical_fit().formula
    for name, formula, depths, axis in (("horizontal", fit, (depth,), 0), ("vertical", upright, DEPTHS, 1)):
        x, z = (one.ravel() for one in np.meshgrid(np.linspace(-0.15, 0.15, 61), depths))
        for error, currents in zip(answers.facts[name], ((1.0, 0.0), (1.0, 1.0), pair), strict=True):
            exact = of_left(x, z, currents)[axis]
            sides = [
                one(x, z, 1e6 * i) for one, i in zip((formula, formula.mirrored()), currents, strict=True)
            ]
            off, near = sum(sides) - exact, np.abs(x) <= 0.05
            found = (error.rms, error.whole, error.middle)
            assert found == pytest.approx(
                (rms(off), rms(off) / rms(exact), rms(off[near]) / rms(exact[near])), rel=1e-9
            )


def test_figures_of_the_vertical_force():
    """Over the depth below the middle; slope and intercept over x of lines over depth; (4-4), (4-6) with our values."""
    formula = vertical_fit().formula
    few, depths, x = (
        np.linspace(0.1, 0.15, 40),
        np.array([0.1, 0.11, 0.12, 0.13, 0.14, 0.15]),
        np.linspace(-0.15, 0.15, 31),
    )
    alone = of_left(np.zeros(40), few)[1]
    line = np.polynomial.Polynomial.fit(few, alone, 1)(few)
    ours = ("computed", "a line through it", "(4-3) with (4-4), our constants")
    one, slope, intercept, two = computed("S9_superposition").curves
    down = ("depth below the pole piece (mm)", "$F_z$ (N)")
    values = (alone, line, formula(np.zeros(40), few, 1e6))
    assert_drawn(one, down, [(name, "ours", 1e3 * few, y) for name, y in zip(ours, values, strict=True)])
    fits = np.array([np.polyfit(depths, of_left(np.full(6, at), depths)[1], 1) for at in x]).T
    for figure, label, y, part in (
        (slope, "slope m (N/m)", fits[0], formula.slope), (intercept, "intercept b (N)", fits[1], formula.intercept),
    ):  # fmt: skip
        lines = [
            ("lines through the computed force", "ours", 1e3 * x, y),
            ("(4-4), our constants", "ours", 1e3 * x, part(x)),
        ]
        assert_drawn(figure, ("x (mm)", label), lines)
    assert [figure.title.split(":")[0] for figure in (one, slope, intercept, two)] == [
        f"Fig. 4-{k}" for k in (2, 3, 4, 6)
    ]
    z = np.linspace(0.1, 0.15, 100)
    both = sum(side(np.zeros(100), z, 1e6) for side in (formula, formula.mirrored()))
    exact = of_left(np.zeros(100), z, (1.0, 1.0))[1]
    assert_drawn(
        two, down, [("computed", "ours", 1e3 * z, exact), ("(4-6), our constants", "ours", 1e3 * z, both)]
    )


def of_coils(x, depth, y=0.0):
    """F_x (coils, n), N, at 1 A in one coil of A-3's unit at a time."""
    solved = spatial_force.unit()
    slopes = solved.unit_fields(np.column_stack([x, np.full_like(x, y), np.full_like(x, -depth)]))[1]
    return read_device("drive_unit_a3").payload.moment * slopes[:, :, 2, 0]


@pytest.mark.parametrize(
    ("depth_mm", "half_mm", "a_m", "y_mm"),
    [(90, 30, (5e-3, 2.2e-2), (-10.0, 0.0, 10.0, 20.0, 30.0)), (95, 24, (6e-3, 2e-2), (0.0, 15.0))],
)
def test_figures_and_facts_in_three_dimensions(depth_mm, half_mm, a_m, y_mm):
    """Table 4-3 with our constants. Electromagnets 1 and 4 of Fig. 4-8 are coils 2 and 5."""
    inputs = {"depth_mm": float(depth_mm), "half_width_mm": float(half_mm)}
    answers = spatial_force.constants(inputs | {"a_m": np.array(a_m), "y_mm": np.array(y_mm)})
    depth, half, ys = 1e-3 * depth_mm, 1e-3 * half_mm, 1e-3 * np.array(y_mm)
    x, numbers = np.linspace(-half, half, half_mm + 1), answers.numbers
    exact = of_coils(x, depth)
    fits = [
        HorizontalForce(numbers["L0"][k], a, numbers["b"][k], numbers["c"][k], side=side)
        for k, (a, side) in enumerate(zip(a_m, (1, -1), strict=True))
    ]
    off = [fit(x, depth, 1.0) - exact[k] for fit, k in zip(fits, (1, 4), strict=True)]
    facts = answers.facts
    assert facts["rms_mN"] == pytest.approx([1e3 * rms(one) for one in off], rel=1e-6)
    assert (facts["device"], facts["mu_r"], facts["refinement"]) == ("drive_unit_a3", 4000.0, 0.4)
    # The formula with its term in |y|, fitted to all lines at once.
    plane = fitted("2", depth, half, a_m[0], 1, ys)
    lines = np.concatenate([of_coils(x, depth, y)[1] for y in ys])
    shape = plane.formula(np.tile(x, len(ys)), depth, 1.0, np.repeat(ys, len(x)))
    assert facts["plane_rms_mN"] == pytest.approx(1e3 * rms(shape - lines), rel=1e-6)
    assert numbers["d"] == pytest.approx(plane.formula.d)
    assert plane.formula.a == a_m[0]
    labels = ("x (mm)", "$F_x$ (mN)")
    axis, beside, two, six = answers.curves
    drawn = []
    for name, k, fit in (("1", 1, fits[0]), ("4", 4, fits[1])):
        drawn += [(f"electromagnet {name}", "ours", 1e3 * x, 1e3 * exact[k])]
        drawn += [(f"(4-9) fitted to {name}", "ours", 1e3 * x, 1e3 * fit(x, depth, 1.0))]
    assert_drawn(axis, labels, drawn)
    drawn = [
        (f"y = {mm} mm", "ours", 1e3 * x, 1e3 * of_coils(x, depth, 1e-3 * mm)[1]) for mm in (10, 20, 30, -10)
    ]
    drawn.append(("(4-9) fitted", "ours", 1e3 * x, 1e3 * plane.formula(x, depth, 1.0, 0.01)))
    assert_drawn(beside, labels, drawn)
    assert [one.title.rpartition(", ")[2] for one in (axis, beside)] == [f"{depth_mm} mm deep"] * 2
    # For each coil a least-squares parabola, and (4-9) with its pole on the side with the better fit.
    parabolas = np.array([np.polynomial.Polynomial.fit(x, line, 2)(x) for line in exact])
    better = np.array([min((fitted(name, depth, half, 2.2e-2, side) for side in (1, -1)), key=lambda one: one.rms)
                       .formula(x, depth, 1.0) for name in spatial_force.unit().coil_names])  # fmt: skip
    near = np.abs(x) < 0.0101
    for figure, rows in ((two, [1, 4]), (six, [*range(6)])):
        drawn = [("computed", "ours", 1e3 * x, 1e3 * exact[rows].sum(axis=0))]
        for name, one in (("(4-9)", better), ("quadratic (4-10)", parabolas)):
            drawn.append((f"{name} fitted and added", "ours", 1e3 * x, 1e3 * one[rows].sum(axis=0)))
        assert_drawn(figure, labels, drawn)
    for name, one in (("formula", better), ("quadratic", parabolas)):
        for error, rows in zip(facts[name], ([1], [1, 4], [*range(6)]), strict=True):
            total = exact[rows].sum(axis=0)
            off = one[rows].sum(axis=0) - total
            found = (len(error.currents), error.rms, error.whole, error.middle)
            assert found == pytest.approx(
                (len(rows), rms(off), rms(off) / rms(total), rms(off[near]) / rms(total[near]))
            )


@pytest.mark.parametrize(("half_width", "count"), [(0.03, 31), (0.0301, 33), (0.002, 3)])
def test_places_are_2_mm_apart_or_a_little_less(half_width, count):
    np.testing.assert_allclose(places(half_width), np.linspace(-half_width, half_width, count))

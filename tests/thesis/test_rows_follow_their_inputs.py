"""Rows of S14 that follow the static curve: each number, figure and fact depends on its own n, height and h. A
stand-in whose shift contains all its arguments replaces the curve."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import divide_currents
from fieldmap.errors import OutsideMapError
from fieldmap.thesis import detail, equilibrium_shift
from tests.computed_parts import assert_drawn

SIGNALS = np.array([0.1, 0.2, 0.4])
X_OVER_SIGNAL = ("x control signal", "x (mm)")
CURVE = equilibrium_shift.curve


def told(field_map, signals, axis="x", n=1.25, z_s=10.0, h=15.0, rule="held"):
    """A shift of 1 m per unit signal at n = 1, whose lower digits are z_s, h and the rule."""
    size = n + 1e-2 * z_s + 1e-4 * h + 1e-6 * (rule == "held") + 1e-7 * (axis == "y")
    signals = np.asarray(signals, float)
    return SimpleNamespace(along=size * signals, largest=10 * size * signals)


@pytest.fixture(autouse=True)
def _stand_in(monkeypatch):
    monkeypatch.setattr(equilibrium_shift, "curve", told)


def test_table_6_2():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "zero_mm": -0.088, "z_mm": 11.0}
    inputs |= {f"{name}_signals": SIGNALS for name in ("n125", "n150")}
    inputs |= {"n125_measured_mm": 10 * SIGNALS, "n150_measured_mm": 20 * SIGNALS}
    answers = equilibrium_shift.n_table(inputs)
    numbers, curves = answers.numbers, iter(answers.curves)
    for name, n in (("n125", 1.25), ("n150", 1.5)):
        for rule, digit in (("held", 1e-6), ("constant", 0.0)):
            for k, h in enumerate((15.0, 25.0)):
                exact = -0.088 + 1e3 * SIGNALS * (n + 0.11 + 1e-4 * h + digit)
                np.testing.assert_allclose(numbers[f"{name}_{rule}"][k], exact, rtol=1e-12)
            figure, places = next(curves), numbers[f"{name}_{rule}"]
            level = {"held": "held by the lift", "constant": "of (7-18) at the origin throughout"}[rule]
            assert figure.title == f"Table 6-2, n = {n}, level {level}: scan over h"
            lines = [(f"h = {h} mm", "ours", SIGNALS, x) for h, x in zip((15, 25), places, strict=True)]
            points = ("measured, Table 6-2", "measured", SIGNALS, {1.25: 10, 1.5: 20}[n] * SIGNALS)
            assert_drawn(figure, X_OVER_SIGNAL, [points, *lines])


def test_table_6_3():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "zero_mm": -0.088, "signals": SIGNALS}
    inputs |= {"heights_mm": [10.0, 11.5], "upper_mm": 10 * SIGNALS, "lower_mm": 20 * SIGNALS}
    answers = equilibrium_shift.height_table(inputs)
    numbers = answers.numbers
    points = [
        (f"measured, z_s = {z} mm", "measured", SIGNALS, k * SIGNALS) for z, k in (("10", 10), ("11.5", 20))
    ]
    for figure, words, digit in zip(
        answers.curves, ("held by the lift", "constant"), (1e-6, 0.0), strict=True
    ):
        assert figure.title == f"Table 6-3, h = 15 mm, level {words}"
        sizes = {"10": 1.25 + 0.1 + 15e-4 + digit, "11.5": 1.25 + 0.115 + 15e-4 + digit}
        lines = [
            (f"ours, z_s = {z} mm", "ours", SIGNALS, -0.088 + 1e3 * k * SIGNALS) for z, k in sizes.items()
        ]
        assert_drawn(figure, X_OVER_SIGNAL, points + lines)
    for rule, digit in (("held", 1e-6), ("constant", 0.0)):
        for k, h in enumerate((15.0, 25.0)):
            lower = -0.088 + 1e3 * SIGNALS * (1.25 + 0.115 + 1e-4 * h + digit)
            np.testing.assert_allclose(numbers[f"lower_{rule}"][k], lower, rtol=1e-12)
            # The positions at 10 mm less those at 11.5 mm, at the last signal.
            np.testing.assert_allclose(numbers[f"further_{rule}"][k], 1e3 * 0.4 * -0.015, rtol=1e-9)


def test_signal_at_the_limit_of_the_amplifier():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "current_limit_A": 3.6}
    inputs |= {"n125_signals": SIGNALS, "n150_signals": 1.5 * SIGNALS}
    answers = equilibrium_shift.limits(inputs)
    numbers, (figure,) = answers.numbers, answers.curves
    assert figure.title == "Largest coil current while the lift is held, z_s = 10 mm, h = 25 mm"
    lines = [
        (f"n = {n}", "ours", k * SIGNALS, 10 * (n + 0.1 + 25e-4 + 1e-6) * k * SIGNALS)
        for n, k in ((1.25, 1.0), (1.5, 1.5))
    ]
    limit = ("limit of the amplifier", "published", [0.0, 0.6], [3.6, 3.6])
    assert_drawn(figure, (X_OVER_SIGNAL[0], "current (A)"), [*lines, limit])
    for name, n in (("n125", 1.25), ("n150", 1.5)):
        exact = [3.6 / (10 * (n + 0.1 + 1e-4 * h + 1e-6)) for h in (15.0, 25.0)]
        np.testing.assert_allclose(numbers[f"{name}_last_signal"], exact, rtol=1e-9)


@pytest.mark.parametrize(("axis", "digit"), [("x", 0.0), ("y", 1e-7)])
def test_branches_of_one_axis_at_their_height(axis, digit):
    out = np.array([0.5, 1.0, 2.0])
    inputs = {"map": None, "z_mm": 12.0, "axis": axis, "figure": "Figure"}
    for side in ("positive", "negative"):
        inputs |= {f"{side}_signals": np.array([0.0, 0.1, 0.2]) * (1 if side == "positive" else -1)}
        inputs |= {f"{side}_outward_mm": out, f"{side}_back_mm": out - [4.5, 0.25, 0.0]}
    answers = equilibrium_shift.branches(inputs)
    numbers, (figure,) = answers.numbers, answers.curves
    assert figure.title == "Figure"
    names = ("ours, lift held", "ours, mean current held", "measured, outward", "measured, on the way back")
    expected = []
    for side in ("positive", "negative"):
        drawn = [numbers[f"{side}_outward_{rule}"] for rule in ("held", "constant")] + [
            inputs[f"{side}_{way}_mm"] for way in ("outward", "back")
        ]
        expected += [
            (name, kind, inputs[f"{side}_signals"], y)
            for name, kind, y in zip(names, ("ours",) * 2 + ("measured",) * 2, drawn, strict=True)
        ]
        np.testing.assert_array_equal(numbers[f"{side}_back_held"], numbers[f"{side}_outward_held"])
    assert_drawn(figure, (f"{axis} control signal", f"{axis} (mm)"), expected)
    # The measured magnet moves 1.5 mm outward, and is at most 4.5 mm lower on the way back. The model moves 274 mm.
    off = np.abs(
        [1e3 * sign * 0.2 * (1.25 + 0.12 + 15e-4 + 1e-6 + digit) + 0.5 - 2.0 for sign in (1, -1)]
    ).max()
    words = re.findall(r"-?\d[\d.]*", figure.message)
    assert (words[0], words[-1]) == ("2", "4.5")
    # In per cent of the 1.5 mm, to two digits.
    assert float(words[1]) == pytest.approx(100 * off / 1.5, rel=0.03)
    for side, sign in (("positive", 1.0), ("negative", -1.0)):
        for rule, more in (("held", 1e-6), ("constant", 0.0)):
            size = 1.25 + 0.12 + 1e-4 * 15.0 + more + digit
            exact = 0.5 + 1e3 * size * sign * np.array([0.0, 0.1, 0.2])
            np.testing.assert_allclose(numbers[f"{side}_outward_{rule}"], exact, rtol=1e-12)


def test_fits_of_a_straight_curve():
    """Our polynomial is a line with the stand-in's slope; the fit to the table returns the printed polynomial; the
    signal for a step of 1 mm."""
    polynomial = np.array([90.0, -70.0, 30.0, 12.0, 0.3])
    signals = np.linspace(0.0, 0.4, 9)
    inputs = {"map": None}
    for axis, signal in (("x", 0.07), ("y", 0.11)):
        inputs |= {f"{axis}_signals": signals, f"{axis}_mm": np.polyval(polynomial, signals)}
        inputs |= {f"{axis}_polynomial": polynomial, f"{axis}_step_signal": signal}
    answers = equilibrium_shift.fits(inputs)
    numbers, fine = answers.numbers, np.linspace(0.0, 0.4, 81)
    for axis, signal, digit, figure in zip("xy", (0.07, 0.11), (0.0, 1e-7), answers.curves, strict=True):
        assert figure.title == f"({'6-4' if axis == 'x' else '6-5'}) and the same fit to ours"
        lines = [
            (f"measured, {axis}", "measured", signals, np.polyval(polynomial, signals)),
            (f"printed polynomial, {axis}", "published", fine, np.polyval(polynomial, fine)),
            (f"ours, {axis}", "ours", fine, np.polyval(numbers[f"{axis}_polynomial"], fine)),
        ]
        assert_drawn(figure, ("control signal", "position (mm)"), lines)
        slope = 1e3 * (1.25 + 0.1 + 15e-4 + 1e-6 + digit)
        assert numbers[f"{axis}_polynomial"] == pytest.approx([0, 0, 0, slope, 0.3], abs=1e-6)
        assert numbers[f"{axis}_table_again"] == pytest.approx(polynomial, rel=1e-8)
        assert numbers[f"{axis}_at_step"] == pytest.approx(np.polyval(polynomial, signal), rel=1e-12)
        assert numbers[f"{axis}_step_signal"] == pytest.approx(1.0 / slope, rel=1e-8)


def test_shift_rows_at_their_height(monkeypatch):
    """Of the shift itself: the stand-in's result contains field, height and magnet model."""
    asked = []

    def shift(fields, signals, h, z_s, rule="held", moment="fixed", lever=0.0, level=0.0):
        asked.append((moment, lever, rule))
        along = (1e-2 * z_s + 1e-4 * h + lever + len(moment) + fields[0] + level) * np.asarray(signals)
        return SimpleNamespace(along=along, origin=np.array([1e-3 * len(fields), 0.0]))

    monkeypatch.setattr(equilibrium_shift, "shift", shift)
    monkeypatch.setattr(equilibrium_shift, "unit_rays", lambda: 0.1)
    monkeypatch.setattr(equilibrium_shift, "UnitRays", lambda states: states)
    monkeypatch.setattr(equilibrium_shift, "finer_unit", lambda: 0.3)
    stiffness = np.array([[3.0, 2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, -5.0]])
    point = SimpleNamespace(kind="saddle", stiffness=stiffness, trace=-0.5)
    rest = SimpleNamespace(points=[point, point], boundary_index=7)

    def stationary_points(field, currents, payload, height):
        # (7-18) at 12 mm; the magnet is 15 mm below the sensed point, whose zero is 77 mm below the disk.
        assert (field, height) == (0.6, pytest.approx(-0.104))
        np.testing.assert_allclose(currents, np.full(6, 1.215 + 0.0343 * 12))
        return rest

    monkeypatch.setattr(equilibrium_shift, "stationary_points", stationary_points)
    inputs = {"map": 0.6, "signals": SIGNALS, "z_mm": 12.0, "zero_mm": -0.4, "measured_mm": 9 * SIGNALS}
    answers = equilibrium_shift.convergence(inputs)
    sizes = np.array([0.1, 0.3, 0.6]) + 0.12 + 15e-4 + 5
    assert answers.numbers["constant"] == pytest.approx(1e3 * (np.outer(sizes, SIGNALS) + 1e-3), rel=1e-12)
    assert {rule for *_, rule in asked} == {"constant"}
    # At the last signal, 0.4.
    facts = {"refinement": 1.3, "mesh_mm": 1e3 * 0.2 * 0.4, "map_mm": 1e3 * 0.5 * 0.4, "drawn_h_mm": 15.0}
    assert answers.facts == pytest.approx(facts)
    asked.clear()
    answers = equilibrium_shift.magnet_models(inputs)
    sizes = [0.6 + 0.12 + 15e-4 + lever + len(moment) for moment, lever, _ in asked]
    places = -0.4 + 1e3 * np.outer(sizes, SIGNALS)
    assert answers.numbers["x"].value == pytest.approx(places, rel=1e-12)
    assert " 5 mm" in " ".join(answers.numbers["x"].assumptions)
    assert [lever for _, lever, _ in asked] == [0.0, 0.0, 0.0, 0.0, 5e-3]
    names = ("fixed", "aligned", "rigid upright", "rigid", "rigid, lever 5 mm")
    lines = [(name, "ours", SIGNALS, x) for name, x in zip(names, places, strict=True)]
    assert_drawn(answers.curves[0], X_OVER_SIGNAL, [("measured", "measured", SIGNALS, 9 * SIGNALS), *lines])
    facts = dict(answers.facts)
    # Eigenvalues of the symmetric part: 3 -+ 1 and -5.
    assert facts.pop("eigenvalues") == pytest.approx([-5.0, 2.0, 4.0])
    assert facts.pop("current_A") == pytest.approx(1.215 + 0.0343 * 12.0, rel=1e-12)
    assert facts == {
        "models": "; ".join(names), "drawn_h_mm": 15.0, "points": 2, "kind": "saddle", "turns": 7, "trace": 0.5,
    }  # fmt: skip
    monkeypatch.setattr(
        equilibrium_shift, "lift_share", lambda field, z, h, level: field + z + 10 * h + 100 * level
    )
    answers = equilibrium_shift.own_current(inputs | {"level_A": 3.0})
    size = 0.1 + 0.12 + 15e-4 + 5 + 3
    assert answers.numbers["x"] == pytest.approx(-0.4 + 1e3 * size * SIGNALS, rel=1e-12)
    assert asked[-1] == ("fixed", 0.0, "constant")
    # Relative to the curve at the measured current, 1.558 A, at 10 mm.
    assert answers.facts.pop("ratio") == pytest.approx((1.25 + 0.1 + 15e-4) / np.full(3, size))
    facts = {"share": 0.1 + 12 + 150 + 300, "measured_level_A": 1.558, "drawn_h_mm": 15.0}
    assert answers.facts == pytest.approx(facts)


def test_where_a_curve_is_taken_from(monkeypatch):
    """The map is used for its own n only, otherwise solved states; by default at 10 mm, h = 15 mm, with held lift."""
    asked = []
    monkeypatch.setattr(equilibrium_shift, "_curve", lambda *given: asked.append(given))
    monkeypatch.setattr(equilibrium_shift, "unit_rays", lambda: "rays")
    CURVE("map", SIGNALS)
    CURVE("map", SIGNALS, "y", 1.5, 11.0, 20.0, "constant")
    signals = tuple(SIGNALS)
    assert asked == [
        (("map", "rays"), signals, "x", 1.25, 10.0, 15.0, "held"),
        (("rays",), signals, "y", 1.5, 11.0, 20.0, "constant"),
    ]


def test_fields_in_their_order_of_preference(monkeypatch):
    """The first field is left for a signal of 0.2, outside its currents, and beyond 0.34. The stand-in lifts 2 N at the
    origin, moves 3 m per unit signal along y and 1 m along x, and raises the level at each step."""
    asked = []

    def equilibrium_at(field, payload, path, place, level, held, scale, moment, lever):
        currents, height = path(level)
        signal = round(currents[2] / level - 1, 6)
        asked.append((field, signal, held, scale, moment, lever, height, tuple(place)))
        if field == "map" and 0.25 > signal > 0.1:
            raise OutsideMapError
        kind = "stable" if signal < 0.4 else "saddle" if signal < 0.6 else "unstable"
        position = np.array([0.2 + signal, 3 * signal, -0.1])
        return SimpleNamespace(lift=2.0, position=position, kind=kind), level + 0.1

    monkeypatch.setattr(equilibrium_shift.levitation, "equilibrium_at", equilibrium_at)
    monkeypatch.setattr(equilibrium_shift, "payload", lambda: SimpleNamespace(mass=0.02))
    monkeypatch.setattr(
        equilibrium_shift,
        "divided",
        lambda level, s, axis, n: level * (1 + s * np.array([1, 0, 1, -2, 0, 0])),
    )
    found = equilibrium_shift.shift(("map", "states"), [0.1, 0.2, 0.3, 0.34, 0.36])
    fields = ["map", "map", "map", "states", "map", "map", "states"]
    assert [one[:2] for one in asked] == list(zip(fields, (0.0, 0.1, 0.2, 0.2, 0.3, 0.34, 0.36), strict=True))
    # The lift is held except at the origin, where it is scaled to the weight; the same model and height throughout.
    weight = 0.02 * 9.80665 / 2.0
    assert [one[2:4] for one in asked] == [(False, 1.0)] + [(True, pytest.approx(weight))] * 6
    assert {one[4:6] for one in asked} == {("fixed", 0.0)}
    assert {round(one[6], 9) for one in asked} == {-0.102}
    assert asked[1][7] == pytest.approx((0.2, 0.0))
    assert asked[4][7] == pytest.approx((0.4, 0.6))
    np.testing.assert_allclose(found.along, 3 * np.array([0.1, 0.2, 0.3, 0.34, 0.36]))
    np.testing.assert_allclose(found.origin, [0.2, 0.0])
    # From 1.558 A; each search starts at the previous level, and the largest current is of coil 3 or 4.
    levels = 1.558 + 0.1 * np.arange(2, 7)
    np.testing.assert_allclose(found.levels, levels)
    np.testing.assert_allclose(found.largest, levels * (1 + np.array([0.1, 0.2, 0.3, 0.34, 0.36])))
    assert found.all_stable
    assert not equilibrium_shift.shift(("states",), [0.1, 0.5]).all_stable
    assert not equilibrium_shift.shift(("states",), [0.7]).all_stable
    asked.clear()
    equilibrium_shift.shift(("map", "states"), [-0.3, -0.36], rule="held")
    equilibrium_shift.shift(("map", "states"), [-0.3], rule="constant", level=2.0, moment="rigid", lever=0.5)
    assert [(one[0], one[2]) for one in asked] == [
        ("map", False), ("map", True), ("states", True), ("map", False), ("map", False),
    ]  # fmt: skip
    assert asked[-1][3:6] == (pytest.approx(weight), "rigid", 0.5)
    with pytest.raises(OutsideMapError):
        equilibrium_shift.shift(("map",), [0.2])


def test_sensitivity_is_asked_for_at_the_origin(monkeypatch):
    def stationary_points(field, currents, payload, height, samples):
        assert (field, tuple(currents), payload) == ("states", (pytest.approx(1.558),) * 6, "payload")
        assert (round(height, 9), samples) == (-0.102, 10)
        return SimpleNamespace(points=[SimpleNamespace(position="place")])

    def sensitivity(field, currents, payload, position, step):
        assert tuple(currents) == (pytest.approx(1.558),) * 6
        return field, payload, position, step

    monkeypatch.setattr(equilibrium_shift, "unit_states", lambda: "states")
    monkeypatch.setattr(equilibrium_shift, "payload", lambda: "payload")
    monkeypatch.setattr(equilibrium_shift, "stationary_points", stationary_points)
    monkeypatch.setattr(equilibrium_shift.levitation, "equilibrium_sensitivity", sensitivity)
    found = equilibrium_shift.sensitivity_at_origin.__wrapped__()
    assert found == ("states", "payload", "place", 0.035)  # A: the mean deviation of Table 3-10


def test_calibrations_name_what_is_fitted_to_what(monkeypatch):
    """Lifts 0.5, 0.6, 0.7 at the depths; 2 mm along x and 3 mm along y at each signal; other factors in each fit."""
    fitted, every = [], []
    shares = np.array([0.5, 0.6, 0.7])

    def calibrate(field, payload, lift, positions, fit, limits=None, given=None):
        assert (field, payload) == ("map", "payload")
        np.testing.assert_allclose(lift.sensed, [-0.077, -0.087, -0.097])
        np.testing.assert_allclose(lift.currents, np.outer([1.215, 1.558, 1.901], np.ones(6)))
        assert lift.deviation == 0.03
        if positions is not None:
            assert (positions.deviation, positions.height_held, positions.from_first) == (
                pytest.approx(4e-4),
                True,
                True,
            )
            np.testing.assert_allclose(positions.sensed, np.full(len(positions.places), -0.087))
        if given is not None:
            every.append((given["field_scale"], fit))
            check_places(positions, "xy")
            # The two points of signal 0 are not used.
            before = [*shares, 99.0, 99.0, 2e-3, 2e-3, 3e-3, 3e-3]
            return SimpleNamespace(table=[SimpleNamespace(before=one) for one in before])
        assert limits == {"magnet_offset": (5e-3, 30e-3)}
        fitted.append((fit, positions))
        k = len(fitted)
        values = {"field_scale": 2.0 + k, "magnet_offset": 0.01 + 1e-3 * k, "current_scale": 1 + 0.1 * k}
        return SimpleNamespace(
            values=values, deviations=dict.fromkeys(values, 0.5), fitted=fit, assumptions=("all",), misfit=1.25,
            misfit_before=22.5,
        )  # fmt: skip

    def check_places(positions, axes):
        """Signals 0.1 and 0.2 of each axis, (6-3) with n = 1.25: shifts of 1 and 3 mm along x, -2 and -4 mm along y."""
        rows, currents = [[0.0, 0.0]], [np.full(6, 1.558)]
        for axis in axes:
            for signal, way in ((0.1, {"x": 1e-3, "y": -2e-3}[axis]), (0.2, {"x": 3e-3, "y": -4e-3}[axis])):
                rows.append([way, np.nan] if axis == "x" else [np.nan, way])
                currents.append(
                    divide_currents(1.558, *((signal, 0.0) if axis == "x" else (0.0, signal)), 1.25)
                )
        np.testing.assert_allclose(positions.places, rows)
        np.testing.assert_allclose(positions.currents, currents)

    monkeypatch.setattr(equilibrium_shift.levitation, "calibrate", calibrate)
    monkeypatch.setattr(equilibrium_shift, "payload", lambda: "payload")
    maps = {("division", "evaluate"): "map"}
    monkeypatch.setattr(detail, "available_map", lambda name, outside_currents: maps[name, outside_currents])
    depths, signals = np.array([0.0, 10.0, 20.0]), np.array([0.0, 0.1, 0.2])
    inputs = {"depths_mm": depths, "lift_deviation": 0.03, "position_deviation_mm": 0.4}
    inputs |= {"x_signals": signals, "y_signals": signals}
    inputs |= {"x_mm": np.array([0.5, 1.5, 3.5]), "y_mm": np.array([0.25, -1.75, -3.75])}
    answers = equilibrium_shift.calibrations(inputs)
    names = ("scale", "scale_and_h", "with_x", "with_x_and_y")
    free = (
        ("field_scale",),
        ("field_scale", "magnet_offset"),
        ("field_scale", "magnet_offset", "current_scale"),
    )
    assert [fit for fit, _ in fitted] == [*free, free[2]]
    assert fitted[0][1] is fitted[1][1] is None
    check_places(fitted[2][1], "x")
    check_places(fitted[3][1], "xy")
    assert every == [(3.0 + k, ("field_scale",)) for k in range(4)]
    x, y = [0.5, 2.5, 2.5], [0.25, 3.25, 3.25]
    for k, name in enumerate(names):
        values = {"current": [1.215 / 0.5, 1.558 / 0.6, 1.901 / 0.7], "x": x, "y": y}
        for of, value in values.items():
            found = answers.numbers[f"{of}_{name}"]
            np.testing.assert_allclose(found.value, value)
            said = found.assumptions
            assert (said[0], said[1].count("0.5"), said[1].count("=")) == (
                "all",
                len(fitted[k][0]),
                len(fitted[k][0]),
            )
            assert f"field_scale = {3 + k}" in said[1]
            assert re.findall(r"\d[\d.]*", said[2]) == ["1.25", "22.5", "3", "0.4"]
        assert re.findall(r"\d[\d.]*", answers.facts[name]) == [
            f"{3 + k}.00",
            f"{11 + k}.0",
            f"{1.1 + 0.1 * k:.2f}",
            "1.2",
        ]
    fits = [f"fit `{name}`" for name in names]
    lift = [
        ("measured, (7-18)", "measured", depths, np.ones(3)),
        *((name, "ours", depths, shares) for name in fits),
    ]
    assert_drawn(answers.curves[0], ("sensor depth z_s (mm)", "lift over weight"), lift)
    for axis, places, figure in zip("xy", (x, y), answers.curves[1:], strict=True):
        drawn = [("measured, rising", "measured", signals, inputs[f"{axis}_mm"])]
        drawn += [(name, "ours", signals, places) for name in fits]
        assert_drawn(figure, (f"{axis} control signal", f"{axis} (mm)"), drawn)


def test_noise_of_the_mean_deviation(monkeypatch):
    """A magnet that moves 3 mm/A along x and 4 mm/A along y, half as far with its lift held: standard deviations at
    0.02 A, and the current deviation that explains the RMS of both axes seen on the rig."""

    def noise(deviation, lift_held):
        return (deviation * (0.5 if lift_held else 1.0)) ** 2 * np.diag([3e-3, 4e-3]) ** 2

    moved = np.array([np.arange(1.0, 7.0), np.arange(-6.0, 0.0)])
    found = SimpleNamespace(noise=noise, at_held_height=1e-3 * moved)
    monkeypatch.setattr(equilibrium_shift, "sensitivity_at_origin", lambda: found)
    coils = SimpleNamespace(coil_names=tuple("123456"))
    monkeypatch.setattr(equilibrium_shift, "unit_states", lambda: coils)
    monkeypatch.setattr(equilibrium_shift, "payload", lambda: SimpleNamespace(mass=0.02))
    answers = equilibrium_shift.noise({"deviation_A": np.array([0.01, 0.03]), "seen_rms_mm": 0.01})
    assert answers.numbers["rms_height_held"] == pytest.approx([0.06, 0.08], rel=1e-12)
    assert answers.numbers["rms_lift_held"] == pytest.approx([0.03, 0.04], rel=1e-12)
    assert answers.facts["mean_deviation_A"] == pytest.approx(0.02)
    assert answers.facts["explained_mA"] == pytest.approx(20.0 * 0.01 / np.sqrt(0.00125), rel=1e-12)
    assert answers.facts["rms_mm"] == pytest.approx([0.03, 0.04])
    assert answers.facts["weight_mN"] == pytest.approx(20 * 9.80665)
    of_coils = [f"{k}: ({k:+.2f}, {k - 7:+.2f})" for k in range(1, 7)]
    assert answers.facts["per_coil"] == ", ".join(of_coils)
    assert answers.facts["drawn_h_mm"] == 15.0

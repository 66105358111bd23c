"""Rows of S14 that follow the static curve: each number is that of its own n, height and h, by a stand-in whose
shift tells with which arguments it was asked."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.thesis import equilibrium_shift

SIGNALS = np.array([0.1, 0.2, 0.4])


def told(field_map, signals, axis="x", n=1.25, z_s=10.0, h=15.0, rule="held"):
    """1 m of shift at signal 1 for n = 1, with digits of z_s, h and the rule below."""
    size = n + 1e-2 * z_s + 1e-4 * h + 1e-6 * (rule == "held") + 1e-7 * (axis == "y")
    signals = np.asarray(signals, float)
    return SimpleNamespace(along=size * signals, largest=10 * size * signals)


@pytest.fixture(autouse=True)
def _stand_in(monkeypatch):
    monkeypatch.setattr(equilibrium_shift, "curve", told)


def test_table_6_2():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "zero_mm": -0.088, "z_mm": 11.0}
    inputs |= {f"{name}_{what}": SIGNALS for name in ("n125", "n150") for what in ("signals", "measured_mm")}
    numbers = equilibrium_shift.n_table(inputs).numbers
    for name, n in (("n125", 1.25), ("n150", 1.5)):
        for rule, digit in (("held", 1e-6), ("constant", 0.0)):
            for k, h in enumerate((15.0, 25.0)):
                exact = -0.088 + 1e3 * SIGNALS * (n + 0.11 + 1e-4 * h + digit)
                np.testing.assert_allclose(numbers[f"{name}_{rule}"][k], exact, rtol=1e-12)


def test_table_6_3():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "zero_mm": -0.088, "signals": SIGNALS}
    inputs |= {"heights_mm": [10.0, 11.5], "upper_mm": SIGNALS, "lower_mm": SIGNALS}
    numbers = equilibrium_shift.height_table(inputs).numbers
    for rule, digit in (("held", 1e-6), ("constant", 0.0)):
        for k, h in enumerate((15.0, 25.0)):
            lower = -0.088 + 1e3 * SIGNALS * (1.25 + 0.115 + 1e-4 * h + digit)
            np.testing.assert_allclose(numbers[f"lower_{rule}"][k], lower, rtol=1e-12)
            # 10 mm less 11.5 mm, at the last signal.
            np.testing.assert_allclose(numbers[f"further_{rule}"][k], 1e3 * 0.4 * -0.015, rtol=1e-9)


def test_signal_at_the_limit_of_the_amplifier():
    inputs = {"map": None, "offsets_mm": [15.0, 25.0], "current_limit_A": 3.6}
    inputs |= {"n125_signals": SIGNALS, "n150_signals": SIGNALS}
    numbers = equilibrium_shift.limits(inputs).numbers
    for name, n in (("n125", 1.25), ("n150", 1.5)):
        exact = [3.6 / (10 * (n + 0.1 + 1e-4 * h + 1e-6)) for h in (15.0, 25.0)]
        np.testing.assert_allclose(numbers[f"{name}_last_signal"], exact, rtol=1e-9)


@pytest.mark.parametrize(("axis", "digit"), [("x", 0.0), ("y", 1e-7)])
def test_branches_of_one_axis_at_their_height(axis, digit):
    out = np.array([0.5, 1.0, 2.0])
    inputs = {"map": None, "z_mm": 12.0, "axis": axis, "figure": "Figure"}
    for side in ("positive", "negative"):
        inputs |= {f"{side}_signals": np.array([0.0, 0.1, 0.2]) * (1 if side == "positive" else -1)}
        inputs |= {f"{side}_outward_mm": out, f"{side}_back_mm": out}
    numbers = equilibrium_shift.branches(inputs).numbers
    for side, sign in (("positive", 1.0), ("negative", -1.0)):
        for rule, more in (("held", 1e-6), ("constant", 0.0)):
            size = 1.25 + 0.12 + 1e-4 * 15.0 + more + digit
            exact = 0.5 + 1e3 * size * sign * np.array([0.0, 0.1, 0.2])
            np.testing.assert_allclose(numbers[f"{side}_outward_{rule}"], exact, rtol=1e-12)


def test_fits_of_a_straight_curve():
    """Ours is a line of the stand-in's slope; the table is of the printed polynomial, which comes back; one step of
    1 mm."""
    polynomial = np.array([90.0, -70.0, 30.0, 12.0, 0.3])
    signals = np.linspace(0.0, 0.4, 9)
    inputs = {"map": None}
    for axis, signal in (("x", 0.07), ("y", 0.11)):
        inputs |= {f"{axis}_signals": signals, f"{axis}_mm": np.polyval(polynomial, signals)}
        inputs |= {f"{axis}_polynomial": polynomial, f"{axis}_step_signal": signal}
    numbers = equilibrium_shift.fits(inputs).numbers
    for axis, signal, digit in (("x", 0.07, 0.0), ("y", 0.11, 1e-7)):
        slope = 1e3 * (1.25 + 0.1 + 15e-4 + 1e-6 + digit)
        assert numbers[f"{axis}_polynomial"] == pytest.approx([0, 0, 0, slope, 0.3], abs=1e-6)
        assert numbers[f"{axis}_table_again"] == pytest.approx(polynomial, rel=1e-8)
        assert numbers[f"{axis}_at_step"] == pytest.approx(np.polyval(polynomial, signal), rel=1e-12)
        assert numbers[f"{axis}_step_signal"] == pytest.approx(1.0 / slope, rel=1e-8)


def test_shift_rows_at_their_height(monkeypatch):
    """Of the shift itself, whose answer tells in which field, at which height and for which model it was asked."""
    asked = []

    def shift(fields, signals, h, z_s, rule="held", moment="fixed", lever=0.0):
        asked.append((moment, lever, rule))
        along = (1e-2 * z_s + 1e-4 * h + lever + len(moment)) * np.asarray(signals)
        return SimpleNamespace(along=along, origin=np.array([1e-3 * len(fields), 0.0]))

    monkeypatch.setattr(equilibrium_shift, "shift", shift)
    for name in ("unit_rays", "UnitRays", "finer_unit"):
        monkeypatch.setattr(equilibrium_shift, name, lambda *_: None)
    point = SimpleNamespace(kind="saddle", stiffness=np.eye(3), trace=0.0)
    rest = SimpleNamespace(points=[point], boundary_index=0)
    monkeypatch.setattr(equilibrium_shift, "stationary_points", lambda *_: rest)
    inputs = {"map": None, "signals": SIGNALS, "z_mm": 12.0, "zero_mm": -0.4, "measured_mm": SIGNALS}
    places = equilibrium_shift.convergence(inputs).numbers["constant"]
    assert places == pytest.approx(1e3 * np.tile((0.12 + 15e-4 + 5) * SIGNALS + 1e-3, (3, 1)), rel=1e-12)
    assert {rule for *_, rule in asked} == {"constant"}
    asked.clear()
    answers = equilibrium_shift.magnet_models(inputs)
    sizes = [0.12 + 15e-4 + lever + len(moment) for moment, lever, _ in asked]
    assert answers.numbers["x"].value == pytest.approx(-0.4 + 1e3 * np.outer(sizes, SIGNALS), rel=1e-12)
    assert [lever for _, lever, _ in asked] == [0.0, 0.0, 0.0, 0.0, 5e-3]
    assert answers.facts["current_A"] == pytest.approx(1.215 + 0.0343 * 12.0, rel=1e-12)


def test_noise_of_the_mean_deviation(monkeypatch):
    """A magnet that moves 3 mm/A along x and 4 along y, half as far with its lift held: variances of a deviation of
    0.02 A; what is seen is the root mean square of both axes."""

    def noise(deviation, lift_held):
        return (deviation * (0.5 if lift_held else 1.0)) ** 2 * np.diag([3e-3, 4e-3]) ** 2

    found = SimpleNamespace(noise=noise, at_held_height=np.zeros((2, 6)))
    monkeypatch.setattr(equilibrium_shift, "sensitivity_at_origin", lambda: found)
    coils = SimpleNamespace(coil_names=tuple("123456"))
    monkeypatch.setattr(equilibrium_shift, "unit_states", lambda: coils)
    answers = equilibrium_shift.noise({"deviation_A": np.array([0.01, 0.03]), "seen_rms_mm": 0.01})
    assert answers.numbers["rms_height_held"] == pytest.approx([0.06, 0.08], rel=1e-12)
    assert answers.numbers["rms_lift_held"] == pytest.approx([0.03, 0.04], rel=1e-12)
    assert answers.facts["mean_deviation_A"] == pytest.approx(0.02)
    assert answers.facts["explained_mA"] == pytest.approx(20.0 * 0.01 / np.sqrt(0.00125), rel=1e-12)

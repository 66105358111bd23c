"""Rows of Tables 6-2 and 6-3 and of the limits: each number is that of its own n, height and h, by a stand-in whose
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

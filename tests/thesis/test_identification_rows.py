"""Requirements on the identification rows of S16 and S17."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from fieldmap.thesis import horizontal, vertical
from fieldmap.thesis.printed import read_part
from tests.computed_parts import computed

PARTS = ("S16_recovery", "S17_recovery", "S16_root_locus", "S16_times_in_minutes")


def numbers_of_both():
    return [number for part in PARTS for number in computed(part).comparisons]


def part(word):
    found = [n for n in numbers_of_both() if word in n.title]
    assert found
    return {n.name: n for n in found}


@pytest.mark.parametrize(
    "word", ["Does the plant come back".lower(), "step records of the horizontal models"]
)
def test_known_plants_come_back_within_one_percent(word):
    numbers = {
        name: n
        for title in {n.title for n in numbers_of_both()}
        if word in title
        for name, n in part(title).items()
    }
    assert numbers
    assert all(abs(n.deviation) < 0.01 for n in numbers.values())


def test_table_5_2_obeys_the_unit_gain_of_integral_action():
    """The gain (1 - zero) / prod(1 - poles) is 1 within the printed digits, for the table's numbers and for ours."""
    for gain, zero, third, pair in [
        (0.002099, 0.9969, 0.9959, 0.9740 + 0.0301j),
        (0.00125, 0.9956, 0.9896, 0.9899 + 0.0207j),
    ]:
        assert gain * (1 - zero) / ((1 - third) * abs(1 - pair) ** 2) == pytest.approx(1.0, abs=0.02)


def test_the_models_arc_is_that_of_the_table_and_minutes_bring_it_closer():
    def distance(word, gains):
        numbers = part(word)
        return np.array(
            [
                abs(
                    complex(numbers[f"pair_real[{k}]"].ours, numbers[f"pair_imaginary[{k}]"].ours)
                    - complex(numbers[f"pair_real[{k}]"].thesis, numbers[f"pair_imaginary[{k}]"].thesis)
                )
                for k in gains
            ]
        )

    model = part("the final model at the gains")
    real = [model[f"pair_real[{k}]"].ours for k in range(4)]
    assert np.all(np.diff(real) > 0)  # towards q = 1 as the gain falls, like the printed poles
    assert distance("the final model at the gains", range(4)).max() < 0.03
    assert distance("times in minutes", (1, 2, 3)).max() < 0.0015
    assert distance("the final model at the gains", (1, 2, 3)).min() > 0.007


def test_minutes_predict_what_they_were_not_fitted_to():
    numbers = part("times in minutes")
    for name, bound in (("zero[1]", 5e-4), ("zero[2]", 5e-4), ("peak_time", 0.05), ("overshoot", 0.05)):
        assert abs(numbers[name].deviation) < bound


PRELIMINARY = -0.03 * np.poly([0.996]), np.poly([1.01, 0.9])
FINAL = -0.03 * np.poly([0.9935]), np.poly([1.01, 0.905])
"""Tables 5-3 and 5-4."""


def loop_poles(plant, gain):
    """With (5-12) in seconds: Ti = 0.007, Td = 0.001, Ts = 0.002; the controller acts on minus the error."""
    pid = -gain * np.array([1 + 1 / 7 + 0.5, 1 / 7 - 2.0, 0.5])
    return np.roots(np.convolve(plant[1], [1, -1, 0]) + np.append(0.0, np.convolve(plant[0], pid)))


def test_figures_of_the_root_locus():
    """Every drawn point is on the locus, and each branch is drawn over the whole range of the figure."""
    whole, near = computed("S16_root_locus").curves
    circle = whole.series[0]
    assert (circle.name, circle.kind) == ("unit circle", "asked")
    np.testing.assert_allclose(np.hypot(circle.x, circle.y), np.ones(200))
    assert np.ptp(np.unwrap(np.arctan2(circle.y, circle.x))) == pytest.approx(2 * np.pi)
    models = {"preliminary model, Table 5-3": PRELIMINARY, "final model, Table 5-4": FINAL}
    for figure, gains, shown in (
        (whole, np.geomspace(1e-3, 40.0, 2000), lambda q: np.abs(q) < 1.4),
        (near, np.linspace(0.01, 1.0, 2000), lambda q: q.real > 0.85),
    ):
        assert (figure.x_label, figure.y_label) == ("real part", "imaginary part")
        for name, plant in models.items():
            lines = np.array([one.x + 1j * one.y for one in figure.series if one.name == name])
            for k in (0, 700, 1999):
                poles = loop_poles(plant, gains[k])
                drawn = lines[:, k][np.isfinite(lines[:, k])]
                assert len(drawn) == shown(poles).sum()
                assert all(np.abs(poles - one).min() < 1e-6 for one in drawn)
    assert whole.equal
    assert re.findall(r"[\d.]+", whole.remark)[:2] == ["0.001", "40"]
    assert re.findall(r"[\d.]+", near.remark)[:2] == ["0.01", "1"]
    table = [loop_poles(FINAL, gain) for gain in (0.5, 0.334, 0.2, 0.15)]
    pair = np.array([q[q.imag.argmax()] for q in table])
    (at, measured) = near.series[-2:]
    np.testing.assert_allclose(at.x + 1j * at.y, pair, rtol=1e-6)
    np.testing.assert_allclose(measured.x, [0.9740, 0.9743, 0.9899, 0.9956])
    np.testing.assert_allclose(measured.y, [0.0301, 0.0246, 0.0207, 0.0167])
    assert [one.points for one in near.series[-2:]] == [True, True]


@pytest.mark.parametrize(
    ("part", "names", "end"),
    [
        ("S16_closed_loop", ["identified plant (5-17), PID"], 1.5),
        ("S20_closed_loop", ["design", "with (7-20)", "with (7-21), as on the rig"], 1.0),
    ],
)
def test_figures_of_steps(part, names, end):
    """Every 2 ms to the end of a step of 1 mm; the peaks agree with the overshoot in the numbers."""
    (figure,) = computed(part).curves
    *lines, asked = figure.series
    assert [one.name for one in lines] == names
    assert (asked.name, asked.kind, set(asked.y)) == ("asked for", "asked", {1.0})
    for one in figure.series:
        np.testing.assert_allclose(one.x, 2e-3 * np.arange(round(end / 2e-3) + 1), atol=1e-12)
    overshoot = {n.name: n.ours for n in computed(part).comparisons}["overshoot"]
    assert 100 * (lines[-1].y.max() - 1) == pytest.approx(overshoot)
    assert (figure.x_label, figure.y_label) == ("time (s)", "height (mm)")


def test_records_are_of_the_signals_and_noise_of_the_row(monkeypatch):
    """6.4: 100 records of 3 s after 0.1 s at rest, each with its own noise."""
    seen = []

    def of_runs(y, u, orders):
        seen.append((y, u, orders.poles, orders.zeros))
        return SimpleNamespace(numerators=np.ones((100, 1)), denominators=np.ones((100, orders.poles + 1)))

    monkeypatch.setattr(horizontal, "modified_least_squares_runs", of_runs)
    inputs = read_part("S17_recovery").inputs | {"x_signal": 0.5, "y_signal": 0.25, "deviation_mm": 0.03}
    horizontal.recovery(inputs)
    assert [one[2:] for one in seen] == [(2, 0), (1, 0)] * 2
    for (y, u, poles, _), axis in zip(seen, "xxyy", strict=True):
        model = inputs[f"{axis}_{'second' if poles == 2 else 'first'}_order"]
        assert set(u[:50]) == {0.0}
        assert set(u[50:]) == {inputs[f"{axis}_signal"]}
        assert y.shape == (100, 1550)
        exact = scipy.signal.lfilter(np.append(np.zeros(poles), model[0]), model[1:], u)
        assert np.std(y - exact) == pytest.approx(0.03, rel=0.01)
        assert np.abs(np.diff(y[:, 0])).min() > 0


@pytest.mark.parametrize(
    ("factors", "signal"),
    [
        (np.poly([-0.1, 0.2, 0.3]), 0.2),
        (np.poly([0.0, 0.5, 0.2]), 0.2),
        (np.convolve([1.0, -0.4, 0.05], [1.0, -0.6]), 0.6),
    ],
)
def test_the_smallest_positive_signal_of_a_polynomial(factors, signal):
    """The signal that reaches 5 mm; not a negative one, not 0, and not a complex pair near 0.2."""
    assert horizontal.signal_of(np.append(factors[:-1], factors[-1] + 5.0), 5.0) == pytest.approx(signal)


def test_a_signal_is_sought_four_times(monkeypatch):
    """The signal is halved each time if the machine goes twice as far as asked; within 1 % it is kept."""
    tried, moved = [], [2.0]

    def run_of(inputs, scenario, changes):
        tried.append(changes["signal.0.by"])
        return SimpleNamespace(
            mean=lambda axis, begin, end: {(6.0, 8.0): moved[-1] + 1, (0.0, 1.0): 1}[begin, end]
        )

    monkeypatch.setattr(horizontal, "run_of", run_of)
    assert horizontal._signal_for({}, "y", 1.0, 0.8)[0] == tried[-1]
    assert tried == [0.8, 0.4, 0.2, 0.1]
    for way, count in ((1.0098, 1), (1.0102, 4), (0.9902, 1), (0.9898, 4)):
        tried.clear()
        moved.append(way)
        horizontal._signal_for({}, "x", 1.0, 0.8)
        assert len(tried) == count


def test_as_many_records_as_are_said():
    assert vertical.RUNS == vertical.over_records({"a": np.ones((3, 1))}).facts["records"] == 100


def test_the_plant_behind_poles_comes_back():
    """g = 1700 mm/s^2 per V, c = 160 1/s^2, d = 3 1/s; wrong poles at the gain held back have no effect."""
    Ts, Ti, Td = 2e-3, 60 * 0.008, 60 * 0.0012
    top, bottom, _ = scipy.signal.cont2discrete(([1700.0], [1.0, 3.0, -160.0]), Ts)
    half, rate = Ts / (2 * Ti), Td / Ts
    pid = np.array([1 + half + rate, half - 1 - 2 * rate, rate])
    gains = np.array([0.5, 0.334, 0.2, 0.15])
    poles = [np.roots(np.convolve(bottom, [1, -1, 0]) + g * np.convolve(np.ravel(top), pid)) for g in gains]
    pair = np.array([p[p.imag.argmax()] for p in poles])
    third = [max(q.real for q in p if abs(q.imag) < 1e-9) for p in poles]
    pair[0] = 0.5
    inputs = {
        "gains": gains, "pair_real": pair.real, "pair_imaginary": pair.imag, "third_gains": gains[[0, 2, 3]],
        "third": [0.1, third[2], third[3]], "held_back": np.array([0.5]), "Ti_s": 0.008, "Td_s": 0.0012, "Ts_s": Ts,
    }  # fmt: skip
    assert vertical._fitted_plant(inputs) == pytest.approx([1700.0, 160.0, 3.0], rel=1e-4)

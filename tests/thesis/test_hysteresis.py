"""The unit on a path out and back with hysteresis, with and without joints, on coarse meshes; its runs and rows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.currents import divide_currents
from fieldmap.device import Payload, read_device
from fieldmap.errors import InputError
from fieldmap.iron import HysteresisSolver, Pinning
from fieldmap.store import Checkpoint
from fieldmap.thesis import detail, hysteresis
from fieldmap.thesis.computation import function_of
from fieldmap.thesis.hysteresis import DEVICE, JointedUnit, Led, Protocol, Run, prepared, walk
from fieldmap.thesis.kept import Kept
from fieldmap.thesis.printed import read_part, shared_value
from fieldmap.thesis.vertical_sensor import thesis_lift_current
from tests.computed_parts import assert_drawn

SIGNALS = np.array([0.0, 0.1, 0.2, 0.1])
COARSE = Led("demagnetised", cells=3, refinement=0.4)


@pytest.fixture(scope="module")
def bare():
    return HysteresisSolver(read_device("drive_unit"), Pinning(0.0, 1), refinement=0.4)


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    return JointedUnit(read_device(DEVICE), COARSE, tmp_path_factory.mktemp("runs"))


def led(unit, pinning, protocol):
    solver = unit.with_pinning(pinning)
    return walk(solver, prepared(solver, "demagnetised", protocol, 0.2), SIGNALS, protocol)


def test_without_pinning_the_way_back_is_the_way_out(bare):
    found = led(bare, Pinning(0.0, 1), Protocol(rule="constant"))
    shift = 1e3 * found.shift("x")
    assert shift[3] == pytest.approx(shift[1], abs=1e-3)
    assert 1.0 < shift[1] < shift[2]


def test_remanent_loops_lead_and_the_lift_is_held(bare):
    """On the way back the magnet is nearer to the origin, as measured; a lag would have the other sign."""
    found = led(bare, Pinning(400.0, 3), Protocol())
    shift = 1e3 * found.shift("x")
    inputs = read_part("S14_x_remanence").inputs
    measured = (inputs["back_mm"] - inputs["outward_mm"])[inputs["signals"] == 0.1]
    assert 0.5 < (shift[3] - shift[1]) / measured[0] < 1.5
    assert found.lifts == pytest.approx(np.full(4, found.lifts[0]), rel=2e-3)


def test_a_run_begins_at_nought():
    with pytest.raises(InputError) as error:
        walk(None, None, [0.1], Protocol())
    assert error.value.problems[0].received == "0.1"


def test_the_file_is_free_while_a_run_computes(tmp_path):
    kept, computed = Kept(tmp_path / "runs", "mark"), []

    def compute():
        with Checkpoint(tmp_path / "runs", "of another run", resume=False):
            pass  # raises if the file is locked
        computed.append(1)
        return {"shift": np.arange(3.0)}

    for _ in range(2):
        assert kept.arrays("key", compute)["shift"].tolist() == [0.0, 1.0, 2.0]
    assert len(computed) == 1
    assert Kept(tmp_path / "runs", "another mark").get("key") is None
    nowhere = Kept(None, "mark")
    nowhere.put("key", {"shift": np.zeros(1)})
    assert nowhere.get("key") is None


def test_joints_and_hysteresis_make_the_magnet_lead_along_y(unit):
    """Unlike the bare unit: on the way back the magnet is beyond the origin, by more than half of the measured shift.
    The run is cached."""
    out, back = (shared_value(f"table_6_6.{way}_mm") for way in ("outward", "back"))
    way = np.array([0.0, 0.15, 0.0])
    shift = unit.run("y", way).shift
    assert 0.5 < shift[1] / (out[3] - out[0]) < 2.0
    assert 0.5 < shift[2] / (back - out)[0] < 1.6
    again = JointedUnit(unit.device, COARSE, unit._folder)
    np.testing.assert_array_equal(again.run("y", way).shift, shift)
    assert "solver" not in vars(again)


def test_a_cached_run_belongs_to_its_device_and_settings(unit, monkeypatch):
    """Runs are computed anew if any setting differs, and only then."""
    computed = []

    def led(solver, memory, signals, protocol, parts):
        computed.append((hysteresis.coercive_field(solver.device), parts, protocol.z_s, protocol.h))
        nothing = np.zeros((len(signals), 2))
        return hysteresis.Walk(signals, nothing, np.ones(len(signals)), np.ones(len(signals)))

    monkeypatch.setattr("fieldmap.thesis.hysteresis.walk", led)
    monkeypatch.setattr("fieldmap.thesis.hysteresis.prepared", lambda *_: None)
    way, folder = np.array([0.0, 0.2]), unit._folder
    changed = {"material.steel.coercive_field_A_per_m": 77.0, "payload.magnet_offset_mm": 11.0}
    for device in (unit.device, read_device(DEVICE, changed)):
        for settings in (COARSE, replace(COARSE, parts=2)):
            for _ in range(2):
                of = JointedUnit(device, settings, folder)
                of.solver = SimpleNamespace(device=device)
                of.run("x", way)
                of.run("x", way, z_s=11.5)
    assert len(computed) == len(set(computed)) == 8


def test_lift_law_at_other_depths_and_currents(unit):
    """Against states solved by hand: lift over weight at (7-18), and the current for the same lift 1 mm deeper."""
    law = hysteresis.lift_law(unit, np.array([10.0]))
    memory = unit.solver.demagnetised
    state = unit.solver.step(np.full(6, thesis_lift_current(10.0)), memory)
    point = np.array([0.0, 0.0, Protocol(h=unit.h).height])
    weight = unit.payload.mass * 9.80665
    assert law.shares[0] == pytest.approx(
        unit.payload.moment * state.gradient(point)[2, 2] / weight, rel=1e-9
    )
    deeper = unit.solver.step(
        np.full(6, thesis_lift_current(10.0) * (1 + 0.01 * law.relative_slope)), state.memory
    )
    below = point - [0.0, 0.0, 1e-3]
    assert deeper.gradient(below)[2, 2] == pytest.approx(state.gradient(point)[2, 2], rel=2e-3)
    more = hysteresis.lift_law(unit, np.array([10.0]), scale=1.5)
    assert more.shares[0] > 1.2 * law.shares[0]
    assert 1.0 < law.relative_slope < 3.0


class Straight:
    """A unit whose magnet moves 20 mm per unit signal, and whose largest current grows by 4 A per unit signal."""

    def run(self, axis, signals, n=1.25, z_s=10.0):
        return Run(20.0 * signals, np.ones_like(signals), 2.0 + 4.0 * np.abs(signals), np.ones_like(signals))


def test_reach_ends_at_the_limit_or_at_the_largest_signal():
    assert hysteresis.reach(Straight(), "x", -1.0, 10.0, 3.55, 0.45) == pytest.approx(20.0 * (1.55 / 4.0))
    assert hysteresis.reach(Straight(), "y", 1.0, 10.0, 9.0, 0.5) == pytest.approx(10.0)


@pytest.mark.parametrize("part", ["S14_x_remanence", "S14_y_remanence", "S14_x_joints", "S14_y_joints"])
def test_rows_set_ours_beside_the_same_branch(monkeypatch, part):
    """With the measured branches as input, every number must agree with the printed one."""
    inputs = dict(read_part(part).inputs)
    joints = part.endswith("joints")

    class Measured:
        device, led, h = read_device(DEVICE), Led(), 15.0

        def run(self, axis, way, z_s):
            side = ("positive_" if way[1] > 0 else "negative_") if joints else ""
            out, back = inputs[f"{side}outward_mm"], inputs[f"{side}back_mm"]
            return Run(np.concatenate([out, back[-2::-1]]) - out[0], way, way, way)

    for name in ("shipped_unit", "_bare_unit"):
        monkeypatch.setattr(f"fieldmap.thesis.hysteresis.{name}", lambda *_: Measured())
    rest = SimpleNamespace(along=1e-3 * inputs["outward_mm"][1:]) if not joints else None
    monkeypatch.setattr("fieldmap.thesis.hysteresis.curve", lambda *_, **__: rest)
    numbers = function_of(part)({"map": None, **inputs}).numbers
    printed = read_part(part).numbers
    sides = {f"{s}_{w}" for s in ("positive", "negative") for w in ("outward", "back")}
    assert set(numbers) == set(printed) == (sides if joints else {"width"})
    for name, values in numbers.items():
        expected = np.array([float(one.text) for one in printed[name]])
        if part == "S14_y_joints" and name.startswith("negative"):
            # The unit is symmetric along y.
            other = np.array([float(one.text) for one in printed[name.replace("negative", "positive")]])
            expected = inputs["negative_outward_mm"][0] - (other - inputs["positive_outward_mm"][0])
        assert np.ravel(values) == pytest.approx(expected, abs=1e-9)


class Followed:
    """Iron whose memory is the list of its past currents."""

    demagnetised = ()
    device = SimpleNamespace(payload=Payload(0.01, moment=0.8))

    def __init__(self):
        self.tries = []

    def step(self, currents, memory, near=None):
        self.tries.append((currents, near))
        return SimpleNamespace(currents=currents, memory=(*memory, currents))


L = 1.558
UP, DOWN = [0.0, L / 3, 2 * L / 3, L], [L, L + 0.664, L + 1.328, 3.55]
"""A, even steps to the level at 10 mm, and from there to the amplifier's limit."""
CYCLE = [0.05, 0.2, 0.05, 0.0, -0.05, -0.2, -0.05, 0.0]


@pytest.mark.parametrize(
    ("history", "levels"),
    [
        ("demagnetised", UP[1:]),
        ("cycled", [*UP[1:], *CYCLE]),
        ("restarted", [*UP[1:], *CYCLE, *UP[2::-1], *UP[1:]]),
        ("wiped", [*UP[1:], *CYCLE, *DOWN[1:], *DOWN[2::-1]]),
        ("saturated", [*UP[1:], *DOWN[1:], *DOWN[2::-1]]),
        ("shaken", L * np.array([0, 2, 0.3, 1.7, 0.6, 1.4, 0.8, 1.2, 0.93, 1])),
    ],
)
def test_histories_step_by_step(history, levels):
    """Equal currents in A, then y signals of up to 0.2 and -0.2, (6-3) with n = 1.5."""
    seen = prepared(Followed(), history, Protocol("y", n=1.5), 0.2)
    first = 3 if history in ("cycled", "restarted", "wiped") else len(levels)
    expected = [
        divide_currents(L, 0.0, one, 1.5) if first <= k < first + 8 else np.full(6, one)
        for k, one in enumerate(levels)
    ]
    np.testing.assert_allclose(seen, expected, atol=1e-9)


@pytest.fixture
def followed(monkeypatch):
    """Iron whose magnet has the lift i^p exp(-a s - b s^2) at mean current i, and the position x = s, y = s^2."""

    def equilibrium_at(field, payload, path, near, level):
        currents, height = path("any level")
        assert (payload.volume_level, height, level) == (1, pytest.approx(-0.107), pytest.approx(2 * 1.558))
        assert currents is field.currents
        mean, s = currents.mean(), signal_of(field.currents)
        nears.append(near)
        lift = mean**power * np.exp(-1.5 * s - 4 * s * s)
        return SimpleNamespace(position=np.array([s, s * s, height]), lift=lift), None

    def signal_of(currents):
        """The x signal of (6-3) with n = 1.25, from its linear relation to the currents."""
        unit = divide_currents(1.0, 0.01, 0.0, 1.25)
        return 0.01 * (currents / currents.mean() - 1)[0] / (unit[0] - 1)

    def as_field(state, box):
        np.testing.assert_allclose(box, [[-16e-3, -16e-3, -132e-3], [16e-3, 16e-3, -84e-3]])
        return state

    monkeypatch.setattr(hysteresis, "equilibrium_at", equilibrium_at)
    monkeypatch.setattr(hysteresis, "as_field", as_field)
    nears, power, solver = [], 0.9, Followed()

    def go(signals, rule="held", of=0.9, parts=1):
        nonlocal power
        power = of
        solver.tries.clear()
        nears.clear()
        found = walk(solver, ("before",), signals, Protocol("x", h=20.0, rule=rule, scale=2.0), parts)
        return found, [round(signal_of(currents), 6) for currents, _ in solver.tries], nears, solver.tries

    return go


@pytest.mark.parametrize(("power", "trials"), [(0.9, [1, 2, 2, 1, 2, 2, 1]), (0.6, [1, 3, 3, 1, 3, 3, 1])])
def test_the_level_is_sought_on_the_curve_of_those_before(followed, power, trials):
    """The logarithm of the level is a parabola of the signal, known after three signals in one direction: then the
    first trial is right. The first step assumes a power of 0.9; another power takes one trial more."""
    signals = np.array([0.0, 0.05, 0.1, 0.2, 0.15, 0.1, 0.05])
    found, tried, nears, _ = followed(signals, of=power)
    assert tried == [s for s, count in zip(signals, trials, strict=True) for _ in range(count)]
    levels = 2 * 1.558 * np.exp((1.5 * signals + 4 * signals**2) / power)
    np.testing.assert_allclose(found.levels, levels, rtol=2e-3 / power)
    np.testing.assert_allclose(found.lifts, found.lifts[0], rtol=2e-3)
    np.testing.assert_allclose(found.places, np.column_stack([signals, signals**2]), atol=1e-9)
    np.testing.assert_allclose(nears[0], [0.0, 0.0])
    # Each search starts at the previous equilibrium.
    np.testing.assert_allclose(nears[-1], [0.1, 0.01], atol=1e-9)


def test_a_level_that_is_constant_and_steps_between_signals(followed):
    found, tried, _, tries = followed([0.0, 0.1, -0.05], "constant", parts=3)
    np.testing.assert_allclose(found.levels, np.full(3, 2 * 1.558))
    assert tried == pytest.approx([0.0, 0.0, 0.0, 0.1 / 3, 0.2 / 3, 0.1, 0.05, 0.0, -0.05], abs=1e-6)
    assert found.lifts[1] == pytest.approx((2 * 1.558) ** 0.9 * np.exp(-0.15 - 0.04))
    assert all(near is None for _, near in tries)


@pytest.mark.parametrize(("power", "trials"), [(0.2, 6), (6.0, 6)])
def test_trials_end_after_six_and_steps_are_bounded(followed, power, trials):
    """For powers outside 0.3 to 2 each secant step is too long or too short."""
    found, tried, *_ = followed(np.array([0.0, 0.2]), of=power)
    assert len(tried) == 1 + trials
    misses, level = [], np.log(2 * 1.558)
    for k in range(6):
        misses.append(power * (level - np.log(2 * 1.558)) - 0.3 - 0.16)
        level -= misses[-1] / (0.9 if k == 0 else np.clip(power, 0.3, 2.0))
    assert found.lifts[1] / found.lifts[0] == pytest.approx(np.exp(misses[-1]))
    assert found.levels[1] == pytest.approx(np.exp(level))


def test_lift_law_of_a_power(monkeypatch):
    """dBz/dz = 2 i^0.8 exp(-30 depth) T/m, depth below the disk in m: at 10 mm the slope is 3 %/mm over 0.8."""
    carried = SimpleNamespace(mass=0.02, moment=0.6, magnet_offset=0.02)

    class Law(Followed):
        def step(self, currents, memory):
            state = super().step(currents, memory)
            state.gradient = lambda point: 2 * currents.mean() ** 0.8 * np.exp(30 * point[2]) * np.eye(3)
            return state

    unit = SimpleNamespace(payload=carried, solver=Law())
    law = hysteresis.lift_law(unit, np.array([5.0, 10.0, 20.0]), scale=1.5)
    levels = 1.5 * np.array([1.3865, 1.558, 1.901])
    depths = 0.077 + 0.02 + np.array([0.005, 0.01, 0.02])
    np.testing.assert_allclose(law.shares, 0.6 * 2 * levels**0.8 * np.exp(-30 * depths) / (0.02 * 9.80665))
    assert law.relative_slope == pytest.approx(3.0 / 0.8)
    # Trial states at 10 mm do not change the memory.
    np.testing.assert_allclose(
        [one.mean() for one, _ in unit.solver.tries], [*levels[:2], 1.02 * levels[1], levels[2]]
    )
    assert np.isnan(hysteresis.lift_law(unit, np.array([5.0])).relative_slope)


def test_units_of_the_rows():
    """Coercive field, joints and offset of the devices; refinement 0.5 and six cells after a shaken history. A quick
    run is coarser, with fewer cells and a demagnetised start."""
    bare = hysteresis._bare_unit.__wrapped__(123.0, 21.0, 7)
    assert (hysteresis.coercive_field(bare.device), bare.h) == (123.0, pytest.approx(21.0))
    assert bare.led == Led("demagnetised", cells=7, parts=1, refinement=0.5)
    shipped = hysteresis.shipped_unit.__wrapped__()
    assert shipped.led == Led("shaken", cells=6, parts=1, refinement=0.5)
    with detail.at(detail.QUICK):
        assert hysteresis._bare_unit.__wrapped__(123.0, 21.0, 10).led == Led("demagnetised", 4, 1, 0.25)
        assert hysteresis.shipped_unit.__wrapped__().led == Led("demagnetised", 3, 1, 0.4)
    told = hysteresis.about_the_joints()
    assert told == {
        "joint_mm": pytest.approx(1e3 * shipped.device.joints[0].gap), "fitted_h_mm": pytest.approx(shipped.h),
        "coercive_A_per_m": shipped.device.materials["steel"].coercive_field, "joint_refinement": 0.5,
        "history": hysteresis.HISTORIES["shaken"],
    }  # fmt: skip


class Curved:
    """A unit with shifts of 20 s + 10 s^2 mm along x, three times as far along y, less a tenth of z_s; its currents
    grow by 4 A per unit signal."""

    def __init__(self):
        self.ways = []

    def run(self, axis, signals, n=1.25, z_s=10.0):
        self.ways.append(np.round(signals, 9).tolist())
        shift = (20.0 * signals + 10.0 * signals**2) * (3 if axis == "y" else 1) - z_s / 10 * (signals != 0)
        return Run(shift, np.ones_like(signals), 2.0 + 4.0 * np.abs(signals), np.ones_like(signals))


def test_branches_and_ranges_by_axis_and_detail(monkeypatch):
    """Along y, and in quick runs, the negative side mirrors the positive side."""
    unit = Curved()
    monkeypatch.setattr(hysteresis, "shipped_unit", lambda: unit)
    way = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.3, 0.2, 0.1, 0.0])

    def along(s, times=1):
        return times * (20 * s + 10 * s * s) - 1.2 * (s != 0)

    np.testing.assert_allclose(hysteresis._branches("x", -way, 12.0), along(-way))
    np.testing.assert_allclose(hysteresis._branches("y", -way, 12.0), -along(way, 3))
    # Along x up to a signal of 0.25, where a coil carries 3 A: 5.625 mm - 1.2 mm, and 4.375 mm + 1.2 mm.
    assert hysteresis.joint_range("x", 12.0, 3.0, 0.45) == pytest.approx(4.425 + 5.575)
    assert hysteresis.joint_range("y", 12.0, 3.0, 0.45) == pytest.approx(2 * (3 * 5.625 - 1.2))
    assert unit.ways[-1] == pytest.approx(np.arange(0.0, 0.46, 0.05))
    with detail.at(detail.QUICK):
        found = hysteresis._branches("x", -way, 12.0)
        assert unit.ways[-1] == pytest.approx([0.0, 0.2, 0.4, 0.2, 0.0])
        np.testing.assert_allclose(found[::2], -along(way[::2]))
        np.testing.assert_allclose(found[1], 0.5 * (found[0] + found[2]))
        # Interpolated between signals of 0, 0.225 and 0.45, because the currents are symmetric.
        reached = np.interp(0.25, [0.225, 0.45], along(np.array([0.225, 0.45])))
        assert hysteresis.joint_range("x", 12.0, 3.0, 0.45) == pytest.approx(2 * reached)


def test_figures_of_branches(monkeypatch):
    """Both directions of each side; ours starts where the measured branch starts. The width for each coercive field."""
    unit, asked = Curved(), []
    monkeypatch.setattr(hysteresis, "shipped_unit", lambda: unit)
    monkeypatch.setattr(hysteresis, "about_the_joints", dict)
    signals, out, back = np.array([0.0, 0.1, 0.2]), np.array([0.5, 2.0, 4.0]), np.array([-1.0, 1.0, 4.0])
    inputs = {"axis": "x", "z_mm": 12.0, "figure": "Figure", "map": "map"}
    for side, sign in (("positive", 1), ("negative", -1)):
        inputs |= {
            f"{side}_signals": sign * signals,
            f"{side}_outward_mm": sign * out,
            f"{side}_back_mm": sign * back,
        }
    (figure,) = hysteresis.joints(inputs).curves
    lines = []
    for s in (signals, -signals):
        side = np.sign(s[1])
        ours = 0.5 * side + 20 * s + 10 * s * s - 1.2 * (s != 0)
        for way, measured in (("outward", out), ("on the way back", back)):
            lines += [(f"ours, {way}", "ours", s, ours), (f"measured, {way}", "measured", s, side * measured)]
    assert figure.title == "Figure"
    assert_drawn(figure, ("x control signal", "x (mm)"), lines)
    assert [one.points for one in figure.series] == [False, True] * 4

    class Bare:
        def __init__(self, *of):
            asked.append(of)
            self.coercive = of[0]

        def run(self, axis, way, z_s):
            """Shift along x; on the way back it is 1 mm less per 100 A/m."""
            assert (axis, z_s) == ("x", 12.0)
            shift = 20 * way - 0.01 * self.coercive * (np.arange(len(way)) > 2)
            return Run(shift, way, way, way)

    def curve(field_map, given, axis, z_s, h):
        assert (field_map, axis, z_s, h) == ("map", "x", 12.0, 18.0)
        return SimpleNamespace(along=0.03 * given)

    monkeypatch.setattr(hysteresis, "_bare_unit", Bare)
    monkeypatch.setattr(hysteresis, "curve", curve)
    inputs |= {"signals": signals, "outward_mm": out, "back_mm": back, "h_mm": 18.0, "cells": 5}
    answers = hysteresis.remanence(inputs | {"coercive_A_per_m": np.array([100.0, 300.0])})
    assert asked == [(100.0, 18.0, 5), (300.0, 18.0, 5)]
    np.testing.assert_allclose(answers.numbers["width"], [[-1, -1, 0], [-3, -3, 0]], atol=1e-12)
    assert answers.facts == {"refinement": 0.5}
    lines = [
        ("measured, outward", "measured", signals, out),
        ("measured, on the way back", "measured", signals, back),
    ]
    for coercive in (100, 300):
        lines.append((f"ours, {coercive} A/m, outward", "ours", signals, 0.5 + 20 * signals))
        less = 0.01 * coercive * np.array([1, 1, 0])
        lines.append((f"ours, {coercive} A/m, on the way back", "ours", signals, 0.5 + 20 * signals - less))
    lines.append(("ours, no hysteresis, shipped mesh", "ours", signals, 0.5 + 30 * signals))
    assert_drawn(answers.curves[0], ("x control signal", "x (mm)"), lines)


def test_what_is_kept_of_a_run(monkeypatch):
    """Shifts from the first place, mm, levels, lifts, and the largest coil current, (6-3) with n = 1.5. The preparation
    has signals up to 0.4."""
    places = np.array([[1e-3, 0.0], [3e-3, 0.0]])
    made = hysteresis.Walk(np.array([0.0, -0.2]), places, np.array([2.0, 3.0]), np.array([0.1, 0.11]))
    ends = []
    monkeypatch.setattr(hysteresis, "walk", lambda solver, memory, *_: made if memory == "memory" else None)
    monkeypatch.setattr(hysteresis, "prepared", lambda *given: ends.append(given[1:]) or "memory")
    unit = JointedUnit(read_device(DEVICE), COARSE, None)
    unit.solver = "solver"
    run = unit.run("x", made.signals, 1.5, 11.5)
    unit.run("x", made.signals)
    unit.run("x", made.signals)
    assert [(history, end) for history, _, end in ends] == [("demagnetised", 0.4)] * 2
    assert [(one.axis, one.n, one.z_s, one.h) for _, one, _ in ends] == [
        ("x", 1.5, 11.5, unit.h), ("x", 1.25, 10.0, unit.h),
    ]  # fmt: skip
    np.testing.assert_allclose(run.shift, [0.0, 2.0])
    np.testing.assert_allclose(run.levels, [2.0, 3.0])
    np.testing.assert_allclose(run.lifts, [0.1, 0.11])
    np.testing.assert_allclose(run.largest, [2.0, divide_currents(3.0, -0.2, 0.0, 1.5).max()])
    assert Led() == Led("shaken", 6, 1, 0.5)

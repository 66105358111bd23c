"""Both branches with joints and hysteresis: the tables as they are fitted, runs and their cache, rows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.thesis.hysteresis import SWINGS, Protocol, Walk
from fieldmap.thesis.joints import (
    DEVICE,
    BranchReadings,
    JointedUnit,
    Led,
    Run,
    coercive_field,
    lift_law,
    reach,
    tables,
    x_joints,
    y_joints,
)
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.vertical_sensor import thesis_lift_current

COARSE = Led("demagnetised", cells=3, refinement=0.4)


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    return JointedUnit(read_device(DEVICE), COARSE, tmp_path_factory.mktemp("runs"))


def test_tables_are_printed_ones_from_where_each_run_began():
    """Corners of the thesis's Tables 6-3 to 6-7, written here by hand."""
    found = tables()
    assert found["Table 6-4"].measured[[0, 7, 8, 15]] == pytest.approx([0.932, 9.417, 6.662, -0.688])
    assert found["Table 6-5"].measured[[0, -1]] == pytest.approx([-0.842, 0.88])
    assert found["Table 6-6"].measured[[0, 5, 6, -1]] == pytest.approx([0.636, 3.566, 1.963, -0.879])
    assert found["Table 6-7"].measured[[5, -1]] == pytest.approx([-3.787, 0.876])
    assert found["Table 6-7"].way[[6, 7, -1]] == pytest.approx([-0.3, -0.25, 0.0])
    single = found["Table 6-3, 11.5 mm"]
    assert (single.back, single.z_s) == (None, 11.5)
    assert single.measured[[0, -1]] == pytest.approx([0.981, 8.666])
    assert found["Table 6-2, n = 1.5"].measured[-1] == pytest.approx(10.758)
    for one in found.values():
        assert len(one.measured) == len(one.way) - 1


def test_joints_and_hysteresis_make_the_magnet_lead_along_y(unit):
    """What the bare unit does not: on the way back it lies beyond the origin, by more than half of what was measured.
    The run is cached."""
    about = tables()["Table 6-6"]
    way = np.array([0.0, 0.15, 0.0])
    shift = unit.run("y", way).shift
    assert 0.5 < shift[1] / about.out[3] < 2.0
    assert 0.5 < shift[2] / (about.back - about.out)[0] < 1.6
    again = JointedUnit(unit.device, COARSE, unit._folder)
    np.testing.assert_array_equal(again.run("y", way).shift, shift)
    assert again._solver is None


def test_a_cached_run_belongs_to_its_device_and_settings(unit, monkeypatch):
    """Runs are computed anew where anything of them differs, and only there."""
    computed = []

    def led(solver, memory, signals, protocol, parts):
        computed.append((coercive_field(solver.device), parts, protocol.z_s, protocol.h))
        nothing = np.zeros((len(signals), 2))
        return Walk(signals, nothing, np.ones(len(signals)), np.ones(len(signals)), memory)

    monkeypatch.setattr("fieldmap.thesis.joints.walk", led)
    monkeypatch.setattr("fieldmap.thesis.joints.prepared", lambda *_: None)
    way, folder = np.array([0.0, 0.2]), unit._folder
    changed = {"material.steel.coercive_field_A_per_m": 77.0, "payload.magnet_offset_mm": 11.0}
    for device in (unit.device, read_device(DEVICE, changed)):
        for settings in (COARSE, replace(COARSE, parts=2)):
            for _ in range(2):
                of = JointedUnit(device, settings, folder)
                of._solver = SimpleNamespace(device=device)
                of.run("x", way)
                of.run("x", way, z_s=11.5)
    assert len(computed) == len(set(computed)) == 8


def test_swings_end_at_the_level_and_die_away():
    assert SWINGS[-1] == 0.0
    assert np.all(np.abs(SWINGS[2::2]) < np.abs(SWINGS[:-2:2]))
    assert np.all(SWINGS[:-2] * SWINGS[1:-1] < 0.0)


def test_lift_law_at_other_depths_and_currents(unit):
    """Against states solved by hand: lift over weight at (7-18), and where the same lift is a millimetre deeper."""
    law = lift_law(unit, np.array([10.0]))
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
    more = lift_law(unit, np.array([10.0]), scale=1.5)
    assert more.shares[0] > 1.2 * law.shares[0]
    assert 1.0 < law.relative_slope < 3.0


class Straight:
    """A unit whose magnet moves 20 mm, and whose largest current grows by 4 A, per signal of 1."""

    def run(self, axis, signals, n=1.25, z_s=10.0):
        return Run(20.0 * signals, np.ones_like(signals), 2.0 + 4.0 * np.abs(signals), np.ones_like(signals))


def test_reach_ends_at_the_limit_or_at_the_largest_signal():
    assert reach(Straight(), "x", -1.0, 10.0, 3.55, 0.45) == pytest.approx(20.0 * (1.55 / 4.0))
    assert reach(Straight(), "y", 1.0, 10.0, 9.0, 0.5) == pytest.approx(10.0)


@pytest.mark.parametrize(("part", "rows"), [("S14_x_joints", x_joints), ("S14_y_joints", y_joints)])
def test_rows_set_ours_beside_the_same_branch(monkeypatch, part, rows):
    """Fed the measured branches, every number must agree with the printed one."""
    inputs = dict(read_part(part).inputs)

    class Measured:
        device, led, h = read_device(DEVICE), Led(), 15.0

        def run(self, axis, way, n=1.25, z_s=10.0):
            side = "positive" if way[1] > 0 else "negative"
            out, back = inputs[f"{side}_outward_mm"], inputs[f"{side}_back_mm"]
            return Run(np.concatenate([out, back[-2::-1]]) - out[0], way, way, way)

    monkeypatch.setattr("fieldmap.thesis.joints.shipped_unit", Measured)
    numbers = rows(inputs).numbers
    printed = read_part(part).numbers
    assert (
        set(numbers)
        == set(printed)
        == {f"{s}_{w}" for s in ("positive", "negative") for w in ("outward", "back")}
    )
    for name, values in numbers.items():
        expected = np.array([float(one.text) for one in printed[name]])
        if part == "S14_y_joints" and name.startswith("negative"):
            # Along y the unit is its own mirror image.
            other = np.array([float(one.text) for one in printed[name.replace("negative", "positive")]])
            expected = inputs["negative_outward_mm"][0] - (other - inputs["positive_outward_mm"][0])
        assert values == pytest.approx(expected, abs=1e-9)


def test_readings_are_those_of_the_table(unit):
    about = tables()["Table 6-4"]
    readings = BranchReadings(about, 0.1)
    asked = []

    class Asked(Straight):
        def run(self, axis, signals, n=1.25, z_s=10.0):
            asked.append((axis, n, z_s))
            return super().run(axis, signals)

    assert readings.computed(unit.device, Asked()) == pytest.approx(20.0 * about.way[1:])
    assert asked == [("x", 1.25, 10.0)]
    assert coercive_field(unit.device) > 0.0

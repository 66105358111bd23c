"""The unit led out and back with iron that remembers, without and with joints, on coarse meshes; its runs and rows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device import read_device
from fieldmap.errors import InputError
from fieldmap.histories import SWINGS
from fieldmap.iron import HysteresisSolver, Pinning
from fieldmap.store import Checkpoint
from fieldmap.thesis import hysteresis
from fieldmap.thesis.computation import function_of
from fieldmap.thesis.hysteresis import DEVICE, JointedUnit, Led, Protocol, Run, prepared, walk
from fieldmap.thesis.kept import Kept
from fieldmap.thesis.printed import read_part, shared_value
from fieldmap.thesis.vertical_sensor import thesis_lift_current

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
    """On the way back the magnet lies nearer to the origin, as measured: a lag would have the other sign."""
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
            pass  # raises where the file is locked
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
    """What the bare unit does not: on the way back it lies beyond the origin, by more than half of what was measured.
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
    """Runs are computed anew where anything of them differs, and only there."""
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


def test_swings_end_at_the_level_and_die_away():
    assert SWINGS[-1] == 0.0
    assert np.all(np.abs(SWINGS[2::2]) < np.abs(SWINGS[:-2:2]))
    assert np.all(SWINGS[:-2] * SWINGS[1:-1] < 0.0)


def test_lift_law_at_other_depths_and_currents(unit):
    """Against states solved by hand: lift over weight at (7-18), and where the same lift is a millimetre deeper."""
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
    """A unit whose magnet moves 20 mm, and whose largest current grows by 4 A, per signal of 1."""

    def run(self, axis, signals, n=1.25, z_s=10.0):
        return Run(20.0 * signals, np.ones_like(signals), 2.0 + 4.0 * np.abs(signals), np.ones_like(signals))


def test_reach_ends_at_the_limit_or_at_the_largest_signal():
    assert hysteresis.reach(Straight(), "x", -1.0, 10.0, 3.55, 0.45) == pytest.approx(20.0 * (1.55 / 4.0))
    assert hysteresis.reach(Straight(), "y", 1.0, 10.0, 9.0, 0.5) == pytest.approx(10.0)


@pytest.mark.parametrize("part", ["S14_x_remanence", "S14_y_remanence", "S14_x_joints", "S14_y_joints"])
def test_rows_set_ours_beside_the_same_branch(monkeypatch, part):
    """Fed the measured branches, every number must agree with the printed one."""
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
            # Along y the unit is its own mirror image.
            other = np.array([float(one.text) for one in printed[name.replace("negative", "positive")]])
            expected = inputs["negative_outward_mm"][0] - (other - inputs["positive_outward_mm"][0])
        assert np.ravel(values) == pytest.approx(expected, abs=1e-9)

"""PID controllers tuned on the machine of a scenario, against the loop of all axes and against simulations."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.dynamics import simulate, tune_axes
from fieldmap.dynamics.scenario.tuning import _keys
from fieldmap.errors import Infeasible, InputError
from tests.refusals import refused

ASKED = {"phase_margin": 40.0, "crossover": 8.0}
QUIET = {"sensors.deviation_mm": [0.0, 0.0, 0.0], "reference.0.by_mm": 0.02}
NUMBERS = ("gain_up", "gain_down", "phase", "crossover", "modulus")


def numbers(margins):
    return [getattr(margins, name) for name in NUMBERS]


@pytest.mark.parametrize("sensors", [{}, {"sensors.scan_rate_Hz": 1200.0, "sensors.averages": 4}])
def test_margins_of_one_axis_are_those_of_the_machine(written, sensors):
    """Six dipoles on a circle: on the axis of the circle the directions do not know each other. Scans that the loop has
    at its samples, and at all moments between them, differ a little."""
    found = tune_axes(written(), ("z", "x", "y"), sensors, **ASKED)
    assert found.point.loop.stable
    for axis, of_machine in zip("zxy", found.point.margins, strict=True):
        tuned = found.axes[axis]
        close = 2e-3 if not sensors else 0.03
        assert numbers(tuned.margins) == pytest.approx(numbers(of_machine), rel=close, abs=1e-6)
        assert tuned.margins.phase >= 40.0
        assert tuned.margins.crossover == pytest.approx(8.0, rel=1e-4)


def test_the_keys_are_the_controllers(written):
    """The depth grows downward and acts on minus the error in scenarios; limits of the file stay."""
    found = tune_axes(written(), ("z", "y"), {"control.y": {"kind": "constant"}}, **ASKED)
    assert set(found.changes) == {"control.z", "control.y"}
    (z, y), ours = (found.changes[f"control.{axis}"] for axis in "zy"), found.axes
    assert (z.pop("lower"), z.pop("upper")) == (0.0, 10.0)
    assert [ours[axis].pid.acts_on_minus_error for axis in "zy"] == [True, False]
    for keys, axis in ((z, "z"), (y, "y")):
        pid = ours[axis].pid
        assert keys == {
            "kind": "pid", "Kc": pid.Kc, "Ti_s": pid.Ti, "Td_s": pid.Td, "Tf_s": pid.Tf, "c": 0.0,
            "integration": "trapezoidal",
        }  # fmt: skip
        assert pid.Ts == 2e-3
    assert found.to_dict()["keys"]["control.y"] == y
    for axis, gain in (("z", -3.0), ("x", 3.0), ("y", 3.0)):
        other = replace(ours["z"], pid=replace(ours["z"].pid, Kc=3.0, acts_on_minus_error=False))
        assert _keys(axis, other)["Kc"] == gain


def test_the_machine_swings_beyond_its_margin_and_not_before(written):
    """Noise-free, a step of 20 um, with the gain near the upper margin: at the last it dies away, or has grown."""
    path = written()
    found = tune_axes(path, ("z",), {"control.z.upper": 20.0}, **ASKED)
    up = found.axes["z"].margins.gain_up
    assert 1.5 < up < 30.0
    ends = {}
    for share in (0.9, 1.1):
        keys = found.changes["control.z"] | {"Kc": share * up * found.axes["z"].pid.Kc}
        run = simulate(path, QUIET | {"control.z": keys, "duration_s": 1.5})
        errors = np.abs(run.error[:, 2])
        ends[share] = errors[-100:].max() / errors[100:200].max()
    assert ends[0.9] < 1e-3
    assert ends[1.1] > 0.3


def test_a_coupled_controller_gives_way(written, six_coils):
    changes = {"map": str(six_coils), "device": "drive_unit", "control.allocation": "lift_and_directions"}
    changes |= {"control.allocation_n": 1.25, "start.depth_mm": 87.0, "body.turning": "upright"}
    found = tune_axes("hold", changes=changes, **ASKED)
    assert found.changes["control.coupled"] is None
    assert found.point.loop.stable
    run = simulate("hold", found.changes)
    assert run.event is None
    assert np.abs(run.error[-100:]).max() < 1e-4


def test_what_cannot_be_had_is_told_at_the_key(written):
    path = written()
    with refused(Infeasible, where="control.z", received="6.51 1/s"):
        tune_axes(path, ("z",), phase_margin=40.0, crossover=1.0)
    with refused(InputError, where="tune_axes(axes)"):
        tune_axes(path, ("depth",))
    with refused(InputError, where="tune_pid(N)"):
        tune_axes(path, ("z",), N=-1.0)

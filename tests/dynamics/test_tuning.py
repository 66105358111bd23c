"""PID controllers tuned on the machine of a scenario, against the loop of all axes and against simulations."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.dynamics import simulate, tune_axes
from fieldmap.dynamics.scenario.tuning import pid_table
from fieldmap.errors import Infeasible, InputError
from tests.refusals import refused

ASKED = {"phase_margin": 40.0, "crossover": 8.0}
QUIET = {"sensors.deviation_mm": [0.0, 0.0, 0.0], "reference.0.by_mm": 0.02}
NUMBERS = ("gain_up", "gain_down", "phase", "crossover", "modulus")


def numbers(margins):
    return [getattr(margins, name) for name in NUMBERS]


@pytest.mark.parametrize("sensors", [{}, {"sensors.scan_rate_Hz": 1200.0, "sensors.averages": 4}])
def test_margins_of_one_axis_are_those_of_the_machine(written, sensors):
    """On the axis of six dipoles on a circle the directions are decoupled. The loop has scans at its samples, while
    tuning averages over all moments between them, which differs a little."""
    found = tune_axes(written(), ("z", "x", "y"), sensors, **ASKED)
    assert found.point.loop.stable
    for axis, of_machine in zip("zxy", found.point.margins, strict=True):
        tuned = found.axes[axis]
        close = 2e-3 if not sensors else 0.03
        assert numbers(tuned.margins) == pytest.approx(numbers(of_machine), rel=close, abs=1e-6)
        assert tuned.margins.phase >= 40.0
        assert tuned.margins.crossover == pytest.approx(8.0, rel=1e-4)


def test_the_keys_are_what_changes_the_controllers(written):
    """Depth counts downward and acts on minus the error in scenarios. Limits of the file stay, and of a PID all keys
    that are not tuned."""
    regulator = {
        "kind": "regulator",
        "A": [[0.0, 1.0], [1.0, 0.0]],
        "B": [0.0, 1.0],
        "C": [1.0, 0.0],
        "Q": [1, 1, 1],
    }
    regulator |= {"R": 1.0, "process_noise": 1.0, "measurement_noise": 1.0, "lower": -0.5, "upper": 0.7}
    stated = {"control.y": regulator, "control.z.b": 0.3, "control.z.integration": "rectangular"}
    found = tune_axes(written(), ("z", "y"), stated, **ASKED)
    assert [found.axes[axis].pid.acts_on_minus_error for axis in "zy"] == [True, False]
    (z, y) = ({"Kc": pid.Kc, "Ti_s": pid.Ti, "Td_s": pid.Td, "Tf_s": pid.Tf, "c": 0.0, "integration": "trapezoidal"}
              for pid in (found.axes[axis].pid for axis in "zy"))  # fmt: skip
    assert found.keys == {f"control.z.{name}": value for name, value in z.items()} | {
        "control.y": {"kind": "pid", **y, "lower": -0.5, "upper": 0.7}
    }
    assert found.changes == stated | found.keys
    assert found.to_dict()["keys"] == found.keys
    assert {tuned.pid.Ts for tuned in found.axes.values()} == {2e-3}
    for axis, gain in (("z", -3.0), ("x", 3.0), ("y", 3.0)):
        other = replace(found.axes["z"].pid, Kc=3.0, acts_on_minus_error=False)
        assert pid_table(axis, other)["Kc"] == gain


def test_the_machine_swings_beyond_its_margin_and_not_before(written):
    """Without noise, a step of 20 um with the gain near the upper margin either decays or grows by the end."""
    path = written()
    found = tune_axes(path, ("z",), {"control.z.upper": 20.0}, **ASKED)
    up = found.axes["z"].margins.gain_up
    assert 1.5 < up < 30.0
    ends = {}
    for share in (0.9, 1.1):
        louder = {"control.z.Kc": share * up * found.axes["z"].pid.Kc}
        run = simulate(path, QUIET | found.changes | louder | {"duration_s": 1.5})
        errors = np.abs(run.error[:, 2])
        ends[share] = errors[-100:].max() / errors[100:200].max()
    assert ends[0.9] < 1e-3
    assert ends[1.1] > 0.3


def test_a_coupled_controller_gives_way(written, six_coils):
    changes = {"map": str(six_coils), "device": "drive_unit", "control.allocation": "lift_and_directions"}
    changes |= {"control.allocation_n": 1.25, "start.depth_mm": 87.0, "body.turning": "upright"}
    found = tune_axes("hold", changes=changes, **ASKED)
    assert list(found.keys) == ["control"]
    assert "coupled" not in found.keys["control"]
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

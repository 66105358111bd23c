"""S18: the optimal regulator of 7.4 on the coupled machine: Tables 7-3 and 7-4, with its estimates."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.control import Estimator, StateSpace, simulate_loop
from fieldmap.curves import Curves, Series
from fieldmap.dynamics.scenario.controllers import AxisRegulator
from fieldmap.thesis import coupled_runs as coupled
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import DEPTH, Readings, X, ours, over_time, run_of
from fieldmap.thesis.vertical import design_of
from fieldmap.typing import Array

_BEGIN, _END = 0.9, 2.0


def step_and_states(run: Readings, quiet: Readings, rig_peak: ArrayLike) -> list[Curves]:
    """Figs 7-32 to 7-34: run with the sensor's noise, quiet without. rig_peak: s after the step, mm beyond it."""
    keys, Ts = _keys(run), run.run.scenario.settings.control.period
    model = StateSpace(np.array(keys.A), np.array(keys.B)[:, None], np.array(keys.C)[None], np.zeros((1, 1)))
    plant, designed = design_of(model, keys.Q, keys.R, (keys.process_noise, keys.measurement_noise), Ts)
    # The thesis's model feeds back x[n-1|n-1].
    regulator = replace(designed, equilibrium_at="measured")
    reference = run.wanted[:, DEPTH] - run.wanted[0, DEPTH]
    loop = simulate_loop(plant, regulator, reference)
    position = run.wanted[0, DEPTH] + loop.y[0]
    lines, models = {"coupled machine": run, "without noise": quiet}, {"design model": position}
    title = "Fig. 7-32: step from 13 to 12.9 mm, regulator"
    remark = "Model: (7-7) with the regulator as it was designed."
    step = over_time(title, DEPTH, lines, begin=_BEGIN, end=_END, remark=remark, models=models)
    after, beyond = np.asarray(rig_peak, dtype=float)
    end = float(run.wanted[-1, DEPTH])
    curves = [coupled.with_measured(step, "peak of the rig, Table 7-3", [1.0 + after], [end - beyond])]
    keys, seen = _keys(quiet), quiet.seen[:, DEPTH]
    assert keys.equilibrium is not None
    intercept, slope = keys.equilibrium
    control = quiet.run.outputs[:, 0] - intercept - slope * seen
    of_machine = filtered_states(regulator.estimator, control, seen - quiet.wanted[:, DEPTH])
    voltage = loop.u[0] - regulator.equilibrium[1] * loop.y[0]
    of_model = filtered_states(regulator.estimator, voltage, loop.y[0] - reference)
    shown = run.during(_BEGIN, _END)
    for k, label in enumerate(("$x_1$ (V s)", "$x_2$ (V s²)")):
        series = (
            Series("coupled machine, without noise", run.time[shown], of_machine[shown, k]),
            Series("design model", run.time[shown], of_model[shown, k], "published"),
        )
        title = f"Fig. 7-{33 + k}: estimated state $x_{k + 1}$ meanwhile"
        curves.append(Curves(title, "time (s)", label, series))
    return curves


def filtered_states(estimator: Estimator, control: Array, deviation: Array) -> Array:
    """x[n|n] (samples, n) from the deviations of control and measurement from their equilibrium: (7-15)."""
    A, B, C, D = (np.asarray(matrix) for matrix in estimator)
    predicted, states = np.zeros(len(A)), np.empty((len(control), len(A)))
    for n, (u, y) in enumerate(zip(control, deviation, strict=True)):
        states[n] = C[1:] @ predicted + D[1:, 1] * y
        predicted = A @ predicted + B @ (u, y)
    return states


def _keys(run: Readings) -> AxisRegulator:
    keys = run.run.scenario.settings.control.z
    assert isinstance(keys, AxisRegulator)
    return keys


def regulator(inputs: dict[str, Any]) -> Answers:
    """Table 7-3, and 7.4.1 on horizontal motion."""
    pid, on_pid = run_of(inputs, "vertical_step"), {"control.z": coupled.VERTICAL_PID}
    near = run_of(inputs, "regulator", {**on_pid, "reference.0.by_mm": 0.0, "start.depth_mm": 12.9})
    best, quiet = run_of(inputs, "regulator"), run_of(inputs, "regulator", {"noise.off": True})
    sides = coupled.runs_of(inputs, "regulator_sideways", {"regulator": {}, "PID": on_pid})
    numbers = {name: ours(run.column(DEPTH), run) for name, run in (("pid", pid), ("regulator", quiet))}
    numbers["time_to_reference"] = ours(quiet.time_to_reference(DEPTH, 1.0), quiet)
    numbers["rms_at_rest"] = ours([near.rms(DEPTH, 1.0), best.rms(DEPTH, 2.0)], near, best)
    numbers["rms_sideways"] = ours([run.rms(DEPTH, 1.0) for run in sides.values()], *sides.values())
    curves = (
        *step_and_states(best, quiet, (inputs["rig_peak_time_s"], 1e-3 * inputs["rig_overshoot_percent"])),
        over_time("Figs 7-36, 7-38: the height while x and y step", DEPTH, dict(reversed(sides.items()))),
        over_time("Figs 7-35, 7-37: x meanwhile", X, sides),
    )
    slow = run_of(inputs, "regulator", {"noise.off": True, "coils.time_constant_ms": 2.0}).step(DEPTH)
    return Answers(numbers, curves, {"slow": slow})


def heights(inputs: dict[str, Any]) -> Answers:
    """Table 7-4, and how far from the block the regulator holds."""

    def above_the_block(gap: Any, changes: dict[str, Any]) -> Readings:
        return run_of(
            inputs, "regulator", {"start.depth_mm": float(inputs["block_below_mm"] - gap), **changes}
        )

    def farther(changes: dict[str, Any]) -> list[str]:
        said = []
        for gap in inputs["further_gaps_mm"]:
            run = above_the_block(gap, {"duration_s": 6.0, **changes})
            last = run.departure(DEPTH, 0.75 * run.time[-1])
            held = f"held within {last:.2f} mm" if last < 1.0 else f"swings by {last:.1f} mm"
            said.append(f"{gap:g} mm: {run.run.metrics.event or held}")
        return said

    runs = [above_the_block(gap, {"reference.0.by_mm": 0.0}) for gap in inputs["gaps_mm"]]
    numbers = {"rms": ours([run.rms(DEPTH, 1.0) for run in runs], *runs)}
    damped = {"drag.linear_N_s_per_m": [float(inputs["identified_drag_N_s_per_m"])] * 3}
    return Answers(numbers, facts={"farther": farther({}), "farther_damped": farther(damped)})

"""S18: the optimal regulator of 7.4 on the linked machine: Tables 7-3 and 7-4."""

from typing import Any

from fieldmap.thesis.linked_runs import DEPTH, VERTICAL_PID, Readings, X, ours, over_time, run_of
from fieldmap.thesis.registry import Answers
from fieldmap.thesis.regulator_states import step_and_states


def regulator(inputs: dict[str, Any]) -> Answers:
    """Table 7-3, and 7.4.1 on horizontal motion."""
    pid = run_of(inputs, "vertical_step")
    near = run_of(
        inputs, "regulator", {"control.z": VERTICAL_PID, "reference.0.by_mm": 0.0, "start.depth_mm": 12.9}
    )
    best, quiet = run_of(inputs, "regulator"), run_of(inputs, "regulator", {"noise.off": True})
    sides = {
        "regulator": run_of(inputs, "regulator_sideways"),
        "PID": run_of(inputs, "regulator_sideways", {"control.z": VERTICAL_PID}),
    }
    numbers: dict[str, Any] = {}
    for name, run in (("pid", pid), ("regulator", quiet)):
        step = run.step(DEPTH)
        column = [step.peak_time, step.rise_time, step.settling_time, 100 * step.overshoot]
        numbers[name] = ours(column, run)
    numbers["time_to_reference"] = ours(quiet.time_to_reference(DEPTH, 1.0), quiet)
    numbers["rms_at_rest"] = ours([near.rms(DEPTH, 1.0), best.rms(DEPTH, 2.0)], near, best)
    numbers["rms_sideways"] = ours([run.rms(DEPTH, 1.0) for run in sides.values()], *sides.values())
    curves = (
        *step_and_states(best, quiet, inputs["rig_peak"]),
        over_time("Figs 7-36, 7-38: the height while x and y step", DEPTH, dict(reversed(sides.items()))),
        over_time("Figs 7-35, 7-37: x meanwhile", X, sides),
    )
    slow = run_of(inputs, "regulator", {"noise.off": True, "coils.time_constant_ms": 2.0}).step(DEPTH)
    words = (
        f"With an amplifier that takes 2 ms, which the thesis does not print, the overshoot is "
        f"{100 * slow.overshoot:.0f} % and the peak comes after {slow.peak_time:.3f} s."
    )
    return Answers(numbers, curves, {"regulator": words})


def heights(inputs: dict[str, Any]) -> Answers:
    """Table 7-4, and how far from the block the regulator holds."""
    face = inputs["block_below_mm"]
    runs = [
        run_of(inputs, "regulator", {"reference.0.by_mm": 0.0, "start.depth_mm": float(face - gap)})
        for gap in inputs["gaps_mm"]
    ]
    numbers = {"rms": ours([run.rms(DEPTH, 1.0) for run in runs], *runs)}
    drag = float(inputs["identified_drag_N_s_per_m"])
    words = (
        f"Farther from the block, after a step of 0.1 mm: {_farther(inputs, {})}. With the damping of (7-7), "
        f"{drag:g} N s/m, in the place of the air's: {_farther(inputs, {'drag.linear_N_s_per_m': [drag] * 3})}."
    )
    return Answers(numbers, (), {"": words})


def _farther(inputs: dict[str, Any], changes: dict[str, Any]) -> str:
    """What becomes of the regulator at each further gap."""
    said = []
    for gap in inputs["further_gaps_mm"]:
        depth = float(inputs["block_below_mm"] - gap)
        run = run_of(inputs, "regulator", {"start.depth_mm": depth, "duration_s": 6.0, **changes})
        said.append(f"{gap:g} mm: {run.run.metrics.event or _held(run)}")
    return "; ".join(said)


def _held(run: Readings) -> str:
    last = run.departure(DEPTH, 0.75 * run.time[-1])
    return f"held within {last:.2f} mm" if last < 1.0 else f"swings by {last:.1f} mm"

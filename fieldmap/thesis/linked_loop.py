"""S18, S19: the linked closed loop on the map, by the shipped scenarios."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldmap.dynamics import ScenarioRun, simulate
from fieldmap.dynamics.scenario import reading_mm
from fieldmap.thesis.registry import Answers, Ours

Array = NDArray[np.float64]

DEPTH = 2


def _ours(value: Any, run: ScenarioRun) -> Ours:
    scenario = f"scenario `{run.scenario.path.stem}`, whose file names every choice; controller times taken as minutes"
    return Ours(value, (scenario, *run.assumptions))


def _seen_rms(run: ScenarioRun, axis: int, share: float = 0.25) -> float:
    """Root mean square of what the sensors show against the reference, mm, over the last share of a run."""
    part = slice(int((1.0 - share) * len(run.time)), None)
    error = (
        reading_mm(run.scenario, run.seen)[part, axis] - reading_mm(run.scenario, run.references)[part, axis]
    )
    return float(np.sqrt(np.mean(error**2)))


def vertical(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 7-1."""
    run = simulate("vertical_step", field_map=inputs["map"])
    step = run.metrics.axes[DEPTH].step
    assert step is not None
    numbers = {
        "peak_time": step.peak_time,
        "rise_time": step.rise_time,
        "settling_time": step.settling_time,
        "overshoot": 100 * step.overshoot,
        "rms_at_rest": _seen_rms(run, DEPTH),
    }
    return {name: _ours(value, run) for name, value in numbers.items()}


def horizontal(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 7-2."""
    runs = [
        simulate("horizontal_pid", {"reference.0.axis": axis}, field_map=inputs["map"]) for axis in ("x", "y")
    ]
    steps = [run.metrics.axes[k].step for k, run in enumerate(runs)]
    rise = [step.rise_time for step in steps if step is not None]
    over = [100 * step.overshoot for step in steps if step is not None]
    rms = [_seen_rms(run, k) for k, run in enumerate(runs)]
    return {
        "rise_time": _ours(rise, runs[0]),
        "overshoot": _ours(over, runs[0]),
        "rms_at_rest": _ours(rms, runs[0]),
    }


def spikes(inputs: dict[str, Any]) -> Answers:
    """7.1.2: largest departure of the height, mm, while x steps."""
    ways: dict[str, dict[str, Any]] = {
        "spike": {},
        "with_compensator": {"control.compensator.push_mm": inputs["push_mm"]},
        "with_small_gain": {"control.x.Kc": inputs["small_gain"]},
    }
    numbers = {}
    for name, changes in ways.items():
        run = simulate("spikes", changes, field_map=inputs["map"])
        numbers[name] = _ours(_largest(run), run)
    small = numbers.pop("with_small_gain").value
    words = (
        f"With the horizontal gain {inputs['small_gain']:g} ours departs by {small:.3f} mm, within the noise of the "
        "measured height: the spikes are gone, as in Figs 7-13, 7-14. As measured, the push of the reference hardly "
        "makes them smaller. Their size goes with how sharply the lift falls when the currents leave balance."
    )
    return Answers(numbers, (), {"": words})


def _largest(run: ScenarioRun) -> float:
    """Largest distance of the true depth from that asked for at the beginning, mm."""
    depth = reading_mm(run.scenario, run.sensed)[:, DEPTH]
    return float(np.abs(depth - reading_mm(run.scenario, run.references)[0, DEPTH]).max())


def circles(inputs: dict[str, Any]) -> dict[str, Any]:
    """7.3: the height on circles of 0.5 and 3 mm."""
    rms = []
    run = None
    for r, rate in zip(inputs["radii_mm"], inputs["rates_rad_per_s"], strict=True):
        changes = {
            "reference.0.by_mm": r,
            "reference.1.by_mm": -r,
            "reference.2.radius_mm": r,
            "reference.2.rate_rad_per_s": rate,
        }
        run = simulate("circle", changes, field_map=inputs["map"])
        part = run.time > inputs["settled_s"]
        seen = reading_mm(run.scenario, run.seen)[part, DEPTH]
        wanted = reading_mm(run.scenario, run.references)[part, DEPTH]
        rms.append(float(np.sqrt(np.mean((seen - wanted) ** 2))))
    assert run is not None
    return {"vertical_rms": _ours(rms, run)}

"""S18: the coupled closed loop on the map, by the shipped scenarios. Tables 7-1 and 7-2, and 7.1."""

from typing import Any

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import (
    DEPTH,
    VERTICAL_PID,
    Readings,
    X,
    Y,
    ours,
    over_time,
    run_of,
    with_measured,
)

TIMES = ("peak_time", "rise_time", "settling_time")


def vertical(inputs: dict[str, Any]) -> Answers:
    """Table 7-1."""
    base = run_of(inputs, "vertical_step")
    step = base.step(DEPTH)
    column = [step.peak_time, step.rise_time, step.settling_time, 100 * step.overshoot]
    column.append(base.rms(DEPTH, 0.75 * base.time[-1]))
    names = (*TIMES, "overshoot", "rms_at_rest")
    numbers = {name: ours(value, base) for name, value in zip(names, column, strict=True)}
    numbers["time_to_reference"] = ours(base.time_to_reference(DEPTH, 1.0), base)
    numbers["setup_of_30"] = ours(column, base)
    drag = inputs["identified_drag_N_s_per_m"]
    slow = run_of(inputs, "vertical_step", {"drag.linear_N_s_per_m": [drag] * 3})
    name = f"damping of (7-7), {drag:g} N s/m"
    title = "Table 7-1: step of 1 mm, PID of 7.2.1"
    curves = (over_time(title, DEPTH, {"air": base, name: slow}, begin=0.8, end=3.0),)
    return Answers(numbers, curves, _tried(inputs, slow))


def _tried(inputs: dict[str, Any], slow: Readings) -> dict[str, str]:
    """What damping, gain and lag do to the step."""
    weaker = {"control.z.Kc": 0.8 * VERTICAL_PID["Kc"]}
    drag = {"drag.linear_N_s_per_m": [0.005, 0.005, float(inputs["between_drag_N_s_per_m"])]}
    runs = {
        "with_damping": slow,
        "with_less_gain": run_of(inputs, "vertical_step", weaker),
        "with_both": run_of(inputs, "vertical_step", {**weaker, **drag}),
        "with_a_lag": run_of(inputs, "vertical_step", {"coils.time_constant_ms": 5.0}),
    }
    return {name: _step_in_words(run) for name, run in runs.items()}


def _step_in_words(run: Readings) -> str:
    step = run.step(DEPTH)
    return (
        f"rise {step.rise_time:.3f} s, reference reached after {run.time_to_reference(DEPTH, 1.0):.3f} s, "
        f"peak {step.peak_time:.2f} s, settling {step.settling_time:.2f} s, overshoot {100 * step.overshoot:.0f} %"
    )


def horizontal(inputs: dict[str, Any]) -> Answers:
    """Table 7-2."""
    runs = {
        "x": run_of(inputs, "horizontal_pid"),
        "y": run_of(inputs, "horizontal_pid", {"reference.0.axis": "y"}),
    }
    steps = [run.step(axis) for axis, run in enumerate(runs.values())]
    share = 0.75 * runs["x"].time[-1]
    every = tuple(runs.values())
    numbers = {
        "rise_time": ours([step.rise_time for step in steps], *every),
        "overshoot": ours([100 * step.overshoot for step in steps], *every),
        "rms_at_rest": ours([run.rms(axis, share) for axis, run in enumerate(every)], *every),
    }
    twice = run_of(inputs, "horizontal_pid", {"control.x.Kc": 0.05})
    curves = tuple(
        over_time(f"Fig. 7-21: step of {name} by 0.1 mm at 11 mm", axis, {name: run}, begin=1.0)
        for axis, (name, run) in enumerate(runs.items())
    )
    return Answers(numbers, curves, {"rise_of_twice_the_gain_s": twice.step(X).rise_time})


SMALL_STEPS = {"reference.0.by_mm": 0.01, "reference.0.times": 10, "reference.0.every_s": 0.5}
ON_THE_AXIS = {
    "start.x_mm": 0.0,
    "start.y_mm": 0.0,
    "start.depth_mm": 10.0,
    "reference.0.by_mm": 0.1,
}
OF_Y = {"reference.0.axis": "y", "reference.1.axis": "x"}
GAIN_1 = {
    f"control.{axis}.{key}": v for axis in "xy" for key, v in (("Kc", 1.0), ("Ti_s", 0.3), ("Td_s", 6e-5))
}


def combined(inputs: dict[str, Any]) -> Answers:
    """7.1.1 and 7.1.3: what a motion along some axes does to the others."""
    steps = {
        "x alone": run_of(inputs, "horizontal_pid", {"control.y": {"kind": "constant"}}),
        "both controlled": run_of(inputs, "horizontal_pid"),
        "both step": run_of(inputs, "horizontal_pid", {"reference.1.by_mm": 0.1}),
    }
    one = steps["both controlled"]
    slow = run_of(inputs, "horizontal_pid", SMALL_STEPS)
    aside = run_of(inputs, "vertical_steps")
    middle = run_of(inputs, "vertical_steps", ON_THE_AXIS)
    numbers = {
        "y_when_x_steps": ours(_shift(one, Y), one),
        "y_when_x_goes_slowly": ours(_shift(slow, Y), slow),
        "aside_when_z_steps": ours([_aside(middle), _aside(aside)], middle, aside),
    }
    y_steps = {
        "y alone": run_of(inputs, "horizontal_pid", {"control.x": {"kind": "constant"}, **OF_Y}),
        "both controlled": run_of(inputs, "horizontal_pid", OF_Y),
        "both step": steps["both step"],
    }
    curves = (
        over_time("Figs 7-1, 7-5: step of x by 0.1 mm", X, steps, begin=1.5, end=9.0),
        over_time("Figs 7-2, 7-5: step of y by 0.1 mm", Y, y_steps, begin=1.5, end=9.0),
        over_time(
            "Figs 7-3, 7-4: y while x moves by 0.1 mm", Y, {"one step": one, "ten steps": slow}, begin=1.0
        ),
        *_steps_of_the_height(middle, aside),
    )
    stiff = run_of(inputs, "horizontal_pid", {**GAIN_1, "reference.1.by_mm": 0.1})
    both = [run.step(X) for run in steps.values()]
    facts = {
        "rises_s": [step.rise_time for step in both],
        "overshoots_percent": [100 * step.overshoot for step in both],
        "end_at_gain_1": stiff.run.metrics.event
        or f"stays up, its height off by {stiff.departure(DEPTH, 1.0):.2f} mm at most",
    }
    return Answers(numbers, curves, facts)


def _steps_of_the_height(middle: Readings, aside: Readings) -> list[Curves]:
    """Figs 7-16 to 7-19."""
    curves = []
    for numbers, place, run in (((16, 17), "(0, 0)", middle), ((18, 19), "(1, 1) mm", aside)):
        title = f"Fig. 7-{numbers[0]}: steps of the height at {place}"
        curves.append(over_time(title, DEPTH, {"depth": run}))
        away = run.true - run.wanted
        series = tuple(Series(name, run.time, away[:, axis]) for name, axis in (("x", X), ("y", Y)))
        title = f"Fig. 7-{numbers[1]}: x and y meanwhile, from {place}"
        remark = "True positions: the sensors show them under a noise of 0.007 mm."
        curves.append(Curves(title, "time (s)", "deviation (mm)", series, remark))
    return curves


def _shift(run: Readings, axis: int) -> float:
    """Largest departure of the true position from the reference, mm: under the sensors' noise."""
    return float(np.abs((run.true - run.wanted)[:, axis]).max())


def _aside(run: Readings) -> float:
    return max(_shift(run, X), _shift(run, Y))


def spikes(inputs: dict[str, Any]) -> Answers:
    """7.1.2: largest departure of the measured height, mm, while x steps, and each remedy."""
    ways: dict[str, dict[str, Any]] = {
        "gain 1": {},
        "gain 1, push": {
            "control.compensator.push_mm": inputs["push_mm"],
            "control.compensator.duration_ms": inputs["duration_ms"],
        },
    }
    ways |= {f"gain {gain:g}": {"control.x.Kc": float(gain)} for gain in inputs["small_gains"]}
    runs = {name: run_of(inputs, "spikes", changes) for name, changes in ways.items()}
    sizes = {name: run.departure(DEPTH, 1.0) for name, run in runs.items()}
    still = runs["gain 1"].departure(DEPTH, 0.0, 2.0)
    numbers = {
        "spike": ours(sizes["gain 1"], runs["gain 1"]),
        "with_compensator": ours(sizes["gain 1, push"], runs["gain 1, push"]),
    }
    tuned = f"gain {float(inputs['small_gains'][0]):g}"
    one = {name: runs[name] for name in ("gain 1", "gain 1, push", tuned)}
    curves = (
        over_time("Figs 7-6, 7-8, 7-12: steps of x", X, runs, begin=1.0),
        over_time("Figs 7-11, 7-15: one step of x", X, one, begin=9.8, end=11.8),
        over_time("Figs 7-7, 7-9, 7-13: the height meanwhile", DEPTH, runs, begin=1.0),
        _one_spike(inputs, runs),
        over_time("Fig. 7-14: the height at rest", DEPTH, {"depth": runs[tuned]}, end=2.0),
    )
    plain = run_of(inputs, "spikes", {"field.iron": "linearised"}).departure(DEPTH, 1.0)
    small = [sizes[f"gain {gain:g}"] for gain in inputs["small_gains"]]
    facts = {
        "small_spikes_mm": small,
        "spikes_then": ["gone" if size < 1.5 * still else "still there" for size in small],
        "still_mm": still,
        "linearised_mm": plain,
    }
    return Answers(numbers, curves, facts)


def _one_spike(inputs: dict[str, Any], runs: dict[str, Readings]) -> Curves:
    """Fig. 7-10, with how far the rig went on the same step."""
    both = {name: runs[name] for name in ("gain 1", "gain 1, push")}
    window = (9.8, 11.8)
    title = "Fig. 7-10: one spike with and without the push"
    drawn = over_time(title, DEPTH, both, begin=window[0], end=window[1])
    for words, peak in zip(("", ", push"), inputs["rig_peaks_mm"], strict=True):
        drawn = with_measured(drawn, f"peak of the rig{words}", window, [peak, peak], points=False)
    return drawn

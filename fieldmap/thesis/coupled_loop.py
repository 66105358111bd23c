"""S18, S19: the coupled closed loop on the map, by the shipped scenarios: Tables 7-1 and 7-2, 7.1; sway and block of
6.1, PD and PID of 6.5 and 6.6, range of 7.2.3; circles of 7.3; the optimal regulator of 7.4 with its state estimates,
Tables 7-3 and 7-4."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.control import Estimator, StateSpace, simulate_loop
from fieldmap.curves import Curves, Series
from fieldmap.dynamics.scenario.controllers import AxisRegulator
from fieldmap.thesis import coupled_runs as coupled
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import DEPTH, Readings, X, Y, ours, over_time, run_of, runs_of
from fieldmap.thesis.vertical import design_of
from fieldmap.typing import Array


def vertical(inputs: dict[str, Any]) -> Answers:
    """Table 7-1."""
    drag, weaker = inputs["identified_drag_N_s_per_m"], {"control.z.Kc": 0.8 * coupled.VERTICAL_PID["Kc"]}
    between = {"drag.linear_N_s_per_m": [0.005, 0.005, float(inputs["between_drag_N_s_per_m"])]}
    changes: dict[str, Any] = {
        "air": {},
        "with_damping": {"drag.linear_N_s_per_m": [drag] * 3},
        "with_less_gain": weaker,
        "with_both": weaker | between,
        "with_a_lag": {"coils.time_constant_ms": 5.0},
    }
    runs = runs_of(inputs, "vertical_step", changes)
    base = runs["air"]
    column = [*base.column(DEPTH), base.rms(DEPTH, 0.75 * base.time[-1])]
    names = ("peak_time", "rise_time", "settling_time", "overshoot", "rms_at_rest")
    found: dict[str, Any] = dict(zip(names, column, strict=True))
    found |= {"time_to_reference": base.time_to_reference(DEPTH, 1.0), "setup_of_30": column}
    lines = {"air": base, f"damping of (7-7), {drag:g} N s/m": runs["with_damping"]}
    title = "Table 7-1: step of 1 mm, PID of 7.2.1"
    curves = (over_time(title, DEPTH, lines, begin=0.8, end=3.0),)
    facts = {name: _step_in_words(run) for name, run in runs.items()}
    return Answers({name: ours(value, base) for name, value in found.items()}, curves, facts)


def _step_in_words(run: Readings) -> str:
    step = run.step(DEPTH)
    return (
        f"rise {step.rise_time:.3f} s, reference reached after {run.time_to_reference(DEPTH, 1.0):.3f} s, "
        f"peak {step.peak_time:.2f} s, settling {step.settling_time:.2f} s, overshoot {100 * step.overshoot:.0f} %"
    )


def horizontal(inputs: dict[str, Any]) -> Answers:
    """Table 7-2."""
    runs = runs_of(inputs, "horizontal_pid", {"x": {}, "y": {"reference.0.axis": "y"}})
    every = list(enumerate(runs.values()))
    columns = np.array([run.column(axis) for axis, run in every])
    rms = [run.rms(axis, 0.75 * run.time[-1]) for axis, run in every]
    found = {"rise_time": columns[:, 1], "overshoot": columns[:, 3], "rms_at_rest": rms}
    twice = run_of(inputs, "horizontal_pid", {"control.x.Kc": 0.05})
    curves = tuple(
        over_time(f"Fig. 7-21: step of {name} by 0.1 mm at 11 mm", axis, {name: run}, begin=1.0)
        for axis, (name, run) in enumerate(runs.items())
    )
    numbers = {name: ours(value, *runs.values()) for name, value in found.items()}
    return Answers(numbers, curves, {"rise_of_twice_the_gain_s": twice.step(X).rise_time})


SMALL_STEPS = {"reference.0.by_mm": 0.01, "reference.0.times": 10, "reference.0.every_s": 0.5}
ON_THE_AXIS = {"start.x_mm": 0.0, "start.y_mm": 0.0, "start.depth_mm": 10.0, "reference.0.by_mm": 0.1}
GAIN_1 = {
    f"control.{axis}.{key}": v for axis in "xy" for key, v in (("Kc", 1.0), ("Ti_s", 0.3), ("Td_s", 6e-5))
}


def combined(inputs: dict[str, Any]) -> Answers:
    """7.1.1 and 7.1.3: effect of a motion along one axis or two on the other axes."""
    still, both_step = {"kind": "constant"}, {"reference.1.by_mm": 0.1}
    to_y = {"reference.0.axis": "y", "reference.1.axis": "x"}
    changes: dict[str, Any] = {
        "x alone": {"control.y": still},
        "both controlled": {},
        "both step": both_step,
        "y alone": {"control.x": still, **to_y},
        "y of both": to_y,
        "ten steps": SMALL_STEPS,
        "gain 1": {**GAIN_1, **both_step},
    }
    runs = runs_of(inputs, "horizontal_pid", changes)
    steps = {name: runs[name] for name in ("x alone", "both controlled", "both step")}
    of_y = {"y alone": "y alone", "both controlled": "y of both", "both step": "both step"}
    y_steps = {name: runs[of] for name, of in of_y.items()}
    one, slow, stiff = runs["both controlled"], runs["ten steps"], runs["gain 1"]
    aside, middle = run_of(inputs, "vertical_steps"), run_of(inputs, "vertical_steps", ON_THE_AXIS)
    numbers = {
        "y_when_x_steps": ours(_shift(one, Y), one),
        "y_when_x_goes_slowly": ours(_shift(slow, Y), slow),
        "aside_when_z_steps": ours([_shift(run, X, Y) for run in (middle, aside)], middle, aside),
    }
    both = {"one step": one, "ten steps": slow}
    curves = [
        over_time("Figs 7-1, 7-5: step of x by 0.1 mm", X, steps, begin=1.5, end=9.0),
        over_time("Figs 7-2, 7-5: step of y by 0.1 mm", Y, y_steps, begin=1.5, end=9.0),
        over_time("Figs 7-3, 7-4: y while x moves by 0.1 mm", Y, both, begin=1.0),
    ]
    remark = "True positions: the sensors show them under a noise of 0.007 mm."
    for first, place, run in ((16, "(0, 0)", middle), (18, "(1, 1) mm", aside)):
        curves.append(over_time(f"Fig. 7-{first}: steps of the height at {place}", DEPTH, {"depth": run}))
        away = (run.true - run.wanted).T
        series = tuple(Series(name, run.time, away[axis]) for axis, name in enumerate("xy"))
        title = f"Fig. 7-{first + 1}: x and y meanwhile, from {place}"
        curves.append(Curves(title, "time (s)", "deviation (mm)", series, remark))
    columns = [run.column(X) for run in steps.values()]
    facts = {
        "rises_s": [column[1] for column in columns],
        "overshoots_percent": [column[3] for column in columns],
        "end_at_gain_1": stiff.run.metrics.event
        or f"stays up, its height off by {stiff.departure(DEPTH, 1.0):.2f} mm at most",
    }
    return Answers(numbers, tuple(curves), facts)


def _shift(run: Readings, *axes: int) -> float:
    """Largest departure of the true position from the reference, mm; the sensors' noise would hide it."""
    return float(np.abs((run.true - run.wanted)[:, axes]).max())


def spikes(inputs: dict[str, Any]) -> Answers:
    """7.1.2: largest departure of the measured height, mm, while x steps, without and with each remedy."""
    push = {f"control.compensator.{name}": inputs[name] for name in ("push_mm", "duration_ms")}
    gains = {f"gain {gain:g}": {"control.x.Kc": float(gain)} for gain in inputs["small_gains"]}
    runs = runs_of(inputs, "spikes", {"gain 1": {}, "gain 1, push": push, **gains})
    sizes = {name: run.departure(DEPTH, 1.0) for name, run in runs.items()}
    still = runs["gain 1"].departure(DEPTH, 0.0, 2.0)
    numbers = {
        name: ours(sizes[of], runs[of])
        for name, of in (("spike", "gain 1"), ("with_compensator", "gain 1, push"))
    }
    tuned, *_ = gains
    both = {name: runs[name] for name in ("gain 1", "gain 1, push")}
    window = (9.8, 11.8)
    # Lines at the peaks of the rig on the same step.
    spike = over_time("Fig. 7-10: one spike with and without the push", DEPTH, both, begin=9.8, end=11.8)
    for words, peak in zip(("", ", push"), inputs["rig_peaks_mm"], strict=True):
        spike = coupled.with_measured(spike, f"peak of the rig{words}", window, [peak, peak], points=False)
    one = {**both, tuned: runs[tuned]}
    curves = (
        over_time("Figs 7-6, 7-8, 7-12: steps of x", X, runs, begin=1.0),
        over_time("Figs 7-11, 7-15: one step of x", X, one, begin=9.8, end=11.8),
        over_time("Figs 7-7, 7-9, 7-13: the height meanwhile", DEPTH, runs, begin=1.0),
        spike,
        over_time("Fig. 7-14: the height at rest", DEPTH, {"depth": runs[tuned]}, end=2.0),
    )
    small = [sizes[name] for name in gains]
    facts = {
        "small_spikes_mm": small,
        "spikes_then": ["gone" if size < 1.5 * still else "still there" for size in small],
        "still_mm": still,
        "linearised_mm": run_of(inputs, "spikes", {"field.iron": "linearised"}).departure(DEPTH, 1.0),
    }
    return Answers(numbers, curves, facts)


UPWARD = {"reference.0.by_mm": -10.0}
BEYOND = {"coils.end_beyond_table": False, "reference.0.by_mm": 40.0, "duration_s": 25.0}


def sway(inputs: dict[str, Any]) -> Answers:
    """6.1: a step in open loop without and with the block; the height near the block."""
    free = run_of(inputs, "horizontal_open_loop")
    block = run_of(inputs, "horizontal_open_loop_plate")
    plate = block.run.scenario.contents.plate
    assert plate is not None
    near = run_of(inputs, "vertical_step", {"plate": {**plate.model_dump(), "face_mm": [0.0, 0.0, -110.0]}})
    far = run_of(inputs, "vertical_step")
    rest = float(np.mean(block.true[block.during(0.75 * block.time[-1]), X]))
    numbers = {
        "settling_with_block": ours(_reaches(block, rest), block),
        "vertical_settling_near_block": ours(near.step(DEPTH).settling_time, near),
    }
    last = 0.75 * free.time[-1]
    swings = [float(np.ptp(run.true[run.during(last), X])) / 2 for run in (free, block)]
    both, title = {"no block": far, "block": near}, "Fig. 6-3: step of the height by 1 mm"
    curves = (
        over_time("Fig. 6-1: step of the x signal, no block", X, {"no block": free}, asked=False),
        over_time("Fig. 6-2: the same above the block", X, {"above the block": block}, asked=False),
        over_time(title, DEPTH, both, begin=0.8, end=3.5),
    )
    rises = {f"rise_{name}_s": run.step(DEPTH).rise_time for name, run in (("near", near), ("far", far))}
    return Answers(numbers, curves, {"swings_mm": swings, **rises})


def _reaches(run: Readings, rest: float, band: float = 0.05) -> float:
    """Settling time, s, from the step of the signal at 1 s until x stays within a band of 5 % of its step."""
    begin = float(run.true[run.during(0.0, 1.0), X].mean())
    away = np.abs(run.true[:, X] - rest) > band * abs(rest - begin)
    return float(run.time[np.flatnonzero(away)[-1]] - 1.0) if away.any() else 0.0


def proportional(inputs: dict[str, Any]) -> Answers:
    """6.5: rest positions of the magnet under a PD controller, out and back."""
    x = run_of(inputs, "horizontal_pd")
    controller = x.run.scenario.contents.control.x
    assert controller is not None
    changes = {
        "control.y": controller.model_dump(exclude_none=True),
        "control.x": {"kind": "constant"},
        "start.y_mm": 0.0,
        "reference.0.axis": "y",
        "reference.1.axis": "y",
    }
    y = run_of(inputs, "horizontal_pd", changes)
    numbers = {
        "x_at_0.9_1.0_0.9": ours([_held_at(x, X, k) for k in (9, 10, 11)], x),
        "y_at_0.1_and_back": ours([_held_at(y, Y, k) for k in (1, 19)], y),
    }
    negative = run_of(inputs, "horizontal_pd", {"reference.0.by_mm": -0.1, "reference.1.by_mm": 0.1})
    late, at = (14.2, 18.4), [15.15, 16.65, 18.15]
    curves = []
    # The figures with the means that 6.5 prints.
    for title, axis, run, shown, times, means in (
        ("12: x under PD control: 0.9, 1, 0.9 mm", X, x, late, at, "x_means_mm"),
        ("13: x under PD control: -0.9, -1, -0.9 mm", X, negative, late, at, "negative_x_means_mm"),
        ("15: y under PD control: 0.9, 1, 0.9 mm", Y, y, late, [], ""),
        ("16: y under PD control, 0 to 1 mm and back", Y, y, (0.0, np.inf), [3.15, 30.15], "y_means_mm"),
    ):
        one = over_time(f"Fig. 6-{title}", axis, {"xy"[axis]: run}, begin=shown[0], end=shown[1])
        curves.append(coupled.with_measured(one, "mean of the rig", times, inputs[means]) if means else one)
    # Five steps out to 0.5 mm and one step back, Ti = 0.005.
    way = {"reference.0.times": 5, "reference.1.times": 1, "reference.1.at_s": 9.5, "duration_s": 12.0}
    for title, axis, name in (("Figs 6-17, 6-18", X, "x"), ("Fig. 6-19", Y, "y")):
        to_axis = changes if name == "y" else {}
        run = run_of(inputs, "horizontal_pd", {**to_axis, **way, f"control.{name}.Ti_s": 0.3})
        curves.append(over_time(f"{title}: {name} under PID control", axis, {name: run}, begin=1.0))
    return Answers(numbers, tuple(curves))


def _held_at(run: Readings, axis: int, steps: int) -> float:
    """Mean position, mm, in the last 0.7 s after `steps` of the ten steps out and ten back, one every 1.5 s."""
    end = 2.0 + 1.5 * steps
    return run.mean(axis, end - 0.7, end - 0.01)


def ranges(inputs: dict[str, Any]) -> Answers:
    """7.2.3: range over which slow references lead the magnet."""
    numbers: dict[str, Any] = {}
    curves = []
    for name, depth in zip(("upper", "lower"), inputs["depths_mm"], strict=False):
        ways = _ways(inputs, float(depth))
        numbers[f"range_{name}"] = ours([_farthest(way, run) for way, run in ways.items()], *ways.values())
        for axis, letter in enumerate("xy"):
            pair = {way: run for way, run in ways.items() if way[1] == letter}
            curves.append(over_time(f"Slowly out along {letter} at {depth:g} mm", axis, pair))
    down, up = run_of(inputs, "range_vertical"), run_of(inputs, "range_vertical", UPWARD)
    on = run_of(inputs, "range_vertical", BEYOND)
    numbers["vertical_range"] = ours(float(down.true[:, DEPTH].max() - up.true[:, DEPTH].min()), down, up)
    facts = {
        "deepest_mm": down.true[:, DEPTH].max(),
        "continued_mm": on.true[:, DEPTH].max(),
        "end": on.run.metrics.event or "the end of the run",
        "largest_current_A": on.run.metrics.largest_current_A,
        "highest_mm": up.true[:, DEPTH].min(),
    }
    curves.append(over_time("Slowly down and up", DEPTH, {"down": on, "up": up}))
    return Answers(numbers, tuple(curves), facts)


def _ways(inputs: dict[str, Any], depth: float) -> dict[str, Readings]:
    """Runs out to each of four sides, 2 mm above the block as in all rows."""
    start = {"start.depth_mm": depth, "plate.face_mm": [0.0, 0.0, -(99.0 + depth)]}
    ways = ("+x", "-x", "+y", "-y")
    outward = {
        way: {**start, "reference.0.axis": way[1], "reference.0.by_mm": float(f"{way[0]}15")} for way in ways
    }
    return runs_of(inputs, "range_sideways", outward)


def _farthest(way: str, run: Readings) -> float:
    """Farthest true position along a way, mm, with its sign, as long as the height is within 1 mm."""
    axis, sign = "xy".index(way[1]), 1.0 if way[0] == "+" else -1.0
    held = np.abs(run.true[:, DEPTH] - run.wanted[:, DEPTH]) < 1.0
    end = len(held) if held.all() else int(np.argmin(held))
    return sign * float((sign * run.true[:end, axis]).max())


class Followed(NamedTuple):
    """Tracking of a circle: relative growth of the radius, phase lag, deg, and RMS of the rest of the path, mm."""

    growth: float
    lag_deg: float
    rest_mm: float


def circles(inputs: dict[str, Any]) -> Answers:
    """RMS of the height on each circle and at rest, and the change of radius and phase."""
    radii, rates, settled = inputs["radii_mm"], inputs["rates_rad_per_s"], float(inputs["settled_s"])
    rest = run_of(inputs, "circle", {"reference": [], "duration_s": 12.0})
    turning = {
        f"{r:g} mm, {rate:g} rad/s": {
            "reference.0.radius_mm": float(r),
            "reference.0.rate_rad_per_s": float(rate),
            "duration_s": float(np.ceil(8.0 + 2 * np.pi * turns / rate)),
        }
        for r, rate, turns in zip(radii, rates, inputs["turns"], strict=True)
    }
    runs = runs_of(inputs, "circle", turning)
    every = tuple(runs.values())
    rms = [run.rms(DEPTH, settled) for run in every]
    numbers = {
        "vertical_rms": ours(rms, *every),
        "rms_at_rest": ours(rest.rms(DEPTH, 2.0), rest),
        "growth": ours(rms[1] / rms[0], *every[:2]),
        "speed": [float(r * w) for r, w in zip(radii[:2], rates[:2], strict=True)],
    }
    followed = [follows(run, float(rate), settled) for run, rate in zip(every, rates, strict=True)]
    paths = [
        coupled.in_the_plane(f"Fig. {figure}: circle of {name}", run, settled)
        for figure, (name, run) in zip(("7-24", "7-27", "7-29"), runs.items(), strict=False)
    ]
    name, first = next(iter(runs.items()))
    in_time = [
        over_time(f"Fig. 7-25: {letter} over time, {name}", axis, {letter: first}, begin=settled)
        for axis, letter in enumerate("xy")
    ]
    height = over_time("Figs 7-26, 7-28, 7-30: the height meanwhile", DEPTH, runs, begin=settled)
    return Answers(numbers, (*paths, *in_time, height), {"followed": followed})


def follows(run: Readings, rate: float, begin: float) -> Followed:
    """Compare the rotating component of the true path with the reference's, by least squares."""
    rows = run.during(begin)
    turning = np.exp(1j * rate * run.time[rows])
    basis = np.column_stack([turning, turning.conj(), np.ones(rows.sum())])
    path, wanted = ((p[rows, X] + 1j * p[rows, Y]) for p in (run.true, run.wanted))
    found = np.linalg.lstsq(basis, path, rcond=None)[0]
    ratio = found[0] / np.linalg.lstsq(basis, wanted, rcond=None)[0][0]
    rest = np.sqrt(np.mean(np.abs(path - found[0] * turning) ** 2))
    return Followed(float(abs(ratio)) - 1.0, float(-np.rad2deg(np.angle(ratio))), float(rest))


_BEGIN, _END = 0.9, 2.0


def step_and_states(run: Readings, quiet: Readings, rig_peak: ArrayLike) -> list[Curves]:
    """Figs 7-32 to 7-34. run: with the sensor's noise, quiet: without. rig_peak: s after the step, mm beyond it."""
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
    sides = runs_of(inputs, "regulator_sideways", {"regulator": {}, "PID": on_pid})
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
    """Table 7-4, and the largest distances from the block at which the regulator holds the magnet."""

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

"""S18, S19: the coupled closed loop on the map, by the shipped scenarios: Tables 7-1 and 7-2, 7.1; sway and block of
6.1, PD and PID of 6.5 and 6.6, range of 7.2.3; circles of 7.3."""

from typing import Any, NamedTuple

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import (
    DEPTH,
    VERTICAL_PID,
    Readings,
    X,
    Y,
    in_the_plane,
    ours,
    over_time,
    run_of,
    runs_of,
    with_measured,
)


def vertical(inputs: dict[str, Any]) -> Answers:
    """Table 7-1."""
    base = run_of(inputs, "vertical_step")
    column = [*base.column(DEPTH), base.rms(DEPTH, 0.75 * base.time[-1])]
    names = ("peak_time", "rise_time", "settling_time", "overshoot", "rms_at_rest")
    numbers = {name: ours(value, base) for name, value in zip(names, column, strict=True)}
    numbers["time_to_reference"] = ours(base.time_to_reference(DEPTH, 1.0), base)
    numbers["setup_of_30"] = ours(column, base)
    drag = inputs["identified_drag_N_s_per_m"]
    slow = run_of(inputs, "vertical_step", {"drag.linear_N_s_per_m": [drag] * 3})
    name = f"damping of (7-7), {drag:g} N s/m"
    title = "Table 7-1: step of 1 mm, PID of 7.2.1"
    curves = (over_time(title, DEPTH, {"air": base, name: slow}, begin=0.8, end=3.0),)
    weaker = {"control.z.Kc": 0.8 * VERTICAL_PID["Kc"]}
    between = {"drag.linear_N_s_per_m": [0.005, 0.005, float(inputs["between_drag_N_s_per_m"])]}
    changes: dict[str, dict[str, Any]] = {
        "with_less_gain": weaker,
        "with_both": weaker | between,
        "with_a_lag": {"coils.time_constant_ms": 5.0},
    }
    tried = {"with_damping": slow, **runs_of(inputs, "vertical_step", changes)}
    return Answers(numbers, curves, {name: _step_in_words(run) for name, run in tried.items()})


def _step_in_words(run: Readings) -> str:
    step = run.step(DEPTH)
    return (
        f"rise {step.rise_time:.3f} s, reference reached after {run.time_to_reference(DEPTH, 1.0):.3f} s, "
        f"peak {step.peak_time:.2f} s, settling {step.settling_time:.2f} s, overshoot {100 * step.overshoot:.0f} %"
    )


def horizontal(inputs: dict[str, Any]) -> Answers:
    """Table 7-2."""
    runs = runs_of(inputs, "horizontal_pid", {"x": {}, "y": {"reference.0.axis": "y"}})
    every = tuple(runs.values())
    columns = np.array([run.column(axis) for axis, run in enumerate(every)])
    rest = 0.75 * every[0].time[-1]
    numbers = {
        "rise_time": ours(columns[:, 1], *every),
        "overshoot": ours(columns[:, 3], *every),
        "rms_at_rest": ours([run.rms(axis, rest) for axis, run in enumerate(every)], *every),
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
GAIN_1 = {
    f"control.{axis}.{key}": v for axis in "xy" for key, v in (("Kc", 1.0), ("Ti_s", 0.3), ("Td_s", 6e-5))
}


def combined(inputs: dict[str, Any]) -> Answers:
    """7.1.1 and 7.1.3: what a motion along some axes does to the others."""
    still, both_step = {"kind": "constant"}, {"reference.1.by_mm": 0.1}
    of_x: dict[str, dict[str, Any]] = {
        "x alone": {"control.y": still},
        "both controlled": {},
        "both step": both_step,
    }
    steps = runs_of(inputs, "horizontal_pid", of_x)
    one = steps["both controlled"]
    slow = run_of(inputs, "horizontal_pid", SMALL_STEPS)
    aside = run_of(inputs, "vertical_steps")
    middle = run_of(inputs, "vertical_steps", ON_THE_AXIS)
    numbers = {
        "y_when_x_steps": ours(_shift(one, Y), one),
        "y_when_x_goes_slowly": ours(_shift(slow, Y), slow),
        "aside_when_z_steps": ours([_aside(middle), _aside(aside)], middle, aside),
    }
    to_y = {"reference.0.axis": "y", "reference.1.axis": "x"}
    of_y = {"y alone": {"control.x": still, **to_y}, "both controlled": to_y}
    y_steps = runs_of(inputs, "horizontal_pid", of_y) | {"both step": steps["both step"]}
    curves = (
        over_time("Figs 7-1, 7-5: step of x by 0.1 mm", X, steps, begin=1.5, end=9.0),
        over_time("Figs 7-2, 7-5: step of y by 0.1 mm", Y, y_steps, begin=1.5, end=9.0),
        over_time(
            "Figs 7-3, 7-4: y while x moves by 0.1 mm", Y, {"one step": one, "ten steps": slow}, begin=1.0
        ),
        *_steps_of_the_height(middle, aside),
    )
    stiff = run_of(inputs, "horizontal_pid", {**GAIN_1, **both_step})
    columns = [run.column(X) for run in steps.values()]
    facts = {
        "rises_s": [column[1] for column in columns],
        "overshoots_percent": [column[3] for column in columns],
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
    runs = runs_of(inputs, "spikes", ways)
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
    curves = (
        over_time("Fig. 6-1: step of the x signal, no block", X, {"no block": free}, asked=False),
        over_time("Fig. 6-2: the same above the block", X, {"above the block": block}, asked=False),
        over_time(
            "Fig. 6-3: step of the height by 1 mm",
            DEPTH,
            {"no block": far, "block": near},
            begin=0.8,
            end=3.5,
        ),
    )
    facts = {
        "swings_mm": swings,
        "rise_near_s": near.step(DEPTH).rise_time,
        "rise_far_s": far.step(DEPTH).rise_time,
    }
    return Answers(numbers, curves, facts)


def _reaches(run: Readings, rest: float, band: float = 0.05) -> float:
    """Time from the signal's step at 1 s until x stays within 5 % of its way, s."""
    begin = float(run.true[run.during(0.0, 1.0), X].mean())
    away = np.abs(run.true[:, X] - rest) > band * abs(rest - begin)
    return float(run.time[np.flatnonzero(away)[-1]] - 1.0) if away.any() else 0.0


def proportional(inputs: dict[str, Any]) -> Answers:
    """6.5: where a PD controller lets the magnet rest, out and back."""
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
    curves = (*_under_pd(inputs, x, negative, y), *_under_pid(inputs, changes))
    return Answers(numbers, curves)


def _under_pd(inputs: dict[str, Any], x: Readings, negative: Readings, y: Readings) -> list[Curves]:
    """Figs 6-12, 6-13, 6-15 and 6-16, with the means that 6.5 prints."""
    late, at = (14.2, 18.4), [15.15, 16.65, 18.15]
    curves = []
    for title, axis, run, shown, times, means in (
        ("12: x under PD control: 0.9, 1, 0.9 mm", X, x, late, at, "x_means_mm"),
        ("13: x under PD control: -0.9, -1, -0.9 mm", X, negative, late, at, "negative_x_means_mm"),
        ("15: y under PD control: 0.9, 1, 0.9 mm", Y, y, late, [], ""),
        ("16: y under PD control, 0 to 1 mm and back", Y, y, (0.0, np.inf), [3.15, 30.15], "y_means_mm"),
    ):
        one = over_time(f"Fig. 6-{title}", axis, {"xy"[axis]: run}, begin=shown[0], end=shown[1])
        curves.append(with_measured(one, "mean of the rig", times, inputs[means]) if means else one)
    return curves


def _under_pid(inputs: dict[str, Any], to_y: dict[str, Any]) -> list[Curves]:
    """Figs 6-17 to 6-19: out to 0.5 mm and back by one step, Ti = 0.005."""
    way = {"reference.0.times": 5, "reference.1.times": 1, "reference.1.at_s": 9.5, "duration_s": 12.0}
    x = run_of(inputs, "horizontal_pd", {**way, "control.x.Ti_s": 0.3})
    y = run_of(inputs, "horizontal_pd", {**to_y, **way, "control.y.Ti_s": 0.3})
    return [
        over_time("Figs 6-17, 6-18: x under PID control", X, {"x": x}, begin=1.0),
        over_time("Fig. 6-19: y under PID control", Y, {"y": y}, begin=1.0),
    ]


def _held_at(run: Readings, axis: int, steps: int) -> float:
    """Mean of the last 0.7 s after so many of the ten steps out and ten back, every 1.5 s, mm."""
    end = 2.0 + 1.5 * steps
    return run.mean(axis, end - 0.7, end - 0.01)


def ranges(inputs: dict[str, Any]) -> Answers:
    """7.2.3: how far slow references lead the magnet."""
    numbers: dict[str, Any] = {}
    curves = []
    for name, depth in zip(("upper", "lower"), inputs["depths_mm"], strict=False):
        ways = _ways(inputs, float(depth))
        numbers[f"range_{name}"] = ours([_farthest(way, run) for way, run in ways.items()], *ways.values())
        for axis, letter in ((X, "x"), (Y, "y")):
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
    """Out to each of four sides, 2 mm above the block as everywhere."""
    start = {"start.depth_mm": depth, "plate.face_mm": [0.0, 0.0, -(99.0 + depth)]}
    ways = ("+x", "-x", "+y", "-y")
    outward = {
        way: {**start, "reference.0.axis": way[1], "reference.0.by_mm": float(f"{way[0]}15")} for way in ways
    }
    return runs_of(inputs, "range_sideways", outward)


def _farthest(way: str, run: Readings) -> float:
    """Farthest true place along a way, while the height is within 1 mm, mm, with the way's sign."""
    axis, sign = "xy".index(way[1]), 1.0 if way[0] == "+" else -1.0
    held = np.abs(run.true[:, DEPTH] - run.wanted[:, DEPTH]) < 1.0
    end = len(held) if held.all() else int(np.argmin(held))
    return sign * float((sign * run.true[:end, axis]).max())


class Followed(NamedTuple):
    """How a circle is followed: radius over the reference's, angle behind it, deg, and RMS of what is left, mm."""

    share: float
    lag_deg: float
    rest_mm: float

    @property
    def growth(self) -> float:
        """Of the radius: share - 1."""
        return self.share - 1.0


def circles(inputs: dict[str, Any]) -> Answers:
    """RMS of the height on each circle, at rest, and what becomes of radius and phase."""
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
    return Answers(numbers, _circle_figures(runs, settled), {"followed": followed})


def follows(run: Readings, rate: float, begin: float) -> Followed:
    """The turning part of the true path against that of the reference, by least squares."""
    rows = run.during(begin)
    turning = np.exp(1j * rate * run.time[rows])
    basis = np.column_stack([turning, turning.conj(), np.ones(rows.sum())])
    path, wanted = ((p[rows, X] + 1j * p[rows, Y]) for p in (run.true, run.wanted))
    found = np.linalg.lstsq(basis, path, rcond=None)[0]
    ratio = found[0] / np.linalg.lstsq(basis, wanted, rcond=None)[0][0]
    rest = np.sqrt(np.mean(np.abs(path - found[0] * turning) ** 2))
    return Followed(float(abs(ratio)), float(-np.rad2deg(np.angle(ratio))), float(rest))


def _circle_figures(runs: dict[str, Readings], settled: float) -> tuple[Any, ...]:
    paths = [
        in_the_plane(f"Fig. {figure}: circle of {name}", {"path": run}, settled)
        for figure, (name, run) in zip(("7-24", "7-27", "7-29"), runs.items(), strict=False)
    ]
    name, first = next(iter(runs.items()))
    in_time = [
        over_time(f"Fig. 7-25: {letter} over time, {name}", axis, {letter: first}, begin=settled)
        for letter, axis in (("x", X), ("y", Y))
    ]
    height = over_time("Figs 7-26, 7-28, 7-30: the height meanwhile", DEPTH, runs, begin=settled)
    return (*paths, *in_time, height)

"""S18: sway and block of 6.1, PD and PID of 6.5 and 6.6, range of 7.2.3, on the coupled machine."""

from typing import Any

import numpy as np

from fieldmap.curves import Curves
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import DEPTH, Readings, X, Y, ours, over_time, run_of, with_measured
from fieldmap.thesis.printed import figure_numbers

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
    begin, end = 14.2, 18.4
    means = {
        "6-12": ([15.15, 16.65, 18.15], inputs["x_means_mm"]),
        "6-13": ([15.15, 16.65, 18.15], inputs["negative_x_means_mm"]),
        "6-16": ([3.15, 30.15], inputs["y_means_mm"]),
    }
    curves = [
        over_time("Fig. 6-12: x under PD control: 0.9, 1, 0.9 mm", X, {"x": x}, begin=begin, end=end),
        over_time(
            "Fig. 6-13: x under PD control: -0.9, -1, -0.9 mm", X, {"x": negative}, begin=begin, end=end
        ),
        over_time("Fig. 6-15: y under PD control: 0.9, 1, 0.9 mm", Y, {"y": y}, begin=begin, end=end),
        over_time("Fig. 6-16: y under PD control, 0 to 1 mm and back", Y, {"y": y}),
    ]
    for k, one in enumerate(curves):
        at = means.get(figure_numbers(one.title)[0])
        if at is not None:
            curves[k] = with_measured(one, "mean of the rig", *at)
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
    ways = {}
    for axis, sign in (("x", "+"), ("x", "-"), ("y", "+"), ("y", "-")):
        changes = {
            "start.depth_mm": depth,
            "plate.face_mm": [0.0, 0.0, -(99.0 + depth)],
            "reference.0.axis": axis,
            "reference.0.by_mm": float(f"{sign}15"),
        }
        ways[sign + axis] = run_of(inputs, "range_sideways", changes)
    return ways


def _farthest(way: str, run: Readings) -> float:
    """Farthest true place along a way, while the height is within 1 mm, mm, with the way's sign."""
    axis, sign = "xy".index(way[1]), 1.0 if way[0] == "+" else -1.0
    held = np.abs(run.true[:, DEPTH] - run.wanted[:, DEPTH]) < 1.0
    end = len(held) if held.all() else int(np.argmin(held))
    return sign * float((sign * run.true[:end, axis]).max())

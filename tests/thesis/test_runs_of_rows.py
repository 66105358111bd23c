"""Rows of the coupled machine: the scenarios and changes that they run, and the numbers from these runs. The runs are
made up, each with its own random numbers; expected values are written out, by chapters 5 to 7."""

import re
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.signal

from fieldmap import control
from fieldmap.control import StateSpace
from fieldmap.dynamics import read_scenario
from fieldmap.errors import NotConverged
from fieldmap.thesis import coupled_loop, coupled_runs, horizontal, vertical_records
from fieldmap.thesis.computation import function_of
from fieldmap.thesis.printed import figure_numbers, read_part
from tests.computed_parts import assert_drawn

X, Y, DEPTH = 0, 1, 2
LABELS = ("x (mm)", "y (mm)", "depth (mm)")
TIME = 0.2 * np.arange(500)
"""s: to 99.8, fewer than a figure shows."""
DRAG = "drag.linear_N_s_per_m"
STILL, TO_Y = {"kind": "constant"}, {"reference.0.axis": "y", "reference.1.axis": "x"}


class Made:
    """The result of `simulate`: the scenario read with its changes, and random readings, mm, outputs and metrics."""

    def __init__(self, k, scenario, changes):
        random = np.random.default_rng(k)
        self.name, self.changes, self.scenario = scenario, deepcopy(changes), read_scenario(scenario, changes)
        self.time, self.outputs = TIME, random.normal(size=(len(TIME), 3))
        # Every third run is quiet. A signal in open loop moves x by 10 mm and y by 20 mm per unit.
        readings = (0.1 if k % 3 == 2 else 1.0) * random.normal(size=(3, len(TIME), 3))
        if "signal.0.by" in changes:
            axis = "xy".index(changes["signal.0.output"])
            readings[1, :, axis] = (10 + 10 * axis) * changes["signal.0.by"] * (TIME > 0.99)
        if scenario == "horizontal_open_loop_plate":
            readings[0, :, X] = 3.0 + 2.0 * np.exp(-TIME / 7.0)
        # The height error is zero for the first 50 samples, at least 10 s.
        readings[0, :50, DEPTH] = readings[2, :50, DEPTH]
        self.mm = dict(zip(("true", "seen", "wanted"), readings, strict=True))
        metres = [
            (one + [0.0, 0.0, self.scenario.zero_depth_mm]) * [1e-3, 1e-3, -1e-3] for one in self.mm.values()
        ]
        self.sensed, self.seen, self.references = metres
        names = ("peak_time", "rise_time", "settling_time", "overshoot")
        steps = [SimpleNamespace(**dict(zip(names, random.uniform(size=4), strict=True))) for _ in range(3)]
        axes = [SimpleNamespace(step=step) for step in steps]
        self.metrics = SimpleNamespace(
            axes=axes, event="fell out" if k == 3 else "", largest_current_A=random.uniform()
        )
        self.assumptions = (f"run {k}",)

    def during(self, what, axis, begin=0.0, end=np.inf):
        return self.mm[what][(begin - 1e-9 <= TIME) & (end > TIME), axis]

    def rms(self, axis, begin):
        error = self.during("seen", axis, begin) - self.during("wanted", axis, begin)
        return np.sqrt(np.mean(error**2))

    def departure(self, axis, begin, end=np.inf):
        return np.abs(self.during("seen", axis, begin, end) - self.during("wanted", axis, begin)[0]).max()

    def column(self, axis):
        step = self.metrics.axes[axis].step
        return [step.peak_time, step.rise_time, step.settling_time, 100.0 * step.overshoot]

    def away(self, *axes):
        return np.abs(self.mm["true"] - self.mm["wanted"])[:, axes].max()

    def reaches(self, axis, at):
        """Time from `at`, s, to the first place at or beyond the last reference, in the direction of the step."""
        final, first = self.mm["wanted"][-1, axis], self.mm["wanted"][0, axis]
        beyond = (self.mm["true"][:, axis] - final) * (1 if final > first else -1) >= 0
        return TIME[(at - 1e-9 <= TIME) & beyond][0] - at

    def line(self, name, axis, begin=0.0, end=np.inf, what="seen", kind="ours"):
        rows = (begin - 1e-9 <= TIME) & (end > TIME)
        return name, kind, TIME[rows], self.mm[what][rows, axis]


def over_time(axis, runs, begin=0.0, end=np.inf, models=(), asked=True):
    """Lines of a figure over time: machine, models, references."""
    lines = [run.line(name, axis, begin, end) for name, run in runs.items()]
    lines += [
        (name, "published", lines[0][2], y[(begin - 1e-9 <= TIME) & (end > TIME)]) for name, y in models
    ]
    lines += [run.line("asked for", axis, begin, end, "wanted", "asked") for run in runs.values() if asked]
    return ("time (s)", LABELS[axis]), lines


def vertical(r, i):
    """Table 7-1: gain 0.334 V/mm, also less a fifth; 0.5 N s/m of (7-7)."""
    drag, air = [i["identified_drag_N_s_per_m"]] * 3, [0.005, 0.005, i["between_drag_N_s_per_m"]]
    weaker = {"control.z.Kc": pytest.approx(0.2672)}
    yield [
        ("vertical_step", {}), ("vertical_step", {DRAG: drag}), ("vertical_step", weaker),
        ("vertical_step", weaker | {DRAG: air}), ("vertical_step", {"coils.time_constant_ms": 5.0}),
    ]  # fmt: skip
    rms = r[0].rms(DEPTH, 0.75 * 99.8)
    names = ("peak_time", "rise_time", "settling_time", "overshoot")
    numbers = dict(zip(names, r[0].column(DEPTH), strict=True))
    numbers |= {"rms_at_rest": rms, "time_to_reference": r[0].reaches(DEPTH, 1.0)}
    yield {name: (value, [0]) for name, value in numbers.items()} | {
        "setup_of_30": ([*r[0].column(DEPTH), rms], [0])
    }
    lines = {"air": r[0], "damping of (7-7), 0.7 N s/m": r[1]}
    yield {"Table 7-1: step of 1 mm, PID of 7.2.1": over_time(DEPTH, lines, 0.8, 3.0)}

    def words(run):
        peak, rise, settling, overshoot = run.column(DEPTH)
        reached = run.reaches(DEPTH, 1.0)
        return [f"{rise:.3f}", f"{reached:.3f}", f"{peak:.2f}", f"{settling:.2f}", f"{overshoot:.0f}"]

    facts = ("air", "with_damping", "with_less_gain", "with_both", "with_a_lag")
    yield {
        name: lambda told, run=run: re.findall(r"\d[\d.]*", told) == words(run)
        for name, run in zip(facts, r, strict=True)
    }


def sideways(r, i):
    """Table 7-2: also twice its gain of 0.025 per mm."""
    yield [("horizontal_pid", one) for one in ({}, {"reference.0.axis": "y"}, {"control.x.Kc": 0.05})]
    columns = [r[0].column(X), r[1].column(Y)]
    yield {
        "rise_time": ([one[1] for one in columns], [0, 1]),
        "overshoot": ([one[3] for one in columns], [0, 1]),
        "rms_at_rest": ([r[0].rms(X, 0.75 * 99.8), r[1].rms(Y, 0.75 * 99.8)], [0, 1]),
    }
    yield {
        f"Fig. 7-21: step of {n} by 0.1 mm at 11 mm": over_time(a, {n: r[a]}, 1.0)
        for a, n in ((X, "x"), (Y, "y"))
    }
    yield {"rise_of_twice_the_gain_s": r[2].column(X)[1]}


def combined(r, i):
    """7.1.1, 7.1.3: steps of 0.1 mm, ten of 0.01 mm; gain 1, Ti = 0.005 and Td = 1e-6 in minutes (6.6)."""
    step = {"reference.1.by_mm": 0.1}
    gains = {"Kc": 1.0, "Ti_s": pytest.approx(60 * 0.005), "Td_s": pytest.approx(60 * 1e-6)}
    both = {f"control.{axis}.{key}": value for axis in "xy" for key, value in gains.items()}
    ten = {"reference.0.by_mm": 0.01, "reference.0.times": 10, "reference.0.every_s": 0.5}
    axis = {"start.x_mm": 0.0, "start.y_mm": 0.0, "start.depth_mm": 10.0, "reference.0.by_mm": 0.1}
    changes = [{"control.y": STILL}, {}, step, {"control.x": STILL, **TO_Y}, TO_Y, ten, {**both, **step}]
    yield [("horizontal_pid", one) for one in changes] + [("vertical_steps", {}), ("vertical_steps", axis)]
    yield {
        "y_when_x_steps": (r[1].away(Y), [1]),
        "y_when_x_goes_slowly": (r[5].away(Y), [5]),
        "aside_when_z_steps": ([r[8].away(X, Y), r[7].away(X, Y)], [7, 8]),
    }
    names = ("x alone", "both controlled", "both step")
    of_y = dict(zip(("y alone", *names[1:]), (r[3], r[4], r[2]), strict=True))
    figures = {
        "Figs 7-1, 7-5: step of x by 0.1 mm": over_time(X, dict(zip(names, r, strict=False)), 1.5, 9.0),
        "Figs 7-2, 7-5: step of y by 0.1 mm": over_time(Y, of_y, 1.5, 9.0),
        "Figs 7-3, 7-4: y while x moves by 0.1 mm": over_time(Y, {"one step": r[1], "ten steps": r[5]}, 1.0),
    }
    for number, place, run in ((16, "(0, 0)", r[8]), (18, "(1, 1) mm", r[7])):
        figures[f"Fig. 7-{number}: steps of the height at {place}"] = over_time(DEPTH, {"depth": run})
        off = run.mm["true"] - run.mm["wanted"]
        lines = [(name, "ours", TIME, off[:, a]) for a, name in ((X, "x"), (Y, "y"))]
        figures[f"Fig. 7-{number + 1}: x and y meanwhile, from {place}"] = (
            ("time (s)", "deviation (mm)"),
            lines,
        )
    yield figures
    columns = [run.column(X) for run in r[:3]]
    yield {
        "rises_s": [one[1] for one in columns],
        "overshoots_percent": [one[3] for one in columns],
        "end_at_gain_1": f"stays up, its height off by {r[6].departure(DEPTH, 1.0):.2f} mm at most",
    }


def spikes(r, i):
    """7.1.2: steps of x at gain 1; the rig's height went to 10.3 and 10.27 mm."""
    push = {"control.compensator.push_mm": 0.2, "control.compensator.duration_ms": 30}
    gains = [{"control.x.Kc": 0.1}, {"control.x.Kc": 0.05}]
    yield [("spikes", one) for one in ({}, push, *gains, {"field.iron": "linearised"})]
    sizes = [run.departure(DEPTH, 1.0) for run in r]
    yield {"spike": (sizes[0], [0]), "with_compensator": (sizes[1], [1])}
    runs = dict(zip(("gain 1", "gain 1, push", "gain 0.1", "gain 0.05"), r, strict=False))
    labels, lines = over_time(DEPTH, {name: runs[name] for name in ("gain 1", "gain 1, push")}, 9.8, 11.8)
    for words, peak in (("", 10.4), (", push", 10.2)):
        lines.append((f"peak of the rig{words}", "measured", [9.8, 11.8], [peak, peak]))
    one = {name: run for name, run in runs.items() if name != "gain 0.05"}
    yield {
        "Figs 7-6, 7-8, 7-12: steps of x": over_time(X, runs, 1.0),
        "Figs 7-11, 7-15: one step of x": over_time(X, one, 9.8, 11.8),
        "Figs 7-7, 7-9, 7-13: the height meanwhile": over_time(DEPTH, runs, 1.0),
        "Fig. 7-10: one spike with and without the push": (labels, lines),
        "Fig. 7-14: the height at rest": over_time(DEPTH, {"depth": r[2]}, 0.0, 2.0),
    }
    still = r[0].departure(DEPTH, 0.0, 2.0)
    yield {
        "small_spikes_mm": sizes[2:4], "still_mm": still, "linearised_mm": sizes[4],
        "spikes_then": ["gone" if size < 1.5 * still else "still there" for size in sizes[2:4]],
    }  # fmt: skip


def sway(r, i):
    """6.1: at 10 mm the block is 9 mm below the magnet of a 25 mm body, as in the other scenarios."""
    plate = {"conductivity_S_per_m": 3.5e7, "thickness_mm": 50.0, "normal": [0.0, 0.0, 1.0]}
    yield [
        ("horizontal_open_loop", {}), ("horizontal_open_loop_plate", {}),
        ("vertical_step", {"plate": plate | {"face_mm": [0.0, 0.0, -110.0]}}), ("vertical_step", {}),
    ]  # fmt: skip
    rest, begin = r[1].during("true", X, 0.75 * 99.8).mean(), r[1].during("true", X, 0.0, 1.0).mean()
    outside = np.abs(r[1].mm["true"][:, X] - rest) > 0.05 * abs(rest - begin)
    settled = TIME[outside][-1] - 1.0
    yield {
        "settling_with_block": (settled, [1]),
        "vertical_settling_near_block": (r[2].column(DEPTH)[2], [2]),
    }
    yield {
        "Fig. 6-1: step of the x signal, no block": over_time(X, {"no block": r[0]}, asked=False),
        "Fig. 6-2: the same above the block": over_time(X, {"above the block": r[1]}, asked=False),
        "Fig. 6-3: step of the height by 1 mm": over_time(DEPTH, {"no block": r[3], "block": r[2]}, 0.8, 3.5),
    }
    yield {
        "swings_mm": [np.ptp(run.during("true", X, 0.75 * 99.8)) / 2 for run in r[:2]],
        "rise_near_s": r[2].column(DEPTH)[1], "rise_far_s": r[3].column(DEPTH)[1],
    }  # fmt: skip


def proportional(r, i):
    """6.5: ten steps of 0.1 mm out and ten back, one every 1.5 s from 2 s on; 6.6: Ti = 0.005 min, 0.5 mm and back."""
    pd = {"kind": "pid", "Kc": 1.0, "Td_s": pytest.approx(60 * 1e-6), "lower": -0.4, "upper": 0.4}
    pd |= {"integration": "trapezoidal", "anti_windup": "none", "Tf_s": 0.0, "b": 1.0, "c": 1.0}
    along_y = {
        "control.y": pd, "control.x": STILL, "start.y_mm": 0.0, "reference.0.axis": "y", "reference.1.axis": "y",
    }  # fmt: skip
    way = {"reference.0.times": 5, "reference.1.times": 1, "reference.1.at_s": 9.5, "duration_s": 12.0}
    changes = (
        {}, along_y, {"reference.0.by_mm": -0.1, "reference.1.by_mm": 0.1},
        way | {"control.x.Ti_s": pytest.approx(0.3)}, along_y | way | {"control.y.Ti_s": pytest.approx(0.3)},
    )  # fmt: skip
    yield [("horizontal_pd", one) for one in changes]
    # 0.9 mm is held from 14 to 15.5 s, 1.0 mm to 17 s, 0.9 mm to 18.5 s; 0.1 mm from 2 to 3.5 s and from 29 to 30.5 s.
    x = [r[0].during("seen", X, end - 0.7, end - 0.01).mean() for end in (15.5, 17.0, 18.5)]
    y = [r[1].during("seen", Y, end - 0.7, end - 0.01).mean() for end in (3.5, 30.5)]
    yield {"x_at_0.9_1.0_0.9": (x, [0]), "y_at_0.1_and_back": (y, [1])}
    figures = {
        "Fig. 6-12: x under PD control: 0.9, 1, 0.9 mm": over_time(X, {"x": r[0]}, 14.2, 18.4),
        "Fig. 6-13: x under PD control: -0.9, -1, -0.9 mm": over_time(X, {"x": r[2]}, 14.2, 18.4),
        "Fig. 6-15: y under PD control: 0.9, 1, 0.9 mm": over_time(Y, {"y": r[1]}, 14.2, 18.4),
        "Fig. 6-16: y under PD control, 0 to 1 mm and back": over_time(Y, {"y": r[1]}),
        "Figs 6-17, 6-18: x under PID control": over_time(X, {"x": r[3]}, 1.0),
        "Fig. 6-19: y under PID control": over_time(Y, {"y": r[4]}, 1.0),
    }
    # In the middle of the averaged intervals.
    late = (15.15, 16.65, 18.15)
    measured = (
        (12, late, "x_means_mm"),
        (13, late, "negative_x_means_mm"),
        (16, (3.15, 30.15), "y_means_mm"),
    )
    for number, at, means in measured:
        (title,) = (one for one in figures if one.startswith(f"Fig. 6-{number}"))
        figures[title][1].append(("mean of the rig", "measured", at, i[means]))
    yield figures
    yield {}


def ranges(r, i):
    """7.2.3: the block is 7 mm below a magnet of h = 15 mm, which is 92 mm plus the depth below the disk."""
    runs = []
    for depth in (9.0, 14.0):
        start = {"start.depth_mm": depth, "plate.face_mm": [0.0, 0.0, -(77 + 15 + depth + 7)]}
        for axis, way in (("x", 15.0), ("x", -15.0), ("y", 15.0), ("y", -15.0)):
            runs.append(("range_sideways", {**start, "reference.0.axis": axis, "reference.0.by_mm": way}))
    beyond = {"coils.end_beyond_table": False, "reference.0.by_mm": 40.0, "duration_s": 25.0}
    runs += [("range_vertical", one) for one in ({}, {"reference.0.by_mm": -10.0}, beyond)]
    yield runs

    def farthest(run, axis, sign):
        """The farthest place before the height is first off by 1 mm or more."""
        off = np.abs(run.mm["true"] - run.mm["wanted"])[:, DEPTH] >= 1.0
        end = np.flatnonzero(off)[0] if off.any() else None
        return sign * (sign * run.mm["true"][:end, axis]).max()

    sides = ((X, 1), (X, -1), (Y, 1), (Y, -1))
    numbers = {
        f"range_{name}": (
            [farthest(r[first + k], *side) for k, side in enumerate(sides)],
            range(first, first + 4),
        )
        for name, first in (("upper", 0), ("lower", 4))
    }
    deepest, highest = r[8].mm["true"][:, DEPTH].max(), r[9].mm["true"][:, DEPTH].min()
    yield numbers | {"vertical_range": (deepest - highest, [8, 9])}
    figures = {
        f"Slowly out along {letter} at {depth} mm": over_time(axis, {f"+{letter}": r[k], f"-{letter}": r[k + 1]})
        for depth, first in ((9, 0), (14, 4)) for axis, letter, k in ((X, "x", first), (Y, "y", first + 2))
    }  # fmt: skip
    yield figures | {"Slowly down and up": over_time(DEPTH, {"down": r[10], "up": r[9]})}
    yield {
        "deepest_mm": deepest, "continued_mm": r[10].mm["true"][:, DEPTH].max(), "highest_mm": highest,
        "end": "the end of the run", "largest_current_A": r[10].metrics.largest_current_A,
    }  # fmt: skip


def regulator(r, i):
    """Table 7-3, 7.4.1; the PID of 7.2.1 with its times in minutes."""
    pid = {
        "kind": "pid",
        "Kc": 0.334,
        "Ti_s": pytest.approx(0.42),
        "Td_s": pytest.approx(0.06),
        "lower": 0.0,
        "upper": 10.0,
    }
    quiet = {"noise.off": True}
    yield [
        ("vertical_step", {}), ("regulator", {"control.z": pid, "reference.0.by_mm": 0.0, "start.depth_mm": 12.9}),
        ("regulator", {}), ("regulator", quiet), ("regulator_sideways", {}), ("regulator_sideways", {"control.z": pid}),
        ("regulator", quiet | {"coils.time_constant_ms": 2.0}),
    ]  # fmt: skip
    yield {
        "pid": (r[0].column(DEPTH), [0]),
        "regulator": (r[3].column(DEPTH), [3]),
        "time_to_reference": (r[3].reaches(DEPTH, 1.0), [3]),
        "rms_at_rest": ([r[1].rms(DEPTH, 1.0), r[2].rms(DEPTH, 2.0)], [1, 2]),
        "rms_sideways": ([r[4].rms(DEPTH, 1.0), r[5].rms(DEPTH, 1.0)], [4, 5]),
    }
    # An overshoot of 80 % of the step of 0.1 mm; the peak is 0.07 s after the step, 1 s after the start.
    loop, states, model = states_of_the_regulator(r[2], r[3])
    labels, lines = over_time(
        DEPTH, {"coupled machine": r[2], "without noise": r[3]}, 0.9, 2.0, [("design model", loop)]
    )
    lines.append(("peak of the rig, Table 7-3", "measured", [1.07], [r[2].mm["wanted"][-1, DEPTH] - 0.08]))
    rows = (TIME > 0.9 - 1e-9) & (TIME < 2.0)
    figures = {"Fig. 7-32: step from 13 to 12.9 mm, regulator": (labels, lines)}
    for k, unit in ((1, "V s"), (2, "V s²")):
        figures[f"Fig. 7-{32 + k}: estimated state $x_{k}$ meanwhile"] = (
            ("time (s)", f"$x_{k}$ ({unit})"),
            [
                ("coupled machine, without noise", "ours", TIME[rows], states[rows, k - 1]),
                ("design model", "published", TIME[rows], model[rows, k - 1]),
            ],
        )
    sides = {"PID": r[5], "regulator": r[4]}
    figures["Figs 7-36, 7-38: the height while x and y step"] = over_time(DEPTH, sides)
    figures["Figs 7-35, 7-37: x meanwhile"] = over_time(X, dict(reversed(sides.items())))
    yield figures
    yield {"slow": r[6].metrics.axes[DEPTH].step}


def states_of_the_regulator(run, quiet):
    """Position in the design loop, (7-7) with (7-12) and 7.4, and estimates x[n|n] of machine and loop by (7-15), from
    output and measured depth relative to the equilibrium of (7-19), or of (7-7)."""
    A, B, C = np.array([[-44.94, 248.3], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[-15.63, -50.97]])
    wide = control.with_output_integral(A, B, C)
    Q = np.array([[5000.0, 796.64, 0.0], [796.64, 5000.0, 0.0], [0.0, 0.0, 10000.0]])
    k = control.lqrd(wide.A, wide.B, Q, 1e-10, 2e-3)
    estimator = control.kalmd(A, B, C, 4e-4, 4e-4, 2e-3)
    rest = 248.3 / 50.97
    designed = control.Regulator(k, estimator, 2e-3, (0.0, rest), equilibrium_at="measured")
    plant = StateSpace(*control.zero_order_hold(A, B, 2e-3), C, np.zeros((1, 1)))
    wanted = run.mm["wanted"][:, DEPTH]
    loop = control.simulate_loop(plant, designed, wanted - wanted[0])

    def filtered(u, y):
        """x[n|n] from D_est, and from C_est below its first row, as `kalmd` returns them."""
        x, found = np.zeros(2), []
        for one, seen in zip(u, y, strict=True):
            found.append(estimator.C_est[1:] @ x + estimator.D_est[1:, 1] * seen)
            x = estimator.A_est @ x + estimator.B_est @ [one, seen]
        return np.array(found)

    seen = quiet.mm["seen"][:, DEPTH]
    machine = filtered(quiet.outputs[:, 0] - 3.42254 - 0.0966197 * seen, seen - quiet.mm["wanted"][:, DEPTH])
    return (
        wanted[0] + loop.y[0],
        machine,
        filtered(loop.u[0] - rest * loop.y[0], loop.y[0] - (wanted - wanted[0])),
    )


def heights(r, i):
    """Table 7-4: the depth is the block's less the gap; "held" means within 1 mm."""
    gaps = [("regulator", {"start.depth_mm": 14.5 - gap, "reference.0.by_mm": 0.0}) for gap in (0.5, 2.0)]
    further = [("regulator", {"start.depth_mm": 14.5 - gap, "duration_s": 6.0}) for gap in (5.0, 6.5)]
    yield gaps + further + [(name, changes | {DRAG: [0.7] * 3}) for name, changes in further]
    yield {"rms": ([run.rms(DEPTH, 1.0) for run in r[:2]], [0, 1])}
    yield {}

    def words(gap, run):
        last = run.departure(DEPTH, 0.75 * 99.8)
        said = f"held within {last:.2f} mm" if last < 1 else f"swings by {last:.1f} mm"
        return f"{gap} mm: {run.metrics.event or said}"

    yield {
        "farther": [words(5, r[2]), words(6.5, r[3])],
        "farther_damped": [words(5, r[4]), words(6.5, r[5])],
    }


def circles(r, i):
    """7.3: each circle for 8 s plus its turns of 2 pi / rate; at rest from 2 s on."""
    names = ("0.5 mm, 0.25 rad/s", "2 mm, 0.5 rad/s", "3 mm, 1 rad/s")
    yield [("circle", {"reference": [], "duration_s": 12.0})] + [
        ("circle", {"reference.0.radius_mm": radius, "reference.0.rate_rad_per_s": rate, "duration_s": lasts})
        for radius, rate, lasts in ((0.5, 0.25, 59.0), (2.0, 0.5, 21.0), (3.0, 1.0, 34.0))
    ]
    runs, rms = dict(zip(names, r[1:], strict=True)), [run.rms(DEPTH, 9.0) for run in r[1:]]
    yield {
        "vertical_rms": (rms, [1, 2, 3]), "rms_at_rest": (r[0].rms(DEPTH, 2.0), [0]),
        "growth": (rms[1] / rms[0], [1, 2]), "speed": ([0.125, 1.0], []),
    }  # fmt: skip
    figures = {}
    for number, (name, run) in zip((24, 27, 29), runs.items(), strict=True):
        lines = [
            (words, kind, run.during(what, X, 9.0), run.during(what, Y, 9.0))
            for words, kind, what in (("path", "ours", "seen"), ("asked for", "asked", "wanted"))
        ]
        figures[f"Fig. 7-{number}: circle of {name}"] = LABELS[:2], lines
    for axis, letter in ((X, "x"), (Y, "y")):
        figures[f"Fig. 7-25: {letter} over time, {names[0]}"] = over_time(axis, {letter: r[1]}, 9.0)
    yield figures | {"Figs 7-26, 7-28, 7-30: the height meanwhile": over_time(DEPTH, runs, 9.0)}

    def turning(run, rate):
        """Growth and lag of the rotating parts, fitted together with a counter-rotating part and a constant."""
        t = TIME[TIME >= 9.0 - 1e-9]
        basis = np.array(
            [np.cos(rate * t) + 1j * np.sin(rate * t), np.cos(rate * t) - 1j * np.sin(rate * t), t**0]
        ).T
        path, wanted = (
            run.during(what, X, 9.0) + 1j * run.during(what, Y, 9.0) for what in ("true", "wanted")
        )
        a, b = (np.linalg.solve(basis.conj().T @ basis, basis.conj().T @ one)[0] for one in (path, wanted))
        rest = np.sqrt(np.mean(np.abs(path - a * basis[:, 0]) ** 2))
        return [abs(a) / abs(b) - 1.0, np.degrees(np.angle(b / a)), rest]

    yield {"followed": [turning(run, rate) for run, rate in zip(r[1:], (0.25, 0.5, 1.0), strict=True)]}


def loop_answer(plant, Kc, Ti, Td, Ts, wanted, sign):
    """A sampled plant under the trapezoidal PID of (5-10), from the first reference on."""
    half, rate = Ts / (2 * Ti), Td / Ts
    pid = sign * Kc * np.array([1 + half + rate, half - 1 - 2 * rate, rate])
    top, bottom = np.convolve(plant[0], pid), np.convolve(plant[1], [1.0, -1.0, 0.0])
    top = np.append(np.zeros(len(bottom) - len(top)), top)
    return wanted[0] + scipy.signal.lfilter(top, bottom + top, wanted - wanted[0])


GAINS = (0.5, 0.334, 0.2, 0.15)
CONTROLLERS = (
    (0.334, 0.007, 0.001),
    (0.2, 0.006, 0.0015),
    (0.7, 5.934e-3, 4.6e-4),
    (0.2094, 4.62e-3, 1.171e-3),
)
"""Table 5-2; 5.7, Figs 5-15, 5-16, 5-17, 5-20: V/mm, and minutes to the machine, seconds to models."""
PLANTS = {
    "preliminary model": (-0.03 * np.poly([0.996]), np.poly([1.01, 0.9])),
    "final model": (-0.03 * np.poly([0.9935]), np.poly([1.01, 0.905])),
    "adjusted model": (-0.02 * np.poly([0.9897]), np.poly([1.01, 0.905])),
}
"""Tables 5-3, 5-4, 5.7."""


def vertical_steps(r, i):
    """Chapter 5: steps from 8 to 9 mm at each gain, and at 0.7 of it; binary signals, steps at 10 mm, ramps."""

    def control_of(Kc, Ti, Td):
        keys = {"Kc": Kc, "Ti_s": 60 * Ti, "Td_s": 60 * Td}
        return {f"control.z.{key}": pytest.approx(value) for key, value in keys.items()}

    def step(gains, depth, by):
        return "vertical_step", control_of(*gains) | {"start.depth_mm": depth, "reference.0.by_mm": by}

    first, second, third, _ = CONTROLLERS
    yield [
        *(step((Kc, 0.007, 0.001), 8.0, 1.0) for Kc in GAINS),
        *(("vertical_prbs", control_of(*gains)) for gains in CONTROLLERS[:3]),
        *(step(gains, 10.0, 1.0) for gains in CONTROLLERS), step(third, 10.0, -2.0), step(first, 10.0, -1.0),
        *(("vertical_ramp", control_of(*gains)) for gains in (first, second)),
        *(step((0.7 * Kc, 0.007, 0.001), 8.0, 1.0) for Kc in GAINS),
    ]  # fmt: skip
    # From the stand-in: a pair, and the mean of two real poles.
    yield {
        "pair_real": ([0.9, 0.91, 0.92, 0.945], [0, 1, 2, 3]), "pair_imaginary": ([0.1, 0.1, 0.1, 0.0], [0, 1, 2, 3]),
        "zero": ([0.5, 0.6, 0.7], [0, 1, 2, 3]),
    }  # fmt: skip
    seen, wanted = (
        r[0].during(what, DEPTH, 0.9) - r[0].during("wanted", DEPTH, 0.9)[0] for what in ("seen", "wanted")
    )
    time, count = TIME[(TIME > 0.9) & (TIME < 200)], 75
    shown = [
        ("coupled machine (ours)", "ours", time[:count], seen[:count]),
        ("modified least squares", "ours", time[:count], 3 * wanted[:count]),
        ("asked for", "asked", time[:count], wanted[:count]),
    ]
    estimates = [(f"$a_{k}$", "ours", time[:count], k + wanted[:count]) for k in range(4)]
    output = [
        ("output", "ours", *(one[(TIME > 0.9) & (TIME < 2.4 - 1e-9)] for one in (TIME, r[0].outputs[:, 0])))
    ]
    pairs = ("from steps of the coupled machine", "ours", [0.9, 0.91, 0.92, 0.945], [0.1, 0.1, 0.1, 0.0])
    rig = (
        "from the rig, Table 5-2",
        "measured",
        [0.974, 0.9743, 0.9899, 0.9956],
        [0.0301, 0.0246, 0.0207, 0.0167],
    )
    forgetting = "Fig. 5-3: recursive estimates of (5-13), forgetting factor 0.9"
    figures = {
        "Fig. 5-2: closed-loop models from the step of Fig. 5-4": (("time (s)", "depth from 8 mm (mm)"), shown),
        forgetting: (("time (s)", "coefficient of the denominator"), estimates),
        "Fig. 5-4: step from 8 to 9 mm, $K_c$ = 0.5 V/mm": over_time(DEPTH, {"coupled machine (ours)": r[0]}, 0.9, 2.4),
        "Fig. 5-5: output of the controller meanwhile": (("time (s)", "output (V)"), output),
        "Fig. 5-6: closed-loop poles by modified least squares, structure (5-15)": (
            ("real part", "imaginary part"), [pairs, rig],
        ),
    }  # fmt: skip

    def draw(title, k, gains, models, begin=0.9, end=2.5):
        asked = r[k].mm["wanted"][:, DEPTH]
        answers = [(name, loop_answer(PLANTS[name], *gains, 0.02, asked, -1)) for name in models]
        figures[f"Fig. 5-{title}"] = over_time(DEPTH, {"coupled machine": r[k]}, begin, end, answers)

    both = ("preliminary model", "final model")
    for number, k, Kc in ((9, 0, 0.5), (10, 1, 0.334)):
        draw(f"{number}: step at $K_c$ = {Kc} V/mm", k, (Kc, 0.007, 0.001), both[:1])
    ordinals = ("first", "second", "third", "fourth")
    for k in range(3):
        title = f"{12 + k}: pseudo-random binary signal, {ordinals[k]} controller"
        draw(title, 4 + k, CONTROLLERS[k], both[1:], 1.0, 6.0)
    for k, number in enumerate((15, 16, 17, 20)):
        models = (*both, "adjusted model") if number == 20 else both
        draw(f"{number}: step of 1 mm, {ordinals[k]} controller", 7 + k, CONTROLLERS[k], models)
    # 1 s after the start; 10 mm, plus the step of 1 mm, plus an overshoot of 40 %.
    figures["Fig. 5-15: step of 1 mm, first controller"][1].append(
        ("peak of the rig, Table 7-1", "measured", [1.3], [11.4])
    )
    draw("18: step of -2 mm, third controller", 11, third, both)
    rows = (TIME > 0.9) & (TIME < 2.5)
    figures["Fig. 5-19: steps up and down laid on each other, first controller"] = (
        ("time (s)", "way along the step (mm)"),
        [
            (name, "ours", TIME[rows], sign * (r[k].mm["seen"][rows, DEPTH] - 10.0))
            for name, k, sign in (("down by 1 mm", 7, 1), ("up by 1 mm", 12, -1))
        ],
    )
    for k in range(2):
        draw(f"{21 + k}: ramp of 5 mm/s, {ordinals[k]} controller", 13 + k, CONTROLLERS[k], both[1:])
    yield figures
    yield {"pair_of_less_gain": [0.1, 0.1, 0.1, 0.0]}


def horizontal_steps(r, i):
    """Chapter 6: steps of 0.1 mm at 2 s under PD and PID, and open-loop steps to the rig's positions."""

    def step(axis, Kc, Ti, Td, depth=10.0, lasts=12.0):
        pid = {"kind": "pid", "Kc": Kc, "Td_s": pytest.approx(60 * Td), "lower": -0.4, "upper": 0.4}
        pid |= {"Ti_s": pytest.approx(60 * Ti)} if Ti < 1e3 else {}
        other = {"x": "y", "y": "x"}[axis]
        return "horizontal_pid", {
            f"control.{axis}": pid, f"control.{other}": STILL, "start.depth_mm": depth, "reference.0.axis": axis,
            "plate.face_mm": [0.0, 0.0, -(77 + 15 + depth + 7)], "duration_s": lasts,
        }  # fmt: skip

    first, second, third, none = (
        (0.025, 0.006, 1e-4),
        (0.1, 0.007, 1e-6),
        (0.1, 0.01, 1e-6),
        (1.0, np.inf, 1e-6),
    )
    slow, runs = (0.025, 0.125, 1e-4), [step("x", *gains) for gains in ((0.025, 0.006, 1e-4), second, third)]
    # The stand-in moves 10 mm per unit along x and 20 mm along y, so the second try is right.
    ways = ((7, "x", 1.4), (8, "x", 1.65), (9, "y", 0.75), (10, "y", 1.18))
    theirs = [smallest_root(i[f"{axis}_polynomial"], way) for _, axis, way in ways]
    ours = [way / {"x": 10, "y": 20}[axis] for _, axis, way in ways]
    for (_, axis, _), *signals in zip(ways, theirs, ours, strict=True):
        for by in signals:
            changes = {"signal.0.output": axis, "signal.0.by": pytest.approx(by, rel=1e-4)}
            runs.append(("horizontal_open_loop_plate", changes))
    runs += [step(axis, *none, lasts=6.0) for axis in "xy"]
    runs += [step("x", *slow, lasts=90.0), step("y", *first), step("y", *slow, lasts=90.0)]
    yield runs + [step(axis, *first, depth=18.0) for axis in "xy"]
    # From the stand-in, for three different runs.
    yield {"model_Ti": ([0.21, 0.22, 0.23], [0, 1, 2])}
    figures = {}
    for (number, axis, way), k in zip(ways, (4, 6, 8, 10), strict=True):
        answers, a = [], "xy".index(axis)
        for order in ("second", "first"):
            top, *bottom = i[f"{axis}_{order}_order"]
            delayed = np.append(np.zeros(len(bottom) - 1), top)
            rise = scipy.signal.lfilter(delayed, bottom, (TIME > 0.99).astype(float))
            begin = r[k].during("seen", a, 0.0, 1.0).mean()
            answers.append((f"{order} order", begin + way * rise * sum(bottom) / top))
        title = f"Fig. 6-{number}: open-loop step of {axis} by {way:g} mm"
        figures[title] = over_time(a, {"coupled machine": r[k]}, 0.5, 6.0, answers, asked=False)

    def draw(title, k, axis, gains, models, begin=1.0, end=10.0):
        a, answers = "xy".index(axis), []
        for name, order, Ti in models:
            top, *bottom = i[f"{axis}_{order}_order"]
            loop = loop_answer(([top], bottom), gains[0], Ti, gains[2], 0.02, r[k].mm["wanted"][:, a], 1)
            answers.append((name, loop))
        figures[f"Fig. 6-{title}"] = over_time(a, {"coupled machine": r[k]}, begin, end, answers)

    def both(Ti):
        return [(f"{order} order", order, Ti) for order in ("second", "first")]

    draw("11: step of x under PD control", 11, "x", none, both(np.inf), 1.5, 5.0)
    draw("14: step of y under PD control", 12, "y", none, both(np.inf), 1.5, 5.0)
    for axis, number, quick, late in (("x", 20, 0, 13), ("y", 22, 14, 15)):
        title = f"step of {axis} under PID control, $T_i$ ="
        draw(f"{number}: {title} 0.006", quick, axis, first, both(0.125))
        draw(f"{number + 1}: {title} 0.125", late, axis, slow, both(2.604), end=90.0)
    for number, k, gains, Ti, fitted in ((24, 1, second, 0.098, 0.22), (25, 2, third, 0.14, 0.23)):
        models = [
            (f"thesis's first-order model, {words}", "first", T)
            for words, T in ((f"{Ti} s", Ti), (f"{fitted} s fitted", fitted))
        ]
        draw(f"{number}: step of x, $K_c$ = 0.1, $T_i$ = {gains[1]:g}", k, "x", gains, models, 1.5, 6.0)
    for number, k, axis in ((26, 16, "x"), (27, 17, "y")):
        draw(f"{number}: step of {axis} at 18 mm", k, axis, first, both(0.125))
    yield figures
    yield {}


def smallest_root(polynomial, way):
    signals = np.linspace(0.0, 0.3, 300001)
    return signals[np.argmax(np.polyval(polynomial, signals) >= way)]


ROWS = {
    "S18_vertical": (vertical, {"identified_drag_N_s_per_m": 0.7, "between_drag_N_s_per_m": 0.3}),
    "S18_horizontal": (sideways, {}),
    "S18_combined": (combined, {}),
    "S18_spikes": (
        spikes,
        {
            "push_mm": 0.2, "duration_ms": 30, "small_gains": np.array([0.1, 0.05]),
            "rig_peaks_mm": np.array([10.4, 10.2]),
        },
    ),
    "S18_sway": (sway, {}),
    "S18_proportional": (proportional, {}),
    "S18_range": (ranges, {"depths_mm": np.array([9.0, 14.0])}),
    "S18_regulator": (regulator, {"rig_peak_time_s": 0.07, "rig_overshoot_percent": 80.0}),
    "S18_heights": (
        heights,
        {
            "block_below_mm": 14.5, "gaps_mm": np.array([0.5, 2.0]), "further_gaps_mm": np.array([5.0, 6.5]),
            "identified_drag_N_s_per_m": 0.7,
        },
    ),
    "S19": (
        circles,
        {
            "radii_mm": np.array([0.5, 2.0, 3.0]), "rates_rad_per_s": np.array([0.25, 0.5, 1.0]),
            "turns": np.array([2, 1, 4]), "settled_s": 9.0,
        },
    ),
    "S16_records": (
        vertical_steps,
        {"less_gain": 0.7, "forgetting": 0.9, "Ts_s": 0.02, "rig_peak_time_s": 0.3, "rig_overshoot_percent": 40.0},
    ),
    "S17_records": (horizontal_steps, {"Ts_s": 0.02}),
}  # fmt: skip


@pytest.fixture
def made(monkeypatch):
    """The runs that a row makes, in their order."""
    runs = []

    def simulate(scenario, changes, field_map):
        assert field_map == "the map"
        runs.append(Made(len(runs), scenario, changes))
        return runs[-1]

    monkeypatch.setattr(coupled_runs, "simulate", simulate)
    return runs


@pytest.fixture
def identified(monkeypatch):
    """Estimators with known results: for (5-15) a pair of poles 0.9 +- 0.1j and further, the last ones real; for (5-13)
    three times the reference."""

    def of_runs(seen, wanted, orders):
        assert (orders.poles, orders.zeros, len(seen), seen.shape) == (3, 1, 4, wanted.shape)
        pairs = np.array([[0.2, 0.9 + 0.01 * k + 0.1j, 0.9 + 0.01 * k - 0.1j] for k in range(3)])
        zeros = np.array([[0.5], [0.6], [0.7], [0.8]])
        return SimpleNamespace(poles=np.vstack([pairs, [[0.99, 1.3, 0.9]]]), zeros=zeros)

    def of_one(seen, wanted, orders, Ts, tolerance):
        assert (orders.poles, orders.zeros, Ts, tolerance) == (4, 3, 0.02, 1e-2)
        poles = np.array([0.987, 0.9, 0.8, 0.123])
        return SimpleNamespace(poles=poles, simulate=lambda u: 3 * u if u is wanted else seen)

    def diverges(*_, **__):
        raise NotConverged.of("generalised_least_squares", "must settle", "nothing", "take more")

    def recursive(seen, wanted, orders, noise_order, forgetting):
        assert (noise_order, forgetting) == (1, 0.9)
        return SimpleNamespace(history=wanted[:, None] + np.arange(9.0))

    for name, one in (
        ("modified_least_squares_runs", of_runs), ("modified_least_squares", of_one),
        ("generalised_least_squares", diverges), ("recursive_least_squares", recursive),
    ):  # fmt: skip
        monkeypatch.setattr(vertical_records.identification, name, one)
    times = {0.025: 0.21, 0.1: 0.22}
    monkeypatch.setattr(
        horizontal,
        "_fitted_time",
        lambda i, plant, control, run: times[control.Kc] + (control.Ti == 0.01) * 0.01,
    )


@pytest.mark.parametrize("part", ROWS)
def test_runs_numbers_and_figures_of_a_row(part, made, identified):
    row, changed = ROWS[part]
    printed = read_part(part)
    inputs = printed.inputs | changed
    answers = function_of(part)({"map": "the map", **inputs})
    runs, numbers, figures, facts = row(made, inputs)
    assert [(run.name, run.changes) for run in made] == runs
    assert answers.numbers.keys() == numbers.keys()
    for name, (value, of) in numbers.items():
        found = answers.numbers[name]
        assert getattr(found, "value", found) == pytest.approx(value, rel=1e-9), name
        if of:
            names = dict.fromkeys(f"`{made[k].name}`" for k in of)
            word = "scenario" if len(names) == 1 else "scenarios"
            assert found.assumptions[0].startswith(f"{word} {', '.join(names)}, whose files")
        assert {f"run {k}" for k in of} == {
            a for a in getattr(found, "assumptions", ()) if a.startswith("run")
        }
    assert [one.title for one in answers.curves] == list(figures)
    for curves in answers.curves:
        assert_drawn(curves, *figures[curves.title])
    assert {number for title in figures for number in figure_numbers(title)} == set(printed.figures)
    assert answers.facts.keys() == facts.keys()
    for name, value in facts.items():
        found = answers.facts[name]
        assert value(found) if callable(value) else same(found, value), name


def same(found, value):
    exact = isinstance(np.ravel(value)[0], str | SimpleNamespace)
    return found == value if exact else np.allclose(found, value, rtol=1e-9)


@pytest.mark.parametrize(("rows", "every"), [(700, 1), (701, 2), (1400, 2), (1401, 3)])
def test_lines_have_700_points_at_most(rows, every):
    """Every k-th point from the first one, of run, models and reference alike."""
    time = 0.01 * np.arange(rows + 5)
    seen, wanted = np.tile(time, (3, 1)).T, 2 * np.tile(time, (3, 1)).T
    run = coupled_runs.Readings(None, time, seen, seen, wanted)
    curves = coupled_runs.over_time("t", DEPTH, {"a": run}, begin=0.05, models={"m": 3 * time})
    x = time[5::every]
    assert_drawn(
        curves, ("time (s)", "depth (mm)"),
        [("a", "ours", x, x), ("m", "published", x, 3 * x), ("asked for", "asked", x, 2 * x)],
    )  # fmt: skip


def test_what_never_comes_and_what_is_there_from_the_step_on():
    """Upwards and downwards; samples before the step do not count, and a window excludes its end."""
    time = np.arange(5.0)
    for way in (1.0, -1.0):
        true = way * np.array([9.0, 0.0, 0.5, 1.0, 1.5])[:, None]
        wanted = way * np.array([-3.0, 1.0, 1.0, 1.0, 1.0])[:, None]
        run = coupled_runs.Readings(None, time, true, true, wanted)
        assert run.time_to_reference(0, 1.0) == 2.0
        assert coupled_runs.Readings(None, time, 0.6 * true, true, wanted).time_to_reference(0, 1.0) == np.inf
        assert run.during(1.0, 3.0).tolist() == [False, True, True, False, False]


def test_what_stays_where_it_begins_has_settled():
    run = Made(0, "horizontal_open_loop_plate", {})
    still = coupled_runs.Readings(run, TIME, np.ones((500, 3)), np.ones((500, 3)), np.ones((500, 3)))
    assert coupled_loop._reaches(still, 1.0) == 0.0

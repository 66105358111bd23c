"""S17: arithmetic of the horizontal axes, and the coupled machine in the figures of chapter 6 that show the rig."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from fieldmap.control import PID, TransferFunction, simulate_loop, steady_gain, transfer_function
from fieldmap.control.identification import Orders, modified_least_squares_runs
from fieldmap.control.linear_models import filter_response
from fieldmap.curves import Curves
from fieldmap.records import Record
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import Readings, X, beside_models, ours, over_time, run_of
from fieldmap.thesis.vertical import RUNS, over_records


def arithmetic(inputs: dict[str, Any]) -> dict[str, Any]:
    """(6-10), (6-11); the signals that move the magnet by 1 mm, and the models' positions at these signals."""
    ratio = inputs["system_Ti_s"] / inputs["model_Ti_s"]
    second = inputs["second_system_Ti_s"] / inputs["second_model_Ti_s"]
    moved: dict[str, Any] = {}
    for axis in "xy":
        signal = signal_of(inputs[f"{axis}_polynomial"], inputs["step_mm"])
        gains = [steady_gain(model, inputs["Ts_s"]) for model in _models(inputs, axis).values()]
        moved |= {f"{axis}_signal": signal, f"{axis}_position": [signal * gain for gain in gains]}
    return {
        "integral_ratio": ratio,
        "model_integral_time": inputs["model_Ti_s"] / ratio,
        "second_integral_ratio": second,
        "second_integral_time": inputs["third_system_Ti_s"] / second,
        **moved,
    }


def signal_of(polynomial: Any, position: float) -> float:
    """The smallest positive signal at which the fitted polynomial reaches a position."""
    roots = np.roots(np.append(polynomial[:-1], polynomial[-1] - position))
    return float(min(root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0))


_TRIES = 4


def recovery(inputs: dict[str, Any]) -> Answers:
    """(6-6) to (6-9), identified again from their own noisy step responses to the signals of 6.4."""
    found_orders = {}
    for axis in "xy":
        for name, poles in (("second", 2), ("first", 1)):
            printed = np.asarray(inputs[f"{axis}_{name}_order"])
            u = np.concatenate([np.zeros(50), np.full(1500, inputs[f"{axis}_signal"])])
            response = filter_response(np.concatenate([np.zeros(poles), printed[:1]]), printed[1:], u)
            noise = np.random.default_rng(7).normal(scale=inputs["deviation_mm"], size=(RUNS, u.size))
            found = modified_least_squares_runs(response + noise, u, Orders(poles=poles, zeros=0))
            found_orders[f"{axis}_{name}_order"] = np.hstack([found.numerators, found.denominators[:, 1:]])
    return over_records(found_orders)


@dataclass(frozen=True)
class Control(Record):
    """A controller of one horizontal axis: Kc per mm; Ti, Td as printed, seconds to models, minutes to the machine."""

    Kc: float
    Ti: float
    Td: float

    def changes(self, axis: str) -> dict[str, Any]:
        """Changes of a scenario in which this axis alone is controlled."""
        gains = {"Kc": self.Kc, "Td_s": 60.0 * self.Td, "lower": -0.4, "upper": 0.4}
        if np.isfinite(self.Ti):
            gains["Ti_s"] = 60.0 * self.Ti
        free = {f"control.{other}": {"kind": "constant"} for other in "xy"}
        return {**free, f"control.{axis}": {"kind": "pid", **gains}}

    def pid(self, Ts: float, Ti: float) -> PID:
        """The controller of a model, with a given integral time, s."""
        return PID(self.Kc, Ti, self.Td, Ts, integration="trapezoidal")


def records(inputs: dict[str, Any]) -> Answers:
    """Integral times with which the first-order model responds as the machine does, and the figures of 6.4 to 6.7."""
    # Several figures show the same step.
    step = cache(partial(_step, inputs))
    controls, runs, times = fitted_times(inputs, step)
    curves = (*_open_loop(inputs), *_closed_loop(inputs, controls, times, step))
    return Answers({"model_Ti": ours(times, *runs)}, curves)


def fitted_times(
    inputs: dict[str, Any], step: Callable[..., Readings] | None = None
) -> tuple[list[Control], list[Readings], list[float]]:
    """The controllers of x, the machine's step under each, and the fitted integral times of the model, s."""
    controls = [Control(*map(float, row)) for row in inputs["controls"]]
    runs = [(step or partial(_step, inputs))(control, "x", 10.0, 12.0) for control in controls]
    first = _models(inputs, "x")["first order"]
    times = [_fitted_time(inputs, first, *pair) for pair in zip(controls, runs, strict=True)]
    return controls, runs, times


def _models(inputs: Mapping[str, Any], axis: str) -> dict[str, TransferFunction]:
    """(6-6) to (6-9)."""
    printed = {order: inputs[f"{axis}_{order}_order"] for order in ("second", "first")}
    return {f"{name} order": transfer_function(row[:1], row[1:]) for name, row in printed.items()}


def _step(
    inputs: dict[str, Any], control: Control, axis: str, depth_mm: float, duration_s: float
) -> Readings:
    """A step of 0.1 mm at 2 s above the block, one axis controlled."""
    changes = {
        **control.changes(axis),
        "start.depth_mm": depth_mm,
        "plate.face_mm": [0.0, 0.0, -(99.0 + depth_mm)],
        "reference.0.axis": axis,
        "duration_s": duration_s,
    }
    return run_of(inputs, "horizontal_pid", changes)


def _fitted_time(inputs: dict[str, Any], plant: TransferFunction, control: Control, run: Readings) -> float:
    """The integral time, s, with which the model's step is nearest to the machine's."""
    rows = run.during(2.0)
    reference = run.wanted[rows, X] - run.wanted[0, X]

    def misses(exponent: float) -> float:
        answer = simulate_loop(plant, control.pid(inputs["Ts_s"], 10.0**exponent), reference).y[0]
        return float(np.sum((answer - run.seen[rows, X]) ** 2))

    return float(10.0 ** minimize_scalar(misses, bounds=(-3.0, 1.0), method="bounded").x)


def _open_loop(inputs: dict[str, Any]) -> list[Curves]:
    """Figs 6-7 to 6-10. The signals of machine and models are chosen so that all end where the rig did."""
    curves = []
    for number, axis, way in zip((7, 8, 9, 10), "xxyy", inputs["ways_mm"], strict=True):
        theirs = signal_of(inputs[f"{axis}_polynomial"], float(way))
        signal, run = _signal_for(inputs, axis, float(way), theirs)
        begin, answers = run.mean("xy".index(axis), 0.0, 1.0), {}
        for name, (numerator, denominator) in _models(inputs, axis).items():
            delayed = np.append(np.zeros(len(denominator) - len(numerator)), numerator)
            rise = filter_response(delayed, denominator, (run.time >= 1.0).astype(float))
            answers[name] = begin + float(way) * rise / (numerator.sum() / denominator.sum())
        title = f"Fig. 6-{number}: open-loop step of {axis} by {way:g} mm"
        remark = f"Signal {signal:.3f} here, {theirs:.3f} on the rig by (6-4), (6-5); models scaled to end there too."
        shown: dict[str, Any] = {"begin": 0.5, "end": 6.0, "remark": remark, "asked": False}
        machine = {"coupled machine": run}
        curves.append(over_time(title, "xy".index(axis), machine, models=answers, **shown))
    return curves


def _signal_for(inputs: dict[str, Any], axis: str, way: float, signal: float) -> tuple[float, Readings]:
    """The signal that moves the machine by `way`, mm, in open loop, and its run."""
    which, found = "xy".index(axis), way
    for _ in range(_TRIES):
        signal *= way / found
        changes = {"signal.0.output": axis, "signal.0.by": signal}
        run = run_of(inputs, "horizontal_open_loop_plate", changes)
        found = run.mean(which, 6.0, 8.0) - run.mean(which, 0.0, 1.0)
        if abs(found / way - 1.0) < 0.01:
            break
    return signal, run


def _closed_loop(
    inputs: dict[str, Any], controls: list[Control], times: list[float], step: Callable[..., Readings]
) -> list[Curves]:
    """Figs 6-11, 6-14 and 6-20 to 6-27, with the responses of the thesis's models to the same reference. times:
    integral times of the first-order model, s, fitted to the machine under each controller."""
    pd = Control(float(inputs["pd_Kc"]), np.inf, float(inputs["pd_Td"]))
    Ti, Tm, scaled = (float(inputs[key]) for key in ("system_Ti", "model_Ti", "scaled_model_Ti"))
    quick, slow = controls[0], replace(controls[0], Ti=Tm)
    curves: list[Curves] = []

    def both(axis: str, T: float) -> dict[str, tuple[TransferFunction, float]]:
        return {name: (plant, T) for name, plant in _models(inputs, axis).items()}

    def draw(
        number: int, axis: str, control: Control, title: str, models: Mapping[str, tuple[TransferFunction, float]],
        remark: str = "", begin: float = 1.0, end: float = 10.0, depth_mm: float = 10.0, lasts: float = 12.0,
    ) -> None:  # fmt: skip
        loops = {name: (plant, control.pid(inputs["Ts_s"], T)) for name, (plant, T) in models.items()}
        run, shown = step(control, axis, depth_mm, lasts), {"begin": begin, "end": end, "remark": remark}
        title = f"Fig. 6-{number}: step of {axis}{title}"
        curves.append(beside_models(title, "xy".index(axis), run, loops, **shown))

    for number, axis in ((11, "x"), (14, "y")):
        draw(number, axis, pd, " under PD control", both(axis, np.inf), begin=1.5, end=5.0, lasts=6.0)
    for number, axis in ((20, "x"), (22, "y")):
        for k, (control, own, T) in enumerate(((quick, Ti, Tm), (slow, Tm, scaled))):
            title, remark = f" under PID control, $T_i$ = {own:g}", f"$T_i$ = {T:g} s in the models."
            end, lasts = (90.0, 90.0) if k else (10.0, 12.0)
            draw(number + k, axis, control, title, both(axis, T), remark, end=end, lasts=lasts)
    for k, printed in ((1, "second_model_Ti"), (2, "third_model_Ti")):
        control, T = controls[k], float(inputs[printed])
        named = {f"{T:.3g} s": T, f"{times[k]:.3g} s fitted": times[k]}
        first = _models(inputs, "x")["first order"]
        models = {f"thesis's first-order model, {words}": (first, one) for words, one in named.items()}
        remark = f"Integral time of the model: {T:g} s is printed, {times[k]:.3g} s fits the machine."
        title = f", $K_c$ = {control.Kc:g}, $T_i$ = {control.Ti:g}"
        draw(23 + k, "x", control, title, models, remark, begin=1.5, end=6.0)
    remark = (
        f"Gains of Fig. 6-20, as none are printed; $T_i$ = {Tm:g} s in the models, which are those of 10 mm."
    )
    for number, axis in ((26, "x"), (27, "y")):
        draw(number, axis, quick, " at 18 mm", both(axis, Tm), remark, depth_mm=18.0)
    return curves

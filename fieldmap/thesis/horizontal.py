"""S17: arithmetic of the horizontal axes, and the coupled machine where chapter 6 shows the rig."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from fieldmap.control import PID, TransferFunction, simulate_loop, steady_gain, transfer_function
from fieldmap.control.identification import Orders, modified_least_squares_runs
from fieldmap.control.linear_models import filter_response
from fieldmap.curves import Curves
from fieldmap.records import Record
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.coupled_runs import Readings, X, answer_of, ours, over_time, run_of
from fieldmap.thesis.vertical import RUNS, over_records
from fieldmap.typing import Array


def arithmetic(inputs: dict[str, Any]) -> dict[str, Any]:
    """(6-10), (6-11), and the signals that move 1 mm; what the models make of these signals."""
    ratio = inputs["system_Ti_s"] / inputs["model_Ti_s"]
    second = inputs["second_system_Ti_s"] / inputs["second_model_Ti_s"]
    signals = {axis: signal_of(inputs[f"{axis}_polynomial"], inputs["step_mm"]) for axis in "xy"}
    positions = {
        axis: [
            signals[axis] * _gain(inputs[f"{axis}_{order}_order"], inputs["Ts_s"])
            for order in ("second", "first")
        ]
        for axis in "xy"
    }
    return {
        "integral_ratio": ratio,
        "model_integral_time": inputs["model_Ti_s"] / ratio,
        "second_integral_ratio": second,
        "second_integral_time": inputs["third_system_Ti_s"] / second,
        "x_signal": signals["x"],
        "y_signal": signals["y"],
        "x_position": positions["x"],
        "y_position": positions["y"],
    }


def signal_of(polynomial: Any, position: float) -> float:
    """The smallest positive signal at which the fitted polynomial reaches a position."""
    roots = np.roots(np.append(polynomial[:-1], polynomial[-1] - position))
    return float(min(root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0))


def _gain(model: Any, Ts: float) -> float:
    return steady_gain((model[:1], model[1:]), Ts)


_MACHINE = "coupled machine"
_FREE = {"kind": "constant"}
_TRIES = 4


def recovery(inputs: dict[str, Any]) -> Answers:
    """(6-6) to (6-9) from records of their own step responses to the signals of 6.4."""
    found_orders = {}
    for axis in "xy":
        for name, poles in (("second", 2), ("first", 1)):
            printed = np.asarray(inputs[f"{axis}_{name}_order"])
            u = np.concatenate([np.zeros(50), np.full(1500, inputs[f"{axis}_signal"])])
            response = filter_response(np.concatenate([np.zeros(poles), printed[:1]]), printed[1:], u)
            noise = np.random.default_rng(7).normal(scale=inputs["deviation_mm"], size=(RUNS, u.size))
            found = modified_least_squares_runs(response + noise, u, Orders(poles=poles, zeros=0))
            both = np.concatenate([found.numerators, found.denominators[:, 1:]], axis=1)
            found_orders[f"{axis}_{name}_order"] = both
    return over_records(found_orders)


@dataclass(frozen=True)
class Control(Record):
    """A controller of one horizontal axis: Kc per mm; Ti, Td as printed, seconds to models, minutes to the machine."""

    Kc: float
    Ti: float
    Td: float

    def changes(self, axis: str) -> dict[str, Any]:
        """Of a scenario in which this axis alone is controlled."""
        other = "y" if axis == "x" else "x"
        gains = {"Kc": self.Kc, "Td_s": 60.0 * self.Td, "lower": -0.4, "upper": 0.4}
        if np.isfinite(self.Ti):
            gains["Ti_s"] = 60.0 * self.Ti
        return {f"control.{axis}": {"kind": "pid", **gains}, f"control.{other}": _FREE}

    def pid(self, Ts: float, Ti: float) -> PID:
        """For a model, with an integral time of its own, s."""
        return PID(self.Kc, Ti, self.Td, Ts, integration="trapezoidal")


def records(inputs: dict[str, Any]) -> Answers:
    """The integral times that make the first-order model answer as the machine does, and the figures of 6.4 to 6.7."""
    controls = [Control(*map(float, row)) for row in inputs["controls"]]
    runs = [_step(inputs, control, "x") for control in controls]
    first = _models(inputs, "x")["first order"]
    times = [_fitted_time(inputs, first, *pair) for pair in zip(controls, runs, strict=True)]
    numbers = {"model_Ti": ours(times, *runs)}
    curves = (
        *_open_loop(inputs),
        *_proportional(inputs),
        *_integral(inputs, controls[0]),
        *_ratio(inputs, controls, runs, times),
        *_deeper(inputs, controls[0]),
    )
    return Answers(numbers, curves)


def _models(inputs: Mapping[str, Any], axis: str) -> dict[str, TransferFunction]:
    """(6-6) to (6-9)."""
    printed = {order: inputs[f"{axis}_{order}_order"] for order in ("second", "first")}
    return {f"{name} order": transfer_function(row[:1], row[1:]) for name, row in printed.items()}


def _step(
    inputs: dict[str, Any], control: Control, axis: str, depth_mm: float = 10.0, duration_s: float = 12.0
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


def _answers(
    inputs: dict[str, Any], control: Control, run: Readings, axis: str, Ti: float
) -> dict[str, Array]:
    """What both models make of a run's reference."""
    pid = control.pid(inputs["Ts_s"], Ti)
    return {
        name: answer_of(plant, pid, run, "xy".index(axis)) for name, plant in _models(inputs, axis).items()
    }


def _fitted_time(inputs: dict[str, Any], plant: TransferFunction, control: Control, run: Readings) -> float:
    """The model's integral time, s."""
    rows = run.during(2.0)
    reference = run.wanted[rows, X] - run.wanted[0, X]

    def misses(exponent: float) -> float:
        answer = simulate_loop(plant, control.pid(inputs["Ts_s"], 10.0**exponent), reference).y[0]
        return float(np.sum((answer - run.seen[rows, X]) ** 2))

    return float(10.0 ** minimize_scalar(misses, bounds=(-3.0, 1.0), method="bounded").x)


def _open_loop(inputs: dict[str, Any]) -> list[Curves]:
    """Figs 6-7 to 6-10: the machine's signal is such that it ends where the rig did, and so is the models'."""
    curves = []
    for number, axis, way in zip((7, 8, 9, 10), "xxyy", inputs["ways_mm"], strict=True):
        theirs = signal_of(inputs[f"{axis}_polynomial"], float(way))
        signal, run = _signal_for(inputs, axis, float(way), theirs)
        begin, answers = run.mean("xy".index(axis), 0.0, 1.0), {}
        for name, plant in _models(inputs, axis).items():
            rise = filter_response(*_padded(plant), (run.time >= 1.0).astype(float))
            answers[name] = begin + float(way) * rise / (plant.numerator.sum() / plant.denominator.sum())
        title = f"Fig. 6-{number}: open-loop step of {axis} by {way:g} mm"
        remark = f"Signal {signal:.3f} here, {theirs:.3f} on the rig by (6-4), (6-5); models scaled to end there too."
        curves.append(_beside(title, axis, run, answers, 0.5, 6.0, remark, asked=False))
    return curves


def _signal_for(inputs: dict[str, Any], axis: str, way: float, signal: float) -> tuple[float, Readings]:
    """The signal that moves the machine so far in open loop, and its run."""
    which = "xy".index(axis)
    for _ in range(_TRIES):
        changes = {"signal.0.output": axis, "signal.0.by": signal}
        run = run_of(inputs, "horizontal_open_loop_plate", changes)
        found = run.mean(which, 6.0, 8.0) - run.mean(which, 0.0, 1.0)
        if abs(found / way - 1.0) < 0.01:
            break
        signal *= way / found
    return signal, run


def _padded(plant: TransferFunction) -> tuple[Array, Array]:
    numerator, denominator = (np.asarray(part, dtype=float) for part in plant)
    return np.append(np.zeros(len(denominator) - len(numerator)), numerator), denominator


def _proportional(inputs: dict[str, Any]) -> list[Curves]:
    """Figs 6-11 and 6-14."""
    control = Control(float(inputs["pd_Kc"]), np.inf, float(inputs["pd_Td"]))
    curves = []
    for number, axis in ((11, "x"), (14, "y")):
        run = _step(inputs, control, axis, duration_s=6.0)
        models = _answers(inputs, control, run, axis, np.inf)
        title = f"Fig. 6-{number}: step of {axis} under PD control"
        curves.append(_beside(title, axis, run, models, 1.5, 5.0))
    return curves


def _beside(
    title: str,
    axis: str,
    run: Readings,
    models: Mapping[str, Array],
    begin: float,
    end: float,
    remark: str = "",
    asked: bool = True,
) -> Curves:
    line = {_MACHINE: run}
    return over_time(
        title, "xy".index(axis), line, begin=begin, end=end, remark=remark, models=models, asked=asked
    )


def _integral(inputs: dict[str, Any], control: Control) -> list[Curves]:
    """Figs 6-20 to 6-23: the rig's integral time on the machine, the models' own; then the models' on the machine."""
    system, model, scaled = (float(inputs[key]) for key in ("system_Ti", "model_Ti", "scaled_model_Ti"))
    slow = Control(control.Kc, model, control.Td)
    curves = []
    for numbers, axis in (((20, 21), "x"), ((22, 23), "y")):
        quick_run, slow_run = _step(inputs, control, axis), _step(inputs, slow, axis, duration_s=90.0)
        for number, one, run, Ti, Tm, end in (
            (numbers[0], control, quick_run, system, model, 10.0),
            (numbers[1], slow, slow_run, model, scaled, 90.0),
        ):
            title = f"Fig. 6-{number}: step of {axis} under PID control, $T_i$ = {Ti:g}"
            remark = f"$T_i$ = {Tm:g} s in the models."
            models = _answers(inputs, one, run, axis, Tm)
            curves.append(_beside(title, axis, run, models, 1.0, end, remark))
    return curves


def _ratio(
    inputs: dict[str, Any], controls: list[Control], runs: list[Readings], times: list[float]
) -> list[Curves]:
    """Figs 6-24 and 6-25: the first-order model with the printed integral time, and with the one that fits ours."""
    plant, curves = _models(inputs, "x")["first order"], []
    for number, k, printed in ((24, 1, "second_model_Ti"), (25, 2, "third_model_Ti")):
        control, run, Ti = controls[k], runs[k], float(inputs[printed])
        models = {
            f"thesis's first-order model, {T:.3g} s{words}": answer_of(
                plant, control.pid(inputs["Ts_s"], T), run, X
            )
            for T, words in ((Ti, ""), (times[k], " fitted"))
        }
        title = f"Fig. 6-{number}: step of x, $K_c$ = {control.Kc:g}, $T_i$ = {control.Ti:g}"
        remark = f"Integral time of the model: {Ti:g} s is printed, {times[k]:.3g} s fits the machine."
        curves.append(_beside(title, "x", run, models, 1.5, 6.0, remark))
    return curves


def _deeper(inputs: dict[str, Any], control: Control) -> list[Curves]:
    """Figs 6-26 and 6-27."""
    Ti = float(inputs["model_Ti"])
    curves = []
    for number, axis in ((26, "x"), (27, "y")):
        run = _step(inputs, control, axis, depth_mm=18.0)
        remark = f"Gains of Fig. 6-20, as none are printed; $T_i$ = {Ti:g} s in the models, which are those of 10 mm."
        models = _answers(inputs, control, run, axis, Ti)
        title = f"Fig. 6-{number}: step of {axis} at 18 mm"
        curves.append(_beside(title, axis, run, models, 1.0, 10.0, remark))
    return curves

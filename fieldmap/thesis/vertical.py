"""S16: the vertical PID controller, the identified plant, and both in closed loop."""

from typing import Any

import numpy as np

from fieldmap.control import (
    PID,
    TransferFunction,
    from_roots,
    pid_transfer_function,
    simulate_loop,
    step_metrics,
)
from fieldmap.curves import Curves, Series
from fieldmap.thesis.registry import Answers, Ours

_PLANT = "the identified plant (5-17), linear and without limits of the output"
_NOISE = (
    "sensor noise white and Gaussian with the deviation at rest of Table 3-8; seed 7; nothing else disturbs"
)


def identified_plant(inputs: dict[str, Any]) -> TransferFunction:
    """(5-17), mm per V."""
    return from_roots(inputs["plant_gain"], inputs["plant_zeros"], inputs["plant_poles"])


def controller(inputs: dict[str, Any]) -> dict[str, Any]:
    """(5-11), (5-16) and the identified plant (7-6)."""
    numerator, denominator = pid_transfer_function(
        inputs["Kc"], inputs["Ti_s"], inputs["Td_s"], inputs["Ts_s"]
    )
    plant = identified_plant(inputs)
    return {
        "numerator": numerator,
        "denominator": denominator,
        "zeros": np.sort(np.roots(numerator))[::-1],
        "plant_numerator": plant.numerator,
        "plant_denominator": plant.denominator,
        "nominal_gain": inputs["plant_gain"],
    }


def closed_loop(inputs: dict[str, Any]) -> Answers:
    """The step of Table 7-1 on the identified plant, and the error at rest with sensor noise."""
    pid = PID(
        inputs["Kc"],
        inputs["Ti_s"],
        inputs["Td_s"],
        inputs["Ts_s"],
        integration="trapezoidal",
        acts_on_minus_error=True,
    )
    plant = identified_plant(inputs)
    run = simulate_loop(plant, pid, np.full(2000, inputs["step_mm"]))
    metrics = step_metrics(run.time, run.y[0], final=inputs["step_mm"])
    reached = run.time[np.argmax(run.y[0] >= inputs["step_mm"])]
    numbers = {
        "peak_time": metrics.peak_time,
        "rise_time": metrics.rise_time,
        "time_to_reference": float(reached),
        "settling_time": metrics.settling_time,
        "overshoot": 100 * metrics.overshoot,
    }
    answers: dict[str, Any] = {name: Ours(value, (_PLANT,)) for name, value in numbers.items()}
    answers["rms_at_rest"] = Ours(rms_at_rest(plant, pid, inputs["sensor_deviation_mm"]), (_PLANT, _NOISE))
    return Answers(answers, (_step_figure(run, inputs["step_mm"]),))


def _step_figure(run: Any, step: float) -> Curves:
    shown = run.time <= 1.5
    time = run.time[shown]
    series = (
        Series("identified plant (5-17), PID", time, run.y[0][shown]),
        Series("asked for", time, np.full_like(time, step), "asked"),
    )
    return Curves("Table 7-1: step of the height on the identified plant", "time (s)", "height (mm)", series)


def rms_at_rest(plant: tuple, controller: Any, deviation: float) -> float:
    """RMS of the position as the sensor shows it, at rest, with white noise of this deviation."""
    runs, samples = 50, 4000
    noise = np.random.default_rng(7).normal(scale=deviation, size=(runs, samples))
    run = simulate_loop(plant, controller, np.zeros(samples), runs=runs, position_noise=noise)
    return float(np.sqrt(np.mean((run.y + noise)[:, samples // 2 :] ** 2)))

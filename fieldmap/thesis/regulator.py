"""S20: regulator and estimator of the vertical axis."""

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg

from fieldmap.control import (
    Regulator,
    StateSpace,
    continuous,
    controller_form,
    kalmd,
    lqrd,
    simulate_loop,
    steady_gain,
    step_metrics,
    with_output_integral,
    zero_order_hold,
)
from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.vertical import identified_plant, rms_at_rest


def models(inputs: dict[str, Any]) -> dict[str, Any]:
    """(7-5)..(7-17), (7-20)."""
    plant, Ts = identified_plant(inputs), inputs["Ts_s"]
    exact = continuous(plant, Ts)
    printed = controller_form(inputs["rounded_numerator"], inputs["rounded_denominator"])
    wide = with_output_integral(printed.A, printed.B, printed.C)
    A_d, B_d = zero_order_hold(wide.A, wide.B, Ts)
    estimator = _estimator(exact, inputs)
    return {
        "numerator": exact.numerator,
        "denominator": exact.denominator,
        "A": wide.A,
        "A_d": A_d,
        "B_d": B_d,
        "riccati_sign": _riccati_sign(wide, inputs["Q"], inputs["R"]),
        "k": lqrd(wide.A, wide.B, inputs["Q"], inputs["R"], Ts),
        **estimator._asdict(),
        "model_equilibrium": 1.0 / steady_gain(plant, Ts),
    }


def _estimator(plant: tuple, inputs: dict[str, Any]) -> Any:
    model = controller_form(*plant)
    return kalmd(model.A, model.B, model.C, inputs["noise_mm2"], inputs["noise_mm2"], inputs["Ts_s"])


def _riccati_sign(model: StateSpace, Q: Any, R: float) -> float:
    """Factor of P B R^-1 B'P that the minimum's P needs: its other terms over this one, by least squares."""
    # The sign does not depend on R; at the thesis's 1e-10 the solver of the equation has few digits left.
    weight = np.array([[1e6 * R]])
    P = scipy.linalg.solve_continuous_are(model.A, model.B, Q, weight)
    quadratic = P @ model.B @ np.linalg.solve(weight, model.B.T @ P)
    rest = model.A.T @ P + P @ model.A + Q
    return -float(np.vdot(quadratic, rest) / np.vdot(quadratic, quadratic))


def closed_loop(inputs: dict[str, Any]) -> Answers:
    """The design on its own model, and with the changes that the rig needed, against Table 7-3."""
    plant, Ts = identified_plant(inputs), inputs["Ts_s"]
    exact = continuous(plant, Ts)
    model = controller_form(*exact)
    wide = with_output_integral(model.A, model.B, model.C)
    k = lqrd(wide.A, wide.B, inputs["Q"], inputs["R"], Ts)
    sampled = StateSpace(*zero_order_hold(model.A, model.B, Ts), model.C, model.D)
    equilibrium = (0.0, 1.0 / steady_gain(plant, Ts))
    at_reference = Regulator(k, _estimator(exact, inputs), Ts, equilibrium, estimate="filtered")
    design = replace(at_reference, equilibrium_at="measured")
    rig = replace(design, estimate="predicted", divisor=inputs["divisor"])
    loops = {"design": design, "with (7-20)": at_reference, "with (7-21), as on the rig": rig}
    runs = {name: simulate_loop(sampled, one, np.ones(2000)) for name, one in loops.items()}
    of_design, of_reference, of_rig = (step_metrics(run.time, run.y[0]) for run in runs.values())
    numbers = {
        "design_overshoot": 100 * of_design.overshoot,
        "overshoot_of_7_20": 100 * of_reference.overshoot,
        "design_rise_time": of_design.rise_time,
        "peak_time": of_rig.peak_time,
        "rise_time": of_rig.rise_time,
        "settling_time": of_rig.settling_time,
        "overshoot": 100 * of_rig.overshoot,
        "rms_at_rest": rms_at_rest(sampled, rig, inputs["sensor_deviation_mm"]),
    }
    return Answers(numbers, (_step_figure(runs),))


def _step_figure(runs: dict[str, Any]) -> Curves:
    series = []
    for name, run in runs.items():
        shown = run.time <= 1.0
        series.append(Series(name, run.time[shown], run.y[0][shown]))
    series.append(Series("asked for", series[0].x, np.ones_like(series[0].x), "asked"))
    title = "Table 7-3: step of the height, regulator on the identified model"
    return Curves(title, "time (s)", "height (mm)", tuple(series))

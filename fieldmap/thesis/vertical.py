"""S16, S20: the identified vertical plant with its PID controller (closed loop, identification from records, poles over
the gain) and with its regulator and estimator."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg
from scipy.optimize import least_squares as minimise

from fieldmap import control
from fieldmap.control import PID, Regulator, StateSpace, TransferFunction, identification
from fieldmap.curves import Curves, Series
from fieldmap.thesis.computation import Answers


def identified_plant(inputs: dict[str, Any]) -> TransferFunction:
    """(5-17), mm per V."""
    return control.from_roots(inputs["plant_gain"], inputs["plant_zeros"], inputs["plant_poles"])


def printed_pid(Kc: float, Ti: float, Td: float, Ts: float) -> PID:
    """The controller in the models of chapter 5, with times in seconds."""
    return PID(Kc, Ti, Td, Ts, integration="trapezoidal", acts_on_minus_error=True)


def controller(inputs: dict[str, Any]) -> dict[str, Any]:
    """(5-11), (5-16) and the identified plant (7-6)."""
    gains = (inputs[name] for name in ("Kc", "Ti_s", "Td_s", "Ts_s"))
    numerator, denominator = control.pid_transfer_function(*gains)
    plant = identified_plant(inputs)
    return {
        "numerator": numerator,
        "denominator": denominator,
        "zeros": np.sort(np.roots(numerator))[::-1],
        "plant_numerator": plant.numerator,
        "plant_denominator": plant.denominator,
        "nominal_gain": inputs["plant_gain"],
    }


def step_response(inputs: dict[str, Any]) -> Answers:
    """The step of Table 7-1 on the identified plant, and the error at rest with sensor noise."""
    plant = identified_plant(inputs)
    pid = printed_pid(inputs["Kc"], inputs["Ti_s"], inputs["Td_s"], inputs["Ts_s"])
    run = control.simulate_loop(plant, pid, np.full(2000, inputs["step_mm"]))
    answers = {
        **_of_step(run, inputs["step_mm"]),
        "time_to_reference": float(run.time[np.argmax(run.y[0] >= inputs["step_mm"])]),
        "rms_at_rest": rms_at_rest(plant, pid, inputs["sensor_deviation_mm"]),
    }
    title = "Table 7-1: step of the height on the identified plant"
    drawn = _steps(title, {"identified plant (5-17), PID": run}, inputs["step_mm"], 1.5)
    return Answers(answers, (drawn,))


def _of_step(run: Any, final: float = 1.0) -> dict[str, float]:
    """Peak, rise and settling time, s, and overshoot, %, by name."""
    metrics = control.step_metrics(run.time, run.y[0], final=final)
    times = {name: getattr(metrics, name) for name in ("peak_time", "rise_time", "settling_time")}
    return {**times, "overshoot": 100 * metrics.overshoot}


def _steps(title: str, runs: dict[str, Any], step: float, end: float) -> Curves:
    """Responses to a step of `step`, mm, until `end`, s."""
    series = []
    for name, run in runs.items():
        shown = run.time <= end
        series.append(Series(name, run.time[shown], run.y[0][shown]))
    series.append(Series("asked for", series[0].x, np.full_like(series[0].x, step), "asked"))
    return Curves(title, "time (s)", "height (mm)", tuple(series))


def rms_at_rest(plant: tuple, controller: Any, deviation: float) -> float:
    """RMS of the measured position at rest, with white sensor noise of this standard deviation."""
    runs, samples = 50, 4000
    noise = np.random.default_rng(7).normal(scale=deviation, size=(runs, samples))
    run = control.simulate_loop(plant, controller, np.zeros(samples), runs=runs, position_noise=noise)
    return float(np.sqrt(np.mean((run.y + noise)[:, samples // 2 :] ** 2)))


RUNS = 100
_DRAWN_GAINS, _ALL_GAINS = np.linspace(0.01, 1.0, 2000), np.geomspace(1e-3, 40.0, 2000)


def recovery(inputs: dict[str, Any]) -> Answers:
    """(5-17) from PRBS records of its closed loop, by the modified least squares on control signal and position."""
    plant, Ts = identified_plant(inputs), inputs["Ts_s"]
    order, amplitude = inputs["prbs_order"], inputs["prbs_amplitude_mm"]
    reference = identification.pseudo_random_binary(order, amplitude=amplitude, samples=2040)
    pid = printed_pid(inputs["Kc"], inputs["Ti_s"], inputs["Td_s"], Ts)
    noise = np.random.default_rng(7).normal(scale=inputs["sensor_deviation_mm"], size=(RUNS, reference.size))
    run = control.simulate_loop(plant, pid, reference, runs=RUNS, position_noise=noise)
    orders = identification.Orders(poles=2, zeros=1)
    found = identification.modified_least_squares_runs(run.y + noise, run.u, orders)
    return over_records({"poles": found.poles.real, "zero": found.zeros.real, "gain": found.gains[:, None]})


def locus(inputs: dict[str, Any]) -> Answers:
    """Table 5-2: the poles that the thesis identified, and the poles of its final model at the same gains."""
    plant = identified_plant(inputs)
    unit = control.pid_transfer_function(1.0, inputs["Ti_s"], inputs["Td_s"], inputs["Ts_s"])
    negative = control.transfer_function(-unit.numerator, unit.denominator)
    gains = np.asarray(inputs["gains"])
    numbers = _pairs_and_third(identification.root_locus(plant, negative, gains).poles, gains, inputs)
    first = control.from_roots(inputs["plant_gain"], inputs["preliminary_zeros"], inputs["preliminary_poles"])
    models = {"preliminary model, Table 5-3": first, "final model, Table 5-4": plant}

    def branches(gains: np.ndarray, shown: Callable[[np.ndarray], np.ndarray]) -> list[Series]:
        return [
            Series(name, np.where(shown(one), one.real, np.nan), one.imag)
            for name, model in models.items()
            for one in identification.root_locus(model, negative, gains, steps=1).poles.T
            if shown(one).any()
        ]

    # Fig. 5-7: the loop is stable if its poles are inside the circle.
    turn = np.exp(1j * np.linspace(0.0, 2 * np.pi, 200))
    circle = Series("unit circle", turn.real, turn.imag, "asked")
    whole = (circle, *branches(_ALL_GAINS, lambda q: np.abs(q) < 1.4))
    pair = numbers["pair_real"], numbers["pair_imaginary"]
    measured = np.array(inputs["measured_real"]), np.array(inputs["measured_imaginary"])
    near = (
        *branches(_DRAWN_GAINS, lambda q: q.real > 0.85),
        Series("final model at the gains of Table 5-2", *pair, points=True),
        Series("identified, Table 5-2", *measured, "measured", points=True),
    )
    title, parts = "Fig. 5-7: poles of the closed loop over the gain", ("real part", "imaginary part")
    about_one = "Figs 5-6, 5-8: poles of the closed loop about q = 1"
    curves = (
        Curves(title, *parts, whole, f"{_from_to(_ALL_GAINS)}; |q| < 1.4.", equal=True),
        Curves(about_one, *parts, near, f"{_from_to(_DRAWN_GAINS)}."),
    )
    return Answers(numbers, curves)


def _from_to(gains: np.ndarray) -> str:
    return f"$K_c$ from {gains[0]:g} to {gains[-1]:g} V/mm, times of the controller in seconds"


def minutes(inputs: dict[str, Any]) -> dict[str, Any]:
    """Table 5-2, section 5.4 and Table 7-1, with the controller's times in minutes and a plant of Newton's form."""
    fitted = _fitted_plant(inputs)
    gains, Ts = np.asarray(inputs["gains"]), inputs["Ts_s"]
    poles = np.array([_loop_poles(fitted, gain, inputs) for gain in gains])
    Ti, Td = 60.0 * inputs["Ti_s"], 60.0 * inputs["Td_s"]
    integral = 0.5 * Ts / Ti
    pid = PID(inputs["step_gain"], Ti, Td, Ts, integration="trapezoidal", c=0.0)
    of_step = _of_step(control.simulate_loop(_newtonian(fitted, Ts), pid, np.ones(3000)))
    del of_step["rise_time"]
    weight = 1e3 * inputs["gravity"] * inputs["amplifier_A_per_V"] / inputs["lift_current_A"]
    return {
        **_pairs_and_third(poles, gains, inputs),
        **of_step,
        "zero": [(1.0 - integral) / (1.0 + integral)] * 3,
        "stiffness_over_gain": fitted[1] / fitted[0],
        "gain_over_weight": fitted[0] / weight,
    }


def over_records(found: dict[str, np.ndarray]) -> Answers:
    """Means over records of values (records, k), by name; the facts NAME_spread are standard deviations."""
    facts: dict[str, Any] = {f"{name}_spread": values.std(axis=0, ddof=1) for name, values in found.items()}
    means = {name: values.mean(axis=0) for name, values in found.items()}
    return Answers(means, facts={"records": RUNS, **facts})


def _newtonian(plant: np.ndarray, Ts: float) -> TransferFunction:
    """g / (s^2 + d s - c), mm per V, for a held input; the controller has the sign of the gain."""
    gain, stiffness, damping = plant
    return control.sampled(([gain], [1.0, damping, -stiffness]), Ts)


def _loop_poles(plant: np.ndarray, gain: float, inputs: dict[str, Any]) -> np.ndarray:
    Ti, Td, Ts = 60.0 * inputs["Ti_s"], 60.0 * inputs["Td_s"], inputs["Ts_s"]
    return control.closed_loop(_newtonian(plant, Ts), control.pid_transfer_function(gain, Ti, Td, Ts)).poles


def _fitted_plant(inputs: dict[str, Any]) -> np.ndarray:
    """g (mm/s^2 per V), c (1/s^2), d (1/s) by least squares on the printed poles, without the held-back gains."""
    pairs = np.asarray(inputs["pair_real"]) + 1j * np.asarray(inputs["pair_imaginary"])
    third = dict(zip(inputs["third_gains"], inputs["third"], strict=True))
    scale = np.array([1e3, 1e2, 10.0])

    def misses(x: np.ndarray) -> np.ndarray:
        found = []
        for gain, pair in zip(inputs["gains"], pairs, strict=True):
            if gain in inputs["held_back"]:
                continue
            poles = _loop_poles(scale * x, gain, inputs)
            found.append(poles[np.argmin(np.abs(poles - pair))] - pair)
            if gain in third:
                found.append(poles[np.argmin(np.abs(poles - third[gain]))] - third[gain])
        return np.concatenate([np.real(found), np.imag(found)])

    # Central differences: with forward differences the search stops at its start values.
    return scale * minimise(misses, [1.6, 1.5, 0.0], jac="3-point").x


def _pairs_and_third(poles: np.ndarray, gains: np.ndarray, inputs: dict[str, Any]) -> dict[str, Any]:
    """The complex pair at every gain, and the largest real pole at the gains where the table has one."""
    pair = np.array([p[np.argmax(p.imag)] for p in poles])
    real = [max(q.real for q in p if abs(q.imag) < 1e-9) for p in poles]
    third = [real[int(np.argmin(np.abs(gains - gain)))] for gain in inputs["third_gains"]]
    return {"pair_real": pair.real, "pair_imaginary": pair.imag, "third": third}


def regulator_models(inputs: dict[str, Any]) -> dict[str, Any]:
    """(7-5)..(7-17), (7-20)."""
    plant, Ts = identified_plant(inputs), inputs["Ts_s"]
    exact = control.continuous(plant, Ts)
    printed = control.controller_form(inputs["rounded_numerator"], inputs["rounded_denominator"])
    wide = control.with_output_integral(printed.A, printed.B, printed.C)
    A_d, B_d = control.zero_order_hold(wide.A, wide.B, Ts)
    models = printed, control.controller_form(*exact)
    (_, of_printed), (_, of_exact) = (_design(one, inputs) for one in models)
    return {
        "numerator": exact.numerator,
        "denominator": exact.denominator,
        "A": wide.A,
        "A_d": A_d,
        "B_d": B_d,
        "riccati_sign": _riccati_sign(wide, inputs["Q"], inputs["R"]),
        "k": of_printed.k,
        **of_exact.estimator._asdict(),
        "model_equilibrium": 1.0 / control.steady_gain(plant, Ts),
    }


def design_of(
    model: StateSpace, Q: Any, R: float, noise: tuple[float, float], Ts: float
) -> tuple[StateSpace, Regulator]:
    """(7-9) to (7-17) for a model in continuous time: the sampled model for a held input, and its regulator with the
    equilibrium at the reference, (7-20). noise: intensities of the process and of the measurement."""
    wide = control.with_output_integral(model.A, model.B, model.C)
    k = control.lqrd(wide.A, wide.B, np.array(Q), R, Ts)
    estimator = control.kalmd(model.A, model.B, model.C, *noise, Ts)
    equilibrium = (0.0, 1.0 / control.steady_gain(control.to_transfer_function(model)))
    plant = StateSpace(*control.zero_order_hold(model.A, model.B, Ts), model.C, model.D)
    return plant, Regulator(k, estimator, Ts, equilibrium)


def _design(model: StateSpace, inputs: dict[str, Any]) -> tuple[StateSpace, Regulator]:
    return design_of(model, inputs["Q"], inputs["R"], (inputs["noise_mm2"],) * 2, inputs["Ts_s"])


def _riccati_sign(model: StateSpace, Q: Any, R: float) -> float:
    """Factor of P B R^-1 B'P in the Riccati equation of the optimal P, by least squares."""
    # The sign does not depend on R; with the thesis's R = 1e-10 the Riccati solver loses most digits.
    weight = np.array([[1e6 * R]])
    P = scipy.linalg.solve_continuous_are(model.A, model.B, Q, weight)
    quadratic = P @ model.B @ np.linalg.solve(weight, model.B.T @ P)
    rest = model.A.T @ P + P @ model.A + Q
    return -float(np.vdot(quadratic, rest) / np.vdot(quadratic, quadratic))


def regulator_loop(inputs: dict[str, Any]) -> Answers:
    """The design on its own model, without and with the changes that the rig needed, for Table 7-3."""
    exact = control.controller_form(*control.continuous(identified_plant(inputs), inputs["Ts_s"]))
    sampled, at_reference = _design(exact, inputs)
    design = replace(at_reference, equilibrium_at="measured")
    rig = replace(design, estimate="predicted", divisor=inputs["divisor"])
    loops = {"design": design, "with (7-20)": at_reference, "with (7-21), as on the rig": rig}
    runs = {name: control.simulate_loop(sampled, one, np.ones(2000)) for name, one in loops.items()}
    of_design, of_reference, of_rig = map(_of_step, runs.values())
    numbers = {
        "design_overshoot": of_design["overshoot"],
        "overshoot_of_7_20": of_reference["overshoot"],
        "design_rise_time": of_design["rise_time"],
        **of_rig,
        "rms_at_rest": rms_at_rest(sampled, rig, inputs["sensor_deviation_mm"]),
    }
    title = "Table 7-3: step of the height, regulator on the identified model"
    return Answers(numbers, (_steps(title, runs, 1.0, 1.0),))

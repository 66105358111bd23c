"""Every part of the thesis's rows depends on each of its inputs. Each input is changed alone, and each number is
compared with a closed form at the changed inputs; for the remaining parts ELSEWHERE names the test that does so."""

import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from scipy.optimize import brentq

from fieldmap import control
from fieldmap.thesis import planar_unit, single_electromagnet, statics, vertical
from fieldmap.thesis.computation import Answers, Ours, function_of
from fieldmap.thesis.printed import part_names, read_part

G, MU0 = 9.80665, 4e-7 * np.pi
CODE = SimpleNamespace(assumptions=())


def magnets(i):
    sphere = np.pi * (1e-3 * i["sphere_diameter_mm"]) ** 3 / 6
    cylinder = np.pi * (1e-3 * i["magnet_diameter_mm"]) ** 2 * 1e-3 * i["magnet_height_mm"] / 4
    return {
        "sphere_volume": sphere,
        "sphere_mass": i["sphere_density"] * sphere,
        "sphere_moment": i["sphere_remanence_T"] * sphere / MU0,
        "magnet_moment": i["magnet_remanence_T"] * cylinder / MU0,
    }


def windings(i):
    """Current over the square of the wire's size, and ampere-turns, stay constant."""
    area = (i["simplified_wire_mm"] / i["exact_wire_mm"]) ** 2
    return {"simplified_current": i["exact_current_A"] * area, "simplified_turns": i["exact_turns"] / area}


def two_windings(i):
    """The two stand-ins differ by the depth in m."""
    return {"difference_of_the_windings": 0.1 * i["far_mm"], "depth_exact": 40.0, "depth_simplified": 50.0}


def divided(ratio, nominal, mm):
    """The planar stand-in's result for left and right currents with a sum of 2 nominal, and the depth."""
    left, right = 2 * nominal / (1 + ratio), 2 * nominal * ratio / (1 + ratio)
    return left + 3 * right - 1e3 * mm


def planar_ratios(i):
    places = [1e3 * divided(r, i["nominal_current_A"], i["depth_mm"]) for r in i["exact_ratios"]]
    curve = [1e3 * (r + 3 * i["nominal_current_A"] - 1e3 * i["depth_mm"]) for r in i["exact_ratios"]]
    return {"equilibrium": places, "equilibrium_in_open_space": places, "equilibrium_with_curve": curve}


def planar_depths(i):
    places = [1e3 * divided(i["ratio"], i["nominal_current_A"], mm) for mm in i["depths_mm"]]
    return {"equilibrium": places, "equilibrium_in_open_space": places}


def planar_gradients(i):
    ratios = {"vertical": 1.0}
    ratios |= dict(zip(("horizontal_large_ratio", "horizontal_small_ratio"), i["exact_ratios"], strict=True))
    found = {name: divided(r, i["nominal_current_A"], i["depth_mm"]) for name, r in ratios.items()}
    return found | {f"{name}_in_open_space": value for name, value in found.items()}


def planar_zeros(i):
    near, far = (divided(i["ratio"], i["nominal_current_A"], i[f"{one}_depth_mm"]) for one in ("near", "far"))
    return {"near": 3, "near_unstable": 1, "far": 1, "depth_of_the_change": 1e3 * (near + 7 * far)}


def lumped(i):
    """Downwards m z'' = m g - m g (i / (i0 + s z))^2, so the poles are +-sqrt(2 g s / (i0 + s z))."""
    current = i["current_at_zero_A"] + i["slope_A_per_mm"] * i["depth_mm"]
    product = -2 * G * 1e3 * i["slope_A_per_mm"] / current
    sign = np.sign(i["identified_denominator"][1])
    return {"product_of_poles": product, "stiffness_term": 1, "current_term": 1, "sign_of_damping": sign}


def frames(i):
    c, s = np.cos(np.radians(i["angle_deg"])), np.sin(np.radians(i["angle_deg"]))
    x, y, out = (
        i["local_x_deviation_mm"],
        i["local_y_deviation_mm"],
        i["half_range_mm"] + i["centre_offset_mm"],
    )
    return {
        "rotation": [c, -s, s, c],
        "translation": [-np.sqrt(2) * out * (c - s), -np.sqrt(2) * out * (c + s)],
        "global_deviation": [np.hypot(c * x, s * y), np.hypot(s * x, c * y)],
    }


def accuracy(i, volts, gain, inside=1.0):
    """The converter's error, V, from Appendix B."""
    offset = i["offset_error"] + i["offset_drift"] * inside + i["nonlinearity"]
    return np.asarray(volts) * gain + i["range_V"] * offset + 3e-6 * i["random_noise_uV"]


def converter(i):
    inside, outside, net = i["internal_change_K"], i["external_change_K"], i["printed_gain_error"]
    zero, full = 1e6 * accuracy(i, [0.0, i["range_V"]], net, inside)
    return {
        "resolution": 2e3 * i["range_V"] / 2 ** i["bits"],
        "gain_error": net - i["gain_drift"] * inside - i["reference_drift"] * outside,
        "net_gain_error": net,
        "net_offset_error": i["offset_error"] + i["offset_drift"] * inside + i["nonlinearity"],
        "noise_uncertainty": 3 * i["random_noise_uV"],
        "accuracy_at_zero": zero,
        "accuracy_at_full_scale": full,
    }


def budget(i):
    """The error budget of Appendix C."""
    actual = i["nominal_mm"] + i["accuracy_mm"] * np.array([1, -1])
    unit = 1e-3 * i["voltage_step_mV"] * i["scale_mm_per_V"]
    shown = unit * np.floor(actual / unit + 0.5 + 1e-9)
    volts = (shown - i["zero_mm"]) / i["scale_mm_per_V"]
    codes = volts / i["converter_step_V"]
    steps = np.ceil(codes - 1e-9)
    taken = steps * i["converter_step_V"]
    off = accuracy(i, taken, i["gain_error"] + i["gain_drift"] + 10 * i["reference_drift"])
    read = np.array([taken[0] + off[0], taken[0] - off[0], taken[1] - off[1], taken[1] + off[1]])
    place = i["zero_mm"] + i["scale_mm_per_V"] * read
    return {
        "actual": actual, "shown": shown, "voltage": volts, "bits_needed": codes, "effective_bits": steps,
        "nearest_bits": np.round(codes), "input_voltage": taken, "accuracy": off, "measured_voltage": read,
        "measurement": place, "error": i["nominal_mm"] - place,
    }  # fmt: skip


def chain(i):
    scan = round(1e3 / i["scan_rate_Hz"], 3)
    noise, step = 1e-6 * i["converter_noise_uV"], 2 * i["range_V"] / 2 ** i["bits"]
    return {
        "resolution": 1e-3 * i["voltage_step_mV"] * i["scale_mm_per_V"],
        "scan_time": 1e3 / i["scan_rate_Hz"],
        "cycle_time": i["cycles"] * scan,
        "averaging_time": 1e-3 * i["averages"] * scan,
        "largest_current": 10 * i["gain_A_per_V"],
        "current_at_input": i["gain_A_per_V"] * i["input_V"],
        "gain": np.mean(i["multimeter_A"]) / i["input_V"],
        "deviation_range": [np.min(i["current_deviation_A"]), np.max(i["current_deviation_A"])],
        # Sheppard: a step q adds q^2 / 12 to the variance, averaged over places within the step.
        "held_deviation": (1e3 * i["scale_mm_per_V"] * np.hypot(noise, step / np.sqrt(12)), 0.01),
    }


def of_levitation(i):
    """Stand-ins: lift current 1 + z/100 + h/1000 A at force 1; lift share 0.3 + z/100 + h/1000 + current/10."""
    zs, hs, h, z = i["depths_mm"], i["offsets_mm"], i["offset_mm"], i["middle_mm"]
    law = 1.215 + 0.0343 * np.asarray(zs)
    return {
        "current": 1 + zs / 100 + h / 1000,
        "total": 6 * (1 + z / 100 + h / 1000),
        "current_over_h": 1 + z / 100 + hs / 1000,
        "current_linear": 1 / (0.4 + zs / 100 + h / 1000),
        "relative_slope": 1 / (1 + z / 100 + hs[:-1] / 1000),
        "lift_over_weight": np.array([0.3 + zs / 100 + one / 1000 + law / 10 for one in hs]).ravel(),
        "lift_with_joints": 2 * zs,
        "slope_with_joints": 5.0,
    }


def clear_directions(i):
    """Stand-in: coil k moves the magnet by k - 3.28 along x and by 3.28 - k along y; the largest is 2.72."""
    moved = np.arange(1.0, 7.0) - 3.28
    signs = np.where(np.abs(moved) > 2.72 * i["least_share"], np.sign(moved), 0)
    return {"directions": np.array([signs, -signs, -signs, signs]).ravel()}


def pid(i, gain):
    half, rate = i["Ts_s"] / (2 * i["Ti_s"]), i["Td_s"] / i["Ts_s"]
    return gain * np.array([1 + half + rate, half - 1 - 2 * rate, rate])


def plant(i):
    return i["plant_gain"] * np.poly(np.atleast_1d(i["plant_zeros"])), np.poly(
        np.atleast_1d(i["plant_poles"])
    )


def controller(i):
    numerator, (top, bottom) = pid(i, i["Kc"]), plant(i)
    return {
        "numerator": numerator, "denominator": [1, -1, 0], "zeros": np.sort(np.roots(numerator))[::-1],
        "plant_numerator": top, "plant_denominator": bottom, "nominal_gain": i["plant_gain"],
    }  # fmt: skip


def loop(i, gain):
    """Forward path and characteristic polynomial; the controller acts on minus the error."""
    top, bottom = plant(i)
    forward = np.convolve(np.append(0.0, top), -pid(i, gain))
    return forward, np.convolve(bottom, [1, -1, 0])


def of_step(y, Ts):
    """Metrics of a step of 1 mm: 10 % to 90 %, and settling within 2 %, interpolated between samples."""

    def crossing(values, k, level):
        return Ts * (k - 1 + (level - values[k - 1]) / (values[k] - values[k - 1]))

    first, last = (crossing(y, np.argmax(y >= level), level) for level in (0.1, 0.9))
    off = np.abs(y - 1)
    return {
        "overshoot": 100 * (y.max() - 1),
        "peak_time": Ts * y.argmax(),
        "rise_time": last - first,
        "settling_time": crossing(off, np.flatnonzero(off > 0.02)[-1] + 1, 0.02),
    }


def closed_loop(i):
    forward, bottom = loop(i, i["Kc"])
    y = scipy.signal.lfilter(forward, bottom + forward, np.ones(2000))
    sensitivity = scipy.signal.lfilter(bottom, bottom + forward, np.eye(1, 20000)[0])
    return of_step(y, i["Ts_s"]) | {
        "time_to_reference": i["Ts_s"] * np.argmax(y >= 1),
        # From about 100 000 samples.
        "rms_at_rest": (i["sensor_deviation_mm"] * np.sqrt(np.sum(sensitivity**2)), 0.02),
    }


def recovered(i):
    """The plant that generated the records."""
    poles = np.sort(np.real(i["plant_poles"]))[::-1]
    return {"poles": (poles, 5e-3), "zero": (i["plant_zeros"], 5e-3), "gain": (i["plant_gain"], 5e-3)}


def recovered_sideways(i):
    orders = [f"{axis}_{order}_order" for axis in "xy" for order in ("second", "first")]
    return {name: (np.delete(i[name], 1), 5e-3) for name in orders}


def loci(i):
    return loci_of([np.roots(np.add(*loop(i, gain))) for gain in i["gains"]], i)


def loci_of(poles, i):
    """The complex pair at each gain, and the real pole nearest to 1 at the gains where one is printed."""
    pair = np.array([p[p.imag.argmax()] for p in poles])
    third = [max(q.real for q in p if abs(q.imag) < 1e-9) for p in poles]
    known = [third[int(np.argmin(np.abs(i["gains"] - gain)))] for gain in i["third_gains"]]
    return {"pair_real": pair.real, "pair_imaginary": pair.imag, "third": known}


def in_minutes(i):
    """For the stand-in g = 1600 mm/s^2 per V, c = 150 1/s^2, d = 2 1/s, with a held input."""
    Ts, Ti, Td = i["Ts_s"], 60 * i["Ti_s"], 60 * i["Td_s"]
    A, B = np.array([[-2.0, 150.0], [1.0, 0.0]]), np.array([[1600.0], [0.0]])
    top, bottom, _ = scipy.signal.cont2discrete(([1600.0], [1.0, 2.0, -150.0]), Ts)
    half, rate = Ts / (2 * Ti), Td / Ts
    pid = np.array([1 + half + rate, half - 1 - 2 * rate, rate])
    bottom, forward = np.convolve(bottom, [1, -1, 0]), np.convolve(np.ravel(top), pid)
    found = loci_of([np.roots(bottom + gain * forward) for gain in i["gains"]], i)
    # A step of 3000 samples; the derivative acts on the position.
    phi = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 3))]]) * Ts)
    x, integral, before, y = np.zeros(2), 0.0, (0.0, 0.0), []
    for _ in range(3000):
        error = 1 - x[1]
        integral += 0.5 * Ts / Ti * (error + before[0])
        u = i["step_gain"] * (error + integral - Td / Ts * (x[1] - before[1]))
        before = error, x[1]
        y.append(x[1])
        x = phi[:2, :2] @ x + phi[:2, 2] * u
    weight = 1e3 * i["gravity"] * i["amplifier_A_per_V"] / i["lift_current_A"]
    of = of_step(np.array(y), Ts)
    del of["rise_time"]
    return (
        found
        | of
        | {
            "zero": [(1 - half) / (1 + half)] * 3,
            "stiffness_over_gain": 150 / 1600,
            "gain_over_weight": 1600 / weight,
        }
    )


def sideways(i):
    first, second = i["system_Ti_s"] / i["model_Ti_s"], i["second_system_Ti_s"] / i["second_model_Ti_s"]
    found = {
        "integral_ratio": first, "model_integral_time": i["model_Ti_s"] / first,
        "second_integral_ratio": second, "second_integral_time": i["third_system_Ti_s"] / second,
    }  # fmt: skip
    for axis in "xy":
        signal = brentq(lambda s, a=axis: np.polyval(i[f"{a}_polynomial"], s) - i["step_mm"], 0, 0.2)
        gains = [
            i[f"{axis}_{order}_order"][0] / sum(i[f"{axis}_{order}_order"][1:])
            for order in ("second", "first")
        ]
        found |= {f"{axis}_signal": signal, f"{axis}_position": signal * np.array(gains)}
    return found


def regulated(i):
    """The continuous model, its voltage at rest, and the rounded model with output integral for a held input."""
    poles = np.log(i["plant_poles"]) / i["Ts_s"]
    top, bottom = plant(i)
    a1, a0 = np.asarray(i["rounded_denominator"])[1:] / i["rounded_denominator"][0]
    b1, b0 = np.asarray(i["rounded_numerator"]) / i["rounded_denominator"][0]
    wide = np.array([[-a1, -a0, 0, 1], [1, 0, 0, 0], [b1, b0, 0, 0], [0, 0, 0, 0]])
    held = scipy.linalg.expm(wide * i["Ts_s"])
    return {
        "denominator": np.poly(poles),
        "model_equilibrium": bottom.sum() / top.sum(),
        "A": wide[:3, :3].ravel(), "A_d": held[:3, :3].ravel(), "B_d": held[:3, 3],
    }  # fmt: skip


def regulated_loop(i):
    """The regulator of lqrd and kalmd on its own model, for the three choices of rest and estimate."""
    Ts, top = i["Ts_s"], plant(i)
    bottom = np.poly(np.log(i["plant_poles"]) / Ts)
    # b1 s + b0 follow from two samples of the step response with a held input.
    first = scipy.signal.lfilter(np.append(0.0, top[0]), top[1], np.ones(3))[1:]
    A, B = np.array([[-bottom[1], -bottom[2]], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    phi = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 3))]]) * Ts)
    steps = [phi[:2, 2], phi[:2, :2] @ phi[:2, 2] + phi[:2, 2]]
    C = np.linalg.solve(np.array(steps), first)[None]
    wide = control.with_output_integral(A, B, C)
    k = control.lqrd(wide.A, wide.B, i["Q"], i["R"], Ts)
    estimator, rest = (
        control.kalmd(A, B, C, i["noise_mm2"], i["noise_mm2"], Ts),
        1 / (top[0].sum() / top[1].sum()),
    )
    model = control.StateSpace(phi[:2, :2], phi[:2, 2:], C, np.zeros((1, 1)))

    def of(at, estimate="filtered", divisor=1.0):
        regulator = control.Regulator(
            k, estimator, Ts, (0.0, rest), equilibrium_at=at, estimate=estimate, divisor=divisor
        )
        return of_step(control.simulate_loop(model, regulator, np.ones(2000)).y[0], Ts)

    design, reference, rig = of("measured"), of("reference"), of("measured", "predicted", i["divisor"])
    return rig | {
        "design_overshoot": design["overshoot"], "overshoot_of_7_20": reference["overshoot"],
        "design_rise_time": design["rise_time"], "rms_at_rest": 7 * i["sensor_deviation_mm"] + i["divisor"],
    }  # fmt: skip


VARIED = {
    "S3": magnets, "S4_windings": windings, "S4_levitation": two_windings, "S5_current_ratio": planar_ratios,
    "S5_depth": planar_depths, "S5_gradients": planar_gradients, "S5_zeros": planar_zeros, "S6": lumped, "S7": frames,
    "S8_converter": converter, "S8_error_budget": budget, "S8_sensor_and_amplifier": chain, "S12": of_levitation,
    "S13": lambda i: {"sum": 6}, "S13_field": clear_directions, "S16_controller": controller,
    "S16_closed_loop": closed_loop, "S16_recovery": recovered, "S16_root_locus": loci,
    "S16_times_in_minutes": in_minutes, "S17_arithmetic": sideways, "S17_recovery": recovered_sideways,
    "S20_models": regulated, "S20_closed_loop": regulated_loop,
}  # fmt: skip
FOLLOW, JUDGED = "thesis/test_rows_follow_their_inputs.py::test_", "thesis/test_rows_judged.py::test_"
FORCES = "thesis/test_force_rows.py::test_"
RUNS = "thesis/test_runs_of_rows.py::test_runs_numbers_and_figures_of_a_row"
BRANCH, MAP = (
    "thesis/test_hysteresis.py::test_rows_set_ours_beside_the_same_branch",
    "thesis/test_map_plants.py::test_",
)
ELSEWHERE = {
    "S9_constants": FORCES + "constants_follow_the_nominal_current",
    "S9_superposition": FORCES + "what_is_said_of_two_magnets",
    "S10": FORCES + "figures_and_facts_in_three_dimensions",
    "S14_table_6_2": FOLLOW + "table_6_2",
    "S14_table_6_3": FOLLOW + "table_6_3",
    "S14_x_branches": FOLLOW + "branches_of_one_axis_at_their_height",
    "S14_y_branches": FOLLOW + "branches_of_one_axis_at_their_height",
    "S14_x_joints": BRANCH, "S14_y_joints": BRANCH, "S14_x_remanence": BRANCH, "S14_y_remanence": BRANCH,
    "S14_fits": FOLLOW + "fits_of_a_straight_curve",
    "S14_limits": FOLLOW + "signal_at_the_limit_of_the_amplifier",
    "S14_convergence": FOLLOW + "shift_rows_at_their_height",
    "S14_magnet_models": FOLLOW + "shift_rows_at_their_height",
    "S14_own_current": JUDGED + "own_current_is_the_level_that_is_asked_for",
    "S14_noise": FOLLOW + "noise_of_the_mean_deviation",
    "S15": JUDGED + "ranges_are_of_both_sides_and_end_at_the_limits",
    "S16_map_plant": MAP + "numbers_of_the_vertical_plant",
    "S17_map_plant": MAP + "numbers_of_the_horizontal_plants",
    "S16_records": RUNS,
    "S17_records": RUNS,
    "S18_vertical": RUNS,
    "S18_spikes": RUNS,
    "S18_proportional": RUNS,
    "S18_range": RUNS,
    "S18_regulator": RUNS,
    "S18_heights": RUNS,
    "S19": RUNS,
    "S14_calibration": FOLLOW + "calibrations_name_what_is_fitted_to_what",
}  # fmt: skip
"""Where inputs of a part are changed or its numbers judged otherwise."""


def test_every_part_with_inputs_is_varied_here_or_elsewhere():
    parts = {part for part in part_names() if read_part(part).inputs}
    assert VARIED.keys() | ELSEWHERE.keys() == parts
    assert not VARIED.keys() & ELSEWHERE.keys()
    for place in ELSEWHERE.values():
        path, _, name = place.partition("::")
        assert f"def {name}" in (Path(__file__).parents[1] / path).read_text(encoding="utf-8"), place


# Inputs without effect on the numbers: printed values for comparison, values only drawn, and start values.
WITHOUT_EFFECT = {
    "S4_levitation": {"near_mm", "printed_depth_mm"},
    "S5_current_ratio": {"table_2_3_mm"},
    "S5_depth": {"table_2_4_mm"},
    # The lift law is per mass; the sensor's zero and steps do not change the noise of a held output.
    "S6": {"mass_g"},
    "S8_error_budget": {"bits"},
    "S8_sensor_and_amplifier": {"zero_mm"},
    "S13": {"u", "x_signal", "y_signal", "n"},
    "S13_field": set(),
    "S16_closed_loop": {"step_mm"},
    "S16_recovery": {"Kc", "Ti_s", "Td_s", "Ts_s", "sensor_deviation_mm", "prbs_order", "prbs_amplitude_mm"},
    "S16_root_locus": {"preliminary_zeros", "preliminary_poles", "measured_real", "measured_imaginary", "third_gains"},
    "S17_arithmetic": {"Ts_s"},
    "S17_recovery": {"x_signal", "y_signal", "deviation_mm"},
    # Covered by the tests of lqrd and kalmd.
    "S20_models": {"Q", "R", "noise_mm2"},
    # They act through the fitted plant, which a stand-in replaces here.
    "S16_times_in_minutes": {"third_gains", "pair_real", "pair_imaginary", "third", "held_back"},
}  # fmt: skip


def changed(name, value):
    """Another valid value of an input."""
    if re.search("_(bits|order)$|^bits$", name) and np.ndim(value) == 0:
        return value + 1
    if name == "identified_denominator":
        return value * np.array([1.0, -1.0, 1.0])
    if name.endswith("_poles") or name.endswith("_zeros") or name == "angle_deg":
        return value * 0.998
    if re.search("_(second|first)_order$", name):
        return value * np.r_[1.05, np.ones(len(value) - 1)]
    return (
        int(value + 1)
        if isinstance(value, int) and value > 2 and name in ("cycles", "averages")
        else value * 1.07
    )


CASES = [
    (part, name)
    for part in VARIED
    for name, value in read_part(part).inputs.items()
    if not isinstance(value, str)
]


@cache
def unchanged(part):
    return VARIED[part](read_part(part).inputs)


@pytest.mark.parametrize(("part", "name"), CASES)
def test_numbers_follow_one_input(part, name, stand_ins):
    given = {"map": None, **read_part(part).inputs}
    given[name] = changed(name, given[name])
    before, exact = unchanged(part), VARIED[part](given)
    found = numbers_of(part, given)
    for number, value in exact.items():
        value, close = value if isinstance(value, tuple) else (value, 1e-8)
        assert np.ravel(found[number]) == pytest.approx(np.ravel(value), rel=close, abs=1e-9), number
    moved = any(
        not np.array_equal(before[key], exact[key]) for key in exact if not isinstance(exact[key], tuple)
    )
    moved |= any(
        not np.allclose(before[key][0], exact[key][0], rtol=1e-6)
        for key in exact
        if isinstance(exact[key], tuple)
    )
    assert moved == (name not in WITHOUT_EFFECT.get(part, ()))


DRAWN = [("S4_levitation", one) for one in ("near_mm", "far_mm", "printed_depth_mm")]
DRAWN += [("S16_root_locus", one) for one in sorted(WITHOUT_EFFECT["S16_root_locus"] - {"third_gains"})]


@pytest.mark.parametrize(("part", "name"), DRAWN)
def test_figures_follow_what_is_drawn(part, name, stand_ins):
    given = dict(read_part(part).inputs)
    once = points_of(part, given)
    given[name] = changed(name, given[name])
    assert points_of(part, given) != once


def points_of(part, inputs):
    return [
        (one.x.tobytes(), one.y.tobytes())
        for curves in function_of(part)(inputs).curves
        for one in curves.series
    ]


def numbers_of(part, inputs):
    found = function_of(part)(inputs)
    numbers = found.numbers if isinstance(found, Answers) else found
    return {key: value.value if isinstance(value, Ours) else value for key, value in numbers.items()}


@pytest.fixture
def stand_ins(monkeypatch):
    """Stand-ins for solved units, whose results depend on all arguments in a known way."""

    def told(solved, amperes, z):
        return amperes[0] + 3 * amperes[1] + 1e6 * z

    def gradient(points, amperes):
        value = told(None, amperes, points[0][1])
        return np.array([[[0.0, 0.0], [value, -value]]])

    def points(solved, amperes, z, *window):
        stable = [True, False, True] if told(None, amperes, z) > told(None, amperes, -0.078) else [True]
        return [SimpleNamespace(stable=one) for one in stable]

    fake = SimpleNamespace(
        report=CODE, gradient=gradient, field=lambda at, amperes: np.zeros((len(at), 2)), coil_names=()
    )
    monkeypatch.setattr(planar_unit, "unit", lambda walls=True: fake)
    monkeypatch.setattr(planar_unit, "reached_from_the_middle", told)
    monkeypatch.setattr(planar_unit, "_flux_density_along_x", lambda *_: (None,))
    monkeypatch.setattr(planar_unit, "planar", SimpleNamespace(stationary_points=points))
    monkeypatch.setattr(planar_unit, "fold_depth", lambda of, i, a, b: told(of, i, -a) + 7 * told(of, i, -b))
    saturated = lambda ratio, nominal: SimpleNamespace(currents=(ratio, nominal), report=CODE)  # noqa: E731
    monkeypatch.setattr(planar_unit, "saturating", saturated)
    one = single_electromagnet
    monkeypatch.setattr(one, "solved", lambda *_: SimpleNamespace(report=CODE))
    monkeypatch.setattr(
        one, "axis_curves", lambda name, d: (1 + d if name == one.SIMPLIFIED else 1 + 0 * d, d)
    )
    monkeypatch.setattr(one, "levitation_depth", lambda name: 0.04 if name == one.EXACT else 0.05)
    monkeypatch.setattr(statics, "lift_current", lambda z, h, scale=1.0: 1 + z / 100 + h / 1000)
    share = lambda field, z, h, current: 0.3 + z / 100 + h / 1000 + current / 10  # noqa: E731
    monkeypatch.setattr(statics, "lift_share", share)
    for name in ("unit_rays", "shipped_unit", "about_the_joints"):
        monkeypatch.setattr(statics, name, dict)
    monkeypatch.setattr(statics, "linear_unit", lambda name: None)
    law = lambda unit, zs: SimpleNamespace(shares=2 * zs, relative_slope=5.0)  # noqa: E731
    monkeypatch.setattr(statics, "lift_law", law)
    moved = np.arange(1.0, 7.0) - 3.28
    monkeypatch.setattr(
        statics, "sensitivity_at_origin", lambda: SimpleNamespace(at_held_height=np.array([moved, -moved]))
    )
    for name in ("_ALL_GAINS", "_DRAWN_GAINS"):
        monkeypatch.setattr(vertical, name, np.geomspace(0.01, 1.0, 3))
    exact = vertical.rms_at_rest

    def at_rest(plant, under, deviation):
        """For the regulator seven times the deviation plus the divisor of its feedback; else exact."""
        told = isinstance(under, control.Regulator) and under.estimate == "predicted"
        return 7 * deviation + under.divisor if told else exact(plant, under, deviation)

    monkeypatch.setattr(vertical, "rms_at_rest", at_rest)
    monkeypatch.setattr(vertical, "_fitted_plant", lambda inputs: np.array([1600.0, 150.0, 2.0]))

"""S7, S8: sensor frames; the measuring and driving chain."""

from typing import Any

import numpy as np

from fieldmap import instruments
from fieldmap.instruments import Amplifier, Converter, Micrometer
from fieldmap.thesis.computation import Ours


def sensor_frames(inputs: dict[str, Any]) -> dict[str, Any]:
    """(3-2), (3-3), (7-1)."""
    offset = 1e-3 * (inputs["half_range_mm"] + inputs["centre_offset_mm"])
    frame = instruments.SensorFrame(np.radians(inputs["angle_deg"]), offset)
    local = (1e-3 * inputs[f"local_{axis}_deviation_mm"] for axis in "xy")
    return {
        "rotation": frame.matrix[:2, :2],
        "translation": np.sqrt(2.0) * 1e3 * frame.matrix[:2, 3],
        "global_deviation": 1e3 * np.array(frame.global_deviation(*local)),
    }


def _sensor(inputs: dict[str, Any], **more: Any) -> Micrometer:
    zero, scale, step = (1e-3 * inputs[name] for name in ("zero_mm", "scale_mm_per_V", "voltage_step_mV"))
    return Micrometer(zero, scale, step, **more)


def _card(inputs: dict[str, Any], gain_error: float) -> Converter:
    names = ("offset_error", "gain_drift", "offset_drift", "reference_drift", "nonlinearity")
    errors = {name: inputs[name] for name in names}
    noise = 1e-6 * inputs["random_noise_uV"]
    return Converter(inputs["range_V"], int(inputs["bits"]), noise, gain_error, **errors)


def converter(inputs: dict[str, Any]) -> dict[str, Any]:
    """Appendix B."""
    inside, outside = inputs["internal_change_K"], inputs["external_change_K"]
    drifts = inputs["gain_drift"] * inside + inputs["reference_drift"] * outside
    residual, ends = inputs["printed_gain_error"] - drifts, [0.0, inputs["range_V"]]
    card, changes = _card(inputs, residual), {"internal_change": inside, "external_change": outside}
    accuracy = instruments.absolute_accuracy(card, ends, **changes)
    zero, full = (Ours(1e6 * value, accuracy.assumptions) for value in accuracy.total)
    return {
        "resolution": 1e3 * card.resolution,
        "gain_error": residual,
        "net_gain_error": accuracy.net_gain_error,
        "net_offset_error": accuracy.net_offset_error,
        "noise_uncertainty": 1e6 * accuracy.noise_uncertainty,
        "accuracy_at_zero": zero,
        "accuracy_at_full_scale": full,
    }


def readings(inputs: dict[str, Any]) -> dict[str, Any]:
    """Appendix C, Table C-1."""
    sensor = _sensor(inputs)
    card = _card(inputs, inputs["gain_error"])
    arguments = (1e-3 * inputs["nominal_mm"], 1e-3 * inputs["accuracy_mm"], sensor, card)
    step = inputs["converter_step_V"]
    budget, nearest = (
        instruments.error_budget(*arguments, converter_step=step, rounding=way) for way in ("up", "nearest")
    )
    return {
        "actual": 1e3 * budget.actual,
        "shown": 1e3 * budget.shown,
        "voltage": budget.voltages,
        "bits_needed": budget.codes,
        "effective_bits": budget.steps,
        "nearest_bits": nearest.steps,
        "input_voltage": budget.inputs,
        "accuracy": budget.accuracies,
        "measured_voltage": budget.measured_voltages,
        "measurement": 1e3 * budget.measured,
        "error": 1e3 * budget.errors,
    }


def sensor_and_amplifier(inputs: dict[str, Any]) -> dict[str, Any]:
    """Tables 3-2, 3-7, 3-9, 3-10."""
    sensor = _sensor(inputs, scan_rate=inputs["scan_rate_Hz"])
    amplifier = Amplifier(inputs["gain_A_per_V"])
    scan_time = round(1e3 * sensor.measuring_time, 3)
    return {
        "resolution": 1e3 * sensor.resolution,
        "scan_time": 1e3 * sensor.measuring_time,
        "cycle_time": inputs["cycles"] * scan_time,
        "averaging_time": 1e-3 * inputs["averages"] * scan_time,
        "largest_current": amplifier.largest_current,
        "current_at_input": inputs["gain_A_per_V"] * inputs["input_V"],
        "gain": float(inputs["multimeter_A"].mean() / inputs["input_V"]),
        "deviation_range": [inputs["current_deviation_A"].min(), inputs["current_deviation_A"].max()],
        "held_deviation": _held(inputs, sensor, amplifier),
    }


def _held(inputs: dict[str, Any], sensor: Micrometer, amplifier: Amplifier) -> float:
    """Standard deviation, um, of measured positions at rest, averaged over positions within one converter step."""
    card = Converter(inputs["range_V"], int(inputs["bits"]), random_noise=1e-6 * inputs["converter_noise_uV"])
    rig = instruments.Rig(Micrometer(sensor.zero, sensor.scale), card, card, amplifier)
    places = np.linspace(0.0, card.resolution * sensor.scale, 50, endpoint=False)[:, None] - 0.01
    true = np.broadcast_to(sensor.zero + places, (50, 2000))
    seen = instruments.measured_positions(rig, true, np.random.default_rng(7))
    return 1e6 * float(np.sqrt(np.mean(seen.std(axis=1) ** 2)))

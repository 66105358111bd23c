"""S17: arithmetic of the horizontal axes."""

from typing import Any

import numpy as np

from fieldmap.control import steady_gain
from fieldmap.thesis.registry import Ours

_MODELS = (
    "positions at rest by the printed models: signal of 1 mm times the gain at q = 1",
    "gains at rest of (6-6), (6-7) are 43.8 and 6.9 mm: small differences of rounded coefficients, so rounding decides",
)


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
        "x_position": Ours(positions["x"], _MODELS),
        "y_position": Ours(positions["y"], _MODELS),
    }


def signal_of(polynomial: Any, position: float) -> float:
    """The smallest positive signal at which the fitted polynomial reaches a position."""
    roots = np.roots(np.append(polynomial[:-1], polynomial[-1] - position))
    return float(min(root.real for root in roots if abs(root.imag) < 1e-12 and root.real > 0))


def _gain(model: Any, Ts: float) -> float:
    return steady_gain((model[:1], model[1:]), Ts)

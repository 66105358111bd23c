"""S7, S8: sensor frames; the measuring and driving chain."""

from typing import Any

import numpy as np

from fieldmap.instruments import SensorFrame


def sensor_frames(inputs: dict[str, Any]) -> dict[str, Any]:
    """(3-2), (3-3), (7-1)."""
    frame = SensorFrame(
        np.radians(inputs["angle_deg"]), 1e-3 * (inputs["half_range_mm"] + inputs["centre_offset_mm"])
    )
    deviations = frame.global_deviation(
        1e-3 * inputs["local_x_deviation_mm"], 1e-3 * inputs["local_y_deviation_mm"]
    )
    return {
        "rotation": frame.matrix[:2, :2],
        "translation": np.sqrt(2.0) * 1e3 * frame.matrix[:2, 3],
        "global_deviation": 1e3 * np.array(deviations),
    }

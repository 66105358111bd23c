"""Instruments between a machine and its controller: sensors, converters, amplifiers, noise, estimators of a pose.

Each instrument is a frozen set of data-sheet numbers, which the user gives. Functions compute its accuracy, or
simulate it, with noise from a seeded `numpy.random.Generator`. Depends on: errors, arguments, core, lookup.
"""

from fieldmap.instruments.calibration_curve import CalibrationCurve, calibrate
from fieldmap.instruments.converter import Accuracy, Amplifier, Converter, absolute_accuracy
from fieldmap.instruments.field_element import FieldElement, measured_readings
from fieldmap.instruments.pose_estimation import (
    Observability,
    PoseEstimate,
    PoseFilter,
    TrackedPose,
    estimate_pose,
    observability,
)
from fieldmap.instruments.rig import (
    ErrorBudget,
    Rig,
    RigNoise,
    draw_noise,
    driven_currents,
    error_budget,
    loop_instruments,
    measured_positions,
)
from fieldmap.instruments.sensors import Micrometer, SensorFrame, watch

__all__ = [
    "Accuracy",
    "Amplifier",
    "CalibrationCurve",
    "Converter",
    "ErrorBudget",
    "FieldElement",
    "Micrometer",
    "Observability",
    "PoseEstimate",
    "PoseFilter",
    "Rig",
    "RigNoise",
    "SensorFrame",
    "TrackedPose",
    "absolute_accuracy",
    "calibrate",
    "draw_noise",
    "driven_currents",
    "error_budget",
    "estimate_pose",
    "loop_instruments",
    "measured_positions",
    "measured_readings",
    "observability",
    "watch",
]

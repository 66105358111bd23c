"""What stands between a machine and its controller: sensor frames, micrometers, converters, amplifiers, noise.

Each instrument is a frozen set of data-sheet numbers; functions turn it into a calculator (what accuracy to expect)
or a block of a simulation (what the controller sees), with noise from a seeded `numpy.random.Generator`.
Depends on: errors, arguments, kernels, control. Knows no particular card or rig: their numbers are the user's.
"""

from fieldmap.instruments.amplifier import Amplifier
from fieldmap.instruments.converter import Accuracy, Converter, absolute_accuracy
from fieldmap.instruments.error_budget import ErrorBudget, error_budget
from fieldmap.instruments.frames import SensorFrame
from fieldmap.instruments.micrometer import Micrometer, watch
from fieldmap.instruments.rig import (
    Rig,
    RigNoise,
    draw_noise,
    driven_currents,
    loop_instruments,
    measured_positions,
)

__all__ = [
    "Accuracy",
    "Amplifier",
    "Converter",
    "ErrorBudget",
    "Micrometer",
    "Rig",
    "RigNoise",
    "SensorFrame",
    "absolute_accuracy",
    "draw_noise",
    "driven_currents",
    "error_budget",
    "loop_instruments",
    "measured_positions",
    "watch",
]

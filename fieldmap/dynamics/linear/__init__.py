"""A machine, linear about a rest: its model, its modes, its loop under a sampled controller."""

from fieldmap.dynamics.linear.loop import (
    ClosedLoop,
    Margins,
    SampledMachine,
    close_loop,
    margins,
    sampled_machine,
    sensor_answer,
)
from fieldmap.dynamics.linear.machine import LinearMachine, linearise, moved_state
from fieldmap.dynamics.linear.modes import Coupling, Mode, Reach, coupling, modes, reach

__all__ = [
    "ClosedLoop",
    "Coupling",
    "LinearMachine",
    "Margins",
    "Mode",
    "Reach",
    "SampledMachine",
    "close_loop",
    "coupling",
    "linearise",
    "margins",
    "modes",
    "moved_state",
    "reach",
    "sampled_machine",
    "sensor_answer",
]

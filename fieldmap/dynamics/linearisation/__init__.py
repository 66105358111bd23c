"""A machine, linear about an operating point: its model, its modes, its loop under a sampled controller."""

from fieldmap.dynamics.linearisation.loop import (
    ClosedLoop,
    Margins,
    SampledMachine,
    close_loop,
    margins,
    sampled_machine,
    sensor_answer,
)
from fieldmap.dynamics.linearisation.machine import (
    ABOUT_Z,
    MOTION,
    VELOCITIES,
    LinearMachine,
    linearise,
    moved_state,
)
from fieldmap.dynamics.linearisation.modes import (
    Controllability,
    Coupling,
    Mode,
    controllability,
    coupling,
    modes,
)

__all__ = [
    "ABOUT_Z",
    "MOTION",
    "VELOCITIES",
    "ClosedLoop",
    "Controllability",
    "Coupling",
    "LinearMachine",
    "Margins",
    "Mode",
    "SampledMachine",
    "close_loop",
    "controllability",
    "coupling",
    "linearise",
    "margins",
    "modes",
    "moved_state",
    "sampled_machine",
    "sensor_answer",
]

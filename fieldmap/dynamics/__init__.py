"""Motion of a levitated magnet on a map: rigid body, coils, instruments and controllers in one compiled loop.

Depends on: errors, arguments, kernels, device, store, lookup, levitation, control, instruments.
"""

from fieldmap.dynamics.blocks import (
    AxisReading,
    ControllerBlock,
    constant_block,
    pid_block,
    regulator_block,
    stacked,
    state_block,
)
from fieldmap.dynamics.closed_loop import (
    Division,
    Machine,
    Mixing,
    Schedule,
    simulate_closed_loop,
    simulate_many,
)
from fieldmap.dynamics.drives import CoilDrive, drive_of_device
from fieldmap.dynamics.iron import FieldOfCurrents, linearised, superposed, tabled
from fieldmap.dynamics.least_power import least_power_mixing, lift_shares
from fieldmap.dynamics.linear import (
    LinearMachine,
    close_loop,
    coupling,
    linearise,
    margins,
    modes,
    reach,
    sampled_machine,
)
from fieldmap.dynamics.motion import (
    FixedCurrentsRun,
    angular_momentum,
    energy,
    move,
    move_adaptively,
    state_of,
)
from fieldmap.dynamics.outcome import Event, LoopRun
from fieldmap.dynamics.rigid_body import RigidBody, body_of_payload
from fieldmap.dynamics.scenario import (
    ScenarioRun,
    linear_points,
    prepare,
    read_scenario,
    run_metrics,
    simulate,
)
from fieldmap.dynamics.sensors import Sensors
from fieldmap.dynamics.surroundings import Drag, Plate, Walls
from fieldmap.dynamics.trim import Trim, trim

__all__ = [
    "AxisReading",
    "CoilDrive",
    "ControllerBlock",
    "Division",
    "Drag",
    "Event",
    "FieldOfCurrents",
    "FixedCurrentsRun",
    "LinearMachine",
    "LoopRun",
    "Machine",
    "Mixing",
    "Plate",
    "RigidBody",
    "ScenarioRun",
    "Schedule",
    "Sensors",
    "Trim",
    "Walls",
    "angular_momentum",
    "body_of_payload",
    "close_loop",
    "constant_block",
    "coupling",
    "drive_of_device",
    "energy",
    "least_power_mixing",
    "lift_shares",
    "linear_points",
    "linearise",
    "linearised",
    "margins",
    "modes",
    "move",
    "move_adaptively",
    "pid_block",
    "prepare",
    "reach",
    "read_scenario",
    "regulator_block",
    "run_metrics",
    "sampled_machine",
    "simulate",
    "simulate_closed_loop",
    "simulate_many",
    "stacked",
    "state_block",
    "state_of",
    "superposed",
    "tabled",
    "trim",
]

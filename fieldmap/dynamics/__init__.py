"""Motion of a levitated magnet on a map: rigid body, coils, instruments and controllers in one compiled loop.

Depends on: errors, arguments, kernels, device, store, lookup, levitation, control, instruments.
"""

from fieldmap.extras import needs

# As in fieldmap.levitation: this check serves all modules of the package.
with needs("levitation", "fieldmap.dynamics"):
    import scipy

    del scipy

from fieldmap.control import (
    AxisReading,
    Controller,
    ControllerBlock,
    LoopRun,
    constant_block,
    pid_block,
    regulator_block,
    stacked,
    state_block,
)
from fieldmap.device.drives import Bridge, CurrentController, Heating
from fieldmap.dynamics.allocation import (
    ControlAllocation,
    MatrixAllocation,
    ParametrisedAllocation,
    least_power_allocation,
    lift_and_directions,
)
from fieldmap.dynamics.closed_loop import RunningMachine, Schedule, simulate_closed_loop, simulate_many
from fieldmap.dynamics.field_of_currents import (
    FieldOfCurrents,
    linearised,
    modelled,
    sampled_field,
    superposed,
    tabled,
)
from fieldmap.dynamics.field_sensing import FieldSensors
from fieldmap.dynamics.linear_loop import close_loop, margins, sampled_machine
from fieldmap.dynamics.linearisation import LinearMachine, controllability, coupling, linearise, modes
from fieldmap.dynamics.loop_run import Event, LevitationRun
from fieldmap.dynamics.machine import CoilDrive, Machine, Sensors, drive_of_device
from fieldmap.dynamics.motion import (
    FixedCurrentsRun,
    angular_momentum,
    energy,
    move,
    move_adaptively,
    state_of,
)
from fieldmap.dynamics.operating_point import OperatingPoint, find_operating_point
from fieldmap.dynamics.rigid_body import Drag, Plate, RigidBody, Walls, body_of_payload
from fieldmap.dynamics.scenario import (
    ScenarioRun,
    linear_points,
    open_machine,
    prepare,
    read_scenario,
    run_metrics,
    simulate,
    tune_axes,
)
from fieldmap.dynamics.several_bodies import SeveralBodies, SeveralBodiesRun
from fieldmap.dynamics.weight_balance import WeightBalance
from fieldmap.levitation.lift import lift_shares

__all__ = [
    "AxisReading",
    "Bridge",
    "CoilDrive",
    "ControlAllocation",
    "Controller",
    "ControllerBlock",
    "CurrentController",
    "Drag",
    "Event",
    "FieldOfCurrents",
    "FieldSensors",
    "FixedCurrentsRun",
    "Heating",
    "LevitationRun",
    "LinearMachine",
    "LoopRun",
    "Machine",
    "MatrixAllocation",
    "OperatingPoint",
    "ParametrisedAllocation",
    "Plate",
    "RigidBody",
    "RunningMachine",
    "ScenarioRun",
    "Schedule",
    "Sensors",
    "SeveralBodies",
    "SeveralBodiesRun",
    "Walls",
    "WeightBalance",
    "angular_momentum",
    "body_of_payload",
    "close_loop",
    "constant_block",
    "controllability",
    "coupling",
    "drive_of_device",
    "energy",
    "find_operating_point",
    "least_power_allocation",
    "lift_and_directions",
    "lift_shares",
    "linear_points",
    "linearise",
    "linearised",
    "margins",
    "modelled",
    "modes",
    "move",
    "move_adaptively",
    "open_machine",
    "pid_block",
    "prepare",
    "read_scenario",
    "regulator_block",
    "run_metrics",
    "sampled_field",
    "sampled_machine",
    "simulate",
    "simulate_closed_loop",
    "simulate_many",
    "stacked",
    "state_block",
    "state_of",
    "superposed",
    "tabled",
    "tune_axes",
]

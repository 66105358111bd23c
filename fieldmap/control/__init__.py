"""Controllers that run sample by sample, and the transfer functions and matrices of their design.

Depends on: errors, arguments, core, device (payload, current division), levitation (forces of a map), scipy; numba for
functions that it compiled. Models are plain arrays, which scipy.signal and python-control accept.
"""

from typing import TYPE_CHECKING, Any

from fieldmap.extras import needs

# All modules need scipy. If it is missing, the error is raised here.
with needs("levitation", "fieldmap.control"):
    import scipy

    del scipy

from fieldmap.control.blocks import (
    AxisReading,
    Controller,
    ControllerBlock,
    constant_block,
    stacked,
    state_block,
)
from fieldmap.control.function_controller import ControlFunction, FunctionController
from fieldmap.control.linear_models import (
    StateSpace,
    TransferFunction,
    closed_loop,
    continuous,
    controller_form,
    from_roots,
    inverse_zero_order_hold,
    sampled,
    steady_gain,
    to_transfer_function,
    transfer_function,
    with_output_integral,
    zero_order_hold,
)
from fieldmap.control.loop import LinearLoopRun, LoopRun, compensated_reference, simulate_loop
from fieldmap.control.margins import Margins
from fieldmap.control.pid import PID, RunningPID, pid_block, pid_transfer_function, run_pid
from fieldmap.control.plants import (
    LumpedMagnet,
    MapPlant,
    levitated_plant,
    lumped_magnet_from_lift_currents,
    plant_from_map,
)
from fieldmap.control.regulator import (
    Estimator,
    Regulator,
    RunningRegulator,
    kalmd,
    lqrd,
    regulator_block,
    run_regulator,
)
from fieldmap.control.step_responses import StepMetrics, step_metrics
from fieldmap.control.tuning import TunedPID, tune_pid
from fieldmap.core.sampled_loop import LoopInstruments
from fieldmap.currents import DivisionSignals, divide_currents, division_slopes, undivide_currents

if TYPE_CHECKING:
    from fieldmap.control.jitted_function import C_SIGNATURE as C_SIGNATURE

__all__ = [
    "C_SIGNATURE",
    "PID",
    "AxisReading",
    "ControlFunction",
    "Controller",
    "ControllerBlock",
    "DivisionSignals",
    "Estimator",
    "FunctionController",
    "LinearLoopRun",
    "LoopInstruments",
    "LoopRun",
    "LumpedMagnet",
    "MapPlant",
    "Margins",
    "Regulator",
    "RunningPID",
    "RunningRegulator",
    "StateSpace",
    "StepMetrics",
    "TransferFunction",
    "TunedPID",
    "closed_loop",
    "compensated_reference",
    "constant_block",
    "continuous",
    "controller_form",
    "divide_currents",
    "division_slopes",
    "from_roots",
    "inverse_zero_order_hold",
    "kalmd",
    "levitated_plant",
    "lqrd",
    "lumped_magnet_from_lift_currents",
    "pid_block",
    "pid_transfer_function",
    "plant_from_map",
    "regulator_block",
    "run_pid",
    "run_regulator",
    "sampled",
    "simulate_loop",
    "stacked",
    "state_block",
    "steady_gain",
    "step_metrics",
    "to_transfer_function",
    "transfer_function",
    "tune_pid",
    "undivide_currents",
    "with_output_integral",
    "zero_order_hold",
]


def __getattr__(name: str) -> Any:
    # Imported on use, since no other name here needs numba.
    if name == "C_SIGNATURE":
        from fieldmap.control.jitted_function import C_SIGNATURE

        return C_SIGNATURE
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

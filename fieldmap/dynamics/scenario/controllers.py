"""Controllers of a scenario as blocks."""

import numpy as np

from fieldmap.control import PID, Regulator, kalmd, lqrd, with_output_integral
from fieldmap.dynamics.blocks import (
    AxisReading,
    ControllerBlock,
    constant_block,
    pid_block,
    regulator_block,
)
from fieldmap.dynamics.scenario.controller_keys import ConstantKeys, PidKeys, RegulatorKeys
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.dynamics.trim import Trim

MILLI = 1e-3


def block_of(scenario: Scenario, axis: str, rest: Trim) -> ControllerBlock:
    """The controller of z (lift), x or y, at rest where the machine is."""
    contents = scenario.contents
    keys = getattr(contents.control, axis)
    zero, period = contents.sensors.zero_depth_mm, MILLI * contents.control.period_ms
    reading = AxisReading("z", -1e3, -zero) if axis == "z" else AxisReading(axis, 1e3)
    output = float(rest.outputs["zxy".index(axis)])
    if isinstance(keys, ConstantKeys):
        return constant_block(output if keys.output is None else keys.output)
    lower = -np.inf if keys.lower is None else keys.lower
    upper = np.inf if keys.upper is None else keys.upper
    at = np.concatenate([rest.sensed, rest.sensed, [1.0]])
    if isinstance(keys, PidKeys):
        pid = PID(
            keys.Kc,
            np.inf if keys.Ti_s is None else keys.Ti_s,
            keys.Td_s,
            period,
            lower,
            upper,
            keys.integration,
            keys.anti_windup,
            derivative=keys.derivative,
            acts_on_minus_error=axis == "z",
        )
        return pid_block(pid, reading, output, at)
    return regulator_block(_regulator(keys, period, (lower, upper), output), reading)


def _regulator(keys: RegulatorKeys, period: float, limits: tuple[float, float], output: float) -> Regulator:
    A, B, C = np.array(keys.A), np.array(keys.B)[:, None], np.array(keys.C)[None]
    wide = with_output_integral(A, B, C)
    weights = np.array(keys.Q)
    k = lqrd(wide[0], wide[1], np.diag(weights) if weights.ndim == 1 else weights, [[keys.R]], period)
    estimator = kalmd(A, B, C, keys.process_noise, keys.measurement_noise, period)
    equilibrium = (output, 0.0) if keys.equilibrium is None else (keys.equilibrium[0], keys.equilibrium[1])
    return Regulator(
        k, estimator, period, equilibrium, keys.equilibrium_at, keys.estimate, keys.divisor, *limits
    )

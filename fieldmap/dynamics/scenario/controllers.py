"""Controllers of a scenario, one for each axis or one for all, and feed-forward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fieldmap.control import (
    PID,
    AxisReading,
    Controller,
    ControllerBlock,
    Regulator,
    constant_block,
    kalmd,
    lqrd,
    pid_block,
    regulator_block,
    with_output_integral,
)
from fieldmap.dynamics.allocation import ParametrisedAllocation
from fieldmap.dynamics.closed_loop import Schedule
from fieldmap.dynamics.coupled import (
    LqgWeights,
    ScheduledController,
    feedforward,
    force_controller,
    lqg_block,
    trajectory,
)
from fieldmap.dynamics.field_of_currents import FieldOfCurrents
from fieldmap.dynamics.linearisation import linearise
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.dynamics.scenario.controller_schema import (
    ConstantKeys,
    CoupledKeys,
    FeedforwardKeys,
    LinearisationKeys,
    OwnKeys,
    PidKeys,
    RegulatorKeys,
)
from fieldmap.dynamics.scenario.reading import Scenario
from fieldmap.dynamics.scenario.start import operating_points_at
from fieldmap.errors import Infeasible
from fieldmap.typing import Array

MILLI = 1e-3


def block_of(scenario: Scenario, axis: str, operating_point: OperatingPoint) -> ControllerBlock:
    """The controller of z (lift), x or y, in equilibrium at the operating point."""
    contents = scenario.contents
    keys = getattr(contents.control, axis)
    zero, period = scenario.zero_depth_mm, MILLI * contents.control.period_ms
    reading = AxisReading("z", -1e3, -zero) if axis == "z" else AxisReading(axis, 1e3)
    output = float(operating_point.outputs["zxy".index(axis)])
    if isinstance(keys, ConstantKeys):
        return constant_block(output if keys.output is None else keys.output)
    lower = -np.inf if keys.lower is None else keys.lower
    upper = np.inf if keys.upper is None else keys.upper
    at = np.concatenate([operating_point.sensed, operating_point.sensed, [1.0]])
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


def coupled_controller(scenario: Scenario, machine: Machine, operating_point: OperatingPoint) -> Controller:
    """The controller of [control.coupled], designed on the machine itself; in equilibrium where the run begins."""
    keys, control = scenario.contents.control.coupled, scenario.contents.control
    period, delay = MILLI * control.period_ms, MILLI * control.delay_ms
    assert keys is not None
    if isinstance(keys, OwnKeys):
        must, remedy = (
            "needs a controller that the caller gives",
            "give one: controller=, or --controller FILE.py:NAME",
        )
        raise scenario.error("control.coupled", must, "none", remedy)
    limits = _limits(keys, machine)
    _check_limits(scenario, operating_point, limits)
    if isinstance(keys, LinearisationKeys):
        weights = _weights(scenario, keys, tuple(MILLI * value for value in keys.allowed_mN))
        return force_controller(machine, operating_point, weights, period, *limits, delay, keys.rounds)
    weights = _weights(scenario, keys, tuple(keys.allowed_outputs))
    if keys.depths_mm is None:
        return lqg_block(linearise(machine, operating_point), weights, period, delay, limits)
    # Heights rise, so the deepest comes first.
    depths = np.linspace(keys.depths_mm[1], keys.depths_mm[0], keys.designs)
    points = operating_points_at(scenario, machine, operating_point, list(depths))
    blocks = [lqg_block(linearise(machine, there), weights, period, delay, limits) for there in points]
    heights = -MILLI * (scenario.zero_depth_mm + depths)
    begin = lqg_block(linearise(machine, operating_point), weights, period, delay, limits).memory
    first = replace(blocks[0], memory=begin)
    return ScheduledController((first, *blocks[1:]), float(heights[0]), float(heights[1] - heights[0]))


def _limits(keys: CoupledKeys | FeedforwardKeys, machine: Machine) -> tuple[Array, Array]:
    """Lowest and highest lift, V, x and y signals: as given, or what suits the allocation."""
    divided, amplifier = isinstance(machine.allocation, ParametrisedAllocation), machine.drive.amplifier
    lift, signal = (10.0, 0.4) if divided else (amplifier.largest_current / amplifier.gain, 1.0)
    # Beside what no current drives, the coils may have to take lift away.
    least = -lift if machine.magnetic.constant and not divided else 0.0
    lower = [least, -signal, -signal] if keys.lower is None else keys.lower
    upper = [lift, signal, signal] if keys.upper is None else keys.upper
    return np.array(lower), np.array(upper)


def _check_limits(scenario: Scenario, operating_point: OperatingPoint, limits: tuple[Array, Array]) -> None:
    """The limits must allow the outputs of the operating point. Raises Infeasible."""
    lower, upper = limits
    if not ((lower <= operating_point.outputs) & (operating_point.outputs <= upper)).all():
        lift, x, y = operating_point.outputs
        must = f"lift, x and y at the operating point must lie within the limits, {lower.tolist()} to {upper.tolist()}"
        received = f"{lift:.3g} V, {x:.3g}, {y:.3g}"
        remedy = "widen lower and upper, or begin elsewhere"
        raise Infeasible(scenario.error("control.coupled", must, received, remedy).problems[0])


def _weights(scenario: Scenario, keys: CoupledKeys, output: tuple[float, ...]) -> LqgWeights:
    def metres(values: list[float]) -> tuple[float, float, float]:
        x, y, depth = (MILLI * value for value in values)
        return x, y, depth

    return LqgWeights(
        place=metres(keys.allowed_mm),
        speed=metres(keys.allowed_mm_per_s),
        output=output,
        sensor=metres(_noise(scenario) if keys.noise_mm is None else keys.noise_mm),
        force=metres(keys.shaking_mN),
        drift=metres(keys.drift_mN),
    )


def _noise(scenario: Scenario) -> list[float]:
    """Of x, y and depth, mm: of crossed sensors both get the root mean square of the two; 1 um where there is none."""
    sensors = scenario.contents.sensors
    a, b, depth = sensors.deviation_mm
    if sensors.angle_deg:
        c, s = np.cos(np.deg2rad(sensors.angle_deg)), np.sin(np.deg2rad(sensors.angle_deg))
        a, b = float(np.hypot(c * a, s * b)), float(np.hypot(s * a, c * b))
    return [max(value, 1e-3) for value in (a, b, depth)]


def fed_forward(
    scenario: Scenario,
    machine: Machine,
    controller: Controller,
    operating_point: OperatingPoint,
    schedule: Schedule,
) -> Schedule:
    """The schedule with the outputs of [control.feedforward] added to those in open loop."""
    keys = scenario.contents.control.feedforward
    if keys is None:
        return schedule
    believed = replace(machine, magnetic=_scaled(machine.magnetic, 1.0 + keys.field_error))
    path = trajectory(
        believed,
        operating_point,
        schedule,
        *_limits(keys, machine),
        MILLI * keys.fastest_mm_per_s,
        keys.largest_m_per_s2,
    )
    added = feedforward(controller, schedule, path)
    given = schedule.feedforward
    return replace(schedule, feedforward=added if given is None else given + added)


def _scaled(field: FieldOfCurrents, factor: float) -> FieldOfCurrents:
    """The same field times a factor."""
    return replace(field, scale=field.scale * factor)

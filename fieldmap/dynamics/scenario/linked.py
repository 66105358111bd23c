"""Controllers of all axes and feed-forward, as a scenario asks for them."""

from dataclasses import replace

import numpy as np

from fieldmap.dynamics.blocks import Controller
from fieldmap.dynamics.closed_loop import Division, Machine, Schedule
from fieldmap.dynamics.iron import FieldOfCurrents
from fieldmap.dynamics.linear import linearise
from fieldmap.dynamics.linked import (
    GaussianWeights,
    ScheduledController,
    feedforward,
    force_controller,
    gaussian_block,
    trajectory,
)
from fieldmap.dynamics.scenario.controller_keys import FeedforwardKeys, GaussianKeys, LinearisationKeys
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.dynamics.scenario.rests import rests_at
from fieldmap.dynamics.trim import Trim
from fieldmap.errors import Infeasible
from fieldmap.typing import Array

MILLI = 1e-3


def linked_controller(scenario: Scenario, machine: Machine, rest: Trim) -> Controller:
    """The controller of [control.linked], designed on the machine itself; at rest where the run begins."""
    keys, control = scenario.contents.control.linked, scenario.contents.control
    period, delay = MILLI * control.period_ms, MILLI * control.delay_ms
    assert keys is not None
    limits = _limits(keys, machine)
    _check_rest(scenario, rest, limits)
    if isinstance(keys, LinearisationKeys):
        weights = _weights(scenario, keys, tuple(MILLI * value for value in keys.allowed_mN))
        return force_controller(machine, rest, weights, period, *limits, delay, keys.rounds)
    weights = _weights(scenario, keys, tuple(keys.allowed_outputs))
    if keys.depths_mm is None:
        return gaussian_block(linearise(machine, rest), weights, period, delay, limits)
    # Heights rise, so the deepest comes first.
    depths = np.linspace(keys.depths_mm[1], keys.depths_mm[0], keys.designs)
    rests = rests_at(scenario, machine, rest, list(depths))
    blocks = [gaussian_block(linearise(machine, there), weights, period, delay, limits) for there in rests]
    heights = -MILLI * (scenario.contents.sensors.zero_depth_mm + depths)
    begin = gaussian_block(linearise(machine, rest), weights, period, delay, limits).memory
    first = replace(blocks[0], memory=begin)
    return ScheduledController((first, *blocks[1:]), float(heights[0]), float(heights[1] - heights[0]))


def _limits(keys: GaussianKeys | FeedforwardKeys, machine: Machine) -> tuple[Array, Array]:
    """Lowest and highest lift, V, x and y signals: as given, or what suits the allocation."""
    divided, amplifier = isinstance(machine.allocation, Division), machine.drive.amplifier
    lift, signal = (10.0, 0.4) if divided else (amplifier.largest_current / amplifier.gain, 1.0)
    lower = [0.0, -signal, -signal] if keys.lower is None else keys.lower
    upper = [lift, signal, signal] if keys.upper is None else keys.upper
    return np.array(lower), np.array(upper)


def _check_rest(scenario: Scenario, rest: Trim, limits: tuple[Array, Array]) -> None:
    """A controller cannot hold what its limits do not let it say. Raises Infeasible."""
    lower, upper = limits
    if not ((lower <= rest.outputs) & (rest.outputs <= upper)).all():
        lift, x, y = rest.outputs
        must = f"lift, x and y at rest must lie within the limits, {lower.tolist()} to {upper.tolist()}"
        received = f"{lift:.3g} V, {x:.3g}, {y:.3g}"
        remedy = "widen lower and upper, or begin elsewhere"
        raise Infeasible(scenario.error("control.linked", must, received, remedy).problems[0])


def _weights(scenario: Scenario, keys: GaussianKeys, output: tuple[float, ...]) -> GaussianWeights:
    def metres(values: list[float]) -> tuple[float, float, float]:
        x, y, depth = (MILLI * value for value in values)
        return x, y, depth

    return GaussianWeights(
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
    scenario: Scenario, machine: Machine, controller: Controller, rest: Trim, schedule: Schedule
) -> Schedule:
    """The schedule with the outputs of [control.feedforward] added to those in open loop."""
    keys = scenario.contents.control.feedforward
    if keys is None:
        return schedule
    believed = replace(machine, magnetic=_scaled(machine.magnetic, 1.0 + keys.field_error))
    path = trajectory(
        believed,
        rest,
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
    kind, scale, *rest = field.numbers
    return replace(field, numbers=(kind, scale * factor, *rest))

"""Where a scenario begins: the magnet's place, the currents that carry it, the operating point at a depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.currents import IndependentCurrents, LiftAndDirections
from fieldmap.device import Device
from fieldmap.dynamics.allocation import (
    ControlAllocation,
    ParametrisedAllocation,
    least_power_allocation,
    lift_and_directions,
)
from fieldmap.dynamics.drives import drive_of_device
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint, find_operating_point
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.scenario.controller_schema import ConstantKeys, LinearisationKeys
from fieldmap.dynamics.scenario.reading import Scenario
from fieldmap.dynamics.scenario.schema import CircleKeys
from fieldmap.errors import FieldmapError, Infeasible, NotConverged
from fieldmap.levitation import force_per_ampere, lift_current, lift_shares
from fieldmap.lookup import FieldMap, division_domain, saturates, wrench_actuation
from fieldmap.typing import Array

MILLI = 1e-3

# Share of what amplifiers and supply give for long that a start chosen by the program takes; what is left is for
# control.
_EASY = 0.5
# Share of it within which currents for soft iron are looked for first: of several sets of them one is even.
_EASIER = 0.9
# Heights of the map at which that is tried.
_HEIGHTS = 21


def magnet_at(scenario: Scenario, opened: FieldMap, body: RigidBody) -> Array:
    """The magnet's centre (3,) of the upright body at the start, m."""
    contents = scenario.contents
    z = -MILLI * (scenario.zero_depth_mm + scenario.start_depth_mm) - _above(body)
    point = np.array([MILLI * (contents.start.x_mm or 0.0), MILLI * (contents.start.y_mm or 0.0), z])
    if not (opened.lower <= point).all() or not (point <= opened.upper).all():
        received = f"the magnet at {[round(1e3 * float(p), 3) for p in point]} mm"
        corners = " to ".join(
            str([round(1e3 * float(v), 3) for v in c]) for c in (opened.lower, opened.upper)
        )
        must = f"must be inside the map, {corners} mm"
        raise scenario.error("start", must, received, "begin elsewhere, or make a larger map")
    return point


def with_depth(scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody) -> Scenario:
    """The scenario with the depth of its start: the given one, or that of the middle of the map, or of the place next
    to it at which half of what amplifiers and supply give carries the body, with its moment along the field if it may
    turn; where there is none, of the place that takes the least, and the middle where nothing lifts."""
    if scenario.contents.start.depth_mm is not None:
        return scenario
    middle = 0.5 * float(opened.lower[2] + opened.upper[2])
    room = 0.05 * (opened.upper[2] - opened.lower[2])
    heights = np.linspace(opened.lower[2] + room, opened.upper[2] - room, _HEIGHTS)
    low, high = drive_of_device(device, scenario.contents.coils.lowest_voltage_V).steady
    chosen, least = _begun(scenario, middle, body), np.inf
    for height in sorted(heights, key=lambda z: abs(z - middle)):
        there = _begun(scenario, float(height), body)
        point = magnet_at(there, opened, body)
        try:
            currents, _ = starting_currents(there, device, opened, body, point)
        except Infeasible:
            continue
        moment = body.magnet.moments.sum(axis=0)
        along = bool(body.magnet.soft) or float(opened.field(point, currents) @ moment) > 0.0
        limit = np.where(currents > 0.0, high, -low)
        share = float(np.max(np.abs(currents) / np.maximum(limit, 1e-12)))
        if share < least and (along or body.upright):
            chosen, least = there, share
        if least <= _EASY:
            break
    return chosen


def _begun(scenario: Scenario, height: float, body: RigidBody) -> Scenario:
    """The scenario that begins with its magnet at a height, m."""
    contents = scenario.contents
    depth = -1e3 * (height + _above(body)) - scenario.zero_depth_mm
    start = contents.start.model_copy(update={"depth_mm": round(depth, 6)})
    return replace(scenario, contents=contents.model_copy(update={"start": start}))


def _above(body: RigidBody) -> float:
    """Height of the sensed point above the magnet's centre, m."""
    return float((body.seen_at - body.magnet_at)[2])


def starting_currents(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody, point: Array
) -> tuple[Array, ControlAllocation]:
    """Currents (n,) that about lift the magnet at a point (3,), m, for the search of the operating point to begin with,
    and the allocation. Raises ScenarioError, Infeasible."""
    signals = _lift_and_directions(scenario, opened)
    free = isinstance(opened.parametrisation, IndependentCurrents)
    if saturates(opened) and body.magnet.soft and free:
        currents = _for_soft_iron(scenario, device, opened, body, point)
    elif saturates(opened):
        currents = _equal(scenario, opened, body, point)
    elif signals is not None:
        currents = lift_current(opened, device.payload, point).currents / scenario.contents.field.scale
    elif body.magnet.soft:
        currents = _for_soft_iron(scenario, device, opened, body, point)
    else:
        currents = _least_power(scenario, opened, body, point)
    if signals is not None:
        return currents, signals
    if opened.fixed_sources:
        return currents, _beside_constant(scenario, device, opened, body, point, currents)
    largest = float(np.abs(currents).max())
    gain = 1.0 if device.driver is None else device.driver.gain
    force = _force_per_ampere(scenario, opened, body, point, currents)
    allocation = least_power_allocation(force, currents / largest, largest / gain)
    _check_idle(scenario, allocation.idle)
    return currents, allocation


def _lift_and_directions(scenario: Scenario, opened: FieldMap) -> ParametrisedAllocation | None:
    """The allocation to six coils in two rows, if it is asked for or the map was made for it. Raises ScenarioError."""
    control, coils, own = scenario.contents.control, len(opened.coil_names), opened.parametrisation
    made_for_it = isinstance(own, LiftAndDirections)
    if control.allocation == "least_power" or (control.allocation is None and not made_for_it):
        return None
    if coils != 6:
        must, remedy = "must be least_power: lift_and_directions is for six coils", "change or leave it out"
        raise scenario.error("control.allocation", must, f"a map of {coils} coils", remedy)
    if control.allocation_n is not None:
        return lift_and_directions(control.allocation_n)
    if not isinstance(own, LiftAndDirections):
        must, remedy = (
            "must be given for a map that was not made for lift_and_directions",
            "write allocation_n",
        )
        raise scenario.error("control.allocation_n", must, "none", remedy)
    return lift_and_directions(own.n)


def _beside_constant(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody, point: Array, currents: Array
) -> ControlAllocation:
    """The allocation where something that no current drives lifts, too: the currents that carry the body may be zero or
    take away, so that its scale is that of the currents which would carry the weight alone."""
    force = _force_per_ampere(scenario, opened, body, point, currents)
    shares = lift_shares(force)
    scale = scenario.contents.field.scale
    largest = body.mass * body.gravity / float(scale * force[2] @ shares)
    gain = 1.0 if device.driver is None else device.driver.gain
    allocation = least_power_allocation(force, shares, largest / gain)
    _check_idle(scenario, allocation.idle)
    return allocation


def _force_per_ampere(
    scenario: Scenario, opened: FieldMap, body: RigidBody, point: Array, currents: Array
) -> Array:
    """Force (3, n), N/A, of the map as it is; of soft iron about the currents as the scale of the field has it."""
    if not body.magnet.soft:
        return force_per_ampere(opened, body.magnet.moments.sum(axis=0), point, currents)
    scale = scenario.contents.field.scale
    return wrench_actuation(opened, point, body.magnet, scale * currents).matrix[:3]


def _for_soft_iron(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody, point: Array
) -> Array:
    """What carries a body of soft iron with least power, and pushes it nowhere else if the coils can do that; with room
    left of what the amplifiers give, if there is."""
    scale, weight = scenario.contents.field.scale, body.mass * body.gravity
    low, high = drive_of_device(device, scenario.contents.coils.lowest_voltage_V).steady
    within = _EASIER * scale * low, _EASIER * scale * high
    free = np.array([np.nan, np.nan, weight])
    told: FieldmapError | None = None
    for force, limits in ((np.nan_to_num(free), within), (np.nan_to_num(free), None), (free, None)):
        try:
            return opened.currents_for(point, force, body.magnet, limits) / scale
        except (Infeasible, NotConverged) as error:
            told = error
    assert told is not None
    problem = told.problems[0]
    start = scenario.error("start", problem.must_hold, problem.received, problem.remedy)
    raise Infeasible(start.problems[0])


def _least_power(scenario: Scenario, opened: FieldMap, body: RigidBody, point: Array) -> Array:
    """Of linear iron: what carries the weight."""
    moment, ones = body.magnet.moments.sum(axis=0), np.ones(len(opened.coil_names))
    force = scenario.contents.field.scale * force_per_ampere(opened, moment, point, ones)
    try:
        shares = lift_shares(force)
    except Infeasible as error:
        found = error.problems[0]
        raise Infeasible(
            scenario.error("start", found.must_hold, found.received, found.remedy).problems[0]
        ) from None
    carried = shares * body.mass * body.gravity
    if opened.fixed_sources:
        carried -= (
            shares * scenario.contents.field.scale * float(moment @ opened.constant_gradient(point)[:, 2])
        )
    return np.asarray(carried / (force[2] @ shares))


def _equal(scenario: Scenario, opened: FieldMap, body: RigidBody, point: Array) -> Array:
    """Of saturating iron: the same current in every coil."""
    coils, scale = len(opened.coil_names), scenario.contents.field.scale
    domain = division_domain(opened)
    levels = np.linspace(domain[0][0], domain[1][0], 9) if domain else np.linspace(0.3, 3.0, 10)
    reduced = opened.info.reduced_model
    if opened.fixed_sources and not domain and isinstance(opened.parametrisation, IndependentCurrents):
        # What no current drives may lift enough by itself, or too much.
        assert reduced is not None
        levels = np.linspace(float(reduced.lower.max()), float(reduced.upper.min()), 25)
    weight = body.mass * body.gravity
    if body.magnet.soft:
        pulls = [opened.wrench(point, body.magnet, np.full(coils, scale * i))[2] for i in levels]
        lift = np.array(pulls)
    else:
        moment = body.magnet.moment * scale
        lift = np.array([moment * opened.gradient(point, np.full(coils, i))[2, 2] for i in levels])
    if opened.fixed_sources and lift[0] > lift[-1]:
        levels, lift = levels[::-1], lift[::-1]
    if lift.max() < weight:
        share = f"{lift.max() / weight:.2g} of the weight at most"
        must = f"equal currents of {levels[0]:.3g} to {levels[-1]:.3g} A must carry the body at the start"
        where = scenario.error("field.scale", must, share, "raise the scale, or begin higher")
        raise Infeasible(where.problems[0])
    return np.full(coils, float(np.interp(weight, lift, levels)))


def _check_idle(scenario: Scenario, idle: tuple[str, ...]) -> None:
    """What a scenario asks of axes along which the coils do not push by themselves. Raises ScenarioError."""
    control, start = scenario.contents.control, scenario.contents.start
    for axis in idle:
        why = f"the coils do not push along {axis} by themselves at the start"
        keys = getattr(control, axis)
        if keys is not None and not isinstance(keys, ConstantKeys):
            must = 'must be of kind "constant"'
            raise scenario.error(f"control.{axis}", f"{must}: {why}", keys.kind, "change it, or add coils")
        if getattr(start, f"{axis}_mm") is not None:
            given = f"{getattr(start, f'{axis}_mm'):g} mm"
            remedy = "leave it out: the magnet floats where the field lets it"
            raise scenario.error(f"start.{axis}_mm", f"must be left out: {why}", given, remedy)
        for number, piece in enumerate(scenario.contents.reference):
            if getattr(piece, "axis", axis if isinstance(piece, CircleKeys) else None) == axis:
                key = f"reference.{number}"
                raise scenario.error(
                    key, "must be along an axis that is held", why, "leave it out, or add coils"
                )
        if isinstance(control.coupled, LinearisationKeys) or control.feedforward is not None:
            key = "control.coupled" if control.feedforward is None else "control.feedforward"
            raise scenario.error(
                key, "needs coils that push along x, y and z", why, "leave it out, or add coils"
            )


def operating_point_at(
    scenario: Scenario, machine: Machine, depth_mm: float, guess: ArrayLike
) -> OperatingPoint:
    """The operating point of a scenario's machine at a depth, with x and y or their signals as at its start.

    guess (3,): outputs near those. Raises NoEquilibrium, and Infeasible where it takes more than the amplifiers give.
    """
    contents = scenario.contents
    nan = np.nan
    place = [nan, nan, -MILLI * (scenario.zero_depth_mm + depth_mm)]
    outputs = [nan, nan, nan]
    for k, (given, keys) in enumerate(
        ((contents.start.x_mm, contents.control.x), (contents.start.y_mm, contents.control.y))
    ):
        if given is not None:
            place[k] = MILLI * given
        else:
            outputs[1 + k] = (
                keys.output if isinstance(keys, ConstantKeys) and keys.output is not None else 0.0
            )
    point = find_operating_point(machine, place, outputs, guess)
    low, high = machine.drive.steady
    beyond = np.maximum(point.currents - high, low - point.currents)
    worst = int(np.argmax(beyond))
    if beyond[worst] > 1e-9 * max(1.0, abs(point.currents[worst])):
        limit = (high if point.currents[worst] > 0 else low)[worst]
        must = f"the body must float within the limits of amplifiers and supply, {limit:.4g} A"
        received = f"{point.currents[worst]:.3g} A"
        remedy = (
            "begin higher or nearer to the axis, take a lighter payload, or state a field.scale; a start without "
            "depth_mm is at the height that takes least already"
        )
        raise Infeasible(scenario.error("start", must, received, remedy).problems[0])
    return point


def operating_points_at(
    scenario: Scenario, machine: Machine, operating_point: OperatingPoint, depths_mm: Sequence[float]
) -> list[OperatingPoint]:
    """As `operating_point_at` at each of these depths; operating_point: the one at the start.

    The search goes from the start outward, each time from the point nearest to the depth.
    """
    start = scenario.start_depth_mm
    known = {start: operating_point}
    for depth in sorted(depths_mm, key=lambda depth: abs(depth - start)):
        if depth not in known:
            nearest = min(known, key=lambda there: abs(there - depth))
            known[depth] = operating_point_at(scenario, machine, depth, known[nearest].outputs)
    return [known[depth] for depth in depths_mm]

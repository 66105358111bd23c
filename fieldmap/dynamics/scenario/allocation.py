"""How lift, x and y of a scenario become currents: by the division of six coils, or for any number by least power."""

import numpy as np

from fieldmap.device import Device
from fieldmap.dynamics.closed_loop import Division, Mixing
from fieldmap.dynamics.least_power import least_power_mixing, lift_shares
from fieldmap.dynamics.rigid_body import RigidBody
from fieldmap.dynamics.scenario.controller_keys import ConstantKeys, LinearisationKeys
from fieldmap.dynamics.scenario.reader import Scenario
from fieldmap.dynamics.scenario.schema import CircleKeys
from fieldmap.errors import Infeasible
from fieldmap.levitation import lift_current
from fieldmap.lookup import FieldMap, division_domain, saturates
from fieldmap.typing import Array

# Share of the currents at rest over which the force of saturating iron is differenced.
_STEP = 0.01


def starting_currents(
    scenario: Scenario, device: Device, opened: FieldMap, body: RigidBody, point: Array
) -> tuple[Array, Division | Mixing]:
    """Currents (n,) that about lift the magnet at a point (3,), m, for the search of the rest to begin with, and the
    allocation. Raises ScenarioError, Infeasible."""
    kind, coils = scenario.contents.control.allocation, len(opened.coil_names)
    if kind == "division" and coils != 6:
        must, remedy = "must be least_power: the division is for six coils", "change or leave it out"
        raise scenario.error("control.allocation", must, f"a map of {coils} coils", remedy)
    divided = kind == "division" or (kind is None and coils == 6)
    if saturates(opened):
        currents = _equal(scenario, opened, body, point)
    elif divided:
        currents = lift_current(opened, device.payload, point).currents / scenario.contents.field.scale
    else:
        currents = _least_power(scenario, opened, body, point)
    if divided:
        return currents, Division(scenario.contents.control.division_n)
    largest = float(np.abs(currents).max())
    gain = 1.0 if device.driver is None else device.driver.gain
    mixing = least_power_mixing(
        _force_per_ampere(opened, body, point, currents), currents / largest, largest / gain
    )
    _check_idle(scenario, mixing.idle)
    return currents, mixing


def _least_power(scenario: Scenario, opened: FieldMap, body: RigidBody, point: Array) -> Array:
    """Of linear iron: what carries the weight."""
    force = scenario.contents.field.scale * _force_per_ampere(
        opened, body, point, np.ones(len(opened.coil_names))
    )
    try:
        shares = lift_shares(force)
    except Infeasible as error:
        found = error.problems[0]
        raise Infeasible(
            scenario.error("start", found.must_hold, found.received, found.remedy).problems[0]
        ) from None
    return np.asarray(shares * body.mass * body.gravity / (force[2] @ shares))


def _equal(scenario: Scenario, opened: FieldMap, body: RigidBody, point: Array) -> Array:
    """Of saturating iron: the same current in every coil."""
    coils, scale = len(opened.coil_names), scenario.contents.field.scale
    domain = division_domain(opened)
    levels = np.linspace(domain[0][0], domain[1][0], 9) if domain else np.linspace(0.3, 3.0, 10)
    moment, weight = body.magnet.moment * scale, body.mass * body.gravity
    lift = np.array([moment * opened.gradient(point, np.full(coils, i))[2, 2] for i in levels])
    if lift.max() < weight:
        share = f"{lift.max() / weight:.2g} of the weight at most"
        must = f"equal currents of {levels[0]:.3g} to {levels[-1]:.3g} A must carry the body at the start"
        where = scenario.error("field.scale", must, share, "raise the scale, or begin higher")
        raise Infeasible(where.problems[0])
    return np.full(coils, float(np.interp(weight, lift, levels)))


def _force_per_ampere(opened: FieldMap, body: RigidBody, point: Array, currents: Array) -> Array:
    """(3, n) of the upright magnet as a point dipole about these currents, N/A: central differences."""
    moment = body.magnet.moments.sum(axis=0)
    steps = _STEP * np.abs(currents).max() * np.eye(len(currents))
    force = [
        (opened.gradient(point, currents + step) - opened.gradient(point, currents - step)).T @ moment
        for step in steps
    ]
    return np.column_stack(force) / (2.0 * steps[0, 0])


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
            remedy = "leave it out: the magnet rests where the field lets it"
            raise scenario.error(f"start.{axis}_mm", f"must be left out: {why}", given, remedy)
        for number, piece in enumerate(scenario.contents.reference):
            if getattr(piece, "axis", axis if isinstance(piece, CircleKeys) else None) == axis:
                key = f"reference.{number}"
                raise scenario.error(
                    key, "must be along an axis that is held", why, "leave it out, or add coils"
                )
        if isinstance(control.linked, LinearisationKeys) or control.feedforward is not None:
            key = "control.linked" if control.feedforward is None else "control.feedforward"
            raise scenario.error(
                key, "needs coils that push along x, y and z", why, "leave it out, or add coils"
            )

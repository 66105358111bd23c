"""Feed-forward along a trajectory by the inverse map: docs/theory/dynamics.md (38), (45), (46)."""

from dataclasses import dataclass

import numpy as np

from fieldmap.control.blocks import Controller
from fieldmap.core.controller import CoreController
from fieldmap.core.machine import VELOCITY, InverseMap, inverse_along
from fieldmap.dynamics.closed_loop import Schedule
from fieldmap.dynamics.coupled.feedback_linearisation import ForceController
from fieldmap.dynamics.field_of_currents import EXACT
from fieldmap.dynamics.machine import Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.errors import Infeasible, InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array

_ROUNDS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Record):
    """What a reference asks of the body, one row per control period: forces (p, 3), N, of the magnet; outputs (p, 3) of
    the allocation that make them; left (p,): force that the outputs' limits do not give, N."""

    forces: Array
    outputs: Array
    left: Array


def trajectory(
    machine: Machine,
    operating_point: OperatingPoint,
    schedule: Schedule,
    lower: Array,
    upper: Array,
    fastest: float = 0.05,
    largest: float = 3.0,
) -> Trajectory:
    """Forces and outputs along the references of a schedule: mass times acceleration, drag and eddy currents at the
    reference's velocity, and the weight, by the inverse map at the reference's place.

    Each row is what the middle of the time asks for in which the sample's outputs act. lower, upper (3,): limits of the
    outputs. fastest: m/s, above which a change of the reference is a step, whose motion is not fed forward; largest:
    acceleration, m/s^2, that is fed forward. The body keeps the turn of the operating point. Raises Infeasible where
    the path leaves the map, InputError for a machine whose allocation does not take three outputs.
    """
    period = schedule.period
    time = period * np.arange(len(schedule.references))
    middle = time + schedule.delay + 0.5 * period
    path = np.column_stack([np.interp(middle, time, column) for column in schedule.references.T])
    velocity, acceleration = _motion(path, period, fastest, largest)
    arm = operating_point.sensed - operating_point.state[:3]
    body = machine.body
    core = machine.core(1.0)
    forces = body.mass * acceleration
    forces[:, 2] += body.mass * body.gravity
    state = operating_point.state.copy()
    for row in np.flatnonzero(np.abs(velocity).max(axis=1)):
        state[:3], state[VELOCITY : VELOCITY + 3] = path[row] - arm, velocity[row]
        forces[row] -= core.losses(state)[0]
    outputs, left = outputs_for(machine, operating_point, path - arm, forces, lower, upper)
    return Trajectory(forces, outputs, left)


def outputs_for(
    machine: Machine,
    operating_point: OperatingPoint,
    positions: Array,
    forces: Array,
    lower: Array,
    upper: Array,
) -> tuple[Array, Array]:
    """The inverse map: outputs (p, 3) at which the magnet of a body at positions (p, 3) feels forces (p, 3), N, and
    what is left of them (p,), N. The search begins at those of the operating point and goes from row to row.

    Raises Infeasible for positions outside the map, InputError for an allocation of other than three outputs.
    """
    m = len(operating_point.outputs)
    if m != 3:
        problem = Problem(
            "outputs_for(machine)", "must have three outputs", f"{m}", "take an allocation of three"
        )
        raise InputError(problem)
    found, left = np.empty((len(positions), 3)), np.empty(len(positions))
    core = machine.core(1.0, EXACT)
    inverse = InverseMap(
        core.machine,
        _ROUNDS,
        np.array([lower, upper], float),
        operating_point.outputs.copy(),
        operating_point.state.copy(),
    )
    numbers = machine.allocation.numbers()
    places, wanted = np.ascontiguousarray(positions, float), np.ascontiguousarray(forces, float)
    inverse_along(inverse, numbers, places, wanted, found, left)
    if np.isnan(left).any():
        where = positions[int(np.flatnonzero(np.isnan(left))[0])]
        problem = Problem(
            "outputs_for(positions)", "must lie in the map", f"{where.tolist()} m", "shorten the path"
        )
        raise Infeasible(problem)
    return found, left


def feedforward(controller: Controller, schedule: Schedule, path: Trajectory) -> Array:
    """(p, m): what is added to a controller's outputs so that they are those of the trajectory where the body is on its
    way; what the controller would say there by itself is taken off."""
    wanted = path.forces if isinstance(controller, ForceController) else path.outputs
    added = np.empty_like(wanted)
    references = schedule.references
    CoreController(controller.arrays).quiet_feedforward(
        references, np.ascontiguousarray(wanted), controller.memory.copy(), added
    )
    return added


def _motion(path: Array, period: float, fastest: float, largest: float) -> tuple[Array, Array]:
    """Velocity and acceleration (p, 3) of a path; none where it steps, no acceleration beyond the largest."""
    if len(path) < 3:
        return np.zeros_like(path), np.zeros_like(path)
    velocity = np.gradient(path, period, axis=0)
    acceleration = np.zeros_like(path)
    acceleration[1:-1] = (path[2:] - 2.0 * path[1:-1] + path[:-2]) / period**2
    steps = np.abs(velocity).max(axis=1) > fastest
    steps[1:-1] |= steps[2:] | steps[:-2]
    velocity[steps], acceleration[steps] = 0.0, 0.0
    return velocity, np.clip(acceleration, -largest, largest)

"""Motion at constant currents, by compiled steps of fixed length, or by an adaptive integrator for comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_choice, check_count, check_positive, check_signal
from fieldmap.core.machine import (
    ANGULAR_VELOCITY,
    INSIDE,
    STATE,
    TURN,
    VELOCITY,
    BodyNumbers,
    CoreMachine,
    Plant,
)
from fieldmap.dynamics.rigid_body import Drag, Plate, RigidBody, Walls
from fieldmap.errors import NotConverged
from fieldmap.lookup import MapAtCurrents, core_map
from fieldmap.records import Record
from fieldmap.typing import Array

ORDERS = {"second": 2, "fourth": 4}


@dataclass(frozen=True, eq=False, repr=False)
class FixedCurrentsRun(Record):
    """time (n,), s; states (n, 13): position, velocity, quaternion (w, x, y, z) body to map, angular velocity in the
    frame of the body. inside: whether the magnet stayed in the map; touched: whether the body touched a wall."""

    time: Array
    states: Array
    inside: bool
    touched: bool


def state_of(
    position: ArrayLike,
    velocity: ArrayLike = (0, 0, 0),
    quaternion: ArrayLike = (1, 0, 0, 0),
    angular_velocity: ArrayLike = (0, 0, 0),
) -> Array:
    """A state from its parts.

    Parameters
    ----------
    position
        Position of the centre of mass (3,), m.
    velocity
        (3,), m/s.
    quaternion
        Orientation of the body (4,), real part first; it is normalised.
    angular_velocity
        (3,), rad/s.

    Returns
    -------
    Array
        State (13,).
    """
    parts = {"position": position, "velocity": velocity, "angular_velocity": angular_velocity}
    checked = {name: check_signal(f"state_of({name})", part, columns=3) for name, part in parts.items()}
    turn = check_signal("state_of(quaternion)", quaternion, columns=4)
    length = float(np.linalg.norm(turn))
    check(length > 0.0, "state_of(quaternion)", "must have a length", "zeros", "(1, 0, 0, 0) for upright")
    moving = checked["velocity"], turn / length, checked["angular_velocity"]
    return np.concatenate([checked["position"], *moving])


def move(
    field: MapAtCurrents,
    body: RigidBody,
    state: ArrayLike,
    duration: float,
    step: float = 1e-4,
    *,
    order: str = "second",
    drag: Drag | None = None,
    plate: Plate | None = None,
    walls: Walls | None = None,
    every: int = 1,
) -> FixedCurrentsRun:
    """The motion of a body in the field of constant currents, by steps of fixed length.

    Parameters
    ----------
    field
        `m.at(currents)`.
    body
        The body.
    state
        State at the start (13,).
    duration, step
        s.
    order
        "second", Strang's splitting, with one evaluation of the field per step, or "fourth", Yoshida's composition,
        with three. Both are symmetric in time, and symplectic without losses.
    drag, plate, walls
        Surroundings of the body.
    every
        Steps from one row of the result to the next.

    Returns
    -------
    FixedCurrentsRun
        The run, which ends when the magnet leaves the map.

    Raises
    ------
    InputError
        For invalid arguments.
    """
    check_positive("move", duration=duration, step=step)
    check_count("move", every=every)
    rule = ORDERS[check_choice("move(order)", order, ORDERS)]
    start = _checked("move(state)", state)
    rows = round(duration / (step * every)) + 1
    states = np.empty((rows, STATE))
    machine = _in_field(field, body.numbers(drag, plate, walls))
    filled, status, touched = machine.move(start, step, every, rule, states)
    time = step * every * np.arange(filled, dtype=np.float64)
    return FixedCurrentsRun(time, states[:filled], bool(status == INSIDE), bool(touched))


def move_adaptively(
    field: MapAtCurrents,
    body: RigidBody,
    state: ArrayLike,
    times: ArrayLike,
    *,
    drag: Drag | None = None,
    plate: Plate | None = None,
    tolerance: float = 1e-12,
) -> Array:
    """States by scipy's DOP853 on the right-hand side of `move`, to check steps of fixed length.

    Parameters
    ----------
    field, body, drag, plate
        As in `move`.
    state
        State at the start (13,).
    times
        Times (n,), s; `state` is at the first one.
    tolerance
        Relative tolerance per step.

    Returns
    -------
    Array
        States (n, 13).

    Raises
    ------
    NotConverged
        If the integrator stops, for example because the magnet leaves the map.
    """
    moments = np.atleast_1d(check_signal("move_adaptively(times)", times))
    start = _checked("move_adaptively(state)", state)
    machine = _in_field(field, body.numbers(drag, plate))

    def slope(_: float, y: Array) -> Array:
        out = np.empty(STATE)
        return out if machine.rates(np.ascontiguousarray(y), out) == INSIDE else np.full(STATE, np.nan)

    atol = tolerance * np.maximum(np.abs(start), 1e-3)
    ends, how = (moments[0], moments[-1]), {"method": "DOP853", "rtol": tolerance, "atol": atol}
    found = scipy.integrate.solve_ivp(slope, ends, start, t_eval=moments, **how)
    if not found.success or not np.isfinite(found.y).all():
        must, remedy = "the integrator must reach the end", "keep the motion in the map"
        raise NotConverged.of("move_adaptively", must, found.message, remedy)
    return np.ascontiguousarray(found.y.T)


def energy(field: MapAtCurrents, body: RigidBody, states: ArrayLike) -> Array:
    """Kinetic energy, magnetic energy and potential energy of the weight; constant without losses: dynamics.md (8).

    Parameters
    ----------
    field
        Map at its currents.
    body
        The body.
    states
        States (n, 13).

    Returns
    -------
    Array
        Energy (n,), J.
    """
    rows = np.atleast_2d(check_signal("energy(states)", states, columns=STATE))
    machine = _in_field(field, body.numbers())
    magnetic = [machine.energy(row) for row in np.array(rows)]
    kinetic = 0.5 * body.mass * (rows[:, VELOCITY : VELOCITY + 3] ** 2).sum(axis=1)
    turning = 0.5 * (rows[:, ANGULAR_VELOCITY : ANGULAR_VELOCITY + 3] ** 2) @ body.inertia
    return kinetic + turning + np.array(magnetic, float) + body.mass * body.gravity * rows[:, 2]


def angular_momentum(body: RigidBody, states: ArrayLike) -> Array:
    """Angular momentum about the centre of mass, in the frame of the map.

    Parameters
    ----------
    body
        The body.
    states
        States (n, 13).

    Returns
    -------
    Array
        Angular momentum (n, 3), kg m^2/s.
    """
    rows = np.atleast_2d(check_signal("angular_momentum(states)", states, columns=STATE))
    return turned(rows[:, TURN : TURN + 4], rows[:, ANGULAR_VELOCITY:STATE] * body.inertia)


def turned(quaternions: Array, vectors: Array) -> Array:
    """Vectors (3,) or (n, 3) of the body, rotated by quaternions (n, 4) into the map."""
    w, u = quaternions[:, :1], quaternions[:, 1:]
    twice = 2.0 * np.cross(u, vectors)
    return np.asarray(vectors + w * twice + np.cross(u, twice))


def _in_field(field: MapAtCurrents, body: BodyNumbers) -> CoreMachine:
    """A body in a field with one set of coefficients of weight 1, without coils."""
    none = np.zeros((0, 4)), np.zeros((0, 7))
    return CoreMachine(Plant(core_map(field).map, body, np.zeros(3), 1.0, None, 1.0, None, *none))


def _checked(where: str, state: ArrayLike) -> Array:
    start = np.array(check_signal(where, state, columns=STATE))
    fits = start.ndim == 1 and abs(np.linalg.norm(start[TURN : TURN + 4]) - 1.0) <= 1e-9
    must = "must be one state (13,) with a quaternion of length 1"
    check(bool(fits), where, must, start.tolist(), "make it by state_of")
    return start

"""The current that carries the weight at a given point."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, InputError, Problem
from fieldmap.levitation.balance import Balance
from fieldmap.levitation.checks import check_currents, check_payload, check_position
from fieldmap.levitation.conventions import GRAVITY
from fieldmap.levitation.dipole import dipole_force
from fieldmap.levitation.interface import LevitationField
from fieldmap.typing import Array

LINEARITY = 1e-6
"""Largest relative departure from force proportional to current that is accepted as linear."""


@dataclass(frozen=True, eq=False)
class LiftCurrent:
    """Currents whose lift equals the weight at a point.

    current: the common factor, A; currents (n_coils,) = current * shares. position (3,), m. force (3,):
    magnetic force there, N; its z component is the weight, the other two are not balanced. force_per_ampere
    (3,), N/A of common current: dF/di at these currents. stiffness (3, 3) = -dF_i/dx_j, N/m. field (3,), T.
    assumptions: what the numbers rest on. history: (common current in A, lift in N) of every state that was
    solved on the way, empty for a linear field.
    """

    current: float
    currents: Array
    position: Array
    force: Array
    force_per_ampere: Array
    stiffness: Array
    field: Array
    assumptions: tuple[str, ...]
    history: tuple[tuple[float, float], ...] = ()


def lift_current(
    field_map: LevitationField, payload: Payload | None, position: ArrayLike, shares: ArrayLike | None = None
) -> LiftCurrent:
    """Common current that carries the weight at a position, for a field proportional to the currents.

    i = m g / (D dBz/dz per ampere), with a vertical point dipole D (2-12), (2-13) of the thesis, turned so
    that it is pulled up by a positive current. position (3,): the magnet's centre, m, inside the map.
    shares (n_coils,): current of each coil per ampere of common current; 1 in every coil unless given (the
    thesis's equal currents).

    Raises InputError for a payload, position or shares that do not fit, or when the force is not
    proportional to the current (then use `lift_current_nonlinear`); Infeasible when the field
    does not lift there at all.

    Example::

        lift = lift_current(m, device.payload, [0, 0, magnet_height(10.0, device.payload.magnet_offset)])
        print(lift.current, "A in each coil")
    """
    carried = check_payload(payload, "lift_current")
    point = check_position(field_map, position, "lift_current(position)")
    given = np.ones(len(field_map.coil_names)) if shares is None else shares
    weights = check_currents(field_map, given, "lift_current(shares)")
    up = np.array([0.0, 0.0, carried.moment])
    gradient = field_map.gradient(point[None, :], weights)[0]
    force = dipole_force(up, gradient)
    direction = direction_of_lift(point, carried.moment, gradient)
    weight = carried.mass * GRAVITY
    current = weight / abs(force[2])
    at = Balance(field_map, current * weights, carried.mass, carried.moment, direction * up)
    total = at.magnetic_force(point[None, :])[0]
    if abs(total[2] - weight) > LINEARITY * weight:
        raise InputError(_not_linear(current, total[2] / weight))
    return LiftCurrent(
        current=current,
        currents=current * weights,
        position=point,
        force=total,
        force_per_ampere=direction * force,
        stiffness=at.stiffness(point),
        field=field_map.field(point[None, :], current * weights)[0],
        assumptions=(
            "linear: field and force are proportional to the currents (no saturation)",
            "the magnet is a vertical point dipole at its centre",
        ),
    )


def direction_of_lift(point: Array, moment: float, gradient: Array) -> float:
    """+1 if a moment that points up is pulled up in this gradient (3, 3), -1 if one that points down is.

    Raises Infeasible if neither is.
    """
    force = dipole_force(np.array([0.0, 0.0, moment]), gradient)
    # Rounding leaves some 1e-16 of the gradient where dBz/dz vanishes.
    if abs(force[2]) <= 1e-12 * moment * np.linalg.norm(gradient):
        raise Infeasible(_no_lift(point))
    return float(np.sign(force[2]))


def _no_lift(point: Array) -> Problem:
    return Problem(
        f"lift_current at {(1e3 * point).round(3).tolist()} mm",
        "dBz/dz must not vanish where a vertical dipole is to be lifted",
        "no vertical force for the given shares",
        "choose another position or other shares",
    )


def _not_linear(current: float, ratio: float) -> Problem:
    return Problem(
        f"lift_current at {current:.4g} A",
        "force must be proportional to the currents",
        f"{ratio:.6g} times the force that proportion gives",
        "use lift_current_nonlinear; this field is not linear",
    )

"""Currents of least power that lift a magnet, or push it along one axis and nowhere else: docs/theory/closed_loop.md
(23), (24)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_signal
from fieldmap.errors import Infeasible
from fieldmap.field import Field
from fieldmap.typing import Array

# A combination of coils weaker than this share of the strongest is taken for none: of currents, it would ask for more
# than a thousand times as much.
_WEAKEST = 1e-3
# Share of a wanted force that coils may leave or put elsewhere and still count as pushing that way.
_LEFT = 0.1
# Share of the largest current over which the force of saturating iron is differenced; without any current, of 1 A.
_CURRENT_STEP = 0.01


def force_per_ampere(field: Field, moment: Array, point: Array, currents: Array) -> Array:
    """dF/di (3, n), N/A, of a point dipole of moment (3,), A m^2, at a point (3,), about currents (n,), A.

    By central differences over 1 % of the largest current, which are exact for a field that is proportional to the
    currents, and of second order in the step where iron saturates.
    """
    steps = _CURRENT_STEP * (float(np.abs(currents).max()) or 1.0) * np.eye(len(currents))
    at = point[None, :]
    force = [
        (field.gradient(at, currents + step)[0] - field.gradient(at, currents - step)[0]).T @ moment
        for step in steps
    ]
    return np.column_stack(force) / (2.0 * steps[0, 0])


def lift_shares(force_per_ampere: ArrayLike) -> Array:
    """Currents (n,) of least power that lift, the largest of size 1, and push sideways as little as they can.

    force_per_ampere (3, n): force of the magnet by the coils' currents, N/A. Raises Infeasible where they do not lift.

    >>> lift_shares([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]]).round(9).tolist()
    [1.0, 1.0]
    """
    return _towards(_checked(force_per_ampere), 2)


def push_shares(force_per_ampere: ArrayLike, axis: int) -> Array:
    """Currents (n,) of least power that push along x (axis 0) or y (1) and nowhere else, the largest of size 1.

    force_per_ampere (3, n): force of the magnet by the coils' currents, N/A. Raises Infeasible where the coils do not
    push that way by themselves.

    >>> push_shares([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]], axis=0).round(9).tolist()
    [1.0, -1.0]
    """
    return _towards(_checked(force_per_ampere), axis)


def signal_pushes(force_per_ampere: ArrayLike) -> tuple[Array, tuple[str, ...]]:
    """Currents (n, 2) of `push_shares` along x and y, and the axes along which the coils do not push by themselves,
    whose currents are zero."""
    pushes, idle = [], []
    for axis in (0, 1):
        try:
            pushes.append(push_shares(force_per_ampere, axis))
        except Infeasible:
            pushes.append(np.zeros(np.shape(force_per_ampere)[1]))
            idle.append("xy"[axis])
    return np.column_stack(pushes), tuple(idle)


def idle_note(axis: str) -> str:
    """What is assumed of an axis along which the coils do not push by themselves."""
    return f"the coils do not push along {axis} by themselves: that signal does nothing"


def _towards(force: Array, axis: int) -> Array:
    """Currents (n,) of least power that push along an axis and not along the others, the largest of size 1. Raises
    Infeasible where there are none."""
    wanted = np.eye(3)[axis]
    currents = np.linalg.pinv(force, rcond=_WEAKEST) @ wanted
    made = force @ currents
    # The lift may have a pull aside, which a stiffness or another signal holds; a signal may not.
    left = abs(made[2] - 1.0) if axis == 2 else float(np.abs(made - wanted).max())
    if left > (0.5 if axis == 2 else _LEFT):
        must = f"the coils must push the magnet along {'xyz'[axis]}"
        received = f"{force[axis].tolist()} N/A along it, of at most {np.abs(force).max():.2g} N/A"
        remedy = "begin at another place, or turn or add a coil"
        raise Infeasible.of("least_power", must, received, remedy)
    return np.asarray(currents / np.abs(currents).max())


def _checked(force_per_ampere: ArrayLike) -> Array:
    return check_signal("least_power(force_per_ampere).T", np.transpose(force_per_ampere), columns=3).T

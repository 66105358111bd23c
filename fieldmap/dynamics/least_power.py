"""Lift and two direction signals for any number of coils, by least power: docs/theory/dynamics.md (47)..(49)."""

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive, check_signal
from fieldmap.dynamics.closed_loop import Mixing
from fieldmap.errors import Infeasible, InputError, Problem
from fieldmap.typing import Array

# A combination of coils weaker than this share of the strongest is taken for none: of currents, it would ask for more
# than a thousand times as much.
_WEAKEST = 1e-3
# Share of a wanted force that coils may leave or put elsewhere and still count as pushing that way.
_LEFT = 0.1
SIGNALS = ("lift_V", "x_signal", "y_signal")


def lift_shares(force_per_ampere: ArrayLike) -> Array:
    """Currents (n,) of least power that lift, the largest of size 1, and push sideways as little as they can.

    force_per_ampere (3, n): force of the magnet by the coils' currents, N/A. Raises Infeasible where they do not lift.

    >>> lift_shares([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]]).round(9).tolist()
    [1.0, 1.0]
    """
    return _largest_is_one(_towards(_checked(force_per_ampere), 2))


def least_power_mixing(force_per_ampere: ArrayLike, shares: ArrayLike, volts: float) -> Mixing:
    """Outputs lift (V), x and y become the voltages of n coils.

    force_per_ampere (3, n): N/A, about the rest. shares (n,): of the lift's volt, such as `lift_shares`. volts: lift at
    rest; an x signal of 1 adds that many volts to the coil that takes most of it, in the proportions that push along x
    and nowhere else with least power. Along an axis on which the coils do not push by themselves the signal does
    nothing, and the assumptions say so. Raises InputError for arguments that do not fit.

    >>> mixing = least_power_mixing([[0.1, -0.1], [0.0, 0.0], [0.3, 0.3]], [1.0, 1.0], 2.0)
    >>> mixing.matrix.round(9).tolist(), mixing.idle
    ([[1.0, 2.0, 0.0], [1.0, -2.0, 0.0]], ('y',))
    """
    force = _checked(force_per_ampere)
    check_positive("least_power_mixing", volts=volts)
    lift = check_signal("least_power_mixing(shares)", shares)
    if lift.shape != force.shape[1:]:
        must = f"must be ({force.shape[1]},)"
        raise InputError(Problem("least_power_mixing(shares)", must, f"{lift.shape}", "give one per coil"))
    columns, idle = [lift], []
    for axis in (0, 1):
        try:
            columns.append(volts * _largest_is_one(_towards(force, axis)))
        except Infeasible:
            columns.append(np.zeros_like(lift))
            idle.append("xy"[axis])
    shown = ", ".join(f"{share:.3g}" for share in lift)
    held = " or ".join(axis for axis in "xy" if axis not in idle)
    signals = f"; a signal {held} of 1 adds {volts:.3g} V to a coil" if held else ""
    words = [f"coils by least power: lift in the shares {shown}{signals}"]
    words += [f"the coils do not push along {axis} by themselves: that signal does nothing" for axis in idle]
    return Mixing(np.column_stack(columns), np.zeros(len(lift)), SIGNALS, tuple(idle), tuple(words))


def _checked(force_per_ampere: ArrayLike) -> Array:
    return check_signal("least_power(force_per_ampere).T", np.transpose(force_per_ampere), columns=3).T


def _towards(force: Array, axis: int) -> Array:
    """Currents (n,) of least power for 1 N along an axis and none along the others; Infeasible where there are none."""
    wanted = np.eye(3)[axis]
    currents = np.linalg.pinv(force, rcond=_WEAKEST) @ wanted
    made = force @ currents
    # The lift may have a pull aside, which a stiffness or another signal holds; a signal may not.
    left = abs(made[2] - 1.0) if axis == 2 else float(np.abs(made - wanted).max())
    if left > (0.5 if axis == 2 else _LEFT):
        must = f"the coils must push the magnet along {'xyz'[axis]}"
        received = f"{force[axis].tolist()} N/A along it, of at most {np.abs(force).max():.2g} N/A"
        remedy = "begin at another place, or turn or add a coil"
        raise Infeasible(Problem("least_power", must, received, remedy))
    return np.asarray(currents)


def _largest_is_one(currents: Array) -> Array:
    return currents / np.abs(currents).max()

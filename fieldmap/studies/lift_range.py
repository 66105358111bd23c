"""How far currents within their limit hold the payload."""

import numpy as np
from scipy.optimize import brentq

from fieldmap.core.least_power import FOUND, least_power
from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, Problem
from fieldmap.field import Field, require_bounds
from fieldmap.iron import LinearSolution
from fieldmap.levitation import GRAVITY
from fieldmap.levitation.balance import upright_force
from fieldmap.lookup.payload import check_payload
from fieldmap.typing import Array

HEIGHTS = 33
GRID = (7, 7, 9)


def lowest_lift_height(field: Field, currents: Array, payload: Payload, over: Array) -> float:
    """Lowest height z (m) of the box on the vertical over (x, y) at which these currents lift the weight.

    The moment is vertical, up or down, whichever is lifted more; pieces are upright. The box's lower end if they lift
    it there too. Raises Infeasible if they lift it nowhere on the vertical.
    """
    lower, upper = (float(corner[2]) for corner in require_bounds(field))

    def lift(z: Array) -> Array:
        points = np.column_stack([np.broadcast_to(over[:2], (len(z), 2)), z])
        force = upright_force(field, currents, payload, points)[:, 2]
        return force if payload.pieces else np.abs(force)

    weight = payload.mass * GRAVITY
    heights = np.linspace(lower, upper, HEIGHTS)
    enough = lift(heights) >= weight
    if not enough.any():
        raise Infeasible(_nowhere(float(lift(heights).max() / weight), float(np.abs(currents).max())))
    first = int(enough.argmax())
    if first == 0:
        return lower
    return float(
        brentq(lambda z: lift(np.array([z]))[0] - weight, heights[first - 1], heights[first], xtol=1e-7)
    )


def _nowhere(share: float, limit: float) -> Problem:
    return Problem(
        "reach",
        "the currents at the limit must lift the payload somewhere in the workspace",
        f"{share:.3g} of the weight at most, with {limit:g} A",
        "raise the limit, lighten the payload, or let the workspace begin nearer to the iron",
    )


def controllable_share(
    solution: LinearSolution, payload: Payload, lower: Array, upper: Array, limit: float
) -> float:
    """Share of a box in which some currents within +-limit hold the payload: no horizontal force, lift = weight.

    By 7 x 7 x 9 cells, each by its centre, with a vertical moment; linear iron, whose coils superpose. Raises
    InputError for a payload of pieces.
    """
    check_payload(payload, "reachable_share")
    axes = [
        low + (np.arange(n) + 0.5) / n * (high - low) for low, high, n in zip(lower, upper, GRID, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    per_ampere = payload.moment * solution.unit_fields(points)[1][:, :, 2, :]
    constant = payload.moment * solution.constant_fields(points)[1][:, 2, :]
    held = [
        _holds(per_ampere[:, k].T, constant[k], payload.mass * GRAVITY, limit) for k in range(len(points))
    ]
    return float(np.mean(held))


def _holds(matrix: Array, constant: Array, weight: float, limit: float) -> bool:
    """Whether currents (n_coils,) exist for forces matrix (3, n_coils) of an upward moment; a downward one is the
    same with the currents turned round, unless magnets add a constant."""
    coils = matrix.shape[1]
    low, high, weights = np.full(coils, -limit), np.full(coils, limit), np.ones(coils)
    for sign in (1.0, -1.0) if constant.any() else (1.0,):
        wanted = np.array([0.0, 0.0, weight]) - sign * constant
        rows = np.ascontiguousarray(sign * matrix)
        currents, active = np.empty(coils), np.empty(coils, np.int64)
        if least_power(rows, wanted, low, high, weights, currents, active) == FOUND:
            return True
    return False

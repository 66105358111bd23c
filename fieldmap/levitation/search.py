"""Where the search for an equilibrium begins, and the root finder."""

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from fieldmap.errors import NoEquilibrium, Problem
from fieldmap.levitation.balance import Balance
from fieldmap.levitation.interface import LevitationField
from fieldmap.lookup import FieldMap
from fieldmap.typing import Array

SEARCH_SHAPE = (7, 7, 15)
MAX_STARTS = 8
TOLERANCE = 1e-8
"""Largest |F + m g| / weight that counts as balance."""


def search_grid(source: LevitationField) -> Array:
    """Points (n, 3) that span the box."""
    lower, upper = np.asarray(source.lower), np.asarray(source.upper)
    # A hair inside the box, so that rounding never puts a point outside it.
    margin = 1e-9 * (upper - lower)
    axes = [
        np.linspace(a, b, n) for a, b, n in zip(lower + margin, upper - margin, SEARCH_SHAPE, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def best_starts(grid: Array, unbalance: Array, source: LevitationField) -> Array:
    """Grid points of least unbalanced force, no two closer than a fifth of the box."""
    scale = np.asarray(source.upper) - np.asarray(source.lower)
    chosen: list[Array] = []
    for index in np.argsort(unbalance, kind="stable"):
        if all(np.abs((grid[index] - other) / scale).max() > 0.2 for other in chosen):
            chosen.append(grid[index])
        if len(chosen) == MAX_STARTS:
            break
    return np.array(chosen)


def roots(balance: Balance, source: LevitationField, starts: Array) -> list[Array]:
    """Distinct points of balance reached from the starts (trust region, analytic derivative, kept in the
    box).

    Where the force of a map steps from one cell to the next, by no more than the map's own error, balance may lie in
    the step; such a point is taken if none is better.
    """
    lower, upper = np.asarray(source.lower), np.asarray(source.upper)
    inset = 1e-9 * (upper - lower)
    answers = [
        least_squares(
            lambda x: balance.residual(x[None, :])[0] / balance.weight,
            np.clip(start, lower + inset, upper - inset),
            jac=lambda x: -balance.stiffness(x) / balance.weight,
            bounds=(lower, upper),
            x_scale=upper - lower,
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
            max_nfev=60,
        )
        for start in starts
    ]
    apart = 1e-5 * float(np.linalg.norm(upper - lower))
    return _distinct(answers, TOLERANCE, apart) or _distinct(answers, largest_step(balance, source), apart)


def _distinct(answers: list[OptimizeResult], unbalance: float, apart: float) -> list[Array]:
    """Where the answers lie that leave no more force than `unbalance` weights, each place once."""
    found: list[Array] = []
    for answer in answers:
        new = all(np.linalg.norm(answer.x - other) > apart for other in found)
        if new and np.linalg.norm(answer.fun) <= unbalance:
            found.append(answer.x)
    return found


def largest_step(balance: Balance, source: LevitationField) -> float:
    """Largest step of the force between cells of a map, over the weight; 0 for a field that has none."""
    if not isinstance(source, FieldMap):
        return 0.0
    share = np.abs(balance.currents / source.info.reference_current).max(initial=1.0)
    return float(balance.magnitude * source.jump().gradient_bound * share / balance.weight)


def no_equilibrium(balance: Balance, grid: Array, residuals: Array, tried: int) -> NoEquilibrium:
    """The error that says where balance was looked for and what lift there is."""
    lift = residuals[:, 2] + balance.weight
    high, low = int(lift.argmax()), int(lift.argmin())
    nearest = int(np.linalg.norm(residuals, axis=1).argmin())

    def at(index: int) -> str:
        x, y, z = 1e3 * grid[index]
        return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"

    weight = balance.weight
    if lift[high] < weight:
        remedy = (
            f"raise the currents ({weight / lift[high]:.3g} times, if the iron is linear), "
            "lighten the payload, or use a map that reaches nearer to the coils"
            if lift[high] > 0
            else "turn the currents on or the polarity of the coils around"
        )
    elif lift[low] > weight:
        remedy = "lower the currents, or use a map that reaches farther from the coils"
    else:
        remedy = "balance the currents, so that the sideways force vanishes inside the map's box"
    return NoEquilibrium(
        Problem(
            where=f"find_equilibrium, {tried} starts in the box {at(0)} to {at(len(grid) - 1)}",
            must_hold=f"the magnetic force must balance the weight {1e3 * weight:.4g} mN at some point",
            received=(
                f"lift from {1e3 * lift[low]:.4g} mN at {at(low)} "
                f"to {1e3 * lift[high]:.4g} mN at {at(high)}; "
                f"least unbalanced force {1e3 * np.linalg.norm(residuals[nearest]):.3g} mN at {at(nearest)}"
            ),
            remedy=remedy,
        )
    )

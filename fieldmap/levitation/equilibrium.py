"""The point at which the magnetic force carries the weight: search and result (docs/theory/equilibrium.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_choice, check_positive
from fieldmap.device.model import Payload
from fieldmap.errors import NoEquilibrium
from fieldmap.field import AnyField, Bounds, require_bounds, resolve_currents
from fieldmap.levitation.balance import (
    BodyBalance,
    MagnetBalance,
    MagnetModel,
    coarse_balance,
    held_at,
    magnet_balance,
    model_of,
    reaction_stated,
    refuse_models_of_pieces,
    rule_stated,
)
from fieldmap.levitation.places import check_centre, check_position, search_grid
from fieldmap.lookup.payload import check_payload, magnetic_body
from fieldmap.plain import Plain, plain_fields, plain_items
from fieldmap.records import Record
from fieldmap.typing import Array

MAX_STARTS = 8
TOLERANCE = 1e-8
"""Largest |F + m g| / weight that counts as balance."""


@dataclass(frozen=True, eq=False, repr=False)
class SearchReport(Record):
    """The search for an equilibrium: numbers of starts tried and of starts that converged, evaluations of the force,
    relative residual |F + m g| / weight, antisymmetric part of the stiffness relative to its norm (0 for an exactly
    curl-free field, small for an interpolated one), and the box of the payload's centre that was searched, m."""

    method: str
    starts: int
    converged: int
    evaluations: int
    relative_residual: float
    stiffness_asymmetry: float
    lower: Array
    upper: Array


@dataclass(frozen=True, eq=False, repr=False)
class Equilibrium(Record):
    """Balance of magnetic force and weight.

    position (3,): the payload's centre, m. force_residual (3,): magnetic force plus weight, N.
    stiffness (3, 3): -dF_i/dx_j, N/m. eigenvalues (3,) ascending, N/m, of its symmetric part, and
    directions (3, 3) with the unit eigenvectors as columns; stable (3,): whether the magnet is pushed back
    along each of them. moment (3,) in A m^2 and currents (n_coils,) in A, at the equilibrium; held: direction of the
    moment of the magnets and whether it turns, such as "moment down, fixed". field (3,): B in T in the middle of the
    payload's magnets and soft iron. others (n, 3): further equilibria found at the same currents, m. volume_error:
    displacement of the place with a finer volume rule of the magnets, m; 0 where the rule is exact or no shape is
    known, NaN where the finer rule leaves the field or its place is not found. assumptions: of the numbers.
    """

    position: Array
    force_residual: Array
    stiffness: Array
    eigenvalues: Array
    directions: Array
    stable: NDArray[np.bool_]
    moment: Array
    held: str
    field: Array
    currents: Array
    others: Array
    volume_error: float
    assumptions: tuple[str, ...]
    report: SearchReport

    @property
    def trace(self) -> float:
        """Trace of the stiffness, N/m: 0 for a fixed dipole in a harmonic field (Earnshaw), <= 0 for an
        aligned one."""
        return float(np.trace(self.stiffness))

    @property
    def stable_axes(self) -> dict[str, bool]:
        """Whether a small displacement along x, y or z alone is pushed back along that axis (diagonal of K
        > 0)."""
        return {axis: bool(k > 0.0) for axis, k in zip("xyz", np.diag(self.stiffness), strict=True)}

    @property
    def angle_to_field(self) -> float:
        """Angle between moment and field, degrees. Beyond 90 a free magnet would turn over."""
        cosine = self.moment @ self.field / (np.linalg.norm(self.moment) * np.linalg.norm(self.field))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def to_dict(self) -> dict[str, Plain]:
        """The result as plain Python, SI units; `directions` as rows."""
        return plain_fields(self) | plain_items(
            directions=self.directions.T,
            trace=self.trace,
            stable_axes=self.stable_axes,
            angle_to_field_deg=self.angle_to_field,
        )


def find_equilibrium(
    field: AnyField,
    currents: Any = None,
    payload: Payload | None = None,
    start: ArrayLike | None = None,
    moment: Literal["fixed", "aligned"] | None = None,
    field_scale: float = 1.0,
) -> Equilibrium:
    """Find where the force on a payload balances its weight, F(x) + m g = 0, inside the field's box.

    docs/theory/equilibrium.md has the equations.

    Parameters
    ----------
    field
        An opened map, a solution, the solver of saturating iron, or any other `fieldmap.field.Field` that has
        a box; a solved state of saturating iron too, whose currents may be left out.
    currents
        (n_coils,), one number for all coils, or by name, A.
    payload
        The levitated body, with its direction. Its magnets are integrated over their volume by the rule of its
        `volume_level`; at level 1, or without a shape, they are point dipoles. Pieces stay upright, and soft iron
        follows B.
    start
        The payload's centre (3,), m, from which to begin. Without it the search covers all places at which the
        payload's magnets, and the centres of its soft iron, lie in the box. Of several equilibria, the one with
        the most stable directions is returned or, if several have as many, the one of these that is nearest to the
        box's vertical axis; the rest are in `.others`.
    moment
        "fixed" keeps the payload's direction; "aligned" lets the moment follow B, as a point dipole. Unless given,
        "aligned" for a payload with turning = "free", "fixed" for any other.
    field_scale
        Calibration: factor of every force except the iron's reaction to the magnets.

    Returns
    -------
    Equilibrium
        The equilibrium: SI units, frame of the field.

    Raises
    ------
    InputError
        For currents that do not fit the field, and pieces that extend over more than its box.
    OutsideMapError
        For a start at which the payload leaves the box.
    NoEquilibrium
        If there is no equilibrium; the error states the available lift.

    Examples
    --------
    >>> m = fieldmap.open_map("maps/out/workspace.h5")  # doctest: +SKIP
    >>> payload = fieldmap.read_device("drive_unit").payload  # doctest: +SKIP
    >>> e = fieldmap.find_equilibrium(m, currents=3.0, payload=payload)  # doctest: +SKIP
    >>> print(e.position, e.stable_axes)  # doctest: +SKIP
    """
    carried = check_payload(payload, "find_equilibrium", pieces=True)
    source, amperes = resolve_currents(field, currents)
    model = model_of(carried) if moment is None else moment
    check_choice("find_equilibrium(moment)", model, ("fixed", "aligned"))
    if carried.pieces:
        refuse_models_of_pieces("find_equilibrium(moment)", model)
    bounds, where = require_bounds(source), "find_equilibrium(start)"
    asked = None if start is None else check_centre(bounds, carried, start, where)
    check_positive("find_equilibrium", field_scale=field_scale)
    balance = replace(magnet_balance(source, amperes, carried, asked, model), field_scale=field_scale)
    box = balance.box
    begin = None if asked is None else check_position(box, asked, where)
    grid = search_grid(box)
    coarse = coarse_balance(balance, carried)
    residuals = coarse.residual(grid)
    balance.evaluations = coarse.evaluations
    best = best_starts(grid, np.linalg.norm(residuals, axis=1), box)
    found: list[Array] = []
    tried = 0
    for starts in [best] if begin is None else [begin[None, :], best]:
        if not found:
            found = roots(balance, box, starts)
            tried += len(starts)
    if not found:
        raise no_equilibrium(balance, carried, grid, residuals, tried)
    return _result(balance, box, found, begin, tried, carried, model)


def _eigen(stiffness: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    eigenvalues, directions = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    # The sign of a direction makes its largest component positive.
    directions = directions * np.sign(directions[np.abs(directions).argmax(axis=0), range(3)])
    # A direction with a negligible stiffness is not stable.
    return eigenvalues, directions, eigenvalues > 1e-9 * np.abs(eigenvalues).max()


def _ranked(balance: MagnetBalance, box: Bounds, found: list[Array], begin: Array | None) -> list[Array]:
    """Equilibria by distance from the start if there is one; else by stability, then by distance from the axis."""
    axis = 0.5 * (box[0] + box[1])

    def order(x: Array) -> tuple[float, float]:
        if begin is not None:
            return 0.0, float(np.linalg.norm(x - begin))
        unstable = 3 - int(_eigen(balance.residual_stiffness(x))[2].sum())
        return float(unstable), float(np.linalg.norm((x - axis)[:2]))

    return sorted(found, key=order)


def _result(
    balance: MagnetBalance,
    box: Bounds,
    found: list[Array],
    begin: Array | None,
    tried: int,
    payload: Payload,
    moment: MagnetModel,
) -> Equilibrium:
    ranked = _ranked(balance, box, found, begin)
    position = ranked[0]
    stiffness = balance.residual_stiffness(position)
    eigenvalues, directions, stable = _eigen(stiffness)
    rests = assumptions_of_pieces(payload) if payload.pieces else assumptions(moment)
    drawn = [float(np.linalg.norm(balance.reaction_force(position[None, :])))]
    rests += reaction_stated(balance.source, payload, drawn, "at the place")
    off = balance.place_error(position)
    residual = balance.residual(position[None, :])[0]
    held, notes = held_at(balance, payload, position)
    report = SearchReport(
        method="trust-region reflective least squares, analytic derivative",
        starts=tried,
        converged=len(found),
        evaluations=balance.evaluations,
        relative_residual=float(np.linalg.norm(residual) / balance.weight),
        stiffness_asymmetry=float(np.linalg.norm(stiffness - stiffness.T) / 2 / np.linalg.norm(stiffness)),
        lower=box[0],
        upper=box[1],
    )
    return Equilibrium(
        position=position,
        force_residual=residual,
        stiffness=stiffness,
        eigenvalues=eigenvalues,
        directions=directions,
        stable=stable,
        moment=np.array(balance.moments(position[None, :])[0]),
        held=held,
        field=balance.flux_density(position),
        currents=balance.currents,
        others=np.array(ranked[1:]).reshape(-1, 3),
        volume_error=off,
        assumptions=(*rule_stated(payload, moment, 1e3 * off, "mm of the place"), *rests, *notes),
        report=report,
    )


def assumptions(moment: str) -> tuple[str, ...]:
    """Assumptions of the force on one magnet."""
    held = {
        "fixed": "the moment keeps its direction, up or down as the payload states",
        "aligned": "the moment stays parallel to the local field and keeps its magnitude",
    }[moment]
    return (
        held,
        "the currents are constant",
        "position means the magnet's centre; the sensor reads a point magnet_offset above it",
    )


def assumptions_of_pieces(payload: Payload) -> tuple[str, ...]:
    """Assumptions of the force on a payload of pieces."""
    return (
        f"the payload of {payload.description} stays upright",
        *magnetic_body(payload).assumptions,
        "the currents are constant",
        "position means the payload's centre; the sensor reads a point magnet_offset above it",
    )


def best_starts(grid: Array, unbalance: Array, box: Bounds) -> Array:
    """Grid points of least unbalanced force, no two closer than a fifth of the box."""
    scale = box[1] - box[0]
    chosen: list[Array] = []
    for index in np.argsort(unbalance, kind="stable"):
        if all(np.abs((grid[index] - other) / scale).max() > 0.2 for other in chosen):
            chosen.append(grid[index])
        if len(chosen) == MAX_STARTS:
            break
    return np.array(chosen)


def roots(balance: MagnetBalance, box: Bounds, starts: Array) -> list[Array]:
    """Distinct points of balance in the box that are reached from the starts (trust region, analytic derivative).

    The force of a map may jump between cells by up to the map's error, and the balance may lie in such a jump; a point
    there is accepted if there is no better one.
    """
    lower, upper = box
    inset = 1e-9 * (upper - lower)
    answers = [
        scipy.optimize.least_squares(
            lambda x: balance.residual(x[None, :])[0] / balance.weight,
            np.clip(start, lower + inset, upper - inset),
            jac=lambda x: -balance.residual_stiffness(x) / balance.weight,
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
    return _distinct(answers, TOLERANCE, apart) or _distinct(answers, largest_step(balance), apart)


def _distinct(answers: list[scipy.optimize.OptimizeResult], unbalance: float, apart: float) -> list[Array]:
    """Distinct places of the answers with a residual force of at most `unbalance` weights."""
    found: list[Array] = []
    for answer in answers:
        new = all(np.linalg.norm(answer.x - other) > apart for other in found)
        if new and np.linalg.norm(answer.fun) <= unbalance:
            found.append(answer.x)
    return found


def largest_step(balance: MagnetBalance) -> float:
    """Largest jump of the force between cells of a map, over the weight; 0 for a continuous field."""
    return balance.magnitude * balance.source.gradient_jump(balance.currents) / balance.weight


_ELSEWHERE = "at a place of your choice: fieldmap currents --lift, or currents_for of the map"


def _towards_lift(balance: MagnetBalance, payload: Payload, lift: float, drawn: float) -> str:
    """The remedy if the largest lift is too small for the weight. drawn: part of the iron's reaction in the lift, N."""
    body = balance.body if isinstance(balance, BodyBalance) else None
    magnets, soft = body is None or len(body.points) > 0, body is not None and bool(body.soft)
    if lift > max(drawn, 0.0):
        # Without magnets, the force on induced moments is proportional to the square of the currents.
        ratio = ((balance.weight - drawn) / (lift - drawn)) ** (1.0 if magnets else 0.5)
        by = "" if magnets and soft else f" ({ratio:.3g} times, if the iron is linear)"
        return f"raise the currents{by}, lighten the payload, or use a map that reaches nearer to the coils"
    if not balance.currents.any():
        return "turn the currents on"
    # Soft iron is pulled towards the stronger field for either sign of the currents.
    more = "put more current into the coils above"
    if magnets:
        over = "the rotation of the pieces" if payload.pieces else 'payload.direction = "down" or "up"'
        more = f"turn the polarity of the coils around, or the magnet ({over})"
    return f"{more}; those that hold the payload {_ELSEWHERE}"


def no_equilibrium(
    balance: MagnetBalance, payload: Payload, grid: Array, residuals: Array, tried: int
) -> NoEquilibrium:
    """The error that states the searched box and the available lift."""
    lift = residuals[:, 2] + balance.weight
    high, low = int(lift.argmax()), int(lift.argmin())
    nearest = int(np.linalg.norm(residuals, axis=1).argmin())

    def at(index: int) -> str:
        x, y, z = 1e3 * grid[index]
        return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"

    weight = balance.weight
    if lift[high] < weight:
        drawn = float(balance.reaction_force(grid[high : high + 1])[0, 2])
        remedy = _towards_lift(balance, payload, float(lift[high]), drawn)
    elif lift[low] > weight:
        remedy = "lower the currents, or use a map that reaches farther from the coils"
    else:
        more = "balance the currents, so that the sideways force vanishes inside the map's box"
        remedy = f"{more}; those that hold the payload {_ELSEWHERE}"
    where = f"find_equilibrium, {tried} starts in the box {at(0)} to {at(len(grid) - 1)}"
    must = f"the magnetic force must balance the weight {1e3 * weight:.4g} mN at some point"
    received = (
        f"lift from {1e3 * lift[low]:.4g} mN at {at(low)} to {1e3 * lift[high]:.4g} mN at {at(high)}; "
        f"least unbalanced force {1e3 * np.linalg.norm(residuals[nearest]):.3g} mN at {at(nearest)}"
    )
    return NoEquilibrium.of(where, must, received, remedy)

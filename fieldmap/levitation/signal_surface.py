"""Equilibrium positions of a magnet over two direction signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_positive, check_signal
from fieldmap.constants import GRAVITY
from fieldmap.currents import LiftAndDirections
from fieldmap.device.model import Payload
from fieldmap.errors import NoEquilibrium, OutsideMapError
from fieldmap.field import AnyField, Field, as_field, coil_currents, require_bounds
from fieldmap.levitation.balance import force_stated, magnet_balance, reaction_stated
from fieldmap.levitation.branches import equilibrium_at
from fieldmap.levitation.lift import idle_note, no_lift, signal_pushes
from fieldmap.levitation.places import box_of_centres, check_centre, check_position
from fieldmap.levitation.stationary import StationaryPoint
from fieldmap.lookup.payload import check_payload, magnetic_body
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class EquilibriumSurface(Record):
    """Equilibrium positions of a magnet over signals x (a,) and y (b,).

    positions (a, b, 3), m, and levels (a, b), A: the lift signal; NaN where no equilibrium is found in the map and its
    domain of currents. stable (a, b): whether the magnet is pushed back in both horizontal directions there.
    field_scale: factor on the force with which the lift equals the weight at the signals nearest to 0.
    """

    x_signals: Array
    y_signals: Array
    positions: Array
    levels: Array
    stable: NDArray[np.bool_]
    field_scale: float
    assumptions: tuple[str, ...]


def equilibrium_surface(
    field: AnyField,
    payload: Payload | None,
    x_signals: ArrayLike,
    y_signals: ArrayLike,
    level: float,
    height: float,
    parametrisation: LiftAndDirections | None = None,
    hold_height: bool = True,
    shares: Any = None,
) -> EquilibriumSurface:
    """Points without horizontal force at one height, for all pairs of direction signals.

    The search for each place starts at the place of the neighbour nearer to 0, so that one branch is followed. Currents
    are those of a `LiftAndDirections` parametrisation. Without one, or with shares, they are level (shares + x c_x + y
    c_y): c_x pushes along x only, with least power and a largest current of 1, at this height in the middle of the box,
    and c_y along y (docs/theory/closed_loop.md (24)). Along an axis on which the coils cannot push alone the signal has
    no effect, and the assumptions say so.

    Parameters
    ----------
    field
        Any `fieldmap.field.Field` with a box.
    payload
        The levitated body.
    x_signals
        (a,), 1.
    y_signals
        (b,), 1.
    level
        Lift signal, A.
    height
        z of the magnet's centre, m.
    parametrisation
        Parametrisation of the currents by signals; by default the one that the map was made for.
    hold_height
        Whether the level is adjusted to keep the lift at the signals nearest to 0 and at `level`, as a
        height controller does. Otherwise the level is constant, and the vertical force is not balanced.
    shares
        Currents per ampere of the level (n_coils,), 1 unless given.

    Returns
    -------
    EquilibriumSurface
        Places, levels and stability over the signals.

    Raises
    ------
    InputError
        For arguments that do not fit.
    OutsideMapError
        For a height or currents beyond the map.
    Infeasible
        Where the coils do not lift.
    NoEquilibrium
        If there is no equilibrium at the signals nearest to 0.

    Examples
    --------
    >>> m = open_map("maps/out/workspace.h5")                                           # doctest: +SKIP
    >>> s = [-0.3, -0.15, 0.0, 0.15, 0.3]                                               # doctest: +SKIP
    >>> equilibrium_surface(m, payload, s, s, level=1.558, height=-0.102).positions     # doctest: +SKIP
    """
    carried = check_payload(payload, "equilibrium_surface", pieces=True)
    check_positive("equilibrium_surface", level=level)
    x = np.atleast_1d(check_signal("equilibrium_surface(x_signals)", x_signals))
    y = np.atleast_1d(check_signal("equilibrium_surface(y_signals)", y_signals))
    source = as_field(field)
    low, high = require_bounds(source)
    middle = np.mean(box_of_centres((low, high), magnetic_body(carried).all_points), axis=0)
    of = getattr(source, "parametrisation", None) if parametrisation is None else parametrisation
    amperes: Callable[[Array], Array]
    if isinstance(of, LiftAndDirections) and shares is None:
        amperes, words = of.currents, f"currents by a lift and two directions with n = {of.n:g}"
    else:
        point = check_centre(
            (low, high), carried, np.append(middle[:2], height), "equilibrium_surface(height)"
        )
        amperes, words = _least_power(source, carried, point, level, 1.0 if shares is None else shares)
    positions, levels = np.full((len(x), len(y), 3), np.nan), np.full((len(x), len(y)), np.nan)
    stable = np.zeros(levels.shape, dtype=bool)
    errors: list[float] = []
    drawn: list[float] = []

    def rest(at: tuple[int, int], start: Array, begin: float, held: bool, scale: float) -> StationaryPoint:
        def path(u: float) -> tuple[Array, float]:
            return amperes(np.array([u, x[at[0]], y[at[1]]])), height

        point, levels[at] = equilibrium_at(source, carried, path, start, begin, held, scale)
        positions[at], stable[at] = point.position, point.kind == "stable"
        errors.append(point.volume_error)
        drawn.append(point.reaction)
        return point

    (centre, _), *others = _outward(x, y)
    begin = rest(centre, middle[:2], level, False, 1.0)
    by_field, weight = begin.lift - begin.reaction, carried.mass * GRAVITY
    scale = (weight - begin.reaction) / by_field if hold_height and by_field > 0 else 1.0
    for at, before in others:
        if np.isfinite(levels[before]):
            with suppress(NoEquilibrium, OutsideMapError):
                rest(at, positions[before][:2], float(levels[before]), hold_height, scale)
    follows = "the level follows, so that the lift stays what it is at the signals nearest to 0"
    constant = "the level is constant; the vertical force is left unbalanced"
    held = (
        *force_stated(carried, "fixed", errors),
        *reaction_stated(source, carried, drawn, "at most"),
        follows if hold_height else constant,
    )
    return EquilibriumSurface(
        x, y, positions, levels, stable, scale, (words, *held, "the payload stays upright")
    )


def _least_power(
    field: Field, payload: Payload, point: Array, level: float, shares: Any
) -> tuple[Callable[[Array], Array], str]:
    """A function from level and direction signals (3,) to currents (n_coils,) of least power, and a text about it."""
    lift = coil_currents(shares, field.coil_names)
    balance = magnet_balance(field, level * lift, payload, point, "fixed")
    check_position(balance.box, point, "equilibrium_surface(height)")
    gradient = field.gradient(point[None, :] + balance.arms.mean(axis=0), level * lift)
    by_field = (balance.magnetic_force(point[None, :]) - balance.reaction_force(point[None, :]))[0]
    if by_field[2] <= 1e-12 * balance.magnitude * np.linalg.norm(gradient):
        raise no_lift("equilibrium_surface", point)
    force = balance.force_per_current(point)
    pushes, idle = signal_pushes(force)
    words = "direction signals push with least power; a signal of 1 adds the level to a coil"
    words = "; ".join([words, *map(idle_note, idle)])
    return lambda signals: signals[0] * (lift + pushes @ signals[1:]), words


def _outward(x: Array, y: Array) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """All pairs of indices from the signals nearest to 0 outward, each with the neighbour from which it is reached."""
    i0, j0 = int(np.argmin(np.abs(x))), int(np.argmin(np.abs(y)))
    yield (i0, j0), (i0, j0)
    for i in sorted(range(len(x)), key=lambda i: abs(i - i0)):
        if i != i0:
            yield (i, j0), (i - int(np.sign(i - i0)), j0)
        for j in sorted(range(len(y)), key=lambda j: abs(j - j0)):
            if j != j0:
                yield (i, j), (i, j - int(np.sign(j - j0)))

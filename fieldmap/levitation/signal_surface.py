"""Where a magnet comes to rest over two signals of a current parametrisation."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_positive, check_signal
from fieldmap.currents import divide_currents
from fieldmap.deprecated import renamed_argument
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium, OutsideMapError, Problem
from fieldmap.field import AnyField, Field, as_field, require_bounds
from fieldmap.kernels.constants import GRAVITY
from fieldmap.levitation.balance import check_payload
from fieldmap.levitation.branches import equilibrium_at
from fieldmap.levitation.stationary import StationaryPoint
from fieldmap.typing import Array

_COILS = ("1", "2", "3", "4", "5", "6")


@dataclass(frozen=True, eq=False)
class EquilibriumSurface:
    """Places of a magnet over signals x (a,) and y (b,).

    positions (a, b, 3), m, and levels (a, b), A: the mean current; NaN where there is no such place in the map, or no
    current in its domain. stable (a, b): whether the magnet is pushed back in both horizontal directions there.
    field_scale: what the force was multiplied by so that the lift carries the weight at the signals nearest to 0.
    """

    x_signals: Array
    y_signals: Array
    positions: Array
    levels: Array
    stable: NDArray[np.bool_]
    field_scale: float
    assumptions: tuple[str, ...]


@renamed_argument("field_map", "field")
def equilibrium_surface(
    field: AnyField,
    payload: Payload | None,
    x_signals: ArrayLike,
    y_signals: ArrayLike,
    level: float,
    height: float,
    n: float = 1.25,
    hold_height: bool = True,
) -> EquilibriumSurface:
    """Points of no horizontal force at one height, for all pairs of direction signals of `divide_currents`.

    field: any `fieldmap.field.Field` with a box, of six coils named "1" to "6". x_signals (a,), y_signals (b,): of the
    division, 1. level: lift signal, mean current per coil, A. height: z of the magnet's centre, m. hold_height: the
    level follows, so that the lift stays what it is at the signals nearest to 0 and at `level`, as a controller of the
    height makes it; otherwise it is constant and the vertical force is left as it is. Each place is looked for from
    that of its neighbour nearer to 0, so that one branch is followed.

    Raises InputError for arguments that do not fit, OutsideMapError for a height beyond the map, and NoEquilibrium
    where there is none at the signals nearest to 0.

    >>> m = open_map("maps/out/division.h5")                                            # doctest: +SKIP
    >>> s = [-0.3, -0.15, 0.0, 0.15, 0.3]                                               # doctest: +SKIP
    >>> equilibrium_surface(m, payload, s, s, level=1.558, height=-0.102).positions     # doctest: +SKIP
    """
    carried = check_payload(payload, "equilibrium_surface")
    check_positive("equilibrium_surface", level=level, n=n)
    x = np.atleast_1d(check_signal("equilibrium_surface(x_signals)", x_signals))
    y = np.atleast_1d(check_signal("equilibrium_surface(y_signals)", y_signals))
    source = as_field(field)
    _check_coils(source)
    low, high = require_bounds(source)
    positions, levels = np.full((len(x), len(y), 3), np.nan), np.full((len(x), len(y)), np.nan)
    stable, middle = np.zeros(levels.shape, dtype=bool), 0.5 * (low + high)

    def rest(at: tuple[int, int], start: Array, begin: float, held: bool, scale: float) -> StationaryPoint:
        def path(u: float) -> tuple[Array, float]:
            return divide_currents(u, x[at[0]], y[at[1]], n), height

        point, levels[at] = equilibrium_at(source, carried, path, start, begin, held, scale)
        positions[at], stable[at] = point.position, point.kind == "stable"
        return point

    (centre, _), *others = _outward(x, y)
    lift = rest(centre, middle[:2], level, False, 1.0).lift
    scale = carried.mass * GRAVITY / lift if hold_height and lift > 0 else 1.0
    for at, before in others:
        if np.isfinite(levels[before]):
            with suppress(NoEquilibrium, OutsideMapError):
                rest(at, positions[before][:2], float(levels[before]), hold_height, scale)
    return EquilibriumSurface(x, y, positions, levels, stable, scale, _assumptions(hold_height, n))


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


def _check_coils(field: Field) -> None:
    if tuple(field.coil_names) != _COILS:
        raise InputError(
            Problem(
                "equilibrium_surface(field)",
                "must have the six coils of the current division (6-2), (6-3): 1 to 6",
                ", ".join(field.coil_names),
                "take a map of a drive unit",
            )
        )


def _assumptions(hold_height: bool, n: float) -> tuple[str, ...]:
    level = "the level follows, so that the lift stays what it is at the signals nearest to 0"
    return (
        f"currents by the division (6-2), (6-3) with n = {n:g}",
        level if hold_height else "the level is constant; the vertical force is left unbalanced",
        "the magnet is a point dipole that stays upright",
    )

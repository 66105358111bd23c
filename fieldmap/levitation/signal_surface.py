"""Where a magnet floats over two signals of a current parametrisation."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check_positive, check_signal
from fieldmap.currents import CurrentParametrisation, LiftAndDirections
from fieldmap.deprecated import renamed_argument
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium, OutsideMapError, Problem
from fieldmap.field import AnyField, Field, as_field, require_bounds
from fieldmap.kernels.constants import GRAVITY
from fieldmap.levitation.balance import check_payload
from fieldmap.levitation.branches import equilibrium_at
from fieldmap.levitation.stationary import StationaryPoint
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False)
class EquilibriumSurface:
    """Places of a magnet over two signals, x (a,) and y (b,).

    positions (a, b, 3), m, and levels (a, b): the level signal, A; NaN where there is no such place in the map, or no
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
@renamed_argument("n", "parametrisation")
def equilibrium_surface(
    field: AnyField,
    payload: Payload | None,
    x_signals: ArrayLike,
    y_signals: ArrayLike,
    level: float,
    height: float,
    parametrisation: CurrentParametrisation | float = 1.25,
    hold_height: bool = True,
    over: tuple[str, str] = ("x", "y"),
) -> EquilibriumSurface:
    """Points of no horizontal force at one height, for all pairs of two signals of a parametrisation.

    field: any `fieldmap.field.Field` with a box. parametrisation: of its coils; a number is the exponent of
    `LiftAndDirections`. over: names of the two signals, whose values are x_signals (a,) and y_signals (b,). level: the
    first of the other signals, which lifts; all further ones are 0. height: z of the magnet's centre, m. hold_height:
    the level follows, so that the lift stays what it is at the signals nearest to 0 and at `level`, as a controller of
    the height makes it; otherwise it is constant and the vertical force is left as it is. Each place is looked for
    from that of its neighbour nearer to 0, so that one branch is followed.

    Raises InputError for arguments that do not fit, OutsideMapError for a height beyond the map, and NoEquilibrium
    where there is none at the signals nearest to 0.

    >>> m = open_map("maps/out/division.h5")                                            # doctest: +SKIP
    >>> s = [-0.3, -0.15, 0.0, 0.15, 0.3]                                               # doctest: +SKIP
    >>> equilibrium_surface(m, payload, s, s, level=1.558, height=-0.102).positions     # doctest: +SKIP
    """
    carried = check_payload(payload, "equilibrium_surface")
    check_positive("equilibrium_surface", level=level)
    x = np.atleast_1d(check_signal("equilibrium_surface(x_signals)", x_signals))
    y = np.atleast_1d(check_signal("equilibrium_surface(y_signals)", y_signals))
    source = as_field(field)
    of = parametrisation
    signals = of if isinstance(of, CurrentParametrisation) else LiftAndDirections(of)
    lift_at, x_at, y_at = _places(source, signals, over)
    low, high = require_bounds(source)
    positions, levels = np.full((len(x), len(y), 3), np.nan), np.full((len(x), len(y)), np.nan)
    stable, middle = np.zeros(levels.shape, dtype=bool), 0.5 * (low + high)

    def equilibrium(
        at: tuple[int, int], start: Array, begin: float, held: bool, scale: float
    ) -> StationaryPoint:
        def path(u: float) -> tuple[Array, float]:
            values = np.zeros(signals.signal_count)
            values[lift_at], values[x_at], values[y_at] = u, x[at[0]], y[at[1]]
            return signals.currents(values), height

        point, levels[at] = equilibrium_at(source, carried, path, start, begin, held, scale)
        positions[at], stable[at] = point.position, point.kind == "stable"
        return point

    (centre, _), *others = _outward(x, y)
    lift = equilibrium(centre, middle[:2], level, False, 1.0).lift
    scale = carried.mass * GRAVITY / lift if hold_height and lift > 0 else 1.0
    for at, before in others:
        if np.isfinite(levels[before]):
            with suppress(NoEquilibrium, OutsideMapError):
                equilibrium(at, positions[before][:2], float(levels[before]), hold_height, scale)
    return EquilibriumSurface(x, y, positions, levels, stable, scale, _assumptions(hold_height, signals))


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


def _places(field: Field, signals: CurrentParametrisation, over: tuple[str, str]) -> tuple[int, int, int]:
    """Where the level and the two signals stand among all. Raises InputError."""
    names, problems = signals.signal_names, []
    where = "equilibrium_surface"
    if len(field.coil_names) != signals.coil_count:
        must_hold = f"must be one of {signals.coil_count} coils, as {signals} has them"
        received = f"{len(field.coil_names)}: {', '.join(field.coil_names)}"
        problems.append(
            Problem(f"{where}(field)", must_hold, received, "give the parametrisation of its coils")
        )
    if len(names) < 3 or len({*over} & {*names}) != 2:
        must_hold = f"must be two of {', '.join(names)}, and leave one that lifts"
        problems.append(Problem(f"{where}(over)", must_hold, f"{over}", "name two signals"))
    if problems:
        raise InputError(*problems)
    level = next(k for k, name in enumerate(names) if name not in over)
    return level, names.index(over[0]), names.index(over[1])


def _assumptions(hold_height: bool, signals: CurrentParametrisation) -> tuple[str, ...]:
    level = "the level follows, so that the lift stays what it is at the signals nearest to 0"
    return (
        f"currents by {signals}",
        level if hold_height else "the level is constant; the vertical force is left unbalanced",
        "the magnet is a point dipole that stays upright",
    )

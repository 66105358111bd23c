"""All points of a window, at one height, where the horizontal force on a lifted vertical dipole vanishes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from fieldmap.arguments import check_count, check_numbers, check_ordered
from fieldmap.field import Currents
from fieldmap.planar.saturating import PlanarState
from fieldmap.planar.solution import PlanarFieldAtCurrents, PlanarSolution
from fieldmap.records import Record
from fieldmap.typing import Array

_TOLERANCE = 1e-10


@dataclass(frozen=True, repr=False)
class StationaryPoint(Record):
    """dB_z/dx = 0 at x, m. stable: whether a vertical dipole that the field lifts is pushed back along x.

    stiffness: -d2Bz/dx2 times the sign of dB_z/dz, T/m2: restoring force per displacement and dipole moment. Along z
    it has the opposite sign (div B = curl B = 0), so that no point is stable in both: Earnshaw's theorem.
    """

    x: float
    stable: bool
    stiffness: float


def stationary_points(
    unit: PlanarSolution | PlanarState,
    currents: Currents,
    z: float,
    lower: float,
    upper: float,
    samples: int = 400,
) -> tuple[StationaryPoint, ...]:
    """All x of a window at a height where dB_z/dx = 0.

    Zeros are bracketed by equal steps; two that lie within one step are found by the extremum between them.

    Parameters
    ----------
    unit
        The solution.
    currents
        Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by name.
    z
        Height, m.
    lower, upper
        Ends of the window, x, m.
    samples
        Number of steps.

    Returns
    -------
    tuple[StationaryPoint, ...]
        The points, in the order of x.

    Raises
    ------
    InputError
        For a window that does not rise or points without a field.

    Examples
    --------
    >>> from fieldmap.planar import read_planar_device, solve_planar, stationary_points
    >>> unit = solve_planar(read_planar_device("planar_drive_unit"))
    >>> for point in stationary_points(unit, [800.0, 1200.0], -0.07, -0.16, 0.16):
    ...     print(f"{1e3 * point.x:.0f} mm", "stable" if point.stable else "unstable")
    -90 mm stable
    -31 mm unstable
    99 mm stable
    """
    check_numbers("stationary_points", z=z, lower=lower, upper=upper)
    check_ordered("stationary_points", lower, upper)
    check_count("stationary_points", samples=samples)

    state = unit.at(currents)

    def slope(x: float) -> float:
        return float(state.derivatives([[x, z]])[1].imag[0])

    def bend(x: float) -> float:
        return float(state.derivatives([[x, z]])[2].imag[0])

    places = np.linspace(lower, upper, samples + 1)
    _, first, second = state.derivatives(np.column_stack([places, np.full(samples + 1, z)])).imag
    brackets = _brackets(places, first, second, slope, bend)
    zeros = [float(brentq(slope, a, b, xtol=_TOLERANCE)) for a, b in brackets]
    zeros += [float(x) for x in places[first == 0.0]]
    return tuple(_point(state, x, z) for x in sorted(zeros))


def _brackets(
    places: Array,
    first: Array,
    second: Array,
    slope: Callable[[float], float],
    bend: Callable[[float], float],
) -> list[tuple[float, float]]:
    """Intervals with one change of sign each."""
    found = []
    for a, b, fa, fb, sa, sb in zip(
        places[:-1], places[1:], first[:-1], first[1:], second[:-1], second[1:], strict=True
    ):
        if fa * fb < 0:
            found.append((a, b))
        elif fa * fb > 0 and sa * sb < 0 and fa * sa < 0:
            middle = float(brentq(bend, a, b, xtol=_TOLERANCE))
            if slope(middle) * fa < 0:
                found += [(a, middle), (middle, b)]
    return found


def _point(state: PlanarFieldAtCurrents, x: float, z: float) -> StationaryPoint:
    _, first, second = state.derivatives([[x, z]])[:, 0]
    # dBz/dz = -Re f', d2Bz/dx2 = -Im f''.
    stiffness = float(-np.sign(-first.real) * -second.imag)
    return StationaryPoint(x, stiffness > 0, stiffness)

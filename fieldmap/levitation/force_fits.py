"""Constants of the force formulas from computed or measured forces, by least squares."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from fieldmap.arguments import check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.levitation.force_formulas import Exponential, HorizontalForce, QuadraticForce, VerticalForce
from fieldmap.typing import Array

Formula = TypeVar("Formula")
# Smallest bracket of (4-7) on the data that a fit may end with: nearer, the pole lies among the data.
_SMALLEST_BRACKET = 0.05
# Longest length, m, that a fit may end with: there its coordinate no longer plays a part.
_LONGEST = 100.0


@dataclass(frozen=True)
class Fit(Generic[Formula]):
    """A formula with fitted constants, and the root mean square and largest error on the data, N."""

    formula: Formula
    rms: float
    largest: float


def fit_horizontal_force(
    x: ArrayLike,
    z: ArrayLike,
    force: ArrayLike,
    nominal_current: float,
    x0: float = 0.0,
    y: ArrayLike | None = None,
    side: int = 1,
    a: float | None = None,
    start: tuple[float, float, float] = (0.2, 0.05, 0.05),
) -> Fit[HorizontalForce]:
    """Constants of (4-7), (4-8), or of (4-9) where y is given, for forces (n,) in N at the nominal current.

    x, z, y (n,) in m, z the depth. a: held at this value, m; None: fitted. Where all z are equal it must be held,
    because only two of L0, a, b are determined by such data. start: a, b and d in m to begin with. L0 and c enter
    linearly and are eliminated; a, b, d are kept between 0 and 100 m, where a coordinate no longer plays a part.
    Raises InputError for arrays of unequal length, fewer data than constants, or one depth with a free.

    >>> true = HorizontalForce(-2e-13, 0.22, 0.05, -0.08, x0=-0.17, nominal_current=1e6)
    >>> x, z = (grid.ravel() for grid in np.meshgrid(np.linspace(-0.15, 0.15, 13), [0.10, 0.125, 0.15]))
    >>> found = fit_horizontal_force(x, z, true(x, z, 1e6), 1e6, x0=-0.17, start=(0.1, 0.1, 1.0)).formula
    >>> print(f"{found.inductance:.3g} {found.a:.3g} {found.b:.3g} {found.c:.3g}")
    -2e-13 0.22 0.05 -0.08
    """
    check_positive("fit_horizontal_force", nominal_current=nominal_current)
    columns = (x, z, force) if y is None else (x, z, force, y)
    data = _data("fit_horizontal_force", len(columns) + 1, *columns)
    if a is None and not np.ptp(data[1]):
        _refuse_one_depth("fit_horizontal_force(a)", "at least two depths, or a held", "hold a")
    shape = _Bracket(side * (data[0] - x0), data[1], None if y is None else np.abs(data[3]), a)

    def linear(logs: Array) -> tuple[Array, Array]:
        bracket = np.maximum(shape(logs), _SMALLEST_BRACKET)
        matrix = np.column_stack([bracket**-2.0, np.ones_like(bracket)])
        solution = np.linalg.lstsq(matrix, side * data[2], rcond=None)[0]
        return solution, matrix @ solution - side * data[2]

    scale = float(np.abs(data[2]).max()) or 1.0
    first = np.log([*start[a is not None : 2 + (y is not None)]])
    limits = -np.inf, np.log(_LONGEST)
    found = least_squares(
        lambda logs: linear(logs)[1] / scale, first, bounds=limits, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    (strength, c), error = linear(found.x)
    a, b, d = shape.lengths(found.x)
    inductance = float(-2.0 * b * strength / nominal_current**2)
    return Fit(HorizontalForce(inductance, a, b, float(c), x0, nominal_current, d, side), *_errors(error))


@dataclass(frozen=True, eq=False)
class _Bracket:
    """1 + z/a + u/b + |y|/d on the data, as a function of the logarithms of the lengths that are free."""

    along: Array
    depth: Array
    beside: Array | None
    held: float | None

    def lengths(self, logs: Array) -> tuple[float, float, float]:
        free = [float(value) for value in np.exp(logs)]
        a = free.pop(0) if self.held is None else self.held
        return a, free[0], free[1] if self.beside is not None else np.inf

    def __call__(self, logs: Array) -> Array:
        a, b, d = self.lengths(logs)
        return 1.0 + self.depth / a + self.along / b + (0.0 if self.beside is None else self.beside / d)


def fit_vertical_force(
    x: ArrayLike, z: ArrayLike, force: ArrayLike, nominal_current: float, x0: float
) -> Fit[VerticalForce]:
    """Constants of (4-6) for forces (n,) in N at positions (n,) in m: straight lines in z for every x, then (4-4).

    As the thesis does it: slope and intercept at each x first, then an exponential through each of them. Raises
    InputError for arrays of unequal length or fewer than two depths at an x.
    """
    check_positive("fit_vertical_force", nominal_current=nominal_current)
    data = _data("fit_vertical_force", 4, x, z, force)
    places = np.unique(data[0])
    lines = np.empty((len(places), 2))
    for k, place in enumerate(places):
        mine = data[0] == place
        if not np.ptp(data[1][mine]):
            _refuse_one_depth("fit_vertical_force(z)", "at least two depths at every x", "add some")
        lines[k] = np.polyfit(data[1][mine], data[2][mine], 1)
    slope, intercept = (_exponential(places, values, x0) for values in lines.T)
    formula = VerticalForce(slope, intercept, nominal_current)
    return Fit(formula, *_errors(formula(data[0], data[1], nominal_current) - data[2]))


def fit_quadratic_force(x: ArrayLike, force: ArrayLike, nominal_current: float = 1.0) -> Fit[QuadraticForce]:
    """Coefficients of (4-10) for forces (n,) in N along one line, x (n,) in m."""
    data = _data("fit_quadratic_force", 3, x, force)
    a0, a1, a2 = (float(value) for value in np.polyfit(data[0], data[1], 2))
    formula = QuadraticForce((a0, a1, a2), nominal_current)
    return Fit(formula, *_errors(formula(data[0], nominal_current) - data[1]))


def _exponential(x: Array, values: Array, x0: float) -> Exponential:
    """A exp(-b (x - x0)) by least squares; A enters linearly and is eliminated."""

    def amplitude(decay: float) -> float:
        shape = np.exp(-decay * (x - x0))
        return float(shape @ values / (shape @ shape))

    def residual(decay: Array) -> Array:
        return amplitude(float(decay[0])) * np.exp(-decay[0] * (x - x0)) - values

    decay = float(least_squares(residual, [1.0 / max(float(np.ptp(x)), 1e-12)]).x[0])
    return Exponential(amplitude(decay), decay, x0)


def _refuse_one_depth(where: str, must_hold: str, remedy: str) -> None:
    raise InputError(Problem(where, must_hold, "one depth", remedy))


def _data(where: str, least: int, *columns: ArrayLike) -> list[Array]:
    arrays = [check_signal(where, column).ravel() for column in columns]
    if len({len(array) for array in arrays}) != 1 or len(arrays[0]) < least:
        received = ", ".join(str(len(array)) for array in arrays)
        raise InputError(
            Problem(
                where, f"arrays of one length, {least} or more", f"lengths {received}", "give as many of each"
            )
        )
    return arrays


def _errors(error: Array) -> tuple[float, float]:
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())

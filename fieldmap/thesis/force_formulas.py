"""Closed formulas for the force of one electromagnet on a levitated dipole, as chapter 4 of the thesis assumes them.

Depth z is positive downwards from the pole piece, as in the thesis; forces in N. The formulas are fits, not physics:
docs/theory/force_formulas.md gives their errors.
"""

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from fieldmap.arguments import check_positive, check_signal
from fieldmap.errors import InputError
from fieldmap.records import Record
from fieldmap.typing import Array

Formula = TypeVar("Formula")
# Smallest bracket of (4-7) in a fit. It keeps the pole of the formula away from the data.
_SMALLEST_BRACKET = 0.05
# Largest length a, b or d in a fit, m. A length this large makes its coordinate irrelevant.
_LONGEST = 100.0


@dataclass(frozen=True)
class HorizontalForce(Record):
    """F_x = side [ -I I0 L0 / (2 b (1 + z/a + side (x - x0)/b + |y|/d)^2) + c I/I0 ].

    side 1 is (4-7), (4-5) at I = I0, and (4-9) with x0 = 0; side -1 is the mirror image (4-8). inductance L0 in H,
    lengths a, b, x0 in m, offset c in N, nominal_current I0 in A; d in m, or infinity for no dependence on y. Singular
    where the bracket in the denominator vanishes.

    >>> force = HorizontalForce(-2e-13, 0.22, 0.05, -0.08, x0=-0.17, nominal_current=1e6)  # Table 4-2
    >>> round(float(force(0.0, 0.125, 1e6)), 5), round(float(force.mirrored()(0.0, 0.125, 1e6)), 5)
    (0.00103, -0.00103)
    """

    inductance: float
    a: float
    b: float
    c: float
    x0: float = 0.0
    nominal_current: float = 1.0
    d: float = np.inf
    side: int = 1

    def bracket(self, x: ArrayLike, z: ArrayLike, y: ArrayLike = 0.0) -> Array:
        """1 + z/a + side (x - x0)/b + |y|/d; the formula has a pole where it is 0.

        Parameters
        ----------
        x, z, y
            Position, m.

        Returns
        -------
        Array
            The number.
        """
        along = self.side * (np.asarray(x, dtype=float) - self.x0)
        return 1.0 + np.asarray(z, dtype=float) / self.a + along / self.b + np.abs(y) / self.d

    def __call__(self, x: ArrayLike, z: ArrayLike, current: float, y: ArrayLike = 0.0) -> Array:
        """Force (n,) in N at positions (n,) in m, current in A."""
        attraction = -current * self.nominal_current * self.inductance / (2.0 * self.b)
        force = attraction / self.bracket(x, z, y) ** 2 + self.c * current / self.nominal_current
        return np.asarray(self.side * force)

    def mirrored(self) -> "HorizontalForce":
        """The electromagnet at the other end of the pole piece: (4-8)."""
        return replace(self, x0=-self.x0, side=-self.side)


@dataclass(frozen=True)
class Exponential(Record):
    """A exp(-side b (x - x0)), (4-4)."""

    amplitude: float
    decay: float
    x0: float
    side: int = 1

    def __call__(self, x: ArrayLike) -> Array:
        """Value (n,) at x (n,) in m."""
        from_end = np.asarray(x, dtype=float) - self.x0
        return np.asarray(self.amplitude * np.exp(-self.side * self.decay * from_end))


@dataclass(frozen=True, repr=False)
class VerticalForce(Record):
    """F_z = (m(x) z + b(x)) I/I0 with exponentials m and b, (4-3), (4-4), (4-6). Upwards is positive."""

    slope: Exponential
    intercept: Exponential
    nominal_current: float

    def __call__(self, x: ArrayLike, z: ArrayLike, current: float) -> Array:
        """Force (n,) in N at positions (n,) in m, current in A."""
        line = self.slope(x) * np.asarray(z, dtype=float) + self.intercept(x)
        return np.asarray(line * current / self.nominal_current)

    def mirrored(self) -> "VerticalForce":
        """The electromagnet at the other end of the pole piece."""
        slope, intercept = (replace(one, x0=-one.x0, side=-one.side) for one in (self.slope, self.intercept))
        return VerticalForce(slope, intercept, self.nominal_current)


@dataclass(frozen=True, repr=False)
class QuadraticForce(Record):
    """F_x = (a0 x^2 + a1 x + a2) I/I0, (4-10): coefficients for one line of constant y and z."""

    coefficients: tuple[float, float, float]
    nominal_current: float = 1.0

    def __call__(self, x: ArrayLike, current: float) -> Array:
        """Force (n,) in N at x (n,) in m."""
        (a0, a1, a2), places = self.coefficients, np.asarray(x, dtype=float)
        return np.asarray((a0 * places**2 + a1 * places + a2) * current / self.nominal_current)


@dataclass(frozen=True, repr=False)
class Fit(Record, Generic[Formula]):
    """A formula with fitted constants, and its root mean square and largest error on the data, N."""

    formula: Formula
    rms: float
    largest: float


@dataclass(frozen=True, repr=False)
class AddedError(Record):
    """Error of the added formulas of single electromagnets against the computed force of all.

    currents: nonzero currents over the nominal current; rms: root mean square error, N; whole and middle: root mean
    square error over that of the computed force, on the whole line and in its middle, where forces cancel.
    """

    currents: tuple[float, ...]
    rms: float
    whole: float
    middle: float

    @property
    def rms_mN(self) -> float:  # noqa: N802 - the unit
        """rms in mN."""
        return 1e3 * self.rms


def added_error(
    currents: tuple[float, ...], added: Array, computed: Array, middle: NDArray[np.bool_]
) -> AddedError:
    """Error of added forces (n,), N; middle (n,): whether a point lies in the middle."""
    error = added - computed
    shares = [_rms(error[places]) / _rms(computed[places]) for places in (np.full_like(middle, True), middle)]
    return AddedError(tuple(current for current in currents if current), _rms(error), *shares)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


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
    """Constants of (4-7), (4-8), or of (4-9) if y is given, from forces.

    L0 and c enter linearly and are eliminated; a, b, d are kept between 0 and 100 m, where they no longer matter.

    Parameters
    ----------
    x
        Positions (n,), m.
    z
        Depths (n,), m.
    force
        (n,), N, at the nominal current.
    nominal_current
        Nominal current, A.
    x0
        End of the pole piece in the formula, m.
    y
        Positions (n,), m, for (4-9).
    side
        +1 or -1, of the formula.
    a
        Fixed value, m; fitted by default. If all z are equal, a must be fixed, because such data determine only
        two of L0, a, b.
    start
        Start values of a, b and d, m.

    Returns
    -------
    Fit[HorizontalForce]
        The formula and its errors.

    Raises
    ------
    InputError
        For arrays of unequal length, fewer data than constants, or one depth with a free.

    Examples
    --------
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
        raise InputError.of(
            "fit_horizontal_force(a)", "at least two depths, or a held", "one depth", "hold a"
        )
    along, beside = side * (data[0] - x0), 0.0 if y is None else np.abs(data[3])

    def lengths(logs: Array) -> tuple[float, float, float]:
        free = np.exp(logs).tolist()
        return (free.pop(0) if a is None else a), free[0], np.inf if y is None else free[1]

    def linear(logs: Array) -> tuple[Array, Array]:
        of_z, of_x, of_y = lengths(logs)
        bracket = 1.0 + data[1] / of_z + along / of_x + beside / of_y
        bracket = np.maximum(bracket, _SMALLEST_BRACKET)
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
    a, b, d = lengths(found.x)
    inductance = float(-2.0 * b * strength / nominal_current**2)
    return Fit(HorizontalForce(inductance, a, b, float(c), x0, nominal_current, d, side), *_errors(error))


def fit_vertical_force(
    x: ArrayLike, z: ArrayLike, force: ArrayLike, nominal_current: float, x0: float
) -> Fit[VerticalForce]:
    """Constants of (4-6) from forces: straight lines in z for every x, then (4-4).

    As in the thesis, slope and intercept are fitted at each x first, and then an exponential to each of the two.

    Parameters
    ----------
    x
        Positions (n,), m.
    z
        Depths (n,), m.
    force
        (n,), N, at the nominal current.
    nominal_current
        Nominal current, A.
    x0
        Reference position of the exponentials, m.

    Returns
    -------
    Fit[VerticalForce]
        The formula and its errors.

    Raises
    ------
    InputError
        For arrays of unequal length or fewer than two depths at an x.
    """
    check_positive("fit_vertical_force", nominal_current=nominal_current)
    data = _data("fit_vertical_force", 4, x, z, force)
    places = np.unique(data[0])
    lines = np.empty((len(places), 2))
    for k, place in enumerate(places):
        mine = data[0] == place
        if not np.ptp(data[1][mine]):
            must_hold = "at least two depths at every x"
            raise InputError.of("fit_vertical_force(z)", must_hold, "one depth", "add some")
        lines[k] = np.polyfit(data[1][mine], data[2][mine], 1)
    slope, intercept = (_exponential(places, values, x0) for values in lines.T)
    formula = VerticalForce(slope, intercept, nominal_current)
    return Fit(formula, *_errors(formula(data[0], data[1], nominal_current) - data[2]))


def fit_quadratic_force(x: ArrayLike, force: ArrayLike, nominal_current: float = 1.0) -> Fit[QuadraticForce]:
    """Coefficients of (4-10) from forces along one line.

    Parameters
    ----------
    x
        Positions (n,), m.
    force
        (n,), N.
    nominal_current
        Nominal current, A.

    Returns
    -------
    Fit[QuadraticForce]
        The formula and its errors.
    """
    data = _data("fit_quadratic_force", 3, x, force)
    formula = QuadraticForce(tuple(np.polyfit(data[0], data[1], 2).tolist()), nominal_current)
    return Fit(formula, *_errors(formula(data[0], nominal_current) - data[1]))


def _exponential(x: Array, values: Array, x0: float) -> Exponential:
    """A exp(-b (x - x0)) by least squares; A enters linearly and is eliminated."""

    def amplitude(decay: float) -> float:
        shape = np.exp(-decay * (x - x0))
        return float(shape @ values / (shape @ shape))

    def residual(decay: Array) -> Array:
        return amplitude(float(decay[0])) * np.exp(-decay[0] * (x - x0)) - values

    decay = float(least_squares(residual, [0.0]).x[0])
    return Exponential(amplitude(decay), decay, x0)


def _data(where: str, least: int, *columns: ArrayLike) -> list[Array]:
    arrays = [check_signal(where, column).ravel() for column in columns]
    if len({len(array) for array in arrays}) != 1 or len(arrays[0]) < least:
        received = ", ".join(str(len(array)) for array in arrays)
        must_hold = f"arrays of one length, {least} or more"
        raise InputError.of(where, must_hold, f"lengths {received}", "give as many of each")
    return arrays


def _errors(error: Array) -> tuple[float, float]:
    return _rms(error), float(np.abs(error).max())

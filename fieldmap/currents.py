"""Parametrisations, which turn a few control signals into the currents of all coils, and boxes of signals.

A controller seldom drives every coil independently. A parametrisation gives the currents (n_coils,) of signals
(n_signals,), their derivatives, and the signals of given currents. A map of saturating iron is valid in a
`CurrentDomain`, a box of signals, and stores its parametrisation by name and parameters.

`IndependentCurrents`: each signal is the current of one coil. `CoilGroups`: each signal is the current of a group of
coils. `LiftAndDirections`: six coils in two rows of three, driven by one lift and two direction signals. A further
parametrisation is a class that derives from `CurrentParametrisation` and is decorated with `register`.

Depends on: errors, arguments, numpy.
"""

from __future__ import annotations

import itertools
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fieldmap.arguments import check, check_count, check_positive, check_signal
from fieldmap.errors import InputError
from fieldmap.plain import Plain, plain_items
from fieldmap.records import Record, tuple_line
from fieldmap.typing import Array

TOLERANCE = 1e-6
"""Largest relative difference between given currents and the currents of their nearest signals."""
ROUNDING = 1e-9
"""Signals that lie beyond a domain by less than this share of its range count as inside."""


class NearestSignals(NamedTuple):
    """Signals (..., n_signals) with the currents nearest to given currents, and the relative mismatch (...).

    The mismatch is relative to the mean or the largest current, depending on the parametrisation. It is infinite where
    no signals exist.
    """

    values: Array
    mismatch: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The arrays by their names, as plain Python."""
        return plain_items(**self._asdict())


class CompiledParametrisation(NamedTuple):
    """A parametrisation for the C core. division: whether six currents come from `LiftAndDirections` with `exponent`;
    otherwise currents = matrix (n_coils, n_signals) @ signals. Unused entries are zero or empty."""

    division: bool
    exponent: float
    matrix: Array

    def __repr__(self) -> str:
        return tuple_line(self)


class CurrentParametrisation(ABC):
    """Turns signals (..., n_signals) into currents (..., n_coils), A. Frozen; equal if name and parameters are."""

    name: ClassVar[str]
    """Name under which the class is registered and stored."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """Arguments of the constructor, as plain JSON."""

    @property
    @abstractmethod
    def coil_count(self) -> int:
        """Number of currents."""

    @property
    @abstractmethod
    def signal_names(self) -> tuple[str, ...]:
        """Short names, in the order of the signals."""

    @property
    def signal_units(self) -> tuple[str, ...]:
        """Unit of each signal, "A" or "1"."""
        return ("A",) * len(self.signal_names)

    @abstractmethod
    def currents(self, signals: ArrayLike) -> Array:
        """Currents of signals.

        Parameters
        ----------
        signals
            Signals (..., n_signals).

        Returns
        -------
        Array
            Currents (..., n_coils), A.

        Raises
        ------
        InputError
            For signals that are not finite.
        """

    @abstractmethod
    def derivative(self, signals: ArrayLike) -> Array:
        """Derivative of the currents by the signals.

        Parameters
        ----------
        signals
            Signals (..., n_signals).

        Returns
        -------
        Array
            d currents / d signals (..., n_coils, n_signals).
        """

    @abstractmethod
    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """The signals whose currents are nearest to given ones.

        Parameters
        ----------
        currents
            Currents (..., n_coils), A.

        Returns
        -------
        NearestSignals
            The signals, and how far their currents are off.
        """

    @abstractmethod
    def largest(self, lower: Array, upper: Array) -> Array:
        """Largest size of every current in a box of signals.

        Parameters
        ----------
        lower, upper
            Corners (n_signals,) of the box.

        Returns
        -------
        Array
            Largest sizes (n_coils,), A.
        """

    @abstractmethod
    def kernel(self) -> CompiledParametrisation:
        """The parametrisation in the form that the C core takes."""

    def within(self, lower: Array, upper: Array, shares: Array) -> Array:
        """Signals at shares of a domain: of the box, cut where the parametrisation limits the currents.

        Parameters
        ----------
        lower, upper
            Corners (n_signals,) of the domain.
        shares
            Shares (..., n_signals) of the ranges, 0 to 1.

        Returns
        -------
        Array
            Signals (..., n_signals).
        """
        return np.asarray(lower + shares * (upper - lower))

    def excess(self, signals: Array) -> float:
        """Relative excess of the largest current over the limit of the parametrisation.

        Parameters
        ----------
        signals
            Signals (n_signals,).

        Returns
        -------
        float
            The excess: 0 or less within the limit, -1 without a limit.
        """
        return -1.0

    def signals(self, currents: ArrayLike, tolerance: float = TOLERANCE) -> Array:
        """Signals of currents: the inverse of `currents`.

        Parameters
        ----------
        currents
            Currents (..., n_coils), A.
        tolerance
            Largest relative mismatch of the currents.

        Returns
        -------
        Array
            Signals (..., n_signals); NaN where no signals give these currents up to the tolerance.
        """
        found = self.nearest(currents)
        return np.where((found.mismatch <= tolerance)[..., None], found.values, np.nan)

    @property
    def signal_count(self) -> int:
        """Number of signals."""
        return len(self.signal_names)

    def to_json(self) -> str:
        """Name and parameters as a text that `parametrisation_from_json` reads."""
        return json.dumps({"name": self.name, "parameters": self.parameters}, sort_keys=True)


_registered: dict[str, type[CurrentParametrisation]] = {}
P = TypeVar("P", bound=type[CurrentParametrisation])


def register(kind: P) -> P:
    """Class decorator: make a parametrisation known by its name.

    Parameters
    ----------
    kind
        The class.

    Returns
    -------
    P
        The class.

    Raises
    ------
    ValueError
        For a name that is taken.
    """
    if _registered.setdefault(kind.name, kind) is not kind:
        raise ValueError(f"parametrisation {kind.name!r} is registered already")
    return kind


def parametrisation(name: str, parameters: Mapping[str, Any]) -> CurrentParametrisation:
    """Make the parametrisation that is registered under a name.

    Parameters
    ----------
    name
        Name of the class.
    parameters
        Arguments of its constructor, plain JSON.

    Returns
    -------
    CurrentParametrisation
        The parametrisation.

    Raises
    ------
    InputError
        For an unknown name, or parameters that do not fit.

    Examples
    --------
    >>> parametrisation("lift and directions", {"n": 1.25}).signal_names
    ('u', 'x', 'y')
    """
    must = f"must be one of {', '.join(_registered)}"
    remedy = "install the version that knows it"
    check(name in _registered, "current parametrisation", must, repr(name), remedy)
    try:
        return _registered[name](**parameters)
    except TypeError as error:
        where, remedy = f"current parametrisation {name!r}", "install the version that knows them"
        raise InputError.of(where, "must have its parameters", str(error), remedy) from error


def parametrisation_from_json(text: str) -> CurrentParametrisation:
    """The parametrisation that `CurrentParametrisation.to_json` describes.

    Parameters
    ----------
    text
        The description.

    Returns
    -------
    CurrentParametrisation
        The parametrisation.

    Raises
    ------
    InputError, ValueError, KeyError or TypeError
        For a text that describes no parametrisation.
    """
    content = json.loads(text)
    return parametrisation(content["name"], content["parameters"])


class _Grouped(CurrentParametrisation):
    """Each signal is the current of a group of coils in series, A."""

    groups: tuple[tuple[int, ...], ...]
    """Numbers of the coils of each group, from 0; every coil is in one group."""

    @property
    def coil_count(self) -> int:
        """Number of currents."""
        return sum(len(group) for group in self.groups)

    @property
    def matrix(self) -> Array:
        """Currents (n_coils, n_groups) with 1 A in one group at a time."""
        return np.eye(len(self.groups))[self._group_of]

    def currents(self, signals: ArrayLike) -> Array:
        """Every coil has the current of its group."""
        return check_signal("signals", signals, columns=len(self.groups)).take(self._group_of, axis=-1)

    def derivative(self, signals: ArrayLike) -> Array:
        """`matrix`, at all signals."""
        leading = check_signal("signals", signals, columns=len(self.groups)).shape[:-1]
        return np.tile(self.matrix, (*leading, 1, 1))

    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """The mean current of each group. The mismatch is the largest difference over the largest current."""
        given = check_signal("currents", currents, columns=self.coil_count)
        matrix = self.matrix
        values = given @ matrix / matrix.sum(axis=0)
        off, size = np.abs(self.currents(values) - given).max(axis=-1), np.abs(given).max(axis=-1)
        return NearestSignals(values, off / np.where(size > 0.0, size, 1.0))

    def largest(self, lower: Array, upper: Array) -> Array:
        """The larger absolute limit of each group's range."""
        return np.maximum(np.abs(lower), np.abs(upper))[self._group_of]

    def kernel(self) -> CompiledParametrisation:
        """`matrix`."""
        return CompiledParametrisation(False, 0.0, self.matrix)

    @cached_property
    def _group_of(self) -> NDArray[np.intp]:
        place = {k: number for number, group in enumerate(self.groups) for k in group}
        return np.array([place[k] for k in range(len(place))], dtype=np.intp)


@register
@dataclass(frozen=True)
class IndependentCurrents(_Grouped, Record):
    """Each signal is the current of one coil, A.

    >>> IndependentCurrents(2).currents([1.0, 2.0])
    array([1., 2.])
    """

    name: ClassVar[str] = "independent"
    coils: int

    def __post_init__(self) -> None:
        check_count("IndependentCurrents", coils=self.coils)

    @property
    def parameters(self) -> dict[str, Any]:
        """The number of coils."""
        return {"coils": int(self.coils)}

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:  # type: ignore[override]
        """One coil each."""
        return tuple((k,) for k in range(self.coils))

    @property
    def signal_names(self) -> tuple[str, ...]:
        """ "i1", "i2" and so on."""
        return tuple(f"i{k + 1}" for k in range(self.coils))

    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """The currents themselves, with mismatch zero."""
        values = check_signal("currents", currents, columns=self.coils)
        return NearestSignals(values, np.zeros(values.shape[:-1]))


@register
@dataclass(frozen=True, repr=False)
class CoilGroups(_Grouped, Record):
    """Each signal is the current of a group of coils in series, A, such as coils that are images by a symmetry.

    groups: numbers of the coils, from 0, of each group; every coil is in one group. Raises InputError otherwise.

    >>> CoilGroups([[0, 2], [1, 3]]).currents([1.0, 2.0])
    array([1., 2., 1., 2.])
    """

    name: ClassVar[str] = "groups"
    groups: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        groups = tuple(tuple(int(k) for k in group) for group in self.groups)
        coils = sorted(k for group in groups for k in group)
        fits = bool(coils) and coils == list(range(len(coils))) and all(groups)
        must = "must name every coil once, by numbers from 0, and no group may be empty"
        check(fits, "CoilGroups(groups)", must, groups, "list each coil once")
        object.__setattr__(self, "groups", groups)

    @property
    def parameters(self) -> dict[str, Any]:
        """The groups."""
        return {"groups": [list(group) for group in self.groups]}

    @property
    def signal_names(self) -> tuple[str, ...]:
        """ "g1", "g2" and so on."""
        return tuple(f"g{k + 1}" for k in range(len(self.groups)))


# Signs of the coordinates of the six coils. The second and the fifth coil lie on the x axis.
_X_SIDE = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
_Y_SIDE = np.array([-1.0, 0.0, 1.0, -1.0, 0.0, 1.0])
_MIDDLE = _Y_SIDE == 0.0


@register
@dataclass(frozen=True)
class LiftAndDirections(CurrentParametrisation, Record):
    """Six coils on a ring, in two rows of three at x < 0 and x > 0, each in the order of rising y.

    Signals: the mean current u, A, sets the lift; x and y, dimensionless, push along the two axes. The four coils at
    the corners get u (1 -+ x)(1 -+ y). The two coils on the x axis share the rest of 6 u in the ratio (1 - n x) :
    (1 + n x), so they follow x more strongly for n > 1. The six currents add up to 6 u, and the two on the x axis to
    2 u, for all x and y: docs/recipes.md.

    limit: largest current of a coil, A, in a domain of these signals. The range of u ends where a coil reaches it.
    None: no limit.

    >>> LiftAndDirections(n=1.25).currents([1.0, 0.2, 0.1]).round(3).tolist()
    [0.72, 0.75, 0.88, 1.08, 1.25, 1.32]
    """

    name: ClassVar[str] = "lift and directions"
    n: float = 1.0
    limit: float | None = None

    def __post_init__(self) -> None:
        check_positive("LiftAndDirections", n=self.n)
        if self.limit is not None:
            check_positive("LiftAndDirections", limit=self.limit)

    @property
    def parameters(self) -> dict[str, Any]:
        """n, and the limit if there is one."""
        limited = {} if self.limit is None else {"limit": float(self.limit)}
        return {"n": float(self.n), **limited}

    @property
    def coil_count(self) -> int:
        """Six."""
        return 6

    @property
    def signal_names(self) -> tuple[str, ...]:
        """ "u", "x", "y"."""
        return ("u", "x", "y")

    @property
    def signal_units(self) -> tuple[str, ...]:
        """u in A."""
        return ("A", "1", "1")

    def currents(self, signals: ArrayLike) -> Array:
        """Currents of the two rows, in the order of the coils."""
        u, x, y = np.moveaxis(check_signal("signals", signals, columns=3), -1, 0)
        return self._divided(u[..., None], x[..., None], y[..., None])

    def derivative(self, signals: ArrayLike) -> Array:
        """Derivatives by u, x and y, one column each."""
        u, x, y = (values[..., None] for values in np.moveaxis(np.asarray(signals, dtype=float), -1, 0))
        by_u = self._divided(np.ones_like(u), x, y)
        corner_x, corner_y = 1.0 + _X_SIDE * x, 1.0 + _Y_SIDE * y
        by_x = u * np.where(_MIDDLE, self.n * _X_SIDE, _X_SIDE * corner_y)
        by_y = u * np.where(_MIDDLE, 0.0, _Y_SIDE * corner_x)
        return np.stack([by_u, by_x, by_y], axis=-1)

    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """u is the mean current, x the projection on the effect of x at y = 0, and y comes from the corner coils. They
        are exact for currents of some signals. The mismatch is the largest difference over u. For a mean of 0 the
        signals are zero and the mismatch is infinite."""
        given = check_signal("currents", currents, columns=6)
        u = given.mean(axis=-1)
        mean = np.where(u == 0.0, 1.0, u)
        share = given / mean[..., None]
        # At y = 0 a corner has the share 1 + s x and a middle coil 1 + n s x. Sums over y cancel the effect of y.
        slope = np.where(_MIDDLE, self.n, 1.0) * _X_SIDE
        x = ((share - 1.0) * slope).sum(axis=-1) / (slope**2).sum()
        y = (share * _Y_SIDE).sum(axis=-1) / 4.0
        divided = self._divided(u[..., None], x[..., None], y[..., None])
        mismatch = np.abs(divided - given).max(axis=-1) / np.abs(mean)
        values = np.where((u == 0.0)[..., None], 0.0, np.stack([u, x, y], axis=-1))
        return NearestSignals(values, np.where(u == 0.0, np.inf, mismatch))

    def largest(self, lower: Array, upper: Array) -> Array:
        """Largest values in the corners of the box, since a current is linear in each signal; at most the limit."""
        corners = lower + np.array(list(itertools.product((0.0, 1.0), repeat=3))) * (upper - lower)
        found = np.abs(self.currents(corners)).max(axis=0)
        return np.asarray(found if self.limit is None else np.minimum(found, self.limit))

    def within(self, lower: Array, upper: Array, shares: Array) -> Array:
        """Signals in the box, with u up to the value at which a coil reaches the limit."""
        signals = np.array(lower + shares * (upper - lower), dtype=float)
        if self.limit is not None:
            at_one = self._divided(np.ones_like(signals[..., :1]), signals[..., 1:2], signals[..., 2:])
            last = np.minimum(upper[0], self.limit / np.abs(at_one).max(axis=-1))
            signals[..., 0] = lower[0] + shares[..., 0] * (last - lower[0])
        return signals

    def excess(self, signals: Array) -> float:
        """Relative excess of the largest of the six currents."""
        if self.limit is None:
            return -1.0
        return float(np.abs(self.currents(signals)).max() / self.limit - 1.0)

    def kernel(self) -> CompiledParametrisation:
        """The exponent n."""
        return CompiledParametrisation(True, float(self.n), np.zeros((0, 0)))

    def _divided(self, u: Array, x: Array, y: Array) -> Array:
        """Currents (..., 6) of signals (..., 1)."""
        corners = u * (1.0 + _X_SIDE * x) * (1.0 + _Y_SIDE * y)
        left = 6.0 * u - np.where(_MIDDLE, 0.0, corners).sum(axis=-1, keepdims=True)
        return np.where(_MIDDLE, 0.5 * left * (1.0 + self.n * _X_SIDE * x), corners)


@dataclass(frozen=True, eq=False, repr=False)
class CurrentDomain(Record):
    """A box of signals from lower to upper (n_signals,), cut at the current limit of the parametrisation."""

    parametrisation: CurrentParametrisation
    lower: Array
    upper: Array

    @property
    def middle(self) -> Array:
        """Currents (n_coils,) in the middle."""
        return self.at(np.full(len(self.lower), 0.5))

    @property
    def largest(self) -> Array:
        """Largest absolute value (n_coils,) of every current, A."""
        return self.parametrisation.largest(self.lower, self.upper)

    def at(self, shares: Array) -> Array:
        """Currents at shares of the ranges.

        Parameters
        ----------
        shares
            Shares (..., n_signals) from 0 to 1.

        Returns
        -------
        Array
            Currents (..., n_coils), A, in C order, as compiled functions take them.
        """
        signals = self.parametrisation.within(self.lower, self.upper, shares)
        return np.ascontiguousarray(self.parametrisation.currents(signals))

    def outside(self, signals: Array, margin: float = ROUNDING) -> int | None:
        """The first signal that is beyond its range.

        Parameters
        ----------
        signals
            Signals (n_signals,).
        margin
            Share of the range by which a signal may lie beyond it.

        Returns
        -------
        int | None
            Number of the signal; None where all are within.
        """
        beside = margin * (self.upper - self.lower)
        beyond = np.flatnonzero(~((signals >= self.lower - beside) & (signals <= self.upper + beside)))
        return int(beyond[0]) if beyond.size else None

    def holds(self, currents: Array) -> bool:
        """Whether currents lie in the domain, up to rounding.

        Parameters
        ----------
        currents
            Currents (n_coils,), A.

        Returns
        -------
        bool
            True for currents in the domain.
        """
        signals = self.parametrisation.signals(currents, ROUNDING)
        return self.outside(signals) is None and self.parametrisation.excess(signals) <= ROUNDING

    def largest_equal_current(self) -> float | None:
        """The largest current, A, that all coils may carry at once. The bisection starts at the mean current in the
        middle of the domain. None if that mean in all coils is outside the domain.

        >>> domain = CurrentDomain(LiftAndDirections(), np.array([1.0, -0.4, -0.4]), np.array([2.0, 0.4, 0.4]))
        >>> round(domain.largest_equal_current(), 6)
        2.0
        """
        low, high = float(self.middle.mean()), float(self.largest.min())
        if not self._holds_equal(low):
            return None
        if self._holds_equal(high):
            return high
        while high - low > ROUNDING * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._holds_equal(middle) else (low, middle)
        return low

    def _holds_equal(self, current: float) -> bool:
        return self.holds(np.full(self.parametrisation.coil_count, current))


@dataclass(frozen=True, eq=False, repr=False)
class DivisionSignals(Record):
    """Result of `undivide_currents`: signals u, x and y, and the mismatch of their currents relative to u."""

    u: Array
    x: Array
    y: Array
    mismatch: Array


def divide_currents(u: ArrayLike, x: ArrayLike, y: ArrayLike, n: float = 1.0) -> Array:
    """Currents of `LiftAndDirections`.

    Parameters
    ----------
    u
        Lift signal; the result has the same unit.
    x, y
        Direction signals. The three broadcast against each other.
    n
        Exponent of the division.

    Returns
    -------
    Array
        Currents (..., 6).

    Raises
    ------
    InputError
        For numbers that are not finite.

    Examples
    --------
    >>> divide_currents(1.0, 0.2, 0.1, n=1.25).round(3).tolist()
    [0.72, 0.75, 0.88, 1.08, 1.25, 1.32]
    """
    check_positive("divide_currents", n=n)
    signals = (check_signal(f"divide_currents({name})", v) for name, v in (("u", u), ("x", x), ("y", y)))
    return LiftAndDirections(n)._divided(*(values[..., None] for values in np.broadcast_arrays(*signals)))


def undivide_currents(currents: ArrayLike, n: float = 1.0) -> DivisionSignals:
    """The signals of `LiftAndDirections` nearest to currents, exact if there are such signals.

    Parameters
    ----------
    currents
        (..., 6).
    n
        Exponent of `LiftAndDirections`.

    Returns
    -------
    DivisionSignals
        u, x and y, and the relative mismatch of their currents.

    Raises
    ------
    InputError
        For currents that are not finite, or whose mean is zero.

    Examples
    --------
    >>> s = undivide_currents([0.72, 0.75, 0.88, 1.08, 1.25, 1.32], n=1.25)
    >>> print(round(float(s.x), 9), round(float(s.y), 9), bool(s.mismatch < 1e-12))
    0.2 0.1 True
    """
    check_positive("undivide_currents", n=n)
    found = LiftAndDirections(n).nearest(check_signal("undivide_currents(currents)", currents, columns=6))
    known, where = bool(np.isfinite(found.mismatch).all()), "undivide_currents(currents)"
    check(known, where, "must have a mean other than 0", "mean 0", "u is that mean")
    u, x, y = np.moveaxis(found.values, -1, 0)
    return DivisionSignals(u, x, y, found.mismatch)


def division_slopes(u: float, x: float, y: float, n: float = 1.0) -> Array:
    """Derivative of the currents of `LiftAndDirections` by its signals.

    The product with the force per ampere of each coil is the force per unit of each signal.

    Parameters
    ----------
    u
        Lift signal, A.
    x, y
        Direction signals.
    n
        Exponent of the division.

    Returns
    -------
    Array
        Derivative (6, 3) by (u, x, y).

    Examples
    --------
    >>> division_slopes(1.5, 0.0, 0.0, n=1.25)[:, 1].tolist()
    [-1.5, -1.875, -1.5, 1.5, 1.875, 1.5]
    """
    check_positive("division_slopes", n=n)
    return LiftAndDirections(n).derivative(check_signal("division_slopes(u, x, y)", [u, x, y]))

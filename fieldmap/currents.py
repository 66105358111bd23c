"""How a few signals become the currents of all coils: a `CurrentParametrisation`, and a box of its signals.

A controller seldom moves every coil by itself. A parametrisation says which currents (n_coils,) belong to signals
(n_signals,), how they change with them, and which signals belong to given currents. A map of saturating iron holds for
a `CurrentDomain`, a box of signals, and stores its parametrisation by name and parameters.

`IndependentCurrents`: each signal is the current of one coil. `CoilGroups`: each signal is the current of a group of
coils. `LiftAndDirections`: six coils in two rows of three, driven by one lift and two direction signals. One more is a
class that derives from `CurrentParametrisation` and is decorated with `register`.

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
"""Currents belong to signals if they differ from those of the nearest signals by no more than this share."""
ROUNDING = 1e-9
"""Signals lie in a domain if they are beyond it by no more than this share of its range."""


class NearestSignals(NamedTuple):
    """Signals (..., n_signals) whose currents are nearest to given ones, and by what share (...) these are off.

    The share is of the mean current or of the largest, as the parametrisation says; infinite where there are no such
    signals.
    """

    values: Array
    mismatch: Array

    def __repr__(self) -> str:
        return tuple_line(self)

    def to_dict(self) -> dict[str, Plain]:
        """The arrays by their names, as plain Python."""
        return plain_items(**self._asdict())


class CompiledParametrisation(NamedTuple):
    """division: six currents of a lift and two directions, with this exponent; else currents = matrix (n_coils,
    n_signals) @ signals. What is not needed is zero or empty."""

    division: bool
    exponent: float
    matrix: Array

    def __repr__(self) -> str:
        return tuple_line(self)


class CurrentParametrisation(ABC):
    """Signals (..., n_signals) to currents (..., n_coils), A. Frozen; equal if name and parameters are equal."""

    name: ClassVar[str]
    """By which it is registered and stored."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, Any]:
        """What, with the name, makes it again: plain JSON."""

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
        """As the C core takes it."""

    def within(self, lower: Array, upper: Array, shares: Array) -> Array:
        """Signals that fill a domain once: the box, unless the parametrisation limits the currents.

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
        """By what share the largest current is beyond the limit of the parametrisation.

        Parameters
        ----------
        signals
            Signals (n_signals,).

        Returns
        -------
        float
            The share; 0 or less within the limit, and -1 where there is none.
        """
        return -1.0

    def signals(self, currents: ArrayLike, tolerance: float = TOLERANCE) -> Array:
        """Signals of currents: the inverse of `currents`.

        Parameters
        ----------
        currents
            Currents (..., n_coils), A.
        tolerance
            By what share the currents may be off.

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
        """Name and parameters as one text, from which `parametrisation_from_json` makes it again."""
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
    """The parametrisation of a name with parameters.

    Parameters
    ----------
    name
        By which it is registered.
    parameters
        By name, plain JSON.

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
        For a text that describes none.
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
        """Currents (n_coils, n_groups) of groups at 1 A."""
        return np.eye(len(self.groups))[self._group_of]

    def currents(self, signals: ArrayLike) -> Array:
        """Every coil has the current of its group."""
        return check_signal("signals", signals, columns=len(self.groups)).take(self._group_of, axis=-1)

    def derivative(self, signals: ArrayLike) -> Array:
        """`matrix`, at all signals."""
        leading = check_signal("signals", signals, columns=len(self.groups)).shape[:-1]
        return np.tile(self.matrix, (*leading, 1, 1))

    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """The mean of each group; off by the largest difference, as a share of the largest current."""
        given = check_signal("currents", currents, columns=self.coil_count)
        matrix = self.matrix
        values = given @ matrix / matrix.sum(axis=0)
        off, size = np.abs(self.currents(values) - given).max(axis=-1), np.abs(given).max(axis=-1)
        return NearestSignals(values, off / np.where(size > 0.0, size, 1.0))

    def largest(self, lower: Array, upper: Array) -> Array:
        """The larger end of each group's range."""
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
        """The currents themselves, which are never off."""
        values = check_signal("currents", currents, columns=self.coils)
        return NearestSignals(values, np.zeros(values.shape[:-1]))


@register
@dataclass(frozen=True, repr=False)
class CoilGroups(_Grouped, Record):
    """Each signal is the current of a group of coils in series, A: a device moved along its symmetry.

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


# The side of the axes on which each of the six coils lies; the second and the fifth lie on the x axis.
_X_SIDE = np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
_Y_SIDE = np.array([-1.0, 0.0, 1.0, -1.0, 0.0, 1.0])
_MIDDLE = _Y_SIDE == 0.0


@register
@dataclass(frozen=True)
class LiftAndDirections(CurrentParametrisation, Record):
    """Six coils on a ring, in two rows of three at x < 0 and x > 0, each in the order of rising y.

    Signals: u, A, the mean current, which lifts; x and y, 1, which push along the two axes. The four coils at the
    corners get u (1 -+ x)(1 -+ y). The two on the x axis share what is left of 6 u as (1 -+ n x): n > 1 lets them
    follow x more. The sum is 6 u and that of the two is 2 u whatever x and y are: docs/recipes.md.

    limit: the largest current of a coil, A, in a domain of these signals: u ends where a coil reaches it, the lower the
    larger x and y are. None: no limit.

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
        """Of the two rows, in the order of the coils."""
        u, x, y = np.moveaxis(check_signal("signals", signals, columns=3), -1, 0)
        return self._divided(u[..., None], x[..., None], y[..., None])

    def derivative(self, signals: ArrayLike) -> Array:
        """Columns by u, x and y."""
        u, x, y = (values[..., None] for values in np.moveaxis(np.asarray(signals, dtype=float), -1, 0))
        by_u = self._divided(np.ones_like(u), x, y)
        corner_x, corner_y = 1.0 + _X_SIDE * x, 1.0 + _Y_SIDE * y
        by_x = u * np.where(_MIDDLE, self.n * _X_SIDE, _X_SIDE * corner_y)
        by_y = u * np.where(_MIDDLE, 0.0, _Y_SIDE * corner_x)
        return np.stack([by_u, by_x, by_y], axis=-1)

    def nearest(self, currents: ArrayLike) -> NearestSignals:
        """u is the mean, x the projection on what x does at y = 0, y what the corners say; exact if there are such
        signals. Off by the largest difference as a share of u. Currents of mean 0 have none: zeros, off by infinity."""
        given = check_signal("currents", currents, columns=6)
        u = given.mean(axis=-1)
        mean = np.where(u == 0.0, 1.0, u)
        share = given / mean[..., None]
        # At y = 0 a corner has the share 1 + s x and a middle coil 1 + n s x; sums over y cancel what y adds.
        slope = np.where(_MIDDLE, self.n, 1.0) * _X_SIDE
        x = ((share - 1.0) * slope).sum(axis=-1) / (slope**2).sum()
        y = (share * _Y_SIDE).sum(axis=-1) / 4.0
        divided = self._divided(u[..., None], x[..., None], y[..., None])
        mismatch = np.abs(divided - given).max(axis=-1) / np.abs(mean)
        values = np.where((u == 0.0)[..., None], 0.0, np.stack([u, x, y], axis=-1))
        return NearestSignals(values, np.where(u == 0.0, np.inf, mismatch))

    def largest(self, lower: Array, upper: Array) -> Array:
        """Found in the corners of the box: a current is linear in each signal alone. None is beyond the limit."""
        corners = lower + np.array(list(itertools.product((0.0, 1.0), repeat=3))) * (upper - lower)
        found = np.abs(self.currents(corners)).max(axis=0)
        return np.asarray(found if self.limit is None else np.minimum(found, self.limit))

    def within(self, lower: Array, upper: Array, shares: Array) -> Array:
        """The box, u up to where a coil reaches the limit."""
        signals = np.array(lower + shares * (upper - lower), dtype=float)
        if self.limit is not None:
            at_one = self._divided(np.ones_like(signals[..., :1]), signals[..., 1:2], signals[..., 2:])
            last = np.minimum(upper[0], self.limit / np.abs(at_one).max(axis=-1))
            signals[..., 0] = lower[0] + shares[..., 0] * (last - lower[0])
        return signals

    def excess(self, signals: Array) -> float:
        """Of the largest of the six currents."""
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
    """A box of signals, lower to upper (n_signals,), within the parametrisation's limit, and the currents that belong
    to them."""

    parametrisation: CurrentParametrisation
    lower: Array
    upper: Array

    @property
    def middle(self) -> Array:
        """Currents (n_coils,) in the middle."""
        return self.at(np.full(len(self.lower), 0.5))

    @property
    def largest(self) -> Array:
        """Largest size (n_coils,) of every current."""
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
            By what share of the range a signal may be beyond it.

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
        """The largest current, A, that all coils may carry at once. None where they may not all carry the mean of the
        currents in the middle of the domain, from which it is searched.

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
    """What `undivide_currents` finds: u, x and y, and by how much the given currents differ from those of these
    signals, relative to u."""

    u: Array
    x: Array
    y: Array
    mismatch: Array


def divide_currents(u: ArrayLike, x: ArrayLike, y: ArrayLike, n: float = 1.0) -> Array:
    """Currents of `LiftAndDirections`.

    Parameters
    ----------
    u
        Lift signal; its unit is that of the result.
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
        Of `LiftAndDirections`.

    Returns
    -------
    DivisionSignals
        u, x and y, and by how much the currents differ from theirs.

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

    With the force per ampere of each coil it gives the forces that lift and direction signals make.

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

"""The field of coils: flux density and its derivatives at points, for currents.

`Field` is what the package works on. Coils, linear solutions, the solver of saturating iron, maps and measured maps are
fields; equilibria, control, dynamics, plots, exports and commands take any of them. `Field.at(currents)` is the same
field at fixed currents, a `FieldAtCurrents`.

A class of your own needs `coil_names`, `field` and `gradient`: derive it from `BaseField`, which supplies the rest, or
hand an object to `as_field`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.errors import InputError, Problem
from fieldmap.typing import Array

Bounds: TypeAlias = tuple[Array, Array]
"""Lower and upper corner (3,) of an axis-parallel box, m."""

Currents: TypeAlias = ArrayLike | Mapping[str, float]
"""Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by name."""

STEP = 1e-4
"""Half the distance of the gradients that are differenced for a second gradient, m."""


@runtime_checkable
class FieldAtCurrents(Protocol):
    """Flux density and its derivatives at points, at fixed currents. Points (n, 3) or (3,), m."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @property
    def currents(self) -> Array:
        """Currents (n_coils,), A."""

    def field(self, points: ArrayLike) -> Array:
        """B (n, 3), T."""

    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""

    def second_gradient(self, points: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""


@runtime_checkable
class Field(Protocol):
    """Flux density and its derivatives at points, for currents. Points (n, 3) or (3,), m; currents as `Currents`."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @property
    def bounds(self) -> Bounds | None:
        """The box in which the field holds or is asked for; None where no box is known."""

    @property
    def proportional(self) -> bool:
        """Whether the field is the sum of the coils' fields, each proportional to its current."""

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the field rests on."""

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""

    def wrench(self, positions: ArrayLike, moments: ArrayLike, currents: Any) -> Array:
        """Force (N) and torque (N m) on point dipoles (n, 6), about their own positions."""

    def at(self, currents: Any) -> FieldAtCurrents:
        """The field at these currents."""


class BaseField(ABC):
    """What every field can do once it has `coil_names`, `field` and `gradient`."""

    @property
    @abstractmethod
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @abstractmethod
    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""

    @abstractmethod
    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""

    @property
    def bounds(self) -> Bounds | None:
        """The box in which the field holds or is asked for; None where no box is known."""
        return None

    @property
    def lower(self) -> Array:
        """Lower corner (3,) of `bounds`, m. Raises InputError where there is none."""
        return require_bounds(self)[0]

    @property
    def upper(self) -> Array:
        """Upper corner (3,) of `bounds`, m. Raises InputError where there is none."""
        return require_bounds(self)[1]

    @property
    def proportional(self) -> bool:
        """Whether the field is the sum of the coils' fields, each proportional to its current."""
        return False

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the field rests on."""
        return ()

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2, by central differences of the gradient.

        The error is O(STEP^2) and O(rounding / STEP), some 1e-6 of it at 0.1 m from the iron. The field must hold a
        step beyond the points.
        """
        return differenced(lambda x: self.gradient(x, currents), points)

    def wrench(self, positions: ArrayLike, moments: ArrayLike, currents: Any) -> Array:
        """Force (N) and torque (N m) on point dipoles (n, 6), about their own positions: see `dipole_wrench`."""
        where = np.asarray(positions, dtype=float)
        points = np.atleast_2d(where)
        result = dipole_wrench(self.field(points, currents), self.gradient(points, currents), moments)
        return result[0] if where.ndim == 1 else result

    def at(self, currents: Any) -> FieldAtCurrents:
        """The field at these currents."""
        return FixedCurrents(self, coil_currents(currents, self.coil_names))


class BaseFieldAtCurrents(ABC):
    """What every field at fixed currents can do once it has `coil_names`, `currents`, `field` and `gradient`."""

    currents: Array

    @property
    @abstractmethod
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @abstractmethod
    def field(self, points: ArrayLike) -> Array:
        """B (n, 3), T."""

    @abstractmethod
    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""

    @property
    def bounds(self) -> Bounds | None:
        """The box in which the field holds or is asked for; None where no box is known."""
        return None

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the field rests on."""
        return ()

    def second_gradient(self, points: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2, by central differences of the gradient, see `BaseField`."""
        return differenced(self.gradient, points)

    def wrench(self, positions: ArrayLike, moments: ArrayLike) -> Array:
        """Force (N) and torque (N m) on point dipoles (n, 6), about their own positions: see `dipole_wrench`."""
        where = np.asarray(positions, dtype=float)
        points = np.atleast_2d(where)
        result = dipole_wrench(self.field(points), self.gradient(points), moments)
        return result[0] if where.ndim == 1 else result


class FixedCurrents(BaseFieldAtCurrents):
    """A field at given currents (n_coils,), A."""

    def __init__(self, source: Field, currents: Array) -> None:
        self.source = source
        self.currents = currents

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return self.source.coil_names

    @property
    def bounds(self) -> Bounds | None:
        """The box of the field."""
        return self.source.bounds

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the field rests on."""
        return self.source.assumptions

    def field(self, points: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self.source.field(points, self.currents)

    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self.source.gradient(points, self.currents)

    def second_gradient(self, points: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self.source.second_gradient(points, self.currents)

    def wrench(self, positions: ArrayLike, moments: ArrayLike) -> Array:
        """Force (N) and torque (N m) on point dipoles (n, 6), about their own positions."""
        return self.source.wrench(positions, moments, self.currents)


class CompletedField(BaseField):
    """An object with `coil_names`, `field` and `gradient`, and what else it has, completed to a `Field`; with a box of
    its own where `bounds` is given."""

    def __init__(self, source: Any, bounds: Bounds | None = None) -> None:
        self.source = source
        self._bounds = bounds

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return tuple(self.source.coil_names)

    @property
    def bounds(self) -> Bounds | None:
        """The given box, or that of the object."""
        if self._bounds is not None:
            return self._bounds
        if hasattr(self.source, "bounds"):
            return self.source.bounds
        if hasattr(self.source, "lower") and hasattr(self.source, "upper"):
            return np.asarray(self.source.lower, dtype=float), np.asarray(self.source.upper, dtype=float)
        return None

    @property
    def proportional(self) -> bool:
        """What the object says; otherwise False."""
        return bool(getattr(self.source, "proportional", False))

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the object says; otherwise none."""
        return tuple(getattr(self.source, "assumptions", ()))

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""
        return np.asarray(self.source.field(points, currents))

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return np.asarray(self.source.gradient(points, currents))

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """The object's own; otherwise by central differences of the gradient."""
        own = getattr(self.source, "second_gradient", None)
        return super().second_gradient(points, currents) if own is None else np.asarray(own(points, currents))

    def at(self, currents: Any) -> FieldAtCurrents:
        """The object's own; otherwise this field at these currents."""
        own = getattr(self.source, "at", None)
        return super().at(currents) if own is None or self._bounds is not None else own(currents)


def as_field(source: Any, bounds: Bounds | None = None) -> Field:
    """The object itself if it is a `Field` (and no other box is asked for), otherwise one made of it.

    source: anything with `coil_names`, `field(points, currents)` and `gradient(points, currents)`; `second_gradient`,
    `lower` and `upper`, `assumptions` are used where it has them. bounds: lower and upper corner (3,), m. Raises
    InputError for an object that lacks one of the three.

    >>> class Uniform:
    ...     coil_names = ("Helmholtz pair",)
    ...     def field(self, points, currents):
    ...         return np.full((len(points), 3), [0.0, 0.0, 1e-3 * currents[0]])
    ...     def gradient(self, points, currents):
    ...         return np.zeros((len(points), 3, 3))
    >>> field = as_field(Uniform())
    >>> print(field.at({"Helmholtz pair": 2.0}).field([[0.0, 0.0, 0.0]]))
    [[0.    0.    0.002]]
    """
    if bounds is None and isinstance(source, Field):
        return source
    missing = [name for name in ("coil_names", "field", "gradient") if not hasattr(source, name)]
    if missing:
        must_hold = "must have coil_names, field(points, currents) and gradient(points, currents)"
        received = f"{type(source).__name__} without {', '.join(missing)}"
        raise InputError(
            Problem("field", must_hold, received, "give a solution, a map, or a field of your own")
        )
    return CompletedField(source, bounds)


def require_bounds(source: Any) -> Bounds:
    """The box of a field. Raises InputError where it has none."""
    bounds = source.bounds
    if bounds is None:
        remedy = "add a [workspace] table to the device, or give the box: as_field(field, (lower, upper))"
        raise InputError(
            Problem(type(source).__name__, "must have a box in which it is used", "none", remedy)
        )
    return bounds[0], bounds[1]


def coil_currents(currents: Any, coil_names: tuple[str, ...], points: int | None = None) -> Array:
    """Currents (n_coils,), A, C order, from an array, one number for all coils, or a mapping by coil name.

    points: how many points there are, where currents (points, n_coils) are welcome too. Raises InputError for a wrong
    number of currents, for coils that a mapping lacks or that do not exist, and for what is not finite.

    >>> coil_currents(1.5, ("left", "right"))
    array([1.5, 1.5])
    >>> coil_currents({"right": 2.0, "left": 1.0}, ("left", "right"))
    array([1., 2.])
    """
    count = len(coil_names)
    if isinstance(currents, Mapping):
        values = _by_name(currents, coil_names)
    else:
        try:
            # Writeable too: compiled code would have to be compiled again for a read-only array.
            values = np.require(currents, np.float64, ["C", "W"])
        except (TypeError, ValueError):
            raise InputError(_wrong(coil_names, points, repr(currents)[:80])) from None
    if values.ndim == 0:
        values = np.full(count, float(values))
    if values.shape != (count,) and (points is None or values.shape != (points, count)):
        raise InputError(_wrong(coil_names, points, f"shape {values.shape}"))
    if not np.isfinite(values).all():
        raise InputError(_wrong(coil_names, points, f"{values}"))
    return values


def _by_name(currents: Mapping[str, float], coil_names: tuple[str, ...]) -> Array:
    names = set(coil_names)
    if set(currents) != names:
        unknown, missing = sorted(set(currents) - names), sorted(names - set(currents))
        parts = [
            f"{words} {', '.join(some)}"
            for words, some in (("unknown", unknown), ("missing", missing))
            if some
        ]
        raise InputError(_wrong(coil_names, None, "; ".join(parts)))
    return np.array([float(currents[name]) for name in coil_names])


def _wrong(coil_names: tuple[str, ...], points: int | None, received: str) -> Problem:
    count = len(coil_names)
    shapes = f"shape ({count},)" if points is None else f"shape ({count},) or ({points}, {count})"
    must_hold = (
        f"must be one finite current per coil ({', '.join(coil_names)}): {shapes}, one number, or by name"
    )
    return Problem("currents", must_hold, received, "give amperes in the order of coil_names")


def dipole_wrench(flux: Array, slope: Array, moments: ArrayLike) -> Array:
    """(n, 6): force (N) and torque (N m) on moments (3,) or (n, 3), A m^2, in flux (n, 3) and slope (n, 3, 3).

    T = m x B, thesis eq. (2-7), and F = grad(m . B) = (grad B)^T m, which is (m . grad) B of eq. (2-8) where B is
    curl-free, and is conservative for a fixed moment even if the interpolant is not quite so.
    """
    dipoles, _ = checked_vectors("moments", moments)
    if len(dipoles) not in (1, len(flux)):
        received = f"{len(dipoles)} moments for {len(flux)} positions"
        problem = Problem("moments", "one for all positions or one each", received, "match them")
        raise InputError(problem)
    dipoles = np.broadcast_to(dipoles, flux.shape)
    force = np.einsum("nij,ni->nj", slope, dipoles)
    return np.concatenate([force, np.cross(dipoles, flux)], axis=1)


def differenced(gradient: Any, points: ArrayLike, step: float = STEP) -> Array:
    """Second gradient (n, 3, 3, 3), T/m^2, of `gradient(points)` (n, 3, 3) by central differences; the last index is
    the differenced one. A single point (3,) gives (3, 3, 3)."""
    where = np.asarray(points, dtype=float)
    at = np.atleast_2d(where)
    steps = step * np.eye(3)
    shifted = np.concatenate([at + steps[:, None, :], at - steps[:, None, :]]).reshape(-1, 3)
    values = gradient(shifted).reshape(2, 3, len(at), 3, 3)
    second = np.moveaxis((values[0] - values[1]) / (2.0 * step), 0, -1)
    return second[0] if where.ndim == 1 else second

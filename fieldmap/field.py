"""The field of coils: flux density and its derivatives at points, for currents.

`Field` is the common interface of the package. Coils, linear solutions, the solver of saturating iron, maps and
measured maps are fields; equilibria, control, dynamics, plots, exports and commands take any field.
`Field.at(currents)` is the field at fixed currents, a `FieldAtCurrents`, as is a solved state of saturating iron.

A class of your own needs `coil_names`, `field` and `gradient`: derive it from `Field`, which supplies the rest, or
pass an object to `as_field`. There `field_and_gradient` may replace `field` and `gradient`.

A controller uses these members of a field or map:

- `coil_names`: the order of the currents, A.
- `bounds`: the box in which the magnet may be, m. Beyond it a map raises OutsideMapError.
- `proportional`: whether the field is the sum of the coils' fields. `affine`: whether it is that sum plus a constant
  field, such as the field of magnets or a background field. An affine field has matrices from currents to force and
  torque that hold for all currents (`fieldmap.lookup.wrench_actuation`); for other fields a matrix belongs to one set
  of currents. `constant_field` and `constant_gradient`: the field with all currents off.
- `wrench(position, moment, currents)`: force and torque on the magnet; `field`, `gradient` and `second_gradient` make
  the linear plant about a point (`fieldmap.control.plant_from_map`).
- `gradient_jump(currents)`: largest jump of the gradient between two cells of a map. A force smaller than the moment
  times this jump is not resolved.
- `assumptions`: assumptions of the model. A certified map has `error_bound`, too.
- `FieldMap.currents_for`: the inverse, least-power currents for a force. `FieldMap.compiled`: the same lookup for code
  that numba compiles, without Python objects.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import checked_vectors
from fieldmap.errors import InputError, Problem
from fieldmap.reaction import Reaction, own_reaction
from fieldmap.records import count_of, short, shortened
from fieldmap.typing import Array
from fieldmap.usual_values import warn_if_unusual

Bounds: TypeAlias = tuple[Array, Array]
"""Lower and upper corner (3,) of an axis-parallel box, m."""

Currents: TypeAlias = ArrayLike | Mapping[str, float]
"""Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by name. Coils that are
not in the mapping carry no current."""

_OF_POINTS = (
    "field",
    "gradient",
    "field_and_gradient",
    "second_gradient",
    "potential",
    "unit_field",
    "unit_gradient",
    "constant_field",
    "constant_gradient",
    "wrench",
)
"""Methods of fields whose first argument is points; they take points of any leading shape."""

STEP = 1e-4
"""Step of the central differences of the gradient for a second gradient, m."""


@runtime_checkable
class MagneticLoad(Protocol):
    """A body in a field: `fieldmap.lookup.MagneticBody`, of magnets of finite size and of soft iron."""

    def wrench(
        self, field: Any, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Force and torque on the load, about its centre.

        Parameters
        ----------
        field
            Any field: see `fieldmap.field.as_field`.
        positions
            Centres (n, 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.
        orientations
            Rotations (3, 3) or (n, 3, 3) whose columns are the axes of the load; upright unless given.

        Returns
        -------
        Array
            Force, N, and torque, N m (n, 6).
        """


class StateLike(Protocol):
    """Required members of a state at one set of currents for `as_field`, such as a state of saturating iron."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @property
    def currents(self) -> Array:
        """Currents (n_coils,), A."""

    def field(self, points: ArrayLike) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Array
            B (n, 3), T.
        """

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the flux density at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        Array
            dB_i/dx_j (n, 3, 3), T/m.
        """


class FieldLike(Protocol):
    """Required members of an object for `as_field`."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        currents
            Currents (n_coils,), A.

        Returns
        -------
        Array
            B (n, 3), T.
        """

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """Gradient of the flux density at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        currents
            Currents (n_coils,), A.

        Returns
        -------
        Array
            dB_i/dx_j (n, 3, 3), T/m.
        """


class PairLike(Protocol):
    """Required members of an object for `as_field` that only computes flux density and gradient together."""

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    def field_and_gradient(self, points: ArrayLike, currents: Any) -> tuple[Array, Array]:
        """Flux density and its gradient at points.

        Parameters
        ----------
        points
            Positions (n, 3), m.
        currents
            Currents (n_coils,), A.

        Returns
        -------
        tuple[Array, Array]
            B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m.
        """


AnyField: TypeAlias = FieldLike | PairLike | StateLike
"""Arguments that functions of the package accept as a field: a `Field`, or an object for `as_field`."""


def _numbers(where: str, points: ArrayLike) -> Array:
    """Points as an array. Raises InputError for anything else."""
    try:
        return np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        must_hold = "must be numbers of shape (3,), (n, 3) or (..., 3)"
        raise InputError.of(where, must_hold, repr(points)[:80], "give x, y, z in m") from None


def of_any_shape(method: Callable[..., Any], first: str = "points") -> Callable[..., Any]:
    """Make a method of points (n, 3) or (3,) take points of any leading shape (..., 3).

    Other arguments with the leading shape of the points have one row for each point.

    Parameters
    ----------
    method
        The method.
    first
        Name of its first argument, the points.

    Returns
    -------
    Callable[..., Any]
        The method for all shapes.
    """

    @functools.wraps(method)
    def taking(self: Any, *arguments: Any, **named: Any) -> Any:
        if not arguments and first in named:
            arguments = (named.pop(first),)
        if arguments and not isinstance(arguments[0], np.ndarray):
            arguments = (_numbers(first, arguments[0]), *arguments[1:])
        if not arguments or arguments[0].ndim <= 2:
            return method(self, *arguments, **named)
        leading = arguments[0].shape[:-1]
        count = len(leading)

        def flat(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(flat, value))
            shape = () if isinstance(value, Mapping | str) or value is None else np.shape(value)
            rows = len(shape) > count and shape[:count] == leading
            return np.reshape(value, (-1, *shape[count:])) if rows else value

        def shaped(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(map(shaped, value))
            return np.reshape(value, (*leading, *np.shape(value)[1:]))

        given = {name: flat(value) for name, value in named.items()}
        return shaped(method(self, *map(flat, arguments), **given))

    return taking


class TakesPoints(ABC):
    """Common base of fields and of fields at fixed currents.

    Methods of every subclass take points of any leading shape. A method named in the class argument `own_shapes` must
    do so by itself, which makes a call with one point faster.
    """

    def __init_subclass__(cls, own_shapes: tuple[str, ...] = (), **options: Any) -> None:
        super().__init_subclass__(**options)
        for name in _OF_POINTS:
            method = cls.__dict__.get(name)
            if callable(method) and name not in own_shapes:
                first = "positions" if name == "wrench" else "points"
                setattr(cls, name, of_any_shape(method, first))

    def __array__(self, *arguments: Any, **named: Any) -> Array:
        """Raises InputError, because numpy would make an array with the field as its only element."""
        must_hold = "a field is a function of points, no array"
        remedy = "ask it at points, field(points, currents); to_xarray(currents) is a map on its nodes"
        raise InputError.of("numpy.asarray", must_hold, type(self).__name__, remedy)

    @property
    @abstractmethod
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""

    @property
    def bounds(self) -> Bounds | None:
        """The box in which the field is valid or is used; None if no box is known."""
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
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the model."""
        return ()

    @property
    def reaction(self) -> Reaction | None:
        """The reaction of the field's iron to magnets, included in forces and torques; None if unknown or left out."""
        return None

    @property
    def has_iron(self) -> bool:
        """Whether the field is known to have iron, which magnets would magnetise."""
        return False

    def outlines(self) -> Sequence[Any]:
        """Outlines for drawings (`fieldmap.device.drawing.Outline`); none by default."""
        return ()


class Field(TakesPoints):
    """Flux density and its derivatives at points, for currents.

    A class of your own has `coil_names`, `field` and `gradient`; the rest follows from these. Points (n, 3), (3,) or of
    any leading shape (..., 3), m; currents as `Currents`. Results for points (..., 3) are (..., 3), (..., 3, 3) and so
    on.
    """

    def __repr__(self) -> str:
        return shortened(
            f"{type(self).__name__}({count_of(len(self.coil_names), 'coil', 'coils')}: {', '.join(self.coil_names)})"
        )

    @abstractmethod
    def field(self, points: ArrayLike, currents: Any) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            B (..., 3), T.
        """

    @abstractmethod
    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """Gradient of the flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            dB_i/dx_j (..., 3, 3), T/m.
        """

    @property
    def proportional(self) -> bool:
        """Whether the field is the sum of the coils' fields, each proportional to its current."""
        return False

    @property
    def affine(self) -> bool:
        """Whether the field is the sum of the coils' fields plus a constant field, which may be zero."""
        return self.proportional

    def field_and_gradient(self, points: ArrayLike, currents: Any) -> tuple[Array, Array]:
        """Flux density and its gradient at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        tuple[Array, Array]
            B (..., 3), T, and dB_i/dx_j (..., 3, 3), T/m.
        """
        return self.field(points, currents), self.gradient(points, currents)

    def gradient_jump(self, currents: Array) -> float:
        """Largest step of the gradient from one cell of a map to the next.

        Parameters
        ----------
        currents
            Currents (n_coils,), A.

        Returns
        -------
        float
            The step, T/m; 0 where the gradient is continuous.
        """
        return 0.0

    def after_loop(self, currents: Any, swing: ArrayLike) -> Field:
        """This field in the middle of the second of two loops of the currents, if it depends on earlier currents.

        Parameters
        ----------
        currents
            Currents at the centre of the loops, A.
        swing
            Change (n_coils,) of the currents to either side, A.

        Returns
        -------
        Field
            The field; this field itself if it depends on the present currents alone.
        """
        return self

    def unit_field(self, points: ArrayLike) -> Array:
        """Flux density per ampere in each coil.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            B per ampere (..., n_coils, 3), T/A.

        Raises
        ------
        InputError
            For a field that is not affine.
        """
        return self._of_units(self.field, self.constant_field, points)

    def unit_gradient(self, points: ArrayLike) -> Array:
        """Gradient per ampere in each coil.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            dB_i/dx_j per ampere (..., n_coils, 3, 3), T/(m A).

        Raises
        ------
        InputError
            For a field that is not affine.
        """
        return self._of_units(self.gradient, self.constant_gradient, points)

    def _of_units(
        self, quantity: Callable[..., Array], constant: Callable[..., Array], points: ArrayLike
    ) -> Array:
        """A quantity (n, ...) with 1 A in one coil at a time, less its value without current: (n, coils, ...)."""
        require_affine(self, "unit_field")
        axis = np.ndim(points) - 1
        every = [quantity(points, row) for row in np.eye(len(self.coil_names))]
        if every and self.proportional:
            return np.stack(every, axis=axis)
        off = np.expand_dims(constant(points), axis)
        return np.stack(every, axis=axis) - off if every else np.repeat(off, 0, axis=axis)

    def constant_field(self, points: ArrayLike) -> Array:
        """Flux density with all currents off.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            B (..., 3), T.
        """
        return self.field(points, np.zeros(len(self.coil_names)))

    def constant_gradient(self, points: ArrayLike) -> Array:
        """Gradient with all currents off.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            dB_i/dx_j (..., 3, 3), T/m.
        """
        return self.gradient(points, np.zeros(len(self.coil_names)))

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """Second derivatives of the flux density, by central differences of the gradient.

        The error is O(STEP^2) + O(rounding / STEP), about 1e-6 relative at 0.1 m from the iron. The field must be
        valid one step beyond the points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        Array
            d2B_i/dx_j dx_k (..., 3, 3, 3), T/m^2.
        """
        return differenced(lambda x: self.gradient(x, currents), points)

    def wrench(
        self,
        positions: ArrayLike,
        moments: ArrayLike | MagneticLoad,
        currents: Any,
        orientations: ArrayLike | None = None,
    ) -> Array:
        """Force and torque on point dipoles, or on a body, about their own positions: see `dipole_wrench`.

        Parameters
        ----------
        positions
            Positions of the dipoles or of the body's centre (3,), (n, 3) or (..., 3) in the frame of the
            field, m.
        moments
            Moments (3,) or (n, 3), A m^2, in the frame of the field; or a `MagneticLoad`, a body of several
            magnets or soft iron.
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.
        orientations
            Of a body: rotations (3, 3) or (n, 3, 3) whose columns are its axes; upright unless given.

        Returns
        -------
        Array
            Force, N, and torque, N m (..., 6).
        """
        pair = functools.partial(self.field_and_gradient, currents=currents)
        return _wrench(self, positions, moments, currents, orientations, pair)

    def at(self, currents: Any) -> FieldAtCurrents:
        """The field at these currents.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.

        Returns
        -------
        FieldAtCurrents
            The field as a function of points alone.
        """
        return FixedCurrents(self, np.array(coil_currents(currents, self.coil_names)))

    def as_magpylib(self, currents: Any, **options: Any) -> Any:
        """The field at these currents as a magpylib source: see `FieldAtCurrents.as_magpylib`.

        Parameters
        ----------
        currents
            Currents, A: (n_coils,) in the order of `coil_names`, one number for all coils, or a mapping by
            name.
        **options
            Position, orientation and style of the source.

        Returns
        -------
        Any
            The source.

        Raises
        ------
        InputError
            For options that magpylib refuses.
        """
        return self.at(currents).as_magpylib(**options)


class FieldAtCurrents(TakesPoints):
    """Flux density and its derivatives at points (n, 3), (3,) or of any leading shape, m, at fixed currents.

    A class of your own has `coil_names`, `currents` (n_coils,), A, `field` and `gradient`.
    """

    def __repr__(self) -> str:
        return shortened(f"{type(self).__name__}(at {short(getattr(self, 'currents', None))} A)")

    currents: Array
    _domain: Bounds | None = None
    """Corners (3,), m, of a box outside which the field gives NaN as a magpylib source."""

    @abstractmethod
    def field(self, points: ArrayLike) -> Array:
        """Flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            B (..., 3), T.
        """

    @abstractmethod
    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the flux density at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            dB_i/dx_j (..., 3, 3), T/m.
        """

    def field_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """Flux density and its gradient at points.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        tuple[Array, Array]
            B (..., 3), T, and dB_i/dx_j (..., 3, 3), T/m.
        """
        return self.field(points), self.gradient(points)

    def second_gradient(self, points: ArrayLike) -> Array:
        """Second derivatives of the flux density, by central differences of the gradient: see
        `Field.second_gradient`.

        Parameters
        ----------
        points
            Positions (3,), (n, 3) or (..., 3) in the frame of the field, m.

        Returns
        -------
        Array
            d2B_i/dx_j dx_k (..., 3, 3, 3), T/m^2.
        """
        return differenced(self.gradient, points)

    def wrench(
        self, positions: ArrayLike, moments: ArrayLike | MagneticLoad, orientations: ArrayLike | None = None
    ) -> Array:
        """Force and torque on point dipoles, or on a body, about their own positions: see `dipole_wrench`.

        Parameters
        ----------
        positions
            Positions of the dipoles or of the body's centre (3,), (n, 3) or (..., 3) in the frame of the
            field, m.
        moments
            Moments (3,) or (n, 3), A m^2, in the frame of the field; or a `MagneticLoad`, a body of several
            magnets or soft iron.
        orientations
            Of a body: rotations (3, 3) or (n, 3, 3) whose columns are its axes; upright unless given.

        Returns
        -------
        Array
            Force, N, and torque, N m (..., 6).
        """
        return _wrench(self, positions, moments, self.currents, orientations, self.field_and_gradient)

    def as_magpylib(self, **options: Any) -> Any:
        """The field as a magpylib source (`fieldmap.magpylib_source.FieldSource`), exact to rounding.

        It works in getB, getH, getJ, getM and getFT (as a source), with sensors and other sources, moved,
        turned and on paths; `show` draws its outlines.

        Parameters
        ----------
        **options
            Position, orientation and style of the source.

        Returns
        -------
        Any
            The source.

        Raises
        ------
        InputError
            For options that magpylib refuses.
        """
        from fieldmap.magpylib_source import source_of_field

        return source_of_field(self, self._domain, self.outlines, **options)


class FixedCurrents(FieldAtCurrents):
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
        """Assumptions of the field."""
        return self.source.assumptions

    @property
    def reaction(self) -> Reaction | None:
        """The reaction of the field's iron."""
        return self.source.reaction

    @property
    def has_iron(self) -> bool:
        """Whether the field has iron."""
        return self.source.has_iron

    def field(self, points: ArrayLike) -> Array:
        """B (n, 3), T."""
        return self.source.field(points, self.currents)

    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return self.source.gradient(points, self.currents)

    def field_and_gradient(self, points: ArrayLike) -> tuple[Array, Array]:
        """B (n, 3), T, and dB_i/dx_j (n, 3, 3), T/m."""
        return self.source.field_and_gradient(points, self.currents)

    def second_gradient(self, points: ArrayLike) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2."""
        return self.source.second_gradient(points, self.currents)

    def outlines(self) -> Sequence[Any]:
        """Outlines of the field."""
        return self.source.outlines()


class FieldOfStates(Field):
    """A field that is evaluated from its states: the methods of `at(currents)` compute all quantities."""

    @abstractmethod
    def at(self, currents: Any) -> FieldAtCurrents:
        """The state at these currents."""

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T, of the state at these currents."""
        return self.at(currents).field(points)

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m, of the state at these currents."""
        return self.at(currents).gradient(points)

    def field_and_gradient(self, points: ArrayLike, currents: Any) -> tuple[Array, Array]:
        """B and dB_i/dx_j of the state at these currents."""
        return self.at(currents).field_and_gradient(points)

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """d2B_i/dx_j dx_k (n, 3, 3, 3), T/m^2, of the state at these currents."""
        return self.at(currents).second_gradient(points)


class CompletedField(Field):
    """A `Field` made of an object for `as_field`, which may have further members of `Field`. bounds: replaces the box
    of the object."""

    def __init__(self, source: Any, bounds: Bounds | None = None) -> None:
        self.source = source
        self._bounds = None if bounds is None else _box(*bounds)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return tuple(self.source.coil_names)

    @property
    def bounds(self) -> Bounds | None:
        """The given box, or the box of the object."""
        if self._bounds is not None:
            return self._bounds
        if hasattr(self.source, "bounds"):
            return self.source.bounds
        if hasattr(self.source, "lower") and hasattr(self.source, "upper"):
            return _box(self.source.lower, self.source.upper)
        return None

    @property
    def proportional(self) -> bool:
        """The object's own value; otherwise False."""
        return bool(getattr(self.source, "proportional", False))

    @property
    def affine(self) -> bool:
        """The object's own value; otherwise `proportional`."""
        return bool(getattr(self.source, "affine", self.proportional))

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The object's own assumptions; otherwise none."""
        return tuple(getattr(self.source, "assumptions", ()))

    @property
    def reaction(self) -> Reaction | None:
        """The object's own reaction; otherwise None."""
        return getattr(self.source, "reaction", None)

    @property
    def has_iron(self) -> bool:
        """The object's own value; otherwise False."""
        return bool(getattr(self.source, "has_iron", False))

    def field(self, points: ArrayLike, currents: Any) -> Array:
        """B (n, 3), T."""
        own = getattr(self.source, "field", None)
        return np.asarray(self._pair(points, currents)[0] if own is None else own(points, currents))

    def gradient(self, points: ArrayLike, currents: Any) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        own = getattr(self.source, "gradient", None)
        return np.asarray(self._pair(points, currents)[1] if own is None else own(points, currents))

    def field_and_gradient(self, points: ArrayLike, currents: Any) -> tuple[Array, Array]:
        """The object's own method; otherwise `field` and `gradient`."""
        if hasattr(self.source, "field_and_gradient"):
            return self._pair(points, currents)
        return super().field_and_gradient(points, currents)

    def gradient_jump(self, currents: Array) -> float:
        """The object's own value; otherwise 0."""
        own = getattr(self.source, "gradient_jump", None)
        return 0.0 if own is None else float(own(currents))

    def second_gradient(self, points: ArrayLike, currents: Any) -> Array:
        """The object's own; otherwise by central differences of the gradient."""
        own = getattr(self.source, "second_gradient", None)
        return super().second_gradient(points, currents) if own is None else np.asarray(own(points, currents))

    def _pair(self, points: ArrayLike, currents: Any) -> tuple[Array, Array]:
        flux, slope = self.source.field_and_gradient(points, currents)
        return flux, slope


class CompletedState(FieldAtCurrents):
    """A `FieldAtCurrents` made of an object with `coil_names`, `currents`, `field` and `gradient`."""

    def __init__(self, source: Any) -> None:
        self.source = source
        self.currents = np.asarray(source.currents, dtype=float)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return tuple(self.source.coil_names)

    @property
    def bounds(self) -> Bounds | None:
        """The object's box; None without one."""
        return getattr(self.source, "bounds", None)

    @property
    def assumptions(self) -> tuple[str, ...]:
        """The object's own assumptions; otherwise none."""
        return tuple(getattr(self.source, "assumptions", ()))

    def field(self, points: ArrayLike) -> Array:
        """B (n, 3), T."""
        return np.asarray(self.source.field(points))

    def gradient(self, points: ArrayLike) -> Array:
        """dB_i/dx_j (n, 3, 3), T/m."""
        return np.asarray(self.source.gradient(points))

    def second_gradient(self, points: ArrayLike) -> Array:
        """The object's own; otherwise by central differences of the gradient."""
        own = getattr(self.source, "second_gradient", None)
        return super().second_gradient(points) if own is None else np.asarray(own(points))


class StateField(FieldOfStates):
    """A `Field` that is known at one set of currents only, such as a solved state of saturating iron.

    state: a `FieldAtCurrents`, or an object for `CompletedState`. Other currents than the state's raise InputError,
    because the field does not superpose.
    """

    def __init__(self, state: Any, bounds: Bounds | None = None) -> None:
        self.state: FieldAtCurrents = state if isinstance(state, FieldAtCurrents) else CompletedState(state)
        self._bounds = None if bounds is None else _box(*bounds)

    @property
    def coil_names(self) -> tuple[str, ...]:
        """Names in the order of the currents."""
        return tuple(self.state.coil_names)

    @property
    def currents(self) -> Array:
        """The only currents (n_coils,), A."""
        return np.asarray(self.state.currents, dtype=float)

    @property
    def bounds(self) -> Bounds | None:
        """The given box, or the box of the state."""
        return self._bounds if self._bounds is not None else self.state.bounds

    @property
    def reaction(self) -> Reaction | None:
        """The reaction of the state's iron."""
        return self.state.reaction

    @property
    def has_iron(self) -> bool:
        """Whether the state has iron."""
        return self.state.has_iron

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of the state."""
        return self.state.assumptions

    def at(self, currents: Any) -> FieldAtCurrents:
        """The state, if these are its currents. Raises InputError for other currents."""
        if not np.array_equal(coil_currents(currents, self.coil_names), self.currents):
            must_hold = "must be the currents of the state: saturating iron does not superpose"
            received = f"{np.asarray(currents).tolist()}, while the state holds {self.currents.tolist()}"
            raise InputError.of("currents", must_hold, received, "solve a state at these currents")
        return self.state


def as_field(source: AnyField, bounds: Bounds | None = None) -> Field:
    """Return the object itself if it is a `Field` and no other box is given; otherwise make a `Field` of it.

    Parameters
    ----------
    source
        An object with `coil_names`, `field(points, currents)` and `gradient(points, currents)`, or with
        `field_and_gradient(points, currents)` instead of these two methods. `second_gradient`, `bounds` (or `lower`
        and `upper`), `proportional` and `assumptions` are used if the object has them. Or a state with `currents`,
        `field(points)` and `gradient(points)`; the field is then valid at these currents only.
    bounds
        Lower and upper corner (3,) of the box, m; the source's own unless given.

    Returns
    -------
    Field
        The field.

    Raises
    ------
    InputError
        For an object without the required members.

    Examples
    --------
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
    if isinstance(source, StateField):
        return StateField(source.state, bounds)
    pair = hasattr(source, "field_and_gradient") and not hasattr(source, "currents")
    needed = ("coil_names",) if pair else ("coil_names", "field", "gradient")
    missing = [name for name in needed if not hasattr(source, name)]
    if missing:
        must_hold = "must have coil_names, field(points, currents) and gradient(points, currents)"
        received = f"{type(source).__name__} without {', '.join(missing)}"
        raise InputError.of("field", must_hold, received, "give a solution, a map, or a field of your own")
    if not isinstance(source, Field) and hasattr(source, "currents"):
        return StateField(source, bounds)
    return CompletedField(source, bounds)


def resolve_currents(source: AnyField, currents: Any) -> tuple[Field, Array]:
    """The field, and the currents at which to evaluate it.

    Parameters
    ----------
    source
        A field, or an object for `as_field`.
    currents
        Currents as for `Field.field`; None for the currents of a state.

    Returns
    -------
    tuple[Field, Array]
        The field, and currents (n_coils,), A.

    Raises
    ------
    InputError
        For an object that is not a field, for currents that do not fit, and for None if the field is not a state.
    """
    field = as_field(source)
    if currents is None:
        if not isinstance(field, StateField):
            names = ", ".join(field.coil_names)
            must_hold = f"must be given for a field of coils ({names})"
            raise InputError.of("currents", must_hold, "none", "give one current per coil, A")
        return field, field.currents
    amperes = coil_currents(currents, field.coil_names)
    warn_if_unusual("currents", amperes, "A", stacklevel=3)
    return field, amperes


def _box(lower: ArrayLike, upper: ArrayLike) -> Bounds:
    return np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)


def require_bounds(source: TakesPoints) -> Bounds:
    """The box of a field.

    Parameters
    ----------
    source
        The field.

    Returns
    -------
    Bounds
        Lower and upper corner (3,), m.

    Raises
    ------
    InputError
        For a field without a box.
    """
    bounds = source.bounds
    if bounds is None:
        remedy = "add a [workspace] table to the device, or give the box: as_field(field, (lower, upper))"
        raise InputError.of(type(source).__name__, "must have a box in which it is used", "none", remedy)
    return bounds[0], bounds[1]


def require_affine(source: Field, what: str) -> None:
    """Refuse a field that is not the sum of its coils' fields and a constant.

    Parameters
    ----------
    source
        The field.
    what
        Name of the caller, at the beginning of the message.

    Raises
    ------
    InputError
        For a field that is not affine.
    """
    if not source.affine:
        must_hold = "a field that is the sum of its coils' fields, and of one that no current changes"
        received = "one that does not superpose, such as that of saturating iron"
        raise InputError.of(what, must_hold, received, "give the currents: at(currents)")


def coil_currents(
    currents: Any, coil_names: tuple[str, ...], points: int | None = None, finite: bool = True
) -> Array:
    """Currents in the order of the coils.

    Parameters
    ----------
    currents
        Currents, A: an array, one number for all coils, or a mapping by coil name. Coils that are not in the
        mapping carry no current.
    coil_names
        Names in the order of the currents.
    points
        Number of points, if currents (points, n_coils) are accepted too.
    finite
        Whether NaN and infinity are refused.

    Returns
    -------
    Array
        Currents (n_coils,) or (points, n_coils), A, in C order.

    Raises
    ------
    InputError
        For a wrong number of currents, and for names of coils that do not exist.

    Examples
    --------
    >>> coil_currents(1.5, ("left", "right"))
    array([1.5, 1.5])
    >>> coil_currents({"right": 2.0, "left": 1.0}, ("left", "right"))
    array([1., 2.])
    """
    count = len(coil_names)
    if isinstance(currents, Mapping):
        values = _by_name(currents, coil_names)
    elif currents is None:  # numpy would turn None into NaN
        raise InputError(_wrong(coil_names, points, "none"))
    else:
        try:
            # Writeable, because numba would compile its kernels again for a read-only array.
            values = np.require(currents, np.float64, ["C", "W"])
        except (TypeError, ValueError, MemoryError):
            raise InputError(_wrong(coil_names, points, repr(currents)[:80])) from None
    if values.ndim == 0:
        values = np.full(count, float(values))
    if values.shape != (count,) and (points is None or values.shape != (points, count)):
        raise InputError(_wrong(coil_names, points, f"shape {values.shape}"))
    if finite and not np.isfinite(values).all():
        raise InputError(_wrong(coil_names, points, f"{values}"))
    return values


def _by_name(currents: Mapping[str, float], coil_names: tuple[str, ...]) -> Array:
    unknown = [str(name) for name in currents if name not in coil_names]
    if unknown:
        raise InputError(_wrong(coil_names, None, f"unknown {', '.join(sorted(unknown))}"))
    try:
        return np.array([float(currents.get(name, 0.0)) for name in coil_names])
    except (TypeError, ValueError):
        raise InputError(_wrong(coil_names, None, repr(dict(currents))[:80])) from None


def _wrong(coil_names: tuple[str, ...], points: int | None, received: str) -> Problem:
    count = len(coil_names)
    shapes = f"shape ({count},)" if points is None else f"shape ({count},) or ({points}, {count})"
    must_hold = (
        f"must be one finite current per coil ({', '.join(coil_names)}): {shapes}, one number, or by name"
    )
    return Problem("currents", must_hold, received, "give amperes in the order of coil_names")


def dipole_wrench(flux: Array, slope: Array, moments: ArrayLike) -> Array:
    """Force and torque on point dipoles in a field and its gradient.

    T = m x B and F = grad(m . B) = (grad B)^T m, docs/theory/wrench.md (1) and (2) for a point. F equals
    (m . grad) B where B is curl-free. For a fixed moment F is conservative even if an interpolated B has some curl.

    Parameters
    ----------
    flux
        Flux density (n, 3), T.
    slope
        Gradient dB_i/dx_j (n, 3, 3), T/m.
    moments
        Moments (3,) or (n, 3), A m^2.

    Returns
    -------
    Array
        Force, N, and torque, N m (n, 6).
    """
    dipoles, _ = checked_vectors("moments", moments)
    if len(dipoles) not in (1, len(flux)):
        received = f"{len(dipoles)} moments for {len(flux)} positions"
        problem = Problem("moments", "one for all positions or one each", received, "match them")
        raise InputError(problem)
    dipoles = np.broadcast_to(dipoles, flux.shape)
    force = np.einsum("nij,ni->nj", slope, dipoles)
    return np.concatenate([force, np.cross(dipoles, flux)], axis=1)


def refuse_orientations(orientations: ArrayLike | None) -> None:
    """Refuse orientations of point dipoles, whose moments are in the frame of the field.

    Parameters
    ----------
    orientations
        The orientations that the caller was given.

    Raises
    ------
    InputError
        For anything but None.
    """
    if orientations is not None:
        must_hold, remedy = "orientations are those of a body", "turn the moments, or give a MagneticBody"
        raise InputError.of("wrench, orientations", must_hold, "moments and orientations", remedy)


def _wrench(
    field: Field | FieldAtCurrents,
    positions: ArrayLike,
    moments: ArrayLike | MagneticLoad,
    currents: Any,
    orientations: ArrayLike | None,
    field_and_gradient: Callable[[Array], tuple[Array, Array]],
) -> Array:
    """Force and torque (n, 6) of a field on dipoles or a body."""
    if isinstance(moments, MagneticLoad):
        return moments.wrench(field, positions, currents, orientations)
    refuse_orientations(orientations)
    where, single = checked_vectors("positions", positions)
    result = dipole_wrench(*field_and_gradient(where), moments)
    if field.reaction is not None:
        result += dipole_wrench(
            *own_reaction(field.reaction, where, checked_vectors("moments", moments)[0]), moments
        )
    return result[0] if single else result


def differenced(gradient: Any, points: ArrayLike, step: float = STEP) -> Array:
    """Second gradient by central differences of a gradient.

    Parameters
    ----------
    gradient
        Called as gradient(points), with points (n, 3); gives (n, 3, 3), T/m.
    points
        Positions (3,) or (n, 3), m.
    step
        Step h of the differences (g(x + h) - g(x - h)) / (2 h), m.

    Returns
    -------
    Array
        (3, 3, 3) or (n, 3, 3, 3), T/m^2; the last index is the differenced one.
    """
    where = np.asarray(points, dtype=float)
    at = np.atleast_2d(where)
    steps = step * np.eye(3)
    shifted = np.concatenate([at + steps[:, None, :], at - steps[:, None, :]]).reshape(-1, 3)
    values = gradient(shifted).reshape(2, 3, len(at), 3, 3)
    second = np.moveaxis((values[0] - values[1]) / (2.0 * step), 0, -1)
    return second[0] if where.ndim == 1 else second

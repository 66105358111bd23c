"""Actuation matrices: field, force and torque per ampere in each coil, and the largest values within current limits.

docs/theory/actuation.md. Rows are components, columns coils. The field of fixed sources is in `constant`. For
saturating iron a matrix holds about given currents.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive, checked_vectors
from fieldmap.errors import InputError
from fieldmap.field import AnyField, Field, as_field, coil_currents
from fieldmap.lookup.magnetic_body import MagneticBody, checked_turns, loaded, reacting_at
from fieldmap.records import Record
from fieldmap.typing import Array

FIELD_ROWS = ("Bx", "By", "Bz")
GRADIENT_ROWS = ("dBx/dx", "dBx/dy", "dBx/dz", "dBy/dy", "dBy/dz")
FORCE_ROWS = ("Fx", "Fy", "Fz")
TORQUE_ROWS = ("Tx", "Ty", "Tz")
# A singular value below this share of the largest, rows scaled to length 1, counts as zero.
RANK = 1e-10


@dataclass(frozen=True, eq=False, repr=False)
class Actuation(Record):
    """A matrix (rows, n_coils): matrix @ currents + constant are the named components in SI units, currents in A.

    constant (rows,): the part that the currents do not change; None for zero.
    """

    rows: tuple[str, ...]
    matrix: Array
    constant: Array | None = None

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the unscaled matrix, largest first. They make sense only for rows of one unit."""
        return np.asarray(np.linalg.svd(self.matrix, compute_uv=False), float)

    @cached_property
    def null_space(self) -> Array:
        """Orthonormal currents (n_coils, k) that change none of the rows."""
        _, size, right = np.linalg.svd(self._scaled)
        rank = int(np.sum(size > RANK * size.max(initial=0.0)))
        return np.asarray(right[rank:].T)

    @property
    def _scaled(self) -> Array:
        """The matrix with rows of length 1."""
        length = np.linalg.norm(self.matrix, axis=1)
        return np.asarray(self.matrix / np.where(length > 0, length, 1.0)[:, None])

    @property
    def rank(self) -> int:
        """Number of independent combinations of the rows that the currents command."""
        return self.matrix.shape[1] - self.null_space.shape[1]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value, with rows of length 1; infinite if the rank is below their number."""
        if self.rank < len(self.rows):
            return float("inf")
        size = np.linalg.svd(self._scaled, compute_uv=False)
        return float(size[0] / size[-1])

    def largest(self, directions: ArrayLike, limits: Limits) -> Array:
        """Largest component along each direction for currents within the limits, with all other components free.

        It is sum_k max(lower_k a_k, upper_k a_k) + direction . constant with a = direction . matrix.

        Parameters
        ----------
        directions
            Directions (k, rows).
        limits
            Largest magnitude of the currents, or (lower, upper), A. Infinite limits give infinity.

        Returns
        -------
        Array
            Components (k,), in the rows' units.

        Examples
        --------
        >>> pair = Actuation(("Fx",), np.array([[0.1, -0.3]]))
        >>> pair.largest([[1.0], [-1.0]], 2.0)
        array([0.8, 0.8])
        """
        axes = np.atleast_2d(np.asarray(directions, dtype=np.float64))
        found = _supported(axes @ self.matrix, *checked_limits(limits, self.matrix.shape[1]))
        return found if self.constant is None else found + axes @ self.constant


Limits = float | tuple[ArrayLike, ArrayLike] | None


def actuation(
    field: AnyField,
    position: ArrayLike,
    currents: Any,
    moment: ArrayLike | MagneticBody | None = None,
    orientation: ArrayLike | None = None,
    loop: float | None = None,
) -> Actuation:
    """Actuation matrix at a position, about given currents.

    matrix @ i + constant are the components at currents i. This is exact if the field superposes and the body has no
    soft iron. Otherwise it holds to first order about `currents`; for the error see `FieldMap.by_currents`.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    position
        Position (3,) in the frame of the field, m.
    currents
        Currents (n_coils,), A, about which the matrix holds.
    moment
        Moment of a dipole (3,), A m^2, or a `MagneticBody`; None for the rows of the field alone.
    orientation
        Rotation (3, 3) of a body, with its axes as columns; upright unless given.
    loop
        Size of current loops, A, whose slopes replace the derivatives: see `FieldMap.by_currents`. A field that
        superposes has the same slopes.

    Returns
    -------
    Actuation
        The matrix (8, n_coils) of flux density, T/A, and the five independent entries of its gradient, T/(m
        A); with a moment (14, n_coils), force, N/A, and torque, N m/A, below.

    Raises
    ------
    InputError
        For a field that neither superposes nor has derivatives by its currents, and for a loop that is not positive.
    """
    if loop is not None:
        check_positive("actuation", loop=loop)
    rows: tuple[str, ...] = FIELD_ROWS + GRADIENT_ROWS
    selection = _SELECTED
    moment = None if moment is None else loaded(as_field(field), moment)
    if isinstance(moment, MagneticBody):
        field_rows = _selected(field, position, rows, selection, currents, loop)
        return _joined(field_rows, _on_body(field, position, moment, currents, orientation, loop))
    if moment is not None:
        rows += FORCE_ROWS + TORQUE_ROWS
        selection = np.concatenate([_SELECTED, dipole_rows(_one(moment))])
    return _selected(field, position, rows, selection, currents, loop)


def field_actuation(field: AnyField, position: ArrayLike, currents: Any = None) -> Actuation:
    """Matrix of the flux density at a position.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    position
        Position (3,) in the frame of the field, m.
    currents
        Currents (n_coils,), A, about which the matrix holds; needed for saturating iron.

    Returns
    -------
    Actuation
        The matrix (3, n_coils), T/A.

    Raises
    ------
    InputError
        As for `actuation`.
    """
    return _selected(field, position, FIELD_ROWS, _SELECTED[:3], currents)


def gradient_actuation(field: AnyField, position: ArrayLike, currents: Any = None) -> Actuation:
    """Matrix of the flux density and the five independent entries of its gradient.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    position
        Position (3,) in the frame of the field, m.
    currents
        Currents (n_coils,), A, about which the matrix holds; needed for saturating iron.

    Returns
    -------
    Actuation
        The matrix (8, n_coils), T/A and T/(m A).

    Raises
    ------
    InputError
        As for `actuation`.
    """
    return _selected(field, position, FIELD_ROWS + GRADIENT_ROWS, _SELECTED, currents)


def wrench_actuation(
    field: AnyField,
    position: ArrayLike,
    moment: ArrayLike | MagneticBody,
    currents: Any = None,
    orientation: ArrayLike | None = None,
) -> Actuation:
    """Matrix of force and torque on a dipole or a body.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    position
        Position (3,) in the frame of the field, m.
    moment
        Moment of the dipole (3,), A m^2, or a `MagneticBody`.
    currents
        Currents (n_coils,), A, about which the matrix holds; needed for saturating iron and for soft iron in the body.
    orientation
        Rotation (3, 3) of a body, with its axes as columns; upright unless given.

    Returns
    -------
    Actuation
        The matrix (6, n_coils), N/A and N m/A.

    Raises
    ------
    InputError
        As for `actuation`.
    """
    moment = loaded(as_field(field), moment)
    if isinstance(moment, MagneticBody):
        return _on_body(field, position, moment, currents, orientation)
    return _selected(field, position, FORCE_ROWS + TORQUE_ROWS, dipole_rows(_one(moment)), currents)


# Rows of B and the independent entries of G on (B, G row by row).
_SELECTED = np.eye(12)[[0, 1, 2, 3, 4, 5, 7, 8]]


def dipole_rows(moment: Array) -> Array:
    """Matrix (6, 12) from (B, G row by row) to force F_j = m_i G_ij and torque m x B on a dipole."""
    force = np.hstack([np.zeros((3, 3)), np.kron(moment, np.eye(3))])
    x, y, z = moment
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.concatenate([force, np.hstack([turn, np.zeros((3, 9))])])


def derivatives_by_currents(
    source: Field, points: Array, currents: Any, loop: float | None = None
) -> tuple[Array, Array, Array, Array]:
    """B and gradient per ampere, (p, n, 3) and (p, n, 3, 3), at points (p, 3), and the part (p, 3) and (p, 3, 3) that
    the currents do not change. Together they are the field at any currents, for saturating iron to first order about
    `currents`."""
    by_currents = getattr(source, "by_currents", None)
    if source.affine or currents is None or by_currents is None:
        # Raises InputError for a field that neither superposes nor has derivatives.
        by_flux, by_slope = source.unit_field(points), source.unit_gradient(points)
        return by_flux, by_slope, source.constant_field(points), source.constant_gradient(points)
    amperes = coil_currents(currents, source.coil_names)
    loops = {} if loop is None else {"loop": loop}
    flux, slope, by_flux, by_slope = by_currents(points, amperes, **loops)
    flux = flux - np.einsum("pni,n->pi", by_flux, amperes)
    return by_flux, by_slope, flux, slope - np.einsum("pnij,n->pij", by_slope, amperes)


def _on_body(
    field: AnyField,
    position: ArrayLike,
    body: MagneticBody,
    currents: Any,
    orientation: ArrayLike | None,
    loop: float | None = None,
) -> Actuation:
    """Force and torque on a body about currents, and their derivatives by them."""
    source, turn = as_field(field), checked_turns(orientation, 1)[0]
    if currents is None and body.soft:
        must_hold = "currents about which the force on soft iron is linear"
        raise InputError.of("actuation, currents", must_hold, "none", "give those of the operating point")
    coils = len(source.coil_names)
    amperes = np.zeros(coils) if currents is None else coil_currents(currents, source.coil_names)
    points = _one(position) + body.all_points @ turn.T
    by_flux, by_slope, *rest = derivatives_by_currents(source, points, amperes, loop)
    # The part of the field that is not proportional to the currents is one more field, of weight 1.
    every = [np.concatenate([a, b[:, None]], axis=1) for a, b in zip((by_flux, by_slope), rest, strict=True)]
    reacts = reacting_at(source.reaction, points)
    wrench, slopes = body.by_fields(every[0], every[1], turn, reacts)(np.append(amperes, 1.0))
    matrix = np.ascontiguousarray(slopes[:, :coils])
    plain = source.proportional and not body.soft and source.reaction is None
    return Actuation(FORCE_ROWS + TORQUE_ROWS, matrix, None if plain else wrench - matrix @ amperes)


def _joined(one: Actuation, other: Actuation) -> Actuation:
    constant = None
    if one.constant is not None or other.constant is not None:
        parts = (np.zeros(len(a.rows)) if a.constant is None else a.constant for a in (one, other))
        constant = np.concatenate(list(parts))
    return Actuation(one.rows + other.rows, np.concatenate([one.matrix, other.matrix]), constant)


def _selected(
    field: AnyField,
    position: ArrayLike,
    rows: tuple[str, ...],
    selection: Array,
    currents: Any,
    loop: float | None = None,
) -> Actuation:
    """Actuation of the components selection (rows, 12) @ (B, G row by row)."""
    source = as_field(field)
    by_flux, by_slope, flux, slope = derivatives_by_currents(source, _one(position)[None], currents, loop)

    def chosen(flux: Array, slope: Array) -> Array:
        both = np.concatenate([flux, slope.reshape(*flux.shape[:-1], 9)], axis=-1)
        return np.ascontiguousarray(selection @ both.T)

    matrix = chosen(by_flux[0], by_slope[0])
    return Actuation(rows, matrix, None if source.proportional else chosen(flux[0], slope[0]))


def capability(
    field: AnyField, positions: ArrayLike, moment: ArrayLike, directions: ArrayLike, limits: Limits
) -> tuple[Array, Array]:
    """Largest force and torque on a dipole along given directions.

    Each value leaves the other components free: see `Actuation.largest`. `currents_for` finds currents for several
    components at once.

    Parameters
    ----------
    field
        Any field: see `fieldmap.field.as_field`.
    positions
        Positions (n, 3) in the frame of the field, m.
    moment
        Moment of the dipole (3,), A m^2.
    directions
        Directions (k, 3).
    limits
        Largest magnitude of the currents, or (lower, upper), A; None for no limits.

    Returns
    -------
    tuple[Array, Array]
        Force, N, and torque, N m (n, k).
    """
    where, _ = checked_vectors("positions", positions)
    axes, _ = checked_vectors("directions", directions)
    axes = axes / np.linalg.norm(axes, axis=1)[:, None]
    dipole = _one(moment)
    source = as_field(field)
    flux, slope = source.unit_field(where), source.unit_gradient(where)
    low, high = checked_limits(limits, flux.shape[1])
    force = np.einsum("ncij,i,dj->ndc", slope, dipole, axes)
    torque = np.einsum("ncj,dj->ndc", np.cross(dipole, flux), axes)
    most_force, most_torque = _supported(force, low, high), _supported(torque, low, high)
    if source.proportional and source.reaction is None:
        return most_force, most_torque
    # Force and torque without currents.
    pull, turn = np.hsplit(source.wrench(where, dipole, np.zeros(len(source.coil_names))), 2)
    return most_force + pull @ axes.T, most_torque + turn @ axes.T


def checked_limits(limits: Limits, n_coils: int) -> tuple[Array, Array]:
    """Lower and upper limits (n_coils,), A, from a number (both ways), a pair, or None. Raises InputError."""
    if limits is None:
        return np.full(n_coils, -np.inf), np.full(n_coils, np.inf)
    if isinstance(limits, int | float) and limits >= 0:
        return np.full(n_coils, -float(limits)), np.full(n_coils, float(limits))
    try:
        # The ends of a pair may be of different shapes, a number and one number per coil.
        pair = limits if isinstance(limits, Sequence | np.ndarray) else (np.negative(limits), limits)
        # Copies: a read-only array is another type to a compiled kernel.
        low, high = (np.array(np.broadcast_to(np.asarray(v, float), n_coils)) for v in pair)
        good = bool(np.all(low <= high))
    except (TypeError, ValueError):
        good = False
    if not good:
        wanted = (
            f"a number, or a pair of lower and upper, each a number or {n_coils} of them, lower <= upper, A"
        )
        raise InputError.of("limits", wanted, repr(limits)[:80], "give for example 3.5 or (0.0, 3.5)")
    return low, high


def _supported(along: Array, low: Array, high: Array) -> Array:
    """Sum over the last axis of the larger of the two ends; a coil without effect adds nothing."""
    with np.errstate(invalid="ignore"):
        ends = np.maximum(along * low, along * high)
    return np.asarray(np.where(along == 0.0, 0.0, ends).sum(axis=-1))


def _one(vector: ArrayLike) -> Array:
    checked, single = checked_vectors("position and moment", vector)
    if not single:
        received = f"shape {checked.shape}"
        raise InputError.of("actuation", "one vector of three numbers", received, "ask pose by pose")
    return checked[0]

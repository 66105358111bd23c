"""Force and torque on a payload: dipoles of fixed moment, and soft iron whose moment the field induces.

    F_k = sum m_i dB_i/dx_k      T = sum m x B + r x F            docs/theory/wrench.md (1), (2), (5)..(10)

over the dipoles that stand for its magnets and one for each ellipsoid of soft iron, r from the body's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_signal, checked_vectors
from fieldmap.core.body import CoreBody
from fieldmap.errors import InputError
from fieldmap.field import AnyField, as_field, coil_currents
from fieldmap.lookup.soft_body import ASSUMPTION, SoftPiece, core_piece
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class MagneticBody(Record):
    """A rigid body as dipoles: points (q, 3), m, and moments (q, 3), A m^2, in its own frame, of its magnets; and its
    pieces of soft iron, each a dipole that the field induces.

    error: largest difference of force and torque from the next finer rule that was found in the field the rule was
    chosen for, relative to the largest force and torque there; None for a rule that was not chosen so. Assumes rigid,
    uniform magnetisation of the magnets (recoil permeability 1), soft iron that is small against the distance over
    which the field changes, and no mutual magnetisation of the pieces.

    >>> MagneticBody(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])).moment
    0.8
    """

    points: Array
    moments: Array
    error: float | None = None
    soft: tuple[SoftPiece, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError for points and moments that are not as many finite vectors."""
        shape, other = np.shape(self.points), np.shape(self.moments)
        fits = shape == other and len(shape) == 2 and shape[1] == 3
        received, remedy = f"shapes {shape} and {other}", "give a row for each dipole"
        check(fits, "MagneticBody(points, moments)", "must both have the shape (q, 3)", received, remedy)
        check_signal("MagneticBody(points)", self.points)
        check_signal("MagneticBody(moments)", self.moments)

    @property
    def moment(self) -> float:
        """Magnitude of the whole fixed moment, A m^2."""
        return float(np.linalg.norm(self.moments.sum(axis=0)))

    @property
    def count(self) -> int:
        """At how many points the field acts on it."""
        return len(self.points) + len(self.soft)

    @cached_property
    def core(self) -> CoreBody:
        """The body as the C core takes it."""
        dipoles = np.concatenate([self.points, self.moments], axis=1, dtype=np.float64)
        return CoreBody(np.ascontiguousarray(dipoles), [core_piece(piece) for piece in self.soft])

    @cached_property
    def all_points(self) -> Array:
        """These points (count, 3), m: of the fixed dipoles, then the centres of the soft pieces."""
        if not self.soft:
            return self.points
        return np.concatenate([self.points, [piece.centre for piece in self.soft]])

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What its force rests on beyond that of rigid magnets."""
        return (ASSUMPTION,) if self.soft else ()

    def wrench(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Force and torque on the body about its centre.

        Parameters
        ----------
        field
            Any field: see `fieldmap.field.as_field`.
        positions
            Centres (3,) or (n, 3) in the frame of the field, m.
        currents
            Currents (n_coils,) or (n, n_coils), A.
        orientations
            Rotations (3, 3) or (n, 3, 3) whose columns are the body's axes; upright unless given.

        Returns
        -------
        Array
            Force, N, and torque, N m (n, 6); (6,) for one position (3,).

        Raises
        ------
        OutsideMapError
            Where a part of the body is outside the field.
        """
        arms, turn, flux, slope, single = self._asked(field, positions, currents, orientations)
        dipoles, _, _ = self._moments(turn, flux)
        result = _wrench(arms, dipoles, flux, slope)
        return result[0] if single else result

    def energy(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Interaction energy: -m . B of the magnets, -integral of m dB of soft iron.

        `wrench` is minus its gradient, by place and turn.

        Parameters
        ----------
        field, positions, currents, orientations
            As for `wrench`.

        Returns
        -------
        Array
            Energy (n,), J.
        """
        _, turn, flux, _, single = self._asked(field, positions, currents, orientations)
        dipoles, induced, _ = self._moments(turn, flux)
        fixed = len(self.points)
        values = induced.sum(axis=1) - np.einsum("nqi,nqi->n", dipoles[:, :fixed], flux[:, :fixed])
        return values[0] if single else values

    def induced_moment(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Moments of the soft pieces in the frame of the field.

        Parameters
        ----------
        field, positions, currents, orientations
            As for `wrench`.

        Returns
        -------
        Array
            Moments (n, s, 3) of s soft pieces, A m^2.
        """
        _, turn, flux, _, single = self._asked(field, positions, currents, orientations)
        dipoles = self._moments(turn, flux)[0][:, len(self.points) :]
        return dipoles[0] if single else dipoles

    def whole_moment(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Moment of the whole body in the frame of the field.

        Parameters
        ----------
        field, positions, currents, orientations
            As for `wrench`.

        Returns
        -------
        Array
            Moment (n, 3), A m^2.
        """
        _, turn, flux, _, single = self._asked(field, positions, currents, orientations)
        total = self._moments(turn, flux)[0].sum(axis=1)
        return total[0] if single else total

    def stiffness(
        self, field: AnyField, position: ArrayLike, currents: Any, orientation: ArrayLike | None = None
    ) -> Array:
        """Stiffness of a body that does not turn; induced moments follow the field.

        Parameters
        ----------
        field
            Any field: see `fieldmap.field.as_field`.
        position
            Centre (3,) in the frame of the field, m.
        currents
            Currents (n_coils,), A.
        orientation
            Rotation (3, 3) whose columns are the body's axes; upright unless given.

        Returns
        -------
        Array
            -dF/dx (3, 3), N/m.
        """
        arms, turn, flux, slope, _ = self._asked(field, np.reshape(position, (1, 3)), currents, orientation)
        dipoles, _, by_field = self._moments(turn, flux, slopes=True)
        second = as_field(field).second_gradient(np.reshape(position, (1, 3)) + arms[0], currents)
        stiffness = -np.einsum("qi,qikl->kl", dipoles[0], second)
        soft = slope[0, len(self.points) :]
        return np.asarray(stiffness - np.einsum("pij,pjl,pik->kl", by_field[0], soft, soft))

    def by_fields(
        self, flux: Array, slope: Array, orientation: Array
    ) -> Callable[[Array], tuple[Array, Array]]:
        """Force and torque as a function of the weights of k fields.

        A soft piece's moment follows the weights, dm/dw = (dm/dB) dB/dw.

        Parameters
        ----------
        flux
            Flux density (count, k, 3), T, of these fields at weight 1 at the points of the body.
        slope
            Gradient (count, k, 3, 3), T/m, of these fields at weight 1 there.
        orientation
            Rotation (3, 3) whose columns are the body's axes.

        Returns
        -------
        Callable[[Array], tuple[Array, Array]]
            A function of weights (k,) that gives the wrench (6,) and its derivatives (6, k) by the weights.
        """
        turn, k = np.array(orientation, dtype=np.float64, order="C"), flux.shape[1]
        flux, slope = np.ascontiguousarray(flux), np.ascontiguousarray(slope)

        def load(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = np.empty(6), np.empty((6, k))
            self.core.wrench_slopes(turn, np.ascontiguousarray(weights), flux, slope, wrench, slopes)
            return wrench, slopes

        return load

    def _moments(self, turn: Array, flux: Array, slopes: bool = False) -> tuple[Array, Array, Array]:
        """Moments (n, count, 3) in the frame of the field; of the soft pieces the energies (n, s) and dm/dB
        (n, s, 3, 3), zero unless asked for."""
        n, s = len(flux), len(self.soft)
        fixed = np.einsum("nij,qj->nqi", turn, self.moments)
        induced, energies, by_field = np.empty((n, s, 3)), np.empty((n, s)), np.zeros((n, s, 3, 3))
        if not s:
            return fixed, energies, by_field
        at, turns = np.ascontiguousarray(flux[:, len(self.points) :]), np.ascontiguousarray(turn)
        self.core.induced_moments(turns, at, induced, energies, by_field if slopes else None)
        return np.concatenate([fixed, induced], axis=1), energies, by_field

    def _asked(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None
    ) -> tuple[Array, Array, Array, Array, bool]:
        where, single = checked_vectors("positions", positions)
        n, q = len(where), self.count
        turn = checked_turns(orientations, n)
        arms = np.einsum("nij,qj->nqi", turn, self.all_points)
        source = as_field(field)
        amperes = coil_currents(currents, source.coil_names, n, finite=False)
        if amperes.ndim == 2:
            amperes = np.repeat(amperes, q, axis=0)
        flux, slope = source.field_and_gradient((where[:, None] + arms).reshape(-1, 3), amperes)
        return arms, turn, flux.reshape(n, q, 3), slope.reshape(n, q, 3, 3), single


def _wrench(arms: Array, dipoles: Array, flux: Array, slope: Array) -> Array:
    """(n, 6) of dipoles (n, q, 3) at arms (n, q, 3) in flux (n, q, 3) and gradient (n, q, 3, 3)."""
    force = np.einsum("nqij,nqi->nqj", slope, dipoles)
    torque = np.cross(dipoles, flux) + np.cross(arms, force)
    return np.concatenate([force.sum(axis=1), torque.sum(axis=1)], axis=1)


def checked_turns(orientations: ArrayLike | None, n: int) -> Array:
    """Rotations of a body at every position.

    Parameters
    ----------
    orientations
        Rotations (3, 3) or (n, 3, 3); upright unless given.
    n
        How many positions there are.

    Returns
    -------
    Array
        Rotations (n, 3, 3).

    Raises
    ------
    InputError
        For what is no rotation, and for another number.
    """
    if orientations is None:
        return np.tile(np.eye(3), (n, 1, 1))
    turn = np.asarray(orientations, dtype=np.float64)
    good = turn.shape in ((3, 3), (n, 3, 3))
    if not good or not np.allclose(turn @ np.swapaxes(turn, -1, -2), np.eye(3), atol=1e-6):
        received = f"shape {turn.shape}" + (" but columns not orthonormal" if good else "")
        must_hold = f"rotation matrices of shape (3, 3) or ({n}, 3, 3)"
        raise InputError.of("wrench, orientations", must_hold, received, "columns are the magnet's axes")
    return np.broadcast_to(turn, (n, 3, 3))

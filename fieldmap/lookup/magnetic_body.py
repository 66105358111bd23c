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

from fieldmap.arguments import check, check_signal, check_vector, checked_vectors
from fieldmap.core.body import CoreBody
from fieldmap.errors import InputError, NotConverged
from fieldmap.field import AnyField, Field, as_field, coil_currents
from fieldmap.lookup.soft_body import ASSUMPTION, SoftPiece, core_piece
from fieldmap.reaction import Reaction, signs_of
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class MagneticBody(Record):
    """A rigid body as dipoles: points (q, 3), m, and moments (q, 3), A m^2, in its own frame, of its magnets; and its
    pieces of soft iron, each a dipole that the field induces (a bead is one or six of them: `soft_rule`).

    error: largest difference of force and torque from the next finer rule that was found in the field the rule was
    chosen for, relative to the largest force and torque there; None for a rule that was not chosen so. Assumes rigid,
    uniform magnetisation of the magnets (recoil permeability 1), pieces of soft iron that are small against the
    distance over which the field changes, and no mutual magnetisation of the pieces.

    >>> MagneticBody(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])).moment
    0.8
    """

    points: Array
    moments: Array
    error: float | None = None
    soft: tuple[SoftPiece, ...] = ()

    def __post_init__(self) -> None:
        """Raises InputError unless points and moments are finite arrays (q, 3) of one shape."""
        shape, other = np.shape(self.points), np.shape(self.moments)
        fits = shape == other and len(shape) == 2 and shape[1] == 3
        received, remedy = f"shapes {shape} and {other}", "give a row for each dipole"
        check(fits, "MagneticBody(points, moments)", "must both have the shape (q, 3)", received, remedy)
        check_signal("MagneticBody(points)", self.points)
        check_signal("MagneticBody(moments)", self.moments)

    @classmethod
    def dipole(cls, moment: ArrayLike) -> MagneticBody:
        """One dipole at the centre.

        Parameters
        ----------
        moment
            (3,), A m^2, in the body's frame.

        Returns
        -------
        MagneticBody
            The body.

        Raises
        ------
        InputError
            Unless the moment is three finite numbers.
        """
        given = check_vector("MagneticBody.dipole(moment)", moment, "give x, y, z in A m^2")
        return cls(np.zeros((1, 3)), given[None])

    @property
    def moment(self) -> float:
        """Magnitude of the whole fixed moment, A m^2."""
        return float(np.linalg.norm(self.moments.sum(axis=0)))

    @property
    def count(self) -> int:
        """Number of points at which the field acts on the body."""
        return len(self.points) + len(self.soft)

    @cached_property
    def core(self) -> CoreBody:
        """The body for the C core."""
        dipoles = np.concatenate([self.points, self.moments], axis=1, dtype=np.float64)
        return CoreBody(np.ascontiguousarray(dipoles), [core_piece(piece) for piece in self.soft])

    @cached_property
    def all_points(self) -> Array:
        """The points (count, 3), m: the fixed dipoles, then the centres of the soft pieces."""
        if not self.soft:
            return self.points
        return np.concatenate([self.points, [piece.centre for piece in self.soft]])

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Assumptions of its force besides rigid magnets."""
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
            If a part of the body is outside the field.
        NotConverged
            If soft iron and the machine's iron magnetise each other without limit.
        """
        found, single = self._found(field, positions, currents, orientations)
        return found.wrench[0] if single else found.wrench

    def energy(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Interaction energy: -m . B of the magnets, -integral of m dB of soft iron, and the energy of the reaction of
        the machine's iron, docs/theory/reaction.md (3).

        `wrench` is minus its gradient by place and rotation.

        Parameters
        ----------
        field, positions, currents, orientations
            As for `wrench`.

        Returns
        -------
        Array
            Energy (n,), J.
        """
        found, single = self._found(field, positions, currents, orientations)
        return found.energy[0] if single else found.energy

    def dipoles(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """The dipoles of the body in the frame of the field.

        Parameters
        ----------
        field, positions, currents, orientations
            As for `wrench`.

        Returns
        -------
        tuple[Array, Array]
            Arms (n, count, 3) from the centres, m, and moments (n, count, 3), A m^2: of the magnets, then of the soft
            pieces.
        """
        if not self.soft:
            turn = checked_turns(orientations, len(checked_vectors("positions", positions)[0]))
            return tuple(np.einsum("nij,qj->nqi", turn, of) for of in (self.points, self.moments))
        found, _ = self._found(field, positions, currents, orientations)
        where, _ = checked_vectors("positions", positions)
        return found.points.reshape(found.moments.shape) - where[:, None], found.moments

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
        found, single = self._found(field, positions, currents, orientations)
        dipoles = found.moments[:, len(self.points) :]
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
        found, single = self._found(field, positions, currents, orientations)
        total = found.moments.sum(axis=1)
        return total[0] if single else total

    def stiffness(
        self, field: AnyField, position: ArrayLike, currents: Any, orientation: ArrayLike | None = None
    ) -> Array:
        """Stiffness of a body that does not turn; induced moments follow the field.

        Parameters
        ----------
        field, position, currents, orientation
            As for `wrench`, of one body.

        Returns
        -------
        Array
            -dF/dx (3, 3), N/m.
        """
        found, _ = self._found(field, np.reshape(position, (1, 3)), currents, orientation, slopes=True)
        source, moments, by_field = as_field(field), found.moments[0], found.by_field[0]
        repelled, fields, gradients = found.reaction
        signs = signs_of(fields.shape[1], repelled)
        weights = signs * np.einsum("qki,qi->k", fields, moments)
        slope = found.slope + np.einsum("k,qkij->qij", weights, gradients)
        inside, soft = fields[len(self.points) :], slope[len(self.points) :]
        stiffness = -np.einsum("qi,qikl->kl", moments, source.second_gradient(found.points, currents))
        stiffness -= np.einsum("pij,pjl,pik->kl", by_field, soft, soft)
        if source.reaction is None:
            return stiffness
        second = source.reaction.second_gradient(found.points)
        # Weights of the reaction and soft moments change with the place: (1 - b chi b s) dw = m . db + b chi dB.
        moved = np.einsum("qkij,qi->kj", gradients, moments)
        moved += np.einsum("pki,pij,pjl->kl", inside, by_field, soft)
        coupled = np.eye(len(signs)) - np.einsum("pki,pij,plj->kl", inside, by_field, inside) * signs
        stiffness -= np.einsum("k,kqijl,qi->jl", weights, second, moments)
        return np.asarray(stiffness - (signs * moved.T) @ np.linalg.solve(coupled, moved))

    def by_fields(
        self, flux: Array, slope: Array, orientation: Array, reacts: tuple[int, Array, Array] | None = None
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
        reacts
            Result of `reacting_at` at these points; no reaction unless given.

        Returns
        -------
        Callable[[Array], tuple[Array, Array]]
            A function of weights (k,) that gives the wrench (6,) and its derivatives (6, k) by the weights.
        """
        turn, k = np.array(orientation, dtype=np.float64, order="C"), flux.shape[1]
        fields = np.ascontiguousarray(flux), np.ascontiguousarray(slope)
        reaction = reacts or reacting_at(None, flux)

        def load(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = np.empty(6), np.empty((6, k))
            self.core.wrench_slopes(turn, np.ascontiguousarray(weights), fields, reaction, wrench, slopes)
            return wrench, slopes

        return load

    def _found(
        self,
        field: AnyField,
        positions: ArrayLike,
        currents: Any,
        orientations: ArrayLike | None,
        slopes: bool = False,
    ) -> tuple[_Found, bool]:
        """Results of the C core, and whether a single position was given."""
        where, single = checked_vectors("positions", positions)
        n, q = len(where), self.count
        turn = np.ascontiguousarray(checked_turns(orientations, n))
        source = as_field(field)
        amperes = coil_currents(currents, source.coil_names, n, finite=False)
        if amperes.ndim == 2:
            amperes = np.repeat(amperes, q, axis=0)
        points = (where[:, None] + np.einsum("nij,qj->nqi", turn, self.all_points)).reshape(-1, 3)
        flux, slope = source.field_and_gradient(points, amperes)
        reaction = reacting_at(source.reaction, points)
        repelled, b, slopes_of_b = reaction
        of_bodies = repelled, b.reshape(n, q, -1, 3), slopes_of_b.reshape(n, q, -1, 3, 3)
        found = np.empty((n, 6)), np.empty(n), np.empty((n, q, 3)), np.empty((n, len(self.soft), 3, 3))
        own = np.ascontiguousarray(flux).reshape(n, q, 3), np.ascontiguousarray(slope).reshape(n, q, 3, 3)
        settled = self.core.at_poses(turn, own, of_bodies, found if slopes else (*found[:3], None))
        if not settled and np.isfinite(flux).all():
            raise unsettled("MagneticBody")
        return _Found(points, slope, reaction, *found), single


@dataclass(frozen=True, eq=False, repr=False)
class _Found(Record):
    """Results for a body at n poses: points (n q, 3), the gradient (n q, 3, 3) there without the iron's reaction, the
    result of `reacting_at`; wrench (n, 6), energy (n,), moments (n, q, 3), dm/dB (n, s, 3, 3) of its s soft pieces."""

    points: Array
    slope: Array
    reaction: tuple[int, Array, Array]
    wrench: Array
    energy: Array
    moments: Array
    by_field: Array


def unsettled(where: str) -> NotConverged:
    """The error for soft iron whose moments do not converge.

    Parameters
    ----------
    where
        Function that was called.

    Returns
    -------
    NotConverged
        The error, to be raised.
    """
    must_hold = "the moments of soft iron must come to an end in each other's fields"
    return NotConverged.of(
        where, must_hold, "moments that grow", "keep bodies apart, or take point dipoles: volume_level = 1"
    )


def loaded(field: Field, moment: ArrayLike | MagneticBody) -> ArrayLike | MagneticBody:
    """A dipole's moment (3,) as a body if the iron of the field reacts to it; anything else unchanged."""
    if field.reaction is None or isinstance(moment, MagneticBody) or np.shape(moment) != (3,):
        return moment
    return MagneticBody.dipole(moment)


def reacting_at(reaction: Reaction | None, points: Array) -> tuple[int, Array, Array]:
    """The iron's reaction at the points of a body, for `MagneticBody.by_fields`.

    Parameters
    ----------
    reaction
        Reaction of a field, or None.
    points
        Positions (p, 3), m.

    Returns
    -------
    tuple[int, Array, Array]
        Number of fields with the sign -1, the last ones; flux densities (p, k, 3), T/sqrt(J), and gradients
        (p, k, 3, 3).
    """
    if reaction is None:
        nothing = np.zeros((len(points), 0, 3, 3))
        return 0, nothing[..., 0], nothing
    flux, slope = (np.ascontiguousarray(np.swapaxes(values, 0, 1)) for values in reaction.fields(points))
    return int((reaction.signs < 0).sum()), flux, slope


def checked_turns(orientations: ArrayLike | None, n: int) -> Array:
    """Rotations of a body at every position.

    Parameters
    ----------
    orientations
        Rotations (3, 3) or (n, 3, 3); upright unless given.
    n
        Number of positions.

    Returns
    -------
    Array
        Rotations (n, 3, 3).

    Raises
    ------
    InputError
        For matrices that are no rotations, and for a wrong number of them.
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

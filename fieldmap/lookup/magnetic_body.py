"""Force and torque on a payload: dipoles of fixed moment, and soft iron whose moment the field induces.

    F_k = sum m_i dB_i/dx_k      T = sum m x B + r x F            docs/theory/wrench.md (1), (2), (5)..(10)

over the dipoles that stand for its magnets and one for each ellipsoid of soft iron, r from the body's centre.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_signal, check_vector, checked_vectors
from fieldmap.core.body import CoreBody
from fieldmap.errors import InputError
from fieldmap.field import AnyField, Field, as_field, coil_currents
from fieldmap.lookup.soft_body import ASSUMPTION, SoftPiece, core_piece
from fieldmap.reaction import Reaction
from fieldmap.records import Record
from fieldmap.typing import Array

# Steps towards the moments of soft iron in the iron's reaction to itself, which is weak: each gains digits.
_STEPS = 40


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
            For what is not three finite numbers.
        """
        given = check_vector("MagneticBody.dipole(moment)", moment, "give x, y, z in A m^2")
        return cls(np.zeros((1, 3)), given[None])

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
        arms, turn, flux, slope, _, single = self._asked(field, positions, currents, orientations)
        dipoles, _, _ = self._moments(turn, flux)
        result = _wrench(arms, dipoles, flux, slope)
        return result[0] if single else result

    def energy(
        self, field: AnyField, positions: ArrayLike, currents: Any, orientations: ArrayLike | None = None
    ) -> Array:
        """Interaction energy: -m . B of the magnets, -integral of m dB of soft iron, and of what the machine's
        iron reacts with, docs/theory/reaction.md (3).

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
        _, turn, flux, _, reacting, single = self._asked(field, positions, currents, orientations)
        dipoles, induced, _ = self._moments(turn, flux)
        fixed = len(self.points)
        values = induced.sum(axis=1) - np.einsum("nqi,nqi->n", dipoles[:, :fixed], flux[:, :fixed])
        # The moments in the field of the reaction count its energy twice.
        values += 0.5 * reacting.squares
        return values[0] if single else values

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
        arms, turn, flux, *_ = self._asked(field, positions, currents, orientations)
        return arms, self._moments(turn, flux)[0]

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
        moments = self.dipoles(field, positions, currents, orientations)[1][:, len(self.points) :]
        return moments[0] if np.ndim(positions) == 1 else moments

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
        total = self.dipoles(field, positions, currents, orientations)[1].sum(axis=1)
        return total[0] if np.ndim(positions) == 1 else total

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
        place = np.reshape(position, (1, 3))
        arms, turn, flux, slope, reacting, _ = self._asked(field, place, currents, orientation)
        dipoles, _, by_field = self._moments(turn, flux, slopes=True)
        source, points = as_field(field), place + arms[0]
        stiffness = -np.einsum("qi,qikl->kl", dipoles[0], source.second_gradient(points, currents))
        soft = slope[0, len(self.points) :]
        stiffness -= np.einsum("pij,pjl,pik->kl", by_field[0], soft, soft)
        if source.reaction is not None:
            stiffness -= reacting.slopes(source.reaction.second_gradient(points), dipoles, by_field, soft)
        return np.asarray(stiffness)

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
            The iron's reaction there, of `reacting_at`; none unless given.

        Returns
        -------
        Callable[[Array], tuple[Array, Array]]
            A function of weights (k,) that gives the wrench (6,) and its derivatives (6, k) by the weights.
        """
        turn, k = np.array(orientation, dtype=np.float64, order="C"), flux.shape[1]
        fields = np.ascontiguousarray(flux), np.ascontiguousarray(slope)
        nothing = np.zeros((len(flux), 0, 3, 3))
        reaction = (0, nothing[..., 0], nothing) if reacts is None else reacts

        def load(weights: Array) -> tuple[Array, Array]:
            wrench, slopes = np.empty(6), np.empty((6, k))
            self.core.wrench_slopes(turn, np.ascontiguousarray(weights), fields, reaction, wrench, slopes)
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
    ) -> tuple[Array, Array, Array, Array, _Reacting, bool]:
        """Arms, turns, flux density and gradient at all points, the reaction of the iron among them, that reaction, and
        whether one position was given."""
        where, single = checked_vectors("positions", positions)
        n, q = len(where), self.count
        turn = checked_turns(orientations, n)
        arms = np.einsum("nij,qj->nqi", turn, self.all_points)
        source = as_field(field)
        amperes = coil_currents(currents, source.coil_names, n, finite=False)
        if amperes.ndim == 2:
            amperes = np.repeat(amperes, q, axis=0)
        points = (where[:, None] + arms).reshape(-1, 3)
        flux, slope = source.field_and_gradient(points, amperes)
        flux, slope = flux.reshape(n, q, 3), slope.reshape(n, q, 3, 3)
        reacting = _Reacting.of(source.reaction, points, (n, q))
        reacting = self._reacting(reacting, turn, flux)
        return arms, turn, flux + reacting.flux, slope + reacting.slope, reacting, single

    def _reacting(self, reacting: _Reacting, turn: Array, flux: Array) -> _Reacting:
        """The reaction to the body in a field (n, q, 3) of others. Moments of soft iron follow it, step by step."""
        if not len(reacting.signs):
            return reacting
        for _ in range(_STEPS):
            before = reacting.weights
            reacting = reacting.to(self._moments(turn, flux + reacting.flux)[0])
            largest = np.abs(reacting.weights).max(initial=0.0)
            if not self.soft or np.abs(reacting.weights - before).max() <= 1e-14 * largest:
                break
        return reacting


def loaded(field: Field, moment: ArrayLike | MagneticBody) -> ArrayLike | MagneticBody:
    """A dipole's moment (3,) as a body where the iron of the field reacts to it; what is asked otherwise as it is."""
    if field.reaction is None or isinstance(moment, MagneticBody) or np.shape(moment) != (3,):
        return moment
    return MagneticBody.dipole(moment)


def reacting_at(reaction: Reaction | None, points: Array) -> tuple[int, Array, Array] | None:
    """The iron's reaction at the points of a body, for `MagneticBody.by_fields`.

    Parameters
    ----------
    reaction
        Of a field, or None.
    points
        Positions (p, 3), m.

    Returns
    -------
    tuple[int, Array, Array] | None
        Of how many fields, the last, the sign is -1; flux densities (p, k, 3), T/sqrt(J), and gradients (p, k, 3, 3).
    """
    if reaction is None:
        return None
    flux, slope = (np.ascontiguousarray(np.swapaxes(values, 0, 1)) for values in reaction.fields(points))
    return int((reaction.signs < 0).sum()), flux, slope


@dataclass(frozen=True, eq=False, repr=False)
class _Reacting(Record):
    """The iron's reaction at q points of n bodies: fields b (k, n, q, 3) and gradients (k, n, q, 3, 3) at weight 1,
    signs (k,), and weights (k, n), docs/theory/reaction.md (1), of each body alone."""

    fields: Array
    gradients: Array
    signs: Array
    weights: Array

    @classmethod
    def of(cls, reaction: Reaction | None, points: Array, shape: tuple[int, int]) -> _Reacting:
        """To nothing yet, at points (n q, 3)."""
        if reaction is None:
            nothing = np.zeros((0, *shape, 3, 3))
            return cls(nothing[..., 0], nothing, np.zeros(0), np.zeros((0, shape[0])))
        fields, gradients = reaction.fields(points)
        k = len(fields)
        gradients = gradients.reshape(k, *shape, 3, 3)
        return cls(fields.reshape(k, *shape, 3), gradients, reaction.signs, np.zeros((k, shape[0])))

    def to(self, moments: Array) -> _Reacting:
        """To moments (n, q, 3) at the points."""
        return replace(self, weights=np.einsum("knqi,nqi->kn", self.fields, moments))

    @cached_property
    def flux(self) -> Array:
        """Its flux density (n, q, 3), T."""
        return np.einsum("k,kn,knqi->nqi", self.signs, self.weights, self.fields)

    @cached_property
    def slope(self) -> Array:
        """Its gradient (n, q, 3, 3), T/m."""
        return np.einsum("k,kn,knqij->nqij", self.signs, self.weights, self.gradients)

    @property
    def squares(self) -> Array:
        """Sum of s w^2 (n,), J."""
        return self.signs @ self.weights**2

    def slopes(self, second: Array, dipoles: Array, by_field: Array, soft: Array) -> Array:
        """Its share in dF/dx (3, 3), N/m, of one body: second (k, q, 3, 3, 3), second derivatives of the fields;
        dipoles, moments (1, q, 3); of the soft pieces, the last of the points, dm/dB (1, p, 3, 3) and the whole
        gradient (p, 3, 3)."""
        first = len(dipoles[0]) - len(soft)
        signs, moments, inside = self.signs, dipoles[0], self.fields[:, 0, first:]
        pull = np.einsum("kqij,qi->kj", self.gradients[:, 0], moments)
        # The weights follow the place, and so do moments of soft iron: (1 - b chi b s) dw = m . db + b chi dB.
        moved = np.einsum("kpi,pij,pjl->kl", inside, by_field[0], soft)
        coupled = np.eye(len(signs)) - np.einsum("kpi,pij,lpj->kl", inside, by_field[0], inside) * signs
        change = np.linalg.solve(coupled, pull + moved)
        slopes = np.einsum("k,k,kqijl,qi->jl", signs, self.weights[:, 0], second, moments)
        return np.asarray(slopes + np.einsum("k,kj,kl->jl", signs, pull + moved, change))


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

"""The force balance of a levitated magnet: an upright dipole, a dipole along the field, a magnet of finite size that
turns, or an upright body of magnets and soft iron.

docs/theory/equilibrium.md. SI units, frame of the field.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, Literal

import numpy as np

from fieldmap.arguments import check, check_choice
from fieldmap.constants import GRAVITY
from fieldmap.device.model import Payload
from fieldmap.device.payload import moment_held
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.field import AnyField, Bounds, Field, as_field, require_bounds
from fieldmap.levitation.places import box_of_centres, search_grid
from fieldmap.lookup.magnetic_body import MagneticBody
from fieldmap.lookup.payload import magnetic_body
from fieldmap.reaction import IN_WORDS, aligned_moments, own_force, own_slopes, reaction_at_dipole
from fieldmap.typing import Array

_NONE = np.zeros((3, 3))
MagnetModel = Literal["fixed", "aligned", "rigid", "rigid upright"]
MODELS = ("fixed", "aligned", "rigid", "rigid upright")
CURRENT_STEP = 0.01
"""Default step of differences of the force in a current, as a share of the largest current."""
_TORQUE = 1e-8
"""Largest residual torque, over moment times field; smaller torques are noise, as a map jumps between its cells."""
_TURNS = 60
"""Most iterations for the axis of a rigid magnet."""
_STEPS = 20
_CLOSE = 1e-10
"""Most iterations of `place_error`, and a step that counts as short, m."""
_APART = 1e-5
"""Step of central differences of the force of the reaction, m."""
_RIGID = 3
"""Lowest level of the volume rule in the models "rigid" and "rigid upright"."""
_HELD = {
    "fixed": "the magnet keeps its vertical direction",
    "aligned": "the magnet is a point dipole that stays parallel to the local field",
    "rigid": "the magnet is rigid and of finite size, and turns about its centre until no torque is left",
    "rigid upright": "the magnet is rigid, of finite size, and stays upright",
}


def dipole_force(moment: Array, gradient: Array) -> Array:
    """F_k = m_i dB_i/dx_k for a field without currents at the dipole: docs/theory/equilibrium.md (1).

    The same law serves a fixed moment and one that follows the field: a turning moment does no first-order
    work when it is parallel to B.

    Parameters
    ----------
    moment
        (..., 3), A m^2.
    gradient
        dB_i/dx_k (..., 3, 3), T/m.

    Returns
    -------
    Array
        Force (..., 3), N.

    Examples
    --------
    >>> import numpy as np
    >>> dipole_force(np.array([0.0, 0.0, 2.0]), np.diag([-0.5, -0.5, 1.0])).tolist()
    [0.0, 0.0, 2.0]
    """
    return np.einsum("...i,...ik->...k", moment, gradient)


def upright_force(field: AnyField, currents: Any, payload: Payload, points: Array) -> Array:
    """Force (n, 3), N, on a payload centred at points (n, 3) that does not turn. Each magnet is a point dipole, so that
    it may stand at the edge of a map."""
    return magnetic_body(payload, 1).wrench(field, points, currents)[:, :3]


def dipole_stiffness(moment: Array, second_gradient: Array) -> Array:
    """K_kl = -dF_k/dx_l = -m_i d2B_i/dx_k dx_l for a moment that keeps its direction.

    Trace-free wherever B is harmonic (Earnshaw): a fixed dipole is never stable in all three directions.

    Parameters
    ----------
    moment
        (..., 3), A m^2.
    second_gradient
        (..., 3, 3, 3), T/m^2.

    Returns
    -------
    Array
        Stiffness (..., 3, 3), N/m.
    """
    return -np.einsum("...i,...ikl->...kl", moment, second_gradient)


def aligned_turning(moment: Array, field: Array, gradient: Array, by_moment: Array = _NONE) -> Array:
    """dm_i/dx_l, A m, of a dipole of constant magnitude that stays parallel to B.

    (lambda / m - P (dB/dm) P) dm = P (dB/dx) dx with lambda = |B| and P the projection perpendicular to m. Without
    dB/dm the stiffness gains -m/|B| (G^T G - (G^T b)(G^T b)^T) with b = B/|B|. The trace of this term is never
    positive: an aligned dipole is at least as unstable as a fixed one. moment, field (3,), gradient (3, 3); by_moment
    (3, 3): dB_i/dm_k, T/(A m^2), of a field that the dipole itself causes. Singular where B = 0.
    """
    size = np.linalg.norm(moment)
    across = np.eye(3) - np.outer(moment, moment) / size**2
    held = np.linalg.norm(field) / size * np.eye(3) - across @ by_moment @ across
    return np.asarray(np.linalg.solve(held, across @ gradient))


@dataclass(eq=False)
class MagnetBalance(ABC):
    """Magnetic force and weight of a magnet in a field at fixed currents (n_coils,), A; base class of all models.

    magnitude: of the moment, or for soft iron the largest sum of the magnitudes of moments so far, A m^2. evaluations:
    number of places at which the force was computed. finer: the same magnets by a finer volume rule; None where the
    rule is exact, or no shape is known. field_scale: scale in `residual`, as for `scaled_force`.
    """

    source: Field
    currents: Array
    mass: float
    magnitude: float
    _: KW_ONLY
    evaluations: int = 0
    finer: MagneticBody | None = None
    field_scale: float = 1.0

    @property
    def weight(self) -> float:
        """Weight, N."""
        return self.mass * GRAVITY

    @property
    def arms(self) -> Array:
        """Points (n, 3) at which the field acts on the magnet, relative to its centre, m; for a magnet that turns, two
        corners of a box that holds these points."""
        return np.zeros((1, 3))

    @property
    def box(self) -> Bounds:
        """The box of the centres at which the whole magnet lies in the field's box, m. Raises InputError."""
        return box_of_centres(require_bounds(self.source), self.arms)

    def flux_density(self, position: Array) -> Array:
        """B (3,), T, at the mean of the arms of a magnet centred at a position (3,), m; the centre may lie outside the
        field."""
        return self.source.field((position + self.arms.mean(axis=0))[None, :], self.currents)[0]

    @abstractmethod
    def moments(self, points: Array) -> Array:
        """Moment (n, 3) of the whole magnet with its centre at points (n, 3), A m^2."""

    @abstractmethod
    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) with the magnet's centre at points (n, 3), N."""

    @abstractmethod
    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m."""

    @property
    @abstractmethod
    def dipoles(self) -> MagneticBody:
        """The dipoles of the magnets, in the frame of `orientations`."""

    def reaction_force(self, points: Array) -> Array:
        """Part (n, 3) of the magnetic force, N, that is the iron's reaction to the magnets, at points (n, 3); zero for
        a field without the reaction."""
        if self.source.reaction is None:
            return np.zeros_like(points)
        turns = self.orientations(points)
        arms, moments = (
            np.einsum("nij,qj->nqi", turns, rows) for rows in (self.dipoles.points, self.dipoles.moments)
        )
        return own_force(self.source.reaction, points[:, None] + arms, moments)

    def scaled_force(self, points: Array, scale: float) -> Array:
        """Magnetic force (n, 3), N, times a scale, except for the iron's reaction to the magnets, which a calibration
        of the field does not change."""
        force = scale * self.magnetic_force(points)
        return force if scale == 1.0 else force + (1.0 - scale) * self.reaction_force(points)

    def scaled_stiffness(self, position: Array, scale: float) -> Array:
        """-dF/dx (3, 3) of `scaled_force` at one position (3,), N/m; the part of the reaction by differences."""
        stiffness = scale * self.stiffness(position)
        if scale == 1.0 or self.source.reaction is None:
            return stiffness
        # At the edge of the box the differences are one-sided.
        ahead, behind = (
            np.clip(position + step, *self.box) for step in (_APART * np.eye(3), -_APART * np.eye(3))
        )
        change = self.reaction_force(ahead) - self.reaction_force(behind)
        return stiffness - (1.0 - scale) * (change / np.diag(ahead - behind)[:, None]).T

    def orientations(self, points: Array) -> Array:
        """Rotations (n, 3, 3) of the magnet with its centre at points (n, 3); their columns are its axes."""
        moments = self.moments(points)
        size = np.linalg.norm(moments, axis=1, keepdims=True)
        return _frames(np.where(size > 0.0, moments / np.where(size > 0.0, size, 1.0), [0.0, 0.0, 1.0]))

    def rule_error(self, point: Array) -> Array:
        """Change of the force at a point (3,) with a finer volume rule of the magnets.

        Returns
        -------
        Array
            (3,), N; zero where the rule is exact or no shape is known, NaN where the finer rule leaves the field.
        """
        if self.finer is None:
            return np.zeros(3)
        at = point[None, :]
        try:
            wrench = self.finer.wrench(self.source, at, self.currents, self.orientations(at))
        except OutsideMapError:
            return np.full(3, np.nan)
        return np.asarray(wrench[0, :3] - self.magnetic_force(at)[0])

    def place_error(self, position: Array) -> float:
        """Displacement of a place of balance (3,) with a finer volume rule of the magnets, m; 0 and NaN as for
        `rule_error`, and NaN if the iteration does not converge."""
        place, step = position, np.full(3, np.nan)
        if self.finer is None:
            return 0.0
        for _ in range(_STEPS):
            try:
                unbalanced = self.residual(place[None, :])[0] + self.rule_error(place)
                stiffness = self.residual_stiffness(place)
            except OutsideMapError:
                break
            if np.isnan(unbalanced).any():
                break
            step = np.linalg.lstsq(stiffness, unbalanced)[0]
            place = place + step
            moved = float(np.linalg.norm(place - position))
            if np.linalg.norm(step) <= 0.05 * moved + _CLOSE:
                return moved
        return float("nan")

    def residual(self, points: Array) -> Array:
        """Scaled magnetic force plus weight (n, 3), N."""
        return self.scaled_force(points, self.field_scale) - [0.0, 0.0, self.weight]

    def residual_stiffness(self, position: Array) -> Array:
        """Minus the derivative of `residual` (3, 3) at one position (3,), N/m."""
        return self.scaled_stiffness(position, self.field_scale)

    def force_per_signal(self, position: Array, signals: Array, steps: Array) -> Array:
        """Slopes of the magnetic force by signals, by central differences: exact for a field that is linear in the
        currents, of second order in the steps where iron saturates. In a map of iron with hysteresis they are taken
        between the ends of the second of two loops (docs/theory/hysteresis.md, (6)).

        Parameters
        ----------
        position
            The magnet's centre (3,), m.
        signals
            Currents (n_coils, k), A, per unit of each signal.
        steps
            Steps of the central differences (k,).

        Returns
        -------
        Array
            Slopes (3, k), N per unit of each signal.
        """

        def force(source: Field, change: Array) -> Array:
            return replace(self, source=source, currents=self.currents + change).magnetic_force(
                position[None, :]
            )[0]

        slopes = []
        for swing, step in zip((signals * steps).T, steps, strict=True):
            looped = self.source.after_loop(self.currents, swing)
            slopes.append((force(looped, swing) - force(looped, -swing)) / (2.0 * step))
        return np.column_stack(slopes)

    def force_per_current(self, position: Array) -> Array:
        """Force per ampere in each coil (3, n_coils), N/A, with the magnet's centre at a position (3,), m, by central
        differences of 1 % of the largest current."""
        count = len(self.currents)
        step = CURRENT_STEP * (float(np.abs(self.currents).max()) or 1.0)
        return self.force_per_signal(position, np.eye(count), np.full(count, step))


@dataclass(eq=False)
class Balance(MagnetBalance):
    """Balance of a point dipole. fixed_moment (3,) in A m^2, or None for a moment that stays parallel to B."""

    fixed_moment: Array | None

    def moments(self, points: Array) -> Array:
        """Moment (n, 3) at points (n, 3), A m^2."""
        if self.fixed_moment is not None:
            return np.broadcast_to(self.fixed_moment, points.shape)
        return aligned_moments(
            self.source.reaction, points, self.source.field(points, self.currents), self.magnitude
        )

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) at points (n, 3), N."""
        self.evaluations += len(points)
        force = dipole_force(self.moments(points), self.source.gradient(points, self.currents))
        return force + self.reaction_force(points)

    @property
    def dipoles(self) -> MagneticBody:
        """One dipole along the third axis."""
        return MagneticBody.dipole([0.0, 0.0, self.magnitude])

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m."""
        point, reaction = position[None, :], self.source.reaction
        second = self.source.second_gradient(point, self.currents)[0]
        moment, turning = self.moments(point)[0], np.zeros((3, 3))
        stiffness = dipole_stiffness(moment, second)
        if self.fixed_moment is None:
            b, slope = (part[0] for part in self.source.field_and_gradient(point, self.currents))
            back, own, change = np.zeros(3), _NONE, _NONE
            if reaction is not None:
                back, own, change = reaction_at_dipole(reaction, position, moment)
            turning = aligned_turning(moment, b + back, slope + change, own)
            stiffness = stiffness - slope.T @ turning
        return stiffness if reaction is None else stiffness - own_slopes(reaction, position, moment, turning)


@dataclass(eq=False)
class RigidBalance(MagnetBalance):
    """Balance of a rigid magnet, integrated over its volume.

    The magnet turns about its centre until T = 0, docs/theory/equilibrium.md (8). lever: distance of the levitated
    body's centre of mass below the magnet's centre, along the magnet's axis, m; the weight then rights the magnet.
    sign: +1 for a moment that starts upward, -1 downward. step: of the central differences for the stiffness, m.
    """

    magnet: MagneticBody
    lever: float = 0.0
    sign: float = 1.0
    step: float = 2e-4

    @property
    def arms(self) -> Array:
        """Corners (2, 3) of a box that holds the magnet in any orientation, and the steps of the stiffness, m."""
        reach = float(np.linalg.norm(self.magnet.points, axis=1).max()) + self.step
        return np.array([[-reach] * 3, [reach] * 3])

    @property
    def dipoles(self) -> MagneticBody:
        """The dipoles of the magnet."""
        return self.magnet

    def moments(self, points: Array) -> Array:
        """Moment (n, 3) at which no torque is left, A m^2."""
        return self.magnitude * self.axes(points)

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) with the centre at points (n, 3), N."""
        return self._wrench(points, self.axes(points))[:, :3]

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m, the magnet turning as it moves; by central differences."""
        steps = self.step * np.eye(3)
        forces = self.magnetic_force(np.concatenate([position + steps, position - steps]))
        return -(forces[:3] - forces[3:]).T / (2.0 * self.step)

    def axes(self, points: Array) -> Array:
        """Unit vectors (n, 3) along the moment at which no torque is left. Raises NotConverged."""
        axis = np.tile([0.0, 0.0, self.sign], (len(points), 1))
        flux = self.source.field(points, self.currents)
        restoring = self.magnet.moment * np.linalg.norm(flux, axis=1) + self.weight * self.lever
        # The weight hangs below the centre, along the axis.
        hanging = self.sign * self.weight * self.lever * np.array([0.0, 0.0, 1.0])
        for _ in range(_TURNS):
            torque = self._wrench(points, axis)[:, 3:] + np.cross(axis, hanging)
            if (np.linalg.norm(torque, axis=1) <= _TORQUE * restoring).all():
                return axis
            # Newton's step without the field's gradient: a turn by torque over the restoring moment of a small tilt.
            axis = axis + np.cross(torque, axis) / restoring[:, None]
            axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        must_hold = f"the torque must fall to {_TORQUE:g} of moment times field"
        received = f"{np.max(np.linalg.norm(torque, axis=1) / restoring):.1e} after {_TURNS} turns"
        remedy = "choose places where the field is not weak, or moment='fixed'"
        raise NotConverged.of("rigid magnet", must_hold, received, remedy)

    def _wrench(self, points: Array, axis: Array) -> Array:
        self.evaluations += len(points)
        return self.magnet.wrench(self.source, points, self.currents, _frames(axis))


@dataclass(eq=False)
class BodyBalance(MagnetBalance):
    """Balance of an upright body of magnets and soft iron; induced moments follow the field: docs/theory/wrench.md
    (5)..(9). orientation (3, 3): its columns are the axes of the body."""

    magnitude: float
    body: MagneticBody
    orientation: Array

    @property
    def arms(self) -> Array:
        """Points (n, 3) of the magnets' volume rules and centres of the soft pieces, relative to the centre, m."""
        return self.body.all_points @ self.orientation.T

    @property
    def dipoles(self) -> MagneticBody:
        """The body, with the dipoles of its magnets; the dipoles of its soft iron depend on the field."""
        return self.body

    def orientations(self, points: Array) -> Array:
        """The orientation of the body, for each point (n, 3, 3)."""
        return np.broadcast_to(self.orientation, (len(points), 3, 3))

    def moments(self, points: Array) -> Array:
        """Moment (n, 3) of the whole body with its centre at points (n, 3), A m^2."""
        fixed = self.body.moments.sum(axis=0) @ self.orientation.T
        if not self.body.soft:
            return np.broadcast_to(fixed, points.shape)
        induced = self.body.induced_moment(self.source, points, self.currents, self.orientation)
        largest = float(np.linalg.norm(induced, axis=2).sum(axis=1).max())
        self.magnitude = max(self.magnitude, largest)
        return np.asarray(fixed + induced.sum(axis=1))

    def magnetic_force(self, points: Array) -> Array:
        """Magnetic force (n, 3) with the centre at points (n, 3), N."""
        self.evaluations += len(points)
        return self.body.wrench(self.source, points, self.currents, self.orientation)[:, :3]

    def stiffness(self, position: Array) -> Array:
        """-dF/dx (3, 3) at one position (3,), N/m."""
        return self.body.stiffness(self.source, position, self.currents, self.orientation)


def body_balance(field: Field, currents: Array, payload: Payload, near: Array | None) -> BodyBalance:
    """The balance of a magnet of finite size in the direction of the payload, or of upright pieces. The largest moment
    of soft iron is sought at the points `near` (n, 3) that lie in the box, or all over the box if there are none."""
    body = magnetic_body(payload)
    fixed = float(np.linalg.norm(body.moments, axis=1).sum())
    upright = BodyBalance(field, currents, payload.mass, fixed, body, np.eye(3), finer=_finer(payload))
    upright.moments(_inside(upright.box, near))
    return upright


def coarse_balance(balance: MagnetBalance, payload: Payload) -> MagnetBalance:
    """The balance with a point dipole for each magnet of an upright body; it serves to choose among many places."""
    return replace(balance, body=magnetic_body(payload, 1)) if isinstance(balance, BodyBalance) else balance


def _finer(payload: Payload) -> MagneticBody | None:
    """The body by a finer volume rule; None if the rule is exact."""
    if not payload.sized and not (payload.soft and payload.soft_level == 1):
        return None
    # Two levels up, since a cylinder may have the same radii one level up.
    return magnetic_body(replace(payload, soft_level=2), payload.volume_level + 2)


def _inside(box: Bounds, near: Array | None) -> Array:
    """The points (n, 3) inside a box, or a grid of the box if there are none."""
    if near is not None:
        found = near[((near >= box[0]) & (near <= box[1])).all(axis=1)]
        if len(found):
            return found
    return search_grid(box)


def _frames(axis: Array) -> Array:
    """Rotations (n, 3, 3) whose third column is the axis, without a twist about it (Rodrigues's formula)."""
    up = np.where(axis[:, 2] >= 0.0, 1.0, -1.0)
    c = np.abs(axis[:, 2])
    # The rotation that takes up * e_z to the axis; a magnet that hangs downward is turned about x first.
    v = np.stack([-axis[:, 1] * up, axis[:, 0] * up, np.zeros(len(axis))], axis=1)
    cross = np.zeros((len(axis), 3, 3))
    cross[:, 0, 2], cross[:, 1, 2] = v[:, 1], -v[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = -v[:, 1], v[:, 0]
    turn = np.eye(3) + cross + np.einsum("nij,njk->nik", cross, cross) / (1.0 + c)[:, None, None]
    turn[up < 0] = turn[up < 0] @ np.diag([1.0, -1.0, -1.0])
    return turn


def magnet_balance(
    field: AnyField,
    currents: Array,
    payload: Payload,
    near: Array | None,
    moment: MagnetModel | None = None,
    lever: float = 0.0,
) -> MagnetBalance:
    """The force balance of a payload's magnet in the direction of the payload, which is the start if the magnet turns.

    A payload of pieces stays upright. The payload's `volume_level` is the level of the quadrature over its magnets.

    Parameters
    ----------
    field
        Any field with a box.
    currents
        Currents (n_coils,), A.
    payload
        The levitated body.
    near
        Point (3,), m, or several (n, 3), near which the largest moment of soft iron is sought; None for the whole
        box.
    moment
        "fixed", a magnet that stays vertical; "aligned", a point dipole that follows B; "rigid", the payload's
        magnet, of finite size at any level, turned until the torque vanishes; "rigid upright", the same
        without turning. Unless given, "aligned" for a payload with turning = "free", "fixed" for any other.
    lever
        Distance of the body's centre of mass below the magnet's centre, m, for "rigid".

    Returns
    -------
    MagnetBalance
        The balance.

    Raises
    ------
    InputError
        For an unknown model, a payload without a magnet, or pieces that extend over more than the box.
    """
    moment = model_of(payload) if moment is None else moment
    check_choice("moment", moment, MODELS)
    source = as_field(field)
    points = None if near is None else np.asarray(near, dtype=float).reshape(-1, 3)
    if payload.pieces:
        refuse_models_of_pieces("magnet_balance(moment)", moment)
    elif moment in ("rigid", "rigid upright") and payload.magnet is None:
        must = "must have a magnet: its shape, size and remanence"
        raise InputError.of("payload.magnet", must, "None", "add [payload.magnet], or choose moment='fixed'")
    payload = modelled(payload, moment)
    # Models that turn have a frame with the moment along its third axis.
    upward = replace(payload, direction="up")
    finer = _finer(upward)
    if moment == "aligned":
        return Balance(source, currents, payload.mass, payload.moment, None, finer=finer)
    if moment != "rigid" and (payload.extended or moment == "rigid upright"):
        return body_balance(source, currents, payload, points)
    held = payload.moment_vector
    if moment == "fixed":
        return Balance(source, currents, payload.mass, payload.moment, held, finer=finer)
    about = (magnetic_body(upward), lever, float(np.sign(held[2])))
    return RigidBalance(source, currents, payload.mass, payload.moment, *about, finer=finer)


def held_at(balance: MagnetBalance, payload: Payload, position: Array) -> tuple[str, tuple[str, ...]]:
    """Direction of the moment at a position (3,), m, and whether it turns, in words; and a note if a free magnet turned
    over there."""
    moment, turns = payload.moment_vector, isinstance(balance, Balance) and balance.fixed_moment is None
    if not turns:
        return moment_held(moment, turns), ()
    found = balance.moments(position[None, :])[0]
    over = f"the magnet has turned over with the field: the payload states {payload.direction}"
    return moment_held(found, turns), (over,) if found @ moment < 0.0 else ()


def model_of(payload: Payload) -> MagnetModel:
    """The default model of a payload's magnet: it follows the field if it may turn."""
    return "aligned" if payload.turning == "free" else "fixed"


def modelled(payload: Payload, moment: MagnetModel) -> Payload:
    """The payload with the volume level that a model of the magnet uses."""
    levels = {"fixed": payload.volume_level, "aligned": 1}
    return replace(payload, volume_level=levels.get(moment, max(payload.volume_level, _RIGID)))


def rule_stated(payload: Payload, moment: MagnetModel, error: float, of: str) -> tuple[str, ...]:
    """The models of magnets and soft iron in words, with the error of a result as estimated by a finer rule.

    Parameters
    ----------
    payload
        The levitated body.
    moment
        As for `magnet_balance`.
    error
        Of the result, in the unit that `of` begins with; NaN if it is not known.
    of
        Unit and name of the result.

    Returns
    -------
    tuple[str, ...]
        A text for magnets, and one for soft iron. The error is stated once, for both together.
    """
    taken = modelled(payload, moment)
    rules = {"magnets": taken.rule, "soft iron": taken.soft_rule}
    stated = [f"{of_what}: {rule}" for of_what, rule in rules.items() if rule]
    if _finer(taken) is not None:
        stated[-1] += ", error " + ("not known" if np.isnan(error) else f"about {error:.2g} {of}")
    return tuple(stated)


def reaction_stated(field: Field, payload: Payload, pulls: Iterable[float], where: str) -> tuple[str, ...]:
    """Whether the iron's reaction to the magnets is in a result, and how large it is.

    Parameters
    ----------
    field
        The field, with or without the reaction of its iron.
    payload
        The levitated body.
    pulls
        Forces of the reaction, N; the largest is stated.
    where
        Words for the places of these forces.

    Returns
    -------
    tuple[str, ...]
        One assumption; none for a field without iron.
    """
    if field.reaction is None:
        return (f"{IN_WORDS}: left out",) if field.has_iron else ()
    # The reaction to induced moments alone is not known separately.
    found = list(pulls) if payload.moment else []
    share = f", {max(found) / (payload.mass * GRAVITY):.2g} of the weight {where}" if found else ""
    return (f"{IN_WORDS}: in{share}",)


def force_stated(payload: Payload, moment: MagnetModel, errors: Iterable[float]) -> tuple[str, ...]:
    """`rule_stated` for the largest of several errors of the force, N."""
    found = list(errors)
    share = 100.0 * np.max(found) / (payload.mass * GRAVITY) if found else np.nan
    return rule_stated(payload, moment, float(share), "% of the weight")


def refuse_models_of_pieces(where: str, moment: str) -> None:
    """Raise InputError for a model that would turn a payload of pieces, which stays upright."""
    must = "must be 'fixed' for a payload of pieces: it stays upright, and soft iron follows the field"
    remedy = "ask for 'fixed'; simulate lets the payload turn"
    check(moment in ("fixed", "rigid upright"), where, must, f"'{moment}'", remedy)


def model_assumptions(moment: MagnetModel, lever: float = 0.0) -> tuple[str, ...]:
    """Assumptions of a model of the magnet.

    Parameters
    ----------
    moment
        As for `magnet_balance`.
    lever
        As for `magnet_balance`.

    Returns
    -------
    tuple[str, ...]
        The assumptions.
    """
    stated = [_HELD[check_choice("moment", moment, MODELS)]]
    if moment == "rigid":
        stated.append(f"the body's centre of mass lies {1e3 * lever:g} mm below the magnet's centre")
    return tuple(stated)

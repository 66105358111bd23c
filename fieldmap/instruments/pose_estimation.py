"""The pose of a magnet from the readings of field sensors, on a map: docs/field_sensors.md (3), (4).

The contribution of the currents is subtracted from the readings; the rest depends on the pose. A least-squares fit
uses one set of readings; an extended Kalman filter uses successive samples. Both use the exact derivatives of the
map's readings. A change of the pose is a shift along the axes of the map and a rotation about those of the body, m
and rad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_positive, check_signal
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.lookup import FieldMap, MagneticBody
from fieldmap.records import Record
from fieldmap.typing import Array

_UNITS = np.repeat([1e-3, np.deg2rad(1.0)], 3)
"""Units of shifts and rotations in norms of a change of the pose: 1 mm and 1 degree."""

# Directions with singular values below this share of the largest one are not observable.
_SEEN = 1e-6
_STEPS, _TRIALS = 100, 30
_FIRST_DAMPING, _LEAST_DAMPING = 1e-3, 1e-9
# A search ends at a step below this size in `_UNITS`.
_ENOUGH = 1e-6
# Largest sum of squared residuals: this share of that of the readings, or this many deviations^2 per reading.
_EXPLAINED, _IN_NOISE = 0.25, 100.0
# Number of positions that are evaluated at a time, limited by memory.
_AT_ONCE = 500
# Relative tolerance for the symmetry of a round magnet's dipoles.
_ROUND = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Observability(Record):
    """Observability of the pose of a magnet at n positions.

    positions (n, 3), m. singular_values (n, k), falling, of the sensitivity matrix: norm of the change of all
    readings, in standard deviations of the noise, for a change of the pose by 1 mm or 1 degree along each singular
    direction. seen (n,): number of observable directions. deviations (n, 6): of an estimate from one set of readings
    (Cramer-Rao bound), m and rad; infinite for components that are not observable.
    """

    positions: Array
    singular_values: Array
    seen: Array
    deviations: Array

    @property
    def smallest(self) -> Array:
        """The smallest singular value (n,) among the directions that are observable at the best position."""
        return self.singular_values[:, self.seen.max() - 1]


@dataclass(frozen=True, eq=False, repr=False)
class PoseEstimate(Record):
    """A pose from one set of readings.

    position (3,), m. rotation (3, 3): columns are the axes of the body. covariance (6, 6), m and rad, of the
    observable directions; deviations (6,): infinite for components that are not observable and keep their start.
    residual (s,): readings minus those of the pose, T. steps: of the search.
    """

    position: Array
    rotation: Array
    covariance: Array
    deviations: Array
    residual: Array
    steps: int


@dataclass(frozen=True, eq=False, repr=False)
class TrackedPose(Record):
    """Pose and velocity in a filter.

    position (3,), m. rotation (3, 3): columns are the axes of the body. velocity (3,), m/s, along the axes of the
    map; spin (3,), rad/s, about the axes of the body. covariance (12, 12): of position, rotation, velocity, spin.
    """

    position: Array
    rotation: Array
    velocity: Array
    spin: Array
    covariance: Array


def observability(
    field_map: FieldMap,
    body: MagneticBody,
    positions: ArrayLike,
    deviation: ArrayLike,
    orientation: ArrayLike | None = None,
) -> Observability:
    """Observability of the pose of a magnet by the sensors of a map.

    Parameters
    ----------
    field_map
        Map with field sensors.
    body
        Magnets without soft iron: `fieldmap.lookup.magnetic_body`.
    positions
        Positions (n, 3), m.
    deviation
        Standard deviation of a reading, T; one number for all sensors or (s,).
    orientation
        Rotation (3, 3) with the axes of the body as columns; by default upright.

    Returns
    -------
    Observability
        Singular values and deviations at every position.

    Raises
    ------
    InputError
        For a map without sensors, a body with soft iron, and a deviation that is not positive.
    OutsideMapError
        If a part of the body is outside the map.
    """
    model = _Model.of("observability", field_map, body, deviation)
    where = np.atleast_2d(check_signal("observability(positions)", positions, columns=3))
    turn = np.eye(3) if orientation is None else np.asarray(orientation, dtype=float)
    parts = [where[k : k + _AT_ONCE] for k in range(0, len(where), _AT_ONCE)]
    weighed = np.concatenate([model.at(part, turn)[1] for part in parts])
    _, values, directions = np.linalg.svd(weighed, full_matrices=False)
    seen = (values > _SEEN * values[:, :1]).sum(axis=1)
    found = [_spread(*one)[1] for one in zip(values, directions, strict=True)]
    return Observability(where, values, seen, np.array(found))


def estimate_pose(
    field_map: FieldMap,
    body: MagneticBody,
    readings: ArrayLike,
    currents: Any,
    deviation: ArrayLike,
    position: ArrayLike | None = None,
    orientation: ArrayLike | None = None,
) -> PoseEstimate:
    """The pose of a magnet by least squares, from one set of readings at known currents.

    Parameters
    ----------
    field_map
        Map with field sensors.
    body
        Magnets without soft iron: `fieldmap.lookup.magnetic_body`.
    readings
        Readings of the sensors (s,), T.
    currents
        Currents, A, as for `FieldMap.field`.
    deviation
        Standard deviation of a reading, T; one number for all sensors or (s,).
    position, orientation
        Start of the search: position (3,), m, by default the middle of the map, and rotation (3, 3), by default
        upright. Directions that are not observable, such as the roll of a round magnet, keep their start.

    Returns
    -------
    PoseEstimate
        The pose, with its covariance.

    Raises
    ------
    InputError
        For a map without sensors, a body with soft iron, and another number of readings.
    NotConverged
        If the search does not end, or would have to leave the map, or ends at a pose that leaves half of the readings
        unexplained (in root mean square, and above the noise).
    """
    model = _Model.of("estimate_pose", field_map, body, deviation)
    middle = 0.5 * (field_map.lower + field_map.upper)
    place = middle if position is None else np.array(position, dtype=float)
    turn = np.eye(3) if orientation is None else np.array(orientation, dtype=float)
    wanted = model.without_currents(readings, currents, place)
    read, weighed = model.at(place, turn)
    off = (wanted - read) / model.noise
    damping = _FIRST_DAMPING
    for steps in range(1, _STEPS + 1):
        left, values, directions = np.linalg.svd(weighed, full_matrices=False)
        blocked = False
        for _ in range(_TRIALS):
            # Levenberg-Marquardt step, which is short along directions with small singular values.
            shares = values / (values**2 + damping * values[0] ** 2)
            step = (off @ left * shares) @ directions
            moved = _moved(place, turn, step * _UNITS)
            found = model.inside(*moved)
            blocked |= found is None
            # Steps at the edge of the map are small too, but do not mean convergence.
            if not blocked and np.linalg.norm(step) < _ENOUGH:
                if off @ off > max(_EXPLAINED * np.sum((wanted / model.noise) ** 2), _IN_NOISE * len(off)):
                    raise _no_pose(off, "must be explained by a pose in the map")
                covariance, deviations = _spread(values, directions)
                return PoseEstimate(place, turn, covariance, deviations, off * model.noise, steps)
            if found is not None:
                after = (wanted - found[0]) / model.noise
                gain = off @ off - after @ after
                if gain > 0.0:
                    break
            damping *= 10.0
        else:
            break
        # The damping follows the accuracy of the linear prediction.
        foreseen = off @ off - np.sum((off - weighed @ step) ** 2)
        damping = max(
            damping * (0.1 if gain > 0.75 * foreseen else 10.0 if gain < 0.25 * foreseen else 1.0),
            _LEAST_DAMPING,
        )
        (place, turn), weighed, off = moved, found[1], after
    raise _no_pose(off, "the search must end in the map")


def _no_pose(off: Array, must_hold: str) -> NotConverged:
    remedy = "begin nearer to the pose, or add sensors; readings beyond the range of a sensor tell nothing"
    received = f"readings that are off by {np.sqrt(off @ off / len(off)):.3g} deviations"
    return NotConverged.of("estimate_pose", must_hold, received, remedy)


@dataclass(frozen=True, eq=False, repr=False)
class PoseFilter(Record):
    """An extended Kalman filter for the pose of a magnet.

    The model is motion with known accelerations plus white noise. field_map: with field sensors. body: magnets
    without soft iron. deviation: of a reading, T; one number for all sensors or (s,). acceleration_noise: root
    spectral densities of acceleration, m/s^2, and angular acceleration, rad/s^2, per root of Hz.

    Raises InputError for a map without sensors, a body with soft iron, and numbers that are not positive.
    """

    field_map: FieldMap
    body: MagneticBody
    deviation: Any
    acceleration_noise: tuple[float, float]

    def __post_init__(self) -> None:
        _Model.of("PoseFilter", self.field_map, self.body, self.deviation)
        names = ("acceleration_noise", "angular_acceleration_noise")
        check_positive("PoseFilter", **dict(zip(names, self.acceleration_noise, strict=True)))

    def start(self, estimate: PoseEstimate, speed: float = 0.1, spin: float = 10.0) -> TrackedPose:
        """Begin with an estimate of a magnet at rest.

        Parameters
        ----------
        estimate
            Result of `estimate_pose`.
        speed, spin
            Standard deviations of its speed, m/s, and of its spin, rad/s.

        Returns
        -------
        TrackedPose
            The state of the filter. A component that is not observable has a standard deviation of half a turn.
        """
        covariance = np.zeros((12, 12))
        covariance[:6, :6] = estimate.covariance
        unseen = np.flatnonzero(np.isinf(estimate.deviations))
        covariance[unseen, unseen] = np.pi**2
        covariance[range(6, 12), range(6, 12)] = np.repeat([speed**2, spin**2], 3)
        return TrackedPose(estimate.position, estimate.rotation, np.zeros(3), np.zeros(3), covariance)

    def step(
        self,
        state: TrackedPose,
        readings: ArrayLike,
        currents: Any,
        duration: float,
        acceleration: ArrayLike = (0.0, 0.0, 0.0),
        angular_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    ) -> TrackedPose:
        """Predict the next sample, and correct the prediction by its readings.

        Parameters
        ----------
        state
            State at the last sample.
        readings
            Readings of the sensors (s,) at this sample, T.
        currents
            Currents at this sample, A, as for `FieldMap.field`.
        duration
            Time between the samples, s.
        acceleration, angular_acceleration
            Known accelerations between the samples (3,), such as force over mass by `FieldMap.wrench`: m/s^2 along
            the axes of the map, rad/s^2 about the axes of the body.

        Returns
        -------
        TrackedPose
            The state at this sample.

        Raises
        ------
        OutsideMapError
            If the predicted pose lies outside the map.
        """
        model = _Model.of("PoseFilter.step", self.field_map, self.body, self.deviation)
        check_positive("PoseFilter.step", duration=duration)
        pushed, turned = (
            duration * np.asarray(one, dtype=float) for one in (acceleration, angular_acceleration)
        )
        velocity, spin = state.velocity + pushed, state.spin + turned
        turn = duration * (spin - 0.5 * turned)
        change = np.concatenate([duration * (velocity - 0.5 * pushed), turn])
        place, rotation = _moved(state.position, state.rotation, change)
        onward = np.eye(12)
        onward[3:6, 3:6] = _rotation(-turn)
        onward[range(6), range(6, 12)] = duration
        covariance = onward @ state.covariance @ onward.T + self._noise(duration)
        read, weighed = model.at(place, rotation)
        sensitivity = np.zeros((len(read), 12))
        sensitivity[:, :6] = weighed / _UNITS
        off = (model.without_currents(readings, currents, place) - read) / model.noise
        gain = np.linalg.solve(
            sensitivity @ covariance @ sensitivity.T + np.eye(len(read)), sensitivity @ covariance
        ).T
        kept = np.eye(12) - gain @ sensitivity
        change = gain @ off
        # The Joseph form keeps the covariance symmetric and positive definite.
        covariance = kept @ covariance @ kept.T + gain @ gain.T
        place, rotation = _moved(place, rotation, change[:6])
        return TrackedPose(place, rotation, velocity + change[6:9], spin + change[9:], covariance)

    def _noise(self, duration: float) -> Array:
        """Covariance (12, 12) of the effect of white accelerations over a time."""
        density = np.diag(np.repeat(np.square(self.acceleration_noise), 3))
        times = np.array([[duration**3 / 3, duration**2 / 2], [duration**2 / 2, duration]])
        return np.kron(times, density)


@dataclass(frozen=True, eq=False, repr=False)
class _Model(Record):
    """Readings of the sensors of a map for a body, with the noise (s,), T. turns (3, 3): projection of a rotation
    that removes the roll about the axis of a round magnet."""

    field_map: FieldMap
    body: MagneticBody
    noise: Array
    turns: Array

    @classmethod
    def of(cls, where: str, field_map: FieldMap, body: MagneticBody, deviation: ArrayLike) -> _Model:
        if field_map.sensors is None:
            remedy = "give the device [[sensor]] tables and make the map with this version"
            raise InputError.of(f"{where}, field_map", "a map with field sensors", "a map without", remedy)
        remedy = "give the magnets alone: iron that the currents magnetise tells of them, too"
        check(not body.soft, f"{where}, body", "magnets without soft iron", "soft iron", remedy)
        noise = np.broadcast_to(np.asarray(deviation, dtype=float), (len(field_map.sensors.names),))
        check_positive(where, smallest_deviation=float(noise.min()))
        axis = _axis_of_roundness(body)
        return cls(field_map, body, noise, np.eye(3) - np.outer(axis, axis))

    def at(self, positions: Array, rotation: Array) -> tuple[Array, Array]:
        """Readings (..., s), T, and their derivatives (..., s, 6) per `_UNITS`, divided by the noise."""
        where, sensors = np.atleast_2d(positions), self.field_map.sensors
        assert sensors is not None
        arms, dipoles = self.body.dipoles(self.field_map, where, None, rotation)
        read, slopes = sensors.of_magnets(where, arms, dipoles)
        slopes = np.concatenate([slopes[..., :3], slopes[..., 3:] @ rotation @ self.turns], axis=-1)
        weighed = slopes * _UNITS / self.noise[:, None]
        return (read[0], weighed[0]) if np.ndim(positions) == 1 else (read, weighed)

    def inside(self, position: Array, rotation: Array) -> tuple[Array, Array] | None:
        """`at`, or None outside the map."""
        if (position < self.field_map.lower).any() or (position > self.field_map.upper).any():
            return None
        try:
            return self.at(position, rotation)
        except OutsideMapError:
            return None

    def without_currents(self, readings: ArrayLike, currents: Any, position: Array) -> Array:
        """Readings (s,) minus the contribution of the currents."""
        given = check_signal("readings", readings)
        must_hold, remedy = (
            f"one for each of {len(self.noise)} sensors",
            "list them in the order of the sensors",
        )
        check(given.shape == self.noise.shape, "readings", must_hold, f"shape {given.shape}", remedy)
        return np.asarray(given - self.field_map.readings(position, np.zeros(3), currents))


def _spread(values: Array, directions: Array) -> tuple[Array, Array]:
    """Covariance (6, 6) of observable directions, and deviations (6,), from singular values and directions (k, 6)."""
    seen = values > _SEEN * values[0]
    found = directions[seen] / values[seen, None]
    covariance = np.outer(_UNITS, _UNITS) * (found.T @ found)
    unseen = np.sum(directions[seen] ** 2, axis=0) < 0.99
    return covariance, np.where(unseen, np.inf, np.sqrt(np.diag(covariance)))


def _axis_of_roundness(body: MagneticBody) -> Array:
    """Unit vector (3,) along the axis of a round magnet, about which a rotation is not observable; zero without one.

    Its dipoles are parallel, and their first and second moments across the axis are those of a round magnet. The
    points of the volume rule alone would make a roll seem observable.
    """
    total = body.moments.sum(axis=0)
    axis = total / (np.linalg.norm(total) or 1.0)
    weights = body.moments @ axis
    across = body.points - np.outer(body.points @ axis, axis)
    size, whole = np.abs(across).max(initial=0.0), np.abs(weights).sum()
    first, second = weights @ across, (weights * across.T) @ across
    uneven = second - 0.5 * np.trace(second) * (np.eye(3) - np.outer(axis, axis))
    is_round = (
        np.abs(np.cross(body.moments, axis)).max(initial=0.0) <= _ROUND * whole
        and np.abs(first).max() <= _ROUND * whole * size
        and np.abs(uneven).max() <= _ROUND * whole * size**2
    )
    return axis if is_round else np.zeros(3)


def _moved(place: Array, rotation: Array, change: Array) -> tuple[Array, Array]:
    return place + change[:3], rotation @ _rotation(change[3:])


def _rotation(turn: Array) -> Array:
    """Rotation (3, 3) by a rotation vector (3,), rad: Rodrigues' formula."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sinc of half the angle is exact at angle 0, too.
    half = np.sinc(0.5 * angle / np.pi)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * across + 0.5 * half**2 * across @ across)

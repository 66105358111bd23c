"""Readings of field sensors, from currents and from magnets: docs/field_sensors.md.

A sensor at s along the unit vector a reads a . B(s). The share of the currents is a sum over the map's fields. The
share of a magnet follows by reciprocity: a dipole m at x gives m . B_s(x), where B_s is the field of a dipole of
1 A m^2 along a at s and of the iron's response to it. So the derivatives by the pose are force and torque of B_s.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from fieldmap.constants import MU0
from fieldmap.core.field_sensors import CoreSensors
from fieldmap.lookup.evaluation import MapFields
from fieldmap.store import StoredSensors
from fieldmap.typing import Array


class MapSensors:
    """The field sensors of a map.

    Attributes
    ----------
    names : of the s sensors.
    positions : (s, 3), m.
    axes : (s, 3), unit vectors.
    """

    def __init__(self, stored: StoredSensors, answers: MapFields | None) -> None:
        self.names, self.positions, self.axes = stored.names, stored.positions, stored.axes
        self._shares, self._answers = stored.shares, answers

    @property
    def shares(self) -> Array:
        """Readings (s, n_fields) of the map's fields at weight 1, T; T/A of coils."""
        return self._shares

    @property
    def answers(self) -> MapFields | None:
        """The iron's responses to dipoles of 1 A m^2 at the sensors, one field each; None without iron."""
        return self._answers

    @property
    def core(self) -> CoreSensors:
        """The sensors as the C core reads them."""
        places = np.ascontiguousarray(np.concatenate([self.positions, self.axes], axis=1), dtype=np.float64)
        answers = None if self._answers is None else self._answers.core.map
        return CoreSensors(places, np.ascontiguousarray(self._shares, dtype=np.float64), answers)

    def mixed(self, mix: Array) -> MapSensors:
        """The sensors for combinations of the map's fields.

        Parameters
        ----------
        mix
            (m, n_fields): the combinations, one per row.

        Returns
        -------
        MapSensors
            Sensors with shares (s, m).
        """
        found = copy(self)
        found._shares = self._shares @ mix.T
        return found

    def of_currents(self, weights: Array) -> Array:
        """Readings from coils, iron, magnets of the machine, and background.

        Parameters
        ----------
        weights
            Weights (..., n_fields) of the map's fields.

        Returns
        -------
        Array
            Readings (..., s), T.
        """
        return np.asarray(weights @ self._shares.T)

    def of_magnets(
        self, positions: Array, arms: Array, moments: Array, slopes: bool = True
    ) -> tuple[Array, Array]:
        """Readings from magnets in the box, and from the iron's reaction to them.

        Parameters
        ----------
        positions
            Positions (n, 3) of n bodies, m.
        arms
            Vectors (n, q, 3) from the position of each body to its q dipoles, m.
        moments
            (n, q, 3), A m^2.
        slopes
            Whether to compute the derivatives.

        Returns
        -------
        tuple[Array, Array]
            Readings (n, s), T, and their derivatives (n, s, 6) by the place, T/m, and by a rotation about the position,
            T/rad; (n, s, 0) without derivatives.

        Raises
        ------
        OutsideMapError
            For dipoles outside the box of a map with iron, by its rule.
        """
        n, q, _ = moments.shape
        flux, gradient = self.fields((positions[:, None] + arms).reshape(-1, 3))
        flux = flux.reshape(-1, n, q, 3)
        read = np.einsum("snqi,nqi->ns", flux, moments)
        if not slopes:
            return read, np.empty((*read.shape, 0))
        force = np.einsum("snqij,nqi->snqj", gradient.reshape(-1, n, q, 3, 3), moments)
        torque = np.cross(moments, flux) + np.cross(arms, force)
        by_pose = np.concatenate([force.sum(axis=2), torque.sum(axis=2)], axis=-1)
        return read, np.ascontiguousarray(np.swapaxes(by_pose, 0, 1))

    def fields(self, points: Array) -> tuple[Array, Array]:
        """The fields B_s of dipoles of 1 A m^2 at the sensors, along their axes, with the iron's responses.

        Parameters
        ----------
        points
            Positions (n, 3), m.

        Returns
        -------
        tuple[Array, Array]
            B (s, n, 3), T/(A m^2), and dB_i/dx_j (s, n, 3, 3).

        Raises
        ------
        OutsideMapError
            As for `of_magnets`.
        """
        flux, gradient = _dipole_fields(self.positions, self.axes, points)
        if self._answers is None:
            return flux, gradient
        of_iron = self._answers.fields(points)
        return flux + of_iron[0], gradient + of_iron[1]


def _dipole_fields(places: Array, axes: Array, points: Array) -> tuple[Array, Array]:
    """Flux densities (s, n, 3) and gradients (s, n, 3, 3) at points (n, 3) of dipoles of 1 A m^2."""
    offset = points - places[:, None]
    distance = np.linalg.norm(offset, axis=-1)[..., None]
    r, a = offset / distance, np.broadcast_to(axes[:, None], offset.shape)
    along = np.sum(r * a, axis=-1)[..., None]
    scale = MU0 / (4.0 * np.pi) / distance**3
    pairs = a[..., :, None] * r[..., None, :]
    slope = pairs + np.swapaxes(pairs, -1, -2) + along[..., None] * np.eye(3)
    slope -= 5.0 * along[..., None] * r[..., :, None] * r[..., None, :]
    return scale * (3.0 * along * r - a), 3.0 * (scale / distance)[..., None] * slope

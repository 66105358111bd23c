"""The height of a magnet from one field sensor, as in desk levitators: docs/field_sensors.md (5)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_count, check_numbers, check_ordered, check_signal
from fieldmap.core.field_sensors import CoreCurve
from fieldmap.field import coil_currents
from fieldmap.lookup import FieldMap, MagneticBody
from fieldmap.lookup.iron_response import tangent_mix
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationCurve(Record):
    """The height of a magnet from the reading of one field sensor, minus the contribution of the currents.

    sensor: its name. constant: reading without currents and magnet, T. per_ampere (n,): contribution of the currents,
    T/A. readings (k,): of the magnet, T, rising; heights (k,), m; slopes (k,): dz/dr, m/T. The curve is piecewise
    cubic between these points, and constant beyond them. error: largest error of the height midway between the
    points, compared with the map, m.
    """

    sensor: str
    constant: float
    per_ampere: Array
    readings: Array
    heights: Array
    slopes: Array
    error: float

    @property
    def core(self) -> CoreCurve:
        """The curve for the C core."""
        return CoreCurve(self.constant, self.per_ampere, self.readings, self.heights, self.slopes)

    def height(self, reading: ArrayLike, currents: ArrayLike) -> Array:
        """The height for readings.

        Parameters
        ----------
        reading
            Readings of the sensor, T: one number or (p,).
        currents
            Currents, A: (n,) for all readings or (p, n).

        Returns
        -------
        Array
            Heights, m, in the shape of the readings.

        Raises
        ------
        InputError
            For numbers that are not finite, or another number of currents.
        """
        given = check_signal("CalibrationCurve.height(reading)", reading)
        flat = np.ascontiguousarray(given, dtype=np.float64).ravel()
        coils = len(self.per_ampere)
        amperes = check_signal("CalibrationCurve.height(currents)", np.atleast_1d(currents), columns=coils)
        found = np.empty(flat.size)
        self.core.find(flat, np.ascontiguousarray(np.broadcast_to(amperes, (flat.size, coils))), found)
        return found.reshape(given.shape)

    def slope_at(self, height: float) -> float:
        """Slope of the curve, the factor from noise of the reading to noise of the height.

        Parameters
        ----------
        height
            m.

        Returns
        -------
        float
            dz/dr, m/T, linear between the points of the curve.
        """
        order = np.argsort(self.heights)
        return float(np.interp(height, self.heights[order], self.slopes[order]))


def calibrate(
    field_map: FieldMap,
    body: MagneticBody,
    sensor: str | None = None,
    *,
    heights: tuple[float, float] | None = None,
    beside: ArrayLike = (0.0, 0.0),
    orientation: ArrayLike | None = None,
    above: float = 0.0,
    nodes: int = 33,
    currents: Any = 0.0,
    scale: float = 1.0,
) -> CalibrationCurve:
    """Compute the calibration curve of one field sensor for a magnet that moves vertically.

    Parameters
    ----------
    field_map
        Map with field sensors.
    body
        Magnets without soft iron: `fieldmap.lookup.magnetic_body`.
    sensor
        Name of the sensor; by default the only one.
    heights
        Lowest and highest height of the magnet, m; by default all heights at which the whole magnet lies in the map.
    beside
        x and y of the magnet, m.
    orientation
        Rotation (3, 3) with the axes of the body as columns; by default upright.
    above
        Height of the sensed point above the centre of the magnet, m.
    nodes
        Number of points of the curve, equally spaced over the heights.
    currents
        Currents, A, as for `FieldMap.field`, about which their contribution is linearised if iron saturates.
    scale
        Calibration factor of the field of coils, iron and background.

    Returns
    -------
    CalibrationCurve
        The curve.

    Raises
    ------
    InputError
        For a map without this sensor, a body with soft iron, and a reading that is not monotonic over the heights.
    OutsideMapError
        If a part of the magnet is outside the map.
    """
    number = _number_of(field_map, sensor)
    check(not body.soft, "calibrate(body)", "must be magnets without soft iron", "soft iron", "leave it out")
    check_count("calibrate", **{"nodes - 1": nodes - 1})
    check_numbers("calibrate", above=above, scale=scale)
    turn = np.eye(3) if orientation is None else np.asarray(orientation, dtype=float)
    low, high = _heights_in(field_map, body.points @ turn.T) if heights is None else heights
    check_ordered("calibrate(heights)", low, high)
    z = np.linspace(low, high, 2 * nodes - 1)
    places = np.column_stack([np.broadcast_to(check_signal("calibrate(beside)", beside), (len(z), 2)), z])
    sensors = field_map.sensors
    assert sensors is not None
    read, slopes = sensors.of_magnets(places, *body.dipoles(field_map, places, None, turn))
    readings, by_height = read[:, number], slopes[:, number, 2]
    rising = np.sign(by_height[0])
    one_way = bool((rising * by_height > 0.0).all() and (rising * np.diff(readings) > 0.0).all())
    turning = 1e3 * z[:-1][np.diff(np.sign(by_height)) != 0.0]
    must = "the reading must rise or fall all the way over the heights"
    remedy = "choose a shorter range of heights, or another place or axis of the sensor"
    check(one_way, "calibrate(heights)", must, f"it turns near {turning.round(2).tolist()} mm", remedy)
    amperes = coil_currents(currents, field_map.coil_names)
    shares = (sensors if field_map.affine else sensors.mixed(tangent_mix(field_map, amperes))).shares[number]
    n, order = len(amperes), slice(None, None, 2 * int(rising))
    curve = CalibrationCurve(
        sensors.names[number],
        scale * float(shares[n:].sum()),
        scale * np.array(shares[:n], dtype=np.float64),
        readings[order].copy(),
        z[order] + above,
        1.0 / by_height[order],
        np.nan,
    )
    found = curve.height(readings[1::2] + curve.constant, np.zeros(n))
    return replace(curve, error=float(np.abs(found - above - z[1::2]).max()))


def _number_of(field_map: FieldMap, sensor: str | None) -> int:
    """Index of the map's sensor with this name; by default the only one."""
    names = () if field_map.sensors is None else field_map.sensors.names
    fits = len(names) == 1 if sensor is None else sensor in names
    remedy = "give the device a [[sensor]] and make the map with this version, or name one of its sensors"
    received = f'"{sensor}"' if sensor else f"{len(names)} sensors and no name"
    check(fits, "calibrate(sensor)", "must be a field sensor of the map", received, remedy)
    return 0 if sensor is None else names.index(sensor)


def _heights_in(field_map: FieldMap, arms: Array) -> tuple[float, float]:
    """Lowest and highest height at which all dipoles (q, 3) from the centre of a magnet lie in the map."""
    low, high = float(field_map.lower[2]), float(field_map.upper[2])
    return low - float(arms[:, 2].min()), high - float(arms[:, 2].max())

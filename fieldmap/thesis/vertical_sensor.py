"""The thesis's vertical sensor and its measured levitation current, in the frame of the drive unit's fields.

Fields are in metres, z up, with the origin on the lower face of the pole disk. The thesis reads depth downward, in
millimetres, from the zero of a laser micrometer (section 3.3.1).
"""

from fieldmap.thesis.printed import shared_value

SENSOR_ZERO_DEPTH = shared_value("section_3_3_1.sensor_zero_mm") / 1e3
"""Depth of the micrometer's zero below the lower face of the pole disk, m."""

# (7-18), in each of the six electromagnets, over the reading in mm.
_LIFT_CURRENT_SLOPE = shared_value("eq_7_18.slope_A_per_mm")
_LIFT_CURRENT_AT_ZERO = shared_value("eq_7_18.intercept_A")


def magnet_height(sensor_mm: float, magnet_offset: float = 0.0) -> float:
    """Height z of the magnet's centre, m, when the vertical sensor reads `sensor_mm` (mm, downward).

    The sensor sees the top of the levitated body; the magnet's centre lies `magnet_offset` (m) below that
    point. Thesis section 3.3.1.

    >>> round(magnet_height(10.0, magnet_offset=0.015), 6)
    -0.102
    """
    return -SENSOR_ZERO_DEPTH - 1e-3 * sensor_mm - magnet_offset


def sensor_reading(height: float, magnet_offset: float = 0.0) -> float:
    """Reading of the vertical sensor, mm downward, for a magnet centre at `height` (m). Inverse of
    `magnet_height`.

    >>> round(sensor_reading(-0.102, magnet_offset=0.015), 6)
    10.0
    """
    return 1e3 * (-SENSOR_ZERO_DEPTH - height - magnet_offset)


def thesis_lift_current(sensor_mm: float) -> float:
    """Measured levitation current in EACH of the six electromagnets, A, at sensor reading `sensor_mm` (mm).

    Thesis (7-18): amplifier current while the vertical position was under PID control; the total is six
    times this (8-6). It is a measurement on the real unit, so it includes saturation, which a linear map
    does not.

    >>> round(thesis_lift_current(10.0), 4)
    1.558
    """
    return _LIFT_CURRENT_SLOPE * sensor_mm + _LIFT_CURRENT_AT_ZERO

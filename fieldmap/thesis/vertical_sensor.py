"""The thesis's vertical sensor and its measured levitation current, in the frame of the drive unit's fields.

Fields are in metres, z up, with the origin on the lower face of the pole disk. The thesis reads depth downward, in
millimetres, from the zero of a laser micrometer (section 3.3.1). The numbers are those of `fieldmap.device.measured`.
"""

from fieldmap.device.measured import measured_machine

_UNIT = measured_machine("drive_unit")
SENSOR_ZERO_DEPTH = -_UNIT.sensor_zero
"""Depth of the micrometer's zero below the lower face of the pole disk, m."""


def magnet_height(sensor_mm: float, magnet_offset: float = 0.0) -> float:
    """Height z of the magnet's centre, m, when the vertical sensor reads `sensor_mm` (mm, downward).

    The sensor sees the top of the levitated body; the magnet's centre lies `magnet_offset` (m) below that
    point. Thesis section 3.3.1.

    >>> round(magnet_height(10.0, magnet_offset=0.015), 6)
    -0.102
    """
    return _UNIT.height(sensor_mm, magnet_offset)


def sensor_reading(height: float, magnet_offset: float = 0.0) -> float:
    """Reading of the vertical sensor, mm downward, for a magnet centre at `height` (m). Inverse of
    `magnet_height`.

    >>> round(sensor_reading(-0.102, magnet_offset=0.015), 6)
    10.0
    """
    return _UNIT.reading_mm(height, magnet_offset)


def thesis_lift_current(sensor_mm: float) -> float:
    """Measured levitation current in EACH of the six electromagnets, A, at sensor reading `sensor_mm` (mm).

    Thesis (7-18): amplifier current while the vertical position was under PID control; the total is six
    times this (8-6). It is a measurement on the real unit, so it includes saturation, which a linear map
    does not.

    >>> round(thesis_lift_current(10.0), 4)
    1.558
    """
    return _UNIT.lift_current(sensor_mm)

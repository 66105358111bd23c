"""The thesis's vertical sensor and its measured levitation current, in the frame of the drive unit's fields.

Fields are in metres, z up, with the origin on the lower face of the pole disk. The thesis reads depth downward, in
millimetres, from the zero of a laser micrometer (section 3.3.1). The numbers are those of `fieldmap.device.measured`.
"""

from fieldmap.device.measured import measured_machine

_UNIT = measured_machine("drive_unit")
SENSOR_ZERO_DEPTH = -_UNIT.sensor_zero
"""Depth of the micrometer's zero below the lower face of the pole disk, m."""


def magnet_height(sensor_mm: float, magnet_offset: float = 0.0) -> float:
    """Height of the magnet's centre from the reading of the vertical sensor.

    The sensor sees the top of the levitated body. Thesis section 3.3.1.

    Parameters
    ----------
    sensor_mm
        Reading, mm, downward.
    magnet_offset
        Depth of the magnet's centre below the top, m.

    Returns
    -------
    float
        z, m.

    Examples
    --------
    >>> round(magnet_height(10.0, magnet_offset=0.015), 6)
    -0.102
    """
    return _UNIT.height(sensor_mm, magnet_offset)


def sensor_reading(height: float, magnet_offset: float = 0.0) -> float:
    """Reading of the vertical sensor for a magnet; inverse of `magnet_height`.

    Parameters
    ----------
    height
        z of the magnet's centre, m.
    magnet_offset
        Depth of the magnet's centre below the top of the body, m.

    Returns
    -------
    float
        Reading, mm, downward.

    Examples
    --------
    >>> round(sensor_reading(-0.102, magnet_offset=0.015), 6)
    10.0
    """
    return _UNIT.reading_mm(height, magnet_offset)


def thesis_lift_current(sensor_mm: float) -> float:
    """Measured levitation current in EACH of the six electromagnets.

    Thesis (7-18): amplifier current under PID control of the vertical position; the total is six times this current
    (8-6). As a measurement on the real unit it includes saturation, which a linear map does not.

    Parameters
    ----------
    sensor_mm
        Reading of the vertical sensor, mm, downward.

    Returns
    -------
    float
        Current, A.

    Examples
    --------
    >>> round(thesis_lift_current(10.0), 4)
    1.558
    """
    return _UNIT.lift_current(sensor_mm)

"""The thesis's measured lift current, for the machine it was measured on."""

from fieldmap.thesis.vertical_sensor import thesis_lift_current

_MEASURED_ON = "drive_unit"
_COILS = 6


def is_measured_machine(device_name: str, coil_count: int) -> bool:
    """Whether (7-18) speaks of this device: the drive unit, in one of its descriptions."""
    return device_name.startswith(_MEASURED_ON) and coil_count == _COILS


def measured_lift_current(device_name: str, coil_count: int, sensor_mm: float) -> float | None:
    """(7-18), A in each coil; None for other machines."""
    return thesis_lift_current(sensor_mm) if is_measured_machine(device_name, coil_count) else None

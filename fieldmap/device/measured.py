"""Measurements on a machine: zero of its vertical sensor, lift current, and equilibrium positions of its magnet over a
direction signal.

The numbers lie in geometry/measured/NAME.toml. A device describes the machine if its name begins with the machine's
name and both have the same number of coils.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from fieldmap.records import Record
from fieldmap.shipped import shipped_folder


@dataclass(frozen=True, repr=False)
class MeasuredShift(Record):
    """Equilibrium positions x_mm (k,) of a magnet at rising x_signals (k,) of `LiftAndDirections` with this n, while a
    controller held the vertical reading at reading_mm. zero_mm: x at signal 0. source: table of the publication."""

    n: float
    reading_mm: float
    x_signals: tuple[float, ...]
    x_mm: tuple[float, ...]
    zero_mm: float
    source: str


@dataclass(frozen=True, repr=False)
class MeasuredMachine(Record):
    """Measurements of one machine.

    sensor_zero: z of the point at which the vertical sensor reads 0, m; readings in mm grow downward. readings_mm:
    readings for which summaries state the lift current. lift_slope, A/mm, and lift_at_zero, A: lift current in each
    coil as a linear function of the reading; lift_source: its equation. shifts: positions over a direction signal.
    """

    device: str
    coils: int
    sensor_zero: float
    readings_mm: tuple[float, ...]
    lift_slope: float
    lift_at_zero: float
    lift_source: str
    shifts: tuple[MeasuredShift, ...] = ()

    def height(self, reading_mm: float, magnet_offset: float = 0.0) -> float:
        """z of the magnet's centre, m, at a reading in mm. magnet_offset: depth of the centre below the point that the
        sensor reads, m.

        >>> round(measured_machine("drive_unit").height(10.0, magnet_offset=0.015), 6)
        -0.102
        """
        return self.sensor_zero - 1e-3 * reading_mm - magnet_offset

    def reading_mm(self, height: float, magnet_offset: float = 0.0) -> float:
        """Reading in mm of a magnet whose centre is at z = height, m: the inverse of `height`."""
        return 1e3 * (self.sensor_zero - height - magnet_offset)

    def lift_current(self, reading_mm: float) -> float:
        """Measured current in each coil, A, that lifts the magnet at a reading in mm.

        >>> round(measured_machine("drive_unit").lift_current(10.0), 4)
        1.558
        """
        return self.lift_slope * reading_mm + self.lift_at_zero

    def describes(self, device_name: str, coil_count: int) -> bool:
        """Whether a device is a description of this machine."""
        return device_name.startswith(self.device) and coil_count == self.coils


def measured_on(device_name: str, coil_count: int) -> MeasuredMachine | None:
    """The machine that a device describes; None if nothing was measured on it.

    >>> measured_on("drive_unit_no_centre_core", 6).device, measured_on("loop_and_sphere", 1)
    ('drive_unit', None)
    """
    found = (machine for machine in _machines() if machine.describes(device_name, coil_count))
    return next(found, None)


def measured_machine(name: str) -> MeasuredMachine:
    """The measurements of a machine by its name. Raises KeyError for a machine without any."""
    return {machine.device: machine for machine in _machines()}[name]


@cache
def _machines() -> tuple[MeasuredMachine, ...]:
    machines = []
    for path in sorted((shipped_folder("geometry") / "measured").glob("*.toml")):
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        sensor, lift = content["vertical_sensor"], content["lift_current"]
        machines.append(
            MeasuredMachine(
                content["device"],
                content["coils"],
                1e-3 * sensor["zero_mm"],
                tuple(sensor["readings_mm"]),
                lift["slope_A_per_mm"],
                lift["at_zero_A"],
                lift["source"],
                _shifts(content.get("equilibrium_shift", ())),
            )
        )
    return tuple(machines)


def _shifts(tables: Sequence[Mapping[str, Any]]) -> tuple[MeasuredShift, ...]:
    """The shifts of a file; a table without a row at signal 0 takes the zero of the first table."""
    shifts: list[MeasuredShift] = []
    for table in tables:
        rows = dict(zip(table["x_signals"], table["x_mm"], strict=True))
        zero = rows.pop(0.0) if 0.0 in rows else shifts[0].zero_mm
        signals, places = tuple(rows), tuple(rows.values())
        shifts.append(MeasuredShift(table["n"], table["reading_mm"], signals, places, zero, table["source"]))
    return tuple(shifts)

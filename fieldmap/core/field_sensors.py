"""Field sensors, and the height of a magnet from one of them, as the C core computes them
(fieldmap/core/field_sensors.h, calibration_curve.h). Arrays are float64 and in C order; any other array raises
TypeError."""

from typing import Any, NamedTuple

from fieldmap.core.library import LIBRARY
from fieldmap.core.machine import CoreMachine
from fieldmap.typing import Array


class CoreSensors(NamedTuple):
    """places (s, 6): place, m, and unit vector of each; shares (s, f): readings of the map's fields at weight 1, T;
    answers: of a `CoreMap` with a field for each sensor, or None without iron."""

    places: Array
    shares: Array
    answers: Any

    def read(self, machine: CoreMachine, state: Array, out: Array) -> int:
        """Fill out (s,), T, at a state (13,) of the body in the present field. Returns the status of the map."""
        return int(LIBRARY.machine_readings(machine.machine, self, state, out))


class CoreCurve(NamedTuple):
    """constant: reading without currents and magnet, T; per_ampere (n,), T/A; readings (k,) of the magnet, T, rising,
    their heights (k,), m, and slopes (k,), m/T."""

    constant: float
    per_ampere: Array
    readings: Array
    heights: Array
    slopes: Array

    def find(self, readings: Array, currents: Array, out: Array) -> None:
        """Fill out (p,): heights, m, for readings (p,), T, at currents (p, n), A."""
        LIBRARY.heights_of_readings(self, readings, currents, out)


class FieldSensing(NamedTuple):
    """Field sensors in a closed loop. chains (s, 10): as fieldmap_chain (instruments.h), of flux densities; latency:
    samples by which readings come late; history (latency + 1, s + n): room for readings and measured currents; curve:
    None without an estimator; sensor: index of the sensor that the curve reads; beside (2,): assumed x, y of the
    sensed point, m."""

    sensors: CoreSensors
    chains: Array
    latency: int
    history: Array
    curve: CoreCurve | None
    sensor: int
    beside: Array

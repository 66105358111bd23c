"""Amplifiers and windings: from the controller's voltages to currents, as compiled loops take them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_not_negative, check_ordered, check_positive, check_signal
from fieldmap.device.model import Device
from fieldmap.errors import InputError, Problem
from fieldmap.instruments import Amplifier, Converter
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class CoilDrive(Record):
    """One amplifier for each of n coils, all alike.

    amplifier: gain, limits of voltage and current, noise. converter: of the controller's outputs; None: no steps.
    resistance (n,), ohm, inductance (n,), H: of the windings, without mutual inductance; None: currents follow at once.
    supply: lowest and highest voltage at a winding, V. time_constant: of the amplifier's own answer, s; 0: as fast as
    the supply allows. docs/theory/dynamics.md (25), (26).
    """

    amplifier: Amplifier
    coils: int
    resistance: ArrayLike | None = None
    inductance: ArrayLike | None = None
    supply: tuple[float, float] = (-np.inf, np.inf)
    time_constant: float = 0.0
    converter: Converter | None = None

    def __post_init__(self) -> None:
        check_not_negative("CoilDrive", time_constant=self.time_constant)
        check_ordered("CoilDrive(supply)", *self.supply)
        if (self.resistance is None) != (self.inductance is None):
            problem = Problem(
                "CoilDrive(resistance, inductance)", "must both be given, or neither", "one", "give both"
            )
            raise InputError(problem)
        for name in ("resistance", "inductance"):
            if getattr(self, name) is not None:
                given = np.broadcast_to(
                    check_signal(f"CoilDrive({name})", getattr(self, name)), (self.coils,)
                )
                check_positive(f"CoilDrive({name})", smallest=float(given.min()))

    @property
    def drives(self) -> Array:
        """(n, 7), in the order of fieldmap_drive (fieldmap/core/instruments.h)."""
        a, c = self.amplifier, self.converter
        step, widest = (0.0, np.inf) if c is None else (c.resolution, c.range)
        lower, upper = max(a.lower, -widest), min(a.upper, widest)
        row = [step, lower, upper, a.gain, a.offset, a.current_lower, a.current_upper]
        return np.tile(np.array(row), (self.coils, 1))

    @property
    def steady(self) -> tuple[Array, Array]:
        """Lowest and highest currents (n,), A, that last: of the amplifier, and of supply over resistance."""
        a = self.amplifier
        low, high = np.full(self.coils, a.current_lower), np.full(self.coils, a.current_upper)
        if self.resistance is None:
            return low, high
        R = np.broadcast_to(np.asarray(self.resistance, float), (self.coils,))
        return np.maximum(low, self.supply[0] / R), np.minimum(high, self.supply[1] / R)

    def numbers(self, step: float) -> Array:
        """(n, 4) for a length of step, s, in the order of fieldmap_winding (fieldmap/core/currents.h)."""
        numbers = np.zeros((self.coils, 4))
        numbers[:, 1] = np.exp(-step / self.time_constant) if self.time_constant else 0.0
        if self.resistance is None or self.inductance is None:
            numbers[:, 2], numbers[:, 3] = np.inf, -np.inf
            # Nothing but the amplifier's answer: 0 times infinity must not come up.
            numbers[:, 2:] = np.finfo(float).max, -np.finfo(float).max
            return numbers
        R = np.broadcast_to(np.asarray(self.resistance, float), (self.coils,))
        L = np.broadcast_to(np.asarray(self.inductance, float), (self.coils,))
        numbers[:, 0] = np.exp(-R * step / L)
        largest = np.finfo(float).max
        numbers[:, 2] = np.clip(self.supply[1] / R, -largest, largest)
        numbers[:, 3] = np.clip(self.supply[0] / R, -largest, largest)
        return numbers


def drive_of_device(device: Device, lowest_voltage: float | None = None, **more: object) -> CoilDrive:
    """The drive of a device file: gain, current limit, supply of [driver], resistance and inductance of its coils.

    lowest_voltage: that the amplifier can put on a winding, V; minus the supply's unless given. Raises InputError where
    the file has no [driver].
    """
    driver = device.driver
    if driver is None:
        problem = Problem(
            "drive_of_device(device)", "must have a [driver]", "none", "add one to the device file"
        )
        raise InputError(problem)
    known = all(coil.resistance and coil.inductance for coil in device.coils)
    supply = driver.supply_voltage or np.inf
    largest = driver.current_limit / driver.gain
    amplifier = Amplifier(
        driver.gain,
        -largest,
        largest,
        current_lower=-driver.current_limit,
        current_upper=driver.current_limit,
    )
    numbers: dict[str, object] = {
        "resistance": [coil.resistance for coil in device.coils] if known else None,
        "inductance": [coil.inductance for coil in device.coils] if known else None,
        "supply": (-supply if lowest_voltage is None else lowest_voltage, supply),
    }
    return CoilDrive(amplifier, len(device.coils), **(numbers | more))  # type: ignore[arg-type]

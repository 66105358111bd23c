"""Instruments as blocks of a simulation: what the controller sees, and what current flows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_numbers, check_signal
from fieldmap.core.instruments import Chain, Drive, drive_all, measure_all
from fieldmap.instruments.amplifier import Amplifier
from fieldmap.instruments.converter import Converter
from fieldmap.instruments.micrometer import Micrometer
from fieldmap.records import Record
from fieldmap.typing import Array

if TYPE_CHECKING:
    from fieldmap.control.loop import LoopInstruments


@dataclass(frozen=True, repr=False)
class Rig(Record):
    """One axis: sensor, input converter, output converter, amplifier.

    gain_error (V/V), offset_error (V): what the input converter's reading is wrong by in this simulation; its data
    sheet bounds them (`absolute_accuracy`), it does not say them.
    """

    micrometer: Micrometer
    input: Converter
    output: Converter
    amplifier: Amplifier
    gain_error: float = 0.0
    offset_error: float = 0.0

    def __post_init__(self) -> None:
        check_numbers("Rig", gain_error=self.gain_error, offset_error=self.offset_error)

    @property
    def chain(self) -> Chain:
        """From a position to what the controller reads, as the C core simulates it."""
        m, c = self.micrometer, self.input
        sensor = (m.zero, m.scale, m.voltage_step, m.lower, m.upper)
        return Chain(*sensor, self.gain_error, self.offset_error, c.resolution, -c.range, c.range)

    @property
    def drive(self) -> Drive:
        """From the controller's voltage to the current, as the C core simulates it."""
        a, c = self.amplifier, self.output
        lower, upper = max(a.lower, -c.range), min(a.upper, c.range)
        return Drive(c.resolution, lower, upper, a.gain, a.offset, a.current_lower, a.current_upper)


@dataclass(frozen=True, eq=False, repr=False)
class RigNoise(Record):
    """Drawn noise, (runs, samples) each: of position, m; of the input converter, V; of the current, A."""

    position: Array
    voltage: Array
    current: Array


def draw_noise(rig: Rig, generator: np.random.Generator, shape: tuple[int, ...]) -> RigNoise:
    """White Gaussian noise of a rig's instruments from a seeded generator; the same seed gives the same noise."""
    deviations = (rig.micrometer.shown_deviation, rig.input.random_noise, rig.amplifier.deviation)
    return RigNoise(*(generator.normal(scale=1.0, size=shape) * deviation for deviation in deviations))


def measured_positions(rig: Rig, positions: ArrayLike, generator: np.random.Generator | None = None) -> Array:
    """What the controller sees of true positions, m, of any shape: noise, sensor steps, converter.

    generator: a seeded one; without it there is no noise. Scanning, averaging and lateness: `watch`. Raises InputError
    for positions that are not finite.
    """
    given = check_signal("measured_positions(positions)", positions)
    flat = np.array(given).ravel()
    voltage_noise = np.zeros(flat.size)
    if generator is not None:
        noise = draw_noise(rig, generator, flat.shape)
        flat, voltage_noise = flat + noise.position, noise.voltage
    out = np.empty(flat.size)
    measure_all(flat, voltage_noise, rig.chain, out)
    return out.reshape(given.shape)


def driven_currents(rig: Rig, voltages: ArrayLike, generator: np.random.Generator | None = None) -> Array:
    """The currents, A, that flow for voltages of the controller, V, of any shape: converter, limits, gain, noise."""
    given = check_signal("driven_currents(voltages)", voltages)
    flat = np.array(given).ravel()
    noise = np.zeros(flat.size) if generator is None else draw_noise(rig, generator, flat.shape).current
    out = np.empty(flat.size)
    drive_all(flat, noise, rig.drive, out)
    return out.reshape(given.shape)


def loop_instruments(rig: Rig, position: float = 0.0, output: float = 0.0) -> LoopInstruments:
    """A rig for `fieldmap.control.simulate_loop`, about an operating position (m) and controller output (V).

    The plant then has the current (A) as input and the position (m) as output.
    """
    # Here: instruments alone need no scipy, control does.
    from fieldmap.control.loop import LoopInstruments

    check_numbers("loop_instruments", position=position, output=output)
    return LoopInstruments(rig.chain, rig.drive, position, output)

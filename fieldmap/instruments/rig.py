"""The instruments of an axis: simulated readings and currents, and the worst-case error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_choice, check_not_negative, check_numbers, check_positive, check_signal
from fieldmap.core.instruments import Chain, Drive, drive_all, measure_all
from fieldmap.core.sampled_loop import LoopInstruments
from fieldmap.instruments.converter import Amplifier, Converter, absolute_accuracy
from fieldmap.instruments.sensors import Micrometer
from fieldmap.records import Record
from fieldmap.typing import Array

ROUNDING = ("up", "nearest")
# A number that lies off a step only by rounding counts as lying on it.
_SLACK = 1e-9


@dataclass(frozen=True, repr=False)
class Rig(Record):
    """One axis: sensor, input converter, output converter, amplifier.

    gain_error (V/V), offset_error (V): errors of the input converter in this simulation. Its data sheet gives only
    their bounds (`absolute_accuracy`).
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
        """The chain from a position to the reading of the controller, for the C core."""
        m, c = self.micrometer, self.input
        sensor = (m.zero, m.scale, m.voltage_step, m.lower, m.upper)
        return Chain(*sensor, self.gain_error, self.offset_error, c.resolution, -c.range, c.range)

    @property
    def drive(self) -> Drive:
        """The drive from the controller's voltage to the current, for the C core."""
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
    """White Gaussian noise of a rig's instruments; the same seed gives the same noise.

    Parameters
    ----------
    rig
        The rig.
    generator
        A seeded generator.
    shape
        Shape of the noise.

    Returns
    -------
    RigNoise
        The noise.
    """
    deviations = (rig.micrometer.shown_deviation, rig.input.random_noise, rig.amplifier.deviation)
    return RigNoise(*(generator.normal(scale=1.0, size=shape) * deviation for deviation in deviations))


def measured_positions(rig: Rig, positions: ArrayLike, generator: np.random.Generator | None = None) -> Array:
    """Readings of the controller from true positions: noise, rounding of the sensor, converter.

    `watch` adds scanning, averaging and latency.

    Parameters
    ----------
    rig
        The rig.
    positions
        True positions, m, of any shape.
    generator
        A seeded generator; without it there is no noise.

    Returns
    -------
    Array
        Positions, m, of the same shape.

    Raises
    ------
    InputError
        For positions that are not finite.
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
    """Currents from voltages of the controller: converter, limits, gain, noise.

    Parameters
    ----------
    rig
        The rig.
    voltages
        Voltages, V, of any shape.
    generator
        A seeded generator; without it there is no noise.

    Returns
    -------
    Array
        Currents, A, of the same shape.

    Raises
    ------
    InputError
        For voltages that are not finite.
    """
    given = check_signal("driven_currents(voltages)", voltages)
    flat = np.array(given).ravel()
    noise = np.zeros(flat.size) if generator is None else draw_noise(rig, generator, flat.shape).current
    out = np.empty(flat.size)
    drive_all(flat, noise, rig.drive, out)
    return out.reshape(given.shape)


def loop_instruments(rig: Rig, position: float = 0.0, output: float = 0.0) -> LoopInstruments:
    """A rig for `fieldmap.control.simulate_loop`.

    The plant then has the current (A) as input and the position (m) as output.

    Parameters
    ----------
    rig
        The rig.
    position
        Operating position, m.
    output
        Controller output there, V.

    Returns
    -------
    LoopInstruments
        The instruments.
    """
    check_numbers("loop_instruments", position=position, output=output)
    return LoopInstruments(rig.chain, rig.drive, position, output)


@dataclass(frozen=True, eq=False, repr=False)
class ErrorBudget(Record):
    """The steps of the error budget. Arrays (2,) are for the highest and the lowest actual position; arrays (4,) are
    for high + accuracy, high - accuracy, low - accuracy, low + accuracy.

    actual (2,), shown (2,) by the sensor, m; voltages (2,); codes (2,) before and steps (2,) after rounding by the
    converter; inputs (2,): voltages of these steps; accuracies (2,), V; measured_voltages (4,); measured (4,), m;
    errors (4,) = nominal - measured, m.
    """

    actual: Array
    shown: Array
    voltages: Array
    codes: Array
    steps: Array
    inputs: Array
    accuracies: Array
    measured_voltages: Array
    measured: Array
    errors: Array


def error_budget(
    position: float,
    sensor_accuracy: float,
    micrometer: Micrometer,
    converter: Converter,
    *,
    converter_step: float | None = None,
    rounding: str = "up",
) -> ErrorBudget:
    """Worst-case readings of a nominal position.

    The sensor rounds to its resolution. The converter rounds to its step, with an error of its absolute accuracy.

    Parameters
    ----------
    position
        Nominal position, m.
    sensor_accuracy
        Accuracy of the sensor, plus and minus, m.
    micrometer
        The sensor.
    converter
        The converter.
    converter_step
        Step of the converter, V; by default its resolution.
    rounding
        Rounding of the converter: "up" (16393.44 becomes 16394) or "nearest".

    Returns
    -------
    ErrorBudget
        The readings, with all steps.

    Raises
    ------
    InputError
        For numbers that are not finite.

    Examples
    --------
    >>> sensor = Micrometer(zero=0.020, scale=2e-3, voltage_step=5e-3)
    >>> card = Converter(range=10, bits=16)
    >>> (1e3 * error_budget(0.030001, 4e-6, sensor, card).shown).round(2).tolist()
    [30.01, 30.0]
    """
    check_numbers("error_budget", position=position)
    check_not_negative("error_budget", sensor_accuracy=sensor_accuracy)
    check_choice("error_budget(rounding)", rounding, ROUNDING)
    step = converter.resolution if converter_step is None else converter_step
    check_positive("error_budget", converter_step=step)
    actual = position + sensor_accuracy * np.array([1.0, -1.0])
    shown = actual
    if micrometer.resolution:
        shown = micrometer.resolution * np.floor(actual / micrometer.resolution + 0.5 + _SLACK)
    voltages = micrometer.voltage(shown)
    codes = voltages / step
    steps = np.ceil(codes - _SLACK) if rounding == "up" else np.floor(codes + 0.5 + _SLACK)
    inputs = steps * step
    accuracies = absolute_accuracy(converter, inputs).total
    signs = np.array([[1.0, -1.0], [-1.0, 1.0]])
    measured_voltages = (inputs[:, None] + signs * accuracies[:, None]).ravel()
    measured = micrometer.position(measured_voltages)
    errors = position - measured
    return ErrorBudget(
        actual, shown, voltages, codes, steps, inputs, accuracies, measured_voltages, measured, errors
    )

"""The electronics of Hall and fluxgate elements, from a flux density to the reading of a controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.core.instruments import Chain, measure_all
from fieldmap.instruments.converter import Converter
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, repr=False)
class FieldElement(Record):
    """Data-sheet numbers of an element with an analogue output and of its input converter.

    sensitivity: V/T. range: largest flux density, plus and minus, T, at which the output saturates. deviation:
    standard deviation of a reading, T, as white Gaussian noise. offset, T, and gain_error (T/T): errors of readings.
    converter: of the output, with its own noise; None: the output is read without a converter. latency: in samples.
    """

    sensitivity: float
    range: float = np.inf
    deviation: float = 0.0
    offset: float = 0.0
    gain_error: float = 0.0
    converter: Converter | None = None
    latency: int = 0

    def __post_init__(self) -> None:
        arguments.check_positive("FieldElement", sensitivity=self.sensitivity)
        if self.range != np.inf:
            arguments.check_positive("FieldElement", range=self.range)
        arguments.check_numbers("FieldElement", offset=self.offset, gain_error=self.gain_error)
        arguments.check_not_negative("FieldElement", deviation=self.deviation)
        arguments.check_count("FieldElement", **{"latency + 1": self.latency + 1})

    @property
    def chain(self) -> Chain:
        """The chain from a flux density to the reading of the controller, for the C core."""
        step, widest = (
            (0.0, np.inf) if self.converter is None else (self.converter.resolution, self.converter.range)
        )
        output = self.range * self.sensitivity
        errors = self.gain_error, self.offset * self.sensitivity
        return Chain(0.0, 1.0 / self.sensitivity, 0.0, -output, output, *errors, step, -widest, widest)

    @property
    def whole_deviation(self) -> float:
        """Standard deviation of the controller's reading, T, from element, converter and its quantisation."""
        if self.converter is None:
            return self.deviation
        of_converter = self.converter.random_noise, self.converter.resolution / np.sqrt(12.0)
        return float(np.hypot(self.deviation, np.hypot(*of_converter) / self.sensitivity))


def measured_readings(
    element: FieldElement, readings: ArrayLike, generator: np.random.Generator | None = None
) -> Array:
    """Readings of the controller from true flux densities: noise, range, offset, gain, converter, latency.

    Parameters
    ----------
    element
        Electronics of every sensor.
    readings
        Flux densities (n, s) of s sensors at n samples, T.
    generator
        A seeded generator; without it there is no noise.

    Returns
    -------
    Array
        Readings (n, s), T. The first reading is repeated until the latency has passed.

    Raises
    ------
    InputError
        For readings that are not finite.

    Examples
    --------
    >>> hall = FieldElement(sensitivity=25.0, range=0.1, converter=Converter(range=2.5, bits=12), latency=1)
    >>> (1e3 * measured_readings(hall, [[0.0102], [0.2]])).round(3).tolist()
    [[10.205], [10.205]]
    """
    given = np.atleast_2d(arguments.check_signal("measured_readings(readings)", readings))
    late = np.maximum(np.arange(len(given)) - element.latency, 0)
    true, volts = given[late].ravel(), np.zeros(given.size)
    if generator is not None:
        true = true + generator.normal(scale=element.deviation, size=true.size)
        if element.converter is not None:
            volts = generator.normal(scale=element.converter.random_noise, size=true.size)
    out = np.empty(true.size)
    measure_all(np.ascontiguousarray(true), volts, element.chain, out)
    return out.reshape(given.shape)

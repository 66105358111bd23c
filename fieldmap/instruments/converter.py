"""Analogue-to-digital and digital-to-analogue converters with their absolute accuracy, and current amplifiers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.records import Record
from fieldmap.typing import Array

USUAL_RANGE = 10.0
"""Default range of analogue signals, plus and minus, V, of sensors, converters and amplifiers, also in scenario
files."""


@dataclass(frozen=True)
class Converter(Record):
    """Data-sheet numbers of a converter card with a symmetric range.

    range: V, from -range to +range. bits. random_noise: V, rms. gain_error: residual, of the reading (V/V).
    offset_error: residual, of the range. gain_drift, reference_drift: of the reading, per kelvin; offset_drift: of the
    range, per kelvin. nonlinearity: integral nonlinearity, of the range.
    """

    range: float
    bits: int
    random_noise: float = 0.0
    gain_error: float = 0.0
    offset_error: float = 0.0
    gain_drift: float = 0.0
    offset_drift: float = 0.0
    reference_drift: float = 0.0
    nonlinearity: float = 0.0

    def __post_init__(self) -> None:
        arguments.check_positive("Converter", range=self.range)
        arguments.check_count("Converter", bits=self.bits)
        numbers = {name: value for name, value in vars(self).items() if name not in ("range", "bits")}
        arguments.check_not_negative("Converter", **numbers)

    @property
    def resolution(self) -> float:
        """One step, V: 2 range / 2^bits."""
        return 2.0 * self.range / 2.0**self.bits


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(Record):
    """Absolute accuracy of a reading, V, the sum of three parts: docs/theory/control.md (10).

    net_gain_error: V/V of the reading; net_offset_error: of the range; noise_uncertainty: V.
    """

    total: Array
    net_gain_error: float
    net_offset_error: float
    noise_uncertainty: float
    assumptions: tuple[str, ...]


def absolute_accuracy(
    converter: Converter,
    reading: ArrayLike,
    *,
    internal_change: float = 1.0,
    external_change: float = 10.0,
    averages: int = 1,
    coverage: float = 3.0,
) -> Accuracy:
    """Worst-case error of a reading: |reading| net gain error + range net offset error + noise uncertainty.

    Net gain error = gain error + gain drift internal_change + reference drift external_change; net offset
    error = offset error + offset drift internal_change + nonlinearity; noise uncertainty = coverage noise /
    sqrt(averages). docs/theory/control.md (10); the makers of such cards give the same sum.

    Parameters
    ----------
    converter
        The converter.
    reading
        Readings, V, of any shape.
    internal_change, external_change
        Kelvins since the last internal and external calibration.
    averages
        Number of readings that are averaged.
    coverage
        Coverage factor: number of standard deviations of the noise.

    Returns
    -------
    Accuracy
        The error and its shares, V.

    Raises
    ------
    InputError
        For numbers that are not finite or negative.

    Examples
    --------
    >>> card = Converter(range=10, bits=16, random_noise=280e-6, gain_error=60e-6, offset_error=20e-6,
    ...     gain_drift=13e-6, offset_drift=21e-6, reference_drift=1e-6, nonlinearity=60e-6)
    >>> (1e6 * absolute_accuracy(card, [0.0, 10.0]).total).round(3).tolist()
    [1850.0, 2680.0]
    """
    where = "absolute_accuracy"
    arguments.check_not_negative(
        where, internal_change=internal_change, external_change=external_change, coverage=coverage
    )
    arguments.check_count(where, averages=averages)
    voltages = arguments.check_signal(f"{where}(reading)", reading)
    c = converter
    gain = c.gain_error + c.gain_drift * internal_change + c.reference_drift * external_change
    offset = c.offset_error + c.offset_drift * internal_change + c.nonlinearity
    noise = coverage * c.random_noise / float(np.sqrt(averages))
    return Accuracy(
        total=np.abs(voltages) * gain + c.range * offset + noise,
        net_gain_error=gain,
        net_offset_error=offset,
        noise_uncertainty=noise,
        assumptions=(
            f"temperature: {internal_change:g} K since the internal calibration, {external_change:g} K since the "
            "external one",
            f"noise covered to {coverage:g} standard deviations, mean of {averages}",
        ),
    )


@dataclass(frozen=True)
class Amplifier(Record):
    """i = gain v + offset, limited.

    gain: A/V. lower, upper: range of the input, V, by default `USUAL_RANGE`. offset: A. deviation: standard deviation
    of the current, A, as white Gaussian noise. current_lower, current_upper: limits of the current, A.
    """

    gain: float
    lower: float = -USUAL_RANGE
    upper: float = USUAL_RANGE
    offset: float = 0.0
    deviation: float = 0.0
    current_lower: float = -np.inf
    current_upper: float = np.inf

    def __post_init__(self) -> None:
        arguments.check_positive("Amplifier", gain=self.gain)
        arguments.check_numbers("Amplifier", lower=self.lower, upper=self.upper, offset=self.offset)
        arguments.check_not_negative("Amplifier", deviation=self.deviation)
        arguments.check_ordered("Amplifier", self.lower, self.upper)
        arguments.check_ordered("Amplifier(current)", self.current_lower, self.current_upper)

    @property
    def largest_current(self) -> float:
        """The current at the upper end of the input, A.

        >>> round(Amplifier(gain=0.355).largest_current, 3)
        3.55
        """
        return min(self.gain * self.upper + self.offset, self.current_upper)

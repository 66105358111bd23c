"""A current amplifier that follows a voltage."""

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import check_not_negative, check_numbers, check_ordered, check_positive
from fieldmap.records import Record

USUAL_RANGE = 10.0
"""V, to both sides: of the analogue signals of sensors, converters and amplifiers. It is assumed where no other range
is given, in Python and in scenario files."""


@dataclass(frozen=True)
class Amplifier(Record):
    """i = gain v + offset, limited.

    gain: A/V. lower, upper: range of the input, V; `USUAL_RANGE` is assumed unless given. offset: A. deviation:
    standard deviation of the current, A, taken as white and Gaussian. current_lower, current_upper: limits of it, A;
    those of the input times the gain unless given.
    """

    gain: float
    lower: float = -USUAL_RANGE
    upper: float = USUAL_RANGE
    offset: float = 0.0
    deviation: float = 0.0
    current_lower: float = -np.inf
    current_upper: float = np.inf

    def __post_init__(self) -> None:
        check_positive("Amplifier", gain=self.gain)
        check_numbers("Amplifier", lower=self.lower, upper=self.upper, offset=self.offset)
        check_not_negative("Amplifier", deviation=self.deviation)
        check_ordered("Amplifier", self.lower, self.upper)
        check_ordered("Amplifier(current)", self.current_lower, self.current_upper)

    @property
    def largest_current(self) -> float:
        """The current at the upper end of the input, A.

        >>> round(Amplifier(gain=0.355).largest_current, 3)
        3.55
        """
        return min(self.gain * self.upper + self.offset, self.current_upper)

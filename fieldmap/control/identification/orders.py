"""The structure of a model that is to be identified."""

from dataclasses import dataclass

from fieldmap.errors import InputError, Problem


@dataclass(frozen=True)
class Orders:
    """How many poles and zeros the sampled model has, and how many samples of dead time on top.

    (b_0 q^zeros + ...) / (q^poles + ...) q^-dead_time: poles=4, zeros=3 is (5-13) of the thesis, poles=3, zeros=1 is
    (5-15). The output follows the input by `delay` = poles - zeros + dead_time samples; sampled plants have one or
    more. Raises InputError for numbers that are not whole, or more zeros than poles.
    """

    poles: int
    zeros: int
    dead_time: int = 0

    def __post_init__(self) -> None:
        values = (self.poles, self.zeros, self.dead_time)
        if (
            any(isinstance(v, bool) or v != int(v) or v < 0 for v in values)
            or self.zeros > self.poles
            or not self.poles
        ):
            raise InputError(
                Problem(
                    "Orders",
                    "must be whole numbers with poles >= 1 and 0 <= zeros <= poles",
                    f"poles {self.poles}, zeros {self.zeros}, dead time {self.dead_time}",
                    "a plant behind a zero-order hold has at least one pole more than zeros",
                )
            )

    @property
    def delay(self) -> int:
        """Samples from the input to its first effect on the output."""
        return self.poles - self.zeros + self.dead_time

    @property
    def parameters(self) -> int:
        """Number of coefficients that are estimated."""
        return self.poles + self.zeros + 1

    @property
    def first(self) -> int:
        """Index of the first sample whose whole past is in the record."""
        return max(self.poles, self.delay + self.zeros)

"""The sampled PID controller, and its transfer function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fieldmap.arguments import check_choice, check_not_negative, check_numbers, check_ordered, check_positive
from fieldmap.control.linear_models import TransferFunction, transfer_function
from fieldmap.records import Record

INTEGRATION = ("rectangular", "trapezoidal")
ANTI_WINDUP = ("none", "hold", "track")
DERIVATIVE = ("error", "measurement")


@dataclass(frozen=True, repr=False)
class PID(Record):
    """A PID controller that runs every Ts seconds: docs/theory/control.md (1), (2).

    u[n] = Kc e[n] + (Kc Ts / Ti) sum e + (Kc Td / Ts) (e[n] - e[n-1]), with e = 0 before the first sample.

    Kc: gain, output per unit of error. Ti: integral time, s (infinity: no integral part). Td: derivative time, s.
    integration: "rectangular" adds e[n]; "trapezoidal" adds (e[n] + e[n-1]) / 2, as LabVIEW's manual documents it.
    lower, upper: limits of the output. anti_windup: "none"; "hold" stops the integral while it would drive the output
    further past a limit; "track" pulls it back with the time constant tracking_time, s (sqrt(Ti Td) unless given; Ti if
    Td = 0). derivative: of the "error", or of minus the "measurement", without a kick at a step of the reference.
    acts_on_minus_error: for a plant of negative gain.
    """

    Kc: float
    Ti: float
    Td: float
    Ts: float
    lower: float = -np.inf
    upper: float = np.inf
    integration: str = "rectangular"
    anti_windup: str = "none"
    tracking_time: float | None = None
    derivative: str = "error"
    acts_on_minus_error: bool = False

    def __post_init__(self) -> None:
        _check_gains("PID", self.Kc, self.Ti, self.Td, self.Ts)
        check_ordered("PID", self.lower, self.upper)
        check_choice("PID(integration)", self.integration, INTEGRATION)
        check_choice("PID(anti_windup)", self.anti_windup, ANTI_WINDUP)
        check_choice("PID(derivative)", self.derivative, DERIVATIVE)
        if self.tracking_time is not None:
            check_positive("PID", tracking_time=self.tracking_time)

    @property
    def sign(self) -> float:
        """-1 for a controller that acts on minus the error."""
        return -1.0 if self.acts_on_minus_error else 1.0

    @property
    def gains(self) -> tuple[float, float, float]:
        """Kc, and per sample Kc Ts / Ti and Kc Td / Ts."""
        return float(self.Kc), float(self.Kc * self.Ts / self.Ti), float(self.Kc * self.Td / self.Ts)

    @property
    def tracking(self) -> float:
        """Share Ts / Tt of what a limit cuts off by which an integral that tracks follows in a sample."""
        time = self.tracking_time
        if time is None:
            time = float(np.sqrt(self.Ti * self.Td)) if self.Td else self.Ti
        return min(1.0, self.Ts / time)


def pid_transfer_function(
    Kc: float, Ti: float, Td: float, Ts: float, *, integration: str = "trapezoidal"
) -> TransferFunction:
    """Numerator and denominator in q of the sampled PID controller: docs/theory/control.md (3).

    k1 = Kc (1 + Ts/2Ti + Td/Ts), k2 = Kc (-1 + Ts/2Ti - 2 Td/Ts), k3 = Kc Td/Ts over q^2 - q: the trapezoidal rule for
    the integral, a backward difference for the derivative. integration="rectangular" has
    Ts/Ti in k1 and nothing in k2. Times in s. Raises InputError for times that are not positive (Td may be 0, Ti
    infinite).

    >>> pid_transfer_function(0.5, 0.007, 0.001, 2e-3).numerator.round(5).tolist()
    [0.82143, -0.92857, 0.25]
    """
    _check_gains("pid_transfer_function", Kc, Ti, Td, Ts)
    check_choice("pid_transfer_function(integration)", integration, INTEGRATION)
    if Ti == np.inf:  # the pole at 1 and its zero cancel
        return transfer_function(Kc * np.array([1.0 + Td / Ts, -Td / Ts]), [1.0, 0.0])
    now, before = (0.5, 0.5) if integration == "trapezoidal" else (1.0, 0.0)
    integral, derivative = Ts / Ti, Td / Ts
    numerator = [1.0 + now * integral + derivative, -1.0 + before * integral - 2.0 * derivative, derivative]
    return transfer_function(Kc * np.array(numerator), [1.0, -1.0, 0.0])


def _check_gains(where: str, Kc: float, Ti: float, Td: float, Ts: float) -> None:
    check_numbers(where, Kc=Kc)
    check_positive(where, Ts=Ts, **_finite_times(Ti))
    check_not_negative(where, Td=Td)


def _finite_times(Ti: float) -> dict[str, float]:
    """An infinite integral time is a controller without integral part."""
    return {} if Ti == np.inf else {"Ti": Ti}

"""The sampled PID controller: its gains, its transfer function, and how it runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.control.blocks import ALONE, AxisReading, ControllerBlock, RunningBlock, run_block
from fieldmap.control.linear_models import TransferFunction, transfer_function
from fieldmap.core.controller import SIGNALS
from fieldmap.records import Record
from fieldmap.typing import Array

# Shares of this error and of the one before in what an integral adds.
INTEGRATION = {"rectangular": (1.0, 0.0), "trapezoidal": (0.5, 0.5)}
USUAL_INTEGRATION: Final = "trapezoidal"
"""Rule of the integral in Python and in scenario files unless another one is given."""
ANTI_WINDUP = ("none", "hold", "track")
DERIVATIVE = ("error", "measurement")


@dataclass(frozen=True, repr=False)
class PID(Record):
    """A PID controller that runs every Ts seconds: docs/theory/control.md (1), (2).

    u[n] = Kc e[n] + (Kc Ts / Ti) s[n] + (Kc Td / Ts) (e[n] - e[n-1]), s the sum of the errors by the rule of the
    integral, with e = 0 before the first sample.

    Kc: gain, output per unit of error. Ti: integral time, s (infinity: no integral part). Td: derivative time, s.
    integration: "trapezoidal" adds (e[n] + e[n-1]) / 2, as LabVIEW's manual documents it; "rectangular" adds e[n].
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
    integration: str = USUAL_INTEGRATION
    anti_windup: str = "none"
    tracking_time: float | None = None
    derivative: str = "error"
    acts_on_minus_error: bool = False

    def __post_init__(self) -> None:
        _check_gains("PID", self.Kc, self.Ti, self.Td, self.Ts)
        arguments.check_ordered("PID", self.lower, self.upper)
        arguments.check_choice("PID(integration)", self.integration, INTEGRATION)
        arguments.check_choice("PID(anti_windup)", self.anti_windup, ANTI_WINDUP)
        arguments.check_choice("PID(derivative)", self.derivative, DERIVATIVE)
        if self.tracking_time is not None:
            arguments.check_positive("PID", tracking_time=self.tracking_time)


def _check_gains(where: str, Kc: float, Ti: float, Td: float, Ts: float) -> None:
    """Of these an integral time may be infinite: there is no integral part."""
    arguments.check_numbers(where, Kc=Kc)
    arguments.check_positive(where, Ts=Ts, **({} if Ti == np.inf else {"Ti": Ti}))
    arguments.check_not_negative(where, Td=Td)


def pid_transfer_function(
    Kc: float, Ti: float, Td: float, Ts: float, *, integration: str = USUAL_INTEGRATION
) -> TransferFunction:
    """The sampled PID controller as a transfer function in q: docs/theory/control.md (3).

    k1 = Kc (1 + Ts/2Ti + Td/Ts), k2 = Kc (-1 + Ts/2Ti - 2 Td/Ts), k3 = Kc Td/Ts over q^2 - q: the trapezoidal
    rule for the integral, a backward difference for the derivative.

    Parameters
    ----------
    Kc
        Gain.
    Ti
        Integral time, s; may be infinite.
    Td
        Derivative time, s; may be 0.
    Ts
        Sampling time, s.
    integration
        "trapezoidal", or "rectangular", which has Ts/Ti in k1 and nothing in k2.

    Returns
    -------
    TransferFunction
        Numerator and denominator in q.

    Raises
    ------
    InputError
        For times that are not positive.

    Examples
    --------
    >>> pid_transfer_function(0.5, 0.007, 0.001, 2e-3).numerator.round(5).tolist()
    [0.82143, -0.92857, 0.25]
    """
    _check_gains("pid_transfer_function", Kc, Ti, Td, Ts)
    arguments.check_choice("pid_transfer_function(integration)", integration, INTEGRATION)
    if Ti == np.inf:  # the pole at 1 and its zero cancel
        return transfer_function(Kc * np.array([1.0 + Td / Ts, -Td / Ts]), [1.0, 0.0])
    now, before = INTEGRATION[integration]
    integral, derivative = Ts / Ti, Td / Ts
    numerator = [1.0 + now * integral + derivative, -1.0 + before * integral - 2.0 * derivative, derivative]
    return transfer_function(Kc * np.array(numerator), [1.0, -1.0, 0.0])


def pid_block(
    controller: PID, reading: AxisReading, output: float = 0.0, at: ArrayLike | None = None
) -> ControllerBlock:
    """A PID controller of one axis as a block: docs/theory/control.md (1).

    Parameters
    ----------
    controller
        The controller.
    reading
        What it reads of its axis.
    output
        The output with which it starts.
    at
        Reference and position (7,) of that start; without it the block begins with nothing before its first
        sample.

    Returns
    -------
    ControllerBlock
        The block.

    Examples
    --------
    >>> block = pid_block(PID(2.0, 0.1, 0.0, 0.01), AxisReading("x", 1e3))
    >>> block.D[0, [0, 3]].tolist()
    [2100.0, -2100.0]
    """
    kp, Ti, Td, Ts = float(controller.Kc), controller.Ti, controller.Td, controller.Ts
    ki, kd = float(kp * Ts / Ti), float(kp * Td / Ts)
    sign = -1.0 if controller.acts_on_minus_error else 1.0
    error = sign * (reading.reference - reading.measured)
    slope = error if controller.derivative == "error" else -sign * reading.measured
    now, before = INTEGRATION[controller.integration]
    # Memory: integral, previous error, previous value of what is differentiated.
    C = np.array([[1.0, ki * before, -kd]])
    D = ((kp + ki * now) * error + kd * slope)[None]
    A, B, E = np.zeros((3, 3)), np.zeros((3, SIGNALS)), np.zeros((3, 1))
    A[0, :2], B[0], B[1], B[2] = (1.0, ki * before), ki * now * error, error, slope
    if controller.anti_windup == "track":
        usual = float(np.sqrt(Ti * Td)) if Td else Ti
        share = min(1.0, Ts / (controller.tracking_time or usual))
        A[0], B[0], E[0, 0] = A[0] - share * C[0], B[0] - share * D[0], share
    memory = np.array([output, 0.0, 0.0])
    if at is not None:
        there = arguments.check_signal("pid_block(at)", at, columns=SIGNALS)
        memory[:] = output - kp * (error @ there), error @ there, slope @ there
    hold = np.array([0 if controller.anti_windup == "hold" else -1, -1, -1])
    limits = np.array([controller.lower]), np.array([controller.upper])
    return ControllerBlock(A, B, C, D, E, *limits, hold, memory)


class RunningPID(RunningBlock):
    """A PID controller with its memory, for a loop of your own: one call of `step` a sample.

    >>> running = RunningPID(PID(Kc=2.0, Ti=0.1, Td=0.0, Ts=0.01))
    >>> [round(running.step(reference=1.0, measured=y), 3) for y in (0.0, 0.5)]
    [2.1, 1.25]
    """

    def __init__(self, controller: PID) -> None:
        self.controller = controller
        self.reset()

    def reset(self, integral: float = 0.0) -> None:
        """Forget the past.

        Parameters
        ----------
        integral
            Where the integral part of the output begins.
        """
        arguments.check_numbers("RunningPID.reset", integral=integral)
        self._start(pid_block(self.controller, ALONE, integral))


def run_pid(controller: PID, reference: ArrayLike, measured: ArrayLike) -> Array:
    """Run a controller from rest for given measurements, in open loop.

    Parameters
    ----------
    controller
        The controller.
    reference
        (n,) or one number.
    measured
        Measurements (n,).

    Returns
    -------
    Array
        Outputs (n,).

    Raises
    ------
    InputError
        For signals that are not finite or of different length.

    Examples
    --------
    >>> run_pid(PID(0.5, 0.007, 0.001, 2e-3), 1.0, [0.0, 0.0]).round(5).tolist()
    [0.82143, 0.71429]
    """
    return run_block(pid_block(controller, ALONE), "run_pid", reference, measured)[0]

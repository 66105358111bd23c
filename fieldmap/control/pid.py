"""The sampled PID controller: gains, transfer function, and runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.control.blocks import ALONE, AxisReading, ControllerBlock, RunningBlock, run_block
from fieldmap.control.linear_models import TransferFunction, transfer_function
from fieldmap.core.controller import SIGNALS, CoreController
from fieldmap.records import Record
from fieldmap.typing import Array

# Weights of the present and of the previous error in the integral.
INTEGRATION = {"rectangular": (1.0, 0.0), "trapezoidal": (0.5, 0.5)}
USUAL_INTEGRATION: Final = "trapezoidal"
"""Default rule of the integral, in Python and in scenario files."""
ANTI_WINDUP = ("none", "clamping", "back_calculation")


@dataclass(frozen=True, repr=False)
class PID(Record):
    """A PID controller of two degrees of freedom that runs every Ts seconds: docs/theory/control.md (1), (2).

    u[n] = Kc (b r[n] - y[n]) + (Kc Ts / Ti) s[n] + D[n], where s is the sum of the errors e = r - y by the rule of the
    integral and D[n] = Tf / (Tf + Ts) D[n-1] + Kc Td / (Tf + Ts) (d[n] - d[n-1]), d = c r - y. Before the first sample
    r, y and D are 0.

    Kc: gain, output per unit of error. Ti: integral time, s (infinity: no integral part). Td: derivative time, s.
    Tf: time constant of the filter of the derivative, s; 0 for none. Others write N = Td / Tf, usually 5 to 20.
    b, c: weights of the set point in the proportional and in the derivative part. c = 0 is the derivative on the
    measurement, without a kick at a step of the reference.
    integration: "trapezoidal" adds (e[n] + e[n-1]) / 2, as LabVIEW's manual documents it; "rectangular" adds e[n].
    lower, upper: limits of the output. anti_windup: "none"; "clamping" (conditional integration) stops the integral
    while it would drive the output further past a limit; "back_calculation" pulls it back with the time constant
    tracking_time, s (sqrt(Ti Td) unless given; Ti if Td = 0). acts_on_minus_error: for a plant of negative gain.
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
    Tf: float = 0.0
    acts_on_minus_error: bool = False
    b: float = 1.0
    c: float = 1.0

    def __post_init__(self) -> None:
        _check_gains("PID", self.Kc, self.Ti, self.Td, self.Ts, self.Tf)
        arguments.check_numbers("PID", b=self.b, c=self.c)
        arguments.check_ordered("PID", self.lower, self.upper)
        arguments.check_choice("PID(integration)", self.integration, INTEGRATION)
        arguments.check_choice("PID(anti_windup)", self.anti_windup, ANTI_WINDUP)
        if self.tracking_time is not None:
            arguments.check_positive("PID", tracking_time=self.tracking_time)


def _check_gains(where: str, Kc: float, Ti: float, Td: float, Ts: float, Tf: float) -> None:
    """Check the gains; an infinite Ti means no integral part."""
    arguments.check_numbers(where, Kc=Kc)
    arguments.check_positive(where, Ts=Ts, **({} if Ti == np.inf else {"Ti": Ti}))
    arguments.check_not_negative(where, Td=Td, Tf=Tf)


def pid_transfer_function(
    Kc: float, Ti: float, Td: float, Ts: float, *, Tf: float = 0.0, integration: str = USUAL_INTEGRATION
) -> TransferFunction:
    """The sampled PID controller as a transfer function in q, from minus the measurement: docs/theory/control.md (3).

    If both weights of the set point are 1, it is also the transfer function from the error.

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
    Tf
        Time constant of the filter of the derivative, s.
    integration
        "trapezoidal" or "rectangular".

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
    _check_gains("pid_transfer_function", Kc, Ti, Td, Ts, Tf)
    arguments.check_choice("pid_transfer_function(integration)", integration, INTEGRATION)
    kept, derivative = Tf / (Tf + Ts), Td / (Tf + Ts)
    slow = np.array([1.0, -kept])
    if Ti == np.inf:  # the pole at 1 and its zero cancel
        return transfer_function(Kc * (slow + derivative * np.array([1.0, -1.0])), slow)
    now, before = INTEGRATION[integration]
    proportional = np.array([1.0 + now * Ts / Ti, -1.0 + before * Ts / Ti])
    numerator = np.polymul(proportional, slow) + derivative * np.array([1.0, -2.0, 1.0])
    return transfer_function(Kc * numerator, np.polymul([1.0, -1.0], slow))


def pid_block(
    controller: PID, reading: AxisReading, output: float = 0.0, at: ArrayLike | None = None
) -> ControllerBlock:
    """A PID controller of one axis as a block: docs/theory/control.md (1), (2).

    Parameters
    ----------
    controller
        The controller.
    reading
        Its reading of the axis.
    output
        Output at the start.
    at
        Signals (7,) at the start; without them all signals before the first sample are zero.

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
    Ti, Td, Ts = controller.Ti, controller.Td, controller.Ts
    proportional, error, slope, kd = _parts(controller, reading)
    ki, kept = controller.Kc * Ts / Ti, controller.Tf / (controller.Tf + Ts)
    now, before = INTEGRATION[controller.integration]
    # Memory: integral, previous error, filtered input of the derivative. D of (1) is kd (input - filtered input).
    C = np.array([[1.0, ki * before, -kd]])
    D = (proportional + ki * now * error + kd * slope)[None]
    A, B, E = np.zeros((3, 3)), np.zeros((3, SIGNALS)), np.zeros((3, 1))
    A[0, :2], A[2, 2] = (1.0, ki * before), kept
    B[0], B[1], B[2] = ki * now * error, error, (1.0 - kept) * slope
    if controller.anti_windup == "back_calculation":
        usual = float(np.sqrt(Ti * Td)) if Td else Ti
        share = min(1.0, Ts / (controller.tracking_time or usual))
        A[0], B[0], E[0, 0] = A[0] - share * C[0], B[0] - share * D[0], share
    memory = np.array([output, 0.0, 0.0])
    if at is not None:
        there = arguments.check_signal("pid_block(at)", at, columns=SIGNALS)
        memory[:] = output - proportional @ there, error @ there, slope @ there
    hold = np.array([0 if controller.anti_windup == "clamping" else -1, -1, -1])
    limits = np.array([controller.lower]), np.array([controller.upper])
    return ControllerBlock(A, B, C, D, E, *limits, hold, memory)


def _parts(controller: PID, reading: AxisReading) -> tuple[Array, Array, Array, float]:
    """Rows (7,) of proportional part, error and input of the derivative, by the signals; factor of the derivative."""
    sign = -1.0 if controller.acts_on_minus_error else 1.0
    wanted, measured = sign * reading.reference, sign * reading.measured
    proportional = controller.Kc * (controller.b * wanted - measured)
    factor = controller.Kc * controller.Td / (controller.Tf + controller.Ts)
    return proportional, wanted - measured, controller.c * wanted - measured, factor


class RunningPID(RunningBlock):
    """A PID controller with its memory, for a loop of your own: call `step` once per sample.

    >>> running = RunningPID(PID(Kc=2.0, Ti=0.1, Td=0.0, Ts=0.01))
    >>> [round(running.step(reference=1.0, measured=y), 3) for y in (0.0, 0.5)]
    [2.1, 1.25]
    """

    def __init__(self, controller: PID) -> None:
        self.controller = controller
        self.reset()

    def reset(self, integral: float = 0.0) -> None:
        """Reset the memory.

        Parameters
        ----------
        integral
            Start value of the integral part of the output.
        """
        arguments.check_numbers("RunningPID.reset", integral=integral)
        self._start(pid_block(self.controller, ALONE, integral))

    def start(self, output: float, reference: float, measured: float) -> None:
        """Start bumplessly, as after manual control: the output continues from its present value.

        Parameters
        ----------
        output
            The present output.
        reference, measured
            The present reference and measurement.
        """
        given = {"output": output, "reference": reference, "measured": measured}
        arguments.check_numbers("RunningPID.start", **given)
        at = [reference, 0.0, 0.0, measured, 0.0, 0.0, 1.0]
        self._start(pid_block(self.controller, ALONE, output, at))
        self._signals[0] = at

    def change(self, controller: PID) -> None:
        """Change the gains bumplessly: the integral compensates the change of the proportional part.

        The derivative part continues from its value; without derivative time it is zero.

        Parameters
        ----------
        controller
            The controller with the new gains.
        """
        (last,) = self._signals
        proportional, _, slope, factor = _parts(self.controller, ALONE)
        part, derivative = proportional @ last, factor * (slope @ last - self.memory[2])
        proportional, error, slope, factor = _parts(controller, ALONE)
        self.memory[0] += part - proportional @ last
        self.memory[1:] = error @ last, slope @ last - (derivative / factor if factor else 0.0)
        self.controller, self._core = controller, CoreController(pid_block(controller, ALONE).arrays)


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

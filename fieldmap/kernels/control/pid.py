"""The sampled PID controller, one sample at a time, with limits and anti-windup: docs/theory/control.md (1), (2).

state (3,): integral part of the output, previous error, previous value of the signal that is differentiated.
"""

from typing import NamedTuple

from fieldmap.kernels.compilation import njit


class PidGains(NamedTuple):
    """Kc; per sample Kc Ts / Ti and Kc Td / Ts."""

    proportional: float
    integral: float
    derivative: float


class PidOptions(NamedTuple):
    """Limits of the output; anti-windup (0 none, 1 hold, 2 track); share Ts / Tt by which the integral tracks; 1 for
    the trapezoidal rule, 0 for the rectangular one. All are floats, so that every controller compiles to the
    same code."""

    lower: float
    upper: float
    anti_windup: float
    tracking: float
    trapezoidal: float


@njit
def pid_step(error, slope_signal, gains, options, state):
    """The output at this sample; advances the state."""
    increment = gains.integral * (0.5 * (error + state[1]) if options.trapezoidal != 0.0 else error)
    integral = state[0] + increment
    wanted = gains.proportional * error + integral + gains.derivative * (slope_signal - state[2])
    output = min(max(wanted, options.lower), options.upper)
    if options.anti_windup == 1.0 and (wanted - output) * increment > 0.0:
        integral = state[0]
    elif options.anti_windup == 2.0:
        integral += options.tracking * (output - wanted)
    state[0], state[1], state[2] = integral, error, slope_signal
    return output


@njit
def pid_sample(error, slope_signal, numbers, state):
    """`pid_step` with gains and options as one array (8,), which Python hands over sooner than named tuples."""
    gains = PidGains(numbers[0], numbers[1], numbers[2])
    options = PidOptions(numbers[3], numbers[4], numbers[5], numbers[6], numbers[7])
    return pid_step(error, slope_signal, gains, options, state)


@njit
def pid_run(errors, slope_signals, gains, options, state, outputs):
    """The outputs of a sequence of samples."""
    for n in range(errors.shape[0]):
        outputs[n] = pid_step(errors[n], slope_signals[n], gains, options, state)

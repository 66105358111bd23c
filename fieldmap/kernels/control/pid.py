"""The sampled PID controller, one sample at a time: thesis (5-10), with limits and anti-windup.

gains: proportional, integral per sample, derivative per sample = Kc, Kc Ts / Ti, Kc Td / Ts.
options: lower limit, upper limit, anti-windup (0 none, 1 hold, 2 track), Ts / Tt for tracking, 1 for the trapezoidal
rule or 0 for the rectangular one.
state: integral part of the output, previous error, previous value of the signal that is differentiated.
"""

from numba import njit


@njit(cache=True)
def pid_step(error, slope_signal, gains, options, state):
    """The output at this sample; advances the state."""
    increment = gains[1] * (0.5 * (error + state[1]) if options[4] != 0.0 else error)
    integral = state[0] + increment
    wanted = gains[0] * error + integral + gains[2] * (slope_signal - state[2])
    output = min(max(wanted, options[0]), options[1])
    if options[2] == 1.0 and (wanted - output) * increment > 0.0:
        integral = state[0]
    elif options[2] == 2.0:
        integral += options[3] * (output - wanted)
    state[0], state[1], state[2] = integral, error, slope_signal
    return output


@njit(cache=True)
def pid_run(errors, slope_signals, gains, options, state, outputs):
    """The outputs of a sequence of samples."""
    for n in range(errors.shape[0]):
        outputs[n] = pid_step(errors[n], slope_signals[n], gains, options, state)

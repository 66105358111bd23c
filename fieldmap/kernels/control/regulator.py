"""State feedback on estimated states, one sample at a time: thesis (7-15), (7-16), (7-21).

a (n, n), b (n, 2): the estimator's A_est and B_est, inputs in the order of the printed matrices: control, then output.
cx (n, n), dx (n,): the rows of C_est and of D_est's last column that give the filtered states. k (n + 1,): feedback of
the states and of the integral. settings: Ts, divisor of the feedback, lower and upper limit of the output, which
states are fed back (0 predicted x[n|n-1], 1 filtered x[n|n], 2 delayed x[n-1|n-1]), intercept and slope of the
equilibrium output, 1 if that is taken at the measured position or 0 at the reference.
state: n predicted states, n delayed filtered states, integral.
"""

from numba import njit


@njit(cache=True)
def regulator_step(reference, measured, a, b, cx, dx, k, settings, state, filtered):
    """The output at this sample; advances the state. filtered (n,): the filtered states, as by-product."""
    n = a.shape[0]
    deviation = measured - reference
    for i in range(n):
        filtered[i] = dx[i] * deviation
        for j in range(n):
            filtered[i] += cx[i, j] * state[j]
    feedback = -k[n] * state[2 * n]
    for i in range(n):
        fed = state[i] if settings[4] == 0.0 else filtered[i] if settings[4] == 1.0 else state[n + i]
        feedback -= k[i] * fed
    equilibrium = settings[5] + settings[6] * (measured if settings[7] != 0.0 else reference)
    output = min(max(equilibrium + feedback / settings[1], settings[2]), settings[3])
    _advance(output - equilibrium, deviation, a, b, settings, state, filtered)
    return output


@njit(cache=True)
def _advance(control, deviation, a, b, settings, state, filtered):
    n = a.shape[0]
    for i in range(n):
        # The filtered states take the place of the old delayed ones; these hold the sum until all are done.
        state[n + i] = b[i, 0] * control + b[i, 1] * deviation
        for j in range(n):
            state[n + i] += a[i, j] * state[j]
    for i in range(n):
        state[i] = state[n + i]
        state[n + i] = filtered[i]
    state[2 * n] += settings[0] * deviation


@njit(cache=True)
def regulator_run(references, measured, a, b, cx, dx, k, settings, state, outputs, states):
    """The outputs of a sequence of samples, and the filtered states (samples, n)."""
    for m in range(measured.shape[0]):
        outputs[m] = regulator_step(references[m], measured[m], a, b, cx, dx, k, settings, state, states[m])

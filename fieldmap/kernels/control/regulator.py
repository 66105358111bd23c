"""State feedback on estimated states, one sample at a time: docs/theory/control.md (8), (9).

k (n + 1,): feedback of the states and of the integral. state: n predicted states, n delayed filtered states, integral.
"""

from typing import Any, NamedTuple

from fieldmap.kernels.compilation import njit


class EstimatorRows(NamedTuple):
    """a (n, n), b (n, 2): of the prediction, inputs control, then output; cx (n, n), dx (n,): of the filtered
    states."""

    a: Any
    b: Any
    cx: Any
    dx: Any


class RegulatorSettings(NamedTuple):
    """Sampling time, s; divisor of the feedback; limits of the output; which states are fed back (0 predicted
    x[n|n-1], 1 filtered x[n|n], 2 delayed x[n-1|n-1]); intercept and slope of the equilibrium output; 1 if that is
    taken at the measured position, 0 at the reference. All are floats, so that every regulator compiles alike."""

    Ts: float
    divisor: float
    lower: float
    upper: float
    estimate: float
    intercept: float
    slope: float
    at_measured: float


@njit
def regulator_step(reference, measured, estimator, k, settings, state, filtered):
    """The output at this sample; advances the state. filtered (n,): the filtered states, as by-product."""
    a, b, cx, dx = estimator
    n = a.shape[0]
    deviation = measured - reference
    for i in range(n):
        filtered[i] = dx[i] * deviation
        for j in range(n):
            filtered[i] += cx[i, j] * state[j]
    feedback = -k[n] * state[2 * n]
    for i in range(n):
        fed = (
            state[i]
            if settings.estimate == 0.0
            else filtered[i]
            if settings.estimate == 1.0
            else state[n + i]
        )
        feedback -= k[i] * fed
    equilibrium = settings.intercept + settings.slope * (
        measured if settings.at_measured != 0.0 else reference
    )
    output = min(max(equilibrium + feedback / settings.divisor, settings.lower), settings.upper)
    _advance(output - equilibrium, deviation, a, b, settings.Ts, state, filtered)
    return output


@njit
def _advance(control, deviation, a, b, Ts, state, filtered):
    n = a.shape[0]
    for i in range(n):
        # The filtered states take the place of the old delayed ones; these hold the sum until all are done.
        state[n + i] = b[i, 0] * control + b[i, 1] * deviation
        for j in range(n):
            state[n + i] += a[i, j] * state[j]
    for i in range(n):
        state[i] = state[n + i]
        state[n + i] = filtered[i]
    state[2 * n] += Ts * deviation


@njit
def regulator_run(references, measured, estimator, k, settings, state, outputs, states):
    """The outputs of a sequence of samples, and the filtered states (samples, n)."""
    for m in range(measured.shape[0]):
        outputs[m] = regulator_step(references[m], measured[m], estimator, k, settings, state, states[m])

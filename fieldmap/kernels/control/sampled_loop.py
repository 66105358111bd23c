"""A sampled linear plant in closed loop with a controller and its instruments, for many runs.

Plant x[n+1] = A x[n] + B (u[n] + disturbance[n]), y[n] = C x[n] (strictly proper: y[n] does not wait for u[n]).
Signals are (runs, samples), the reference (samples,); y: true position, u: the controller's output. The plant's u is
what the drive makes of the controller's output, less the operating value.

The loop stands once for each law, so that a sample costs no choice: PID, regulator, and any linear block.
"""

from typing import Any, NamedTuple

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.control.block import SIGNALS, control
from fieldmap.kernels.control.instruments import GAIN, OFFSET, drive, measure
from fieldmap.kernels.control.pid import pid_step
from fieldmap.kernels.control.regulator import regulator_step


class SampledPlant(NamedTuple):
    """A (n, n), B (n,), C (n,) of the deviations; output of the controller at the operating point."""

    A: Any
    B: Any
    C: Any
    operating: float


class LoopSignals(NamedTuple):
    """Noise of position, of the converter's voltage and of the current, and disturbance of the plant's input."""

    position_noise: Any
    voltage_noise: Any
    current_noise: Any
    disturbance: Any


class LoopChain(NamedTuple):
    """Measuring chain (10,) and drive (7,), as in fieldmap.kernels.control.instruments; position of the operating
    point."""

    chain: Any
    drive: Any
    position: float


# The loops take their tuples apart before they begin: handed to a function at every sample, the references of all their
# arrays would be counted there, which takes longer than the sample.


@njit
def _applied(operating, output, noise, numbers):
    """What the drive makes of the controller's output, less what it makes of the operating value."""
    applied = drive(operating + output, noise, numbers)
    applied -= numbers[GAIN] * operating + numbers[OFFSET]
    return applied


@njit
def _advance(A, B, u, x, scratch):
    """Advance x (n,) by a sample with this input."""
    for i in range(x.shape[0]):
        scratch[i] = B[i] * u
        for j in range(x.shape[0]):
            scratch[i] += A[i, j] * x[j]
    for i in range(x.shape[0]):
        x[i] = scratch[i]


@njit
def pid_loop(plant, reference, signals, instruments, sign, slope_of_error, gains, options, y, u):
    """PID on sign * (reference - measured). slope_of_error: 1 to differentiate the error, 0 the measurement."""
    A, B, C, operating = plant
    position_noise, voltage_noise, current_noise, disturbance = signals
    chain, numbers, zero = instruments
    scratch = np.empty(A.shape[0])
    for run in range(y.shape[0]):
        x, state = np.zeros(A.shape[0]), np.zeros(3)
        for n in range(y.shape[1]):
            y[run, n] = np.dot(C, x)
            seen = measure(zero + y[run, n] + position_noise[run, n], voltage_noise[run, n], chain) - zero
            error = sign * (reference[n] - seen)
            slope = error if slope_of_error != 0 else -sign * seen
            u[run, n] = pid_step(error, slope, gains, options, state)
            applied = _applied(operating, u[run, n], current_noise[run, n], numbers)
            _advance(A, B, applied + disturbance[run, n], x, scratch)


@njit
def regulator_loop(plant, reference, signals, instruments, estimator, k, settings, y, u):
    """The regulator with its estimator. The equilibrium output that the regulator adds is part of u; the plant gets u
    less its own operating output at the position 0, and `settings` says what the regulator takes for it."""
    A, B, C, operating = plant
    position_noise, voltage_noise, current_noise, disturbance = signals
    chain, numbers, zero = instruments
    scratch, filtered = np.empty(A.shape[0]), np.empty(estimator.a.shape[0])
    for run in range(y.shape[0]):
        x, state = np.zeros(A.shape[0]), np.zeros(2 * estimator.a.shape[0] + 1)
        for n in range(y.shape[1]):
            y[run, n] = np.dot(C, x)
            seen = measure(zero + y[run, n] + position_noise[run, n], voltage_noise[run, n], chain) - zero
            u[run, n] = regulator_step(reference[n], seen, estimator, k, settings, state, filtered)
            applied = _applied(operating, u[run, n], current_noise[run, n], numbers)
            _advance(A, B, applied + disturbance[run, n], x, scratch)


@njit
def block_loop(plant, reference, signals, instruments, block, memory, y, u):
    """Any linear block of one output: reference and measured position stand for all three axes of its signals."""
    A, B, C, operating = plant
    position_noise, voltage_noise, current_noise, disturbance = signals
    chain, numbers, zero = instruments
    size = memory.shape[0]
    scratch, inner = np.empty(A.shape[0]), np.empty(size + 1)
    v, output, none = np.ones(SIGNALS), np.empty(1), np.zeros(1)
    for run in range(y.shape[0]):
        x, state = np.zeros(A.shape[0]), memory.copy()
        for n in range(y.shape[1]):
            y[run, n] = np.dot(C, x)
            seen = measure(zero + y[run, n] + position_noise[run, n], voltage_noise[run, n], chain) - zero
            for k in range(3):
                v[k], v[3 + k] = reference[n], seen
            control(block, v, none, state, inner, output)
            u[run, n] = output[0]
            applied = _applied(operating, u[run, n], current_noise[run, n], numbers)
            _advance(A, B, applied + disturbance[run, n], x, scratch)

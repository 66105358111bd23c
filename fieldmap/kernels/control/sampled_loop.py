"""A sampled plant in closed loop with a controller and its instruments, for many runs.

Plant x[n+1] = A x[n] + B (u[n] + disturbance[n]), y[n] = C x[n] (strictly proper: y[n] does not wait for u[n]).
Arrays of signals are (runs, samples). Instruments: see fieldmap.kernels.control.instruments; the loop's u is what the
drive makes of the controller's output, less the operating value.
"""

import numpy as np
from numba import njit

from fieldmap.kernels.control.instruments import drive, measure
from fieldmap.kernels.control.pid import pid_step
from fieldmap.kernels.control.regulator import regulator_step


@njit(cache=True)
def _advance_plant(a, b, u, x, scratch):
    n = a.shape[0]
    for i in range(n):
        scratch[i] = b[i] * u
        for j in range(n):
            scratch[i] += a[i, j] * x[j]
    for i in range(n):
        x[i] = scratch[i]


@njit(cache=True)
def pid_loop(plant, reference, noise, disturbance, instruments, sign, slope_of_error, gains, options, y, u):
    """PID on sign * (reference - measured). plant: A, B, C, operating output. noise: of position, of voltage, of
    current. instruments: chain, drive, operating position. slope_of_error: 1 to differentiate the error, 0 the
    measurement. y: true position; u: the controller's output."""
    a, b, c, operating = plant
    position_noise, voltage_noise, current_noise = noise
    chain, numbers, zero = instruments
    scratch = np.empty(a.shape[0])
    for run in range(y.shape[0]):
        x, state = np.zeros(a.shape[0]), np.zeros(3)
        for n in range(y.shape[1]):
            y[run, n] = np.dot(c, x)
            seen = measure(zero + y[run, n] + position_noise[run, n], voltage_noise[run, n], chain) - zero
            error = sign * (reference[n] - seen)
            slope = error if slope_of_error != 0 else -sign * seen
            u[run, n] = pid_step(error, slope, gains, options, state)
            applied = drive(operating + u[run, n], current_noise[run, n], numbers)
            applied -= numbers[3] * operating + numbers[4]
            _advance_plant(a, b, applied + disturbance[run, n], x, scratch)


@njit(cache=True)
def regulator_loop(plant, reference, noise, disturbance, instruments, estimator, k, settings, y, u):
    """The regulator with its estimator (A_est, B_est, rows of C_est and D_est for the states) on the plant. The
    equilibrium output that the regulator adds is part of u; the plant gets u less its own operating output at the
    position 0, and `settings` says what the regulator takes for it."""
    a, b, c, operating = plant
    position_noise, voltage_noise, current_noise = noise
    chain, numbers, zero = instruments
    a_est, b_est, cx, dx = estimator
    scratch, filtered = np.empty(a.shape[0]), np.empty(a_est.shape[0])
    for run in range(y.shape[0]):
        x, state = np.zeros(a.shape[0]), np.zeros(2 * a_est.shape[0] + 1)
        for n in range(y.shape[1]):
            y[run, n] = np.dot(c, x)
            seen = measure(zero + y[run, n] + position_noise[run, n], voltage_noise[run, n], chain) - zero
            u[run, n] = regulator_step(reference[n], seen, a_est, b_est, cx, dx, k, settings, state, filtered)
            applied = drive(operating + u[run, n], current_noise[run, n], numbers)
            applied -= numbers[3] * operating + numbers[4]
            _advance_plant(a, b, applied + disturbance[run, n], x, scratch)

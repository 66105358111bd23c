"""Least squares of y[n] on past outputs and inputs, all at once by Givens rotations or sample by sample.

Regressor of sample n: -y[n-1] ... -y[n-poles], u[n-delay] ... u[n-delay-terms+1] (and past errors where there are
some). Rotations: Golub and Van Loan, Matrix Computations, 4th ed., 5.1.8 and 6.5.3; they cost one pass over the
records, and no squared condition. Recursive: Ljung, System Identification, 2nd ed., 11.2 and 11.5.
Signals float64, C-contiguous; arguments are not checked here.
"""

from typing import NamedTuple

import numpy as np

from fieldmap.kernels.compilation import njit
from fieldmap.kernels.copy_vector import copy_vector


class Structure(NamedTuple):
    """Numbers of poles, of terms of the input, samples of delay, terms of past errors, and the first sample used."""

    poles: int
    terms: int
    delay: int
    noise: int
    first: int


@njit(nogil=True)
def rotate_in(row, triangle):
    """Add a row (m,) to an upper triangle (m, m) so that triangle.T triangle grows by row.T row. Spoils row."""
    m = row.shape[0]
    for j in range(m):
        if row[j] != 0.0:
            length = np.sqrt(triangle[j, j] ** 2 + row[j] ** 2)
            cosine, sine = triangle[j, j] / length, row[j] / length
            triangle[j, j] = length
            for k in range(j + 1, m):
                kept = triangle[j, k]
                triangle[j, k] = cosine * kept + sine * row[k]
                row[k] = cosine * row[k] - sine * kept


@njit(nogil=True)
def fill_regressor(y, u, n, poles, terms, delay, row):
    """Past outputs, negative, and inputs of sample n."""
    for i in range(poles):
        row[i] = -y[n - 1 - i]
    for i in range(terms):
        row[poles + i] = u[n - delay - i]


@njit(nogil=True)
def triangles(y, u, poles, terms, delay, first, out):
    """out (runs, p + 1, p + 1), p = poles + terms: the triangle of regressors and output over samples first...;
    y, u (runs, samples)."""
    p = poles + terms
    row = np.empty(p + 1)
    for run in range(y.shape[0]):
        out[run] = 0.0
        for n in range(first, y.shape[1]):
            fill_regressor(y[run], u[run], n, poles, terms, delay, row)
            row[p] = y[run, n]
            rotate_in(row, out[run])


@njit(nogil=True)
def recursive(y, u, structure, forgetting, theta, covariance, history):
    """Recursive (extended) least squares from the given theta (p,) and covariance (p, p), both updated.

    structure: `Structure`. With noise terms the regressor goes on with past errors after the update (extended least
    squares). history (samples, p): theta after each sample.
    """
    poles, terms, delay, noise, first = structure
    known, p = poles + terms, poles + terms + noise
    row, gain = np.zeros(p), np.empty(p)
    for n in range(y.shape[0]):
        if n >= first:
            fill_regressor(y, u, n, poles, terms, delay, row)
            for i in range(p):
                gain[i] = 0.0
                for j in range(p):
                    gain[i] += covariance[i, j] * row[j]
            scale = forgetting + np.dot(row, gain)
            error = y[n] - np.dot(row, theta)
            for i in range(p):
                theta[i] += gain[i] * error / scale
            for i in range(p):
                for j in range(i + 1):
                    covariance[i, j] = (covariance[i, j] - gain[i] * gain[j] / scale) / forgetting
                    covariance[j, i] = covariance[i, j]
            error = y[n] - np.dot(row, theta)
            for i in range(p - 1, known, -1):
                row[i] = row[i - 1]
            if noise > 0:
                row[known] = error
        copy_vector(theta, history[n])

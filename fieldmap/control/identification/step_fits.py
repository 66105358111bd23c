"""First and second order models from step responses, and metrics of noisy ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check_count, check_numbers, check_signal
from fieldmap.control.linear_models import TransferFunction
from fieldmap.control.step_metrics import StepMetrics, step_metrics
from fieldmap.errors import InputError, NotConverged, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class StepFit(Record):
    """A continuous model fitted to a step response.

    model: in s. gain: output per input at rest. parameters: name -> value, standard errors under the same names in
    `errors` (white noise of the sensor assumed). residual_rms: in units of the output.
    """

    model: TransferFunction
    gain: float
    parameters: dict[str, float]
    errors: dict[str, float]
    residual_rms: float


def fit_first_order(time: ArrayLike, response: ArrayLike, step: float = 1.0) -> StepFit:
    """gain / (time_constant s + 1) from the response to a step of the input at time[0]: (17).

    time (n,), s; response (n,): deviation from rest; step: height of the input's step. Raises InputError and
    NotConverged.

    >>> t = np.linspace(0, 3, 301)
    >>> fit = fit_first_order(t, 4.0 * (1 - np.exp(-t / 0.5)), step=2.0)
    >>> print({name: round(value, 6) for name, value in fit.parameters.items()})
    {'gain': 2.0, 'time_constant': 0.5}
    """
    t, y = _record("fit_first_order", time, response, step)
    guess = np.array([y[-1] / step, max(_time_to(t, y, 0.632), t[1])])
    theta, deviation, rms = _fit(lambda p: step * p[0] * -np.expm1(-t / p[1]), y, guess, "fit_first_order")
    model = TransferFunction(np.array([theta[0] / theta[1]]), np.array([1.0, 1.0 / theta[1]]))
    return _report(model, theta, deviation, rms, ("gain", "time_constant"))


def fit_second_order(time: ArrayLike, response: ArrayLike, step: float = 1.0) -> StepFit:
    """gain w^2 / (s^2 + 2 damping w s + w^2), w the natural frequency in rad/s, no zeros: (18); arguments as
    `fit_first_order`. damping > 1 is two real poles."""
    t, y = _record("fit_second_order", time, response, step)
    half = max(_time_to(t, y, 0.5), t[1])
    tries = [
        _fit(
            lambda p: step * _second_order(t, p),
            y,
            np.array([y[-1] / step, 1.5 / half, z]),
            "fit_second_order",
        )
        for z in (0.3, 1.5)
    ]
    theta, deviation, rms = min(tries, key=lambda found: found[2])
    w = theta[1]
    model = TransferFunction(np.array([theta[0] * w * w]), np.array([1.0, 2.0 * theta[2] * w, w * w]))
    return _report(model, theta, deviation, rms, ("gain", "natural_frequency", "damping"))


def noisy_step_metrics(
    time: ArrayLike, response: ArrayLike, *, before: int, window: int, band: float = 0.02
) -> StepMetrics:
    """`step_metrics` of a measured response whose levels are not known and whose samples are noisy.

    before: number of samples ahead of the step, whose mean is the initial value; the final value is the mean of the
    last quarter. window: samples over which a parabola is fitted around each sample (Savitzky and Golay), odd: choose
    it shorter than a quarter of the rise. A band narrower than four standard deviations of what noise is left is
    refused: settling would be the noise's. steady_rms is that of the record as measured. Raises InputError.
    """
    where = "noisy_step_metrics"
    check_count(where, before=before, window=window)
    t, y = _record(where, time, response, 1.0)
    if not 5 <= window < (t.size - before) // 4 or window % 2 == 0 or before < 2:
        raise InputError(
            Problem(
                f"{where}(before, window)",
                "must be two or more samples of rest, and an odd window from 5 to a quarter of the rest",
                f"{before}, {window} of {t.size} samples",
                "take the record from before the step on",
            )
        )
    since, after = t[before:], y[before:]
    initial, final = float(np.mean(y[:before])), float(np.mean(after[-(after.size // 4) :]))
    # Here, as in `filter_response`: scipy.signal takes long to load.
    from scipy.signal import savgol_filter

    smooth = savgol_filter(after, window, 2)
    left = float(np.std(smooth[-(after.size // 4) :]))
    needed = 4.0 * left / max(abs(final - initial), 1e-300)
    if band < needed:
        raise InputError(
            Problem(
                f"{where}(band)",
                f"must be above {needed:.2g}, four deviations of the noise left",
                f"{band!r}",
                "widen the band or the window, or average several steps",
            )
        )
    found = step_metrics(since, smooth, initial=initial, final=final, band=band)
    rms = float(np.std(after[-(after.size // 4) :]))
    return StepMetrics(found.rise_time, found.peak_time, found.settling_time, found.overshoot, rms)


def _second_order(t: Array, theta: Array) -> Array:
    gain, w, damping = theta
    if abs(damping - 1.0) < 1e-6:  # the two poles meet: their difference is a divisor
        damping = 1.0 + 1e-6
    root = np.sqrt(complex(damping * damping - 1.0))
    fast, slow = w * (-damping - root), w * (-damping + root)
    return gain * np.real(1.0 + (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (slow - fast))


def _record(where: str, time: ArrayLike, response: ArrayLike, step: float) -> tuple[Array, Array]:
    t, y = check_signal(f"{where}(time)", time), check_signal(f"{where}(response)", response)
    check_numbers(where, step=step)
    if t.ndim != 1 or t.shape != y.shape or t.size < 8 or (np.diff(t) <= 0).any() or step == 0.0:
        raise InputError(
            Problem(
                where,
                "must be eight or more rising times, as many values, and a step that is not 0",
                f"shapes {t.shape} and {y.shape}, step {step!r}",
                "give one response from the step on",
            )
        )
    return t - t[0], y


def _time_to(t: Array, y: Array, share: float) -> float:
    return float(t[np.argmax(y / y[-1] >= share)]) if y[-1] else float(t[-1] / 2)


def _fit(response: Any, y: Array, guess: Array, where: str) -> tuple[Array, Array, float]:
    """Parameters (positive after the gain, so they are fitted as logarithms), their deviations, the residual."""

    def unpack(x: Array) -> Array:
        return np.concatenate([x[:1] * scale, np.exp(np.clip(x[1:], -50, 50))])

    scale = guess[0] if guess[0] else 1.0
    start = np.concatenate([[1.0], np.log(guess[1:])])
    found = scipy.optimize.least_squares(lambda x: response(unpack(x)) - y, start, xtol=1e-12, ftol=1e-14)
    if not found.success or not np.isfinite(found.fun).all():
        raise NotConverged(
            Problem(where, "must converge", found.message, "check that the response begins at the step")
        )
    variance = 2 * found.cost / (y.size - start.size)
    triangle = np.linalg.qr(found.jac, mode="r")
    spread = np.sqrt(variance * np.sum(np.linalg.pinv(triangle) ** 2, axis=1))
    theta = unpack(found.x)
    lever = np.concatenate([[abs(scale)], theta[1:]])
    return theta, lever * spread, float(np.sqrt(variance))


def _report(model: TransferFunction, theta: Array, deviation: Array, rms: float, names: tuple) -> StepFit:
    parameters = {name: float(value) for name, value in zip(names, theta, strict=True)}
    errors = {name: float(value) for name, value in zip(names, deviation, strict=True)}
    return StepFit(model, float(theta[0]), parameters, errors, rms)

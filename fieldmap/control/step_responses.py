"""Metrics of step responses, and models of first and second order fitted to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import ArrayLike

from fieldmap.arguments import check, check_count, check_numbers, check_positive, check_record
from fieldmap.control.linear_models import TransferFunction
from fieldmap.errors import NotConverged
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True)
class StepMetrics(Record):
    """Times in s from the step on, infinite if the record ends before; overshoot as a share of the step.

    rise_time: from 10 % to 90 % of the step. peak_time: of the largest excursion in the direction of the step.
    settling_time: after which the response stays within the band (2 % of the step by default). overshoot: of that peak
    beyond the final value, 0 if none. steady_rms: root mean square of the error against the final value over the last
    part of the record.
    """

    rise_time: float
    peak_time: float
    settling_time: float
    overshoot: float
    steady_rms: float


def step_metrics(
    time: ArrayLike,
    response: ArrayLike,
    *,
    initial: float = 0.0,
    final: float = 1.0,
    band: float = 0.02,
    steady_share: float = 0.25,
) -> StepMetrics:
    """Rise, peak and settling time, overshoot and steady RMS error of a step response.

    Crossings are interpolated between samples. Noise is not removed: average a noisy record first, or use its
    settling time with care.

    Parameters
    ----------
    time
        (n,), rising, s; the step is at time[0].
    response
        (n,).
    initial
        Value before the step.
    final
        Set point after the step.
    band
        Band of settling, as a share of the step.
    steady_share
        Share of the record, at its end, over which the RMS is taken.

    Returns
    -------
    StepMetrics
        The metrics.

    Raises
    ------
    InputError
        For signals that are not finite or too short, and for a step of 0.

    Examples
    --------
    >>> t = np.linspace(0, 10, 10001)
    >>> m = step_metrics(t, 1 - np.exp(-t))  # first order: ln 9, ln 50, no overshoot
    >>> print(round(m.rise_time, 3), round(m.settling_time, 3), m.overshoot)
    2.197 3.912 0.0
    """
    moments, values = check_record("step_metrics", 2, time=time, response=response)
    check_positive("step_metrics", band=band, steady_share=steady_share)
    step = final - initial
    changes = bool(np.isfinite(step)) and step != 0.0
    check(changes, "step_metrics(final)", "must differ from initial", repr(final), "give the step")
    since, share = moments - moments[0], (values - initial) / step
    peak = int(np.argmax(share))
    high = _first_above(since, share, 0.9)
    tail = share[since >= (1.0 - min(steady_share, 1.0)) * since[-1]]
    return StepMetrics(
        rise_time=high - _first_above(since, share, 0.1) if np.isfinite(high) else np.inf,
        peak_time=float(since[peak]),
        settling_time=_settled(since, np.abs(share - 1.0), band),
        overshoot=max(0.0, float(share[peak] - 1.0)),
        steady_rms=abs(step) * float(np.sqrt(np.mean((tail - 1.0) ** 2))),
    )


def _first_above(time: Array, share: Array, level: float) -> float:
    """Time at which the level is first reached; infinite if it never is."""
    above = np.flatnonzero(share >= level)
    return _crossing(time, share, int(above[0]), level) if above.size else np.inf


def _settled(time: Array, distance: Array, band: float) -> float:
    outside = np.flatnonzero(distance > band)
    return _crossing(time, distance, int(outside[-1]) + 1, band) if outside.size else 0.0


def _crossing(time: Array, values: Array, after: int, level: float) -> float:
    """Time at which the line from sample after - 1 to sample `after` meets the level; infinite past the last sample."""
    if after in (0, time.size):
        return float(time[0]) if after == 0 else np.inf
    before, behind = values[after - 1], values[after]
    return float(time[after - 1] + (level - before) / (behind - before) * (time[after] - time[after - 1]))


def noisy_step_metrics(
    time: ArrayLike, response: ArrayLike, *, before: int, window: int, band: float = 0.02
) -> StepMetrics:
    """`step_metrics` of a measured response with unknown levels and noisy samples.

    The final value is the mean of the last quarter. A band narrower than four standard deviations of the
    remaining noise is refused, since the noise would decide the settling time. steady_rms is taken from the
    record as measured.

    Parameters
    ----------
    time
        (n,), rising, s.
    response
        (n,).
    before
        Number of samples before the step; their mean is the initial value.
    window
        Odd number of samples around each sample to which a parabola is fitted (Savitzky and Golay), shorter
        than a quarter of the rise.
    band
        Band of settling, as a share of the step.

    Returns
    -------
    StepMetrics
        The metrics.

    Raises
    ------
    InputError
        For signals that do not fit, and for a band that is narrower than the noise.
    """
    where = "noisy_step_metrics"
    check_count(where, before=before, window=window)
    t, y = check_record(where, 8, time=time, response=response)
    fits = 5 <= window < (t.size - before) // 4 and window % 2 == 1 and before >= 2
    must = "must be two or more samples of rest, and an odd window from 5 to a quarter of the rest"
    received, remedy = f"{before}, {window} of {t.size} samples", "take the record from before the step on"
    check(fits, f"{where}(before, window)", must, received, remedy)
    since, after = t[before:], y[before:]
    last = slice(-(after.size // 4), None)
    initial, final = float(np.mean(y[:before])), float(np.mean(after[last]))
    # Imported on use, as in `filter_response`: scipy.signal takes long to load.
    from scipy.signal import savgol_filter

    smooth = savgol_filter(after, window, 2)
    needed = 4.0 * float(np.std(smooth[last])) / max(abs(final - initial), 1e-300)
    must = f"must be above {needed:.2g}, four deviations of the noise left"
    remedy = "widen the band or the window, or average several steps"
    check(band >= needed, f"{where}(band)", must, repr(band), remedy)
    found = step_metrics(since, smooth, initial=initial, final=final, band=band)
    return replace(found, steady_rms=float(np.std(after[last])))


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
    """Fit gain / (time_constant s + 1) to the response to a step of the input at time[0]: (17).

    Parameters
    ----------
    time
        (n,), s.
    response
        Deviation from rest (n,).
    step
        Height of the input's step.

    Returns
    -------
    StepFit
        The fit.

    Raises
    ------
    InputError
        For signals that do not fit.
    NotConverged
        If the fit does not converge.

    Examples
    --------
    >>> t = np.linspace(0, 3, 301)
    >>> fit = fit_first_order(t, 4.0 * (1 - np.exp(-t / 0.5)), step=2.0)
    >>> print({name: round(value, 6) for name, value in fit.parameters.items()})
    {'gain': 2.0, 'time_constant': 0.5}
    """
    t, y = _response("fit_first_order", time, response, step)
    guess = np.array([y[-1] / step, max(_time_to(t, y, 0.632), t[1])])

    def answer(p: Array) -> Array:
        return step * p[0] * -np.expm1(-t / p[1])

    def model(gain: float, T: float) -> TransferFunction:
        return TransferFunction(np.array([gain / T]), np.array([1.0, 1.0 / T]))

    return _fit("fit_first_order", answer, y, guess, ("gain", "time_constant"), model)


def fit_second_order(time: ArrayLike, response: ArrayLike, step: float = 1.0) -> StepFit:
    """Fit gain w^2 / (s^2 + 2 damping w s + w^2), w the natural frequency in rad/s, no zeros: (18).

    damping > 1 means two real poles.

    Parameters
    ----------
    time
        (n,), s.
    response
        Deviation from rest (n,).
    step
        Height of the input's step.

    Returns
    -------
    StepFit
        The fit.

    Raises
    ------
    InputError
        For signals that do not fit.
    NotConverged
        If the fit does not converge.
    """
    t, y = _response("fit_second_order", time, response, step)
    half = max(_time_to(t, y, 0.5), t[1])

    def answer(p: Array) -> Array:
        gain, w, damping = p
        if abs(damping - 1.0) < 1e-6:  # the two poles meet: their difference is a divisor
            damping = 1.0 + 1e-6
        root = np.sqrt(complex(damping * damping - 1.0))
        fast, slow = w * (-damping - root), w * (-damping + root)
        both = fast * np.exp(slow * t) - slow * np.exp(fast * t)
        return step * (gain * np.real(1.0 + both / (slow - fast)))

    def model(gain: float, w: float, damping: float) -> TransferFunction:
        return TransferFunction(np.array([gain * w * w]), np.array([1.0, 2.0 * damping * w, w * w]))

    names = ("gain", "natural_frequency", "damping")
    starts = [np.array([y[-1] / step, 1.5 / half, damping]) for damping in (0.3, 1.5)]
    tries = [_fit("fit_second_order", answer, y, start, names, model) for start in starts]
    return min(tries, key=lambda found: found.residual_rms)


def _response(where: str, time: ArrayLike, response: ArrayLike, step: float) -> tuple[Array, Array]:
    """Times relative to the first one, and the response."""
    t, y = check_record(where, 8, time=time, response=response)
    check_numbers(where, step=step)
    remedy = "give the height of the input's step"
    check(step != 0.0, f"{where}(step)", "must be a step that is not 0", step, remedy)
    return t - t[0], y


def _time_to(t: Array, y: Array, share: float) -> float:
    return float(t[np.argmax(y / y[-1] >= share)]) if y[-1] else float(t[-1] / 2)


def _fit(
    where: str,
    answer: Callable[[Array], Array],
    y: Array,
    guess: Array,
    names: tuple[str, ...],
    model: Callable[..., TransferFunction],
) -> StepFit:
    """answer: response (n,) for given parameters; those after the gain are positive, and are fitted as logarithms.
    model: transfer function for given parameters."""
    scale = guess[0] if guess[0] else 1.0

    def unpack(x: Array) -> Array:
        return np.concatenate([x[:1] * scale, np.exp(np.clip(x[1:], -50, 50))])

    start = np.concatenate([[1.0], np.log(guess[1:])])
    found = scipy.optimize.least_squares(lambda x: answer(unpack(x)) - y, start, xtol=1e-12, ftol=1e-14)
    if not found.success or not np.isfinite(found.fun).all():
        remedy = "check that the response begins at the step"
        raise NotConverged.of(where, "must converge", found.message, remedy)
    variance = 2 * found.cost / (y.size - start.size)
    triangle = np.linalg.qr(found.jac, mode="r")
    spread = np.sqrt(variance * np.sum(np.linalg.pinv(triangle) ** 2, axis=1))
    theta = unpack(found.x)
    errors = np.concatenate([[abs(scale)], theta[1:]]) * spread
    parameters, deviations = (dict(zip(names, values.tolist(), strict=True)) for values in (theta, errors))
    return StepFit(model(*theta), float(theta[0]), parameters, deviations, float(np.sqrt(variance)))

"""What a step response is judged by: one definition, used everywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import check_positive, check_signal
from fieldmap.errors import InputError, Problem
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True)
class StepMetrics(Record):
    """Times in s from the step on, infinite where the record ends before; overshoot as a share of the step.

    rise_time: from 10 % to 90 % of the step. peak_time: of the largest excursion in the direction of the step.
    settling_time: after which the response stays within the band (2 % of the step unless another was asked for).
    overshoot: of that peak beyond the final value, 0 if none. steady_rms: root mean square of the error against the
    final value over the last part of the record.
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

    time (n,): rising, s, the step is at time[0]; response (n,); initial, final: value before the step and the value
    that is asked for. band: of settling, as a share of the step. steady_share: the last share of the record that the
    RMS is taken over. Crossings are interpolated between samples. Noise is not removed: average it first, or read the
    settling time of a noisy record with care. Raises InputError for signals that are not finite or too short, and for
    a step of 0.

    >>> t = np.linspace(0, 10, 10001)
    >>> m = step_metrics(t, 1 - np.exp(-t))  # first order: ln 9, ln 50, no overshoot
    >>> print(round(m.rise_time, 3), round(m.settling_time, 3), m.overshoot)
    2.197 3.912 0.0
    """
    moments, values = _record(time, response)
    check_positive("step_metrics", band=band, steady_share=steady_share)
    step = final - initial
    if not (np.isfinite(step) and step != 0.0):
        raise InputError(
            Problem("step_metrics(final)", "must differ from initial", f"{final!r}", "give the step")
        )
    since, share = moments - moments[0], (values - initial) / step
    peak = int(np.argmax(share))
    tail = share[since >= (1.0 - min(steady_share, 1.0)) * since[-1]]
    return StepMetrics(
        rise_time=_first_above(since, share, 0.9) - _first_above(since, share, 0.1),
        peak_time=float(since[peak]),
        settling_time=_settled(since, np.abs(share - 1.0), band),
        overshoot=max(0.0, float(share[peak] - 1.0)),
        steady_rms=abs(step) * float(np.sqrt(np.mean((tail - 1.0) ** 2))),
    )


def _record(time: ArrayLike, response: ArrayLike) -> tuple[Array, Array]:
    moments = np.atleast_1d(check_signal("step_metrics(time)", time))
    values = np.atleast_1d(check_signal("step_metrics(response)", response))
    if (
        moments.ndim != 1
        or moments.size < 2
        or moments.shape != values.shape
        or (np.diff(moments) <= 0).any()
    ):
        raise InputError(
            Problem(
                "step_metrics(time, response)",
                "must be two or more rising times and as many values",
                f"shapes {moments.shape} and {values.shape}",
                "give one response; take the runs of a simulation one by one",
            )
        )
    return moments, values


def _first_above(time: Array, share: Array, level: float) -> float:
    """When the level is first reached; NaN-free: infinite if never (and then the difference of two is infinite)."""
    above = np.flatnonzero(share >= level)
    if not above.size:
        return np.inf
    return _crossing(time, share, int(above[0]), level)


def _settled(time: Array, distance: Array, band: float) -> float:
    outside = np.flatnonzero(distance > band)
    if not outside.size:
        return 0.0
    after = int(outside[-1]) + 1
    return np.inf if after == time.size else _crossing(time, distance, after, band)


def _crossing(time: Array, values: Array, after: int, level: float) -> float:
    """Where the straight line between sample after - 1 and sample `after` meets the level."""
    if after == 0:
        return float(time[0])
    before, behind = values[after - 1], values[after]
    return float(time[after - 1] + (level - before) / (behind - before) * (time[after] - time[after - 1]))

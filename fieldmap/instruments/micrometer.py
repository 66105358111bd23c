"""A scanning position sensor with an analogue output."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap.arguments import (
    check_count,
    check_not_negative,
    check_numbers,
    check_ordered,
    check_positive,
    check_signal,
)
from fieldmap.core.instruments import held_scans
from fieldmap.errors import InputError, Problem
from fieldmap.instruments.amplifier import USUAL_RANGE
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True)
class Micrometer(Record):
    """A sensor that scans a position and shows it as a voltage: position = scale voltage + zero.

    zero: position at 0 V, m. scale: m/V. voltage_step: resolution of the analogue output, V (0: none). lower, upper:
    its range, V; `USUAL_RANGE` is assumed unless given. scan_rate: scans per second, which `measuring_time` and `watch`
    need. averages: scans whose mean is shown. latency: scans between the end of a mean and its appearance.
    deviation: standard deviation of one scan, m, taken as white and Gaussian.
    """

    zero: float
    scale: float
    voltage_step: float = 0.0
    lower: float = -USUAL_RANGE
    upper: float = USUAL_RANGE
    scan_rate: float | None = None
    averages: int = 1
    latency: int = 0
    deviation: float = 0.0

    def __post_init__(self) -> None:
        check_numbers("Micrometer", zero=self.zero)
        check_positive("Micrometer", scale=self.scale)
        if self.scan_rate is not None:
            check_positive("Micrometer", scan_rate=self.scan_rate)
        check_not_negative(
            "Micrometer", voltage_step=self.voltage_step, deviation=self.deviation, latency=self.latency
        )
        check_ordered("Micrometer", self.lower, self.upper)
        check_count("Micrometer", averages=self.averages, **{"latency + 1": self.latency + 1})

    @property
    def resolution(self) -> float:
        """The position that one step of the analogue output stands for, m."""
        return self.scale * self.voltage_step

    @property
    def measuring_time(self) -> float:
        """Time for one mean, s."""
        return self.averages / _scan_rate(self)

    @property
    def shown_deviation(self) -> float:
        """Standard deviation of what is shown, m: deviation / sqrt(averages), before rounding."""
        return self.deviation / float(np.sqrt(self.averages))

    def position(self, voltage: ArrayLike) -> Array:
        """The position, m, that a voltage stands for."""
        return self.zero + self.scale * check_signal("Micrometer.position(voltage)", voltage)

    def voltage(self, position: ArrayLike) -> Array:
        """The voltage for a position, m, before rounding and limits; inverse of `position`.

        >>> round(float(Micrometer(zero=0.020, scale=2e-3).voltage(0.030)), 9)
        5.0
        """
        return (check_signal("Micrometer.voltage(position)", position) - self.zero) / self.scale


def watch(
    micrometer: Micrometer,
    times: ArrayLike,
    positions: ArrayLike,
    Ts: float,
    generator: np.random.Generator | None = None,
) -> Array:
    """What the sensor shows every Ts seconds of a motion, m: scanned, averaged, late, held in between.

    times (n,): rising, s; positions (n,), m, with a straight line in between; the samples begin at times[0] and end at
    or before times[-1]. generator: a seeded one draws a scan's noise; without it there is none. Before the first mean
    is known the first scan is shown. Rounding and limits of the output are those of `measured_positions`. Raises
    InputError for signals that are not finite or too short, or times that do not rise.

    >>> still = watch(Micrometer(0.020, 2e-3, scan_rate=1000.0, averages=2), [0, 1e-2], [0, 1e-2], Ts=4e-3)
    >>> (1e3 * still).round(3).tolist()
    [0.0, 2.5, 6.5]
    """
    moments, places = _motion(times, positions)
    check_positive("watch", Ts=Ts)
    span, rate = moments[-1] - moments[0], _scan_rate(micrometer)
    scan_times = moments[0] + np.arange(int(np.floor(span * rate + 1e-9)) + 1) / rate
    scans = np.interp(scan_times, moments, places)
    if generator is not None:
        scans = scans + generator.normal(scale=micrometer.deviation, size=scans.size)
    shown = np.empty(int(np.floor(span / Ts + 1e-9)) + 1)
    held_scans(scans, micrometer.averages, micrometer.latency, Ts * rate, shown)
    return shown


def _scan_rate(micrometer: Micrometer) -> float:
    if micrometer.scan_rate is None:
        remedy = "Micrometer(..., scan_rate=1000.0), scans per second"
        raise InputError(Problem("Micrometer(scan_rate)", "must be given to measure in time", "None", remedy))
    return micrometer.scan_rate


def _motion(times: ArrayLike, positions: ArrayLike) -> tuple[Array, Array]:
    moments = np.atleast_1d(check_signal("watch(times)", times))
    places = np.atleast_1d(check_signal("watch(positions)", positions))
    if moments.size < 2 or moments.shape != places.shape or not (np.diff(moments) > 0).all():
        raise InputError(
            Problem(
                "watch(times, positions)",
                "must be two or more rising times and as many positions",
                f"shapes {moments.shape} and {places.shape}",
                "give the motion on a grid of times",
            )
        )
    return moments, places

"""Position sensors: a scanning sensor with an analogue output, and the frame of two crossed sensors in a machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldmap import arguments
from fieldmap.core.instruments import held_scans
from fieldmap.errors import InputError, Problem
from fieldmap.instruments.converter import USUAL_RANGE
from fieldmap.records import Record
from fieldmap.typing import Array


@dataclass(frozen=True)
class Micrometer(Record):
    """A sensor that scans a position, with an analogue output: position = scale voltage + zero.

    zero: position at 0 V, m. scale: m/V. voltage_step: resolution of the analogue output, V (0: no rounding). lower,
    upper: its range, V, by default `USUAL_RANGE`. scan_rate: scans per second, required for `measuring_time` and
    `watch`. averages: number of scans that are averaged. latency: delay of the output after the last scan of an
    average, in scans. deviation: standard deviation of one scan, m, as white Gaussian noise.
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
        arguments.check_numbers("Micrometer", zero=self.zero)
        arguments.check_positive("Micrometer", scale=self.scale)
        if self.scan_rate is not None:
            arguments.check_positive("Micrometer", scan_rate=self.scan_rate)
        arguments.check_not_negative(
            "Micrometer", voltage_step=self.voltage_step, deviation=self.deviation, latency=self.latency
        )
        arguments.check_ordered("Micrometer", self.lower, self.upper)
        arguments.check_count("Micrometer", averages=self.averages, **{"latency + 1": self.latency + 1})

    @property
    def resolution(self) -> float:
        """Position step of one voltage step of the output, m."""
        return self.scale * self.voltage_step

    @property
    def measuring_time(self) -> float:
        """Time for one average, s."""
        return self.averages / _scan_rate(self)

    @property
    def shown_deviation(self) -> float:
        """Standard deviation of the output, m: deviation / sqrt(averages), before rounding."""
        return self.deviation / float(np.sqrt(self.averages))

    def position(self, voltage: ArrayLike) -> Array:
        """The position for a voltage.

        Parameters
        ----------
        voltage
            Voltage, V, of any shape.

        Returns
        -------
        Array
            Position, m.
        """
        return self.zero + self.scale * arguments.check_signal("Micrometer.position(voltage)", voltage)

    def voltage(self, position: ArrayLike) -> Array:
        """The voltage for a position, before rounding and limits; inverse of `position`.

        Parameters
        ----------
        position
            m, of any shape.

        Returns
        -------
        Array
            Voltage, V.

        Examples
        --------
        >>> round(float(Micrometer(zero=0.020, scale=2e-3).voltage(0.030)), 9)
        5.0
        """
        return (arguments.check_signal("Micrometer.voltage(position)", position) - self.zero) / self.scale


def watch(
    micrometer: Micrometer,
    times: ArrayLike,
    positions: ArrayLike,
    Ts: float,
    generator: np.random.Generator | None = None,
) -> Array:
    """Readings of the sensor during a motion: scanned, averaged, delayed, and held in between.

    Before the first average is available, the reading is the first scan. `measured_positions` rounds and limits.

    Parameters
    ----------
    micrometer
        The sensor.
    times
        Times (n,), rising, s; the samples begin at times[0] and end at or before times[-1].
    positions
        Positions (n,), m, with linear interpolation in time.
    Ts
        Sampling time, s.
    generator
        A seeded generator for the noise of the scans; without it there is no noise.

    Returns
    -------
    Array
        Positions at every sample, m.

    Raises
    ------
    InputError
        For signals that are not finite or too short, or times that do not rise.

    Examples
    --------
    >>> still = watch(Micrometer(0.020, 2e-3, scan_rate=1000.0, averages=2), [0, 1e-2], [0, 1e-2], Ts=4e-3)
    >>> (1e3 * still).round(3).tolist()
    [0.0, 2.5, 6.5]
    """
    moments, places = arguments.check_record("watch", 2, times=times, positions=positions)
    arguments.check_positive("watch", Ts=Ts)
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


@dataclass(frozen=True, repr=False)
class SensorFrame(Record):
    """Two sensors in a plane, rotated against the machine's axes, that measure the near edge of a round body.

    angle: of the sensors' axes against the machine's, rad. offset: reading of each sensor on the machine's axis, m.
    radius: of the body, from the measured edge to its centre, m. bias: correction of the machine's x and y for
    tolerances of the mounting, m.

    Local positions are (..., 3): the two readings and, unchanged by the transform, the third coordinate.

    >>> frame = SensorFrame(np.pi / 4, offset=0.026, radius=0.0059)
    >>> frame.to_global([0.0201, 0.0201, 0.010]).round(6).tolist()
    [0.0, 0.0, 0.01]
    """

    angle: float
    offset: float
    radius: float = 0.0
    bias: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        arguments.check_numbers(
            "SensorFrame", angle=self.angle, offset=self.offset, x=self.bias[0], y=self.bias[1]
        )
        arguments.check_not_negative("SensorFrame", radius=self.radius)

    @property
    def matrix(self) -> Array:
        """Homogeneous transform (4, 4) from local to global, without bias."""
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        turn, move = np.eye(4), np.eye(4)
        turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
        move[:2, 3] = self.radius - self.offset
        return turn @ move

    def to_global(self, local: ArrayLike) -> Array:
        """Positions in the machine's frame.

        Parameters
        ----------
        local
            Local positions (..., 3), m.

        Returns
        -------
        Array
            Positions (..., 3), m.

        Raises
        ------
        InputError
            For numbers that are not finite, or another shape.
        """
        points = arguments.check_signal("SensorFrame.to_global(local)", local, columns=3)
        matrix = self.matrix
        return points @ matrix[:3, :3].T + matrix[:3, 3] + [*self.bias, 0.0]

    def to_local(self, position: ArrayLike) -> Array:
        """Readings of the sensors; inverse of `to_global`.

        Parameters
        ----------
        position
            Positions (..., 3) in the machine's frame, m.

        Returns
        -------
        Array
            Local positions (..., 3), m.

        Raises
        ------
        InputError
            For numbers that are not finite, or another shape.
        """
        points = arguments.check_signal("SensorFrame.to_local(position)", position, columns=3)
        matrix = self.matrix
        return (points - [*self.bias, 0.0] - matrix[:3, 3]) @ matrix[:3, :3]

    def global_deviation(self, local_x: float, local_y: float) -> tuple[float, float]:
        """Standard deviations of the machine's x and y from those of two independent readings.

        docs/theory/control.md (11): the diagonal of R diag(local_x^2, local_y^2) R^T. At 45 degrees both are
        the root mean square of the two.

        Parameters
        ----------
        local_x, local_y
            Deviations of the readings, m.

        Returns
        -------
        tuple[float, float]
            Deviations of x and y, m.

        Examples
        --------
        >>> sx, sy = SensorFrame(np.pi / 4, offset=0.026).global_deviation(5.42e-6, 8.38e-6)
        >>> print(f"{1e3 * sx:.5f} {1e3 * sy:.5f} mm")
        0.00706 0.00706 mm
        """
        arguments.check_not_negative("SensorFrame.global_deviation", local_x=local_x, local_y=local_y)
        cosine, sine = np.cos(self.angle), np.sin(self.angle)
        return float(np.hypot(cosine * local_x, sine * local_y)), float(
            np.hypot(sine * local_x, cosine * local_y)
        )

"""The position sensors of a rig, as compiled loops take them."""

from dataclasses import dataclass, field

import numpy as np

from fieldmap.arguments import check_count, check_not_negative, check_numbers
from fieldmap.core.closed_loop import Sensing
from fieldmap.instruments import Rig, SensorFrame
from fieldmap.records import Record
from fieldmap.typing import Array


def _ideal() -> Array:
    return np.array([0.0, 1.0, 0.0, -np.inf, np.inf, 0.0, 0.0, 0.0, -np.inf, np.inf])


@dataclass(frozen=True, eq=False, repr=False)
class Sensors(Record):
    """Two sensors that cross in the horizontal plane and one for the depth; ideal unless more is given.

    frame: of the crossed sensors; without it they read x and y. zero_depth: depth below the map's origin at which the
    third reads 0, m; it reads downward. deviations (3,): noise of
    what each shows, m. rigs: measuring chain of each. voltage_noise: of their input converters, V. scan_rate: 1/s, 0
    for sensors that show what is at each sample; averages, one number for all or one for each, latency: as in
    `Micrometer`. measured_with: averages with which the deviations were measured; those that are set unless given.
    """

    frame: SensorFrame | None = None
    zero_depth: float = 0.0
    deviations: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rigs: tuple[Rig | None, Rig | None, Rig | None] = (None, None, None)
    voltage_noise: float = 0.0
    scan_rate: float = 0.0
    averages: int | tuple[int, int, int] = 1
    latency: int = 0
    measured_with: int | None = None
    assumptions: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        check_numbers("Sensors", zero_depth=self.zero_depth)
        check_not_negative(
            "Sensors",
            scan_rate=self.scan_rate,
            voltage_noise=self.voltage_noise,
            latency=self.latency,
            **{f"deviations[{k}]": value for k, value in enumerate(self.deviations)},
        )
        counts = {f"averages[{k}]": number for k, number in enumerate(self.means)}
        check_count("Sensors", **counts, measured_with=self.measured_with or 1)

    @property
    def means(self) -> tuple[int, int, int]:
        """Averages of each sensor."""
        given = self.averages
        return given if isinstance(given, tuple) else (given, given, given)

    @property
    def numbers(self) -> Sensing:
        """As compiled loops take them."""
        into, shift = np.diag([1.0, 1.0, -1.0]), np.array([0.0, 0.0, -self.zero_depth])
        if self.frame is not None:
            shift[:2] = self.frame.to_local([0.0, 0.0, 0.0])[:2]
            for k in range(2):
                into[:2, k] = (self.frame.to_local(np.eye(3)[k]) - self.frame.to_local(np.zeros(3)))[:2]
        chains = np.array([_ideal() if rig is None else rig.chain for rig in self.rigs])
        period = 1.0 / self.scan_rate if self.scan_rate else 0.0
        scan = np.array([period, float(self.latency), *map(float, self.means)])
        return Sensing(into, shift, chains, np.ascontiguousarray(np.linalg.inv(into)), scan)

    @property
    def scan_deviations(self) -> Array:
        """Noise of one scan (3,), m: white, so that the mean of n has it over the root of n."""
        with_how_many = (self.measured_with,) * 3 if self.measured_with else self.means
        return np.sqrt(with_how_many) * np.asarray(self.deviations)

    def scans(self, duration: float) -> int:
        """How many scans fall into a run."""
        return int(np.floor(duration * self.scan_rate + 1e-9)) + 1 if self.scan_rate else 0

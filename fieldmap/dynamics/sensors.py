"""The position sensors of a rig, as compiled loops take them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from fieldmap.arguments import check_not_negative
from fieldmap.core.closed_loop import Sensing
from fieldmap.dynamics.surroundings import NotNegatives
from fieldmap.inputs.declared import Key, check_fields
from fieldmap.inputs.tables import MILLI, NotNegative, Positive, Table
from fieldmap.instruments import Amplifier, Converter, Micrometer, Rig, SensorFrame
from fieldmap.instruments.converter import USUAL_RANGE
from fieldmap.records import Record
from fieldmap.typing import Array

Count = Annotated[int, Field(ge=1)]
Bits = Annotated[int, Field(ge=1, le=32)]


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
    zero_depth: Annotated[
        float, Key(..., "depth below the map's origin at which the vertical sensor reads 0", "mm")
    ] = 0.0
    deviations: Annotated[
        tuple[float, float, float],
        Key(NotNegatives, "noise of the two crossed sensors and the vertical one", "mm", name="deviation"),
    ] = (0.0, 0.0, 0.0)
    rigs: tuple[Rig | None, Rig | None, Rig | None] = (None, None, None)
    voltage_noise: float = 0.0
    scan_rate: Annotated[NotNegative, Key(..., "rate of scans; 0: shows what is at each sample", "Hz")] = 0.0
    averages: Annotated[
        int | tuple[int, int, int],
        Key(
            Count | Annotated[list[Count], Field(min_length=3, max_length=3)],
            "scans whose mean is shown; one number, or one for each sensor",
        ),
    ] = 1
    latency: Annotated[
        Annotated[int, Field(ge=0)], Key(..., "scans by which a mean comes late", name="latency_scans")
    ] = 0
    measured_with: Annotated[
        Count | None,
        Key(
            ...,
            "averages with which deviation_mm was measured; `averages` unless given",
            name="deviation_averages",
        ),
    ] = None
    assumptions: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        check_fields(self)
        check_not_negative("Sensors", voltage_noise=self.voltage_noise)

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
        """How many scans fall into a run.

        Parameters
        ----------
        duration
            Of the run, s.

        Returns
        -------
        int
            The number.
        """
        return int(np.floor(duration * self.scan_rate + 1e-9)) + 1 if self.scan_rate else 0


class ChainKeys(Table):
    """Keys of the sensors' measuring chain, whose frame, rigs and noise of the converters these make."""

    angle_deg: float = Field(default=0.0, description="of the crossed sensors against x and y")
    step_mm: NotNegative = Field(default=0.0, description="resolution of the sensors")
    input_bits: Bits | None = Field(default=None, description="of the input converter")
    input_range_V: Positive = Field(
        default=USUAL_RANGE, description="of the input converter, to both sides; assumed unless given"
    )
    mm_per_V: Positive = Field(
        default=2.0, description="of the sensors' outputs, for input_bits; assumed unless given"
    )
    input_noise_V: NotNegative = Field(default=0.0, description="of the input converter")

    def also_makes(self) -> Mapping[str, Any]:
        """Fields of `Sensors`."""
        frame = SensorFrame(np.deg2rad(self.angle_deg), offset=0.0) if self.angle_deg else None
        rig = None
        if self.input_bits is not None or self.step_mm:
            converter = Converter(self.input_range_V, self.input_bits or 48, self.input_noise_V)
            step, scale = self.step_mm / self.mm_per_V, MILLI * self.mm_per_V
            micrometer = Micrometer(0.0, scale, voltage_step=step, lower=-1e3, upper=1e3)
            rig = Rig(micrometer, converter, converter, Amplifier(1.0))
        return {"frame": frame, "rigs": (rig, rig, rig), "voltage_noise": self.input_noise_V}

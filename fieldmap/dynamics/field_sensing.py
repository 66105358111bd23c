"""Field sensors in a closed loop, instead of position sensors: docs/field_sensors.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldmap.core.closed_loop import Sensing
from fieldmap.core.field_sensors import FieldSensing
from fieldmap.dynamics.machine import Sensors
from fieldmap.instruments import CalibrationCurve, FieldElement
from fieldmap.lookup import MapSensors
from fieldmap.typing import Array


@dataclass(frozen=True, eq=False, repr=False)
class FieldSensors(Sensors):
    """Field sensors as the sensors of a controller.

    The sensors read the field of coils, iron, magnets and background. reads: the sensors in the fields of the
    machine's `FieldOfCurrents`. elements: the electronics of each sensor (s,), with equal latencies.
    current_deviation: noise of the measured currents, A. curve: gives the height of the sensed point; None: there is
    no estimator, and a controller function gets the readings (s,), T, and currents (n,), A. beside (2,): with a
    curve, the assumed x and y of the sensed point, m.

    deviations, scan_rate and latency describe a position sensor with the same delay and noise of the height, for the
    design of controllers and for linear models.
    """

    reads: MapSensors | None = None
    elements: tuple[FieldElement, ...] = ()
    coils: int = 0
    current_deviation: float = 0.0
    curve: CalibrationCurve | None = None
    beside: Any = (np.nan, np.nan)

    @property
    def numbers(self) -> Sensing:
        """The numbers for compiled loops, with a new history."""
        assert self.reads is not None
        late, count = self.elements[0].latency, len(self.elements)
        sensing = FieldSensing(
            self.reads.core,
            np.array([one.chain for one in self.elements]),
            late,
            np.zeros((late + 1, count + self.coils)),
            None if self.curve is None else self.curve.core,
            0 if self.curve is None else self.reads.names.index(self.curve.sensor),
            np.array(self.beside, dtype=np.float64),
        )
        ideal = super().numbers
        return ideal._replace(scan=np.append(0.0, ideal.scan[1:]), field=sensing)

    @property
    def field_deviations(self) -> Array:
        """Noise (2 s + n,) of the elements, T, of their converters, V, and of the measured currents, A."""
        converters = [0.0 if one.converter is None else one.converter.random_noise for one in self.elements]
        elements = [one.deviation for one in self.elements]
        return np.array([*elements, *converters, *[self.current_deviation] * self.coils])

    def scans(self, duration: float) -> int:
        """Number of scans: none, because the sensors are read at each sample.

        Parameters
        ----------
        duration
            Duration of the run, s.

        Returns
        -------
        int
            0.
        """
        return 0

"""Field sensors of a scenario: their electronics, and the estimator in front of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from fieldmap.core.machine import rotation
from fieldmap.dynamics.field_sensing import FieldSensors
from fieldmap.dynamics.machine import Bits, Machine
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.errors import InputError, ScenarioError
from fieldmap.inputs.declared import Key
from fieldmap.inputs.document import AtKey
from fieldmap.inputs.tables import Name, NotNegative, Number, Positive
from fieldmap.instruments import CalibrationCurve, Converter, FieldElement, calibrate
from fieldmap.instruments.converter import USUAL_RANGE
from fieldmap.lookup import FieldMap
from fieldmap.records import Record

_EACH = Number | list[Number]
# Scans per control period of an equivalent position sensor, a large number so that its delay is the latency alone.
_SCANS = 1000


@dataclass(frozen=True, repr=False)
class FieldSensorSettings(Record):
    """The controller uses the field sensors of the device instead of position sensors."""

    sensitivity: Annotated[Positive, Key(..., "of the elements", "V_per_T")]
    estimator: Annotated[
        Literal["calibration_curve", "none"],
        Key(
            ...,
            "calibration_curve: the height from one sensor, less the share of the currents; x and y are taken to be "
            "those of the start; none: a controller of kind own gets all readings and the currents",
        ),
    ] = "calibration_curve"
    sensor: Annotated[Name | None, Key(..., "that the curve reads; the only one unless given")] = None
    nodes: Annotated[Annotated[int, Field(ge=2, le=10_000)], Key(..., "points of the curve")] = 33
    range: Annotated[
        Positive | None,
        Key(..., "largest flux density of an element, to both sides; no limit unless given", "mT"),
    ] = None
    deviation: Annotated[NotNegative, Key(..., "noise of an element", "mT")] = 0.0
    offset: Annotated[
        float | tuple[float, ...],
        Key(_EACH, "what readings are wrong by; one number, or one for each sensor", "mT"),
    ] = 0.0
    gain_error: Annotated[
        float | tuple[float, ...],
        Key(_EACH, "relative error of the gain; one number, or one for each sensor"),
    ] = 0.0
    input_bits: Annotated[Bits | None, Key(..., "of the input converters; no steps unless given")] = None
    input_range: Annotated[
        Positive, Key(..., "of the input converters, to both sides; assumed unless given", "V")
    ] = USUAL_RANGE
    input_noise: Annotated[NotNegative, Key(..., "of the input converters", "V")] = 0.0
    latency: Annotated[
        Annotated[int, Field(ge=0, le=1000)],
        Key(
            ...,
            "samples by which readings come late, with the currents of that moment",
            name="latency_samples",
        ),
    ] = 0
    current_deviation: Annotated[
        NotNegative, Key(..., "noise of the measured currents, whose share is taken off", "A")
    ] = 0.0

    def sensors(
        self, machine: Machine, opened: FieldMap, point: OperatingPoint, period: float
    ) -> FieldSensors:
        """The sensors of a machine that begins at an operating point. Raises ScenarioError.

        Parameters
        ----------
        machine
            The machine with position sensors; their zero of the depth is kept.
        opened
            Its map.
        point
            Operating point at the start.
        period
            Control period, s.
        """
        reads = machine.magnetic.sensors
        if reads is None:
            must, remedy = (
                "needs a map with field sensors",
                "give the device [[sensor]] tables and make its map",
            )
            raise ScenarioError(AtKey("field_sensors", must, "a map without", remedy))
        elements = self._elements(len(reads.names))
        curve = None if self.estimator == "none" else self._curve(machine, opened, point)
        deviation, beside = 0.0, (np.nan, np.nan)
        if curve is not None:
            noise = elements[reads.names.index(curve.sensor)].whole_deviation
            deviation = noise * abs(curve.slope_at(float(point.sensed[2])))
            beside = float(point.sensed[0]), float(point.sensed[1])
        by = "no estimator" if curve is None else f"the height by the calibration curve of {curve.sensor}"
        return FieldSensors(
            zero_depth=machine.sensors.zero_depth,
            deviations=(0.0, 0.0, deviation),
            scan_rate=_SCANS / period if self.latency else 0.0,
            latency=_SCANS * self.latency,
            assumptions=(f"field sensors {', '.join(reads.names)}; {by}",),
            reads=reads,
            elements=elements,
            coils=machine.drive.coils,
            current_deviation=self.current_deviation,
            curve=curve,
            beside=beside,
        )

    def _elements(self, count: int) -> tuple[FieldElement, ...]:
        each = {}
        for name, key in (("offset", "offset_mT"), ("gain_error", "gain_error")):
            given = np.ravel(getattr(self, name))
            if given.size not in (1, count):
                must, remedy = f"one number or one for each of {count} sensors", "correct the list"
                raise ScenarioError(AtKey(f"field_sensors.{key}", must, f"{given.size} numbers", remedy))
            each[name] = np.broadcast_to(given, count).tolist()
        converter = None
        if self.input_bits is not None or self.input_noise:
            converter = Converter(self.input_range, self.input_bits or 48, self.input_noise)
        numbers = self.sensitivity, np.inf if self.range is None else self.range, self.deviation
        return tuple(
            FieldElement(*numbers, offset, error, converter, self.latency)
            for offset, error in zip(each["offset"], each["gain_error"], strict=True)
        )

    def _curve(self, machine: Machine, opened: FieldMap, point: OperatingPoint) -> CalibrationCurve:
        body, turn = machine.body, rotation(point.state)
        arm = turn @ (body.seen_at - body.magnet_at)
        try:
            return calibrate(
                opened,
                body.magnet,
                self.sensor,
                beside=(point.sensed - arm)[:2],
                orientation=turn,
                above=float(arm[2]),
                nodes=self.nodes,
                currents=point.currents,
                scale=machine.magnetic.scale,
            )
        except InputError as error:
            (problem,) = error.problems
            where = "field_sensors.sensor" if "sensor" in problem.where else "field_sensors.estimator"
            raise ScenarioError(AtKey(where, problem.must_hold, problem.received, problem.remedy)) from None

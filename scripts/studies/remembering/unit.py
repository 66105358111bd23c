"""The jointed unit: its map, the factor of its force, and runs of the shipped scenarios on it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldmap.device import Device, read_device
from fieldmap.dynamics.scenario import ScenarioRun, read_scenario, simulate
from fieldmap.levitation import GRAVITY
from fieldmap.lookup import FieldMap, interpolate
from fieldmap.records import Record
from fieldmap.store import read_map
from fieldmap.thesis.hysteresis import Protocol
from fieldmap.thesis.printed import read_part
from fieldmap.typing import Array

DEVICE, H = "drive_unit_joints", "payload.magnet_offset_mm"
DEVIATION_MM = np.array([0.00542, 0.00838, 0.0104])
"""Standard deviations of the sensors: Table 3-8."""
SCENARIO_H_MM = 15.0
"""Value of h for which the faces of the blocks in the scenarios were chosen."""


@dataclass(frozen=True, eq=False, repr=False)
class Unit(Record):
    """The unit with the choices that the thesis leaves open and the study varies.

    derivative: of the "error" or the "measurement", in all PID controllers. noise: factor of the noise of Table 3-8.
    """

    field: FieldMap
    device: Device
    derivative: str = "measurement"
    noise: float = 1.0

    @property
    def protocol(self) -> Protocol:
        """Protocol for 10 mm depth and the currents of (7-18)."""
        assert self.device.payload is not None
        return Protocol("x", h=1e3 * self.device.payload.magnet_offset)

    @property
    def scale(self) -> float:
        """Factor of the force with which the current of (7-18) carries the body at 10 mm."""
        payload, protocol = self.device.payload, self.protocol
        assert payload is not None
        field, currents = begun(self.field, protocol), np.full(6, protocol.level)
        lift = pull(field, np.array([0.0, 0.0, protocol.height]), currents)[2]
        return payload.mass * GRAVITY / (payload.moment * lift)

    def simulate(self, scenario: str, changes: Mapping[str, Any], *, field_map: FieldMap) -> ScenarioRun:
        """Run a shipped scenario, with its block at the same distance below the body as in the file."""
        contents, given = read_scenario(scenario, changes).contents, dict(changes)
        given |= {"field.scale": self.scale, "sensors.deviation_mm": (self.noise * DEVIATION_MM).tolist()}
        for axis in "xyz":
            if getattr(contents.control, axis).kind == "pid":
                given[f"control.{axis}.c"] = float(self.derivative == "error")
        if contents.plate is not None:
            x, y, z = contents.plate.face_mm
            given["plate.face_mm"] = [x, y, z + SCENARIO_H_MM - self.protocol.h]
        return simulate(scenario, given, field_map=field_map, device=self.device)

    def inputs(self, part: str) -> dict[str, Any]:
        """Inputs of a part of the comparison with the thesis, for this unit."""
        return {**read_part(part).inputs, "map": self.field, "simulate": self.simulate}


def unit(path: str, coercive: float = 1.0, h_mm: float | None = None) -> Unit:
    """The unit on a map, with its coercive field multiplied by a factor (0: no memory), and another h if given."""
    data = read_map(path)
    model = data.reduced_model
    assert model is not None
    changed = replace(model, pinning=coercive * model.pinning)
    if coercive == 0.0:
        changed = replace(model, pinning=np.zeros((0, 0)), shares=np.zeros(0))
    opened = interpolate(replace(data, reduced_model=changed), outside_currents="evaluate")
    return Unit(opened, read_device(DEVICE, {} if h_mm is None else {H: h_mm}))


def begun(field: FieldMap, protocol: Protocol) -> FieldMap:
    """The field after the history "shaken", if it has memory."""
    return field.memory("shaken", protocol.level) if field.remembers else field


def pull(field: FieldMap, point: Array, currents: Array) -> Array:
    """Force on an upright moment of 1 A m^2."""
    return np.asarray(field.gradient(point, currents)[2])

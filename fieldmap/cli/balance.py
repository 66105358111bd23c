"""What `fieldmap equilibrium` answers: where the payload floats, or the current that lifts it."""

import sys
from typing import Any

from fieldmap.cli.lift import lift_in_map
from fieldmap.cli.measured import is_measured_machine, measured_lift_current
from fieldmap.cli.opening import Source
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, Problem
from fieldmap.field import BaseField, Bounds, Field, as_field
from fieldmap.levitation import GRAVITY, find_equilibrium, lift_current
from fieldmap.levitation.balance import check_position
from fieldmap.thesis.vertical_sensor import sensor_reading
from fieldmap.typing import Array


def floating(
    source: Source, currents: Array, payload: Payload, start: Array | None, moment: str
) -> dict[str, Any]:
    """The equilibrium at given currents."""
    if start is not None:
        check_position(_box(source), start, "--start")
    if moment not in ("fixed", "aligned"):
        raise InputError(Problem("--moment", "must be fixed or aligned", moment, "choose one"))
    field, assumptions = source.open(currents)
    found = find_equilibrium(searchable(source, field), currents, payload, start, moment)  # type: ignore[arg-type]
    return _common(source, payload, found, assumptions) | {
        "eigenvalues": found.eigenvalues,
        "directions": found.directions.T,
        "stable": found.stable,
        "trace": found.trace,
        "stable_axes": found.stable_axes,
        "moment": found.moment,
        "angle_to_field_deg": found.angle_to_field,
        "others": found.others,
        "force_residual": found.force_residual,
        "report": found.report,
    }


def lifted(source: Source, payload: Payload, height: float) -> dict[str, Any]:
    """The common current that carries the payload with its magnet at this height (m) on the axis."""
    point = check_position(_box(source), [0.0, 0.0, height], "the magnet's centre")
    if source.states is None:
        field, assumptions = source.open(None)
        lift = (
            lift_in_map(field, payload, point)
            if source.kind == "map"
            else lift_current(searchable(source, field), payload, point)
        )
        assumptions = (*assumptions, *source.warnings(field, lift.currents))
    else:
        lift, assumptions = _lift_by_states(source, payload, point)
    answer = _common(source, payload, lift, assumptions)
    measured = measured_lift_current(source.device_name, len(source.coil_names), answer["sensor_mm"])
    return answer | {
        "lift_current": lift.current,
        "current_limit": None if source.driver is None else source.driver.current_limit,
        "force": lift.force,
        "force_per_ampere": lift.force_per_ampere,
        "states": [{"current": current, "lift": newtons} for current, newtons in lift.history],
        "thesis": measured,
        "ratio": None if measured is None else lift.current / measured,
    }


def _lift_by_states(source: Source, payload: Payload, point: Array) -> tuple[Any, tuple[str, ...]]:
    field = _States(source)
    lift = lift_current(field, payload, point, on_state=_tell_state)
    return lift, field.notes


class _States(BaseField):
    """The field of a device whose iron is solved for each set of currents; notes: of the last state."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self.notes: tuple[str, ...] = ()

    @property
    def coil_names(self) -> tuple[str, ...]:
        return self._source.coil_names

    @property
    def bounds(self) -> Bounds:
        return _box(self._source)

    def field(self, points: Any, currents: Any) -> Array:
        return self._solved(currents).field(points, currents)

    def gradient(self, points: Any, currents: Any) -> Array:
        return self._solved(currents).gradient(points, currents)

    def _solved(self, currents: Array) -> Field:
        field, self.notes = self._source.open(currents)
        return field


def _tell_state(current: float, share: float) -> None:
    print(f"{current:.4f} A per coil lifts {100 * share:.2f} % of the weight", file=sys.stderr)


def _box(source: Source) -> Bounds:
    """The box in which an equilibrium may be looked for, known before anything is solved."""
    if source.corners is None:
        remedy = "add a [workspace] table to the device file"
        raise InputError(Problem(source.name, "must have a [workspace] to search", "none", remedy))
    return source.corners


def searchable(source: Source, field: Any) -> Any:
    """A map as it is; a solution with second gradients by differences, inside the workspace's box."""
    return field if source.kind == "map" else as_field(field, _box(source))


def _common(source: Source, payload: Payload, found: Any, assumptions: tuple[str, ...]) -> dict[str, Any]:
    return {
        "source": source.name,
        "kind": source.kind,
        "coil_names": source.coil_names,
        "position": found.position,
        "sensor_mm": sensor_reading(found.position[2], payload.magnet_offset),
        "has_sensor": payload.magnet_offset != 0
        or is_measured_machine(source.device_name, len(source.coil_names)),
        "currents": found.currents,
        "mass": payload.mass,
        "weight": payload.mass * GRAVITY,
        "moment_magnitude": payload.moment,
        "magnet_offset": payload.magnet_offset,
        "field": found.field,
        "stiffness": found.stiffness,
        "assumptions": (*found.assumptions, *assumptions),
    }

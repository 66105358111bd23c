"""What a map file holds: device, grid, field in the middle, accuracy, and the current that lifts its payload."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.currents import CurrentDomain
from fieldmap.device import recorded_device
from fieldmap.device.measured import MeasuredMachine, measured_on
from fieldmap.device.model import Device, Payload
from fieldmap.errors import Infeasible, OutsideMapError
from fieldmap.io.field_source import existing_map
from fieldmap.levitation import lift_current
from fieldmap.lookup import FieldMap, open_map
from fieldmap.plain import Plain, plain_items
from fieldmap.store import MapInfo
from fieldmap.typing import Array

NO_SATURATION = (
    'This map is linear: no saturation. A recipe with iron.model = "saturating" makes a map over currents with '
    "saturation (docs/recipes.md)."
)
_HEIGHTS = 6
"""Of a box, ends included, at whose inner ones the lift current is stated where there is no sensor."""


@dataclass(frozen=True, eq=False)
class MiddleField:
    """Bz, T, and dBz/dz, T/m, in the middle of the box (3,), m: for 1 A in each coil alone and in all, or at the
    reference currents of a map of saturating iron."""

    at: Array
    Bz: tuple[float, ...]
    dBz_dz: tuple[float, ...]


@dataclass(frozen=True)
class LiftAtHeight:
    """The current in each coil, A, that lifts the payload with its magnet at z = height, m, on the axis.

    current: None where it lies beyond the map. sensor_mm: reading of the machine's sensor, and measured: the current
    that was measured there; None where nothing was measured.
    """

    height: float
    current: float | None
    sensor_mm: float | None = None
    measured: float | None = None

    @property
    def ratio(self) -> float | None:
        """Ours over the measured one."""
        return None if self.measured is None or self.current is None else self.current / self.measured

    def to_dict(self) -> dict[str, Plain]:
        """The row as plain Python. The measured current stands under "thesis", as in earlier versions."""
        return plain_items(
            sensor_mm=self.sensor_mm,
            height=self.height,
            current=self.current,
            thesis=self.measured,
            ratio=self.ratio,
        )


@dataclass(frozen=True, eq=False)
class MapSummary:
    """What `fieldmap info` prints. size: of the file, bytes; lift_source: where measured lift currents are printed."""

    path: Path
    size: int
    info: MapInfo
    device: Device | None
    middle: MiddleField
    lift: tuple[LiftAtHeight, ...]
    lift_source: str

    @property
    def payload(self) -> Payload | None:
        """The payload of the recorded device."""
        return None if self.device is None else self.device.payload

    @property
    def domain(self) -> CurrentDomain | None:
        """The currents that a map of saturating iron is for; None for a map that holds for any."""
        return None if self.info.reduced_model is None else self.info.reduced_model.domain

    @property
    def saturation(self) -> str:
        """That a linear map knows no saturation, where its iron has some; otherwise empty."""
        return NO_SATURATION if self.domain is None and _saturates(self.info.provenance.device_text) else ""

    def signal_ranges(self) -> dict[str, tuple[float, float]]:
        """Range of each signal of `domain`; of independent currents by the names of the coils."""
        if self.domain is None:
            return {}
        names = signal_names(self.domain, self.info.coil_names)
        return dict(
            zip(names, zip(self.domain.lower.tolist(), self.domain.upper.tolist(), strict=True), strict=True)
        )

    def to_dict(self) -> dict[str, Plain]:
        """The summary as plain Python, SI units but for `sensor_mm`."""
        info, record, grid = self.info, self.info.provenance, self.info.grid
        return plain_items(
            path=str(self.path),
            size=self.size,
            title=record.title,
            device=record.device_name,
            created=record.created,
            coil_names=info.coil_names,
            solver=record.solver_report,
            grid={"lower": grid.lower, "upper": grid.upper, "spacing": grid.spacing, "shape": grid.shape},
            reference_current=info.reference_current,
            interpolation_error=info.interpolation_error,
            error_bounds=info.error_bounds,
            current_error=info.current_error,
            current_domain=self._domain_items(),
            middle=self.middle,
            assumptions=record.assumptions,
            payload=self.payload,
            lift=[row.to_dict() for row in self.lift],
            saturation=self.saturation,
        )

    def _domain_items(self) -> dict[str, object] | None:
        if self.domain is None:
            return None
        parametrisation = self.domain.parametrisation
        return {
            "division_exponent": parametrisation.parameters.get("n"),
            "ranges": self.signal_ranges(),
            "parametrisation": parametrisation.name,
        }


def signal_names(domain: CurrentDomain, coil_names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the signals of a domain; of independent currents those of the coils."""
    names = domain.parametrisation.signal_names
    return tuple(coil_names) if domain.parametrisation.name == "independent" else names


def summarise_map(path: str | PathLike[str]) -> MapSummary:
    """What a map file holds. Raises MapFileError as `open_map`."""
    place = existing_map(path)
    opened = open_map(place)
    record = opened.info.provenance
    device = recorded_device(record.device_text) if record.device_text else None
    machine = measured_on(record.device_name, len(opened.coil_names))
    payload = None if device is None else device.payload
    return MapSummary(
        path=place,
        size=place.stat().st_size,
        info=opened.info,
        device=device,
        middle=middle_field(opened),
        lift=() if payload is None else lift_by_height(opened, payload, machine),
        lift_source="" if machine is None else machine.lift_source,
    )


def middle_field(opened: FieldMap) -> MiddleField:
    """The field in the middle of a map's box."""
    centre = 0.5 * (np.asarray(opened.lower) + np.asarray(opened.upper))
    alone = np.eye(len(opened.coil_names))
    saturating = opened.info.reduced_model is not None
    currents = [opened.info.reference_current] if saturating else [*alone, alone.sum(axis=0)]
    return MiddleField(
        centre,
        tuple(float(opened.field(centre[None, :], i)[0, 2]) for i in currents),
        tuple(float(opened.gradient(centre[None, :], i)[0, 2, 2]) for i in currents),
    )


def lift_by_height(
    opened: FieldMap, payload: Payload, machine: MeasuredMachine | None = None
) -> tuple[LiftAtHeight, ...]:
    """The lift current on the axis at several heights inside the map.

    The heights are those of the stated readings of a measured machine, beside what was measured; otherwise they divide
    the box. Heights where the field does not lift are left out.
    """
    first = float(np.mean(opened.info.reference_current))
    rows = []
    for reading, height in _heights(opened, payload.magnet_offset, machine):
        try:
            current: float | None = lift_current(opened, payload, [0.0, 0.0, height], first=first).current
        except Infeasible:
            continue
        except OutsideMapError:
            current = None
        measured = None if machine is None or reading is None else machine.lift_current(reading)
        rows.append(LiftAtHeight(height, current, reading, measured))
    return tuple(rows)


def _heights(
    opened: FieldMap, offset: float, machine: MeasuredMachine | None
) -> Iterator[tuple[float | None, float]]:
    """Sensor readings, mm, and heights, m, inside the box."""
    low, high = float(opened.lower[2]), float(opened.upper[2])
    if not (opened.lower[0] <= 0.0 <= opened.upper[0] and opened.lower[1] <= 0.0 <= opened.upper[1]):
        return
    if machine is None:
        yield from ((None, float(height)) for height in np.linspace(high, low, _HEIGHTS)[1:-1])
        return
    for reading in machine.readings_mm:
        height = machine.height(reading, offset)
        if low <= height <= high:
            yield reading, height


def _saturates(text: str) -> bool:
    """Whether a device file, as recorded, has a material that saturates."""
    import tomllib

    from fieldmap.device.materials import keys_of_table

    tables: Mapping[str, Mapping[str, Any]] = tomllib.loads(text).get("material", {}) if text else {}
    found = (keys_of_table(table) for table in tables.values())
    return any(keys is not None and keys.material.saturates for keys in found)

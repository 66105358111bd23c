"""What a map holds, in some twenty lines: `fieldmap map --summary` and `fieldmap info`."""

from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.cli.lift import lift_in_map
from fieldmap.cli.measured import is_measured_machine, measured_lift_current
from fieldmap.currents import IndependentCurrents, LiftAndDirections
from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, OutsideMapError
from fieldmap.levitation import GRAVITY
from fieldmap.thesis.vertical_sensor import magnet_height

SENSOR_READINGS_MM = (10.0, 20.0, 30.0, 40.0)
SATURATION = (
    'This map is linear: no saturation. A recipe with iron.model = "saturating" makes a map over currents with '
    "saturation (docs/recipes.md)."
)


def print_summary(path: Path, json: bool) -> None:
    """Open a map and print what it holds."""
    from fieldmap.lookup import open_map

    summary = summarise(path, open_map(path))
    if json:
        from fieldmap.cli.printing import print_json

        print_json(summary)
    else:
        from fieldmap.cli.summary_text import print_text

        print_text(summary)


def summarise(path: Path, opened: Any) -> dict[str, Any]:
    """The numbers of the summary: SI units, and millimetres where the name says so."""
    from fieldmap.cli.opening import recorded_payload

    info = opened.info
    record = info.provenance
    payload = recorded_payload(record.device_text)
    return {
        "path": str(path),
        "size": path.stat().st_size,
        "title": record.title,
        "device": record.device_name,
        "created": record.created,
        "coil_names": opened.coil_names,
        "solver": dict(record.solver_report),
        "grid": {
            "lower": info.grid.lower,
            "upper": info.grid.upper,
            "spacing": info.grid.spacing,
            "shape": info.grid.shape,
        },
        "reference_current": info.reference_current,
        "interpolation_error": info.interpolation_error,
        "error_bounds": info.error_bounds,
        "current_error": info.current_error,
        "current_domain": _domain(info),
        "middle": middle(opened),
        "assumptions": tuple(record.assumptions),
        "payload": payload,
        "lift": lift_rows(opened, payload, record.device_name),
        "saturation": SATURATION if info.reduced_model is None and _saturates(record.device_text) else "",
    }


def _domain(info: Any) -> dict[str, Any] | None:
    """The currents that a map of saturating iron is for."""
    model = info.reduced_model
    if model is None:
        return None
    of = model.parametrisation
    names = info.coil_names if isinstance(of, IndependentCurrents) else of.signal_names
    ranges = zip(names, model.lower.tolist(), model.upper.tolist(), strict=True)
    return {
        "division_exponent": of.n if isinstance(of, LiftAndDirections) else None,
        "ranges": {name: (low, high) for name, low, high in ranges},
    }


def middle(opened: Any) -> dict[str, Any]:
    """Bz (T) and dBz/dz (T/m) in the middle of the box for 1 A in each coil alone, and in all; of saturating iron,
    at the reference currents."""
    centre = 0.5 * (np.asarray(opened.lower) + np.asarray(opened.upper))
    alone = np.eye(len(opened.coil_names))
    saturating = opened.info.reduced_model is not None
    currents = [opened.info.reference_current] if saturating else [*alone, alone.sum(axis=0)]
    return {
        "at": centre,
        "Bz": [float(opened.field(centre[None, :], i)[0, 2]) for i in currents],
        "dBz_dz": [float(opened.gradient(centre[None, :], i)[0, 2, 2]) for i in currents],
    }


def lift_rows(opened: Any, payload: Payload | None, device: str) -> list[dict[str, Any]]:
    """Lift current per coil on the axis, beside the thesis's measured (7-18) for the drive unit it was
    measured on."""
    if payload is None:
        return []
    coils = len(opened.coil_names)
    thesis = is_measured_machine(device, coils)
    rows = []
    for reading, height in _heights(opened, payload.magnet_offset, thesis):
        try:
            current = lift_in_map(opened, payload, [0.0, 0.0, height]).current
        except Infeasible:
            continue
        except OutsideMapError:
            current = None
        measured = measured_lift_current(device, coils, reading)
        rows.append(
            {
                "sensor_mm": reading if thesis else None,
                "height": height,
                "current": current,
                "thesis": measured,
                "ratio": None if measured is None or current is None else current / measured,
            }
        )
    return rows


def _heights(opened: Any, offset: float, thesis: bool) -> list[tuple[float, float]]:
    """Sensor readings (mm) and heights (m) inside the box; without the thesis's sensor, four heights of the
    box."""
    low, high = float(opened.lower[2]), float(opened.upper[2])
    if not (opened.lower[0] <= 0.0 <= opened.upper[0] and opened.lower[1] <= 0.0 <= opened.upper[1]):
        return []
    if thesis:
        pairs = [(reading, magnet_height(reading, offset)) for reading in SENSOR_READINGS_MM]
        return [(reading, height) for reading, height in pairs if low <= height <= high]
    return [(0.0, float(height)) for height in np.linspace(high, low, 6)[1:-1]]


def weight(payload: Payload) -> float:
    """Weight, N."""
    return payload.mass * GRAVITY


def _saturates(text: str) -> bool:
    import tomllib

    from fieldmap.device.materials import keys_of_table

    materials = tomllib.loads(text).get("material", {}) if text else {}
    laws = [keys_of_table(table) for table in materials.values()]
    return any(law.material.saturates for law in laws if law is not None)

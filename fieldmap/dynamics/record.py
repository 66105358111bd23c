"""A run as named arrays: for files and tables."""

import numpy as np

from fieldmap.dynamics.outcome import LoopRun
from fieldmap.store import RunRecord


def recorded(run: LoopRun, coil_names: tuple[str, ...], about: dict[str, object] | None = None) -> RunRecord:
    """All signals of a run with units and columns; how it ended, its state at that moment, and what it assumes."""
    coils = ", ".join(coil_names)
    arrays = {
        "time": (run.time, "s", "time"),
        "position": (run.position, "m", "x, y, z of the centre of mass"),
        "velocity": (run.velocity, "m/s", "x, y, z"),
        "quaternion": (run.quaternion, "1", "w, x, y, z, body to map"),
        "spin": (run.spin, "rad/s", "about the body's axes"),
        "sensed": (run.sensed, "m", "x, y, z of the sensed point, as it is"),
        "seen": (run.seen, "m", "x, y, z of the sensed point, as the controller sees it"),
        "reference": (run.references, "m", "x, y, z of the sensed point"),
        "currents": (run.currents, "A", coils),
        "commanded": (run.commanded, "A", coils),
        "outputs": (run.outputs, "N", "x, y, z of the force that is asked for")
        if run.forces
        else (run.outputs, "V, 1, 1", "lift, x signal, y signal"),
    }
    event = run.event
    ended: dict[str, object] = {"event": "", "end_s": float(run.time[-1]) if len(run.time) else 0.0}
    if event is not None:
        ended = {
            "event": event.name,
            "about_event": event.about,
            "end_s": event.time,
            "state": [value if np.isfinite(value) else None for value in event.state.tolist()],
            "currents": [value if np.isfinite(value) else None for value in event.currents.tolist()],
        }
    words = {"touched": list(run.touched), "assumptions": list(run.assumptions)}
    return RunRecord(arrays, {**ended, **words, **(about or {})})


def as_csv(record: RunRecord) -> str:
    """The signals of a run as CSV text: one row per sample, names with units in the first line."""
    names, columns = [], []
    for name, (values, unit, about) in record.arrays.items():
        wide = values.reshape(len(values), -1)
        parts = [part.strip() for part in about.split(",")]
        units = [part.strip() for part in unit.split(",")]
        for k in range(wide.shape[1]):
            label = (
                name if wide.shape[1] == 1 else f"{name} {parts[k].split(' ')[0] if k < len(parts) else k}"
            )
            names.append(f"{label} ({units[min(k, len(units) - 1)]})")
            columns.append(wide[:, k])
    rows = np.column_stack(columns)
    lines = [",".join(names), *(",".join(f"{value:.9g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"

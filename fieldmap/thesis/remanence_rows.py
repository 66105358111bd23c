"""S14: the two branches of Tables 6-4 and 6-6 with iron that remembers, at coercive fields that are named."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.iron.solvers.hysteresis import HysteresisSolver, Pinning
from fieldmap.maps.generation import OUTPUT_FOLDER
from fieldmap.provenance import fingerprint
from fieldmap.store import KeptState, StateArchive
from fieldmap.thesis.registry import Answers, Ours
from fieldmap.thesis.remanence import Axis, Protocol, prepared, walk
from fieldmap.thesis.shift_tables import curve
from fieldmap.thesis.shifts import COMMON, RULES
from fieldmap.thesis.unit_states import DEVICE, ROOMS
from fieldmap.typing import Array

REFINEMENT = 0.5
"""Mesh sizes of the device file are divided by this: positions within 8 %, a run in a minute or two."""
_FILE = "thesis_remanence.h5"


def x_remanence(inputs: dict[str, Any]) -> Answers:
    """Table 6-4, along x."""
    return _branches(inputs, "x", "Table 6-4")


def y_remanence(inputs: dict[str, Any]) -> Answers:
    """Table 6-6, along y."""
    return _branches(inputs, "y", "Table 6-6")


def _branches(inputs: dict[str, Any], axis: Axis, table: str) -> Answers:
    """Back less out, a row for each coercive field; places from where the run began."""
    signals, measured = inputs["signals"], (inputs["outward_mm"], inputs["back_mm"])
    zero, count = measured[0][0], len(inputs["signals"])
    drawn = [
        Series(f"measured, {words}", signals, places, "measured", points=True)
        for words, places in zip(("outward", "on the way back"), measured, strict=True)
    ]
    widths = []
    for coercive in inputs["coercive_A_per_m"]:
        pinning = Pinning(float(coercive), int(inputs["cells"]))
        shift = 1e3 * kept_shift(pinning, Protocol(axis, z_s=inputs["z_mm"], h=inputs["h_mm"]), signals)
        out, back = shift[:count], shift[count - 1 :][::-1]
        widths.append(back - out)
        for words, places in (("outward", out), ("on the way back", back)):
            drawn.append(Series(f"ours, {coercive:g} A/m, {words}", signals, zero + places))
    static = static_places(inputs, axis)
    drawn.append(Series("ours, no hysteresis, shipped mesh", signals, zero + static))
    about = (
        COMMON[0].replace("one state for each set of currents, no hysteresis", "rate-independent hysteresis"),
        f"coercive field: a row each for {', '.join(f'{c:g}' for c in inputs['coercive_A_per_m'])} A/m; not measured",
        f"iron demagnetised before the run; mesh sizes over {REFINEMENT:g}; h = {inputs['h_mm']:g} mm",
        RULES["held"],
    )
    figure = Curves(
        f"{table} with iron that remembers", f"{axis} control signal (1)", f"{axis} (mm)", tuple(drawn)
    )
    return Answers({"width": Ours(np.array(widths), about)}, (figure,))


def static_places(inputs: dict[str, Any], axis: Axis) -> Array:
    """Places (k,), mm, from signal 0, without hysteresis: the other parts' static curve."""
    found = curve(inputs["map"], inputs["signals"][1:], axis, z_s=inputs["z_mm"], h=inputs["h_mm"])
    return 1e3 * np.append(0.0, found.along)


def kept_shift(
    pinning: Pinning, protocol: Protocol, signals: Array, folder: Path | None = OUTPUT_FOLDER
) -> Array:
    """Shifts (2 k - 1,), m, at signals (k,) out and back from demagnetised iron; computed once, kept in a file."""
    way = np.concatenate([signals, signals[-2::-1]])
    axis = float("xy".index(protocol.axis))
    key = np.array([pinning.coercive_field, pinning.cells, axis, protocol.z_s, protocol.h, *way])
    if folder is None:
        return _shift(pinning, protocol, way)
    mark = fingerprint((*read_device(DEVICE).texts, str(REFINEMENT)), (*ROOMS, "levitation", "thesis"))
    with StateArchive(folder / _FILE, mark) as archive:
        number = 0
        while (kept := archive.get(number)) is not None:
            if np.array_equal(kept.currents, key) and not isinstance(kept.values, str):
                return kept.values
            number += 1
        found = _shift(pinning, protocol, way)
        archive.put(number, KeptState(key, found))
    return found


def _shift(pinning: Pinning, protocol: Protocol, way: Array) -> Array:
    solver = _unit().pinned(pinning)
    memory = prepared(solver, "demagnetised", protocol, float(way.max()))
    return walk(solver, memory, way, protocol).shift(protocol.axis)


@cache
def _unit() -> HysteresisSolver:
    return HysteresisSolver(read_device(DEVICE), Pinning(0.0), REFINEMENT)

"""S14: the two branches of Tables 6-4 and 6-6, the unit's magnet led out and back with hysteresis in the iron."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.currents import LiftAndDirections
from fieldmap.curves import Curves, Series
from fieldmap.device import read_device
from fieldmap.errors import InputError, Problem
from fieldmap.field import as_field
from fieldmap.iron import HysteresisSolver, HystereticState, IronMemory, Pinning
from fieldmap.levitation import StationaryPoint, equilibrium_at
from fieldmap.provenance import fingerprint
from fieldmap.records import Record
from fieldmap.store import Checkpoint
from fieldmap.thesis import detail
from fieldmap.thesis.available_maps import FOLDER, WAIT
from fieldmap.thesis.drive_unit import DEVICE, LOWER, PACKAGES, UPPER
from fieldmap.thesis.equilibrium_shift import Rule, curve
from fieldmap.thesis.printed import shared_value
from fieldmap.thesis.rows import Answers
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

Axis = Literal["x", "y"]
History = Literal["demagnetised", "cycled", "restarted", "wiped", "saturated", "shaken"]
HISTORIES: dict[str, str] = {
    "demagnetised": "iron that was never magnetised; currents rise evenly to the level of the origin",
    "cycled": "the same, then the signal has been to the end of the table, to the opposite end and back to 0",
    "restarted": "as cycled, then all currents were switched off and raised evenly again",
    "wiped": "as cycled, then the largest current in all coils, and evenly down to the level of the origin",
    "saturated": "demagnetised, then the largest current in all coils, and evenly down to the level of the origin",
    "shaken": "demagnetised, then all currents swing about the level of the origin, from zero to twice the level and "
    "less and less, as a controller's do that catches the magnet",
}
LARGEST_CURRENT = shared_value("section_3_7.largest_current_A")
"""The amplifier's limit, A."""
SWINGS = np.array([-1.0, 1.0, -0.7, 0.7, -0.4, 0.4, -0.2, 0.2, -0.07, 0.0])
"""Of the history "shaken": currents less their level, over the level, from turn to turn."""
_LIFT_TOLERANCE, _TRIALS = 2e-3, 6
# d log lift / d log level to begin with: between (7-18) and the level at which the unscaled model lifts.
_EXPONENT = 0.9


@dataclass(frozen=True, eq=False, repr=False)
class Walk(Record):
    """Places (k, 2), m, of the magnet at signals (k,), the first of them 0; levels (k,), A; lifts (k,), N."""

    signals: Array
    places: Array
    levels: Array
    lifts: Array
    memory: IronMemory

    def shift(self, axis: Axis) -> Array:
        """Distances (k,), m, along an axis from where the magnet was at the first signal."""
        along = self.places[:, "xy".index(axis)]
        return np.asarray(along - along[0])


@dataclass(frozen=True, eq=False, repr=False)
class Protocol(Record):
    """How the signals become currents and how deep the magnet hangs: n of (6-3), z_s and h in mm, and the level rule of
    `fieldmap.thesis.equilibrium_shift`."""

    axis: Axis = "x"
    n: float = 1.25
    z_s: float = 10.0
    h: float = 15.0
    rule: Rule = "held"

    def currents(self, level: float, signal: float) -> Array:
        """Currents (6,), A."""
        x, y = (signal, 0.0) if self.axis == "x" else (0.0, signal)
        return LiftAndDirections(self.n).currents([level, x, y])

    @property
    def level(self) -> float:
        """Current in each coil at the origin, A: (7-18)."""
        return thesis_lift_current(self.z_s)

    @property
    def height(self) -> float:
        """z of the magnet's centre, m."""
        return magnet_height(self.z_s, 1e-3 * self.h)


def prepared(solver: HysteresisSolver, history: History, protocol: Protocol, end: float) -> IronMemory:
    """The iron at signal 0 before the run, after a history in which the signal went to `end` and -`end`."""
    check_choice("history", history, get_args(History))
    level = protocol.level
    if history == "shaken":
        memory = solver.demagnetised
        for swing in SWINGS:
            memory = solver.step(np.full(6, (1.0 + swing) * level), memory).memory
        return memory
    memory = _evenly(solver, solver.demagnetised, 0.0, level, 3)
    if history == "saturated":
        memory = _evenly(solver, memory, level, LARGEST_CURRENT, 3)
        return _evenly(solver, memory, LARGEST_CURRENT, level, 3)
    if history == "demagnetised":
        return memory
    for signal in end * np.array([0.25, 1.0, 0.25, 0.0, -0.25, -1.0, -0.25, 0.0]):
        memory = solver.step(protocol.currents(level, float(signal)), memory).memory
    if history == "cycled":
        return memory
    by = 0.0 if history == "restarted" else LARGEST_CURRENT
    return _evenly(solver, _evenly(solver, memory, level, by, 3), by, level, 3)


def _evenly(solver: HysteresisSolver, memory: IronMemory, start: float, end: float, steps: int) -> IronMemory:
    for level in np.linspace(start, end, steps + 1)[1:]:
        memory = solver.step(np.full(6, level), memory).memory
    return memory


def walk(
    solver: HysteresisSolver,
    memory: IronMemory,
    signals: Sequence[float] | Array,
    protocol: Protocol,
    parts: int = 1,
) -> Walk:
    """The magnet at signals (k,) in their order, the first of which is 0, from where the iron is.

    parts: steps of the iron from one signal to the next. With the rule "held" the level follows so that the lift stays
    what it was at the first signal, to 0.2 %; trials leave no trace in the iron. Raises InputError, NoEquilibrium,
    NotConverged.
    """
    if signals[0] != 0.0:
        must = "must begin with 0, from where places count"
        raise InputError(Problem("walk(signals)", must, f"{signals[0]:g}", "put 0 first"))
    found: list[tuple[StationaryPoint, float]] = []
    level, before = protocol.level, 0.0
    for signal in signals:
        for part in range(1, parts):
            between = before + (signal - before) * part / parts
            memory = solver.step(protocol.currents(level, between), memory).memory
        near = found[-1][0].position[:2] if found else np.zeros(2)
        target = found[0][0].lift if found and protocol.rule == "held" else None
        guess = _next_level(found, signals, level) if protocol.rule == "held" else level
        state, point, level = _settled(solver, memory, float(signal), guess, target, near, protocol)
        memory, before = state.memory, float(signal)
        found.append((point, level))
    places = np.array([point.position[:2] for point, _ in found])
    lifts = np.array([point.lift for point, _ in found])
    return Walk(np.asarray(signals, dtype=float), places, np.array([u for _, u in found]), lifts, memory)


def _next_level(
    found: Sequence[tuple[StationaryPoint, float]], signals: Sequence[float] | Array, level: float
) -> float:
    """Where the search for the level begins: on the parabola, or the line, of its logarithm through those before, as
    far back as the signal went the same way."""
    k = len(found)
    if k == 0:
        return level
    steps = np.diff(signals[: k + 1])
    count = 1
    while count < min(3, k) and steps[-1] * steps[-1 - count] > 0.0:
        count += 1
    known = np.log([one for _, one in found[k - count :]])
    return float(np.exp(np.polyval(np.polyfit(signals[k - count : k], known, count - 1), signals[k])))


def _settled(
    solver: HysteresisSolver,
    memory: IronMemory,
    signal: float,
    level: float,
    target: float | None,
    near: Array,
    protocol: Protocol,
) -> tuple[HystereticState, StationaryPoint, float]:
    """State, rest point and level at one signal, by secants on logarithms where a lift is to be held."""
    tried: list[tuple[float, float]] = []
    state = None
    for _ in range(_TRIALS):
        state = solver.step(protocol.currents(level, signal), memory, near=state)
        point = _rest(state, near, protocol, solver)
        if target is None or abs(point.lift / target - 1.0) < _LIFT_TOLERANCE:
            break
        tried.append((np.log(level), np.log(point.lift / target)))
        exponent = _EXPONENT
        if len(tried) > 1:
            (u0, f0), (u1, f1) = tried[-2:]
            exponent = float(np.clip((f1 - f0) / (u1 - u0), 0.3, 2.0))
        level = float(np.exp(tried[-1][0] - tried[-1][1] / exponent))
    assert state is not None
    return state, point, float(level)


def _rest(
    state: HystereticState, near: Array, protocol: Protocol, solver: HysteresisSolver
) -> StationaryPoint:
    # A state knows its own currents only, so the path has one of them.
    field = as_field(state, (LOWER, UPPER))
    point, _ = equilibrium_at(
        field, solver.device.payload, lambda _: (state.currents, protocol.height), near, protocol.level
    )
    return point


REFINEMENT = 0.5
"""Mesh sizes of the device file are divided by this: positions within 8 %, a run in a minute or two."""
_FILE = "thesis_remanence.cache"


def x_remanence(inputs: dict[str, Any]) -> Answers:
    """Table 6-4, along x."""
    return _branch_rows(inputs, "x", "Table 6-4")


def y_remanence(inputs: dict[str, Any]) -> Answers:
    """Table 6-6, along y."""
    return _branch_rows(inputs, "y", "Table 6-6")


def _branch_rows(inputs: dict[str, Any], axis: Axis, table: str) -> Answers:
    """Back less out, a row for each coercive field; places from where the run began."""
    signals, measured = inputs["signals"], (inputs["outward_mm"], inputs["back_mm"])
    zero, count = measured[0][0], len(inputs["signals"])
    drawn = [
        Series(f"measured, {words}", signals, places, "measured", points=True)
        for words, places in zip(("outward", "on the way back"), measured, strict=True)
    ]
    widths = []
    for coercive in inputs["coercive_A_per_m"]:
        pinning = Pinning(float(coercive), detail.fewer(int(inputs["cells"])))
        shift = 1e3 * cached_shift(pinning, Protocol(axis, z_s=inputs["z_mm"], h=inputs["h_mm"]), signals)
        out, back = shift[:count], shift[count - 1 :][::-1]
        widths.append(back - out)
        for words, places in (("outward", out), ("on the way back", back)):
            drawn.append(Series(f"ours, {coercive:g} A/m, {words}", signals, zero + places))
    static = static_places(inputs, axis)
    drawn.append(Series("ours, no hysteresis, shipped mesh", signals, zero + static))
    figure = Curves(
        f"{table} with hysteresis in the iron", f"{axis} control signal", f"{axis} (mm)", tuple(drawn)
    )
    return Answers({"width": np.array(widths)}, (figure,), {"refinement": detail.refinement(REFINEMENT)})


def static_places(inputs: dict[str, Any], axis: Axis) -> Array:
    """Places (k,), mm, from signal 0, without hysteresis: the other parts' static curve."""
    found = curve(inputs["map"], inputs["signals"][1:], axis, z_s=inputs["z_mm"], h=inputs["h_mm"])
    return 1e3 * np.append(0.0, found.along)


def cached_shift(pinning: Pinning, protocol: Protocol, signals: Array, folder: Path | None = FOLDER) -> Array:
    """Shifts (2 k - 1,), m, at signals (k,) out and back from demagnetised iron; computed once, cached in a file."""
    way = np.concatenate([signals, signals[-2::-1]])
    axis = float("xy".index(protocol.axis))
    key = np.array([pinning.coercive_field, pinning.cells, axis, protocol.z_s, protocol.h, *way])
    if folder is None:
        return _shift(pinning, protocol, way)
    mark = fingerprint(
        (*read_device(DEVICE).texts, str(detail.refinement(REFINEMENT))), (*PACKAGES, "levitation", "thesis")
    )
    name = json.dumps(key.tolist())
    with Checkpoint(folder / _FILE, mark, wait=WAIT) as checkpoint:
        piece = checkpoint.get(name)
    if piece is not None:
        return piece.arrays["shifts"]
    # Minutes, for which the file is left to other runs.
    found = _shift(pinning, protocol, way)
    with Checkpoint(folder / _FILE, mark, wait=WAIT) as checkpoint:
        checkpoint.put(name, {"shifts": found})
    return found


def _shift(pinning: Pinning, protocol: Protocol, way: Array) -> Array:
    solver = _unit().with_pinning(pinning)
    memory = prepared(solver, "demagnetised", protocol, float(way.max()))
    return walk(solver, memory, way, protocol).shift(protocol.axis)


@detail.cached
def _unit() -> HysteresisSolver:
    return HysteresisSolver(read_device(DEVICE), Pinning(0.0), detail.refinement(REFINEMENT))

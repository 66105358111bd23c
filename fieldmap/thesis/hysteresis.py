"""S14: the two branches of Tables 6-4 to 6-7, with the magnet led out and back and hysteresis in the iron.

The unit has iron with a coercive field, and in one variant also joints at the cores' ends. The thickness of the joints
and the coercive field, which nobody measured, are fitted to Table 6-4; the other tables are then compared.
`scripts/studies/joint_study.py` does the fit, docs/joint_study.md discusses it.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from fieldmap.arguments import check_choice
from fieldmap.curves import Curves, Series
from fieldmap.device import Device, read_device
from fieldmap.device.materials import SaturatingMaterial
from fieldmap.errors import InputError
from fieldmap.field import as_field
from fieldmap.histories import history_of_currents
from fieldmap.iron import HysteresisSolver, HystereticState, IronMemory, Pinning
from fieldmap.levitation import GRAVITY, StationaryPoint, equilibrium_at
from fieldmap.lookup.payload import check_payload
from fieldmap.provenance import fingerprint
from fieldmap.records import Record
from fieldmap.thesis import detail
from fieldmap.thesis.computation import Answers
from fieldmap.thesis.detail import FOLDER
from fieldmap.thesis.drive_unit import LOWER, PACKAGES, UPPER, as_dipole
from fieldmap.thesis.equilibrium_shift import Axis, Rule, both_ways, curve, divided
from fieldmap.thesis.kept import Kept
from fieldmap.thesis.printed import shared_value
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

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
_LIFT_TOLERANCE, _TRIALS = 2e-3, 6
# Start value of d log lift / d log level, for levels between (7-18) and the lift current of the unscaled model.
_EXPONENT = 0.9


@dataclass(frozen=True, eq=False, repr=False)
class Walk(Record):
    """Positions (k, 2), m, of the magnet at signals (k,), of which the first is 0; levels (k,), A; lifts (k,), N."""

    signals: Array
    places: Array
    levels: Array
    lifts: Array

    def shift(self, axis: Axis) -> Array:
        """Distances (k,), m, along an axis from the position at the first signal."""
        along = self.places[:, "xy".index(axis)]
        return np.asarray(along - along[0])


@dataclass(frozen=True, repr=False)
class Protocol(Record):
    """Division of currents and depth of the magnet: n of (6-3), z_s and h in mm, and the level rule of
    `fieldmap.thesis.equilibrium_shift`. scale: factor of the level, for other turns or another current sensing."""

    axis: Axis = "x"
    n: float = 1.25
    z_s: float = 10.0
    h: float = 15.0
    rule: Rule = "held"
    scale: float = 1.0

    def currents(self, level: float, signal: float) -> Array:
        """Currents (6,), A."""
        return divided(level, signal, self.axis, self.n)

    @property
    def level(self) -> float:
        """Current in each coil at the origin, A: (7-18)."""
        return self.scale * thesis_lift_current(self.z_s)

    @property
    def height(self) -> float:
        """z of the magnet's centre, m."""
        return magnet_height(self.z_s, 1e-3 * self.h)


def prepared(solver: HysteresisSolver, history: History, protocol: Protocol, end: float) -> IronMemory:
    """State of the iron at signal 0 before the run, after a history; cycles go to the signals `end` and -`end`."""
    check_choice("history", history, get_args(History))
    level = protocol.level

    def evenly(*levels: float) -> list[Array]:
        return [np.full(6, u) for a, b in pairwise(levels) for u in np.linspace(a, b, 4)[1:]]

    signals = end * np.array([0.25, 1.0, 0.25, 0.0, -0.25, -1.0, -0.25, 0.0])
    rise, cycle = evenly(0.0, level), [protocol.currents(level, float(signal)) for signal in signals]
    steps = {
        "demagnetised": rise,
        "cycled": [*rise, *cycle],
        "restarted": [*rise, *cycle, *evenly(level, 0.0, level)],
        "wiped": [*rise, *cycle, *evenly(level, LARGEST_CURRENT, level)],
        "saturated": [*rise, *evenly(level, LARGEST_CURRENT, level)],
        "shaken": list(history_of_currents("shaken", np.full(6, level))),
    }
    memory = solver.demagnetised
    for currents in steps[history]:
        memory = solver.step(currents, memory).memory
    return memory


def walk(
    solver: HysteresisSolver,
    memory: IronMemory,
    signals: Sequence[float] | Array,
    protocol: Protocol,
    parts: int = 1,
) -> Walk:
    """Follow the magnet through signals (k,) in order, beginning at 0 with the iron in the state `memory`.

    parts: steps of the iron from one signal to the next. With the rule "held" the level is adjusted so that the lift
    stays within 0.2 % of the lift at the first signal; trials do not change the iron. Raises InputError,
    NoEquilibrium, NotConverged.
    """
    if signals[0] != 0.0:
        must_hold = "must begin with 0, from where places count"
        raise InputError.of("walk(signals)", must_hold, f"{signals[0]:g}", "put 0 first")
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
    places, lifts, levels = zip(*((point.position[:2], point.lift, u) for point, u in found), strict=True)
    return Walk(np.asarray(signals, float), np.array(places), np.array(levels), np.array(lifts))


def _next_level(
    found: Sequence[tuple[StationaryPoint, float]], signals: Sequence[float] | Array, level: float
) -> float:
    """Start value of the search for the level: the logarithm of earlier levels is extrapolated by a parabola or line
    through up to three points, as far back as the signal went the same way."""
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
    """State, rest point and level at one signal. A target lift is met by the secant method on logarithms."""
    tried: list[tuple[float, float]] = []
    state = None
    for _ in range(_TRIALS):
        state = solver.step(protocol.currents(level, signal), memory, near=state)
        # A state holds at its own currents only, so the currents do not depend on the level.
        at, field = (state.currents, protocol.height), as_field(state, (LOWER, UPPER))
        point, _ = equilibrium_at(field, as_dipole(solver.device), lambda _, at=at: at, near, protocol.level)
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


DEVICE = "drive_unit_joints"
REFINEMENT = 0.5
"""Divisor of the mesh sizes of the device file: positions within 8 %, a run in a minute or two."""
COARSEST = 0.4
"""Smallest divisor at which the mesher can mesh the sheets between the cores and the disk."""
_FILE = "thesis_hysteresis.cache"
_CODE = (*PACKAGES, "levitation", "thesis/hysteresis", "thesis/vertical_sensor", "thesis/drive_unit")


@dataclass(frozen=True, repr=False)
class Led(Record):
    """Settings of a run: history of the iron, number of play cells, steps from signal to signal, mesh."""

    history: History = "shaken"
    cells: int = 6
    parts: int = 1
    refinement: float = REFINEMENT


def coercive_field(device: Device) -> float:
    """Coercive field of the steel, A/m; all iron of the unit is one steel."""
    (steel,) = (one for one in device.materials.values() if isinstance(one, SaturatingMaterial))
    return steel.coercive_field


class JointedUnit:
    """A device whose magnet is led through tables of signals. The mesh is made when a run is not in the cache.

    folder: where runs are cached, for the same device, settings, libraries and code; None for no cache.
    """

    def __init__(self, device: Device, led: Led | None = None, folder: Path | None = FOLDER) -> None:
        self.device, self.led = device, led or Led()
        self.payload = check_payload(device.payload, "JointedUnit")
        self.h = 1e3 * self.payload.magnet_offset
        self._folder = folder
        self._before: dict[float, IronMemory] = {}

    @cached_property
    def solver(self) -> HysteresisSolver:
        """The solver of the meshed unit."""
        pinning = Pinning(coercive_field(self.device), self.led.cells)
        return HysteresisSolver(self.device, pinning, self.led.refinement)

    def run(self, axis: Axis, signals: Array, n: float = 1.25, z_s: float = 10.0) -> "Run":
        """Lead the magnet through signals (k,) in their order, or read the run from the cache."""
        about = self.device.replace(provenance={}, title="").to_toml()
        key = json.dumps([about, self.led.to_dict(), axis, n, z_s, signals.tolist()])
        kept = Kept(None if self._folder is None else self._folder / _FILE, fingerprint((), _CODE))
        return Run(**kept.arrays(key, lambda: self._run(signals, Protocol(axis, n, z_s, self.h))))

    def _run(self, signals: Array, protocol: Protocol) -> dict[str, Array]:
        if protocol.z_s not in self._before:
            self._before[protocol.z_s] = prepared(self.solver, self.led.history, protocol, 0.4)
        found = walk(self.solver, self._before[protocol.z_s], signals, protocol, self.led.parts)
        currents = [protocol.currents(u, s) for u, s in zip(found.levels, found.signals, strict=True)]
        largest = np.abs(currents).max(axis=1)
        shift = 1e3 * found.shift(protocol.axis)
        return {"shift": shift, "levels": found.levels, "largest": largest, "lifts": found.lifts}


@dataclass(frozen=True, eq=False, repr=False)
class Run(Record):
    """Shifts (k,), mm, from the position at the first signal; levels (k,), A; largest coil current (k,), A; lifts
    (k,), N."""

    shift: Array
    levels: Array
    largest: Array
    lifts: Array


@dataclass(frozen=True, eq=False, repr=False)
class LiftLaw(Record):
    """Lift over weight (k,) at depths z_s (k,), mm, with the currents of (7-18), and the relative growth of the current
    with depth for constant lift at z_s = 10 mm, % per mm."""

    shares: Array
    relative_slope: float


def lift_law(of: JointedUnit, depths: Array, scale: float = 1.0) -> LiftLaw:
    """(7-18) with joints and hysteresis; the currents grow from zero while the magnet is lowered."""
    payload = of.payload
    weight = payload.mass * GRAVITY

    def share(state: HystereticState, z_s: float) -> float:
        point = np.array([0.0, 0.0, magnet_height(z_s, payload.magnet_offset)])
        return float(payload.moment * state.gradient(point)[2, 2] / weight)

    memory, shares, slope = of.solver.demagnetised, [], np.nan
    for z_s in depths:
        level = scale * thesis_lift_current(z_s)
        state = of.solver.step(np.full(6, level), memory)
        memory = state.memory
        shares.append(share(state, z_s))
        if z_s == 10.0:
            more = of.solver.step(np.full(6, 1.02 * level), memory)
            by_current = np.log(share(more, z_s) / shares[-1]) / np.log(1.02)
            by_depth = np.log(share(state, z_s + 1.0) / share(state, z_s - 1.0)) / 2.0
            slope = float(-100.0 * by_depth / by_current)
    return LiftLaw(np.array(shares), slope)


def remanence(inputs: dict[str, Any]) -> Answers:
    """Width between return and outward branch, one row for each coercive field."""
    signals, measured = inputs["signals"], (inputs["outward_mm"], inputs["back_mm"])
    zero, z, h, axis = measured[0][0], inputs["z_mm"], inputs["h_mm"], inputs["axis"]
    drawn, widths = both_ways("measured", signals, *measured, "measured"), []
    for coercive in inputs["coercive_A_per_m"]:
        unit = _bare_unit(float(coercive), h, int(inputs["cells"]))
        out, back = out_and_back(unit.run(axis, there_and_back(signals), z_s=z).shift)
        widths.append(back - out)
        drawn += both_ways(f"ours, {coercive:g} A/m", signals, zero + out, zero + back)
    static = 1e3 * np.append(0.0, curve(inputs["map"], signals[1:], axis, z_s=z, h=h).along)
    drawn.append(Series("ours, no hysteresis, shipped mesh", signals, zero + static))
    figure = Curves(inputs["figure"], f"{axis} control signal", f"{axis} (mm)", tuple(drawn))
    return Answers({"width": np.array(widths)}, (figure,), {"refinement": detail.refinement(REFINEMENT)})


def there_and_back(signals: Array) -> Array:
    """Signals (2 k - 1,) from the first to the last and back."""
    return np.concatenate([signals, signals[-2::-1]])


def out_and_back(values: Array) -> tuple[Array, Array]:
    """Values (k,) of the way out and of the way back, both in the order of the way out."""
    count = len(values) // 2 + 1
    return values[:count], values[count - 1 :][::-1]


@detail.cached
def _bare_unit(coercive: float, h: float, cells: int) -> JointedUnit:
    """The unit without joints, with iron of a given coercive field, A/m."""
    device = read_device("drive_unit", {"payload.magnet_offset_mm": h})
    steel: Any = device.materials["steel"]
    led = Led("demagnetised", detail.fewer(cells), refinement=detail.refinement(REFINEMENT))
    return JointedUnit(device.replace(materials={"steel": replace(steel, coercive_field=coercive)}), led)


@detail.cached
def shipped_unit() -> JointedUnit:
    """The shipped device, with the joints and the coercive field that were fitted to Table 6-4."""
    history: History = "demagnetised" if detail.current().is_quick else "shaken"
    led = Led(history, detail.fewer(Led().cells), refinement=max(detail.refinement(REFINEMENT), COARSEST))
    return JointedUnit(read_device(DEVICE), led)


def joints(inputs: dict[str, Any]) -> Answers:
    """Both branches of both sides; each side begins at the first measured position."""
    axis, drawn = inputs["axis"], []
    numbers: dict[str, Any] = {}
    for side in ("positive", "negative"):
        signals, *measured = (inputs[f"{side}_{what}"] for what in ("signals", "outward_mm", "back_mm"))
        shift = _branches(axis, there_and_back(signals), inputs["z_mm"])
        out, back = out_and_back(measured[0][0] + shift)
        numbers |= {f"{side}_outward": out, f"{side}_back": back}
        pairs = (
            both_ways("ours", signals, out, back),
            both_ways("measured", signals, measured[0], measured[1], "measured"),
        )
        drawn += [line for pair in zip(*pairs, strict=True) for line in pair]
    figure = Curves(inputs["figure"], f"{axis} control signal", f"{axis} (mm)", tuple(drawn))
    return Answers(numbers, (figure,), about_the_joints())


def _branches(axis: Axis, way: Array, z_s: float) -> Array:
    """Shifts (k,), mm, of the shipped unit; a quick report computes every fourth, and only positive signals."""
    quick = detail.current().is_quick
    if way[1] < 0.0 and (axis == "y" or quick):
        # The unit is symmetric along y, and nearly symmetric along x.
        return -_branches(axis, -way, z_s)
    step = len(way) // 4 if quick else 1
    shift = shipped_unit().run(axis, way[::step], z_s=z_s).shift
    return np.interp(np.arange(len(way)), np.arange(0, len(way), step), shift)


def joint_range(axis: Axis, z_s: float, limit: float, largest_signal: float) -> float:
    """Range of the shipped unit, mm, both sides together; for y and in a quick report twice the positive side."""
    if axis == "y" or detail.current().is_quick:
        return 2.0 * reach(shipped_unit(), axis, 1.0, z_s, limit, largest_signal)
    return sum(reach(shipped_unit(), axis, sign, z_s, limit, largest_signal) for sign in (1.0, -1.0))


def about_the_joints() -> dict[str, Any]:
    """Fitted values of the shipped device, and settings of the runs."""
    of = shipped_unit()
    return {
        "joint_mm": 1e3 * of.device.joints[0].gap,
        "coercive_A_per_m": coercive_field(of.device),
        "fitted_h_mm": of.h,
        "joint_refinement": of.led.refinement,
        "history": HISTORIES[of.led.history],
    }


def reach(of: JointedUnit, axis: Axis, sign: float, z_s: float, limit: float, largest_signal: float) -> float:
    """Distance, mm, at which a coil reaches the limit, A, or the signal its largest value."""
    spacing = largest_signal / 2 if detail.current().is_quick else 0.05
    signals = np.arange(0.0, largest_signal + 1e-9, spacing)
    run = of.run(axis, sign * signals, z_s=z_s)
    return float(np.interp(np.interp(limit, run.largest, signals), signals, np.abs(run.shift)))

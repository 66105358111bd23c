"""S14: both branches of Tables 6-4 to 6-7 with joints at the cores' ends and hysteresis in the iron.

Two numbers that nobody measured, the thickness of the joints and the coercive field, are fitted to Table 6-4; with them
the other tables are computed and compared. `scripts/studies/joint_study.py` does the fit, docs/joint_study.md reads it.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldmap.curves import Curves, Series
from fieldmap.device import Device, read_device
from fieldmap.device.materials import SaturatingMaterial
from fieldmap.iron import HysteresisSolver, HystereticState, IronMemory, Pinning
from fieldmap.levitation import GRAVITY
from fieldmap.lookup.payload import check_payload
from fieldmap.provenance import fingerprint
from fieldmap.records import Record
from fieldmap.store import Checkpoint
from fieldmap.thesis import detail
from fieldmap.thesis.available_maps import FOLDER, WAIT
from fieldmap.thesis.drive_unit import PACKAGES
from fieldmap.thesis.hysteresis import HISTORIES, Axis, History, Protocol, Walk, prepared, walk
from fieldmap.thesis.printed import shared_value
from fieldmap.thesis.rows import Answers
from fieldmap.thesis.vertical_sensor import magnet_height, thesis_lift_current
from fieldmap.typing import Array

DEVICE = "drive_unit_joints"
REFINEMENT = 0.5
"""Mesh sizes of the device file are divided by this."""
_FILE = "thesis_joints.cache"
_CODE = (*PACKAGES, "levitation", "thesis/hysteresis", "thesis/vertical_sensor", "thesis/drive_unit")


@dataclass(frozen=True, eq=False, repr=False)
class Branches(Record):
    """One of the thesis's tables of places, mm, from where its run began.

    signals (k,), the first of them 0; out (k,), on the way out; back (k,), on the way back, or None where the table has
    the way out only. n of (6-3), z_s in mm.
    """

    name: str
    axis: Axis
    signals: Array
    out: Array
    back: Array | None = None
    n: float = 1.25
    z_s: float = 10.0

    @property
    def way(self) -> Array:
        """The signals in the order of the run."""
        return self.signals if self.back is None else np.concatenate([self.signals, self.signals[-2::-1]])

    @property
    def measured(self) -> Array:
        """Places (m,) in the order of the run but for the first, which is 0."""
        return self.out[1:] if self.back is None else np.concatenate([self.out[1:], self.back[-2::-1]])


def _numbers(name: str) -> Array:
    return np.asarray(shared_value(name), dtype=float)


def tables() -> dict[str, Branches]:
    """Tables 6-4 to 6-7, and those of 6.2 with one way only: n = 1.5 of Table 6-2, z_s = 11.5 mm of Table 6-3. The
    latter have no reading at signal 0; that of Table 6-4 stands for it."""
    found = {}
    sides: tuple[tuple[int, Axis], ...] = ((4, "x"), (5, "x"), (6, "y"), (7, "y"))
    for number, axis in sides:
        signals, out, back = (
            _numbers(f"table_6_{number}.{what}") for what in ("signals", "outward_mm", "back_mm")
        )
        name = f"Table 6-{number}"
        found[name] = Branches(name, axis, signals, out - out[0], back - out[0])
    zero = _numbers("table_6_4.outward_mm")[0]
    for name, asked, places, n, z_s in (
        ("Table 6-2, n = 1.5", "table_6_2.n150_signals", "table_6_2.n150_mm", 1.5, 10.0),
        ("Table 6-3, 11.5 mm", "table_6_2.n125_signals", "table_6_3.lower_mm", 1.25, 11.5),
    ):
        out = np.append(0.0, _numbers(places) - zero)
        found[name] = Branches(name, "x", np.append(0.0, _numbers(asked)), out, n=n, z_s=z_s)
    return found


@dataclass(frozen=True, repr=False)
class Led(Record):
    """How a run is computed: history of the iron before it, play cells, steps from signal to signal, mesh."""

    history: History = "shaken"
    cells: int = 6
    parts: int = 1
    refinement: float = REFINEMENT


def coercive_field(device: Device) -> float:
    """Of the steel, A/m; all iron of the unit is one steel."""
    (steel,) = (one for one in device.materials.values() if isinstance(one, SaturatingMaterial))
    return steel.coercive_field


class JointedUnit:
    """A device whose magnet is led through tables of signals. The mesh is made when a run is not in the cache.

    folder: where runs are cached, for the same device, settings, libraries and code; None: nowhere.
    """

    def __init__(self, device: Device, led: Led | None = None, folder: Path | None = FOLDER) -> None:
        self.device, self.led = device, led or Led()
        self.payload = check_payload(device.payload, "JointedUnit")
        self.h = 1e3 * self.payload.magnet_offset
        self._folder = folder
        self._solver: HysteresisSolver | None = None
        self._before: dict[float, IronMemory] = {}

    @property
    def solver(self) -> HysteresisSolver:
        """The unit, meshed."""
        if self._solver is None:
            pinning = Pinning(coercive_field(self.device), self.led.cells)
            self._solver = HysteresisSolver(self.device, pinning, self.led.refinement)
        return self._solver

    def run(self, axis: Axis, signals: Array, n: float = 1.25, z_s: float = 10.0) -> "Run":
        """The magnet at signals (k,) in their order."""
        about = self.device.replace(provenance={}, title="").to_toml()
        key = json.dumps([about, self.led.to_dict(), axis, n, z_s, signals.tolist()])
        with self._cache() as cache:
            piece = None if cache is None else cache.get(key)
        if piece is not None:
            return Run(**piece.arrays)
        protocol = Protocol(axis, n, z_s, self.h)
        if z_s not in self._before:
            self._before[z_s] = prepared(self.solver, self.led.history, protocol, 0.4)
        found = _run(walk(self.solver, self._before[z_s], signals, protocol, self.led.parts), protocol)
        with self._cache() as cache:
            if cache is not None:
                cache.put(
                    key, {name: getattr(found, name) for name in ("shift", "levels", "largest", "lifts")}
                )
        return found

    @contextmanager
    def _cache(self) -> Iterator[Checkpoint | None]:
        if self._folder is None:
            yield None
            return
        with Checkpoint(self._folder / _FILE, fingerprint((), _CODE), wait=WAIT) as cache:
            yield cache


@dataclass(frozen=True, eq=False, repr=False)
class Run(Record):
    """Shifts (k,), mm, from where the magnet was at the first signal; levels (k,), A; largest current of any coil (k,),
    A; lifts (k,), N."""

    shift: Array
    levels: Array
    largest: Array
    lifts: Array


def _run(found: Walk, protocol: Protocol) -> Run:
    each = [protocol.currents(u, s) for u, s in zip(found.levels, found.signals, strict=True)]
    return Run(1e3 * found.shift(protocol.axis), found.levels, np.abs(each).max(axis=1), found.lifts)


@dataclass(frozen=True, eq=False, repr=False)
class BranchReadings(Record):
    """A table as `fieldmap.studies.fit_machine` reads it; `deviation`, mm, is that of one place."""

    branches: Branches
    deviation: float

    @property
    def name(self) -> str:
        """Of the table."""
        return self.branches.name

    @property
    def measured(self) -> Array:
        """Places, mm."""
        return self.branches.measured

    def computed(self, device: Device, field: JointedUnit) -> Array:
        """The same places of a unit."""
        about = self.branches
        return field.run(about.axis, about.way, about.n, about.z_s).shift[1:]


@dataclass(frozen=True, eq=False, repr=False)
class ScaledProtocol(Protocol):
    """A `Protocol` whose currents are `scale` times those of (7-18): other turns, or another current sensing."""

    scale: float = 1.0

    @property
    def level(self) -> float:
        """Current in each coil at the origin, A."""
        return self.scale * thesis_lift_current(self.z_s)


@dataclass(frozen=True, eq=False, repr=False)
class LiftLaw(Record):
    """Lift over weight (k,) at depths z_s (k,), mm, with the currents of (7-18), and by how much the current must grow
    with depth at z_s = 10 mm for the same lift, % per mm."""

    depths: Array
    shares: Array
    relative_slope: float


def lift_law(of: JointedUnit, depths: Array, scale: float = 1.0) -> LiftLaw:
    """(7-18) with joints and hysteresis: the currents grow from nothing, as the magnet is lowered."""
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
    return LiftLaw(np.asarray(depths), np.array(shares), slope)


def places_at(of: JointedUnit, axis: Axis, signals: Array, scale: float = 1.0) -> Array:
    """Places (k,), mm, of the magnet on its way out at z_s = 10 mm, with all currents scaled."""
    protocol = ScaledProtocol(axis, h=of.h, scale=scale)
    memory = prepared(of.solver, of.led.history, protocol, 0.4)
    return 1e3 * walk(of.solver, memory, signals, protocol, of.led.parts).shift(axis)


# ---- rows of the thesis ----

COARSEST = 0.4
"""Sheets between the cores and the disk have no mesh below this."""


@detail.cached
def shipped_unit() -> JointedUnit:
    """The shipped device, with the joints and the coercive field that were fitted to Table 6-4."""
    history: History = "demagnetised" if detail.current().is_quick else "shaken"
    led = Led(history, detail.fewer(Led().cells), refinement=max(detail.refinement(REFINEMENT), COARSEST))
    return JointedUnit(read_device(DEVICE), led)


def x_joints(inputs: dict[str, Any]) -> Answers:
    """Tables 6-4 and 6-5."""
    return _branch_rows(
        inputs, "x", "Both branches along x: joints and hysteresis, fitted to the positive side"
    )


def y_joints(inputs: dict[str, Any]) -> Answers:
    """Tables 6-6 and 6-7."""
    return _branch_rows(inputs, "y", "Both branches along y: predicted by joints and hysteresis fitted to x")


def _branch_rows(inputs: dict[str, Any], axis: Axis, title: str) -> Answers:
    """Both branches of both sides, each from where the measured run began."""
    numbers: dict[str, Any] = {}
    drawn = []
    for side in ("positive", "negative"):
        signals, out, back = (inputs[f"{side}_{what}"] for what in ("signals", "outward_mm", "back_mm"))
        shift = _branches(axis, np.concatenate([signals, signals[-2::-1]]), inputs["z_mm"])
        count = len(signals)
        ours = {"outward": out[0] + shift[:count], "back": out[0] + shift[count - 1 :][::-1]}
        for (way, places), measured in zip(ours.items(), (out, back), strict=True):
            numbers[f"{side}_{way}"] = places
            name = "outward" if way == "outward" else "on the way back"
            drawn.append(Series(f"ours, {name}", signals, places))
            drawn.append(Series(f"measured, {name}", signals, measured, "measured", points=True))
    figure = Curves(title, f"{axis} control signal", f"{axis} (mm)", tuple(drawn))
    return Answers(numbers, (figure,), about_the_joints())


def _branches(axis: Axis, way: Array, z_s: float) -> Array:
    """Shifts (k,), mm, of the shipped unit; in a quick report five are computed, for positive signals."""
    quick = detail.current().is_quick
    if way[1] < 0.0 and (axis == "y" or quick):
        # The unit is its own mirror image along y, and nearly so along x.
        return -_branches(axis, -way, z_s)
    step = len(way) // 4 if quick else 1
    shift = shipped_unit().run(axis, way[::step], z_s=z_s).shift
    return np.interp(np.arange(len(way)), np.arange(0, len(way), step), shift)


def joint_range(axis: Axis, z_s: float, limit: float, largest_signal: float) -> float:
    """Of the shipped unit, mm, both sides together; in a quick report twice the positive side."""
    if axis == "y" or detail.current().is_quick:
        return 2.0 * reach(shipped_unit(), axis, 1.0, z_s, limit, largest_signal)
    return sum(reach(shipped_unit(), axis, sign, z_s, limit, largest_signal) for sign in (1.0, -1.0))


def about_the_joints() -> dict[str, Any]:
    """What the shipped device was fitted with, and how the runs are computed."""
    of = shipped_unit()
    return {
        "joint_mm": 1e3 * of.device.joints[0].gap,
        "coercive_A_per_m": coercive_field(of.device),
        "fitted_h_mm": of.h,
        "joint_refinement": of.led.refinement,
        "history": HISTORIES[of.led.history],
    }


def reach(of: JointedUnit, axis: Axis, sign: float, z_s: float, limit: float, largest_signal: float) -> float:
    """How far the magnet gets, mm, until a coil carries the limit, A, or the signal is at its largest."""
    spacing = largest_signal / 2 if detail.current().is_quick else 0.05
    signals = np.arange(0.0, largest_signal + 1e-9, spacing)
    run = of.run(axis, sign * signals, z_s=z_s)
    return float(np.interp(np.interp(limit, run.largest, signals), signals, np.abs(run.shift)))

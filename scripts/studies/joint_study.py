"""Do joints at the cores' ends and remanence explain the measured branches of the equilibrium shift?

    python scripts/studies/joint_study.py [--processes 2] [--part variants numerics level reach]

Fits the thickness of the joints, the coercive field and h to Table 6-4 alone, and predicts Tables 6-5 to 6-7, 6-2 and
6-3. Then prints the same tables with other joints, disks, histories and meshes; the lift at the measured currents for
several readings of the thesis; and the range of the magnet. Runs are cached in maps/out, so that a killed study can
continue. docs/joint_study.md and docs/joint_study_variants.md show the results.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import argparse  # noqa: E402
import json  # noqa: E402
import multiprocessing  # noqa: E402
import time  # noqa: E402
from collections.abc import Mapping  # noqa: E402
from concurrent.futures import ProcessPoolExecutor  # noqa: E402
from dataclasses import dataclass, replace  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

from fieldmap.device import Device, read_device  # noqa: E402
from fieldmap.records import Record  # noqa: E402
from fieldmap.studies import Unknown, fit_machine  # noqa: E402
from fieldmap.thesis import hysteresis  # noqa: E402
from fieldmap.thesis.hysteresis import (  # noqa: E402
    DEVICE,
    HISTORIES,
    LARGEST_CURRENT,
    REFINEMENT,
    Axis,
    History,
    JointedUnit,
    Led,
    Protocol,
    lift_law,
    prepared,
    reach,
    walk,
)
from fieldmap.thesis.printed import shared_value  # noqa: E402
from fieldmap.typing import Array  # noqa: E402

JOINT, COERCIVE, H = "parameters.joint", "material.steel.coercive_field_A_per_m", "payload.magnet_offset_mm"
LOWER = "joint.lower.gap_mm"
DEVIATION = 0.5
"""Standard deviation of a position, mm, about the misfit of the fit. The thesis states none; sensors read 0.01 mm."""
UNKNOWNS = (
    Unknown(JOINT, 0.05, lower=0.001, upper=1.0, step=0.015),
    Unknown(COERCIVE, 200.0, lower=0.0, upper=2000.0, step=40.0),
    Unknown(H, 17.5, lower=1.0, upper=30.0, prior=(17.5, 4.3), step=1.5),
)
"""Unknowns. The prior of h has the mean and standard deviation of a uniform distribution from 10 to 25 mm."""
CLOSE = 4e-2
FIRST = "Table 6-4"
BRANCHES = ("Table 6-5", "Table 6-6", "Table 6-7")
PARTS = ("variants", "numerics", "level", "reach")
SINGLE = ("Table 6-2, n = 1.5", "Table 6-3, 11.5 mm")


@dataclass(frozen=True, eq=False, repr=False)
class Branches(Record):
    """One of the thesis's tables of positions, mm, relative to the beginning of its run.

    signals (k,), of which the first is 0; out (k,), on the way out; back (k,), on the way back, or None if the table
    has the way out only. n of (6-3), z_s in mm.
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
        """Positions (m,) in the order of the run without the first, which is 0."""
        return self.out[1:] if self.back is None else np.concatenate([self.out[1:], self.back[-2::-1]])


def _numbers(name: str) -> Array:
    return np.asarray(shared_value(name), dtype=float)


def tables() -> dict[str, Branches]:
    """Tables 6-4 to 6-7, and two tables of 6.2 with one way only: n = 1.5 of Table 6-2, z_s = 11.5 mm of Table 6-3.
    These two have no reading at signal 0 and use the one of Table 6-4."""
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


@dataclass(frozen=True, eq=False, repr=False)
class BranchReadings(Record):
    """A table as readings for `fieldmap.studies.fit_machine`. deviation: of one position, mm."""

    branches: Branches
    deviation: float

    @property
    def name(self) -> str:
        """Name of the table."""
        return self.branches.name

    @property
    def measured(self) -> Array:
        """Measured positions, mm."""
        return self.branches.measured

    def computed(self, device: Device, field: JointedUnit) -> Array:
        """The same positions computed for a unit, mm."""
        about = self.branches
        return field.run(about.axis, about.way, about.n, about.z_s).shift[1:]


def places_at(of: JointedUnit, axis: Axis, signals: Array, scale: float = 1.0) -> Array:
    """Positions (k,), mm, of the magnet on its way out at z_s = 10 mm, with all currents scaled."""
    protocol = Protocol(axis, h=of.h, scale=scale)
    memory = prepared(of.solver, of.led.history, protocol, 0.4)
    return 1e3 * walk(of.solver, memory, signals, protocol, of.led.parts).shift(axis)


def say(values: Mapping[str, float]) -> None:
    """Print one line for a computed set of values."""
    print("  " + ", ".join(f"{key.split('.')[-1]} {value:.4g}" for key, value in values.items()), flush=True)


def fit(processes: int, history: History, refinement: float, predicted: tuple[str, ...]) -> dict[str, Any]:
    """Fit joint, coercive field and h to Table 6-4, and predict other tables with the fitted values."""
    known = tables()
    found = fit_machine(
        DEVICE,
        UNKNOWNS,
        [BranchReadings(known[FIRST], DEVIATION)],
        [BranchReadings(known[name], DEVIATION) for name in predicted],
        solve=partial(JointedUnit, led=Led(history, refinement=refinement)),
        on_solve=say,
        close=CLOSE,
        workers=processes,
    )
    after = {
        one.name: {"after": one.after.tolist(), "uncertainty": one.uncertainty.tolist()}
        for one in found.tables
    }
    return {
        "history": history,
        "refinement": refinement,
        "values": dict(found.values),
        "deviations": found.deviations,
        "misfit": found.misfit,
        "correlation": found.correlation.tolist(),
        "indistinct": found.indistinct,
        "solves": found.solves,
        "tables": after,
    }


ENDS = {"both ends": ("lower", "upper"), "disk": ("lower",), "upper plate": ("upper",), "none": ()}
"""Ends of the cores with joints -> names of these joints in the device file."""
LEG_ON_Y = "leg on y"


def built(changes: Mapping[str, float], how: str) -> Device:
    """The unit with changed values. how: which ends of the cores have joints, or that the yoke is turned about z so
    that the leg is at +y."""
    device = read_device(DEVICE, dict(changes))
    if how != LEG_ON_Y:
        return device.replace(joints=tuple(joint for joint in device.joints if joint.name in ENDS[how]))
    (yoke,) = (body for body in device.bodies if body.name == "yoke")
    turned = replace(yoke, parts=tuple(_turned(part) for part in yoke.parts))
    return device.replace(bodies=tuple(turned if body is yoke else body for body in device.bodies))


def _turned(part: Any) -> Any:
    """A box, turned by a quarter turn about z."""
    (a, b, c), (x, y, z) = part.shape.size, part.placement.position
    shape = replace(part.shape, size=(b, a, c))
    return replace(part, shape=shape, placement=replace(part.placement, position=(y, -x, z)))


def led(
    changes: dict[str, float], settings: dict[str, Any], how: str, names: tuple[str, ...]
) -> dict[str, Any]:
    """Computed positions of tables, mm, with the level and the largest coil current at each, A."""
    one, known, found = JointedUnit(built(changes, how), Led(**settings)), tables(), {}
    for name in names:
        about = known[name]
        run = one.run(about.axis, about.way, about.n, about.z_s)
        found[name] = {"after": run.shift[1:], "largest": run.largest, "levels": run.levels}
    return found


def computed(
    pool: ProcessPoolExecutor, settings: Mapping[str, "Variant"], refinement: float
) -> dict[str, Any]:
    """Compute variants for Tables 6-4 and 6-6, and for Tables 6-4 to 6-7 without joints or with a turned yoke."""
    waiting = {
        name: pool.submit(
            led,
            changes,
            {"refinement": refinement} | how,
            build,
            (FIRST, *BRANCHES) if build in (LEG_ON_Y, "none") else (FIRST, "Table 6-6"),
        )
        for name, (changes, how, build) in settings.items()
    }
    return {name: future.result() for name, future in waiting.items()}


def show_computed(part: str, found: dict[str, Any]) -> None:
    """Print the RMS deviations of all variants, and the tables of each."""
    names = (FIRST, "Table 6-6")
    print(f"\n{part}: rms of {' and '.join(names)}, mm, of both, and of {BRANCHES[0]} to 6-7", flush=True)
    for name, one in found.items():
        every = [rms(one, BRANCHES)] if set(BRANCHES) <= set(one) else []
        print(row(name, [rms(one, (each,)) for each in names] + [rms(one, names)] + every), flush=True)
    for name, one in found.items():
        print(f"\n{name}")
        show(one, tuple(one), "computed")


def rms(found: dict[str, Any], names: tuple[str, ...]) -> float:
    """Root mean square, mm, of computed less measured positions of tables."""
    known = tables()
    left = [np.subtract(found[name]["after"], known[name].measured) for name in names]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


Variant = tuple[dict[str, float], dict[str, Any], str]
"""Changed keys of the device, settings of the run, and `how` of `built`."""


def variants(best: dict[str, Any]) -> dict[str, Variant]:
    """Other joints, disks and histories at the values of the fit; nothing is fitted again."""
    at, history = dict(best["values"]), {"history": best["history"]}
    double = at | {JOINT: 2 * at[JOINT]}
    found: dict[str, Variant] = {
        "as fitted": (at, history, "both ends"),
        "no joints, no hysteresis": (at | {COERCIVE: 0.0}, history, "none"),
        "joints, no hysteresis": (at | {COERCIVE: 0.0}, history, "both ends"),
        "hysteresis, no joints": (at, history, "none"),
        "the whole gap at the disk": (double, history, "disk"),
        "the whole gap at the upper plate": (double, history, "upper plate"),
        "shims of 0.2 mm at the disk": (at | {LOWER: at[JOINT] + 0.2}, history, "both ends"),
        "disk of 6.35 mm": (at | {"parameters.disk": 6.35}, history, "both ends"),
        "leg of the yoke on +y": (at, history, LEG_ON_Y),
    }
    for other in ("demagnetised", "cycled", "saturated", "shaken"):
        if other != best["history"]:
            found[f"history: {other}"] = (at, {"history": other}, "both ends")
    return found


def numerics(best: dict[str, Any]) -> dict[str, Variant]:
    """Finer meshes, more play cells, more steps."""
    at, history = dict(best["values"]), {"history": best["history"]}
    return {
        "mesh sizes over 0.7": (at, history | {"refinement": 0.7}, "both ends"),
        "11 play cells": (at, history | {"cells": 11}, "both ends"),
        "three steps from signal to signal": (at, history | {"parts": 3}, "both ends"),
    }


@dataclass(frozen=True)
class Reading:
    """An interpretation of the thesis that would change the level: changes of the device, and a scale of all currents.

    depth: additional depth of the magnet, mm. without: name of a body that is left out.
    """

    words: str
    changes: dict[str, float]
    scale: float = 1.0
    depth: float = 0.0
    without: str = ""


READINGS = (
    Reading("as fitted", {}),
    Reading("sensor zero 57 mm below the disk, not 77 (3-1)", {}, depth=-20.0),
    Reading("h = 5 mm", {H: 5.0}),
    Reading("1350 turns (A-3), not 840", {}, scale=1350.0 / 840.0),
    Reading("currents twice those sensed", {}, scale=2.0),
    Reading("a magnet of twice the moment", {"payload.magnet.height_mm": 20.0}),
    Reading("disk of 6.35 mm (3.1)", {"parameters.disk": 6.35}),
    Reading("no centre core", {}, without="centre core"),
    Reading("no joints", {JOINT: 1e-3}),
)
ABOVE = np.array([*hysteresis.UPPER[:2], -0.05])
DEPTHS = np.array([0.0, 5.0, 10.0, 15.0, 20.0])


def level(best: dict[str, Any], reading: Reading) -> dict[str, Any]:
    """Lift over weight at the currents of (7-18), its slope with depth, and positions at signals 0.1 and 0.2."""
    # Some interpretations put the magnet above the box in which the study searches equilibria.
    hysteresis.UPPER = ABOVE
    changes = dict(best["values"]) | reading.changes
    changes[H] += reading.depth
    device = read_device(DEVICE, changes)
    device = device.replace(bodies=tuple(body for body in device.bodies if body.name != reading.without))
    of = JointedUnit(device, Led(best["history"], refinement=best["refinement"]))
    law = lift_law(of, DEPTHS, reading.scale)
    signals = np.array([0.0, 0.1, 0.2])
    places = {axis: places_at(of, axis, signals, reading.scale)[1:] for axis in ("x", "y")}
    return {"shares": law.shares, "slope": law.relative_slope, **places}


def reached(best: dict[str, Any], axis: Axis, sign: float, z_s: float) -> float:
    """Range of the magnet to one side, mm."""
    of = JointedUnit(read_device(DEVICE, best["values"]), Led(best["history"], refinement=best["refinement"]))
    return reach(of, axis, sign, z_s, LARGEST_CURRENT, LARGEST_SIGNAL[axis])


def row(name: str, values: Any) -> str:
    """A line of a table of mm."""
    return f"{name:36s}" + "".join(f"{value:7.2f}" for value in values)


def show(found: dict[str, Any], names: tuple[str, ...], words: str, scale: float = 1.0) -> None:
    """Print tables, computed below measured: on the way out, and back less out."""
    known = tables()
    for name in names:
        about, computed = known[name], np.append(0.0, found[name]["after"])
        count = len(about.signals)
        print(row(f"{name}, signal", about.signals))
        print(row("  measured, out", about.out))
        print(row(f"  {words}, out", computed[:count]))
        if about.back is not None:
            print(row("  measured, back less out", about.back - about.out))
            print(row(f"  {words}, back less out", computed[count - 1 :][::-1] - computed[:count]))
        if "uncertainty" in found[name]:
            print(row("  +- in the order of the run", scale * np.asarray(found[name]["uncertainty"])))


def show_fit(one: dict[str, Any]) -> None:
    """Print the values of a fit, with errors scaled by its misfit."""
    scale = max(1.0, one["misfit"])
    words = [
        f"{key.split('.')[-1]} {value:.3g} +- {scale * one['deviations'][key]:.2g}"
        for key, value in one["values"].items()
    ]
    print(
        f"{one['history']}: {'; '.join(words)}; off by {DEVIATION * one['misfit']:.2f} mm rms ({one['solves']} runs)"
    )
    print(f"  correlations {np.round(one['correlation'], 2).tolist()}; not told apart: {one['indistinct']}")


def show_level(found: dict[str, Any]) -> None:
    """Print the interpretations below the measured values."""
    print(
        "\nLift over weight at the currents of (7-18), its slope at 10 mm, places at signals 0.1, 0.2 of x and y, mm"
    )
    print(f"{'z_s, mm':50s}" + "".join(f"{z:7.0f}" for z in DEPTHS) + "   %/mm")
    print(
        f"{'measured':50s}"
        + "   1.00" * len(DEPTHS)
        + f"{100 * 0.0343 / 1.558:7.2f}   1.43   2.95   0.95   1.83"
    )
    for name, one in found.items():
        values = [*one["shares"], one["slope"], *one["x"], *one["y"]]
        print(f"{name:50s}" + "".join(f"{value:7.2f}" for value in values))


def show_limit(found: dict[str, Any]) -> None:
    """Print the signal at which a coil reaches the amplifier's limit."""
    for name, one in found.items():
        signals, largest = tables()[name].signals, one["largest"]
        k = int(np.clip(np.searchsorted(largest, LARGEST_CURRENT), 1, len(signals) - 1))
        share = (LARGEST_CURRENT - largest[k - 1]) / (largest[k] - largest[k - 1])
        print(
            f"{name}: {LARGEST_CURRENT:g} A at signal {signals[k - 1] + share * (signals[k] - signals[k - 1]):.3f}"
        )


LARGEST_SIGNAL = {"x": 0.45, "y": 0.5}
REACHES: dict[str, tuple[float, Axis, float]] = {
    "x at z_s = 11.5 mm": (20.0, "x", 11.5),
    "y at z_s = 11.5 mm": (22.0, "y", 11.5),
    "x at z_s = 18 mm": (10.0, "x", 18.0),
    "y at z_s = 18 mm": (14.0, "y", 18.0),
}
"""Ranges of 7.2.3, mm, with their axes and depths."""


def reaches(pool: ProcessPoolExecutor, best: dict[str, Any]) -> dict[str, Any]:
    """Compute both sides of every range."""
    waiting = {
        name: [pool.submit(reached, best, axis, sign, z_s) for sign in (1.0, -1.0)]
        for name, (_, axis, z_s) in REACHES.items()
    }
    return {name: [one.result() for one in each] for name, each in waiting.items()}


def show_reach(found: dict[str, Any]) -> None:
    """Print the computed ranges and the ranges of 7.2.3."""
    print("\nRange, mm, to both sides and together; 7.2.3 in brackets")
    for name, sides in found.items():
        measured = REACHES[name][0]
        print(f"{name:25s}{sides[0]:7.1f}{-sides[1]:7.1f}{sum(sides):7.1f} ({measured:g})")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--history", choices=tuple(HISTORIES), default="shaken")
    parser.add_argument("--part", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument(
        "--refinement", type=float, default=REFINEMENT, help="divides the mesh sizes of the file"
    )
    parser.add_argument("--json", type=Path, help="file for what was found")
    options = parser.parse_args()
    started = time.time()
    with ProcessPoolExecutor(options.processes, multiprocessing.get_context("spawn")) as pool:
        best = fit(options.processes, options.history, options.refinement, BRANCHES)
        found: dict[str, Any] = {"fit": best}
        print(f"\nFitted to {FIRST}, {time.time() - started:.0f} s")
        show_fit(best)
        show(best["tables"], (FIRST,), "fitted")
        scale = max(1.0, best["misfit"])
        print(f"\nPredicted; +- from the errors of the fit, times its misfit of {scale:.1f}")
        show(best["tables"], BRANCHES, "predicted", scale)
        # Rounded as in the shipped device.
        best["values"] = {key: float(f"{value:.3g}") for key, value in best["values"].items()}
        how = {"history": best["history"], "refinement": best["refinement"]}
        single = [pool.submit(led, best["values"], how, "both ends", (name,)) for name in SINGLE]
        found["single"] = {name: one for future in single for name, one in future.result().items()}
        show(found["single"], SINGLE, "predicted")
        show_limit(found["single"])
        print(f"off by {rms(best['tables'], BRANCHES):.2f} mm rms in Tables 6-5 to 6-7", flush=True)
        for part, made in (("variants", variants), ("numerics", numerics)):
            if part in options.part:
                found[part] = computed(pool, made(best), options.refinement)
                show_computed(part, found[part])
        if "level" in options.part:
            every = list(pool.map(level, [best] * len(READINGS), READINGS))
            found["level"] = {reading.words: one for reading, one in zip(READINGS, every, strict=True)}
            show_level(found["level"])
        if "reach" in options.part:
            found["reach"] = reaches(pool, best)
            show_reach(found["reach"])
    print(f"{time.time() - started:.0f} s")
    if options.json:
        options.json.write_text(
            json.dumps(found, indent=1, default=lambda value: np.asarray(value).tolist()) + "\n"
        )


if __name__ == "__main__":
    main()

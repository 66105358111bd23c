"""Does the hysteresis that was fitted to Table 6-4 of the thesis predict its dynamic tables?

    python scripts/studies/remembering_study.py [--only gains tables branches] [--map maps/out/remembering.h5]

The map of maps/remembering.toml is used with its memory and without (the same model, its cells taken away). gains: how
far the magnet goes and how much more it is pulled, by the size of a loop of a signal. tables: the shipped scenarios of
chapters 6 and 7 with both. branches: Tables 6-4 to 6-7 by the map and by the full solver. Prints figures, not
verdicts; docs/remembering_study.md reads them.
"""

import argparse
import os
from collections.abc import Iterator

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from dataclasses import replace  # noqa: E402

import numpy as np  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.table import Table  # noqa: E402
from scipy.optimize import fsolve  # noqa: E402

import fieldmap as fm  # noqa: E402
from fieldmap.dynamics.scenario import simulate_batches  # noqa: E402
from fieldmap.iron import HysteresisSolver  # noqa: E402
from fieldmap.lookup import FieldMap, interpolate  # noqa: E402
from fieldmap.store import read_map  # noqa: E402
from fieldmap.thesis.equilibrium_shift import divided  # noqa: E402
from fieldmap.thesis.hysteresis import Protocol, prepared, walk  # noqa: E402
from fieldmap.thesis.printed import read_part  # noqa: E402

DEVICE, REFINEMENT = "drive_unit_joints", 0.4
SCALE = 2.13
"""Of the force: with it the map carries the body 10 mm deep with the 1.558 A of (7-18), as in docs/thesis_dynamics.md
the map of the unit without joints with 2.1."""
AMPLITUDES = (0.005, 0.02, 0.05, 0.1, 0.2)
LEVEL_LOOPS = (0.001, 0.006, 0.02, 0.06, 0.12)
# Of the experiments: scenario, changes, axes under PID control, axis of the step, and what the rig did.
EXPERIMENTS = (
    ("Table 7-1", "vertical_step", {}, "z", 2, "overshoot 50 %, peak 0.2 s, rise 0.102 s"),
    ("Table 7-2, x", "horizontal_pid", {}, "xyz", 0, "overshoot 0 %, rise 0.7 s"),
    ("Table 7-2, y", "horizontal_pid", {"reference.0.axis": "y"}, "xyz", 1, "overshoot 0 %, rise 0.9 s"),
)
NOISE = {"as Table 3-8": None, "a fifth": 0.2, "none": 0.0}
DEVIATION = np.array([0.00542, 0.00838, 0.0104])


def without_memory(path: str) -> FieldMap:
    """The map with the same model of the iron, whose cells are taken away: it follows the anhysteretic law."""
    data = read_map(path)
    assert data.reduced_model is not None
    model = replace(data.reduced_model, pinning=np.zeros((0, 0)), shares=np.zeros(0))
    return interpolate(replace(data, reduced_model=model), outside_currents="evaluate")


def gains(both: dict[str, FieldMap], console: Console) -> None:
    """Slopes between the ends of the second of two loops of each size, after the history "shaken"."""
    protocol = Protocol("x", h=1e3 * fm.read_device(DEVICE).payload.magnet_offset)
    for axis in "xy":
        table = Table("loop of the signal", *both, title=f"{axis} of the magnet, mm per unit of its signal")
        for size in AMPLITUDES:
            row = []
            for opened in both.values():
                places = np.array(list(_loop(opened, replace(protocol, axis=axis), size)))
                row.append(f"{1e3 * (places[6] - places[8]) / (2.0 * size):.1f}")
            table.add_row(f"+- {size:g}", *row)
        console.print(table)
    table = Table("loop of all currents", *both, title="d ln(lift) / d ln(current)")
    for share in LEVEL_LOOPS:
        row = []
        for opened in both.values():
            levels = protocol.level * (1.0 + share * np.array([1.0, -1.0, 1.0, -1.0]))
            lifts = [
                _pull(opened, point, currents)[2]
                for opened, point, currents in _steps(opened, levels, protocol)
            ]
            row.append(f"{np.log(lifts[3] / lifts[2]) / np.log(levels[3] / levels[2]):.3f}")
        table.add_row(f"+- {100 * share:g} %", *row)
    console.print(table)


def _steps(
    opened: FieldMap, levels: np.ndarray, protocol: Protocol
) -> Iterator[tuple[FieldMap, np.ndarray, np.ndarray]]:
    memory, point = _begun(opened, protocol), np.array([0.0, 0.0, protocol.height])
    for level in levels:
        currents = np.full(6, level)
        memory = memory.step(currents) if memory.remembers else memory
        yield memory, point, currents


def _begun(opened: FieldMap, protocol: Protocol) -> FieldMap:
    return opened.memory("shaken", protocol.level) if opened.remembers else opened


def _pull(field: FieldMap, point: np.ndarray, currents: np.ndarray) -> np.ndarray:
    """Force on an upright moment of 1 A m^2."""
    return field.gradient(point, currents)[2]


def _rest(field: FieldMap, currents: np.ndarray, height: float, near: np.ndarray) -> np.ndarray:
    """Where an upright magnet is not pulled aside (2,), m."""

    def aside(place: np.ndarray) -> np.ndarray:
        return _pull(field, np.array([*place, height]), currents)[:2]

    found: np.ndarray = fsolve(aside, near, xtol=1e-7)
    return found


def _loop(opened: FieldMap, protocol: Protocol, size: float) -> Iterator[float]:
    memory, place, axis = _begun(opened, protocol), np.zeros(2), "xy".index(protocol.axis)
    for signal in size * np.array([0.5, 1.0, 0.0, -1.0, 0.0, 0.5, 1.0, 0.0, -1.0]):
        currents = protocol.currents(protocol.level, float(signal))
        memory = memory.step(currents) if memory.remembers else memory
        place = _rest(memory, currents, protocol.height, place)
        yield float(place[axis])


def tables(both: dict[str, FieldMap], console: Console) -> None:
    """The shipped scenarios on both, by the noise of the sensors and by what the controllers differentiate."""
    table = Table(
        "experiment", "rig", "iron", "derivative of", "noise", "overshoot, %", "rise, s", "peak, s", "rms, mm"
    )
    for title, scenario, changes, controlled, axis, rig in EXPERIMENTS:
        for name, opened in both.items():
            for derivative in ("error", "measurement"):
                more = {f"control.{one}.derivative": derivative for one in controlled}
                for noise, share in NOISE.items():
                    given = {"device": DEVICE, "field.scale": SCALE, **changes, **more}
                    if share is not None:
                        given["sensors.deviation_mm"] = (share * DEVIATION).tolist()
                    simulation = simulate_batches(scenario, lambda opened=opened: opened, given, runs=4)
                    steps = [run.metrics.axes[axis].step for run in simulation.batches[0].runs]
                    numbers = [
                        [100.0 * step.overshoot for step in steps],
                        [step.rise_time for step in steps],
                        [step.peak_time for step in steps],
                        [step.steady_rms for step in steps],
                    ]
                    words = [f"{np.nanmean(np.array(each, float)):.3g}" for each in numbers]
                    table.add_row(title, rig, name, derivative, noise, *words)
    console.print(table)


def branches(opened: FieldMap, console: Console) -> None:
    """Places along Tables 6-4 to 6-7 with the lift held: map, full solver, largest difference."""
    device = fm.read_device(DEVICE)
    solver = HysteresisSolver(device, None, REFINEMENT)
    table = Table(
        "table", "largest difference, mm", "largest shift, mm", title="branches by map and full solver"
    )
    for number, (axis, side) in enumerate((a, s) for a in "xy" for s in ("positive", "negative")):
        signals = read_part(f"S14_{axis}_branches").inputs[f"{side}_signals"]
        signals = np.concatenate([signals, signals[-2::-1]])
        protocol = Protocol(axis, h=1e3 * device.payload.magnet_offset)
        full = walk(solver, prepared(solver, "shaken", protocol, 0.4), signals, protocol)
        along = np.array(list(_walked(opened, signals, protocol)))[:, "xy".index(axis)]
        difference = 1e3 * np.abs((along - along[0]) - full.shift(axis)).max()
        table.add_row(f"6-{4 + number}", f"{difference:.3f}", f"{1e3 * np.abs(full.shift(axis)).max():.2f}")
    console.print(table)


def _walked(opened: FieldMap, signals: np.ndarray, protocol: Protocol) -> Iterator[np.ndarray]:
    """Places (2,) at signals, the level such that the lift stays that at the first."""
    memory, known, lift = _begun(opened, protocol), np.array([0.0, 0.0, protocol.level]), np.nan
    for signal in signals:
        known = fsolve(_left, known, (memory, float(signal), protocol, lift), xtol=1e-7)
        currents = divided(known[2], float(signal), protocol.axis, protocol.n)
        if np.isnan(lift):
            lift = _pull(memory, np.array([*known[:2], protocol.height]), currents)[2]
        memory = memory.step(currents)
        yield known[:2]


def _left(
    unknowns: np.ndarray, memory: FieldMap, signal: float, protocol: Protocol, lift: float
) -> np.ndarray:
    """Pull aside, and what the lift is off, or the level from that of the protocol where no lift is known."""
    currents = divided(unknowns[2], signal, protocol.axis, protocol.n)
    pull = _pull(memory, np.array([*unknowns[:2], protocol.height]), currents)
    return np.array([*pull[:2], unknowns[2] - protocol.level if np.isnan(lift) else pull[2] - lift])


def main() -> None:
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=["gains", "tables", "branches"])
    parser.add_argument("--map", default="maps/out/remembering.h5")
    given = parser.parse_args()
    wanted, console = given.only or ["gains", "tables", "branches"], Console(width=150)
    opened = fm.open_map(given.map, outside_currents="evaluate")
    both = {"with memory": opened, "without": without_memory(given.map)}
    if "gains" in wanted:
        gains(both, console)
    if "tables" in wanted:
        tables(both, console)
    if "branches" in wanted:
        branches(opened, console)


if __name__ == "__main__":
    main()

"""Do remanent loops of iron explain the two branches of the thesis's Tables 6-4 to 6-7?

    python scripts/studies/hysteresis_study.py [--axis x] [--coercive 0 50 100 200 400] [--history demagnetised ...]

Leads the drive unit's currents through the signals of the tables, out and back, with iron of several coercive fields
and histories, and prints computed and measured positions. One run of 17 signals takes about half a minute of processor
time at refinement 0.5 with a constant level, and twice as long with the lift held. docs/hysteresis_study.md discusses
the figures.
"""

import argparse
import json
import os

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import time  # noqa: E402
from dataclasses import dataclass  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from fieldmap.device import read_device  # noqa: E402
from fieldmap.iron.solvers.hysteresis import HysteresisSolver, Pinning  # noqa: E402
from fieldmap.thesis.hysteresis import HISTORIES, Protocol, prepared, walk  # noqa: E402
from fieldmap.thesis.printed import read_part  # noqa: E402


@dataclass(frozen=True)
class Measured:
    """Signals and positions, mm, of one table: out and back, both in the order of rising size of the signal."""

    table: str
    signals: np.ndarray
    out: np.ndarray
    back: np.ndarray


def measured(axis: str, side: str, every: int) -> Measured:
    """One of Tables 6-4 to 6-7, with every `every`-th signal."""
    inputs = read_part(f"S14_{axis}_branches").inputs
    signals, out, back = (inputs[f"{side}_{what}"][::every] for what in ("signals", "outward_mm", "back_mm"))
    number = {("x", "positive"): 4, ("x", "negative"): 5, ("y", "positive"): 6, ("y", "negative"): 7}[
        axis, side
    ]
    return Measured(f"Table 6-{number}", signals, out, back)


def run(solver: HysteresisSolver, history: str, table: Measured, protocol: Protocol, parts: int) -> dict:
    """One run: positions, mm, relative to the position at the first signal."""
    started = time.process_time()
    signals = np.concatenate([table.signals, table.signals[-2::-1]])
    memory = prepared(solver, history, protocol, float(table.signals[-1]))
    found = walk(solver, memory, signals, protocol, parts)
    shift, count = 1e3 * found.shift(protocol.axis), len(table.signals)
    return {
        "table": table.table, "coercive_A_per_m": solver.pinning.coercive_field, "cells": solver.pinning.cells,
        "history": history, "rule": protocol.rule, "h_mm": protocol.h, "faces": len(solver.surface.areas),
        "parts": parts, "signals": table.signals.tolist(), "out_mm": shift[:count].tolist(),
        "back_mm": shift[count - 1 :][::-1].tolist(),
        "start_mm": (1e3 * found.places[0]).tolist(), "levels_A": found.levels.tolist(),
        "seconds": time.process_time() - started,
    }  # fmt: skip


def show_loops(solver: HysteresisSolver, table: Measured, protocol: Protocol) -> None:
    """Print the flux through opposite cores and the lateral force on the magnet, at a constant level, out and back."""
    memory = prepared(solver, "demagnetised", protocol, float(table.signals[-1]))
    print(
        f"Hc {solver.pinning.coercive_field:g} A/m, constant level: signal, mean Bz of cores 5 and 2 in T, "
        "dBz/dx on the axis"
    )
    for signal in np.concatenate([table.signals, table.signals[-2::-1]]):
        state = solver.step(protocol.currents(protocol.level, float(signal)), memory)
        memory = state.memory
        cores = (state.flux_density(f"core {name}")[2] for name in (5, 2))
        push = 1e3 * state.gradient([0.0, 0.0, protocol.height])[2, 0]
        print(f"{signal:8.2f}" + "".join(f"{b:8.2f}" for b in cores) + f"{push:8.2f} mT/m", flush=True)


def row(name: str, values: np.ndarray) -> str:
    """A line of a table of mm."""
    return f"{name:38s}" + "".join(f"{value:8.2f}" for value in values)


def show(table: Measured, runs: list[dict]) -> None:
    """Print the table, and every run below it: out, and back less out."""
    print(f"\n{table.table}, mm, counted from where the run began")
    print(row("signal", table.signals))
    print(row("measured, out", table.out - table.out[0]))
    print(row("measured, back - out", table.back - table.out))
    for of in runs:
        name = f"Hc {of['coercive_A_per_m']:g} A/m, {of['history']}, {of['rule']}"
        print(row(f"{name}, out", np.array(of["out_mm"])))
        print(row(" " * 20 + "back - out", np.array(of["back_mm"]) - np.array(of["out_mm"])))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--axis", choices=("x", "y"), default="x")
    parser.add_argument("--side", choices=("positive", "negative"), default="positive")
    parser.add_argument(
        "--coercive", type=float, nargs="+", default=[0.0, 50.0, 100.0, 200.0, 400.0], help="A/m"
    )
    parser.add_argument("--history", choices=tuple(HISTORIES), nargs="+", default=["demagnetised"])
    parser.add_argument("--rule", choices=("held", "constant"), default="held", help="of the current level")
    parser.add_argument("--offset", type=float, default=15.0, help="h, mm: the magnet below the point read")
    parser.add_argument("--every", type=int, default=1, help="take every so many of the signals")
    parser.add_argument("--cells", type=int, default=6, help="pinning fields")
    parser.add_argument("--parts", type=int, default=1, help="steps of the iron from signal to signal")
    parser.add_argument(
        "--refinement", type=float, default=0.5, help="divides the mesh sizes of the device file"
    )
    parser.add_argument("--device", default="drive_unit")
    parser.add_argument(
        "--loops", action="store_true", help="show the flux in opposite cores in the place of runs"
    )
    parser.add_argument("--json", type=Path, help="file to which every run is appended, one a line")
    options = parser.parse_args()
    table = measured(options.axis, options.side, options.every)
    protocol = Protocol(options.axis, h=options.offset, rule=options.rule)
    base = HysteresisSolver(read_device(options.device), refinement=options.refinement)
    print(f"{options.device}: {len(base.surface.areas)} faces; level {protocol.level:.3f} A at the origin")
    runs = []
    for coercive in options.coercive:
        pinning = Pinning(coercive, options.cells)
        if options.loops:
            show_loops(base.with_pinning(pinning), table, protocol)
            continue
        for history in options.history:
            runs.append(run(base.with_pinning(pinning), history, table, protocol, options.parts))
            runs[-1]["device"] = options.device
            print(
                f"{pinning.assumption}; {history}: {HISTORIES[history]}; {runs[-1]['seconds']:.0f} s",
                flush=True,
            )
            if options.json:
                with options.json.open("a") as file:
                    file.write(json.dumps(runs[-1]) + "\n")
    if runs:
        show(table, runs)


if __name__ == "__main__":
    main()

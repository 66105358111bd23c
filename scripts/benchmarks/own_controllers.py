"""Samples per second of a user's own controller in Python, numba and C, of the shipped PID, and of a loop by hand.

The machine is that of `benchmarks.dynamics`: linear iron, six coils, noise and windings; all forms are one PID on the
height. Measured twice: with mechanical steps of 0.1 ms at a period of 2 ms, where the mechanics dominates, and with one
mechanical step per sample. Times are processor seconds, the least of several runs, in which the forms take turns.
"""

import ctypes
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.dynamics import NAN, machines
from fieldmap.control import PID, FunctionController
from fieldmap.dynamics import (
    AxisReading,
    RunningMachine,
    Schedule,
    constant_block,
    find_operating_point,
    pid_block,
    simulate_closed_loop,
    stacked,
)

KC, TI, TD = 0.334, 0.42, 0.06


@dataclass(frozen=True)
class Row:
    """One form of the controller: samples per second with 20 mechanical steps per sample and with one."""

    what: str
    samples_per_second: float
    of_one_step: float


def pid(output: float, ts: float) -> Callable[..., Any]:
    """The PID as a Python function."""
    kp, ki, kd = KC, KC * ts / TI, KC * TD / ts

    def control(time, measured, reference, state):  # type: ignore[no-untyped-def]
        error = 1e3 * (measured[2] - reference[2])
        state[0] += ki * error
        wanted = output - kp * error - state[0] - kd * (error - state[1])
        state[1] = error
        return wanted, 0.0, 0.0

    return control


C_TEXT = """
int control(double time, const double *measured, const double *reference, double *state, double *outputs)
{{
    double error = 1e3 * (measured[2] - reference[2]);
    state[0] += {ki!r} * error;
    outputs[0] = {output!r} - {kp!r} * error - state[0] - {kd!r} * (error - state[1]);
    outputs[1] = outputs[2] = 0.0;
    state[1] = error;
    return 0;
}}
"""


def compiled(output: float, ts: float, folder: Path) -> Any:
    """The PID as a C function; None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    text = C_TEXT.format(ki=KC * ts / TI, kp=KC, kd=KC * TD / ts, output=output)
    source, library = folder / f"pid_{ts:g}.c", folder / f"pid_{ts:g}.so"
    source.write_text(text)
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", library, source], check=True)
    return ctypes.CDLL(str(library)).control


def forms(output: float, at: np.ndarray, ts: float, folder: Path) -> dict[str, Any]:
    """The controllers by name."""
    python, still = pid(output, ts), constant_block(0.0)
    shipped = PID(KC, TI, TD, ts, 0.0, 10.0, acts_on_minus_error=True)
    around: dict[str, Any] = {"state": 2, "lower": [0.0, -1.0, -1.0], "upper": [10.0, 1.0, 1.0]}

    found = {
        "shipped PID": stacked(pid_block(shipped, AxisReading("z", -1e3, -77.0), output, at), still, still),
        "numba function": FunctionController(numba.njit(python), **around),
        "Python function": FunctionController(python, **around),
        "by hand: machine.step": python,
    }
    in_c = compiled(output, ts, folder)
    if in_c is not None:
        found["C function"] = FunctionController(in_c, **around)
    return found


def seconds_per_sample(
    machine: Any, rest: Any, ts: float, samples: int, repeats: int, folder: Path
) -> dict[str, float]:
    """Processor seconds per sample of each form, the least of some runs."""
    schedule = Schedule(np.tile(rest.sensed, (samples, 1)), ts, 1e-4, delay=0.0)
    at = np.concatenate([rest.sensed, rest.sensed, [1.0]])
    found = forms(float(rest.outputs[0]), at, ts, folder)
    best = dict.fromkeys(found, np.inf)
    for turn in range(repeats + 1):
        for name, controller in found.items():
            begin = time.process_time()
            if callable(controller):
                hand, state = RunningMachine(machine, schedule, rest.state, rest.currents, 0), np.zeros(2)
                for _ in range(samples):
                    hand.step(controller(hand.time, hand.measured, hand.reference, state))
            else:
                simulate_closed_loop(machine, controller, schedule, rest.state, rest.currents, 0)
            if turn:
                best[name] = min(best[name], (time.process_time() - begin) / samples)
    return best


def measure(quick: bool) -> dict[str, Any]:
    """Rows of all forms."""
    machine = machines()["linear or linearised iron"]
    rest = find_operating_point(machine, [NAN, NAN, -0.087], [NAN, 0.0, 0.0], [4.0, 0.0, 0.0])
    count, repeats = (500, 2) if quick else (5000, 5)
    with tempfile.TemporaryDirectory() as folder:
        slow = seconds_per_sample(machine, rest, 2e-3, count, repeats, Path(folder))
        fast = seconds_per_sample(machine, rest, 1e-4, count, repeats, Path(folder))
    rows = [Row(name, 1 / slow[name], 1 / fast[name]) for name in slow]
    return {"rows": [asdict(row) for row in rows]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the rows."""
    table = Table("controller", "samples/s, 20 steps each", "samples/s, 1 step each")
    for row in result["rows"]:
        table.add_row(row["what"], f"{row['samples_per_second']:,.0f}", f"{row['of_one_step']:,.0f}")
    console.print(table)

"""Controller steps per second on one core: compiled loops with plant and instruments, and one Python call per sample.

Times are medians of processor seconds, so that a busy machine matters less. A step of a loop includes the whole sample:
sensor, converter, controller, drive, plant. The plant is the vertical plant of the thesis, (5-17).
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from fieldmap import control
from fieldmap.instruments import Amplifier, Converter, Micrometer, Rig, draw_noise, loop_instruments

TS = 2e-3
WANTED = 1e6


@dataclass(frozen=True)
class Row:
    """One way to run a controller."""

    what: str
    steps: int
    ns_per_step: float
    steps_per_second: float


def plant() -> control.TransferFunction:
    """(5-17), in metres and volts."""
    return control.from_roots(-0.03e-3, [0.9935], [1.01, 0.905])


def regulator() -> control.Regulator:
    """(7-12)..(7-17), for the plant in metres."""
    model = control.controller_form(*control.continuous(plant(), TS))
    wide = control.with_output_integral(model.A, model.B, 1e3 * model.C)
    Q = np.array([[5000, 796.64, 0], [796.64, 5000, 0], [0, 0, 10000]])
    k = control.lqrd(wide.A, wide.B, Q, 1e-10, TS) * [1.0, 1.0, 1e3]
    estimator = control.kalmd(model.A, model.B, model.C, 4e-4, 4e-10, TS)
    return control.Regulator(k, estimator, TS, equilibrium=(0.0, 4871.8), equilibrium_at="measured")


def rig() -> Rig:
    """The thesis's sensor and cards; the plant takes volts, so the amplifier's gain is 1 A/V."""
    card = Converter(range=10.0, bits=16, random_noise=280e-6)
    sensor = Micrometer(zero=0.020, scale=2e-3, voltage_step=5e-3, deviation=10.4e-6)
    return Rig(sensor, card, card, Amplifier(gain=1.0))


def ways(runs: int, samples: int) -> list[tuple[str, int, Callable[[], Any]]]:
    """Name, number of steps, and function to time, for each way."""
    pid = control.PID(334.0, 0.007, 0.001, TS, integration="trapezoidal", acts_on_minus_error=True)
    step = np.full(samples, 1e-4)
    noise = draw_noise(rig(), np.random.default_rng(1), (runs, samples))
    signals = {
        "runs": runs,
        "position_noise": noise.position,
        "voltage_noise": noise.voltage,
        "instruments": loop_instruments(rig(), position=0.010, output=4.4),
    }
    running, few = control.RunningPID(pid), min(samples, 1000)
    seen = np.zeros(runs * samples)
    return [
        ("PID alone, compiled", seen.size, lambda: control.run_pid(pid, 1e-4, seen)),
        ("PID, plant", seen.size, lambda: control.simulate_loop(plant(), pid, step, runs=runs)),
        (
            "PID, plant, instruments with noise",
            seen.size,
            lambda: control.simulate_loop(plant(), pid, step, **signals),
        ),
        (
            "LQR and Kalman filter, plant, instruments with noise",
            seen.size,
            lambda: control.simulate_loop(plant(), regulator(), step, **signals),
        ),
        ("PID, one Python call a sample", few, lambda: [running.step(0.0, 0.0) for _ in range(few)]),
    ]


def measure(quick: bool) -> dict[str, Any]:
    """Measure all rows, after compilation."""
    runs, samples, repetitions = (2, 100, 1) if quick else (500, 2000, 7)
    for _, _, work in ways(1, 10):
        work()
    rows = []
    for what, steps, work in ways(runs, samples):
        seconds = []
        for _ in range(repetitions):
            start = time.process_time()
            work()
            seconds.append(time.process_time() - start)
        each = max(statistics.median(seconds), 1e-9) / steps
        rows.append(asdict(Row(what, steps, 1e9 * each, 1.0 / each)))
    return {"runs": runs, "samples": samples, "repetitions": repetitions, "rows": rows}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        caption=f"controllers: processor time on one core, median of {result['repetitions']}, "
        f"{result['runs']} runs of {result['samples']} samples; wanted: {WANTED:.0e} steps per second, compiled"
    )
    table.add_column("controller")
    for heading in ("ns per step", "steps per second"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        table.add_row(row["what"], f"{row['ns_per_step']:.1f}", f"{row['steps_per_second']:.2e}")
    console.print(table)

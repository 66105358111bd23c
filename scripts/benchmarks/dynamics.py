"""Speed of the simulation of a levitated magnet on one core, relative to real time, and time of a thousand runs.

Closed loop in six degrees of freedom: PID every 2 ms, mechanics every 0.1 ms, coils with R and L, noise of sensors and
currents, crossed sensors, 16-bit converter. Times are processor seconds, so that a busy machine matters less. The map,
made up in harmonic form, has the size of the drive unit: six fields of coils, and for the table twenty fields of iron.
"""

import os
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from fieldmap.control import PID
from fieldmap.core.current_table import CoreTable
from fieldmap.currents import LiftAndDirections, divide_currents
from fieldmap.device import read_device
from fieldmap.dynamics import (
    AxisReading,
    Drag,
    Machine,
    Plate,
    Schedule,
    Sensors,
    body_of_payload,
    constant_block,
    drive_of_device,
    find_operating_point,
    lift_and_directions,
    pid_block,
    simulate_closed_loop,
    simulate_many,
    stacked,
    superposed,
)
from fieldmap.dynamics.field_of_currents import FieldOfCurrents
from fieldmap.instruments import SensorFrame
from fieldmap.lookup import FieldMap, interpolate, unit_block, volume_rule
from fieldmap.lookup.current_table import spline_table
from fieldmap.store import Grid, MapData

LOWER, UPPER = np.array([-0.02, -0.02, -0.14]), np.array([0.02, 0.02, -0.076])
WANTED, RUNS_WANTED = 100.0, 60.0
NAN = np.nan


@dataclass(frozen=True)
class Row:
    """One kind of run."""

    what: str
    times_real_time: float
    us_per_step: float


def dipoles(moments: np.ndarray, sources: np.ndarray) -> FieldMap:
    """A map of vertical dipoles (n,) A m^2 per ampere at sources (n, 3)."""
    cells = np.array([10, 10, 16])
    grid = Grid(LOWER, (UPPER - LOWER) / cells, tuple(cells + 1))
    points = grid.points()
    flux, slope = [], []
    for moment, source in zip(moments, sources, strict=True):
        r = points - source
        d = np.linalg.norm(r, axis=1)[:, None]
        m = np.array([0.0, 0.0, moment])
        flux.append(1e-7 * (3 * (r @ m)[:, None] * r / d**5 - m / d**3))
        along, d2 = (r @ m)[:, None, None], (d**2)[:, :, None]
        outer = m[:, None] * r[:, None, :] + m * r[:, :, None]
        slope.append(
            3e-7 * (outer + along * np.eye(3) - 5 * along * r[:, :, None] * r[:, None, :] / d2) / d2**2.5
        )
    n = len(moments)
    data = MapData(
        grid,
        tuple(f"{k}" for k in range(n)),
        np.ones(n),
        flux_density=np.array(flux).reshape(n, *grid.shape, 3),
        gradient=np.array(slope).reshape(n, *grid.shape, 3, 3),
    )
    return interpolate(data)


def fields() -> dict[str, FieldOfCurrents]:
    """Linear iron, and a table of saturating iron whose twenty fields are in proportion to the currents."""
    angles = np.deg2rad([240.0, 180.0, 120.0, 300.0, 0.0, 60.0])
    coils = np.column_stack([0.044 * np.cos(angles), 0.044 * np.sin(angles), np.full(6, 0.026)])
    linear = superposed(dipoles(np.full(6, 8.0), coils))
    turn = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    iron = np.column_stack([0.05 * np.cos(turn), 0.05 * np.sin(turn), np.full(20, 0.01)])
    both = dipoles(np.concatenate([np.full(6, 4.0), np.full(20, 1.0)]), np.concatenate([coils, iron]))
    share = np.cos(turn[:, None] - angles) * 0.3 + 1.0 / 6.0
    axes = [np.linspace(0.5, 2.9, 5), np.linspace(-0.4, 0.4, 17), np.linspace(-0.3, 0.3, 17)]
    currents = divide_currents(*np.meshgrid(*axes, indexing="ij"), 1.25)
    slopes = np.broadcast_to(share.T, (5, 17, 17, 6, 20))
    table = CoreTable(spline_table(axes, LiftAndDirections(1.25), currents @ share.T, slopes))
    return {"linear": linear, "table": FieldOfCurrents(unit_block(both), (), both, table=table, iron="table")}


def machines() -> dict[str, Machine]:
    """The machines, by name."""
    device = read_device("drive_unit")
    seeing = Sensors(SensorFrame(np.pi / 4, 0.026), deviations=(5.42e-6, 8.38e-6, 1.04e-5))
    drag = Drag((0.3, 0.3, 0.5), turning=(1e-5,) * 3)
    around = (drive_of_device(device), seeing, lift_and_directions(1.25), drag)
    found = fields()
    payload = device.payload
    assert payload is not None
    assert payload.magnet is not None
    point = body_of_payload(payload, radius=5.9e-3, height=0.025)
    finite = body_of_payload(payload, radius=5.9e-3, height=0.025, magnet=volume_rule(payload.magnet, 2))
    block = Plate(3.5e7, 0.05, (0.0, 0.0, -0.112))
    return {
        "linear or linearised iron": Machine(found["linear"], point, *around),
        "and a conducting plate": Machine(found["linear"], point, *around, plate=block),
        "and a magnet of 8 dipoles": Machine(found["linear"], finite, *around),
        "table of saturating iron": Machine(found["table"], point, *around),
    }


def prepared(machine: Machine, seconds: float) -> Any:
    """A function of the seed that makes one run."""
    rest = find_operating_point(machine, [NAN, NAN, -0.087], [NAN, 0.0, 0.0], [4.0, 0.0, 0.0])
    at = np.concatenate([rest.sensed, rest.sensed, [1.0]])
    pid = PID(0.334, 0.42, 0.06, 2e-3, 0.0, 10.0, acts_on_minus_error=True)
    still = constant_block(0.0)
    control = stacked(pid_block(pid, AxisReading("z", -1e3, -77.0), rest.outputs[0], at), still, still)
    schedule = Schedule(np.tile(rest.sensed, (round(seconds / 2e-3), 1)), delay=5e-4)
    return lambda seed: simulate_closed_loop(machine, control, schedule, rest.state, rest.currents, seed)


def measure(quick: bool) -> dict[str, Any]:
    """Rows, and a thousand runs (if quick, a hundred runs and the extrapolated time of a thousand)."""
    rows = []
    seconds, count = 5.0, 2 if quick else 10
    for name, machine in machines().items():
        one = prepared(machine, seconds)
        one(0)
        begin = time.process_time()
        runs = [one(seed) for seed in range(count)]
        spent = time.process_time() - begin
        assert all(run.event is None for run in runs)
        rows.append(asdict(Row(name, count * seconds / spent, 1e6 * spent / (count * seconds / 1e-4))))
    many = 10 if quick else 1000
    threads = min(2, os.cpu_count() or 1)
    one = prepared(machines()["linear or linearised iron"], seconds)
    wall, begin = time.perf_counter(), time.process_time()
    ends = simulate_many(many, one, threads=threads, keep=lambda run: run.event is None)
    spent, wall = time.process_time() - begin, time.perf_counter() - wall
    assert all(ends)
    return {
        "rows": rows,
        "many": {"runs": many, "threads": threads, "processor_seconds": spent, "wall_seconds": wall},
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the rows."""
    table = Table(title="levitated magnet in closed loop, six degrees of freedom, 2 ms and 0.1 ms")
    for name in ("field", "times real time", "us per step of 0.1 ms"):
        table.add_column(name, justify="left" if name == "field" else "right")
    for row in result["rows"]:
        table.add_row(row["what"], f"{row['times_real_time']:.0f}", f"{row['us_per_step']:.2f}")
    console.print(table)
    many = result["many"]
    console.print(
        f"{many['runs']} runs of 5 s on {many['threads']} threads: {many['processor_seconds']:.1f} processor seconds, "
        f"{many['wall_seconds']:.1f} s of the clock"
    )

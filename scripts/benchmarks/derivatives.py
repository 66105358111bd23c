"""Cost of derivatives of a state relative to the state: three numbers (force on a dipole) by more and more keys.

Measured on eight coils, and on the drive unit with a coarser mesh, with linear and with saturating iron. A solve is
mesh, assembly and solution, as for each variant of a device; a state is the solution alone on an assembled mesh. The
first gradient of a linear solution, which assembles its mesh again, is not counted. Times are wall seconds, the least
of two after a warm-up, all in one run.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.iron import DipoleForce, NonlinearSolver, SolvedState

WANTED = 1.5
"""Largest cost of a gradient, in solves."""


@dataclass(frozen=True)
class Row:
    """One set of keys: seconds of a whole solve, of a state on an assembled mesh, and of the gradient; cost of the
    gradient in solves."""

    device: str
    iron: str
    keys: str
    count: int
    solve: float
    state: float
    gradient: float
    in_solves: float


def _seconds(work: Callable[[], object], repeats: int) -> float:
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def _sets(device: fm.Device) -> dict[str, list[str]]:
    """Sets of keys of a device, as in its written-out file."""
    names = device.coil_names
    currents = [f"current.{name}" for name in names]
    turns = [f"coil.{name}.turns" for name in names]
    places = [f"coil.{name}.position_mm.{axis}" for name in names for axis in (1, 2, 3)]
    laws = []
    for name, material in device.materials.items():
        if isinstance(material, fm.BHTable):
            laws += [f"material.{name}.B_T.{k + 1}" for k in range(len(material.b))]
        else:
            laws.append(f"material.{name}.mu_r")
    return {
        "one current": currents[:1],
        "currents, turns and laws": [*currents, *turns, *laws],
        "these and places of the coils": [*currents, *turns, *laws, *places],
    }


def measure(quick: bool) -> dict[str, Any]:
    """Rows, JSON-ready."""
    cases = [("eight_coils", 0.5)] if quick else [("eight_coils", 1.0), ("drive_unit", 0.7)]
    rows = [asdict(row) for name, refinement in cases for row in _rows(name, refinement, 1 if quick else 2)]
    return {"rows": rows}


def _rows(name: str, refinement: float, repeats: int) -> Iterator[Row]:
    shipped = fm.read_device(name)
    device = fm.read_device(shipped.to_toml())
    amperes = [1.5] * len(device.coils)
    assert device.bounds is not None
    force = DipoleForce(0.5 * (device.bounds[0] + device.bounds[1]), [0.0, 0.0, 8.0])
    sets = _sets(device)
    if name == "eight_coils":  # its cores touch nothing
        numbers = ("radius_mm", "height_mm", "position_mm.1", "position_mm.2", "position_mm.3")
        shapes = [f"body.{body.name}.{number}" for body in device.bodies for number in numbers]
        sets |= {f"shapes and places of cores, {n}": shapes[:n] for n in (1, 10, 30)}
        sets["all of these"] = [*sets["these and places of the coils"], *shapes]
    for iron in ("linear", "saturating"):
        alone = float("nan")
        if iron == "linear":
            solve = _seconds(lambda: fm.solve_linear(device, refinement=refinement), repeats)
            state: SolvedState = fm.solve_linear(device, refinement=refinement).at(amperes)
        else:
            solve = _seconds(lambda: NonlinearSolver(device, refinement).solve(amperes), repeats)
            solver = NonlinearSolver(device, refinement)
            alone = _seconds(lambda: solver.solve(amperes), repeats)  # noqa: B023
            state = solver.solve(amperes)
        for words, keys in sets.items():
            gradient = _seconds(partial(state.derivative, force, keys), repeats)
            yield Row(name, iron, words, len(keys), solve, alone, gradient, gradient / solve)


def show(result: dict[str, Any], console: Console) -> None:
    """As a table."""
    table = Table(title=f"gradients of a force (wanted: {WANTED} solves at most)")
    for name in ("device", "iron", "keys", "count", "solve, s", "state, s", "gradient, s", "in solves"):
        table.add_column(name, justify="left" if name in ("device", "iron", "keys") else "right")
    for row in result["rows"]:
        values = [f"{row[key]:.2f}" for key in ("solve", "state", "gradient", "in_solves")]
        table.add_row(row["device"], row["iron"], row["keys"], str(row["count"]), *values)
    console.print(table)

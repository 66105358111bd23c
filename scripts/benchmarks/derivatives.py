"""What derivatives of a state cost beside the state: three numbers (the force on a dipole) by more and more keys.

On the drive unit with linear iron and with saturating iron, at a refinement that keeps it to seconds. A solve is mesh,
assembly and solution, as it is for each variant of a device; a state is the solution alone on what is assembled. Wall
seconds, the least of three after one to warm up; all in one run.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.iron import DipoleForce, NonlinearSolver

WANTED = 1.5
"""Solves that a gradient may take."""


@dataclass(frozen=True)
class Row:
    """One set of keys: seconds of a whole solve, of a state on an assembled mesh, and of the gradient; its cost in
    solves."""

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
    """Keys of the drive unit, as its file has them written out."""
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
    device = fm.read_device("eight_coils" if quick else "drive_unit")
    refinement, repeats = (0.5, 1) if quick else (0.7, 3)
    written = fm.read_device(device.to_toml())
    amperes = [1.5] * len(device.coils)
    point = 0.5 * (device.bounds[0] + device.bounds[1]) if device.bounds else [0.0, 0.0, -0.1]
    force = DipoleForce(point, [0.0, 0.0, 8.0])
    rows = []
    for iron in ("linear", "saturating"):
        if iron == "linear":
            solution = fm.solve_linear(written, refinement=refinement)
            solve = _seconds(lambda: fm.solve_linear(written, refinement=refinement), repeats)
            state, alone = solution.at(amperes), float("nan")
        else:
            solver = NonlinearSolver(written, refinement)
            state = solver.solve(amperes)
            alone = _seconds(lambda solver=solver: solver.solve(amperes), repeats)
            solve = _seconds(lambda: NonlinearSolver(written, refinement).solve(amperes), repeats)
        for words, keys in _sets(written).items():
            gradient = _seconds(lambda state=state, keys=keys: state.derivative(force, keys), repeats)
            rows.append(Row(iron, words, len(keys), solve, alone, gradient, gradient / solve))
    return {"device": device.name, "rows": [asdict(row) for row in rows]}


def show(result: dict[str, Any], console: Console) -> None:
    """As a table."""
    table = Table(title=f"gradients of a force, {result['device']} (wanted: {WANTED} solves at most)")
    for name in ("iron", "keys", "count", "solve, s", "state, s", "gradient, s", "in solves"):
        table.add_column(name, justify="left" if name in ("iron", "keys") else "right")
    for row in result["rows"]:
        values = [f"{row[key]:.2f}" for key in ("solve", "state", "gradient", "in_solves")]
        table.add_row(row["iron"], row["keys"], str(row["count"]), *values)
    console.print(table)

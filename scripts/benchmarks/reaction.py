"""Cost of the iron's reaction to magnets: maps with and without the reaction, and one wrench on a dipole.

Maps of linear iron, where solves for single dipoles are added to few solves for coils, on the mesh of the device and on
a coarse one. Times are processor seconds of the map and of a wrench by the C core from Python, the least of three.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.lookup import FieldMap

WANTED = {"map": 1.5, "coarse map": 2.0, "wrench": 2.0}
"""Largest ratio of times with and without the reaction."""
_CASES = {
    "drive_unit": (5e-3, 1.0),
    "drive_unit, coarse": (5e-3, 0.4),
    "eight_coils": (5e-3, 1.0),
    "eight_coils, coarse": (5e-3, 0.5),
    "desk_levitator, coarse": (3e-3, 1.0),
}
_CALLS = 5000


@dataclass(frozen=True)
class Row:
    """Seconds of a map and of a wrench without and with the reaction, and number of fields of the reaction."""

    device: str
    fields: int
    map_without: float
    map_with: float
    wrench_without: float
    wrench_with: float


def _least(work: Callable[[], object], repeats: int = 3) -> float:
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def _row(case: str, folder: Path) -> Row:
    spacing, refinement = _CASES[case]
    device, path = fm.read_device(case.split(",")[0]), folder / "map.h5"

    def make(reaction: bool) -> None:
        iron = {"reaction": reaction, "refinement": refinement}
        fm.generate(device, path, resume=False, progress=False, spacing=spacing, iron=iron, accept_error=True)

    def ask(field: FieldMap) -> float:
        place, moment = 0.5 * (field.lower + field.upper) + 1e-3, np.array([0.0, 0.1, 1.0])
        currents = np.full(len(field.coil_names), 0.5)

        def calls() -> None:
            for _ in range(_CALLS):
                field.wrench(place, moment, currents)

        return _least(calls, 7) / _CALLS

    # The first map compiles the kernels.
    make(True)
    without, found = _least(lambda: make(False)), _least(lambda: make(True))
    opened = fm.open_map(path)
    assert opened.reaction is not None
    return Row(
        case, len(opened.reaction.signs), without, found, ask(fm.open_map(path, reaction=False)), ask(opened)
    )


def measure(quick: bool) -> dict[str, Any]:
    """All cases; quick: the coarse ones."""
    cases = [case for case in _CASES if not quick or "coarse" in case]
    with TemporaryDirectory() as folder:
        return {"rows": [asdict(_row(case, Path(folder))) for case in cases]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    wanted = ", ".join(f"{what} {times:g}" for what, times in WANTED.items())
    table = Table(title="the iron's reaction to magnets", caption=f"wanted, times at most: {wanted}")
    for name in ("device", "fields", "map, s", "with it, s", "times", "wrench, ns", "with it, ns", "times"):
        table.add_column(name, justify="left" if name == "device" else "right")
    for row in result["rows"]:
        maps, wrenches = (row["map_without"], row["map_with"]), (row["wrench_without"], row["wrench_with"])
        table.add_row(
            row["device"],
            str(row["fields"]),
            *(f"{seconds:.2f}" for seconds in maps),
            f"{maps[1] / maps[0]:.2f}",
            *(f"{1e9 * seconds:.0f}" for seconds in wrenches),
            f"{wrenches[1] / wrenches[0]:.2f}",
        )
    console.print(table)

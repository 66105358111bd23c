"""Speed of making maps: points times coils per second, gradients included, compared with magpylib's getB.

Times are medians of processor seconds on one thread, so that a busy machine matters less. The coils are the coils of
the drive unit, the points nodes of its workspace. magpylib has no coil of rectangular section; nested magnetised shells
replace it, and "difference" is the largest |B - B_ours| over the largest |B|. The last rows are whole maps: the field
of the coils and of the iron at the nodes, without and with the file, and without the solution of the iron.
"""

import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import fieldmap as fm
from fieldmap.device.model import Device, WorkspaceCylinder
from fieldmap.sources import unit_flux_densities, unit_flux_density_and_gradient
from fieldmap.sources.magpylib_objects import magpylib_coil
from fieldmap.store import Grid, MapData, write_map
from fieldmap.threads import thread_count, use_threads

Array = NDArray[np.float64]
WANTED = 10.0


@dataclass(frozen=True)
class Row:
    """One way to compute a field; rate: points times coils per second; difference: of B from ours, relative; ratio: our
    rate with gradients over this rate."""

    what: str
    gives: str
    points: int
    rate: float
    difference: float | None
    ratio: float | None


def nodes(device: Device, count: int) -> Grid:
    """A grid of about `count` nodes in the box around the workspace."""
    space = device.workspace
    if isinstance(space, WorkspaceCylinder):
        reach = np.array([space.radius, space.radius, 0.0])
        lower, upper = space.base - reach, space.base + reach + [0.0, 0.0, space.height]
    else:
        lower, upper = space.lower, space.upper
    each = max(2, round(count ** (1 / 3)))
    return Grid(lower, (np.asarray(upper) - lower) / (each - 1), (each, each, each))


def seconds(work: Callable[[], Any], repetitions: int) -> float:
    """Median processor seconds, after one run that compiles and warms up."""
    work()
    taken = []
    for _ in range(repetitions):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return max(statistics.median(taken), 1e-9)


def coil_rows(device: Device, points: Array, repetitions: int, fewer: int) -> list[Row]:
    """Coils without iron: ours with and without gradients, magpylib's with more and more shells."""
    coils, work = device.coils, len(points) * len(device.coils)
    field = work / seconds(lambda: unit_flux_densities(coils, points), repetitions)
    both = work / seconds(
        lambda: [unit_flux_density_and_gradient(coil, points) for coil in coils], repetitions
    )
    rows = [
        Row("coils, fieldmap", "B", len(points), field, None, None),
        Row("coils, fieldmap", "B and gradient", len(points), both, None, None),
    ]
    few = points[:: max(1, len(points) // fewer)]
    ours = unit_flux_densities(coils, few)
    for shells in (2, 4, 8):
        twins = [magpylib_coil(coil, shells=shells) for coil in coils]
        theirs = np.array([twin.getB(few) for twin in twins])
        rate = (
            few.size / 3 * len(coils) / seconds(lambda t=twins: [twin.getB(few) for twin in t], repetitions)
        )
        difference = float(np.abs(theirs - ours).max() / np.abs(ours).max())
        rows.append(Row(f"coils, magpylib, {shells} shells", "B", len(few), rate, difference, both / rate))
    return rows


def map_rows(name: str, refinement: float, points: int, repetitions: int) -> list[Row]:
    """A whole map of a device with linear iron, and its file."""
    device = fm.read_device(name)
    solution = fm.solve_linear(device, refinement=refinement)
    grid, coils = nodes(device, points), len(device.coils)
    where, faces = grid.points(), len(solution.state.faces.areas)
    fields = solution.unit_fields(where)
    data = MapData(
        grid,
        solution.coil_names,
        np.ones(coils),
        flux_density=fields[0].reshape(coils, *grid.shape, 3),
        gradient=fields[1].reshape(coils, *grid.shape, 3, 3),
    )
    evaluated = seconds(lambda: solution.unit_fields(where), repetitions)
    with tempfile.TemporaryDirectory() as folder:
        stored = seconds(lambda: write_map(Path(folder) / "map.h5", data), repetitions)
    work = len(where) * coils
    gives = "B and gradient"
    return [
        Row(f"map of {name}, {faces} faces of iron", gives, len(where), work / evaluated, None, None),
        Row("the same, and its file", gives, len(where), work / (evaluated + stored), None, None),
    ]


def measure(quick: bool) -> dict[str, Any]:
    """All rows, on one thread; the number of threads is restored."""
    points, fewer, repetitions = (100, 20, 1) if quick else (20_000, 1000, 3)
    threads = thread_count()
    use_threads(1)
    device = fm.read_device("drive_unit")
    rows = coil_rows(device, nodes(device, points).points(), repetitions, fewer)
    rows += map_rows("disk_six_cores", 0.4 if quick else 0.7, points, repetitions)
    use_threads(threads)
    return {"repetitions": repetitions, "rows": [asdict(row) for row in rows]}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        caption="generation: points x coils per second, processor time, one thread, median of "
        f"{result['repetitions']}; ratio: ours with gradients over theirs without; wanted: {WANTED:g}"
    )
    table.add_column("what")
    table.add_column("gives")
    for heading in ("points", "points x coils / s", "ratio", "difference of B"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.0f}"
        difference = "" if row["difference"] is None else f"{row['difference']:.0e}"
        table.add_row(row["what"], row["gives"], f"{row['points']}", f"{row['rate']:.2e}", ratio, difference)
    console.print(table)

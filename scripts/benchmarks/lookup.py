"""Lookup of a field in a map, compared with other libraries: same points, same grid, same field.

Six circular loops (radius 16 mm, centres on a ring of 44 mm at z = 26 mm) with 1 A each; 17 x 17 x 17 nodes over
|x|, |y| <= 20 mm, -110 mm <= z <= -70 mm. Errors are the largest difference from the closed form over all points, in
units of the largest component; a third of the points lies in the outermost layer of cells. Times are medians of
processor seconds on one thread; the gain by two threads is of elapsed time. The global form is tested with a seventh
loop over the workspace of the drive unit (z from -140 to -76 mm, nodes 4 mm apart), and there also with all loops at
z = 1 mm, where the drive unit has iron.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.lookup_peers import peers
from benchmarks.two_threads import sentences, threads_gain
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import FieldMap, interpolate
from fieldmap.store import Grid, MapData

Array = NDArray[np.float64]

LOWER, SIZE, RADIUS, RING = np.array([-0.02, -0.02, -0.11]), 0.04, 0.016, 0.044
KINDS = ("harmonic", "hermite", "global")


def loops(points: Array, n_coils: int = 6, height: float = 0.026) -> tuple[Array, Array]:
    """B (n_coils, n, 3) and G of six loops on the ring and, seventh, one in the middle; 1 A each."""
    angles = np.arange(6) * np.pi / 3
    centres = np.stack([RING * np.cos(angles), RING * np.sin(angles), np.full(6, height)], axis=1)
    centres = np.concatenate([centres, [[0.0, 0.0, height]]])[:n_coils]
    parts = [loop_flux_density_and_gradient(points - centre, RADIUS) for centre in centres]
    return np.stack([part[0] for part in parts]), np.stack([part[1] for part in parts])


CASE = Grid(LOWER, np.full(3, SIZE / 16), (17, 17, 17))
WORKSPACE = Grid(np.array([-0.02, -0.02, -0.14]), np.full(3, 0.004), (11, 11, 17))


def loop_map(grid: Grid = CASE, n_coils: int = 6, height: float = 0.026) -> MapData:
    """The map of the loops."""
    flux, slope = loops(grid.points(), n_coils, height)
    return MapData(
        grid,
        tuple(f"loop {k + 1}" for k in range(n_coils)),
        np.ones(n_coils),
        flux_density=flux.reshape(n_coils, *grid.shape, 3),
        gradient=slope.reshape(n_coils, *grid.shape, 3, 3),
    )


def places(n: int) -> Array:
    """Random points, every third of them moved into the outermost layer of cells."""
    rng = np.random.default_rng(1)
    unit = rng.random((n, 3))
    axis = rng.integers(0, 3, n)
    depth = unit[np.arange(n), axis] / 16
    outer = np.where(rng.random(n) < 0.5, depth, 1 - depth)
    moved = np.arange(n) % 3 == 0
    unit[moved, axis[moved]] = outer[moved]
    return LOWER + SIZE * unit


def cpu_ns(work: Callable[[], object], count: int, repetitions: int) -> float:
    """Median processor time over count, after one run that compiles and warms up."""
    work()
    seconds = []
    for _ in range(repetitions):
        start = time.process_time_ns()
        work()
        seconds.append(time.process_time_ns() - start)
    return statistics.median(seconds) / count


def one_ns(
    ask: Callable[..., object], points: list[Array], others: tuple[Any, ...], repetitions: int
) -> float:
    """Time of one call per point, with at most one more argument.

    The two loops are written out, because a starred call costs a tenth of a lookup.
    """

    def alone() -> None:
        for point in points:
            ask(point)

    def with_another() -> None:
        (other,) = others
        for point in points:
            ask(point, other)

    return cpu_ns(with_another if others else alone, len(points), repetitions)


def relative(ours: Array, exact: Array) -> float:
    """Largest difference over largest component."""
    return float(np.abs(ours - exact).max() / np.abs(exact).max())


@njit
def _one_by_one(evaluate: Any, data: Array, points: Array) -> float:
    total = 0.0
    for p in range(points.shape[0]):
        flux, slope = evaluate(data, points[p, 0], points[p, 1], points[p, 2])
        total += flux[2] + slope[0][0] + slope[1][2] + slope[2][1]
    return total


def our_row(m: FieldMap, points: Array, exact: tuple[Array, Array], repetitions: int) -> dict[str, Any]:
    """Times and errors of one of our forms; the field alone, field and gradient, one point three ways."""
    currents = np.ones(len(m.coil_names))
    fixed, n = m.at(currents), len(points)
    out = (np.empty((n, 3)), np.empty((n, 3, 3)))
    pair = (np.empty(3), np.empty((3, 3)))
    some = [point.copy() for point in points[:2000]]
    evaluate, data = m.compiled(currents)
    flux, slope = fixed.field_and_gradient(points)
    size = np.linalg.norm(slope, axis=(1, 2))
    curl = np.linalg.norm(slope - slope.transpose(0, 2, 1), axis=(1, 2)) / np.sqrt(2)
    jump = m.jump()
    return {
        "name": f"fieldmap {m.kind}",
        "one_ns": one_ns(m.field_and_gradient, some, (currents,), repetitions),
        "one_fixed_ns": one_ns(fixed.field_and_gradient, some, (pair,), repetitions),
        "compiled_ns": cpu_ns(lambda: _one_by_one(evaluate, data, points), n, repetitions),
        "batch_ns": cpu_ns(lambda: fixed.field(points, out[0]), n, repetitions),
        "both_ns": cpu_ns(lambda: fixed.field_and_gradient(points, out), n, repetitions),
        "contract_us": cpu_ns(lambda: [m.at([1.0, k, 1, 1, 1, 1]) for k in range(9)], 9000, repetitions),
        "eB": relative(flux, exact[0]),
        "eG": relative(slope, exact[1]),
        "divergence": float((np.abs(np.trace(slope, axis1=1, axis2=2)) / size).max()),
        "curl": float((curl / size).max()),
        "jump_B": jump.flux_density / float(np.abs(exact[0]).max()),
        "jump_B_bound": jump.flux_density_bound / float(np.abs(exact[0]).max()),
        "kilobytes": m.nbytes / 1024,
    }


def peer_row(peer: Any, points: Array, exact: tuple[Array, Array], repetitions: int) -> dict[str, Any]:
    """Times and errors of another library, for the functions that it has."""
    some, thin = [point.copy() for point in points[:300]], points[:20_000].copy()
    row = {
        "name": peer.name,
        "one_ns": one_ns(peer.one, some, (), repetitions),
        "batch_ns": cpu_ns(lambda: peer.field(thin), len(thin), repetitions),
        "eB": relative(peer.field(points), exact[0]),
    }
    if peer.both is not None:
        row["both_ns"] = cpu_ns(lambda: peer.both(thin), len(thin), repetitions)
        row["eG"] = relative(peer.both(points)[1], exact[1])
    return row


def inverse_row(data: MapData, count: int) -> dict[str, float]:
    """Time of one call of `currents_for` from Python, for a force on a dipole, six coils and limits; and the largest
    relative error of the force at the currents found."""
    m = interpolate(data, threads=1)
    rng = np.random.default_rng(4)
    where, moment = places(count), np.array([0.0, 0.0, 1.0])
    wanted = [
        m.wrench(point, moment, row)[:3]
        for point, row in zip(where, rng.uniform(-1, 1, (count, 6)), strict=True)
    ]
    m.currents_for(where[0], wanted[0], moment, 1.0)
    spent, worst = [], 0.0
    for point, force in zip(where, wanted, strict=True):
        start = time.process_time_ns()
        found = m.currents_for(point, force, moment, 1.0)
        spent.append(time.process_time_ns() - start)
        off = m.wrench(point, moment, found)[:3] - force
        worst = max(worst, float(np.linalg.norm(off) / np.linalg.norm(force)))
    return {"us": statistics.median(spent) / 1e3, "error": worst}


def global_rows(count: int) -> list[dict[str, Any]]:
    """The global form of seven coils, with the loops at their own height and close to the disk's lower face."""
    rows = []
    points = WORKSPACE.lower + np.random.default_rng(2).random((count, 3)) * (
        WORKSPACE.upper - WORKSPACE.lower
    )
    for height in (0.026, 0.001):
        m = interpolate(loop_map(WORKSPACE, 7, height), "global", threads=1)
        exact = [part.sum(axis=0) for part in loops(points, 7, height)]
        flux, slope = m.field_and_gradient(points, np.ones(7))
        row = {"height_mm": 1e3 * height, "eB": relative(flux, exact[0]), "eG": relative(slope, exact[1])}
        rows.append({**row, "kilobytes": m.nbytes / 1024})
    return rows


def measure(quick: bool) -> dict[str, Any]:
    """All rows."""
    points, repetitions = places(2000 if quick else 100_000), 1 if quick else 9
    data = loop_map()
    exact = tuple(part.sum(axis=0) for part in loops(points))
    rows = [our_row(interpolate(data, kind, threads=1), points, exact, repetitions) for kind in KINDS]
    found, missing = peers(data.grid, data.flux_density.sum(axis=0), lambda p: loops(p)[0].sum(axis=0))
    rows += [peer_row(peer, points, exact, repetitions) for peer in found]
    return {
        "points": len(points),
        "repetitions": repetitions,
        "rows": rows,
        "missing": missing,
        "two_threads": threads_gain(data, places(1_000_000)) if not quick else threads_gain(data, points, 1),
        "global_of_seven": global_rows(20_000),
        "currents_for": inverse_row(data, 200 if quick else 10_000),
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the tables."""
    keys = ("one_ns", "one_fixed_ns", "compiled_ns", "batch_ns", "both_ns", "eB", "eG")
    names = ("one", "one, at(I), out", "compiled", "B", "B and G", "eB", "eG")
    table = Table(
        caption=f"lookup: processor ns per point on one thread, median of {result['repetitions']}, {result['points']} "
        "points. one: a Python call for one point (ours with gradient); compiled: from a numba loop, with gradient"
    )
    table.add_column("library")
    for name in names:
        table.add_column(name, justify="right")
    for row in result["rows"]:
        cells = [
            "-" if key not in row else f"{row[key]:.0f}" if key.endswith("ns") else f"{row[key]:.1e}"
            for key in keys
        ]
        table.add_row(row["name"], *cells)
    console.print(table)
    for row in result["rows"][: len(KINDS)]:
        console.print(
            f"{row['name']}: divergence {row['divergence']:.0e}, curl {row['curl']:.0e} of |G|; jump of B "
            f"{row['jump_B']:.0e}, bound {row['jump_B_bound']:.0e}, of the largest B; currents contracted in "
            f"{row['contract_us']:.0f} us; {row['kilobytes']:.0f} kB"
        )
    for sentence in sentences(result["two_threads"]):
        console.print(sentence)
    for row in result["global_of_seven"]:
        console.print(
            f"global form, workspace, seven loops at z = {row['height_mm']:.0f} mm: eB {row['eB']:.0e}, "
            f"eG {row['eG']:.0e}, {row['kilobytes']:.1f} kB"
        )
    inverse = result["currents_for"]
    console.print(
        f"currents_for, force of a dipole from six coils within limits: {inverse['us']:.0f} us a call from Python, "
        f"force met to {inverse['error']:.0e}"
    )
    for name, reason in result["missing"].items():
        console.print(f"not in the table: {name} ({reason})")

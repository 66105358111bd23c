"""The source kernels compared with magpylib's getB, on the same points, on one thread.

Times are medians. "difference" is the largest |B - B_magpylib| / |B_magpylib| over the points. magpylib has no coil of
rectangular section; eight nested shells replace it.
"""

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import magpylib
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from fieldmap.constants import MU0
from fieldmap.device.model import CircularCoil, RoundedRectangleCoil
from fieldmap.kernels.coils.loop import loop_flux_density, loop_flux_density_and_gradient
from fieldmap.kernels.coils.sheet import sheet_flux_density, sheet_flux_density_and_gradient
from fieldmap.kernels.iron.charged_triangle import triangles_field, triangles_field_and_gradient
from fieldmap.sources import unit_flux_density, unit_flux_density_and_gradient
from fieldmap.sources.magpylib_objects import magpylib_coil
from fieldmap.threads import thread_count, use_threads

Array = NDArray[np.float64]
Function = Callable[[Array], object]


@dataclass(frozen=True)
class Case:
    """One source: our field, our field and gradient, magpylib's field; magpylib gets every `thin`-th point."""

    name: str
    points: Array
    field: Callable[[Array], Array]
    field_and_gradient: Function
    magpylib: Callable[[Array], Array]
    thin: int = 1


@dataclass(frozen=True)
class Row:
    """Nanoseconds per point; ratio = magpylib's field over our field and gradient."""

    kernel: str
    field_ns: float
    field_and_gradient_ns: float
    magpylib_ns: float
    ratio: float
    difference: float


def cases(count: int) -> list[Case]:
    """Loop, sheet and charged face, then the coils made of them, at random points of a box around each."""
    points = np.random.default_rng(0).uniform(-0.06, 0.06, (count, 3))
    below = points * [1.0, 1.0, 0.3] - [0.0, 0.0, 0.06]
    return [
        loop_case(points),
        sheet_case(points),
        triangle_case(points),
        coil_case(CircularCoil("circular coil", 0.011, 0.021, 0.039, 1.0), below),
        coil_case(RoundedRectangleCoil("rounded square coil", 0.016, 0.016, 0.015, 0.010, 0.039, 1.0), below),
    ]


def loop_case(points: Array) -> Case:
    """Circular loop against magpylib's Circle."""
    radius = 0.02
    twin = magpylib.current.Circle(current=1.0, diameter=2 * radius)
    return Case(
        "circular loop",
        points,
        lambda p: loop_flux_density(p, radius),
        lambda p: loop_flux_density_and_gradient(p, radius),
        twin.getB,
    )


def sheet_case(points: Array) -> Case:
    """Cylindrical current sheet against the surface of a magnetised cylinder."""
    radius, height = 0.02, 0.039
    twin = magpylib.magnet.Cylinder(polarization=(0, 0, MU0 / height), dimension=(2 * radius, height))
    return Case(
        "cylindrical sheet",
        points,
        lambda p: sheet_flux_density(p, radius, height),
        lambda p: sheet_flux_density_and_gradient(p, radius, height),
        twin.getB,
    )


def triangle_case(points: Array) -> Case:
    """One charged triangle, as on the iron's surface, against magpylib's Triangle."""
    corners = np.array([[[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0, 0.015, 0.0]]])
    normal, density = np.array([[0.0, 0.0, 1.0]]), np.array([1 / (4 * np.pi)])
    twin = magpylib.misc.Triangle(polarization=(0, 0, 1.0), vertices=corners[0])
    return Case(
        "charged triangle",
        points,
        lambda p: triangles_field(p, corners, normal, density),
        lambda p: triangles_field_and_gradient(p, corners, normal, density),
        twin.getB,
    )


def coil_case(coil: CircularCoil | RoundedRectangleCoil, points: Array) -> Case:
    """A coil of rectangular section against nested magnetised shells."""
    twin = magpylib_coil(coil, shells=8)
    return Case(
        f"{coil.name} (magpylib: 8 shells)",
        points,
        lambda p: unit_flux_density(coil, p),
        lambda p: unit_flux_density_and_gradient(coil, p),
        twin.getB,
        thin=20,
    )


def median_ns(function: Function, points: Array, repetitions: int) -> float:
    """Median time per point, after one run that compiles and warms up."""
    function(points)
    seconds = []
    for _ in range(repetitions):
        start = time.perf_counter()
        function(points)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds) / len(points) * 1e9


def measured(case: Case, repetitions: int) -> Row:
    """Times and agreement of one case."""
    fewer = case.points[:: case.thin]
    ours = median_ns(case.field, case.points, repetitions)
    both = median_ns(case.field_and_gradient, case.points, repetitions)
    theirs = median_ns(case.magpylib, fewer, repetitions)
    expected = case.magpylib(fewer)
    error = np.linalg.norm(case.field(fewer) - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return Row(case.name, ours, both, theirs, theirs / both, float(error.max()))


def measure(quick: bool) -> dict[str, Any]:
    """All rows, on one thread; the number of threads is restored."""
    points, repetitions = (300, 1) if quick else (50_000, 9)
    threads = thread_count()
    use_threads(1)
    rows = [asdict(measured(case, repetitions)) for case in cases(points)]
    use_threads(threads)
    return {"points": points, "repetitions": repetitions, "rows": rows}


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    points, repetitions = result["points"], result["repetitions"]
    table = Table(
        caption=f"kernels: ns per point, one thread, median of {repetitions}, {points} points; "
        "ratio includes our gradient"
    )
    table.add_column("kernel")
    for heading in ("B", "B and gradient", "magpylib B", "ratio", "difference"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        table.add_row(
            row["kernel"],
            f"{row['field_ns']:.1f}",
            f"{row['field_and_gradient_ns']:.1f}",
            f"{row['magpylib_ns']:.0f}",
            f"{row['ratio']:.1f}",
            f"{row['difference']:.0e}",
        )
    console.print(table)

"""Fields of the package as magpylib sources, where getB of the source and a magnet is compared with `field`; and
currents and magnets of magpylib's kinds, where our code is compared with magpylib's.

Times are processor times of all threads together. "difference" is the largest difference of the source's B from
`field`, relative to the largest B. A moved and turned source is compared with `field` at points moved back.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import magpylib
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.device.air_fields import flux_density, flux_density_and_gradient
from fieldmap.sources import CoilSet

Array = NDArray[np.float64]
_TURN, _SHIFT = Rotation.from_rotvec([0.3, 0.2, -0.5]), np.array([0.01, -0.02, 0.03])


@dataclass(frozen=True)
class Row:
    """Microseconds of processor time per point; ratio = getB of source and magnet over `field`; differences, relative;
    force: relative difference of getFT on a 1 mm magnet from `wrench`."""

    field: str
    points: int
    field_us: float
    magpylib_us: float
    ratio: float
    difference: float
    moved: float
    force: float


def best(function: Callable[[], object], repetitions: int) -> float:
    """Least processor time of several calls, after one that warms up."""
    function()
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def measured(name: str, source: Any, field: Any, points: Array, repetitions: int) -> Row:
    """Measure one field, by itself and in magpylib. source: the magpylib source; field: at the same currents."""
    magnet = magpylib.magnet.Cuboid(
        polarization=(0, 0, 1.0), dimension=(0.01, 0.01, 0.01), position=(0.2, 0.0, 0.0)
    )
    sensor = magpylib.Sensor(pixel=points)
    expected = field.field(points)
    largest = np.abs(expected).max()
    both = magpylib.getB([source, magnet], sensor)
    alone = best(lambda: field.field(points), repetitions)
    together = best(lambda: magpylib.getB([source, magnet], sensor), repetitions)
    moved = source.copy(position=_SHIFT, orientation=_TURN)
    turned = _TURN.inv().apply(moved.getB(_TURN.apply(points) + _SHIFT))
    polarisation = np.array([0.5, -0.3, 1.0])
    ball = magpylib.magnet.Sphere(polarization=polarisation, diameter=1e-3, position=points[0])
    force = np.concatenate(magpylib.getFT(source, ball))
    wrench = field.wrench(points[:1], [polarisation * np.pi / 6 * 1e-9 / magpylib.mu_0])[0]
    parts = (slice(0, 3), slice(3, 6))
    off = max(float(np.linalg.norm((force - wrench)[k]) / np.linalg.norm(wrench[k])) for k in parts)
    return Row(
        name,
        len(points),
        1e6 * alone / len(points),
        1e6 * together / len(points),
        together / alone,
        float(np.abs(both[0] - expected).max() / largest),
        float(np.abs(turned - expected).max() / largest),
        off,
    )


@dataclass(frozen=True)
class KindRow:
    """Microseconds of processor time per point of B, of B with its gradient, and of magpylib's B; the largest
    difference of the two fields, relative to each."""

    kind: str
    field_us: float
    both_us: float
    magpylib_us: float
    difference: float


def kinds(points: Array, repetitions: int) -> list[KindRow]:
    """Currents and magnets of all kinds, each in its own position and orientation."""
    magnet, current = magpylib.magnet, magpylib.current
    square = [[0, 0, 0], [0.02, 0, 0], [0.02, 0.02, 0], [0, 0.02, 0], [0, 0, 0]]
    strip = [[0.02 * (k // 2), 0.01 * (k % 2), 0] for k in range(6)]
    corners = [[0, 0, 0], [0.01, 0, 0], [0, 0.012, 0], [0, 0, 0.009]]
    ball = np.random.default_rng(1).normal(size=(60, 3))
    ball *= 0.01 / np.linalg.norm(ball, axis=1, keepdims=True)
    j = (0.2, -0.3, 1.0)
    things = {
        "Circle": current.Circle(current=3.0, diameter=0.02),
        "Polyline, 4 segments": current.Polyline(current=2.0, vertices=square),
        "TriangleStrip, 4 triangles": current.TriangleStrip(current=2.0, vertices=strip),
        "Cuboid": magnet.Cuboid(polarization=j, dimension=(0.01, 0.012, 0.014)),
        "Tetrahedron": magnet.Tetrahedron(polarization=j, vertices=corners),
        "TriangularMesh, 116 triangles": magnet.TriangularMesh.from_ConvexHull(points=ball, polarization=j),
        "Sphere": magnet.Sphere(polarization=j, diameter=0.01),
        "Cylinder, along its axis": magnet.Cylinder(polarization=(0, 0, 1.0), dimension=(0.01, 0.012)),
        "Cylinder, across": magnet.Cylinder(polarization=j, dimension=(0.01, 0.012)),
        "CylinderSegment": magnet.CylinderSegment(polarization=j, dimension=(0.004, 0.01, 0.012, 30, 140)),
    }
    rows = []
    for name, thing in things.items():
        (source,) = fm.Background.from_magpylib(thing).sources
        ours, theirs = flux_density(source, points), thing.getB(points)
        functions = (
            lambda x, source=source: flux_density(source, x),
            lambda x, source=source: flux_density_and_gradient(source, x),
            thing.getB,
        )
        times = [1e6 * best(lambda f=f: f(points), repetitions) / len(points) for f in functions]
        error = np.linalg.norm(ours - theirs, axis=1) / np.linalg.norm(theirs, axis=1)
        rows.append(KindRow(name, *times, float(error.max())))
    return rows


def measure(quick: bool) -> dict[str, Any]:
    """Coils, linear and saturating iron of the disk with six cores, and a map of it."""
    count, repetitions = (50, 1) if quick else (2000, 5)
    device = fm.read_device("loop_and_sphere" if quick else "disk_six_cores")
    shares = 0.02 + 0.96 * np.random.default_rng(0).random((count, 3))
    currents = np.linspace(0.5, 1.5, len(device.coils))
    fields: list[tuple[str, Any]] = [
        ("coils alone", CoilSet(device.coils, device.bounds).at(currents)),
        ("linear iron", fm.solve_linear(device).at(currents)),
        ("saturating iron", fm.solve(device, currents)),
    ]
    if not quick:
        with tempfile.TemporaryDirectory() as folder:
            opened = fm.open_map(fm.generate("maps/quick.toml", Path(folder) / "quick.h5"))
        fields.append(("map", opened.at(np.linspace(0.5, 1.5, len(opened.coil_names)))))
    rows = []
    for name, field in fields:
        lower, upper = field.bounds
        rows.append(measured(name, field.as_magpylib(), field, lower + (upper - lower) * shares, repetitions))
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (count, 3))
    return {
        "device": device.name,
        "rows": [asdict(row) for row in rows],
        "kinds": [asdict(row) for row in kinds(points, repetitions)],
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        caption=f"magpylib sources: {result['device']}, processor time in us per point; getB is of source and magnet"
    )
    table.add_column("field")
    for heading in ("points", "field", "getB", "ratio", "difference", "moved, turned", "getFT"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        table.add_row(
            row["field"],
            f"{row['points']}",
            f"{row['field_us']:.2f}",
            f"{row['magpylib_us']:.2f}",
            f"{row['ratio']:.2f}",
            f"{row['difference']:.0e}",
            f"{row['moved']:.0e}",
            f"{row['force']:.0e}",
        )
    console.print(table)
    table = Table(
        caption="kinds of magpylib's sources: processor time in us per point; largest relative difference of B"
    )
    table.add_column("kind")
    for heading in ("B", "B and gradient", "magpylib B", "difference"):
        table.add_column(heading, justify="right")
    for row in result["kinds"]:
        times = (f"{row[key]:.2f}" for key in ("field_us", "both_us", "magpylib_us"))
        table.add_row(row["kind"], *times, f"{row['difference']:.0e}")
    console.print(table)

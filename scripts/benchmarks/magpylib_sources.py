"""Fields of the package as magpylib sources: getB of the source and a magnet beside `field` itself.

Processor time, all threads together. "difference" is the largest of the source's B from `field`, relative to its
largest; of the moved source, which is also turned, from `field` at points moved back.
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
    """One field, as itself and in magpylib. source: as a magpylib source; field: at the same currents."""
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
    return {"device": device.name, "rows": [asdict(row) for row in rows]}


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

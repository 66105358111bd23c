"""An iron disk at mu_r 4000 under a thick coil, its reference, and the two programs that solve it.

Reference: axisymmetric finite elements with errors of 2e-7 (tests/reference/axisymmetric.csv, "disk,4000"). Error, the
same for both programs: largest |B - B_reference| over the largest |B_reference| of the points. B is the total field
with the field of the coil, which is exact in both.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fieldmap as fm
from fieldmap.device.model import Body, CircularCoil, Cylinder, Device, LinearMaterial, Part, Placement
from fieldmap.sources import unit_flux_density

Array = NDArray[np.float64]
TABLE = Path(__file__).parents[2] / "tests" / "reference" / "axisymmetric.csv"
MU_R, RADIUS, HEIGHT = 4000.0, 0.066, 0.006
COIL = CircularCoil(
    "coil", 0.011, 0.021, 0.039, 840.0, placement=Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
)
# Largest element and first layer at the disk's edges.
MESH_SIZE, EDGE_SIZE = 0.008, 0.0005


@dataclass(frozen=True)
class Row:
    """One mesh of one program. seconds, cpu_seconds: meshing and solving, cold; field_error, gradient_error:
    relative to the largest value; gradient_error is None where the program has no gradient."""

    program: str
    mesh: str
    unknowns: int
    seconds: float
    cpu_seconds: float
    evaluation_seconds: float
    field_error: float
    gradient_error: float | None


def reference() -> tuple[Array, Array, Array]:
    """Points (n, 3) in the half-plane y = 0, flux density (n, 2) = Bz, Br and its slope along z (n, 2)."""
    rows = [line.split(",")[2:] for line in TABLE.read_text().splitlines() if line.startswith("disk,4000,")]
    values = np.array(rows, float)
    points = np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]])
    return points, values[:, 2:4], values[:, 4:6]


def relative_error(ours: Array, exact: Array) -> float:
    """Largest length of the difference over the largest length of the exact vectors."""
    return float(np.linalg.norm(ours - exact, axis=1).max() / np.linalg.norm(exact, axis=1).max())


def timed(work: Callable[[], object]) -> tuple[object, float, float]:
    """Result, wall seconds, processor seconds of all threads."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def fieldmap_row(refinement: float) -> Row:
    """This package: from the device in memory to the solution, then the field and gradient at the points."""
    points, field, slope = reference()
    at_origin = Part(Cylinder(RADIUS, HEIGHT))
    disk = Body("disk", "iron", (at_origin,), MESH_SIZE, EDGE_SIZE)
    device = Device("disk", "", (COIL,), (disk,), {"iron": LinearMaterial("iron", MU_R)})
    unit, wall, cpu = timed(lambda: fm.solve_linear(device, refinement=refinement))
    (b, g), evaluation, _ = timed(lambda: unit.unit_fields(points))
    return Row(
        "fieldmap",
        f"{unit.report.surface_faces} faces",
        unit.report.unknowns,
        wall,
        cpu,
        evaluation,
        relative_error(b[0][:, [2, 0]], field),
        relative_error(g[0][:, [2, 0], 2], slope),
    )


def material_response_row(across: int, layers: int) -> Row:
    """magpylib-material-response in its usual use: a cuboid grid without the cells centred outside the disk.

    The choices favour that program: the cells are scaled to the disk's true volume, the thick coil's exact field enters
    at the cells' centres (`H_ext`; no current object in the collection, where its order would matter), and the direct
    solver is used, which took half the time of "auto" here. Its default rule of point matching is better here than
    interaction="newell", and cuboids are better than the cylinder segments of its `mesh_Cylinder`.
    """
    import magpylib
    from magpylib_material_response.demag import apply_demag

    points, field, _ = reference()

    def solved() -> list[magpylib.magnet.Cuboid]:
        cells = _cuboid_disk(across, layers)
        centres = np.array([cell.position for cell in cells])
        for cell, applied in zip(cells, unit_flux_density(COIL, centres), strict=True):
            cell.H_ext = tuple(applied)
        collection = magpylib.Collection(*cells, override_parent=True)
        apply_demag(collection, susceptibility=MU_R - 1, inplace=True, solver="direct")
        return cells

    cells, wall, cpu = timed(solved)
    b, evaluation, _ = timed(
        lambda: magpylib.getB(cells, points, sumup=True) + unit_flux_density(COIL, points)
    )
    mesh = f"{len(cells)} cuboids, {layers} layers"
    error = relative_error(b[:, [2, 0]], field)
    return Row("material-response", mesh, 3 * len(cells), wall, cpu, evaluation, error, None)


def _cuboid_disk(across: int, layers: int):
    import magpylib
    from magpylib_material_response.meshing import mesh_Cuboid

    around = magpylib.magnet.Cuboid(
        dimension=(2 * RADIUS, 2 * RADIUS, HEIGHT), position=(0, 0, HEIGHT / 2), polarization=(0, 0, 0)
    )
    grid = mesh_Cuboid(around, (across, across, layers)).sources_all
    cells = [cell for cell in grid if np.hypot(*cell.position[:2]) <= RADIUS]
    area = len(cells) / layers * (2 * RADIUS / across) ** 2
    stretch = np.array([1.0, 1.0, 0.0]) * np.sqrt(np.pi * RADIUS**2 / area) + [0.0, 0.0, 1.0]
    for cell in cells:
        cell.position, cell.dimension = cell.position * stretch, cell.dimension * stretch
    return cells

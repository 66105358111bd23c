"""The published validation cases of magpylib-material-response, and a cube of known polarizability: error over time.

- cuboids: three magnets of susceptibility 0.3 to 1; soft magnet: a magnet beside a cube of mu_r 4000. That package
  validates both against finite elements (ANSYS) and includes the numbers. Reference here: both forms of this package on
  fine meshes, which agree within the differences stated in `tests/reference/peer_cases.csv`.
- cube: mean magnetisation of a cube of mu_r 1e6 in a uniform field, polarizability 3.644305190268 (Helsing and Perfekt,
  Appl. Comput. Harmon. Anal. 34, 2013).

Errors: largest |B - B_truth| over the largest |B_truth| of the points; for the cube, of the polarizability.
`python scripts/benchmarks/peer_cases.py` computes the reference again (five minutes).
"""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import magpylib
import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

import fieldmap as fm
from benchmarks.disk_case import Array, relative_error, timed

TRUTH = Path(__file__).parents[2] / "tests" / "reference" / "peer_cases.csv"
POLARIZABILITY = 3.644305190268
MM = 1e-3
# Largest element and first layer at edges, as shares of the smallest side.
MESHES = ((0.5, None), (0.5, 0.1), (0.4, 0.05), (0.3, 0.02), (0.25, 0.01))
TRUTH_MESHES = ((0.25, 0.01), (0.16, 0.003))
CELLS = (1, 8, 64, 216, 512)
CUBE_CELLS = (4, 8, 12)


@dataclass(frozen=True)
class Row:
    """One mesh of one program. seconds, cpu_seconds: meshing, solving, and the field at the points."""

    case: str
    program: str
    mesh: str
    seconds: float
    cpu_seconds: float
    error: float


# ---- the models, as that package's documentation states them ----


def cuboids() -> magpylib.Collection:
    """Three magnets that demagnetise each other."""
    one = magpylib.magnet.Cuboid(polarization=(0, 0, 1), dimension=(MM, MM, MM), position=(-1.5 * MM, 0, 0))
    two = magpylib.magnet.Cuboid(polarization=(0.9, 0, 0), dimension=(MM, MM, MM), position=(0, 0, 0.2 * MM))
    two.rotate_from_angax(-45, "y")
    across = 0.6 * np.array([np.sin(np.pi / 6), np.cos(np.pi / 6), 0.0])
    three = magpylib.magnet.Cuboid(
        polarization=across, dimension=(MM, MM, 2 * MM), position=(1.6 * MM, 0, 0.5 * MM)
    )
    three.rotate_from_angax(30, "z")
    return _responding((one, 0.3), (two, 1.0), (three, 0.5))


def soft_magnet() -> magpylib.Collection:
    """A magnet beside a soft cube standing on its edge."""
    hard = magpylib.magnet.Cuboid(
        polarization=(0, 0, 1), dimension=(MM, MM, 2 * MM), position=(0, 0, 0.5 * MM)
    )
    soft = magpylib.magnet.Cuboid(polarization=(0, 0, 0), dimension=(MM, MM, MM), position=(1.5 * MM, 0, 0))
    soft.rotate_from_angax(45, "y")
    return _responding((hard, 0.5), (soft, 3999.0))


def _responding(*magnets: tuple[Any, float]) -> magpylib.Collection:
    for magnet, susceptibility in magnets:
        magnet.susceptibility = susceptibility
    return magpylib.Collection(*(magnet for magnet, _ in magnets))


@dataclass(frozen=True)
class Case:
    """A model, lines of points along x, and the data set of finite elements, of which every `every`-th point counts."""

    name: str
    model: Callable[[], magpylib.Collection]
    lines: tuple[tuple[float, float, int, float], ...]
    dataset: str
    every: int

    @property
    def all_points(self) -> Array:
        """All points of the data set (n, 3), m."""
        lines = [
            np.column_stack([np.linspace(start, end, count), np.zeros(count), np.full(count, z)])
            for start, end, count, z in self.lines
        ]
        return MM * np.concatenate(lines)

    @property
    def points(self) -> Array:
        """The compared points (n, 3), m."""
        return self.all_points[:: self.every]


CASES = (
    Case("cuboids", cuboids, ((-4.0, 4.0, 301, -1.0),), "FEMdata_test_cuboids", 10),
    Case(
        "soft magnet",
        soft_magnet,
        tuple((-4.0, 6.0, 1001, z) for z in (-1.0, -3.0, -5.0)),
        "FEMdata_test_softmag",
        77,
    ),
)


# ---- the programs ----


def device_of(case: Case, size: float, layer: float | None) -> fm.Device:
    """The model as a device of this package. size, layer: mesh size and first layer, mm."""
    device = fm.Device.from_magpylib(case.model(), mesh_size=size * MM)
    edge = None if layer is None else layer * MM
    return device.replace(bodies=[replace(body, edge_size=edge) for body in device.bodies])


def our_field(case: Case, size: float, layer: float | None, form: str = "auto") -> tuple[Array, int]:
    """B (n, 3) at the points, and the number of faces."""
    unit = fm.solve_linear(device_of(case, size, layer), form=form)
    return unit.field(case.points, []), unit.report.surface_faces


def their_field(case: Case, cells: int) -> tuple[Array, int]:
    """B (n, 3) of magpylib-material-response with about `cells` cells in each cuboid."""
    from magpylib_material_response.demag import apply_demag
    from magpylib_material_response.meshing import mesh_all

    meshed = mesh_all(case.model(), target_elems=cells, per_child_elems=True, min_elems=1)
    solved = apply_demag(meshed)
    return magpylib.getB(solved, case.points), len(solved.sources_all)


def our_cube(size: float, layer: float | None) -> tuple[float, int]:
    """Polarizability, and the number of faces."""
    edge = None if layer is None else layer * MM
    cube = fm.Body("cube", "iron", fm.Box((MM, MM, MM)), size * MM, edge)
    iron = {"iron": fm.LinearMaterial("iron", 1e6)}
    device = fm.Device("cube", "", (), (cube,), iron, background=fm.Background([0.0, 0.0, 1.0]))
    state = fm.solve_linear(device).at([])
    corners = state.mesh.points[state.mesh.tets]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    polarisation = state.iron.mean_polarisation(np.arange(len(volume)), state.weights)
    return float(volume @ polarisation[:, 2] / volume.sum()), state.report.surface_faces


def their_cube(across: int) -> tuple[float, int]:
    """Polarizability of across^3 cells, volume-averaged interactions, which is the better rule and solver here."""
    from magpylib_material_response.demag import apply_demag
    from magpylib_material_response.meshing import mesh_Cuboid

    cube = magpylib.magnet.Cuboid(dimension=(MM, MM, MM), polarization=(0, 0, 0))
    meshed = mesh_Cuboid(cube, (across, across, across))
    for cell in meshed.sources_all:
        cell.H_ext = (0.0, 0.0, 1.0)
    apply_demag(meshed, susceptibility=1e6 - 1, inplace=True, solver="iterative", interaction="newell")
    return float(np.mean([cell.polarization[2] for cell in meshed.sources_all])), across**3


# ---- truth ----


def truth(name: str) -> Array:
    """B (n, 3) at the points of a case."""
    rows = [line.split(",") for line in TRUTH.read_text().splitlines() if line.startswith(name + ",")]
    return np.array([row[4:7] for row in rows], float)


def finite_elements(case: Case) -> Array | None:
    """B (n, 3) of the data set at the points, 0 where it has no component; None without the package."""
    try:
        from magpylib_material_response import get_dataset
    except ModuleNotFoundError:
        return None
    values = get_dataset(case.dataset)["results"][0]["value"]
    count = len(case.all_points)
    columns = [np.asarray(values.get(f"B{axis}", np.zeros(count)), float) for axis in "xyz"]
    # The data set interleaves the points of the lines.
    in_turn = np.column_stack(columns).reshape(-1, len(case.lines), 3)
    return in_turn.transpose(1, 0, 2).reshape(-1, 3)[:: case.every]


def write_truth() -> None:
    """Write means of both forms on the finest mesh, and their differences from each other and from the coarser mesh."""
    lines = [
        "# B at points of two validation cases of magpylib-material-response (scripts/benchmarks/peer_cases.py):",
        "# means of the potential and the flux form of this package on fine meshes. case, x, y, z (m), Bx, By, Bz (T).",
    ]
    for case in CASES:
        fields = {
            (level, form): our_field(case, *level, form)[0]
            for level in TRUTH_MESHES
            for form in ("potential", "flux")
        }
        coarse, fine = (
            [field for (level, _), field in fields.items() if level == wanted] for wanted in TRUTH_MESHES
        )
        mean = sum(fine) / 2
        apart, moved = relative_error(fine[0], fine[1]), relative_error(sum(coarse) / 2, mean)
        lines.append(
            f"# {case.name}: the forms differ by {apart:.0e}, the coarser mesh by {moved:.0e} of the largest."
        )
        for point, value in zip(case.points, mean, strict=True):
            lines.append(",".join([case.name, *(f"{x:.6g}" for x in point), *(f"{b:.9g}" for b in value)]))
        print(lines[-len(mean) - 1], flush=True)
    TRUTH.write_text("\n".join(lines) + "\n")


# ---- rows ----


def measure(quick: bool) -> dict[str, Any]:
    """Rows of both programs for every case. Small first solves compile everything, outside the timing."""
    other = other_program()
    meshes, cells = (MESHES[:2], CELLS[:2]) if quick else (MESHES, CELLS)
    for mesh in MESHES[:2]:
        our_cube(*mesh)
    rows = []
    for case in CASES:
        exact = truth(case.name)
        our_field(case, *MESHES[1])
        for mesh in meshes:
            rows.append(_row(case.name, "fieldmap", "faces", exact, lambda c=case, m=mesh: our_field(c, *m)))
        if other:
            their_field(case, CELLS[0])
            for count in cells:
                rows.append(
                    _row(
                        case.name,
                        "material-response",
                        "cells",
                        exact,
                        lambda c=case, n=count: their_field(c, n),
                    )
                )
        published = finite_elements(case)
        if published is not None:
            rows.append(Row(case.name, "ANSYS", "as published", 0.0, 0.0, relative_error(published, exact)))
    for mesh in meshes:
        rows.append(_row("cube", "fieldmap", "faces", None, lambda m=mesh: our_cube(*m)))
    if other:
        their_cube(2)
        for across in CUBE_CELLS[: 1 if quick else None]:
            rows.append(_row("cube", "material-response", "cells", None, lambda n=across: their_cube(n)))
    return {
        "other": other or "magpylib-material-response is not installed",
        "rows": [asdict(row) for row in rows],
    }


def other_program() -> str:
    """Name and version of the other program; "" if it is not installed."""
    try:
        import magpylib_material_response
    except ModuleNotFoundError:
        return ""
    return f"magpylib-material-response {magpylib_material_response.__version__}"


def _row(
    case: str, program: str, unit: str, exact: Array | None, solve: Callable[[], tuple[Any, int]]
) -> Row:
    (value, count), wall, cpu = timed(solve)
    error = abs(value / POLARIZABILITY - 1) if exact is None else relative_error(value, exact)
    return Row(case, program, f"{count} {unit}", wall, cpu, float(error))


def show(result: dict[str, Any], console: Console) -> None:
    """Print the table."""
    table = Table(
        title="cases of magpylib-material-response, and a cube of known polarizability",
        caption="s: mesh, solve and field, wall clock (processor); errors by the largest field, of the cube its own",
    )
    for heading in ("case", "program", "mesh"):
        table.add_column(heading)
    for heading in ("s", "(cpu s)", "error"):
        table.add_column(heading, justify="right")
    for row in result["rows"]:
        published = row["program"] == "ANSYS"
        times = ("-", "-") if published else (f"{row['seconds']:.2f}", f"({row['cpu_seconds']:.2f})")
        table.add_row(row["case"], row["program"], row["mesh"], *times, f"{row['error']:.1e}")
    console.print(table)
    console.print(result["other"], highlight=False)


if __name__ == "__main__":
    write_truth()

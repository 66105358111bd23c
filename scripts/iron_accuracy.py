"""Measure both forms of the iron solver against fields that something else computed: the tables of docs/theory/iron.md.

python scripts/iron_accuracy.py            (some minutes; --all adds the devices with six cores and with yoke)
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.model import (
    BHTable,
    Body,
    CircularCoil,
    Cylinder,
    Device,
    LinearMaterial,
    Part,
    Placement,
    Sphere,
)
from fieldmap.iron import NonlinearSolver, generate_mesh
from fieldmap.iron.forms.bh_law import law_tables
from fieldmap.iron.forms.flux_form import FluxForm
from fieldmap.iron.forms.potential_form import Magnetisation, PotentialForm
from fieldmap.iron.forms.state import IronState
from fieldmap.iron.operators.assembled import assemble

Array = NDArray[np.float64]
REFERENCES = Path(__file__).parents[1] / "tests" / "reference"
UP = np.array([0.0, 0.0, 1.0])
FORMS = ("potential", "flux")


@dataclass(frozen=True)
class Row:
    """One line: what, form, faces of the surface, steps of the solver, largest relative errors of B and gradient."""

    case: str
    form: str
    faces: int
    steps: int
    field: float
    gradient: float | None = None

    def __str__(self) -> str:
        gradient = "-" if self.gradient is None else f"{self.gradient:.1e}"
        return f"| {self.case} | {self.form} | {self.faces} | {self.steps} | {self.field:.1e} | {gradient} |"


def spheres() -> Iterator[Row]:
    """A sphere in a uniform field: outside, the field of a dipole (Jackson, section 5.11)."""
    radius = 0.05
    points = np.array([[0.06, 0, 0], [0, 0, 0.06], [0.04, 0.03, 0.04], [0.1, 0.02, 0.03], [0, 0.07, -0.02]])
    distance = np.linalg.norm(points, axis=1)[:, None]
    unit = (3 * points * points[:, 2:] / distance**2 - UP) * (radius / distance) ** 3
    for size in (0.012, 0.007):
        ball = Body("ball", "iron", (Part(Sphere(radius)),), size)
        iron = assemble(generate_mesh(Device("ball", "", (), (ball,), {"iron": LinearMaterial("iron", 1.0)})))
        solvers = {"potential": PotentialForm(iron), "flux": FluxForm(iron)}
        for mu in (1e-4, 2.0, 10.0, 1e3, 1e6):
            for form in FORMS if mu >= 1 else ("flux",):
                state = _in_uniform_field(solvers[form], mu)
                exact = (mu - 1) / (mu + 2) * unit
                error = np.linalg.norm(state.faces.field(points, state.density)[0] - exact, axis=1)
                worst = (error / np.linalg.norm(exact + UP, axis=1)).max()
                yield Row(
                    f"sphere, mu_r {mu:g}", form, len(iron.surface.areas), state.iterations, float(worst)
                )


def _in_uniform_field(solver: PotentialForm | FluxForm, mu_r: float) -> IronState:
    def applied(x: Array) -> Array:
        return np.broadcast_to(UP, (1, *x.shape))

    count = len(solver.elements.volume)
    if isinstance(solver, FluxForm):
        return solver.solve(np.full(count, mu_r), solver.elements.load(applied))
    law = law_tables([LinearMaterial("iron", mu_r)])
    material = Magnetisation(np.zeros(count, np.int64), law, np.zeros((1, count, 3)))
    return solver.solve_linear(material, solver.elements.coil_field(applied), 1e-7).iron


def axisymmetric() -> Iterator[Row]:
    """Disk, disk and core, disk and core and plate with a thick coil, against finite elements good to 5e-7."""
    for case, mu, size, edge in (
        ("disk", 1000, 0.0025, 0.0005),
        ("diskcore", 1000, 0.005, 0.002),
        ("diskcore", 1000, 0.0035, 0.001),
        ("diskcore", 1000, 0.0025, 0.0005),
        ("diskcore", 4000, 0.0025, 0.0005),
        ("spool", 1000, 0.0025, 0.0005),
    ):
        points, exact = _reference("axisymmetric.csv", f"{case},{mu}")
        device = _on_one_axis(case, size, edge, LinearMaterial("iron", float(mu)))
        for form in FORMS:
            unit = fm.solve_linear(device, form=form)
            b, g = unit.unit_fields(points)
            words = {"disk": "disk", "diskcore": "disk, core", "spool": "disk, core, plate"}[case]
            steps, faces = unit.report.iterations, unit.report.surface_faces
            yield Row(f"{words}, mu_r {mu}", form, faces, steps, *_errors(b[0], g[0], exact))


def saturated() -> Iterator[Row]:
    """Disk and core of saturating iron, against finite elements good to 1e-4 (B) and 3e-4 (gradient)."""
    solver, state = NonlinearSolver(_on_one_axis("diskcore", 0.0025, 0.0005, _analytic_law())), None
    for ampere_turns in (4200, 12600, 33600):
        points, exact = _reference("axisymmetric_saturated.csv", str(ampere_turns))
        state = solver.solve([ampere_turns / 840], start=state)
        report = state.report
        case = f"disk, core, up to {report.largest_flux_density:.2f} T"
        error = _errors(state.field(points), state.gradient(points), exact)
        yield Row(case, "potential, Newton", report.surface_faces, report.iterations, *error)


def _analytic_law() -> BHTable:
    """The law of tests/reference/axisymmetric_saturated.csv as a dense table."""
    b = np.linspace(0.05, 3.5, 400)
    u = b**10.8
    h = (1 / 4000 + (0.5 - 1 / 4000) * u / (u + 1.8e4)) * b / mu_0
    return BHTable("iron", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)


def _on_one_axis(case: str, core_size: float, edge: float, material: LinearMaterial | BHTable) -> Device:
    def body(name: str, shape: Cylinder, bottom: float, size: float) -> Body:
        at = Placement(np.array([0.0, 0.0, bottom]), np.eye(3))
        return Body(name, "iron", (Part(shape, at),), size, edge)

    bodies = (
        body("disk", Cylinder(0.066, 0.006), 0.0, 0.008),
        body("core", Cylinder(0.01, 0.04), 0.006, core_size),
        body("plate", Cylinder(0.066, 0.006), 0.046, 0.008),
    )
    at = Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    coil = CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at)
    count = {"disk": 1, "diskcore": 2, "spool": 3}[case]
    return Device(case, "", (coil,), bodies[:count], {"iron": material})


def _reference(file: str, case: str) -> tuple[Array, Array]:
    """Points (n, 3) in the half-plane y = 0 and columns Bz, Br, dBz/dz (and dBr/dz)."""
    lines = [line for line in (REFERENCES / file).read_text().splitlines() if line.startswith(f"{case},")]
    skip = case.count(",") + 1
    values = np.array([[float(x) for x in line.split(",")[skip:]] for line in lines])
    return np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]]), values[:, 2:]


def _errors(b: Array, g: Array, exact: Array) -> tuple[float, float]:
    ours = np.column_stack([b[:, 2], b[:, 0], g[:, 2, 2], g[:, 0, 2]])[:, : exact.shape[1]]
    error = np.abs(ours - exact).max(axis=0) / np.abs(exact).max(axis=0)
    return float(error[:2].max()), float(error[2:].max())


def shipped(name: str, mu_r: float) -> Iterator[Row]:
    """A shipped device against the known values of its file."""
    device = fm.read_device(name)
    for form in FORMS:
        unit = fm.solve_linear(device, mu_r=mu_r, form=form)
        errors: dict[bool, list[float]] = {False: [], True: []}
        for known in device.references:
            is_gradient = known.quantity.startswith("d")
            ours = (unit.gradient if is_gradient else unit.field)(known.at, known.currents)
            place = tuple("xyz".index(letter) for letter in known.quantity if letter in "xyz")
            errors[is_gradient].append(float(ours[place]) / known.value - 1)
        worst = (max(values, key=abs) for values in errors.values())
        case, faces = f"{name}, mu_r {mu_r:g} (signed)", unit.report.surface_faces
        yield Row(case, form, faces, unit.report.iterations, *worst)


def six_cores() -> Iterator[Row]:
    """Disk with six cores has no exact field: change to a finer mesh, of the largest value in the workspace."""
    device = fm.read_device("disk_six_cores")
    x, z = np.linspace(-0.02, 0.02, 5), np.linspace(-0.14, -0.076, 5)
    points = np.stack(np.meshgrid(x, x, z, indexing="ij"), axis=-1).reshape(-1, 3)
    for form in FORMS:
        one, fine = (fm.solve_linear(device, refinement=r, form=form) for r in (1.0, 1.2))
        pairs = zip(one.unit_fields(points), fine.unit_fields(points), strict=True)
        change = (float(np.abs(a - best).max() / np.abs(best).max()) for a, best in pairs)
        case = f"disk, six cores, against {fine.report.surface_faces} faces"
        yield Row(case, form, one.report.surface_faces, one.report.iterations, *change)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--all", action="store_true", help="also the large devices")
    given = parser.parse_args()
    print("| case | form | surface faces | steps | B | gradient |\n|---|---|---|---|---|---|")
    groups = [spheres(), shipped("loop_and_sphere", 1000.0), axisymmetric(), saturated()]
    if given.all:
        groups += [six_cores(), shipped("drive_unit_a3", 4000.0)]
    for group in groups:
        for row in group:
            print(row, flush=True)


if __name__ == "__main__":
    main()

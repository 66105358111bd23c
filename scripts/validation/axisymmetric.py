"""Disk, core and plate about the axis of a thick coil, against axisymmetric finite elements (tests/reference)."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
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
)
from fieldmap.iron import LinearSolution, NonlinearSolver
from validation.row import Array, Row, timed

REFERENCES = Path(__file__).parents[2] / "tests" / "reference"
WORDS = {"disk": "disk", "diskcore": "disk, core", "spool": "disk, core, plate"}
# Bounds for the open circuits, and for the circuit of two plates with a gap between them.
BOUNDS = {"disk": (1e-3, 2e-3), "diskcore": (1e-3, 2e-3), "spool": (2e-3, 3e-3)}
LINEAR = (
    ("disk", 1000),
    ("disk", 4000),
    ("diskcore", 1000),
    ("diskcore", 4000),
    ("spool", 1000),
    ("spool", 4000),
)


def linear() -> Iterator[Row]:
    """Constant permeability, both forms."""
    source = "axisymmetric finite elements, 5e-7 (tests/reference/axisymmetric.csv)"
    for case, mu in LINEAR:
        device, errors = linear_case(case, mu)
        for form in ("potential", "flux"):
            unit, wall, cpu = timed(lambda device=device, form=form: fm.solve_linear(device, form=form))
            for what, value, bound in zip(("B", "gradient"), errors(unit), BOUNDS[case], strict=True):
                yield Row(
                    f"{WORDS[case]}, mu_r {mu}, {form} form",
                    f"error of {what}",
                    value,
                    bound,
                    source,
                    unit.report.surface_faces,
                    unit.report.iterations,
                    wall,
                    cpu,
                )


def linear_case(case: str, mu_r: int) -> tuple[Device, Callable[[LinearSolution], tuple[float, float]]]:
    """A device of the reference, and a function from its solution to the errors of B and of the gradient."""
    points, exact = _reference("axisymmetric.csv", f"{case},{mu_r}")

    def errors(unit: LinearSolution) -> tuple[float, float]:
        b, g = unit.unit_fields(points)
        return _errors(b[0], g[0], exact)

    return on_one_axis(case, LinearMaterial("iron", float(mu_r))), errors


def saturated() -> Iterator[Row]:
    """Disk and core of saturating iron; each state starts from the one before."""
    source = "axisymmetric finite elements, 1e-4 and 3e-4 (tests/reference/axisymmetric_saturated.csv)"
    solver, state = NonlinearSolver(on_one_axis("diskcore", _analytic_law())), None
    for ampere_turns in (4200, 12600, 33600):
        points, exact = _reference("axisymmetric_saturated.csv", str(ampere_turns))
        state, wall, cpu = timed(lambda at=ampere_turns, start=state: solver.solve([at / 840], start=start))
        case = f"disk, core, iron up to {state.report.largest_flux_density:.2f} T"
        for what, value in zip(
            ("B", "gradient"), _errors(state.field(points), state.gradient(points), exact), strict=True
        ):
            report = state.report
            yield Row(
                case,
                f"error of {what}",
                value,
                1e-3,
                source,
                report.surface_faces,
                report.iterations,
                wall,
                cpu,
            )


def on_one_axis(case: str, material: LinearMaterial | BHTable) -> Device:
    """The device of the reference tables, with layers of 0.5 mm at sharp edges."""

    def body(name: str, shape: Cylinder, bottom: float, size: float) -> Body:
        at = Placement(np.array([0.0, 0.0, bottom]), np.eye(3))
        return Body(name, "iron", (Part(shape, at),), size, 0.0005)

    bodies = (
        body("disk", Cylinder(0.066, 0.006), 0.0, 0.008),
        body("core", Cylinder(0.01, 0.04), 0.006, 0.0025),
        body("plate", Cylinder(0.066, 0.006), 0.046, 0.008),
    )
    at = Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    coil = CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at)
    count = {"disk": 1, "diskcore": 2, "spool": 3}[case]
    return Device.unchecked(name=case, coils=(coil,), bodies=bodies[:count], materials={"iron": material})


def _analytic_law() -> BHTable:
    """The law of the saturated reference as a dense table."""
    b = np.linspace(0.05, 3.5, 400)
    u = b**10.8
    h = (1 / 4000 + (0.5 - 1 / 4000) * u / (u + 1.8e4)) * b / mu_0
    return BHTable("iron", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)


def _reference(file: str, case: str) -> tuple[Array, Array]:
    """Points (n, 3) in the half-plane y = 0 and columns Bz, Br, dBz/dz (and dBr/dz)."""
    lines = [line for line in (REFERENCES / file).read_text().splitlines() if line.startswith(f"{case},")]
    skip = case.count(",") + 1
    values = np.array([[float(x) for x in line.split(",")[skip:]] for line in lines])
    return np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]]), values[:, 2:]


def _errors(b: Array, g: Array, exact: Array) -> tuple[float, float]:
    """Largest error of each column over its own largest value: the worst of B, and the worst of the gradient."""
    ours = np.column_stack([b[:, 2], b[:, 0], g[:, 2, 2], g[:, 0, 2]])[:, : exact.shape[1]]
    error = np.abs(ours - exact).max(axis=0) / np.abs(exact).max(axis=0)
    return float(error[:2].max()), float(error[2:].max())

"""Iron and a thick coil about one axis, against an independent axisymmetric finite-element solution.

tests/reference/axisymmetric.csv says how the reference was made; its own error is 5e-7.
"""

from pathlib import Path

import numpy as np
import pytest

from fieldmap.device.model import Body, CircularCoil, Cylinder, Device, LinearMaterial, Part, Placement
from fieldmap.iron import solve_linear

TABLE = Path(__file__).parents[1] / "reference" / "axisymmetric.csv"


def reference(case, mu_r):
    """Points (n, 3) on the half-plane y = 0 and columns Bz, Br, dBz/dz, dBr/dz."""
    rows = [line.split(",") for line in TABLE.read_text().splitlines() if line.startswith(f"{case},{mu_r},")]
    values = np.array([[float(x) for x in row[2:]] for row in rows])
    points = np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]])
    return points, values[:, 2:]


def device(case, core_size=0.0025, edge=0.0005):
    def body(name, radius, bottom, height, size):
        at = Placement(np.array([0.0, 0.0, bottom]), np.eye(3))
        return Body(name, "iron", (Part(Cylinder(radius, height), at),), size, edge)

    disk = body("disk", 0.066, 0.0, 0.006, 0.008)
    core = body("core", 0.01, 0.006, 0.04, core_size)
    plate = body("plate", 0.066, 0.046, 0.006, 0.008)
    coil = CircularCoil(
        "coil", 0.011, 0.021, 0.039, 840.0, placement=Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    )
    bodies = {"disk": (disk,), "diskcore": (disk, core), "spool": (disk, core, plate)}[case]
    return Device(case, "", (coil,), bodies, {"iron": LinearMaterial("iron", 1000.0)})


def errors(case, mu_r, **mesh):
    """Largest error of each column over its largest value, and the number of surface faces."""
    points, exact = reference(case, mu_r)
    solution = solve_linear(device(case, **mesh), mu_r=float(mu_r))
    b, g = solution.unit_fields(points)
    ours = np.column_stack([b[0, :, 2], b[0, :, 0], g[0, :, 2, 2], g[0, :, 0, 2]])
    return np.abs(ours - exact).max(axis=0) / np.abs(exact).max(axis=0), solution.report.surface_faces


@pytest.mark.parametrize(("case", "mu_r", "edge"), [("disk", 1000, 0.0005), ("diskcore", 4000, 0.001)])
def test_disk_and_core(case, mu_r, edge):
    """Flux density within 0.1 %, gradient within 0.2 %. Disk and core at 1000: `test_convergence_with_the_mesh`."""
    error, _ = errors(case, mu_r, core_size=0.0035, edge=edge)
    assert (error[:2] < 1e-3).all()
    assert (error[2:] < 2e-3).all()


def test_open_magnetic_circuit_with_two_plates():
    error, _ = errors("spool", 1000, core_size=0.0035, edge=0.001)
    assert (error[:2] < 1e-3).all()
    assert (error[2:] < 2e-3).all()


def test_convergence_with_the_mesh():
    """Error against the number of unknowns: slope and bound. Both sizes, body and edge layer, are refined."""
    sequence = [(0.007, 0.004), (0.005, 0.002), (0.0035, 0.001), (0.0025, 0.0005)]
    results = [errors("diskcore", 1000, core_size=size, edge=edge) for size, edge in sequence]
    worst = np.array([error.max() for error, _ in results])
    faces = np.array([count for _, count in results])
    slope = -np.polyfit(np.log(faces), np.log(worst), 1)[0]
    assert slope > 0.9
    assert worst[-1] < 8e-4


def test_both_forms_agree_on_the_inductance():
    """Flux linkages come from the internal fields, including thin elements at edges."""
    disk = device("disk", edge=0.001)
    one, other = (
        solve_linear(disk, form=form, refinement=0.6).inductance() for form in ("potential", "flux")
    )
    # They bracket the exact value; on this coarse mesh they differ by 5e-4.
    assert one == pytest.approx(other, rel=1e-3)

"""The surface form compared with both volume forms: error over processor time on open, closed and shielding cases.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python scripts/studies/surface_form.py [CASE ...]

Cases: sphere, pair, shell, cube, disk, spool, window, barrier, unit. With one thread processor seconds are meaningful
on a busy machine; they include everything from the device to a solution, with the mesh. Each form first solves a small
body, so that the timing includes no compilation.
"""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from validation.axisymmetric import linear_case

import fieldmap as fm
from fieldmap.device.model import (
    Background,
    Body,
    Box,
    CircularCoil,
    Cylinder,
    Device,
    LinearMaterial,
    Part,
    Placement,
    Sphere,
)
from fieldmap.iron import LinearSolution

UP = np.array([0.0, 0.0, 1.0])
RADIUS = 0.05
FORMS = ("surface", "potential", "flux")
Error = Callable[[LinearSolution], float]


def in_field(body: Body, mu_r: float) -> Device:
    """One body in a uniform field of 1 T along z."""
    return Device("d", "", (), (body,), {"iron": LinearMaterial("iron", mu_r)}, background=Background(UP))


def moment_error(exact: float) -> Error:
    """Relative error of the dipole moment along z, in units of volume times T."""

    def error(solution: LinearSolution) -> float:
        assert solution.state is not None
        charge = solution.state.density[0] * solution.state.faces.areas
        return float(charge @ solution.state.faces.centres[:, 2]) / exact - 1

    return error


def sphere(size: float) -> tuple[Device, Error]:
    """An open case: a sphere, mu_r 1000."""
    body = Body("ball", "iron", (Part(Sphere(RADIUS)),), size * RADIUS)
    return in_field(body, 1000.0), moment_error(4 * np.pi * 999 / 1002 * RADIUS**3)


def pair(size: float) -> tuple[Device, Error]:
    """Two spheres half a radius apart, mu_r 1000, in a field along their axis: the moment of each, by re-expansion of
    their multipoles (`tests/iron/test_surface_form.py`, 80 orders)."""
    at = Placement(2.5 * RADIUS * UP, np.eye(3))
    parts = {"lower": (Part(Sphere(RADIUS)),), "upper": (Part(Sphere(RADIUS), at),)}
    bodies = tuple(Body(name, "iron", part, size * RADIUS) for name, part in parts.items())
    iron = {"iron": LinearMaterial("iron", 1000.0)}
    device = Device("d", "", (), bodies, iron, background=Background(UP))

    def error(solution: LinearSolution) -> float:
        assert solution.state is not None
        faces = solution.state.faces
        lower = faces.centres[:, 2] < 1.25 * RADIUS
        charge = (solution.state.density[0] * faces.areas)[lower]
        return float(charge @ faces.centres[lower, 2]) / (4 * np.pi * RADIUS**3 * PAIR) - 1

    return device, error


PAIR = 1.154800787736


def shell(size: float) -> tuple[Device, Error]:
    """Shield, a/b = 0.8, mu_r 1000: the field in the hollow is 1/40 of the applied field (Jackson 5.121)."""
    mu, ratio = 1000.0, 0.8
    parts = (Part(Sphere(RADIUS)), Part(Sphere(ratio * RADIUS), operation="cut"))
    exact = 9 * mu / ((2 * mu + 1) * (mu + 2) - 2 * ratio**3 * (mu - 1) ** 2)
    hollow = RADIUS * np.array([[0, 0, 0.0], [0.4, 0, 0], [0, 0.2, 0.4], [-0.2, 0.4, -0.2]])

    def error(solution: LinearSolution) -> float:
        return float(np.abs(solution.field(hollow, []) / exact - UP).max())

    return in_field(Body("shell", "iron", parts, size * RADIUS), mu), error


def cube(size: float) -> tuple[Device, Error]:
    """A cube with sharp edges and corners, mu_r 1e8 for infinity (Helsing and Perfekt 2013)."""
    body = Body("cube", "iron", (Part(Box((1.0, 1.0, 1.0))),), size, 0.25 * size**2)
    return in_field(body, 1e8), moment_error(3.644305190268)


def barrier(size: float) -> tuple[Device, Error]:
    """The same cube with mu_r 1e-4; the reference is the exact value at mu_r 0, which differs by about 1e-4."""
    body = Body("cube", "iron", (Part(Box((1.0, 1.0, 1.0))),), size, 0.25 * size**2)
    return in_field(body, 1e-4), moment_error(-1.638415711)


def _axisymmetric(case: str, size: float) -> tuple[Device, Error]:
    device, errors = linear_case(case, 4000)
    bodies = tuple(_scaled(body, size) for body in device.bodies)
    return Device("d", "", device.coils, bodies, device.materials), lambda solution: errors(solution)[0]


def _scaled(body: Body, size: float) -> Body:
    edge = None if body.edge_size is None else body.edge_size * size**2
    return Body(body.name, body.material, body.parts, body.mesh_size * size, edge)


def disk(size: float) -> tuple[Device, Error]:
    """A disk under a thick coil, mu_r 4000, against axisymmetric finite elements: B at 63 points."""
    return _axisymmetric("disk", size)


def spool(size: float) -> tuple[Device, Error]:
    """Disk, core and plate, mu_r 4000: a circuit with one gap."""
    return _axisymmetric("spool", size)


def window(size: float) -> tuple[Device, Error]:
    """A closed window with a coil on one limb, mu_r 1000: its inductance, against the mean of both volume forms on
    meshes of 12 720 faces (they differ by 5e-4)."""
    hole = Placement(np.array([0.0, 0.0, -0.01]), np.eye(3))
    parts = (Part(Box((0.1, 0.1, 0.02))), Part(Box((0.06, 0.06, 0.04)), hole, "cut"))
    along_y = np.column_stack([[1, 0, 0], [0, 0, -1], [0, 1, 0]]).astype(float)
    coil = CircularCoil(
        "coil", 0.017, 0.022, 0.03, 100.0, placement=Placement(np.array([0.04, 0.0, 0.01]), along_y)
    )
    body = Body("window", "iron", parts, 0.012 * size, 0.003 * size**2)
    device = Device("window", "", (coil,), (body,), {"iron": LinearMaterial("iron", 1000.0)})
    return device, lambda solution: float(solution.inductance()[0, 0]) / WINDOW - 1


WINDOW = 0.018732


def unit(size: float) -> tuple[Device, Error]:
    """The drive unit with yoke, mu_r 4000: B of all coils in the workspace against the potential form on the same mesh
    sizes."""
    device = fm.read_device("drive_unit_a3")
    x, y, z = (np.linspace(low, high, 5) for low, high in zip(*device.bounds, strict=True))
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    truth = fm.solve_linear(device, mu_r=4000.0, refinement=1 / size).unit_fields(points)[0]
    largest = np.linalg.norm(truth, axis=2).max(axis=1)

    def error(solution: LinearSolution) -> float:
        b = solution.unit_fields(points)[0]
        return float((np.linalg.norm(b - truth, axis=2).max(axis=1) / largest).max())

    bodies = tuple(_scaled(body, size) for body in device.bodies)
    iron = {name: LinearMaterial(name, 4000.0) for name in device.materials}
    return Device("unit", "", device.coils, bodies, iron, workspace=device.workspace), error


CASES = {
    "sphere": (sphere, (0.4, 0.25, 0.16, 0.1)),
    "pair": (pair, (0.25, 0.14)),
    "shell": (shell, (0.3, 0.2, 0.14)),
    "cube": (cube, (0.3, 0.2, 0.14, 0.1)),
    "disk": (disk, (1.4, 1.0, 0.7)),
    "spool": (spool, (1.4, 1.0)),
    "window": (window, (1.0, 0.7, 0.5)),
    "barrier": (barrier, (0.3, 0.2, 0.14)),
    "unit": (unit, (1.5,)),
}


def rows(case: str) -> Iterator[tuple[str, int, int, float, float]]:
    """Form, faces, steps, processor seconds and error of every mesh of a case."""
    make, sizes = CASES[case]
    for size in sizes:
        device, error = make(size)
        for form in FORMS:
            if form == "potential" and case == "barrier":
                continue
            start = time.process_time()
            solution = fm.solve_linear(device, form=form)
            seconds = time.process_time() - start
            report = solution.report
            yield form, report.surface_faces, report.iterations, seconds, error(solution)


def main(cases: list[str]) -> None:
    """Print a table of the cases."""
    warm = in_field(Body("b", "iron", (Part(Cylinder(0.01, 0.01)),), 0.005, 0.002), 10.0)
    for form in FORMS:
        fm.solve_linear(warm, form=form).field([[0.0, 0.0, 0.02]], [])
    print("| case | form | faces | steps | cpu s | error |\n|---|---|---|---|---|---|")
    for case in cases or list(CASES):
        for form, faces, steps, seconds, error in rows(case):
            print(f"| {case} | {form} | {faces} | {steps} | {seconds:.2f} | {error:+.1e} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

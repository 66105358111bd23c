"""How W is stored must not show in the result: compression forced on a small mesh, by the public doors."""

import numpy as np
import pytest
from scipy.constants import mu_0

import fieldmap as fm
from fieldmap.device.model import BHTable, Body, CircularCoil, Cylinder, Device, Part, Placement
from fieldmap.iron.operators import assembled

POINTS = np.array([[x, 0.0, z] for x in (0.0, 0.01, 0.02) for z in (-0.01, -0.02, -0.04)])


def electromagnet():
    """Disk and core of saturating iron in a coil."""
    h = np.geomspace(20.0, 1e5, 40)
    b = mu_0 * h + 2.0 * h / (h + 400.0)
    law = BHTable("iron", h, b, "straight line to the origin", "slope mu0", b[0] / h[0] / mu_0)

    def body(name, radius, height, bottom, size):
        at = Placement(np.array([0.0, 0.0, bottom]), np.eye(3))
        return Body(name, "iron", (Part(Cylinder(radius, height), at),), size, 0.003)

    bodies = (body("disk", 0.03, 0.006, 0.0, 0.01), body("core", 0.01, 0.04, 0.006, 0.008))
    at = Placement(np.array([0.0, 0.0, 0.026]), np.eye(3))
    return Device(
        "electromagnet",
        "",
        (CircularCoil("coil", 0.011, 0.021, 0.039, 840.0, placement=at),),
        bodies,
        {"iron": law},
    )


def with_storage(monkeypatch, storage, run):
    monkeypatch.setattr(assembled, "chosen_storage", lambda faces, operations: storage)
    solution = run()
    assert solution.report.storage.startswith("compressed") == (storage == "compressed")
    return solution


def assert_same(one, other):
    assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_linear_iron(monkeypatch, form):
    def run():
        return fm.solve_linear(fm.read_device("loop_and_sphere"), mu_r=1000.0, form=form)

    dense, compressed = (with_storage(monkeypatch, s, run) for s in ("dense", "compressed"))
    assert compressed.report.surface_faces > 500
    space = dense.state.faces.centres.max(axis=0)
    points = np.array([[x, 0.0, -z] for x in (0.0, 0.5) for z in (1.5, 2.0)]) * space.max()
    for one, other in zip(dense.unit_fields(points), compressed.unit_fields(points), strict=True):
        assert_same(one, other)


def test_saturating_iron(monkeypatch):
    dense, compressed = (
        with_storage(monkeypatch, s, lambda: fm.solve(electromagnet(), [40.0]))
        for s in ("dense", "compressed")
    )
    assert compressed.report.iterations == dense.report.iterations
    assert_same(dense.field(POINTS), compressed.field(POINTS))
    assert_same(dense.gradient(POINTS), compressed.gradient(POINTS))

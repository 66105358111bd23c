"""Flat-faced bodies get the volume of the curved ones, to second order better than inscribed polygons."""

import numpy as np
import pytest

from fieldmap.device.model import Body, Box, Cylinder, Device, LinearMaterial, Part, Placement, Ring, Sphere
from fieldmap.iron.mesh import mesh as mesh_module
from fieldmap.iron.mesh.mesh import generate_mesh, volumes

IRON = {"iron": LinearMaterial("iron", 100.0)}


def volume(*bodies):
    mesh = generate_mesh(Device("d", "", (), bodies, IRON))
    each = volumes(mesh.points, mesh.tets)
    assert each.min() > 0
    return np.array([each[mesh.body == k].sum() for k in range(len(bodies))])


@pytest.mark.parametrize(
    ("shape", "exact", "bound"),
    [
        (Cylinder(0.01, 0.04), np.pi * 0.01**2 * 0.04, 6e-4),
        (Ring(0.03, 0.04, 0.02), np.pi * (0.04**2 - 0.03**2) * 0.02, 6e-4),
        (Sphere(0.02), 4 / 3 * np.pi * 0.02**3, 3e-3),
        (Box((0.01, 0.02, 0.03)), 6e-6, 1e-12),
    ],
)
def test_volume(shape, exact, bound):
    assert volume(Body("b", "iron", (Part(shape),), 0.0035))[0] == pytest.approx(exact, rel=bound)


def test_without_it_the_error_is_many_times_larger(monkeypatch):
    body = Body("b", "iron", (Part(Cylinder(0.01, 0.04)),), 0.008)
    exact = np.pi * 0.01**2 * 0.04
    rounded = abs(volume(body)[0] / exact - 1)
    monkeypatch.setattr(mesh_module, "equal_volume_vertices", lambda points, *_: points)
    assert abs(volume(body)[0] / exact - 1) > 20 * rounded


def test_curved_surface_between_two_bodies():
    """A core through a plate: both keep their volume."""
    core = Body("core", "iron", (Part(Cylinder(0.01, 0.03)),), 0.006)
    through = Placement(np.array([0.0, 0, -0.01]), np.eye(3))
    plate = Body(
        "plate", "iron", (Part(Cylinder(0.04, 0.006)), Part(Cylinder(0.01, 0.05), through, "cut")), 0.006
    )
    exact = np.pi * np.array([0.01**2 * 0.03, (0.04**2 - 0.01**2) * 0.006])
    assert volume(core, plate) == pytest.approx(exact, rel=1.5e-3)

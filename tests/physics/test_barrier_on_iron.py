"""A flux barrier glued to iron: two bodies of very different permeability share one surface."""

from itertools import pairwise

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import Body, CircularCoil, Cylinder, Device, LinearMaterial, Part, Placement

AXIS = np.array([[0.0, 0.0, -0.01], [0.0, 0.0, 0.025]])


def solved(mu_r, refinement=1.0):
    """Iron rod with a cap of weak permeability under a coil, all about the z axis."""
    above = Placement(np.array([0.0, 0.0, 0.01]), np.eye(3))
    rod = Body("rod", "iron", (Part(Cylinder(0.01, 0.01)),), 0.004)
    cap = Body("cap", "cap", (Part(Cylinder(0.01, 0.005), above),), 0.004)
    at = Placement(np.array([0.0, 0.0, 0.04]), np.eye(3))
    coil = CircularCoil("coil", 0.02, 0.025, 0.01, 100.0, placement=at)
    materials = {"iron": LinearMaterial("iron", 1000.0), "cap": LinearMaterial("cap", mu_r)}
    return fm.solve_linear(Device("rod", "", (coil,), (rod, cap), materials), refinement=refinement)


@pytest.mark.parametrize("mu_r", [0.1, 1e-4])
def test_symmetry_and_mesh(mu_r):
    """No transverse field on the axis, and half the element size changes little."""
    field, finer = (solved(mu_r, refinement).field(AXIS, [1.0]) for refinement in (0.7, 1.4))
    assert np.abs(field[:, :2]).max() < 3e-3 * np.abs(field[:, 2]).min()
    assert field[:, 2] == pytest.approx(finer[:, 2], rel=5e-3)


def test_a_weaker_cap_is_nearly_a_barrier():
    """The limit mu_r -> 0 is approached steadily."""
    fields = [solved(mu_r).field(AXIS, [1.0])[:, 2] for mu_r in (1e-2, 1e-3, 1e-4)]
    first, second = (np.abs(a - b).max() for a, b in pairwise(fields))
    assert 5 * second < first < 0.02 * np.abs(fields[0]).max()

"""Solved iron as magpylib objects: magpylib's field of them against ours."""

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import (
    Body,
    CircularCoil,
    Cylinder,
    Device,
    Froehlich,
    LinearMaterial,
    Part,
    PermanentMagnet,
    Placement,
    Sphere,
)
from fieldmap.errors import InputError
from fieldmap.maps.solver_state import from_arrays, to_arrays

POINTS = np.array([[0.0, 0.0, -0.006], [0.008, 0.002, -0.004], [0.012, 0.0, 0.01], [0.0, -0.03, 0.05]])


def at(x, y, z):
    return Placement(np.array([x, y, z], float), np.eye(3))


def device(material):
    core = Body("core", "iron", (Part(Cylinder(0.005, 0.02)),), 0.004, 0.001)
    magnet = Body("magnet", "magnet", (Part(Sphere(0.003), at(0, 0, 0.03)),), 0.0015)
    coil = CircularCoil("coil", 0.006, 0.008, 0.01, 100.0, placement=at(0, 0, 0.01))
    magnetised = PermanentMagnet("magnet", np.array([0.3, 0.0, 1.0]), 1.05)
    return Device("d", "", (coil,), (core, magnet), {"iron": material, "magnet": magnetised})


def test_the_flux_form_to_rounding():
    """Its charges are those of the polarisation that is exported: two programs, one field. (Ours takes distant faces
    as point charges: 1e-6.)"""
    unit = fm.solve_linear(device(LinearMaterial("iron", 200.0)), form="flux", tolerance=1e-5)
    exported = unit.as_magpylib([3.0])
    ours = unit.field(POINTS, [3.0])
    assert exported.getB(POINTS) == pytest.approx(ours, abs=1e-5 * np.abs(ours).max())


def test_a_saturated_state_to_its_discretisation():
    """Means of the polarisation in place of the second-order form's charges: a difference that the mesh makes small."""

    def error(refinement):
        state = fm.solve(device(Froehlich("iron", 2000.0, 2.1)), [30.0], refinement=refinement)
        ours, theirs = state.field(POINTS), state.as_magpylib().getB(POINTS)
        return np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)

    coarse, fine = error(0.8), error(1.6)
    assert fine.max() < 0.02
    assert (fine < 0.7 * coarse).all()


def test_bodies_and_coils_are_told_apart():
    unit = fm.solve_linear(device(LinearMaterial("iron", 200.0)))
    exported = unit.as_magpylib([0.0])
    assert [child.style.label for child in exported.children] == ["core", "magnet"]
    assert sum(len(child.children) for child in exported.children) == len(unit.mesh.tets)
    assert len(unit.as_magpylib([1.0]).children) == 3


def test_coils_alone_and_solutions_read_back():
    alone = Device("d", "", device(LinearMaterial("iron", 2.0)).coils)
    unit = fm.solve_linear(alone)
    assert unit.as_magpylib([2.0]).getB(POINTS) == pytest.approx(
        unit.field(POINTS, [2.0]), rel=1e-6, abs=1e-12
    )
    core = Device("d", "", alone.coils, device(None).bodies[:1], {"iron": LinearMaterial("iron", 2.0)})
    stored = from_arrays(core, *to_arrays(fm.solve_linear(core)))
    with pytest.raises(InputError, match="read back from a file"):
        stored.as_magpylib([1.0])

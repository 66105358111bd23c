"""Solved iron as magpylib objects: magpylib's field of them against ours."""

import magpylib
import numpy as np
import pytest

import fieldmap as fm
from fieldmap.device.model import (
    Body,
    Box,
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
from fieldmap.maps.linear_fields import from_arrays, to_arrays
from fieldmap.sources.magpylib_objects import magpylib_coil

POINTS = np.array([[0.0, 0.0, -0.006], [0.008, 0.002, -0.004], [0.012, 0.0, 0.01], [0.0, -0.03, 0.05]])


def at(x, y, z):
    return Placement(np.array([x, y, z], float), np.eye(3))


def device(material):
    core = Body("core", "iron", (Part(Cylinder(0.005, 0.02)),), 0.004, 0.001)
    magnet = Body("magnet", "magnet", (Part(Sphere(0.003), at(0, 0, 0.03)),), 0.0015)
    coil = CircularCoil("coil", 0.006, 0.008, 0.01, 100.0, placement=at(0, 0, 0.01))
    magnetised = PermanentMagnet("magnet", np.array([0.3, 0.0, 1.0]), 1.05)
    return Device("d", "", (coil,), (core, magnet), {"iron": material, "magnet": magnetised})


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_a_magnet_to_rounding(form):
    """At mu_r = 1 the polarisation is the remanence whatever the coil does: magpylib's own block and coil."""
    remanence = np.array([0.3, -0.2, 1.0])
    block = Body("block", "magnet", (Part(Box((0.01, 0.008, 0.006)), at(0, 0, 0.02)),), 0.003)
    coil = CircularCoil("coil", 0.006, 0.008, 0.01, 100.0, placement=at(0, 0, 0.008))
    unit = fm.solve_linear(
        Device("d", "", (coil,), (block,), {"magnet": PermanentMagnet("magnet", remanence, 1.0)}), form=form
    )
    exact = magpylib.magnet.Cuboid(
        polarization=remanence, dimension=(0.01, 0.008, 0.006), position=(0, 0, 0.023)
    ).getB(POINTS) + magpylib_coil(coil, 3.0).getB(POINTS)
    assert unit.as_magpylib([3.0]).getB(POINTS) == pytest.approx(exact, rel=1e-7, abs=1e-12)


@pytest.mark.parametrize("form", ["potential", "flux"])
def test_linear_iron_to_its_discretisation(form):
    unit = fm.solve_linear(device(LinearMaterial("iron", 200.0)), form=form, refinement=1.3)
    ours, theirs = unit.field(POINTS, [3.0]), unit.as_magpylib([3.0]).getB(POINTS)
    error = np.linalg.norm(theirs - ours, axis=1) / np.linalg.norm(ours, axis=1)
    assert error.max() < 0.03


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
    core = Device(
        "d",
        "",
        alone.coils,
        device(LinearMaterial("iron", 2.0)).bodies[:1],
        {"iron": LinearMaterial("iron", 2.0)},
    )
    stored = from_arrays(core, *to_arrays(fm.solve_linear(core)))
    with pytest.raises(InputError) as caught:
        stored.as_magpylib([1.0])
    assert caught.value.problems[0].where == "magnetisation"

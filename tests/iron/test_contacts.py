"""Derivatives by sizes and places of bodies that slide along a contact: a core that stands on a disk."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import FluxDensityAt, NonlinearSolver
from fieldmap.iron.mesh import charged_faces
from fieldmap.iron.mesh.mesh import generate_mesh, volumes
from fieldmap.iron.sensitivity import by_nodes
from fieldmap.iron.sensitivity.changes import Parameters
from fieldmap.iron.sensitivity.moved_bodies import MovedBodies
from fieldmap.iron.solvers import meshed_device
from fieldmap.iron.topology import build_faces

CORE = """[[body]]
name = "core"
material = "iron"
shape = "cylinder"
radius_mm = 5.0
height_mm = 20.0
mesh_size_mm = 3.0
position_mm = [8.0, 1.0, "= thick"]
"""
TEXT = f"""format = 1
name = "foot"
title = "A core on a disk"

[parameters]
thick = 4.0

[material.iron]
kind = "arctangent"
mu_r = 500.0
saturation_polarisation_T = 2.0

[[body]]
name = "disk"
material = "iron"
shape = "cylinder"
radius_mm = 20.0
height_mm = "= thick"
mesh_size_mm = 3.0
position_mm = [0.0, 0.0, 0.0]

{CORE}
[[coil]]
name = "coil"
kind = "circular"
inner_radius_mm = 7.0
outer_radius_mm = 12.0
height_mm = 16.0
turns = 500
position_mm = [8.0, 1.0, 14.0]
"""
OTHER = CORE.replace('"core"', '"other"').replace("[8.0, 1.0,", "[-10.0, 0.0,")
TWO = TEXT.replace("[[coil]]", f"{OTHER}\n[[coil]]")
# The core is saturated at this current, A.
CURRENT = 6.0
AT = FluxDensityAt([[0.0, 0.002, -0.006], [0.015, 0.003, 0.03]])
# Key: its value, and the step of differences on moved nodes.
KEYS = {
    "body.disk.radius_mm": (20.0, 0.04),
    "body.core.radius_mm": (5.0, 0.01),
    "body.core.position_mm.1": (8.0, 0.02),
    "parameters.thick": (4.0, 0.01),
}
# Key: the step of differences between two new meshes, and the allowed relative error of the derivative.
NEW_MESHES = {
    "body.disk.radius_mm": (1.0, 0.04),
    "body.core.radius_mm": (0.25, 0.02),
    "parameters.thick": (0.2, 0.03),
}


@cache
def state(refinement=0.8):
    return NonlinearSolver(TEXT, refinement, symmetry="none").solve([CURRENT], tolerance=1e-8)


def moved(key, step, mesh=None):
    """The meshes with the key a step above and a step below."""
    mesh, device = mesh or state().mesh, fm.read_device(TEXT)
    change = Parameters(device).change(key, step)
    points = MovedBodies(device, mesh, build_faces(mesh.points, mesh.tets)).points(change)
    return [replace(mesh, points=one) for one in points]


@pytest.fixture
def closed_form_between_all_faces(monkeypatch):
    """As in test_moved_bodies.py: pairs of faces that cross three radii would make noise."""
    for module in (charged_faces, by_nodes):
        monkeypatch.setattr(module, "NEAR_RADII", 1e3)


@cache
def solved_by_closed_forms():
    """A state on a coarse mesh, and its derivatives."""
    solved = NonlinearSolver(TEXT, 0.4, symmetry="none").solve([CURRENT], tolerance=1e-8)
    return solved, solved.derivative(AT, list(KEYS))


@pytest.mark.parametrize("key", KEYS)
def test_against_differences_of_whole_solves_on_moved_nodes(key, closed_form_between_all_faces, monkeypatch):
    value, step = KEYS[key]
    solved, derivatives = solved_by_closed_forms()
    fields = []
    for side, mesh in zip((1, -1), moved(key, step, solved.mesh), strict=True):
        monkeypatch.setattr(meshed_device, "generate_mesh", lambda *_, mesh=mesh: mesh)
        device = fm.read_device(TEXT, {key: value + side * step})
        fields.append(NonlinearSolver(device).solve([CURRENT], tolerance=1e-8).field(AT.points))
    difference = (fields[0] - fields[1]) / (2 * step)
    assert np.abs(derivatives[key] - difference).max() <= 5e-5 * np.abs(difference).max()


def off_from_new_meshes(text, key, value, step):
    """Relative error of a derivative by a shape, which does not depend on how nodes move, against two new meshes."""
    ahead, behind = (
        NonlinearSolver(fm.read_device(text, {key: value + side * step}), 1.2)
        .solve([CURRENT])
        .field(AT.points)
        for side in (1, -1)
    )
    difference = (ahead - behind) / (2 * step)
    here = NonlinearSolver(text, 1.2, symmetry="none").solve([CURRENT], tolerance=1e-8)
    return np.abs(here.derivative(AT, [key])[key] - difference).max() / np.abs(difference).max()


@pytest.mark.parametrize("key", NEW_MESHES)
def test_against_differences_of_new_meshes(key):
    step, bound = NEW_MESHES[key]
    assert off_from_new_meshes(TEXT, key, KEYS[key][0], step) <= bound


HOOK = """
[[body]]
name = "hook"
material = "iron"
mesh_size_mm = 3.0

[[body.part]]   # the leg
shape = "box"
size_mm = [6.0, 6.0, "= thick * 4"]
position_mm = [-10.0, 0.0, "= thick"]

[[body.part]]   # an arm on it
shape = "box"
size_mm = [14.0, 6.0, 5.0]
position_mm = [-14.0, 0.0, "= thick * 5"]
"""


HOOKED = TEXT.replace("[[coil]]", f"{HOOK}\n[[coil]]")


def test_parts_of_a_body_carry_their_faces():
    """A leg that grows lifts the arm on it: the volume follows the formula, and all faces stay in their planes."""
    device = fm.read_device(HOOKED)
    mesh = generate_mesh(device, 1.2, symmetry="none")
    change = Parameters(device).change("parameters.thick", 0.2)
    above, _ = MovedBodies(device, mesh, build_faces(mesh.points, mesh.tets)).points(change)
    hook = mesh.nodes_of_bodies[2]
    before, after = mesh.points[hook], above[hook]
    for height, moved in ((4e-3, 4.2e-3), (20e-3, 21e-3), (25e-3, 26e-3)):
        plane = np.abs(before[:, 2] - height) < 1e-9
        assert plane.any()
        inside = (np.abs(before[:, 0] + 0.01) < 2.9e-3) & (np.abs(before[:, 1]) < 2.9e-3)
        # No face separates the leg from the arm.
        face = plane & ~(inside & (height == 20e-3))
        np.testing.assert_allclose(after[face, 2], moved, atol=1e-12)
    side = np.abs(np.abs(before[:, 1]) - 3e-3) < 1e-9
    np.testing.assert_allclose(after[side, 1], before[side, 1], atol=1e-12)
    of_hook = mesh.body == 2
    volume = volumes(above, mesh.tets)[of_hook].sum()
    assert volume == pytest.approx(36e-6 * 16.8e-3 + 14e-3 * 30e-6, rel=1e-9)


def test_parts_against_differences_of_new_meshes():
    assert off_from_new_meshes(HOOKED, "parameters.thick", 4.0, 0.2) <= 0.03


def test_a_disk_grows_under_its_core():
    """Its rim and the volume follow the formula, its planes stay planes, and the core stays where it is."""
    mesh = state().mesh
    above, _ = moved("body.disk.radius_mm", 2.0)
    disk, core = mesh.nodes_of_bodies
    np.testing.assert_array_equal(above.points[core], mesh.points[core])
    np.testing.assert_allclose(above.points[disk, 2], mesh.points[disk, 2], atol=1e-12)
    distance = np.hypot(*mesh.points[disk, :2].T)
    rim = distance > 0.0199
    np.testing.assert_allclose(above.points[disk][rim, :2], 1.1 * mesh.points[disk][rim, :2], rtol=1e-9)
    of_disk = mesh.body == 0
    total = [volumes(one.points, mesh.tets)[of_disk].sum() for one in (above, mesh)]
    assert total[0] / total[1] == pytest.approx(1.1**2, rel=1e-9)
    assert volumes(above.points, mesh.tets).min() > 0


def test_a_core_grows_on_its_disk():
    mesh = state().mesh
    above, _ = moved("body.core.radius_mm", 0.5)
    disk, core = mesh.nodes_of_bodies
    axis = np.array([0.008, 0.001])
    before, after = (one.points[core, :2] - axis for one in (mesh, above))
    np.testing.assert_allclose(after, 1.1 * before, atol=1e-15)
    np.testing.assert_allclose(above.points[disk, 2], mesh.points[disk, 2], atol=1e-12)
    rim = np.hypot(*mesh.points[disk, :2].T) > 0.0199
    np.testing.assert_allclose(above.points[disk][rim], mesh.points[disk][rim], atol=1e-15)
    # Nodes of the disk outside the contact make room.
    beside = np.setdiff1d(disk, core)
    assert np.abs(above.points[beside] - mesh.points[beside]).max() > 0.2e-3


@pytest.mark.parametrize(
    ("text", "key", "who"),
    [
        (TEXT, "body.core.position_mm.3", "'disk' and 'core'"),
        (TWO, "body.other.position_mm.3", "'disk' and 'other'"),
        # The core crosses the disk's rim: edges of both bodies bound the contact.
        (TEXT.replace("[8.0, 1.0,", "[18.0, 1.0,"), "body.disk.radius_mm", "'disk' and 'core'"),
    ],
    ids=["lifted", "one of two lifted", "across the rim"],
)
def test_refused(text, key, who):
    solved = fm.solve_linear(text, refinement=0.5).at([1.0])
    with pytest.raises(InputError, match="touch") as caught:
        solved.derivative(FluxDensityAt([0.0, 0.0, -0.02]), [key])
    assert who in str(caught.value)

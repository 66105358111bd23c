"""Derivatives of solved states by places and sizes of bodies: against whole solves on the mesh with moved nodes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fieldmap as fm
from fieldmap.errors import InputError
from fieldmap.iron import FluxDensityAt, FluxLinkage, GradientAt, NonlinearSolver
from fieldmap.iron.mesh import charged_faces
from fieldmap.iron.mesh.mesh import volumes
from fieldmap.iron.sensitivity import by_nodes
from fieldmap.iron.sensitivity.changes import Parameters
from fieldmap.iron.sensitivity.moved_bodies import MovedBodies
from fieldmap.iron.solvers import linear, meshed_device
from fieldmap.iron.topology import build_faces
from tests.conftest import DEVICES

DEVICE, COARSE = DEVICES / "core_and_magnet.toml", 0.4
# The last point is close to the block; elsewhere, turning the block changes the field by only 1e-6 per degree.
POINTS = np.array([[0.0, 0.001, -0.02], [0.01, 0.003, 0.033], [-0.011, 0.002, 0.025]])
CURRENTS = (60.0, 20.0)
QUANTITIES = {"field": FluxDensityAt(POINTS), "gradient": GradientAt(POINTS[1:]), "linkage": FluxLinkage()}


def turned(x, value):
    """About the z axis through the block's middle, (-16, 0) mm, by value in degrees."""
    cosine, sine, middle = np.cos(np.radians(value)), np.sin(np.radians(value)), np.array([-0.016, 0.0, 0.0])
    return (x - middle) @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) + middle


# Key: its value, step of the difference, body, and where its points go.
KEYS = {
    "body.core.radius_mm": (5.0, 0.01, "core", lambda x, v: x * [v / 5, v / 5, 1]),
    "body.core.height_mm": (30.0, 0.02, "core", lambda x, v: x * [1, 1, v / 30]),
    "body.plate.size_mm.2": (10.0, 0.02, "plate", lambda x, v: x * [1, v / 10, 1]),
    "body.plate.position_mm.3": (42.0, 0.02, "plate", lambda x, v: x + [0, 0, 1e-3 * (v - 42)]),
    "body.magnet.position_mm.1": (12.0, 0.02, "magnet", lambda x, v: x + [1e-3 * (v - 12), 0, 0]),
    # The linkage changes by only 5e-5 of itself: a difference over a smaller step is noise.
    "body.block.rotation_deg.3": (0.0, 0.15, "block", turned),
}


@pytest.fixture(autouse=True, scope="module")
def closed_form_between_all_faces():
    """Beyond three radii the potential between two faces is a sum over points, and a pair that crosses that distance
    jumps by the error of the sum. Differences over a small step see that as noise of 1e-4. These tests take the closed
    form for all pairs, in solutions and derivatives alike."""
    patch = pytest.MonkeyPatch()
    for module in (charged_faces, by_nodes):
        patch.setattr(module, "NEAR_RADII", 1e3)
    yield
    patch.undo()


@cache
def base(linear_iron):
    if linear_iron:
        return fm.solve_linear(text(), tolerance=1e-9, symmetry="none", refinement=COARSE).at(CURRENTS)
    return NonlinearSolver(text(), COARSE, symmetry="none").solve(CURRENTS, tolerance=1e-8)


@cache
def text():
    block = 'name = "block"\n'
    return DEVICE.read_text(encoding="utf-8").replace(block, f"{block}rotation_deg = [0, 0, 0]\n")


@cache
def found(linear_iron, name):
    return base(linear_iron).derivative(QUANTITIES[name], list(KEYS))


def solved_on(mesh, key, value, linear_iron, monkeypatch):
    module = linear if linear_iron else meshed_device
    monkeypatch.setattr(module, "generate_mesh", lambda *_: mesh)
    device = fm.read_device(text(), {key: value})
    if linear_iron:
        return fm.solve_linear(device, tolerance=1e-9).at(CURRENTS)
    return NonlinearSolver(device).solve(CURRENTS, tolerance=1e-8)


def moved_state(key, shift, linear_iron, monkeypatch):
    """The state with a key changed by a shift, on the mesh whose nodes are moved by this file's own formula."""
    value, _, name, move = KEYS[key]
    mesh = base(linear_iron).mesh
    nodes = np.unique(mesh.tets[mesh.body == mesh.body_names.index(name)])
    points = mesh.points.copy()
    points[nodes] = move(points[nodes], value + shift)
    return solved_on(replace(mesh, points=points), key, value + shift, linear_iron, monkeypatch)


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("linear_iron", [False, True])
def test_against_differences_of_whole_solves(key, linear_iron, monkeypatch):
    step = KEYS[key][1]
    ahead, behind = (moved_state(key, side * step, linear_iron, monkeypatch) for side in (1, -1))
    pairs = {
        "field": (ahead.field(POINTS), behind.field(POINTS)),
        "gradient": (ahead.gradient(POINTS[1:]), behind.gradient(POINTS[1:])),
        # The linkage in air does not depend on the bodies.
        "linkage": (ahead._iron_linkage, behind._iron_linkage),
    }
    for quantity, (one, other) in pairs.items():
        difference = (one - other) / (2 * step)
        error = np.abs(found(linear_iron, quantity)[key] - difference).max()
        assert error <= 5e-5 * np.abs(difference).max(), quantity


@pytest.mark.parametrize("key", ["body.magnet.position_mm.1", "body.core.radius_mm"])
def test_taylor(key, monkeypatch):
    """The remainder after the first order falls with the square of the step."""
    derivative = found(False, "field")[key]
    left = [
        np.linalg.norm(
            moved_state(key, step, False, monkeypatch).field(POINTS)
            - base(False).field(POINTS)
            - step * derivative
        )
        for step in (0.4, 0.2, 0.1)
    ]
    slope = np.log2(np.array(left[:-1]) / left[1:])
    assert np.all(np.abs(slope - 2) < 0.25), slope


WHOLE = """format = 1
name = "whole"
title = "A ball in a ring"

[parameters]
z = 0.0
gauge = 1.0

[material.iron]
kind = "arctangent"
mu_r = 500.0
saturation_polarisation_T = 2.0

[[body]]
name = "ball"
material = "iron"
shape = "sphere"
radius_mm = "= 4*gauge"
mesh_size_mm = 4.0
position_mm = [0.0, 0.0, "= z + 3"]

[[body]]
name = "ring"
material = "iron"
shape = "ring"
inner_radius_mm = "= 8*gauge"
outer_radius_mm = "= 10*gauge"
height_mm = 3.0
mesh_size_mm = 5.0
position_mm = [0.0, 0.0, "= z"]

[[coil]]
name = "coil"
kind = "circular"
inner_radius_mm = 12.0
outer_radius_mm = 14.0
height_mm = 4.0
turns = 500
position_mm = [1.0, 0.0, "= z + 10"]
"""


@cache
def whole():
    return NonlinearSolver(WHOLE, 0.7, symmetry="none").solve([20.0], tolerance=1e-8)


def test_a_machine_that_moves_as_a_whole_takes_its_field_along():
    """The field at a fixed point changes by minus its gradient: coil and bodies follow the parameter together."""
    points = np.array([[0.001, 0.002, -0.006], [0.006, 0.0, 0.004]])
    result = whole().derivative(FluxDensityAt(points), ["parameters.z"])
    expected = -1e-3 * whole().gradient(points)[:, :, 2]
    np.testing.assert_allclose(result["parameters.z"], expected, atol=2e-5 * np.abs(expected).max())


def test_nodes_follow_their_shapes():
    """Spheres and rings: nodes stay on the surfaces, and the volume follows its formula."""
    device, mesh = fm.read_device(WHOLE), whole().mesh
    change = Parameters(device).change("parameters.gauge", 0.1)
    above, _ = MovedBodies(device, mesh, build_faces(mesh.points, mesh.tets)).points(change)
    ring = np.unique(mesh.tets[mesh.body == 1])
    distance = np.hypot(*above[ring, :2].T)
    before = np.hypot(*mesh.points[ring, :2].T)
    assert distance[np.isclose(before, 0.008)] == pytest.approx(0.0088)
    assert distance[np.isclose(before, 0.010)] == pytest.approx(0.0110)
    ball = mesh.body == 0
    ratio = volumes(above, mesh.tets)[ball] / volumes(mesh.points, mesh.tets)[ball]
    assert ratio == pytest.approx(1.1**3)


def test_touching_bodies_move_together_or_not_at_all():
    boxes = [
        fm.Body(name, "iron", fm.Box((4e-3, 4e-3, 4e-3)), 4e-3).moved([x, 1e-3, 0.0])
        for name, x in (("one", 0.0), ("two", 4e-3))
    ]
    coil = fm.CircularCoil("coil", 0.012, 0.014, 4e-3, 500)
    device = fm.Device("pair", "", (coil,), boxes, {"iron": fm.LinearMaterial("iron", 100.0)})
    state = fm.solve_linear(device, refinement=0.5).at([1.0])
    quantity = FluxDensityAt([0.0, 0.0, -0.01])
    both = state.derivative(quantity, ["body.*.position_mm.2"])
    assert np.abs(both["body.*.position_mm.2"]).max() > 0
    with pytest.raises(InputError) as caught:
        state.derivative(quantity, ["body.one.position_mm.2"])
    assert caught.value.problems[0].where == "derivative, body.one.position_mm.2"


def test_many_keys_take_one_pass_over_the_pairs(monkeypatch):
    """Each key has the derivative that it has alone, when other faces count as moving."""
    calls, own = [], by_nodes.mutual_gradient
    monkeypatch.setattr(by_nodes, "mutual_gradient", lambda *args: calls.append(1) or own(*args))
    together = base(True).derivative(QUANTITIES["field"], list(KEYS))
    assert len(calls) == 1
    for key in ("body.plate.size_mm.2", "body.block.rotation_deg.3"):
        alone = base(True).derivative(QUANTITIES["field"], [key])[key]
        np.testing.assert_allclose(together[key], alone, atol=1e-12 * np.abs(alone).max())


def test_a_mesh_with_symmetry_has_the_derivatives_of_the_same_without(monkeypatch):
    """A ball that moves against the symmetry, and a size that keeps it. For the many pairs of triangles of equal size,
    rounding decides which triangle gets the outer rule, so whole solves with and without symmetry have differences 5e-5
    apart."""
    device = WHOLE.replace("[1.0, 0.0,", "[0.0, 0.0,")
    keys, at = ["body.ball.position_mm.1", "body.ring.height_mm"], FluxDensityAt([[0.001, 0.002, -0.006]])
    state = NonlinearSolver(device, 0.7).solve([20.0], tolerance=1e-8)
    assert state.mesh.symmetry is not None
    found = state.derivative(at, keys)
    monkeypatch.setattr(meshed_device, "generate_mesh", lambda *_: replace(state.mesh, symmetry=None))
    expected = NonlinearSolver(device).solve([20.0], tolerance=1e-8).derivative(at, keys)
    for key in keys:
        np.testing.assert_allclose(found[key], expected[key], atol=1e-4 * np.abs(expected[key]).max())

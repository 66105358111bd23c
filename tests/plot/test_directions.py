"""Every arrow of every picture has the right direction: vectors of three different components, against literals."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista as pv
from matplotlib.figure import Figure

import fieldmap as fm
from fieldmap.constants import GRAVITY
from fieldmap.field import as_field
from fieldmap.plot import force_slice
from fieldmap.plot.device_drawing import add_directions, add_payload, arrows_at
from fieldmap.plot.forces import _add_coils, add_equilibrium, add_forces
from fieldmap.plot.live_window import _along
from fieldmap.plot.picture import _add_net_force
from fieldmap.plot.shown import Shown

# B = SLOPE x + (0.1, 0.2, -0.3) T per ampere. SLOPE is symmetric, so rows and columns give the same forces.
SLOPE = np.array([[1.0, 0.5, 0.4], [0.5, -3.0, -0.2], [0.4, -0.2, 2.0]])
FLUX = np.array([0.1, 0.2, -0.3])
LOWER, UPPER = np.array([-0.01, -0.02, -0.05]), np.array([0.01, 0.02, -0.02])
PAYLOAD = fm.Payload(mass=0.01, moment=0.3, magnet=fm.MagnetCylinder(0.004, 0.01, 1.2))
# m dBz/dx_j with m = 0.3 A m^2 upward.
FORCE = 0.3 * np.array([0.4, -0.2, 2.0])
NET = FORCE - [0.0, 0.0, 0.01 * GRAVITY]
ARROW = pv.Arrow(start=(-0.5, 0.0, 0.0), tip_length=0.4, tip_radius=0.15, shaft_radius=0.05)
TIP = int(np.argmax(ARROW.points[:, 0]))


class Slanted:
    coil_names, lower, upper, proportional = ("one",), LOWER, UPPER, True

    def __init__(self, slope=SLOPE):
        self.slope = slope

    def field(self, points, currents):
        return currents[0] * (np.atleast_2d(points) @ self.slope.T + FLUX)

    def gradient(self, points, currents):
        return currents[0] * np.broadcast_to(self.slope, (len(np.atleast_2d(points)), 3, 3))


def along(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def drawn_vectors(mesh):
    """Vectors (n, 3), mm, from tail to tip of each arrow in a mesh."""
    arrows = np.asarray(mesh.points, float).reshape(-1, ARROW.n_points, 3)
    tails = arrows[:, np.asarray(ARROW.points[:, 0]) <= -0.5 + 1e-6].mean(axis=1)
    return arrows[:, TIP] - tails


@pytest.fixture
def scene():
    made = pv.Plotter(off_screen=True)
    yield made
    made.close()


def meshes(scene):
    """The meshes of a scene, in the order in which they were added."""
    mappers = [actor.mapper for actor in scene.actors.values() if isinstance(actor, pv.Actor)]
    for mapper in mappers:
        mapper.Update()
    return [pv.wrap(mapper.GetInput()) for mapper in mappers]


def arrows_in(scene):
    """The vectors of the largest mesh of a scene, which has many arrows."""
    return drawn_vectors(max(meshes(scene), key=lambda mesh: mesh.n_points))


def shown(**more):
    return Shown(
        "slanted",
        field=as_field(Slanted()),
        currents=np.ones(1),
        lower=LOWER,
        upper=UPPER,
        payload=PAYLOAD,
        **more,
    )


def test_arrows_of_given_vectors():
    vectors = np.array([[1.0, 2.0, 3.0], [-2.0, 0.5, -1.0]])
    found = drawn_vectors(arrows_at(np.zeros((2, 3)), vectors, 7.0))
    np.testing.assert_allclose(found, 7.0 * vectors / np.sqrt(14.0), atol=1e-5)


def test_directions_of_the_flux_density(scene):
    add_directions(scene, as_field(Slanted(0 * SLOPE)).at([2.0]), (LOWER, UPPER))
    found = along(arrows_in(scene))
    np.testing.assert_allclose(found, np.tile(along(FLUX), (len(found), 1)), atol=1e-5)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_magnetic_force(scene, direction, sign):
    add_forces(scene, replace(shown(), payload=replace(PAYLOAD, direction=direction)), "")
    found = along(arrows_in(scene))
    np.testing.assert_allclose(found, np.tile(sign * along(FORCE), (len(found), 1)), atol=1e-5)


def test_net_force_about_the_equilibrium(scene):
    add_equilibrium(scene, shown(equilibrium=np.array([0.0, 0.0, -0.03])), "")
    found = along(arrows_in(scene))
    np.testing.assert_allclose(found, np.tile(along(NET), (len(found), 1)), atol=1e-5)


def test_net_force_in_a_picture(scene):
    _add_net_force(scene, SimpleNamespace(payload=PAYLOAD), Slanted(), 1.0)
    found = along(arrows_in(scene))
    np.testing.assert_allclose(found, np.tile(along(NET), (len(found), 1)), atol=1e-5)


@pytest.mark.parametrize(("normal", "across"), [("x", (1, 2)), ("y", (0, 2)), ("z", (0, 1))])
def test_net_force_in_a_slice(normal, across):
    ax = Figure().add_subplot()
    force_slice(Slanted(), [1.0], normal=normal, payload=PAYLOAD, ax=ax)
    (quiver,) = [one for one in ax.collections if type(one).__name__ == "Quiver"]
    np.testing.assert_allclose(quiver.U, NET[across[0]], rtol=1e-9)
    np.testing.assert_allclose(quiver.V, NET[across[1]], rtol=1e-9)


@pytest.mark.parametrize(("direction", "sign"), [("up", 1.0), ("down", -1.0)])
def test_moment_of_the_payload(scene, direction, sign):
    """From the face of the magnet in the moment's direction; the magnet is 10 mm high."""
    add_payload(scene, replace(PAYLOAD, direction=direction), np.array([1.0, 2.0, -30.0]))
    arrow = meshes(scene)[-1]
    np.testing.assert_allclose(np.sort(sign * (np.array(arrow.bounds[4:]) + 30.0)), [5.0, 15.0], atol=1e-4)
    # The cone is the widest part, and is beyond the shaft.
    away = np.hypot(arrow.points[:, 0] - 1.0, arrow.points[:, 1] - 2.0)
    assert sign * (arrow.points[np.argmax(away), 2] + 30.0) > 11.0


def test_moments_of_pieces(scene):
    """Of each magnet, from its own place along its own axis; soft iron has none of its own."""
    turned = fm.PayloadPiece(
        fm.MagnetCylinder(0.002, 0.004, 1.2), fm.placed([0.003, -0.001, 0.002], [50.0, 30.0, 40.0])
    )
    along = np.asarray(turned.placement.rotation)[:, 2]
    assert np.abs(along).min() > 0.1
    soft = fm.PayloadPiece(fm.SoftSphere(0.002, mu_r=100.0), fm.placed([-0.004, 0.0, 0.0]))
    upright = fm.PayloadPiece(fm.MagnetBlock((0.001, 0.006, 0.002), 1.2), fm.placed([0.0, 0.006, 0.0]))
    add_payload(scene, fm.Payload(1e-3, pieces=[turned, soft, upright]), np.array([1.0, 2.0, -30.0]))
    pointing = [mesh for mesh in meshes(scene) if mesh.n_points == pv.Arrow().n_points]
    expected = [([4.0, 1.0, -28.0], along, 2.0, 6.0), ([1.0, 8.0, -30.0], [0.0, 0.0, 1.0], 1.0, 7.0)]
    assert len(pointing) == len(expected)
    for arrow, (centre, way, first, last) in zip(pointing, expected, strict=True):
        ahead = (np.asarray(arrow.points, float) - centre) @ way
        np.testing.assert_allclose([ahead.min(), ahead.max()], [first, last], atol=1e-4)
        tip = arrow.points[np.argmax(ahead)]
        np.testing.assert_allclose(tip, centre + last * np.asarray(way), atol=1e-4)


def test_what_each_coil_makes(scene):
    """From the constant force to the force at the coil's upper limit."""
    start, makes = np.array([1.0, 2.0, 3.0]), np.array([[0.5, -1.0, 2.0]])
    found = SimpleNamespace(
        constant=start, coil_names=("one",), per_ampere=makes, upper=np.array([2.0]), lower=np.array([-1.0])
    )
    _add_coils(scene, found, np.ones(3), 10.0)
    points = meshes(scene)[0].points
    ahead = (points - start) @ makes[0]
    np.testing.assert_allclose(points[np.argmax(ahead)], start + 2.0 * makes[0], atol=1e-5)
    assert ahead.min() > -1e-3


def test_force_in_the_live_window():
    pose = _along(along(FORCE), 5.0, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(pose @ [0.0, 0.0, 0.0, 1.0], [1.0, 2.0, 3.0, 1.0])
    np.testing.assert_allclose(pose @ [1.0, 0.0, 0.0, 1.0], [*(5.0 * along(FORCE) + [1.0, 2.0, 3.0]), 1.0])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(125.0)

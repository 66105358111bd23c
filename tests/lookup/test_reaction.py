"""The iron's reaction in a map: forces on magnets that it draws to the iron, and their energy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.errors import OutsideMapError
from fieldmap.lookup import compiled_wrench, magnetic_body
from fieldmap.lookup.actuation import actuation
from fieldmap.lookup.magnetic_body import MagneticBody
from tests.iron.test_reaction import BOX, ball, series

PLACE = np.array([0.002, 0.001, -0.0253])
TURN = Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
CURRENT = np.array([0.5])
STEP = 1e-5


@pytest.fixture(scope="module")
def device():
    return fm.read_device("desk_levitator")


@pytest.fixture(scope="module")
def file(device, tmp_path_factory):
    path = tmp_path_factory.mktemp("reaction") / "levitator.h5"
    return fm.generate(device, path, spacing=3e-3, progress=False)


@pytest.fixture(scope="module", params=["harmonic", "hermite"])
def field(file, request):
    return fm.open_map(file, kind=request.param)


@pytest.fixture(scope="module")
def without(file, field):
    return fm.open_map(file, kind=field.kind, reaction=False)


def bodies(device):
    """A finite magnet; the magnet with a soft bead; and the bead alone."""
    magnet = magnetic_body(device.payload, level=2)
    bead = magnetic_body(fm.SoftSphere(4e-3, mu_r=500.0))
    piece = bead.soft[0]
    moved = fm.Payload(mass=0.01, pieces=[fm.SoftSphere(4e-3, mu_r=500.0)])
    both = MagneticBody(magnet.points, magnet.moments, soft=magnetic_body(moved).soft)
    assert piece.volume > 0
    return {"magnet": magnet, "magnet and bead": both, "bead": bead}


@pytest.fixture(scope="module", params=["magnet", "magnet and bead", "bead"])
def body(device, request):
    return bodies(device)[request.param]


def turned(axis, angle):
    return Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix() @ TURN


def test_force_and_torque_are_derivatives_of_the_energy(field, body):
    load = body.wrench(field, PLACE, CURRENT, TURN)
    by_place = [
        (body.energy(field, PLACE - h, CURRENT, TURN) - body.energy(field, PLACE + h, CURRENT, TURN))
        / (2 * STEP)
        for h in STEP * np.eye(3)
    ]
    by_turn = [
        (
            body.energy(field, PLACE, CURRENT, turned(k, -STEP))
            - body.energy(field, PLACE, CURRENT, turned(k, STEP))
        )
        / (2 * STEP)
        for k in range(3)
    ]
    assert load[:3] == pytest.approx(np.array(by_place), abs=2e-6 * np.abs(load[:3]).max())
    assert load[3:] == pytest.approx(np.array(by_turn), abs=2e-6 * np.abs(load[3:]).max() + 1e-12)


def test_stiffness_is_the_derivative_of_the_force(field, body):
    stiffness = body.stiffness(field, PLACE, CURRENT, TURN)
    slopes = [
        (body.wrench(field, PLACE - h, CURRENT, TURN)[:3] - body.wrench(field, PLACE + h, CURRENT, TURN)[:3])
        / (2 * STEP)
        for h in STEP * np.eye(3)
    ]
    assert stiffness == pytest.approx(np.array(slopes).T, abs=5e-6 * np.abs(stiffness).max())


def test_actuation_holds_the_reaction(field, body):
    """Matrix and constant about a current give the load there; the matrix is the load's derivative by the current."""
    about = actuation(field, PLACE, CURRENT, body, TURN)
    load = body.wrench(field, PLACE, CURRENT, TURN)
    assert about.matrix[8:] @ CURRENT + about.constant[8:] == pytest.approx(load, rel=1e-9)
    h = 1e-4
    slope = (body.wrench(field, PLACE, CURRENT + h, TURN) - body.wrench(field, PLACE, CURRENT - h, TURN)) / (
        2 * h
    )
    assert about.matrix[8:, 0] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())


def test_all_ways_to_ask_agree(field, device):
    """One dipole in the C core, several places, a body of one dipole, and numba's caller."""
    moment = np.array([0.1, 0.2, 1.0])
    load = field.wrench(PLACE, moment, CURRENT)
    one = MagneticBody(np.zeros((1, 3)), moment[None])
    assert field.wrench(np.stack([PLACE, PLACE]), moment, CURRENT)[1] == pytest.approx(load, rel=1e-9)
    assert field.wrench(PLACE, one, CURRENT) == pytest.approx(load, rel=1e-9)
    assert field.at(CURRENT).wrench(PLACE, moment) == pytest.approx(load, rel=1e-9)
    body = bodies(device)["magnet and bead"]
    function, data = compiled_wrench(field, body)
    wrench, slopes = np.zeros(6), np.zeros((6, 1))
    assert function(data, CURRENT, PLACE, TURN, wrench, slopes)
    assert wrench == pytest.approx(body.wrench(field, PLACE, CURRENT, TURN), rel=1e-9)
    about = actuation(field, PLACE, CURRENT, body, TURN)
    assert slopes == pytest.approx(about.matrix[8:], rel=1e-9)


@pytest.mark.parametrize("kind", ["harmonic", "hermite"])
def test_torque_on_a_tilted_dipole_beside_a_ball(tmp_path, kind):
    """m x A m with A of the closed series: across and along the radius of the ball, which is z."""
    device = replace(ball(fm.LinearMaterial("iron", 10.0)), workspace=fm.WorkspaceBox(*BOX))
    field = fm.open_map(fm.generate(device, tmp_path / "ball.h5", spacing=2e-3, progress=False), kind=kind)
    moment = 0.7 * np.array([0.6, 0.0, 0.8])
    for distance in (0.035, 0.045):
        along, across = series(10.0, distance)[0].ravel()
        torque = field.wrench([0.0, 0.0, -distance], moment, [0.0])[3:]
        exact = moment[2] * moment[0] * (across - along)
        assert torque == pytest.approx([0.0, exact, 0.0], abs=5e-3 * abs(exact))


def test_currents_for_a_force_count_it(field, without, device):
    moment, force = [0.0, 0.0, device.payload.moment], [np.nan, np.nan, device.payload.mass * 9.80665]
    place = [0.0, 0.0, -0.022]
    currents = field.currents_for(place, force, moment)
    assert field.wrench(place, moment, currents)[2] == pytest.approx(force[2], rel=1e-9)
    alone = without.currents_for(place, force, moment)
    drawn = field.wrench(place, moment, [0.0])[2]
    assert currents / alone == pytest.approx(1.0 - drawn / force[2], rel=1e-9)


def test_left_out_and_outside(file, field, without):
    moment = [0.0, 0.0, 1.0]
    assert without.wrench(PLACE, moment, [0.0]) == pytest.approx(np.zeros(6), abs=1e-15)
    assert field.wrench(PLACE, moment, [0.0])[2] > 1e-3
    assert without.wrench(PLACE, moment, CURRENT) == pytest.approx(
        field.wrench(PLACE, moment, CURRENT) - field.wrench(PLACE, moment, [0.0]), rel=1e-9
    )
    with pytest.raises(OutsideMapError):
        field.wrench([0.0, 0.0, -0.1], moment, CURRENT)


def test_force_on_the_magnet_as_a_body_of_the_device(file, device, tmp_path):
    """The full solver with the magnet meshed: at several places, with the coil off and on."""
    field = fm.open_map(file)
    body = magnetic_body(device.payload, level=3)
    magnet = fm.PermanentMagnet("ndfeb", np.array([0.0, 0.0, 1.2]), 1.0)
    for x, z, current in ((0.0, -0.02, 0.0), (0.003, -0.022, 0.4), (0.0, -0.03, -0.5)):
        shape = fm.Part(fm.Cylinder(0.006, 0.01), fm.Placement([x, 0.0, z - 0.005]))
        bodies_ = (*device.bodies, fm.Body("magnet", "ndfeb", (shape,), 0.002, edge_size=0.001))
        machine = fm.Device("with magnet", "", device.coils, bodies_, {**device.materials, "ndfeb": magnet})
        solution = fm.solve_linear(machine)
        force = solution.force_on("magnet", [current])
        load = body.wrench(field, [x, 0.0, z], [current])[:3]
        assert load == pytest.approx(force, abs=5e-3 * np.linalg.norm(force))
        both = force + solution.force_on("core", [current]) + solution.force_on("1", [current])
        assert np.linalg.norm(both) < 1e-3 * np.linalg.norm(force)

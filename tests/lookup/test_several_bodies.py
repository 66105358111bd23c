"""Currents for forces on several bodies: a stacked least-squares problem, derivatives, rank and condition."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.dynamics import RigidBody, SeveralBodies, sampled_field, state_of
from fieldmap.errors import Infeasible, InputError, NotConverged
from fieldmap.lookup import Actuation, currents_for_several, magnetic_body, volume_rule
from fieldmap.sources import CoilSet
from tests.dynamics.conftest import saturating_map
from tests.refusals import refused

PLACES = np.array([[0.006, 0.001, 0.002], [-0.005, -0.002, -0.001]])
TURNS = Rotation.from_rotvec([[0.3, 0.2, 0.1], [0.0, 0.1, 0.4]]).as_matrix()
FORCES = np.array([[0.01, -0.02, 0.03], [-0.02, 0.01, 0.02]])
RESISTANCE = np.array([1.0, 2.0, 0.5, 1.5, 1.0, 0.7, 1.2, 0.8])
NAN = np.nan


@pytest.fixture(scope="module")
def coils():
    """Eight coils of random directions around the bodies, over a box."""
    made = []
    for k, axis in enumerate(Rotation.random(8, rng=np.random.default_rng(4))):
        place = fm.Placement(axis.apply([0.0, 0.0, 0.035]), axis.as_matrix())
        made.append(fm.CircularCoil(str(k), 5e-3, 12e-3, 10e-3, 300.0, placement=place))
    return CoilSet(made, (np.full(3, -0.012), np.full(3, 0.012)))


@pytest.fixture(scope="module")
def field(coils):
    return sampled_field(coils, 3e-3)


def magnets():
    return [volume_rule(fm.MagnetCylinder(3e-3, 4e-3, 1.2), 2), volume_rule(fm.MagnetSphere(4e-3, 1.0), 1)]


def beads(material):
    return [magnetic_body(fm.SoftSphere(4e-3, **material)), magnetic_body(fm.SoftSphere(3e-3, **material))]


def loads(field, bodies, currents, places=PLACES, turns=TURNS):
    """Force and torque (n, 6) by the simulator."""
    turned = Rotation.from_matrix(turns).as_quat()[:, [3, 0, 1, 2]]
    several = SeveralBodies(field, [RigidBody(1e-3, np.full(3, 1e-8), one) for one in bodies])
    return several.wrench([state_of(p, quaternion=q) for p, q in zip(places, turned, strict=True)], currents)


def test_forces_on_two_magnets_by_stacked_least_squares(coils, field):
    """min |sqrt(R) I| with six rows: columns of forces by unit currents, less the magnets' forces on each other."""
    idle = loads(field, magnets(), np.zeros(8))[:, :3].ravel()
    columns = np.array([loads(field, magnets(), unit)[:, :3].ravel() - idle for unit in np.eye(8)]).T
    root = np.sqrt(RESISTANCE)
    exact = np.linalg.lstsq(columns / root, FORCES.ravel() - idle, rcond=None)[0] / root
    found = currents_for_several(field, PLACES, magnets(), FORCES, resistance=RESISTANCE, orientations=TURNS)
    np.testing.assert_allclose(found.currents, exact, rtol=1e-8)
    assert np.abs(idle).max() > 0.1 * np.abs(FORCES).max()
    scaled = columns / np.linalg.norm(columns, axis=1)[:, None]
    assert found.actuation.rank == 6
    assert found.actuation.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-6)
    assert found.actuation.rows[3] == "Fx of body 2"
    given = found.actuation.matrix @ found.currents + found.actuation.constant
    np.testing.assert_allclose(given, FORCES.ravel(), rtol=1e-9)
    direct = currents_for_several(coils, PLACES, magnets(), FORCES, resistance=RESISTANCE, orientations=TURNS)
    np.testing.assert_allclose(direct.currents, exact, rtol=1e-3)


def test_single_components_and_torques(field):
    forces, torques = [[NAN, NAN, 0.03], [0.02, NAN, NAN]], [[1e-4, NAN, NAN], [NAN, -2e-4, NAN]]
    moments = [[0.0, 0.0, 0.03], [0.02, 0.0, 0.01]]
    found = currents_for_several(field, PLACES, moments, forces, torques=torques)
    assert found.actuation.rows == ("Fz of body 1", "Tx of body 1", "Fx of body 2", "Ty of body 2")
    dipoles = [fm.lookup.MagneticBody(np.zeros((1, 3)), np.array([m])) for m in moments]
    given = loads(field, dipoles, found.currents, turns=np.tile(np.eye(3), (2, 1, 1)))
    np.testing.assert_allclose(given[[0, 0, 1, 1], [2, 3, 0, 4]], [0.03, 1e-4, 0.02, -2e-4], rtol=1e-9)


@pytest.mark.parametrize("material", [{"mu_r": 1e3}, {"material": fm.material("steel_a3")}])
def test_forces_on_soft_beads(field, material):
    """The beads magnetise each other; derivatives by currents contain this."""
    bodies, forces = beads(material), [[NAN, NAN, 2e-3], [NAN, NAN, 1e-3]]
    found = currents_for_several(field, PLACES, bodies, forces, orientations=TURNS)
    given = loads(field, bodies, found.currents)
    np.testing.assert_allclose(given[:, 2], [2e-3, 1e-3], rtol=1e-6)
    h = 1e-3 * np.abs(found.currents).max()
    slopes = [
        (
            loads(field, bodies, found.currents + h * unit)[:, 2]
            - loads(field, bodies, found.currents - h * unit)[:, 2]
        )
        / (2 * h)
        for unit in np.eye(8)
    ]
    matrix = found.actuation.matrix
    np.testing.assert_allclose(matrix, np.array(slopes).T, rtol=0, atol=1e-5 * np.abs(matrix).max())
    alone = [one.wrench(field, place, found.currents)[2] for one, place in zip(bodies, PLACES, strict=True)]
    assert np.abs(np.array(alone) / [2e-3, 1e-3] - 1).max() > 1e-3


def test_slopes_hold_the_reaction_of_the_iron(tmp_path):
    """A magnet with a bead beside it, and a bead, below a core."""
    path = fm.generate(fm.read_device("desk_levitator"), tmp_path / "map.h5", spacing=3e-3, progress=False)
    field, (bead, _) = fm.open_map(path), beads({"mu_r": 500.0})
    pieces = [fm.PayloadPiece(fm.MagnetCylinder(4e-3, 4e-3, 1.2))]
    pieces.append(fm.PayloadPiece(fm.SoftSphere(2e-3, mu_r=500.0), fm.placed([4e-3, 0, 1e-3])))
    bodies, places = (
        [magnetic_body(fm.Payload(1e-3, pieces=pieces), level=2), bead],
        PLACES - [0.002, 0, 0.02],
    )
    lift = [[NAN, NAN, 0.02], [NAN] * 3]
    found = currents_for_several(field, places, bodies, lift, orientations=TURNS)
    given = loads(field, bodies, found.currents, places)[0, 2]
    assert given == pytest.approx(0.02, rel=1e-6)
    slope = (
        loads(field, bodies, found.currents + 1e-3, places)[0, 2]
        - loads(field, bodies, found.currents - 1e-3, places)[0, 2]
    ) / 2e-3
    assert found.actuation.matrix[0, 0] == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("free", [False, True])
def test_forces_in_a_map_of_saturating_iron(free):
    """By the search, over free currents and over currents of a division."""
    field, rows = saturating_map(free=free), np.array([[NAN, NAN, 0.0], [NAN, NAN, 0.0]])
    made = field.parametrisation
    start, aim = (
        made.currents(np.array([u, x, 0.1, 1.0, -0.5, 0.3][: 6 if free else 3]))
        for u, x in ((1.6, 0.1), (1.9, -0.1))
    )
    rows[:, 2] = loads(field, magnets(), aim)[:, 2]
    found = currents_for_several(field, PLACES, magnets(), rows, orientations=TURNS, start=start)
    given = loads(field, magnets(), found.currents)
    np.testing.assert_allclose(given[:, 2], rows[:, 2], rtol=1e-6)


def test_what_cannot_be_had_is_refused_with_rank_and_condition(coils):
    """Two coils and three rows; and limits that are too small."""
    few = CoilSet(coils.coils[:2], coils.bounds)
    rows = [[0.01, NAN, 0.03], [NAN, NAN, 0.02]]
    with pytest.raises(Infeasible) as caught:
        currents_for_several(few, PLACES, magnets(), rows)
    about = caught.value.actuation
    assert isinstance(about, Actuation)
    assert (about.rank, about.matrix.shape, about.condition) == (2, (3, 2), np.inf)
    with pytest.raises(Infeasible) as caught:
        currents_for_several(coils, PLACES, magnets(), FORCES, limits=0.05)
    assert caught.value.actuation.rank == 6
    assert np.isfinite(caught.value.actuation.condition)
    assert 0.0 < (caught.value.share or 0.5) < 1.0
    assert caught.value.binding


def test_refusals(field):
    near = PLACES[:1] + [[0, 0, 0], [0, 0, 2e-3]]
    with pytest.raises(NotConverged):
        currents_for_several(field, near, beads({"mu_r": 1e6}), FORCES)
    for wrong in (
        lambda: currents_for_several(field, PLACES, magnets()[:1], FORCES),
        lambda: currents_for_several(field, PLACES, magnets()),
        lambda: currents_for_several(field, PLACES, magnets(), FORCES[:1]),
        lambda: currents_for_several(field, PLACES, magnets(), np.full((2, 3), NAN)),
        lambda: currents_for_several(field, PLACES, [[0, 1], [0, 0, 1]], FORCES),
        lambda: currents_for_several(field, PLACES, magnets(), FORCES, limits=(2.0, 1.0)),
    ):
        with refused(InputError):
            wrong()

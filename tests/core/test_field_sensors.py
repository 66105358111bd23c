"""Readings and calibration curves in the C core, against closed forms in numpy and scipy."""

from functools import partial

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from fieldmap.core.field_sensors import CoreCurve, CoreSensors
from fieldmap.dynamics import RigidBody, state_of, superposed
from fieldmap.lookup import MagneticBody, interpolate
from fieldmap.lookup.soft_body import SoftPiece
from fieldmap.store import Grid, MapData
from fieldmap.store.map_data import StoredFields, StoredSensors
from tests.dynamics.machines import machine_in

GRID = Grid([-0.01] * 3, [0.005] * 3, (5, 5, 5))
PLACES = np.array([[0.0, 0.0, 0.03], [0.025, -0.004, 0.011]])
AXES = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, -0.8]])
# T/A for two coils, and T for the constant field.
SHARES = np.array([[0.03, -0.01, 2e-4], [0.005, 0.02, -5e-5]])
FIELDS = [np.array([0.01, 0.002, -0.004]), np.array([-0.003, 0.02, 0.001]), np.array([1e-4, 2e-4, -3e-4])]
# Fields linear in the place, free of curl and divergence: any interpolant is exact.
SLOPES = [
    np.array([[a, c, b], [c, b, a], [b, a, -a - b]]) for a, b, c in ((0.1, 0.3, -0.2), (0.4, -0.1, 0.2))
]
ANSWERS = [(np.array([0.02, -0.01, 0.05]), SLOPES[0]), (np.array([-0.03, 0.04, 0.01]), SLOPES[1])]
BODY = MagneticBody(
    np.array([[0, 1e-3, 2e-3], [1e-3, 0, -2e-3]]), np.array([[0.1, 0.2, 0.7], [0, -0.3, 0.2]])
)
AT = np.array([0.0011, -0.0022, 0.0013])
TURN = Rotation.from_rotvec([0.3, -0.2, 0.5])
CURRENTS = np.array([1.3, -0.7])


def field(answers=True, kind="harmonic"):
    points = GRID.points()
    shape = (*GRID.shape, 3)
    of_iron = StoredFields(
        np.stack([(b + points @ g).reshape(shape) for b, g in ANSWERS]),
        np.stack([np.broadcast_to(g, (*shape, 3)) for _, g in ANSWERS]),
    )
    sensors = StoredSensors(("a", "b"), PLACES, AXES, SHARES, of_iron if answers else None)
    data = MapData(
        GRID,
        ("1", "2"),
        [1.0, 1.0],
        fixed_sources=("background",),
        constant_field=True,
        flux_density=np.stack([np.broadcast_to(b, shape) for b in FIELDS]),
        gradient=np.zeros((3, *shape, 3)),
        sensors=sensors,
    )
    return interpolate(data, kind=kind)


def core_readings(m, body, scale=1.0):
    of = superposed(m, scale)
    core = machine_in(of, 2, RigidBody(0.01, [1e-6] * 3, body))
    core.follow(CURRENTS)
    found = np.empty(2)
    quaternion = np.roll(TURN.as_quat(), 1)
    assert of.sensors.core.read(core, state_of(AT, quaternion=quaternion), found) == 0
    return found


def of_dipoles(points, moments, answers=True):
    """Jackson (5.56), and the iron's answers."""
    found = np.zeros(2)
    for x, m in zip(points, moments, strict=True):
        r = PLACES - x
        d = np.linalg.norm(r, axis=1, keepdims=True)
        flux = mu_0 / (4 * np.pi) * (3 * (r @ m)[:, None] * r / d**5 - m / d**3)
        found += np.sum(flux * AXES, axis=1)
        if answers:
            found += [m @ (b + g @ x) for b, g in ANSWERS]
    return found


@pytest.mark.parametrize("kind", ["harmonic", "hermite"])
@pytest.mark.parametrize("answers", [True, False])
@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_readings_are_the_closed_form_and_those_of_python(kind, answers, scale):
    """A scale from calibration changes the field of the currents, not the field of the magnets."""
    m, turn = field(answers, kind), TURN.as_matrix()
    found = core_readings(m, BODY, scale)
    weights = np.append(CURRENTS, 1.0)
    expected = scale * SHARES @ weights + of_dipoles(
        AT + BODY.points @ turn.T, BODY.moments @ turn.T, answers
    )
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    if scale == 1.0:
        np.testing.assert_allclose(found, m.readings(AT, BODY, CURRENTS, turn), rtol=1e-12)


def test_soft_iron_of_the_body_is_read_too():
    piece = SoftPiece(
        np.array([1e-3, 0.0, -1e-3]), np.diag([1.0, 1.0, 1.0]), np.full(3, 1 / 3), 3e-8, mu_r=50.0
    )
    body = MagneticBody(BODY.points, BODY.moments, soft=(piece,))
    m, turn = field(), TURN.as_matrix()
    found = core_readings(m, body)
    np.testing.assert_allclose(found, m.readings(AT, body, CURRENTS, turn), rtol=1e-12)
    # A small sphere of high permeability has the moment 3 V B / mu0 (mu_r - 1) / (mu_r + 2).
    flux = FIELDS[0] * CURRENTS[0] + FIELDS[1] * CURRENTS[1] + FIELDS[2]
    moment = 3 * 3e-8 * flux / mu_0 * 49 / 52
    own = of_dipoles([AT + turn @ piece.centre], [moment])
    np.testing.assert_allclose(found - core_readings(m, BODY), own, rtol=1e-6)


READINGS = np.array([0.01, 0.014, 0.03, 0.07])
HEIGHTS = np.array([-0.03, -0.024, -0.017, -0.013])
RISES = np.array([2.0, 1.1, 0.3, 0.05])
CURVE = CoreCurve(2e-3, np.array([0.04, -0.01]), READINGS, HEIGHTS, RISES)


def test_a_curve_is_hermites_cubic_less_the_share_of_the_currents():
    random = np.random.default_rng(1)
    left = np.append(random.uniform(READINGS[0], READINGS[-1], 200), READINGS)
    currents = random.normal(size=(len(left), 2))
    found = np.empty(len(left))
    CURVE.find(left + 2e-3 + currents @ [0.04, -0.01], currents, found)
    np.testing.assert_allclose(found, CubicHermiteSpline(READINGS, HEIGHTS, RISES)(left), rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("left", "height"), [(0.0099, -0.03), (-1.0, -0.03), (0.0701, -0.013), (9.0, -0.013)]
)
def test_beyond_its_ends_a_curve_keeps_the_end(left, height):
    found = np.empty(1)
    CURVE.find(np.array([left + 2e-3]), np.zeros((1, 2)), found)
    assert found[0] == height


@pytest.mark.parametrize(
    "changed",
    [
        {"readings": READINGS[:1]},
        {"heights": HEIGHTS[:3]},
        {"slopes": RISES[:2]},
        {"per_ampere": np.zeros((1, 2))},
    ],
)
def test_a_curve_of_other_sizes_is_refused(changed):
    with pytest.raises(TypeError):
        CURVE._replace(**changed).find(np.zeros(1), np.zeros((1, 2)), np.empty(1))


def test_sensors_of_other_sizes_are_refused():
    m = field()
    core, sensors = machine_in(superposed(m), 2), m.sensors.core
    read = partial(CoreSensors.read, machine=core, state=state_of(AT), out=np.empty(2))
    for changed in ({"shares": SHARES[:1]}, {"places": np.zeros((2, 5))}, {"places": np.zeros((0, 6))}):
        with pytest.raises(TypeError):
            read(sensors._replace(**changed))
    with pytest.raises(ValueError, match="answers"):
        read(CoreSensors(sensors.places[:1].copy(), SHARES[:1], sensors.answers))

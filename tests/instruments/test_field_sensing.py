"""Pose from eight field sensors below a core: least squares and the filter against the Cramer-Rao bound; the
electronics of an element."""

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

import fieldmap as fm
from fieldmap.errors import InputError, NotConverged, OutsideMapError
from fieldmap.instruments import (
    Converter,
    FieldElement,
    PoseFilter,
    estimate_pose,
    measured_readings,
    observability,
)
from fieldmap.instruments.pose_estimation import _rotation
from fieldmap.lookup import MagneticBody, magnetic_body

NOISE = 20e-6
ANGLES = 0.3 + 0.5 * np.pi * np.arange(4)
PLACE = np.array([0.0012, -0.0021, -0.0263])
TURN = Rotation.from_rotvec([0.08, -0.05, 0.0]).as_matrix()


@pytest.fixture(scope="module")
def device():
    """The desk levitator with sensors at four places beside its workspace, one along z and one along the radius."""
    sensors = []
    for k, (x, y) in enumerate(zip(np.cos(ANGLES), np.sin(ANGLES), strict=True)):
        place = [0.018 * x, 0.018 * y, -0.035]
        sensors += [fm.FieldSensor(f"z{k}", place, [0, 0, 1]), fm.FieldSensor(f"r{k}", place, [x, y, 0])]
    return fm.read_device("desk_levitator").replace(sensors=sensors)


@pytest.fixture(scope="module")
def field(device, tmp_path_factory):
    path = tmp_path_factory.mktemp("sensing") / "desk.h5"
    return fm.open_map(fm.generate(device, path, spacing=3e-3, progress=False))


@pytest.fixture(scope="module")
def body(device):
    return magnetic_body(device.payload, level=4)


def tilt(estimate, turn):
    """Angle between the magnet's axes, rad."""
    return np.arctan2(np.linalg.norm(np.cross(estimate.rotation[:, 2], turn[:, 2])), 1.0)


def test_a_hundred_poses_from_eight_sensors(field, body):
    """Within 0.2 mm and 1 degree, with 20 uT of noise, at any current, starting in the middle of the map."""
    random = np.random.default_rng(2)
    for _ in range(100):
        place = [-0.003, -0.003, -0.032] + random.random(3) * [0.006, 0.006, 0.012]
        turn = Rotation.from_rotvec(np.radians(random.uniform(-8, 8, 3))).as_matrix()
        current = random.uniform(-1.5, 1.5, 1)
        read = field.readings(place, body, current, turn) + NOISE * random.normal(size=8)
        found = estimate_pose(field, body, read, current, NOISE)
        assert np.linalg.norm(found.position - place) < 2e-4
        assert tilt(found, turn) < np.radians(1.0)
        assert np.abs(found.residual).max() < 5 * NOISE


def test_without_noise_it_is_the_pose(field, body):
    for roll, within in ((0.0, 1e-8), (0.7, 2e-6)):
        # A rolled magnet has other points of the volume rule.
        turn = TURN @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
        read = field.readings(PLACE, body, 0.4, turn)
        found = estimate_pose(field, body, read, 0.4, NOISE, PLACE + [1e-3, 1e-3, 2e-3])
        assert found.position == pytest.approx(PLACE, abs=within)
        assert tilt(found, turn) < 1e3 * within
        # The roll of a round magnet is not observable: it keeps its start value, with infinite deviation.
        assert np.isinf(found.deviations).tolist() == [False] * 5 + [True]
        assert abs(Rotation.from_matrix(found.rotation).as_rotvec()[2]) < 1e-2


def test_the_currents_share_is_taken_off(field, body):
    read = field.readings(PLACE, body, 1.0, TURN)
    right, wrong = (estimate_pose(field, body, read, current, NOISE) for current in (1.0, 0.9))
    assert np.linalg.norm(right.position - PLACE) < 1e-7
    assert np.linalg.norm(wrong.position - PLACE) > 1e-5


def test_errors_are_those_of_the_bound(field, body):
    """300 estimates at one pose: their covariance is the stated one, the Cramer-Rao bound."""
    random, exact = np.random.default_rng(3), field.readings(PLACE, body, 0.2, TURN)
    shifts, scores = [], []
    for _ in range(300):
        found = estimate_pose(field, body, exact + NOISE * random.normal(size=8), 0.2, NOISE, PLACE, TURN)
        off = np.append(found.position - PLACE, Rotation.from_matrix(TURN.T @ found.rotation).as_rotvec())
        shifts.append(off[:5])
        scores.append(off[:5] @ np.linalg.solve(found.covariance[:5, :5], off[:5]))
    # Sample deviations have an error of 4 %, the mean of chi squared with five degrees one of 0.18.
    bound = observability(field, body, PLACE, NOISE, TURN).deviations[0, :5]
    assert np.std(shifts, axis=0) == pytest.approx(bound, rel=0.15)
    assert np.mean(scores) == pytest.approx(5.0, abs=0.7)


def test_singular_values_are_those_of_differences(field, body):
    columns = []
    for k, unit in enumerate(np.repeat([1e-3, np.radians(1.0)], 3)):
        ends = []
        for h in (-1e-2, 1e-2):
            change = h * unit * np.eye(6)[k]
            turn = TURN @ Rotation.from_rotvec(change[3:]).as_matrix()
            ends.append(field.readings(PLACE + change[:3], body, 0.0, turn))
        columns.append((ends[1] - ends[0]) / 2e-2)
    # The volume rule's points make the roll weakly visible, unlike a real magnet's.
    differences = np.stack(columns[:5], axis=1) / NOISE
    found = observability(field, body, [PLACE, PLACE], NOISE, TURN)
    values = np.linalg.svd(differences, compute_uv=False)
    assert found.singular_values[1, :5] == pytest.approx(values, rel=1e-4)
    assert found.seen.tolist() == [5, 5]
    assert found.smallest == pytest.approx([values[-1]] * 2, rel=1e-4)


def test_one_sensor_below_a_dipole_sees_the_height(tmp_path):
    """B = mu0 m / (2 pi z^3) on the axis, where roll, shift and tilt of a dipole have no first-order effect."""
    ring = fm.CircularCoil("1", 0.01, 0.02, 0.01, 100.0, placement=fm.Placement([0.0, 0.0, 0.03]))
    device = fm.Device(
        "air",
        "",
        (ring,),
        workspace=fm.WorkspaceBox([-0.004, -0.004, 0.0], [0.004, 0.004, 0.016]),
        sensors=[fm.FieldSensor("below", [0.0, 0.0, -0.02], [0.0, 0.0, 3.0])],
    )
    field = fm.open_map(fm.generate(device, tmp_path / "air.h5", spacing=2e-3, progress=False))
    dipole, z = MagneticBody(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])), 0.025
    found = observability(field, dipole, [0.0, 0.0, z - 0.02], NOISE)
    slope = 3 * mu_0 * 0.8 / (2 * np.pi * z**4)
    assert found.singular_values == pytest.approx(np.array([[1e-3 * slope / NOISE]]), rel=1e-12)
    assert found.deviations[0, 2] == pytest.approx(NOISE / slope, rel=1e-12)
    assert np.isinf(found.deviations[0, [0, 1, 3, 4, 5]]).all()
    # The reading of a dipole 10 mm above the map.
    with pytest.raises(NotConverged):
        estimate_pose(field, dipole, [mu_0 * 0.8 / (2 * np.pi * 0.046**3)], 0.0, NOISE)


def test_two_magnets_show_their_roll(field):
    """A second dipole off the axis makes the roll visible."""
    pair = MagneticBody(np.array([[0.0, 0.0, 0.0], [0.004, 0.0, 0.0]]), np.array([[0, 0, 0.5], [0, 0, 0.3]]))
    assert observability(field, pair, PLACE, NOISE).seen.tolist() == [6]
    crossed = MagneticBody(np.zeros((2, 3)), np.array([[0.5, 0, 0.0], [0, 0.3, 0.2]]))
    # Two dipoles at one place act as one dipole.
    assert observability(field, crossed, PLACE, NOISE).seen.tolist() == [5]


def test_the_filter_averages_a_magnet_at_rest(field, body):
    """For a magnet known to be at rest, n samples reduce the deviation by the root of n."""
    random, exact = np.random.default_rng(4), field.readings(PLACE, body, 0.2, TURN)
    first = estimate_pose(field, body, exact, 0.2, NOISE, PLACE, TURN)
    follow = PoseFilter(field, body, NOISE, (1e-9, 1e-9))
    state = follow.start(first, speed=1e-9, spin=1e-9)
    for _ in range(24):
        state = follow.step(state, exact + NOISE * random.normal(size=8), 0.2, 1e-3)
    deviations = np.sqrt(np.diag(state.covariance))
    assert deviations[:5] == pytest.approx(first.deviations[:5] / 5.0, rel=1e-3)
    assert np.abs(state.position - PLACE).max() < 4 * deviations[:3].max()


def test_the_filter_follows_a_swing(field, body):
    """A magnet swinging with known accelerations: errors are as stated, and smaller than those of single estimates."""
    random, step, follow = np.random.default_rng(5), 1e-3, PoseFilter(field, body, NOISE, (0.05, 0.5))
    rate, reach, lean = 2 * np.pi * 4.0, np.array([2e-3, -1e-3, 1.5e-3]), np.array([0.06, 0.04, 0.0])
    phases = rate * step * np.arange(400)
    places = PLACE + np.sin(phases)[:, None] * reach
    turns = Rotation.from_rotvec(np.sin(phases)[:, None] * lean).as_matrix()
    reads = field.readings(places, body, 0.1, turns) + NOISE * random.normal(size=(400, 8))
    state = follow.start(estimate_pose(field, body, reads[0], 0.1, NOISE, PLACE))
    scores, single, filtered = [], [], []
    for k in range(1, 400):
        # The mean acceleration of the step.
        pull = -(rate**2) * 0.5 * (np.sin(phases[k - 1]) + np.sin(phases[k]))
        state = follow.step(state, reads[k], 0.1, step, pull * reach, pull * lean)
        off = state.position - places[k]
        scores.append(off @ np.linalg.solve(state.covariance[:3, :3], off))
        filtered.append(off)
        single.append(estimate_pose(field, body, reads[k], 0.1, NOISE, places[k]).position - places[k])
    assert np.mean(scores[50:]) == pytest.approx(3.0, abs=1.0)
    assert np.std(filtered[50:]) < 0.6 * np.std(single)
    assert state.velocity == pytest.approx(rate * np.cos(phases[-1]) * reach, abs=5e-3)


def test_noise_of_two_steps_is_that_of_one_of_both_lengths(field, body):
    """Covariance of white acceleration: the second half's plus the propagated first half's; and its absolute size."""
    follow, half = PoseFilter(field, body, NOISE, (0.3, 2.0)), 2e-3
    onward = np.eye(12)
    onward[range(6), range(6, 12)] = half
    once, twice = follow._noise(half), follow._noise(2 * half)
    assert onward @ once @ onward.T + once == pytest.approx(twice, rel=1e-12)
    assert np.diag(once)[[6, 11]] == pytest.approx([0.3**2 * half, 2.0**2 * half], rel=1e-12)


def test_what_cannot_be_told_is_refused(field, body):
    read = field.readings(PLACE, body, 0.0)
    with pytest.raises(NotConverged):
        estimate_pose(field, body, 50.0 * read, 0.0, NOISE)
    with pytest.raises(OutsideMapError):
        estimate_pose(field, body, read, 0.0, NOISE, [0.0, 0.0, 0.1])
    soft = magnetic_body(fm.SoftSphere(3e-3, mu_r=100.0))
    for wrong in (
        lambda: estimate_pose(field, body, read[:7], 0.0, NOISE),
        lambda: estimate_pose(field, soft, read, 0.0, NOISE),
        lambda: observability(field, body, PLACE, 0.0),
        lambda: PoseFilter(field, body, NOISE, (1.0, 0.0)),
        lambda: FieldElement(sensitivity=0.0),
        lambda: FieldElement(25.0, latency=-1),
    ):
        with pytest.raises(InputError):
            wrong()


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [1e-9, 0, 0], [0.3, -1.2, 2.0]])
def test_turns(turn):
    assert _rotation(np.array(turn)) == pytest.approx(Rotation.from_rotvec(turn).as_matrix(), abs=1e-15)


def test_electronics():
    """25 V/T into 12 bits of +-2.5 V: a step of 48.8 uT. The element's range acts first, then gain and offset."""
    card = Converter(range=2.5, bits=12, random_noise=1e-3)
    hall = FieldElement(25.0, range=0.09, deviation=30e-6, offset=1e-3, gain_error=0.02, converter=card)
    step = 2 * 2.5 / 2**12 / 25.0
    seen = measured_readings(hall, [[0.04, -0.2, 0.2]])
    for value, wanted in zip(
        seen[0], (0.04 * 1.02 + 1e-3, -0.09 * 1.02 + 1e-3, 0.09 * 1.02 + 1e-3), strict=True
    ):
        assert abs(value - wanted) <= 0.5 * step + 1e-12
        assert value / step == pytest.approx(round(value / step), abs=1e-9)
    late = measured_readings(FieldElement(25.0, latency=2), np.arange(5.0)[:, None] * 1e-3)
    assert late[:, 0] == pytest.approx([0.0, 0.0, 0.0, 1e-3, 2e-3], abs=1e-15)
    many = measured_readings(hall, np.full((40_000, 1), 0.04), np.random.default_rng(6))
    assert many.std() == pytest.approx(hall.whole_deviation, rel=0.02)
    assert hall.whole_deviation == pytest.approx(
        np.sqrt((30e-6) ** 2 + (1e-3 / 25.0) ** 2 + step**2 / 12), rel=1e-12
    )

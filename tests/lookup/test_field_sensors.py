"""Readings of field sensors against closed forms, the solver's own field, and differences."""

import h5py
import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre

import fieldmap as fm
from fieldmap.errors import DeviceFileError, GeometryError, InputError, MapFileError, OutsideMapError
from fieldmap.lookup import MagneticBody, interpolate, magnetic_body
from fieldmap.store import read_map, seal_map, write_map

RADIUS, MU_R = 0.02, 100.0
LOWER, UPPER = np.array([-0.006, -0.006, -0.046]), np.array([0.006, 0.006, -0.034])
# Below, beside and above the box; only the first is along an axis of the frame.
SENSORS = (
    fm.FieldSensor("below", [0.0, 0.0, -0.052], [0.0, 0.0, 2.0]),
    fm.FieldSensor("beside", [0.015, 0.002, -0.04], [1.0, -2.0, 0.5]),
    fm.FieldSensor("under the ball", [0.001, -0.002, -0.026], [0.3, 0.2, -1.0]),
)
COIL = fm.CircularCoil("1", 0.01, 0.02, 0.01, 2000.0, placement=fm.Placement([0.0, 0.0, 0.03]))
EARTH = fm.Background(flux_density=np.array([20e-6, -5e-6, -45e-6]))
TURN = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
PLACE = np.array([0.0021, -0.0013, -0.041])
BODY = MagneticBody(
    np.array([[0.0, 0.001, 0.002], [0.001, 0.0, -0.002]]), np.array([[0.1, 0.2, 0.7], [0.0, -0.3, 0.2]])
)


def machine(iron, **more):
    ball = fm.Body("ball", "iron", fm.Sphere(RADIUS), 0.0035)
    return fm.Device(
        "ball",
        "",
        (COIL,),
        (ball,) if iron else (),
        {"iron": fm.LinearMaterial("iron", MU_R)} if iron else {},
        **{"workspace": fm.WorkspaceBox(LOWER, UPPER), "sensors": SENSORS, **more},
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sensors")


@pytest.fixture(scope="module")
def file(folder):
    return fm.generate(machine(iron=True), folder / "ball.h5", spacing=3e-3, progress=False)


@pytest.fixture(scope="module", params=["harmonic", "hermite"])
def field(file, request):
    return fm.open_map(file, kind=request.param)


@pytest.fixture(scope="module")
def air(folder):
    device = machine(iron=False, background=EARTH)
    return fm.open_map(fm.generate(device, folder / "air.h5", spacing=3e-3, progress=False))


def dipole(moments, points, places):
    """B (n, s, 3) at places (s, 3) of dipoles (n, 3) at points (n, 3): Jackson (5.56)."""
    r = places - points[:, None]
    d = np.linalg.norm(r, axis=-1, keepdims=True)
    along = np.einsum("nsi,ni->ns", r, moments)[..., None]
    return mu_0 / (4 * np.pi) * (3 * along * r / d**5 - moments[:, None] / d**3)


def of_ball(axes, places, moments, points):
    """Readings (n, s) by sensors (s, 3) of a permeable ball at the origin that dipoles (n, 3) magnetise.

    To the potential of a charge at x, sum r'^l / r^(l+1) P_l, the ball answers -chi a^(2l+1) / (r r')^(l+1) P_l, chi =
    l (mu_r - 1) / (l mu_r + l + 1) (Jackson, section 4.4). A dipole is the derivative of a charge along its moment, and
    a reading is the derivative of the potential along the axis; both by central differences of fourth order.
    """
    h, degrees = 2e-4, np.arange(1, 120)
    chi = degrees * (MU_R - 1) / (degrees * MU_R + degrees + 1)
    steps, shares = np.array([-2, -1, 1, 2]) * h, np.array([1, -8, 8, -1]) / (12 * h)
    total, sizes = 0.0, np.linalg.norm(moments, axis=1, keepdims=True)
    for up, weight in zip(steps, shares, strict=True):
        for down, other in zip(steps, shares, strict=True):
            at = (places + up * axes)[None]
            of = (points + down * moments / sizes)[:, None]
            r, s = np.linalg.norm(at, axis=-1), np.linalg.norm(of, axis=-1)
            cosine = np.sum(at * of, axis=-1) / (r * s)
            terms = chi * (RADIUS**2 / (r * s)[..., None]) ** (degrees + 1) / RADIUS
            series = np.sum(terms * eval_legendre(degrees, cosine[..., None]), axis=-1)
            total = total + weight * other * series
    return mu_0 / (4 * np.pi) * sizes * total


def poses(count):
    random = np.random.default_rng(1)
    points = LOWER + random.random((count, 3)) * (UPPER - LOWER)
    return points, random.normal(size=(count, 3))


def geometry():
    return np.array([one.position for one in SENSORS]), np.array([one.direction for one in SENSORS])


def test_a_hundred_dipoles_near_a_ball(field):
    """To the error of the mesh: elements are a sixth of the ball's radius wide."""
    points, moments = poses(100)
    places, axes = geometry()
    direct = np.einsum("nsi,si->ns", dipole(moments, points, places), axes)
    iron = of_ball(axes, places, moments, points)
    read = field.readings(points, moments, 0.0)
    # The iron counts: typically an eighth of the reading under the ball.
    assert np.median(np.abs(iron / direct)[:, 2]) > 0.1
    for k, within in enumerate((1e-3, 1e-3, 5e-3)):
        off = np.abs(read - direct - iron)[:, k].max()
        assert off < within * np.abs(iron)[:, k].max()


def test_currents_as_the_solver(file, field):
    solution = fm.solve_linear(machine(iron=True))
    places, axes = geometry()
    truth = np.einsum("si,si->s", solution.field(places, [1.3]), axes)
    away = field.readings(PLACE, [0.0, 0.0, 0.0], 1.3)
    assert away == pytest.approx(truth, rel=1e-9)
    # Each place has its own row of currents.
    rows = field.readings(np.stack([PLACE, PLACE]), [0.1, 0.0, 0.4], [[0.0], [1.3]])
    assert rows[1] - rows[0] == pytest.approx(truth, rel=1e-9)


def test_magnet_as_a_body_of_the_device(field):
    """The full solver, with a meshed magnet in place of the dipoles."""
    shape, place = fm.MagnetSphere(6e-3, 1.2), np.array([0.001, 0.002, -0.038])
    law = fm.PermanentMagnet("ndfeb", np.array([0.0, 0.0, 1.2]), 1.0)
    magnet = fm.Body("magnet", "ndfeb", fm.Part(fm.Sphere(3e-3), fm.Placement(place)), 0.0012)
    alone = machine(iron=True, workspace=None)
    both = alone.replace(bodies=(*alone.bodies, magnet), materials={**alone.materials, "ndfeb": law})
    places, axes = geometry()
    truth = np.einsum("si,si->s", fm.solve_linear(both).field(places, [0.7]), axes)
    read = field.readings(place, magnetic_body(shape), 0.7)
    assert read == pytest.approx(truth, rel=1e-2, abs=5e-3 * np.abs(truth).max())


def test_in_air_by_closed_forms(air):
    """A dipole, a thick coil on its axis, and the background. Nothing is stored on the grid, so no place is outside."""
    places, axes = geometry()
    z = -0.052 - 0.03
    ends = np.array([z - 0.005, z + 0.005])
    # Uniform current in a thick coil: Montgomery, Solenoid Magnet Design, (2.1).
    logarithms = np.log((0.02 + np.hypot(0.02, ends)) / (0.01 + np.hypot(0.01, ends)))
    on_axis = mu_0 * 2000.0 / (2 * 0.01 * 0.01) * np.diff(ends * logarithms)[0]
    points, moments = poses(5)
    points[0] = 0.0, 0.0, 1.0
    off = air.readings(points, moments, 0.0)
    assert off == pytest.approx(
        np.einsum("nsi,si->ns", dipole(moments, points, places) + EARTH.flux_density, axes), rel=1e-12
    )
    assert (air.readings(points, moments, 2.0) - off)[:, 0] == pytest.approx(2.0 * on_axis, rel=1e-9)


@pytest.mark.parametrize("load", [np.array([0.3, -0.1, 0.8]), BODY], ids=["dipole", "body"])
def test_slopes_by_taylor(field, air, load):
    """The error of the first-order prediction falls with the square of the step."""
    for m in (field, air):
        for k in range(6):
            errors = []
            for h in (2e-3, 1e-3) if k > 2 else (2e-5, 1e-5):
                ends = [m.readings(*pose(load, k, sign * h)) for sign in (-1.0, 1.0)]
                _, slopes = m.readings_and_slopes(*pose(load, k, 0.0))
                errors.append(np.abs((ends[1] - ends[0]) / (2 * h) - slopes[:, k]).max())
            size = np.abs(slopes).max(axis=0)[k]
            assert errors[0] < 1e-4 * size
            assert errors[1] < 0.3 * errors[0] or errors[0] < 1e-8 * size


def pose(load, k, step):
    """Arguments of `readings` with the body moved along an axis, or turned about one, of the frame of the field."""
    place, turn = PLACE + step * np.eye(6)[k, :3], Rotation.from_rotvec(step * np.eye(6)[k, 3:]).as_matrix()
    if isinstance(load, MagneticBody):
        return place, load, 0.5, turn @ TURN
    return place, turn @ load, 0.5


def test_a_body_is_the_sum_of_its_dipoles(field):
    whole = field.readings(PLACE, BODY, 0.5, TURN)
    points, moments = PLACE + BODY.points @ TURN.T, BODY.moments @ TURN.T
    off = field.readings(PLACE, np.zeros(3), 0.5)
    assert whole == pytest.approx((field.readings(points, moments, 0.5) - off).sum(axis=0) + off, rel=1e-9)


def test_soft_iron_is_read_by_its_induced_moment(field):
    """A bead in the coil's field is a dipole; its slopes are refused."""
    bead = magnetic_body(fm.SoftSphere(3e-3, mu_r=500.0))
    moment = bead.induced_moment(field, PLACE, 2.0)[0]
    assert np.linalg.norm(moment) > 0
    assert field.readings(PLACE, bead, 2.0) == pytest.approx(field.readings(PLACE, moment, 2.0), rel=1e-9)
    with pytest.raises(InputError, match="soft iron"):
        field.readings_and_slopes(PLACE, bead, 2.0)


def test_maps_keep_them_or_say_that_they_have_none(file, field, tmp_path):
    data = read_map(file)
    again = write_map(tmp_path / "again.h5", data)
    one, other = (fm.open_map(path) for path in (file, again))
    assert np.array_equal(one.readings(PLACE, BODY, 0.5), other.readings(PLACE, BODY, 0.5))
    assert one.sensors.names == ("below", "beside", "under the ball")
    assert one.sensors.axes[0].tolist() == [0.0, 0.0, 1.0]
    # As of an earlier version.
    without = interpolate(data.__class__(**{**vars(data), "sensors": None}))
    assert without.sensors is None
    with pytest.raises(InputError) as caught:
        without.readings(PLACE, BODY, 0.5)
    assert "[[sensor]]" in caught.value.problems[0].remedy
    with pytest.raises(OutsideMapError):
        field.readings([0.0, 0.0, -0.06], BODY, 0.5)


@pytest.mark.parametrize("name", ["shares", "positions", "answers/gradient"])
@pytest.mark.parametrize("damage", ["one fewer", "not a number"])
def test_damaged_sensors_are_refused(file, tmp_path, name, damage):
    path = write_map(tmp_path / "damaged.h5", read_map(file))
    with h5py.File(path, "r+") as opened:
        group = opened["fieldmap/sensors"]
        values = group[name][()]
        del group[name]
        values[0] = np.nan
        group[name] = values[1:] if damage == "one fewer" else values
    seal_map(path)
    with pytest.raises(MapFileError):
        read_map(path)


def test_sensors_in_files(tmp_path):
    device = machine(iron=True)
    (tmp_path / "ball.toml").write_text(device.to_toml())
    read = fm.read_device(tmp_path / "ball.toml")
    assert [one.name for one in read.sensors] == [one.name for one in SENSORS]
    for one, other in zip(read.sensors, SENSORS, strict=True):
        assert one.position == pytest.approx(other.position, rel=1e-12)
        assert one.axis == pytest.approx(other.axis, rel=1e-12)
    (tmp_path / "twice.toml").write_text(device.to_toml().replace('"beside"', '"below"'))
    with pytest.raises(DeviceFileError) as caught:
        fm.read_device(tmp_path / "twice.toml")
    assert "sensor.2.name" in caught.value.problems[0].where


def test_sensors_inside_iron_are_refused():
    inside = fm.FieldSensor("deep", [0.0, 0.0, -0.0199], [0.0, 0.0, 1.0])
    with pytest.raises(GeometryError) as caught:
        fm.solve_linear(machine(iron=True, sensors=[inside]))
    assert "sensor 'deep'" in caught.value.problems[0].where
    just_outside = fm.FieldSensor("near", [0.0, 0.0, -0.02001], [0.0, 0.0, 1.0])
    fm.iron.check_geometry(machine(iron=True, sensors=[just_outside]))

"""Plants of a magnet in a map against closed forms of a dipole's field, and against the forces themselves."""

import numpy as np
import pytest

from fieldmap.control import division_slopes, plant_from_map
from fieldmap.device.model import Payload
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.levitation import find_equilibrium, lift_current
from fieldmap.lookup import interpolate
from fieldmap.store import Grid, MapData
from tests.conftest import dipole_field, dipole_gradient

PAYLOAD = Payload(mass=0.011, moment=0.8, magnet=None, magnet_offset=0.0, inertia=None, drag=0.0)
DEPTH = 0.1
POINT = np.array([0.0, 0.0, -DEPTH])
GRAVITY = 9.80665


def map_of(places, moment=60.0):
    """Map of vertical dipoles at places (coils, 3), per ampere, with nodes every 2 mm."""
    grid = Grid([-8e-3, -8e-3, -DEPTH - 8e-3], np.full(3, 2e-3), (9, 9, 9))
    flux = np.array([dipole_field(moment, place, grid.points()) for place in places])
    slope = np.array([dipole_gradient(moment, place, grid.points()) for place in places])
    shape = (len(places), *grid.shape)
    names = tuple(str(k + 1) for k in range(len(places)))
    nodes = {"flux_density": flux.reshape(*shape, 3), "gradient": slope.reshape(*shape, 3, 3)}
    return interpolate(MapData(grid, names, np.ones(len(places)), **nodes), kind="harmonic")


@pytest.fixture(scope="module")
def one():
    """One dipole coil at the origin."""
    return map_of(np.zeros((1, 3)))


@pytest.fixture(scope="module")
def six():
    """Six dipole coils on a circle, at the angles of the thesis's names 1 to 6."""
    angle = np.radians([240, 180, 120, 300, 0, 60])
    return map_of(0.044 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(6)]), moment=10.0)


def at_lift(field, **settings):
    lift = lift_current(field, PAYLOAD, POINT)
    return lift, plant_from_map(field, PAYLOAD, POINT, lift.currents, **settings)


def test_one_dipole_coil(one):
    """F = 6 k m M i / z^4 gives K_zz = -dF/dz = -4g/|z| at any moments, and K_xx = K_yy = -K_zz/2 (Laplace). The
    second gradient of the map is accurate to 1e-4."""
    lift, plant = at_lift(one)
    np.testing.assert_allclose(plant.pole_products, np.array([2, 2, -4]) * GRAVITY / DEPTH, rtol=1e-4)
    np.testing.assert_allclose(
        plant.force_per_signal[:, 0], [0, 0, PAYLOAD.mass * GRAVITY / lift.current], atol=1e-7
    )
    assert np.abs(plant.imbalance).max() < 1e-6
    poles = np.linalg.eigvals(plant.axis("z").A)
    np.testing.assert_allclose(
        np.sort(poles.real), np.sqrt(4 * GRAVITY / DEPTH) * np.array([-1, 1]), rtol=5e-5
    )


def test_an_aligned_moment_is_less_stable_sideways(one):
    """Moment along B: U = -M |B|; on the axis d2|B|/dx2 = B (-3/2 ... ) / z^2, by differences of |B| itself."""
    lift, plant = at_lift(one, moment="aligned")

    def energy(x):
        return -PAYLOAD.moment * np.linalg.norm(dipole_field(60.0, np.zeros(3), np.array([[x, 0.0, -DEPTH]])))

    h = 1e-4
    curvature = lift.current * (energy(h) - 2 * energy(0.0) + energy(-h)) / h**2
    assert plant.stiffness[0, 0] == pytest.approx(curvature, rel=1e-4)
    assert plant.stiffness[0, 0] < at_lift(one)[1].stiffness[0, 0]


def test_linear_about_the_true_forces(six):
    """Taylor test against wrenches of the map: the remainder is of second order in the excursion."""
    u, n = lift_current(six, PAYLOAD, POINT).current, 1.25
    plant = plant_from_map(six, PAYLOAD, POINT, np.full(6, u), division_slopes(u, 0.0, 0.0, n))
    model, direction = plant.model(), np.array([1e-3, -2e-3, 1.5e-3])
    signal = np.array([0.05, 0.1, -0.08])

    def rest(h):
        currents = np.full(6, u) + division_slopes(u, 0.0, 0.0, n) @ (h * signal)
        force = six.wrench(POINT + h * direction, [0, 0, -PAYLOAD.moment * _side(six, u)], currents)[:3]
        true = force / PAYLOAD.mass - [0, 0, GRAVITY]
        state = np.concatenate([h * direction, np.zeros(3)])
        return np.linalg.norm(model.A[3:] @ state + model.B[3:] @ (h * signal) - true)

    assert rest(0.5) / rest(0.25) == pytest.approx(4.0, rel=0.05)


def _side(field, u):
    """-1 where the lifted moment points up."""
    return -np.sign(field.gradient(POINT, np.full(6, u))[2, 2])


def test_gain_at_rest_is_where_the_magnet_goes(six):
    """Horizontal positions from the linear plant, and from the equilibrium search at the divided currents."""
    u, signal = lift_current(six, PAYLOAD, POINT).current, 1e-3
    slopes = division_slopes(u, 0.0, 0.0, 1.25)
    plant = plant_from_map(six, PAYLOAD, POINT, np.full(6, u), slopes)
    for axis, column in (("x", 1), ("y", 2)):
        currents = np.full(6, u) + slopes[:, column] * signal
        found = find_equilibrium(six, currents, PAYLOAD, start=POINT).position["xyz".index(axis)]
        model = plant.axis(axis, signal=column)
        gain = -(model.C @ np.linalg.solve(model.A, model.B)).item()
        assert gain * signal == pytest.approx(found, rel=2e-3)


def test_trace_of_the_products_vanishes(six):
    products = at_lift(six)[1].pole_products
    assert abs(products.sum()) < 1e-5 * np.abs(products).max()


def test_every_coil_is_an_input_unless_signals_are_named(six):
    lift, plant = at_lift(six)
    assert plant.force_per_signal.shape == (3, 6)
    np.testing.assert_allclose(plant.force_per_signal @ lift.currents, lift.force, atol=1e-9)


def test_saturation_is_seen_in_the_slope(one):
    """A field proportional to the square root of the current halves the slope of force over current."""

    class Saturating:
        coil_names, lower, upper = one.coil_names, one.lower, one.upper

    for name in ("field", "gradient", "second_gradient"):
        method = getattr(one, name)
        setattr(Saturating, name, staticmethod(lambda x, i, of=method: of(x, np.sqrt(np.asarray(i, float)))))
    i = lift_current(one, PAYLOAD, POINT).current ** 2
    exact = 0.5 * PAYLOAD.mass * GRAVITY / i
    small = plant_from_map(Saturating(), PAYLOAD, POINT, [i]).force_per_signal[2, 0]
    assert small == pytest.approx(exact, rel=3e-5)
    errors = [
        plant_from_map(Saturating(), PAYLOAD, POINT, [i], signal_steps=[h * i]).force_per_signal[2, 0] - exact
        for h in (0.2, 0.1)
    ]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)  # second order in the step


def test_damping_moves_the_poles_and_can_be_asked_back(one):
    damped = at_lift(one, damping=0.5)[1]
    slow = np.linalg.eigvals(damped.axis("x").A)
    slow = slow.real[np.argmin(np.abs(slow))]
    assert at_lift(one)[1].damping_for_pole("x", slow) == pytest.approx(0.5 / PAYLOAD.mass, rel=1e-9)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"payload": None}, InputError),
        ({"currents": [np.nan]}, InputError),
        ({"currents": [1.0, 1.0]}, InputError),
        ({"position": [0.0, 0.0, 0.0]}, OutsideMapError),
        ({"signals": np.ones((2, 1))}, InputError),
        ({"signals": [[np.inf]]}, InputError),
        ({"damping": np.ones((2, 2))}, InputError),
        ({"moment": "sideways"}, InputError),
        ({"signal_steps": [0.0]}, InputError),
        ({"signal_steps": [0.1, 0.1]}, InputError),
    ],
)
def test_bad_input(one, change, error):
    good = {"field": one, "payload": PAYLOAD, "position": POINT, "currents": [3.0]}
    with pytest.raises(error):
        plant_from_map(**(good | change))


def test_bad_questions(one):
    plant = at_lift(one)[1]
    for ask in (
        lambda: plant.axis("w"),
        lambda: plant.axis("z", 1),
        lambda: plant.damping_for_pole("x", 0.0),
    ):
        with pytest.raises(InputError):
            ask()

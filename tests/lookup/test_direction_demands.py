"""Currents for a magnet that follows the field, against scipy's optimiser and Taylor's theorem."""

from functools import partial

import numpy as np
import pytest
from scipy.optimize import minimize

import fieldmap as fm
from fieldmap.device.payload import SoftSphere
from fieldmap.errors import Infeasible, InputError
from fieldmap.levitation.balance import Balance
from fieldmap.lookup import currents_for, magnetic_body
from tests.dynamics.conftest import saturating_map
from tests.lookup.test_currents_for import loops
from tests.refusals import refused

SIZE, LIMIT = 0.8, 5000.0


@pytest.fixture(scope="module", params=[False, True], ids=["coils", "coils and a constant field"])
def eight(request):
    return loops(request.param)


def cases(field, count, seed=3):
    """Positions, directions and forces: random, so that the magnet may need more than the force alone takes."""
    rng, middle = np.random.default_rng(seed), 0.5 * (field.lower + field.upper)
    for _ in range(count):
        position = middle + 0.3 * (rng.random(3) - 0.5) * (field.upper - field.lower)
        direction = rng.normal(size=3)
        yield position, direction / np.linalg.norm(direction), 0.02 * rng.normal(size=3)


def by_scipy(field, position, direction, force, least):
    """Least sum of squares with B across zero, the force on the moment, and B along the direction at least `least`, by
    the fields of single coils; rows have length 1."""
    coils = len(field.coil_names)

    def rows(currents):
        flux, slope = field.field_and_gradient(position, currents)
        return np.concatenate([SIZE * direction @ slope, np.cross(direction, flux), [direction @ flux]])

    idle = rows(np.zeros(coils))
    matrix = np.stack([rows(unit) - idle for unit in np.eye(coils)], axis=1)
    wanted = np.concatenate([force, np.zeros(3), [least]]) - idle
    length = np.linalg.norm(matrix, axis=1)
    matrix, wanted = matrix / length[:, None], wanted / length
    # Two of the three rows across are independent.
    basis, _, _ = np.linalg.svd(matrix[3:6])
    across = basis[:, :2].T
    equal = np.vstack([matrix[:3], across @ matrix[3:6]])
    target = np.concatenate([wanted[:3], across @ wanted[3:6]])
    found = minimize(
        lambda x: x @ x,
        np.linalg.lstsq(equal, target, rcond=None)[0] / LIMIT,
        jac=lambda x: 2 * x,
        method="SLSQP",
        bounds=[(-1.0, 1.0)] * coils,
        constraints=[
            {"type": "eq", "fun": lambda x: equal @ x - target / LIMIT, "jac": lambda x: equal},
            {"type": "ineq", "fun": lambda x: matrix[6] @ x - wanted[6] / LIMIT, "jac": lambda x: matrix[6]},
        ],
        options={"ftol": 1e-15, "maxiter": 500},
    )
    assert found.success, found.message
    return LIMIT * found.x


@pytest.mark.parametrize("least", [1e-4, 1e-3])
def test_they_are_those_of_an_optimiser(eight, least):
    """They have least power under the inequality too: sometimes more than the force alone takes, never less."""
    bound = 0
    for position, direction, force in cases(eight, 12):
        found = eight.currents_for(position, force, SIZE, LIMIT, direction=3.0 * direction, least_field=least)
        flux, slope = eight.field_and_gradient(position, found)
        np.testing.assert_allclose(SIZE * direction @ slope, force, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.cross(direction, flux), 0.0, atol=1e-11)
        assert direction @ flux >= least * (1 - 1e-9)
        bound += direction @ flux < least * (1 + 1e-6)
        other = by_scipy(eight, position, direction, force, least)
        np.testing.assert_allclose(found, other, atol=2e-4 * np.abs(other).max())
        assert found @ found <= (1 + 1e-6) * (other @ other)
    assert 0 < bound < 12


def test_the_magnet_stays_and_its_force_is_that_of_one_that_follows_the_field(eight):
    """A free dipole at these currents points along the direction, and m B pushes a turned dipole back."""
    for position, direction, force in cases(eight, 6, seed=8):
        found = eight.currents_for(position, force, SIZE, direction=direction, least_field=2e-3)
        free = Balance(eight, found, 0.01, SIZE, None)
        np.testing.assert_allclose(free.moments(position[None, :])[0], SIZE * direction, atol=1e-7)
        np.testing.assert_allclose(free.magnetic_force(position[None, :])[0], force, atol=1e-8)
        aside = np.linalg.svd(direction[None, :])[2][1]
        angle = 1e-3
        turned = SIZE * (np.cos(angle) * direction + np.sin(angle) * aside)
        torque = eight.wrench(position, turned, found)[3:]
        back = np.cross(direction, aside) @ torque
        assert back == pytest.approx(
            -SIZE * np.linalg.norm(eight.field(position, found)) * np.sin(angle), rel=1e-6
        )


def test_a_magnet_that_would_turn_over_is_refused_with_the_remedy(eight):
    """Without a least field: refused if least power has B against the direction; else it is least power."""
    refusals = 0
    for position, direction, force in cases(eight, 12):
        across = np.linalg.svd(direction[None, :])[2][1:]
        free = eight.currents_for(position, force, SIZE * direction, torque=np.zeros(3))
        assert np.abs(across @ eight.field(position, free)).max() < 1e-11
        if direction @ eight.field(position, free) > 1e-9:
            found = eight.currents_for(position, force, SIZE, direction=direction)
            np.testing.assert_allclose(found, free, atol=1e-9 * np.abs(free).max())
        else:
            refusals += 1
            with refused(Infeasible, remedy="least_field"):
                eight.currents_for(position, force, SIZE, direction=direction)
    assert 0 < refusals < 12


def test_direction_alone_and_limits(eight):
    position = 0.5 * (eight.lower + eight.upper)
    found = currents_for(eight, position, direction=[1.0, 2.0, -2.0], least_field=0.01)
    np.testing.assert_allclose(
        eight.field(position, found), 0.01 / 3 * np.array([1.0, 2.0, -2.0]), atol=1e-12
    )
    with pytest.raises(Infeasible) as caught:
        currents_for(eight, position, limits=1e-3, direction=[1.0, 2.0, -2.0], least_field=0.01)
    assert set(np.abs(list(caught.value.binding.values()))) == {1e-3}


def test_saturating_iron():
    """The demand is met to the search's tolerance, with no more power than known currents that meet it too."""
    field = saturating_map(free=True)
    rng = np.random.default_rng(2)
    position, known = 0.5 * (field.lower + field.upper), rng.uniform(0.3, 1.5, len(field.coil_names))
    flux, slope = field.field_and_gradient(position, known)
    direction = flux / np.linalg.norm(flux)
    force = SIZE * direction @ slope
    found = field.currents_for(position, force, SIZE, direction=direction)
    flux, slope = field.field_and_gradient(position, found)
    np.testing.assert_allclose(SIZE * direction @ slope, force, rtol=0, atol=1e-8 * np.abs(force).max())
    assert np.linalg.norm(np.cross(direction, flux)) < 1e-7 * (direction @ flux)
    assert found @ found <= (1 + 1e-5) * (known @ known)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_force_contains_the_reaction_of_the_iron(tmp_path, way):
    """The iron draws the magnet upward for either sense of its moment: the coil carries the rest of the weight."""
    device = fm.read_device("desk_levitator")
    path = fm.generate(device, tmp_path / "levitator.h5", spacing=3e-3, progress=False)
    field, alone = fm.open_map(path), fm.open_map(path, reaction=False)
    position, size = np.array([0.002, 0.001, -0.027]), device.payload.moment
    direction = way * field.field(position, [1.0])
    moment = size * direction / np.linalg.norm(direction)
    force = [np.nan, np.nan, 9.80665 * device.payload.mass]
    for ask in (field.currents_for, partial(currents_for, field)):
        currents = ask(position, force=force, moment=size, direction=direction)
        assert field.wrench(position, moment, currents)[2] == pytest.approx(force[2], rel=1e-9)
        assert alone.wrench(position, moment, currents)[2] < 0.8 * force[2]


@pytest.mark.parametrize(
    ("given", "where"),
    [
        ({"direction": [0.0, 0.0, 0.0]}, "direction"),
        ({"direction": [0.0, np.nan, 1.0]}, "direction"),
        ({"direction": [0.0, 1.0]}, "direction"),
        ({"direction": [0, 0, 1], "torque": np.zeros(3)}, "torque"),
        ({"direction": [0, 0, 1], "field": np.zeros(3)}, "field"),
        ({"direction": [0, 0, 1], "force": np.zeros(3)}, "moment"),
        ({"direction": [0, 0, 1], "force": np.zeros(3), "moment": [0, 0, 1]}, "moment"),
        ({"direction": [0, 0, 1], "force": np.zeros(3), "moment": -1.0}, "moment"),
        (
            {
                "direction": [0, 0, 1],
                "force": np.zeros(3),
                "moment": magnetic_body(SoftSphere(1e-3, mu_r=9.0)),
            },
            "moment",
        ),
        ({"direction": [0, 0, 1], "least_field": -1e-3}, "least_field"),
        ({"field": [0, 0, 1e-3], "least_field": 1e-3}, "least_field"),
    ],
)
def test_what_cannot_be_asked(eight, given, where):
    with pytest.raises(InputError) as caught:
        eight.currents_for(0.5 * (eight.lower + eight.upper), **given)
    assert where in caught.value.problems[0].where

"""The inverse of a map whose iron saturates: a model made for the test, which knows its own field and derivative."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import linprog

from fieldmap.currents import IndependentCurrents, LiftAndDirections
from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.lookup import interpolate
from fieldmap.lookup.inverse import currents_of_model, demand_of
from fieldmap.store import Grid, MapData

NAMES = tuple("abcde")
MIX = np.array([[0.5, 0.2, 0.0, 0.1, 0.3], [0.0, 0.4, 0.5, 0.2, -0.1]])
POSITION = np.array([0.002, -0.001, 0.003])


@pytest.fixture(scope="module")
def block():
    """Five coils and two fields of iron: random gradients, one constant field each."""
    rng = np.random.default_rng(4)
    grid = Grid([-0.01, -0.01, -0.01], [0.01, 0.01, 0.01], (3, 3, 3))
    slope = rng.normal(size=(7, 3, 3))
    slope += slope.transpose(0, 2, 1)
    slope -= np.eye(3) * np.trace(slope, axis1=1, axis2=2)[:, None, None] / 3
    flux = 0.02 * rng.normal(size=(7, 1, 3)) + np.einsum("kij,pj->kpi", slope, grid.points())
    slopes = np.broadcast_to(slope[:, None, None, None], (7, 3, 3, 3, 3, 3))
    data = MapData(
        grid, tuple("abcdefg"), np.ones(7), flux_density=flux.reshape(7, 3, 3, 3, 3), gradient=slopes
    )
    return interpolate(data)._evaluator


@pytest.fixture(scope="module")
def model():
    """Amplitudes that grow with the currents and level off."""
    known = np.array([np.zeros(5), 2 * np.ones(5), -2 * np.ones(5)])
    data = SimpleNamespace(
        coil_count=5,
        field_count=2,
        known_currents=known,
        parametrisation=IndependentCurrents(5),
        lower=np.full(5, -4.0),
        upper=np.full(5, 4.0),
        output=np.eye(2),
    )
    return fake(data, lambda currents: 1.5 * np.tanh(MIX @ currents), bent)


def bent(currents):
    return 1.5 / np.cosh(MIX @ currents)[:, None] ** 2 * MIX


def fake(data, amplitudes, derivative):
    def weights(currents):
        return np.concatenate([currents, amplitudes(currents)])

    def slopes(currents):
        return np.concatenate([np.eye(len(currents)), derivative(currents)])

    return SimpleNamespace(
        model=data,
        fields_beside_coils=2,
        search=lambda: SimpleNamespace(weights=weights, slopes=slopes),
        slopes_at=slopes,
    )


def unit_rows(block, demand):
    from fieldmap.lookup.inverse import rows_at

    return rows_at(block, POSITION, demand, 7)


def given(rows, currents):
    return rows @ np.concatenate([currents, 1.5 * np.tanh(MIX @ currents)])


def derivative(rows, currents):
    return rows @ np.concatenate([np.eye(5), bent(currents)])


def test_demands_are_met_with_least_power(block, model):
    rng = np.random.default_rng(8)
    bounds, bound_somewhere = np.tile([-2.5, 2.5], (5, 1)), 0
    for _ in range(40):
        demand = demand_of(None, None, None, np.zeros(3), None)
        rows = unit_rows(block, demand)
        wanted = given(rows, rng.uniform(-2.5, 2.5, 5))
        demand = demand_of(None, None, None, wanted, None)
        found = currents_of_model(block, NAMES, model, POSITION, demand, 2.5, np.ones(5), None)
        np.testing.assert_allclose(given(rows, found), wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())
        assert np.abs(found).max() <= 2.5
        bound_somewhere += np.abs(found).max() > 2.4999
        # First order: along the demand's own derivative nothing within the limits costs less.
        slope = derivative(rows, found)
        judge = linprog(2 * found, A_eq=slope, b_eq=slope @ found, bounds=bounds)
        assert judge.fun == pytest.approx(2 * found @ found, rel=1e-5)
    assert bound_somewhere


def test_a_start_close_by_leads_to_the_same_currents(block, model):
    demand = demand_of([0.1, -0.2, 0.5], [0.0, 0.1, 0.4], None, None, None)
    cold = currents_of_model(block, NAMES, model, POSITION, demand, None, np.ones(5), None)
    calls = []
    counting = fake(model.model, lambda i: calls.append(0) or 1.5 * np.tanh(MIX @ i), bent)
    warm = currents_of_model(block, NAMES, counting, POSITION, demand, None, np.ones(5), cold + 1e-3)
    many = len(calls)
    again = currents_of_model(block, NAMES, counting, POSITION, demand, None, np.ones(5), [3.0, -3, 3, -3, 3])
    np.testing.assert_allclose(warm, cold, atol=1e-6)
    np.testing.assert_allclose(again, cold, atol=1e-6)
    assert many < len(calls) - many


def test_what_cannot_be_reached_says_where_the_search_ended(block, model):
    demand = demand_of(None, None, None, [5.0, 0.0, 0.0], None)
    with pytest.raises(Infeasible, match=r"reached: B.*start") as caught:
        currents_of_model(block, NAMES, model, POSITION, demand, 1.0, np.ones(5), None)
    assert caught.value.binding
    assert set(np.abs(list(caught.value.binding.values())).round(5)) == {1.0}
    assert 0 < caught.value.reachable[0] < 5


def test_refusals(block, model):
    demand = demand_of(None, None, None, [1e-3, 0.0, 0.0], None)
    divided = SimpleNamespace(
        model=SimpleNamespace(**{**vars(model.model), "parametrisation": LiftAndDirections(1.0)})
    )
    with pytest.raises(InputError, match="currents_for"):
        currents_of_model(block, NAMES, divided, POSITION, demand, None, np.ones(5), None)
    with pytest.raises(OutsideMapError):
        currents_of_model(block, NAMES, model, [0, 0, 1.0], demand, None, np.ones(5), None)
    with pytest.raises(InputError, match="currents"):
        currents_of_model(block, NAMES, model, POSITION, demand, None, np.ones(5), [1.0])

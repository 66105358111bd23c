"""The inverse of a map whose iron saturates: a model made for the test, which knows its own field and derivative."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from fieldmap.currents import CoilGroups, IndependentCurrents, LiftAndDirections
from fieldmap.device.model import Arctangent
from fieldmap.device.payload import SoftSphere
from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import MagneticBody, currents_for, interpolate, magnetic_body
from fieldmap.lookup.inverse import Search, currents_of_model, demand_of
from fieldmap.store import Grid, MapData
from tests.dynamics.conftest import saturating_map
from tests.iron.test_differential_inductance import device as core_beside_magnet

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


@pytest.fixture(scope="module")
def divided():
    """A map of six coils over a division."""
    return saturating_map()


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


def test_power_that_a_demand_costs_does_not_stand_in_its_way():
    """One coil that saturates, and a first price of the demand far below what it costs."""
    demand = SimpleNamespace(names=("B",), values=np.array([0.9]))
    goal = SimpleNamespace(
        demand=demand, size=np.ones(1), given=np.tanh, slope=lambda i: 1.0 / np.cosh(i)[:, None] ** 2
    )
    search = Search(goal, ("a",), np.full(1, -10.0), np.full(1, 10.0), np.ones(1), np.full(1, 0.1))
    np.testing.assert_allclose(search.run(np.zeros(1)), np.arctanh(0.9), rtol=1e-7)


def test_what_a_search_leaves_of_a_demand_is_met_by_the_least_change():
    """Of two coils that give 1 and 2: by the line from where they are to the nearest point that meets it."""
    slope = np.array([[1.0, 2.0]])
    demand = SimpleNamespace(names=("B",), values=np.array([3.0]))
    goal = SimpleNamespace(
        demand=demand, size=np.ones(1), given=lambda i: slope @ i, slope=lambda i: slope.copy()
    )
    limits = np.full(2, 10.0)
    search = Search(goal, ("a", "b"), -limits, limits, np.ones(2), np.full(2, 0.1))
    here = np.array([1.0, 0.9])
    np.testing.assert_allclose(search._met(here), here + 0.2 / 5.0 * slope[0], rtol=1e-12)
    met = np.array([1.0, 1.0])
    assert search._met(met) is met
    assert search._met(met + [1e-12, 0.0])[0] == 1.0 + 1e-12


def over(model, parametrisation, lower, upper, known):
    """The same model over signals; known: signals whose currents it was trained on."""
    made = {"parametrisation": parametrisation, "lower": np.array(lower), "upper": np.array(upper)}
    made["known_currents"] = parametrisation.currents(known)
    return SimpleNamespace(**{**vars(model), "model": SimpleNamespace(**{**vars(model.model), **made})})


def test_groups_of_coils_meet_a_demand_with_least_power_of_the_currents(block, model):
    """Beside SLSQP on the currents of the groups, whose power is that of the coils."""
    groups = CoilGroups([[0, 3], [1], [2, 4]])
    grouped = over(model, groups, [-4.0] * 3, [4.0] * 3, [[0, 0, 0], [2, 2, 2], [-2, -2, -2]])
    rng = np.random.default_rng(3)
    for _ in range(5):
        known = groups.currents(rng.uniform(-2.0, 2.0, 3))
        demand = demand_of(None, None, None, [0.0, 0.0, np.nan], None)
        rows = unit_rows(block, demand)
        wanted = given(rows, known)
        demand = demand_of(None, None, None, [*wanted, np.nan], None)
        found = currents_of_model(block, NAMES, grouped, POSITION, demand, None, np.ones(5), None)
        assert np.ptp(found[[0, 3]]) == np.ptp(found[[2, 4]]) == 0.0
        np.testing.assert_allclose(given(rows, found), wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())
        held = {
            "type": "eq",
            "fun": lambda s, rows=rows, wanted=wanted: (
                (given(rows, groups.currents(s)) - wanted) / np.abs(wanted).max()
            ),
        }
        judge = minimize(lambda s: (groups.currents(s) ** 2).sum(), groups.signals(known), constraints=[held])
        assert found @ found == pytest.approx(judge.fun, rel=1e-5)
        # Three components leave no choice.
        wanted = given(unit_rows(block, demand_of(None, None, None, np.zeros(3), None)), known)
        demand = demand_of(None, None, None, wanted, None)
        found = currents_of_model(block, NAMES, grouped, POSITION, demand, None, np.ones(5), None)
        np.testing.assert_allclose(found, known, atol=1e-6)


def test_a_force_by_the_signals_of_a_division(divided):
    """Currents of the division that make it; of this field along an axis there are many."""
    domain, moment = divided.info.reduced_model.domain, np.array([0.1, -0.2, 0.8])
    body = MagneticBody(np.zeros((1, 3)), moment[None])
    rng = np.random.default_rng(5)
    for _ in range(10):
        known = domain.at(rng.uniform(0.1, 0.9, 3))
        force = divided.wrench(POSITION, moment, known)[:3]
        for load in (moment, body):
            for start in (None, known):
                found = divided.currents_for(POSITION, force, load, start=start)
                made = divided.wrench(POSITION, moment, found)[:3]
                np.testing.assert_allclose(made, force, rtol=0, atol=1e-6 * np.abs(force).max())
                assert domain.holds(found)
    most = np.abs(found).max()
    np.testing.assert_array_equal(
        divided.currents_for(POSITION, force, body, 1.01 * most, start=known), found
    )
    with pytest.raises(Infeasible) as caught:
        divided.currents_for(POSITION, force, body, 0.99 * most, start=known)
    assert f"in coil {np.argmax(np.abs(found)) + 1}" in caught.value.problems[0].received
    # Ten times what the largest lift of the map gives: the search ends at the end of a signal.
    much = 10.0 * divided.wrench(POSITION, moment, domain.at(np.array([1.0, 0.5, 0.5])))[:3]
    with pytest.raises(Infeasible, match="signal") as caught:
        divided.currents_for(POSITION, much, moment)
    assert set(caught.value.binding) <= {"u", "x", "y"}


def test_a_limit_of_the_division_itself_binds(divided):
    reduced = divided.info.reduced_model
    domain, moment = reduced.domain, np.array([0.1, -0.2, 0.8])
    known = domain.at([0.9, 0.8, 0.7])
    force = divided.wrench(POSITION, moment, known)[:3]
    limited = over(
        divided._model,
        LiftAndDirections(1.25, limit=0.95 * np.abs(known).max()),
        domain.lower,
        domain.upper,
        [[1.6, 0, 0]],
    )
    limited.search, limited.slopes_at = divided._model.search, divided._model.slopes_at
    limited.fields_beside_coils = divided._model.fields_beside_coils
    limited.model.coil_count = 6
    demand = demand_of(force, moment, None, None, None)
    with pytest.raises(Infeasible, match="limits"):
        currents_of_model(divided._evaluator, "123456", limited, POSITION, demand, None, np.ones(6), None)


@pytest.fixture(scope="module")
def solved():
    """A core that saturates and a magnet, with two coils: each currents are solved for."""
    return NonlinearSolver(core_beside_magnet(Arctangent("steel", 2000.0, 2.0)), 0.5)


BESIDE = np.array([0.003, -0.002, 0.042])
KNOWN = np.array([50.0, 30.0])


@pytest.fixture(scope="module")
def saturated(solved):
    """Its state at known currents, where iron without saturation would need less."""
    state, none = solved.solve(KNOWN), solved.solve(0.0)
    inductance = solved.differential_inductance(state)[0, 0]
    assert inductance < 0.6 * solved.differential_inductance(none)[0, 0]
    return state


@pytest.mark.parametrize("load", ["field", "dipole", "magnets", "soft iron"])
def test_a_solved_device_has_the_currents_back(solved, saturated, load, monkeypatch):
    """Two coils and two components: the currents of a state that saturates, from nothing; by the state's own field and
    a body's own wrench."""
    known, moment, state = KNOWN, np.array([0.01, 0.02, 0.05]), saturated
    start, on = None, moment
    if load == "magnets":
        on = MagneticBody(np.array([[1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3]]), np.array([moment, -0.5 * moment]))
    if load == "soft iron":
        # The square of the field has its force: the currents of both senses would do.
        on, start = magnetic_body(SoftSphere(1e-3, mu_r=100.0)), 0.8 * known
    if load == "field":
        asked = {"flux_density": [np.nan, *state.field(BESIDE)[1:]]}
    else:
        force = moment @ state.gradient(BESIDE)
        if load != "dipole":
            force = on.wrench(solved, BESIDE, known)[:3]
        asked = {"force": [np.nan, *force[1:]], "moment": on}
    calls, by_currents = [], solved.by_currents
    with monkeypatch.context() as patch:
        patch.setattr(solved, "by_currents", lambda *given: calls.append(1) or by_currents(*given))
        found = currents_for(solved, BESIDE, **asked, start=start)
    np.testing.assert_allclose(found, known, rtol=2e-5)
    # Newton's method with the exact derivative: with one that is half as large again it takes twelve.
    assert len(calls) <= 8
    with pytest.raises(Infeasible) as caught:
        currents_for(solved, BESIDE, **asked, start=start, limits=0.5 * np.abs(known).max())
    assert caught.value.reachable.shape == (2,)
    with pytest.raises(InputError, match="position"):
        currents_for(solved, [BESIDE, BESIDE], **asked)


def test_refusals(block, model):
    demand = demand_of(None, None, None, [1e-3, 0.0, 0.0], None)
    with pytest.raises(OutsideMapError):
        currents_of_model(block, NAMES, model, [0, 0, 1.0], demand, None, np.ones(5), None)
    with pytest.raises(InputError, match="currents"):
        currents_of_model(block, NAMES, model, POSITION, demand, None, np.ones(5), [1.0])

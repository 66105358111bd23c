"""The inverse of a map of saturating iron: a model made for the test, with its own field and derivative."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from fieldmap.currents import CoilGroups, IndependentCurrents, LiftAndDirections
from fieldmap.device.model import Arctangent
from fieldmap.device.payload import SoftSphere
from fieldmap.errors import Infeasible, InputError, NotConverged, OutsideMapError, Problem
from fieldmap.iron import NonlinearSolver
from fieldmap.lookup import MagneticBody, currents_for, interpolate, inverse, magnetic_body
from fieldmap.lookup.current_model import CurrentSearch
from fieldmap.lookup.demand import Demand, demand_of
from fieldmap.lookup.inverse import best_of, least_power_currents, starts_on_soft_iron
from fieldmap.lookup.inverse_problem import SolvedField, SumOfFields, Variables
from fieldmap.lookup.inverse_search import MOST_EVALUATIONS, Search, linear_currents
from fieldmap.store import Grid, MapData
from tests.dynamics.conftest import saturating_map
from tests.iron.test_differential_inductance import device as core_beside_magnet
from tests.lookup.test_currents_for import loops

NAMES = tuple("abcde")
MIX = np.array([[0.5, 0.2, 0.0, 0.1, 0.3], [0.0, 0.4, 0.5, 0.2, -0.1]])
POSITION = np.array([0.002, -0.001, 0.003])
CLOSELY = {"met": 1e-9, "saving": 1e-12, "remedy": ""}


@pytest.fixture(scope="module")
def block():
    """Fields of five coils and two of iron: random gradients, and one constant field each."""
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
    def weights_and_slopes(currents):
        weights = np.concatenate([currents, amplitudes(currents)])
        return weights, np.concatenate([np.eye(len(currents)), derivative(currents)])

    return SimpleNamespace(
        model=data,
        fields_beside_coils=2,
        search=lambda: SimpleNamespace(weights_and_slopes=weights_and_slopes),
    )


def ask(block, model, demand, limits=None, start=None, position=POSITION, names=NAMES):
    fields = SumOfFields(block.each_field, names, iron=model)
    return least_power_currents(fields, position, demand, limits, None, start, None)


def unit_rows(block, demand):
    flux, slope = np.empty((1, 7, 3)), np.empty((1, 7, 3, 3))
    block.each_field(POSITION[None], flux, slope)
    return demand.selection @ np.concatenate([flux[0], slope[0].reshape(7, 9)], axis=1).T


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
        found = ask(block, model, demand, 2.5)
        np.testing.assert_allclose(given(rows, found), wanted, rtol=0, atol=1e-8 * np.abs(wanted).max())
        assert np.abs(found).max() <= 2.5
        bound_somewhere += np.abs(found).max() > 2.4999
        # First order: no other currents within the limits meet the linearised demand at less cost.
        slope = derivative(rows, found)
        judge = linprog(2 * found, A_eq=slope, b_eq=slope @ found, bounds=bounds)
        assert judge.fun == pytest.approx(2 * found @ found, rel=1e-5)
    assert bound_somewhere


def test_a_start_close_by_leads_to_the_same_currents(block, model):
    demand = demand_of([0.1, -0.2, 0.5], [0.0, 0.1, 0.4], None, None, None)
    cold = ask(block, model, demand)
    calls = []
    counting = fake(model.model, lambda i: calls.append(0) or 1.5 * np.tanh(MIX @ i), bent)
    warm = ask(block, counting, demand, start=cold + 1e-3)
    many = len(calls)
    again = ask(block, counting, demand, start=[3.0, -3, 3, -3, 3])
    np.testing.assert_allclose(warm, cold, atol=1e-6)
    np.testing.assert_allclose(again, cold, atol=1e-6)
    assert many < len(calls) - many


def test_what_cannot_be_reached_says_where_the_search_ended(block, model):
    demand = demand_of(None, None, None, [5.0, 0.0, 0.0], None)
    with pytest.raises(Infeasible, match=r"reached: B.*start") as caught:
        ask(block, model, demand, 1.0)
    assert caught.value.binding
    assert set(np.abs(list(caught.value.binding.values())).round(5)) == {1.0}
    assert 0 < caught.value.reachable[0] < 5


def goal(wanted, limit, about):
    """One row of a demand on coils with limits."""
    coils = len(limit)
    demand = SimpleNamespace(names=("B",), values=np.array([wanted]), text=str)
    variables = Variables(tuple("ab")[:coils], -np.array(limit), np.array(limit), np.ones(coils))
    return SimpleNamespace(
        demand=demand, variables=variables, about=about, evaluations=0, undirected=lambda: 0.0
    )


def linear(matrix, constant, wanted, low, high):
    """A goal of flux densities matrix @ currents + constant."""
    matrix, constant, coils = np.array(matrix, float), np.array(constant, float), len(matrix[0])
    demand = Demand(("Bx", "By")[: len(matrix)], np.zeros((len(matrix), 12)), np.array(wanted, float))
    variables = Variables(
        tuple("abc")[:coils], np.array(low, float), np.array(high, float), np.array([1.0, 4.0, 9.0])[:coils]
    )
    return SimpleNamespace(
        demand=demand,
        variables=variables,
        about=lambda i: (matrix @ i + constant, matrix),
        evaluations=0,
        undirected=lambda: 0.0,
    )


@pytest.mark.parametrize("size", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize(
    ("constant", "wanted", "high", "share"),
    # Two coils give 1 and 2 per ampere, within -0.5 and 1 A, and within -1 A and `high`.
    [
        (0.0, 6.0, 1.0, 0.5),
        (1.0, 6.0, 1.0, 4.0 / 6.0),
        (-1.0, 6.0, 1.0, 2.0 / 6.0),
        (0.0, -5.0, 1.0, 0.5),
        (-7.0, 6.0, 1.0, None),
        (0.0, 3.001, 1.0, 3.0 / 3.001),
        (0.0, 1.7, 0.25, 1.5 / 1.7),
    ],
)
def test_the_share_of_a_demand_within_limits_is_that_of_the_ends(constant, wanted, high, share, size):
    goal = linear([[1.0 / size, 2.0 / size]], [constant], [wanted], [-0.5 * size, -size], [size, high * size])
    with pytest.raises(Infeasible) as caught:
        linear_currents(goal)
    error, ends = caught.value, (size, high * size) if wanted > 0 else (-0.5 * size, -size)
    assert error.binding == dict(zip("ab", ends, strict=True))
    assert error.share == (None if share is None else pytest.approx(share, rel=1e-10))
    assert f"coil a at {ends[0]:g} A, coil b at {ends[1]:g} A" in error.problems[0].must_hold
    assert error.problems[0].received == f"Bx = {wanted:g} T"
    if share is None:
        assert "no share" in error.problems[0].remedy
        return
    assert error.reachable == pytest.approx([share * wanted])
    assert f"allow {share:.6g} of the demand: Bx = {share * wanted:.6g} T" in error.problems[0].remedy


def test_no_currents_at_all_give_no_share():
    with pytest.raises(Infeasible, match="no share"):
        linear_currents(linear([[1.0, 2.0]], [0.0], [1.0], [0.0, 0.0], [0.0, 0.0]))


def test_least_power_of_unequal_resistances_and_what_is_there_already():
    """Power i^2 + 4 j^2 and i + 2 j = 4: i = 2, j = 1. A demand that is met already costs nothing."""
    wide = [-9.0, -9.0], [9.0, 9.0]
    assert linear_currents(linear([[1.0, 2.0]], [1.0], [5.0], *wide)) == pytest.approx([2.0, 1.0])
    for off, nothing in ((0.5e-13, True), (2e-13, False), (-2e-13, False)):
        found = linear_currents(linear([[1.0, 2.0]], [5.0], [5.0 * (1.0 + off)], *wide))
        assert (not found.any()) == nothing
    with pytest.raises(Infeasible) as caught:
        linear_currents(linear([[1.0], [1.0]], [0.5, 1.0], [2.0, 3.0], [-9.0], [9.0]))
    # The nearest point to the demand that one coil can give.
    assert caught.value.reachable == pytest.approx([2.25, 2.75])
    assert caught.value.share is None


def search_of(goal, first, scale=0.1):
    return Search(goal, np.array(first, float), np.full(len(first), scale), **CLOSELY)


@pytest.mark.parametrize(
    ("wanted", "first", "scale", "typical"),
    [
        # A demand of 3 takes three times the shortest change (0.2, 0.4) that gives 1.
        (3.0, [0.0, 0.0], 0.1, [0.6, 1.2]),
        (3.0, [5.0, -1.0], 0.1, [5.0, 1.6]),
        (3.0, [0.0, 0.0], 20.0, [2.0, 2.0]),
        (0.0, [0.5, -0.25], 0.1, [0.5, 0.4]),
    ],
)
def test_what_is_missed_is_judged_by_what_typical_currents_give(wanted, first, scale, typical):
    search = search_of(linear([[1.0, -2.0]], [0.0], [wanted], [-9, -9], [9, 9]), first, scale)
    gives, (i, j) = typical[0] + 2.0 * typical[1], typical
    assert search.size == pytest.approx([max(gives, wanted)])
    assert search.price == pytest.approx(10.0 * (i * i + 4.0 * j * j))
    missed = abs(first[0] - 2.0 * first[1] - wanted)
    assert search._off(np.array(first)) == pytest.approx(missed / max(gives, wanted), abs=1.1e-12)


def test_an_aim_beyond_the_limits_is_a_half_or_a_quarter_of_the_way():
    """0.9 is missing at 0.6 of at most 1: a quarter of it can be had."""
    search = search_of(linear([[1.0]], [0.0], [1.5], [-1.0], [1.0]), [0.6])
    aim, left = search._aim(np.array([0.6]), 0.8)
    assert (aim[0], left) == (pytest.approx(0.825), pytest.approx(0.6))


@pytest.mark.parametrize(
    ("low", "high", "values", "binding"),
    [
        # A limit is reached within a ten-thousandth of the range, or of the largest value where the range is infinite.
        ([-1, -1], [1, 1], [0.99981, -0.99979], {"a": 0.99981}),
        ([-1, -1], [1, 1], [0.5, -0.99981], {"b": -0.99981}),
        ([0, 0], [np.inf, np.inf], [4e-5, 0.5], {"a": 4e-5}),
        ([0, 0], [np.inf, np.inf], [6e-5, 0.5], {}),
    ],
)
def test_where_a_search_is_stuck_the_limits_that_it_has_reached_are_told(low, high, values, binding):
    error = search_of(linear([[1.0, 2.0]], [0.5], [9.0], low, high), [0.1, 0.1])._stuck(np.array(values))
    assert error.binding == binding
    assert error.reachable == pytest.approx([values[0] + 2.0 * values[1] + 0.5])
    assert ("bind: none" in error.problems[0].must_hold) == (not binding)


def test_a_search_ends_with_the_evaluations_of_its_call():
    """With all evaluations used, a search ends with the least change to its start that meets the demand, or fails."""
    goal = linear([[1.0, 2.0]], [0.0], [3.0], [-9, -9], [9, 9])
    goal.evaluations = MOST_EVALUATIONS - 1
    assert search_of(goal, [0.0, 0.0]).run() == pytest.approx([1.5, 0.75])
    goal.evaluations = MOST_EVALUATIONS
    # The change is i / 1 = j * 4 / 2 of least power, added to the start.
    assert search_of(goal, [1.0, 0.9]).run() == pytest.approx([1.1, 0.95])
    flat = linear([[0.0, 0.0]], [0.0], [3.0], [-9, -9], [9, 9])
    flat.evaluations = MOST_EVALUATIONS
    search = search_of(flat, [0.0, 0.0])
    with pytest.raises(NotConverged) as caught:
        search.run()
    assert f"100 steps and {MOST_EVALUATIONS} evaluations" in caught.value.problems[0].must_hold
    assert caught.value.problems[0].received == "1.0e+00 of the demand left"
    assert search.left_by(caught.value) == np.inf
    assert search.left_by(Infeasible(Problem("", "", "", ""), reachable=np.array([-1.0]))) == 4.0
    assert search.left_by(Infeasible(Problem("", "", "", ""))) == np.inf


def test_power_that_a_demand_costs_does_not_stand_in_its_way():
    """One coil that saturates, and a first price of the demand far below its cost."""
    saturating = goal(0.9, [10.0], lambda i: (np.tanh(i), 1.0 / np.cosh(i)[:, None] ** 2))
    search = Search(saturating, np.zeros(1), np.full(1, 0.1), **CLOSELY)
    search.price = 0.1
    np.testing.assert_allclose(search.run(), np.arctanh(0.9), rtol=1e-7)


def test_what_a_search_leaves_of_a_demand_is_met_by_the_least_change():
    """Two coils give 1 and 2 per ampere: the change is along the shortest line to the demand."""
    slope = np.array([[1.0, 2.0]])
    here = np.array([1.0, 0.9])
    search = Search(goal(3.0, [10.0, 10.0], lambda i: (slope @ i, slope)), here, np.full(2, 0.1), **CLOSELY)
    np.testing.assert_allclose(search._met(here), here + 0.2 / 5.0 * slope[0], rtol=1e-12)
    met = np.array([1.0, 1.0])
    assert search._met(met) is met
    assert search._met(met + [1e-12, 0.0])[0] == 1.0 + 1e-12


def test_a_search_does_not_go_on_for_rounding(divided, monkeypatch):
    """The field of a reduced model is known to 1e-13 or so; with this stop the search takes less than 20 steps."""
    domain, moment = divided.info.reduced_model.domain, np.array([0.1, -0.2, 0.8])
    place = 0.5 * (divided.lower + divided.upper)
    force = divided.wrench(place, moment, domain.middle)[:3]
    asked, about = [], CurrentSearch.weights_and_slopes

    def counting(self, currents):
        asked.append(currents)
        return about(self, currents)

    monkeypatch.setattr(CurrentSearch, "weights_and_slopes", counting)
    found = divided.currents_for(place, force, moment)
    assert len(asked) < 30
    np.testing.assert_allclose(divided.wrench(place, moment, found)[:3], force, rtol=0, atol=1e-9)


def test_what_a_search_can_have_at_most_counts_what_no_current_drives():
    """One coil commands the first of two components only; without current they are 0.5 and 1."""
    rows = goal(2.0, [10.0], lambda i: (np.array([i[0] + 0.5, 1.0]), np.array([[1.0], [0.0]])))
    rows.demand = Demand(("Bx", "By"), np.zeros((2, 12)), np.array([2.0, 3.0]))
    with pytest.raises(Infeasible) as caught:
        Search(rows, np.array([0.3]), np.ones(1), **CLOSELY).run()
    np.testing.assert_allclose(caught.value.reachable, [2.0, 1.0], rtol=1e-12)


def test_of_several_searches_the_one_of_least_power_counts():
    fresh = SimpleNamespace(evaluations=0)

    def ended(*currents):
        variables = Variables(tuple("ab"), -np.ones(2), np.ones(2), np.array([1.0, 2.0]))
        return SimpleNamespace(run=lambda: np.array(currents), variables=variables, goal=fresh)

    def failed(reachable):
        def run():
            raise Infeasible(Problem("currents_for", "", "", ""), reachable=np.array([reachable]))

        return SimpleNamespace(run=run, left_by=lambda error: 1.0 - error.reachable[0], goal=fresh)

    found = best_of([ended(1.0, 1.0), ended(1.0, -0.5), failed(0.9), ended(-1.0, 1.0)])
    np.testing.assert_array_equal(found, [1.0, -0.5])
    # With the evaluations of a call used up, the first search is the last, whether it fails or not.
    for evaluations, best in ((MOST_EVALUATIONS - 1, 0.1), (MOST_EVALUATIONS, 1.0)):
        fresh.evaluations = evaluations
        np.testing.assert_array_equal(best_of([ended(1.0, 1.0), ended(0.1, 0.1)]), [best, best])
    with pytest.raises(Infeasible):
        best_of([failed(0.2), ended(1.0, 1.0)])
    fresh.evaluations = 0
    with pytest.raises(Infeasible) as caught:
        best_of([failed(0.2), failed(0.9), failed(0.5)])
    assert caught.value.reachable == 0.9


def test_searches_end_where_some_in_a_row_bring_nothing_better():
    """Searches end after two without less power, or eight without a result; one with less power restarts the count."""
    begun = []

    def ends(*powers):
        """Searches that end at these powers, None for a failure; each is made when its turn comes."""
        variables = Variables(("a",), -np.ones(1), np.ones(1), np.ones(1))
        for power in powers:
            begun.append(power)

            def run(power=power):
                if power is None:
                    raise Infeasible(Problem("currents_for", "", "", ""))
                return np.array([np.sqrt(power)])

            counted = SimpleNamespace(evaluations=0)
            yield SimpleNamespace(run=run, left_by=lambda _: 1.0, variables=variables, goal=counted)

    for powers, best, count in (
        ((4.0, 4.0, 4.0, 1.0), 4.0, 3),
        ((4.0, None, 4.0, 1.0), 4.0, 3),
        ((4.0, 4.0, 3.0, 3.0, 2.0, None, None, 1.0), 2.0, 7),
        ((4.0, 3.9999, 3.9998, 1.0), 3.9998, 3),
        ((*[None] * 7, 4.0, 4.0, 4.0, 1.0), 4.0, 10),
    ):
        begun.clear()
        np.testing.assert_allclose(best_of(ends(*powers)) ** 2, [best], rtol=1e-12)
        assert len(begun) == count
    begun.clear()
    with pytest.raises(Infeasible):
        best_of(ends(*[None] * 8, 4.0))
    assert len(begun) == 8


def test_a_search_that_creeps_at_its_limits_gives_up(monkeypatch):
    """Forces on a bead beyond the limits of eight coils: no search makes eleven steps that change little."""
    field, rng, paths = loops(), np.random.default_rng(1), []
    aim = Search._aim

    def noted(self, values, off):
        if not paths or paths[-1][0] is not self:
            paths.append((self, []))
        paths[-1][1].append(off)
        return aim(self, values, off)

    monkeypatch.setattr(Search, "_aim", noted)
    bead, middle = magnetic_body(SoftSphere(3e-3, mu_r=1000.0)), 0.5 * (field.lower + field.upper)
    for _ in range(4):
        force = field.wrench(middle, bead, rng.uniform(-5.0, 5.0, 8))[:3]
        with pytest.raises((Infeasible, NotConverged)):
            field.currents_for(middle, 10.0 * force[[1, 2, 0]], bead, 6.0)
    still = 0
    for _, left in paths:
        for k in range(len(left) - 9):
            stretch = left[k : k + 11]
            assert min(stretch) <= max(1e-2, 0.9 * max(stretch)) or len(stretch) < 11
        still += len(left) >= 9 and min(left[-9:]) > 0.9 * max(left[-9:])
    assert still


QUADRATIC = np.array(
    [
        [[3.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, -2.0]],
        [[-1.0, 0.3, 0.1], [0.3, 0.5, 0.0], [0.1, 0.0, 2.0]],
    ]
)


def pulled(wanted, low=-9.0, high=9.0, linear=0.0):
    """Two components of second order in three currents, and a linear part of the first component."""
    slope = linear * np.array([[0.1, 0.2, -0.3], [0.0, 0.0, 0.0]])
    variables = Variables(tuple("abc"), np.full(3, low), np.full(3, high), np.ones(3))
    return SimpleNamespace(
        demand=SimpleNamespace(values=np.array(wanted)),
        variables=variables,
        about=lambda i: (np.einsum("k,rkn,n->r", i, QUADRATIC, i) + slope @ i, 2.0 * QUADRATIC @ i + slope),
    )


def scaled(direction, wanted):
    given = direction @ QUADRATIC[0] @ direction
    return None if given <= 0.0 else np.sqrt(wanted / given) * direction


@pytest.mark.parametrize("scale", [0.5, 1e-3])
@pytest.mark.parametrize(("low", "ways"), [(-9.0, 1), (-8.0, 2)])
def test_searches_on_soft_iron_begin_along_the_strongest_directions(low, ways, scale):
    """Directions of the demand, with more or less of the second component, each component over its largest second
    derivative. The starts are as long as the first component takes."""
    wanted, lengths = np.array([2.4, 0.2]), np.array([6.0, 4.0])
    starts = list(starts_on_soft_iron(pulled(wanted, low), scale))
    share = wanted / lengths / (wanted[0] / lengths[0])
    expected = []
    for aside in (0.0, 1.0, -1.0):
        matrix = np.einsum("r,rkn->kn", (share + [0.0, aside]) / lengths, QUADRATIC)
        for vector in np.linalg.eigh(matrix)[1].T[:0:-1]:
            expected += [
                one
                for one in [scaled(way * vector, wanted[0]) for way in (1.0, -1.0)[:ways]]
                if one is not None
            ]
    assert len(starts) == len(expected) > 3 * ways
    for found, one in zip(starts, expected, strict=True):
        sign = np.sign(found @ one) if ways == 1 else 1.0
        np.testing.assert_allclose(sign * found, one, rtol=1e-6, atol=1e-9)


def test_where_iron_has_a_moment_of_its_own_searches_begin_without_currents():
    """A linear part above rounding: no currents first, then both senses. A demand of zero: no currents only."""
    for linear, first in ((1e-10, False), (1e-7, True)):
        starts = list(starts_on_soft_iron(pulled([2.4, 0.2], linear=linear), 1.0))
        assert (not starts[0].any()) == first
        assert len(starts) == (1 + 2 * 5 if first else 5)
    nothing = list(starts_on_soft_iron(pulled([0.0, 0.0]), 1.0))
    assert [start.tolist() for start in nothing] == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize(("ratio", "kept"), [(1.005, True), (1.02, False)])
def test_a_start_within_a_hundredth_is_left_as_it_is(ratio, kept):
    direction = np.array([1.0, 0.0, 0.0])
    found = inverse._as_long_as_needed(pulled([3.0 * ratio**2 * 0.25, 0.0]), 0, 7.0 * direction, 0.5)
    assert found[0] == pytest.approx(0.5 if kept else 0.5 * ratio, rel=1e-12)
    held = inverse._as_long_as_needed(pulled([300.0, 0.0], high=2.0), 0, direction, 0.5)
    assert held[0] == 2.0
    assert inverse._as_long_as_needed(pulled([-1.0, 0.0]), 0, direction, 0.5) is None


def test_a_solved_device_as_fields_of_its_coils_and_the_rest():
    """Made up: derivatives by two currents, and a field that is not their sum."""
    random = np.random.default_rng(14)
    flux, slope = random.standard_normal((4, 3)), random.standard_normal((4, 3, 3))
    by_flux, by_slope = random.standard_normal((4, 2, 3)), random.standard_normal((4, 2, 3, 3))
    asked = []

    def by_currents(points, currents):
        asked.append((points, currents))
        return flux, slope, by_flux, by_slope

    field, points, about = SolvedField(by_currents, ("a", "b")), random.random((4, 3)), np.array([2.0, -3.0])
    fields, weights, slopes = field.at(points)(about)
    np.testing.assert_array_equal(weights, [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(slopes, [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    for k, (b, g) in enumerate(
        [(by_flux[:, 0], by_slope[:, 0]), (by_flux[:, 1], by_slope[:, 1]), (flux, slope)]
    ):
        np.testing.assert_array_equal(fields[:, k], np.concatenate([b, g.reshape(4, 9)], axis=1))
    linear = field.linear_about(about)
    assert (linear.coil_names, linear.constant) == (("a", "b"), True)
    b, g = np.empty((4, 3, 3)), np.empty((4, 3, 3, 3))
    linear.each_field(points, b, g)
    for found, each, here in ((b, by_flux, flux), (g, by_slope, slope)):
        np.testing.assert_array_equal(found[:, :2], each)
        np.testing.assert_allclose(found[:, 2], here - 2.0 * each[:, 0] + 3.0 * each[:, 1], rtol=1e-12)
    assert all(given[0] is points and given[1] is about for given in asked)


def test_a_place_that_the_fields_do_not_know_is_told_in_mm():
    def each_field(points, flux, slope):
        flux[:], slope[:] = 1.0, 1.0
        flux[points[:, 0] > 0.01] = np.nan

    fields = SumOfFields(each_field, ("a",))
    with pytest.raises(OutsideMapError) as caught:
        fields.at(np.array([[0.0, 0.0, 0.0], [0.02, -0.0123456789, 0.003]]))
    problem = caught.value.problems[0]
    assert problem.received == "(20.0, -12.345679, 3.0) mm"
    assert "the whole body" in problem.must_hold
    with pytest.raises(OutsideMapError, match="a place in the map's box"):
        fields.at(np.array([[0.02, 0.0, 0.0]]))


def test_how_searches_are_set_up(divided, monkeypatch):
    """The start of a search, the typical size of its currents, and its tolerances of demand and power."""

    class StopError(Exception):
        pass

    def noted(goal, first, scale, met, saving, remedy):
        raise StopError(first.tolist(), scale.tolist(), met, saving, "start=" in remedy)

    monkeypatch.setattr(inverse, "Search", noted)
    bead, demand = (
        magnetic_body(SoftSphere(1e-3, mu_r=100.0)),
        demand_of(None, None, None, [0.0, 0.0, 1.0], None),
    )

    def by_currents(points, currents):
        n = len(points)
        return np.zeros((n, 3)), np.zeros((n, 3, 3)), np.ones((n, 2, 3)), np.ones((n, 2, 3, 3))

    def set_up(field, demand=demand, limits=None, start=None):
        with pytest.raises(StopError) as caught:
            least_power_currents(field, POSITION, demand, limits, None, start, None)
        return caught.value.args

    solved = SolvedField(by_currents, ("a", "b"))
    assert set_up(solved) == ([0.0, 0.0], [1.0, 1.0], 1e-5, 1e-5, True)
    assert set_up(solved, limits=(0.5, 3.0)) == ([0.5, 0.5], [0.5, 0.5], 1e-5, 1e-5, True)
    assert set_up(solved, limits=(-4.0, 3.0)) == ([0.0, 0.0], [4.0, 4.0], 1e-5, 1e-5, True)
    assert set_up(solved, start=[0.5, -2.0]) == ([0.5, -2.0], [2.0, 2.0], 1e-5, 1e-5, False)
    # On soft iron the tolerance of the power is larger; the model of a map gives the typical size.
    on_bead = demand_of([0.0, 0.0, 1e-6], bead, None, None, None)
    assert set_up(solved, on_bead, start=[0.5, 1.0])[2:4] == (1e-5, 1e-5)
    reduced = divided.info.reduced_model
    signals = reduced.parametrisation.nearest(reduced.known_currents).values
    for asked, saving in ((demand, 1e-12), (on_bead, 1e-7)):
        first, scale, *ends = set_up(divided._fields_of_currents(), asked)
        assert ends == [1e-9, saving, True]
        np.testing.assert_allclose(scale, np.maximum(np.abs(signals).max(axis=0), 1e-12))
        middle = reduced.parametrisation.nearest(reduced.known_currents.mean(axis=0)).values
        np.testing.assert_allclose(first, middle, atol=1e-12)


def over(model, parametrisation, lower, upper, known):
    """The same model over signals; known: signals of the currents that it was trained on."""
    made = {"parametrisation": parametrisation, "lower": np.array(lower), "upper": np.array(upper)}
    made["known_currents"] = parametrisation.currents(known)
    return SimpleNamespace(**{**vars(model), "model": SimpleNamespace(**{**vars(model.model), **made})})


def test_groups_of_coils_meet_a_demand_with_least_power_of_the_currents(block, model):
    """Against SLSQP on the currents of the groups, with the power of the coils."""
    groups = CoilGroups([[0, 3], [1], [2, 4]])
    grouped = over(model, groups, [-4.0] * 3, [4.0] * 3, [[0, 0, 0], [2, 2, 2], [-2, -2, -2]])
    rng = np.random.default_rng(3)
    for _ in range(5):
        known = groups.currents(rng.uniform(-2.0, 2.0, 3))
        demand = demand_of(None, None, None, [0.0, 0.0, np.nan], None)
        rows = unit_rows(block, demand)
        wanted = given(rows, known)
        demand = demand_of(None, None, None, [*wanted, np.nan], None)
        found = ask(block, grouped, demand)
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
        # Three components of a demand leave no choice.
        wanted = given(unit_rows(block, demand_of(None, None, None, np.zeros(3), None)), known)
        demand = demand_of(None, None, None, wanted, None)
        found = ask(block, grouped, demand)
        np.testing.assert_allclose(found, known, atol=1e-6)


def test_a_force_by_the_signals_of_a_division(divided):
    """Within the limits of the currents and of the signals."""
    domain, moment = divided.info.reduced_model.domain, np.array([0.1, -0.2, 0.8])
    body, known = MagneticBody(np.zeros((1, 3)), moment[None]), domain.at(np.array([0.3, 0.7, 0.6]))
    force = divided.wrench(POSITION, moment, known)[:3]
    found = divided.currents_for(POSITION, force, body, start=known)
    most = np.abs(found).max()
    np.testing.assert_array_equal(
        divided.currents_for(POSITION, force, body, 1.01 * most, start=known), found
    )
    least = np.abs(found).min()
    # A millionth of the largest current counts as rounding.
    for limits in ((-1.0 - 5e-7) * most, (-most, most * (1.0 - 5e-7)), (least + 5e-7 * most, 2.0 * most)):
        bound = (limits, -limits) if np.isscalar(limits) else limits
        np.testing.assert_array_equal(divided.currents_for(POSITION, force, body, bound, start=known), found)
    lowest = int(np.argmin(found))
    for limits, coil in (
        ((1.0 - 2e-6) * most, np.argmax(np.abs(found))),
        ((found[lowest] + 2e-6 * most, 9.0), lowest),
    ):
        with pytest.raises(Infeasible) as caught:
            divided.currents_for(POSITION, force, body, limits, start=known)
        received = caught.value.problems[0].received
        assert f"takes {found[coil]:.6g} A in coil {coil + 1}" in received
    # The demand is ten times the largest lift of the map: the search ends at the end of a signal.
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
    limited.search = divided._model.search
    limited.fields_beside_coils = divided._model.fields_beside_coils
    limited.model.coil_count = 6
    demand = demand_of(force, moment, None, None, None)
    with pytest.raises(Infeasible, match="limits"):
        ask(divided._evaluator, limited, demand, names=tuple("123456"))


@pytest.fixture(scope="module")
def solved():
    """A core that saturates and a magnet, with two coils; each state is solved anew."""
    return NonlinearSolver(core_beside_magnet(Arctangent("steel", 2000.0, 2.0)), 0.5)


BESIDE = np.array([0.003, -0.002, 0.042])
KNOWN = np.array([50.0, 30.0])


@pytest.fixture(scope="module")
def saturated(solved):
    """The state at known currents; iron without saturation would need less."""
    state, none = solved.solve(KNOWN), solved.solve(0.0)
    inductance = solved.differential_inductance(state)[0, 0]
    assert inductance < 0.6 * solved.differential_inductance(none)[0, 0]
    return state


@pytest.mark.parametrize("load", ["field", "dipole", "magnets", "soft iron", "soft iron of one sense"])
def test_a_solved_device_has_the_currents_back(solved, saturated, load, monkeypatch):
    """Two coils and two components: the search finds the currents of a saturated state from its own field or wrench,
    without a start."""
    known, moment, state = KNOWN, np.array([0.01, 0.02, 0.05]), saturated
    start, on = None, moment
    if load == "magnets":
        on = MagneticBody(np.array([[1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3]]), np.array([moment, -0.5 * moment]))
    limits = None
    if load.startswith("soft iron"):
        # The force goes with the square of the field: currents of either sense would do.
        on = magnetic_body(SoftSphere(1e-3, mu_r=100.0))
        start, limits = (0.8 * known, None) if load == "soft iron" else (None, (10.0, 100.0))
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
        found = currents_for(solved, BESIDE, **asked, start=start, limits=limits)
    np.testing.assert_allclose(found, known, rtol=2e-5)
    # Newton's method has the exact derivative; with one that is half as large again it takes twelve evaluations.
    assert len(calls) <= 8
    with pytest.raises(Infeasible) as caught:
        currents_for(solved, BESIDE, **asked, start=start, limits=0.5 * np.abs(known).max())
    assert caught.value.reachable.shape == (2,)
    with pytest.raises(InputError, match="position"):
        currents_for(solved, [BESIDE, BESIDE], **asked)


def test_refusals(block, model):
    demand = demand_of(None, None, None, [1e-3, 0.0, 0.0], None)
    with pytest.raises(OutsideMapError):
        ask(block, model, demand, position=[0, 0, 1.0])
    with pytest.raises(InputError, match="currents"):
        ask(block, model, demand, start=[1.0])

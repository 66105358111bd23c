"""Fewer modes and points against the model that they were made from, and against linear algebra."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from fieldmap.currents import CurrentDomain, IndependentCurrents, LiftAndDirections
from fieldmap.device.materials.froehlich import Froehlich
from fieldmap.iron.elements.bh_law import law_tables, straight_laws
from fieldmap.iron.solvers.reduced import Weights
from fieldmap.maps.training import condensation
from fieldmap.maps.training.condensation import condensed
from fieldmap.maps.training.currents import extreme_signals, sequence
from tests.maps.bar import Bar, bar, solved

ACCURACY = 1e-3
STEEL = Froehlich("steel", 2000.0, 2.1)


@dataclass
class Case(Bar):
    """A bar with a domain of its currents."""

    domain: CurrentDomain

    def condensed(self, accuracy=ACCURACY):
        known = np.array([self.domain.middle])
        pair = known, solved(self.model, known)
        return condensed(self.model, pair, self.domain, self.fields, self.off, accuracy)

    def changes(self, found, currents):
        """Changes of the field at currents (s, c), as shares of the accuracy."""
        whole = solved(self.model, currents)
        few = solved(found.model, currents) @ found.basis.T
        return self.off(currents, whole, few - whole) / ACCURACY

    def combined(self, count=16):
        """This many modes, from the states of the choice."""
        by, _ = condensation._currents(self.domain)
        states = condensation._States(self.model, by, solved(self.model, by), self.fields, False)
        return condensation.Condensed(*states.combined(count, self.off), 0.0)


def case(tables, domain):
    made = bar(tables, domain.parametrisation.coil_count, 40, 300, falls=2)
    return Case(made.model, made.fields, domain)


@pytest.fixture(scope="module")
def free():
    box = CurrentDomain(IndependentCurrents(3), np.full(3, -1.5), np.full(3, 2.0))
    return case(law_tables([STEEL]), box)


def test_fewer_modes_and_points_give_the_field_at_other_currents(free):
    found = free.condensed()
    assert found.model.modes < free.model.modes
    assert len(found.model.weights) < 0.7 * len(free.model.weights)
    assert 0.0 < found.changed <= condensation._IN_ALL
    np.testing.assert_allclose(found.basis.T @ found.basis, np.eye(found.model.modes), atol=1e-9)
    assert found.model.weights.sum() == pytest.approx(free.model.weights.sum(), rel=0.01)
    others = free.domain.at(np.random.default_rng(77).random((100, 3)))
    changes = free.changes(found, others)
    # The bound holds for a hundred other states; the 200 states of the test were within nine tenths.
    assert changes.max() < 2.0
    assert np.median(changes) < 0.5


def test_modes_do_not_depend_on_the_numbers_of_modes_tried_before(free):
    currents = free.domain.at(np.random.default_rng(3).random((60, 3)))
    states = condensation._States(free.model, currents, solved(free.model, currents), free.fields, False)
    first = states.combined(16, free.off)[1]
    states.combined(24, free.off)
    np.testing.assert_array_equal(states.combined(16, free.off)[1], first)
    np.testing.assert_allclose(first.T @ first, np.eye(16), atol=1e-9)


def test_a_choice_that_leaves_nothing_at_once_is_taken(free, monkeypatch):
    """Four places, thirty points at each: with all four places the rest drops to rounding in one step."""
    monkeypatch.setattr(condensation, "_STATES", 100)
    monkeypatch.setattr(condensation, "_TRIED", 50)
    numbers = np.repeat([20, 90, 160, 250], 30)
    many = replace(free, model=free.model.sampled(numbers, np.full(120, 1.0 / 120.0)))
    found = many.condensed()
    assert len(found.model.weights) <= 60
    assert 0.0 < found.changed <= condensation._IN_ALL
    assert found.model.weights.sum() == pytest.approx(1.0, rel=0.01)


def test_adjoint_states_make_the_field_better_than_proper_modes_alone(free, monkeypatch):
    """By Becker and Rannacher the error is a product of the projection errors of states and of adjoint states."""
    others = free.domain.at(np.random.default_rng(78).random((60, 3)))
    monkeypatch.setattr(condensation, "_ROUNDS", 0)
    errors = []
    for share in (condensation._ADJOINT, 1e-9):
        monkeypatch.setattr(condensation, "_ADJOINT", share)
        errors.append(free.changes(free.combined(), others).max())
    assert errors[0] < 0.7 * errors[1]


def test_linear_iron_needs_a_mode_for_each_coil():
    """Its states are sums of the coils' states, whatever else the modes hold: one step of modes is enough."""
    box = CurrentDomain(IndependentCurrents(2), np.full(2, -1.0), np.full(2, 1.0))
    linear = case(straight_laws(np.array([50.0])), box)
    found = linear.condensed()
    assert found.model.modes == condensation._STEP
    model = linear.model.combined(found.basis)
    exact = condensation.Condensed(model, found.basis, 0.0)
    assert linear.changes(exact, box.at(np.random.default_rng(2).random((20, 2)))).max() < 0.1


def test_changes_to_first_order_are_those_of_solves_on_the_basis(free):
    """For linear iron exactly; for saturating iron the rest falls with the square of the basis's projection error."""
    currents = free.domain.at(np.random.default_rng(4).random((20, 3)))
    linear = replace(free.model, tables=straight_laws(np.array([50.0])))
    for model, count, close in ((linear, 2, 1e-5), (free.model, 6, 0.2), (free.model, 12, 0.1)):
        whole = solved(model, currents, 1e-12)
        states = condensation._States(model, currents, whole, free.fields, False)
        basis = np.ascontiguousarray(np.linalg.svd(whole[:15])[2][:count].T)
        expected = solved(model.combined(basis), currents, 1e-12) @ basis.T - whole
        rest = np.abs(states.projected(basis) - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert rest.max() < close


def test_where_all_modes_are_needed_all_stay(free):
    seen = replace(free, fields=np.eye(free.model.modes))
    found = seen.condensed(1e-9 * ACCURACY)
    assert found.model is seen.model
    assert found.changed == 0.0
    np.testing.assert_array_equal(found.basis, np.eye(seen.model.modes))


def test_states_beside_a_domain_of_few_signals_count(monkeypatch):
    """Coils lag behind their signals: currents off a division by some hundredths are within the accuracy too."""
    box = CurrentDomain(LiftAndDirections(1.25), np.array([0.3, -0.4, -0.4]), np.array([2.0, 0.4, 0.4]))
    divided = case(law_tables([STEEL]), box)
    by, tried = condensation._currents(box)
    assert len(by) == 2 * (condensation._STATES + len(extreme_signals(box)) // 2 + 1)
    assert all(box.holds(values) for values in tried)
    others = box.at(np.random.default_rng(5).random((60, 3)))
    random = np.random.default_rng(6).uniform(-1.0, 1.0, others.shape[:1] + (6,))
    beside = others + 0.03 * np.abs(others).max(axis=1, keepdims=True) * random
    found = divided.condensed()
    assert divided.changes(found, others).max() < 2.0
    assert divided.changes(found, beside).max() < 2.0
    # The same number of modes, chosen without such states, holds such currents less well.
    errors = []
    for share in (condensation._BESIDE, 0.0):
        monkeypatch.setattr(condensation, "_BESIDE", share)
        errors.append(divided.changes(divided.combined(), beside).max())
    assert errors[0] < 0.8 * errors[1]


def test_adjoint_states_say_what_a_disturbance_changes(free):
    """f . da / dr for the constant r of the equation, by differences of solves."""
    currents = free.domain.at(np.array([[0.9, 0.3, 0.8]]))
    whole = free.model.solve(currents[0], np.zeros(free.model.modes), 1e-12)[0]
    states = condensation._States(free.model, currents, whole[None], free.fields, False)
    size = np.linalg.norm(whole @ free.fields)
    random = np.random.default_rng(9).standard_normal((3, free.model.modes))
    for direction in 1e-6 * random / np.linalg.norm(random, axis=1, keepdims=True):
        ahead, behind = (
            replace(free.model, constant=share * direction).solve(currents[0], whole, 1e-12)[0]
            for share in (1.0, -1.0)
        )
        expected = 0.5 * (ahead - behind) @ free.fields / size
        ours = direction @ states._adjoint[0]
        assert np.abs(ours - expected).max() < 1e-3 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("modes", "needed", "found"),
    [
        (40, 1, 8),
        (40, 8, 8),
        (40, 9, 16),
        (40, 32, 32),
        (40, 33, None),
        (41, 33, 40),
        (41, 41, None),
        (8, 1, None),
        (200, 150, 152),
    ],
)
def test_the_fewest_modes_come_in_steps_of_eight(modes, needed, found):
    """A model that needs this many modes; None if it needs all."""
    assert condensation._fewest(modes, lambda count: count, lambda count: count >= needed) == found


def test_states_of_the_choice_and_of_its_test_share_the_extremes(monkeypatch):
    """Half of the states of the choice fill the domain, half are drawn; the test draws other states."""
    box = CurrentDomain(IndependentCurrents(4), np.full(4, -1.5), np.full(4, 2.0))
    edges = box.parametrisation.currents(extreme_signals(box))
    by, tried = condensation._currents(box)
    half = (len(edges) + 1) // 2
    assert half <= 64
    assert (len(by), len(tried)) == (400 + half, 200 + len(edges) - half)
    np.testing.assert_array_equal(by[:200], box.parametrisation.currents(sequence(box, 200)))
    both = np.concatenate([by[400:], tried[200:]])
    assert {tuple(row) for row in both} == {tuple(row) for row in edges}
    for rows in (by, tried):
        assert (rows >= box.lower).all()
        assert (rows <= box.upper).all()
    # Neither keeps the order of the extremes.
    assert not np.array_equal(np.sort(by[400:], axis=0), np.sort(edges[::2], axis=0))
    many = CurrentDomain(IndependentCurrents(8), np.full(8, -1.5), np.full(8, 2.0))
    assert [len(rows) for rows in condensation._currents(many)] == [464, 264]


def test_currents_lie_beside_those_of_signals_by_a_twentieth_of_the_largest():
    box = CurrentDomain(LiftAndDirections(1.25), np.array([0.3, -0.4, -0.4]), np.array([2.0, 0.4, 0.4]))
    by, _ = condensation._currents(box)
    own, beside = np.split(by, 2)
    assert all(box.holds(row) for row in own[::20])
    shares = (beside - own) / np.abs(own).max(axis=1, keepdims=True)
    assert 0.0499 < shares.max() <= 0.05
    assert -0.05 <= shares.min() < -0.0499
    assert np.abs(shares.mean(axis=0)).max() < 0.005


def test_a_point_more_or_less_changes_the_linkages_by_its_condition(free):
    """An error of a weight changes a state's linkage directly, and moves the state: the condition has both parts."""
    currents = np.array([0.9, -0.4, 1.3])
    amplitude = solved(free.model, currents[None], 1e-12)[0]
    conditions = free.model.conditions(currents, amplitude, free.fields, Weights(0.03, 1.0))
    added = conditions.of_points(free.model)[:, free.model.modes :]

    def linked(model):
        state = model.solve(currents, amplitude, 1e-12)[0]
        return model.sums(model.moments(currents, state))[model.modes :]

    for point in (20, 150, 260):
        ends = []
        for share in (1e-3, -1e-3):
            weights = free.model.weights.copy()
            weights[point] *= 1.0 + share
            ends.append(linked(replace(free.model, weights=weights)))
        changed = (ends[0] - ends[1]) / 2e-3 / np.abs(linked(free.model)).max()
        assert changed == pytest.approx(added[point], rel=1e-2, abs=1e-3 * np.abs(added).max())


def test_conditions_on_the_points_are_met_by_their_own_weights(free):
    """With all factors at one the conditions are met exactly. An error of 1 % of the volume counts as half the accuracy
    in each state."""
    currents = free.domain.at(np.random.default_rng(5).random((7, 3)))
    states = condensation._States(free.model, currents, solved(free.model, currents), free.fields, False)
    basis = np.eye(free.model.modes)
    volume = free.model.weights / free.model.weights.sum()
    found = [states.conditions(free.model, basis, accuracy) for accuracy in (1e-3, 1e-2)]
    for products, wanted, size in found:
        np.testing.assert_allclose(products.sum(axis=1), wanted, rtol=1e-8)
        assert wanted.sum() == pytest.approx(size**2, rel=1e-9)
    # Conditions of fields and energies are multiples of the accuracy.
    rest = (1e-6 * found[0][0] - 1e-4 * found[1][0]) / (1e-6 - 1e-4)
    weight = 7 * 0.5**2 / 0.01**2
    scale = np.abs(found[1][0]).max()
    np.testing.assert_allclose(rest, weight * np.outer(volume, volume), atol=1e-8 * scale)
    # One state: the change by one point's weight of the field, of the linkages, and a little of the energy.
    one = condensation._States(free.model, currents[:1], solved(free.model, currents[:1]), free.fields, False)
    products, wanted, size = one.conditions(free.model, basis, 1e-3)
    weights = free.model.weights.copy()
    weights[150] *= 1.0 + 1e-4
    amplitude = solved(free.model, currents[:1])[0]
    other = replace(free.model, weights=weights)
    moved = other.solve(currents[0], amplitude, 1e-12)[0]
    off = moved - amplitude
    factor = free.model.tangent_factor(currents[0], amplitude)
    of_field = np.linalg.norm(off @ free.fields) / np.linalg.norm(amplitude @ free.fields)
    of_energy = 0.03 * np.linalg.norm(factor.T @ off) / np.linalg.norm(factor.T @ amplitude)
    linked, then = (
        of.sums(of.moments(currents[0], at))[of.modes :]
        for of, at in ((free.model, amplitude), (other, moved))
    )
    of_linkage = 0.1 * np.linalg.norm(then - linked) / np.abs(linked).max()
    squares = of_field**2 + of_energy**2 + of_linkage**2
    expected = squares / 1e-6 / 1e-8 + 2500.0 * volume[150] ** 2
    assert products[150, 150] == pytest.approx(expected, rel=0.02)

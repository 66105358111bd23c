"""The current that carries the weight, against closed forms of fields and of their dependence on the current."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.device.model import MagnetCylinder, Payload, PayloadPiece, Placement
from fieldmap.device.placement import rotation_matrix
from fieldmap.errors import Infeasible, InputError, NotConverged, OutsideMapError, Problem
from fieldmap.field import Field, as_field
from fieldmap.levitation import find_equilibrium, lift_current
from fieldmap.levitation.lift import (
    MAX_STATES,
    _next_current,
    force_per_ampere,
    lift_shares,
    push_shares,
    signal_pushes,
)
from tests.refusals import refused

PAYLOAD = Payload(mass=0.01119, moment=0.813)
WEIGHT = 0.01119 * 9.80665
COEFFICIENTS = (0.02, 0.03, 0.6, 0.0)
POINT = [0.0, 0.0, 0.02]
PER_AMPERE = 0.813 * (2 * 0.03 + 6 * 0.6 * 0.02)  # N/A: D (2 c2 + 6 c3 z)
SHAPE = MagnetCylinder(0.01, 0.012, 0.813 * mu_0 / (0.25 * np.pi * 0.01**2 * 0.012))
OVER = Placement((0.0, 0.0, 0.0), rotation_matrix((180.0, 0.0, 0.0)))
DOWN = Payload(mass=0.01119, pieces=[PayloadPiece(SHAPE, OVER)])
NEEDED = WEIGHT / PER_AMPERE  # what an unsaturated field needs, A


def test_closed_form(axisymmetric):
    """D I (2 c2 + 6 c3 z) = m g; off the axis F_x = -3 I D c3 x is reported."""
    lift = lift_current(axisymmetric(COEFFICIENTS), PAYLOAD, [0.005, 0, 0.02])
    assert lift.current == pytest.approx(NEEDED, rel=1e-12)
    np.testing.assert_allclose(lift.force, [-3 * NEEDED * 0.813 * 0.6 * 0.005, 0, WEIGHT], atol=1e-15)
    assert lift.history == ()


def test_the_equilibrium_of_the_lift_current_is_where_it_was_asked_for(axisymmetric):
    source = axisymmetric(COEFFICIENTS)
    lift = lift_current(source, PAYLOAD, [0, 0, 0.013], shares=[2.0])
    assert lift.currents == pytest.approx([2.0 * lift.current])
    found = find_equilibrium(source, lift.currents, PAYLOAD)
    np.testing.assert_allclose(found.position, [0, 0, 0.013], atol=1e-9)
    np.testing.assert_allclose(found.stiffness, lift.stiffness, rtol=1e-9, atol=1e-12)


class Law(Field):
    """Fields g(i) B_1(x): the field shape of one ampere, a saturating law g, and a list of the solved currents."""

    coil_names = ("only",)

    def __init__(self, shape, law):
        self.shape, self.law, self.states = shape, law, []

    @property
    def bounds(self):
        return self.shape.lower, self.shape.upper

    def state(self, currents):
        current = np.asarray(currents, dtype=float)
        if not self.states or self.states[-1] != current[0]:
            self.states.append(current[0])
        effective = np.array([self.law(current[0])])
        return SimpleNamespace(
            coil_names=("only",),
            currents=current,
            field=lambda points: self.shape.field(points, effective),
            gradient=lambda points: self.shape.gradient(points, effective),
        )

    def field(self, points, currents):
        return self.state(currents).field(points)

    def gradient(self, points, currents):
        return self.state(currents).gradient(points)


class UpTo(Law):
    """The same field, defined up to a largest current."""

    def __init__(self, shape, law, largest):
        super().__init__(shape, law)
        self.largest = largest

    def state(self, currents):
        if currents[0] > self.largest:
            raise OutsideMapError(Problem("currents", "must be held", f"{currents[0]}", "none"))
        return super().state(currents)


def knee(slope):
    """g(i) = i up to the knee at 0.6 NEEDED, and a lower slope beyond: the inverse is known."""
    corner = 0.6 * NEEDED
    return lambda i: i if i < corner else corner + slope * (i - corner)


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (lambda i: i, NEEDED),
        (knee(0.1), 0.6 * NEEDED + 0.4 * NEEDED / 0.1),
        (lambda i: 2 * NEEDED * np.tanh(i), np.arctanh(0.5)),
        # A field of the other sense takes a negative current.
        (lambda i: -2 * NEEDED * np.tanh(i), -np.arctanh(0.5)),
        (lambda i: NEEDED * i**3, 1.0),
        (lambda i: i - 0.3 * NEEDED, 1.3 * NEEDED),
    ],
    ids=["linear", "knee", "tanh", "turned", "cubic", "biased"],
)
@pytest.mark.parametrize("first", [0.5, 1.0, 3.0])
def test_the_inverse_of_the_law(axisymmetric, law, expected, first):
    """Every state is reported as progress and stands in the history."""
    field, told = Law(axisymmetric(COEFFICIENTS), law), []
    lift = lift_current(field, PAYLOAD, POINT, None, first, 1e-6, lambda *state: told.append(state))
    assert lift.force[2] == pytest.approx(WEIGHT, rel=1e-6)
    assert lift.current == pytest.approx(expected, rel=1e-5)
    # The slope is taken to the nearest state that is at least a hundredth away.
    history = np.array(lift.history)
    i, newtons = history[-1]
    far = [k for k in range(len(history) - 1) if abs(history[k, 0] / i - 1.0) >= 0.01]
    k = min(far, key=lambda k: abs(history[k, 0] - i))
    assert lift.force_per_ampere[2] == pytest.approx(
        (newtons - history[k, 1]) / (i - history[k, 0]), rel=1e-9
    )
    np.testing.assert_allclose(lift.history, [(i, PER_AMPERE * law(i)) for i in field.states])
    np.testing.assert_allclose(told, [(i, newtons / WEIGHT) for i, newtons in lift.history])


@pytest.mark.parametrize("share", [-2.0, 0.5])
@pytest.mark.parametrize(
    "payload", [PAYLOAD, Payload(mass=0.01119, pieces=[SHAPE])], ids=["moment", "pieces"]
)
def test_the_current_takes_the_sign_that_lifts(axisymmetric, payload, share):
    """The magnet keeps its direction for either winding sense; a magnet that points down needs the other sign."""
    field = Law(axisymmetric(COEFFICIENTS), lambda i: 2 * NEEDED * np.tanh(i))
    lift = lift_current(field, payload, POINT, [share], 0.5, 1e-6)
    assert lift.currents == pytest.approx([np.arctanh(0.5)], rel=1e-4)
    assert (lift.held, np.sign(lift.current)) == ("moment up, fixed", np.sign(share))
    turned = replace(payload, direction="down") if payload is PAYLOAD else DOWN
    other = lift_current(field, turned, POINT, [share], 0.5, 1e-6)
    assert other.currents == pytest.approx([-np.arctanh(0.5)], rel=1e-4)
    assert other.held == "moment down, fixed"
    assert lift.force[2] == pytest.approx(WEIGHT, rel=1e-5)


def test_a_first_current_that_is_right_has_its_slope_from_one_two_hundredths_away(axisymmetric):
    field = Law(axisymmetric(COEFFICIENTS), lambda i: i)
    lift = lift_current(field, PAYLOAD, POINT, first=NEEDED)
    assert field.states[:2] == pytest.approx([NEEDED, 1.02 * NEEDED])
    assert lift.force_per_ampere[2] == pytest.approx(PER_AMPERE, rel=1e-9)


def test_a_linear_field_needs_three_states_at_most_and_agrees_with_the_linear_function(axisymmetric):
    shape = axisymmetric(COEFFICIENTS)
    field = Law(shape, lambda i: i)
    lift, linear = (lift_current(one, PAYLOAD, POINT) for one in (field, shape))
    assert len(field.states) <= 3
    assert lift.current == pytest.approx(linear.current, rel=1e-9)
    for name, rtol, atol in (
        ("force_per_ampere", 1e-9, 1e-12),
        ("field", 1e-9, 1e-12),
        ("stiffness", 1e-5, 1e-7),
    ):
        np.testing.assert_allclose(getattr(lift, name), getattr(linear, name), rtol, atol)


@pytest.mark.parametrize(
    "payload", [PAYLOAD, Payload(mass=0.01119, pieces=[SHAPE])], ids=["moment", "pieces"]
)
def test_force_per_ampere_is_the_slope_not_the_ratio(axisymmetric, payload):
    field = Law(axisymmetric(COEFFICIENTS), knee(0.25))
    lift = lift_current(field, payload, POINT, first=2.0 * NEEDED)
    assert lift.current == pytest.approx(0.6 * NEEDED + 0.4 * NEEDED / 0.25, rel=1e-4)
    assert lift.force_per_ampere[2] == pytest.approx(0.25 * PER_AMPERE, rel=1e-6)


@pytest.mark.parametrize(
    ("tried", "following"),
    [
        # A secant step inside the bracket, or, without enough lift so far, at most three times the last current.
        ([(1.0, -0.5), (2.0, 0.5)], 1.5),
        ([(1.0, -0.5), (2.0, -0.4)], 6.0),
        ([(1.0, 0.5), (2.0, 0.6)], -4.0),
        # A secant that leaves the bracket of the states next to the weight: the middle of the bracket.
        ([(1.0, -0.5), (2.0, 0.5), (1.9, 0.6)], 1.5),
        ([(1.0, -0.5), (2.0, 0.0), (2.2, 0.1), (2.3, 0.05)], 1.5),
    ],
)
def test_the_next_current_is_kept_in_the_bracket(tried, following):
    assert _next_current(tried) == pytest.approx(following)


def test_lift_that_never_reaches_the_weight_ends(axisymmetric):
    field = Law(axisymmetric(COEFFICIENTS), lambda i: 0.9 * NEEDED * np.tanh(i))
    with pytest.raises(NotConverged) as caught:
        lift_current(field, PAYLOAD, POINT)
    assert min(caught.value.residuals) == pytest.approx(0.1, abs=1e-6)
    (told,) = caught.value.problems
    assert len(field.states) == MAX_STATES
    assert f"within {MAX_STATES} states" in told.must_hold
    # The last four lifts and the currents of their states.
    last = [f"{PER_AMPERE * field.law(i) / WEIGHT:.4g} at {i:.4g} A" for i in field.states[-4:]]
    assert told.received.endswith(": " + ", ".join(last))


@pytest.mark.parametrize(
    "of", [lambda shape: shape, lambda shape: Law(shape, lambda i: i)], ids=["one", "any"]
)
def test_a_uniform_field_lifts_nothing_at_any_current(axisymmetric, of):
    with pytest.raises(Infeasible) as caught:
        lift_current(of(axisymmetric((0.02, 0.0, 0.0, 0.0))), PAYLOAD, [0.001, 0, -0.0125], [1.0])
    assert "[1.0, 0.0, -12.5] mm" in caught.value.problems[0].where


@pytest.mark.parametrize(
    ("position", "shares", "first", "tolerance", "where"),
    [
        ([0, 0, 0.2], [1.0], 1.0, 1e-4, "lift_current(position)"),
        (POINT, [0.0], 1.0, 1e-4, "lift_current(shares)"),
        (POINT, [[1.0]], 1.0, 1e-4, "currents"),
        (POINT, [1.0, 1.0], 1.0, 1e-4, "currents"),
        (POINT, [1.0], 0.0, 1e-4, "lift_current(first)"),
        (POINT, [1.0], float("nan"), 1e-4, "lift_current(first)"),
        (POINT, [1.0], 1.0, 0.0, "lift_current(tolerance)"),
    ],
)
def test_bad_arguments(axisymmetric, position, shares, first, tolerance, where):
    with refused(InputError, where=where):
        lift_current(Law(axisymmetric(COEFFICIENTS), np.tanh), PAYLOAD, position, shares, first, tolerance)


def test_a_state_answers_for_its_own_currents_only(axisymmetric):
    field = as_field(Law(axisymmetric(COEFFICIENTS), np.tanh).state([2.0]))
    np.testing.assert_allclose(
        field.field([POINT], [2.0]), np.tanh(2.0) * axisymmetric(COEFFICIENTS).field([POINT], [1.0])
    )
    for question in (field.field, field.gradient, field.second_gradient):
        with refused(InputError, where="currents"):
            question([POINT], [2.1])


def test_the_equilibrium_of_a_state_is_where_its_lift_current_was_asked_for(axisymmetric):
    field = Law(axisymmetric(COEFFICIENTS), knee(0.5))
    lift = lift_current(field, PAYLOAD, [0, 0, 0.013], tolerance=1e-9)
    state = as_field(field.state(lift.currents), field.bounds)
    for found in (find_equilibrium(state, payload=PAYLOAD), find_equilibrium(field, lift.currents, PAYLOAD)):
        np.testing.assert_allclose(found.position, [0, 0, 0.013], atol=1e-7)
        np.testing.assert_array_equal(found.currents, lift.currents)


def test_a_current_beyond_the_field_says_how_far_it_came(axisymmetric):
    field = UpTo(axisymmetric(COEFFICIENTS), knee(0.5), 1.2 * NEEDED)
    with pytest.raises(OutsideMapError) as caught:
        lift_current(field, PAYLOAD, POINT, first=NEEDED)
    (problem,) = caught.value.problems
    assert problem.where.startswith("lift_current at [0.0, 0.0, 20.0] mm")
    # The lift is 0.6 + 0.5 (1 - 0.6) of the weight at the current that a straight law would need.
    assert f"0.8 at {NEEDED:.4g} A" in problem.received


@pytest.mark.parametrize(("weak", "lifts"), [(0.9e-3, False), (1.1e-3, True)], ids=["left out", "taken"])
def test_a_combination_a_thousand_times_weaker_than_the_largest_is_left_out(weak, lifts):
    """One coil pushes along x only, one along y, and one hardly lifts."""
    force = np.diag([1.0, 0.5, weak])
    np.testing.assert_allclose(push_shares(force, 0), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(push_shares(force, 1), [0, 1, 0], atol=1e-12)
    if lifts:
        np.testing.assert_allclose(lift_shares(force), [0, 0, 1], atol=1e-12)
    else:
        with refused(
            Infeasible, must_hold="along z", received=f"{[0.0, 0.0, weak]} N/A along it, of at most 1 N/A"
        ):
            lift_shares(force)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lift_may_push_sideways_and_a_signal_by_a_tenth_at_most(axis, sign):
    """One coil has a force of 1 along an axis and a along another. By least squares it takes 1 / (1 + a^2), which
    leaves a / (1 + a^2) along the other axis and a^2 / (1 + a^2) of the demand."""
    limit = 1.0 if axis == 2 else (1.0 - np.sqrt(0.96)) / 0.2
    for factor, holds in ((0.99, True), (1.01, False)):
        force = np.zeros((3, 1))
        force[axis], force[axis - 1] = 1.0, sign * factor * limit
        pushes, idle = signal_pushes(force)
        if axis == 2:
            if holds:
                assert lift_shares(force).tolist() == [1.0]
            else:
                with pytest.raises(Infeasible):
                    lift_shares(force)
        else:
            assert ("xy"[axis] in idle) is not holds
            assert pushes[0, axis] == (1.0 if holds else 0.0)


@pytest.mark.parametrize("currents", [[0.0], [-2.0]])
def test_force_per_ampere_about_currents_of_either_sign_and_none(axisymmetric, currents):
    """m (i + i^3 / 3)' = m (1 + i^2), by differences over 1 % of the largest current, or of 1 A at zero current."""
    field = Law(axisymmetric(COEFFICIENTS), lambda i: i + i**3 / 3.0)
    found = force_per_ampere(field, np.array([0.0, 0.0, 0.813]), np.array(POINT), np.array(currents))
    h = 0.01 * (abs(currents[0]) or 1.0)
    exact = PER_AMPERE * (1.0 + currents[0] ** 2 + h**2 / 3.0)
    np.testing.assert_allclose(found, [[0.0], [0.0], [exact]], rtol=1e-9, atol=1e-12)

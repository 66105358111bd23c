"""Lift current where the field is not proportional to the current, against closed forms of the current."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, InputError, NotConverged, OutsideMapError
from fieldmap.levitation import (
    DifferencedField,
    FixedCurrents,
    find_equilibrium,
    lift_current,
    lift_current_nonlinear,
)

PAYLOAD = Payload(mass=0.01119, moment=0.813)
WEIGHT = 0.01119 * 9.80665
COEFFICIENTS = (0.02, 0.03, 0.6, 0.0)
POINT = [0.0, 0.0, 0.02]
PER_AMPERE = 0.813 * (2 * 0.03 + 6 * 0.6 * 0.02)  # N/A: D (2 c2 + 6 c3 z)
NEEDED = WEIGHT / PER_AMPERE  # what an unsaturated field needs, A


class Laws:
    """Fields g(i) B_1(x): the shape of one ampere, a current that saturates, and a count of the states."""

    def __init__(self, shape, law):
        self.shape, self.law, self.states = shape, law, []

    def __call__(self, currents):
        current = np.asarray(currents, dtype=float)
        self.states.append(current[0])
        effective = np.array([self.law(current[0])])
        state = SimpleNamespace(
            coil_names=("only",),
            currents=current,
            field=lambda points: self.shape.field(points, effective),
            gradient=lambda points: self.shape.gradient(points, effective),
        )
        return DifferencedField(FixedCurrents(state), self.shape.lower, self.shape.upper)


def knee(slope):
    """g(i) = i up to the knee at 0.6 NEEDED, then a lower slope: its inverse is known."""
    corner = 0.6 * NEEDED
    return lambda i: i if i < corner else corner + slope * (i - corner)


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (lambda i: i, NEEDED),
        (knee(0.1), 0.6 * NEEDED + 0.4 * NEEDED / 0.1),
        (lambda i: 2 * NEEDED * np.tanh(i), np.arctanh(0.5)),
        (lambda i: NEEDED * i**3, 1.0),
        (lambda i: i - 0.3 * NEEDED, 1.3 * NEEDED),
    ],
    ids=["linear", "knee", "tanh", "cubic", "biased"],
)
@pytest.mark.parametrize("first", [0.5, 1.0, 3.0])
def test_the_inverse_of_the_law(axisymmetric, law, expected, first):
    solve_at = Laws(axisymmetric(COEFFICIENTS), law)
    lift = lift_current_nonlinear(solve_at, PAYLOAD, POINT, [1.0], first=first, tolerance=1e-6)
    assert lift.force[2] == pytest.approx(WEIGHT, rel=1e-6)
    assert lift.current == pytest.approx(expected, rel=1e-5)
    assert [current for current, _ in lift.history] == pytest.approx(solve_at.states)
    assert [newtons for _, newtons in lift.history] == pytest.approx(
        [PER_AMPERE * law(i) for i in solve_at.states]
    )


def test_a_linear_field_needs_three_states_at_most_and_agrees_with_the_linear_function(axisymmetric):
    shape = axisymmetric(COEFFICIENTS)
    solve_at = Laws(shape, lambda i: i)
    lift, linear = (
        lift_current_nonlinear(solve_at, PAYLOAD, POINT, [1.0]),
        lift_current(shape, PAYLOAD, POINT),
    )
    assert len(solve_at.states) <= 3
    assert lift.current == pytest.approx(linear.current, rel=1e-9)
    np.testing.assert_allclose(lift.force_per_ampere, linear.force_per_ampere, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(lift.field, linear.field, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(lift.stiffness, linear.stiffness, rtol=1e-5, atol=1e-7)


def test_force_per_ampere_is_the_slope_not_the_ratio(axisymmetric):
    solve_at = Laws(axisymmetric(COEFFICIENTS), knee(0.25))
    lift = lift_current_nonlinear(solve_at, PAYLOAD, POINT, [1.0], first=2.0 * NEEDED)
    assert lift.force_per_ampere[2] == pytest.approx(0.25 * PER_AMPERE, rel=1e-6)


def test_a_field_that_pulls_the_other_way_turns_the_moment(axisymmetric):
    solve_at = Laws(axisymmetric(COEFFICIENTS), lambda i: -2 * NEEDED * np.tanh(i))
    lift = lift_current_nonlinear(solve_at, PAYLOAD, POINT, [1.0], tolerance=1e-6)
    assert lift.current == pytest.approx(np.arctanh(0.5), rel=1e-5)
    assert lift.force[2] == pytest.approx(WEIGHT, rel=1e-6)


def test_every_state_is_told(axisymmetric):
    told = []
    solve_at = Laws(axisymmetric(COEFFICIENTS), knee(0.5))
    lift_current_nonlinear(
        solve_at, PAYLOAD, POINT, [1.0], on_state=lambda current, ratio: told.append((current, ratio))
    )
    assert [current for current, _ in told] == solve_at.states
    assert told[-1][1] == pytest.approx(1.0, abs=1e-4)


def test_lift_that_never_reaches_the_weight_ends(axisymmetric):
    solve_at = Laws(axisymmetric(COEFFICIENTS), lambda i: 0.9 * NEEDED * np.tanh(i))
    with pytest.raises(NotConverged, match=r"0\.9 at") as caught:
        lift_current_nonlinear(solve_at, PAYLOAD, POINT, [1.0])
    assert min(caught.value.residuals) == pytest.approx(0.1, abs=1e-6)


def test_a_uniform_field_lifts_nothing(axisymmetric):
    with pytest.raises(Infeasible):
        lift_current_nonlinear(Laws(axisymmetric((0.02, 0, 0, 0)), lambda i: i), PAYLOAD, [0, 0, 0], [1.0])


@pytest.mark.parametrize(
    ("position", "shares", "first", "tolerance", "error"),
    [
        ([0, 0, 0.2], [1.0], 1.0, 1e-4, OutsideMapError),
        (POINT, [0.0], 1.0, 1e-4, InputError),
        (POINT, [[1.0]], 1.0, 1e-4, InputError),
        (POINT, [1.0], 0.0, 1e-4, InputError),
        (POINT, [1.0], float("nan"), 1e-4, InputError),
        (POINT, [1.0], 1.0, 0.0, InputError),
    ],
)
def test_bad_arguments(axisymmetric, position, shares, first, tolerance, error):
    with pytest.raises(error, match="lift_current_nonlinear"):
        lift_current_nonlinear(
            Laws(axisymmetric(COEFFICIENTS), lambda i: i), PAYLOAD, position, shares, first, tolerance
        )


def test_a_state_answers_for_its_own_currents_only(axisymmetric):
    field = Laws(axisymmetric(COEFFICIENTS), np.tanh)([2.0])
    np.testing.assert_allclose(
        field.field([POINT], [2.0]), np.tanh(2.0) * axisymmetric(COEFFICIENTS).field([POINT], [1.0])
    )
    for question in (field.field, field.gradient):
        with pytest.raises(InputError, match="does not superpose"):
            question([POINT], [2.1])


def test_the_equilibrium_of_a_state_is_where_its_lift_current_was_asked_for(axisymmetric):
    solve_at = Laws(axisymmetric(COEFFICIENTS), knee(0.5))
    lift = lift_current_nonlinear(solve_at, PAYLOAD, [0, 0, 0.013], [1.0], tolerance=1e-9)
    found = find_equilibrium(solve_at(lift.currents), lift.currents, PAYLOAD)
    np.testing.assert_allclose(found.position, [0, 0, 0.013], atol=1e-7)

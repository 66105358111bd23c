import re
from dataclasses import replace
from functools import partial
from itertools import product
from types import SimpleNamespace

import magpylib
import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap.device.model import Payload
from fieldmap.errors import InputError, NoEquilibrium, OutsideMapError
from fieldmap.field import as_field
from fieldmap.levitation import find_equilibrium, magnet_balance
from fieldmap.levitation.equilibrium import _ranked, best_starts, largest_step
from fieldmap.levitation.places import check_position
from tests.levitation.conftest import slope_on_axis
from tests.refusals import refused

PAYLOAD = Payload(mass=0.01119, moment=0.813)
WEIGHT = 0.01119 * 9.80665


def test_closed_form_position_and_stiffness(axisymmetric):
    """phi = c2 (z^2 - r^2/2) + c3 (z^3 - 3 z r^2/2): F_z = I D (2 c2 + 6 c3 z), K = I D c3 diag(3, 3, -6)."""
    c2, c3, current = 0.03, 0.6, 1.5
    found = find_equilibrium(axisymmetric((0.02, c2, c3, 0.0)), [current], PAYLOAD)
    height = (WEIGHT / (current * PAYLOAD.moment) - 2 * c2) / (6 * c3)
    np.testing.assert_allclose(found.position, [0, 0, height], atol=1e-9)
    stiffness = current * PAYLOAD.moment * c3 * np.diag([3, 3, -6])
    np.testing.assert_allclose(found.stiffness, stiffness, rtol=1e-9, atol=1e-12)
    assert found.stable.tolist() == [False, True, True]
    assert found.stable_axes == {"x": True, "y": True, "z": False}
    assert np.linalg.norm(found.force_residual) < 1e-8 * WEIGHT
    assert abs(found.trace) < 1e-9 * np.linalg.norm(found.stiffness)
    np.testing.assert_allclose(found.moment, [0, 0, PAYLOAD.moment])


def test_a_gradient_that_falls_upward_is_stable_along_z_only(axisymmetric):
    found = find_equilibrium(axisymmetric((0.02, 0.06, -0.2, 0.0)), [1.5], PAYLOAD)
    assert found.stable_axes == {"x": False, "y": False, "z": True}
    assert found.stable.tolist() == [False, False, True]
    np.testing.assert_allclose(np.abs(found.directions[:, 2]), [0, 0, 1], atol=1e-9)


def test_reversed_currents_hold_a_magnet_that_points_the_other_way(axisymmetric):
    """The magnet does not turn: currents that push it down are refused; the remedy names payload.direction."""
    source, below = axisymmetric((0.02, 0.03, 0.08, 0.0)), replace(PAYLOAD, direction="down")
    up, down = find_equilibrium(source, [1.5], PAYLOAD), find_equilibrium(source, [-1.5], below)
    np.testing.assert_allclose(down.position, up.position, atol=1e-12)
    np.testing.assert_allclose(up.moment, [0, 0, PAYLOAD.moment])
    np.testing.assert_allclose(down.moment, -up.moment)
    assert (up.held, down.held) == ("moment up, fixed", "moment down, fixed")
    assert up.angle_to_field == pytest.approx(0.0, abs=1e-5)
    for current, payload in ((-1.5, PAYLOAD), (1.5, below)):
        with refused(NoEquilibrium, remedy="payload.direction"):
            find_equilibrium(source, [current], payload)


def test_a_payload_that_may_turn_follows_the_field(axisymmetric):
    """Like moment="aligned" of any payload; if the field points against the stated direction, the result says so."""
    source, free = axisymmetric((0.02, 0.03, 0.6, 0.0)), replace(PAYLOAD, turning="free")
    found = find_equilibrium(source, [1.5], free)
    asked = find_equilibrium(source, [1.5], PAYLOAD, moment="aligned")
    np.testing.assert_allclose(found.position, asked.position, atol=1e-12)
    assert found.held == asked.held == "moment up, free to turn"
    assert not any("turned over" in words for words in found.assumptions)
    over = find_equilibrium(source, [-1.5], free)
    np.testing.assert_allclose(over.moment, -found.moment, atol=1e-12)
    assert over.held == "moment down, free to turn"
    assert any("turned over" in words for words in over.assumptions)
    held = find_equilibrium(source, [1.5], replace(PAYLOAD, turning="fixed"))
    np.testing.assert_array_equal(held.position, find_equilibrium(source, [1.5], PAYLOAD).position)


def test_of_two_equilibria_the_one_near_the_start_is_taken(axisymmetric):
    """phi = c4 z^4 + ...: F_z = 12 I D c4 z^2, balanced at +-z0; stable sideways above, upward below."""
    c4, current = 5.0, 1.0
    source = axisymmetric((0.0, 0.0, 0.0, c4))
    height = np.sqrt(WEIGHT / (12 * current * PAYLOAD.moment * c4))
    assert height < 0.1
    for side in (1.0, -1.0):
        found = find_equilibrium(source, [current], PAYLOAD, start=[1e-3, 0, side * 0.9 * height])
        np.testing.assert_allclose(found.position, [0, 0, side * height], atol=1e-9)
    whole = find_equilibrium(source, [current], PAYLOAD)
    np.testing.assert_allclose(whole.position, [0, 0, height], atol=1e-9)  # two stable directions against one
    assert any(np.allclose(other, [0, 0, -height], atol=1e-7) for other in whole.others)


def test_an_aligned_moment_follows_the_field(axisymmetric):
    source = axisymmetric((0.02, 0.03, 0.6, 0.0))
    source.potentials[0, 1, 0, 0] += 0.004  # a uniform sideways field tilts the magnet
    found = find_equilibrium(source, [1.5], PAYLOAD, moment="aligned")
    assert found.angle_to_field < 1e-5
    assert found.moment[0] > 0.05 * PAYLOAD.moment
    assert found.trace < 0.0
    # The force balance by |B| only.
    h = 1e-5
    ahead, behind = (
        np.linalg.norm(source.field(found.position + s * h * np.eye(3), [1.5]), axis=1) for s in (1, -1)
    )
    force = PAYLOAD.moment * (ahead - behind) / (2 * h)
    np.testing.assert_allclose(force, [0, 0, WEIGHT], atol=1e-6 * WEIGHT)


class Loop:
    """20 turns of 44 mm radius in the plane z = 0 through magpylib; gradient by fourth-order differences."""

    coil_names = ("loop",)

    def field(self, points, currents):
        loop = magpylib.current.Circle(current=20 * currents[0], diameter=0.088)
        return loop.getB(np.atleast_2d(points)).reshape(-1, 3)

    def gradient(self, points, currents):
        h, shares = 5e-4, {1: 8, -1: -8, 2: -1, -2: 1}
        columns = [
            sum(share * self.field(points + k * h * e, currents) for k, share in shares.items()) / (12 * h)
            for e in np.eye(3)
        ]
        return np.stack(columns, axis=-1)


def test_on_the_axis_of_a_loop():
    """The root of D d/dz [mu0 I R^2 / 2 (R^2 + z^2)^1.5] = m g below the loop, found by bisection."""
    current = 150.0
    slope = partial(slope_on_axis, radius=0.044, turns=20 * current)
    height = brentq(lambda z: PAYLOAD.moment * slope(z) - WEIGHT, -0.2, -0.03, xtol=1e-14)
    source = as_field(Loop(), ([-0.01, -0.01, -0.2], [0.01, 0.01, -0.03]))
    found = find_equilibrium(source, [current], PAYLOAD)
    np.testing.assert_allclose(found.position, [0, 0, height], atol=1e-7)
    second = (slope(height + 1e-6) - slope(height - 1e-6)) / 2e-6
    stiffness = PAYLOAD.moment * second * np.diag([0.5, 0.5, -1])
    np.testing.assert_allclose(found.stiffness, stiffness, rtol=1e-5, atol=1e-5)
    assert found.stable_axes == {"x": True, "y": True, "z": False}


def test_too_little_current_says_how_much_is_missing(axisymmetric):
    source = axisymmetric((0.02, 0.03, 0.1, 0.1))
    # dBz/dz = 2 c2 + 6 c3 z + c4 (12 z^2 - 6 r^2), largest on the axis at the upper face
    most = 0.5 * PAYLOAD.moment * (2 * 0.03 + 6 * 0.1 * 0.1 + 12 * 0.1 * 0.1**2)
    with pytest.raises(NoEquilibrium) as caught:
        find_equilibrium(source, [0.5], PAYLOAD)
    problem = caught.value.problems[0]
    # The least force is on an edge, where c4 (12 z^2 - 6 r^2) has r^2 = 2 (20 mm)^2, at one of 15 heights.
    r2 = 2 * 0.02**2
    slopes = {z: 0.06 + 0.6 * z + 1.2 * z**2 for z in np.linspace(-0.1, 0.1, 15)}
    low = min(slopes, key=slopes.get)
    least = 0.5 * PAYLOAD.moment * (slopes[low] - 0.6 * r2)
    told = [float(number) for number in re.findall(r"-?[\d.]+(?:e-?\d+)?", problem.received)]
    off = 1e3 * (WEIGHT - most)
    corner, place = [-20.0, -20.0, 1e3 * low], [0.0, 0.0, 100.0]
    expected = [1e3 * least, *corner, 1e3 * most, *place, off, *place]
    np.testing.assert_allclose(told, expected, rtol=5e-3, atol=0.05)
    np.testing.assert_allclose(np.array(told)[[0, 4]], np.array(expected)[[0, 4]], rtol=5e-4)
    assert problem.where == (
        "find_equilibrium, 8 starts in the box (-20.0, -20.0, -100.0) mm to (20.0, 20.0, 100.0) mm"
    )
    assert f"{1e3 * WEIGHT:.4g} mN" in problem.must_hold
    assert f"{WEIGHT / most:.3g} times" in problem.remedy
    assert caught.value.exit_code == 1


@pytest.mark.parametrize(("current", "remedy"), [(5.0, "lower"), (0.0, "turn the currents on")])
def test_too_much_current_and_no_current(axisymmetric, current, remedy):
    with refused(NoEquilibrium, remedy=remedy):
        find_equilibrium(axisymmetric((0.02, 0.5, 0.1, 0.0)), [current], PAYLOAD)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"currents": [1.0, 2.0]}, InputError),
        ({"currents": [np.nan]}, InputError),
        ({"start": [0, 0, 0.5]}, OutsideMapError),
        ({"start": [0, 0]}, InputError),
        ({"payload": None}, InputError),
        ({"payload": Payload(mass=0.0, moment=-1.0)}, InputError),
        ({"moment": "free"}, InputError),
    ],
)
def test_bad_input(axisymmetric, change, error):
    arguments = {"currents": [1.5], "payload": PAYLOAD} | change
    with pytest.raises(error) as caught:
        find_equilibrium(axisymmetric((0.02, 0.03, 0.6, 0.0)), **arguments)
    assert caught.value.exit_code == 2
    assert all(p.where and p.must_hold and p.received and p.remedy for p in caught.value.problems)


@pytest.mark.parametrize("middle", [0.0, 0.3])
def test_a_position_may_leave_the_box_by_rounding_only(middle):
    """A position may be outside by a share of 1e-12 of the box, at any place of the box; it is moved onto the wall."""
    lower, upper = (middle + side * np.array([0.02, 0.03, 0.05]) for side in (-1, 1))
    for corner, rounding in ((upper, 5e-14), (lower, -5e-14)):
        at_the_wall = check_position((lower, upper), corner + [rounding, 0.0, 0.0], "here")
        np.testing.assert_array_equal(at_the_wall, corner)
        with pytest.raises(OutsideMapError):
            check_position((lower, upper), corner + [20 * rounding, 0.0, 0.0], "here")
    with pytest.raises(OutsideMapError) as caught:
        check_position((lower, upper), middle + np.array([0.0, 0.0, 0.0625]), "here")
    (told,), z = caught.value.problems, 1e3 * middle
    assert (told.where, told.received) == ("here", f"({z:g}, {z:g}, {z + 62.5:g}) mm")
    box = f"({z - 20:g}, {z - 30:g}, {z - 50:g}) to ({z + 20:g}, {z + 30:g}, {z + 50:g}) mm"
    assert box in told.must_hold


class Counted:
    """A field with a box that counts the places of its gradient evaluations. Its second gradient has an antisymmetric
    part of `skew` T/m^2 in x and y, which no real field has."""

    def __init__(self, source, skew=0.0):
        self.source, self.skew, self.asked = source, skew, 0
        self.coil_names, self.lower, self.upper = source.coil_names, source.lower, source.upper

    def field(self, points, currents):
        return self.source.field(points, currents)

    def gradient(self, points, currents):
        self.asked += len(points)
        return self.source.gradient(points, currents)

    def second_gradient(self, points, currents):
        whole = self.source.second_gradient(points, currents).copy()
        whole[:, 2, 0, 1] += self.skew
        whole[:, 2, 1, 0] -= self.skew
        return whole


def test_a_search_reports_what_it_did(axisymmetric):
    c2, c3, current, skew = 0.03, 0.6, 1.5, 0.4
    field = Counted(axisymmetric((0.02, c2, c3, 0.0)), skew)
    found = find_equilibrium(field, [current], PAYLOAD, start=[0.001, 0.002, 0.01])
    report, k = found.report, current * PAYLOAD.moment * c3
    assert (report.starts, report.converged) == (1, 1)
    # The stiffness takes no evaluation of the gradient.
    assert report.evaluations == field.asked
    assert report.relative_residual == pytest.approx(np.linalg.norm(found.force_residual) / WEIGHT, rel=1e-9)
    stiffness = k * np.diag([3.0, 3.0, -6.0])
    stiffness[[0, 1], [1, 0]] = PAYLOAD.moment * skew * np.array([-1.0, 1.0])
    np.testing.assert_allclose(found.stiffness, stiffness, rtol=1e-9, atol=1e-12)
    part = PAYLOAD.moment * skew * np.sqrt(2.0)
    assert report.stiffness_asymmetry == pytest.approx(part / np.hypot(k * np.sqrt(54.0), part), rel=1e-9)
    np.testing.assert_allclose(found.eigenvalues, k * np.array([-6.0, 3.0, 3.0]), rtol=1e-9)
    np.testing.assert_array_equal([report.lower, report.upper], [field.lower, field.upper])


def test_starts_are_the_places_of_least_force_a_fifth_of_the_box_apart():
    box = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 4.0, 3.0])
    line = 0.5 + 0.0105 * np.arange(-47, 48)
    grid = box[0] + line[:, None] * (box[1] - box[0])
    unbalance = np.abs(line - 0.499)
    # From the middle outward, each start farther than 0.2 from all others.
    wanted = [0.5, 0.29, 0.71, 0.08, 0.92]
    found = best_starts(grid, unbalance, box)
    np.testing.assert_allclose(found, box[0] + np.array(wanted)[:, None] * (box[1] - box[0]))
    # Starts may be apart along one side only; there are at most eight.
    corners = np.array(list(product((-1.0, 0.0, 1.0), (0.0, 4.0), (2.0, 3.0))))
    np.testing.assert_array_equal(best_starts(corners, np.arange(12.0), box), corners[:8])


def test_the_largest_step_of_a_force_is_that_of_the_gradient_times_the_moment_over_the_weight():
    source = SimpleNamespace(gradient_jump=lambda currents: 3e-3 * currents[0])
    balance = SimpleNamespace(magnitude=0.8, source=source, currents=[0.5], weight=0.1)
    assert largest_step(balance) == pytest.approx(0.012)


def test_an_aligned_moment_has_no_direction_where_there_is_no_field(axisymmetric):
    """B = 2 c2 (-x / 2, -y / 2, z) and the force vanish at the origin."""
    source = as_field(axisymmetric((0.0, 0.3, 0.0)))
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.01], [0.01, 0.0, 0.0]])
    balance = magnet_balance(source, np.array([2.0]), PAYLOAD, None, "aligned")
    moments = PAYLOAD.moment * np.array([[0.0, 0, 0], [0, 0, -1], [-1, 0, 0]])
    np.testing.assert_allclose(balance.moments(points), moments, atol=1e-15)
    force = 2.0 * PAYLOAD.moment * 0.6 * np.array([[0, 0, 0], [0, 0, -1], [0.5, 0, 0]])
    np.testing.assert_allclose(balance.magnetic_force(points), force, atol=1e-15)


def test_places_are_ranked_by_their_distance_from_the_middle_of_the_box():
    box = np.array([0.01, -0.02, -0.1]), np.array([0.03, 0.0, -0.05])
    balance = SimpleNamespace(residual_stiffness=lambda _: -np.eye(3))
    near, far = np.array([0.021, -0.012, -0.09]), np.array([0.012, -0.008, -0.07])
    for found in ([near, far], [far, near]):
        assert [tuple(x) for x in _ranked(balance, box, found, None)] == [tuple(near), tuple(far)]
        assert [tuple(x) for x in _ranked(balance, box, found, far + 1e-3)] == [tuple(far), tuple(near)]

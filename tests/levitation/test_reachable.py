"""Reachable sets against random currents, all corners of the box, closed forms of volumes, and a magnet's force."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fieldmap.device.model import Payload
from fieldmap.errors import InputError
from fieldmap.levitation import ReachableSet, reachable, zonotope
from fieldmap.lookup import magnetic_body, open_map
from tests.refusals import refused

RANDOM = np.random.default_rng(5)


def corners_by_brute_force(directions, lower, upper):
    """The hull of the images of all 2^n corners."""
    images = np.array(list(product(*zip(lower, upper, strict=True)))) @ directions
    return images[ConvexHull(images).vertices], ConvexHull(images).volume


def same_points(one, other, tolerance):
    distance = np.linalg.norm(one[:, None] - other[None], axis=2)
    assert len(one) == len(other)
    assert max(distance.min(axis=1).max(), distance.min(axis=0).max()) < tolerance


@pytest.mark.parametrize("count", [3, 4, 6, 9])
def test_corners_are_those_of_all_corners_of_the_box(count):
    directions = RANDOM.normal(size=(count, 3))
    lower, upper = -RANDOM.random(count), RANDOM.random(count)
    corners, triangles, volume = zonotope(directions, lower, upper)
    expected, hull = corners_by_brute_force(directions, lower, upper)
    same_points(corners, expected, 1e-9)
    assert volume == pytest.approx(hull, rel=1e-9)
    # n (n - 1) parallelograms, two triangles each, and Euler's formula.
    assert len(triangles) == 2 * count * (count - 1)
    assert len(corners) == count * (count - 1) + 2
    # Shephard: the volume is the sum of the determinants of all triples.
    threes = np.array(list(combinations(directions * (upper - lower)[:, None], 3)))
    assert volume == pytest.approx(np.abs(np.linalg.det(threes)).sum(), rel=1e-9)


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_triangles_face_outward(size):
    corners, triangles, volume = zonotope(size * RANDOM.normal(size=(5, 3)), -np.ones(5), np.ones(5))
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    assert np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0 == pytest.approx(volume, rel=1e-9)
    assert (np.einsum("ti,ti->t", a, np.cross(b - a, c - a)) > 0).all()


@pytest.mark.parametrize("size", [1e-3, 1e3])
@pytest.mark.parametrize("count", [3, 6])
def test_many_directions_in_one_plane(count, size):
    """Hexagonal prisms, in any unit: three or six coils on a circle pull within a plane, one coil along its axis."""
    angle = np.arange(count) * np.pi / 3
    plane = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    directions, ends = size * np.vstack([plane, [0, 0, 2.0]]), np.ones(count + 1)
    corners, _, volume = zonotope(directions, -ends, ends)
    expected, hull = corners_by_brute_force(directions, -ends, ends)
    # Regular hexagon of side 2 or 4, height 4.
    assert volume == pytest.approx(1.5 * np.sqrt(3) * (2 * count / 3) ** 2 * 4.0 * size**3)
    assert volume == pytest.approx(hull)
    same_points(corners, expected, 1e-9 * size)


def test_flat_sets_have_no_volume():
    line = zonotope([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0]], [-1, -1], [1, 1])
    assert line[2] == 0.0
    assert np.abs(np.linalg.norm(line[0], axis=1) - 3 * np.sqrt(5)).max() < 1e-12
    flat = zonotope([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]], -np.ones(3), np.ones(3))
    assert flat[2] == 0.0
    assert flat[0].max() == 2.0
    assert not len(flat[1])
    # The corners of a hexagon; then a set without freedom is a point.
    assert len(flat[0]) == 6
    point = zonotope([[1.0, 2.0, 3.0], [0.5, 0.0, 1.0]], [1.0, 2.0], [1.0, 2.0])
    assert (point[0].tolist(), point[2]) == ([[2.0, 2.0, 5.0]], 0.0)


@pytest.mark.parametrize(("thickness", "flat"), [(3e-10, True), (3e-9, False)])
def test_a_set_thinner_than_a_billionth_of_its_length_is_flat(thickness, flat):
    """A box of 2 by 2 by about 1e-9: the thickness over the length of 2 equals the ratio of singular values."""
    volume = zonotope(np.diag([1.0, 1.0, thickness]), -np.ones(3), np.ones(3))[2]
    assert volume == pytest.approx(0.0 if flat else 8.0 * thickness, rel=1e-6)


PER_AMPERE = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])


@pytest.fixture
def three_of_one_volt():
    """Three coils of fields PER_AMPERE, and a constant field."""
    lower, upper, constant = (
        np.array([-1.0, 1.0, -3.0]),
        np.array([2.0, 2.0, -1.0]),
        np.array([5.0, 6.0, 7.0]),
    )
    corners, triangles, volume = zonotope(PER_AMPERE, lower, upper)
    place = {"position": np.zeros(3), "moment": None, "coil_names": ("a", "b", "c")}
    limits = {"lower": lower, "upper": upper, "constant": constant, "per_ampere": PER_AMPERE}
    shape = {"vertices": corners + constant, "triangles": triangles, "volume": volume}
    return ReachableSet(quantity="field", **place, **limits, **shape)


@pytest.mark.parametrize(
    ("direction", "currents"),
    [((0, 0, 1), [2, 1, -1]), ((0, 0, -4), [-1, 1, -3]), ((0, 3, 0), [0, 2, -1]), ((0, -1, 0), [0, 1, -1])],
)
def test_coils_that_do_not_matter_carry_as_little_as_they_may(three_of_one_volt, direction, currents):
    found = three_of_one_volt.currents_along(direction)
    np.testing.assert_array_equal(found, currents)
    value = np.array(currents) @ PER_AMPERE + [5.0, 6.0, 7.0]
    np.testing.assert_array_equal(three_of_one_volt.at(found), value)
    unit = np.array(direction) / np.linalg.norm(direction)
    assert three_of_one_volt.largest_along(direction) == pytest.approx(value @ unit)


@pytest.mark.parametrize(("off", "inside"), [(0.9e-9, True), (1.1e-9, False)])
def test_what_is_outside_by_rounding_is_inside(three_of_one_volt, off, inside):
    """The tolerance is a billionth of the longest side, which is 0.5 (3) + 2 (2) along z."""
    top = three_of_one_volt.at([0.0, 2.0, -2.0])
    assert three_of_one_volt.holds([top, top + [0.0, 5.5 * off, 0.0]]).tolist() == [True, inside]
    with refused(InputError, where="ReachableSet.holds"):
        replace(three_of_one_volt, triangles=np.empty((0, 3), int)).holds(top)


@pytest.fixture(scope="module")
def coils(six_coils):
    return open_map(six_coils)


@pytest.mark.parametrize("moment", [None, (0.1, 0.2, 0.8)])
def test_random_currents_are_inside_and_ends_are_reached(coils, moment):
    place = np.array([0.004, -0.003, -0.09])
    limits = np.linspace(1.0, 2.0, len(coils.coil_names))
    found = reachable(coils, place, limits, moment)
    currents = RANDOM.uniform(-1.0, 1.0, size=(200, len(limits))) * limits

    def by_hand(amperes):
        if moment is None:
            return coils.field(place[None], amperes)[0]
        ahead, behind = (coils.field(place + s * 1e-6 * np.eye(3), amperes) for s in (1, -1))
        return (ahead - behind) @ moment / 2e-6

    values = np.array([by_hand(row) for row in currents])
    assert found.unit == ("T" if moment is None else "N")
    np.testing.assert_allclose(found.at(currents), values, atol=1e-6 * np.abs(values).max())
    assert found.holds(found.at(currents)).all()
    assert not found.holds(1.001 * found.vertices).any()
    assert found.holds(0.999 * found.vertices).all()
    for direction in RANDOM.normal(size=(20, 3)):
        unit = direction / np.linalg.norm(direction)
        furthest = (found.vertices @ unit).max()
        assert found.largest_along(direction) == pytest.approx(furthest, rel=1e-9)
        assert found.at(found.currents_along(unit)) @ unit == pytest.approx(furthest, rel=1e-9)


def test_limits_of_one_sign(coils):
    count = len(coils.coil_names)
    found = reachable(coils, (0.0, 0.0, -0.09), [np.zeros(count), np.full(count, 2.0)], (0.0, 0.0, 0.8))
    assert (found.currents_along((0, 0, 1)) >= 0).all()
    both = reachable(coils, (0.0, 0.0, -0.09), 2.0, (0.0, 0.0, 0.8))
    assert both.volume == pytest.approx(8 * found.volume, rel=1e-9)


def test_one_coil_may_be_held(coils):
    count = len(coils.coil_names)
    ends = np.ones((2, count)) * [[-1.0], [2.0]]
    ends[0, 1] = 2.0
    found = reachable(coils, (0.0, 0.0, -0.09), ends)
    assert found.currents_along((0, 0, -1))[1] == found.currents_along((0, 0, 1))[1] == 2.0
    np.testing.assert_array_equal([found.lower, found.upper], ends)


@pytest.mark.parametrize(
    "limits",
    [-1.0, 0.0, [1.0, 2.0], np.nan, [[-1.0] * 5 + [3.0], [2.0] * 6], np.ones((3, 6)), np.ones((2, 5))],
)
def test_wrong_limits(coils, limits):
    with pytest.raises(InputError, match="limits"):
        reachable(coils, (0.0, 0.0, -0.09), limits)


def test_a_payload_in_the_place_of_a_moment(coils):
    """Every function that takes a moment names the conversion as its remedy."""
    at, payload = np.array([0.0, 0.0, -0.09]), Payload(mass=1e-3, moment=0.8)
    asked = (
        lambda: reachable(coils, at, 1.0, payload),
        lambda: coils.currents_for(at, force=[0.0, 0.0, 0.01], moment=payload),
        lambda: coils.wrench(at, payload, 1.0),
        lambda: coils.actuation(at, 1.0, payload),
    )
    for ask in asked:
        with refused(InputError, remedy="magnetic_body(payload)"):
            ask()
    # The remedy works.
    assert coils.wrench(at, magnetic_body(payload), 1.0)[2] == pytest.approx(
        coils.wrench(at, [0, 0, 0.8], 1.0)[2]
    )

"""Plants computed from the unit's field, compared with the identified plants."""

from types import SimpleNamespace

import numpy as np
import pytest

from fieldmap.control import continuous
from fieldmap.currents import divide_currents
from fieldmap.thesis import map_plants
from fieldmap.thesis.computation import function_of
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.vertical_sensor import magnet_height


def ours(part):
    return function_of(part)(read_part(part).inputs).numbers


@pytest.fixture(scope="module")
def vertical():
    return ours("S16_map_plant")


@pytest.fixture(scope="module")
def horizontal():
    return ours("S17_map_plant")


def test_what_is_called_identified_follows_from_the_printed_models():
    """(6-6), (6-7) in continuous time: their constant terms are the products of the poles."""
    inputs = read_part("S17_arithmetic").inputs
    for axis, number in zip("xy", read_part("S17_map_plant").numbers["product"], strict=True):
        model = inputs[f"{axis}_second_order"]
        denominator = continuous((model[:1], model[1:]), inputs["Ts_s"]).denominator
        assert denominator[2] / denominator[0] == pytest.approx(number.value, abs=number.half_unit)


def test_the_three_products_add_up_to_zero(vertical, horizontal):
    """Earnshaw, for both kinds of iron; map and difference steps leave 1e-3."""
    third = list(read_part("S16_map_plant").inputs["offsets_mm"]).index(15.0)
    for name, product in (
        ("product", vertical["product"][third]),
        ("product_saturating", vertical["product_saturating"]),
    ):
        assert abs(np.sum(horizontal[name]) + product) < 1e-3 * abs(product)


def test_depth_falls_with_current_and_the_axis_is_unstable(vertical):
    assert vertical["sign_of_gain"] == [-1.0, -1.0]
    assert all(-248.3 * 1.3 < p < -248.3 * 0.6 for p in vertical["product"])


def test_horizontal_axes_are_stable_and_overdamped_by_the_identified_pole(horizontal):
    for name in ("", "_saturating"):
        damping, product = horizontal[f"damping{name}"], horizontal[f"product{name}"]
        assert np.all(np.square(damping) > 4 * np.asarray(product))
        np.testing.assert_allclose(damping, 44.94, rtol=0.1)


def test_signals_move_the_magnet_the_right_way(horizontal):
    for name in ("position", "position_saturating", "position_1_558_A"):
        assert min(horizontal[name]) > 0
    # As saturated as the rig: within a factor of two of the measured 1 mm, unlike linear iron.
    assert all(0.5 < x < 2 for x in horizontal["position_1_558_A"])
    assert all(x > 2 for x in horizontal["position"])


def test_volts_per_millimetre_of_depth_are_those_of_the_lift_currents():
    """The linear plant's slope against lift currents of its field half a millimetre above and below."""
    inputs = read_part("S16_map_plant").inputs
    depth, h, n = inputs["depth_mm"], inputs["offset_mm"], inputs["n"]
    plant = map_plants._linear_plant(depth, h, n)
    field = map_plants._linear_map(magnet_height(depth, 0.028), magnet_height(depth, 0.004))
    carried = map_plants.read_device("drive_unit").payload
    currents = []
    for way in (-0.5, 0.5):
        point = np.array([[0.0, 0.0, magnet_height(depth + way, 1e-3 * h)]])
        force = carried.moment * field.gradient(point, np.ones(6))[0, 2, 2]
        currents.append(carried.mass * 9.80665 / force)
    volts = np.diff(currents)[0] / inputs["amplifier_A_per_V"]
    assert map_plants._volts_per_mm(plant, inputs["amplifier_A_per_V"]) == pytest.approx(volts, rel=2e-3)


class Plant:
    """A plant whose pole products and stiffness are proportional to k."""

    def __init__(self, k):
        self.pole_products = k * np.array([10.0, 20.0, -300.0])
        self.stiffness = k * np.diag([3.0, 5.0, -70.0])
        self.force_per_signal = np.array([[9.0, 0.2 * k, 9.0], [9.0, 9.0, 0.5], [0.7, 9.0, 9.0]])
        self.imbalance = np.array([9.0, 9.0, 0.1 * k])

    def axis(self, name):
        return SimpleNamespace(B=np.array([[9.0], [{"z": 0.3}[name]]]))

    def damping_for_pole(self, axis, pole):
        return pole * {"x": 1.0, "y": 10.0}[axis]


@pytest.fixture
def plants(monkeypatch):
    asked = []

    def linear(depth, h, n):
        asked.append((depth, h, n))
        return Plant(1.0 + h / 100)

    def saturating(depth, h, n, steps, current=None):
        asked.append((depth, h, n, steps, current))
        return Plant(2.0 if current is None else current)

    monkeypatch.setattr(map_plants, "_linear_plant", linear)
    monkeypatch.setattr(map_plants, "_saturating_plant", saturating)
    return asked


ASKED = {"depth_mm": 11.0, "offset_mm": 20.0, "n": 1.5, "x_signal": 0.06, "y_signal": 0.08}


def test_numbers_of_the_vertical_plant(plants):
    inputs = ASKED | {"offsets_mm": np.array([5.0, 25.0]), "amplifier_A_per_V": 0.4}
    answers = map_plants.vertical(inputs)
    assert plants == [(11.0, h, 1.5) for h in (5.0, 25.0, 20.0)] + [(11.0, 20.0, 1.5, (0.06, 0.08), None)]
    numbers = answers.numbers
    assert numbers["product"] == pytest.approx([-315.0, -375.0])
    assert numbers["product_saturating"] == pytest.approx(-600.0)
    assert numbers["sign_of_gain"] == [-1.0, -1.0]
    # K dz = f di: 70 k N/m over 0.7 N/A are 100 k A/m, or 0.1 k A/mm, or 0.25 k V/mm.
    assert (numbers["slope"], numbers["slope_saturating"]) == pytest.approx((0.3, 0.5))
    assert answers.facts["saturating_lift"] == pytest.approx(1.2)
    assert answers.facts["refinement"] == 0.4


def test_numbers_of_the_horizontal_plants(plants):
    """Poles of the first-order models: ln(0.99) and ln(0.98) over 2 ms."""
    inputs = ASKED | {"measured_current_A": 4.0, "Ts_s": 2e-3}
    inputs |= {"x_first_order": np.array([0.06, 1.0, -0.99]), "y_first_order": np.array([0.05, 1.0, -0.98])}
    answers = map_plants.horizontal(inputs)
    steps = (0.06, 0.08)
    assert plants == [(11.0, 20.0, 1.5), (11.0, 20.0, 1.5, steps, None), (11.0, 20.0, 1.5, steps, 4.0)]
    numbers = answers.numbers
    assert numbers["product"] == pytest.approx([12.0, 24.0])
    assert numbers["product_saturating"] == pytest.approx([20.0, 40.0])
    damping = [np.log(0.99) / 2e-3, 10 * np.log(0.98) / 2e-3]
    for name in ("damping", "damping_saturating"):
        assert numbers[name] == pytest.approx(damping)
    # A force of 0.2 k N per unit over 3 k N/m along x, and 0.5 N over 5 k N/m along y.
    for name, k in (("position", 1.2), ("position_saturating", 2.0), ("position_1_558_A", 4.0)):
        assert numbers[name] == pytest.approx([0.06 * 200 / 3, 0.08 * 100 / k])
    assert (answers.facts["saturating_lift"], answers.facts["measured_lift"]) == pytest.approx((1.2, 1.4))


def test_plants_are_taken_at_the_lift_current_or_the_one_that_is_asked_for(monkeypatch):
    """At 10 mm and h = 15 mm, with equal currents and (6-3) with n = 1.25."""
    made = []

    def plant(field, payload, point, currents, signals, signal_steps):
        np.testing.assert_allclose(point, [0.0, 0.0, -0.102])
        level = currents[0]
        np.testing.assert_allclose(currents, np.full(6, level))
        # Slopes by u, x and y about level, 0, 0.
        for k, (x, y) in enumerate(((1e-6, 0.0), (0.0, 1e-6)), 1):
            ahead = (divide_currents(level, x, y, 1.25) - np.full(6, level)) / 1e-6
            np.testing.assert_allclose(signals[:, k], ahead, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(signals[:, 0], np.ones(6))
        made.append((field.coil_names, payload.moment, level, signal_steps))
        return made[-1]

    monkeypatch.setattr(map_plants, "plant_from_map", plant)
    known = {"linear": 2.5, "states": 4.5}

    def lift_current(field, payload, point, first=1.0):
        assert point[2] == pytest.approx(-0.102)
        return SimpleNamespace(current=known[field.name])

    def field(name):
        return SimpleNamespace(name=name, coil_names=tuple("123456"))

    def linear_map(lower, upper):
        assert (lower, upper) == (pytest.approx(-0.115), pytest.approx(-0.091))
        return field("linear")

    monkeypatch.setattr(map_plants, "lift_current", lift_current)
    monkeypatch.setattr(map_plants, "_linear_map", linear_map)
    monkeypatch.setattr(map_plants, "_states", lambda *at: field("states") if at == (10.0, 15.0) else None)
    linear = map_plants._linear_plant.__wrapped__(10.0, 15.0, 1.25)
    saturating = map_plants._saturating_plant.__wrapped__
    lifted, given = (saturating(10.0, 15.0, 1.25, (0.06, 0.1), current) for current in (None, 1.5))
    assert [one[2:] for one in (linear, lifted, given)] == [
        (2.5, None), (4.5, [0.02, 0.06, 0.1]), (1.5, [0.02, 0.06, 0.1]),
    ]  # fmt: skip


def test_the_linear_map_is_the_field_of_the_unit(monkeypatch):
    """Nodes at most 3 mm apart, 6 mm to both sides of the axis; the map is exact for a uniform gradient."""
    slope = np.array([[1.0, 2.0, 3.0], [2.0, -5.0, 4.0], [3.0, 4.0, 4.0]])
    nodes = []

    def unit_fields(points):
        nodes.append(points)
        return (points @ slope)[None], np.broadcast_to(slope, (1, len(points), 3, 3))

    def solve(device, refinement):
        assert (device.title, refinement) == (map_plants.read_device("drive_unit").title, 0.4)
        return SimpleNamespace(coil_names=("1",), unit_fields=unit_fields)

    monkeypatch.setattr(map_plants, "solve_linear", solve)
    field = map_plants._linear_map.__wrapped__(-0.115, -0.0915)
    points = np.array([[5e-3, -6e-3, -0.0916], [0.0, 1e-3, -0.1149]])
    np.testing.assert_allclose(field.field(points, [2.0]), 2 * points @ slope, rtol=1e-9)
    np.testing.assert_allclose(field.gradient(points, [2.0]), 2 * np.tile(slope, (2, 1, 1)), rtol=1e-9)
    (at,) = nodes
    np.testing.assert_allclose(
        [at.min(axis=0), at.max(axis=0)], [[-6e-3, -6e-3, -0.115], [6e-3, 6e-3, -0.0915]]
    )
    assert [len(np.unique(column.round(9))) for column in at.T] == [5, 5, 9]

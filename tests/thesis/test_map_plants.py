"""Plants of the unit's field beside the identified ones."""

import numpy as np
import pytest

from fieldmap.control import continuous
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
    """Earnshaw, for either iron; the step of the differences and the map leave 1e-3."""
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
    # The same saturation as on the rig: within a factor of two of the measured 1 mm, which linear iron is not.
    assert all(0.5 < x < 2 for x in horizontal["position_1_558_A"])
    assert all(x > 2 for x in horizontal["position"])


def test_volts_per_millimetre_of_depth_are_those_of_the_lift_currents():
    """The linear plant's slope against the lift currents of its field a millimetre above and below."""
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

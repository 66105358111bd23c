import numpy as np
import pytest

from fieldmap.thesis.printed import shared_value
from fieldmap.thesis.vertical_sensor import magnet_height, sensor_reading, thesis_lift_current


def test_the_sensor_zero_is_77_mm_below_the_disk():
    assert magnet_height(0.0) == pytest.approx(-0.077, abs=1e-15)


def test_a_larger_reading_is_lower_and_the_magnet_sits_below_the_point_read():
    assert magnet_height(11.0) - magnet_height(10.0) == pytest.approx(-1e-3)
    assert magnet_height(10.0, 0.015) == pytest.approx(magnet_height(10.0) - 0.015)


@pytest.mark.parametrize("offset", [0.0, 0.005, 0.02])
def test_height_and_reading_are_inverses(offset):
    readings = np.array([-3.0, 0.0, 10.0, 40.0])
    back = [sensor_reading(magnet_height(z, offset), offset) for z in readings]
    np.testing.assert_allclose(back, readings, atol=1e-12)


def test_the_levitation_current_has_the_printed_numbers_of_7_18():
    # The driver voltage of (7-19) is this law over the amplifier gain 0.355 A/V: 3.42 V at z = 0.
    assert thesis_lift_current(0.0) / 0.355 == pytest.approx(3.4225, abs=1e-4)
    # 1.558 A at z_s = 10 mm.
    assert thesis_lift_current(10.0) == pytest.approx(1.558, abs=1e-12)


def test_the_printed_numbers_are_those_of_the_measured_machine():
    assert thesis_lift_current(0.0) == shared_value("eq_7_18.intercept_A")
    slope = thesis_lift_current(1.0) - thesis_lift_current(0.0)
    assert slope == pytest.approx(shared_value("eq_7_18.slope_A_per_mm"), abs=1e-15)

"""Instruments in the C core against a few lines of numpy and values by hand."""

import numpy as np
import pytest

from fieldmap.core.instruments import Chain, Drive, drive_all, held_scans, measure_all

RANDOM = np.random.default_rng(9)
VALUES, NOISE = RANDOM.uniform(-14.0, 14.0, 300), RANDOM.normal(scale=0.02, size=300)
ANY_CHAIN = Chain(0.4, 1.3, 0.25, -7.0, 6.0, 1e-2, 0.05, 0.1, -5.0, 5.5)
ANY_DRIVE = Drive(0.2, -8.0, 9.0, 0.7, -0.3, -4.0, 5.0)


def measured(values, chain, noise=0.0):
    values, out = np.atleast_1d(np.asarray(values, float)), np.empty(np.size(values))
    measure_all(values, np.zeros(values.size) + noise, chain, out)
    return out


def driven(values, drive, noise=0.0):
    values, out = np.atleast_1d(np.asarray(values, float)), np.empty(np.size(values))
    drive_all(values, np.zeros(values.size) + noise, drive, out)
    return out


def converted(values, step, lower, upper):
    limited = np.clip(values, lower, upper)
    return step * np.floor(limited / step + 0.5)


def test_ideal_instruments_change_nothing():
    np.testing.assert_array_equal(measured(VALUES, Chain()), VALUES)
    np.testing.assert_array_equal(driven(VALUES, Drive()), VALUES)


@pytest.mark.parametrize(
    ("value", "step", "rounded"),
    [(0.26, 0.1, 0.3), (-0.26, 0.1, -0.3), (0.7, 0.0, 0.7), (-0.5, 1.0, 0.0), (0.5, 1.0, 1.0)],
)
def test_nearest_step_halves_go_up(value, step, rounded):
    for found in (
        measured(value, Chain(sensor_step=step)),
        measured(value, Chain(input_step=step)),
        driven(value, Drive(output_step=step)),
    ):
        assert found == pytest.approx(rounded)


def test_limits_come_before_steps():
    chain = Chain(sensor_step=0.3, sensor_lower=-10.0, sensor_upper=10.0)
    assert measured([12.0, -12.0], chain) == pytest.approx([9.9, -9.9])
    assert driven(12.0, Drive(0.0, -10.0, 10.0, 0.355, 0.1, -np.inf, 3.6)) == pytest.approx(3.6)


def test_a_chain_of_any_numbers():
    c = ANY_CHAIN
    sensed = converted((VALUES - c.zero) / c.scale, c.sensor_step, c.sensor_lower, c.sensor_upper)
    disturbed = (1 + c.gain_error) * sensed + c.offset_error + NOISE
    expected = c.zero + c.scale * converted(disturbed, c.input_step, c.input_lower, c.input_upper)
    np.testing.assert_allclose(measured(VALUES, c, NOISE), expected, rtol=1e-12)


def test_a_drive_of_any_numbers():
    d = ANY_DRIVE
    current = d.gain * converted(VALUES, d.output_step, d.lower, d.upper) + d.offset + NOISE
    np.testing.assert_allclose(driven(VALUES, d, NOISE), np.clip(current, -4.0, 5.0), rtol=1e-12)


def test_no_number_passes_no_limit():
    """A sensor shows its lower end for NaN, as for a value below its range."""
    assert measured(np.nan, ANY_CHAIN) == measured(-1e9, ANY_CHAIN)
    assert driven(np.nan, ANY_DRIVE) == driven(-1e9, ANY_DRIVE)


@pytest.mark.parametrize(
    ("averages", "latency", "ratio", "shown"),
    [
        (2, 0, 1.0, [1.0, 2.0, 2.0, 6.0, 6.0]),
        (1, 2, 1.0, [1.0, 1.0, 1.0, 3.0, 5.0]),
        (1, 0, 0.5, [1.0, 1.0, 3.0, 3.0, 5.0]),
        (2, 1, 1.0, [1.0, 1.0, 2.0, 2.0, 6.0]),
        (3, 0, 4.0, [1.0, 3.0, 7.0, 7.0, 7.0]),
        (9, 0, 1.0, [1.0, 1.0, 1.0, 1.0, 1.0]),
    ],
)
def test_held_scans(averages, latency, ratio, shown):
    scans, out = np.array([1.0, 3.0, 5.0, 7.0, 9.0]), np.empty(5)
    held_scans(scans, averages, latency, ratio, out)
    np.testing.assert_array_equal(out, shown)


def test_a_scan_at_the_moment_of_a_sample_counts():
    """100 * 0.29 is 28.999999999999996, the time of scan 29."""
    out = np.empty(101)
    held_scans(np.arange(40.0), 1, 0, 0.29, out)
    assert out[100] == 29.0


def test_what_does_not_fit_is_refused():
    out = np.empty(3)
    for given in (
        (np.zeros(3), np.zeros(2), Chain(), out),
        (np.zeros(3), np.zeros(3), Drive(), out),
        (np.zeros(3), np.zeros(3), Chain(), np.empty(2)),
        (np.zeros((3, 1)), np.zeros(3), Chain(), out),
        (np.zeros(6)[::2], np.zeros(3), Chain(), out),
    ):
        with pytest.raises(TypeError):
            measure_all(*given)
    with pytest.raises(TypeError):
        drive_all(np.zeros(3), np.zeros(3), Chain(), out)
    for averages, latency in ((0, 0), (1, -1), (2**40, 0)):
        with pytest.raises(ValueError, match="averages"):
            held_scans(np.zeros(3), averages, latency, 1.0, out)
    with pytest.raises(TypeError):
        held_scans(np.zeros(0), 1, 0, 1.0, out)

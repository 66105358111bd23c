"""Instruments in a simulation: steps, limits, noise, scanning, and one axis of the thesis's rig in closed loop."""

import numpy as np
import pytest

from fieldmap import control
from fieldmap.errors import InputError
from fieldmap.instruments import (
    Amplifier,
    Converter,
    Micrometer,
    Rig,
    draw_noise,
    driven_currents,
    loop_instruments,
    measured_positions,
    watch,
)

SENSOR = Micrometer(zero=0.020, scale=2e-3, voltage_step=5e-3, deviation=10.4e-6)
CARD = Converter(range=10.0, bits=16, random_noise=280e-6)
AMPLIFIER = Amplifier(gain=0.355, deviation=0.033)
RIG = Rig(SENSOR, CARD, CARD, AMPLIFIER)
STEPLESS = Rig(
    Micrometer(zero=0.020, scale=2e-3, deviation=10.4e-6), Converter(10.0, 50), Converter(10.0, 50), AMPLIFIER
)


def test_a_sensor_whose_rate_is_asked_for_must_state_it():
    for asked in (lambda: SENSOR.measuring_time, lambda: watch(SENSOR, [0.0, 1.0], [0.0, 0.0], 0.1)):
        with pytest.raises(InputError) as caught:
            asked()
        assert caught.value.problems[0].where == "Micrometer(scan_rate)"


def test_what_is_seen_of_a_still_position():
    """Rounded to 5 mV, then to the card's step, by numpy."""
    positions = np.random.default_rng(1).uniform(0.001, 0.039, 500)
    volts = np.round((positions - 0.020) / 2e-3 / 5e-3) * 5e-3
    step = 20 / 65536
    seen = 0.020 + 2e-3 * np.round(volts / step) * step
    np.testing.assert_allclose(measured_positions(RIG, positions), seen, atol=1e-12)


def test_limits_of_the_sensor():
    seen = measured_positions(RIG, [-0.010, 0.050])
    np.testing.assert_allclose(seen, [0.0, 0.040], atol=1e-6)


def test_a_uniform_position_is_off_by_the_step_over_root_twelve():
    """The deviation of rounding, from 20 000 samples, to 2 %."""
    positions = np.random.default_rng(2).uniform(0.01, 0.03, 20_000)
    rig = Rig(SENSOR, Converter(10.0, 50), CARD, AMPLIFIER)
    error = measured_positions(rig, positions) - positions
    assert error.std() == pytest.approx(10e-6 / np.sqrt(12), rel=0.02)


def test_noise_adds_up():
    """Sensor and card without steps: root of the sum of squares."""
    rig = Rig(STEPLESS.micrometer, Converter(10.0, 50, random_noise=2e-3), CARD, AMPLIFIER)
    seen = measured_positions(rig, np.full((100, 200), 0.012), np.random.default_rng(3))
    assert seen.shape == (100, 200)
    assert seen.std() == pytest.approx(np.hypot(10.4e-6, 2e-3 * 2e-3), rel=0.02)
    assert seen.mean() == pytest.approx(0.012, abs=5e-7)


def test_gain_and_offset_of_the_card():
    rig = Rig(STEPLESS.micrometer, STEPLESS.input, CARD, AMPLIFIER, gain_error=1e-3, offset_error=5e-3)
    # 0.030 m is 5 V, read as 5.010 V.
    assert measured_positions(rig, 0.030) == pytest.approx(0.030 + 2e-3 * 0.010, abs=1e-9)


def test_the_seed_decides():
    first, again, other = (measured_positions(RIG, np.zeros(50), np.random.default_rng(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_amplifier():
    """(3-4), saturation at 10 V: 3.55 A; a converter that rounds to 1/6553.6 V."""
    np.testing.assert_allclose(
        driven_currents(RIG, [1.4, 25.0, -25.0]), [0.497, 3.55, -3.55], atol=0.355 * 1.6e-4
    )
    assert AMPLIFIER.largest_current == pytest.approx(3.55)


def test_amplifier_with_its_own_limits_and_noise():
    noisy = driven_currents(RIG, np.full(20_000, 2.8), np.random.default_rng(4))
    assert noisy.std() == pytest.approx(0.033, rel=0.02)
    one_way = Rig(SENSOR, CARD, CARD, Amplifier(0.355, current_lower=0.0, current_upper=3.0))
    np.testing.assert_allclose(driven_currents(one_way, [-1.0, 9.9]), [0.0, 3.0])


def test_averaging_halves_the_noise_of_four_scans():
    sensor = Micrometer(0.020, 2e-3, scan_rate=1200.0, averages=4, deviation=10.4e-6)
    shown = watch(sensor, [0.0, 40.0], [0.01, 0.01], Ts=1 / 300, generator=np.random.default_rng(5))
    assert shown[2:].std() == pytest.approx(5.2e-6, rel=0.02)
    assert sensor.shown_deviation == pytest.approx(5.2e-6)


@pytest.mark.parametrize(("averages", "latency"), [(1, 0), (1, 3), (5, 0), (5, 2)])
def test_a_ramp_is_seen_late(averages, latency):
    """The delay is (averages - 1) / 2 + latency scans if samples coincide with scans."""
    rate = 1000.0
    sensor = Micrometer(0.0, 1.0, scan_rate=rate, averages=averages, latency=latency)
    shown = watch(sensor, [0.0, 1.0], [0.0, 1.0], Ts=averages / rate)
    times = np.arange(shown.size) * averages / rate
    # Samples at multiples of `averages` scans see the mean that ended one scan, or at least `latency` scans, earlier.
    whole = averages * (-(-latency // averages)) if averages > 1 else latency
    age = (averages - 1) / 2 + (1 if averages > 1 else 0) + whole
    np.testing.assert_allclose((times - shown)[10:], age / rate, atol=1e-12)


def test_what_is_held():
    """A scan every 10 ms sampled every 2 ms: five equal samples."""
    shown = watch(Micrometer(0.0, 1.0, scan_rate=100.0), [0.0, 0.1], [0.0, 0.1], Ts=2e-3)
    np.testing.assert_allclose(
        shown[:50].reshape(10, 5), np.repeat(np.arange(10)[:, None] * 0.01, 5, axis=1), atol=1e-12
    )


def test_compiled_loop_is_the_blocks_in_a_row():
    """A whole run against the blocks, sample by sample."""
    mass, stiffness, per_ampere = 0.01119, -4.2, 0.12
    model = control.levitated_plant(mass, stiffness, -per_ampere)
    A, B = control.zero_order_hold(model.A, model.B, 2e-3)
    pid = control.PID(900.0, 0.2, 0.02, 2e-3, acts_on_minus_error=True)
    at = {"position": 0.010, "output": 4.0}
    noise = draw_noise(RIG, np.random.default_rng(6), (1, 80))
    run = control.simulate_loop(
        (A, B, model.C, model.D), pid, np.full(80, 1e-4), instruments=loop_instruments(RIG, **at),
        position_noise=noise.position, voltage_noise=noise.voltage, current_noise=noise.current,
    )  # fmt: skip
    x, running, positions = np.zeros(2), control.RunningPID(pid), []
    for n in range(80):
        positions.append(x[0])
        volts = np.round((0.010 + x[0] + noise.position[0, n] - 0.020) / 2e-3 / 5e-3) * 5e-3
        step = 20 / 65536
        seen = 0.020 + 2e-3 * np.round((volts + noise.voltage[0, n]) / step) * step - 0.010
        u = running.step(1e-4, seen)
        current = (
            0.355 * np.round(np.clip(4.0 + u, -10, 10) / step) * step + noise.current[0, n] - 0.355 * 4.0
        )
        x = A @ x + B[:, 0] * current
    np.testing.assert_allclose(run.y[0], positions, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (lambda: Micrometer(0.02, 0.0), "scale"),
        (lambda: Micrometer(0.02, 2e-3, scan_rate=0.0), "scan_rate"),
        (lambda: Micrometer(0.02, 2e-3, averages=0), "averages"),
        (lambda: Micrometer(0.02, 2e-3, latency=-1), "latency"),
        (lambda: Micrometer(0.02, 2e-3, latency=1.5), "latency"),
        (lambda: Micrometer(0.02, 2e-3, lower=1.0, upper=-1.0), "rise"),
        (lambda: SENSOR.voltage([np.nan]), "finite"),
        (lambda: Amplifier(0.0), "gain"),
        (lambda: Amplifier(0.355, deviation=np.nan), "deviation"),
        (lambda: measured_positions(RIG, [0.0, np.inf]), "entry 1"),
        (lambda: driven_currents(RIG, np.nan), "finite"),
        (lambda: watch(SENSOR, [0.0], [0.0], 1e-3), "2 or more"),
        (lambda: watch(SENSOR, [0.0, 0.0], [0.0, 1.0], 1e-3), "rising"),
        (lambda: watch(SENSOR, [0.0, 1.0], [0.0, 1.0], 0.0), "Ts"),
        (lambda: Rig(SENSOR, CARD, CARD, AMPLIFIER, gain_error=np.inf), "gain_error"),
    ],
)
def test_bad_input(broken, says):
    with pytest.raises(InputError, match=says):
        broken()

"""What rows of the thesis do with the numbers below them, each judged by another way.

A machine stands for the unit whose statics are known in closed form: six vertical dipoles on a ring, whose moments
saturate with their currents, mu(i) = MU i / (1 + i / KNEE).
"""

import numpy as np
import pytest
import scipy.signal
from scipy.optimize import brentq

from fieldmap import control
from fieldmap.currents import divide_currents
from fieldmap.device.model import Payload
from fieldmap.field import Field, coil_currents
from fieldmap.thesis import equilibrium_shift, horizontal, statics, vertical
from fieldmap.thesis.coupled_runs import Readings
from fieldmap.thesis.equilibrium_shift import Shift
from fieldmap.thesis.force_formulas import added_error, fit_quadratic_force
from fieldmap.thesis.printed import read_part
from fieldmap.thesis.vertical_sensor import magnet_height

MU, KNEE = 12.0, 4.0
MASS, MOMENT = 0.011186, 0.8126
RING = np.array(
    [
        [0.044 * np.cos(a), 0.044 * np.sin(a), 0.026]
        for a in np.deg2rad([240.0, 180.0, 120.0, 300.0, 0.0, 60.0])
    ]
)


def slope(point, currents):
    """dBz/dx_i (3,) of the machine: the derivative of B_z = 1e-7 mu (3 z^2 / d^5 - 1 / d^3), by complex steps."""
    moments = MU * currents / (1.0 + currents / KNEE)
    found = []
    for step in 1e-30j * np.eye(3):
        r = point + step - RING
        d2 = (r * r).sum(axis=1)
        found.append((1e-7 * moments * (3.0 * r[:, 2] ** 2 / d2**2.5 - d2**-1.5)).sum().imag / 1e-30)
    return np.array(found)


class SaturatingRing(Field):
    """Of this field only dB_z/dx_i is asked for; the rest of the gradient is left out."""

    coil_names, proportional = tuple("123456"), False
    bounds = (np.array([-0.025, -0.025, -0.13]), np.array([0.025, 0.025, -0.07]))

    def field(self, points, currents):
        return np.zeros((len(np.atleast_2d(points)), 3))

    def gradient(self, points, currents):
        i = coil_currents(currents, self.coil_names)
        r = np.atleast_2d(points)[:, None] - RING
        z, d2 = r[..., 2:], (r * r).sum(axis=-1, keepdims=True)
        along = 3.0 * r / d2**2.5 - 15.0 * z**2 * r / d2**3.5
        along[..., 2:] += 6.0 * z / d2**2.5
        out = np.zeros((len(r), 3, 3))
        out[:, 2] = 1e-7 * np.einsum("k,pki->pi", MU * i / (1.0 + i / KNEE), along)
        return out

    def second_gradient(self, points, currents):
        h = 1e-6
        p = np.atleast_2d(points)
        return np.stack(
            [
                (self.gradient(p + s, currents) - self.gradient(p - s, currents)) / (2 * h)
                for s in h * np.eye(3)
            ],
            axis=-1,
        )


@pytest.fixture
def ring(monkeypatch):
    """The machine in the unit's place; what rows keep is forgotten before and after."""
    field = SaturatingRing()
    carried = Payload(MASS, MOMENT)
    for module in (equilibrium_shift, statics):
        monkeypatch.setattr(module, "unit_rays", lambda: field)
        monkeypatch.setattr(module, "payload", lambda: carried)
    monkeypatch.setattr("fieldmap.thesis.drive_unit.payload", lambda: carried)
    equilibrium_shift._curve.cache_clear()
    yield field
    equilibrium_shift._curve.cache_clear()


def rest_along_x(level, signal, n, z_s, h):
    """mm, of the magnet on the x axis where nothing pushes it along x; the ring is symmetric about that axis."""
    currents = divide_currents(level, signal, 0.0, n)
    height = magnet_height(z_s, 1e-3 * h)
    return 1e3 * brentq(lambda x: slope(np.array([x, 0.0, height]), currents)[0], 0.0, 0.024, xtol=1e-12)


def test_each_column_of_table_6_2_is_computed_with_its_own_n(ring):
    signals = np.array([0.05, 0.1, 0.2])
    inputs = {
        "map": ring,
        "offsets_mm": [15.0],
        "zero_mm": -0.088,
        "z_mm": 10.0,
        **{f"n{n}_signals": signals for n in (125, 150)},
        **{f"n{n}_measured_mm": np.ones(3) for n in (125, 150)},
    }
    numbers = equilibrium_shift.n_table(inputs).numbers
    level = 1.558
    for n, name in ((1.25, "n125"), (1.5, "n150")):
        expected = [rest_along_x(level, s, n, 10.0, 15.0) - 0.088 for s in signals]
        assert numbers[f"{name}_constant"][0] == pytest.approx(expected, rel=2e-3)
    apart = numbers["n150_constant"][0] / numbers["n125_constant"][0]
    assert np.abs(apart - 1.0).min() > 0.05


def test_own_current_is_the_level_that_is_asked_for(ring):
    signals = np.array([0.1, 0.2])
    inputs = {"map": ring, "signals": signals, "level_A": 3.0, "z_mm": 10.0, "zero_mm": 0.1}
    answers = equilibrium_shift.own_current(inputs)
    expected = [rest_along_x(3.0, s, 1.25, 10.0, 15.0) + 0.1 for s in signals]
    assert answers.numbers["x"] == pytest.approx(expected, rel=1e-5)
    lower = [rest_along_x(1.5, s, 1.25, 10.0, 15.0) + 0.1 for s in signals]
    assert np.abs(np.array(lower) / expected - 1.0).min() > 0.02


def test_relative_slope_of_the_lift_current(monkeypatch):
    """1.7 % per mm of an exponential law."""
    monkeypatch.setattr(statics, "lift_current", lambda z_s, h: 1.5 * np.exp(0.017 * z_s))
    assert statics._relative_slope(10.0, 15.0) == pytest.approx(1.7, rel=1e-4)


def test_lift_current_of_the_ring(ring):
    """Where the lift of six equal coils is the weight: I / (1 + I / KNEE) = weight / lift of one ampere, by hand."""
    point = np.array([0.0, 0.0, magnet_height(8.0, 0.015)])
    unsaturated = MOMENT * slope(point, np.full(6, 1e-9))[2] / 1e-9
    share = MASS * 9.80665 / unsaturated
    statics.lift_current.cache_clear()
    found = statics.lift_current(8.0, 15.0)
    statics.lift_current.cache_clear()
    assert found == pytest.approx(share / (1.0 - share / KNEE), rel=1e-5)


def test_ranges_are_of_both_sides_and_end_at_the_limits(monkeypatch):
    """A unit that moves 20 mm per unit signal along x, 30 towards negative x, 10 along y, and whose largest current is
    1.5 A + 5 A per unit signal."""

    def followed(axis, way, z_s, h):
        signals = way * np.array([0.1, 0.2, 0.3, 0.4, 0.5])
        per_signal = {("x", 1.0): 0.02, ("x", -1.0): 0.03, ("y", 1.0): 0.01}[axis, way]
        places = np.zeros((5, 2))
        places[:, "xy".index(axis)] = per_signal * signals
        return Shift(signals, places, np.zeros(2), np.full(5, 1.5), 1.5 + 5.0 * np.abs(signals), True)

    monkeypatch.setattr(statics, "_followed", followed)
    monkeypatch.setattr(statics, "_deepest", lambda h, limit, scaled: 0.0)
    monkeypatch.setattr(statics, "_checked_at_half", lambda: 0.0)
    # As far, with joints: 4 mm by ampere of the limit, less a tenth of the depth.
    monkeypatch.setattr(statics, "joint_range", lambda axis, z_s, limit, largest: 4.0 * limit - 0.1 * z_s)
    inputs = {
        "current_limit_A": 3.25,  # a signal of 0.35
        "offsets_mm": [15.0],
        "depths_mm": [11.5, 18.0],
        "largest_y_signal": 0.3,
    }
    numbers = statics.ranges(inputs).numbers
    assert numbers["x_range_upper"] == pytest.approx([0.35 * (20.0 + 30.0)])
    assert numbers["y_range_lower"] == pytest.approx([2 * 0.3 * 10.0])
    assert numbers["x_range_upper_joints"] == pytest.approx(13.0 - 1.15)
    assert numbers["y_range_lower_joints"] == pytest.approx(13.0 - 1.8)
    numbers = statics.ranges(inputs | {"current_limit_A": 2.5}).numbers
    assert numbers["y_range_upper"] == pytest.approx([2 * 0.2 * 10.0])


def test_the_step_of_the_identified_plant():
    """Peak, overshoot and arrival of the loop of (5-11), (5-17), from its transfer function by scipy."""
    inputs = read_part("S16_closed_loop").inputs
    kc, ti, td, ts = (inputs[name] for name in ("Kc", "Ti_s", "Td_s", "Ts_s"))
    # (5-10) with the trapezoidal integral: kc (1 + ts/(2 ti) (1 + q)/(1 - q) + td/ts (1 - q)), over (1 - q).
    half = ts / (2.0 * ti)
    pid = kc * np.array([1.0 + half + td / ts, half - 1.0 - 2.0 * td / ts, td / ts])
    num = inputs["plant_gain"] * np.poly(np.atleast_1d(inputs["plant_zeros"]))
    den = np.poly(np.atleast_1d(inputs["plant_poles"]))
    num = np.concatenate([np.zeros(len(den) - len(num)), num])
    # The plant's gain is negative and the controller acts on minus the error.
    top = np.convolve(num, -pid)
    bottom = np.convolve(den, [1.0, -1.0, 0.0]) + top
    y = inputs["step_mm"] * scipy.signal.lfilter(top, bottom, np.ones(2000))
    numbers = vertical.step_response(inputs).numbers
    assert numbers["overshoot"] == pytest.approx(100.0 * (y.max() / inputs["step_mm"] - 1.0), abs=1e-6)
    assert numbers["peak_time"] == pytest.approx(ts * y.argmax(), abs=1e-9)
    assert numbers["time_to_reference"] == pytest.approx(ts * np.argmax(y >= inputs["step_mm"]), abs=1e-9)


def test_what_is_said_of_the_regulator_is_what_its_curves_show():
    answers = vertical.regulator_loop(read_part("S20_closed_loop").inputs)
    curves = {series.name: series for series in answers.curves[0].series}
    for number, name in (
        ("overshoot", "with (7-21), as on the rig"),
        ("design_overshoot", "design"),
        ("overshoot_of_7_20", "with (7-20)"),
    ):
        assert answers.numbers[number] == pytest.approx(100.0 * (curves[name].y.max() - 1.0), abs=1e-9)
    assert answers.numbers["overshoot"] > 10.0
    rig = curves["with (7-21), as on the rig"]
    assert answers.numbers["peak_time"] == pytest.approx(rig.x[rig.y.argmax()], abs=1e-9)


def test_time_to_reference_of_a_ramp():
    """From a step at 1 s a position goes from 10 to 11 mm in 0.37 s and on."""
    time = np.arange(0.0, 3.0, 1e-3)
    wanted = np.where(time < 1.0, 10.0, 11.0)
    for way in (1.0, -1.0):
        true = way * (10.0 + np.clip((time - 1.0) / 0.37, 0.0, 1.2))
        run = Readings(None, time, true[:, None], true[:, None], way * wanted[:, None])
        assert run.time_to_reference(0, 1.0) == pytest.approx(0.37, abs=1.01e-3)


def test_rest_voltage_of_the_regulator_is_that_of_its_model():
    """b / (s^2 + c s - k) rests at a voltage of -k / b per unit of position."""
    model = control.controller_form([-250.0], [1.0, 45.0, -500.0])
    _, regulator = vertical.design_of(model, np.diag([1.0, 1.0, 1.0]), 1e-3, (1e-4, 1e-4), 2e-3)
    assert regulator.equilibrium == pytest.approx((0.0, 2.0), rel=1e-9)


def test_gains_of_the_regulator_follow_the_ratios_of_its_weights():
    """Twice the cost is the same optimum; dearer control and a worse sensor have smaller gains."""
    model = control.controller_form([-250.0], [1.0, 45.0, -500.0])

    def gains(cost, R, noise):
        _, regulator = vertical.design_of(model, cost * np.diag([1.0, 2.0, 3e4]), R, noise, 2e-3)
        return regulator.k, regulator.estimator.D_est

    once, sensed = gains(1.0, 1e-3, (10.0, 1e-4))
    twice, scaled = gains(2.0, 2e-3, (30.0, 3e-4))
    dear, worse = gains(1.0, 1e-1, (10.0, 1.0))
    np.testing.assert_allclose(twice, once, rtol=1e-6)
    np.testing.assert_allclose(scaled, sensed, rtol=1e-6, atol=1e-15)
    assert np.abs(dear).sum() < 0.9 * np.abs(once).sum()
    assert np.abs(worse).sum() < 0.5 * np.abs(sensed).sum()


def test_mean_and_standard_deviation_over_records():
    """n - 1: the mean was found from the same records. Squares 9 + 1 + 1 + 9 over 3."""
    answers = vertical.over_records({"poles": np.array([[1.0, 10.0], [3.0, 10.0], [5.0, 10.0], [7.0, 10.0]])})
    assert answers.numbers["poles"] == pytest.approx([4.0, 10.0])
    assert answers.facts["poles_spread"] == pytest.approx([np.sqrt(20.0 / 3.0), 0.0])


def test_errors_of_added_formulas():
    """Errors 3, 4, 0 of forces 5, 12, 0; the first two lie in the middle."""
    found = added_error(
        (1.0, 0.0), np.array([8.0, 8.0, 0.0]), np.array([5.0, 12.0, 0.0]), np.array([True, True, False])
    )
    assert found.currents == (1.0,)
    assert (found.rms, found.rms_mN) == pytest.approx((np.sqrt(25 / 3), 1e3 * np.sqrt(25 / 3)))
    assert (found.whole, found.middle) == pytest.approx((5 / 13, 5 / 13))
    found = added_error(
        (1.0,), np.array([8.0, 8.0, 1.0]), np.array([5.0, 12.0, 2.0]), np.array([True, False, False])
    )
    assert (found.whole, found.middle) == pytest.approx((np.sqrt(26 / 173), 3 / 5))


def test_largest_and_root_mean_square_error_of_a_fit():
    """Of values at four places in a row a parabola leaves their part along (-1, 3, -3, 1), whose square is 20."""
    found = fit_quadratic_force([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 20.0])
    assert found.largest == pytest.approx(3.0)
    assert found.rms == pytest.approx(np.sqrt(5.0))


def test_departure_is_the_largest_and_rms_the_root_mean_square():
    seen = np.array([[10.0, 10.1, 9.7, 10.2]]).T
    run = Readings(None, np.arange(4.0), seen, seen, np.full((4, 1), 10.0))
    assert run.departure(0, 1.0) == pytest.approx(0.3)
    assert run.rms(0, 1.0) == pytest.approx(np.sqrt(0.14 / 3))
    assert run.rms(0, 1.0, 3.0) == pytest.approx(np.sqrt(0.05))
    assert run.mean(0, 1.0, 3.0) == pytest.approx(9.9)


def test_integral_time_of_a_model_is_found_in_its_own_step():
    """The step of a first-order loop with an integral time of 0.2 s, 3 mm away from where x begins."""
    plant, wanted = control.transfer_function([0.02], [1.0, -0.99]), np.full(3000, 3.0)
    time = 2e-3 * np.arange(3000)
    wanted[time >= 2.0] += 0.1
    under = horizontal.Control(0.5, 9.0, 0.001)
    seen = 3.0 + control.simulate_loop(plant, under.pid(2e-3, 0.2), wanted[time >= 2.0] - 3.0).y[0]
    seen = np.append(np.full(np.sum(time < 2.0), 3.0), seen)
    # The reference counts from where the run begins.
    run = Readings(None, time, seen[:, None], seen[:, None] - 3.0, wanted[:, None])
    assert horizontal._fitted_time({"Ts_s": 2e-3}, plant, under, run) == pytest.approx(0.2, rel=1e-3)

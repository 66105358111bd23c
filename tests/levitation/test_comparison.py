"""A field against measurements: lift currents, the factor on the force and shifts, each found in another way.

Six vertical dipoles on a ring have moments that saturate with their currents: mu(i) = MU i / (1 + i / KNEE).
"""

import numpy as np
import pytest
from scipy.constants import g as gravity
from scipy.optimize import brentq, fsolve, least_squares

from fieldmap.currents import CoilGroups, LiftAndDirections, divide_currents
from fieldmap.device.measured import MeasuredMachine, MeasuredShift
from fieldmap.device.model import Payload
from fieldmap.errors import OutsideMapError, Problem
from fieldmap.field import Field, coil_currents
from fieldmap.levitation import (
    LiftAtHeight,
    equilibrium_at,
    fit_force,
    lift_by_height,
    shifts_beside_measured,
)
from tests.levitation.conftest import dipole_field

MU, KNEE = 8.0, 4.0
ANGLES = np.deg2rad([240.0, 180.0, 120.0, 300.0, 0.0, 60.0])
RING = np.column_stack([0.044 * np.cos(ANGLES), 0.044 * np.sin(ANGLES), np.full(6, 0.026)])
MASS, MOMENT = 0.010, 0.8
PAYLOAD = Payload(MASS, MOMENT, magnet_offset=0.005)
LIMIT = 3.0
N = 1.25


def dipole_gradient(points, moments):
    """dB_i/dx_j (n, 3, 3) of the vertical dipoles of the ring."""
    return sum(m * dipole_field(points - place)[1] for place, m in zip(RING, moments, strict=True))


class Field(Field):
    """Holds for currents from 0 to LIMIT."""

    coil_names, proportional, assumptions = tuple("123456"), False, ("dipoles",)
    bounds = (np.array([-0.02, -0.02, -0.12]), np.array([0.02, 0.02, -0.06]))

    def moments(self, currents):
        i = coil_currents(currents, self.coil_names)
        if (i < 0.0).any() or (i > LIMIT).any():
            raise OutsideMapError(Problem("currents", "must be held", f"{i}", "none"))
        return MU * i / (1.0 + i / KNEE)

    def field(self, points, currents):
        """Not used: the force depends on the gradient only."""
        return np.zeros((len(np.atleast_2d(points)), 3))

    def gradient(self, points, currents):
        return dipole_gradient(np.atleast_2d(points), self.moments(currents))

    def second_gradient(self, points, currents):
        p, h = np.atleast_2d(points), 1e-6 * np.eye(3)
        ahead, behind = ([self.gradient(p + s * step, currents) for step in h] for s in (1, -1))
        return np.moveaxis(np.array(ahead) - np.array(behind), 0, -1) / 2e-6


def force(point, currents):
    """On an upright magnet, N: m dBz/dx_i."""
    return MOMENT * dipole_gradient(np.atleast_2d(point), Field().moments(currents))[0, 2]


def lift(height, current):
    return force([0.0, 0.0, height], np.full(6, current))[2]


def carrying(height, factor=1.0):
    """The current whose lift, times a factor, is the weight."""
    return brentq(lambda i: factor * lift(height, i) - MASS * gravity, 0.0, LIMIT)


def machine(**changes):
    about = {"device": "ring", "coils": 6, "sensor_zero": -0.060, "lift_slope": 0.02, "lift_at_zero": 0.4}
    about |= {"readings_mm": (0.0, 10.0, 20.0, 30.0, 90.0), "lift_source": "Table 1"}
    return MeasuredMachine(**(about | changes))


def test_heights_without_a_sensor_divide_the_box():
    rows = lift_by_height(Field(), PAYLOAD)
    np.testing.assert_allclose([row.height for row in rows], np.linspace(-0.06, -0.12, 6)[1:-1])
    assert [row.current is None for row in rows] == [False, False, True, True]
    for row in rows:
        if row.current is not None:
            assert row.current == pytest.approx(carrying(row.height), rel=2e-4)
        assert (row.sensor_mm, row.measured, row.lift_share, row.ratio) == (None, None, None, None)


def test_lift_currents_beside_the_measured():
    rows = lift_by_height(Field(), PAYLOAD, machine(), largest=LIMIT)
    # The last reading lies outside the box.
    assert [row.sensor_mm for row in rows] == [0.0, 10.0, 20.0, 30.0]
    np.testing.assert_allclose([row.height for row in rows], [-0.065, -0.075, -0.085, -0.095])
    np.testing.assert_allclose([row.measured for row in rows], [0.4, 0.6, 0.8, 1.0])
    beyond = [lift(row.height, LIMIT) < MASS * gravity for row in rows]
    assert beyond == [False, False, False, True]
    for row, too_weak in zip(rows, beyond, strict=True):
        assert row.lift_share == pytest.approx(lift(row.height, row.measured) / (MASS * gravity), rel=1e-9)
        if too_weak:
            assert (row.current, row.beyond, row.ratio) == (None, LIMIT, None)
        else:
            found = carrying(row.height)
            assert row.current == pytest.approx(found, rel=2e-4)
            assert row.ratio == pytest.approx(found / row.measured, rel=2e-4)
            assert row.beyond is None


def test_readings_at_the_ends_of_the_box_are_inside():
    """Heights of -60 and -120 mm are rows; 1 mm beyond them there is no row."""
    read = machine(readings_mm=(-6.0, -5.0, 55.0, 56.0))
    assert [row.sensor_mm for row in lift_by_height(Field(), PAYLOAD, read)] == [-5.0, 55.0]


def test_a_current_below_the_least_of_the_field_is_not_beyond_the_largest():
    class FromTwoAmperes(Field):
        def moments(self, currents):
            if (coil_currents(currents, self.coil_names) < 2.0).any():
                raise OutsideMapError(Problem("currents", "must be held", "less", "none"))
            return super().moments(currents)

    row = lift_by_height(FromTwoAmperes(), PAYLOAD, machine(), largest=LIMIT)[0]
    assert (row.current, row.beyond, row.lift_share) == (None, None, None)


def test_the_factor_on_the_force_and_what_it_leaves():
    rows = lift_by_height(Field(), PAYLOAD, machine(), largest=LIMIT)
    fit = fit_force(Field(), PAYLOAD, rows)

    def left(f):
        return [f[0] * lift(row.height, row.measured) / (MASS * gravity) - 1.0 for row in rows]

    assert fit.factor == pytest.approx(least_squares(left, [1.0], xtol=1e-12).x[0], rel=1e-6)
    for row, current, deviation in zip(rows, fit.currents, fit.deviations, strict=True):
        found = carrying(row.height, fit.factor)
        assert current == pytest.approx(found, rel=2e-4)
        assert deviation == pytest.approx(found / row.measured - 1.0, abs=3e-4)
    # Without measurements there is no fit.
    assert fit_force(Field(), PAYLOAD, lift_by_height(Field(), PAYLOAD)) is None


def test_no_lift_off_the_axis_or_without_pull():
    class Aside(Field):
        bounds = (np.array([0.005, -0.02, -0.12]), np.array([0.02, 0.02, -0.06]))

    class Uniform(Field):
        def gradient(self, points, currents):
            return np.zeros((len(np.atleast_2d(points)), 3, 3))

    assert lift_by_height(Aside(), PAYLOAD, machine()) == ()
    assert lift_by_height(Uniform(), PAYLOAD, machine()) == ()


def test_a_row_as_plain_python():
    row = LiftAtHeight(-0.1, 3.0, None, 10.0, 1.5, 0.6, 2e-4)
    assert row.ratio == 2.0
    read = {"sensor_mm": 10.0, "measured": 1.5, "lift_share": 0.6, "volume_error": 2e-4}
    assert row.to_dict() == {"height": -0.1, "current": 3.0, "beyond": None, "ratio": 2.0, **read}


SIGNALS = (0.05, 0.1, 0.2)
READ = MeasuredShift(N, 10.0, SIGNALS, (0.5, 1.0, 2.5), -0.2, "Table 2")


def at_rest(signals, level, height):
    """x of zero push: at the given level, and at the level that keeps the lift of signal 0; and that level."""
    on_axis = lift(height, level)
    rows, x, both = [], 0.0, np.array([0.0, level])
    for signal in signals:

        def pull(x, u, s=signal):
            return force([x, 0.0, height], divide_currents(u, s, 0.0, N))

        x = brentq(lambda x: pull(x, level)[0], -0.02, 0.02)
        both = fsolve(lambda v: pull(*v)[[0, 2]] - [0.0, on_axis], both, xtol=1e-12)
        rows.append((x, *both))
    return np.array(rows).T


def test_shifts_beside_the_measured():
    other = MeasuredShift(1.5, 10.0, SIGNALS, (0.5, 1.0, 2.5), -0.2, "Table 3")
    both = machine(shifts=(READ, other), lift_at_zero=2.0)
    (shift,) = shifts_beside_measured(Field(), PAYLOAD, both, LiftAndDirections(N, LIMIT))
    assert (shift.source, shift.n, shift.sensor_mm) == ("Table 2", N, 10.0)
    assert (shift.height, shift.level, shift.zero) == pytest.approx((-0.075, 2.2, -2e-4))
    np.testing.assert_allclose(shift.measured, [5e-4, 1e-3, 2.5e-3])
    places, held, levels = at_rest(SIGNALS, 2.2, -0.075)
    assert np.abs(places - held).max() > 2e-5
    # Shifts count from the reading at signal 0, where the calculated x is 0.
    np.testing.assert_allclose(shift.constant_level, places - 2e-4, atol=2e-7)
    np.testing.assert_allclose(shift.constant_lift, held - 2e-4, atol=2e-7)
    np.testing.assert_allclose(shift.levels, levels, rtol=1e-4)


def test_shifts_that_cannot_be_compared_are_left_out():
    measured = machine(shifts=(READ,), lift_at_zero=2.0)
    division = LiftAndDirections(N)
    for one, of in (
        (measured, LiftAndDirections(1.5)),
        (measured, CoilGroups([[0, 2, 4], [1, 3, 5]])),
        (machine(), division),
        (machine(shifts=(READ,), sensor_zero=0.0), division),
        (machine(shifts=(READ,), lift_at_zero=LIMIT), division),
    ):
        assert shifts_beside_measured(Field(), PAYLOAD, one, of) == ()


def test_where_the_currents_end_there_is_no_place():
    far = machine(shifts=(MeasuredShift(N, 10.0, (0.1, 0.4), (1.0, 5.0), 0.0, "Table 2"),), lift_at_zero=2.4)
    (shift,) = shifts_beside_measured(Field(), PAYLOAD, far, LiftAndDirections(N))
    assert np.isfinite(shift.constant_level).tolist() == [True, False]
    assert np.isfinite(shift.levels).tolist() == [True, False]


@pytest.mark.parametrize("held", [False, True])
def test_one_point_of_the_path_in_a_few_newton_steps(held):
    """Place and level against scipy's solver. Newton's method with the derivative of the force takes six steps, of four
    states each if the level is sought too."""
    height, level, signal = -0.075, 0.6, 0.2
    asked = []

    def path(u):
        asked.append(u)
        return divide_currents(u, signal, 0.0, N), height

    scale = MASS * gravity / lift(height, level)
    point, found = equilibrium_at(Field(), PAYLOAD, path, [0.0, 0.0], level, held, scale)
    constant, follows, levels = (values[0] for values in at_rest([signal], level, height))
    assert point.position[:2] == pytest.approx([follows if held else constant, 0.0], abs=2e-9)
    assert found == pytest.approx(levels if held else level, rel=1e-7)
    assert len(asked) <= (26 if held else 14)

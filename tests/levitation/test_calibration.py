"""Calibration on readings made from a known rig: the fit returns the truth, with the covariance of the noise."""

import numpy as np
import pytest
from scipy.optimize import brentq

from fieldmap.device.model import Payload
from fieldmap.errors import InputError
from fieldmap.levitation import LiftReadings, PositionReadings, calibrate, magnet_balance, stationary_points
from tests.levitation.conftest import solid_harmonics

PAYLOAD = Payload(mass=0.01119, moment=0.813, magnet_offset=0.015)
WEIGHT = 0.01119 * 9.80665
SENSED = np.array([0.012, 0.014, 0.016, 0.018, 0.020, 0.022])
TRUTH = {"field_scale": 1.3, "magnet_offset": 0.012}


class Saturating:
    """Currents enter as 3 tanh(i / 3), so that a scale of the field and a scale of the currents differ."""

    def __init__(self, linear):
        self.linear = linear
        self.coil_names, self.lower, self.upper = linear.coil_names, linear.lower, linear.upper

    def __getattr__(self, name):
        method = getattr(self.linear, name)
        return lambda points, currents: method(points, 3.0 * np.tanh(np.asarray(currents) / 3.0))


@pytest.fixture
def rig(polynomial_field):
    """Two coils side by side: both lift more the higher the magnet is, and each draws it to its own side."""
    potentials = []
    for side in (-1.0, 1.0):
        t = solid_harmonics(c2=0.035, c3=0.5)
        t[1, 0, 1] = 0.01 * side
        potentials.append(t)
    return Saturating(polynomial_field(potentials))


def lift_readings(rig, truth, gains=(1.0, 1.0), noise=0.0, seed=0):
    """Equal currents that carry the magnet of the true rig, by bisection."""
    rng, found = np.random.default_rng(seed), []
    for sensed in SENSED:
        point = np.array([0.0, 0.0, sensed - truth["magnet_offset"]])

        def left(i, point=point):
            slope = rig.gradient(point[None], i * np.asarray(gains))[0, 2, 2]
            return truth["field_scale"] * PAYLOAD.moment * slope - WEIGHT

        found.append(brentq(left, 0.01, 20.0, xtol=1e-14) * (1.0 + noise * rng.normal()))
    return LiftReadings(SENSED, np.outer(found, [1.0, 1.0]), deviation=max(noise, 0.01))


def position_readings(rig, truth, gains=(1.0, 1.0)):
    """The places at which the true rig's magnet rests at unequal currents."""
    currents = np.array([[0.9, 1.1], [0.8, 1.2], [1.2, 0.8], [0.7, 1.3]])
    places = []
    for amperes in currents:
        height = 0.016 - truth["magnet_offset"]
        (point,) = stationary_points(rig, amperes * np.asarray(gains), PAYLOAD, height).points
        places.append(point.position[:2])
    return PositionReadings(np.full(4, 0.016), currents, places)


def test_field_scale_and_offset_come_back(rig):
    found = calibrate(rig, PAYLOAD, lift=lift_readings(rig, TRUTH))
    assert found.fitted == ("field_scale", "magnet_offset")
    assert found.values["field_scale"] == pytest.approx(1.3, rel=1e-5)
    assert found.values["magnet_offset"] == pytest.approx(0.012, rel=1e-5)
    assert found.before["magnet_offset"] == 0.015
    assert found.misfit < 1e-4 < 1.0 < found.misfit_before
    assert [row.after for row in found.table] == pytest.approx([1.0] * 6, rel=1e-6)
    assert all(abs(row.before - 1.0) > 0.05 for row in found.table)
    expected = [f"lift over weight at {1e3 * z:g} mm" for z in SENSED]
    assert [row.quantity for row in found.table] == expected


def test_what_a_scale_alone_leaves_of_six_readings(rig):
    """s L_k is measured as 1 within 3 %: s = sum L / sum L^2 with deviation 0.03 / |L|, and the misfit over all six."""
    read = lift_readings(rig, TRUTH, noise=0.03)
    how = {"fit": ["field_scale"], "given": {"magnet_offset": 0.012, "field_scale": 1.2}}
    found = calibrate(rig, PAYLOAD, lift=read, **how)
    points = np.column_stack([np.zeros((6, 2)), SENSED - 0.012])
    slopes = [rig.gradient(point[None], i)[0, 2, 2] for point, i in zip(points, read.currents, strict=True)]
    lifts = PAYLOAD.moment * np.array(slopes) / WEIGHT
    scale = lifts.sum() / (lifts @ lifts)
    assert found.values["field_scale"] == pytest.approx(scale, rel=1e-7)
    assert found.deviations == {"field_scale": pytest.approx(0.03 / np.linalg.norm(lifts), rel=1e-6)}
    for misfit, s in ((found.misfit, scale), (found.misfit_before, 1.2)):
        assert misfit == pytest.approx(np.sqrt(np.mean((s * lifts - 1.0) ** 2)) / 0.03, rel=1e-6)
    assert [row.before for row in found.table] == pytest.approx(1.2 * lifts)
    assert [row.after for row in found.table] == pytest.approx(scale * lifts)


def test_gains_of_the_coils_need_places(rig):
    """Equal currents do not tell the coils apart."""
    gains = (1.1, 0.95)
    read = {
        of: make(rig, TRUTH, gains)
        for of, make in (("lift", lift_readings), ("positions", position_readings))
    }
    found = calibrate(rig, PAYLOAD, **read, fit=["field_scale", "magnet_offset", "gains"])
    assert [found.values[f"gain coil {k}"] for k in range(2)] == pytest.approx(gains, rel=1e-4)
    assert found.values["field_scale"] == pytest.approx(1.3, rel=1e-4)
    np.testing.assert_allclose(found.currents([2.0, 2.0]), [2.2, 1.9], rtol=1e-4)


def test_places_may_count_from_the_first(rig):
    """A sensor that was set to zero at the magnet's first place: the places fit for any first place."""
    read = position_readings(rig, TRUTH)
    sensed, currents, places = (np.asarray(of)[:2] for of in (read.sensed, read.currents, read.places))
    positions = PositionReadings(sensed, currents, places + [3e-3, -1e-3], from_first=True)
    how = {"fit": ["field_scale"], "given": {"magnet_offset": TRUTH["magnet_offset"]}}
    found = calibrate(rig, PAYLOAD, lift_readings(rig, TRUTH), positions, **how)
    assert found.misfit < 1e-3
    rows = [row for row in found.table if " of reading " in row.quantity]
    # The first reading counts from itself and is left out.
    expected = places[1] - places[0]
    assert [row.quantity for row in rows] == ["x of reading 1", "y of reading 1"]
    assert [row.measured for row in rows] == pytest.approx(expected, abs=1e-12)
    assert [row.after for row in rows] == pytest.approx(expected, abs=1e-7)


def test_field_scale_and_current_scale_differ_where_iron_saturates(rig):
    lift = lift_readings(rig, TRUTH, (1.2, 1.2))
    fit = ["field_scale", "current_scale"]
    found = calibrate(rig, PAYLOAD, lift=lift, fit=fit, given={"magnet_offset": 0.012})
    assert [found.values[name] for name in fit] == pytest.approx([1.3, 1.2], rel=1e-4)


def test_where_nothing_saturates_the_two_scales_are_one(rig):
    lift = lift_readings(rig.linear, TRUTH)
    with pytest.raises(InputError, match=r"field_scale and current_scale|current_scale and field_scale"):
        calibrate(rig.linear, PAYLOAD, lift=lift, fit=["field_scale", "current_scale"])


def test_places_at_a_held_height(rig):
    """The controller sets the level of the currents, which is not read. Lift fixes the level by the field scale."""
    read = position_readings(rig, TRUTH)
    height, held = 0.016 - TRUTH["magnet_offset"], []
    for amperes in np.asarray(read.currents):
        u = 1.0
        for _ in range(60):
            (point,) = stationary_points(rig, amperes * u, PAYLOAD, height).points
            u *= WEIGHT / (TRUTH["field_scale"] * point.lift)
        held.append(point.position[:2])
    given = PositionReadings(np.full(4, 0.016), read.currents, held, height_held=True)
    lift = lift_readings(rig, TRUTH)
    found = calibrate(rig, PAYLOAD, lift=lift, positions=given)
    assert found.values["field_scale"] == pytest.approx(1.3, rel=1e-4)
    assert found.misfit < 1e-3


def test_a_level_that_is_not_read_is_that_of_the_lift(rig):
    """Currents in a proportion of 9 to 11; the controller sets the level that carries the magnet."""
    currents, height = np.array([0.9, 1.1]), 0.016 - TRUTH["magnet_offset"]
    (point,) = stationary_points(rig, currents, PAYLOAD, height).points
    carried = Payload(mass=1.3 * point.lift / 9.80665, moment=PAYLOAD.moment, magnet_offset=0.012)
    read = [0.016], [3.0 * currents], [point.position[:2]]
    found = calibrate(
        rig, carried, positions=PositionReadings(*read, 1e-6, height_held=True), fit=["field_scale"]
    )
    assert found.values["field_scale"] == pytest.approx(1.3, rel=1e-3)
    assert found.misfit < 1.0 < found.misfit_before


@pytest.mark.parametrize(
    ("name", "given", "limits", "end"),
    [
        ("field_scale", {}, {"field_scale": (0.5, 1.1)}, 1.1),
        ("field_scale", {}, {"field_scale": (1.5, 2.0)}, 1.5),
        # A thousandth of the box of 40 mm is left above the highest magnet, or below the lowest.
        ("magnet_offset", {"field_scale": 0.1}, None, 0.022 - 0.02 + 4e-5),
        ("magnet_offset", {"field_scale": 9.0}, None, 0.012 + 0.02 - 4e-5),
    ],
)
def test_what_is_fitted_stays_within_its_limits(rig, name, given, limits, end):
    lift = lift_readings(rig, TRUTH)
    found = calibrate(rig, PAYLOAD, lift=lift, fit=name, given=given, limits=limits)
    assert found.fitted == (name,)
    assert found.values[name] == pytest.approx(end, rel=1e-6)
    assert f"at the bound of {name}" in found.assumptions[-1]


@pytest.mark.parametrize(("weight", "end"), [(30.0, 20.0), (0.03, 0.05)])
def test_scales_are_from_a_twentieth_to_twenty(rig, weight, end):
    """The payload has another weight than the magnet of the readings."""
    other = Payload(weight * PAYLOAD.mass, PAYLOAD.moment, magnet_offset=0.012)
    found = calibrate(rig, other, lift=lift_readings(rig, TRUTH), fit="field_scale")
    assert found.values["field_scale"] == pytest.approx(end, rel=1e-6)
    # A start beyond the limits begins a millionth of their range inside.
    how = {"lift": lift_readings(rig, TRUTH), "fit": "field_scale", "given": {"field_scale": 2.0 * weight}}
    begun = calibrate(rig, other, **how).before["field_scale"]
    assert begun == pytest.approx(end - np.sign(end - 1.0) * 1e-6 * 19.95 if weight > 1 else 0.06, rel=1e-12)


def test_the_covariance_is_the_scatter_of_repeated_readings(rig):
    fits = [calibrate(rig, PAYLOAD, lift=lift_readings(rig, TRUTH, noise=0.02, seed=k)) for k in range(20)]
    scatter = np.std([[f.values[name] for name in f.fitted] for f in fits], axis=0)
    stated = np.mean([list(f.deviations.values()) for f in fits], axis=0)
    # Lift is tanh of the current, so its relative deviation is a little less than the current's.
    np.testing.assert_allclose(scatter, stated, rtol=0.4)


FEW = LiftReadings(SENSED[:1], [[1.0, 1.0]])
TWO = LiftReadings(SENSED[:2], [[1.0, 1.0]] * 2)


@pytest.mark.parametrize(
    ("wrong", "where", "received"),
    [
        ({}, "calibrate", "none"),
        ({"lift": FEW, "fit": ["scale"]}, "calibrate(fit)", "['scale']"),
        ({"lift": FEW}, "calibrate(readings)", "1 readings"),
        ({"lift": FEW, "given": {"offset": 0.01}}, "calibrate(given)", "offset = 0.01"),
        ({"lift": TWO, "given": {"field_scale": np.nan}}, "calibrate(given)", "field_scale = nan"),
        ({"lift": TWO, "fit": []}, "calibrate(fit)", "[]"),
        ({"lift": TWO, "fit": ["gains"] * 2}, "calibrate(fit)", "['gains', 'gains']"),
        (
            {"lift": TWO, "fit": ["gains", "current_scale"]},
            "calibrate(fit)",
            "['gains', 'current_scale']",
        ),
    ],
)
def test_what_cannot_be_fitted_is_said(rig, wrong, where, received):
    with pytest.raises(InputError) as error:
        calibrate(rig, PAYLOAD, **wrong)
    assert [(p.where, p.received) for p in error.value.problems] == [(where, received)]


def test_lift_is_that_of_the_balance(rig):
    """The reading before the fit is the lift that magnet_balance computes."""
    lift = lift_readings(rig, TRUTH)
    found = calibrate(rig, PAYLOAD, lift=lift)
    point = np.array([0.0, 0.0, SENSED[2] - 0.015])
    balance = magnet_balance(rig, np.asarray(lift.currents)[2], PAYLOAD, point)
    assert found.table[2].before == pytest.approx(balance.magnetic_force(point[None])[0, 2] / WEIGHT)

"""Answers about a named field, for a polynomial field: forces by hand, F = m grad Bz, stiffness = -m d2Bz."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.constants import g as gravity

from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.io.answers import floating, least_power, lift_force, lifted, probe, require_box
from fieldmap.lookup.magnetic_body import MagneticBody
from tests.dynamics.conftest import saturating_map

CURRENTS = [0.2, 0.4]  # 0.2 + 0.5 * 0.4 = 0.4 A of the polynomial


def test_points_with_the_force_on_a_moment(polynomial):
    points = np.array([[0.001, 0.002, -0.05], [0.0, 0.0, -0.03]])
    moment = np.array([0.1, 0.0, 0.8])
    answer = probe(polynomial.source(), points, CURRENTS, moment)
    x, y, z = points.T
    radial = -0.5 * (polynomial.b1 + polynomial.b2 * z)
    along = polynomial.b0 + polynomial.b1 * z + 0.5 * polynomial.b2 * (z**2 - 0.5 * (x**2 + y**2))
    flux = 0.4 * np.column_stack([radial * x, radial * y, along])
    np.testing.assert_allclose([p.B for p in answer.points], flux, rtol=1e-14)
    # F_j = m_i dB_i/dx_j: for a moment along x the row of Bx, for a moment along z the row of Bz.
    slope_x = 0.4 * np.column_stack([radial, 0 * x, -0.5 * polynomial.b2 * x])
    slope_z = 0.4 * np.column_stack([-0.5 * polynomial.b2 * x, -0.5 * polynomial.b2 * y, -2 * radial])
    np.testing.assert_allclose([p.force for p in answer.points], 0.1 * slope_x + 0.8 * slope_z, rtol=1e-13)
    np.testing.assert_allclose([p.torque for p in answer.points], np.cross(moment, flux), rtol=1e-13)
    assert answer.assumptions == ("a polynomial",)
    first = answer.to_dicts()[0]
    assert (first["source"], first["coil_names"], first["currents"]) == (
        "poly.h5",
        ["left", "right"],
        CURRENTS,
    )
    assert first["force"] == answer.points[0].force.tolist()


def test_points_without_a_moment_have_no_force(polynomial):
    (row,) = probe(polynomial.source(), np.array([[0.0, 0.0, -0.03]]), CURRENTS).to_dicts()
    assert {"B", "gradient"} <= set(row)
    assert {"moment", "force", "torque"}.isdisjoint(row)


def test_where_it_floats(polynomial):
    # m s (b1 + b2 z) = weight at z = -0.05; stiffness m s b2 / 2 sideways, minus twice that along z.
    strength = 0.010 * gravity / (0.8 * (polynomial.b1 - 0.05 * polynomial.b2))
    answer = floating(polynomial.source(), polynomial.payload, [strength, 0.0])
    np.testing.assert_allclose(answer.found.position, [0, 0, -0.05], atol=1e-9)
    stiffness = 0.8 * strength * polynomial.b2 * np.diag([0.5, 0.5, -1.0])
    np.testing.assert_allclose(answer.found.stiffness, stiffness, rtol=1e-9, atol=1e-12)
    plain = answer.to_dict()
    assert plain["weight"] == pytest.approx(0.010 * gravity)
    assert plain["stable_axes"] == {"x": True, "y": True, "z": False}
    assert "measured" not in plain
    assert plain["assumptions"][-1] == "a polynomial"


def test_what_lifts_it_beside_what_was_measured(polynomial):
    """With the drive unit's names: sensor zero at -77 mm, measured current 0.0343 A/mm reading + 1.215 A, (7-18)."""
    source = polynomial.source(device_name="drive_unit", coil_names=tuple("123456"))
    alone = lifted(polynomial.source(), polynomial.payload, -0.097)
    # 1.5 is the sum of the coils' shares.
    common = 0.010 * gravity / (0.8 * 1.5 * (polynomial.b1 - 0.097 * polynomial.b2))
    assert alone.found.current == pytest.approx(common, rel=1e-12)
    assert (alone.machine, alone.measured_current, alone.current_limit) == (None, None, 3.5)
    measured = type(alone)(source, alone.payload, alone.found, ())
    assert measured.reading_mm == pytest.approx(97 - 77 - 15)
    assert measured.measured_current == pytest.approx(0.0343 * 5.0 + 1.215)
    plain = measured.to_dict()
    assert plain["ratio"] == pytest.approx(common / (0.0343 * 5.0 + 1.215))
    assert plain["measured"] == measured.measured_current


def test_what_cannot_be_asked(polynomial):
    source = polynomial.source()
    with pytest.raises(InputError) as error:
        floating(source, polynomial.payload, CURRENTS, moment="loose")
    assert (error.value.problems[0].where, error.value.problems[0].received) == ("moment", "loose")
    with pytest.raises(OutsideMapError) as outside:
        floating(source, polynomial.payload, CURRENTS, start=np.array([0.0, 0.0, 0.5]))
    assert outside.value.problems[0].where == "start"
    with pytest.raises(OutsideMapError):
        lifted(source, polynomial.payload, 0.5)
    with pytest.raises(InputError) as error:
        require_box(polynomial.source(bounds=None))
    assert error.value.problems[0].where == "poly.h5"


class Body(MagneticBody):
    """A body whose load depends on the point in a known way."""

    assumptions = ("a body",)

    moments = np.array([[0.0, 0.0, -0.3], [0.0, 0.0, 0.1]])

    def __init__(self):
        pass

    def wrench(self, field, points, currents):
        return np.hstack([points, 10.0 * points]) * currents[0]

    def whole_moment(self, field, points, currents):
        return points + 1.0


def test_points_with_the_load_on_a_body(polynomial):
    points = np.array([[0.001, 0.002, -0.05], [0.003, 0.004, -0.03]])
    answer = probe(polynomial.source(), points, CURRENTS, Body())
    assert answer.held == "moment down, fixed"
    for point, found in zip(points, answer.points, strict=True):
        np.testing.assert_allclose(found.force, 0.2 * point, rtol=1e-15)
        np.testing.assert_allclose(found.torque, 2.0 * point, rtol=1e-15)
        np.testing.assert_allclose(found.moment, point + 1.0, rtol=1e-15)
        np.testing.assert_allclose(found.at, point)
    assert answer.assumptions == ("a polynomial", "a body")
    plain = answer.to_dicts()
    assert [row["at"] for row in plain] == points.tolist()
    assert [row["assumptions"] for row in plain] == [["a polynomial", "a body"]] * 2
    assert plain[1]["kind"] == "map"


def test_currents_of_least_power_for_a_force(polynomial):
    """F = m dBz/dz s with s = I_1 + I_2 / 2: least squares for one number s give s (1, 1/2) / 1.25."""
    source, at, moment = polynomial.source(), np.array([0.0, 0.0, -0.05]), np.array([0.0, 0.0, 0.8])
    wanted = np.array([np.nan, np.nan, 0.06])
    answer = least_power(source, at, moment, force=wanted)
    s = 0.06 / (0.8 * (polynomial.b1 - 0.05 * polynomial.b2))
    np.testing.assert_allclose(answer.currents, [s / 1.25, s / 2.5], rtol=1e-9)
    assert answer.sum_of_squares == pytest.approx(s**2 / 1.25, rel=1e-9)
    plain = answer.to_dict()
    assert (plain["asked"], plain["limit"]) == ({"force": [None, None, 0.06]}, None)
    assert plain["by_name"] == {"left": answer.currents[0], "right": answer.currents[1]}
    assert plain["sum_of_squares"] == answer.sum_of_squares
    assert plain["force"] == pytest.approx([0.0, 0.0, 0.06], abs=1e-12)
    assert (plain["at"], plain["source"]) == (at.tolist(), "poly.h5")


def test_currents_of_least_power_for_a_field_within_a_limit(polynomial):
    """Bz = b s: beyond the first coil's limit the second coil adds the rest, with twice the current."""
    source, at = polynomial.source(), np.array([0.0, 0.0, -0.05])
    b = polynomial.b0 - 0.05 * polynomial.b1 + 0.5 * polynomial.b2 * 0.05**2
    asked = {"field": np.array([np.nan, np.nan, 0.5 * b]), "force": None, "torque": None}
    free = least_power(source, at, **asked)
    np.testing.assert_allclose(free.currents, [0.4, 0.2], rtol=1e-9)
    assert list(free.asked) == ["field"]
    limited = least_power(source, at, None, 0.36, **asked)
    np.testing.assert_allclose(limited.currents, [0.36, 0.28], rtol=1e-6)
    assert (limited.limit, limited.to_dict()["B"][2]) == (0.36, pytest.approx(0.5 * b))
    with pytest.raises(Infeasible):
        least_power(source, at, None, 0.3, **asked)


@pytest.mark.parametrize(("coils", "free"), [(1, True), (2, True), (3, False), (4, False), (6, False)])
def test_a_weight_to_be_carried(polynomial, coils, free):
    """Two coils cannot control three components."""
    sideways = np.nan if free else 0.0
    np.testing.assert_array_equal(
        lift_force(polynomial.payload, coils), [sideways, sideways, 0.010 * gravity]
    )


def test_without_a_payload_there_is_nothing_to_carry():
    with pytest.raises(InputError) as error:
        lift_force(None, 6)
    assert error.value.problems[0].where == "--lift(payload)"


@pytest.mark.parametrize("offset", [0.0, 0.015, -0.015])
@pytest.mark.parametrize(("device", "coils"), [("rig", 2), ("rig", 6), ("drive_unit", 6), ("drive_unit", 2)])
def test_a_reading_needs_a_machine_whose_sensor_was_measured(polynomial, offset, device, coils):
    source = polynomial.source(device_name=device, coil_names=tuple("123456")[:coils], driver=None)
    answer = lifted(polynomial.source(), replace(polynomial.payload, magnet_offset=offset), -0.09)
    there = replace(answer, source=source)
    unknown = (device, coils) != ("drive_unit", 6)
    assert there.reading_mm == (None if unknown else pytest.approx(90 - 77 - 1e3 * offset))
    assert (there.machine is None) == unknown
    assert (there.measured_current is None) == unknown
    assert there.current_limit is None
    plain = there.to_dict()
    told = {"sensor_mm": there.reading_mm, "mass": 0.010, "weight": 0.010 * gravity}
    told |= {"moment_magnitude": 0.8, "magnet_offset": offset, "current_limit": None, "kind": "map"}
    told |= {"measured": there.measured_current, "coil_names": list(source.coil_names), "source": "poly.h5"}
    assert {name: plain[name] for name in told} == told
    assert (plain["ratio"] is None) == unknown
    assert answer.to_dict()["current_limit"] == 3.5


def test_a_search_begins_where_it_is_told_to(polynomial, monkeypatch):
    """Place, currents and model of the magnet are passed on unchanged."""
    asked = []

    def found(*given):
        asked.append(given)
        return SimpleNamespace(assumptions=("of the search",), currents=np.array(CURRENTS))

    monkeypatch.setattr("fieldmap.levitation.find_equilibrium", found)
    source, start = polynomial.source(), np.array([0.001, 0.0, -0.05])
    for moment in ("fixed", "aligned"):
        answer = floating(source, polynomial.payload, {"right": 0.4}, start, moment)
        field, currents, payload, place, model = asked.pop()
        assert (field, payload, model) == (source.field, polynomial.payload, moment)
        np.testing.assert_array_equal(currents, [0.0, 0.4])
        np.testing.assert_array_equal(place, start)
        assert answer.assumptions == ("of the search", "a polynomial")
    floating(source, polynomial.payload, CURRENTS)
    assert asked.pop()[3:] == (None, None)


def test_a_current_is_searched_from_the_reference_of_a_map_that_saturates(polynomial, monkeypatch):
    asked = []

    def lift_current(field, payload, point, first, on_state):
        asked.append((point.tolist(), first, on_state))
        return SimpleNamespace(assumptions=("of the search",), currents=np.ones(2))

    monkeypatch.setattr("fieldmap.levitation.lift_current", lift_current)
    field = saturating_map()
    monkeypatch.setattr(
        type(field), "info", SimpleNamespace(reference_current=np.array([1.5, 2.0, 4.0])), raising=False
    )
    saturating = polynomial.source(field=field, coil_names=field.coil_names)
    monkeypatch.setattr(type(saturating), "assumptions", lambda self, currents=None: ("of the field",))
    tell = print
    assert lifted(saturating, polynomial.payload, -0.05, tell).assumptions == (
        "of the search",
        "of the field",
    )
    lifted(polynomial.source(), polynomial.payload, -0.06)
    # A device has no reference currents.
    lifted(replace(saturating, device="a device"), polynomial.payload, -0.07)
    assert asked == [([0, 0, -0.05], 2.5, tell), ([0, 0, -0.06], 1.0, None), ([0, 0, -0.07], 1.0, None)]

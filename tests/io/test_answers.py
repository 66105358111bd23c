"""Answers about a named field, against a polynomial field: forces by hand, F = m grad Bz, stiffness = -m d2Bz."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import g as gravity

from fieldmap.errors import InputError, OutsideMapError
from fieldmap.io.answers import floating, lifted, probe, require_box

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
    # F_j = m_i dB_i/dx_j: of the moment along x, the row of Bx; of that along z, the row of Bz.
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
    # m s (b1 + b2 z) = weight at z = -0.05; stiff sideways by m s b2 / 2, soft along z by twice that.
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
    """The names of the drive unit's map: 0 of the sensor at -77 mm, measured 0.0343 A/mm reading + 1.215 A, (7-18)."""
    source = polynomial.source(device_name="drive_unit", coil_names=tuple("123456"))
    alone = lifted(polynomial.source(), polynomial.payload, -0.097)
    # 1.5 = the sum of the shares of a common current.
    common = 0.010 * gravity / (0.8 * 1.5 * (polynomial.b1 - 0.097 * polynomial.b2))
    assert alone.found.current == pytest.approx(common, rel=1e-12)
    assert (alone.machine, alone.measured_current, alone.current_limit) == (None, None, 3.5)
    assert alone.has_sensor
    assert alone.reading_mm == pytest.approx(97 - 77 - 15)
    measured = type(alone)(source, alone.payload, alone.found, ())
    assert measured.measured_current == pytest.approx(0.0343 * 5.0 + 1.215)
    plain = measured.to_dict()
    assert plain["ratio"] == pytest.approx(common / (0.0343 * 5.0 + 1.215))
    assert plain["measured"] == measured.measured_current


def test_a_payload_without_an_offset_on_an_unknown_machine_has_no_reading(polynomial):
    answer = lifted(polynomial.source(), replace(polynomial.payload, magnet_offset=0.0), -0.05)
    assert not answer.has_sensor


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

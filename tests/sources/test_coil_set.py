"""Coils alone as a field: the sum of unit fields, and derivatives against closed forms."""

import numpy as np
import pytest
from scipy.constants import mu_0

from fieldmap.device.model import CircularCoil, Placement, RoundedRectangleCoil
from fieldmap.errors import InputError
from fieldmap.field import Field, FieldAtCurrents
from fieldmap.sources import CoilSet, unit_flux_density_and_gradient

COILS = (
    CircularCoil("left", 0.011, 0.021, 0.039, 840.0, placement=Placement(np.array([-0.03, 0.0, 0.0]))),
    RoundedRectangleCoil("right", 0.016, 0.012, 0.009, 0.010, 0.039, 500.0, -1, Placement(np.full(3, 0.02))),
)
POINTS = np.random.default_rng(5).uniform(-0.03, 0.03, (7, 3)) - [0.0, 0.0, 0.08]
CURRENTS = np.array([1.5, -0.7])


def on_axis(coil, z):
    """Bz on the axis of a circular coil, per ampere: the integral of the loop's field over the section."""
    a, b = coil.inner_radius, coil.outer_radius
    density = coil.turns / ((b - a) * coil.height)

    def from_level(t):
        return t * np.log((b + np.hypot(b, t)) / (a + np.hypot(a, t)))

    return 0.5 * mu_0 * density * (from_level(z + coil.height / 2) - from_level(z - coil.height / 2))


def test_it_is_a_field_of_proportional_coils():
    coils = CoilSet(COILS)
    assert isinstance(coils, Field)
    assert isinstance(coils, Field)
    assert isinstance(coils.at(CURRENTS), FieldAtCurrents)
    assert coils.proportional
    assert coils.coil_names == ("left", "right")
    assert coils.bounds is None
    box = np.zeros(3), np.ones(3)
    assert CoilSet(COILS, box).bounds is box


def test_field_and_gradient_are_sums_of_unit_fields():
    coils = CoilSet(COILS)
    units = [unit_flux_density_and_gradient(coil, POINTS) for coil in COILS]
    flux = sum(current * unit[0] for current, unit in zip(CURRENTS, units, strict=True))
    slope = sum(current * unit[1] for current, unit in zip(CURRENTS, units, strict=True))
    assert coils.field(POINTS, CURRENTS) == pytest.approx(flux, rel=1e-9)
    assert coils.gradient(POINTS, CURRENTS) == pytest.approx(slope, rel=1e-9, abs=1e-14)
    state = coils.at({"right": -0.7, "left": 1.5})
    np.testing.assert_array_equal(state.field(POINTS), coils.field(POINTS, CURRENTS))
    np.testing.assert_array_equal(state.gradient(POINTS[0]), coils.gradient(POINTS[0], CURRENTS))
    assert coils.field(POINTS[0], CURRENTS).shape == (3,)


def test_a_row_of_currents_for_every_point():
    coils = CoilSet(COILS)
    rows = np.random.default_rng(6).normal(size=(len(POINTS), 2))
    rows[2] = 0.0
    expected = [coils.field(point, row) for point, row in zip(POINTS, rows, strict=True)]
    np.testing.assert_allclose(coils.field(POINTS, rows), expected, rtol=1e-9, atol=1e-18)
    slopes = [coils.gradient(point, row) for point, row in zip(POINTS, rows, strict=True)]
    np.testing.assert_allclose(coils.gradient(POINTS, rows), slopes, rtol=1e-9, atol=1e-15)


def test_derivatives_on_the_axis_against_the_closed_form():
    coil = CircularCoil("c", 0.011, 0.021, 0.039, 840.0)
    coils = CoilSet([coil])
    z = np.array([0.025, 0.04, 0.08])
    points = np.column_stack([np.zeros((3, 2)), z])
    # Differences of sixth order in z, with errors far below the tolerances.
    h = 2e-4
    samples = np.array([on_axis(coil, z + k * h) for k in range(-3, 4)])
    first = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60 @ samples / h
    second = np.array([2, -27, 270, -490, 270, -27, 2]) / 180 @ samples / h**2
    assert coils.field(points, 1.0)[:, 2] == pytest.approx(on_axis(coil, z), rel=1e-9)
    assert coils.gradient(points, 1.0)[:, 2, 2] == pytest.approx(first, rel=1e-7)
    # Central differences of the gradient over 0.1 mm: 1e-4 at 5 mm from the winding, less farther away.
    found = coils.second_gradient(points, 1.0)[:, 2, 2, 2]
    assert found == pytest.approx(second, rel=1e-4)
    assert found[2] == pytest.approx(second[2], rel=1e-5)


def test_the_second_gradient_outside_the_windings_is_symmetric_and_trace_free():
    second = CoilSet(COILS).second_gradient(POINTS, CURRENTS)
    scale = np.abs(second).max()
    for axes in ((0, 1, 3, 2), (0, 2, 1, 3), (0, 3, 2, 1)):
        assert np.abs(second - second.transpose(axes)).max() < 5e-5 * scale
    assert np.abs(np.trace(second, axis1=1, axis2=2)).max() < 5e-5 * scale


def test_wrongly_many_currents_are_refused():
    with pytest.raises(InputError) as caught:
        CoilSet(COILS).field(POINTS, [1.0, 2.0, 3.0])
    assert caught.value.problems[0].where == "currents"


def test_without_coils_there_is_no_field():
    assert not CoilSet(()).field(POINTS, ()).any()

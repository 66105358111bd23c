import numpy as np
import pytest

from fieldmap.device.model import Payload
from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.levitation import find_equilibrium, lift_current

PAYLOAD = Payload(mass=0.01119, moment=0.813)
WEIGHT = 0.01119 * 9.80665
COEFFICIENTS = (0.02, 0.03, 0.6, 0.0)


def test_closed_form(axisymmetric):
    """D I (2 c2 + 6 c3 z) = m g."""
    lift = lift_current(axisymmetric(COEFFICIENTS), PAYLOAD, [0, 0, 0.02])
    assert lift.current == pytest.approx(WEIGHT / (0.813 * (0.06 + 3.6 * 0.02)), rel=1e-12)
    np.testing.assert_allclose(lift.force, [0, 0, WEIGHT], atol=1e-15)
    assert "linear" in lift.assumptions[0]


def test_the_equilibrium_of_the_lift_current_is_where_it_was_asked_for(axisymmetric):
    source = axisymmetric(COEFFICIENTS)
    lift = lift_current(source, PAYLOAD, [0, 0, 0.013], shares=[2.0])
    assert lift.currents == pytest.approx([2.0 * lift.current])
    found = find_equilibrium(source, lift.currents, PAYLOAD)
    np.testing.assert_allclose(found.position, [0, 0, 0.013], atol=1e-9)
    np.testing.assert_allclose(found.stiffness, lift.stiffness, rtol=1e-9, atol=1e-12)


def test_off_the_axis_the_sideways_force_is_reported(axisymmetric):
    lift = lift_current(axisymmetric(COEFFICIENTS), PAYLOAD, [0.005, 0, 0.02])
    # F_x = -3 I D c3 x
    assert lift.force[0] == pytest.approx(-3 * lift.current * 0.813 * 0.6 * 0.005, rel=1e-12)


def test_a_uniform_field_lifts_nothing(axisymmetric):
    with pytest.raises(Infeasible):
        lift_current(axisymmetric((0.02, 0.0, 0.0, 0.0)), PAYLOAD, [0, 0, 0])


def test_a_field_that_saturates_is_refused(axisymmetric):
    class Saturating(axisymmetric):
        def gradient(self, points, currents):
            return super().gradient(points, np.tanh(currents))

    with pytest.raises(InputError, match="not linear"):
        lift_current(Saturating(COEFFICIENTS), PAYLOAD, [0, 0, 0.02])


def test_outside_and_wrong_shares(axisymmetric):
    with pytest.raises(OutsideMapError):
        lift_current(axisymmetric(COEFFICIENTS), PAYLOAD, [0, 0, 0.2])
    with pytest.raises(InputError, match="one finite current"):
        lift_current(axisymmetric(COEFFICIENTS), PAYLOAD, [0, 0, 0.02], shares=[1.0, 1.0])

"""Levitated plants against differences and closed forms; step metrics; the compensator of 7.1.2."""

import numpy as np
import pytest

from fieldmap import control
from fieldmap.control import LumpedMagnet, compensated_reference, levitated_plant, step_metrics
from fieldmap.errors import InputError

MAGNET = LumpedMagnet(inductance=0.02, length=0.035, mass=0.0112, damping=0.05)
Z = 0.012


def test_force_is_half_the_slope_of_the_inductance():
    """(2-18) with (2-19), by differences; L1 drops out."""
    inductance = [0.7 + 0.02 / (1 + z / 0.035) for z in (Z - 1e-6, Z + 1e-6)]
    assert MAGNET.force(Z, 1.4) == pytest.approx(0.5 * np.diff(inductance)[0] / 2e-6 * 1.4**2, rel=1e-8)


def test_equilibrium_current_carries_the_weight():
    assert abs(MAGNET.acceleration(Z, 0.0, MAGNET.equilibrium_current(Z))) < 1e-12


def test_linearised_plant_is_the_derivative():
    """(2-21): Taylor test, second order in the excursion."""
    plant, current = MAGNET.plant(Z), MAGNET.equilibrium_current(Z)
    direction = np.array([0.3, 2.0, 1.0])

    def rest(h):
        dz, dv, di = h * direction * [1e-3, 1e-2, 1e-1]
        linear = plant.A[1] @ [dz, dv] + plant.B[1, 0] * di
        return abs(MAGNET.acceleration(Z + dz, dv, current + di) - linear)

    orders = [np.log2(rest(h) / rest(h / 2)) for h in (0.1, 0.05)]
    assert min(orders) > 1.9


def test_gain_at_rest_is_the_slope_of_the_equilibrium():
    """dz/di of the plant at rest = 1 / (d i_eq / dz), by differences."""
    model = MAGNET.plant(Z)
    gain = -(model.C @ np.linalg.solve(model.A, model.B)).item()
    slope = (MAGNET.equilibrium_current(Z + 1e-6) - MAGNET.equilibrium_current(Z - 1e-6)) / 2e-6
    assert gain == pytest.approx(1 / slope, rel=1e-8)


def test_matched_to_a_measured_law():
    magnet = control.lumped_magnet_from_lift_currents(1.215, 34.3, mass=0.01119)
    z = np.linspace(0, 0.03, 5)
    np.testing.assert_allclose([magnet.equilibrium_current(x) for x in z], 1.215 + 34.3 * z, rtol=1e-13)


def test_linked_axes_are_those_of_the_matrices():
    """Eigenvalues k of the coupled stiffness give poles +- sqrt(-k/m); force enters the velocities."""
    K = np.array([[5.0, 1.0, 0.2], [1.0, 3.0, -0.4], [0.2, -0.4, -8.0]])
    force = np.arange(6.0).reshape(3, 2)
    model = levitated_plant(0.02, K, force)
    squares = np.sort_complex(np.linalg.eigvals(model.A) ** 2).real
    np.testing.assert_allclose(squares, np.repeat(np.sort(-np.linalg.eigvalsh(K) / 0.02), 2), rtol=1e-9)
    np.testing.assert_allclose(model.B[3:], force / 0.02)
    assert not model.B[:3].any()


def test_damping_of_each_axis():
    both = levitated_plant(0.1, np.eye(2), np.eye(2), damping=0.3)
    np.testing.assert_allclose(both.A[2:, 2:], -3.0 * np.eye(2))


@pytest.mark.parametrize("zeta", [0.2, 0.5])
def test_metrics_of_the_second_order(zeta):
    """Peak at pi/wd, overshoot exp(-pi zeta / sqrt(1 - zeta^2)) of the standard system, w0 = 1."""
    wd = np.sqrt(1 - zeta**2)
    t = np.linspace(0, 60, 60001)
    y = 1 - np.exp(-zeta * t) * (np.cos(wd * t) + zeta / wd * np.sin(wd * t))
    metrics = step_metrics(t, 3.0 + 2.0 * y, initial=3.0, final=5.0)
    assert metrics.peak_time == pytest.approx(np.pi / wd, abs=1e-3)
    assert metrics.overshoot == pytest.approx(np.exp(-np.pi * zeta / wd), rel=1e-6)
    assert metrics.settling_time <= -np.log(0.02 * wd) / zeta  # where the envelope enters the band
    assert metrics.settling_time > 0.7 * -np.log(0.02) / zeta
    assert metrics.steady_rms < 1e-3


def test_metrics_of_a_step_down_are_those_of_a_step_up():
    t = np.linspace(0, 10, 1001)
    y = 1 - np.exp(-t) * np.cos(3 * t)
    assert step_metrics(t, -2 * y, final=-2.0).overshoot == pytest.approx(step_metrics(t, y).overshoot)


def test_what_is_not_reached_is_infinite():
    metrics = step_metrics([0.0, 1.0, 2.0], [0.0, 0.1, 0.5])
    assert metrics.rise_time == np.inf
    assert metrics.settling_time == np.inf
    assert metrics.overshoot == 0.0
    # Between two samples the response is a straight line, so two samples are enough.
    assert step_metrics([0.0, 2.0], [0.0, 1.25]).rise_time == pytest.approx(0.8 / 1.25 * 2.0)


def test_steady_error():
    t = np.linspace(0, 1, 401)
    assert step_metrics(t, 1.0 + 0.1 * np.where(np.arange(401) % 2, 1, -1)).steady_rms == pytest.approx(0.1)


def test_compensator():
    """7.1.2: 0.05 mm less for 10 ms after a rise, more after a fall; nothing at the beginning."""
    horizontal = np.repeat([0.0, 1e-4, 5e-5], [10, 20, 10])
    reference = compensated_reference(0.010, horizontal, 2e-3, push=5e-5, duration=0.010)
    push = 0.010 - reference
    np.testing.assert_allclose(push[10:15], 5e-5)
    np.testing.assert_allclose(push[30:35], -5e-5)
    assert np.abs(np.delete(push, [*range(10, 15), *range(30, 35)])).max() == 0.0


def test_a_change_during_a_push_begins_a_new_one():
    reference = compensated_reference(np.zeros(8), [0, 1, 1, 0, 0, 0, 0, 0], Ts=1.0, push=2.0, duration=3.0)
    np.testing.assert_allclose(reference, [0, -2, -2, 2, 2, 2, 0, 0])


@pytest.mark.parametrize(
    "broken",
    [
        lambda: compensated_reference(0.01, [0.0, np.nan], 2e-3, 5e-5, 0.010),
        lambda: compensated_reference(0.01, [0.0], 0.0, 5e-5, 0.010),
        lambda: levitated_plant(0.0, 1.0, 1.0),
        lambda: levitated_plant(0.1, np.nan, 1.0),
        lambda: levitated_plant(0.1, np.ones((2, 3)), np.ones((2, 1))),
        lambda: levitated_plant(0.1, np.eye(2), np.ones((3, 1))),
        lambda: levitated_plant(0.1, 1.0, 1.0, damping=np.inf),
        lambda: LumpedMagnet(0.02, 0.0, 0.01),
        lambda: MAGNET.force(-1.0, 1.0),
        lambda: step_metrics([0.0, 0.0], [0.0, 1.0]),
        lambda: step_metrics([0.0, 1.0], [0.0, np.inf]),
        lambda: step_metrics([0.0, 1.0], [0.0, 1.0], final=0.0),
        lambda: step_metrics([0.0, 1.0], np.zeros((2, 2))),
    ],
)
def test_bad_input(broken):
    with pytest.raises(InputError):
        broken()

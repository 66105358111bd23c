"""The linear machine against the nonlinear one, against closed forms, and against python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest

from fieldmap.control import PID
from fieldmap.control.margins import margins_of_curves
from fieldmap.dynamics import (
    AxisReading,
    CoilDrive,
    Schedule,
    Sensors,
    close_loop,
    controllability,
    coupling,
    find_operating_point,
    linear_points,
    linearise,
    margins,
    modes,
    pid_block,
    prepare,
    read_scenario,
    simulate_closed_loop,
    stacked,
)
from fieldmap.dynamics.linear_loop import (
    ClosedLoop,
    sampled_machine,
    sensor_answer,
    shares_of_the_past,
)
from fieldmap.dynamics.linearisation import moved_state
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.instruments import Amplifier, Micrometer, SensorFrame, watch
from tests.dynamics.machines import CURVE, GAIN, MASS, MOMENT, PERIOD, QUIET, SLOPE, one_coil


@pytest.fixture
def machine(axial):
    """One coil whose 2 A carry the body at the origin; nothing drives the body sideways."""
    return one_coil(axial, upright=True)


@pytest.fixture
def linear(machine):
    # Height and horizontal places are given or solved for; the lift is solved for.
    return linearise(machine, find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [5.0]))


def test_one_coil_has_its_closed_form(linear):
    """m z'' = m_z (b1 + b2 z) i - m g - c z', m x'' = -m_z b2 x i / 2 - c x'."""
    up = MOMENT * CURVE * 2.0 / MASS
    wanted = np.block([[np.zeros((3, 3)), np.eye(3)], [np.diag([-up / 2, -up / 2, up]), -5.0 * np.eye(3)]])
    np.testing.assert_allclose(linear.A, wanted, atol=1e-6 * up)
    np.testing.assert_allclose(linear.B[:, 0], [0, 0, 0, 0, 0, GAIN * MOMENT * SLOPE / MASS], atol=1e-9)
    found = [(set(mode.named_shares(linear)), mode.pole) for mode in modes(linear)]
    upright = sorted(pole.real for moves, pole in found if moves == {"z"})
    assert upright == pytest.approx([-2.5 - np.sqrt(6.25 + up), -2.5 + np.sqrt(6.25 + up)])
    # x and y have equal poles, so any mixture of the two is a mode.
    sideways = [pole for moves, pole in found if moves <= {"x", "y"}]
    assert len(sideways) == 4
    np.testing.assert_allclose([pole.real for pole in sideways], -2.5, rtol=1e-6)
    np.testing.assert_allclose([abs(pole.imag) for pole in sideways], np.sqrt(up / 2 - 6.25), rtol=1e-6)


def test_what_no_coil_moves_is_out_of_reach(linear):
    found = controllability(linear)
    assert found.controllability < 1e-9
    assert found.observability > 1e-2
    assert abs(found.worst_input.imag) > 1
    upward = linear.only(("z", "velocity_z"))
    assert controllability(upward).controllability > 1.0
    assert {mode.input_gains.max() > 1 for mode in modes(upward)} == {True}
    # Only modes faster than the bound count: the unstable one, or none.
    (rising,) = (pole.real for pole in np.linalg.eigvals(linear.A) if pole.real > 1.0)
    assert controllability(linear, rising - 0.5).worst_input == pytest.approx(rising)
    assert controllability(linear, rising - 0.5).controllability > 1e-3
    assert controllability(linear, rising + 1e-6).controllability == np.inf
    with pytest.raises(InputError, match="turn_x"):
        linear.only(("turn_x",))


def test_modes_are_measured_in_units_of_a_size(axial):
    """Sizes: 1 mm, 0.1 rad, the same per 0.1 s, and 0.1 A."""
    drive = CoilDrive(Amplifier(GAIN), 1, time_constant=4e-3)
    machine = one_coil(axial, drive)
    found = linearise(machine, find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [5.0]))
    sizes = {"turn": 0.1, "angular": 1.0, "velocity": 1e-2, "i1": 0.1, "x": 1e-3, "y": 1e-3, "z": 1e-3}
    units = np.array([sizes[name.split("_")[0]] for name in found.states])
    assert len(units) == 13
    A, B, C = found.A / units[:, None] * units, found.B / units[:, None], found.C * units / 1e-3
    (rising,) = (pole for pole in np.linalg.eigvals(A) if pole.real > 1.0)
    beside = np.column_stack([A - rising * np.eye(13), B])
    below = np.vstack([A - rising * np.eye(13), C])
    least = [np.linalg.svd(each, compute_uv=False)[-1] for each in (beside, below)]
    asked = controllability(found, 1.0)
    assert [asked.controllability, asked.observability] == pytest.approx(least, rel=1e-6)


def test_time_constants_of_amplifiers_are_states(machine):
    slow = replace(machine, drive=CoilDrive(Amplifier(GAIN), 1, time_constant=4e-3))
    found = linearise(slow, find_operating_point(slow, [np.nan, np.nan, 5e-3], [np.nan], [5.0]))
    assert found.states[-1] == "i1"
    assert min(mode.pole.real for mode in modes(found)) == pytest.approx(-250.0)
    fast = linearise(machine, found.operating_point)
    np.testing.assert_allclose(
        -found.C @ np.linalg.solve(found.A, found.B), -fast.C @ np.linalg.solve(fast.A, fast.B)
    )


def test_an_integrator_has_a_pole_of_zero_and_no_damping(axial):
    """About the magnet's axis only a drag of 1e-5 N m s acts; the inertia is 2e-7 kg m^2."""
    turning = one_coil(axial)
    for drag, slower in ((turning.drag, -1e-5 / 2e-7), (None, 0.0)):
        machine = replace(turning, drag=drag)
        found = linearise(machine, find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [5.0]))
        about_z = [mode for mode in modes(found) if mode.named_shares(found, 0.99).keys() == {"turn_z"}]
        np.testing.assert_allclose([mode.pole for mode in about_z], [0.0, slower], rtol=1e-6)
        assert np.isnan([mode.damping for mode in about_z]).tolist() == [True, drag is None]


def test_a_rest_at_the_edge_of_the_map_is_refused(machine):
    rest = find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [5.0])
    state = rest.state.copy()
    state[2] = 0.0199
    with pytest.raises(OutsideMapError, match=r"0\.4 mm"):
        linearise(machine, replace(rest, state=state))


def difference(experiment, linear, loop, size, periods=60):
    """Largest difference between the nonlinear and the linear loop, relative to the disturbance."""
    disturbed = np.array([1.0, -0.7, 0.5, 8.0, -6.0, 0.0, 5.0, 3.0, -4.0, 0.0, 0.0, 0.0])
    deviation, point = size * disturbed[: len(linear.states)], experiment.operating_point
    state = moved_state(linear, deviation)
    schedule = Schedule(np.tile(point.sensed, (periods, 1)), PERIOD, 2e-5, experiment.schedule.delay)
    driven = experiment.machine, experiment.controller, schedule
    run = simulate_closed_loop(*driven, state, point.currents, None)
    here, path = np.zeros(len(loop.A)), []
    here[: len(deviation)] = deviation
    for _ in range(periods):
        path.append(loop.C @ here)
        here = loop.A @ here
    return np.abs(run.sensed - point.sensed - path).max() / size


def test_the_nonlinear_loop_comes_to_the_linear_one_with_the_square_of_what_disturbs(six):
    """Taylor test of the whole loop: a turning body, coils, delay, controllers of three axes."""
    experiment = prepare(read_scenario("vertical_step", QUIET), six)
    linear = linearise(experiment.machine, experiment.operating_point)
    assert linear.states == (
        *("x", "y", "z", "turn_x", "turn_y", "turn_z", "velocity_x", "velocity_y", "velocity_z"),
        *("angular_velocity_x", "angular_velocity_y", "angular_velocity_z"),
    )
    loop = close_loop(linear, experiment.controller, experiment.schedule)
    relative = [difference(experiment, linear, loop, size) for size in (4e-4, 2e-4, 1e-4)]
    np.testing.assert_allclose(np.log2(np.divide(relative[:-1], relative[1:])), 1.0, atol=0.1)
    assert relative[-1] < 0.05


def test_a_body_that_keeps_its_direction_obeys_earnshaw(six):
    experiment = prepare(read_scenario("vertical_step", {"reference.0.by_mm": 0.0}), six)
    linear = linearise(experiment.machine, experiment.operating_point)
    K = linear.A[3:, :3]
    # To the jumps of the map between cells.
    np.testing.assert_allclose(K, K.T, atol=2e-5 * np.abs(K).max())
    assert abs(np.trace(K)) < 5e-4 * np.abs(K).max()
    # Six coils on a circle: on its axis each signal moves only its own direction.
    found = coupling(linear)
    np.testing.assert_allclose(found.relative, np.eye(3), atol=1e-3)
    np.testing.assert_allclose(found.relative.sum(axis=0), 1.0)


@pytest.mark.parametrize("delay", [0.0, 0.5e-3, 2e-3])
def test_sampling_holds_what_the_controller_said_last(linear, delay):
    """Against python-control with the period divided into pieces as long as the delay."""
    piece = 0.5e-3
    fine = control.c2d(control.ss(*linear.model), piece)
    found = sampled_machine(linear, PERIOD, delay)
    x, before, now = np.linspace(1.0, 2.0, 6), 0.7, -0.4
    there = x
    for k in range(4):
        held = before if k * piece < delay - 1e-9 else now
        there = fine.A @ there + fine.B[:, 0] * held
    np.testing.assert_allclose(
        found.A @ x + found.B[:, 0] * now + found.before[:, 0] * before, there, rtol=1e-9
    )


@pytest.mark.parametrize(("middle", "up", "down"), [(1.2, np.exp(1.3), 0.0), (3.5, np.inf, np.exp(-1.0))])
def test_margins_of_a_curve_that_is_straight_in_the_logarithm_are_exact_on_any_frequencies(middle, up, down):
    """-l = (f0 / f) exp(i (1 - 0.4 log f)): |l| = 1 at f0, and the angle passes 0 at log f = 2.5."""
    frequencies = np.exp(np.linspace(0.0, 4.6, 8))
    x = np.log(frequencies)
    curve = -np.exp(middle - x + 1j * (1.0 - 0.4 * x))
    # A second curve of half the size has another crossover and does not change the first result.
    found = margins_of_curves(frequencies, np.array([curve, curve / 2.0]))
    above, below, phase, crossover, _ = found[:, 0]
    assert crossover == pytest.approx(np.exp(middle), rel=1e-9)
    assert phase == pytest.approx(np.rad2deg(abs(1.0 - 0.4 * middle)), rel=1e-9)
    assert (above, below) == pytest.approx((up, down), rel=1e-9)
    assert found[3, 1] == pytest.approx(np.exp(middle) / 2.0, rel=1e-9)


def test_margins_are_those_of_python_control(linear, machine):
    # With the trapezoidal rule the polynomials of python-control lose 1 degree of the phase margin to rounding.
    pid = pid_block(PID(2.0, 0.4, 0.06, PERIOD, integration="rectangular"), AxisReading("z", 1e3))
    loop = close_loop(linear, pid, Schedule(np.zeros((2, 3)), PERIOD, delay=1e-3))
    assert loop.stable
    (found,) = margins(loop, ("lift",))
    plant = sampled_machine(linear.only(("z", "velocity_z")), PERIOD, 1e-3)
    A = np.block([[plant.A, plant.before], [np.zeros((1, 3))]])
    late = control.ss(A, np.vstack([plant.B, [[1.0]]]), [[1.0, 0, 0]], 0, PERIOD)
    own = control.ss(pid.A, pid.B[:, 5:6], pid.C, pid.D[:, 5:6], PERIOD)
    gm, pm, sm, _, wpc, _ = control.stability_margins(-own * late)
    assert found.phase == pytest.approx(pm, rel=1e-3)
    assert found.crossover == pytest.approx(wpc / 2 / np.pi, rel=1e-3)
    assert found.modulus == pytest.approx(sm, rel=1e-3)
    assert found.gain_up == pytest.approx(gm if gm > 1 else found.gain_up, rel=1e-3)
    scanning = margins(loop, ("lift",), Sensors(scan_rate=1200.0, averages=4))[0]
    late_by = (3 / 2 + 4 / 2) / 1200.0
    assert found.phase - scanning.phase == pytest.approx(360 * late_by * found.crossover, rel=0.15)


def test_an_unstable_sway_leaves_the_margins_of_the_lift(linear):
    """For a machine with unstable x; then z also depends on x, and x on z."""
    pid = pid_block(PID(2.0, 0.4, 0.06, PERIOD), AxisReading("z", 1e3))
    at, A = linear.states.index, linear.A.copy()
    A[at("velocity_x"), at("x")] *= -1.0

    def found(A, block=pid):
        loop = close_loop(replace(linear, A=A), block, Schedule(np.zeros((2, 3)), PERIOD, delay=1e-3))
        return loop.stable, margins(loop, ("lift",))

    stable, (before,) = found(linear.A)
    unstable, (after,) = found(A)
    assert (stable, unstable) == (True, False)
    numbers = ("gain_up", "gain_down", "phase", "crossover", "modulus")
    for name in numbers:
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-9)
    assert (before.unstable, after.unstable) == (0.0, pytest.approx(0.0, abs=1e-9))
    # Coupled in one direction only, x does not change the lift's margins; coupled both ways, it does.
    A[at("velocity_z"), at("x")] = 1.0
    _, (after,) = found(A)
    assert after.modulus == pytest.approx(before.modulus, rel=1e-9)
    A[at("velocity_x"), at("z")] = 100.0
    stable, (after,) = found(A)
    assert not stable
    assert after.unstable == 0.0
    assert after.modulus < before.modulus
    weak = pid_block(PID(0.1, 0.4, 0.0, PERIOD), AxisReading("z", 1e3))
    stable, (after,) = found(linear.A, weak)
    assert not stable
    assert after.unstable > 0.5


def test_margins_hold_beside_an_unstable_axis_that_is_felt(linear):
    """Loops of z and x, coupled both ways; x is too weak for its unstable pole, or strong enough. At each margin a pole
    is on the unit circle, and the number of unstable poles changes there."""
    at, A, B = linear.states.index, linear.A.copy(), np.hstack([linear.B, np.zeros_like(linear.B)])
    A[at("velocity_x"), at("x")] *= -1.0
    A[at("velocity_z"), at("x")], A[at("velocity_x"), at("z")] = 8.0, 12.0
    B[at("velocity_x"), 1] = B[at("velocity_z"), 0]
    both = replace(linear, A=A, B=B, D=np.zeros((3, 2)), inputs=("lift", "x"))
    up = pid_block(PID(2.0, 0.4, 0.06, PERIOD), AxisReading("z", 1e3))

    def poles(aside, factors=(1.0, 1.0)):
        block = stacked(up, pid_block(PID(aside, np.inf, 0.01, PERIOD), AxisReading("x", 1e3)))
        times = np.array(factors)[:, None]
        changed = replace(block, C=times * block.C, D=times * block.D)
        loop = close_loop(both, changed, Schedule(np.zeros((2, 3)), PERIOD, delay=1e-3))
        return loop, np.abs(loop.poles)

    for aside, count in ((0.02, 1), (2.0, 0)):
        lift, x = found = margins(poles(aside)[0], ("lift", "x"))
        assert (poles(aside)[1] > 1.0).sum() == count
        # True as well with the constant state of a PD controller.
        assert poles(aside)[0].stable == (count == 0)
        assert (lift.unstable < 0.01, x.unstable > 0.99) == (True, count == 1)
        # At the gain 0.0489 the controller of x equals the stiffness of the field, for both gains of the controller.
        assert aside * (x.gain_up if count else x.gain_down) == pytest.approx(0.0489, abs=1e-4)
        for margin, which in zip(found, np.eye(2), strict=True):
            for factor in {margin.gain_up, margin.gain_down} - {0.0, np.inf}:
                inside, there, behind = (
                    poles(aside, 1.0 + share * (factor - 1.0) * which)[1] for share in (0.999, 1.0, 1.001)
                )
                assert np.abs(there - 1.0).min() < 1e-6
                assert (inside > 1.0).sum() == count != (behind > 1.0).sum()
        ways = np.exp(1j * np.deg2rad([lift.phase, -lift.phase]))
        assert min(np.abs(poles(aside, (way, 1.0))[1] - 1.0).min() for way in ways) < 1e-6


def scaled(linear, pid, factor, delay=1e-3):
    """The loop with its controller's outputs times a factor."""
    return close_loop(
        linear, replace(pid, C=factor * pid.C, D=factor * pid.D, E=pid.E / factor),
        Schedule(np.zeros((2, 3)), PERIOD, delay=delay),
    )  # fmt: skip


def test_margins_are_where_the_loop_becomes_unstable(linear):
    """At the gain margins a pole is on the unit circle. The sensitivity 1 / (1 + l) = 1 - T, T the reference response,
    gives the smallest distance from -1 and, where |l| = |T / (1 - T)| = 1, the phase margin."""
    upward = linear.only(("z", "velocity_z"))
    pid = pid_block(PID(1.0, 0.2, 0.04, PERIOD), AxisReading("z", 1e3))
    loop = scaled(upward, pid, 1.0)
    (found,) = margins(loop, ("lift",))
    assert loop.stable
    assert 0.0 < found.gain_down < 1.0 < found.gain_up < np.inf
    for factor in (found.gain_up, found.gain_down):
        assert np.abs(scaled(upward, pid, factor).poles).max() == pytest.approx(1.0, abs=1e-5)
        inner = factor + 0.02 * (1.0 - factor)
        assert scaled(upward, pid, inner).stable
    rates = np.geomspace(1e-2, np.pi / PERIOD, 4000)

    def answer(rate):
        q = np.exp(1j * rate * PERIOD)
        return (loop.C @ np.linalg.solve(q * np.eye(len(loop.A)) - loop.A, loop.B))[2, 2]

    T = np.array([answer(rate) for rate in rates])
    assert found.modulus == pytest.approx(1.0 / np.abs(1.0 - T).max(), rel=1e-4)
    at = answer(2.0 * np.pi * found.crossover)
    assert abs(at / (1.0 - at)) == pytest.approx(1.0, rel=1e-4)
    assert found.phase == pytest.approx(np.degrees(abs(np.angle(-at / (1.0 - at)))), rel=1e-3)
    # Sensors that average four scans, later, lower the phase.
    (scanning,) = margins(loop, ("lift",), Sensors(scan_rate=1200.0, averages=4))
    lag = 360.0 * (3 / 2 + 4 / 2) / 1200.0 * found.crossover
    assert found.phase - scanning.phase == pytest.approx(lag, rel=0.2)


@pytest.mark.parametrize("frequency", [0.0, 3.0])
def test_coupling_is_that_of_the_answers(linear, frequency):
    """A machine with inputs in the order lift, x, y: gains in the order x, y, z, and relative gains."""
    rng = np.random.default_rng(5)
    B, names = np.vstack([np.zeros((3, 3)), rng.normal(size=(3, 3))]), ("lift_V", "x_signal", "y_signal")
    found = coupling(replace(linear, B=B, D=0.1 * np.eye(3), inputs=names), frequency)
    s = 2j * np.pi * frequency
    answer = (linear.C @ np.linalg.inv(s * np.eye(6) - linear.A) @ B + 0.1 * np.eye(3))[:, [1, 2, 0]]
    assert found.frequency == frequency
    np.testing.assert_allclose(found.gain, np.abs(answer) if frequency else answer.real, rtol=1e-9)
    relative = answer * np.linalg.inv(answer).T
    np.testing.assert_allclose(found.relative, relative.real, rtol=1e-9)
    # By definition: each response divided by the response with the other outputs held.
    if not frequency:
        held = 1.0 / np.linalg.inv(answer).T
        np.testing.assert_allclose(found.relative, (answer / held).real, rtol=1e-9)
    other = coupling(replace(linear, B=B, D=0.1 * np.eye(3), inputs=("a", "b", "c")), frequency)
    np.testing.assert_allclose(other.gain[:, [1, 2, 0]], found.gain, rtol=1e-12)


def test_shares_of_modes_and_the_worst_poles_are_told_apart(linear):
    """Two made-up modes: one that no input moves, and one that no output shows."""
    A, names = np.diag([-1.0, -3.0, 2.0]), ("x", "velocity_x", "turn_y")
    B, C = np.array([[0.0], [1.0], [1.0]]), np.array([[1.0, 1.0, 0.0]])
    made = replace(linear, A=A, B=B, C=C, states=names)
    found = controllability(made)
    assert (found.worst_input, found.worst_output) == (-1.0, 2.0)
    assert (found.controllability, found.observability) == pytest.approx((0.0, 0.0), abs=1e-12)
    above = controllability(made, 0.0)
    assert (above.worst_input, above.worst_output) == (2.0, 2.0)
    first, second, third = modes(made)
    assert [mode.pole for mode in (first, second, third)] == [2.0, -1.0, -3.0]
    assert [mode.named_shares(made) for mode in (first, second, third)] == [{"turn_y": 1}, {"x": 1}, {"x": 1}]
    # Inputs in their own unit; outputs in mm; states in units of mm, 10 mm/s and 0.1 rad.
    np.testing.assert_allclose([mode.input_gains[0] for mode in (first, second, third)], [10.0, 0.0, 100.0])
    np.testing.assert_allclose([mode.output_gains[0] for mode in (first, second, third)], [0.0, 1.0, 10.0])
    swinging = replace(linear, A=np.array([[0.0, 5.0], [-5.0, -6.0]]), B=B[:2], C=C[:, :2], states=names[:2])
    (mode, other) = modes(swinging)
    assert (mode.pole, other.pole) == (pytest.approx(-3 + 4j), pytest.approx(-3 - 4j))
    assert mode.frequency == pytest.approx(2.0 / np.pi)
    assert mode.damping == pytest.approx(0.6)
    half = replace(mode, shares=np.array([0.951, 0.049]))
    assert half.named_shares(replace(swinging, states=("x", "turn_y"))) == {"x": 0.951}
    assert half.named_shares(replace(swinging, states=("x", "turn_y")), 0.049).keys() == {"x", "turn_y"}


@pytest.mark.parametrize(("pole", "stable"), [(0.999, True), (-1.0, False), (1.0, False)])
def test_a_pole_on_the_unit_circle_is_not_stable(pole, stable):
    loop = ClosedLoop(np.diag([0.5, pole]), np.zeros((2, 3)), np.zeros((3, 2)), 1e-3, None, None)
    assert loop.stable is stable


def test_what_scanning_sensors_show_of_a_sine_is_what_the_micrometer_shows():
    rate, n = 2 * np.pi * 12.3, 5
    sensors = Sensors(scan_rate=1200.0, averages=n, latency=2)
    time = np.arange(0.0, 4.0, 1e-4)
    shown = watch(
        Micrometer(0.0, 1e-3, scan_rate=1200.0, averages=n, latency=2), time, np.sin(rate * time), 1e-4
    )
    part = time > 1.0
    answer = 2j * np.mean(shown[part] * np.exp(-1j * rate * time[part]))
    np.testing.assert_allclose(sensor_answer(sensors, rate), answer * np.eye(3), atol=0.02)
    # Averaging of the depth alone: crossed sensors show each scan in x and y.
    crossed = Sensors(SensorFrame(np.pi / 4, offset=0.0), scan_rate=1200.0, averages=(1, 1, n), latency=2)
    assert sensor_answer(crossed, rate)[2, 2] == pytest.approx(answer, abs=0.02)
    assert abs(sensor_answer(crossed, rate)[0, 0]) > abs(answer)


@pytest.mark.parametrize(("averages", "holds"), [(4, True), (64, False)])
def test_averaging_makes_unstable_what_the_simulation_loses(six, averages, holds):
    changes = {
        "field.scale": 2.1,
        "start.depth_mm": 10.0,
        "control.coupled.depths_mm": [8.0, 12.0],
        "reference.0.by_mm": 0.0,
        "reference.1.by_mm": 0.0,
        "duration_s": 6.0,
        "sensors.scan_rate_Hz": 1200.0,
        "sensors.averages": [averages, averages, 1],
    }
    experiment = prepare(read_scenario("without_block", changes), six)
    (point,) = linear_points(experiment)
    assert point.loop.stable is holds
    run = experiment.run()
    assert np.abs(run.sensed - run.references)[-200:, :2].max() < 1e-4 or not holds
    assert (run.event is None) is holds
    # The weights of past samples sum to one and agree with the frequency response for a slow sine.
    shares = shares_of_the_past(experiment.machine.sensors, 2e-3)
    np.testing.assert_allclose(shares.sum(axis=0), np.eye(3), atol=1e-12)
    turned = np.einsum("kij,k->ij", shares, np.exp(-1j * 8.0 * 2e-3 * np.arange(len(shares))))
    np.testing.assert_allclose(turned, sensor_answer(experiment.machine.sensors, 8.0), atol=1e-3)
    # A mode with pole z was smaller by 1/z at each earlier sample.
    machine, k = point.loop.machine, point.loop.controller
    listen, states = k.D[:, 3:6], k.A + k.E @ k.C
    applied = (k.B + k.E @ k.D)[:, 3:6]
    seen = [z for z in point.loop.poles if abs(z) > 0.9]
    assert len(seen) > 5
    for z in seen:
        now = np.einsum("kij,k->ij", shares, z ** -np.arange(len(shares), dtype=float)) @ machine.C
        without_past = np.block(
            [
                [machine.A + machine.B @ listen @ now, machine.before, machine.B @ k.C],
                [listen @ now, np.zeros((k.outputs, k.outputs)), k.C],
                [applied @ now, np.zeros((len(k.A), k.outputs)), states],
            ]
        )
        assert np.abs(np.linalg.eigvals(without_past) - z).min() < 1e-6

"""Linear machines whose coils are driven by voltages: against differences of the equations in numpy, closed forms,
energy, and simulations."""

from dataclasses import replace

import control
import numpy as np
import pytest
import scipy

import fieldmap as fm
from fieldmap.control import PID
from fieldmap.control.blocks import constant_block
from fieldmap.dynamics import (
    AxisReading,
    Bridge,
    CoilDrive,
    CurrentController,
    Drag,
    Heating,
    Machine,
    MatrixAllocation,
    RigidBody,
    Schedule,
    Sensors,
    close_loop,
    find_operating_point,
    linearise,
    margins,
    modelled,
    modes,
    pid_block,
    prepare,
    read_scenario,
    simulate_closed_loop,
    stacked,
    state_of,
    superposed,
)
from fieldmap.dynamics.coupled import LqgWeights, lqg_block, outputs_for
from fieldmap.dynamics.linearisation import moved_state
from fieldmap.dynamics.operating_point import OperatingPoint
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody, interpolate
from fieldmap.lookup.soft_body import soft_rule
from fieldmap.store import StoredLinkage
from tests.dynamics.conftest import saturating_data
from tests.dynamics.machines import CURVE, MASS, MOMENT, PERIOD, QUIET, SLOPE, one_coil

RESISTANCE = np.array([3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
AIR = StoredLinkage(2e-3 * (np.eye(6) + 0.2), 1e-4 * np.arange(6.0))
AIR_OF_THREE = StoredLinkage(2e-3 * (np.eye(3) + 0.3), np.zeros(3))
INERTIA, ARM = np.array([6e-7, 8e-7, 3e-7]), np.array([5e-4, -3e-4, 1e-3])
CURRENTS = np.array([0.9, -0.8, 1.2, 0.4, -0.7, 1.1])
# A rotation about no axis of the frame, and a place off the axis.
TURN = scipy.spatial.transform.Rotation.from_rotvec([0.2, -0.3, 0.5])
PLACE = np.array([1.3e-3, -2.1e-3, 2.6e-3])


@pytest.fixture(scope="module")
def m():
    """A made-up map of saturating iron with six free currents, and linkages of realistic size."""
    data = saturating_data(free=True)
    model = data.reduced_model
    small = replace(model, weights=1e-7 * model.weights, air=1e-7 * model.air)
    return interpolate(replace(data, reduced_model=small, linkage=AIR), outside_currents="evaluate")


@pytest.fixture(scope="module")
def magnet():
    """Two dipoles and a soft sphere."""
    soft = soft_rule(fm.SoftSphere(2e-3, mu_r=50.0))
    points, moments = np.array([[0, 0, 1e-3], [1e-3, 0, 0]]), np.array([[0.1, 0.2, 0.7], [0.0, -0.3, 0.2]])
    return MagneticBody(points, moments, soft=soft)


@pytest.fixture(scope="module")
def six_coils_driven(m, magnet):
    body = RigidBody(0.02, INERTIA, magnet, magnet_at=ARM, seen_at=[0, 0, 5e-3])
    drive = CoilDrive(Amplifier(1.0), 6, RESISTANCE, mode="voltage")
    direct = MatrixAllocation(np.eye(6), np.zeros(6))
    return Machine(modelled(m), body, drive, Sensors(), direct, Drag((0.01, 0.02, 0.03), turning=(1e-6,) * 3))


@pytest.fixture(scope="module")
def standing():
    """A state with constant currents, at which the body is not at rest; linearisation allows that."""
    quaternion = np.roll(TURN.as_quat(), 1)
    return OperatingPoint(state_of(PLACE, quaternion=quaternion), CURRENTS, RESISTANCE * CURRENTS, PLACE, 0.0)


def rates(m, magnet, x, u, w):
    """Time derivatives of place, turn about the body's axes, velocity, angular velocity and currents (18,), from forces
    and flux linkages of the map alone."""
    place, turn, velocity, spin, currents = np.split(x, [3, 6, 9, 12])
    rotation = TURN * scipy.spatial.transform.Rotation.from_rotvec(turn)
    R = rotation.as_matrix()

    def linked(currents, time=0.0):
        there = (rotation * scipy.spatial.transform.Rotation.from_rotvec(time * spin)).as_matrix()
        return m.flux_linkage(currents, place + time * velocity + there @ ARM, magnet, there)

    step, ampere = 1e-5, 2e-3
    L = np.array([linked(currents + ampere * k) - linked(currents - ampere * k) for k in np.eye(6)]).T / (
        2 * ampere
    )
    induced = (linked(currents, step) - linked(currents, -step)) / (2 * step)
    wrench = m.wrench(place + R @ ARM, magnet, currents, R)
    torque = (
        R.T @ (wrench[3:] + np.cross(R @ ARM, wrench[:3]) + w[3:])
        - 1e-6 * spin
        - np.cross(spin, INERTIA * spin)
    )
    push = wrench[:3] + w[:3] - np.array([0.01, 0.02, 0.03]) * velocity
    follow = np.linalg.solve(L, u - RESISTANCE * currents - induced)
    return np.concatenate([velocity, spin, push / 0.02 - [0, 0, 9.80665], torque / INERTIA, follow])


def test_slopes_are_differences_of_the_equations_in_numpy(m, magnet, six_coils_driven, standing):
    found = linearise(six_coils_driven, standing)
    assert found.states[12:] == ("i1", "i2", "i3", "i4", "i5", "i6")
    x = np.concatenate([PLACE, np.zeros(9), CURRENTS])
    np.testing.assert_allclose(found.at_rest, x)
    u, w = RESISTANCE * CURRENTS, np.zeros(6)
    sizes = np.repeat([2e-5, 2e-4, 1e-3, 1e-2, 2e-3], [3, 3, 3, 3, 6])

    def slopes(of, steps):
        return np.array([(of(step) - of(-step)) / (2 * step.max()) for step in np.diag(steps)]).T

    A = slopes(lambda step: rates(m, magnet, x + step, u, w), sizes)
    B = slopes(lambda step: rates(m, magnet, x, u + step, w), np.full(6, 0.1))
    G = slopes(lambda step: rates(m, magnet, x, u, w + step), np.repeat([1e-3, 1e-6], 3))
    blocks = [slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 18)]
    sides = (A, found.A, blocks), (B, found.B, [slice(6)]), (G, found.G, [slice(3), slice(3, 6)])
    for wanted, asked, columns in sides:
        for row in blocks:
            for column in columns:
                size = np.abs(wanted[row, column]).max()
                # The iron solver's tolerance limits the accuracy of differences of linkages.
                share = 1e-3 if row.start == 12 else 2e-5
                np.testing.assert_allclose(asked[row, column], wanted[row, column], atol=share * size + 1e-8)


def supply_rates(linear, R):
    """At each frequency, 1/s, the responses (n, n) of currents, velocities and angular velocities in the map's frame to
    voltages, forces and torques, with the body held at its place."""
    names = [name for name in linear.states if name.startswith(("i", "velocity", "angular"))]
    held = linear.only(tuple(names))
    turned = scipy.linalg.block_diag(np.eye(3), R, np.eye(6))
    B = np.hstack([held.G, held.B])
    for rate in np.geomspace(0.1, 1e5, 60):
        yield turned @ np.linalg.solve(1j * rate * np.eye(len(names)) - held.A, B)


def test_a_machine_that_is_held_takes_power_at_any_frequency(six_coils_driven, standing):
    """Coils, drag and inertia only store and dissipate, so responses to voltages, forces and torques are positive real.
    With the sign of the induced voltages reversed they are not."""
    found = linearise(six_coils_driven, standing)
    wrong = found.A.copy()
    wrong[12:, 6:12] *= -1.0

    def least(linear):
        answers = supply_rates(linear, TURN.as_matrix())
        # In units that give all powers a similar size.
        sizes = np.repeat([0.1, 10.0, 1.0], [3, 3, 6])
        taken = [(answer + answer.conj().T) / sizes / sizes[:, None] for answer in answers]
        return min(np.linalg.eigvalsh(each)[0] / np.linalg.eigvalsh(each)[-1] for each in taken)

    assert least(found) > -1e-9
    assert least(replace(found, A=wrong)) < -1e-3
    # Reciprocity: the force per current equals the induced voltage per velocity.
    L, M = np.linalg.inv(found.B[12:]), np.diag([*(3 * [0.02]), *INERTIA])
    given = M @ found.A[6:12, 12:]
    np.testing.assert_allclose(L @ found.A[12:, 6:12], -given.T, atol=1e-9 * np.abs(given).max())


THREE = np.array([3.0, 5.0, 4.0])
RUNS = {
    "voltage": (THREE * CURRENTS[:3], {}),
    "current_controller": (CURRENTS[:3], {"controller": CurrentController(proportional=20.0, integral=4e3)}),
    "bridge": (THREE * CURRENTS[:3] + 0.3 * np.sign(CURRENTS[:3]), {"bridge": Bridge(2e4, drop=0.3)}),
}


@pytest.mark.parametrize("mode", RUNS)
def test_a_run_comes_to_the_linear_machine_with_the_square_of_what_disturbs(axial, magnet, standing, mode):
    """With body, coils, controllers and outputs disturbed at once, about a rest that external loads hold."""
    outputs, of_mode = RUNS[mode]
    pulling = axial.map((0.02, 0.3, 2.0), (-0.01, 0.5, 5.0), (0.03, -0.2, 8.0), linkage=AIR_OF_THREE)
    gain, supply = 1 / 60 if mode == "bridge" else 1.0, (-60.0, 60.0)
    drive = CoilDrive(Amplifier(gain), 3, THREE, None, supply, mode=mode, **of_mode)
    body, direct = RigidBody(0.02, INERTIA, magnet, magnet_at=ARM), MatrixAllocation(np.eye(3), np.zeros(3))
    machine = Machine(superposed(pulling), body, drive, Sensors(), direct)
    point = replace(standing, currents=CURRENTS[:3], outputs=outputs)
    linear, R, shown = linearise(machine, point), TURN.as_matrix(), [0, 1, 2, 6, 7, 8, 12, 13, 14]
    load = pulling.wrench(PLACE + R @ ARM, magnet, CURRENTS[:3], R)
    load += np.concatenate([[0.0, 0.0, -0.02 * 9.80665], np.cross(R @ ARM, load[:3])])
    motion = [1.0, -0.7, 0.5, 8.0, -6.0, 5.0, 300.0, 200.0, -100.0, 2e4, -1e4, 3e4]
    amperes, step = np.array([100.0, -200.0, 150.0]), np.array([200.0, 400.0, -300.0])
    begin = np.concatenate([motion, amperes, THREE * amperes])[: len(linear.states)]
    whole = np.pad(linear.A, (0, 1))
    # The load keeps its direction in space while the body turns: -R^T T about the body's axes.
    whole[9:12, 3:6] -= np.cross(np.eye(3), R.T @ load[3:]) / INERTIA[:, None]
    whole[:-1, -1] = linear.B @ step

    def off(size):
        plan = Schedule(np.zeros((20, 3)), 2e-4, 1e-6, loads=-load[None])
        told = stacked(*(constant_block(value) for value in outputs + size * step))
        at = moved_state(linear, size * begin), CURRENTS[:3] + size * amperes
        run = simulate_closed_loop(machine, told, plan, *at, None)
        found = np.hstack([run.position - PLACE, run.velocity, run.currents - CURRENTS[:3]]) / size
        path = np.array([scipy.linalg.expm(whole * t) @ np.append(begin, 1.0) for t in run.time])[:, shown]
        return np.abs(found - path).max(axis=0) / np.abs(path).max(axis=0)

    errors = np.array([off(size) for size in (2e-4, 1e-4, 5e-5)])
    np.testing.assert_allclose(np.log2(errors[:-1] / errors[1:]), 1.0, atol=0.1)
    assert errors[-1].max() < 2e-3


ONE = StoredLinkage([[20e-3]], [0.0])
OHMS, PULL = 4.0, MOMENT * SLOPE
# Polynomials of the coil, and of the body with the field's negative stiffness at 2 A.
COIL, MOTION = [20e-3, OHMS], [MASS, 0.05, -MOMENT * CURVE * 2.0]


def levitator(axial, **drive):
    """One coil whose 2 A carry the body at the origin: its machine, the linear machine, and its part of z and coil."""
    given = CoilDrive(Amplifier(1.0), 1, **{"resistance": OHMS, "supply": (-12.0, 12.0), **drive})
    machine = one_coil(axial, given, linkage=ONE, upright=True)
    found = linearise(machine, find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [5.0]))
    alone = tuple(name for name in found.states if name.startswith("i") or name.endswith("z"))
    return machine, found, found.only(alone)


def held_at(z, ampere, output):
    """An operating point at z, whether or not the body is at rest there."""
    state, sensed = state_of([0, 0, z]), np.array([0, 0, z + 5e-3])
    return OperatingPoint(state, np.array([ampere]), np.array([output]), sensed, 0.0)


def same_answer(linear, numerator, denominator):
    """Assert that the response of z to the first input is this ratio of polynomials."""
    found = control.ss2tf(control.ss(linear.A, linear.B[:, :1], linear.C[2], 0))
    scale, top = denominator[0], found.num[0][0]
    np.testing.assert_allclose(found.den[0][0], np.divide(denominator, scale), rtol=1e-5)
    np.testing.assert_allclose(top[-len(numerator) :], np.divide(numerator, scale), rtol=1e-5)
    np.testing.assert_allclose(top[: -len(numerator)], 0.0, atol=1e-9 * np.abs(top).max())


def test_a_levitator_with_a_source_of_voltage_is_of_third_order(axial):
    """Z/V = K / ((L s + R)(m s^2 + c s - k) + K^2 s), K = dF/di, k = dF/dz; its poles are two of motion and R/L."""
    _, whole, found = levitator(axial, mode="voltage")
    assert found.states == ("z", "velocity_z", "i1")
    assert whole.operating_point.outputs == pytest.approx([2.0 * OHMS])
    bottom = np.polyadd(np.polymul(COIL, MOTION), [PULL**2, 0.0])
    same_answer(found, [PULL], bottom)
    (electrical,) = [mode.pole for mode in modes(found) if "i1" in mode.named_shares(found, 0.6)]
    assert electrical == pytest.approx(min(np.roots(bottom)), rel=1e-6)
    assert electrical == pytest.approx(-OHMS / 20e-3, rel=0.05)
    by_place, by_output = whole.forces
    assert (by_place[2, 2], by_output[2, 0]) == pytest.approx((-MOTION[2], PULL / OHMS), rel=1e-5)


def test_a_bead_whose_inductance_follows_its_place(axial):
    """Textbook: m z" = i^2 L'(z)/2, V = R i + d(L(z) i)/dt, L(z) = L + X b(z)^2 of an ellipsoid, X from Osborn."""
    axes, mu_r, ampere, z = np.array([2e-3, 2e-3, 3e-3]), 80.0, 1.7, 2e-3
    e = np.sqrt(1.0 - (2.0 / 3.0) ** 2)
    factor = (1.0 - e**2) / e**2 * (np.arctanh(e) / e - 1.0)
    X = np.pi / 6.0 * axes.prod() / scipy.constants.mu_0 * (mu_r - 1.0) / (1.0 + factor * (mu_r - 1.0))
    soft = soft_rule(fm.SoftEllipsoid(tuple(axes), mu_r=mu_r))[0]
    bead = MagneticBody(np.zeros((0, 3)), np.zeros((0, 3)), soft=(soft,))
    drive = CoilDrive(Amplifier(1.0), 1, OHMS, mode="voltage")
    machine = one_coil(axial, drive, linkage=StoredLinkage([[2e-5]], [0.0]), upright=True, magnet=bead)
    found = linearise(machine, held_at(z, ampere, ampere * OHMS)).only(("z", "velocity_z", "i1"))
    b, slope = 0.02 + SLOPE * z + CURVE * z**2 / 2, SLOPE + CURVE * z
    L, rise, curve = 2e-5 + X * b**2, 2 * X * b * slope, 2 * X * (slope**2 + b * CURVE)
    assert L > 2.2e-5
    wanted = [
        [0.0, 1.0, 0.0],
        [ampere**2 * curve / 2 / MASS, -0.05 / MASS, ampere * rise / MASS],
        [0.0, -ampere * rise / L, -OHMS / L],
    ]
    np.testing.assert_allclose(found.A, wanted, rtol=2e-5, atol=1e-9)
    np.testing.assert_allclose(found.B[:, 0], [0.0, 0.0, 1.0 / L], rtol=2e-5)


def test_a_current_controller_adds_its_integral(axial):
    """Z/I_c = K (P s + I) / ((L s^2 + (R + P) s + I)(m s^2 + c s - k) + K^2 s^2)."""
    gains = CurrentController(proportional=25.0, integral=5e3)
    _, whole, found = levitator(axial, mode="current_controller", controller=gains)
    assert found.states == ("z", "velocity_z", "i1", "integral1")
    np.testing.assert_allclose(whole.at_rest[-2:], [2.0, 2.0 * OHMS])
    bottom = np.polyadd(np.polymul([20e-3, OHMS + 25.0, 5e3], MOTION), [PULL**2, 0.0, 0.0])
    same_answer(found, PULL * np.array([25.0, 5e3]), bottom)
    assert whole.forces[1][2, 0] == pytest.approx(PULL)


@pytest.mark.parametrize(("ripple", "more"), [(1e-2, 0.0), (3.0, 0.6 / 3.0)])
def test_a_bridge_gives_duty_times_supply_less_its_loss(axial, ripple, more):
    """Within the ripple the loss acts as a resistance; warm copper adds more. A run stays at this operating point."""
    bridge = Bridge(20e3, dead_time=1e-6, drop=0.12, ripple=ripple)
    warm = Heating(1e-3, 1e6, coefficient=4e-3, reference=20.0, ambient=45.0)
    drive = CoilDrive(
        Amplifier(0.1), 1, OHMS, None, (-12.0, 12.0), mode="bridge", bridge=bridge, heating=warm
    )
    machine = one_coil(axial, drive, linkage=ONE, upright=True)
    point = find_operating_point(machine, [np.nan, np.nan, 5e-3], [np.nan], [7.0])
    lost = 0.6 if more == 0.0 else 2.0 * more
    assert point.outputs * 1.2 == pytest.approx([2.0 * 1.1 * OHMS + lost])
    found = linearise(machine, point)
    assert found.A[-1, -1] == pytest.approx(-(1.1 * OHMS + more) / 20e-3)
    assert found.B[-1, 0] == pytest.approx(0.1 * 12.0 / 20e-3)
    plan = Schedule(np.zeros((20, 3)), 1e-3, 1e-4)
    run = simulate_closed_loop(
        machine, constant_block(point.outputs[0]), plan, point.state, point.currents, None
    )
    np.testing.assert_allclose(run.currents, 2.0, rtol=1e-5)


def test_the_inverse_map_of_a_source_of_voltage_is_that_of_lasting_currents(six):
    """By Ohm's law, compared with an ideal source of current."""
    experiment = prepare(read_scenario("vertical_step", QUIET), six)
    ideal, point = experiment.machine, experiment.operating_point
    gain, linkage = ideal.drive.amplifier.gain, StoredLinkage(1e-3 * np.eye(6), np.zeros(6))
    drive = CoilDrive(Amplifier(5.0), 6, OHMS, mode="voltage")
    fed = replace(ideal, drive=drive, magnetic=replace(ideal.magnetic, linkage=linkage))
    places = point.state[:3] + 1e-3 * np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.5]])
    forces = ideal.body.mass * np.array([[0.0, 0.0, 9.81], [0.1, -0.2, 9.0]])
    scale = np.array([gain / (5.0 / OHMS), 1.0, 1.0])
    limits = np.array([-20.0, -1.0, -1.0]), np.array([20.0, 1.0, 1.0])
    wanted, _ = outputs_for(ideal, point, places, forces, *limits)
    asked = replace(point, outputs=scale * point.outputs)
    found, left = outputs_for(fed, asked, places, forces, *(scale * limit for limit in limits))
    np.testing.assert_allclose(found, scale * wanted, rtol=1e-6, atol=1e-12)
    assert np.abs(left).max() < 1e-9


def test_margins_of_a_levitator_are_those_of_python_control(axial):
    """Against the closed form, sampled, under a PID controller of the voltage."""
    _, whole, _ = levitator(axial, mode="voltage")
    pid = pid_block(PID(1.0, 2.0, 0.05, PERIOD, integration="rectangular"), AxisReading("z", 1e3))
    loop = close_loop(whole, pid, Schedule(np.zeros((2, 3)), PERIOD))
    assert loop.stable
    (found,) = margins(loop, ("lift",))
    plant = control.tf([PULL], np.polyadd(np.polymul(COIL, MOTION), [PULL**2, 0.0]))
    own = control.ss2tf(control.ss(pid.A, pid.B[:, 5:6], pid.C, pid.D[:, 5:6], PERIOD))
    opened, rates = -own * control.c2d(plant, PERIOD), np.geomspace(0.1, np.pi / PERIOD, 4000)
    curve = control.frd(opened, rates, smooth=True)
    factors, phases, moduli, _, at, _ = control.stability_margins(curve, returnall=True)
    assert found.phase == pytest.approx(min(abs(phases)), rel=1e-3)
    assert found.crossover == pytest.approx(at[abs(phases).argmin()] / (2.0 * np.pi), rel=1e-3)
    assert found.modulus == pytest.approx(min(moduli), rel=1e-3)
    assert (found.gain_down, found.gain_up) == pytest.approx(tuple(sorted(factors)), rel=1e-3)


def test_a_regulator_estimates_the_current_that_its_voltage_drives(axial):
    """Its model has the coil: its loop has margins, and at rest its voltage carries the body. A regulator designed for
    currents without lag loses the body."""
    weights = LqgWeights(output=(30.0,))
    _, found, _ = levitator(axial, mode="voltage")
    _, ideal, _ = levitator(axial, resistance=None)
    schedule = Schedule(np.zeros((2, 3)), PERIOD, delay=1e-3)
    at_once = replace(ideal, B=ideal.B / OHMS, operating_point=found.operating_point)
    own, foreign = (lqg_block(each, weights, PERIOD, 1e-3) for each in (found, at_once))
    loops = [close_loop(found, block, schedule) for block in (own, foreign)]
    assert [loop.stable for loop in loops] == [True, False]
    (margin,) = margins(loops[0], ("lift",))
    assert margin.modulus > 0.4
    point = found.operating_point
    signals = np.concatenate([point.sensed, point.sensed, [1.0]])
    assert own.C @ own.memory + own.D @ signals == pytest.approx([2.0 * OHMS])
    np.testing.assert_allclose(own.memory[6:7], [2.0])

"""Controllers of all axes at once: the inverse map, regulators on physical states, feed-forward, linearisation."""

import numpy as np
import pytest
import scipy.linalg

from fieldmap.control import PID, divide_currents, lqrd
from fieldmap.core.controller import CoreController
from fieldmap.dynamics import (
    AxisReading,
    Schedule,
    Sensors,
    close_loop,
    linear_points,
    linearise,
    pid_block,
    prepare,
    read_scenario,
    simulate,
    simulate_closed_loop,
)
from fieldmap.dynamics.coupled import (
    LqgWeights,
    ScheduledController,
    _motion,
    feedforward,
    lqg_block,
    outputs_for,
    trajectory,
)
from fieldmap.dynamics.linear_loop import sampled_machine, shares_of_the_past
from fieldmap.errors import Infeasible, InputError, ScenarioError
from tests.refusals import refused

LOW, HIGH = np.array([0.0, -0.4, -0.3]), np.array([10.0, 0.4, 0.3])
WEIGHTS = LqgWeights(sensor=(7e-6, 7e-6, 1e-5))
# Without the block, noise and quantisation.
PLAIN = {
    "drag.linear_N_s_per_m": [0.5] * 3,
    "reference.0.by_mm": 0.0,
    "noise.off": True,
    "coils.output_bits": None,
    "sensors.angle_deg": 0.0,
}


@pytest.fixture(scope="module")
def still(six):
    return prepare(read_scenario("vertical_step", PLAIN), six)


def test_the_inverse_map_gives_the_force_of_the_map(six, still):
    """Against the map's own wrench at the found currents, and `currents_for`, whose other currents give that force."""
    places = still.operating_point.sensed + np.array(
        [[1e-3, 2e-3, -3e-3], [-4e-3, 1e-3, 5e-3], [0.0, 0.0, 0.0]]
    )
    centres = places - [0.0, 0.0, 0.015]
    weight = 0.01119 * 9.80665
    forces = np.array([[1e-3, -2e-3, weight], [0.0, 3e-3, 1.2 * weight], [2e-3, 0.0, 0.8 * weight]])
    outputs, left = outputs_for(still.machine, still.operating_point, centres, forces, LOW, HIGH)
    assert left.max() < 1e-9
    scale, moment = still.scenario.contents.field.scale, still.machine.body.magnet.moment
    for centre, force, (u, x, y) in zip(centres, forces, outputs, strict=True):
        currents = still.machine.drive.amplifier.gain * divide_currents(u, x, y, 1.25)
        found = six.wrench(centre, [0.0, 0.0, scale * moment], currents)
        np.testing.assert_allclose(np.ravel(found)[:3], force, atol=2e-9)
        others = six.currents_for(centre, force=force, moment=[0.0, 0.0, scale * moment])
        again = six.wrench(centre, [0.0, 0.0, scale * moment], others)
        np.testing.assert_allclose(np.ravel(again)[:3], force, atol=1e-8)


def test_forces_beyond_the_limits_are_told_and_places_outside_refused(still):
    centre = still.operating_point.state[None, :3]
    outputs, left = outputs_for(still.machine, still.operating_point, centre, [[0.05, 0.0, 0.1]], LOW, HIGH)
    assert left[0] > 0.01
    assert outputs[0, 1] == HIGH[1]
    with refused(Infeasible, where="outputs_for(positions)"):
        outputs_for(
            still.machine, still.operating_point, centre + [0.05, 0.0, 0.0], [[0.0, 0.0, 0.1]], LOW, HIGH
        )


def test_the_regulator_is_that_of_lqrd_where_nothing_is_late(still):
    """The gain on position and velocity: for a short period close to the sampled optimum of the continuous cost."""
    linear = linearise(still.machine, still.operating_point)
    period = 1e-4
    block = lqg_block(linear, WEIGHTS, period)
    cost = np.concatenate([1.0 / np.square(WEIGHTS.place), 1.0 / np.square(WEIGHTS.speed)])
    wanted = lqrd(linear.A, linear.B, np.diag(cost), np.diag(1.0 / np.square(WEIGHTS.output)), period)
    # Outputs against states, with the rest of the memory at zero; the estimate is the memory less the measured part.
    n = 6
    taken = block.D[:, 3:6]
    found = -(block.C[:, :n] + taken @ linear.C)
    np.testing.assert_allclose(found, wanted, rtol=0.02, atol=0.02 * np.abs(wanted).max())


@pytest.mark.parametrize("late", [0.0, 0.5e-3, 2e-3])
def test_the_loop_has_the_poles_of_regulator_and_estimator(still, late):
    """Separation: with the delay in its model the closed loop is stable, and settles at the reference."""
    linear = linearise(still.machine, still.operating_point)
    block = lqg_block(linear, WEIGHTS, 2e-3, late)
    loop = close_loop(linear, block, Schedule(np.zeros((2, 3)), 2e-3, delay=late))
    assert loop.stable
    # The estimator has the unknown force as a state, so the sensed point reaches its reference without offset.
    settled = loop.C @ np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.B)
    np.testing.assert_allclose(settled, np.eye(3), atol=1e-6)
    other = np.abs(scipy.linalg.eigvals(block.A)).max()
    assert other < 1.0 + 1e-6


@pytest.mark.parametrize("scans", [(5e5, 1, 3000), (1200.0, 4, 2), (900.0, (1, 3, 6), 0)])
def test_an_estimator_knows_how_late_its_sensors_are(still, scans):
    """Separation: at any lag of the sensors, the poles of the regulator are poles of the loop."""
    linear, period, late = linearise(still.machine, still.operating_point), 2e-3, 5e-4
    sensors = Sensors(scan_rate=scans[0], averages=scans[1], latency=scans[2])
    shown = shares_of_the_past(sensors, period)
    block = lqg_block(linear, WEIGHTS, period, late, shown=shown)
    loop = close_loop(linear, block, Schedule(np.zeros((2, 3)), period, delay=late), sensors)
    assert loop.stable
    settled = loop.C @ np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.B)
    np.testing.assert_allclose(settled, np.eye(3), atol=1e-6)
    sampled = sampled_machine(linear, period, late)
    A = np.block([[sampled.A, sampled.before], [np.zeros((3, 9))]])
    B = np.vstack([sampled.B, np.eye(3)])
    cost = np.concatenate([1.0 / np.square(WEIGHTS.place), 1.0 / np.square(WEIGHTS.speed), np.zeros(3)])
    R = np.diag(1.0 / np.square(WEIGHTS.output))
    P = scipy.linalg.solve_discrete_are(A, B, np.diag(cost), R)
    own = scipy.linalg.eigvals(A - B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))
    assert max(np.abs(loop.poles - pole).min() for pole in own) < 1e-6
    # A regulator designed without the lag has other poles.
    plain = close_loop(
        linear,
        lqg_block(linear, WEIGHTS, period, late),
        Schedule(np.zeros((2, 3)), period, delay=late),
        sensors,
    )
    assert max(np.abs(plain.poles - pole).min() for pole in own) > 1e-3


def test_constant_forces_are_found_and_carried(still, six):
    """For a push of 2 mN along y the estimated unknown force converges to the push, and the body returns."""
    linear = linearise(still.machine, still.operating_point)
    block = lqg_block(linear, WEIGHTS, 2e-3, 5e-4)
    wanted = np.tile(still.operating_point.sensed, (1500, 1))
    push = Schedule(wanted, 2e-3, 1e-4, 5e-4, loads=np.array([[0.0, 2e-3, 0.0, 0.0, 0.0, 0.0]]))
    run = simulate_closed_loop(still.machine, block, push, still.state, still.currents, None)
    assert run.event is None
    assert np.abs(run.sensed[50:] - wanted[0]).max() > 2e-6
    np.testing.assert_allclose(run.sensed[-1], wanted[0], atol=2e-7)


def said_by(controller, signals, outputs):
    """The last outputs of a controller, and its memory after them."""
    memory, out = controller.memory.copy(), np.zeros((len(signals), outputs))
    CoreController(controller.arrays).control(signals, None, memory, out)
    return out[-1], memory


@pytest.mark.parametrize("matters", ["place", "speed", "output"])
def test_each_weight_of_a_regulator_counts(still, matters):
    """Where the other weights count a hundredth: scipy's optimum of the sampled cost, on states and last outputs."""
    linear = linearise(still.machine, still.operating_point)
    given = {"place": (0.1e-3, 0.2e-3, 0.4e-3), "speed": (3e-3, 5e-3, 9e-3), "output": (2.0, 0.1, 0.3)}
    given = {name: tuple(np.multiply(v, 1.0 if name == matters else 5.0)) for name, v in given.items()}
    period, late = 2e-3, 0.5e-3
    block = lqg_block(linear, LqgWeights(**given, sensor=(7e-6,) * 3), period, late)
    sampled = sampled_machine(linear, period, late)
    A = np.block([[sampled.A, sampled.before], [np.zeros((3, 9))]])
    B = np.vstack([sampled.B, np.eye(3)])
    cost = [*np.square(given["place"]), *np.square(given["speed"])]
    Q, R = np.diag([*(period / np.array(cost)), 0, 0, 0]), np.diag(period / np.square(given["output"]))
    P = scipy.linalg.solve_discrete_are(A, B, Q, R)
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    # The estimate is the memory less the measured part; the last outputs follow the unknown force in the memory.
    found = -(block.C + block.D[:, 3:6] @ np.hstack([linear.C, np.zeros((3, 6))]))
    np.testing.assert_allclose(
        found[:, [0, 1, 2, 3, 4, 5, 9, 10, 11]], K, rtol=1e-6, atol=1e-9 * np.abs(K).max()
    )


def test_each_noise_of_an_estimator_counts(still):
    """Kalman's steady gain on states and unknown force, by scipy, with a different noise for each."""
    linear = linearise(still.machine, still.operating_point)
    force, drift, sensor = (1e-5, 3e-5, 9e-5), (4e-4, 9e-4, 3e-3), (5e-6, 8e-6, 2e-5)
    period = 2e-3
    block = lqg_block(linear, LqgWeights(force=force, drift=drift, sensor=sensor), period)
    mass, n = still.machine.body.mass, 6
    pushed = np.zeros((n, 3))
    pushed[3:] = np.eye(3) / mass
    # Van Loan: effect of a held force on the states over a period.
    held = scipy.linalg.expm(period * np.block([[linear.A, pushed], [np.zeros((3, 9))]]))
    noise = np.zeros((9, 9))
    noise[:n, :n] = pushed @ np.diag(np.square(force)) @ pushed.T
    noise[n:, n:] = np.diag(np.square(drift))
    C, R = np.hstack([linear.C, np.zeros((3, 3))]), np.diag(np.square(sensor))
    P = scipy.linalg.solve_discrete_are(held.T, C.T, period * noise, R)
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    # The gain from measurements to the memory is the prediction from the corrected estimate.
    np.testing.assert_allclose(block.B[:9, 3:6], held @ K, rtol=1e-5, atol=1e-6 * np.abs(held @ K).max())
    # Sensors without noise are taken as having 1 um.
    plain = (
        lqg_block(linear, LqgWeights(force=force, drift=drift, sensor=of), period)
        for of in (None, (1e-6,) * 3)
    )
    np.testing.assert_array_equal(*(one.B for one in plain))


def test_one_design_is_the_same_as_many_alike(still):
    block = lqg_block(linearise(still.machine, still.operating_point), WEIGHTS, 2e-3)
    many = ScheduledController((block, block, block), -0.09, 1e-3)
    v = np.array([1e-3, 0.0, -0.0893, 2e-3, 1e-3, -0.09, 1.0])
    answers = [np.concatenate(said_by(controller, np.tile(v, (3, 1)), 3)) for controller in (block, many)]
    np.testing.assert_allclose(*answers, rtol=1e-12)


def test_between_designs_outputs_are_between(still):
    low = pid_block(PID(1.0, np.inf, 0.0, 2e-3), AxisReading("x", 1e3))
    high = pid_block(PID(3.0, np.inf, 0.0, 2e-3), AxisReading("x", 1e3))
    both = ScheduledController((low, high), -0.1, 0.01)
    heights = (-0.2, -0.1, -0.0975, -0.09, 0.0)
    said = [said_by(both, np.array([[1e-3, 0, z, 0, 0, 0, 1.0]]), 1)[0] for z in heights]
    np.testing.assert_allclose(np.ravel(said), [1.0, 1.0, 1.5, 3.0, 3.0])
    with refused(InputError, where="ScheduledController(blocks)"):
        ScheduledController(
            (low, lqg_block(linearise(still.machine, still.operating_point), WEIGHTS, 2e-3)), 0.0, 1.0
        )


def test_the_block_at_a_height_is_between_its_neighbours(still):
    """`at` interpolates every matrix and the feed-forward; beyond the ends it returns the last block."""
    blocks = [
        pid_block(PID(kc, ti, td, 2e-3), AxisReading("z", 1e3), output)
        for kc, ti, td, output in ((1.0, 0.4, 0.01, 1.0), (3.0, 0.2, 0.02, 2.0), (4.0, 0.1, 0.05, 4.0))
    ]
    many = ScheduledController(tuple(blocks), -0.1, 0.01)
    for height, a, b, share in (
        (-0.2, 0, 1, 0.0),
        (-0.0975, 0, 1, 0.25),
        (-0.083, 1, 2, 0.7),
        (0.0, 1, 2, 1.0),
    ):
        found = many.at(np.array([0.0, 0.0, height]), None, None)
        for name in (*"ABCDE", "feedforward"):
            one, other = (getattr(blocks[k], name) for k in (a, b))
            np.testing.assert_allclose(
                getattr(found, name), one + share * (other - one), rtol=1e-9, atol=1e-15
            )
    alone = ScheduledController((blocks[1],), -0.1, 0.01).at(np.zeros(3), None, None)
    np.testing.assert_array_equal(alone.D, blocks[1].D)
    with refused(InputError, where="ScheduledController(step)"):
        ScheduledController(tuple(blocks), -0.1, 0.0)


@pytest.mark.parametrize(("speed", "step"), [(0.049, False), (0.051, True)])
def test_a_reference_faster_than_told_is_a_step_and_is_not_fed_forward(speed, step):
    """x moves at the given speed for 20 samples, and rests before and after."""
    path = np.zeros((60, 3))
    path[:, 0] = speed * 2e-3 * np.clip(np.arange(60) - 20.0, 0.0, 20.0)
    velocity, acceleration = _motion(path, 2e-3, 0.05, 3.0)
    inside = slice(22, 39)
    np.testing.assert_allclose(velocity[inside, 0], 0.0 if step else speed, rtol=1e-9)
    if step:
        assert not np.abs(acceleration).max()
    else:
        # Half of the speed in one sample exceeds the feed-forward.
        assert acceleration[[20, 40], 0].tolist() == [3.0, -3.0]
    slow, slowly = _motion(0.1 * path, 2e-3, 0.05, 3.0)
    assert slowly[[20, 40], 0] == pytest.approx([0.1 * speed / 2e-3, -0.1 * speed / 2e-3])
    np.testing.assert_allclose(slow[inside, 0], 0.1 * speed)
    assert not np.any(_motion(path[:2] + [[0.0], [1e-5]], 2e-3, 0.05, 3.0))


CIRCLE = {
    "reference.0.at_s": 1.0,
    "reference.0.out_at_s": 0.2,
    "reference.0.out_mm_per_s": 2.0,
    "reference.0.radius_mm": 1.0,
    "reference.0.rate_rad_per_s": 1.6,
    "duration_s": 5.0,
}


def tracking(run, after=2.0):
    error = (run.sensed - run.references)[run.time > after, :2]
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def test_feedforward_tracks_far_better_than_the_pid_alone(six):
    alone = tracking(simulate("circle", CIRCLE, field_map=six))
    ahead = tracking(simulate("circle_feedforward", CIRCLE, field_map=six))
    wrong = {**CIRCLE, "control.feedforward.field_error": 0.05}
    assert alone > 2e-4
    assert ahead < alone / 50
    assert tracking(simulate("circle_feedforward", wrong, field_map=six)) < alone / 5


def test_feedforward_asks_for_what_newton_asks_for(still):
    """Along a swing of 2 mm at 1 Hz: mass times acceleration, the drag of 0.5 N s/m and the weight."""
    period = 2e-3
    time = period * np.arange(600)
    swing = np.tile(still.operating_point.sensed, (600, 1))
    swing[:, 0] += 2e-3 * np.sin(2 * np.pi * time)
    schedule = Schedule(swing, period)
    path = trajectory(still.machine, still.operating_point, schedule, LOW, HIGH)
    middle, w = time + period / 2, 2 * np.pi
    wanted = 2e-3 * (0.5 * w * np.cos(w * middle) - 0.01119 * w**2 * np.sin(w * middle))
    np.testing.assert_allclose(path.forces[5:-5, 0], wanted[5:-5], atol=2e-3 * np.abs(wanted).max())
    assert path.left.max() < 1e-9
    added = feedforward(still.controller, schedule, path)
    # A PID without error keeps its output of the start.
    np.testing.assert_allclose(added, path.outputs - still.operating_point.outputs, atol=1e-9)


@pytest.mark.parametrize("name", ["coupled_regulator", "circle_linearised"])
def test_controllers_of_all_axes_hold_and_follow(six, name):
    changes = {} if name == "coupled_regulator" else CIRCLE
    run = simulate(name, changes, field_map=six)
    assert run.event is None
    error = 1e3 * np.abs(run.sensed - run.references)[-300:].max(axis=0)
    assert error.max() < 0.05
    assert run.forces == (name == "circle_linearised")
    if run.forces:
        weight = 0.01119 * 9.80665
        np.testing.assert_allclose(run.outputs.mean(axis=0), [0.0, 0.0, weight], atol=0.02 * weight)


def test_without_the_block_the_regulator_damps_what_the_pid_lets_sway(six):
    """Decay of a push from the side, over the heights covered by the map of six dipoles."""
    changes = {
        "duration_s": 8.0,
        "start.depth_mm": 5.0,
        "field.scale": 2.1,
        "control.coupled.depths_mm": [5.0, 15.0],
        "control.coupled.designs": 4,
        "reference.0.by_mm": 10.0,
        "reference.1.by_mm": 0.0,
        "reference.0.rate_mm_per_s": 2.5,
    }
    run = simulate("without_block", changes, field_map=six)
    assert run.event is None
    aside = 1e3 * np.hypot(*(run.sensed - run.references)[:, :2].T)
    assert aside[(run.time > 1.0) & (run.time < 1.3)].max() > 0.05
    assert aside[(run.time > 7.0)].max() < 0.03
    loop = linear_points(prepare(run.scenario, six), [5.0, 10.0, 15.0])
    assert all(point.loop.stable and min(m.modulus for m in point.margins) > 0.4 for point in loop)


def test_linear_points_know_feedback_linearisation(six):
    """The linear loop about a rest is the limit of the nonlinear loop for small deviations."""
    quiet = {"reference.0.radius_mm": 1e-9, "noise.off": True, "coils.output_bits": None}
    experiment = prepare(read_scenario("circle_linearised", quiet), six)
    (point,) = linear_points(experiment)
    assert point.loop.stable
    wanted = np.tile(experiment.operating_point.sensed, (80, 1))
    state = experiment.state.copy()
    state[:3] += [2e-6, -1e-6, 1e-6]
    run = simulate_closed_loop(
        experiment.machine,
        experiment.controller,
        Schedule(wanted, 2e-3, 2e-5, 5e-4),
        state,
        experiment.currents,
        None,
    )
    z, path = np.zeros(len(point.loop.A)), []
    z[:3] = [2e-6, -1e-6, 1e-6]
    for _ in range(80):
        path.append(point.loop.C @ z)
        z = point.loop.A @ z
    assert np.abs(run.sensed - wanted - path).max() < 2e-8


@pytest.mark.parametrize(
    ("changes", "where", "received"),
    [
        ({"control.x": {"kind": "constant"}}, "control", "x, coupled"),
        ({"control.coupled.lower": [0.0, 0.5, -0.3]}, "control.coupled", ""),
        ({"control.coupled.allowed_mm": [0.3, 0.3]}, "allowed_mm", ""),
        ({"control.coupled.kind": "lqr"}, "control.coupled", ""),
        ({"control.coupled.depths_mm": [3.0, 1.0]}, "control.coupled", ""),
    ],
)
def test_what_cannot_be_is_refused(changes, where, received):
    with pytest.raises(ScenarioError) as error:
        read_scenario("coupled_regulator", changes)
    assert where in error.value.problems[0].where
    assert error.value.problems[0].received.endswith(received)


def test_weights_that_do_not_fit_are_named(still):
    with refused(InputError, where="LqgWeights(output)", received="1"):
        lqg_block(linearise(still.machine, still.operating_point), LqgWeights(output=(1.0,)), 2e-3)
    with refused(InputError, where="LqgWeights(output[0])"):
        LqgWeights(output=(0.0,) * 3)

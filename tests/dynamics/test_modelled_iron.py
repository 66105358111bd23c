"""Runs on saturating iron solved at every current, against steps by hand and the map's lookups."""

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest

from fieldmap.core.iron import IronState
from fieldmap.dynamics import (
    CoilDrive,
    Machine,
    MatrixAllocation,
    RigidBody,
    RunningMachine,
    Schedule,
    Sensors,
    constant_block,
    find_operating_point,
    linearise,
    linearised,
    modelled,
    simulate_closed_loop,
    simulate_many,
    stacked,
    state_of,
    superposed,
    tabled,
)
from fieldmap.errors import InputError, NotConverged
from fieldmap.instruments import Amplifier
from fieldmap.lookup import MagneticBody, compiled_wrench, iron_weights
from tests.dynamics.machines import machine_in
from tests.refusals import refused

RNG = np.random.default_rng(3)
MASS, MOMENT, GRAVITY, STEP, PERIOD = 0.01, np.array([0.0, 0.0, 0.4]), 9.80665, 1e-4, 1e-3
# The supply takes 15 ms to bring the slowest current there.
RESISTANCE, INDUCTANCE, SUPPLY = 2.0, 0.08, 20.0
START, ASKED = RNG.uniform(-0.3, 0.3, 6), np.array([2.5, -2.0, 1.5, 2.5, 2.0, -1.0])
PLAN = Schedule(np.zeros((20, 3)), PERIOD, STEP)


def machine_of(field, **more):
    body = RigidBody(MASS, [1e-6] * 3, MagneticBody(np.zeros((1, 3)), MOMENT[None]), upright=True)
    n = 6
    drive = CoilDrive(Amplifier(1.0, -10.0, 10.0), n, [RESISTANCE] * n, [INDUCTANCE] * n, (-SUPPLY, SUPPLY))
    names = tuple(f"coil_{k}_V" for k in range(n))
    allocation = MatrixAllocation(np.eye(n), np.zeros(n), names)
    return Machine(field, body, drive, Sensors(zero_depth=0.0), allocation, **more)


def constant(values):
    return stacked(*(constant_block(value) for value in values))


def run_of(field, **more):
    machine = machine_of(field, **more)
    return simulate_closed_loop(machine, constant(ASKED), PLAN, state_of([0, 0, 0]), START, None)


def by_hand(force):
    """Place and currents at every sample, by Strang steps and exact windings in Python; force(currents, place), N."""
    decay = np.exp(-RESISTANCE * STEP / INDUCTANCE)
    high, low = SUPPLY / RESISTANCE, -SUPPLY / RESISTANCE
    place, velocity, currents = np.zeros(3), np.zeros(3), START.copy()
    weight = np.array([0.0, 0.0, -MASS * GRAVITY])
    load, rows = force(currents, place) + weight, []
    for step in range(200):
        if step % 10 == 0:
            rows.append([*place, *currents])
        currents = np.clip(ASKED, low + (currents - low) * decay, high + (currents - high) * decay)
        velocity = velocity + 0.5 * STEP * load / MASS
        place = place + STEP * velocity
        load = force(currents, place) + weight
        velocity = velocity + 0.5 * STEP * load / MASS
    return np.array(rows)


@pytest.fixture(scope="module")
def free(saturating):
    return saturating(free=True)


def test_a_run_is_the_loop_by_hand_with_the_maps_own_function(free):
    """The same solves in the same order, in the C core and in numba: equal to single-precision rounding of sums. The
    supply limits the currents at first."""
    function, data = free.compiled()

    def force(currents, place):
        return np.array(function(data, currents, *place)[1]).T @ MOMENT

    run, wanted = run_of(modelled(free)), by_hand(force)
    assert run.event is None
    np.testing.assert_allclose(run.currents, wanted[:, 3:], rtol=0, atol=1e-13)
    np.testing.assert_allclose(run.position, wanted[:, :3], rtol=0, atol=1e-10 * np.ptp(wanted[:, :3]))
    assert np.ptp(run.currents, axis=0).min() > 0.1


def test_a_run_is_the_loop_by_hand_with_compiled_wrench(free):
    """The compiled wrench solves a hundred times as accurately: equal to the run's tolerance, while a run linearised at
    the start deviates because the iron saturates."""
    wrench, data = compiled_wrench(free, MagneticBody(np.zeros((1, 3)), MOMENT[None]))
    found, slopes = np.empty(6), np.empty((6, 6))

    def force(currents, place):
        assert wrench(data, currents, place, np.eye(3), found, slopes)
        return found[:3].copy()

    wanted = by_hand(force)[:, :3]
    travel = np.ptp(wanted, axis=0).max()
    off = np.abs(run_of(modelled(free)).position - wanted).max() / travel
    assert off < 2e-5
    straight = np.abs(run_of(linearised(free, START)).position - wanted).max() / travel
    assert straight > 5e-3
    exact = replace(modelled(free), tolerance=1e-10)
    assert np.abs(run_of(exact).position - wanted).max() / travel < 2e-8


def test_weights_are_those_of_lookups_at_any_currents(free):
    machine = machine_in(replace(modelled(free, scale=1.5), tolerance=1e-9), 6)
    for currents in RNG.uniform(-3.0, 3.0, (20, 6)):
        assert machine.follow(currents)
        iron = iron_weights(free, currents)[0][0]
        np.testing.assert_allclose(machine.weights, 1.5 * np.concatenate([currents, iron]), rtol=0, atol=1e-5)
    assert not machine.follow(np.full(6, 3.1))
    assert np.isfinite(machine.weights).all()
    machine.follow(np.full(6, np.nan))
    assert np.isnan(machine.weights).all()


def test_a_run_says_what_it_took_for_the_iron(free, saturating, axial):
    run = run_of(modelled(free))
    assert run.iron.model == "model"
    changed = np.abs(np.diff(run.currents, axis=0)).max(axis=1) > 0.0
    assert 100 < run.iron.solves - 1 <= 10 * changed.sum() < run.iron.solves + 9
    assert run.iron.newton_steps >= run.iron.solves
    assert run.iron.unsolved == run.iron.outside == 0
    assert any("model" in words for words in run.assumptions)
    assert modelled(free).iron == "model"
    assert linearised(free, START).iron == "linearised"
    assert tabled(saturating(), (4, 5, 5)).iron == "table"
    assert (
        modelled(axial.map((0.02, -0.1, 0.3))).iron
        == superposed(axial.map((0.02, -0.1, 0.3))).iron
        == "linear"
    )


def test_currents_beyond_the_maps_are_noted_and_may_end_a_run(free):
    machine = machine_of(modelled(free))
    beyond = constant([4.0, *ASKED[1:]])
    run = simulate_closed_loop(machine, beyond, PLAN, state_of([0, 0, 0]), START, None)
    assert run.touched == ("currents",)
    assert 0 < run.iron.outside < run.iron.solves
    ended = simulate_closed_loop(
        replace(machine, ending=("currents",)), beyond, PLAN, state_of([0, 0, 0]), START, None
    )
    assert ended.event.name == "beyond the map's currents"
    assert ended.event.currents[0] > 3.0
    assert ended.iron.outside == 1


def test_steps_that_do_not_converge_are_counted_and_keep_the_iron(free):
    """With a tolerance of zero no solve converges: at the start that is an error, later it is only counted."""
    with pytest.raises(NotConverged):
        run_of(replace(modelled(free), tolerance=0.0))
    hand = RunningMachine(machine_of(modelled(free)), PLAN, state_of([0, 0, 0]), START, None)
    hand.step(ASKED)
    machine = hand._begun.machine
    iron, room = IronState(machine.plant.iron), np.empty(9)
    # The tolerance of one solve also holds for the later solves.
    iron.solve(hand.currents, room, tolerance=0.0)
    before = machine.weights
    hand.step(ASKED)
    hand.step(ASKED)
    assert hand.run.iron.unsolved == 20
    assert hand.run.iron.solves == 31
    np.testing.assert_array_equal(machine.weights[6:], before[6:])
    np.testing.assert_array_equal(machine.weights[:6], hand.currents)
    # After a converged solve the run continues normally.
    iron.solve(hand.currents, room, tolerance=1e-10)
    hand.step(ASKED)
    assert hand.run.iron.unsolved == 20
    np.testing.assert_allclose(
        machine.weights[6:], iron_weights(free, hand.currents)[0][0], rtol=0, atol=1e-7
    )


def test_runs_on_threads_and_copies_of_a_machine_have_the_same_bits(free):
    """Each run has its own states; a copy or a pickle contains no function address of another process."""
    machine = machine_of(modelled(free))

    def one(machine, seed):
        return simulate_closed_loop(machine, constant(ASKED), PLAN, state_of([0, 0, 0]), START, seed)

    wanted = [run.rows for run in simulate_many(4, lambda seed: one(machine, seed), seed=1)]
    found = [run.rows for run in simulate_many(4, lambda seed: one(machine, seed), seed=1, threads=3)]
    np.testing.assert_array_equal(found, wanted)
    for other in (copy.deepcopy(machine), pickle.loads(pickle.dumps(machine))):
        again = [run.rows for run in simulate_many(4, lambda seed, other=other: one(other, seed), seed=1)]
        np.testing.assert_array_equal(again, wanted)


def test_operating_points_and_slopes_are_those_of_the_model(free):
    """At an operating point the map's own wrench balances the weight; slopes by currents are the map's as well."""
    machine = machine_of(modelled(free))
    # Three outputs carry the body; each drives an arbitrary pattern of currents.
    patterns = np.linalg.qr(RNG.normal(size=(6, 3)))[0]
    mixed = replace(machine, allocation=MatrixAllocation(patterns, START, ("a", "b", "c")))
    heavy = replace(mixed, body=replace(mixed.body, mass=2e-4))
    point = find_operating_point(heavy, [0.0, 0.0, 0.0], [np.nan] * 3, [0.1, 0.1, 0.1])
    load = free.wrench(np.zeros(3), MOMENT, point.currents)
    np.testing.assert_allclose(load[:3], [0.0, 0.0, 2e-4 * GRAVITY], rtol=0, atol=1e-6 * 2e-4 * GRAVITY)
    at_once = replace(heavy, drive=CoilDrive(Amplifier(1.0, -10.0, 10.0), 6))
    linear = linearise(at_once, point)
    wanted = free.actuation(np.zeros(3), point.currents, MOMENT).matrix[8:11] @ patterns
    np.testing.assert_allclose(linear.model.B[3:6] * 2e-4, wanted, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("given", ["resistance", "inductance"])
def test_a_winding_needs_both_its_numbers(given):
    with refused(InputError, where="CoilDrive(resistance, inductance)"):
        CoilDrive(Amplifier(1.0), 6, **{given: 2.0})

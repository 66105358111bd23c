"""The closed loop against the linear loop of fieldmap.control, its parts against closed forms, and the end of runs."""

from dataclasses import replace

import numpy as np
import pytest

from fieldmap.control import PID, simulate_loop, zero_order_hold
from fieldmap.dynamics import (
    AxisReading,
    CoilDrive,
    Schedule,
    Sensors,
    Walls,
    pid_block,
    simulate_closed_loop,
    simulate_many,
    state_of,
)
from fieldmap.errors import InputError
from fieldmap.instruments import Amplifier, Micrometer, SensorFrame, watch
from tests.dynamics.machines import CURVE, GAIN, MASS, MOMENT, PERIOD, SLOPE, one_coil
from tests.refusals import refused

HEIGHT = AxisReading("z", 1e3)


@pytest.fixture
def machine(axial):
    return one_coil(axial, skin=[[0, 0, -6e-3], [5e-3, 0, 0]])


PIDS = {"Kc": 2.0, "Ti": 0.4, "Td": 0.06, "Ts": PERIOD}


def controller(**more):
    at = np.array([0, 0, 5e-3, 0, 0, 5e-3, 1.0])
    return pid_block(PID(**(PIDS | more)), HEIGHT, 2.0 / GAIN, at)


def references(rise, samples=500):
    wanted = np.tile([0.0, 0.0, 5e-3], (samples, 1))
    wanted[50:, 2] += rise
    return wanted


def run(machine, rise=1e-5, seed=None, start=None, current=2.0, samples=500, pid=None, **more):
    schedule = Schedule(references(rise, samples), PERIOD, **({"step": 1e-4} | more))
    begin = state_of([0, 0, 0]) if start is None else start
    return simulate_closed_loop(machine, pid or controller(), schedule, begin, [current], seed)


WEAK = {"current": 0.0, "pid": controller(Kc=0.0, lower=-1.0, upper=0.1)}


def linear_plant():
    """Current to height in mm: m z'' = m_z (b1 + b2 z) i - m g - c z', about 2 A, sampled."""
    A = np.array([[0.0, 1.0], [MOMENT * CURVE * 2.0 / MASS, -0.05 / MASS]])
    B = np.array([[0.0], [MOMENT * SLOPE / MASS]])
    return zero_order_hold(A, B, PERIOD)


@pytest.mark.parametrize("late", [0.0, PERIOD])
def test_small_steps_are_those_of_the_linear_loop(machine, late):
    """Against simulate_loop of the linearised, sampled plant; a delay of one period adds a state to that plant."""
    A, B = linear_plant()
    C = np.array([[1e3, 0.0]])
    if late:
        A = np.block([[A, B], [np.zeros((1, 3))]])
        B, C = np.array([[0.0], [0.0], [1.0]]), np.array([[1e3, 0.0, 0.0]])
    wanted = simulate_loop(
        (A, B * GAIN, C, np.zeros((1, 1))), PID(**PIDS), 1e3 * (references(1e-5)[:, 2] - 5e-3)
    )
    found = run(machine, delay=late)
    assert found.event is None
    moved = 1e3 * (found.sensed[:, 2] - 5e-3)
    assert np.abs(wanted.y).max() > 0.009
    np.testing.assert_allclose(moved, wanted.y[0], atol=2e-3 * np.abs(wanted.y).max())
    np.testing.assert_allclose(found.outputs[:, 0] - 5.0, wanted.u[0], atol=5e-3 * np.abs(wanted.u).max())


def test_mechanical_steps_are_of_second_order(machine):
    ends = [run(machine, 1e-3, samples=100, step=h).position[-1, 2] for h in (4e-4, 2e-4, 1e-4, 5e-5)]
    changes = np.abs(np.diff(ends))
    np.testing.assert_allclose(np.log2(changes[:-1] / changes[1:]), 2.0, atol=0.3)


def test_a_run_is_the_same_bit_for_bit(machine):
    noisy = replace(
        machine,
        sensors=Sensors(zero_depth=0.0, deviations=(5e-6, 8e-6, 1e-5)),
        drive=CoilDrive(Amplifier(GAIN, deviation=1e-3), 1),
    )
    one, again, other = (run(noisy, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one.rows, again.rows)
    assert np.abs(one.seen - other.seen).max() > 1e-6
    many = simulate_many(4, lambda seed: run(noisy, seed=seed, samples=100), seed=1)
    threads = simulate_many(4, lambda seed: run(noisy, seed=seed, samples=100), seed=1, threads=2)
    for a, b in zip(many, threads, strict=True):
        np.testing.assert_array_equal(a.rows, b.rows)
    assert np.abs(many[0].rows - many[1].rows).max() > 0


def test_noise_has_the_deviations_and_directions_of_crossed_sensors(machine):
    """At 45 degrees, x and y both have the root mean square of the two deviations, thesis (7-1)."""
    frame = SensorFrame(np.pi / 4, offset=0.026, radius=0.0059, bias=(1e-3, 5e-3))
    seeing = Sensors(frame, 0.0, (5.42e-6, 8.38e-6, 1.04e-5))
    noisy = run(replace(machine, sensors=seeing), seed=2, samples=4000)
    noise = noisy.seen - noisy.sensed
    np.testing.assert_allclose(noise.std(axis=0), [7.06e-6, 7.06e-6, 1.04e-5], rtol=0.05)
    across = np.cov(noise[:, :2].T)[0, 1]
    np.testing.assert_allclose(across, (5.42e-6**2 - 8.38e-6**2) / 2, rtol=0.2)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=1e-6)


def test_scans_come_late_and_averaged_as_the_micrometer_says(machine):
    """Against `watch` on the simulated motion: a slow swing along x."""
    sensors = Sensors(zero_depth=0.0, scan_rate=1200.0, averages=2, latency=3)
    swing = state_of([0, 0, 0], [0.02, 0.0, 0.0])
    found = run(replace(machine, sensors=sensors), 0.0, start=swing, samples=200)
    micrometer = Micrometer(0.0, 1e-3, scan_rate=1200.0, averages=2, latency=3)
    wanted = watch(micrometer, found.time, found.sensed[:, 0], PERIOD)
    np.testing.assert_allclose(found.seen[:, 0], wanted, atol=3e-7)
    assert np.abs(found.seen[:, 0] - found.sensed[:, 0]).max() > 5e-5


def test_averaging_takes_noise_by_the_root_of_the_scans(machine):
    """Deviations measured with one scan; the sensors average 9, 16 and 1 scans."""
    seeing = Sensors(None, 0.0, (6e-6, 8e-6, 5e-6), scan_rate=5e4, averages=(9, 16, 1), measured_with=1)
    noisy = run(replace(machine, sensors=seeing), seed=3, samples=3000)
    np.testing.assert_allclose((noisy.seen - noisy.sensed).std(axis=0), [2e-6, 2e-6, 5e-6], rtol=0.06)


def test_currents_follow_resistance_and_inductance_within_the_supply(machine):
    """A command step of 0.8 A: 40 V raise the current at (40 - R i) / L up to the commanded value."""
    R, L = 4.25, 29e-3

    def after_a_period(supply, **more):
        driven = replace(machine, drive=CoilDrive(Amplifier(GAIN), 1, R, L, supply, **more))
        found = run(driven, 0.0, samples=5, step=1e-5, feedforward=np.full((5, 1), 2.0))
        return found.currents[1, 0], found.commanded[1, 0]

    i = 40 / R + (2.0 - 40 / R) * np.exp(-R / L * PERIOD)
    assert i > 2.8  # so the amplifier gets there within a period
    current, asked = after_a_period((-40.0, 40.0))
    assert current == pytest.approx(asked, rel=1e-12)
    weak, _ = after_a_period((0.0, 10.0))
    assert weak == pytest.approx(10 / R + (2.0 - 10 / R) * np.exp(-R / L * PERIOD), rel=1e-9)
    slow, asked = after_a_period((-40.0, 40.0), time_constant=1e-3)
    assert slow == pytest.approx(asked + (2.0 - asked) * np.exp(-2.0), rel=1e-9)


def test_a_disturbing_force_is_carried_by_the_integral(machine):
    found = run(machine, 0.0, samples=3000, loads=np.array([[0, 0, -0.01, 0, 0, 0]]))
    np.testing.assert_allclose(found.sensed[-1, 2], 5e-3, atol=1e-6)
    np.testing.assert_allclose(found.currents[-1, 0], (MASS * 9.80665 + 0.01) / (MOMENT * SLOPE), rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "change", "given"),
    [
        ("fell out", {}, WEAK),
        (
            "hit the pole",
            {},
            {"current": 8.0, "pid": controller(Kc=0.0, lower=9.0, upper=10.0), "rise": 0.02},
        ),
        ("left the map", {}, {"start": state_of([0, 0, 0], [3.0, 0.0, 0.0])}),
        ("hit the floor", {"walls": Walls(floor=-0.015), "ending": ("floor",)}, WEAK),
        ("hit the pole", {"walls": Walls(ceiling=0.004), "ending": ("ceiling",)}, {"rise": 0.01}),
        (
            "hit the tube",
            {"walls": Walls(radius=0.01), "ending": ("tube",)},
            {"start": state_of([0, 0, 0], [1.0, 0.0, 0.0])},
        ),
        ("current saturates", {"longest_saturation": 0.02}, WEAK),
        ("not finite", {}, {"start": state_of([0, 0, 0], angular_velocity=[1e200, 0.0, 0.0])}),
    ],
)
def test_failing_runs_end_with_a_name_and_what_was_so_far(machine, name, change, given):
    found = run(replace(machine, **change), **({"rise": 0.0} | given))
    assert found.event is not None
    assert found.event.name == name
    assert len(found.time) < 500
    assert len(found.rows) == len(found.time) == len(found.references)
    assert found.time[-1] <= found.event.time <= found.time[-1] + PERIOD + 1e-9
    assert found.event.state.shape == (13,)
    if name == "hit the floor":
        assert found.event.state[2] - 6e-3 < -0.015
    if name == "fell out":
        assert found.event.state[2] < -0.02


def test_walls_that_do_not_end_a_run_are_remembered(machine):
    found = run(
        replace(machine, walls=Walls(floor=-0.015)), 0.0, current=0.0, pid=controller(Kc=0.0, upper=0.1)
    )
    assert found.event is None
    assert found.touched == ("floor",)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"step": 3e-4}, "Schedule(step)"),
        ({"delay": 3e-3}, "Schedule(step)"),
        ({"feedforward": np.zeros((500, 2))}, "Schedule(feedforward)"),
    ],
)
def test_schedules_that_do_not_fit_are_named(machine, change, where):
    with refused(InputError, where=where):
        run(machine, **change)


@pytest.mark.parametrize(
    ("given", "fits"),
    [
        ({"delay": PERIOD}, True),
        ({"delay": PERIOD + 1e-4}, False),
        ({"delay": -1e-4}, False),
        ({"delay": 0.0}, True),
        ({"step": PERIOD}, True),
        ({"step": 2 * PERIOD}, False),
        ({"step": 1e-4 * (1 + 4e-8)}, True),
        ({"step": 1e-4 * (1 + 1e-6)}, False),
        ({"delay": 1.5e-4}, False),
        ({"step": 0.0}, False),
        ({"period": -PERIOD}, False),
        ({"every": 0}, False),
        ({"references": np.zeros((3, 2))}, False),
    ],
)
def test_rates_that_go_into_each_other(given, fits):
    about = {"references": np.zeros((7, 3)), "period": PERIOD, "step": 1e-4} | given
    if not fits:
        with pytest.raises(InputError):
            Schedule(**about)
        return
    clock = Schedule(**about, every=3).clock
    steps = round(PERIOD / about["step"]), round(given.get("delay", 0.0) / about["step"])
    assert (clock.per_period, clock.delay, clock.every) == (*steps, 3)
    assert Schedule(**about).duration == pytest.approx(7 * PERIOD)


@pytest.mark.parametrize("threads", [1, 2])
def test_many_runs_are_told_of_one_after_the_other(threads):
    told, seeds = [], []
    found = simulate_many(
        [lambda seed, k=k: seeds.append(seed) or k for k in range(4)],
        threads=threads, keep=lambda k: 10 * k, progress=lambda *given: told.append(given),
    )  # fmt: skip
    assert found == [0, 10, 20, 30]
    assert told == [(f"run {k} of 4", k / 4) for k in (1, 2, 3, 4)]
    own = np.random.SeedSequence(0).spawn(4)
    assert sorted(seed.spawn_key for seed in seeds) == [seed.spawn_key for seed in own]
    with refused(InputError, where="simulate_many(one)"):
        simulate_many(2)


@pytest.mark.parametrize("currents", [[], [2.0, 0.0], [[2.0]]])
def test_there_is_one_current_at_the_start_for_each_coil(machine, currents):
    schedule = Schedule(references(1e-5, 10), PERIOD, step=1e-4)
    with refused(InputError, where="simulate_closed_loop(currents)", received=str(np.shape(currents))):
        simulate_closed_loop(machine, controller(), schedule, state_of([0, 0, 0]), currents)

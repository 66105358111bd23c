"""The environment of Gymnasium: its checker, a controller that holds the magnet, our own simulator, speed, seeds."""

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fieldmap import dynamics
from fieldmap.core.iron import IronState
from fieldmap.device import read_device
from fieldmap.dynamics import CoilDrive, CurrentController, Drag, RigidBody, Schedule, move
from fieldmap.errors import Infeasible, InputError, OutsideMapError
from fieldmap.instruments import Amplifier, Converter
from fieldmap.kernels.coils.loop import loop_flux_density_and_gradient
from fieldmap.lookup import FiniteMagnet, interpolate
from fieldmap.sources import CoilSet
from fieldmap.store import Grid, MapData, StoredLinkage, write_map

gymnasium = pytest.importorskip("gymnasium", reason='no Gymnasium (pip install "fieldmap[gymnasium]")')
from gymnasium.utils.env_checker import check_env  # noqa: E402

from fieldmap.interop.levitation_env import ENVIRONMENT, IRON, LevitationEnv  # noqa: E402
from tests.conftest import DEVICES  # noqa: E402
from tests.docs.pages import blocks  # noqa: E402
from tests.dynamics.conftest import saturating_map  # noqa: E402
from tests.refusals import refused  # noqa: E402

MAGNET = FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]]))


def pid(env, seed, steps, gains=(60.0, 2.7, 60.0)):
    """Rewards, places and whether the episode was cut, with a PID controller of the height through all coils alike or
    through the z signal."""
    observation, _ = env.reset(seed=seed)
    whole, rewards, places = 0.0, [], []
    inner = env.unwrapped
    signals = env.action_space.shape == (3,)
    for _ in range(steps):
        whole += -observation[2] * inner.period
        # Share of the weight: currents and force are proportional.
        share = -gains[0] * observation[2] - gains[1] * observation[5] + gains[2] * whole
        if signals:
            push = -10.0 * observation[:2] - 0.5 * observation[3:5]
            action = np.array([*push, share]) / 0.5
        else:
            action = np.full(6, share)
        observation, reward, ended, cut, _ = env.step(np.clip(action, -1, 1))
        rewards.append(reward)
        places.append(inner.state[:3] - inner.target)
        if ended or cut:
            break
    return np.array(rewards), np.array(places), cut


@pytest.mark.filterwarnings("ignore:.*Box observation space.*:UserWarning")
@pytest.mark.parametrize("action", ["currents", "signals"])
def test_the_checker_passes(action):
    env = gymnasium.make(ENVIRONMENT, action=action, noise=[1e-5] * 3)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("share", "ends"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("direction", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.0, 0.8]])
def test_an_episode_ends_at_its_limit(share, ends, direction):
    """The limit is 3 mm from the target; in one period the magnet falls some 0.02 mm."""
    env = LevitationEnv(limit=3e-3)
    place = env.target + share * 3e-3 * np.array(direction)
    env.reset(seed=0, options={"state": dynamics.state_of(place)})
    _, reward, ended, cut, _ = env.step(np.zeros(env.action_space.shape))
    assert (ended, cut) == (ends, False)
    assert reward == (0.0 if ends else pytest.approx(1.0 - share**2, abs=0.02))


@pytest.mark.parametrize("action", ["currents", "signals"])
def test_a_pid_holds_ten_seconds(action):
    env = gymnasium.make(ENVIRONMENT, action=action, noise=[2e-6, 2e-6, 2e-6])
    rewards, places, cut = pid(env, 3, 6000)
    assert cut
    assert len(rewards) == 5000
    assert np.abs(places[2500:, 2]).max() < 1e-4
    assert np.abs(places).max() < 2.5e-3
    assert rewards.min() > 0.5
    # It does not hold itself.
    env.reset(seed=3)
    ended, steps = False, 0
    while not ended:
        _, reward, ended, _, _ = env.step(np.zeros(env.action_space.shape))
        steps += 1
    assert steps < 500
    assert reward == 0.0


def test_the_motion_is_that_of_our_simulator(ring):
    env = LevitationEnv(step=1e-4, drag=Drag())
    env.reset(seed=1)
    begin = env.state
    amperes = env.rest * 1.01
    share = 0.01 * env.rest / np.abs(env.rest).max()
    for _ in range(20):
        env.step(share)
    np.testing.assert_allclose(env.currents, amperes, rtol=1e-12)
    run = move(env.field.at(amperes), env.body, begin, 0.04, 1e-4)
    np.testing.assert_allclose(env.state, run.states[-1], rtol=0, atol=1e-12)
    assert abs(env.state[2] - begin[2]) > 1e-5
    # The built-in rig is that of these tests.
    np.testing.assert_allclose(
        env.field.field([0, 0, -0.1], 1.0), ring.map.field([0, 0, -0.1], 1.0), rtol=1e-12
    )


@pytest.mark.parametrize(("iron", "error"), [("model", 2e-5), ("linearised", None)])
def test_the_iron_saturates(iron, error):
    """Against our simulator in the field of the map itself, an ampere and more from the currents at rest."""
    field = saturating_map(free=True)
    body = RigidBody(0.01119, np.full(3, 2e-7), MAGNET)
    env = LevitationEnv(
        field, body, (0.0, 0.0, 0.0), span=1.5, iron=iron, drag=Drag(), step=1e-4, start=0.0, tilt=0.0
    )
    env.reset(seed=0)
    begin, action = env.state, np.array([0.9, 0.2, -0.5, 1.0, 0.6, -0.1])
    for _ in range(2):
        env.step(action)
    run = move(field.at(env.rest + 1.5 * action), body, begin, 2 * env.period, 1e-4)
    moved = np.abs(run.states[-1] - begin).max()
    off = np.abs(env.state - run.states[-1]).max() / moved
    assert off < error if error else off > 1e-2


@pytest.fixture(scope="module")
def divided():
    """A map over a division: six loops in two rows, three more as the fields of the iron, and the model of the iron of
    `saturating_map`. Also a body whose weight the middle of the domain carries, and its place."""
    grid = Grid([-0.02, -0.02, -0.12], np.full(3, 0.005), (9, 9, 13))
    angles = np.radians([240, 180, 120, 300, 0, 60, 90, 210, 330])
    centres = 0.044 * np.column_stack([np.cos(angles), np.sin(angles), np.full(9, 0.6)])
    found = [loop_flux_density_and_gradient(grid.points() - centre, 0.016) for centre in centres]
    size = 600.0 * np.array([1.0] * 6 + [0.3] * 3)[:, None]
    flux = (size * [b.ravel() for b, _ in found]).reshape(9, *grid.shape, 3)
    slope = (size * [g.ravel() for _, g in found]).reshape(9, *grid.shape, 3, 3)
    reduced = saturating_map().info.reduced_model
    data = MapData(
        grid, tuple("123456"), np.ones(6), flux_density=flux, gradient=slope, reduced_model=reduced
    )
    field, target = interpolate(data, outside_currents="evaluate"), np.array([0.001, -0.002, -0.09])
    weight = field.wrench(target, MAGNET.moments[0], reduced.domain.at(np.array([0.5, 0.5, 0.5])))[2]
    return field, RigidBody(weight / 9.80665, np.full(3, 2e-7), MAGNET), target


@pytest.mark.filterwarnings("ignore:.*Box observation space.*:UserWarning")
@pytest.mark.parametrize("action", ["currents", "signals"])
@pytest.mark.parametrize("iron", ["model", "table", "linearised"])
def test_the_checker_passes_over_a_division(divided, action, iron):
    env = LevitationEnv(*divided, action=action, iron=iron, noise=[1e-5] * 3)
    assert env.action_space.shape == (3,)
    check_env(env, skip_render_check=True)
    # The same seed gives the same episode, whatever the model of the iron has solved in between.
    episodes = []
    for far in (0.1, 0.9, 0.1):
        seen = [env.reset(seed=4)[0]] + [env.step(far * np.ones(3))[0] for _ in range(3)]
        episodes.append(seen)
    np.testing.assert_array_equal(episodes[0], episodes[2])


def machine_of(env, drive, iron):
    """The environment's machine for `RunningMachine`: outputs are the currents that are asked of the amplifiers."""
    allocation, sensors = dynamics.MatrixAllocation(np.eye(6), np.zeros(6)), dynamics.Sensors(zero_depth=0.0)
    return dynamics.Machine(IRON[iron](env.field), env.body, drive, sensors, allocation, drag=Drag())


@pytest.mark.parametrize("iron", ["model", "table"])
@pytest.mark.parametrize("winding", [None, 0.02])
def test_signals_of_a_division_move_the_machine(divided, iron, winding):
    """Against the machine moved sample by sample, at the currents that the signals make; with windings the iron is
    solved at every step."""
    coils = (
        {} if winding is None else {"resistance": [2.0] * 6, "inductance": [winding] * 6, "supply": (-20, 20)}
    )
    drive = CoilDrive(Amplifier(1.0, -1e9, 1e9), 6, **coils)
    env = LevitationEnv(*divided, iron=iron, drive=drive, drag=Drag(), step=2e-4, span=0.3, start=1e-4)
    env.reset(seed=2)
    schedule = Schedule(np.zeros((5, 3)), env.period, 2e-4)
    rig = dynamics.RunningMachine(machine_of(env, drive, iron), schedule, env.state, env.rest, None)
    begin = env.state
    domain = env.field.info.reduced_model.domain
    rest = domain.parametrisation.signals(env.rest)
    for action in np.random.default_rng(1).uniform(-1, 1, (5, 3)):
        env.step(action)
        signals = rest + 0.3 * 0.5 * (domain.upper - domain.lower) * action
        rig.step(domain.parametrisation.currents(np.clip(signals, domain.lower, domain.upper)))
        np.testing.assert_allclose(env.currents, rig.currents, rtol=1e-12)
        np.testing.assert_allclose(env.state, rig.state, rtol=0, atol=1e-13)
    assert np.abs(env.state - begin).max() > 1e-6
    assert np.ptp(env.currents - env.rest) > 1e-2


def test_signals_stay_in_the_ranges_of_the_division(divided):
    env = LevitationEnv(*divided, span=10.0)
    domain = env.field.info.reduced_model.domain
    for sense in (1.0, -1.0):
        env.reset(seed=0)
        env.step(np.full(3, sense))
        ends = domain.upper if sense > 0 else domain.lower
        np.testing.assert_allclose(domain.parametrisation.signals(env.currents), ends, rtol=1e-9)


def test_forces_by_the_signals_of_a_division(divided):
    """Each of three signals gives a thousandth of the weight along its axis and nothing along the others."""
    env = LevitationEnv(*divided, action="signals", start=0.0, tilt=0.0, span=1e-3)
    weight, moment = env.body.mass * env.body.gravity, MAGNET.moments[0]
    held = env.field.wrench(env.target, moment, env.rest)[:3]
    np.testing.assert_allclose(held, [0, 0, weight], atol=1e-6 * weight)
    domain = env.field.info.reduced_model.domain
    assert domain.holds(env.rest)
    for action in np.eye(3):
        env.reset(seed=0)
        env.step(action)
        pushed = env.field.wrench(env.target, moment, env.currents)[:3] - held
        np.testing.assert_allclose(pushed, 1e-3 * weight * action, atol=1e-5 * weight)
        assert domain.holds(env.currents)


def test_solves_that_do_not_converge_and_currents_beyond_the_map_are_told(divided):
    """With a tolerance of zero no solve converges: one fails in a step in which currents jump, none while they stay."""
    env = LevitationEnv(*divided)
    _, info = env.reset(seed=0)
    assert info == {"unsolved": 0, "outside": 0}
    # The tolerance of this solve holds for the next ones, too.
    plant = env._machine.plant
    weights = np.empty(len(env._machine.weights))
    IronState(plant.iron).solve(env.currents, weights, tolerance=0.0)
    assert env.step(np.full(3, 0.1))[4] == {"unsolved": 1, "outside": 0}
    assert env.step(np.full(3, 0.1))[4] == {"unsolved": 0, "outside": 0}
    assert env.step(np.full(3, 0.2))[4] == {"unsolved": 1, "outside": 0}
    assert env.reset(seed=0)[1] == {"unsolved": 0, "outside": 0}
    assert env.step(np.full(3, 0.1))[4] == {"unsolved": 0, "outside": 0}
    # Free currents may leave the map's range, up to 3 A.
    body = RigidBody(0.01119, np.full(3, 2e-7), MAGNET)
    env = LevitationEnv(saturating_map(free=True), body, (0.0, 0.0, 0.0), span=3.5, start=0.0, tilt=0.0)
    env.reset(seed=0)
    assert env.step(np.full(6, 0.01))[4]["outside"] == 0
    assert env.step(np.ones(6))[4] == {"unsolved": 0, "outside": 1}
    # With linear iron there is nothing to solve.
    plain = LevitationEnv()
    plain.reset(seed=0)
    assert plain.step(np.zeros(6))[4] == {"unsolved": 0, "outside": 0}


def test_rest_signals_and_reward(ring):
    env = LevitationEnv(action="signals", start=0.0, tilt=0.0)
    weight = env.body.mass * env.body.gravity
    moment = env.body.magnet.moments.sum(axis=0)
    env.reset(seed=0)
    held = env.field.wrench(env.target, moment, env.rest)[:3]
    np.testing.assert_allclose(held, [0, 0, weight], atol=1e-9 * weight)
    for axis in range(3):
        env.reset(seed=0)
        action = 0.2 * np.eye(3)[axis]
        _, reward, *_ = env.step(action)
        pushed = env.field.wrench(env.target, moment, env.currents)[:3] - held
        np.testing.assert_allclose(pushed, 0.1 * weight * np.eye(3)[axis], atol=1e-6 * weight)
        off = env.state[:3] - env.target
        assert reward == pytest.approx(1 - off @ off / 5e-3**2 - 0.01 * 0.04 / 3, rel=1e-12)


@pytest.mark.parametrize(
    ("drive", "limit"),
    [
        ({"amplifier": Amplifier(0.5, -5.0, 4.0, offset=0.1)}, 2.1),
        ({"amplifier": Amplifier(0.5, -5.0, 9.0, current_upper=2.2)}, 2.2),
        ({"amplifier": Amplifier(0.5), "converter": Converter(4.6, 16)}, 2.3),
        (
            {"amplifier": Amplifier(0.5), "resistance": 4.0, "inductance": 1e-6, "supply": (-20.0, 9.6)},
            2.4,
        ),
    ],
)
@pytest.mark.parametrize(("beyond", "held"), [(-1e-3, False), (1e-3, True)])
def test_currents_stay_within_the_drive(drive, limit, beyond, held):
    """At rest they are some 1.8 A; the currents asked for are just inside a limit or just beyond it."""
    env = LevitationEnv(drive=CoilDrive(coils=6, **drive), span=1.0)
    env.reset(seed=0)
    env.step(limit + beyond - env.rest)
    np.testing.assert_allclose(env.currents, limit if held else limit + beyond, atol=1e-9)


def test_actions_count_to_one():
    """An action beyond 1 counts as 1; one just inside counts as it is."""
    env = LevitationEnv(span=0.2)
    for given, taken in ((0.999, 0.999), (1.0, 1.0), (1.001, 1.0), (-1.001, -1.0)):
        env.reset(seed=0)
        env.step(np.full(6, given))
        np.testing.assert_allclose(env.currents - env.rest, 0.2 * taken, rtol=1e-9)


def test_an_episode_is_cut_after_its_length():
    """Ten seconds of periods of 2 ms, or the length given to `make`: the last step is cut, none before."""
    assert gymnasium.spec(ENVIRONMENT).max_episode_steps == 5000
    env = gymnasium.make(ENVIRONMENT, max_episode_steps=3, disable_env_checker=True)
    env.reset(seed=0)
    assert [env.step(np.zeros(6))[2:4] for _ in range(3)] == [(False, False)] * 2 + [(False, True)]


def test_seeds_alone_or_side_by_side():
    """In a vectorised environment each does what it does alone; other seeds give other episodes."""
    actions = np.random.default_rng(0).uniform(-0.02, 0.02, (20, 4, 6))
    keys = {"noise": [1e-5] * 3}
    together = gymnasium.make_vec(ENVIRONMENT, 4, vectorization_mode="sync", **keys)
    seen = [together.reset(seed=[7, 8, 9, 7])[0]]
    seen += [together.step(row)[0] for row in actions]
    seen = np.array(seen)
    for k, seed in enumerate((7, 8, 9)):
        env = LevitationEnv(**keys)
        alone = [env.reset(seed=seed)[0]] + [env.step(row[k])[0] for row in actions]
        np.testing.assert_array_equal(seen[:, k], alone)
    assert (seen[0, 0] == seen[0, 3]).all()
    assert np.abs(seen[0, 0, :3] - seen[0, 1, :3]).min() > 0


def test_ten_thousand_steps_a_second():
    """Through gymnasium.make, its checks of every step switched off as users do who train."""
    env = gymnasium.make(ENVIRONMENT, disable_env_checker=True)
    env.reset(seed=0)
    action, best = np.zeros(6), np.inf
    for _ in range(5):
        env.reset(seed=0)
        begin = time.perf_counter()
        for _ in range(300):
            env.step(action)
        best = min(best, (time.perf_counter() - begin) / 300)
    print(f"{1 / best:.0f} steps a second")
    assert best < 1e-4


def test_a_bead_of_soft_iron_rests_and_answers_signals():
    """A bead has no moment of its own. At rest it stays, and a signal along an axis pushes along that axis alone."""
    device = read_device(DEVICES / "five_coils_above_a_bead.toml")
    body, target = dynamics.body_of_payload(device.payload, upright=True), (0.0, 0.0, -0.015)
    field = CoilSet(device.coils, device.bounds)
    env = LevitationEnv(field, body, target, action="signals", span=1e-3, start=0.0, tilt=0.0, step=1e-4)
    env.reset(seed=0)
    env.step(np.zeros(3))
    fall = body.gravity * env.period
    np.testing.assert_allclose(env.state[3:6], 0.0, atol=1e-4 * fall)
    for action in np.eye(3):
        env.reset(seed=0)
        env.step(action)
        # A thousandth of the weight; the pull goes with the square of the currents.
        np.testing.assert_allclose(env.state[3:6], 1e-3 * fall * action, atol=3e-5 * fall)
    # A drive that gives too little is refused.
    largest = 0.3 * np.abs(env.rest).max()
    with pytest.raises(Infeasible):
        LevitationEnv(field, body, target, drive=CoilDrive(Amplifier(1.0, -largest, largest), 5))


@pytest.mark.parametrize("bandwidth", [50.0, 500.0])
def test_coils_that_linkages_couple(ring, bandwidth):
    """Against the machine moved sample by sample; a slow controller lags behind what it is asked for."""
    body = RigidBody(0.01119, [6.8e-7, 7.1e-7, 1.9e-7], MAGNET)
    linkage = StoredLinkage(0.01 * (np.eye(6) + 0.2), np.zeros(6))
    field = interpolate(replace(ring.data, linkage=linkage))
    of = {"mode": "current_controller", "controller": CurrentController(bandwidth=bandwidth)}
    drive = CoilDrive(Amplifier(1.0, -1e9, 1e9), 6, resistance=2.0, supply=(-200.0, 200.0), **of)
    env = LevitationEnv(field, body, (0.0, 0.0, -0.09), drive=drive, drag=Drag(), span=0.1, start=1e-4)
    env.reset(seed=2)
    begin, schedule = env.state, Schedule(np.zeros((5, 3)), env.period, 2e-4)
    rig = dynamics.RunningMachine(machine_of(env, drive, "model"), schedule, begin, env.rest, None)
    behind = []
    for action in np.random.default_rng(1).uniform(-1, 1, (5, 6)):
        env.step(action)
        asked = env.rest + 0.1 * action
        rig.step(asked)
        np.testing.assert_allclose(env.currents, rig.currents, rtol=1e-12)
        np.testing.assert_allclose(env.state, rig.state, rtol=0, atol=1e-13)
        behind.append(np.abs(env.currents - asked).max())
    # After a period of 2 ms, exp(-2 pi bandwidth period) of a jump is left.
    share = np.exp(-2 * np.pi * bandwidth * env.period)
    assert 0.1 * share < np.mean(behind) / 0.1 < 2.5 * share + 0.02
    again = env.reset(seed=2)[0]
    np.testing.assert_allclose(again[12:], env.rest)


def test_what_does_not_fit(ring):
    volts = CoilDrive(Amplifier(1.0), 6, resistance=2.0, mode="voltage")
    without = {"mode": "current_controller", "controller": CurrentController(bandwidth=50.0)}
    for drive in (volts, CoilDrive(Amplifier(1.0), 6, resistance=2.0, **without)):
        with pytest.raises(InputError):
            LevitationEnv(drive=drive)
    with pytest.raises(InputError):
        LevitationEnv(field=ring.map)
    with pytest.raises(InputError):
        LevitationEnv(action="volts")
    body = RigidBody(0.01119, np.full(3, 2e-7), MAGNET)
    with pytest.raises(Infeasible):
        LevitationEnv(saturating_map(), body, (0.0, 0.0, 0.0))
    with pytest.raises(InputError):
        LevitationEnv(saturating_map(free=True), body, (0.0, 0.0, 0.0), iron="table")
    env = LevitationEnv()
    far = env.state
    env.reset(seed=0)
    far = env.state
    far[2] = 1.0
    with pytest.raises(OutsideMapError):
        env.reset(options={"state": far})


def test_what_is_observed():
    """Place, velocity, the body's axis, angular velocity and currents; noise on the place alone."""
    noise = np.array([1e-5, 2e-5, 4e-5])
    env = LevitationEnv(noise=noise)
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.5])
    x, y, z, w = turn.as_quat()
    begin = [0.001, -0.002, -0.089, 0.1, 0.2, 0.3, w, x, y, z, 4.0, 5.0, 6.0]
    seen = np.array([env.reset(seed=k, options={"state": begin})[0] for k in range(200)])
    exact = [*turn.apply([0, 0, 1]), 4.0, 5.0, 6.0, *env.rest]
    np.testing.assert_allclose(seen[0, 3:], [0.1, 0.2, 0.3, *exact], rtol=1e-12)
    off = seen[:, :3] - [0.001, -0.002, 0.001]
    np.testing.assert_allclose(off.std(axis=0), noise, rtol=0.2)
    assert np.abs(off.mean(axis=0) / noise).max() < 0.3
    env = LevitationEnv(noise=[0.0, 0.0, 1e-5])
    assert np.ptp([env.reset(seed=k, options={"state": begin})[0][:3] for k in range(9)], axis=0)[
        :2
    ].tolist() == [0, 0]


def test_where_an_episode_begins():
    """At rest, up to half a millimetre off along each axis, and turned about x and y by up to 0.02 rad."""
    env = LevitationEnv()
    states = np.array([(env.reset(seed=k), env.state)[1] for k in range(300)])
    off, turned = states[:, :3] - [0.0, 0.0, -0.09], Rotation.from_quat(states[:, [7, 8, 9, 6]]).as_rotvec()
    for seen, reach in ((off, 5e-4), (turned[:, :2], 0.02)):
        assert (np.abs([seen.min(axis=0) + reach, seen.max(axis=0) - reach]) < 0.04 * reach).all()
    assert not states[:, 3:6].any()
    assert not states[:, 10:].any()
    assert np.abs(turned[:, 2]).max() < 1e-6
    body = env.body
    assert (body.mass, body.magnet.moments.tolist()) == (0.01119, [[0.0, 0.0, 0.8]])
    # A cylinder of 16 mm x 20 mm.
    np.testing.assert_allclose(body.inertia, [5.5204e-7, 5.5204e-7, 3.5808e-7], rtol=1e-4)


def test_air_slows_the_body_unless_another_drag_is_given():
    """By 1 mN s/m and 1e-8 N m s unless another is given; against our simulator, with a body that moves and turns."""
    begin = dynamics.state_of([0.0, 0.0, -0.09], (0.1, -0.2, 0.05), (1.0, 0.0, 0.0, 0.0), (20.0, -30.0, 10.0))
    air = Drag(linear=(1e-3,) * 3, turning=(1e-8,) * 3)
    ends = []
    for given, same in ((None, air), (Drag(), None), (Drag(linear=(5e-3,) * 3), Drag(linear=(5e-3,) * 3))):
        env = LevitationEnv(drag=given, step=1e-4)
        env.reset(seed=0, options={"state": begin})
        env.step(np.zeros(6))
        run = move(env.field.at(env.rest), env.body, begin, env.period, 1e-4, drag=same)
        np.testing.assert_allclose(env.state, run.states[-1], rtol=1e-9, atol=1e-12)
        ends.append(env.state)
    assert np.abs(np.diff(ends, axis=0)).max(axis=1).min() > 1e-5


def test_steps_divide_the_period():
    """Their number is the nearest whole one, at least one."""
    for step, other in ((1.2e-3, 1e-3), (1.0, 2e-3), (1.1e-4, 2e-3 / 18)):
        ends = []
        for length in (step, other):
            env = LevitationEnv(step=length)
            env.reset(seed=1)
            env.step(np.full(6, 0.5))
            ends.append(env.state)
        np.testing.assert_allclose(*ends, rtol=1e-13)
    for name, value in (("period", 0.0), ("step", 0.0), ("limit", 0.0), ("start", -1e-9), ("tilt", -1e-9)):
        with refused(InputError, where=f"LevitationEnv({name})"):
            LevitationEnv(**{name: value})
    env = LevitationEnv(start=0.0, tilt=0.0)
    env.reset(seed=1)
    assert env.state[[0, 1, 7, 8, 9]].tolist() == [0.0] * 5


def test_an_episode_ends_outside_the_map():
    env = LevitationEnv(limit=1.0)
    env.reset(seed=0, options={"state": dynamics.state_of([0.0199, 0.0, -0.09], (1.0, 0.0, 0.0))})
    _, reward, ended, cut, _ = env.step(np.zeros(6))
    assert (reward, ended, cut) == (0.0, True, False)


def test_a_rig_of_ones_own(ring, tmp_path):
    """A map or its file, by either kind of path; the magnet off the body's centre; all three arguments, or none."""
    seat = np.array([1e-3, -2e-3, 3e-3])
    body = RigidBody(0.02, np.full(3, 2e-7), MAGNET, magnet_at=seat)
    given = {"field": ring.map, "body": body, "target": (0.001, 0.002, -0.095)}
    rests = []
    for field in (ring.map, write_map(tmp_path / "ring.h5", ring.data), str(tmp_path / "ring.h5")):
        env = LevitationEnv(**given | {"field": field})
        held = ring.map.wrench(np.array(given["target"]) + seat, MAGNET.moments[0], env.rest)[:3]
        np.testing.assert_allclose(held, [0, 0, 0.02 * 9.80665], atol=1e-7)
        rests.append(env.rest)
    np.testing.assert_allclose(rests[1:], [rests[0]] * 2, rtol=1e-9)
    for count in (1, 2):
        for names in itertools.combinations(given, count):
            with refused(InputError, received=f"{count} of them"):
                LevitationEnv(**{name: given[name] for name in names})


def test_the_lines_of_the_documentation(capsys):
    names = {}
    exec(blocks("simulators.md", below="## Gymnasium")[0], names)
    assert names["steps"] == 5000
    assert names["total"] > 4900

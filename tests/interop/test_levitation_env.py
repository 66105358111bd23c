"""The environment of Gymnasium: its checker, a controller that holds the magnet, our own simulator, speed, seeds."""

import re
import time
from pathlib import Path

import numpy as np
import pytest

from fieldmap.dynamics import Drag, RigidBody, move
from fieldmap.errors import InputError, OutsideMapError
from fieldmap.lookup import FiniteMagnet

gymnasium = pytest.importorskip("gymnasium", reason='no Gymnasium (pip install "fieldmap[gymnasium]")')
from gymnasium.utils.env_checker import check_env  # noqa: E402

from fieldmap.interop.levitation_env import ENVIRONMENT, LevitationEnv  # noqa: E402
from tests.dynamics.conftest import saturating_map  # noqa: E402

ROOT = Path(__file__).parents[2]


def pid(env, seed, steps, gains=(60.0, 2.7, 60.0)):
    """Rewards and places of an episode with a PID controller of the height, all coils alike, or of the z signal."""
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
    # The made-up rig is that of these tests.
    np.testing.assert_allclose(
        env.field.field([0, 0, -0.1], 1.0), ring.map.field([0, 0, -0.1], 1.0), rtol=1e-12
    )


@pytest.mark.parametrize(("iron", "error"), [("model", 2e-5), ("linearised", None)])
def test_the_iron_saturates(iron, error):
    """Beside our simulator in the field of the map itself, an ampere and more off the currents at rest."""
    field = saturating_map(free=True)
    body = RigidBody(0.01119, np.full(3, 2e-7), FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])))
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


def test_seeds_alone_or_side_by_side():
    """Of several in one vectorised environment each does what it does alone; other seeds, other episodes."""
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


def test_what_does_not_fit(ring):
    with pytest.raises(InputError):
        LevitationEnv(field=ring.map)
    with pytest.raises(InputError):
        LevitationEnv(action="volts")
    body = RigidBody(0.01119, np.full(3, 2e-7), FiniteMagnet(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.8]])))
    with pytest.raises(InputError):
        LevitationEnv(saturating_map(), body, (0.0, 0.0, 0.0))
    env = LevitationEnv()
    far = env.state
    env.reset(seed=0)
    far = env.state
    far[2] = 1.0
    with pytest.raises(OutsideMapError):
        env.reset(options={"state": far})


def test_the_lines_of_the_documentation(capsys):
    section = (ROOT / "docs" / "other_programs.md").read_text().split("## Gymnasium")[1]
    names = {}
    exec(re.search(r"```python\n(.*?)```", section, re.DOTALL)[1], names)
    assert names["steps"] == 5000
    assert names["total"] > 4900

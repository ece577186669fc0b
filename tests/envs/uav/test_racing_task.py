import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import sada_gym  # noqa: F401 - registers
from sada_gym.envs.uav.course import Course
from sada_gym.envs.uav.races import Ending
from sada_gym.envs.uav.reference import Reference
from sada_gym.envs.uav.task import RacingTaskEnv, RacingTaskVectorEnv
from sada_gym.envs.uav.track import GATES
from sada_gym.sb3 import SB3VecEnv

ID = "SADA-RacingTask-v0"


@pytest.mark.filterwarnings("error")
def test_it_keeps_gymnasiums_and_sb3s_rules():
    check_env(gym.make(ID, render_mode="rgb_array").unwrapped)
    check_env_sb3(gym.make(ID).unwrapped)


def same(one, other):
    """Whether two nests of dictionaries and arrays are equal to the last bit."""
    if isinstance(one, dict):
        return set(one) == set(other) and all(same(one[key], other[key]) for key in one)
    if one is None or other is None:
        return one is other
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype == object:
        return len(one) == len(other) and all(map(same, one, other))
    return np.array_equal(one, other)


def test_the_batch_equals_single_environments():
    batch = gym.make_vec(ID, num_envs=18)
    single = SyncVectorEnv([RacingTaskEnv] * 18, autoreset_mode=AutoresetMode.SAME_STEP)
    assert same(batch.reset(seed=5)[0], single.reset(seed=5)[0])
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(80):
        # mostly forward and down, so that some hit frames and the ground
        actions = rng.normal([0.5, 0.0, -0.1, 0.0], 0.3, (18, 4)).clip(-1, 1).astype(np.float32)
        ours, theirs = batch.step(actions), single.step(actions)
        assert all(map(same, ours, theirs))
        ends += int((ours[2] | ours[3]).sum())
    assert ends > 0
    batch.close()
    single.close()


def test_sb3_gets_the_batch_as_a_vec_env():
    env = SB3VecEnv(RacingTaskVectorEnv(num_envs=2))
    env.seed(3)
    first = env.reset()
    alone, _ = RacingTaskEnv().reset(seed=3)
    assert same({key: value[0] for key, value in first.items()}, alone)
    seen, ended = first, None
    for _ in range(201):
        seen, _, done, infos = env.step(np.zeros((2, 4)))
        if done[0]:
            ended = infos[0]
            break
    assert ended is not None
    assert ended["TimeLimit.truncated"] is True
    assert not same(ended["terminal_observation"], {key: value[0] for key, value in seen.items()})
    env.close()


def test_good_flying_is_rewarded_and_standing_still_is_not():
    env = RacingTaskEnv()
    env.reset(seed=1)
    worth, over = 0.0, False
    while not over:
        action = Reference().act(env._lessons.races, np.zeros(1, np.intp))[0]
        _, reward, over, truncated, info = env.step(action.astype(np.float32))
        worth += reward
        assert not truncated
    assert info["is_success"]
    assert info["gates_passed"] == GATES
    assert worth > 50
    env.reset(seed=1)
    steps, truncated = 0, False
    while not truncated:
        _, reward, terminated, truncated, info = env.step(np.zeros(4, np.float32))
        assert not terminated
        steps += 1
    assert steps == 200
    assert reward == pytest.approx(-5, abs=0.1)
    assert info["gates_passed"] == 0


def test_who_flies_out_of_the_world_is_lost():
    env = RacingTaskEnv()
    env.reset(seed=2)
    terminated = False
    while not terminated:
        _, reward, terminated, truncated, _ = env.step(np.array([0.0, 0.0, 1.0, 0.0], np.float32))
        assert not truncated
    assert reward < -4
    assert Ending.LOST in env._lessons.races.endings[0]


def test_a_step_needs_a_reset():
    env = RacingTaskEnv()
    with pytest.raises(ResetNeeded, match="no drone has set off yet"):
        env.step(np.zeros(4, np.float32))
    env.reset(seed=0)
    for _ in range(200):
        env.step(np.zeros(4, np.float32))
    with pytest.raises(ResetNeeded, match="a race has ended"):
        env.step(np.zeros(4, np.float32))
    env.close()
    env.close()


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(3), r"Expected an action of shape \(4,\), got \(3,\)"),
        (np.array([0, np.nan, 0, 0]), "Expected an action of finite numbers"),
    ],
)
def test_bad_actions_are_named(action, message):
    env = RacingTaskEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(action)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"anchors": (6,)}, "Expected anchors among 3, 4, 5, got 6"),
        ({"anchors": ()}, "Expected anchors to hold at least one number"),
        ({"spread": 1.5}, "Expected spread from 0 to 1, got 1.5"),
        ({"speed_m_s": float("nan")}, "Expected speed_m_s from 0 to 16, got nan"),
    ],
)
def test_a_course_of_what_there_is_not_is_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        Course(**keywords)


def test_the_picture_is_the_cameras():
    env = RacingTaskEnv(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.std() > 10

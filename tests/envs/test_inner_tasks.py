"""The inner tasks' environments: what those of driving, racing and the robot have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import sada_gym  # noqa: F401 - registers
from sada_gym.envs.driving.episodes import LANE_TOLERANCE_M
from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv
from sada_gym.envs.robot.task import RobotTaskEnv, RobotTaskVectorEnv
from sada_gym.envs.uav.task import RacingTaskEnv, RacingTaskVectorEnv
from sada_gym.foundations.sb3_vec_env import SB3VecEnv


class Task(NamedTuple):
    """One inner task, and how to bring its episodes to an end."""

    id: str
    env: type[gym.Env]
    vector_env: type[gym.vector.VectorEnv]
    many: int
    steps: int
    actions: Callable[[np.random.Generator], np.ndarray]
    """Draws those of `many` agents, under which some episodes end within the steps."""
    least_ends: int
    fatal: list[float]
    """The action that ends an episode within 201 steps ..."""
    ended: Callable[[dict[str, Any]], bool]
    """... and whether it ended so."""


def careless_driving(rng):
    steering = rng.normal(0, 0.25, 3).clip(-1, 1)
    return np.column_stack([steering, np.full(3, 0.6)]).astype(np.float32)


def careless_flying(rng):
    # mostly forward and down, so that some hit frames and the ground
    return rng.normal([0.5, 0.0, -0.1, 0.0], 0.3, (18, 4)).clip(-1, 1).astype(np.float32)


def careless_robots(rng):
    return rng.normal([1.0, 0.0], 0.2, (6, 2)).clip(-1, 1).astype(np.float32)


def has_collided(info):
    return info["TimeLimit.truncated"] is False and info["is_success"] is False


def left_the_lane(info):
    failed = info["TimeLimit.truncated"] is False and info["is_success"] is False
    return failed and info["lateral_m"] > LANE_TOLERANCE_M


def was_late(info):
    return info["TimeLimit.truncated"] is True


TASKS = [
    Task(
        "SADA-DrivingTask-v0",
        DrivingTaskEnv,
        DrivingTaskVectorEnv,
        many=3,
        steps=60,
        actions=careless_driving,
        least_ends=4,
        fatal=[0.6, 1.0],
        ended=left_the_lane,
    ),
    Task(
        "SADA-RacingTask-v0",
        RacingTaskEnv,
        RacingTaskVectorEnv,
        many=18,
        steps=80,
        actions=careless_flying,
        least_ends=1,
        fatal=[0.0, 0.0, 0.0, 0.0],
        ended=was_late,
    ),
    Task(
        "SADA-RobotTask-v0",
        RobotTaskEnv,
        RobotTaskVectorEnv,
        many=6,
        steps=80,
        actions=careless_robots,
        least_ends=3,
        fatal=[1.0, 0.0],
        ended=has_collided,
    ),
]


@pytest.fixture(params=TASKS, ids=[task.id for task in TASKS])
def task(request):
    return request.param


def same(first, other):
    """Whether two nests of dictionaries and arrays are equal to the last bit."""
    if isinstance(first, dict):
        return set(first) == set(other) and all(same(first[key], other[key]) for key in first)
    if first is None or other is None:
        return first is other
    first, other = np.asarray(first), np.asarray(other)
    if first.dtype == object:
        return len(first) == len(other) and all(map(same, first, other))
    return np.array_equal(first, other)


def row(batch, i):
    """What environment i of a batch observes."""
    return {key: value[i] for key, value in batch.items()}


@pytest.mark.filterwarnings("error")
def test_it_keeps_gymnasiums_and_sb3s_rules(task):
    check_env(gym.make(task.id, render_mode="rgb_array").unwrapped)
    check_env_sb3(gym.make(task.id).unwrapped)


def test_the_batch_equals_single_environments(task):
    batch = gym.make_vec(task.id, num_envs=task.many)
    single = SyncVectorEnv([task.env] * task.many, autoreset_mode=AutoresetMode.SAME_STEP)
    assert same(batch.reset(seed=5)[0], single.reset(seed=5)[0])
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(task.steps):
        actions = task.actions(rng)
        ours, theirs = batch.step(actions), single.step(actions)
        assert all(map(same, ours, theirs))
        ends += int((ours[2] | ours[3]).sum())
    assert ends >= task.least_ends
    batch.close()
    single.close()


def test_each_has_spaces_of_its_own(task):
    first, other = task.env(), task.env()
    first.action_space.seed(0)
    other.action_space.seed(0)
    assert same(first.action_space.sample(), other.action_space.sample())
    batch = task.vector_env(num_envs=2)
    assert batch.single_action_space is not task.vector_env(num_envs=2).single_action_space


def test_any_seed_that_gymnasium_takes_is_taken_by_the_batch_too(task):
    seed = 2**31 + 5
    env = SB3VecEnv(task.vector_env(num_envs=2))
    env.seed(seed)
    assert same(row(env.reset(), 1), task.env().reset(seed=seed + 1)[0])
    with pytest.raises(ValueError, match="Expected seeds to be ints from 0 up, got -1"):
        task.vector_env(num_envs=1).reset(seed=-1)


def test_what_is_no_distribution_is_refused(task):
    with pytest.raises(
        ValueError,
        match=r"Expected distribution to be a (Drive|Race|Trip)Distribution, got \{'spread': 1\}",
    ):
        task.env({"spread": 1})


def test_sb3_gets_the_statistics_of_gymnasiums_wrapper(task):
    env = SB3VecEnv(RecordEpisodeStatistics(task.vector_env(num_envs=1)))
    env.reset()
    for _ in range(201):
        _, _, done, (info,) = env.step(np.tile(task.fatal, (1, 1)))
        if done[0]:
            break
    assert info["episode"]["l"] > 1


def test_sb3_gets_the_batch_as_a_vec_env(task):
    env = SB3VecEnv(task.vector_env(num_envs=2))
    env.seed(3)
    first = env.reset()
    alone, _ = task.env().reset(seed=3)
    assert same(row(first, 0), alone)
    ended = None
    for _ in range(201):
        seen, reward, done, infos = env.step(np.tile(task.fatal, (2, 1)))
        assert reward.dtype == np.float32
        if done[0]:
            ended = infos[0]
            break
    assert ended is not None
    assert task.ended(ended)
    assert not same(ended["terminal_observation"], row(seen, 0))
    env.close()


def test_sb3_is_given_only_what_resets_as_it_expects(task):
    env = SyncVectorEnv([task.env], autoreset_mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match=r"mode SAME_STEP, got .*NEXT_STEP"):
        SB3VecEnv(env)


def test_some_of_a_batch_can_set_off_anew(task):
    batch = task.vector_env(num_envs=2)
    batch.reset(seed=0)
    for _ in range(4):
        seen = batch.step(np.tile(task.fatal, (2, 1)))[0]
    anew, _ = batch.reset(seed=[7, None], options={"reset_mask": np.array([True, False])})
    alone, _ = task.env().reset(seed=7)
    assert same(row(anew, 0), alone)
    assert same(row(seen, 1), row(anew, 1))
    batch.close()


def test_a_batch_has_members_and_a_seed_for_each(task):
    with pytest.raises(ValueError, match="Expected num_envs of at least 1, got 0"):
        task.vector_env(num_envs=0)
    with pytest.raises(ValueError, match=r"Expected 2 seeds, .* got 1"):
        task.vector_env(num_envs=2).reset(seed=[1])


def test_a_step_needs_a_reset(task):
    env, action = task.env(), np.array(task.fatal, np.float32)
    with pytest.raises(ResetNeeded, match="no episode has begun yet"):
        env.step(action)
    env.reset(seed=0)
    over = False
    while not over:
        _, _, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
    with pytest.raises(ResetNeeded, match="an episode has ended"):
        env.step(action)
    env.close()


def test_an_action_of_another_shape_is_named(task):
    env = task.env()
    env.reset(seed=0)
    size = len(task.fatal)
    with pytest.raises(ValueError, match=rf"an action of shape \({size},\), got \(3,\)"):
        env.step(np.zeros(3, np.float32))


@pytest.mark.parametrize("number", [np.nan, "left"])
def test_an_action_of_no_finite_numbers_is_named(task, number):
    env = task.env()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="Expected an action of finite numbers, got"):
        env.step(np.array([number, *task.fatal[1:]]))


@pytest.mark.parametrize("many", [False, True])
def test_closing_twice_is_fine(task, many):
    env = task.vector_env(num_envs=2) if many else task.env()
    env.reset(seed=0)
    env.close()
    env.close()

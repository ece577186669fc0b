import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_env_sb3

import sada_gym  # noqa: F401 - registers
from sada_gym.envs.driving.camera import camera
from sada_gym.envs.driving.course import Course
from sada_gym.envs.driving.drives import LANE_TOLERANCE_M, Drives, Ending
from sada_gym.envs.driving.expert import Expert
from sada_gym.envs.driving.task import DrivingTaskEnv, DrivingTaskVectorEnv
from sada_gym.sb3 import SB3VecEnv

ID = "SADA-DrivingTask-v0"


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
    batch = gym.make_vec(ID, num_envs=3)
    single = SyncVectorEnv([DrivingTaskEnv] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    assert same(batch.reset(seed=5)[0], single.reset(seed=5)[0])
    rng = np.random.default_rng(0)
    ends = 0
    for _ in range(60):
        steering = rng.normal(0, 0.25, 3).clip(-1, 1)
        actions = np.column_stack([steering, np.full(3, 0.6)]).astype(np.float32)
        ours, theirs = batch.step(actions), single.step(actions)
        assert all(map(same, ours, theirs))
        ends += int((ours[2] | ours[3]).sum())
    assert ends > 3


def test_sb3_gets_the_batch_as_a_vec_env():
    env = SB3VecEnv(DrivingTaskVectorEnv(num_envs=2))
    env.seed(3)
    first = env.reset()
    alone, _ = DrivingTaskEnv().reset(seed=3)
    assert same({key: value[0] for key, value in first.items()}, alone)
    ended = None
    for _ in range(60):
        seen, reward, done, infos = env.step(np.tile([0.6, 1.0], (2, 1)))
        assert reward.dtype == np.float32
        if done[0]:
            ended = infos[0]
            break
    assert ended is not None
    assert ended["TimeLimit.truncated"] is False
    assert ended["is_success"] is False
    assert ended["lateral_m"] > LANE_TOLERANCE_M
    assert not same(ended["terminal_observation"], {key: value[0] for key, value in seen.items()})


def test_sb3_is_given_only_what_resets_as_it_expects():
    env = SyncVectorEnv([DrivingTaskEnv], autoreset_mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match=r"mode SAME_STEP, got .*NEXT_STEP"):
        SB3VecEnv(env)


def test_good_driving_is_rewarded_and_leaving_the_lane_is_not():
    env = DrivingTaskEnv()
    env.reset(seed=1)
    rewards, over = [], False
    while not over:
        drives = env._lessons.drives
        action = Expert().act(drives, np.zeros(1, np.intp))[0]
        _, reward, over, _, info = env.step(action.astype(np.float32))
        rewards.append(reward)
    assert info["is_success"]
    assert np.mean(rewards[10:-1]) > 0.6
    assert rewards[-1] > 10
    env.reset(seed=1)
    for _ in range(60):
        _, reward, over, _, info = env.step(np.array([0.5, 1.0], np.float32))
        if over:
            break
    assert reward < -9
    assert abs(info["lateral_m"]) > LANE_TOLERANCE_M


def test_who_stands_still_is_too_late():
    env = DrivingTaskEnv(Course(corners=(1, 1)))
    env.reset(seed=0)
    truncated, steps = False, 0
    while not truncated:
        _, reward, terminated, truncated, info = env.step(np.array([0.0, -1.0], np.float32))
        assert not terminated
        assert reward == 0.0
        steps += 1
    length = env._lessons.drives.starts[0].route.length_m
    assert steps == int(np.ceil(length / (10 / 3.6) * 5))
    assert info["progress_m"] == 0.0


def test_the_expert_arrives_everywhere():
    for layout in ("training", "benchmark"):
        course = Course(layout, lateral_m=0.8, turned_deg=8.0, speed_m_s=8.0)
        rng = np.random.default_rng(0)
        drives = Drives(camera(layout), [course.draw(rng) for _ in range(60)])
        expert, furthest = Expert(), 0.0
        while len(which := drives.under_way()):
            drives.step(which, expert.act(drives, which))
            furthest = max(furthest, np.abs(drives.lateral_m).max())
        assert (drives.ending == Ending.ARRIVED).all()
        assert furthest < 1.6


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(3, np.float32), r"Expected an action of shape \(2,\), got \(3,\)"),
        (np.array([0.0, np.nan], np.float32), "Expected an action of finite numbers, got"),
        (np.array(["left", "slow"]), "Expected an action of finite numbers, got"),
    ],
)
def test_a_bad_action_is_named(action, message):
    env = DrivingTaskEnv()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        env.step(action)


def test_before_a_reset_nothing_drives():
    with pytest.raises(ResetNeeded, match="no car has set off yet"):
        DrivingTaskEnv().step(np.zeros(2, np.float32))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layout": "moon"}, "a layout among benchmark, training, got 'moon'"),
        ({"weathers": ()}, r"a tuple of weathers' names, got \(\)"),
        ({"weathers": "ClearNoon"}, "a tuple of weathers' names, got 'ClearNoon'"),
        ({"weathers": ("Fog",)}, "a weather among ClearNoon, .*, got 'Fog'"),
        ({"height_m": (2.0, 1.0)}, r"height_m from low to high within 0\.5 and 5, got \(2"),
        ({"height_m": (-1.0, 1.0)}, r"height_m from low to high within 0\.5 and 5"),
        ({"height_m": (np.nan, 1.0)}, r"height_m from low to high within 0\.5 and 5"),
        ({"pitch_deg": (-60.0, 0.0)}, r"pitch_deg from low to high within -25 and 25"),
        ({"corners": (0, 2)}, r"corners from low to high within 1 and 20"),
        ({"lateral_m": 9.0}, r"lateral_m from low to high within 0 and 1\.75, got 9"),
    ],
)
def test_a_course_that_nobody_could_drive_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Course(**settings)


def test_some_cars_of_a_batch_can_set_off_anew():
    batch = DrivingTaskVectorEnv(num_envs=2)
    batch.reset(seed=0)
    for _ in range(4):
        seen = batch.step(np.tile([0.0, 1.0], (2, 1)))[0]
    anew, _ = batch.reset(seed=[7, None], options={"reset_mask": np.array([True, False])})
    alone, _ = DrivingTaskEnv().reset(seed=7)
    assert same({key: value[0] for key, value in anew.items()}, alone)
    assert same(*({key: value[1] for key, value in one.items()} for one in (seen, anew)))


def test_a_batch_has_cars_and_a_seed_for_each():
    with pytest.raises(ValueError, match="at least one environment, got num_envs=0"):
        DrivingTaskVectorEnv(num_envs=0)
    with pytest.raises(ValueError, match=r"Expected 2 seeds, .* got 1"):
        DrivingTaskVectorEnv(num_envs=2).reset(seed=[1])

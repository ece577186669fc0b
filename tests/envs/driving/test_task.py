import numpy as np
import pytest

from sada_gym.envs.driving.camera.pinhole import camera
from sada_gym.envs.driving.episodes import (
    LANE_TOLERANCE_M,
    DriveDistribution,
    DrivingEnd,
    DrivingEpisodes,
)
from sada_gym.envs.driving.task import DrivingTaskEnv
from studies.training.driving.privileged import PrivilegedDriver


def test_good_driving_is_rewarded_and_leaving_the_lane_is_not():
    env = DrivingTaskEnv()
    env.reset(seed=1)
    rewards, over = [], False
    while not over:
        drives = env.task.episodes
        action = PrivilegedDriver().act(drives, np.zeros(1, np.intp))[0]
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
    env = DrivingTaskEnv(DriveDistribution(corners=(1, 1)))
    env.reset(seed=0)
    truncated, steps = False, 0
    while not truncated:
        _, reward, terminated, truncated, info = env.step(np.array([0.0, -1.0], np.float32))
        assert not terminated
        assert reward == 0.0
        steps += 1
    length = env.task.episodes.starts[0].route.length_m
    assert steps == int(np.ceil(length / (10 / 3.6) * 5))
    assert info["progress_m"] == 0.0


def test_the_expert_arrives_everywhere():
    for layout in ("training", "benchmark"):
        distribution = DriveDistribution(layout, lateral_m=0.8, turned_deg=8.0, speed_m_s=8.0)
        rng = np.random.default_rng(0)
        drives = DrivingEpisodes(camera(layout), [distribution.draw(rng) for _ in range(60)])
        expert, furthest = PrivilegedDriver(), 0.0
        while len(which := drives.under_way()):
            drives.step(which, expert.act(drives, which))
            furthest = max(furthest, np.abs(drives.lateral_m).max())
        assert (drives.ending == DrivingEnd.ARRIVED).all()
        assert furthest < 1.6


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layout": "moon"}, "a layout among benchmark, training, got 'moon'"),
        ({"weathers": ()}, r"a tuple of weathers' names, got \(\)"),
        ({"weathers": "ClearNoon"}, "a tuple of weathers' names, got 'ClearNoon'"),
        ({"weathers": ("Fog",)}, "a weather among ClearNoon, .*, got 'Fog'"),
        ({"height_m": (2.0, 1.0)}, r"height_m .* low and high, from 0\.5 to 5, got \(2"),
        ({"height_m": (-1.0, 1.0)}, r"height_m .* low and high, from 0\.5 to 5"),
        ({"height_m": (np.nan, 1.0)}, r"height_m .* low and high, from 0\.5 to 5"),
        ({"height_m": [1.0, 2.0]}, r"height_m to be a tuple of two numbers, .*got \[1"),
        ({"height_m": (1.0, 2.0, 3.0)}, r"height_m to be a tuple of two numbers"),
        ({"pitch_deg": (-60.0, 0.0)}, r"pitch_deg .* from -25 to 25"),
        ({"corners": (0, 2)}, r"corners to be a tuple of two ints, .* from 1 to 20"),
        ({"corners": (1.5, 2.5)}, r"corners to be a tuple of two ints"),
        ({"lateral_m": 9.0}, r"lateral_m from 0 to 1\.75, got 9"),
        ({"lateral_m": "1"}, r"lateral_m from 0 to 1\.75, got '1'"),
    ],
)
def test_a_course_that_nobody_could_drive_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        DriveDistribution(**settings)

import numpy as np
import pytest

from sada_gym.envs.uav.agent.pilot import PrivilegedPilot
from sada_gym.envs.uav.episodes import RaceDistribution
from sada_gym.envs.uav.task import RacingTaskEnv
from sada_gym.envs.uav.world.referee import GateOutcome
from sada_gym.envs.uav.world.track import GATES


def test_good_flying_is_rewarded_and_standing_still_is_not():
    env = RacingTaskEnv()
    env.reset(seed=1)
    worth, over = 0.0, False
    while not over:
        action = PrivilegedPilot().act(env.task.episodes, np.zeros(1, np.intp))[0]
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
    assert GateOutcome.LOST in env.task.episodes.endings[0]


def test_the_task_ends_where_the_drone_touches_the_ground():
    env = RacingTaskEnv()
    env.reset(seed=2)
    terminated = False
    while not terminated:
        action = np.array([0.0, 0.0, -0.3, 0.0], np.float32)
        _, reward, terminated, truncated, info = env.step(action)
        assert not truncated
    assert reward == -5
    assert not info["is_success"]
    assert env.task.episodes.endings[0, 0] == GateOutcome.HIT


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"anchors": (6,)}, "Expected anchors among 3, 4, 5, got 6"),
        ({"anchors": ()}, "Expected anchors to be a tuple of at least one number"),
        ({"anchors": 3}, "Expected anchors to be a tuple of at least one number, got 3"),
        ({"spread": "a"}, "Expected spread from 0 to 1, got 'a'"),
        ({"spread": 1.5}, "Expected spread from 0 to 1, got 1.5"),
        ({"speed_m_s": float("nan")}, "Expected speed_m_s from 0 to 16, got nan"),
    ],
)
def test_a_course_of_what_there_is_not_is_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        RaceDistribution(**keywords)


def test_the_picture_is_the_cameras():
    env = RacingTaskEnv(render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8
    assert picture.std() > 10

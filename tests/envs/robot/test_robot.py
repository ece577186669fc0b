import gymnasium as gym
import numpy as np
import pytest

from sada_gym import GymnasiumApplication
from sada_gym.application import feasible_worlds
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.robot.agent.privileged import PrivilegedDriver
from sada_gym.envs.robot.application import PLANS, RobotApplication
from sada_gym.envs.robot.frame import WIDTH
from sada_gym.envs.robot.task import RobotTaskEnv
from sada_gym.envs.robot.world.floor_plan import TRIPS
from sada_gym.testing.purity import assert_pure, compare_outcomes, draw_worlds
from sada_gym.testing.rules import check_outcomes

D = 10


class Blind:
    """Follows its way and looks at nothing; an SB3 model to those who call it."""

    observation_space = RobotTaskEnv.task_class.episodes_class.observation_space
    action_space = RobotTaskEnv.task_class.episodes_class.action_space

    def predict(self, observation, *, deterministic):
        state = observation["state"]
        angle = np.arctan2(state[:, 3], state[:, 2])
        speed = np.where(abs(angle) < 0.8, 0.9, 0.0)
        return np.column_stack([speed, np.clip(2 * angle, -1, 1)]).astype(np.float32), None


def blind():
    return RobotApplication(agent=Blind(), agent_id="blind")


def test_scores_are_pure():
    assert_pure(blind(), n=4, sizes=(3,), other_process=False)


def test_more_worlds_than_are_driven_at_a_time_are_the_same(monkeypatch):
    mu, seeds = draw_worlds(blind(), 3, 1)
    together = blind().evaluate(mu, seeds)
    monkeypatch.setattr(RobotApplication, "worlds_at_once", 2)
    compare_outcomes(together, blind().evaluate(mu, seeds), "two at a time", [0, 1, 2])


def test_what_an_evaluation_tells():
    application = blind()
    check_outcomes(application)
    (info,) = application.evaluate(np.zeros((1, D)), [3]).infos
    assert len(info["endings"]) == PLANS * TRIPS == len(info["remaining_m"])
    assert info["score"] == pytest.approx(info["endings"].count("arrived") / 10)
    for ending, left in zip(info["endings"], info["remaining_m"], strict=True):
        assert (left < 0.5) == (ending == "arrived")


def test_the_batch_equals_the_scalar_environments():
    batch = AdversaryVectorEnv(RobotApplication, agent=Blind(), num_envs=2)
    batch.reset(seed=5)
    mu = draw_worlds(batch.application, 2, 0)[0]
    _, rewards, *_ = batch.step(mu)
    for i in range(2):
        env = AdversaryEnv(RobotApplication, agent=Blind())
        env.reset(seed=5 + i)
        assert env.step(mu[i])[1] == rewards[i]


GOLDEN = [("cacccccacc", 31.1989), ("caaaaaaaaa", 5.3237), ("ccccaaaaac", 19.9119)]
"""Of the blind driver: for each mu the endings of its trips (first letters), and what was left."""


def test_golden_trips():
    mu = np.random.default_rng(0).uniform(-1, 1, (3, D)).round(1)
    infos = blind().evaluate(mu, [0, 1, 2]).infos
    initials = ["".join(ending[0] for ending in info["endings"]) for info in infos]
    assert initials == [endings for endings, _ in GOLDEN]
    left = [float(info["remaining_m"].sum()) for info in infos]
    np.testing.assert_allclose(left, [metres for _, metres in GOLDEN], atol=1e-3)


@pytest.mark.long
def test_the_privileged_driver_says_what_can_be_reached():
    application = blind()
    mu, seeds = draw_worlds(application, 3, 0)
    score = application.privileged_score(mu, seeds)
    assert (score >= 0.9).all()
    assert feasible_worlds(application, mu, seeds).all()
    np.testing.assert_array_equal(
        RobotApplication(agent=PrivilegedDriver()).evaluate(mu, seeds).score, score
    )


def test_pictures_show_the_trip_that_failed():
    application = blind()
    mu = np.zeros(D)
    picture = application.render(mu, 3)
    assert picture.shape[1] == 1.5 * WIDTH
    assert application.observation(mu, 3).shape == (560, WIDTH, 3)
    rollouts = application.rollouts(mu, 3)
    assert len(rollouts) == PLANS * TRIPS
    crosses = (np.abs(picture.astype(int) - (213, 94, 0)) < 12).all(axis=-1)
    assert crosses[:, WIDTH:].any() == any(rollout.score < 1 for rollout in rollouts)


@pytest.mark.long
def test_a_replay_shows_every_step():
    application = blind()
    mu = np.full(D, -0.5)
    frames, score = application.replay(mu, 3)
    steps = sum(len(rollout["poses"]) for rollout in application.rollouts(mu, 3))
    assert len(frames) == steps + 4 * PLANS * TRIPS  # the last frame stays for a second
    assert score == application.evaluate([mu], [3]).score[0]
    assert len({frame.shape for frame in frames}) == 1


def test_the_task_takes_conditions_by_keyword():
    env = gym.make("SADA-RobotTask-v0", latency_s=0.0, obstacle_density=2.0)
    env.reset(seed=0)
    (start,) = env.unwrapped.task.episodes.starts
    assert start.conditions.latency_s == 0.0
    assert start.conditions.barrels == 16
    with pytest.raises(ValueError, match=r"Expected latency_s from 0 to 0\.6, got 3"):
        gym.make("SADA-RobotTask-v0", latency_s=3.0)


def test_the_task_is_attacked_like_any_gymnasium_environment():
    application = GymnasiumApplication(
        "SADA-RobotTask-v0",
        agent=Blind(),
        parameters={"wheel_gain": (-0.18, 0.18), "latency_s": (0.0, 0.6)},
        score="success",
        fooling_threshold=0.0,
        max_steps=300,
        episodes=4,
        agent_id="blind",
    )
    mu = np.array([[0.0, -1.0], [1.0, 1.0]])
    outcomes = application.evaluate(mu, [0, 1])
    np.testing.assert_array_equal(
        outcomes.score, application.evaluate(mu[::-1], [1, 0]).score[::-1]
    )
    assert outcomes.score[0] > 0.0
    assert application.render(mu[0], 0).shape == (560, WIDTH, 3)

"""Tests of the scores of episodes."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from wrapped_toys import cart_pole, pendulum, reach

from sada_gym import GymnasiumApplication
from sada_gym.envs.wrapped import Episode
from sada_gym.envs.wrapped.scores import as_score


def episode(rewards, **last):
    count = len(rewards)
    infos = (*({} for _ in range(count)), last)
    return Episode(
        np.array(rewards, float), (None,) * (count + 1), (0,) * count, infos, True, False
    )


@pytest.mark.parametrize(
    ("rewards", "expected"),
    [
        ([-1.0, -1.0], (0.0, False)),
        ([3.0], (1.0, True)),
        ([0.0], (0.5, False)),
        ([-9.0], (0.0, True)),
    ],
)
def test_a_return_is_placed_between_low_and_high(rewards, expected):
    assert as_score(("return", -2, 2))(episode(rewards)) == expected


def test_success_is_read_at_the_end():
    score = as_score("success")
    assert score(episode([0.0], is_success=np.True_)) == (1.0, False)
    assert score(episode([0.0], is_success=False)) == (0.0, False)
    assert score(episode([0.0], success=1.0, is_success=False)) == (0.0, False)
    assert score(episode([0.0], success=1.0)) == (1.0, False)
    wanted = r"info\['is_success'\] or info\['success'\] at the end .* keys 'speed'"
    with pytest.raises(ValueError, match=wanted):
        score(episode([0.0], speed=1.0))


def test_success_may_have_another_name():
    score = as_score(["success", "landed"])
    assert score(episode([0.0], landed=np.array([True]), success=False)) == (1.0, False)
    assert score.settings == ["success", "landed"]
    assert as_score("success").settings == "success"
    with pytest.raises(ValueError, match=r"info\['landed'\] .* keys 'speed', 'success'"):
        score(episode([0.0], speed=1.0, success=True))
    with pytest.raises(ValueError, match=r"info\['landed'\] to be True or False, 1 or 0, got arr"):
        score(episode([0.0], landed=np.ones(2)))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.nan, r"Expected True or False as success, but info\['success'\] is NaN"),
        (np.float32("nan"), "is NaN"),
        ("False", "to be True or False, 1 or 0, got 'False'"),
        (0.5, "got 0.5"),
        (None, "got None"),
        (2, "got 2"),
        ([True], r"got \[True\]"),
    ],
)
def test_nothing_but_truth_is_success(value, message):
    with pytest.raises(ValueError, match=message):
        as_score("success")(episode([0.0], success=value))


def with_infos(*infos):
    none = (None,) * len(infos)
    return Episode(np.zeros(len(infos) - 1), none, none[1:], infos, True, False)


def test_a_failure_at_any_step_counts():
    score = as_score(["failure", "crashed"])
    assert score(with_infos({}, {"crashed": False}, {"crashed": np.False_})) == (1.0, False)
    assert score(with_infos({}, {"crashed": True}, {"crashed": False})) == (0.0, False)
    assert score(with_infos({"crashed": 1}, {}, {})) == (0.0, False)
    assert score.settings == ["failure", "crashed"]
    with pytest.raises(ValueError, match=r"info\['crashed'\] at any step .* keys 'speed'"):
        score(with_infos({}, {"speed": 1.0}))
    with pytest.raises(ValueError, match=r"info\['crashed'\] to be True or False, .* got 'yes'"):
        score(with_infos({}, {"crashed": "yes"}))


def test_costs_of_all_steps_add_up_to_a_limit():
    score = as_score(("cost", 4))
    assert score(with_infos({}, {"cost": 0.0}, {})) == (1.0, False)
    assert score(with_infos({}, {"cost": np.float32(1)}, {"cost": 2})) == (0.25, False)
    assert score(with_infos({}, {"cost": 9.0})) == (0.0, False)
    assert as_score(["cost", 2, "price"])(with_infos({}, {"price": 1.0})) == (0.5, False)
    assert score.settings == ["cost", 4.0, "cost"]
    with pytest.raises(ValueError, match=r"info\['cost'\] at any step .* keys none"):
        score(with_infos({}, {}))
    with pytest.raises(ValueError, match=r"info\['cost'\] to be a number, got 'much'"):
        score(with_infos({}, {"cost": "much"}))
    with pytest.raises(ValueError, match="is not finite"):
        score(with_infos({}, {"cost": np.nan}))


class Vector(gym.Env):
    """Rewards are vectors: the number of the step, and whether the action was 1."""

    observation_space = gym.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gym.spaces.Discrete(2)

    def __init__(self, weight: float = 1.0) -> None:
        self.weight = weight

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        reward = np.array([self.steps, self.weight * action])
        return np.zeros(1, np.float32), reward, self.steps == 3, False, {"crashed": self.steps == 2}


class Plain(Vector):
    """Rewards are numbers."""

    def step(self, action):
        observation, reward, *rest = super().step(action)
        return observation, float(reward[0]), *rest


def vector(score, environment=Vector):
    return GymnasiumApplication(
        environment,
        agent=lambda observation: 1,
        agent_id="ones",
        parameters={"weight": (0.0, 1.0)},
        score=score,
        fooling_threshold=0.5,
        max_steps=5,
    )


def test_an_entry_of_vector_rewards_counts():
    assert vector(("return", 0, 3, 1)).evaluate([[1.0], [-1.0]], [0, 0]).score.tolist() == [1, 0]
    assert vector(("return", 0, 12, 0)).evaluate([[1.0]], [0]).score.tolist() == [0.5]
    for score, message in (
        (("return", 0, 3), "Choose an entry by score="),
        (("return", 0, 3, 2), "rewards with an entry 2 from Vector, as score= says, got"),
    ):
        with pytest.raises(ValueError, match=message):
            vector(score).evaluate([[0.0]], [0])
    with pytest.raises(ValueError, match="rewards with an entry 0"):
        cart_pole(score=("return", 0, 3, 0)).evaluate([[0.0, 0.0]], [0])


def test_a_failure_is_read_from_all_steps_of_an_environment():
    assert vector(("failure", "crashed"), Plain).evaluate([[0.0]], [0]).score.tolist() == [0.0]


def test_length_is_a_share():
    score = as_score(["length", 4])
    assert [score(episode([0.0] * n))[0] for n in (1, 4, 9)] == [0.25, 1.0, 1.0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("return", 1.0, 1.0), "finite low < high"),
        (("return", 0.0, np.inf), "finite low < high"),
        (("return", 0.0), "Expected score to be"),
        (("length", 0), "a number of steps"),
        ("sucess", "Expected score to be"),
        (("success", 3), "Expected score to be"),
        (("failure",), "Expected score to be"),
        (("failure", 3), "Expected score to be"),
        (("cost", 0), "with a limit above 0, got 0"),
        (("cost", 3, 4), "Expected score to be"),
        (("return", 0, 1, -1), "at least 0, got -1"),
        (("return", 0, 1, "x"), "a whole number, got 'x'"),
        (("success", "a", "b"), "Expected score to be"),
        (None, "Expected score to be"),
    ],
)
def test_what_is_no_score_gets_a_sentence(given, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(score=given)


@pytest.mark.parametrize(
    ("score", "message"),
    [
        (1.5, r"a score in \[0, 1\] from <lambda>, got 1.5"),
        (np.nan, r"a number in \[0, 1\] from <lambda>, got nan"),
        ("good", r"a number in \[0, 1\] from <lambda>, got 'good'"),
        (None, r"a number in \[0, 1\] from <lambda>, got None"),
    ],
)
def test_a_function_must_give_a_score(score, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(score=lambda episode: score).evaluate([[0.0, 0.0]], [0])


def test_a_function_that_raises_gets_a_sentence():
    with pytest.raises(ValueError, match="a score from <lambda>, got KeyError: 'speed'"):
        cart_pole(score=lambda episode: episode.infos[-1]["speed"]).evaluate([[0.0, 0.0]], [0])


def test_a_function_gets_the_whole_episode():
    seen = []

    def keep(episode):
        seen.append(episode)
        return float(episode.terminated)

    pendulum(score=keep, max_steps=5).evaluate([[0.0, 0.0]], [0])
    for values in seen:
        assert len(values) == len(values.rewards) == len(values.actions) == 5
        assert len(values.observations) == len(values.infos) == 6
        assert (values.truncated, values.terminated) == (True, False)
        assert values.total == values.rewards.sum()
        assert np.ptp([observation[0] for observation in values.observations]) > 0.0
    reach(score=keep).evaluate([[1.0]], [0])
    assert seen[-1].infos[-1]["is_success"] == seen[-1].terminated


def test_several_episodes_are_averaged():
    application = cart_pole(episodes=4)
    info = application.evaluate([[0.3, 0.5]], [1]).infos[0]
    assert info["score"] == pytest.approx(info["return"] / 500.0)
    episodes = application.episodes(np.array([[0.3, 0.5]], np.float32), [1])
    application.play(episodes)
    assert len(set(episodes.score.tolist())) > 1
    assert info["score"] == episodes.score.mean()


def test_an_environment_may_end_its_episodes_by_itself(monkeypatch):
    with pytest.raises(ValueError, match=r'max_steps="own" if it ends them by itself'):
        reach(max_steps=None)
    application = reach(max_steps="own", score=("length", 60))
    (info,) = application.evaluate([[-1.0]], [0]).infos
    assert 0 < info["length"] <= 30
    assert application.settings["max_steps"] == "own"
    with pytest.raises(ValueError, match="max_steps to be a whole number, got 'none'"):
        reach(max_steps="none")


def test_an_episode_that_does_not_end_by_itself_breaks_its_world(monkeypatch):
    monkeypatch.setattr("sada_gym.envs.wrapped.episodes.MOST_STEPS", 20)
    settings = {"max_steps": "own", "parameters": {"steps": (1.0, 99.0)}, "agent": lambda seen: 0}
    outcomes = reach(**settings).evaluate([[-1.0], [1.0]], [0, 0])
    reasons = [info["invalid"] for info in outcomes.infos]
    assert reasons == ["", "it did not end within 20 steps"]
    with pytest.raises(ValueError, match=r"max_steps='own' says, .* Pass max_steps=1000, say"):
        reach(**settings, on_error="raise").evaluate([[1.0]], [0])

"""`reuse=True` resets an environment instead of making one, and no score changes."""

from __future__ import annotations

from functools import partial
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO

import tests.support.one_engine as toys
from sada_gym import attack
from sada_gym.envs.wrapped import Attribute, Function, ObservationDelay, ResetOption
from sada_gym.errors import UserError
from tests.support.breaking_worlds import breaking, uniform
from tests.support.one_engine import OneEngine, one_engine

MU = np.random.default_rng(0).uniform(-1, 1, (6, 2)).astype(np.float32)
PARAMETERS = {
    "mass": Attribute(1.0, 4.0),
    "drag": Attribute(0.5, 2.0, factor=True),
    "late": ObservationDelay(0, 2, integer=True),
}
kept = partial(one_engine, "allowed", parameters=PARAMETERS)


@pytest.fixture(autouse=True)
def no_engine(monkeypatch):
    """Count the engines of one test."""
    for name, value in {"ALIVE": [], "most_alive": 0, "made": 0}.items():
        monkeypatch.setattr(toys, name, value)


@pytest.mark.parametrize("episodes", [1, 3])
@pytest.mark.parametrize("num_envs", [None, 1])
def test_kept_environments_give_the_same_bits_and_are_not_made_again(num_envs, episodes):
    def answers(application):
        mu = np.c_[MU, MU[:, :1]]
        outcomes = application.evaluate(mu, range(6))
        frames, score = application.replay(mu[1], 1)
        picture = application.render(mu[2], 2)
        again = application.evaluate(mu[::-1], range(6)[::-1])
        assert again.score.tolist() == outcomes.score[::-1].tolist()
        return outcomes.infos, frames, score, picture, application.behaviours(mu, range(6))

    new = answers(kept(episodes=episodes))
    application = kept(episodes=episodes, reuse=True, num_envs=num_envs)
    toys.made = toys.most_alive = 0
    assert repr(answers(application)) == repr(new)
    assert toys.most_alive == num_envs or num_envs is None
    before = toys.made
    application.evaluate(np.c_[MU, MU[:, :1]], range(6))
    assert toys.made == before
    application.close()
    assert not toys.ALIVE


def test_a_network_keeps_as_many_as_it_answers_in_one_call():
    agent = PPO("MlpPolicy", OneEngine(second="allowed"), seed=0, device="cpu")
    toys.ALIVE.clear()
    settings = {"agent": agent, "deterministic": False}
    mu = np.random.default_rng(1).uniform(-1, 1, (40, 3)).astype(np.float32)
    new = kept(**settings).evaluate(mu, range(40)).infos
    application = kept(reuse=True, **settings)
    assert application.evaluate(mu, range(40)).infos == new
    assert len(toys.ALIVE) == 16


def test_only_one_engine_is_alive_though_two_applications_keep_theirs():
    first, second = (one_engine(parameters=PARAMETERS, reuse=True, num_envs=1) for _ in range(2))
    mu = np.c_[MU, MU[:, :1]]
    for _ in range(2):
        assert (first.evaluate(mu, range(6)).score == second.evaluate(mu, range(6)).score).all()
    env, _ = first.world(mu[0], 0)
    env.close()
    assert toys.most_alive == 1


def test_a_keyword_of_the_constructor_needs_new_environments():
    with pytest.raises(UserError, match=r"takes after it is made, with reuse=True, got 'slope'"):
        one_engine(num_envs=1, reuse=True)


class Leaky(OneEngine):
    """What earlier episodes did is left in it, in a way of one's choice."""

    seen: ClassVar[int] = 0

    def __init__(self, render_mode=None, leak="speed"):
        super().__init__(render_mode, "allowed")
        self.leak, self.total = leak, 0.0
        self.own = np.random.default_rng(0)

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        if self.leak == "seed":
            self.x = self.own.normal(size=2) * 0.1
            return self.x.astype(np.float32), info
        return observation, info

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        self.total += 1.0
        if self.leak == "speed":
            self.x[1] += 0.01 * self.total
            observation = self.x.astype(np.float32)
        if self.leak == "reward":
            reward -= 0.001 * self.total
        if self.leak == "length":
            terminated = terminated or self.total > 20
        return observation, reward, terminated, truncated, info


@pytest.mark.parametrize(
    ("leak", "told"),
    {
        "speed": r"observation\[1\] was \S+, then \S+ right after step 1\.",
        "reward": r"the reward of step 1 was \S+, then \S+\.",
        "length": r"it ended after 8 steps, then after \d steps?\.|after 8 steps, then after \d",
        "seed": r"observation\[0\] was \S+, then \S+ right after its reset, which may ignore the",
    }.items(),
)
def test_what_a_reset_does_not_undo_is_told(leak, told):
    settings = {"parameters": {"mass": Attribute(1.0, 4.0)}, "env_kwargs": {"leak": leak}}
    mu = MU[:, :1]
    with pytest.raises(UserError, match=rf"as reuse=True needs, but .* seed \d.*{told}"):
        leaky(reuse=True, **settings).evaluate(mu, range(6))
    leaky(**settings).evaluate(mu, range(6))


def leaky(**kwargs):
    settings = {
        "agent": toys.hold,
        "agent_id": "hold",
        "derived": {"weight": "mass * 9.81"},
        "score": ("return", -5.0, 0.0),
        "fooling_threshold": 0.5,
        "max_steps": 20,
    }
    from sada_gym import GymnasiumApplication

    return GymnasiumApplication(Leaky, **{**settings, **kwargs})


class Careless(OneEngine):
    """Draws from NumPy's global generator."""

    def __init__(self, render_mode=None):
        super().__init__(render_mode, "allowed")

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = np.random.default_rng().normal(size=2)
        return self.x.astype(np.float32), {}


def test_an_environment_whose_reset_ignores_the_seed_gets_a_sentence(monkeypatch):
    monkeypatch.setattr(toys, "OneEngine", Careless)
    application = one_engine(parameters={"mass": (1.0, 4.0)}, env_kwargs={}, reuse=True)
    with pytest.raises(
        UserError,
        match=r"share nothing\. The first difference: .* which may ignore the seed",
    ):
        application.evaluate(MU[:, :1], range(6))


def shove(env, value):
    env.x[1] += value


class Optional(OneEngine):
    """Its reset takes where it begins."""

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed)
        self.x[0] += (options or {}).get("start", 0.0)
        return observation, info


def test_options_of_reset_and_functions_need_no_new_environment(monkeypatch):
    monkeypatch.setattr(toys, "OneEngine", Optional)
    parameters = {"start": ResetOption(-1.0, 1.0), "shove": Function(-1.0, 1.0, set=shove)}
    new, old = (
        one_engine("allowed", parameters=parameters, derived=None, reuse=reuse)
        .evaluate(MU, range(6))
        .infos
        for reuse in (False, True)
    )
    assert new == old


def test_one_that_broke_is_not_kept():
    parameters = {"mass": Attribute(0.5, 2.0), "wind": Attribute(-0.5, 0.5)}
    mu = uniform(40)
    new, old = (
        breaking("raises", parameters=parameters, reuse=reuse).evaluate(mu, range(40))
        for reuse in (False, True)
    )
    assert new.invalid
    assert old.infos == new.infos


@pytest.mark.long
def test_workers_and_a_resumed_run_have_the_same_bits(tmp_path):
    settings = {"budget": 30, "samples": 12, "seed": 0}
    new = attack(kept(), "gaussian", out=tmp_path / "a", **settings)
    old = attack(
        kept(reuse=True, num_envs=1), "gaussian", out=tmp_path / "b", workers=2, **settings
    )
    again = attack(kept(reuse=True), "gaussian", out=tmp_path / "b", resume=True, **settings)
    for run in (old, again):
        assert (run.samples.score == new.samples.score).all()


def test_gymnasiums_own_environment_is_kept():
    def pole(**options):
        return toys.GymnasiumApplication(
            "CartPole-v1",
            agent=lambda seen: int(seen[2] + seen[3] > 0),
            parameters={"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
            derived={"polemass_length": "masspole * length"},
            score=("length", 500),
            fooling_threshold=0.5,
            **options,
        )

    assert pole(reuse=True).evaluate(MU, range(6)).infos == pole().evaluate(MU, range(6)).infos
    assert isinstance(gym.spec("CartPole-v1").max_episode_steps, int)

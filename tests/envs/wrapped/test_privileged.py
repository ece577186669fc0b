"""A second agent in the same worlds tells which failures may not be the agent's own."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from wrapped_toys import balance, cart_pole, worlds

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped.toml import read_application
from sada_gym.errors import StoreError, UserError
from sada_gym.evaluations import fools


def clumsy(state: object) -> int:
    return 0


def test_it_scores_as_an_agent_would_in_the_same_worlds() -> None:
    application = cart_pole(agent=clumsy, privileged=balance)
    other = cart_pole(agent=balance)
    mu, seeds = worlds(application, 6)
    np.testing.assert_array_equal(
        application.privileged_score(mu, seeds), other.evaluate(mu, seeds).score
    )
    np.testing.assert_array_equal(
        application.evaluate(mu, seeds).score, cart_pole(agent=clumsy).evaluate(mu, seeds).score
    )
    copied = pickle.loads(pickle.dumps(application))
    np.testing.assert_array_equal(
        copied.privileged_score(mu, seeds), application.privileged_score(mu, seeds)
    )


def test_without_one_nothing_changes() -> None:
    application = cart_pole()
    mu, seeds = worlds(application, 2)
    assert application.privileged_score(mu, seeds) is None
    assert "privileged" not in application.settings


def test_a_function_needs_a_name_in_stores_and_another_agent_has_another_key() -> None:
    unnamed = cart_pole(agent_id=None, agent=PPO("MlpPolicy", "CartPole-v1"), privileged=balance)
    assert unnamed.fingerprint is None
    with pytest.raises(StoreError, match=r"the privileged agent \(balance\)"):
        attack(unnamed, "random", out="unused", budget=0, samples=1)
    keys = {
        str(cart_pole(agent=clumsy, privileged=agent, agent_id=name).settings["privileged"])
        for agent, name in ((balance, "a"), (balance, "b"))
    }
    assert len(keys) == 2


def test_the_summary_tells_failures_in_which_both_fail(tmp_path: Path) -> None:
    def result(name: str, privileged: object) -> object:
        application = cart_pole(agent=clumsy, privileged=privileged)
        return attack(
            application, "random", out=tmp_path / name, budget=0, samples=20, pictures=False
        )

    found = result("a", balance)
    application = cart_pole(agent=balance)
    mastered = ~fools(
        application.evaluate(found.samples.mu, found.samples.seed.tolist()).score, 0.5
    )
    assert found.result.feasible.worlds == mastered.sum()
    both = (found.samples.fooled(0.5) & ~mastered).sum()
    assert 0 < both < found.result.fooled
    told = " ".join(repr(found).split())
    assert f"in {both} of {found.result.fooled} failures the privileged agent fails too" in told
    assert "unknown: the privileged agent fails in the worlds of all" in repr(result("b", clumsy))


def test_worlds_that_cannot_be_computed_are_no_feasible_ones() -> None:
    class Breaks(gym.Wrapper):  # type: ignore[type-arg]
        def step(self, action: object) -> object:
            if self.unwrapped.gravity > 15.0:
                raise RuntimeError("blown up")
            return super().step(action)

    application = GymnasiumApplication(
        lambda: Breaks(gym.make("CartPole-v1")),
        agent=balance,
        privileged=balance,
        parameters={"gravity": (5.0, 20.0)},
        score=("return", 0.0, 500.0),
        fooling_threshold=0.5,
        feasible="gravity > 8",
        agent_id="by hand",
    )
    mu = np.array([[-0.9], [0.0], [0.9]], np.float32)
    scores = application.privileged_score(mu, [1, 2, 3])
    assert scores is not None
    assert scores[1] > 0.0
    assert scores[0] == scores[2] == 0.0


class Drunk:
    """Draws its actions from what nobody seeds."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng()

    def predict(self, observation: np.ndarray, **_: object) -> tuple[np.ndarray, None]:
        return self.rng.integers(2, size=len(observation)), None


def test_one_that_answers_differently_is_refused() -> None:
    application = cart_pole(privileged=Drunk(), agent_id="a")
    with pytest.raises(UserError, match="Drunk"):
        application.privileged_score(*worlds(application, 3))


@pytest.mark.parametrize("privileged", [3, "missing.zip", dict, PPO])
def test_what_is_no_agent_is_one_sentence(privileged: object) -> None:
    with pytest.raises((UserError, TypeError, ValueError), match="Expected"):
        cart_pole(privileged=privileged)


def test_a_file_names_it_as_the_agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    PPO("MlpPolicy", "CartPole-v1", n_steps=32, seed=0).save(tmp_path / "old one.zip")
    (tmp_path / "my_agents.py").write_text("def left(state):\n    return 0\n")
    text = """
environment = "CartPole-v1"
agent = "my_agents:left"
agent_id = "left"
privileged = "old one.zip"
score = ["return", 0, 60.0]
fooling_threshold = 0.5
[parameters]
gravity = [5, 20.0]
"""
    (tmp_path / "pole.toml").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    application = read_application(tmp_path / "pole.toml")
    assert application._privileged.name == "old one"
    mu, seeds = worlds(application, 2)
    assert application.privileged_score(mu, seeds).shape == (2,)
    (tmp_path / "pole.toml").write_text(text.replace('"old one.zip"', "3"))
    with pytest.raises(UserError, match="Expected 'privileged'"):
        read_application(tmp_path / "pole.toml")
    sys.modules.pop("my_agents", None)

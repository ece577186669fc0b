"""Agents with masks, with a memory, and such that draw their actions."""

from __future__ import annotations

import pickle
from functools import partial
from typing import ClassVar

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import DQN, PPO, SAC
from wrapped_toys import Reach, balance, cart_pole, pendulum, reach, worlds

from sada_gym.testing.purity import assert_pure


class Strict(Reach):
    """It ends where an action is invalid, and says which is valid."""

    refused: ClassVar[list[int]] = []

    def action_masks(self):
        return np.array([self.position[0] > 0.0, self.position[0] <= 0.0])

    def step(self, action):
        if not self.action_masks()[action]:
            self.refused.append(action)
        return super().step(action)


class Lists:
    """Its predict takes masks, and takes the first valid action of each row."""

    def predict(self, observation, deterministic, action_masks=None):
        assert action_masks.shape == (len(observation["goal"]), 2)
        return action_masks.argmax(axis=1), None


def test_masks_of_the_environment_reach_the_agent():
    Strict.refused.clear()
    application = reach(Strict, agent=Lists())
    application.evaluate(*worlds(application))
    assert not Strict.refused
    assert_pure(application, n=3, sizes=(1, 2), other_process=False)


def test_an_agent_that_needs_masks_is_refused_where_there_are_none():
    with pytest.raises(ValueError, match=r"an environment with action_masks\(\), because Lists"):
        reach(Reach, agent=Lists())


def test_masks_without_a_valid_action_are_the_environments_fault():
    class Stuck(Strict):
        def action_masks(self):
            return [False, False]

    with pytest.raises(ValueError, match=r"a valid action in Stuck, got action_masks\(\) with"):
        reach(Stuck, agent=Lists()).evaluate([[0.0]], [0])


def test_sb3s_masked_and_recurrent_models_act_as_they_do_elsewhere():
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed")
    Strict.refused.clear()
    masked = contrib.MaskablePPO("MultiInputPolicy", Strict(), seed=0, device="cpu")
    assert_pure(reach(Strict, agent=masked), n=3, sizes=(1, 2), other_process=False)
    assert not Strict.refused

    model = contrib.RecurrentPPO("MlpLstmPolicy", "CartPole-v1", seed=3, device="cpu")
    application = cart_pole(agent=model, parameters={"gravity": (9.7, 9.9)}, agent_id=None)
    assert application.policy._tile == 16
    assert application.fingerprint
    assert_pure(application, n=20, sizes=(1, 7, 16))

    class Alone:  # one episode's state, kept as SB3's documentation does it
        def __init__(self):
            self.state, self.start = None, np.ones(1, bool)

        def __call__(self, seen):
            action, self.state = model.predict(
                seen, state=self.state, episode_start=self.start, deterministic=True
            )
            self.start = np.zeros(1, bool)
            return int(action)

    alone = cart_pole(agent=Alone, parameters={"gravity": (9.7, 9.9)})
    mu, seeds = worlds(application)
    scores = application.evaluate(mu, seeds).score
    assert (alone.evaluate(mu, seeds).score == scores).all()


class Counts:
    """Balances, but every third time it does the other thing."""

    times = 0

    def __call__(self, seen):
        self.times += 1
        return balance(seen) if self.times % 3 else 1 - balance(seen)


class CountsInPredict(Counts):
    def predict(self, observation, deterministic):
        assert observation.shape == (1, 4)
        return np.array([self(observation[0])]), None

    def reset(self):
        self.times = 0


class CountsInState:
    """The same as a model whose predict is handed the state."""

    def __init__(self, pack=lambda times: {"times": times}, unpack=lambda state: state["times"]):
        self.pack, self.unpack = pack, unpack

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        assert (episode_start == (state is None)).all()
        times = np.zeros(len(observation)) if state is None else self.unpack(state)
        times = times + 1
        actions = (observation[:, 2] + observation[:, 3] > 0.0).astype(int)
        return np.where(times % 3 == 0, 1 - actions, actions), self.pack(times)


def opaque(times):
    return [float(times[0]), "seen"] if len(times) == 1 else "many"


KINDS = {
    "a class": Counts,
    "a function that makes one": lambda: Counts(),
    "a part of a class": partial(Counts),
    "an object with reset": CountsInPredict(),
    "a state of arrays": CountsInState(),
    "a state with episodes on the second axis": CountsInState(
        lambda times: (np.stack([times, times]),), lambda state: state[0][0]
    ),
    "a state of anything": CountsInState(opaque, lambda state: np.array([state[0]])),
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_agent_remembers_each_episode_by_itself(kind):
    application = cart_pole(agent=KINDS[kind])
    mu, seeds = worlds(application)
    scores = application.evaluate(mu, seeds).score
    expected = []
    for row, seed in zip(mu, seeds, strict=True):
        times = Counts()
        env = gym.make("CartPole-v1")
        gravity, length = application.parameters.physical(row[None].astype(np.float32))[0]
        env.unwrapped.gravity, env.unwrapped.length = float(gravity), float(length)
        start = application.episodes(row[None].astype(np.float32), [seed])
        seen, over, steps = start.observation(0), False, 0
        env.reset(seed=0)
        env.unwrapped.state = start.running[0].env.unwrapped.state
        while not over:
            seen, _, terminated, truncated, _ = env.step(times(seen))
            over, steps = terminated or truncated, steps + 1
        expected.append(steps / 500)
    assert scores.tolist() == expected
    assert_pure(application, n=6, sizes=(1, 4), other_process=False)


def test_an_object_with_reset_stays_as_it_was_and_shares_its_weights():
    class Network(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.layer = torch.nn.Linear(4, 2)
            self.hidden = 0.0

        def reset(self):
            self.hidden = 0.0

        def forward(self, seen):
            self.hidden += float(seen[0])
            return int(self.layer(torch.from_numpy(seen)).argmax())

    agent = Network()
    application = cart_pole(agent=agent)
    application.evaluate(*worlds(application))
    assert agent.hidden == 0.0
    copies = application.policy._agents
    assert len({id(copy) for copy in copies}) == 6
    assert {id(copy.layer.weight) for copy in copies} == {id(agent.layer.weight)}


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (lambda: 3, "to make an agent, an object with predict or a function of .*, got 3"),
        (lambda: 1 / 0, "an agent for each episode from .*, got ZeroDivisionError"),
        (PPO, "got the class PPO, which takes arguments. Make one"),
    ],
)
def test_bad_factories_get_a_sentence(agent, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(agent=agent)


def test_an_object_with_reset_that_cannot_be_copied_gets_a_sentence():
    class Held(Counts):
        def reset(self):
            pass

        def __deepcopy__(self, memo):
            raise TypeError("cannot pickle 'Session' object")

    with pytest.raises(ValueError, match=r"'Session' object\. Pass a function without arguments"):
        cart_pole(agent=Held())


class Draws:
    """Draws from its own generator, which it gets with the episode."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)

    def __call__(self, seen):
        return int(self.rng.integers(2))


def draws(seen):
    return int(np.random.random() + torch.rand(1).item() > 1.0)  # noqa: NPY002


@pytest.mark.parametrize(
    ("agent", "best"), [(Draws, True), (draws, False)], ids=["own generator", "global generators"]
)
def test_what_an_agent_draws_follows_from_the_evaluations_seed(agent, best):
    application = cart_pole(agent=agent, deterministic=best, parameters={"gravity": (9.7, 9.9)})
    assert_pure(application, n=5, sizes=(1, 3))
    lengths = [info["length"] for info in application.evaluate(np.zeros((8, 1)), range(8)).infos]
    assert len(set(lengths)) > 2
    if not best:
        with pytest.raises(ValueError, match="answers the same whenever it is asked"):
            cart_pole(agent=agent).evaluate(np.zeros((8, 2)), range(8))


@pytest.mark.long
def test_stochastic_policies_are_pure_and_other_applications():
    for model, make, env in ((PPO, cart_pole, "CartPole-v1"), (SAC, pendulum, "Pendulum-v1")):
        agent = model("MlpPolicy", env, seed=0, device="cpu")
        best, drawn = (
            make(agent=agent, agent_id=None, deterministic=deterministic)
            for deterministic in (True, False)
        )
        assert "deterministic" not in best.settings
        assert drawn.settings == {**best.settings, "deterministic": False}
        assert_pure(drawn, n=3, sizes=(1, 2), other_process=False)
        mu, seeds = worlds(best)
        extras = [
            [info["return"] for info in application.evaluate(mu, seeds).infos]
            for application in (best, drawn, pickle.loads(pickle.dumps(drawn)))
        ]
        assert extras[0] != extras[1] == extras[2]


def test_drawing_leaves_the_callers_generators_alone():
    model = PPO("MlpPolicy", "CartPole-v1", seed=0, device="cpu")
    for agent, best in ((model, False), (draws, False), (Draws, True)):
        np.random.seed(5)  # noqa: NPY002
        torch.manual_seed(5)
        before = np.random.get_state()[1].tolist(), torch.get_rng_state().tolist()  # noqa: NPY002
        application = cart_pole(agent=agent, deterministic=best)
        application.evaluate([[0.0, 0.0]], [0])
        application.rollouts([0.0, 0.0], 0)
        after = np.random.get_state()[1].tolist(), torch.get_rng_state().tolist()  # noqa: NPY002
        assert before == after


def test_a_greedy_policy_explores_by_the_evaluations_seed():
    agent = DQN("MlpPolicy", "CartPole-v1", seed=0, device="cpu")
    agent.exploration_rate = 0.5
    application = cart_pole(agent=agent, deterministic=False)
    assert_pure(application, n=4, sizes=(1, 3), other_process=False)


def test_noise_that_lasts_for_several_steps_is_refused():
    agent = PPO("MlpPolicy", "Pendulum-v1", use_sde=True, device="cpu")
    pendulum(agent=agent)
    with pytest.raises(ValueError, match="each action separately, got PPO with use_sde=True"):
        pendulum(agent=agent, deterministic=False)
    with pytest.raises(ValueError, match="deterministic to be a bool, got 1"):
        pendulum(agent=agent, deterministic=1)


def test_masks_are_for_choices():
    with pytest.raises(ValueError, match=r"actions to choose from, .* got Box"):
        pendulum(agent=Lists())

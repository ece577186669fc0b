"""The agents that `GymnasiumApplication` takes: models, objects, functions and files."""

from __future__ import annotations

import pickle
import re
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
import wrapped_toys as toys
from gymnasium import spaces
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecFrameStack, VecNormalize
from wrapped_toys import Reach, balance, cart_pole, pendulum, reach, worlds

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import Function, Keyword
from sada_gym.testing.purity import assert_pure


def trained(env):
    """An SB3 model that hardly learnt anything."""
    return PPO(
        "MlpPolicy",
        env,
        n_steps=32,
        batch_size=32,
        learning_rate=lambda left: 3e-4 * left,  # which cannot be pickled
        seed=0,
        device="cpu",
    ).learn(64)


def test_sb3_models_are_pure_with_what_they_were_trained_under():
    vec = VecFrameStack(VecNormalize(make_vec_env("Pendulum-v1", 2, seed=0)), 3)
    application = pendulum(agent=trained(vec))
    assert [type(transform).__name__ for transform in application.policy._transforms] == [
        "Normalize",
        "StackFrames",
    ]
    assert_pure(application, n=5, sizes=(1, 2, 5))
    assert application.fingerprint


class Picture(gym.Env):
    """Shows a picture, and can be neither copied nor pickled once it was made."""

    observation_space = spaces.Box(0, 255, (36, 40, 3), np.uint8)
    action_space = spaces.Discrete(2)

    def __init__(self, brightness=100):
        self.brightness = brightness
        self.handle = vars(Picture)  # a mappingproxy

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = 4
        return self._seen(), {}

    def step(self, action):
        self.left -= 1
        return self._seen(), float(action), self.left == 0, False, {}

    def _seen(self):
        return self.np_random.integers(self.brightness, size=(36, 40, 3), dtype=np.uint8)


def test_models_of_pictures_go_to_workers_without_the_environment_of_their_training():
    model = PPO("CnnPolicy", Picture(), n_steps=8, batch_size=8, seed=0, device="cpu")
    application = GymnasiumApplication(
        Picture,
        agent=model,
        agent_id="of pictures",
        parameters={"brightness": Keyword(50, 250, integer=True)},
        score=("return", 0.0, 4.0),
        fooling_threshold=0.5,
        max_steps=4,
    )
    assert [type(transform).__name__ for transform in application.policy._transforms] == [
        "TransposeImage"
    ]
    assert_pure(application, n=3, sizes=(2,))


def test_statistics_of_a_file_do_what_the_models_own_do(tmp_path):
    vec = VecNormalize(make_vec_env("Pendulum-v1", 2, seed=0))
    model = trained(VecFrameStack(vec, 2))
    vec.save(str(tmp_path / "statistics.pkl"))
    model.save(tmp_path / "model.zip")
    application = pendulum(agent=model)
    alone = partial(pendulum, agent=PPO.load(tmp_path / "model.zip", device="cpu"))
    filed = alone(vec_normalize=tmp_path / "statistics.pkl", allow_pickle=True)
    mu, seeds = worlds(application)
    scores = application.evaluate(mu, seeds).score
    assert (filed.evaluate(mu, seeds).score == scores).all()
    assert filed.fingerprint == application.fingerprint != alone().fingerprint
    assert (alone().evaluate(mu, seeds).score != scores).any()
    assert_pure(filed, n=3, sizes=(1, 2))
    with pytest.raises(ValueError, match="allow_pickle=True if it is your own"):
        alone(vec_normalize=tmp_path / "statistics.pkl")
    (tmp_path / "other.pkl").write_bytes(pickle.dumps([1]))
    with pytest.raises(ValueError, match=r"VecNormalize in .*other.pkl, got a list"):
        alone(vec_normalize=tmp_path / "other.pkl", allow_pickle=True)
    with pytest.raises(ValueError, match="VecNormalize or the path of its file, got 3"):
        alone(vec_normalize=3)


def test_statistics_of_another_environment_are_refused():
    other = VecNormalize(make_vec_env("CartPole-v1", 1))
    with pytest.raises(ValueError, match=re.escape("of shape [(3,)], got those of [(4,)]")):
        pendulum(agent=PPO("MlpPolicy", "Pendulum-v1", device="cpu"), vec_normalize=other)


@pytest.mark.parametrize("model", [PPO, DQN])
def test_models_choose_the_actions_that_they_choose_elsewhere(model):
    agent = model("MlpPolicy", "CartPole-v1", seed=1, device="cpu")
    scored = cart_pole(agent=agent, parameters={"gravity": (9.7, 9.9)})
    asked = cart_pole(
        agent=lambda seen: int(agent.predict(seen, deterministic=True)[0]),
        parameters={"gravity": (9.7, 9.9)},
    )
    mu, seeds = worlds(scored)
    assert (scored.evaluate(mu, seeds).score == asked.evaluate(mu, seeds).score).all()


def test_a_dictionary_of_observations_suits_sb3():
    agent = PPO("MultiInputPolicy", Reach(), seed=0, device="cpu")
    assert_pure(reach(agent=agent), n=5, sizes=(1, 2, 5))


def test_a_model_of_one_key_named_observation_is_no_special_case():
    env = toys.OneKey()
    vec = VecNormalize(make_vec_env(toys.OneKey, 2))
    agent = PPO("MultiInputPolicy", vec, n_steps=32, batch_size=32, device="cpu").learn(64)
    application = reach(toys.OneKey, agent=agent)
    assert isinstance(env.observation_space, spaces.Dict)
    assert_pure(application, n=3, sizes=(1, 2, 3))


def test_the_path_of_a_zip_means_the_model_in_it(tmp_path):
    model = PPO("MlpPolicy", "CartPole-v1", seed=1, device="cpu")
    model.save(tmp_path / "careful.zip")
    application = cart_pole(agent=model, agent_id=None)
    filed = cart_pole(agent=str(tmp_path / "careful.zip"), agent_id=None)
    mu, seeds = worlds(application)
    assert (filed.evaluate(mu, seeds).score == application.evaluate(mu, seeds).score).all()
    assert filed.fingerprint == application.fingerprint
    assert filed.agent_name == "careful"
    assert_pure(filed, n=3, sizes=(1, 2))


def test_a_package_that_is_missing_gets_a_sentence(monkeypatch):
    spec = gym.envs.registration.EnvSpec("Lacking-v0", entry_point="no_such_package:Env")
    monkeypatch.setitem(gym.registry, "Lacking-v0", spec)
    with pytest.raises(ValueError, match="the packages that Lacking-v0 needs, got ModuleNotFound"):
        cart_pole("Lacking-v0")


def test_wrappers_that_learn_are_refused_until_they_are_frozen():
    normalised = partial(cart_pole, parameters={"length": (0.4, 0.6)})
    with pytest.raises(ValueError, match="learn nothing, got NormalizeObservation, whose statist"):
        normalised(toys.normalised_cart_pole)
    frozen = normalised(toys.normalised_cart_pole, env_kwargs={"learning": False})
    assert_pure(frozen, n=3, sizes=(1, 2))


@pytest.mark.parametrize(
    "space",
    [
        spaces.Tuple([spaces.Discrete(2)]),
        spaces.Text(3),
        spaces.Dict(inner=spaces.Dict(x=spaces.Discrete(2))),
    ],
)
def test_observations_that_no_model_can_get_are_refused_with_a_sentence(space):
    class Blind:
        def predict(self, seen, deterministic):
            raise AssertionError

    class Odd(Reach):
        def __init__(self, speed=0.1):
            super().__init__(speed)
            self.observation_space = space

        def reset(self, *, seed=None, options=None):
            return space.sample(), {}

    with pytest.raises(ValueError, match=r"a flat dictionary of them .*, or pass a func"):
        reach(Odd, agent=Blind())


def test_a_model_for_other_spaces_is_refused():
    with pytest.raises(ValueError, match="Train it on CartPole-v1"):
        cart_pole(agent=PPO("MlpPolicy", "Acrobot-v1", device="cpu"))
    with pytest.raises(ValueError, match="Train it on Pendulum-v1"):
        pendulum(agent=PPO("MlpPolicy", "MountainCarContinuous-v0", device="cpu"))


def test_wrappers_of_training_must_be_at_work_here_too():
    model = trained(gym.wrappers.FlattenObservation(gym.make("CartPole-v1")))
    with pytest.raises(ValueError, match=r"wrapper gymnasium\.ObservationWrapper"):
        cart_pole(agent=model)
    application = cart_pole(
        toys.flat_cart_pole, agent=model, parameters={"length": (0.4, 0.6)}, agent_id="flat"
    )
    assert application.evaluate([[0.0]], [0]).score[0] > 0.0


def test_without_a_fingerprint_an_attack_asks_for_an_agent_id(tmp_path):
    with pytest.raises(ValueError, match="Pass agent_id='a name you change with the agent'"):
        attack(cart_pole(agent_id=None), "random", budget=8, samples=8, out=tmp_path / "run")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"parameters": {"long": Function(0.2, 2.0, set=toys.set_length)}},
            r"the parameter 'long' \(set_length\) is a function of your own",
        ),
        ({"score": toys.upright}, r"the score \(upright\) is a function"),
        (
            {
                "environment": toys.flat_cart_pole,
                "score": toys.upright,
                "parameters": {"length": (0.4, 0.6)},
            },
            r"the environment \(flat_cart_pole\) and the score \(upright\) are functions",
        ),
    ],
)
def test_a_function_that_makes_an_agent_id_necessary_is_named(tmp_path, change, named):
    application = cart_pole(**{"agent_id": None, **change})
    with pytest.raises(ValueError, match=f"agent_id in .*{named}.*Pass agent_id='a name'"):
        attack(application, "random", budget=8, samples=8, out=tmp_path / "run")


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (lambda seen: 1 / 0, "got ZeroDivisionError: division by zero. The agent is called as"),
        (lambda seen: 2, "action of .* from 0 to 1, got 2 at step 0 of an episode of CartPole-v1"),
        (lambda seen: float("nan"), "a whole number as the action of .*, got nan"),
        (lambda seen: [0], r"a whole number as the action of .*, got \[0\]"),
        (lambda seen: None, "a whole number as the action of .*, got None"),
    ],
)
def test_bad_choices_of_an_agent_get_a_sentence(agent, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(agent=agent).evaluate([[0.0, 0.0]], [0])


@pytest.mark.parametrize(
    ("agent", "message"),
    [
        (lambda seen: 0.5, r"an action of shape \(1,\) from .*, got shape \(\)"),
        (lambda seen: [np.nan], r"finite actions from .*, got \[nan\] at step 0"),
        (lambda seen: ["left"], "numbers as the action of .*, got"),
    ],
)
def test_bad_numbers_of_an_agent_get_a_sentence(agent, message):
    with pytest.raises(ValueError, match=message):
        pendulum(agent=agent).evaluate([[0.0, 0.0]], [0])


def test_a_model_that_gives_nan_gets_a_sentence():
    class Diverged:
        def predict(self, seen, deterministic):
            return np.full((len(seen), 1), np.nan), None

    with pytest.raises(ValueError, match="finite actions from Diverged"):
        pendulum(agent=Diverged()).evaluate([[0.0, 0.0]], [0])


@pytest.mark.parametrize(
    ("predict", "message"),
    [
        (lambda seen, deterministic: 1 / 0, "actions from Mine, got ZeroDivisionError: division"),
        (lambda seen: (seen, None), r"actions from Mine, got TypeError: .*It is called as predict"),
        (lambda seen, deterministic: np.zeros(len(seen)), r"\(actions, None\) .*, got ndarray"),
    ],
)
def test_a_bad_predict_gets_a_sentence(predict, message):
    mine = type("Mine", (), {"predict": staticmethod(predict)})
    with pytest.raises(ValueError, match=message):
        cart_pole(agent=mine())


def test_any_object_with_predict_gets_batches():
    class Batched:
        def predict(self, seen, deterministic):
            return (seen[:, 2] + seen[:, 3] > 0.0).astype(int), None

    mu, seeds = worlds(cart_pole())
    scores = cart_pole(agent=Batched()).evaluate(mu, seeds).score
    assert (scores == cart_pole().evaluate(mu, seeds).score).all()


def test_an_agent_that_remembers_is_refused():
    class Tiring:
        asked = 0

        def __call__(self, seen):
            self.asked += 1
            return balance(seen) if self.asked < 30 else 0

    application = cart_pole(agent=Tiring())
    with pytest.raises(ValueError, match="an agent that answers the same whenever it is asked"):
        application.evaluate([[0.0, 0.0]], [0])


def test_an_agent_with_the_contract_of_agents_acts_as_it_is():
    class Mine:
        fingerprint = "mine"

        def start(self, count):
            pass

        def act(self, episodes, which):
            seen = next(iter(episodes.observe(which).values()))
            return (seen[:, 2] + seen[:, 3] > 0.0).astype(int)

    mu, seeds = worlds(cart_pole())
    scores = cart_pole(agent=Mine()).evaluate(mu, seeds).score
    assert (scores == cart_pole().evaluate(mu, seeds).score).all()


class NotesThreads:
    """Keeps the contract of agents, and notes in how many threads torch computes."""

    fingerprint = "notes"

    def __init__(self):
        self.threads = set()

    def start(self, count):
        self.threads.add(torch.get_num_threads())

    def act(self, episodes, which):
        self.threads.add(torch.get_num_threads())
        return [0 for _ in which]


def test_agents_act_in_one_thread_and_their_caller_keeps_its_own(tmp_path):
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        application = cart_pole(agent=NotesThreads())
        attack(application, "random", budget=4, samples=2, out=tmp_path / "run")
        application.replay([0.0, 0.0], 0)
        assert application.agent.threads == {1}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)

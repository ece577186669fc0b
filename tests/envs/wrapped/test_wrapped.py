"""Tests of `GymnasiumApplication` from end to end."""

from __future__ import annotations

import os
import pickle
import re
import warnings
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
from wrapped_toys import Impure, Reach, Shared, balance, cart_pole, pendulum, reach

from sada_gym import GymnasiumApplication
from sada_gym.attack import attack
from sada_gym.envs.wrapped import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    Attribute,
    Function,
    Keyword,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RepeatedActions,
)
from sada_gym.testing.check import check_application, check_file
from sada_gym.testing.purity import assert_pure

DISTURBED = {
    "noise": ObservationNoise(0.0, 0.1),
    "late": ObservationDelay(0, 3),
    "lost": ObservationDropout(0.0, 0.5),
    "slow": ActionDelay(0, 3),
    "shaky": ActionNoise(0.0, 0.3),
    "repeated": RepeatedActions(1, 3),
}


def worlds(application, n=6):
    rng = np.random.default_rng(0)
    return rng.uniform(-1.0, 1.0, (n, len(application.parameters))), [*range(n)]


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


@pytest.mark.parametrize(
    "application",
    [
        partial(cart_pole, parameters={"gravity": (5.0, 20.0), **DISTURBED}),
        partial(cart_pole, episodes=3),
        partial(pendulum, parameters={"g": (5.0, 15.0), "gain": ActionGain(0.5, 1.5), **DISTURBED}),
        partial(reach, parameters={"speed": (0.05, 0.2), **DISTURBED}),
    ],
)
def test_scores_are_pure(application):
    assert_pure(application(), n=7, sizes=(1, 2, 7))


def test_sb3_models_are_pure_with_what_they_were_trained_under():
    vec = VecFrameStack(VecNormalize(make_vec_env("Pendulum-v1", 2, seed=0)), 3)
    application = pendulum(agent=trained(vec))
    assert [type(one).__name__ for one in application.acting._transforms] == [
        "Normalize",
        "StackFrames",
    ]
    assert_pure(application, n=5, sizes=(1, 2, 5))
    assert application.fingerprint


def test_statistics_of_a_file_do_what_the_models_own_do(tmp_path):
    vec = VecNormalize(make_vec_env("Pendulum-v1", 2, seed=0))
    model = trained(VecFrameStack(vec, 2))
    vec.save(str(tmp_path / "statistics.pkl"))
    model.save(tmp_path / "model.zip")
    held = pendulum(agent=model)
    alone = partial(pendulum, agent=PPO.load(tmp_path / "model.zip", device="cpu"))
    filed = alone(statistics=tmp_path / "statistics.pkl", trust=True)
    mu, seeds = worlds(held)
    scores = held.evaluate(mu, seeds).score
    assert (filed.evaluate(mu, seeds).score == scores).all()
    assert filed.fingerprint == held.fingerprint != alone().fingerprint
    assert (alone().evaluate(mu, seeds).score != scores).any()
    assert_pure(filed, n=3, sizes=(1, 2))
    with pytest.raises(ValueError, match="trust=True if it is your own"):
        alone(statistics=tmp_path / "statistics.pkl")
    (tmp_path / "other.pkl").write_bytes(pickle.dumps([1]))
    with pytest.raises(ValueError, match=r"VecNormalize in .*other.pkl, got a list"):
        alone(statistics=tmp_path / "other.pkl", trust=True)
    with pytest.raises(ValueError, match="VecNormalize or the path of its file, got 3"):
        alone(statistics=3)


def test_statistics_of_another_environment_are_refused():
    other = VecNormalize(make_vec_env("CartPole-v1", 1))
    with pytest.raises(ValueError, match=re.escape("of shape [(3,)], got those of [(4,)]")):
        pendulum(agent=PPO("MlpPolicy", "Pendulum-v1", device="cpu"), statistics=other)


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
    held = cart_pole(agent=model, agent_id=None)
    filed = cart_pole(agent=str(tmp_path / "careful.zip"), agent_id=None)
    mu, seeds = worlds(held)
    assert (filed.evaluate(mu, seeds).score == held.evaluate(mu, seeds).score).all()
    assert filed.fingerprint == held.fingerprint
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


@pytest.mark.parametrize("workers", [1, 2])
def test_eight_lines_attack_cart_pole(tmp_path, workers):
    result = attack(
        cart_pole(), "random", budget=8, samples=8, out=tmp_path / "run", workers=workers
    )
    assert result.report.afr == pytest.approx(np.mean(result.samples.score <= 0.5))
    assert result.report.settings.packages.keys() >= {"gymnasium", "torch", "stable-baselines3"}


def test_an_attack_without_pictures_warns_and_goes_on(tmp_path):
    application = reach(fooling_threshold=1.0)
    with pytest.raises(NotImplementedError, match="draws no pictures"):
        application.render([0.0], 0)
    with pytest.raises(NotImplementedError, match="draws no pictures"):
        application.replay([0.0], 0)
    with pytest.warns(UserWarning, match="No frames are drawn. Reach draws no pictures"):
        result = attack(application, "random", budget=8, samples=4, out=tmp_path / "run")
    assert {path.name for path in result.pictures} == {"marginals.png", "scores.png"}


def test_pictures_come_from_the_environment():
    application = cart_pole(episodes=2)
    last = application.render([0.0, 0.0], 3)
    first = application.observation([0.0, 0.0], 3)
    frames, score = application.replay([0.0, 0.0], 3)
    outcomes = application.evaluate([[0.0, 0.0]], [3])
    assert score == outcomes.score[0]
    assert len(frames) == 2 * outcomes.infos[0]["length"] + 2
    assert (frames[0] == first).all()
    assert any((frame == last).all() for frame in frames)
    assert last.shape == (400, 600, 3)
    assert application.render_fps == 50


def test_pictures_are_drawn_without_a_screen_and_without_a_complaint(monkeypatch, capfd):
    pytest.importorskip("pygame").quit()
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    cart_pole().observation([0.0, 0.0], 0)
    assert capfd.readouterr().err == ""
    assert "SDL_VIDEODRIVER" not in os.environ


def test_infos_have_the_same_keys_and_whole_numbers():
    application = cart_pole(
        parameters={"late": ObservationDelay(0, 3), "push": Keyword(choices=("weak", "strong"))},
        environment=toys.pushed_cart_pole,
        episodes=2,
    )
    mu, seeds = worlds(application)
    infos = application.evaluate(mu, seeds).infos
    assert {frozenset(info) for info in infos} == {
        frozenset(
            ("score", "fooled", "seed", "parameters", "return", "length", "clipped", "values")
        )
    }
    assert {info["values"]["push"] for info in infos} == {"weak", "strong"}
    assert all(info["values"]["late"] in range(4) for info in infos)
    assert all(info["return"] == info["length"] == 500 * info["score"] for info in infos)


def test_settings_and_fingerprint_tell_applications_apart():
    base = cart_pole()
    mine = partial(cart_pole, agent_id=None)
    others = [
        cart_pole(score=("return", 0.0, 400.0)),
        cart_pole(episodes=2),
        cart_pole(max_steps=100),
        cart_pole(parameters={"length": (0.2, 2.0), "gravity": (5.0, 20.0)}),
        cart_pole(parameters={"gravity": (5.0, 20.0), "length": Attribute(0.2, 2.0, unit="m")}),
        cart_pole(env_kwargs={"sutton_barto_reward": True}),
        pendulum(agent_id="by hand"),
    ]
    found = [(one.name, one.version, repr(one.settings)) for one in (base, *others)]
    assert len(set(found)) == len(found)
    assert (base.name, base.version) == ("CartPole", 1)
    assert base.fingerprint
    assert base.fingerprint != cart_pole(agent_id="other").fingerprint
    assert mine().fingerprint is None
    model = PPO("MlpPolicy", "CartPole-v1", device="cpu")
    assert mine(agent=model).fingerprint
    assert mine(agent=model, score=toys.upright).fingerprint is None
    assert cart_pole(score=toys.upright).fingerprint
    assert mine(toys.flat_cart_pole, agent=model).fingerprint is None


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


def test_workers_tell_of_clipped_returns_once(tmp_path, capfd):
    application = cart_pole(score=("return", 0.0, 20.0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        attack(application, "random", budget=120, samples=90, out=tmp_path / "run", workers=2)
    clipped = [one for one in caught if "return outside the range" in str(one.message)]
    assert len(clipped) == 1
    assert "of CartPole-v1 had" in str(clipped[0].message)
    assert "outside the range" not in capfd.readouterr().err


def test_many_clipped_returns_are_told_once():
    application = cart_pole(score=("return", 0.0, 20.0))
    mu, seeds = worlds(application, 60)
    application.evaluate(mu[:30], seeds[:30])
    with pytest.warns(UserWarning, match="return outside the range"):
        application.evaluate(mu[30:], seeds[30:])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        application.evaluate(mu, seeds)


def test_an_environment_with_global_randomness_is_found():
    report = check_application(reach(Impure))
    failed = {check.name: check.sentence for check in report.checks if not check.passed}
    assert "let it draw from its own np_random" in failed["randomness"]
    report = check_application(reach(Shared))
    failed = {check.name: check.sentence for check in report.checks if not check.passed}
    assert "purity" in failed


def test_check_finds_a_dead_parameter_by_name(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from sada_gym import GymnasiumApplication\n"
        "def balance(state):\n"
        "    return int(state[2] + state[3] > 0.0)\n"
        "mine = GymnasiumApplication('CartPole-v1', agent=balance, max_steps=200,\n"
        "    parameters={'length': (0.1, 2.0), 'masscart': (0.5, 2.0)},\n"
        "    score=('return', 0.0, 200.0), fooling_threshold=0.5)\n"
    )
    (report,) = check_file(file)
    failed = {check.name: check.sentence for check in report.checks if not check.passed}
    assert report.subject == "CartPole-v1"
    assert [*failed] == ["live parameters"]
    assert "no change by masscart over" in failed["live parameters"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"environment": "CartPole-v7"}, "Did you mean 'CartPole-v1'"),
        ({"environment": 3}, "an environment's id, or a function"),
        ({"environment": dict}, "make a gymnasium.Env, got dict"),
        ({"environment": "nowhere:CartPole-v1"}, "importable module before the colon"),
        ({"environment": toys.endless, "max_steps": None}, "Pass max_steps=1000"),
        ({"environment": toys.broken}, "got RuntimeError: no world"),
        ({"env_kwargs": {"gravty": 1}}, "keyword of CartPole-v1"),
        ({"env_kwargs": [1]}, "env_kwargs to be a dictionary"),
        ({"env_kwargs": {"render_mode": "human"}}, "env_kwargs without render_mode"),
        ({"parameters": {}}, "parameters as a dictionary"),
        ({"parameters": {"gravity": (9.0, 9.0)}}, "low < high for parameter 'gravity'"),
        ({"parameters": {"gravity": 9.0}}, r"\(low, high\) or a place"),
        ({"parameters": {"gravty": (5.0, 9.0)}}, "no 'gravty'. Did you mean gravity"),
        ({"agent": "missing.zip"}, "SB3 zip as the agent, got missing.zip: no such file"),
        (
            {"parameters": {"length": (0.2, 2.0), "b": Attribute(0.2, 2.0, paths="length")}},
            "got 'length' and 'b' for the same place",
        ),
        ({"parameters": {"step": (0.0, 1.0)}}, "a value at 'step' of CartPole-v1 .*, got a funct"),
        ({"agent": PPO}, "an agent, got the class PPO"),
        ({"agent": 3}, "a function of an observation as the agent, got 3"),
        ({"episodes": 0}, "episodes of at least 1"),
        ({"max_steps": 0}, "max_steps of at least 1"),
        ({"sample_size": 1.5}, "sample_size to be a whole number"),
        ({"fooling_threshold": 2.0}, "a number from 0 to 1"),
        ({"name": 3}, "name to be a text"),
        ({"agent_id": 3}, "agent_id to be a name"),
    ],
)
def test_bad_arguments_get_a_sentence(change, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(**change)


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


def test_a_vector_environment_alone_is_refused(monkeypatch):
    place = "gymnasium.envs.classic_control.cartpole:CartPoleVectorEnv"
    spec = gym.envs.registration.EnvSpec("Many-v0", vector_entry_point=place)
    monkeypatch.setitem(gym.registry, "Many-v0", spec)
    with pytest.raises(ValueError, match="got Many-v0, which exists as a vector environment only"):
        cart_pole("Many-v0")


def test_partial_functions_that_make_other_environments_are_told_apart():
    weak, strong = (
        cart_pole(partial(toys.pushed_cart_pole, push), parameters={"length": (0.2, 2.0)})
        for push in ("weak", "strong")
    )
    assert weak.game.maker.name == "pushed_cart_pole"
    assert weak.settings != strong.settings


def test_any_object_with_predict_gets_batches():
    class Batched:
        def predict(self, seen, deterministic):
            return (seen[:, 2] + seen[:, 3] > 0.0).astype(int), None

    mu, seeds = worlds(cart_pole())
    scores = cart_pole(agent=Batched()).evaluate(mu, seeds).score
    assert (scores == cart_pole().evaluate(mu, seeds).score).all()


def test_a_reward_that_is_no_number_gets_a_sentence():
    with pytest.raises(ValueError, match="rewards that are finite numbers from Reach"):
        reach(reward=np.nan).evaluate([[0.0]], [0])


def test_an_environment_that_raises_in_a_step_gets_a_sentence():
    with pytest.raises(ValueError, match=r"make a step with .*, got OverflowError: too far"):
        reach(fails=True).evaluate([[0.0]], [0])


def test_a_parameter_that_changes_a_space_is_refused():
    with pytest.raises(ValueError, match="the same observation space in all worlds"):
        reach(parameters={"size": Keyword(1, 3, integer=True)})


def test_box_actions_are_clipped_to_their_space():
    mu, seeds = worlds(pendulum())
    far = pendulum(agent=lambda seen: np.array([100.0]))
    near = pendulum(agent=lambda seen: np.array([2.0]))
    assert (far.evaluate(mu, seeds).score == near.evaluate(mu, seeds).score).all()


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


def test_the_class_is_loaded_by_its_name_alone():
    assert GymnasiumApplication.__module__ == "sada_gym.envs.wrapped.application"
    assert balance([0, 0, 1, 0]) == 1

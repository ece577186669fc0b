"""Tests of `GymnasiumApplication` from end to end."""

from __future__ import annotations

import os
import warnings
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import wrapped_toys as toys
from stable_baselines3 import PPO
from wrapped_toys import Impure, Shared, balance, cart_pole, pendulum, reach, worlds

from sada_gym import GymnasiumApplication, attack
from sada_gym.envs.wrapped import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    Attribute,
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


@pytest.mark.long
@pytest.mark.parametrize("workers", [1, 2])
def test_eight_lines_attack_cart_pole(tmp_path, workers):
    result = attack(
        cart_pole(), "random", budget=8, samples=8, out=tmp_path / "run", workers=workers
    )
    assert result.result.afr == pytest.approx(np.mean(result.samples.score <= 0.5))
    assert result.result.settings.packages.keys() >= {"gymnasium", "torch", "stable-baselines3"}


def test_an_attack_without_pictures_warns_and_goes_on(tmp_path):
    application = reach(fooling_threshold=1.0)
    with pytest.raises(NotImplementedError, match="draws no pictures"):
        application.render([0.0], 0)
    with pytest.raises(NotImplementedError, match="draws no pictures"):
        application.replay([0.0], 0)
    with pytest.warns(UserWarning, match="No frames are drawn. Reach draws no pictures"):
        result = attack(application, "random", budget=8, samples=4, out=tmp_path / "run")
    assert {path.name for path in result.pictures} == {"marginals.png", "scores.png"}


@pytest.mark.long
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
            (
                "score",
                "fooled",
                "seed",
                "parameters",
                "return",
                "length",
                "clipped",
                "values",
                "invalid",
            )
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
    keys = [
        (application.name, application.version, repr(application.settings))
        for application in (base, *others)
    ]
    assert len(set(keys)) == len(keys)
    assert (base.name, base.version) == ("CartPole", 1)
    assert base.fingerprint
    assert base.fingerprint != cart_pole(agent_id="other").fingerprint
    assert mine().fingerprint is None
    model = PPO("MlpPolicy", "CartPole-v1", device="cpu")
    assert mine(agent=model).fingerprint
    assert mine(agent=model, score=toys.upright).fingerprint is None
    assert cart_pole(score=toys.upright).fingerprint
    assert mine(toys.flat_cart_pole, agent=model).fingerprint is None


@pytest.mark.long
def test_workers_tell_of_clipped_returns_once(tmp_path, capfd):
    application = cart_pole(score=("return", 0.0, 20.0))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        attack(application, "random", budget=120, samples=90, out=tmp_path / "run", workers=2)
    clipped = [warning for warning in caught if "return outside the range" in str(warning.message)]
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


@pytest.mark.long
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
        ({"parameters": {"gravity": 9.0}}, r"\(low, high\) or a binding"),
        ({"parameters": {"gravty": (5.0, 9.0)}}, "no 'gravty'. Did you mean gravity"),
        ({"agent": "missing.zip"}, "SB3 zip as the agent, got missing.zip: no such file"),
        (
            {"parameters": {"length": (0.2, 2.0), "b": Attribute(0.2, 2.0, paths="length")}},
            "got 'length' and 'b' for the same target",
        ),
        ({"parameters": {"step": (0.0, 1.0)}}, "a value at 'step' of CartPole-v1 .*, got a funct"),
        ({"agent": PPO}, "an agent, got the class PPO"),
        ({"agent": 3}, "a function of an observation as the agent, got 3"),
        ({"episodes": 0}, "episodes of at least 1"),
        ({"max_steps": 0}, "max_steps of at least 1"),
        ({"sample_size": 1.5}, "sample_size to be a whole number"),
        ({"fooling_threshold": 2.0}, "a number from 0 to 1"),
        ({"name": 3}, "name to be a text"),
        ({"agent_id": 3}, "agent_id in one line"),
    ],
)
def test_bad_arguments_get_a_sentence(change, message):
    with pytest.raises(ValueError, match=message):
        cart_pole(**change)


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
    assert weak.episode_spec.factory.name == "pushed_cart_pole"
    assert weak.settings != strong.settings


@pytest.mark.parametrize("on_error", ["raise", "invalid", "fooled"])
def test_a_reward_of_several_numbers_gets_the_advice_to_choose_one(on_error):
    """No world is at fault, so that none counts as fooled or invalid."""
    advice = r"Expected one number as a reward from Reach, got .* Choose an entry .* by a wrapper"
    with pytest.raises(
        TypeError, match=rf"{advice}.*TransformReward\(env, lambda reward: reward @ weights"
    ):
        reach(reward=np.array([1.0, 2.0]), on_error=on_error).evaluate([[0.0]], [0])


def test_the_advice_on_a_reward_of_several_numbers_works():
    def make(**kwargs):
        env = toys.Reach(reward=np.array([0.25, 2.0]), **kwargs)
        return gym.wrappers.TransformReward(env, lambda reward: reward[0])

    chosen = reach(environment=make, score=("return", 0, 10))
    plain = reach(reward=0.25, score=("return", 0, 10))
    scores = [one.evaluate([[0.0]], [0]).score for one in (chosen, plain)]
    np.testing.assert_array_equal(*scores)


def test_a_reward_that_is_no_number_gets_a_sentence():
    with pytest.raises(ValueError, match="rewards that are finite numbers from Reach"):
        reach(reward=np.nan, on_error="raise").evaluate([[0.0]], [0])


def test_an_environment_that_raises_in_a_step_gets_a_sentence():
    with pytest.raises(ValueError, match=r"make a step with .*, got OverflowError: too far"):
        reach(fails=True, on_error="raise").evaluate([[0.0]], [0])


def test_a_parameter_that_changes_a_space_is_refused():
    with pytest.raises(ValueError, match="the same observation space in all worlds"):
        reach(parameters={"size": Keyword(1, 3, integer=True)})


def test_box_actions_are_clipped_to_their_space():
    mu, seeds = worlds(pendulum())
    far = pendulum(agent=lambda seen: np.array([100.0]))
    near = pendulum(agent=lambda seen: np.array([2.0]))
    assert (far.evaluate(mu, seeds).score == near.evaluate(mu, seeds).score).all()


def test_the_class_is_loaded_by_its_name_alone():
    assert GymnasiumApplication.__module__ == "sada_gym.envs.wrapped.application"
    assert balance([0, 0, 1, 0]) == 1

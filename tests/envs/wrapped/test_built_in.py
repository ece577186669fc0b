"""Controllers inside the simulator: `agent="built-in"`, and agents that get the environment."""

from __future__ import annotations

from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from typer.testing import CliRunner

from sada_gym import GymnasiumApplication, attack
from sada_gym.agents.built_in import BuiltInAgent
from sada_gym.agents.functions import agent_of
from sada_gym.cli import app
from sada_gym.envs.wrapped import Attribute, ObservationNoise, inspection
from sada_gym.errors import UserError
from sada_gym.evaluation.key import ApplicationKey


class Cruise(gym.Env):
    """A cruise control holds a speed against a slope; the action adds to its throttle."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    action_space = spaces.Box(-1, 1, (1,), np.float32)

    def __init__(self, render_mode=None, gain=0.5):
        self.gain, self.slope, self.target = gain, 0.0, 1.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.speed = self.np_random.uniform(0.5, 1.5)
        return np.array([self.speed], np.float32), {}

    def step(self, action):
        throttle = self.gain * (self.target - self.speed) + float(action[0])
        self.speed += throttle - self.slope
        return np.array([self.speed], np.float32), -abs(1.0 - self.speed), False, False, {}


gym.register("Cruise-v3", Cruise, max_episode_steps=9)
MU = np.random.default_rng(0).uniform(-1, 1, (5, 1)).astype(np.float32)


def cruising(agent="built-in", **kwargs):
    settings = {
        "parameters": {"slope": Attribute(0.0, 0.3)},
        "score": ("return", -9.0, 0.0),
        "fooling_threshold": 0.7,
    }
    return GymnasiumApplication("Cruise-v3", agent=agent, **{**settings, **kwargs})


def test_an_environment_that_acts_by_itself_gets_zero():
    application = cruising()
    zero = cruising(lambda _: [0.0])
    assert application.agent_name == "built-in"
    assert (application.evaluate(MU, range(5)).score == zero.evaluate(MU, range(5)).score).all()
    assert cruising(reuse=True, num_envs=1).evaluate(MU, range(5)).infos == (
        application.evaluate(MU, range(5)).infos
    )


@pytest.mark.parametrize(
    ("space", "action"),
    [
        (spaces.Box(0.5, 2.0, (2,), np.float32), [0.5, 0.5]),
        (spaces.Discrete(3), 0),
        (spaces.Discrete(3, start=2), 2),
        (spaces.Discrete(3, start=-5), -3),
        (spaces.MultiDiscrete([2, 3]), [0, 0]),
        (spaces.MultiDiscrete([2, 3], start=[1, 0]), [1, 0]),
        (spaces.MultiBinary(2), [0, 0]),
    ],
)
def test_the_action_is_the_one_nearest_to_zero(space, action):
    (given,) = BuiltInAgent(space, "").act(None, np.zeros(1, np.intp))
    assert np.asarray(given).tolist() == action


def test_its_identity_is_the_package_its_version_and_the_keywords(monkeypatch):
    same, other = cruising().fingerprint, cruising(env_kwargs={"gain": 0.1}).fingerprint
    assert cruising().fingerprint == same != other
    keys = [ApplicationKey.of(cruising(fooling_threshold=limit)) for limit in (0.7, 0.8)]
    assert keys[0].fingerprint == keys[1].fingerprint

    def pole():
        return GymnasiumApplication(
            "CartPole-v1",
            agent="built-in",
            parameters={"gravity": (5.0, 20.0)},
            score=("length", 500),
            fooling_threshold=0.5,
        ).fingerprint

    now = pole()
    monkeypatch.setattr(inspection, "version", lambda _: "99.0")
    assert pole() != now


@pytest.mark.long
def test_a_file_names_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cruise.toml").write_text(
        f'environment = "{__name__}:Cruise-v3"\nagent = "built-in"\n'
        'score = ["return", -9.0, 0.0]\nfooling_threshold = 0.7\n'
        '[parameters]\nslope = { kind = "attribute", low = 0.0, high = 0.3 }\n'
    )
    command = [
        "attack",
        "cruise.toml",
        "--adversary",
        "random",
        "--budget",
        "20",
        "--samples",
        "12",
    ]
    result = CliRunner().invoke(app, [*command, "--out", "run"])
    assert result.exit_code == 0, result.output
    assert "built-in" in (tmp_path / "run" / "result.json").read_text()


class Controller:
    """Looks into the environment for the slope, which no observation shows."""

    def __init__(self, start=0):
        self.calls = 0

    def predict(self, observation, deterministic=True, env=None):
        assert observation.shape == (1,)
        return np.array([env.unwrapped.slope]), None


class Remembering(Controller):
    def reset(self, seed):
        self.last = 0.0

    def predict(self, observation, deterministic=True, env=None):
        self.last = env.unwrapped.slope
        return [self.last]


def controls(observation, env):
    return [env.unwrapped.slope]


@pytest.mark.parametrize("agent", [Controller(), Remembering(), Remembering, controls])
def test_a_controller_that_has_an_argument_env_gets_it(agent):
    slopes = {"slope": Attribute(0.0, 0.3), "noise": ObservationNoise(0.0, 0.1)}
    seen, blind = (
        cruising(one, parameters=slopes).evaluate(np.c_[MU, MU], range(5)).score
        for one in (agent, lambda _: [0.0])
    )
    assert (seen > blind).all()
    again = cruising(agent, parameters=slopes, num_envs=1).evaluate(np.c_[MU, MU], range(5)).score
    assert (again == seen).all()


def test_a_controller_in_another_process_gets_a_sentence():
    agent = agent_of(Controller(), None, "Controller")

    class Elsewhere:
        def observation(self, i):
            return np.zeros(1)

    with pytest.raises(UserError, match=r"without an argument env in a separate process"):
        agent.act(Elsewhere(), np.zeros(1, np.intp))


@pytest.mark.long
def test_a_run_of_it_is_resumed_with_the_same_bits(tmp_path):
    settings = {"budget": 30, "samples": 12, "seed": 0}
    first = attack(cruising(), "gaussian", out=tmp_path / "a", **settings)
    two = attack(cruising(num_envs=1), "gaussian", out=tmp_path / "b", workers=2, **settings)
    again = attack(cruising(), "gaussian", out=tmp_path / "b", resume=True, **settings)
    assert (two.samples.score == first.samples.score).all()
    assert (again.samples.score == first.samples.score).all()


@pytest.mark.slow
def test_the_autopilot_of_jsbsims_cessna_is_attacked():
    pytest.importorskip("jsbsim", reason="pip install jsbsim")
    from tests.support.cessna import Cessna

    fly = partial(
        GymnasiumApplication,
        Cessna,
        agent="built-in",
        agent_id="c172x",
        parameters={"payload": Attribute(0.0, 400.0), "turn": Attribute(-60.0, 60.0)},
        score=("return", 0.0, 20.0),
        fooling_threshold=0.5,
        max_steps=60,
    )
    mu = np.random.default_rng(0).uniform(-1, 1, (3, 2)).astype(np.float32)
    new = fly().evaluate(mu, range(3))
    assert not new.invalid
    for options in ({"num_envs": 1}, {"reuse": True}):
        assert fly(**options).evaluate(mu, range(3)).score.tolist() == new.score.tolist()

"""Worlds of an attack, a suite or a diagnosis come to any training script."""

import copy
import pickle
import shutil
import warnings
from collections import Counter

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_sb3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

from sada_gym import GymnasiumApplication, attack
from sada_gym.adversaries import make
from sada_gym.analyses.regression.export import export
from sada_gym.analyses.regression.suite import read_suite
from sada_gym.analyses.training import FailureCurriculum, curriculum_vec_env, failures, weaknesses
from sada_gym.envs.robot import RobotTaskEnv, TripDistribution
from sada_gym.envs.wrapped import (
    ActionNoise,
    Attribute,
    Keyword,
    ObservationDelay,
    ObservationNoise,
    ResetOption,
)
from sada_gym.errors import FileError, UserError
from sada_gym.foundations.determinism import one_thread
from sada_gym.measures.diagnosis.record import Condition, Diagnosis, Weakness, write_diagnosis
from sada_gym.oracle import Oracle

TOML = """
environment = "CartPole-v1"
agent = "not-there.zip"
score = ["length", 60]
fooling_threshold = 0.7
max_steps = 60
[parameters]
gravity = [5.0, 20.0]
length = [0.2, 2.0]
"""


def balance(state):
    return int(state[2] + state[3] > 0)


def pole(**changed):
    settings = {
        "agent": balance,
        "parameters": {"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        "score": ("length", 60),
        "fooling_threshold": 0.7,
        "max_steps": 60,
        "agent_id": "by hand",
    }
    return GymnasiumApplication("CartPole-v1", **{**settings, **changed})


def lazy(state):
    return 0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """An attack on an agent that fails everywhere within 60 steps, or nearly so."""
    folder = tmp_path_factory.mktemp("runs") / "a pole's run"
    options = {"budget": 40, "samples": 8, "pictures": False, "progress": False}
    attack(pole(agent=lazy), "gaussian", out=folder, **options)
    return folder


@pytest.fixture
def toml(tmp_path):
    path = tmp_path / "pole.toml"
    path.write_text(TOML)
    return path


def episode(env, **reset):
    """Play one episode by random actions; return all that was seen."""
    observation, info = env.reset(**reset)
    env.action_space.seed(0)
    seen, over = [observation], False
    while not over:
        observation, _, terminated, truncated, last = env.step(env.action_space.sample())
        seen.append(observation)
        over = terminated or truncated
    return seen, info, last


def sources(env, count=200, **reset):
    infos = [env.reset(**(reset if i == 0 else {}))[1]["curriculum"] for i in range(count)]
    return Counter(info["source"] for info in infos), infos


# ---- the worlds


def test_an_episode_is_played_in_the_world_of_the_evaluation():
    application = pole(
        parameters={
            "gravity": (5.0, 20.0),
            "noise": ObservationNoise(0.0, 0.3),
            "delay": ObservationDelay(0, 3),
            "slips": ActionNoise(0.0, 0.5),
        }
    )
    mu, seed = np.array([0.3, 0.6, 0.9, 0.2], np.float32), 12
    env, arguments = application.world(mu, seed)
    observation, _ = env.reset(**arguments)
    steps, over = 0, False
    while not over:
        observation, _, terminated, truncated, _ = env.step(balance(observation))
        steps, over = steps + 1, terminated or truncated
    assert steps == application.evaluate([mu], [seed]).infos[0]["length"]


def test_the_worlds_are_those_that_were_drawn(toml, run):
    env = FailureCurriculum(toml, run, shares={"failures": 0.5, "uniform": 0.5})
    values = set()
    for seed in range(5):
        _, info = env.reset(seed=seed)
        told = info["curriculum"]["parameters"]
        assert env.unwrapped.gravity == pytest.approx(told["gravity"], rel=1e-6)
        assert env.unwrapped.length == pytest.approx(told["length"], rel=1e-6)
        values.add(env.unwrapped.gravity)
    assert len(values) == 5


def test_a_nominal_world_without_a_known_mu_is_the_environment_as_it_is():
    outside = pole(parameters={"gravity": (12.0, 20.0)})
    assert outside.nominal is None
    env = FailureCurriculum(outside, shares={"nominal": 1.0})
    _, info = env.reset(seed=0)
    assert info["curriculum"] == {"source": "nominal"}
    assert env.unwrapped.gravity == 9.8


def test_nominal_worlds_follow_a_density():
    density = {"uniform": [9.7, 9.9]}
    application = pole(parameters={"gravity": Attribute(5.0, 20.0, nominal=density)})
    env = FailureCurriculum(application, shares={"nominal": 1.0})
    env.reset(seed=0)
    drawn = [env.reset()[1]["curriculum"]["parameters"]["gravity"] for _ in range(20)]
    assert all(9.7 - 1e-5 <= value <= 9.9 + 1e-5 for value in drawn)  # mu is rounded to float32
    assert len(set(drawn)) > 10


def test_only_feasible_worlds_are_drawn():
    application = pole(feasible="gravity * length < 5")
    env = FailureCurriculum(application, np.array([[1.0, 1.0], [-0.9, -0.9]]))
    for _ in range(50):
        told = env.reset()[1]["curriculum"].get("parameters")
        assert told is None or told["gravity"] * told["length"] < 5
    with pytest.raises(UserError, match="feasible= allows"):
        FailureCurriculum(application, np.array([[1.0, 1.0]]))


# ---- sources and shares


def test_shares_are_kept_and_infos_tell_the_source(toml, run):
    env = FailureCurriculum(toml, run)
    counts, _ = sources(env, 400, seed=0)
    assert env.mixture.shares == {"failures": 0.5, "uniform": 0.25, "nominal": 0.25}
    assert 160 < counts["failures"] < 240
    assert 70 < counts["uniform"] < 130
    *_, last = episode(env)
    assert last["curriculum"]["source"] in counts


def test_failures_of_a_run_are_exactly_those(toml, run):
    env = FailureCurriculum(toml, failures(run), shares={"failures": 1.0})
    _, infos = sources(env, 20)
    scores = pole(agent=lazy).evaluate([info["mu"] for info in infos], range(20)).score
    assert (scores <= 0.7).mean() > 0.8  # with other seeds than in the run


def test_a_suite_gives_its_failures(toml, run, tmp_path):
    suite = tmp_path / "suite of a pole"
    export(run, suite, confirm=1, application=pole(agent=lazy))
    failing = [c for c in read_suite(suite)[1].test_cases if c.objective == "failure"]
    env = FailureCurriculum(toml, suite, shares={"failures": 1.0})
    _, infos = sources(env, 30)
    assert {tuple(info["mu"].tolist()) for info in infos} <= {case.mu for case in failing}


def test_a_diagnosis_gives_worlds_in_its_weaknesses(toml, run, tmp_path):
    folder = tmp_path / "diagnosed"
    shutil.copytree(run, folder)
    (folder / "diagnosis.json").unlink()
    with pytest.raises(FileError, match="diagnosis"):
        weaknesses(folder)
    high = Condition(parameter="gravity", ranges=((18.0, 20.0),), text="gravity is above 18")
    weakness = Weakness(
        conditions=(high,),
        text="gravity is above 18",
        volume=0.1,
        share=0.9,
        failures=9,
        distinct=1,
        inside=None,
        outside=None,
        thresholds=(),
        examples=(),
    )
    known = {"sentence": "It fails.", "worlds": 48, "failures": 10}
    write_diagnosis(folder, Diagnosis(**known))
    with pytest.raises(UserError, match="names weaknesses"):
        weaknesses(folder)
    write_diagnosis(folder, Diagnosis(weaknesses=(weakness,), **known))
    env = FailureCurriculum(toml, weaknesses(folder), shares={"failures": 1.0})
    _, infos = sources(env, 20)
    assert min(info["parameters"]["gravity"] for info in infos) >= 18.0 - 1e-4
    with pytest.raises(UserError, match="parameter of the diagnosis"):
        FailureCurriculum("SADA-Robot-v0", weaknesses(folder))


def test_a_live_adversary_is_asked_and_not_changed(toml):
    adversary, twin = (_trained("random", 2) for _ in range(2))
    FailureCurriculum(toml, adversary)
    np.testing.assert_array_equal(adversary.sample(5), twin.sample(5))
    with pytest.raises(UserError, match="adversary of 2 parameters, got one of 3"):
        FailureCurriculum(toml, _trained("random", 3))
    with pytest.raises(UserError, match="trained adversary"):
        FailureCurriculum(toml, make("gaussian", 2, seed=0))


def _trained(name, dimension):
    adversary = make(name, dimension, seed=3)
    adversary.train(Oracle(lambda mu: mu[:, 0] ** 2, dimension=dimension, threshold=0.3, budget=4))
    return adversary


def test_sources_change_while_training_goes_on(toml):
    env = FailureCurriculum(toml)
    assert env.mixture.shares == {"uniform": 0.5, "nominal": 0.5}
    env.set_source(np.zeros((1, 2)))
    assert env.mixture.shares["failures"] == 0.5
    shares = {"failures": 0.2, "second": 0.8}
    env.set_source(np.full((1, 2), 0.5), "second", shares)
    assert set(sources(env)[0]) == {"failures", "second"}
    with pytest.raises(UserError, match="sum to 1"):
        env.set_source(np.ones((1, 2)), "second", {"second": 0.5})
    with pytest.raises(UserError, match="holds neither"):
        env.set_source("nowhere")
    assert env.mixture.shares == shares  # nothing of it was taken


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ({"failures": 0.5, "uniform": 0.3}, r"sum to 1, got .* 0\.8"),
        ({"failures": 1.5, "uniform": -0.5}, "from 0 to 1"),
        ({"failures": float("nan"), "uniform": 1.0}, "from 0 to 1"),
        ({"failure": 1.0}, "Did you mean failures"),
        ({"failures": "half", "uniform": 0.5}, "a number such as 0.5"),
        ({"failures": True}, "a number such as 0.5"),
        ([0.5, 0.5], "by name"),
        ({}, "sum to 1"),
    ],
)
def test_bad_shares_are_refused(toml, shares, message):
    with pytest.raises(UserError, match=message):
        FailureCurriculum(toml, np.zeros((1, 2)), shares=shares)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (3, "as a source of worlds"),
        ("", "as a source of worlds"),
        (np.zeros((0, 2)), "at least one world"),
        (np.zeros((1, 3)), r"shape \(n, 2\)"),
        (np.full((1, 2), 2.0), r"within \[-1, 1\]"),
        ({"uniform": np.zeros((1, 2))}, "other than 'uniform'"),
        ({1: np.zeros((1, 2))}, "by name"),
    ],
)
def test_bad_sources_are_refused(toml, source, message):
    with pytest.raises(UserError, match=message):
        FailureCurriculum(toml, source)


def test_runs_of_other_worlds_are_refused_or_moved(run, tmp_path):
    with pytest.raises(UserError, match="lacks gravity"):
        FailureCurriculum("SADA-Robot-v0", run)
    other = pole(parameters={"gravity": (5.0, 20.0), "force_mag": (5.0, 20.0)})
    with pytest.raises(UserError, match="lacks length and has besides force_mag"):
        FailureCurriculum(other, run)
    narrower = pole(parameters={"length": (0.2, 2.0), "gravity": (8.0, 12.0)})
    with pytest.warns(UserWarning, match="outside the range of gravity"):
        env = FailureCurriculum(narrower, run, shares={"failures": 1.0})
    _, infos = sources(env, 20)
    assert all(8.0 <= info["parameters"]["gravity"] <= 12.0 for info in infos)


def test_a_run_without_failures_is_refused(tmp_path, toml):
    folder = tmp_path / "unbeaten"
    never = pole(fooling_threshold=0.0)
    attack(never, "random", budget=4, samples=4, out=folder, pictures=False, progress=False)
    with pytest.raises(UserError, match="Expected a run with failures"):
        failures(folder)
    assert FailureCurriculum(toml, folder).mixture.shares["failures"] == 0.5  # what it learnt


# ---- Gymnasium, Stable-Baselines3, processes


@pytest.mark.parametrize("given", ["toml", "SADA-Robot-v0", "SADA-DrivingTask-v0"])
def test_the_checkers_of_gymnasium_and_sb3_pass(given, toml):
    env = FailureCurriculum(toml if given == "toml" else given)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about the environments' own spaces
        check_env(env, skip_render_check=True)
        check_env_sb3(env)
    env.close()


def test_a_seed_fixes_everything_and_copies_draw_worlds_of_their_own(toml, run):
    env = FailureCurriculum(toml, run)
    first = [episode(env, seed=5), episode(env)]
    other = pickle.loads(pickle.dumps(env))
    second = [episode(other, seed=5), episode(other)]
    for (seen, info, _), (again, info_again, _) in zip(first, second, strict=True):
        np.testing.assert_array_equal(np.array(seen), np.array(again))
        assert info["curriculum"]["source"] == info_again["curriculum"]["source"]
    env.reset(seed=5)
    copies = [copy.deepcopy(env) for _ in range(2)]
    worlds = [
        [info["mu"].tolist() for info in sources(each, 10)[1] if "mu" in info] for each in copies
    ]
    assert worlds[0] != worlds[1]


def test_a_script_trains_in_processes_and_gets_new_sources(toml, run):
    with one_thread():
        env = make_vec_env(
            lambda: FailureCurriculum(toml, run), n_envs=2, seed=0, vec_env_cls=SubprocVecEnv
        )
        try:
            model = PPO("MlpPolicy", env, n_steps=32, n_epochs=1, device="cpu").learn(64)
            first = [info["curriculum"] for info in env.reset_infos]
            assert len({tuple(info.get("mu", ())) for info in first}) == 2
            env.env_method(
                "set_source", np.full((1, 2), 0.25, np.float32), shares={"failures": 1.0}
            )
            env.reset()
            told = [info["curriculum"]["mu"].tolist() for info in env.reset_infos]
            assert told == [[0.25, 0.25]] * 2
            assert model.num_timesteps == 64
        finally:
            env.close()


def test_a_model_that_learns_in_worlds_can_be_attacked_as_it_is():
    """Noise and delay are parts of a world, and no wrappers of the agent."""
    application = pole(
        parameters={"gravity": (5.0, 20.0), "delay": ObservationDelay(0, 3)}, agent_id=None
    )
    with one_thread():
        env = make_vec_env(lambda: FailureCurriculum(application), n_envs=2)
        model = PPO("MlpPolicy", env, n_steps=8, n_epochs=1, device="cpu")
        env.reset()
        attacked = GymnasiumApplication(
            "CartPole-v1",
            agent=model,
            parameters={"gravity": (5.0, 20.0), "delay": ObservationDelay(0, 3)},
            score=("length", 60),
            fooling_threshold=0.5,
        )
        assert len(attacked.evaluate(np.zeros((2, 2)), [0, 1]).score) == 2


def test_dictionaries_options_and_own_wrappers_are_kept():
    env = FailureCurriculum(
        GymnasiumApplication(
            Dicts,
            agent=lambda _: 0,
            parameters={"noise": ObservationNoise(0.0, 0.1), "start": ResetOption(0.0, 1.0)},
            score=("length", 5),
            fooling_threshold=0.5,
            max_steps=5,
        ),
        np.full((1, 2), 1.0),
        shares={"failures": 1.0},
    )
    observation, info = env.reset(seed=0, options={"mine": 3})
    assert set(observation) == {"position"}
    assert info["options"] == {"mine": 3, "start": 1.0}
    seen, _, last = episode(env, seed=0)
    assert len(seen) == 6  # cut off after five steps
    assert last["curriculum"]["source"] == "failures"
    assert env.reset(options={})[1]["options"] == {"start": 1.0}


class Dicts(gym.Env):
    """Its observations are dictionaries, and its reset says which options it got."""

    observation_space = gym.spaces.Dict({"position": gym.spaces.Box(-9.0, 9.0, (1,))})
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return {"position": np.zeros(1, np.float32)}, {"options": dict(options or {})}

    def step(self, action):
        return {"position": np.ones(1, np.float32)}, 0.0, False, False, {}


class Fragile(gym.Env):
    """It breaks at its reset or in its third step, where it is told to."""

    observation_space = gym.spaces.Box(-1.0, 1.0, (1,))
    action_space = gym.spaces.Discrete(2)

    def __init__(self, broken: float = 0.0, breaks: float = 0.0) -> None:
        self.broken, self.breaks = broken > 0.5, breaks > 0.5

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if self.broken:
            raise RuntimeError("no such world")
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        if self.breaks and self.steps == 3:
            raise RuntimeError("it blew up")
        return np.zeros(1, np.float32), 1.0, False, False, {}


def test_broken_worlds_are_drawn_again_or_cut_off():
    application = _fragile()
    both = np.array([[1.0, -1.0], [-1.0, 1.0]])
    env = FailureCurriculum(application, both, shares={"failures": 1.0})
    for _ in range(10):
        _, info = env.reset()
        assert info["curriculum"]["mu"].tolist() == [-1.0, 1.0]  # the other one breaks at once
    seen, _, last = episode(env)
    assert len(seen) == 4
    assert "it blew up" in last["invalid"]
    env.set_source(both[:1])
    with pytest.raises(UserError, match=r"20 in a row broke.*no such world"):
        env.reset()


def _fragile():
    return GymnasiumApplication(
        Fragile,
        agent=lambda _: 0,
        parameters={"broken": Keyword(0.0, 1.0), "breaks": Keyword(0.0, 1.0)},
        score=("length", 5),
        fooling_threshold=0.5,
        max_steps=5,
        feasible="broken + breaks < 1.99",
    )


# ---- our own tasks


def test_tasks_of_ours_take_the_conditions_and_keep_their_starts():
    own = RobotTaskEnv(TripDistribution(turned_deg=0.0))
    mu = np.array([[-1.0] + 8 * [0.0] + [1.0]])
    env = FailureCurriculum(own, mu, shares={"failures": 0.5, "nominal": 0.5})
    seen = set()
    for _ in range(12):
        _, info = env.reset()
        start = env.unwrapped.task.episodes.starts[0]
        assert start.turned_rad == 0.0
        failing = info["curriculum"]["source"] == "failures"
        assert (start.conditions.latency_s == pytest.approx(0.6)) is failing
        seen.add(failing)
    assert seen == {True, False}


@pytest.mark.parametrize("name", ["SADA-Robot-v0", "SADA-Driving-OneCurve-v0"])
def test_lockstep_draws_a_world_for_each_episode(name):
    with one_thread():
        env = curriculum_vec_env(name, num_envs=3, shares={"uniform": 1.0})
        env.seed(0)
        env.reset()
        starts = env.env.unwrapped.task.episodes.starts
        assert len({_world(start) for start in starts}) == 3
        dimension = len(env.mixture.space.parameters)
        env.env_method("set_source", np.zeros((1, dimension)), shares={"failures": 1.0})
        env.reset()
        assert len({_world(start) for start in env.env.unwrapped.task.episodes.starts}) == 1
        env.step(np.zeros((3, 2)))
        with pytest.raises(NotImplementedError):
            env.env_method("get_state")
        env.close()


def _world(start):
    return getattr(start, "conditions", None) or (start.mount, start.weather)


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ("CartPole-v1", "sada-gym init CartPole-v1"),
        ("SADA-Detection-Car-v0", "whose agents can be trained"),
        ("SADA-Robt-v0", "Did you mean"),
        (7, "to train in, got 7"),
    ],
)
def test_what_cannot_be_trained_in_is_said(environment, message):
    with pytest.raises(UserError, match=message):
        FailureCurriculum(environment)


def test_environments_without_mu_or_of_many_episodes_are_refused():
    with gym.make("CartPole-v1") as env, pytest.raises(UserError, match="set by mu"):
        FailureCurriculum(env)
    env = gym.make_vec("CartPole-v1", num_envs=2)
    with pytest.raises(UserError, match="single episodes"):
        FailureCurriculum(env)
    env.close()

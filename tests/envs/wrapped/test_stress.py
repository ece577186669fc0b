"""Adaptive stress testing: an environment whose action is the disturbance of the next step."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from scipy.optimize import minimize
from stable_baselines3.common.env_checker import check_env as check_env_of_sb3
from wrapped_toys import balance, cart_pole, pendulum

from sada_gym import (
    GymnasiumApplication,
    StressEnv,
    export,
    record,
    regress,
    replay,
    report,
)
from sada_gym.envs.wrapped import (
    ActionDelay,
    ActionGain,
    ActionNoise,
    Attribute,
    Force,
    Keyword,
    ObservationDelay,
    ObservationDropout,
    ObservationNoise,
    RealTime,
    SensorFailure,
)
from sada_gym.errors import Notice

STEPS = 4


def blow(env, strength):
    env.state = np.asarray(env.state) + np.array([0.0, strength, 0.0, 0.0])


def gusty(**changes):
    arguments = {
        "agent": balance,
        "parameters": {
            "wind": Force(-0.5, 0.5, apply=blow, nominal={"normal": [0.0, 0.1]}),
            "noise": ObservationNoise(0.0, 0.3),
        },
        "score": ("length", 100),
        "max_steps": 100,
        "agent_id": "balance",
    }
    return cart_pole(**arguments | changes)


@pytest.mark.parametrize("options", [{}, {"actions": "normal"}, {"state": lambda env: env.state}])
def test_both_checkers_pass(options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        warnings.filterwarnings("ignore", message=".*different from the unwrapped version.*")
        warnings.filterwarnings("ignore", message=".*spec.*")
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(StressEnv(gusty(), **options), skip_render_check=True)
        check_env_of_sb3(StressEnv(gusty(), **options))


def played(env, seed, act):
    """The return, the infos and the observations of an episode."""
    observation, _ = env.reset(seed=seed)
    observations, total, infos, ended = [observation], 0.0, [], False
    while not ended:
        observation, reward, ended, _, info = env.step(act(len(infos)))
        observations.append(observation)
        total += reward
        infos.append(info)
    return total, infos, observations


EVERYTHING = {
    "noise": ObservationNoise(0.0, 1.0),
    "late": ObservationDelay(0, 3),
    "lost": ObservationDropout(0.0, 1.0),
    "action late": ActionDelay(0, 3),
    "gain": ActionGain(0.2, 2.0),
    "action noise": ActionNoise(0.0, 0.5),
    "g": Attribute(5.0, 15.0),
    "m": Attribute(0.5, 2.0, factor=True),
}


@pytest.mark.parametrize("seed", [0, 1])
def test_a_failure_is_a_world_that_repeats_exactly(seed):
    application = pendulum(
        parameters=EVERYTHING, score=("return", -900.0, 0.0), fooling_threshold=1.0, max_steps=40
    )
    env, rng = StressEnv(application), np.random.default_rng(seed)
    for episode in range(3):
        actions = rng.uniform(-1.0, 1.0, (40, len(EVERYTHING)))
        _, infos, _ = played(env, seed + 10 * episode, lambda step, a=actions: a[step])
        assert infos[-1]["fooled"]
    failures = env.failures
    assert failures.mu.shape == (3, 40 * len(EVERYTHING))
    again = env.application.evaluate(failures.mu, failures.seed.tolist())
    assert again.score.tolist() == failures.score.tolist()
    assert 0.0 < failures.score.min() < failures.score.max() < 1.0
    assert env.application.parameters.names[41] == "late[1]"


def test_rewards_are_those_of_adaptive_stress_testing():
    env = StressEnv(gusty(), miss=10.0)
    calm, infos, _ = played(env, 3, lambda step: np.array([0.0, -1.0], np.float32))
    assert len(infos) == 100
    assert infos[-1]["score"] == 1.0
    assert calm == pytest.approx(-10.0 * infos[-1]["miss_distance"] + 0.0, abs=1e-2)
    assert infos[-1]["miss_distance"] == 1.0 - 0.5
    assert len(env.failures) == 0
    strong, infos, _ = played(env, 3, lambda step: np.array([0.8, -1.0], np.float32))
    assert infos[-1]["fooled"]
    assert infos[-1]["miss_distance"] == 0.0
    each = -0.5 * (0.4 / 0.1) ** 2
    assert infos[0]["log_likelihood"] == pytest.approx(each, rel=0.01)
    assert strong == pytest.approx(each * len(infos), rel=0.01)
    assert len(env.failures) == 1
    frames, score = env.application.replay(env.failures.mu[0], int(env.failures.seed[0]))
    assert score == env.failures.score[0]
    assert len(frames) == len(infos) + 1


def test_a_failure_is_as_likely_as_its_episode():
    wind = Force(-0.5, 0.5, apply=blow, nominal={"normal": [0.1, 0.1]})
    noise = ObservationNoise(0.0, 0.3, nominal={"normal": [0.0, 0.05]})
    env = StressEnv(gusty(parameters={"wind": wind, "noise": noise}))
    _, infos, _ = played(env, 3, lambda step: np.array([0.9, -0.7], np.float32))
    assert len(infos) < 50
    density = env.application.density
    (whole,) = density.log_density(env.failures.mu) - density.highest
    assert whole == pytest.approx(sum(info["log_likelihood"] for info in infos), abs=1.0)


class Remembering:
    """Pushes to one side until it has seen two observations, then to the other."""

    def reset(self):
        self.seen = 0

    def __call__(self, state):
        self.seen += 1
        return int(self.seen > 2)


def test_two_of_one_application_share_no_memory():
    application = gusty(agent=Remembering())
    envs = [StressEnv(application) for _ in range(2)]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
    left = [*envs]
    while left:
        for env in [*left]:
            if env.step(np.array([0.0, -1.0], np.float32))[2]:
                left.remove(env)
    for env in envs:
        failures = env.failures
        again = env.application.evaluate(failures.mu, failures.seed.tolist())
        assert again.score.tolist() == failures.score.tolist()


def test_the_end_tells_of_each_requirement():
    scores = {"long": ("length", 100), "upright": lambda episode: 0.75}
    env = StressEnv(gusty(score=scores))
    _, infos, _ = played(env, 3, lambda step: np.array([0.8, -1.0], np.float32))
    assert infos[-1]["requirements"]["upright"] == 0.75
    assert infos[-1]["requirements"]["long"] < 0.5


def test_actions_may_be_draws_from_the_density():
    env = StressEnv(gusty(), actions="normal")
    _, infos, _ = played(env, 0, lambda step: np.array([2.0, -1.0], np.float32))
    assert infos[0]["log_likelihood"] == pytest.approx(-2.0, rel=0.01)
    failing = env.failures.mu[0].reshape(2, 100)[:, : len(infos)]
    wind = env.application.parameters.physical(env.failures.mu)[0, : len(infos)]
    assert np.unique(failing[0]).size == 1
    assert wind == pytest.approx(0.2, abs=0.001)


class Drifting(gym.Env):
    """A linear system: a mass with friction that the wind moves; it must not get too far."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gym.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self) -> None:
        self.wind = 0.0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.state = 0, np.zeros(2)
        return self.state.copy(), {}

    def step(self, action):
        self.time += 1
        self.state = np.array([[1.0, 0.5], [0.0, 0.8]]) @ self.state
        self.state[1] += self.wind
        return self.state.copy(), 0.0, self.time >= STEPS, False, {}


def reached(episode):
    return float(np.clip(1.0 - episode.observations[-1][0] / 3.0, 0.0, 1.0))


def drifting():
    return GymnasiumApplication(
        Drifting,
        agent=lambda seen: np.zeros(1),
        parameters={"wind": Attribute(-2.5, 2.5, nominal={"normal": [0.0, 0.5]})},
        score=reached,
        fooling_threshold=0.5,
        max_steps=STEPS,
    )


def likeliest():
    """The least sum of z^2 / 2 of standard normal wind that brings the mass to 1.5: a QP."""

    def place(z):
        state = np.zeros(2)
        for one in z:
            state = np.array([[1.0, 0.5], [0.0, 0.8]]) @ state
            state[1] += 0.5 * one
        return state[0]

    found = minimize(
        lambda z: 0.5 * z @ z,
        np.ones(STEPS),
        jac=lambda z: z,
        constraints={"type": "ineq", "fun": lambda z: place(z) - 1.5},
        method="SLSQP",
        options={"ftol": 1e-12},
    )
    assert found.success
    return found.fun


@pytest.mark.long
def test_the_likeliest_failure_of_a_linear_system_is_found():
    env, rng = StressEnv(drifting(), actions="normal", miss=1000.0), np.random.default_rng(5)
    mean, spread = np.zeros(STEPS), np.ones(STEPS)
    best = -np.inf
    for _ in range(15):  # cross-entropy over sequences (Rubinstein 1999)
        z = mean + spread * rng.standard_normal((24, STEPS))
        results = [played(env, 0, lambda step, own=own: own[[step]]) for own in z]
        returns = np.array([total for total, _, _ in results])
        elite = z[np.argsort(-returns)[:5]]
        mean, spread = elite.mean(axis=0), elite.std(axis=0) + 0.03
        failed = [total for total, infos, _ in results if infos[-1]["fooled"]]
        best = max([best, *failed])
    assert 0.999 * likeliest() <= -best <= 1.05 * likeliest()
    assert (env.failures.score <= 0.5).all()
    again = env.application.evaluate(env.failures.mu[-5:], env.failures.seed[-5:].tolist())
    assert again.fooled.all()


@pytest.mark.long
def test_failures_are_a_run_like_any_other(tmp_path):
    env = StressEnv(gusty(max_steps=20, score=("length", 20), fooling_threshold=1.0))
    for seed in range(3):
        played(env, seed, lambda step: np.array([0.8 - 0.1 * (step % 3), -0.5], np.float32))
    application = env.application
    run = record(application, env.failures, tmp_path / "run")
    assert run.result.afr == 1.0
    assert len(run.failures.failures) == 3
    assert (tmp_path / "run" / "worlds.csv").is_file()
    page = (tmp_path / "run" / "report.html").read_text()
    assert "stress testing" in page
    assert "wind[0]" in page
    replay(run, out=tmp_path / "film.gif", application=application)  # raises for another score
    assert (tmp_path / "film.gif").stat().st_size > 1_000
    written = report(run, out=tmp_path / "again.html", application=application)
    assert written.read_text() == page
    export(run, tmp_path / "suite", confirm=0, application=application)
    result = regress(tmp_path / "suite", application)
    assert {world.now for world in result.worlds} >= {"fail"}
    assert result.decision.status == "passed"
    with pytest.raises(ValueError, match="at least one world"):
        record(application, StressEnv(gusty()).failures, tmp_path / "none")
    with pytest.raises(TypeError, match="worlds as Evaluations"):
        record(application, [0.0], tmp_path / "none")


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"fails": Keyword(choices=(True, False))}, "may change in each step"),
        ({"wind": Attribute(-1.0, 1.0, knots=3)}, "may change in each step"),
        ({"it": SensorFailure(at=(0, 3), lasts=3, entries=(0,))}, "may change in each step"),
        ({"it": Force(-1.0, 1.0, apply=blow, start=2)}, "may change in each step.*got it"),
        ({"it": Force(-1.0, 1.0, apply=blow, at=2, lasts=1)}, "may change in each step.*got it"),
    ],
)
def test_what_cannot_change_in_each_step_is_told(parameters, message):
    class Failing(Drifting):
        def __init__(self, fails=False) -> None:
            super().__init__()

    application = GymnasiumApplication(
        Failing,
        agent=lambda seen: np.zeros(1),
        parameters=parameters,
        score=reached,
        fooling_threshold=0.5,
        max_steps=STEPS,
    )
    with pytest.raises(ValueError, match=message):
        StressEnv(application)


def test_bad_arguments_are_told():
    with pytest.raises(ValueError, match="'uniform'"):
        StressEnv(drifting(), actions="uniform")
    with pytest.raises(ValueError, match="miss above 0"):
        StressEnv(drifting(), miss=-1.0)
    with pytest.raises(TypeError, match="Expected a GymnasiumApplication, got 'CartPole-v1'"):
        StressEnv("CartPole-v1")
    with pytest.warns(Notice):
        timed = gusty(parameters={"slow": RealTime(1.0, 2.0)})
    with pytest.raises(ValueError, match="the same score again, but a random agent or RealTime"):
        StressEnv(timed)
    env = StressEnv(drifting())
    with pytest.raises(gym.error.ResetNeeded):
        env.step([0.0])
    env.reset(seed=0)
    with pytest.raises(ValueError, match="an action of 1 numbers"):
        env.step([0.0, 1.0])

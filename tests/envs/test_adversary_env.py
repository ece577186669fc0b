"""AdversaryEnv and AdversaryVectorEnv: seeds, horizon, autoreset, and one dynamics for both."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal

from sada_gym.application import Scored
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.parameters import Mu


class Counting(AnalyticApplication):
    """Counts evaluations and closings, gives every kind of extra, and fails on demand."""

    def __init__(self) -> None:
        super().__init__(noise=0.2)
        self.evaluations = 0
        self.failing = False

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        if self.failing:
            raise OSError("the simulator is gone")
        self.evaluations += len(mu)
        scored = super().evaluate_batch(mu, seeds)
        extras = [
            {
                **extra,
                "box": np.array([seed % 7, 2, 3, 4.5]),
                "labels": list(range(seed % 3)),
                "shape": f"shape-{seed % 5}",
                "agent": {"speed_m_s": seed / 3, "crashed": seed % 2 == 0},
            }
            for extra, seed in zip(scored.extras, seeds, strict=True)
        ]
        return Scored(scored.score, extras)


def actions(steps: int, count: int | None = None) -> np.ndarray:
    shape = (steps, 2) if count is None else (steps, count, 2)
    return np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)


def test_the_spaces_are_the_contracts() -> None:
    env = AdversaryEnv(AnalyticApplication(dimension=3))
    assert env.action_space == gym.spaces.Box(-1, 1, (3,), np.float32)
    assert env.observation_space == gym.spaces.Box(-1, 1, (5,), np.float32)


def test_one_proposal_is_an_episode_by_default() -> None:
    env = AdversaryEnv(Counting())
    observation, info = env.reset(seed=3)
    assert_array_equal(observation, np.float32([0, 0, 0, 1]), strict=True)
    assert info == {}
    mu = np.float32([0.25, -0.5])
    observation, reward, terminated, truncated, info = env.step(mu)
    assert (terminated, truncated) == (True, False)
    assert type(reward) is float
    assert reward == -info["score"]
    assert_array_equal(observation, np.float32([0.25, -0.5, info["score"], 0]), strict=True)
    assert data_equivalence(env.application.evaluate([mu], [3]).infos[0], info, exact=True)


def test_horizon_counts_the_steps_down() -> None:
    env = AdversaryEnv(AnalyticApplication(), horizon=3)
    env.reset(seed=0)
    left = []
    for mu in actions(3):
        observation, _, terminated, _, _ = env.step(mu)
        left.append((observation[-1], terminated))
    assert left == [(np.float32(2 / 3), False), (np.float32(1 / 3), False), (0.0, True)]


def test_seeds_are_the_given_one_then_those_of_np_random() -> None:
    env = AdversaryEnv(AnalyticApplication(), horizon=2)
    seeds = []
    for given in (5, None):
        env.reset(seed=given)
        seeds += [env.step(mu)[4]["seed"] for mu in actions(2)]
    rng = np.random.Generator(np.random.PCG64(5))
    assert seeds == [5, *(int(rng.integers(2**31)) for _ in range(3))]
    assert all(type(seed) is int for seed in seeds)


def test_rendering_and_failing_leave_the_seeds_alone() -> None:
    def seeds(disturb: bool) -> list[int]:
        env = AdversaryEnv(Counting(), horizon=4, render_mode="rgb_array")
        env.reset(seed=0)
        drawn = []
        for mu in actions(4):
            if disturb:
                env.render()
                with pytest.raises(ValueError, match="Expected mu within"):
                    env.step(mu + 9)
                env.application.failing = True
                with pytest.raises(OSError, match="gone"):
                    env.step(mu)
                env.application.failing = False
            drawn.append(env.step(mu)[4]["seed"])
        return drawn

    assert seeds(disturb=True) == seeds(disturb=False)


def test_a_float64_action_is_rounded_once() -> None:
    env = AdversaryEnv(AnalyticApplication())
    mu = np.random.default_rng(1).uniform(-1, 1, 2)
    env.reset(seed=0)
    observation, reward, *_ = env.step(mu)
    env.reset(seed=0)
    rounded, reward_of_rounded, *_ = env.step(mu.astype(np.float32))
    assert reward == reward_of_rounded
    assert_array_equal(observation, rounded)


def test_render_shows_the_middle_after_reset_and_then_the_last_evaluation() -> None:
    application = AnalyticApplication(noise=0.2)
    env = AdversaryEnv(application, render_mode="rgb_array")
    env.reset(seed=4)
    assert_array_equal(env.render(), application.render(np.zeros(2), 4))
    mu = np.float32([0.5, 0.5])
    env.step(mu)
    assert_array_equal(env.render(), application.render(mu, 4))


def test_replay_gives_the_score_again() -> None:
    env = AdversaryEnv(AnalyticApplication(noise=0.2))
    env.reset(seed=9)
    mu = np.float32([0.1, 0.2])
    info = env.step(mu)[4]
    frames, score = env.replay(mu, info["seed"])
    assert score == info["score"]
    assert frames[0].dtype == np.uint8


@pytest.mark.parametrize("started", [False, True])
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_alike(started: bool, duplicate: Any) -> None:
    for env in (
        AdversaryEnv(Counting(), horizon=3),
        AdversaryVectorEnv(Counting(), num_envs=2, horizon=3),
    ):
        proposals = actions(2) if isinstance(env, AdversaryEnv) else actions(2, 2)
        if started:
            env.reset(seed=1)
            env.step(proposals[0])
        twin = duplicate(env)
        if not started:
            env.reset(seed=1)
            twin.reset(seed=1)
        assert data_equivalence(env.step(proposals[1]), twin.step(proposals[1]), exact=True)


@pytest.mark.parametrize("horizon", [1, 3])
@pytest.mark.parametrize("seed", [7, [3, 1, 4]])
def test_the_batch_equals_sync_vector_env(horizon: int, seed: Any) -> None:
    native = AdversaryVectorEnv(Counting(), num_envs=3, horizon=horizon)
    sync = SyncVectorEnv(
        [lambda: AdversaryEnv(Counting(), horizon=horizon)] * 3,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    assert native.metadata["autoreset_mode"] == sync.metadata["autoreset_mode"]
    assert native.action_space == sync.action_space
    assert native.observation_space == sync.observation_space
    assert data_equivalence(native.reset(seed=seed), sync.reset(seed=seed), exact=True)
    for mu in actions(7, 3):
        assert data_equivalence(native.step(mu), sync.step(mu), exact=True)
    mask = np.array([True, False, True])
    for envs in (native, sync):
        envs.reset(seed=[11, None, 12], options={"reset_mask": mask})
    for mu in actions(4, 3):
        assert data_equivalence(native.step(mu), sync.step(mu), exact=True)
    states = [[rng.bit_generator.state for rng in envs.np_random] for envs in (native, sync)]
    assert states[0] == states[1]


def test_autoreset_evaluates_nothing_and_keeps_the_last_info() -> None:
    envs = AdversaryVectorEnv(Counting(), num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    for step, mu in enumerate(actions(3, 2), start=1):
        observation, reward, terminated, truncated, infos = envs.step(mu)
        assert envs.application.evaluations == 2 * step
        assert terminated.all()
        assert not truncated.any()
        assert_array_equal(observation, np.float32([[0, 0, 0, 1]] * 2), strict=True)
        assert_array_equal(reward, -infos["final_info"]["score"], strict=True)
        assert_array_equal(np.stack(infos["final_obs"])[:, :2], mu)
    last_seed = int(infos["final_info"]["seed"][1])
    assert_array_equal(envs.render()[1], envs.application.render(mu[1], last_seed))


def test_closing_twice_is_fine() -> None:
    for env in (AdversaryEnv(Counting()), AdversaryVectorEnv(Counting(), num_envs=2)):
        env.close()
        env.close()


def test_steps_out_of_turn_are_refused() -> None:
    env = AdversaryEnv(AnalyticApplication(), render_mode="rgb_array")
    with pytest.raises(ResetNeeded, match=r"Expected reset\(\) before step\(\)"):
        env.step(np.zeros(2))
    with pytest.raises(ResetNeeded, match=r"Expected reset\(\) before render\(\)"):
        env.render()
    env.reset()
    env.step(np.zeros(2))
    with pytest.raises(ResetNeeded, match="no episode has a step left"):
        env.step(np.zeros(2))


def test_rendering_without_a_render_mode_warns() -> None:
    env = AdversaryEnv(AnalyticApplication())
    env.reset()
    with pytest.warns(UserWarning, match="render_mode='rgb_array'"):
        assert env.render() is None


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(3), r"Expected an action of shape \(2,\), got \(3,\)"),
        (np.zeros((1, 2)), r"Expected an action of shape \(2,\), got \(1, 2\)"),
        (np.array([0, np.nan]), r"Expected mu within \[-1, 1\], got nan"),
        (np.array([0, 1.01]), r"Expected mu within \[-1, 1\], got 1.01"),
        ([[1], [1, 2]], "Expected mu to be an array of real numbers, got: setting an array el"),
        (np.ma.zeros(2), r"Expected mu without a mask, .* mu.filled\(value\)"),
        (["0", "0"], "Expected mu to be an array of real numbers, got dtype <U1"),
    ],
)
def test_a_bad_action_is_refused(action: np.ndarray, message: str) -> None:
    env = AdversaryEnv(AnalyticApplication())
    env.reset()
    with pytest.raises(ValueError, match=message):
        env.step(action)


@pytest.mark.parametrize("seed", [-1, 1.5, True, "3", np.float64(2), np.bool_(True)])
def test_a_bad_seed_is_refused(seed: Any) -> None:
    with pytest.raises(ValueError, match="Expected seeds to be ints from 0 up, got"):
        AdversaryEnv(AnalyticApplication()).reset(seed=seed)
    vector = AdversaryVectorEnv(AnalyticApplication(), num_envs=2)
    for given in (seed, [seed, seed]):
        with pytest.raises(ValueError, match="Expected seeds to be ints from 0 up, got"):
            vector.reset(seed=given)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"seed": [1, 2, 3]}, "Expected 2 seeds, one for each environment, got 3"),
        ({"seed": [-1, 2]}, "Expected seeds to be ints from 0 up, got -1"),
        (
            {"options": {"reset_mask": [1, 0, 1]}},
            r"Expected reset_mask of shape \(2,\) and dtype bool, got \(3,\) and int",
        ),
    ],
)
def test_a_bad_vector_reset_is_refused(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AdversaryVectorEnv(AnalyticApplication(), num_envs=2).reset(**keywords)


def test_a_bad_batch_of_actions_is_refused() -> None:
    envs = AdversaryVectorEnv(AnalyticApplication(), num_envs=2)
    envs.reset()
    with pytest.raises(ValueError, match=r"Expected actions of shape \(2, 2\), got \(3, 2\)"):
        envs.step(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="Expected mu to be an array of real numbers, got: "):
        envs.step([[0, 0], [0]])
    with pytest.raises(ValueError, match="Expected mu without a mask"):
        envs.step(np.ma.zeros((2, 2)))


@pytest.mark.parametrize("env_class", [AdversaryEnv, AdversaryVectorEnv])
@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"horizon": 0}, "Expected horizon to be an int of at least 1, got 0"),
        ({"horizon": 1.5}, "Expected horizon to be an int of at least 1, got 1.5"),
        ({"horizon": 10**30}, "Expected horizon of at most 2,147,483,647, got 1,000,000,000,000,"),
        ({"render_mode": "human"}, r"Expected render_mode None or among \['rgb_array'\]"),
    ],
)
def test_bad_keywords_are_refused(env_class: Any, keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        env_class(AnalyticApplication(), **keywords)


def test_no_environments_are_refused() -> None:
    with pytest.raises(ValueError, match="Expected num_envs of at least 1, got 0"):
        AdversaryVectorEnv(AnalyticApplication(), num_envs=0)
    for count in ("3", 1.5, None):
        with pytest.raises(
            ValueError, match=f"Expected num_envs to be a whole number, got {count!r}"
        ):
            AdversaryVectorEnv(AnalyticApplication(), num_envs=count)
    with pytest.raises(ValueError, match="Expected num_envs of at most 1,048,576, got 10,000,000,"):
        AdversaryVectorEnv(AnalyticApplication(), num_envs=10**10)


@pytest.mark.parametrize("options", [5, "seed", 0, ["reset_mask"]])
def test_options_that_are_no_dictionary_are_refused(options: Any) -> None:
    message = "Expected the options of a reset in a dictionary, got"
    with pytest.raises(ValueError, match=message):
        AdversaryEnv(AnalyticApplication()).reset(options=options)
    with pytest.raises(ValueError, match=message):
        AdversaryVectorEnv(AnalyticApplication(), num_envs=2).reset(options=options)


def test_a_scalar_array_is_no_seed() -> None:
    with pytest.raises(ValueError, match=r"Expected seeds to be ints from 0 up, got array\(3\)"):
        AdversaryVectorEnv(AnalyticApplication(), num_envs=2).reset(seed=np.array(3))  # type: ignore[arg-type]

"""What `reset` takes and gives: any seed from 0 up, known options, an empty info."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from families import SHIPPED, family
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal

import sada_gym
from sada_gym.envs import AdversaryEnv, AdversaryVectorEnv
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.foundations.registration import task_ids
from sada_gym.foundations.seeds import SEED_BOUND, fold_seed

LARGE = (2**31, 2**32 - 1, 2**32, 2**64, 10**40)
PINNED = [1577607325, 996212484, 1982462498, 1915600865, 767697750]


def evaluated(env: AdversaryEnv, seed: int) -> int:
    """The seed of the first evaluation after a reset."""
    env.reset(seed=seed)
    return int(env.step(np.zeros(2))[4]["seed"])


def test_a_seed_below_the_bound_is_its_own() -> None:
    for seed in (0, 7, SEED_BOUND - 1):
        assert fold_seed(seed) == seed
        assert evaluated(AdversaryEnv(AnalyticApplication()), seed) == seed


def test_a_large_seed_is_folded_and_the_same_everywhere() -> None:
    # the values are pinned: another fold would change what a seed means
    assert [fold_seed(seed) for seed in LARGE] == PINNED
    env = AdversaryEnv(AnalyticApplication())
    assert [evaluated(env, seed) for seed in LARGE] == PINNED
    for seed, folded in zip(LARGE, PINNED, strict=True):
        env.reset(seed=seed)
        large = [env.np_random.random()]
        env.reset(seed=folded)
        assert large == [env.np_random.random()]


def test_large_seeds_do_not_meet_small_ones() -> None:
    k = range(2_000)
    for start in (SEED_BOUND, 2 * SEED_BOUND, 2**32):
        folded = [fold_seed(start + i) for i in k]
        assert len(set(folded)) == len(folded)
        assert not set(folded) & set(k)
        assert all(0 <= seed < SEED_BOUND for seed in folded)


def test_evaluate_keeps_its_bound() -> None:
    with pytest.raises(ValueError, match=r"Expected seeds to be ints in \[0, 2\*\*31\)"):
        AnalyticApplication().evaluate([[0, 0]], [2**31])


@pytest.mark.parametrize("seed", [2**31 - 2, 2**32 - 2, [2**31 - 1, 2**32 - 1, 5]])
def test_a_batch_takes_large_seeds_as_the_scalar_environments_do(seed: Any) -> None:
    native = AdversaryVectorEnv(AnalyticApplication(noise=0.2), num_envs=3, horizon=2)
    sync = SyncVectorEnv(
        [lambda: AdversaryEnv(AnalyticApplication(noise=0.2), horizon=2)] * 3,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    assert data_equivalence(native.reset(seed=seed), sync.reset(seed=seed), exact=True)
    given = seed if isinstance(seed, list) else [seed + i for i in range(3)]
    for step in range(4):
        mu = np.full((3, 2), step / 10, np.float32)
        returned = native.step(mu)
        assert data_equivalence(returned, sync.step(mu), exact=True)
        if step == 0:
            assert returned[4]["seed"].tolist() == [fold_seed(number) for number in given]


@pytest.mark.parametrize(
    "env_id", family([*sada_gym.env_ids(), *task_ids()], *SHIPPED, *task_ids())
)
def test_every_environment_takes_any_uint32(env_id: str) -> None:
    env = gym.make(env_id)
    observation, _ = env.reset(seed=2**32 - 1)
    again, _ = env.reset(seed=np.uint32(2**32 - 1))  # type: ignore[arg-type]
    assert data_equivalence(observation, again, exact=True)
    if env_id in ("SADA-Analytic-v0", "SADA-Detection-Car-v0"):
        info = env.step(np.zeros(env.action_space.shape, np.float32))[4]
        assert info["seed"] == fold_seed(2**32 - 1)
    with pytest.raises(ValueError, match="Expected seeds to be ints from 0 up, got -1"):
        env.reset(seed=-1)
    env.close()


@pytest.mark.parametrize("env_id", ["SADA-Analytic-v0", "SADA-RacingTask-v0"])
def test_unknown_options_are_refused(env_id: str) -> None:
    env, envs = gym.make(env_id), gym.make_vec(env_id, num_envs=2)
    with pytest.raises(
        ValueError, match=r"Expected no reset options, got 'seed'. Pass the seed as reset\(seed="
    ):
        env.reset(options={"seed": 3})
    with pytest.raises(
        ValueError, match=r"Expected reset options among \['reset_mask'\], got 'reset_musk'"
    ):
        envs.reset(options={"reset_musk": np.array([True, False])})
    env.reset(options={})
    envs.reset(options={"reset_mask": np.array([True, True])})
    env.close()
    envs.close()


def test_a_reset_tells_nothing_of_an_evaluation() -> None:
    """A seed in it would stand beside the `final_info` of the evaluation before."""
    assert gym.make("SADA-Analytic-v0").reset(seed=3)[1] == {}
    envs = gym.make_vec("SADA-Analytic-v0", num_envs=2)
    assert envs.reset(seed=3)[1] == {}
    infos = envs.step(np.zeros((2, 2), np.float32))[4]
    assert sorted(key for key in infos if not key.startswith("_")) == ["final_info", "final_obs"]


@pytest.mark.parametrize("env_id", ["SADA-Analytic-v0", "SADA-RacingTask-v0"])
def test_batches_have_their_autoreset_mode_as_an_attribute_too(env_id: str) -> None:
    envs = gym.make_vec(env_id, num_envs=2)
    assert envs.autoreset_mode is envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    envs.close()


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, "SameStep"])
def test_the_documented_keyword_saves_every_second_action(mode: Any) -> None:
    """Gymnasium's default throws the action away that comes after the end of an episode."""

    def evaluations(**keywords: Any) -> int:
        envs = gym.make_vec(
            "SADA-Analytic-v0", num_envs=2, vectorization_mode="sync", vector_kwargs=keywords
        )
        envs.reset(seed=0)
        rewards = [envs.step(np.full((2, 2), 0.9, np.float32))[1] for _ in range(6)]
        return int((np.array(rewards) != 0).sum())

    assert evaluations() == 6
    assert evaluations(autoreset_mode=mode) == 12


@pytest.mark.parametrize("render_mode", [3, ["rgb_array"], b"rgb_array", np.array(["a", "b"])])
def test_a_render_mode_that_is_no_string_is_refused(render_mode: Any) -> None:
    with pytest.raises(ValueError, match="Expected render_mode None or among"):
        AdversaryEnv(AnalyticApplication(), render_mode=render_mode)
    with pytest.raises(ValueError, match="Expected render_mode None or among"):
        gym.make_vec("SADA-Analytic-v0", num_envs=2, render_mode=render_mode)
    with pytest.raises(ValueError, match="Expected render_mode None or among"):
        sada_gym.make_application("SADA-Analytic-v0", render_mode=render_mode)


def test_an_action_keeps_its_mask_until_it_is_refused() -> None:
    env = AdversaryEnv(AnalyticApplication(), render_mode="rgb_array")
    env.reset(seed=0)
    masked = np.ma.array([0.1, 0.2], mask=[True, False])
    for use in (
        env.step,
        lambda mu: env.replay(mu, 3),
        lambda mu: env.application.observation(mu, 3),
    ):
        with pytest.raises(ValueError, match="Expected mu without a mask"):
            use(masked)
    with pytest.raises(TypeError, match="Expected mu to be an array of real numbers, got dtype"):
        env.step(np.array(["0.1", "0.2"]))
    assert_array_equal(env.step([0.1, 0.2])[0][:2], np.float32([0.1, 0.2]))  # type: ignore[arg-type]

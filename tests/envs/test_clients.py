"""Libraries that drive the environments with seeds of their own choice, up to 2**32 - 1."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from sada_gym.foundations.sb3_vec_env import SB3VecEnv

ANALYTIC = "SADA-Analytic-v0"


def native() -> VecEnv:
    return SB3VecEnv(gym.make_vec(ANALYTIC, num_envs=2))


def dummy() -> VecEnv:
    return DummyVecEnv([lambda: gym.make(ANALYTIC)] * 2)


@pytest.fixture
def large_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let SB3 draw the largest seed that it can."""
    monkeypatch.setattr(np.random, "randint", lambda *_, **__: np.uint32(2**32 - 1))


@pytest.mark.usefixtures("large_draws")
@pytest.mark.parametrize("make", [native, dummy, lambda: make_vec_env(ANALYTIC, n_envs=2)])
def test_sb3_seeds_itself(make: Any) -> None:
    envs = make()
    seeds = envs.seed(None)
    assert min(seeds) >= 2**32 - 1
    envs.reset()
    infos = envs.step(np.zeros((2, 2), np.float32))[3]
    assert all(0 <= info["seed"] < 2**31 for info in infos)
    envs.close()


@pytest.mark.parametrize("make", [native, dummy])
def test_ppo_learns_without_a_seed_and_is_evaluated(make: Any, tmp_path: Path) -> None:
    model = PPO("MlpPolicy", make(), n_steps=4, batch_size=8, n_epochs=1, device="cpu")
    callback = EvalCallback(make(), n_eval_episodes=2, eval_freq=4, verbose=0, warn=False)
    model.learn(16, callback=callback)
    assert np.isfinite(callback.last_mean_reward)


def test_torchrl_draws_seeds_and_steps() -> None:
    envs = pytest.importorskip("torchrl.envs")
    env = envs.GymEnv(ANALYTIC)
    env.set_seed(2**32 - 1)
    for _ in range(20):
        env.set_seed(env.set_seed(2**32 - 1))
        assert env.rollout(2)["next", "reward"].shape == (1, 1)
    batch = envs.GymWrapper(gym.make_vec(ANALYTIC, num_envs=3))
    assert batch.rollout(2)["next", "reward"].shape[0] == 3


def test_rl_zoo_trains_with_its_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    train = pytest.importorskip("rl_zoo3.train")
    settings = tmp_path / "settings.yml"
    settings.write_text(
        f"{ANALYTIC}:\n  n_timesteps: 32\n  policy: MlpPolicy\n  n_steps: 8\n  batch_size: 8\n"
    )
    words = f"--algo ppo --env {ANALYTIC} --gym-packages sada_gym -conf {settings} --verbose 0"
    words += f" -f {tmp_path / 'log'} --eval-freq 8 --eval-episodes 2"
    monkeypatch.setattr(sys, "argv", ["train", *words.split()])
    train.train()
    assert list((tmp_path / "log").rglob("evaluations.npz"))

import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

from sada_gym.errors import UserError
from sada_gym.evaluation.env import OracleEnv, OracleVectorEnv
from sada_gym.foundations.determinism import one_thread
from sada_gym.foundations.sb3_vec_env import SB3VecEnv
from sada_gym.oracle import Oracle
from sada_gym.sb3 import AttackCallback, sample_policy

ANALYTIC = "SADA-Analytic-v0"
ROOT = Path(__file__).resolve().parent.parent
ZOO = sorted((ROOT / "examples" / "rl_zoo3").glob("*.yml"))


@pytest.fixture(autouse=True)
def threads():
    with one_thread():
        yield


def ppo(env, folder=None):
    settings = {"n_steps": 20, "batch_size": 20, "n_epochs": 1, "seed": 0, "device": "cpu"}
    return PPO("MlpPolicy", env, tensorboard_log=folder and str(folder), **settings)


def written(folder):
    """Read a TensorBoard log back: scalars as {name: {step: value}}, histograms likewise."""
    accumulators = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    (file,) = folder.rglob("events.*")
    everything = {"scalars": 0, "histograms": 0}
    log = accumulators.EventAccumulator(str(file), everything).Reload()
    tags = log.Tags()
    scalars = {n: {e.step: e.value for e in log.Scalars(n)} for n in tags["scalars"]}
    return scalars, {
        n: {e.step: e.histogram_value for e in log.Histograms(n)} for n in tags["histograms"]
    }


def test_the_callback_logs_the_queries_and_ends_the_training(tmp_path):
    pytest.importorskip("tensorboard")
    oracle = Oracle(ANALYTIC, budget=110)
    model = ppo(SB3VecEnv(OracleVectorEnv(oracle, 2)), tmp_path)
    model.learn(10_000, callback=AttackCallback(oracle, every=50))
    assert oracle.remaining == 0
    record = oracle.record
    scalars, histograms = written(tmp_path)
    assert set(scalars["attack/score"]) == {50, 100, 110}
    assert scalars["attack/budget_left"] == {50: 60, 100: 10, 110: 0}
    for start, stop in ((0, 50), (50, 100), (100, 110)):
        mu, score = record.mu[start:stop], record.score[start:stop]
        assert scalars["attack/score"][stop] == pytest.approx(score.mean(), rel=1e-5)
        assert scalars["attack/fooling_rate"][stop] == pytest.approx((score <= 0.3).mean())
        for i, name in enumerate(("x0", "x1")):
            assert scalars[f"mu_mean/{name}"][stop] == pytest.approx(mu[:, i].mean(), abs=1e-5)
            assert scalars[f"mu_sd/{name}"][stop] == pytest.approx(mu[:, i].std(), rel=1e-4)
            assert histograms[f"mu/{name}"][stop].num == stop - start


def test_the_last_rollout_is_learnt_from_with_the_callback_too(tmp_path):
    pytest.importorskip("tensorboard")
    updates = []
    for logged in (False, True):
        oracle = Oracle(ANALYTIC, budget=80)
        model = ppo(SB3VecEnv(OracleVectorEnv(oracle, 2)), tmp_path)
        callback = AttackCallback(oracle) if logged else None
        for _ in range(2):  # two rollouts; the second call counts on from the first
            model.learn(40, callback=callback, reset_num_timesteps=False)
        assert oracle.remaining == 0
        updates.append(model._n_updates)
    assert updates == [2, 2]


def test_the_callback_names_a_functions_parameters_by_number_and_goes_on(tmp_path):
    pytest.importorskip("tensorboard")
    oracle = Oracle(lambda mu: mu[:, 0] ** 2, dimension=2, threshold=0.1, budget=60)
    oracle(np.zeros((20, 2)))  # what was asked before the training is not its own
    settings = {"learning_starts": 5, "train_freq": 10, "batch_size": 8, "device": "cpu"}
    policy = {"net_arch": [8]}
    model = SAC(
        "MlpPolicy",
        OracleEnv(oracle, horizon=3),
        tensorboard_log=str(tmp_path),
        policy_kwargs=policy,
        seed=0,
        **settings,
    )
    model.learn(30, callback=AttackCallback(oracle, every=25))
    scalars, _ = written(tmp_path)
    assert set(scalars["mu_mean/1"]) == {45, 50}
    assert oracle.remaining == 10


def test_a_callback_that_can_write_nothing_is_refused():
    oracle = Oracle(ANALYTIC, budget=10)
    with pytest.raises(UserError, match=r"got one that does not\. Make it with tensorboard_log"):
        ppo(OracleEnv(oracle)).learn(10, callback=AttackCallback(oracle))
    assert oracle.remaining == 10
    with pytest.raises(UserError, match="Expected every of at least 1, got 0"):
        AttackCallback(oracle, every=0)


def test_a_policy_is_sampled_by_the_seed_alone():
    model = ppo(gym.make(ANALYTIC))
    before = torch.random.get_rng_state()
    mu = sample_policy(model, 2, 50, seed=3)
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.rand(1)
    np.testing.assert_array_equal(sample_policy(model, 2, 50, seed=3), mu)
    assert (sample_policy(model, 2, 50, seed=4) != mu).any()
    assert (mu.shape, mu.dtype) == ((50, 2), np.float32)
    assert (np.abs(mu) <= 1.0).all()
    assert sample_policy(model, 2, 0, seed=0).shape == (0, 2)


def watchful(model):
    """Let an untrained policy depend on what it observes, with little noise."""
    with torch.no_grad():
        model.policy.action_net.weight.mul_(100.0)
        model.policy.log_std.fill_(-4.0)
    return model


def test_a_policys_samples_are_its_first_proposals():
    env = gym.make(ANALYTIC, horizon=4)
    model = watchful(ppo(env))
    first, _ = env.reset(seed=0)
    later, *_ = env.step(np.float32([0.5, -0.5]))
    expected, other = (model.predict(seen, deterministic=True)[0] for seen in (first, later))
    assert np.abs(expected - other).max() > 0.1
    mean = sample_policy(model, 2, 1000, seed=0).mean(axis=0)
    np.testing.assert_allclose(mean, expected, atol=0.01)


def test_a_policy_behind_vec_normalize_sees_what_it_was_trained_on():
    env = VecNormalize(SB3VecEnv(gym.make_vec(ANALYTIC, num_envs=2, horizon=4)))
    model = watchful(ppo(env))
    env.obs_rms.mean, env.obs_rms.var = np.array([0.1, -0.2, 0.3, 0.5]), np.full(4, 0.25)
    expected, _ = model.predict(env.reset()[0], deterministic=True)
    plain, _ = model.predict(np.float32([0, 0, 0, 1]), deterministic=True)
    assert np.abs(expected - plain).max() > 0.1
    mean = sample_policy(model, 2, 1000, seed=0).mean(axis=0)
    np.testing.assert_allclose(mean, expected, atol=0.01)


@pytest.mark.parametrize("algorithm", [PPO, SAC])
def test_a_policy_with_state_dependent_noise_proposes_different_mu(algorithm):
    model = algorithm("MlpPolicy", gym.make(ANALYTIC), use_sde=True, device="cpu", seed=0)
    mu = sample_policy(model, 2, 200, seed=0)
    assert (mu.std(axis=0) > 0.02).all()
    np.testing.assert_array_equal(sample_policy(model, 2, 200, seed=0), mu)


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (lambda: gym.make(ANALYTIC, dimension=3), r"whose observation space is Box\(.*\(4,\), fl"),
        (lambda: gym.make("Pendulum-v1"), r"whose observation space is .* with 2 parameters"),
        (lambda: WideActions(), r"whose action space is Box\(-1\.0, 1\.0, \(2,\).*, got Box\(-2"),
    ],
)
def test_a_policy_whose_spaces_do_not_fit_is_refused(env, message):
    with pytest.raises(UserError, match=message):
        sample_policy(ppo(env()), 2, 5, seed=0)


class WideActions(gym.Env):
    observation_space = gym.spaces.Box(-1.0, 1.0, (4,), np.float32)
    action_space = gym.spaces.Box(-2.0, 2.0, (2,), np.float32)


@pytest.mark.parametrize("bad", [{"n": -1}, {"n": 2.5}, {"seed": -1}])
def test_bad_numbers_are_refused(bad):
    with pytest.raises(UserError, match=f"Expected {next(iter(bad))} "):
        sample_policy(ppo(gym.make(ANALYTIC)), 2, **{"n": 5, "seed": 0, **bad})


@pytest.mark.parametrize("file", ZOO, ids=lambda file: file.stem)
def test_the_settings_for_rl_zoo_hold_for_every_environment(file):
    assert re.findall(r"^([\w-]+):", file.read_text(), re.MULTILINE) == ["default"]


def test_there_are_settings_for_three_algorithms():
    assert [file.stem for file in ZOO] == ["ppo", "sac", "tqc"]


@pytest.mark.parametrize("file", ZOO, ids=lambda file: file.stem)
def test_rl_zoo_trains_with_our_settings(file, tmp_path, monkeypatch):
    train = pytest.importorskip("rl_zoo3.train")
    words = f"--algo {file.stem} --env {ANALYTIC} --gym-packages sada_gym -conf {file} -n 40"
    words += f" -f {tmp_path / 'log'} --eval-freq 20 --eval-episodes 2 --verbose 0 --seed 0"
    monkeypatch.setattr(sys, "argv", ["train", *words.split()])
    train.train()
    assert list((tmp_path / "log").rglob(f"{ANALYTIC}.zip"))


def rows(store):
    """Count the evaluations that a store has committed; none other may have it open."""
    with closing(sqlite3.connect(store)) as opened:
        return opened.execute("SELECT count(*) FROM evaluation").fetchone()[0]


@pytest.mark.slow
def test_a_killed_script_goes_on_from_its_store(tmp_path):
    text = (ROOT / "examples" / "sb3_adversary.py").read_text()
    (tmp_path / "script.py").write_text(text.replace("BUDGET = 8_192", "BUDGET = 2_048"))
    path = os.pathsep.join([str(ROOT), *sys.path])
    settings = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": path}}
    command = [sys.executable, "script.py"]
    store = tmp_path / "sb3.sqlite"
    script = subprocess.Popen(command, **settings)
    while sum(file.stat().st_size for file in tmp_path.glob("sb3.sqlite*")) < 80_000:
        assert script.poll() is None
        time.sleep(0.01)
    script.send_signal(signal.SIGKILL)
    script.wait()
    committed = rows(store)
    assert 100 <= committed < 2_048
    again, third = (subprocess.check_output(command, text=True, **settings) for _ in range(2))
    known = re.search(r"horizon 1: 2,048 queries, the store knew ([\d,]+) of them", again)
    assert int(known[1].replace(",", "")) == committed
    assert "horizon 1: 2,048 queries, the store knew 2,048 of them" in third
    # but for what the store knew, it says the same
    unknown = re.compile(r"the store knew [\d,]+ of them")
    assert unknown.sub("", again) == unknown.sub("", third)

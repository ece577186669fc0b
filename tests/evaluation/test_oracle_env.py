import subprocess
import sys
import warnings
from contextlib import suppress

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_sb3
from toy import paraboloid

from sada_gym.envs.adversary import AdversaryEnv
from sada_gym.errors import BudgetExhausted, UserError
from sada_gym.evaluation.env import OracleEnv, OracleVectorEnv
from sada_gym.evaluation.problems import make_application
from sada_gym.foundations.sb3_vec_env import SB3VecEnv
from sada_gym.oracle import Oracle, evaluation_seeds

ANALYTIC = "SADA-Analytic-v0"
MU = np.random.default_rng(0).uniform(-1, 1, (20, 2)).astype(np.float32)


def oracle_of(budget, **settings):
    return Oracle(ANALYTIC, budget=budget, **settings)


@pytest.mark.parametrize("horizon", [1, 3])
def test_the_checkers_pass_without_a_warning(horizon):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(spec|not a render).*")
        check_env(OracleEnv(oracle_of(1000), horizon), skip_render_check=True)
        check_env_sb3(OracleEnv(oracle_of(1000), horizon), skip_render_check=True)


def test_a_step_is_a_query():
    oracle = oracle_of(10, env_kwargs={"noise": 0.2})
    env = OracleEnv(oracle)
    application = make_application(ANALYTIC, noise=0.2)
    expected = application.evaluate(MU[:10], evaluation_seeds(0, "train", 0, 10)).score
    for i in range(10):
        env.reset()
        observation, reward, terminated, truncated, info = env.step(MU[i])
        assert reward == -expected[i] == -info["score"]
        assert oracle.remaining == 9 - i
        assert (terminated, truncated) == (True, False)
        np.testing.assert_array_equal(observation, np.float32([*MU[i], expected[i], 0]))
    np.testing.assert_array_equal(oracle.record.mu, MU[:10])


def test_observations_are_those_of_the_adversarys_environment():
    inner = AdversaryEnv(make_application(ANALYTIC), horizon=4)
    env = OracleEnv(oracle_of(8), horizon=4)
    assert env.observation_space == inner.observation_space
    assert env.action_space == inner.action_space
    np.testing.assert_array_equal(env.reset()[0], inner.reset(seed=0)[0])
    for mu in MU[:4]:
        (ours, *end, _), (theirs, *their_end, _) = env.step(mu), inner.step(mu)
        np.testing.assert_array_equal(ours, theirs)
        assert end == their_end


def test_the_last_query_truncates_and_the_next_step_raises():
    oracle = oracle_of(2)
    env = OracleEnv(oracle, horizon=5)
    env.reset()
    assert env.step(MU[0])[2:4] == (False, False)
    assert env.step(MU[1])[2:4] == (False, True)
    with pytest.raises(BudgetExhausted, match=r"at least 1 queries to be left .* got 0"):
        env.step(MU[2])
    env.reset()
    with pytest.raises(BudgetExhausted):
        env.step(MU[2])
    assert len(oracle.record) == 2


def test_scores_of_any_function_stay_in_the_box():
    oracle = Oracle(lambda mu: 7.0 * paraboloid(mu) + 3.0, dimension=2, threshold=0.3, budget=1)
    env = OracleEnv(oracle)
    env.reset()
    observation, reward, *_ = env.step(MU[0])
    assert observation in env.observation_space
    assert reward < -3.0


@pytest.fixture
def one_thread():
    """Keep torch's threads from waiting for each other where others use the processor too."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("count", [1, 4])
def test_ppo_spends_exactly_the_budget(count):
    oracle = oracle_of(150)  # two rollouts of 64, and a third that is cut
    env = OracleEnv(oracle) if count == 1 else SB3VecEnv(OracleVectorEnv(oracle, count))
    model = PPO("MlpPolicy", env, n_steps=64 // count, batch_size=64, n_epochs=1, seed=0)
    with suppress(BudgetExhausted):
        model.learn(10_000)
    assert oracle.remaining == 0
    assert len(oracle.record) == 150
    assert model._n_updates == 2
    mu, _ = model.predict(env.reset() if count > 1 else env.reset()[0], deterministic=False)
    assert np.abs(mu).max() <= 1.0


@pytest.mark.usefixtures("one_thread")
def test_ppo_learns():
    oracle = oracle_of(2560)
    env = SB3VecEnv(OracleVectorEnv(oracle, 64))
    settings = {"n_steps": 2, "batch_size": 128, "n_epochs": 5, "learning_rate": 1e-2}
    model = PPO("MlpPolicy", env, gamma=0.0, seed=0, device="cpu", **settings)
    with suppress(BudgetExhausted):
        model.learn(oracle.remaining)
    assert oracle.remaining == 0
    score = oracle.record.score
    assert score[-256:].mean() < 0.85 * score[:256].mean()


def test_the_vector_environment_equals_scalar_ones():
    whole, single = oracle_of(12), oracle_of(12)
    vector, env = OracleVectorEnv(whole, 4, horizon=3), OracleEnv(single, horizon=3)
    first, _ = vector.reset()
    np.testing.assert_array_equal(first, np.tile(env.reset()[0], (4, 1)))
    steps = [vector.step(MU[4 * i : 4 * i + 4]) for i in range(3)]
    for k in range(4):
        env.reset()
        for i in range(3):
            observation, reward, terminated, _, info = env.step(MU[4 * i + k])
            state, rewards, ends, _, infos = steps[i]
            last = infos["final_obs"][k] if terminated else state[k]
            np.testing.assert_array_equal(last, observation)
            assert (rewards[k], ends[k]) == (reward, terminated)
            inner = infos["final_info"] if terminated else infos
            assert inner["score"][k] == info["score"]
    np.testing.assert_array_equal(steps[-1][0], first)  # begun anew


def test_the_last_queries_are_spent_though_fewer_than_a_batch():
    oracle = oracle_of(10)
    env = OracleVectorEnv(oracle, 4)
    env.reset()
    env.step(MU[:4])
    env.step(MU[4:8])
    with pytest.raises(BudgetExhausted, match="at least 4 queries to be left for a step, got 2"):
        env.step(MU[8:12])
    np.testing.assert_array_equal(oracle.record.mu, MU[:10])


def test_only_some_are_reset():
    env = OracleVectorEnv(oracle_of(10), 2, horizon=3)
    env.reset()
    before = env.step(MU[:2])[0]
    after, _ = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(after[0], np.float32([0, 0, 0, 1]))
    np.testing.assert_array_equal(after[1], before[1])


def test_gymnasiums_wrappers_take_it():
    env = gym.wrappers.RecordEpisodeStatistics(OracleEnv(oracle_of(3)))
    env.reset()
    *_, info = env.step(MU[0])
    assert info["episode"]["r"] == pytest.approx(-info["score"])


def test_gymnasiums_vector_wrappers_take_it():
    env = gym.wrappers.vector.RecordEpisodeStatistics(OracleVectorEnv(oracle_of(8), 4))
    assert env.unwrapped.autoreset_mode is env.metadata["autoreset_mode"]
    env.reset()
    _, reward, *_, infos = env.step(MU[:4])
    np.testing.assert_allclose(infos["episode"]["r"], reward)
    assert SB3VecEnv(env).num_envs == 4


def test_a_step_before_the_reset_is_refused():
    with pytest.raises(ResetNeeded):
        OracleEnv(oracle_of(3)).step(MU[0])


@pytest.mark.parametrize("horizon", [0, -1, 1.5, True])
def test_a_bad_horizon_is_refused(horizon):
    with pytest.raises(UserError, match="Expected horizon to be an int of at least 1"):
        OracleEnv(oracle_of(3), horizon)


def test_bad_actions_and_counts_are_refused():
    env = OracleEnv(oracle_of(3))
    env.reset()
    with pytest.raises(UserError, match=r"Expected an action of shape \(2,\), got \(3,\)"):
        env.step(np.zeros(3))
    with pytest.raises(UserError, match="within"):
        env.step(np.full(2, 2.0))
    with pytest.raises(UserError, match="num_envs of at least 1"):
        OracleVectorEnv(oracle_of(3), 0)
    with pytest.raises(UserError, match="Expected num_envs to be a whole number"):
        OracleVectorEnv(oracle_of(3), 2.5)
    vector = OracleVectorEnv(oracle_of(3), 2)
    with pytest.raises(UserError, match=r"Expected actions of shape \(2, 2\)"):
        vector.step(np.zeros((3, 2)))
    with pytest.raises(UserError, match="Expected mu without a mask"):
        env.step(np.ma.zeros(2))
    with pytest.raises(UserError, match="Expected mu without a mask"):
        vector.step(np.ma.zeros((2, 2)))
    with pytest.raises(UserError, match="Expected mu to be an array of real numbers, got: "):
        env.step([[1], [1, 2]])
    for each in (env, vector):
        with pytest.raises(
            UserError, match="Expected the options of a reset in a dictionary, got 5"
        ):
            each.reset(options=5)
        with pytest.raises(UserError, match=r"Expected .*reset options.*, got 'mask'"):
            each.reset(options={"mask": 1})
    with pytest.raises(UserError, match="Expected seeds to be ints from 0 up, got 'x'"):
        vector.reset(seed="x")
    with pytest.raises(UserError, match="Expected horizon of at most 2,147,483,647"):
        OracleEnv(oracle_of(3), 10**30)
    assert env.oracle.remaining == 3


def test_it_imports_no_application():
    code = (
        "import sada_gym, sys; cards = {*sys.modules}; import sada_gym.evaluation.env; "
        "print([m for m in {*sys.modules} - cards if m.startswith('sada_gym.envs')])"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"

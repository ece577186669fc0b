import random
import subprocess
import sys

import numpy as np
import pytest
import torch
from numpy.testing import assert_array_equal

from sada_gym import adversaries
from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.reinforce import Reinforce
from sada_gym.adversaries.rl_sb3 import PPO, SAC, TD3
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.errors import AdversaryError, TrainingDiverged, UserError
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape

OFF_POLICY = {"hidden": (16,), "updates": 0.2, "batch": 16}
QUICK = {
    "reinforce": {"components": 3},
    "ppo": {"hidden": (16,), "epochs": 3},
    "sac": OFF_POLICY,
    "td3": OFF_POLICY,
}
NAMES = list(QUICK)
SB3 = NAMES[1:]


class TestReinforce(AdversaryContract):
    def make(self, dimension, seed):
        return Reinforce(dimension, seed=seed, **QUICK["reinforce"])


class TestPPO(AdversaryContract):
    def make(self, dimension, seed):
        return PPO(dimension, seed=seed, **QUICK["ppo"])


class TestSAC(AdversaryContract):
    def make(self, dimension, seed):
        return SAC(dimension, seed=seed, **QUICK["sac"])


class TestTD3(AdversaryContract):
    def make(self, dimension, seed):
        return TD3(dimension, seed=seed, **QUICK["td3"])


def trained(name, score=None, budget=130, dimension=2, seed=0, **options):
    """Train quickly: the adversary and its oracle."""
    score = score or AnalyticScore(dimension)
    oracle = FunctionOracle(score, budget)
    adversary = adversaries.make(name, dimension, seed=seed, **{**QUICK[name], **options})
    adversary.train(oracle)
    return adversary, np.concatenate(oracle.queries)


class AnalyticScore:
    """The analytic application's Q."""

    def __init__(self, dimension):
        self.application = AnalyticApplication(dimension=dimension)

    def __call__(self, mu):
        return self.application.evaluate(mu, range(len(mu))).score


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("budget", [23, 56, 100, 133])
def test_the_whole_budget_is_spent_and_learnt_from(name, budget):
    """A rollout is never cut: what would not fill one is asked uniformly, first."""
    oracle = FunctionOracle(AnalyticScore(2), budget)
    options = {**QUICK[name], "rollout": 20, "dissimilarity": 0.5}
    adversary = adversaries.make(name, 2, seed=0, **options)
    learnt, learn = [], adversary.learn
    adversary.learn = lambda proposals, rewards: (
        learnt.append(proposals.mu) or learn(proposals, rewards)
    )
    adversary.train(oracle)
    rollouts = int(0.9 * budget) // 20
    uniform, *others = oracle.queries
    assert [len(mu) for mu in oracle.queries] == [budget - 20 * rollouts, *[20] * rollouts]
    expected = np.random.default_rng(0).uniform(-1.0, 1.0, (len(uniform), 2)).astype(np.float32)
    assert_array_equal(uniform, expected)
    assert_array_equal(others, learnt)
    assert len(adversary.queries) == budget


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("rollout", [2, 20, 37])
@pytest.mark.parametrize("uniform_share", [0.01, 0.1, 0.5, 0.97])
def test_a_budget_below_a_rollout_is_refused_with_the_least_that_suffices(
    name, rollout, uniform_share
):
    adversary = adversaries.make(
        name, 2, seed=0, **QUICK[name], rollout=rollout, uniform_share=uniform_share
    )
    least = adversary.minimum_budget
    assert adversary._rollouts(least) == 1
    assert adversary._rollouts(least - 1) == 0
    oracle = RecordingOracle(AnalyticApplication(), budget=least - 1)
    message = rf"Expected a budget of at least {least} queries for {name}, got {least - 1}: .*whole"
    with pytest.raises(AdversaryError, match=message + rf" rollout of {rollout}\. Raise the bud"):
        adversary.train(oracle)
    assert oracle.remaining == least - 1


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("transform", [lambda q: q**4, np.log])
def test_the_scale_of_q_changes_nothing(name, transform):
    def rescaled(mu):
        return transform(AnalyticScore(2)(mu))

    adversary, queries = trained(name, dissimilarity=0.3)
    oracle = FunctionOracle(rescaled, 130, float(transform(0.3)))
    other = adversaries.make(name, 2, seed=0, **QUICK[name], dissimilarity=0.3)
    other.train(oracle)
    assert_array_equal(np.concatenate(oracle.queries), queries)
    assert_array_equal(other.sample(50), adversary.sample(50))


@pytest.mark.parametrize("name", NAMES)
def test_global_generators_change_nothing_and_are_hidden_from_the_oracle(name):
    """A score function may use them: it meets them as its user left them."""
    drawn = []

    def score(mu):
        drawn.append((random.random(), np.random.random(), float(torch.rand(1))))  # noqa: NPY002
        return AnalyticScore(2)(mu)

    results = []
    for seed in (1, 2):
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        torch.manual_seed(seed)
        adversary, queries = trained(name, score)
        results.append((queries, adversary.sample(20)))
    for ours, theirs in zip(*results, strict=True):
        assert_array_equal(ours, theirs)
    assert len(set(drawn)) == len(drawn)
    random.seed(2)
    np.random.seed(2)  # noqa: NPY002
    torch.manual_seed(2)
    half = len(drawn) // 2
    again = [
        (random.random(), np.random.random(), float(torch.rand(1)))  # noqa: NPY002
        for _ in range(half)
    ]
    assert again == drawn[half:]


@pytest.mark.parametrize("name", NAMES)
def test_the_number_of_threads_changes_nothing(name):
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            adversary, queries = trained(
                name,
                dimension=3,
                budget=80,
                **({} if name == "reinforce" else {"hidden": (64, 64)}),
            )
            results.append(np.concatenate([queries, adversary.sample(3000)]))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert_array_equal(*results)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("score", "flags"), [(0.0, []), (0.9, [NONE_FOOLED])])
def test_constant_scores(name, score, flags):
    adversary, _ = trained(name, lambda mu: np.full(len(mu), score), dissimilarity=0.5)
    assert adversary.flags == flags
    assert len(np.unique(adversary.sample(300), axis=0)) == 300


@pytest.mark.parametrize("name", NAMES)
def test_where_nothing_fools_the_order_of_scores_leads_to_the_lowest(name):
    options = {"updates": 0.4, "batch": 32} if name in ("sac", "td3") else {}
    adversary = adversaries.make(name, 2, seed=0, **options)
    adversary.train(FunctionOracle(lambda mu: 0.5 + 0.2 * np.abs(mu - 0.6).max(axis=1), 500))
    assert adversary.flags == [NONE_FOOLED]
    distance = np.abs(adversary.sample(300) - 0.6).max(axis=1)
    uniform = np.abs(np.random.default_rng(0).uniform(-1, 1, (300, 2)) - 0.6).max(axis=1)
    assert distance.mean() < 0.75 * uniform.mean()


@pytest.mark.parametrize("name", SB3)
@pytest.mark.parametrize("what", ["weights", "loss"])
def test_training_that_diverges_is_an_error_that_says_what_to_change(name, what, monkeypatch):
    adversary = adversaries.make(name, 2, seed=0, **QUICK[name])
    begin, number = adversary.begin, float("nan" if what == "weights" else "inf")

    def spoil(**settings):
        for weights in adversary._model.policy.parameters():
            weights.data.fill_(number)

    def begin_badly(queries):
        begin(queries)
        if what == "weights":
            spoil()
        else:
            adversary._model.train = spoil

    monkeypatch.setattr(adversary, "begin", begin_badly)
    oracle = RecordingOracle(AnalyticApplication(), budget=200)
    with pytest.raises(TrainingDiverged, match=rf"training of {name} .*Lower learning_rate"):
        adversary.train(oracle)
    assert oracle.remaining > 0


@pytest.mark.parametrize("name", SB3)
def test_one_start_gives_one_place_and_many_starts_many(name):
    for starts, many in (("centre", False), ("uniform", True)):
        adversary, _ = trained(name, starts=starts)
        start = adversary.act(30).start
        assert (len(np.unique(start, axis=0)) > 1) == many


def test_the_policy_of_ppo_is_sampled_as_stable_baselines3_would():
    adversary, _ = trained("ppo", starts="centre", rollout=20)
    action = np.stack([adversary.act(1).action[0] for _ in range(4000)])
    theirs, _ = adversary._model.predict(np.zeros((4000, 2), np.float32))
    inside = np.abs(action).max(axis=1) < 1.0  # SB3 clips what lies outside
    kept = np.abs(theirs).max(axis=1) < 1.0
    assert_allclose_moments(action[inside], theirs[kept])


@pytest.mark.parametrize("name", ["sac", "td3"])
def test_off_policy_policies_are_sampled_as_stable_baselines3_would(name):
    adversary, _ = trained(name, starts="centre")
    action = adversary.act(4000).action
    theirs, _ = adversary._model.predict(np.zeros((4000, 2), np.float32), deterministic=False)
    if name == "td3":
        theirs = theirs + adversary.options.noise * np.random.default_rng(0).normal(size=(4000, 2))
    assert_allclose_moments(action, theirs)


def assert_allclose_moments(ours, theirs):
    np.testing.assert_allclose(ours.mean(axis=0), theirs.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(ours.std(axis=0), theirs.std(axis=0), atol=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_weights_of_another_shape_are_refused(name, tmp_path):
    adversary, _ = trained(name)
    adversary.save(tmp_path)
    path = tmp_path / "adversary.json"
    shape = '"components": 3', '"components": 4'
    text = path.read_text()
    for old, new in (shape, ('"hidden": [\n      16\n    ]', '"hidden": [17]')):
        text = text.replace(old, new)
    assert text != path.read_text()
    path.write_text(text)
    with pytest.raises(UserError, match="Expected a folder that") as caught:
        type(adversary).load(tmp_path)
    assert "\n" not in str(caught.value)


def test_the_plain_presets_are_the_textbooks():
    for name in SB3:
        plain = adversaries.find(name).presets["plain"]
        assert (plain.starts, plain.dissimilarity) == ("centre", 0.0)
    assert Reinforce.presets["plain"].components == 1


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("ppo", {"rollout": 1}, "Expected rollout to be an int from 2 to"),
        ("ppo", {"starts": "here"}, "Expected starts to be one of centre, uniform"),
        ("sac", {"updates": 0}, "Expected updates to be a float between 0 and 100, both excl"),
        ("td3", {"noise": 0.0}, "Expected noise to be a float between 0 and 10"),
        ("td3", {"entropy": 0.1}, "option of td3 to be .*; got 'entropy'"),
        ("reinforce", {"components": 0}, "Expected components to be an int from 1"),
        ("reinforce", {"dissimilarity": -1.0}, "Expected dissimilarity to be a float from 0"),
        ("sac", {"entropy": float("nan")}, "Expected entropy to be a float from 0"),
    ],
)
def test_bad_options_are_refused(name, options, message):
    with pytest.raises(UserError, match=message):
        adversaries.make(name, 2, **options)


@pytest.mark.long
def test_stable_baselines3_is_imported_only_to_train():
    code = "import sys; from sada_gym import adversaries;"
    code += f"[adversaries.make(name, 2) for name in {NAMES}];"
    code += "sys.exit('stable_baselines3' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_leads_uniform_samples(name):
    """With the defaults, at 2,000 queries, in eight dimensions with a random world."""
    landscape = Landscape(0)
    adversary = adversaries.make(name, 8, seed=0)
    adversary.train(FunctionOracle(landscape, 2000))
    assert landscape.fooling_rate(adversary.sample(1000)).mean() > 0.35 + 0.15

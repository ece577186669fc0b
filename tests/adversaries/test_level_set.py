import numpy as np
import pytest

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.level_set import MIN_BUDGET, LevelSet
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.testing import AdversaryContract
from sada_gym.testing.scales import scales
from studies.landscapes import THRESHOLD, FunctionOracle, Landscape


class TestLevelSet(AdversaryContract):
    budget = 100

    def make(self, dimension, seed):
        return LevelSet(dimension, seed=seed, rounds=1, models=["trees"])


def trained(function, *, dimension, budget=500, threshold=THRESHOLD, **options):
    oracle = FunctionOracle(function, budget, threshold)
    adversary = LevelSet(dimension, seed=0, **options)
    adversary.train(oracle)
    return adversary, oracle


@pytest.mark.long
@pytest.mark.parametrize(
    ("dimension", "budget"), [(2, 400), pytest.param(8, 1_500, marks=pytest.mark.slow)]
)
def test_fools_and_covers_separate_regions(dimension, budget):
    boxes = AnalyticApplication(dimension=dimension)
    adversary, oracle = trained(
        lambda mu: boxes.evaluate(mu, range(len(mu))).score,
        dimension=dimension,
        budget=budget,
        rounds=2,
    )
    assert oracle.remaining == 0
    samples = adversary.sample(250)
    score = boxes.evaluate(samples, range(250)).score
    assert attack_fooling_rate(score, 0.3).low > 0.85
    assert set(boxes.fooling_region(samples)) >= set(range(4))
    truth = boxes.sample_fooling_set(2_000, np.random.default_rng(1))
    covered = fooling_coverage(samples, score <= 0.3, truth).coverage
    assert covered > 0.9


@pytest.mark.long
def test_fools_as_often_as_the_truth_where_the_world_is_random():
    waves = Landscape(0)
    adversary, _ = trained(waves, dimension=8, budget=1_000, rounds=2)
    uniform = np.random.default_rng(0).uniform(-1, 1, (5_000, 8))
    rate = waves.fooling_rate(uniform)
    assert waves.fooling_rate(adversary.sample(500)).mean() > rate[rate >= 0.5].mean() - 0.03


def test_its_queries_and_samples_are_the_same_on_every_scale():
    boxes = AnalyticApplication(dimension=2)

    def score(mu):
        return boxes.evaluate(mu, range(len(mu))).score

    uniform = np.random.default_rng(1).uniform(-1.0, 1.0, (5_000, 2))
    first, *others = [
        trained(
            lambda mu, m=scale.map: m(score(mu)),
            threshold=float(scale.map(0.3)),
            dimension=2,
            budget=200,
            rounds=1,
            models=["process"],
        )[0]
        for scale in scales(score(uniform))
    ]
    samples = first.sample(50)
    for other in others:
        assert (other.queries.mu == first.queries.mu).all()
        assert (other.sample(50) == samples).all()


def test_it_holds_where_a_softmax_decides_and_the_threshold_is_tiny():
    image = DigitsApplication(image=135, parameters=("rotation_deg", "scale"))

    def score(mu):
        return image.evaluate(mu, [0] * len(mu)).score

    uniform = np.random.default_rng(2).uniform(-1.0, 1.0, (5_000, 2)).astype(np.float32)
    threshold = float(np.quantile(score(uniform), 0.1))
    assert threshold < 0.001
    adversary, _ = trained(score, threshold=threshold, dimension=2, budget=400, rounds=1)
    assert (score(adversary.sample(250)) <= threshold).mean() > 0.9


def test_queries_gather_where_the_boundary_is():
    boxes = AnalyticApplication(dimension=2)
    adversary, _ = trained(
        lambda mu: boxes.evaluate(mu, range(len(mu))).score,
        dimension=2,
        budget=300,
        uniform=0.3,
        explore=0.0,
        rounds=2,
    )

    def near_boundary(mu):
        return (np.abs(boxes.evaluate(mu, range(len(mu))).score - 0.3) < 0.1).mean()

    first, chosen = adversary.queries.mu[:90], adversary.queries.mu[90:]
    assert near_boundary(chosen) > 3 * near_boundary(first)


def test_a_rare_set_is_walked_in():
    centre = np.array([0.3, -0.4, 0.1, 0.5])

    def q(mu):
        return np.clip(np.linalg.norm(mu - centre, axis=1) / 0.8, 0.0, 1.0)

    adversary, _ = trained(q, dimension=4, budget=600, models=["process"])  # 0.1 % fools
    assert adversary._share < 0.002
    samples = adversary.sample(300)
    assert (q(samples) <= 0.3).mean() > 0.8
    assert samples.std(axis=0).min() > 0.03


@pytest.mark.long
@pytest.mark.parametrize("volume", [0.25, 1.0])
def test_the_sampled_set_keeps_a_part_of_the_volume_predicted_to_fool(volume):
    waves = Landscape(5, rate=0.05, noise=1.0)  # of which 300 queries make hardly any mu sure
    adversary, _ = trained(
        waves, dimension=8, budget=300, volume=volume, rounds=2, models=["trees"]
    )
    p = adversary._surrogate(np.random.default_rng(0).uniform(-1, 1, (20_000, 8)))
    assert (p >= 0.5).mean() < 0.2 * p.mean()
    assert (p >= adversary.level).mean() == pytest.approx(volume * p.mean(), rel=0.2)


def test_where_none_fools_it_says_so_and_takes_the_likeliest():
    adversary, _ = trained(
        lambda mu: 0.5 + 0.4 * np.abs(mu[:, 0]), dimension=2, budget=300, rounds=1
    )
    assert NONE_FOOLED in adversary.flags
    assert np.abs(adversary.sample(100)[:, 0]).mean() < 0.2


@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_a_constant_score_gives_uniform_samples(constant):
    adversary, _ = trained(lambda mu: np.full(len(mu), constant), dimension=3, budget=100)
    assert (NONE_FOOLED in adversary.flags) == (constant == 1.0)
    assert abs(adversary.sample(2_000).std() - 3**-0.5) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("dimension", [1, 64])
def test_extreme_dimensions(dimension):
    adversary, _ = trained(
        lambda mu: (mu[:, 0] + 1.0) / 2.0, dimension=dimension, budget=300, rounds=1
    )
    samples = adversary.sample(100)
    assert samples.shape == (100, dimension)
    assert (samples[:, 0] <= -0.4).mean() > 0.8


def test_too_small_a_budget_is_refused():
    with pytest.raises(ValueError, match=f"budget of at least {MIN_BUDGET} queries, got 19"):
        trained(lambda mu: mu[:, 0], dimension=1, budget=19)


def test_scores_that_are_no_numbers_are_refused():
    with pytest.raises(ValueError, match="finite scores"):
        trained(lambda mu: np.full(len(mu), np.nan), dimension=1)


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"uniform": 0.0}, "Expected uniform to be a float from 0.05 to 1, such as 0.4; got 0.0"),
        ({"uniform": "x"}, "Expected uniform to be a float"),
        ({"rounds": -1}, "Expected rounds to be an int from 0 to 100, such as 4; got -1"),
        ({"rounds": 2.5}, "Expected rounds to be an int"),
        ({"rounds": True}, "Expected rounds to be an int"),
        ({"explore": 1.5}, "Expected explore to be a float from"),
        ({"coverage": np.nan}, "Expected coverage to be a float from"),
        ({"volume": -0.1}, "Expected volume to be a float from 0 to 1, such as .*; got -0.1"),
        ({"models": ["forest"]}, r"1 to 2 items, each one of trees, process, .*got \['forest'\]"),
        ({"models": "trees"}, "each one of trees, process, such as .*; got 'trees'"),
        ({"models": []}, "Expected models to be a list of 1 to 2 items"),
    ],
)
def test_a_bad_option_is_refused(bad, message):
    with pytest.raises(ValueError, match=message):
        LevelSet(2, **bad)

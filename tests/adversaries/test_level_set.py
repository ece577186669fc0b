import numpy as np
import pytest

from sada_gym.adversaries.fitted import NONE_FOOLED
from sada_gym.adversaries.level_set import MIN_BUDGET, LevelSet
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.envs.digits.application import DigitsApplication
from sada_gym.evaluations import Evaluations
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.rates import attack_fooling_rate
from sada_gym.testing import AdversaryContract
from sada_gym.testing.scales import scales
from studies import many_dimensions
from studies.landscapes import THRESHOLD, FunctionOracle, Landscape
from studies.lucky_landscapes import LuckyLandscape


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
def test_the_level_is_raised_in_a_rare_set_as_well():
    # 3 % of the box are predicted to fool: 50,000 points, the usual pool, hold too few to judge by
    adversary, _ = trained(many_dimensions.gust, dimension=20, threshold=0.5)
    assert adversary.level > 0.5
    samples = adversary.sample(250)
    assert (many_dimensions.gust(samples) <= 0.5).mean() > 0.75


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


def spots():
    return LuckyLandscape(0, shape="spots", dimension=5)


@pytest.fixture(scope="module")
def lucky():
    adversary, _ = trained(spots(), dimension=5, rounds=2, models=["process"])
    assert adversary.hits_pay
    return adversary


def test_where_luck_hides_many_spots_samples_lie_beside_hits_and_fool_more_often(lucky):
    without, _ = trained(spots(), dimension=5, rounds=2, models=["process"], trial=0.0)
    assert not without.hits_pay
    assert lucky.queries.fooled(THRESHOLD).sum() > without.queries.fooled(THRESHOLD).sum()
    rates = [spots().fooling_rate(a.draw(1_000)).mean() for a in (without, lucky)]
    assert rates[1] > rates[0] + 0.1


def test_samples_beside_hits_and_in_the_level_set_have_the_parts_asked_for(lucky):
    def far(samples):
        """Farther from each hit than a step goes: the norm of five Gaussian numbers is below 5."""
        distances = np.linalg.norm(samples[:, None] - lucky._centres[None], axis=2)
        return distances.min(axis=1) > 5 * lucky.options.width

    samples = lucky.draw(4_000)
    assert len(samples) == 4_000
    expected = 0.25 * far(lucky._draw_level_set(2_000)).mean()
    assert expected > 0.1
    assert far(samples).mean() == pytest.approx(expected, abs=0.03)
    assert abs(far(samples[:2_000]).mean() - far(samples[2_000:]).mean()) < 0.05  # in any order


def test_a_saved_one_still_knows_that_hits_pay(lucky, tmp_path):
    lucky.save(tmp_path)
    loaded = LevelSet.load(tmp_path)
    assert loaded.hits_pay
    assert (loaded.sample(100) == lucky.sample(100)).all()


def test_all_its_queries_are_feasible_where_hits_pay():
    class Oracle(FunctionOracle):
        def permits(self, mu):
            return mu[:, 0] > 0.2

    adversary = LevelSet(5, seed=0, models=["process"], rounds=2)
    adversary.train(Oracle(spots(), 500, THRESHOLD))
    assert adversary.hits_pay
    assert (adversary.queries.mu[:, 0] > 0.2).all()
    assert (adversary.sample(300)[:, 0] > 0.2).all()


def test_where_no_way_from_hit_to_hit_is_permitted_the_attack_goes_on():
    class Ring(FunctionOracle):
        def permits(self, mu):
            return np.abs(np.linalg.norm(mu, axis=1) - 0.8) < 0.01

    luck = np.random.default_rng(3)
    adversary = LevelSet(2, seed=0, models=["process"])
    oracle = Ring(lambda mu: luck.random(len(mu)) * 0.75, 200, THRESHOLD)  # 40 % fool by luck
    adversary.train(oracle)
    assert adversary.hits_pay
    assert len(adversary.queries) == 200
    assert oracle.permits(adversary.queries.mu).all()
    assert oracle.permits(adversary.sample(50)).all()


@pytest.mark.long
def test_samples_do_not_crowd_beside_the_few_hits_that_checks_leave_where_all_is_luck():
    luck = np.random.default_rng(0)
    adversary, _ = trained(
        lambda mu: luck.random(len(mu)) * 6.0, dimension=5, budget=1_000, models=["process"]
    )  # 5 % fool, wherever they are
    assert adversary.hits_pay  # close to hits as seldom as elsewhere
    samples = adversary.sample(500)
    distances = np.linalg.norm(samples[:, None] - samples[None], axis=2)
    assert (distances < 0.25).mean(axis=1).max() < 0.1


class Trial:
    """An oracle of which mu close to hits fool at one rate, and those of the level set at another.

    Half of the pool is likely to fool, x > 0; the surrogate says so. Hits lie at x < -0.5.
    """

    threshold = 0.5

    def __init__(self, of_hits, of_set, predicted):
        self._rates, self._predicted = (of_hits, of_set), predicted

    def __call__(self, mu):
        at_hits = mu[:, 0] < 0.0
        score = np.ones(len(mu))
        for rows, rate in zip((at_hits, ~at_hits), self._rates, strict=True):
            score[np.flatnonzero(rows)[: round(rate * rows.sum())]] = 0.0
        return score

    def predict(self, mu):
        return np.where(mu[:, 0] < 0.0, self._predicted[0], self._predicted[1])


@pytest.mark.parametrize(
    ("of_hits", "of_set", "predicted", "pays"),
    [
        (0.6, 0.6, (0.6, 0.6), True),
        (0.56, 0.6, (0.56, 0.6), True),  # checks will make up for so much
        (0.52, 0.6, (0.52, 0.6), False),
        (0.24, 0.3, (0.24, 0.3), False),  # as far behind, for a set that seldom fools
        (0.7, 0.4, (0.4, 0.8), True),  # (0.7 + 0.4)/2 against (0.4 + 0.8)/2: both tell
        (0.6, 0.55, (0.4, 0.8), False),
        (1.0, 0.95, (1.0, 0.95), False),  # nothing is to be gained
    ],
)
def test_hits_pay_where_tried_and_predicted_they_fool_nearly_as_often(
    of_hits, of_set, predicted, pays
):
    adversary, trial = LevelSet(2, seed=0), Trial(of_hits, of_set, predicted)
    adversary.threshold = trial.threshold
    hits = np.stack([np.full(20, -0.8), np.linspace(-0.9, 0.9, 20)], axis=1).astype(np.float32)
    queries = Evaluations.unseeded(hits, np.zeros(20))
    pool = adversary._uniform(2_000)
    p = trial.predict(pool) + 0.1 * (pool[:, 0] > 0.0)
    tried = adversary._try_hits(queries, trial.predict, pool, p, 50, trial)
    assert len(tried) == 100
    assert (tried.mu[:50, 0] < -0.5).all()
    assert (tried.mu[50:, 0] > 0.0).all()
    assert adversary.hits_pay == pays


@pytest.mark.parametrize("options", [{"trial": 0.0}, {"trial": 0.25, "rounds": 100}, {"rounds": 1}])
@pytest.mark.parametrize("budget", [MIN_BUDGET, 41, 120])
def test_the_budget_is_spent_to_the_last_query(options, budget):
    adversary, oracle = trained(spots(), dimension=5, budget=budget, models=["process"], **options)
    assert oracle.remaining == 0
    assert len(adversary.queries) == budget


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
        ({"trial": 0.3}, "Expected trial to be a float from 0 to 0.25, such as 0.05; got 0.3"),
        ({"width": 0.0}, "Expected width to be a float"),
        ({"keep": 1.5}, "Expected keep to be a float from 0 to 1"),
        ({"beside": -0.1}, "Expected beside to be a float from 0 to 1"),
        ({"models": ["forest"]}, r"1 to 2 items, each one of trees, process, .*got \['forest'\]"),
        ({"models": "trees"}, "each one of trees, process, such as .*; got 'trees'"),
        ({"models": []}, "Expected models to be a list of 1 to 2 items"),
    ],
)
def test_a_bad_option_is_refused(bad, message):
    with pytest.raises(ValueError, match=message):
        LevelSet(2, **bad)

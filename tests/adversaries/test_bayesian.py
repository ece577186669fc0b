import numpy as np
import pytest
from numpy.testing import assert_array_equal
from threadpoolctl import threadpool_info, threadpool_limits

from sada_gym.adversaries import make
from sada_gym.adversaries.bayesian import Bayesian, minimise, stages
from sada_gym.adversaries.query_pool import evaluate_uniform
from sada_gym.envs.analytic import AnalyticApplication
from sada_gym.testing import AdversaryContract, RecordingOracle
from studies.landscapes import FunctionOracle, Landscape

QUICK = {"candidates": 512, "components": (1, 4)}


class TestBayesian(AdversaryContract):
    uses_values = True

    def make(self, dimension, seed):
        return Bayesian(dimension, seed=seed, **QUICK)


class TestBatchedBayesian(AdversaryContract):
    uses_values = True

    def make(self, dimension, seed):
        return Bayesian(dimension, seed=seed, batch=16, initial=30, **QUICK)


@pytest.mark.parametrize(("dimension", "share", "afr"), [(2, 0.7, 0.9), (8, 0.17, 0.5)])
def test_beats_uniform_on_boxes(dimension, share, afr):
    """A uniform search finds fooling points, and fools, 10 % of the time."""
    application = AnalyticApplication(dimension=dimension)
    oracle = RecordingOracle(application, budget=500)
    adversary = Bayesian(dimension, seed=0, candidates=4096)
    adversary.train(oracle)
    assert oracle.remaining == 0
    region = application.fooling_region(oracle.queries)
    assert (region >= 0).mean() > share
    if dimension == 2:
        assert np.bincount(region[region >= 0], minlength=4).min() > 20
    assert (application.fooling_region(adversary.sample(1000)) >= 0).mean() > afr


def test_leads_random_where_the_world_is_random():
    landscape = Landscape(0)
    adversary = Bayesian(8, seed=0, candidates=4096)
    adversary.train(FunctionOracle(landscape, 400))
    assert landscape.fooling_rate(adversary.sample(1000)).mean() > 0.35 + 0.3


def test_omega_comes_first():
    oracle = RecordingOracle(AnalyticApplication(), budget=100)
    Bayesian(2, seed=7, **QUICK).train(oracle)
    uniform = np.random.default_rng(7).uniform(-1, 1, (20, 2)).astype(np.float32)
    assert (oracle.queries[:20] == uniform).all()


@pytest.mark.parametrize(
    ("budget", "initial", "expected"), [(100, None, 20), (40, None, 10), (100, 50, 50), (9, 50, 9)]
)
def test_number_of_uniform_points(budget, initial, expected):
    oracle = FunctionOracle(lambda mu: np.abs(mu[:, 0]), budget)
    Bayesian(2, seed=0, initial=initial, **QUICK).train(oracle)
    assert len(oracle.queries[0]) == expected
    assert {len(query) for query in oracle.queries[1:]} <= {1}


def test_learns_from_the_last_evaluations_alone():
    """Only the first point, uniform, fools: S is all that is left, and lies where Q is low."""
    asked = []

    def score(mu):
        asked.append(mu)
        return (
            np.full(len(mu), 0.1) if len(asked) == 1 else 0.5 + 0.2 * np.abs(mu - 0.5).max(axis=1)
        )

    for last, flagged in ((40, True), (60, False)):
        asked.clear()
        adversary = Bayesian(2, seed=0, last=last, initial=1, **QUICK)
        adversary.train(FunctionOracle(score, 60))
        assert bool(adversary.flags) == flagged
    assert np.abs(adversary.sample(50) - asked[0]).max() < 0.1


def test_size_of_the_induced_set():
    spread = []
    for size in (5, 100):
        adversary = Bayesian(2, seed=0, induced_size=size, initial=200, components=(1,))
        adversary.train(FunctionOracle(lambda mu: np.abs(mu).max(axis=1), 200, threshold=0.9))
        spread.append(adversary.sample(1000).std())
    assert spread[0] < 0.5 * spread[1]


@pytest.mark.parametrize("dimension", [1, 2, 64])
@pytest.mark.parametrize("value", [0.1, 0.9])
def test_constant_scores(dimension, value):
    adversary = Bayesian(dimension, seed=0, **QUICK)
    adversary.train(FunctionOracle(lambda mu: np.full(len(mu), value), 60))
    assert adversary.sample(50).shape == (50, dimension)
    flag = "none of the last 60 points fooled: learnt from the lowest scores instead"
    assert adversary.flags == ([flag] if value > 0.3 else [])


def test_no_budget_is_refused():
    with pytest.raises(ValueError, match="budget of at least 1"):
        Bayesian(2).train(FunctionOracle(lambda mu: np.zeros(len(mu)), 0))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"candidates": 1000}, "power of two, as .* got 1000"),
        ({"candidates": 256}, "Expected candidates to be an int from 512 to 131,072, .* got 256"),
        ({"candidates": 512.0}, "Expected candidates to be an int from 512 .* got 512.0"),
        ({"last": 0}, "Expected last to be an int from 1 to .*; got 0"),
        ({"initial": 0}, "Expected initial to be an int from 1 to .*, or None; got 0"),
        ({"induced_size": -1}, "Expected induced_size to be an int from 0 to .*; got -1"),
        ({"batch": -1}, "Expected batch to be an int from 1 to 10,000, such as 1; got -1"),
        ({"components": ()}, r"Expected components to be a list of 1 to 64 items.*; got \(\)"),
        ({"components": (4, 0)}, r"each an int from 1 to 1,000, such as .*; got \(4, 0\)"),
    ],
)
def test_bad_options_are_refused(option, message):
    with pytest.raises(ValueError, match=message):
        make("bayesian", 2, **option)


def test_options_and_flags_survive_saving(tmp_path):
    options = {"initial": 5, "last": 20, "induced_size": 10, "batch": 4, **QUICK}
    adversary = Bayesian(2, seed=0, **options)
    adversary.train(FunctionOracle(lambda mu: np.ones(len(mu)), 40))
    adversary.save(tmp_path)
    loaded = Bayesian.load(tmp_path)
    assert loaded.options == adversary.options
    assert loaded.flags == adversary.flags
    assert len(loaded.flags) == 1


def bowl(mu):
    return np.minimum(((mu - 0.3) ** 2).mean(axis=1), 1.0)


def search(score, budget, *, dimension=2, initial=10, seed=0, **options):
    oracle, rng = FunctionOracle(score, budget), np.random.default_rng(seed)
    queries = evaluate_uniform(initial, dimension, oracle, rng)
    return minimise(oracle, queries, rng, candidates=512, **options), oracle


def test_finds_the_minimum_and_spends_all():
    queries, oracle = search(bowl, 60)
    assert oracle.remaining == 0
    assert_array_equal(queries.mu, np.concatenate(oracle.queries))
    assert queries.score.min() < 5e-4
    assert queries.score[10:].mean() < 0.2 * queries.score[:10].mean()


@pytest.mark.parametrize("dimension", [1, 2, 64])
def test_never_asks_twice_and_stays_in_the_box(dimension):
    queries, _ = search(bowl, 300 if dimension == 1 else 100, dimension=dimension)
    assert len(np.unique(queries.mu, axis=0)) == len(queries)
    assert (np.abs(queries.mu) <= 1).all()


def test_more_steps_than_candidates():
    queries, _ = search(lambda mu: np.abs(mu[:, 0]), 700, dimension=1)
    assert len(np.unique(queries.mu)) == 700


@pytest.mark.parametrize("value", [0.0, 0.5, 1.0])
def test_a_search_over_constant_scores_spreads(value):
    queries, _ = search(lambda mu: np.full(len(mu), value), 50)
    assert queries.mu.std(axis=0).min() > 0.3


def test_noise_does_not_hold_it_at_a_lucky_point():
    rng = np.random.default_rng(5)
    queries, _ = search(lambda mu: bowl(mu) + 0.2 * rng.normal(size=len(mu)), 150)
    assert np.sqrt(bowl(queries.mu[100:]).mean()) < 0.35


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_batches(batch):
    queries, oracle = search(bowl, 60, batch=batch)
    sizes = [len(query) for query in oracle.queries[1:]]
    assert max(sizes) == min(batch, 30)
    assert len(np.unique(queries.mu, axis=0)) == 60
    assert queries.score.min() < 2e-3


def test_a_batch_spreads():
    _, oracle = search(bowl, 40, batch=8, initial=20)
    apart = np.linalg.norm(oracle.queries[1][:, None] - oracle.queries[1], axis=2)
    assert apart[np.triu_indices(8, 1)].min() > 0.01


def test_does_not_depend_on_the_number_of_blas_threads():
    batches = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            batches.append(search(bowl, 80, dimension=8)[0].mu)
    assert_array_equal(*batches)


def test_threads_are_as_before_while_the_oracle_works():
    seen = set()

    def score(mu):
        seen.update(pool["num_threads"] for pool in threadpool_info())
        return bowl(mu)

    with threadpool_limits(2):
        search(score, 14)
    assert seen == {2}


def test_a_score_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="1 NaN"):
        search(lambda mu: np.where(len(mu) > 1, bowl(mu), np.nan), 20)


@pytest.mark.parametrize("start", [1, 7, 80])
@pytest.mark.parametrize("stop", [1, 80, 81, 1000, 10_000])
def test_stages_double_up_to_the_end_and_their_factorisations_stay_cheap(start, stop):
    ends = stages(start, stop)
    if stop <= start:
        assert ends == []
    else:
        assert ends[-1] == stop
        assert all(a // 2 == b for a, b in zip(ends[:0:-1], ends[-2::-1], strict=True))
        assert all(end > start for end in ends)
        assert sum(end**2 for end in ends[:-1]) <= stop**2 / 3

import itertools

import numpy as np
import pytest
from scipy.stats import beta, norm, t, trim_mean

from sada_gym.measures.statistics import estimate, interquartile_mean, shared_ranks

LEVELS = np.linspace(0.55, 0.85, 6)  # the tracks' true rates
REPETITIONS = 400


def test_interquartile_mean_is_scipys_trimmed_mean():
    values = np.random.default_rng(0).random((12, 5))
    assert interquartile_mean(values) == trim_mean(values.ravel(), 0.25)
    assert interquartile_mean([0, 0, 4, 6, 100, 5, 5, 4]) == 4.5
    assert interquartile_mean([1, 2, 6]) == 3.0
    for bad in ([], [1.0, np.nan]):
        with pytest.raises(ValueError, match="at least one value"):
            interquartile_mean(bad)


def repeat(draw, statistic="mean", samples=None):
    """Tell how often the interval holds the true mean, and its mean width."""
    hits, widths = 0, []
    for i in range(REPETITIONS):
        low, high = estimate(
            draw(), statistic=statistic, samples=samples, seed=i, resamples=400
        ).interval
        hits += low <= LEVELS.mean() <= high
        widths.append(high - low)
    return hits / REPETITIONS, float(np.mean(widths))


@pytest.mark.parametrize("statistic", ["mean", "iqm"])
@pytest.mark.parametrize("seeds", [3, 10])
def test_the_interval_holds_the_truth_as_often_as_it_says(statistic, seeds):
    rng = np.random.default_rng(0)
    share, _ = repeat(lambda: rng.normal(LEVELS[:, None], 0.1, (6, seeds)), statistic)
    assert 0.915 <= share <= 0.98  # 0.95 and three standard errors


def test_the_interval_is_that_of_all_resamples_at_students_level():
    values = np.array([0.31, 0.42, 0.48, 0.77, 0.93])
    means = np.mean(list(itertools.product(values, repeat=4)), axis=1)
    tail = norm.cdf(t.ppf(0.05, 4))
    low, high = estimate([values], level=0.9, resamples=50_000).interval
    assert (low, high) == pytest.approx(np.quantile(means, [tail, 1 - tail]), abs=0.015)
    assert low < np.quantile(means, 0.05) - 0.02


def test_tracks_are_strata():
    """Differences between tracks are no doubt about the mean over these tracks."""
    values = LEVELS[:, None] + 0.001 * np.random.default_rng(0).normal(size=(6, 5))
    low, high = estimate(values).interval
    assert 0 < high - low < 0.002 < np.ptp(LEVELS)


@pytest.mark.parametrize("seeds", [1, 4])
def test_a_rate_of_test_samples_alone(seeds):
    rng = np.random.default_rng(1)

    def draw():
        return rng.binomial(100, LEVELS[:, None], (6, seeds)) / 100

    share, width = repeat(draw, samples=100)
    assert 0.915 <= share <= 0.995
    honest = 2 * 1.96 * np.sqrt((LEVELS * (1 - LEVELS)).mean() / (600 * seeds))
    assert 0.95 * honest <= width <= 1.4 * honest


def test_a_rate_of_training_and_test_samples():
    rng = np.random.default_rng(2)

    def draw():
        return rng.binomial(50, np.clip(rng.normal(LEVELS[:, None], 0.08, (6, 4)), 0, 1)) / 50

    share, _ = repeat(draw, samples=50)
    assert 0.915 <= share <= 0.985


def test_what_is_resampled():
    apart, alike = [0.2, 0.9, 0.5], [0.5, 0.5, 0.52]
    assert estimate([apart, alike]).resampled == "seeds"
    assert estimate([apart, apart], samples=50).resampled == "seeds"
    assert estimate([alike, alike], samples=50).resampled == "test samples"
    assert estimate([apart, alike], samples=50).resampled == "seeds and test samples"
    assert estimate([[0.5], [0.2]], samples=50).resampled == "test samples"


def test_one_seed_of_a_figure_that_is_no_rate_has_no_interval():
    got = estimate([[0.25], [0.75]])
    assert (got.value, got.interval, got.resampled) == (0.5, None, "nothing")


def test_one_track_with_one_seed_has_jeffreys_interval():
    got = estimate([[0.8]], samples=250, resamples=100_000)
    assert got.interval == pytest.approx(beta(200.5, 50.5).ppf([0.025, 0.975]), abs=1e-3)
    assert estimate([[0.8]], samples=250, level=0.5).interval == pytest.approx(
        beta(200.5, 50.5).ppf([0.25, 0.75]), abs=2e-3
    )


def test_seeds_that_all_fool_do_not_make_a_rate_certain():
    low, high = estimate(np.ones((1, 5)), samples=100).interval
    assert 0.99 < low < 1.0
    assert high == 1.0


def test_tracks_may_have_their_own_number_of_samples():
    values = [[0.8], [0.9]]
    wide = estimate(values, samples=[10, 10]).interval
    mixed = estimate(values, samples=[10, 1_000]).interval
    assert np.ptp(mixed) < 0.95 * np.ptp(wide)
    assert estimate(values, samples=10).interval == wide


def test_draws_stand_in_for_what_test_samples_would_change():
    draws = np.random.default_rng(0).normal(0.5, 0.1, (1, 1_000))
    lone = estimate([[0.5]], draws=draws, resamples=1_000)
    assert lone.resampled == "test samples"
    assert lone.interval == pytest.approx(tuple(np.quantile(draws, [0.025, 0.975])))
    alike = estimate([[0.5, 0.51, 0.49]], draws=draws, resamples=1_000)
    assert alike.resampled == "test samples"
    apart = estimate([[0.1, 0.5, 0.9]], draws=draws, resamples=1_000)
    assert apart.resampled == "seeds"
    with pytest.raises(ValueError, match=r"draws of shape \(tracks, resamples\) = \(1, 10000\)"):
        estimate([[0.5]], draws=draws)


def test_the_seed_fixes_the_interval():
    values = np.random.default_rng(0).random((4, 5))
    assert estimate(values, seed=1) == estimate(values, seed=1)
    assert estimate(values, seed=1).interval != estimate(values, seed=2).interval


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        ([0.1, 0.2], {}, r"shape \(tracks, seeds\)"),
        ([[]], {}, r"shape \(tracks, seeds\)"),
        ([[0.1, np.nan]], {}, "finite values"),
        ([[0.1]], {"statistic": "median"}, "mean or iqm, got 'median'"),
        ([[0.1]], {"resamples": 0}, "at least 1 resample"),
        ([[0.1]], {"level": 1.0}, "level within"),
        ([[0.1, 0.15]], {"samples": 10}, "Expected rates among"),
        ([[-1.0]], {"samples": 10}, "Expected rates among"),
        ([[0.1]], {"samples": 0}, "at least 1"),
        ([[0.1]], {"samples": [10, 10]}, "one for each track"),
    ],
)
def test_bad_runs_are_refused(values, options, message):
    with pytest.raises(ValueError, match=message):
        estimate(values, **options)


def ranked(intervals, **options):
    values = {name: sum(bounds) / 2 for name, bounds in intervals.items()}
    return {s.name: s.label for s in shared_ranks(values, intervals, **options)}


def test_intervals_apart_are_ranked_one_after_the_other():
    assert ranked({"low": (0.1, 0.2), "high": (0.8, 0.9), "mid": (0.4, 0.5)}) == {
        "high": "1",
        "mid": "2",
        "low": "3",
    }


def test_overlapping_intervals_share_a_rank():
    assert ranked({"a": (0.6, 0.8), "b": (0.7, 0.9), "c": (0.2, 0.3), "d": (0.3, 0.4)}) == {
        "b": "1=",
        "a": "1=",
        "d": "3=",
        "c": "3=",
    }


def test_overlapping_does_not_pass_on():
    assert ranked({"a": (0.8, 0.9), "b": (0.7, 0.85), "c": (0.6, 0.75)}) == {
        "a": "1=",
        "b": "1=",
        "c": "2",
    }


def test_a_wide_interval_wins_no_rank():
    intervals = {"best": (0.9, 0.95), "sure": (0.84, 0.86), "vague": (0.3, 0.99)}
    assert ranked(intervals) == {"best": "1", "sure": "2=", "vague": "2="}
    values = {"best": 0.92, "unknown": 0.5}
    standings = shared_ranks(values, {"best": (0.9, 0.95), "unknown": None})
    assert [s.label for s in standings] == ["1=", "1="]


def test_controls_stand_in_the_table_without_a_rank():
    intervals = {"memorise": (0.98, 1.0), "a": (0.8, 0.9), "b": (0.8, 0.9), "random": (0.3, 0.4)}
    standings = shared_ranks(
        {name: sum(bounds) / 2 for name, bounds in intervals.items()},
        intervals,
        controls=("memorise", "random", "absent"),
    )
    assert [(s.name, s.rank, s.label) for s in standings] == [
        ("memorise", None, "-"),
        ("a", 1, "1="),
        ("b", 1, "1="),
        ("random", None, "-"),
    ]
    assert standings[1].interval == (0.8, 0.9)
    assert standings[1].value == pytest.approx(0.85)


def test_bad_standings_are_refused():
    with pytest.raises(ValueError, match=r"each of \['a'\], got some for \['b'\]"):
        shared_ranks({"a": 1.0}, {"b": (0.0, 1.0)})
    with pytest.raises(ValueError, match="low <= high for a"):
        shared_ranks({"a": 1.0}, {"a": (1.0, 0.0)})
    with pytest.raises(ValueError, match="finite value"):
        shared_ranks({"a": np.nan}, {"a": None})

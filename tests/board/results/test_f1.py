"""F1 joins AFR and coverage, orders the tables, and says where it cannot."""

import numpy as np
import pytest
from made_experiments import made_experiment, made_target

from sada_gym.board.results.figures import f1, f1_figure
from sada_gym.board.results.models import SeedResult
from sada_gym.board.results.rows import RunSummary, front_of, rows_of_runs
from sada_gym.experiment.measure import Measures

M = 100


def measures(fooled, relative, ideal=0.9):
    return Measures(
        afr=fooled / M,
        afr_interval_95=(0.0, 1.0),
        fooled=fooled,
        mean_score=0.5,
        mu_std=0.3,
        density=None if relative is None else 1.0,
        coverage=None if relative is None else relative * ideal,
        relative_coverage=relative,
        novelty=None,
        image_novelty=None,
    )


def runs_of(label, seeds, track="a"):
    return [
        RunSummary(
            label=label,
            entry=label,
            experiment=made_experiment(
                made_target(track), label, rule="t", budget=10, samples=M, seed=seed
            ),
            claims=SeedResult(seed=seed, queries=10, measures=measures(fooled, relative)),
            control=label == "ideal",
            disqualified=False,
        )
        for seed, (fooled, relative) in enumerate(seeds)
    ]


def rows(*runs, track=None):
    together = [run for several in runs for run in several if track in (None, run.track)]
    return {row.entry: row for row in rows_of_runs(together)}


def test_f1_is_the_harmonic_mean_of_afr_over_the_ideal_s_and_coverage():
    assert f1(0.4, 0.5, 0.8) == pytest.approx(0.5)
    assert f1(0.9, 1.0, 0.6) == pytest.approx(1.0)  # an AFR above the ideal's counts as the ideal's
    assert f1(1.0, 0.04) == pytest.approx(2 * 0.04 / 1.04)
    assert f1(0.0, 0.0) == 0.0
    assert f1([0.2, 0.4], [0.4, 0.2]).shape == (2,)
    assert f1(0.3, 0.9) == f1(0.9, 0.3)


def test_a_collapsed_adversary_comes_last_though_it_always_fools():
    by_entry = rows(
        runs_of("ideal", [(80, 1.0), (80, 1.0), (80, 1.0)]),
        runs_of("collapsed", [(100, 0.04), (100, 0.05), (100, 0.03)]),
        runs_of("good", [(75, 0.9), (78, 0.92), (80, 0.91)]),
        runs_of("random", [(30, 0.6), (28, 0.62), (31, 0.58)]),
    )
    ranks = {entry: row.rank for entry, row in by_entry.items()}
    assert ranks == {"ideal": None, "collapsed": "3", "good": "1", "random": "2"}
    assert by_entry["collapsed"].afr.value == 1.0
    expected = np.mean([f1(n / M, c, 0.8) for n, c in [(75, 0.9), (78, 0.92), (80, 0.91)]])
    assert by_entry["good"].f1.value == pytest.approx(float(expected))
    low, high = by_entry["good"].f1.interval_95
    assert low < by_entry["good"].f1.value < high
    assert by_entry["good"].deciding == by_entry["good"].f1


def test_without_the_ideal_its_afr_counts_as_100_percent():
    by_entry = rows(runs_of("good", [(75, 0.9), (78, 0.9)]))
    assert by_entry["good"].f1.value == pytest.approx(float(np.mean(f1([0.75, 0.78], [0.9, 0.9]))))


def test_without_coverage_the_rank_is_by_afr():
    by_entry = rows(runs_of("good", [(75, None)]), runs_of("random", [(20, None)]))
    assert {entry: (row.f1, row.rank) for entry, row in by_entry.items()} == {
        "good": (None, "1"),
        "random": (None, "2"),
    }
    assert by_entry["good"].deciding == by_entry["good"].afr


def test_a_comparison_with_a_track_without_coverage_is_ranked_by_afr():
    runs = [
        *runs_of("good", [(75, 0.5)]),
        *runs_of("good", [(75, None)], track="b"),
        *runs_of("random", [(20, 1.0)]),
        *runs_of("random", [(20, None)], track="b"),
    ]
    assert {entry: (row.f1, row.rank) for entry, row in rows(runs).items()} == {
        "good": (None, "1"),
        "random": (None, "2"),
    }
    on_a = rows(runs, track="a")
    assert all(row.f1 is not None for row in on_a.values())


def test_a_run_without_coverage_where_others_have_it_takes_the_rank():
    by_entry = rows(runs_of("good", [(75, 0.9)]), runs_of("odd", [(90, None)]))
    assert {entry: row.rank for entry, row in by_entry.items()} == {"good": "1", "odd": None}


@pytest.mark.parametrize("seeds", [1, 2, 3])
def test_the_interval_holds_other_test_samples_even_of_one_seed(seeds):
    runs = [measures(60, 0.8)] * seeds
    figure = f1_figure({"a": runs}, {"a": M}, {"a": 0.75})
    low, high = figure.interval_95
    assert figure.value == pytest.approx(0.8)
    assert 0.02 < high - low < 0.25
    assert f1_figure({"a": runs}, {"a": M}, {"a": 0.75}) == figure


def test_more_seeds_and_tracks_make_it_narrower():
    def width(tracks, seeds):
        runs = {f"{i}": [measures(60, 0.8)] * seeds for i in range(tracks)}
        low, high = f1_figure(runs, dict.fromkeys(runs, M), {}).interval_95
        return high - low

    assert width(1, 1) > width(1, 3) > width(6, 3)


def test_seeds_that_differ_widen_it():
    alike = f1_figure({"a": [measures(60, 0.8)] * 3}, {"a": M}, {})
    apart = f1_figure({"a": [measures(n, 0.8) for n in (20, 60, 95)]}, {"a": M}, {})
    assert np.diff(apart.interval_95) > 3 * np.diff(alike.interval_95)


def test_the_interval_holds_the_truth():
    rng, hits = np.random.default_rng(0), 0
    truth = float(f1(0.6, 0.8, 0.75))
    for _ in range(60):
        runs = {
            f"{track}": [
                measures(n := int(rng.binomial(M, 0.6)), rng.binomial(n, 0.72) / n / 0.9)
                for _ in range(3)
            ]
            for track in range(6)
        }
        figure = f1_figure(runs, dict.fromkeys(runs, M), dict.fromkeys(runs, 0.75))
        hits += figure.interval_95[0] <= truth <= figure.interval_95[1]
    assert hits >= 51


def test_nothing_measured_has_no_f1():
    assert f1_figure({}, {}, {}) is None


def test_the_front_leaves_controls_and_what_is_incomplete_out():
    by_entry = rows(
        runs_of("ideal", [(100, 1.0)]),
        runs_of("often", [(90, 0.3)]),
        runs_of("wide", [(50, 0.9)]),
        runs_of("beaten", [(40, 0.2)]),
    )
    assert front_of(by_entry.values()) == {"often": True, "wide": True, "beaten": False}

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from bench_toys import (
    ANALYTIC,
    LOGGED,
    Inline,
    Recorder,
    costs_of,
    made,
    make_reference,
    run_in,
    suite,
)

from sada_gym.board.benchmark.entries import find_missing
from sada_gym.board.benchmark.folder import novelty_picture, reserve, store_file
from sada_gym.board.benchmark.job import RunError
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.results import results_of
from sada_gym.board.benchmark.run import report_benchmark
from sada_gym.board.benchmark.schedule import do_runs
from sada_gym.board.results.entry import read_entries
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.problems import make_application
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.measure import checkpoints
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.novelty import novelty
from sada_gym.measures.rates import mu_std
from sada_gym.measures.reference import load_reference
from sada_gym.oracle import evaluation_seeds


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    for track in (ANALYTIC, LOGGED):
        make_reference(folder, track)
    return folder


def work(out, chosen, references, callback=None):
    """Do all runs in this process, which is quicker than in others."""
    plan = make_plan(chosen, references)
    reserve(out)
    entries = out / "entries"
    do_runs(
        plan, list(plan.runs), out, entries, Workers(1, Inline()), callback or BenchmarkCallback()
    )
    return plan


@pytest.fixture(scope="module")
def done(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("done")
    recorder = Recorder()
    adversaries = ("ideal", "random", "gaussian", "gmm10", "bench_toys:Picky", "bench_toys:Short")
    plan = work(out, suite(*adversaries, seeds=2), references, recorder)
    return out, plan, recorder


def run_of(done, label, table="n120", seed=0):
    """Return what the entry says of a run, and its samples."""
    _, claims, samples = run_in(done[0] / "entries", label, table, seed)
    return claims, samples


def test_each_run_is_in_its_entry(done):
    out, plan, _ = done
    assert len(list(plan.runs)) == 2 * 2 * 6
    names = {run.label: plan.metadata[run.label].name for run in plan.runs}
    assert sorted(made(out / "entries")) == sorted(
        (names[run.label], f"{ANALYTIC}.{run.key.table}", run.seed) for run in plan.runs
    )
    folder = out / "entries" / "gaussian"
    assert sorted(path.name for path in folder.iterdir()) == [
        "SADA-Analytic.json",
        "SADA-Analytic.npz",
        "entry.toml",
    ]
    result, seed, _ = run_in(out / "entries", "gaussian", "n120", 1)
    assert seed.packages["numpy"] == np.__version__
    assert (result.experiment.protocol.budget, result.experiment.protocol.samples) == (120, 30)
    assert "time" not in (folder / "SADA-Analytic.json").read_text()


def test_an_entry_says_who_made_it(done):
    entries = {entry.metadata.name: entry for entry in read_entries(done[0] / "entries")}
    ours, theirs = entries["gaussian"], entries["bench_toys-picky"]
    assert (ours.adversary.name, theirs.adversary.name) == ("gaussian", "bench_toys:Picky")
    assert (ours.metadata.title, ours.metadata.licence) == ("gaussian", "MIT")
    assert ours.metadata.authors == ("sada_gym's developers",)
    assert ours.metadata.command == "sada-gym benchmark -a gaussian"
    credits = theirs.metadata
    assert (credits.title, credits.authors, credits.licence) == ("bench_toys:Picky", (), "")


def test_the_figures_are_those_of_the_samples(done, references):
    seed, samples = run_of(done, "gaussian")
    application = make_application(ANALYTIC)
    replayed = application.evaluate(samples.mu, samples.seed.tolist())
    assert samples.seed.tolist() == evaluation_seeds(0, "test", 0, 30)
    np.testing.assert_array_equal(replayed.score, samples.score)
    measures = seed.measures
    assert measures.afr == replayed.fooled.mean() == measures.fooled / 30
    assert measures.afr_interval_95[0] < measures.afr < measures.afr_interval_95[1]
    assert measures.mean_score == samples.score.mean()
    assert measures.mu_std == mu_std(samples.mu)
    known, _ = load_reference(ANALYTIC, application, references).split()
    expected = fooling_coverage(samples.mu, replayed.fooled, known, seed=0)
    assert (measures.density, measures.coverage) == (expected.density, expected.coverage)
    queries = np.random.default_rng(0).uniform(-1, 1, (120, 2)).astype(np.float32)
    assert measures.novelty.median == novelty(samples.mu, queries).median
    search = seed.search
    fooled = application.evaluate(queries, evaluation_seeds(0, "train", 0, 120)).fooled
    assert (search.queries, search.fooled) == (120, fooled.sum())
    assert [mark.queries for mark in search.curve] == [100, 120]
    assert [mark.found for mark in search.curve] == [fooled[:100].sum(), fooled.sum()]
    assert 0 < search.curve[0].coverage <= search.curve[1].coverage <= 1


def test_others_are_read_by_the_ideal(done, references):
    seed, samples = run_of(done, "ideal")
    ideal = seed.measures
    application = make_application(ANALYTIC)
    measured_by, known = load_reference(ANALYTIC, application, references).split()
    drawn = {row.tobytes() for row in samples.mu}
    assert drawn <= {row.tobytes() for row in known}
    assert not drawn & {row.tobytes() for row in measured_by}
    assert ideal.afr == 1.0  # no noise: what fools once always does
    assert ideal.relative_coverage == 1.0
    assert ideal.novelty is None
    assert seed.queries == seed.search.queries == 0
    assert run_in(done[0] / "entries", "ideal", "n120")[0].experiment.protocol.budget == 0
    gaussian = run_of(done, "gaussian")[0].measures
    share = gaussian.coverage / ideal.coverage
    assert gaussian.relative_coverage == share
    assert 0.2 < gaussian.novelty.ratio < 5


def test_ideal_samples_repeat_only_where_there_are_too_few():
    points = np.arange(20, dtype=np.float32).reshape(10, 2)
    few = draw(points, 8)
    assert len(np.unique(few, axis=0)) == 8
    assert draw(points, 30).shape == (30, 2)
    np.testing.assert_array_equal(draw(points, 8), few)
    assert (draw(points, 8, seed=1) != few).any()


def draw(points, count, seed=0):
    return Ideal(2, seed=seed, fooling_set=points).sample(count)


def test_the_ideal_is_an_adversary_like_any_other(tmp_path):
    points = np.arange(20, dtype=np.float32).reshape(10, 2) / 20
    ideal = Ideal(2, seed=0, fooling_set=points)
    ideal.save(tmp_path)
    loaded = Ideal.load(tmp_path).sample(300)
    assert (loaded == ideal.sample(300)).all()
    assert {row.tobytes() for row in loaded} == {row.tobytes() for row in points}
    with pytest.raises(ValueError, match=r"fooling set of shape \(m, 3\), m >= 1, got \(10, 2\)"):
        Ideal(3, fooling_set=points)


def test_a_group_shares_its_omega(done):
    out, plan, _ = done
    timing = costs_of(out, "gaussian", "n120")
    assert (timing.evaluated, timing.known) == (120 + 30, 0)
    for label, table, known in (("gmm10", "n120", 120), ("gaussian", "n60", 60)):
        timing = costs_of(out, label, table)
        assert timing.known >= known
        assert timing.evaluated + timing.known == known + 30
    with EvaluationStore(store_file(out, plan.groups[0].target, plan.groups[0].seed)) as store:
        train = "SELECT count(*) FROM evaluation WHERE seed & 3 = 0"  # the stream's bits
        # Omega once, and the halves that Picky and Short aim, which agree where they are clipped
        assert 180 < store._connection.execute(train).fetchone()[0] <= 120 + 60 + 30


def test_the_random_adversary_spends_nothing(done):
    seed, _ = run_of(done, "random")
    assert seed.search.queries == 0
    assert seed.search.curve == ()
    assert seed.measures.novelty is None
    assert seed.measures.coverage > 0


def test_a_refusal_is_a_result(done):
    refused, samples = run_of(done, "bench_toys:Picky", "n60")
    assert refused.error == "Expected a budget of at least 100, got 60."
    assert (refused.measures, refused.search, samples) == (None, None, None)
    fine, _ = run_of(done, "bench_toys:Picky", "n120")
    assert fine.error is None
    assert fine.measures.afr > 0
    assert find_missing(done[0] / "entries", done[1]).runs == ()  # it is not tried again
    short, _ = run_of(done, "bench_toys:Short")
    assert short.error.startswith("Expected samples of shape (30, 2) from Short.sample")


def test_rows_sum_up_the_runs(done):
    out, plan, _ = done
    results = results_of(read_entries(out / "entries"), plan.suite.tables)
    [row] = [r for r in results.rows_of("n120", "", None) if r.label == "gaussian"]
    rates = [run_of(done, "gaussian", seed=seed)[0].measures.afr for seed in (0, 1)]
    assert row.afr.value == pytest.approx(np.mean(rates))
    assert row.afr.interval_95[0] < row.afr.value < row.afr.interval_95[1]
    assert (row.runs, row.tracks, row.failed, row.complete) == (2, 1, 0, True)
    ranks = {r.label: r.rank for r in results.rows_of("n60", "", None)}
    assert ranks["ideal"] is None
    assert ranks["bench_toys:Picky"] is None
    assert ranks["gaussian"] in {"1", "1="}
    [failed] = [r for r in results.rows_of("n60", "", None) if r.label == "bench_toys:Picky"]
    assert (failed.runs, failed.failed, failed.complete, failed.afr) == (0, 2, False, None)


def test_every_finished_run_is_reported(done):
    _, plan, recorder = done
    assert [run for run, _ in recorder.finished] == list(plan.runs)
    assert sum(timing.evaluated for _, timing in recorder.finished) > 500


@pytest.mark.long
def test_progress_within_a_run_is_reported(tmp_path, references, monkeypatch):
    monkeypatch.setenv("TOY_PAUSE_S", "0.03")  # the 30 tests take over three polls
    plan = make_plan(suite("toy:Greedy", track=LOGGED, budgets=(60,)), references)
    recorder = Recorder()
    with ThreadPoolExecutor(1) as executor:
        do_runs(
            plan, list(plan.runs), tmp_path, tmp_path / "entries", Workers(1, executor), recorder
        )
    stages = [progress.stage for _, progress in recorder.progress]
    assert stages[0] == "train"
    assert "test" in stages
    assert {run for run, _ in recorder.progress} == set(map(str, plan.runs))
    evaluated = [progress.evaluated for _, progress in recorder.progress]
    assert evaluated == sorted(evaluated)
    assert evaluated[-1] > 60
    assert not (tmp_path / ".progress").exists()


def test_without_a_reference_set_coverage_is_blank(tmp_path):
    chosen = suite("ideal", "random", "gaussian", budgets=(60,))
    plan = work(tmp_path, chosen, tmp_path / "none")
    [note] = plan.notes
    assert note.startswith(f"{ANALYTIC} has no reference set: the row ideal, coverage")
    assert {entry for entry, _, _ in made(tmp_path / "entries")} == {"random", "gaussian"}
    _, seed, _ = run_in(tmp_path / "entries", "gaussian", "n60")
    measures = seed.measures
    assert (measures.density, measures.coverage, measures.relative_coverage) == (None,) * 3
    assert measures.novelty.median > 0
    assert measures.novelty.ratio is None
    assert seed.search.curve[-1].coverage is None
    result = report_benchmark(tmp_path, tmp_path / "none", notes=plan.notes)
    text = (tmp_path / "table.md").read_text()
    assert note in text
    assert "| gaussian |" in text
    assert not any("afr-coverage" in path.name for path in tmp_path.rglob("*"))
    shown = [
        row.coverage
        for comparison in result.results.comparisons
        for rows in (comparison.rows, *comparison.by_track.values())
        for row in rows
    ]
    assert shown == [None] * 4


def test_a_reference_set_that_hardly_fools_is_as_good_as_none(tmp_path):
    make_reference(tmp_path, ANALYTIC, points=20)
    plan = make_plan(suite("ideal", "random"), tmp_path)
    assert "has hardly any fooling reference point" in plan.notes[0]
    assert {cell.label for cell in plan.runs} == {"random"}


def test_images_are_compared_on_the_first_seed(tmp_path, references):
    chosen = suite("ideal", "bench_toys:Picky", track=LOGGED, budgets=(120,), seeds=2, images=2)
    plan = work(tmp_path, chosen, references)
    first, second = (run for run in plan.runs if run.label != "ideal")
    assert (first.seed, second.seed) == (0, 1)
    of_first, of_second = (
        run_in(tmp_path / "entries", run.label, run.key.table, run.seed, LOGGED)[1].measures
        for run in (first, second)
    )
    images = of_first.image_novelty
    assert images.samples == 2
    assert 0 < images.median <= images.median_of_nearest_mu
    assert images.ratio == images.median / images.ideal
    assert of_second.image_novelty is None
    [picture] = (tmp_path / "pictures").rglob("*.png")
    assert picture == novelty_picture(tmp_path, first.key)
    assert picture.stat().st_size > 1000


def test_a_bug_stops_the_group_and_names_the_run(tmp_path, references):
    with pytest.raises(RunError, match=r"KeyError in bench_toys:Buggy on SADA.*seed 0, table n60"):
        work(tmp_path, suite("random", "bench_toys:Buggy", budgets=(60,)), references)
    assert {entry for entry, _, _ in made(tmp_path / "entries")} == {"random"}


@pytest.mark.parametrize(
    ("queries", "marks"),
    [(0, []), (60, [60]), (100, [100]), (2000, [100, 200, 500, 1000, 2000]), (130, [100, 130])],
)
def test_checkpoints(queries, marks):
    assert checkpoints(queries) == marks

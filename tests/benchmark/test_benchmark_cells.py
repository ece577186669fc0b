import numpy as np
import pytest
from bench_toys import ANALYTIC, LOGGED, make_reference, suite

from sada_gym.benchmark.folder import (
    CellReport,
    Timing,
    cell_folder,
    claim,
    find_missing,
    read_cells,
    store_file,
)
from sada_gym.benchmark.ideal import draw_ideal
from sada_gym.benchmark.measure import checkpoints
from sada_gym.benchmark.plan import make_plan
from sada_gym.benchmark.results import write_results
from sada_gym.benchmark.run import report_benchmark
from sada_gym.benchmark.work import CellError, Job, work_on
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.files import read_model
from sada_gym.measures.coverage import fooling_coverage
from sada_gym.measures.novelty import novelty
from sada_gym.measures.rates import mu_std
from sada_gym.measures.reference import load_reference
from sada_gym.oracle import evaluation_seeds
from sada_gym.registration import make_application
from sada_gym.runs.record import read_samples


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    for track in (ANALYTIC, LOGGED):
        make_reference(folder, track)
    return folder


def work(out, chosen, references, tell=lambda told: None):
    """Do all groups in this process, which is quicker than in others."""
    plan = make_plan(chosen, references)
    claim(out, chosen.tables)
    for group in plan.groups:
        work_on(Job(group, out, references, workers=1), tell)
    return plan


@pytest.fixture(scope="module")
def done(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("done")
    told = []
    adversaries = ("ideal", "random", "gaussian", "gmm10", "bench_toys:Picky", "bench_toys:Short")
    plan = work(out, suite(*adversaries, seeds=2), references, told.append)
    return out, plan, told


def cell_of(done, label, table="n120", seed=0):
    out, plan, _ = done
    [cell] = [c for c in plan.cells if (c.label, c.table, c.seed) == (label, table, seed)]
    folder = cell_folder(out, cell)
    return read_model(folder / "cell.json", CellReport), folder


def test_each_cell_has_its_folder(done):
    out, plan, _ = done
    assert len(list(plan.cells)) == 2 * 2 * 6
    assert len(read_cells(out)) == 24
    report, folder = cell_of(done, "gaussian", seed=1)
    assert folder == out / "cells" / "n120" / ANALYTIC / "gaussian-1"
    assert sorted(path.name for path in folder.iterdir()) == [
        "cell.json",
        "samples.npz",
        "timing.json",
    ]
    assert report.settings.packages["numpy"] == np.__version__
    assert report.settings.budget == 120
    assert report.settings.samples == 30
    assert "time" not in (folder / "cell.json").read_text()


def test_the_figures_are_those_of_the_samples(done, references):
    report, folder = cell_of(done, "gaussian")
    samples, application = read_samples(folder / "samples.npz"), make_application(ANALYTIC)
    replayed = application.evaluate(samples.mu, samples.seed.tolist())
    assert samples.seed.tolist() == evaluation_seeds(0, "test", 0, 30)
    np.testing.assert_array_equal(replayed.score, samples.score)
    measures = report.measures
    assert measures.afr == replayed.fooled.mean() == measures.fooled / 30
    assert measures.afr_interval_95[0] < measures.afr < measures.afr_interval_95[1]
    assert measures.mean_score == samples.score.mean()
    assert measures.mu_std == mu_std(samples.mu)
    known, _ = load_reference(ANALYTIC, application, references).halves()
    expected = fooling_coverage(samples.mu, replayed.fooled, known, seed=0)
    assert (measures.density, measures.coverage) == (expected.density, expected.coverage)
    omega = np.random.default_rng(0).uniform(-1, 1, (120, 2)).astype(np.float32)
    assert measures.novelty.median == novelty(samples.mu, omega).median
    search = report.search
    fooled = application.evaluate(omega, evaluation_seeds(0, "train", 0, 120)).fooled
    assert (search.queries, search.fooled) == (120, fooled.sum())
    assert [mark.queries for mark in search.curve] == [100, 120]
    assert [mark.found for mark in search.curve] == [fooled[:100].sum(), fooled.sum()]
    assert 0 < search.curve[0].coverage <= search.curve[1].coverage <= 1


def test_others_are_read_by_the_ideal(done, references):
    ideal, folder = cell_of(done, "ideal")
    application = make_application(ANALYTIC)
    measured_by, known = load_reference(ANALYTIC, application, references).halves()
    drawn = {row.tobytes() for row in read_samples(folder / "samples.npz").mu}
    assert drawn <= {row.tobytes() for row in known}
    assert not drawn & {row.tobytes() for row in measured_by}
    assert ideal.measures.afr == 1.0  # no noise: what fools once always does
    assert ideal.measures.relative_coverage == 1.0
    assert ideal.measures.novelty is None
    assert ideal.search.queries == ideal.settings.budget == 0
    gaussian, _ = cell_of(done, "gaussian")
    share = gaussian.measures.coverage / ideal.measures.coverage
    assert gaussian.measures.relative_coverage == share
    assert 0.2 < gaussian.measures.novelty.ratio < 5


def test_ideal_samples_repeat_only_where_there_are_too_few():
    points = np.arange(20, dtype=np.float32).reshape(10, 2)
    few = draw_ideal(points, 8, seed=0)
    assert len(np.unique(few, axis=0)) == 8
    assert draw_ideal(points, 30, seed=0).shape == (30, 2)
    np.testing.assert_array_equal(draw_ideal(points, 8, seed=0), few)
    assert (draw_ideal(points, 8, seed=1) != few).any()


def test_a_group_shares_its_omega(done):
    out, plan, _ = done
    _, gaussian = cell_of(done, "gaussian")
    timing = read_model(gaussian / "timing.json", Timing)
    assert (timing.evaluated, timing.known) == (120 + 30, 0)
    for label, table, known in (("gmm10", "n120", 120), ("gaussian", "n60", 60)):
        _, folder = cell_of(done, label, table)
        timing = read_model(folder / "timing.json", Timing)
        assert timing.known >= known
        assert timing.evaluated + timing.known == known + 30
    with EvaluationStore(store_file(out, plan.groups[0])) as store:
        train = "SELECT count(*) FROM evaluation WHERE seed & 3 = 0"  # the stream's bits
        # Omega once, and the halves that Picky and Short aim, which agree where they are clipped
        assert 180 < store._connection.execute(train).fetchone()[0] <= 120 + 60 + 30


def test_the_random_adversary_spends_nothing(done):
    report, _ = cell_of(done, "random")
    assert report.search.queries == 0
    assert report.search.curve == ()
    assert report.measures.novelty is None
    assert report.measures.coverage > 0


def test_a_refusal_is_a_result(done):
    refused, folder = cell_of(done, "bench_toys:Picky", "n60")
    assert refused.error == "Expected a budget of at least 100, got 60."
    assert (refused.measures, refused.search) == (None, None)
    assert not (folder / "samples.npz").exists()
    fine, _ = cell_of(done, "bench_toys:Picky", "n120")
    assert fine.error is None
    assert fine.measures.afr > 0
    short, _ = cell_of(done, "bench_toys:Short")
    assert short.error.startswith("Expected samples of shape (30, 2) from bench_toys:Short")


def test_rows_sum_up_the_cells(done):
    out, _, _ = done
    results = write_results(out)
    [row] = [r for r in results.rows_of("n120", "", None) if r.label == "gaussian"]
    rates = [cell_of(done, "gaussian", seed=seed)[0].measures.afr for seed in (0, 1)]
    assert row.afr.value == pytest.approx(np.mean(rates))
    assert row.afr.interval_95[0] < row.afr.value < row.afr.interval_95[1]
    assert (row.runs, row.tracks, row.failed, row.complete) == (2, 1, 0, True)
    ranks = {r.label: r.afr and r.afr.rank for r in results.rows_of("n60", "", None)}
    assert ranks["ideal"] is None
    assert ranks["bench_toys:Picky"] is None
    assert ranks["gaussian"] in {"1", "1="}
    [failed] = [r for r in results.rows_of("n60", "", None) if r.label == "bench_toys:Picky"]
    assert (failed.runs, failed.failed, failed.complete, failed.afr) == (0, 2, False, None)


def test_progress_is_told(done, references):
    _, plan, told = done
    finished = [one for one in told if one.wall_s is not None]
    assert [one.cell for one in finished] == list(plan.cells)
    counts = [(one.done, one.total) for one in told if one.cell.label == "gaussian"]
    assert (0, 120) in counts
    assert (0, 30) in counts
    assert sum(one.new for one in told) > 500


def test_without_a_reference_set_coverage_is_blank(tmp_path):
    chosen = suite("ideal", "random", "gaussian", budgets=(60,))
    plan = work(tmp_path, chosen, tmp_path / "none")
    [note] = plan.notes
    assert note.startswith(f"{ANALYTIC} has no reference set: the ideal row, coverage")
    reports = {report.settings.label: report for report, _ in read_cells(tmp_path)}
    assert set(reports) == {"random", "gaussian"}
    measures = reports["gaussian"].measures
    assert (measures.density, measures.coverage, measures.relative_coverage) == (None,) * 3
    assert measures.novelty.median > 0
    assert measures.novelty.ratio is None
    assert reports["gaussian"].search.curve[-1].coverage is None
    result = report_benchmark(tmp_path, tmp_path / "none", notes=plan.notes)
    text = (tmp_path / "table.md").read_text()
    assert note in text
    assert "| gaussian |" in text
    assert not any("afr-coverage" in path.name for path in tmp_path.rglob("*.png"))
    assert [row.coverage for row in result.results.rows] == [None] * 4


def test_a_reference_set_that_hardly_fools_is_as_good_as_none(tmp_path):
    make_reference(tmp_path, ANALYTIC, points=20)
    plan = make_plan(suite("ideal", "random"), tmp_path)
    assert "has hardly any fooling reference point" in plan.notes[0]
    assert {cell.label for cell in plan.cells} == {"random"}


def test_a_changed_reference_set_is_refused(tmp_path, references):
    out = tmp_path / "out"
    out.mkdir()
    work(out, suite("random", budgets=(60,)), references)
    make_reference(tmp_path, ANALYTIC, points=500)
    for adversary in ("random", "gaussian"):
        plan = make_plan(suite(adversary, budgets=(60,)), tmp_path)
        with pytest.raises(ValueError, match=r"reference.points was 600 and is 500.*delete that"):
            find_missing(out, plan)


def test_images_are_compared_on_the_first_seed(tmp_path, references):
    chosen = suite("ideal", "bench_toys:Picky", track=LOGGED, budgets=(120,), seeds=2, images=2)
    work(tmp_path, chosen, references)
    first, second = (
        (report, folder)
        for report, folder in read_cells(tmp_path)
        if report.settings.label != "ideal"
    )
    assert (first[0].settings.seed, second[0].settings.seed) == (0, 1)
    images = first[0].measures.image_novelty
    assert images.samples == 2
    assert 0 < images.median <= images.median_of_nearest_mu
    assert images.ratio == images.median / images.ideal
    assert (first[1] / "novelty.png").stat().st_size > 1000
    assert second[0].measures.image_novelty is None
    assert not (second[1] / "novelty.png").exists()


def test_a_bug_stops_the_group_and_names_the_cell(tmp_path, references):
    with pytest.raises(CellError, match=r"KeyError in bench_toys:Buggy on SADA.*seed 0, table n60"):
        work(tmp_path, suite("random", "bench_toys:Buggy", budgets=(60,)), references)
    assert [report.settings.label for report, _ in read_cells(tmp_path)] == ["random"]


def test_half_written_cells_are_no_cells(tmp_path, references):
    plan = work(tmp_path, suite("random", budgets=(60,)), references)
    [(_, folder)] = read_cells(tmp_path)
    folder.rename(folder.with_name(f".{folder.name}.tmp"))
    assert read_cells(tmp_path) == []
    assert find_missing(tmp_path, plan) == list(plan.cells)


@pytest.mark.parametrize(
    ("queries", "marks"),
    [(0, []), (60, [60]), (100, [100]), (2000, [100, 200, 500, 1000, 2000]), (130, [100, 130])],
)
def test_checkpoints(queries, marks):
    assert checkpoints(queries) == marks

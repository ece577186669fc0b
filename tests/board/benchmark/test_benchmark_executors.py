"""A benchmark's results are the same on whatever executor, and whatever its workers see."""

import os
from concurrent.futures import Executor, Future, ThreadPoolExecutor

import pytest
from bench_toys import ANALYTIC, LOGGED, Recorder, contents, make_reference, suite

from sada_gym.board.benchmark import progress
from sada_gym.board.benchmark.entries import find_missing
from sada_gym.board.benchmark.folder import read_costs, reserve
from sada_gym.board.benchmark.job import RunError
from sada_gym.board.benchmark.plan import make_plan
from sada_gym.board.benchmark.schedule import do_runs
from sada_gym.errors import WorkerError
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.experiment.algorithm import RunProgress

SMALL = suite("ideal", "memorise", "bench_toys:Picky", budgets=(120, 60), seeds=2)


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    for track in (ANALYTIC, LOGGED):
        make_reference(folder, track)
    return folder


@pytest.fixture(scope="module")
def ours(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("ours")
    run(out, SMALL, references, workers=2)
    return out


def run(out, chosen, references, *, workers=1, callback=None):
    """Do what is missing, and leave the report out, which takes the most of the time."""
    plan = make_plan(chosen, references)
    reserve(out)
    entries = out / "entries"
    do_runs(
        plan,
        find_missing(entries, plan).runs,
        out,
        entries,
        Workers.of(workers),
        callback or progress.BenchmarkCallback(),
    )


def stored(out):
    """Count the evaluations in all stores."""
    total = 0
    for path in (out / "stores").glob("*.sqlite"):
        with EvaluationStore(path) as store:
            total += len(store)
    return total


def evaluated(out):
    """Sum up the evaluations that all runs made."""
    return sum(costs.evaluated for costs in read_costs(out))


@pytest.mark.long
def test_threads_give_the_same(ours, tmp_path, references):
    with ThreadPoolExecutor(2) as executor:
        run(tmp_path, SMALL, references, workers=Workers(2, executor))
    assert contents(tmp_path) == contents(ours)


def test_workers_that_do_not_see_the_folder_give_the_same(ours, tmp_path, references, monkeypatch):
    monkeypatch.setattr("sada_gym.board.benchmark.job.can_read", lambda out, token: False)
    monkeypatch.setattr("sada_gym.board.benchmark.schedule.can_read", lambda out, token: False)
    recorder = Recorder()
    with ThreadPoolExecutor(2) as executor:
        run(tmp_path, SMALL, references, workers=Workers(2, executor), callback=recorder)
    assert contents(tmp_path) == contents(ours)
    assert stored(tmp_path) == stored(ours)
    assert evaluated(tmp_path) == evaluated(ours)  # each run knows what those before it evaluated
    assert {progress.stage for _, progress in recorder.progress} == {"train"}
    assert len(recorder.finished) == 12


def test_a_token_of_another_call_is_no_sight_of_the_folder(tmp_path):
    with progress.progress_folder(tmp_path) as first:
        assert progress.can_read(tmp_path, first)
        assert not progress.can_read(tmp_path, "another")
        assert not progress.can_read(tmp_path / "elsewhere", first)
    assert not progress.can_read(tmp_path, first)


def test_a_worker_whose_benchmark_has_ended_gives_up(ours, references):
    run = next(make_plan(SMALL, references).runs)
    with progress.progress_folder(ours) as token:
        file = progress.ProgressFile(ours, token, run)
        file(RunProgress("train", 1, 2))
        assert progress.read_progress(ours, run).done == 1
    with pytest.raises(progress.Abandoned, match="has ended"):
        file(RunProgress("test"))


class Broken(Executor):
    """It loses its first real job, as a cluster without a scheduler does."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        if fn is progress.can_read:
            future.set_result(True)
        else:
            future.set_exception(ConnectionError("the scheduler is gone"))
        return future


def test_an_executor_that_gives_up_is_told_in_a_sentence(tmp_path, references):
    with pytest.raises(WorkerError, match=r"gave up on .*scheduler is gone.*What is finished"):
        run(tmp_path, SMALL, references, workers=Workers(executor=Broken()))


@pytest.fixture(scope="module")
def deaths(tmp_path_factory):
    """Return the file that remembers deaths, which every worker can name."""
    file = tmp_path_factory.mktemp("deaths") / "deaths"
    os.environ["TOY_DEATHS"] = str(file)
    yield file
    del os.environ["TOY_DEATHS"]


@pytest.fixture(scope="module")
def dask(deaths):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client.get_executor()


@pytest.mark.long
def test_dask_gives_the_same(ours, tmp_path, references, dask):
    run(tmp_path, SMALL, references, workers=Workers(executor=dask))
    assert contents(tmp_path) == contents(ours)
    assert (stored(tmp_path), evaluated(tmp_path)) == (stored(ours), evaluated(ours))


def test_dask_replaces_a_worker_that_is_killed(tmp_path, references, dask, deaths):
    chosen = suite("bench_toys:Fragile", budgets=(60,))
    deaths.write_text("")
    run(tmp_path / "killed", chosen, references, workers=Workers(executor=dask))
    assert deaths.read_text() == "x"
    run(tmp_path / "whole", chosen, references, workers=Workers(executor=dask))
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    assert evaluated(tmp_path / "killed") == 30  # its queries were in the store by then


@pytest.mark.long
def test_a_bug_keeps_its_traceback_on_dask(tmp_path, references, dask):
    with pytest.raises(RunError, match="KeyError in bench_toys:Buggy"):
        run(
            tmp_path,
            suite("bench_toys:Buggy", budgets=(60,)),
            references,
            workers=Workers(executor=dask),
        )

import os
import shutil
import signal
import time
from pathlib import Path

import pytest
from bench_toys import ANALYTIC, LOGGED, Inline, contents, costs_of, made, make_reference, suite
from forked import FORKSERVER

from sada_gym.board.benchmark.folder import read_costs, reserve, sole_user
from sada_gym.board.benchmark.job import RunError
from sada_gym.board.benchmark.run import run_benchmark
from sada_gym.errors import StoreError, StoreInUse, WorkerError
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.store import EvaluationStore

WHOLE = suite("ideal", "memorise", "bench_toys:Picky", budgets=(90, 60), seeds=2)
KILLED = suite("ideal", "memorise", "bench_toys:Picky", track=LOGGED, budgets=(150,), seeds=2)


@pytest.fixture(scope="module")
def references(tmp_path_factory):
    folder = tmp_path_factory.mktemp("references")
    for track in (ANALYTIC, LOGGED):
        make_reference(folder, track)
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory, references):
    out = tmp_path_factory.mktemp("done")
    return run_benchmark(WHOLE, out, workers=2, references=references)


@pytest.mark.long
def test_it_ends_with_results_tables_and_pictures(done):
    assert sorted(path.name for path in done.folder.iterdir()) == [
        ".lock",
        "entries",
        "pictures",
        "stores",
        "table.md",
        "timings.jsonl",
    ]
    results = done.results
    assert done.entries == done.folder / "entries"
    assert len(results.runs) == 2 * 2 * 3
    assert [results.seeds_of(target) for target in results.targets] == [[0, 1]]
    assert results.targets[0].reference.points == 600
    costs = read_costs(done.folder)
    assert len(costs) == 12
    assert all(cost.wall_s >= 0 for cost in costs)
    pictures = {path.name for path in (done.folder / "pictures" / "n90").iterdir()}
    assert pictures == {"afr-coverage.svg", "anytime.png", "marginals-Analytic.png", "novelty.png"}


@pytest.mark.long
def test_workers_are_no_part_of_the_result(done, tmp_path, references):
    run_benchmark(WHOLE, tmp_path, workers=5, references=references)  # two a group
    assert contents(tmp_path) == contents(done.folder)


@pytest.mark.long
def test_done_is_done_and_more_is_added(done, tmp_path, references, monkeypatch):
    run_benchmark(suite("memorise", budgets=(90,)), tmp_path, references=references)
    first = len(read_costs(tmp_path))
    run_benchmark(WHOLE, tmp_path, workers=1, references=references)
    assert len(read_costs(tmp_path)) == 12
    assert first == 1  # which is not done again
    assert contents(tmp_path) == contents(done.folder)

    def refuse(*args):
        raise AssertionError("nothing is left to do")

    monkeypatch.setattr("sada_gym.board.benchmark.schedule.WorkerPool", refuse)
    run_benchmark(WHOLE, tmp_path, workers=2, references=references)
    assert contents(tmp_path) == contents(done.folder)


def test_other_folders_are_refused(tmp_path, references):
    chosen = suite("random", budgets=(60,))
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ValueError, match=r"got the file"):
        run_benchmark(chosen, tmp_path / "file", references=references)
    with pytest.raises(ValueError, match=r"which holds something else. Name another"):
        run_benchmark(chosen, tmp_path, references=references)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_two_at_once_are_refused(tmp_path, references):
    chosen = suite("random", budgets=(60,))
    out = tmp_path / "out"
    reserve(out)
    with sole_user(out), pytest.raises(ValueError, match="another is at work there"):
        run_benchmark(chosen, out, references=references)


def test_a_folder_whose_lock_is_no_database_is_not_taken_for_one_in_use(tmp_path):
    (tmp_path / ".lock").write_text("mine")
    with pytest.raises(StoreError, match="got something else in"), sole_user(tmp_path):
        pass


def test_a_bug_stops_it_and_names_the_run(tmp_path, references):
    chosen = suite("random", "bench_toys:Buggy", budgets=(60,))
    with pytest.raises(RunError, match=r"KeyError in bench_toys:Buggy on SADA-Analytic-v0"):
        run_benchmark(chosen, tmp_path, references=references)
    assert len(made(tmp_path / "entries")) == 1
    assert not (tmp_path / "table.md").exists()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_what_looks_like_bad_input_stops_it_too(tmp_path, references):
    chosen = suite("bench_toys:Wrong", budgets=(60,))
    with pytest.raises(RunError, match=r"ValueError in bench_toys:Wrong on .*looks like bad input"):
        run_benchmark(chosen, tmp_path, references=references)
    assert made(tmp_path / "entries") == []


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_run_whose_process_is_killed_is_done_again(tmp_path, references, monkeypatch):
    chosen = suite("random", "bench_toys:Fragile", budgets=(60,))
    for name in ("killed", "whole"):
        deaths = tmp_path / f"{name}.deaths"
        deaths.write_text("" if name == "killed" else "x")
        monkeypatch.setenv("TOY_DEATHS", str(deaths))
        run_benchmark(chosen, tmp_path / name, references=references)
    assert (tmp_path / "killed.deaths").read_text() == "x"
    assert contents(tmp_path / "killed") == contents(tmp_path / "whole")
    again = costs_of(tmp_path / "killed", "bench_toys:Fragile", "n60")
    assert (again.evaluated, again.known) == (30, 60)  # no query is repeated


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no such signal")
def test_a_run_that_kills_its_process_again_and_again_is_named(tmp_path, references):
    chosen = suite("random", "bench_toys:Deadly", budgets=(60,))
    with pytest.raises(WorkerError, match=r"process of bench_toys:Deadly on SADA.* died 3 times"):
        run_benchmark(chosen, tmp_path, references=references)
    assert len(made(tmp_path / "entries")) == 1


def run_logged(out, references, environment):
    os.environ.update(environment)
    run_benchmark(KILLED, out, workers=2, references=references)


def start(out, log, references, pause_s="0.004"):
    """Start a benchmark in a process that can be killed."""
    environment = {"TOY_LOG": str(log), "TOY_PAUSE_S": pause_s}
    process = FORKSERVER.Process(target=run_logged, args=(out, references, environment))
    process.start()
    return process


def end_of(process):
    process.join()
    return process.exitcode


def logged(log):
    """Return the (process, seed) pairs of a log; its last line may be incomplete."""
    if not log.exists():
        return []
    return [
        tuple(map(int, line.split()))
        for line in log.read_text().splitlines(keepends=True)
        if line.endswith("\n") and len(line.split()) == 2
    ]


def is_alive(process):
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def wait_for(condition, limit_s=120.0):
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes in /proc")
def test_killed_at_any_moment_it_goes_on_and_ends_the_same(tmp_path, references):
    assert end_of(start(tmp_path / "whole", tmp_path / "whole.log", references, "0")) == 0
    out = tmp_path / "out"
    for attempt, evaluations in enumerate((30, 80, 130)):
        log = tmp_path / f"{attempt}.log"
        process = start(out, log, references)
        wait_for(lambda: len(logged(log)) > evaluations)  # noqa: B023
        process.kill()
        process.join()
        workers = {worker for worker, _ in logged(log)}
        wait_for(lambda: not any(map(is_alive, workers)), limit_s=10)  # noqa: B023
        if attempt < 2:
            assert not (out / "table.md").exists()
    assert 0 < len(made(out / "entries")) < 6
    elsewhere = tmp_path / "elsewhere"  # a second machine, which has no store
    shutil.copytree(out / "entries", elsewhere / "entries")
    run_benchmark(KILLED, elsewhere, workers=Workers(executor=Inline()), references=references)
    assert contents(elsewhere / "entries") == contents(tmp_path / "whole" / "entries")
    assert contents(elsewhere)["table.md"] == contents(tmp_path / "whole")["table.md"]
    assert len(read_costs(elsewhere)) == 6 - len(made(out / "entries"))
    committed, last = stored(out), tmp_path / "last.log"
    assert end_of(start(out, last, references, "0")) == 0
    assert len(logged(last)) == stored(out) - committed > 0
    assert committed > 60
    assert contents(out) == contents(tmp_path / "whole")


def stored(out):
    """Count the evaluations in all stores."""
    return sum(map(stored_in, (out / "stores").glob("*.sqlite")))


def stored_in(path, limit_s=60.0):
    """Count the evaluations in a store; wait for a worker that is about to end, as a run does.

    A worker that has logged nothing yet is not among those that the test waits for.
    """
    end = time.monotonic() + limit_s
    while True:
        try:
            with EvaluationStore(path) as store:
                return len(store)
        except StoreInUse:
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.05)

"""The oracle on executors that are not ours: the same scores to the last bit."""

import asyncio
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy import Toy, paraboloid

from sada_gym.errors import MissingExtra, UserError, WorkerError
from sada_gym.evaluation import dispatch, executors
from sada_gym.evaluation.executors import Workers, count_workers, open_executor
from sada_gym.evaluation.workers import PortableScorer, evaluate_if_loadable
from sada_gym.oracle import Oracle

pytestmark = pytest.mark.timeout(120)

MU = np.random.default_rng(0).uniform(-1, 1, (150, 3)).astype(np.float32)
ANALYTIC = {"env_kwargs": {"dimension": 3, "noise": 0.2}}
DETECTION_MU = np.random.default_rng(1).uniform(-1, 1, (12, 8)).astype(np.float32)


def scores(problem, mu=MU, **settings):
    with Oracle(problem, budget=len(mu), **settings) as oracle:
        return oracle(mu)


@pytest.fixture(scope="module")
def expected():
    return scores("SADA-Analytic-v0", **ANALYTIC)


@pytest.fixture(scope="module")
def cluster():
    pytest.importorskip("distributed")
    with open_executor("dask", workers=2) as opened:
        yield opened


def client_of(opened):
    return opened.workers.executor._client


@pytest.mark.long
def test_dask_gives_the_same(cluster, expected):
    assert cluster.workers.count == count_workers(cluster.workers.executor) == 2
    result = scores("SADA-Analytic-v0", **ANALYTIC, workers=replace(cluster.workers, chunk_size=7))
    np.testing.assert_array_equal(result, expected)


@pytest.mark.slow  # each worker loads torch and compiles
def test_dask_gives_the_same_detections(cluster):
    expected = scores("SADA-Detection-Car-v0", DETECTION_MU)
    result = scores(
        "SADA-Detection-Car-v0", DETECTION_MU, workers=replace(cluster.workers, chunk_size=5)
    )
    np.testing.assert_array_equal(result, expected)


def test_threads_give_the_same_detections():
    expected = scores("SADA-Detection-Car-v0", DETECTION_MU)
    with ThreadPoolExecutor(2) as threads:
        result = scores(
            "SADA-Detection-Car-v0", DETECTION_MU, workers=Workers(executor=threads, chunk_size=4)
        )
    np.testing.assert_array_equal(result, expected)


def test_a_local_cluster_leaves_the_environment_as_it_was():
    pytest.importorskip("distributed")
    before = dict(os.environ)
    with open_executor("dask", workers=1):
        assert dict(os.environ) == before
    assert dict(os.environ) == before


def test_one_dask_process_gives_the_same(expected):
    pytest.importorskip("distributed")
    with open_executor("dask", workers=1) as opened:
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=opened.workers)
    np.testing.assert_array_equal(result, expected)


def test_dasks_threads_give_the_same(expected):
    distributed = pytest.importorskip("distributed")
    settings = {"processes": False, "threads_per_worker": 2, "dashboard_address": ":0"}
    with distributed.Client(n_workers=1, set_as_default=False, **settings) as client:
        executor = client.get_executor()
        assert count_workers(executor) == 2
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=Workers(executor=executor))
    np.testing.assert_array_equal(result, expected)


def test_threads_give_the_same(expected):
    with ThreadPoolExecutor(3) as threads:
        assert count_workers(threads) == 3
        result = scores(
            "SADA-Analytic-v0", **ANALYTIC, workers=Workers(executor=threads, chunk_size=4)
        )
    np.testing.assert_array_equal(result, expected)


def test_loky_gives_the_same(expected):
    loky = pytest.importorskip("loky")
    executor = loky.ProcessPoolExecutor(2)
    try:
        assert count_workers(executor) == 2
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=Workers(executor=executor))
    finally:
        executor.shutdown(kill_workers=True)
    np.testing.assert_array_equal(result, expected)


def test_our_own_processes_are_an_executor_by_name(expected):
    with open_executor("processes", 2) as opened:
        assert (opened.workers.executor, opened.workers.count) == (None, 2)
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=opened.workers)
    np.testing.assert_array_equal(result, expected)


# a worker that dies


class Killer:
    """Kill one worker once some chunks have come back."""

    def __init__(self, find_worker, after=2):
        self.find_worker, self.left = find_worker, after

    def __call__(self, done, total, cached):
        self.left -= 1
        if self.left == 0:
            os.kill(self.find_worker(), signal.SIGKILL)


def one_process_at_work(log):
    processes = [int(line.split()[0]) for line in log.read_text().splitlines()]
    return next(pid for pid in processes if pid != os.getpid())


@pytest.mark.parametrize("kind", ["ours", "dask"])
def test_a_killed_worker_changes_nothing(kind, tmp_path, request):
    log, store = tmp_path / "log", tmp_path / "run.sqlite"
    executor = request.getfixturevalue("cluster").workers.executor if kind == "dask" else None
    settings = {"workers": Workers(2, executor, chunk_size=5), "store": store}
    killer = Killer(lambda: one_process_at_work(log))
    result = scores(Toy(log=str(log), pause_s=0.005), progress=killer, **settings)
    assert killer.left <= 0
    np.testing.assert_array_equal(result, scores(Toy()))
    # the chunks that were under way are done again, and no other
    done = len(log.read_text().splitlines())
    assert len(MU) <= done <= len(MU) + 5 * 2 * dispatch._AHEAD


class Deadly:
    """Score, but kill the process where mu[0] is largest."""

    def __call__(self, mu):
        if (mu[:, 0] == MU[:, 0].max()).any():
            os.kill(os.getpid(), signal.SIGKILL)
        return paraboloid(mu)


@pytest.mark.long
def test_mu_that_kills_every_worker_ends_with_a_sentence_and_the_rest_is_known():
    settings = {"dimension": 3, "threshold": 0.3, "workers": Workers(2, chunk_size=10)}
    done = []
    with pytest.raises(WorkerError, match="A worker process died"):
        scores(Deadly(), progress=lambda d, t, k: done.append(d), **settings)
    assert done[-1] >= 30


@pytest.mark.long
def test_mu_that_kills_every_dask_worker_ends_with_a_sentence(cluster, monkeypatch):
    # three by default, and each is a process that starts
    monkeypatch.setattr(client_of(cluster).cluster.scheduler, "allowed_failures", 1)
    settings = {
        "dimension": 3,
        "threshold": 0.3,
        "workers": replace(cluster.workers, chunk_size=10),
    }
    with pytest.raises(WorkerError, match=r"lost its workers.*\(KilledWorker\).*resume the run"):
        scores(Deadly(), **settings)
    client_of(cluster).wait_for_workers(2, timeout=120)


def test_a_result_that_dask_loses_with_its_worker_is_evaluated_again(expected):
    cfexecutor = pytest.importorskip("distributed.cfexecutor")

    class Result:
        """A future of Dask whose worker died just after its result had come."""

        status = "lost"

        def __init__(self, answer):
            self.answer = answer

        async def _result(self, raiseit):
            return self.answer

    class Losing(ThreadPoolExecutor):
        """Loses every second result, as Dask does."""

        submitted = 0

        def submit(self, function, *args):
            self.submitted += 1
            future = super().submit(function, *args)
            if self.submitted % 2:
                return future
            lost = Future()
            answer = future.result()
            asyncio.run(lose(Result(answer), lost))
            return lost

    async def lose(result, lost):
        await cfexecutor._cascade_future(result, lost)

    with Losing(1) as executor:
        workers = Workers(1, executor, chunk_size=10)
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=workers)
    assert executor.submitted > 15
    np.testing.assert_array_equal(result, expected)


def test_a_broken_loky_ends_with_a_sentence():
    loky = pytest.importorskip("loky")
    executor = loky.ProcessPoolExecutor(2)
    try:
        workers = Workers(executor=executor, chunk_size=10)
        with pytest.raises(WorkerError, match="The executor lost its workers"):
            scores(Deadly(), dimension=3, threshold=0.3, workers=workers)
    finally:
        executor.shutdown(kill_workers=True)


def test_a_script_needs_no_guard(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import sada_gym\n"
        "from sada_gym.oracle import Oracle\n"
        "Oracle('SADA-Analytic-v0', budget=4, workers=2)([[0.0, 0.0]] * 4)\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.long
def test_a_worker_that_starts_after_the_end_says_nothing(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys, time\n"
        "if any('spawn_main' in word for word in sys.orig_argv):\n"
        f"    try:\n        os.mkdir({str(tmp_path / 'first')!r})\n"
        "    except FileExistsError:\n        time.sleep(4)\n"
    )
    script = tmp_path / "script.py"
    script.write_text(
        "import sada_gym\n"
        "from sada_gym.oracle import Oracle\n"
        "Oracle('SADA-Analytic-v0', budget=4, workers=2)([[0.0, 0.0]] * 4)\n"
    )
    paths = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


# a cluster elsewhere


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def remote():
    """Start a scheduler and a worker by Dask's own commands; give the scheduler and address."""
    pytest.importorskip("distributed")
    address = f"tcp://127.0.0.1:{free_port()}"
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    here = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    port = address.rpartition(":")[2]
    scheduler = subprocess.Popen(
        [*dask, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"], **quiet
    )
    worker = subprocess.Popen(
        [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "30"],
        env=here,
        **quiet,
    )
    wait_for_port(int(port))
    yield scheduler, f"dask:{address}"
    for process in (worker, scheduler):
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()


def wait_for_port(port):
    deadline = time.monotonic() + 30
    while time.monotonic() < deadline:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
        except OSError:
            time.sleep(0.1)
        else:
            return


@pytest.mark.long
def test_a_running_cluster_is_used_and_one_that_is_lost_ends_with_a_sentence(
    remote, expected, tmp_path
):
    scheduler, address = remote
    store = tmp_path / "run.sqlite"
    with open_executor(address) as opened:
        assert opened.workers.count == 1
        result = scores("SADA-Analytic-v0", **ANALYTIC, workers=opened.workers)
        np.testing.assert_array_equal(result, expected)

        toy, done = Toy(pause_s=0.02), []

        def lose_scheduler(*counts):
            done.append(counts)
            if len(done) == 3:
                scheduler.kill()

        settings = {"store": store, "workers": replace(opened.workers, chunk_size=5)}
        with pytest.raises(WorkerError, match=r"connection to its scheduler.*resume the run"):
            scores(toy, progress=lose_scheduler, **settings)
    known = []
    result = scores(toy, store=store, progress=lambda d, t, k: known.append(k))
    np.testing.assert_array_equal(result, scores(Toy()))
    assert known[0] >= 15


@pytest.fixture
def collected():
    """Collect Dask's half-made client: while another one starts it would wait for that for ever."""
    yield
    gc.collect()


@pytest.mark.long
@pytest.mark.usefixtures("collected")
def test_an_unreachable_address_is_told_of_within_seconds():
    pytest.importorskip("distributed")
    start = time.monotonic()
    with pytest.raises(UserError, match=r"Expected a Dask scheduler at tcp://127.0.0.1:\d+, but"):
        open_executor(f"dask:tcp://127.0.0.1:{free_port()}")
    assert time.monotonic() - start < 15


@pytest.mark.usefixtures("collected")
@pytest.mark.parametrize("address", ["nonsense", "http://127.0.0.1:1", "127.0.0.1:99999"])
def test_a_bad_address_is_told_of(address, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "_CONNECT_S", 1.0)
    with pytest.raises(UserError, match=rf"Expected a Dask scheduler at {address}, but none"):
        open_executor(f"dask:{address}")


def test_a_cluster_without_workers_is_told_of(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(executors, "_FIRST_WORKER_S", 0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        pytest.raises(UserError, match=r"Expected workers in the cluster .* dask worker tcp"),
    ):
        open_executor(f"dask:{cluster.scheduler_address}")


def test_a_cluster_that_loses_all_workers_does_not_wait_for_ever(monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(dispatch, "_CHECK_S", 0.1)
    monkeypatch.setattr(dispatch, "_NO_WORKER_S", 0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        pytest.raises(WorkerError, match=r"Expected workers in the cluster.*resume the run"),
    ):
        scores("SADA-Analytic-v0", **ANALYTIC, workers=Workers(executor=client.get_executor()))


def test_other_versions_in_the_cluster_are_refused(cluster, monkeypatch):
    address = client_of(cluster).scheduler.address
    here = {**executors._versions(), "numpy": "1.2.3"}
    monkeypatch.setattr(executors, "_versions", Here(here))
    with pytest.raises(UserError, match=r"Expected the same versions .* instead of 1\.2\.3"):
        open_executor(f"dask:{address}")


class Here:
    """Answer otherwise in this process alone: elsewhere it is the function again."""

    def __init__(self, answer):
        self.answer = answer

    def __call__(self):
        return self.answer

    def __reduce__(self):
        return getattr, (executors, "_versions")


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra, match=r"pip install -c constraints.txt '\.\[cluster\]'"):
        open_executor("dask")


@pytest.mark.parametrize("spec", ["", "dask:", "threads", "Dask", "processes:2"])
def test_an_unknown_executor_is_refused(spec):
    with pytest.raises(UserError, match=r"Expected an executor of processes, dask, dask:ADDRESS"):
        open_executor(spec)


def test_closing_twice_is_fine_and_ends_the_workers():
    pytest.importorskip("distributed")
    opened = open_executor("dask", 1)
    (pid,) = client_of(opened).run(os.getpid).values()
    opened.close()
    opened.close()
    deadline = time.monotonic() + 10
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_an_executor_that_was_closed_is_told_of():
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    with pytest.raises(WorkerError, match="Expected an open executor"):
        scores(Toy(), workers=Workers(executor=threads))


# what is sent


class Large:
    """A function with a megabyte of weights."""

    def __init__(self, seed=0):
        self.weights = np.random.default_rng(seed).random(130_000)

    def __call__(self, mu):
        return paraboloid(mu) * self.weights[:1]


class Recording(ThreadPoolExecutor):
    """Note what is handed over, and how much at a time."""

    def __init__(self, workers):
        super().__init__(workers)
        self.sizes, self.open, self.most = [], 0, 0
        self.lock = threading.Lock()

    def submit(self, function, task, *args):
        self.sizes.append(task.size)
        future = super().submit(function, task, *args)
        with self.lock:
            self.open += 1
            self.most = max(self.most, self.open)
        future.add_done_callback(self._done)
        return future

    def _done(self, _):
        with self.lock:
            self.open -= 1


def test_a_large_model_is_sent_once_for_each_worker_not_with_every_chunk():
    problem = Large()
    with Recording(2) as executor:
        workers = Workers(executor=executor, chunk_size=1)
        result = scores(problem, dimension=3, threshold=0.3, workers=workers)
    np.testing.assert_array_equal(result, problem(MU))
    assert sum(size > 1_000_000 for size in executor.sizes) == 2
    assert executor.sizes.count(0) == len(MU) - 2


def test_a_large_model_reaches_dasks_workers_even_one_that_is_new(cluster):
    problem = Large()
    settings = {
        "dimension": 3,
        "threshold": 0.3,
        "workers": replace(cluster.workers, chunk_size=5),
    }
    pids = client_of(cluster).run(os.getpid)
    killer = Killer(lambda: next(iter(pids.values())), after=4)
    result = scores(problem, progress=killer, **settings)
    np.testing.assert_array_equal(result, problem(MU))


def test_a_process_that_lacks_the_payload_asks_for_it():
    task = PortableScorer.of(Large(seed=1))  # that no other test has sent
    light = PortableScorer(None, task.key)
    assert evaluate_if_loadable(light, MU[:2], [0, 1]) is None
    whole = evaluate_if_loadable(task, MU[:2], [0, 1])
    again = evaluate_if_loadable(light, MU[:2], [0, 1])
    np.testing.assert_array_equal(again.scores, whole.scores)


def test_only_a_few_chunks_are_handed_out_at_a_time():
    with Recording(2) as executor:
        scores(Toy(), workers=Workers(executor=executor, chunk_size=1))
    assert len(executor.sizes) == len(MU)
    assert executor.most <= 2 * dispatch._AHEAD


@pytest.mark.long
def test_dasks_workers_leave_ctrl_c_to_the_parent(cluster):
    masks = client_of(cluster).run(blocked_signals)
    assert all(signal.SIGINT in mask for mask in masks.values())


def blocked_signals():
    return {int(s) for s in signal.pthread_sigmask(signal.SIG_BLOCK, set())}

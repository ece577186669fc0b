"""What a cluster gives and what it costs: throughput by workers, commits, bytes, overhead a task.

Run it: OMP_NUM_THREADS=1 python -m studies.cluster
"""

from __future__ import annotations

import argparse
import os
import pickle
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil

from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.executors import OpenExecutor, open_executor
from sada_gym.evaluation.key import ApplicationKey
from sada_gym.evaluation.problems import Registered, make_application
from sada_gym.evaluation.store import EvaluationStore
from sada_gym.evaluation.workers import PortableScorer, WorkerPool
from sada_gym.oracle import Oracle

ANALYTIC, DETECTION = "SADA-Analytic-v0", "SADA-Detection-Car-v0"
COUNTS = {ANALYTIC: 10_000, DETECTION: 400}
CHUNKS = (1, 8, 64)
DIMENSION = 8


def main() -> None:
    """Measure all and print tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--share", type=float, default=1.0, help="of the evaluations measured")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores\n")
    commits()
    sizes()
    overheads()
    print()
    throughput(arguments.workers, arguments.share)


def throughput(workers: Sequence[int], share: float) -> None:
    """Evaluations a second by workers."""
    print("| workers | analytic, evaluations/s | detection, evaluations/s |\n| --- | --- | --- |")
    row("this process", lambda env_id: rate(env_id, share))
    for count in workers:
        if count == 1:
            continue  # which is this process
        row(f"our own processes, {count}", lambda env_id, n=count: rate(env_id, share, workers=n))
    for count in workers:
        with dask_workers(count) as address, open_executor(address) as cluster:
            row(
                f"`dask worker` commands, {cluster.workers.count}",
                lambda env_id, c=cluster: rate(env_id, share, workers=c.workers),
            )
    print()


def row(name: str, measure: Callable[[str], float]) -> None:
    """Print one row."""
    print(f"| {name} | {measure(ANALYTIC):,.0f} | {measure(DETECTION):,.0f} |", flush=True)


def rate(env_id: str, share: float, **settings: object) -> float:
    """Evaluations a second of an oracle with a store, once its workers have loaded everything."""
    count = max(64, int(COUNTS[env_id] * share))
    with tempfile.TemporaryDirectory() as folder:
        evaluator = Evaluator(env_id, store=Path(folder) / "run.sqlite", **settings)  # type: ignore[arg-type]
        rng = np.random.default_rng(0)
        warm = Oracle(evaluator, budget=64, stream="verification")
        warm(rng.uniform(-1, 1, (64, evaluator.dimension)))
        oracle = Oracle(evaluator, budget=count)
        start = time.perf_counter()
        oracle(rng.uniform(-1, 1, (count, evaluator.dimension)))
        seconds = time.perf_counter() - start
        evaluator.close()
    return count / seconds


@contextmanager
def dask_workers(count: int) -> Iterator[str]:
    """Start a scheduler and workers on the loopback, by Dask's own commands."""
    with dask_commands(count) as (address, _):
        yield address


@contextmanager
def dask_commands(count: int) -> Iterator[tuple[str, int]]:
    """Return the scheduler's process as well."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m", "dask"]
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["worker", address, "--nworkers", str(count), "--nthreads", "1", "--no-dashboard"]
    started = [
        subprocess.Popen([*dask, *command], stderr=subprocess.DEVNULL)
        for command in (scheduler, worker)
    ]
    try:
        while True:
            with open_when_up(address) as cluster:
                if cluster.workers == count:
                    break
            time.sleep(0.5)
        yield f"dask:{address}", started[0].pid
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


def open_when_up(address: str) -> OpenExecutor:
    """Open the cluster, again and again until it is there."""
    for _ in range(10):
        try:
            return open_executor(f"dask:{address}")
        except ValueError:
            time.sleep(0.5)
    raise SystemExit("the cluster did not start")


def commits() -> None:
    """What the store takes."""
    print("| evaluations a commit | commits/s | evaluations/s |\n| --- | --- | --- |")
    rng = np.random.default_rng(0)
    for size in CHUNKS:
        with tempfile.TemporaryDirectory() as folder:
            store = EvaluationStore(Path(folder) / "run.sqlite")
            key = store.context(ApplicationKey.of(make_application(ANALYTIC)))
            mu = rng.uniform(-1, 1, (1_000, size, DIMENSION)).astype(np.float32)
            start = time.perf_counter()
            for i, chunk in enumerate(mu):
                store.commit(key, chunk, list(range(i * size, (i + 1) * size)), np.full(size, 0.5))
            each = len(mu) / (time.perf_counter() - start)
            store.close()
        print(f"| {size} | {each:,.0f} | {each * size:,.0f} |")
    print()


def sizes() -> None:
    """What crosses the network, besides Dask's own messages."""
    print("| evaluations a chunk | bytes an evaluation, there and back |\n| --- | --- |")
    task = PortableScorer.of(Registered(DETECTION, {}))
    for size in CHUNKS:
        seeds = [2**30] * size
        task_bytes = pickle.dumps((task, np.zeros((size, DIMENSION), np.float32), seeds))
        back = pickle.dumps(np.zeros(size))
        print(f"| {size} | {(len(task_bytes) + len(back)) / size:,.0f} |")
    print()


def overheads() -> None:
    """What a task costs that does nothing, by the clock and in the processes that are only one."""
    print("| executor | clock, ms a task | parent, CPU ms | scheduler, CPU ms |")
    print("| --- | --- | --- | --- |")
    pool = WorkerPool(2)
    print("| our own processes, 2 | {:.2f} | {:.2f} | |".format(*overhead(pool.executor)))
    pool.close()
    with dask_commands(2) as (address, pid), open_executor(address) as cluster:
        assert cluster.executor is not None
        overheads = overhead(cluster.executor, psutil.Process(pid))
        print("| Dask, 2 | {:.2f} | {:.2f} | {:.2f} |".format(*overheads))


def overhead(
    executor: Executor, scheduler: psutil.Process | None = None, count: int = 1_000
) -> tuple[float, float, float]:
    """Milliseconds a task, a few at a time as the evaluator has them: clock, parent, scheduler."""
    for future in [executor.submit(abs, -1) for _ in range(50)]:
        future.result()
    start, before = (time.perf_counter(), time.process_time()), cpu_seconds(scheduler)
    running: set[Future[int]] = set()
    for i in range(count):
        running.add(executor.submit(abs, -i))
        if len(running) == 4:
            running = wait(running, return_when=FIRST_COMPLETED).not_done
    wait(running)
    clock, parent = time.perf_counter() - start[0], time.process_time() - start[1]
    return tuple(1e3 * s / count for s in (clock, parent, cpu_seconds(scheduler) - before))


def cpu_seconds(process: psutil.Process | None) -> float:
    """What a process has used so far."""
    return 0.0 if process is None else sum(process.cpu_times()[:2])


if __name__ == "__main__":
    main()

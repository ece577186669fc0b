"""`--executor`: where evaluations run, in processes of this machine or on a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

PROCESSES = "processes"
EXECUTOR_HELP = "`processes`, `dask` (a local cluster), or `dask:ADDRESS` of a scheduler."


@contextmanager
def open_named(name: str, workers: int) -> Iterator[tuple[Executor | None, int]]:
    """Open an executor by its name and close it at the end.

    Args:
        name: The executor's name on the command line.
        workers: The number of workers to start, where it is not running already.

    Yields:
        The executor, None for processes of this machine, and its number of workers.
    """
    if name == PROCESSES:
        yield None, workers
        return
    from sada_gym.evaluation.executors import open_executor

    with open_executor(name, workers) as opened:
        yield opened.executor, opened.workers

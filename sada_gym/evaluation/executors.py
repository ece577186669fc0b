"""Executors for evaluations: our own processes, a Dask cluster, or any other one."""

from __future__ import annotations

import logging
import os
import platform
import sys
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from sada_gym.errors import MissingExtra, UserError, UserTypeError, check_integer, install_line
from sada_gym.evaluation.spawn import spawn_context
from sada_gym.evaluation.workers import MAX_WORKERS, inherited_settings
from sada_gym.foundations.arithmetic import arithmetic
from sada_gym.foundations.environment_variables import set_environment_variables

KINDS = ("processes", "dask", "dask:ADDRESS")
"""The names that `open_executor` takes."""

_CONNECT_S = 5.0
_FIRST_WORKER_S = 30.0
_CLOSE_S = 5.0
_NANNY = "distributed.nanny.pre-spawn-environ"
_ENVIRONMENT = ("NUMBA_NUM_THREADS", "PYTHONSAFEPATH")
"""Variables that are set to 1 before a Dask worker starts, beside those that Dask sets."""

_SET_BY_DASK = ("PYTHONHASHSEED", "__DASK_PARENT_PID")

_DECISIVE = ("sada-gym", "numpy", "torch")
"""Scores differ if a worker has another version of one of these packages."""


@dataclass(frozen=True, eq=False)
class Workers:
    """Says which processes evaluate. `workers=` also takes a number: that many local processes.

    Attributes:
        count: 1 evaluates in this process, more start that many processes. With an executor, give
            the number of its workers if the executor does not know it.
        executor: Any PEP 3148 executor (`concurrent.futures`, loky, Dask's `Client.get_executor()`)
            to use instead of local processes. It is not closed.
        chunk_size: How many evaluations a worker gets at a time; None chooses.

    Raises:
        TypeError, ValueError: If an argument is not as described.
    """

    count: int = 1
    executor: Executor | None = None
    chunk_size: int | None = None

    def __post_init__(self) -> None:
        """Check them."""
        check_integer("workers", self.count, 1, MAX_WORKERS if self.executor is None else None)
        if self.chunk_size is not None:
            check_integer("chunk_size", self.chunk_size, 1)
        if self.executor is not None and not callable(getattr(self.executor, "submit", None)):
            raise UserTypeError(
                "Expected an executor of concurrent.futures, loky or Dask, such as "
                f"ProcessPoolExecutor(), got {self.executor!r}."
            )

    @classmethod
    def of(cls, given: int | Workers) -> Workers:
        """Return workers, also those that are given by their number."""
        return given if isinstance(given, Workers) else cls(given)


class OpenExecutor(ExitStack):
    """An executor that is ready for work.

    `close` disconnects from a cluster, or stops one that was started here. It may be repeated.

    Attributes:
        workers: Pass this to `attack`, `Oracle` or any other `workers=`.
    """

    def __init__(self, executor: Executor | None, workers: int) -> None:
        super().__init__()
        self.workers = Workers(workers, executor)
        if executor is not None:
            log = logging.getLogger("distributed")
            self.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)  # we say ourselves what the user must know


def open_executor(spec: str = "processes", workers: int = 1) -> OpenExecutor:
    """Open an executor by its name.

    Args:
        spec: `processes` for local processes, `dask` for a new Dask cluster on this machine, or
            `dask:ADDRESS` for a running cluster, by the address of its scheduler, such as
            `dask:tcp://10.0.0.5:8786`.
        workers: How many processes to start. A running cluster keeps its own number.

    Returns:
        The executor. Close it, or use it as a context manager.

    Raises:
        ValueError: If there is no such executor, or nothing answers at the address.
        MissingExtra: If Dask is not installed.

    Example:
        >>> with open_executor("dask", workers=2) as cluster:
        ...     oracle = Oracle("SADA-Analytic-v0", budget=100, workers=cluster.workers)
    """
    check_integer("workers", workers, 1)
    kind, _, address = spec.partition(":")
    if spec == "processes":
        return OpenExecutor(None, workers)
    if spec == "dask":
        return _local_cluster(workers)
    if kind == "dask" and address:
        return _running_cluster(address)
    raise UserError(
        f"Expected an executor of {', '.join(KINDS)}, got {spec!r}. "
        "ADDRESS is a scheduler's, such as tcp://10.0.0.5:8786."
    )


def count_workers(executor: Executor) -> int | None:
    """Return how many workers an executor has; None if it does not know."""
    client = getattr(executor, "_client", None)  # of Dask's executors
    if client is not None:
        try:
            return int(sum(client.nthreads().values()))
        except Exception:  # whatever is wrong with the cluster, its futures will say
            return None
    # concurrent.futures and loky alike
    workers = getattr(executor, "_max_workers", None)
    return workers if isinstance(workers, int) else None


def engine_errors() -> tuple[type[BaseException], ...]:
    """Return the errors that futures of a broken executor raise, and evaluations never."""
    errors: list[type[BaseException]] = [BrokenExecutor, CancelledError]
    distributed = sys.modules.get("distributed")  # loaded by whoever made such an executor
    if distributed is not None:
        errors += [distributed.KilledWorker, distributed.client.ClosedClientError]
    return tuple(errors)


def lost_its_worker(error: BaseException) -> bool:
    """Return whether Dask lost a finished result: its worker died, and nobody's code failed.

    Dask's own future then fails to unpack the result, as if it were an exception with its parts.
    """
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return trace is not None and trace.tb_frame.f_code.co_name == "_cascade_future"


def _distributed() -> Any:
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise MissingExtra(
            "Expected the package distributed (Dask) for this executor, but it is not installed. "
            f"{install_line('cluster')}"
        ) from error
    return distributed


def _local_cluster(workers: int) -> OpenExecutor:
    distributed = _distributed()
    import dask

    changed = (*dask.config.get(_NANNY), *_ENVIRONMENT, *_SET_BY_DASK)
    before = {name: os.environ.get(name) for name in changed}
    spawn_context()  # starts the resource tracker: its own start would unblock SIGINT again
    # the cluster's thread inherits the blocked SIGINT, and so do all workers that it starts: a
    # Ctrl-C is the parent's
    with dask.config.set({f"{_NANNY}.{name}": "1" for name in _ENVIRONMENT}), inherited_settings():
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=None,  # else Dask stops workers that take more than their share
            silence_logs=logging.CRITICAL,
        )
    set_environment_variables(before)  # other processes that start here see the old values
    client = distributed.Client(cluster, set_as_default=False)
    opened = OpenExecutor(client.get_executor(pure=False), workers)
    opened.callback(set_environment_variables, before)  # a worker that is replaced changes them
    opened.callback(_leave, cluster)
    opened.callback(_leave, client)
    return opened


def _running_cluster(address: str) -> OpenExecutor:
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except Exception as error:  # Dask raises what it stumbles over: even MemoryError
        raise UserError(
            f"Expected a Dask scheduler at {address}, but none answered within {_CONNECT_S:.0f} s "
            f"({error}). Check the address, that `dask scheduler` is running there, and that no "
            "firewall is in between."
        ) from error
    opened = OpenExecutor(client.get_executor(pure=False), 1)
    opened.callback(_leave, client)
    try:
        opened.workers = replace(opened.workers, count=_ready_workers(client, address))
    except BaseException:
        opened.close()
        raise
    return opened


def _leave(connection: Any) -> None:
    with suppress(OSError, TimeoutError):  # it may be gone
        connection.close(timeout=_CLOSE_S)


def _ready_workers(client: Any, address: str) -> int:
    try:
        client.wait_for_workers(1, timeout=_FIRST_WORKER_S)
    except TimeoutError as error:
        raise UserError(
            f"Expected workers in the cluster at {address}, but there was none within "
            f"{_FIRST_WORKER_S:.0f} s. Start some: dask worker {address}"
        ) from error
    own = _versions()
    try:
        versions = client.run(_versions)
    except ModuleNotFoundError as error:
        raise UserError(
            f"Expected sada-gym to be installed where the workers of {address} run, but it is not "
            f"({error}). Install sada-gym {own['sada-gym']} there."
        ) from error
    for worker, its in versions.items():
        differing = [f"{k} {its[k]} instead of {own[k]}" for k in own if its[k] != own[k]]
        if differing:
            raise UserError(
                f"Expected the same versions in the cluster as here, got a worker, {worker}, with "
                f"{', '.join(differing)}. Scores could differ: install the same ones everywhere."
            )
    return int(sum(client.nthreads().values()))


def _versions() -> dict[str, str]:
    versions = {"Python": ".".join(platform.python_version_tuple()[:2])}
    for name in _DECISIVE:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "(none)"
    versions["arithmetic:"] = arithmetic()
    return versions

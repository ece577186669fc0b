"""Worker processes: what they evaluate, how they start, and how they end."""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children
from multiprocessing.connection import Connection
from multiprocessing.queues import SimpleQueue
from typing import Any

import cloudpickle

from sada_gym.application import Application
from sada_gym.errors import Notice, UserError, UserTypeError, WorkerError, described
from sada_gym.evaluation import watch
from sada_gym.evaluation.problems import Answer, Registered, Scorer, score
from sada_gym.evaluation.spawn import spawn_context, without_main
from sada_gym.foundations.environment_variables import environment_variables
from sada_gym.parameters import Mu

MAX_WORKERS = 1_024
"""The limit of our own processes: each holds a simulator and a network, some 300 MB."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_CACHE_SIZE = 4
_DYING_S = 10.0
_DYING_CHECKS, _DYING_CHECK_S = 40, 0.05
_MOST_WARNINGS, _LONGEST_WARNING = 10, 500

_sent_warnings: set[str] = set()
"""The warnings that this worker has sent."""

_payloads: dict[str, bytes] = {}
"""The last payloads that this process received, when it started or later, by key."""

_payloads_lock = threading.Lock()

_scorers = threading.local()
"""The scorers that this thread has loaded, by key. Threads seldom can share a simulator."""

WarningQueue = SimpleQueue[tuple[type[Warning], str]]


@dataclass(frozen=True)
class PortableScorer:
    """A scorer made portable: it can be sent to any process, and is loaded once in each.

    Its payload is pickled; it is None where the process got it when it started, by its digest.
    With `main` the process must have run the script that sends it.
    """

    payload: bytes | None
    key: str
    main: bool = False

    @classmethod
    def of(cls, source: Registered | Scorer) -> PortableScorer:
        """Pickle a source; raise `UserTypeError` if it cannot be pickled.

        Lambdas, closures and the classes of a script or a notebook are sent by value. Where these
        hold what cannot be sent, such as a lock, a script's objects go by name.
        """
        main = False
        try:
            payload = cloudpickle.dumps(source)
        except Exception as error:  # whatever an object's own __reduce__ raises
            main = True
            try:
                payload = pickle.dumps(source)
            except Exception:
                raise UserTypeError(
                    "Expected something that can be pickled and sent to worker processes, got "
                    f"{source!r} ({described(error)}). Leave out open files, locks and "
                    "connections, or use workers=1."
                ) from error
        return cls(payload, hashlib.sha256(payload).hexdigest(), main)

    @property
    def size(self) -> int:
        """The size of the payload in bytes."""
        return 0 if self.payload is None else len(self.payload)

    def __call__(self, mu: Mu, seeds: Sequence[int]) -> Answer:
        """Evaluate one chunk, see `score`."""
        scorers: dict[str, Scorer] = vars(_scorers)
        if self.key not in scorers:
            _drop_oldest(scorers)
            scorers[self.key] = self._load()
        return score(scorers[self.key], mu, seeds)

    def _load(self) -> Scorer:
        try:
            payload = _payloads[self.key] if self.payload is None else self.payload
            source: Registered | Scorer = pickle.loads(payload)
            return source.build() if isinstance(source, Registered) else source
        except (UserError, WorkerError):  # such as an agent that is gone
            raise
        except Exception as error:
            raise WorkerError(
                f"A worker process could not load the problem ({described(error)}). "
                "Define it at the module level of an importable file, or use workers=1."
            ) from error


def _drop_oldest(cache: dict[str, Any]) -> None:
    while len(cache) >= _CACHE_SIZE:
        oldest = cache.pop(next(iter(cache)))
        if isinstance(oldest, Application):
            oldest.close()


def evaluate_if_loadable(task: PortableScorer, mu: Mu, seeds: Sequence[int]) -> Answer | None:
    """Return the scores of one chunk; None if neither task nor process has the payload.

    The process keeps the payload, so that a large model crosses the network once for each.
    """
    with _payloads_lock:
        if task.payload is not None and task.key not in _payloads:
            _drop_oldest(_payloads)
            _payloads[task.key] = task.payload
        loadable = task.payload is not None or task.key in _payloads or task.key in vars(_scorers)
    return task(mu, seeds) if loadable else None


class WorkerPool:
    """A process pool whose workers leave Ctrl-C to the parent and never outlive it.

    Each worker computes in one thread and watches a pipe that only the parent holds open: when
    the parent closes it, or dies in whatever way, the worker exits at once. All processes start at
    once; the task that they will evaluate, if any, is sent once, not with every chunk.
    """

    def __init__(self, workers: int, task: PortableScorer | None = None) -> None:
        context = spawn_context()
        watched, self._lifeline = context.Pipe(duplex=False)
        self._warnings: WarningQueue = context.SimpleQueue()
        self._watched = watch.shared_memory(context, workers)
        numbers: SimpleQueue[int] = context.SimpleQueue()
        for number in range(workers):
            numbers.put(number)
        self.executor = ProcessPoolExecutor(
            workers,
            mp_context=context,
            initializer=_initialise,
            initargs=(watched, task, self._warnings, self._watched, numbers),
        )
        before = set(active_children())
        by_value = task is not None and not task.main
        with inherited_settings(), without_main() if by_value else nullcontext():
            # any call: the pool starts a process for it
            self._started = [self.executor.submit(os.getpid) for _ in range(workers)]
        self._processes = set(active_children()) - before
        for process in self._processes:
            # a pool may be dropped while they start, and what they share must still be there
            vars(process)["shared"] = numbers, self._warnings, self._watched

    @property
    def failed_to_start(self) -> bool:
        """Whether a process raised an exception as it started. Another one would do the same."""
        if any(
            done.done() and not done.cancelled() and not done.exception() for done in self._started
        ):
            return False
        return any(process.exitcode == 1 for process in self._processes)

    def stop_overdue(self, timeout: float) -> set[int]:
        """Kill the processes that compute one world for longer; return the keys of the worlds."""
        processes = {process.pid: process for process in self._processes}
        overdue = set()
        for pid, (world, seconds) in watch.worlds(self._watched).items():
            # twice: it may be at the next world by now
            now, _ = watch.worlds(self._watched).get(pid, (None, 0.0))
            if seconds > timeout and now == world and pid in processes:
                overdue.add(world)
                _kill_group(pid)
                processes[pid].kill()
        return overdue

    def deaths(self) -> dict[int, str]:
        """Say how the processes that died in a world ended, by the key of that world."""
        worlds = watch.worlds(self._watched)
        for _ in range(_DYING_CHECKS if worlds else 0):  # an exit code comes a moment later
            deaths = {
                worlds[process.pid][0]: _ending(process.exitcode)
                for process in self._processes
                # an executor that has lost a process terminates the others
                if process.exitcode not in (None, 0, -signal.SIGTERM) and process.pid in worlds
            }
            if deaths:
                return deaths
            time.sleep(_DYING_CHECK_S)
        return {}

    def warnings(self) -> Iterator[tuple[type[Warning], str]]:
        """Iterate over the warnings since the last call; they come before their chunk's scores."""
        while not self._warnings.empty():
            yield self._warnings.get()

    def close(self, *, now: bool = False) -> None:
        """Stop the workers, `now` without waiting for running chunks; twice is fine."""
        # the pool first: one that finds its processes gone fails all futures that it holds, and
        # raises at those that its caller has cancelled
        self.executor.shutdown(wait=not now, cancel_futures=True)
        self._lifeline.close()
        for process in self._processes:
            process.join(_DYING_S)
            if process.exitcode:  # what it had started may be alive
                _kill_group(process.pid)


def _kill_group(pid: int | None) -> None:
    """Kill a worker, if it is alive, and the engines that its environments started."""
    if pid is not None and hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)


def _ending(exitcode: int) -> str:
    try:
        return f"was ended by {signal.Signals(-exitcode).name}"
    except ValueError:
        return f"ended with exit code {exitcode}"


@contextmanager
def inherited_settings() -> Iterator[None]:
    """Give processes that start here one thread each, and block SIGINT from the beginning.

    Both must be set before the interpreter starts: NumPy reads the variables when it is imported,
    and a Ctrl-C during start-up would print a traceback for each worker.
    """
    with environment_variables(dict.fromkeys(_THREADS, "1")):
        if not hasattr(signal, "pthread_sigmask"):
            yield
            return
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _initialise(
    lifeline: Connection,
    task: PortableScorer | None,
    queue: WarningQueue,
    watched: Any,
    numbers: SimpleQueue[int],
) -> None:
    watch.join(watched, numbers.get())
    if task is not None and task.payload is not None:
        _payloads[task.key] = task.payload
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)  # the engines that it starts end with it, see `_kill_group`
    warnings.showwarning = partial(_send_warning, queue)  # the parent shows it once
    threading.Thread(target=_exit_with_parent, args=(lifeline,), daemon=True).start()


def _send_warning(
    queue: WarningQueue, message: Warning | str, category: type[Warning], *_: Any
) -> None:
    # a full pipe would stop the worker until the parent reads it, which waits for the worker
    text = str(message)
    if issubclass(category, Notice):  # the parent opens the application, too, and has said it
        return
    if len(_sent_warnings) < _MOST_WARNINGS and text not in _sent_warnings:
        _sent_warnings.add(text)
        # the parent may be unable to import the category of another library
        portable = category if category.__module__ == "builtins" else UserWarning
        queue.put((portable, text[:_LONGEST_WARNING]))


def _exit_with_parent(lifeline: Connection) -> None:
    lifeline.poll(None)  # nothing is ever sent: this returns when the other end is closed
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)

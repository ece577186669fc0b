"""Worker processes: what they evaluate, how they start, and how they end."""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import threading
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children
from multiprocessing.connection import Connection
from multiprocessing.queues import SimpleQueue
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application
from sada_gym.environment_variables import environment_variables
from sada_gym.errors import UserTypeError, WorkerError
from sada_gym.evaluation.problems import Registered, Scorer, score
from sada_gym.evaluation.spawn import spawn_context
from sada_gym.parameters import Mu

MAX_WORKERS = 1_024
"""The limit of our own processes: each holds a simulator and a network, some 300 MB."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_CACHE_SIZE = 4
_DYING_S = 10.0


@dataclass(frozen=True)
class PortableScorer:
    """A scorer made portable: it can be sent to any process, and is loaded once in each.

    Attributes:
        payload: The pickled source: `Registered`, an application or a function; None where the
            process was given it when it started.
        key: The payload's digest.
    """

    payload: bytes | None
    key: str

    @classmethod
    def of(cls, source: Registered | Scorer) -> PortableScorer:
        """Pickle a source.

        Raises:
            TypeError: If it cannot be pickled.
        """
        try:
            payload = pickle.dumps(source)
        except Exception as error:  # pickle raises whatever an object's own __reduce__ raises
            raise UserTypeError(
                "Expected something that can be pickled and sent to worker processes, got "
                f"{source!r} ({error}). Define it at the module level of an importable file "
                "(no lambda, no closure), or use workers=1."
            ) from error
        return cls(payload, hashlib.sha256(payload).hexdigest())

    @property
    def size(self) -> int:
        """The size of the payload in bytes."""
        return 0 if self.payload is None else len(self.payload)

    def __call__(self, mu: Mu, seeds: Sequence[int]) -> npt.NDArray[np.float64]:
        """Evaluate one chunk, see `score`."""
        return score(self._scorer(), mu, seeds)

    def _scorer(self) -> Scorer:
        loaded: dict[str, Scorer] = vars(_loaded)
        if self.key not in loaded:
            _drop_oldest(loaded)
            loaded[self.key] = self._load()
        return loaded[self.key]

    def _load(self) -> Scorer:
        try:
            payload = _given[self.key] if self.payload is None else self.payload
            source: Registered | Scorer = pickle.loads(payload)
            return source.build() if isinstance(source, Registered) else source
        except Exception as error:
            raise WorkerError(
                f"A worker process could not load the problem ({type(error).__name__}: {error}). "
                "Define it at the module level of an importable file, or use workers=1."
            ) from error


_MOST_WARNINGS, _LONGEST_WARNING = 10, 500
_said: set[str] = set()
"""The warnings that this worker has sent."""
_given: dict[str, bytes] = {}
"""The last payloads that this process received, when it started or later, by key."""

_giving = threading.Lock()


_loaded = threading.local()
"""The scorers that this thread has loaded, by key. Threads seldom can share a simulator."""


def _drop_oldest(kept: dict[str, Any]) -> None:
    """Make room for one more entry."""
    while len(kept) >= _CACHE_SIZE:
        oldest = kept.pop(next(iter(kept)))
        if isinstance(oldest, Application):
            oldest.close()


def evaluate_if_known(
    task: PortableScorer, mu: Mu, seeds: Sequence[int]
) -> npt.NDArray[np.float64] | None:
    """Evaluate one chunk in a process that may have seen the task before.

    This lets a large model cross the network once for each process, not with every chunk.

    Args:
        task: The task. This process keeps its payload; a task without one must have come before.
        mu: (n, d) float32, checked.
        seeds: n evaluation seeds.

    Returns:
        (n,) float64, or None if this process lacks the payload and must get it first.
    """
    with _giving:
        if task.payload is not None and task.key not in _given:
            _drop_oldest(_given)
            _given[task.key] = task.payload
        known = task.payload is not None or task.key in _given or task.key in vars(_loaded)
    return task(mu, seeds) if known else None


class WorkerPool:
    """A process pool whose workers leave Ctrl-C to the parent and never outlive it.

    Each worker computes in one thread and watches a pipe that only the parent holds open: when
    the parent closes it, or dies in whatever way, the worker exits at once.

    Args:
        workers: The number of processes, which start at once.
        task: The task that they will evaluate, if any. It is sent once, not with every chunk.
    """

    def __init__(self, workers: int, task: PortableScorer | None = None) -> None:
        context = spawn_context()
        watched, self._lifeline = context.Pipe(duplex=False)
        self._heard: SimpleQueue[tuple[type[Warning], str]] = context.SimpleQueue()
        self.executor = ProcessPoolExecutor(
            workers,
            mp_context=context,
            initializer=_initialise,
            initargs=(watched, task, self._heard),
        )
        before = set(active_children())
        with inherited_settings():
            for _ in range(workers):
                self.executor.submit(_nothing)
        self._processes = set(active_children()) - before

    @property
    def failed_to_start(self) -> bool:
        """Whether a process raised an exception as it started. Another one would do the same."""
        return any(process.exitcode == 1 for process in self._processes)

    def warnings(self) -> Iterator[tuple[type[Warning], str]]:
        """Give the category and the text of each warning that the workers sent since the last call.

        They come before the scores of the chunk in which they arose.
        """
        while not self._heard.empty():
            yield self._heard.get()

    def close(self, *, now: bool = False) -> None:
        """Stop the workers; calling it twice is fine.

        Args:
            now: Whether to drop the running chunks instead of waiting for them.
        """
        # the pool first: one that finds its processes gone fails all futures that it holds, and
        # raises at those that its caller has cancelled
        self.executor.shutdown(wait=not now, cancel_futures=True)
        self._lifeline.close()
        for process in self._processes:
            process.join(_DYING_S)


@contextmanager
def inherited_settings() -> Iterator[None]:
    """Give processes that start here one thread each, and block SIGINT from the beginning.

    Both must stand before the interpreter starts: NumPy reads the variables when it is imported,
    and a Ctrl-C during start-up would print a traceback for each worker.
    """
    masks = hasattr(signal, "pthread_sigmask")
    with environment_variables(dict.fromkeys(_THREADS, "1")):
        if masks:
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            if masks:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _initialise(
    lifeline: Connection,
    task: PortableScorer | None,
    told: SimpleQueue[tuple[type[Warning], str]],
) -> None:
    if task is not None and task.payload is not None:
        _given[task.key] = task.payload
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.showwarning = partial(_tell, told)  # the parent shows it once, not each worker
    threading.Thread(target=_exit_with_parent, args=(lifeline,), daemon=True).start()


def _tell(
    told: SimpleQueue[tuple[type[Warning], str]],
    message: Warning | str,
    category: type[Warning],
    *_: Any,
) -> None:
    # a full pipe would stop the worker until the parent reads it, which waits for the worker
    if len(_said) < _MOST_WARNINGS and str(message) not in _said:
        _said.add(str(message))
        # the parent may be unable to import the category of another library
        known = category if category.__module__ == "builtins" else UserWarning
        told.put((known, str(message)[:_LONGEST_WARNING]))


def _exit_with_parent(lifeline: Connection) -> None:
    lifeline.poll(None)  # nothing is ever sent: this returns when the other end is closed
    os._exit(1)


def _nothing() -> None:
    """Do nothing, so that the pool starts a process."""

"""Starting processes that import nothing from the current folder.

Python starts a spawned process, and the one that keeps track of semaphores, with `python -c`. That
searches the current folder first: a `socket.py` there would run in place of Python's own. Once it
runs, a process has the module path of its parent, as always.
"""

from __future__ import annotations

import multiprocessing.util
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import spawn
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from sada_gym.foundations.environment_variables import environment_variables

_SAFE_PATH = "PYTHONSAFEPATH"
_lock = threading.RLock()


class _Process(SpawnProcess):
    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._inherited = _SAFE_PATH in os.environ

    @staticmethod
    def _Popen(process_obj: Any) -> Any:  # noqa: N802 - multiprocessing calls it so
        with _safe_path():
            return SpawnProcess._Popen(process_obj)

    def run(self) -> None:
        if not self._inherited:  # a script that the work starts finds its own folder, as always
            os.environ.pop(_SAFE_PATH, None)
        super().run()


class _Context(SpawnContext):
    Process = _Process


@contextmanager
def without_main() -> Iterator[None]:
    """Let processes that start in this block not run the parent's script as a module.

    They get what they need by value. So a script needs no `if __name__ == "__main__":`.
    """
    prepare = spawn.get_preparation_data

    def prepare_without(name: str) -> dict[str, object]:
        prepared = prepare(name)
        return {key: value for key, value in prepared.items() if not key.startswith("init_main")}

    with _lock:
        spawn.get_preparation_data = prepare_without
        try:
            yield
        finally:
            spawn.get_preparation_data = prepare


def spawn_context() -> SpawnContext:
    """Return a context for executors and queues whose processes start safely."""
    if os.name == "posix":
        from multiprocessing.resource_tracker import ensure_running

        with _safe_path():
            ensure_running()  # otherwise the first queue starts it
    return _Context()


@contextmanager
def _safe_path() -> Iterator[None]:
    """Keep the current folder off the module path of interpreters that start in this block."""
    safe = {_SAFE_PATH: os.environ.get(_SAFE_PATH) or "1"}
    with _lock, environment_variables(safe) if sys.version_info >= (3, 11) else _program():
        yield


@contextmanager
def _program() -> Iterator[None]:
    """Do the same on Python 3.10, which lacks the variable, by the program of `python -c`."""
    util: Any = multiprocessing.util
    start = util.spawnv_passfds

    def start_safely(path: str, command: Sequence[Any], descriptors: Sequence[int]) -> Any:
        words = list(command)
        script = words.index("-c") + 1
        words[script] = f"import sys; del sys.path[0]; {words[script]}"
        return start(path, words, descriptors)

    util.spawnv_passfds = start_safely
    try:
        yield
    finally:
        util.spawnv_passfds = start

"""How workers report their progress to the benchmark, and the benchmark to its caller.

Workers that can read the benchmark's folder write one small file for each run there. The folder
also holds a token, new with each call of the benchmark. A worker that finds the token sees the
folder; one that later finds another token, or none, knows that nobody waits for its run.
"""

from __future__ import annotations

import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from sada_gym.board.benchmark.entries import Missing
from sada_gym.board.benchmark.folder import Timing, store_file
from sada_gym.board.benchmark.plan import BenchmarkPlan
from sada_gym.experiment.algorithm import RunProgress
from sada_gym.experiment.record import RunSettings

_FOLDER = ".progress"
_TOKEN = "token"
_EVERY_S = 0.5


class BenchmarkCallback:
    """Receives the progress of a benchmark, always in the caller's own thread.

    The methods do nothing; override those that you need.
    """

    def on_start(self, plan: BenchmarkPlan, missing: Missing) -> None:
        """Receive the plan, and the runs of it that are still to be made."""

    def on_progress(self, run: RunSettings, progress: RunProgress) -> None:
        """Receive a run's progress, if its worker can read the benchmark's folder."""

    def on_finish(self, run: RunSettings, timing: Timing) -> None:
        """Receive a finished run, which is already in its entry, and how long it took."""

    def on_report(self) -> None:
        """All runs are finished; the report is written next."""


class Abandoned(RuntimeError):  # noqa: N818 - reads as what happened
    """The benchmark that wanted a run has ended."""


@contextmanager
def progress_folder(out: Path) -> Iterator[str]:
    """Make the folder of progress for as long as the benchmark works, and give its token."""
    folder = out / _FOLDER
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    token = uuid.uuid4().hex
    _write(folder / _TOKEN, token)
    try:
        yield token
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def can_read(out: Path, token: str) -> bool:
    """Say whether this process sees the folder of the benchmark that made the token."""
    try:
        return (out / _FOLDER / _TOKEN).read_text() == token
    except OSError:
        return False


class ProgressFile:
    """Writes a run's progress, at most twice a second, or when a stage first begins."""

    def __init__(self, out: Path, token: str, run: RunSettings) -> None:
        self._out, self._token, self._run = out, token, run
        self._stages: set[str] = set()
        self._written = 0.0

    def __call__(self, progress: RunProgress) -> None:
        """Write the progress, if half a second has passed; `Abandoned` if the benchmark ended."""
        if progress.stage in self._stages and time.monotonic() - self._written < _EVERY_S:
            return
        if not can_read(self._out, self._token):
            raise Abandoned(f"The benchmark that wanted {self._run} has ended.")
        path = _file(self._out, self._run)
        _write(path, json.dumps({"run": str(self._run), **asdict(progress)}))
        self._stages.add(progress.stage)
        self._written = time.monotonic()


def read_progress(out: Path, run: RunSettings) -> RunProgress | None:
    """Read the progress that a run's worker wrote last; None where it wrote none yet."""
    try:
        content = json.loads(_file(out, run).read_text())
    except (OSError, ValueError):
        return None
    return RunProgress(**content) if content.pop("run") == str(run) else None


def _file(out: Path, run: RunSettings) -> Path:
    # one file for each group: its runs follow one another
    return out / _FOLDER / f"{store_file(out, run.experiment.target, run.seed).stem}.json"


def _write(path: Path, text: str) -> None:
    beside = path.with_name(f"{path.name}.{os.getpid()}")
    beside.write_text(text)
    beside.replace(path)  # no reader ever finds half a file

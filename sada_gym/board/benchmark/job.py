"""One run of a benchmark as a job: plain data goes to a worker, plain data comes back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from sada_gym import adversaries
from sada_gym.analyses.plots.novelty import novelty_sheet
from sada_gym.analyses.plots.style import png
from sada_gym.board.benchmark.folder import RunDone, Timing, store_file
from sada_gym.board.benchmark.plan import RunGroup
from sada_gym.board.benchmark.progress import Abandoned, ProgressFile, can_read
from sada_gym.errors import AdversaryError, StoreError, StoreInUse, WorkerError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.experiment.algorithm import Algorithm1, OnProgress, ignore_progress
from sada_gym.experiment.ideal import IDEAL
from sada_gym.experiment.record import RunFailure, RunReport, RunSettings
from sada_gym.experiment.target import OpenTarget

_PATIENCE_S = 60.0


class RunError(RuntimeError):
    """A bug in an adversary or an application stopped a run."""


@dataclass(frozen=True, eq=False)
class RunJob:
    """A run as a worker gets it, with the group that it belongs to.

    Attributes:
        workers: The number of processes that evaluate; 1 evaluates in the worker's own.
        out: The benchmark's folder. The worker may be on a machine that lacks it.
        token: The content of the folder's token, see `sada_gym.board.benchmark.progress`.
        stored: The bytes of the group's store, for a worker that doesn't see the folder.
    """

    settings: RunSettings
    group: RunGroup
    workers: int
    out: Path
    token: str
    stored: bytes | None


def do_run(job: RunJob) -> RunDone:
    """Do a run, in whatever process or thread.

    Raises:
        RunError: If an adversary or an application raised anything but an `AdversaryError`.
        StoreError: If the group's store cannot serve.
        WorkerError: If a process that evaluates died.
        Abandoned: If the benchmark that wanted the run has ended.
    """
    visible = can_read(job.out, job.token)
    on_progress = ProgressFile(job.out, job.token, job.settings) if visible else ignore_progress
    evaluator = _evaluator(job)
    try:
        with _store(evaluator, job, visible):
            return _do(job, evaluator, on_progress, keep=not visible)
    except BaseException as error:
        _forget()
        if isinstance(error, (StoreError, WorkerError, Abandoned)) or not isinstance(
            error, Exception
        ):
            raise
        raise RunError(f"{type(error).__name__} in {job.settings}: {error}") from error


def _do(job: RunJob, evaluator: Evaluator, on_progress: OnProgress, *, keep: bool) -> RunDone:
    settings, group, spec = job.settings, job.group, job.settings.experiment.adversary
    started, worked = time.monotonic(), time.process_time()
    _forget_peak_memory()
    adversary = spec.make(evaluator.dimension, seed=settings.seed, ideal_set=group.ideal_set)
    run = Algorithm1(
        settings,
        adversary,
        evaluator,
        fooling_set=group.fooling_set,
        ideal_set=group.ideal_set,
        on_progress=on_progress,
    )
    result: RunReport | RunFailure
    picture = None
    try:
        run.train()
        run.test()
    except AdversaryError as error:
        result = RunFailure(settings=settings, error=str(error))
    else:
        result = run.measure()
        if run.images is not None:
            picture = png(novelty_sheet(*run.images))
    return RunDone(
        result=result,
        timing=Timing(
            training_s=round(run.process_s - run.evaluation_s, 3),
            evaluation_s=round(run.evaluation_s, 3),
            evaluated=run.evaluated,
            known=run.cached,
            wall_s=round(time.monotonic() - started, 3),
            core_s=round(time.process_time() - worked, 3),
            peak_memory_mib=_peak_memory_mib(),
        ),
        samples=run.samples if isinstance(result, RunReport) else None,
        picture=picture,
        evaluations=run.evaluations if keep else (),
    )


_kept = threading.local()
"""The open target of this thread's last run: the next one mostly attacks the same."""


def _evaluator(job: RunJob) -> Evaluator:
    wanted = job.group.target, job.workers
    if vars(_kept).get("wanted") != wanted:
        _forget()
        for name in {run.experiment.adversary.name for run in job.group.runs} - {IDEAL}:
            adversaries.resolve(name, {})  # all modules are loaded now, not hours later
        _kept.target, _kept.wanted = job.group.target.open(workers=job.workers), wanted
    target: OpenTarget = _kept.target
    return target.evaluator


def _forget() -> None:
    target: OpenTarget | None = vars(_kept).pop("target", None)
    vars(_kept).clear()
    if target is not None:
        target.close(now=True)


@contextmanager
def _store(evaluator: Evaluator, job: RunJob, visible: bool) -> Iterator[None]:
    """Open the group's store, or a copy of it where the worker doesn't see the folder."""
    with TemporaryDirectory(prefix="sada-gym-") as copies:
        path = store_file(job.out, job.group.target, job.group.seed)
        if not visible:
            path = Path(copies) / path.name
            if job.stored is not None:
                path.write_bytes(job.stored)
        path.parent.mkdir(parents=True, exist_ok=True)
        _attach(evaluator, path)
        try:
            yield
        finally:
            evaluator.detach()


def _attach(evaluator: Evaluator, path: Path) -> None:
    """Open a store; wait for a process of a killed run that is still about to end."""
    end = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return evaluator.attach(path)
        except StoreInUse:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def _forget_peak_memory() -> None:
    """Let the system measure the peak anew, where it can (Linux)."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak_memory_mib() -> int | None:
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return None
    peaks = [line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")]
    return int(peaks[0]) // 1024 if peaks else None

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
from sada_gym.application import Application
from sada_gym.benchmark.folder import Timing, store_file
from sada_gym.benchmark.progress import Abandoned, ProgressFile, can_read
from sada_gym.errors import AdversaryError, StoreError, StoreInUse, WorkerError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Evaluations
from sada_gym.evaluation.store import Context
from sada_gym.parameters import Mu
from sada_gym.plots.novelty import novelty_sheet
from sada_gym.plots.style import png
from sada_gym.runs.assemble import make_adversary
from sada_gym.runs.ideal import IDEAL
from sada_gym.runs.record import RunFailure, RunReport, RunSettings
from sada_gym.runs.run import OnProgress, Run, RunContext, ignore_progress

_PATIENCE_S = 60.0


class RunError(RuntimeError):
    """A run could not be made because of a bug: neither the store nor the adversary refused."""


@dataclass(frozen=True, eq=False)
class RunJob:
    """A run as a worker gets it.

    Attributes:
        settings: The settings of the run.
        keywords: The environment's keywords that name the agent.
        fooling_set: The points that coverage is measured by, see `RunContext`.
        ideal_set: The points that ideal samples are drawn from, see `RunContext`.
        workers: The number of processes that evaluate; 1 evaluates in the worker's own.
        adversaries: The names of all adversaries of the group, whose modules are loaded at once.
        out: The benchmark's folder. The worker may be on a machine that lacks it.
        token: The content of the folder's token, see `sada_gym.benchmark.progress`.
        stored: The bytes of the group's store, for a worker that doesn't see the folder.
    """

    settings: RunSettings
    keywords: dict[str, str]
    fooling_set: Mu | None
    ideal_set: Mu | None
    workers: int
    adversaries: tuple[str, ...]
    out: Path
    token: str
    stored: bytes | None = None


@dataclass(frozen=True, eq=False)
class RunDone:
    """A finished run as a worker gives it back.

    Attributes:
        result: The run's report, or why it failed.
        timing: The time and memory that it took.
        samples: Its test samples; None after a failure.
        picture: The comparison of images as a PNG, if there is one.
        context: What its scores belong to.
        evaluations: The evaluations that the group's store still lacks; none where the worker had
            it open.
    """

    result: RunReport | RunFailure
    timing: Timing
    samples: Evaluations | None
    picture: bytes | None
    context: Context
    evaluations: tuple[Evaluations, ...]


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
            done = _do(job, evaluator, on_progress, keep=not visible)
    except BaseException as error:
        _forget()
        if isinstance(error, (StoreError, WorkerError, Abandoned)) or not isinstance(
            error, Exception
        ):
            raise
        raise RunError(f"{type(error).__name__} in {job.settings}: {error}") from error
    return done


def _do(job: RunJob, evaluator: Evaluator, on_progress: OnProgress, *, keep: bool) -> RunDone:
    settings, application = job.settings, _application(evaluator)
    context = RunContext(
        evaluator, application, job.fooling_set, job.ideal_set, on_progress=on_progress
    )
    started = time.monotonic()
    _forget_peak_memory()
    adversary = make_adversary(
        settings.adversary,
        evaluator.dimension,
        seed=settings.seed,
        preset=settings.preset,
        options=settings.options,
        ideal_set=job.ideal_set,
    )
    run = Run(settings, adversary, context)
    result: RunReport | RunFailure
    picture = None
    try:
        run.train()
        run.test()
    except AdversaryError as error:
        threshold = float(application.fooling_threshold)
        result = RunFailure(settings=settings, fooling_threshold=threshold, error=str(error))
    else:
        result = run.measure()
        if run.images is not None:
            picture = png(novelty_sheet(run.images.ours, run.images.ideal))
    return RunDone(
        result=result,
        timing=_timing(run, time.monotonic() - started),
        samples=run.samples if isinstance(result, RunReport) else None,
        picture=picture,
        context=Context.of(application),
        evaluations=run.evaluations if keep else (),
    )


def _timing(run: Run, wall_s: float) -> Timing:
    return Timing(
        training_s=round(run.process_s - run.evaluation_s, 3),
        evaluation_s=round(run.evaluation_s, 3),
        evaluated=run.evaluated,
        known=run.known,
        wall_s=round(wall_s, 3),
        peak_memory_mib=_peak_memory_mib(),
    )


class _Kept(threading.local):
    """The evaluator of this thread's last run: the next one is mostly on the same track."""

    def __init__(self) -> None:
        self.key: tuple[object, ...] | None = None
        self.evaluator: Evaluator | None = None


_kept = _Kept()


def _evaluator(job: RunJob) -> Evaluator:
    key = (job.settings.track, tuple(sorted(job.keywords.items())), job.workers)
    if _kept.evaluator is None or _kept.key != key:
        _forget()
        for name in job.adversaries:  # all modules are loaded now, not hours later
            if name != IDEAL:
                adversaries.resolve(name, {})
        _kept.evaluator = Evaluator(
            job.settings.track, env_kwargs=job.keywords, workers=job.workers
        )
        _kept.key = key
    return _kept.evaluator


def _forget() -> None:
    evaluator, _kept.evaluator, _kept.key = _kept.evaluator, None, None
    if evaluator is not None:
        evaluator.close(now=True)


def _application(evaluator: Evaluator) -> Application:
    application = evaluator.application
    assert application is not None
    return application


@contextmanager
def _store(evaluator: Evaluator, job: RunJob, visible: bool) -> Iterator[None]:
    """Open the group's store, or a copy of it where the worker doesn't see the folder."""
    with TemporaryDirectory(prefix="sada-gym-") as copies:
        path = store_file(job.out, job.settings)
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
            evaluator.attach(path)
        except StoreInUse:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)
        else:
            return


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

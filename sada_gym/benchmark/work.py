"""The work on one group, in a process of its own: every cell that is missing, one by one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.queues import SimpleQueue
from pathlib import Path

from sada_gym.benchmark.cell import Bench, CellWork, Told
from sada_gym.benchmark.folder import store_file
from sada_gym.benchmark.plan import Group
from sada_gym.benchmark.suite import IDEAL
from sada_gym.errors import StoreError, WorkerError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.measures.reference import load_reference

_PATIENCE_S = 60.0


@dataclass(frozen=True)
class Job:
    """A group to work on.

    Attributes:
        group: What it is, with only those cells that are missing.
        out: The benchmark's folder.
        references: Where the reference sets lie.
        workers: Processes that evaluate.
    """

    group: Group
    out: Path
    references: Path
    workers: int


class CellError(RuntimeError):
    """A cell could not be made for a reason that is a bug: neither bad input nor the store's."""


_channel: SimpleQueue[Told] | None = None
"""Where this process tells of its work."""


def connect(channel: SimpleQueue[Told]) -> None:
    """Let this process tell of its work from now on; called when it starts."""
    global _channel
    _channel = channel


def work(job: Job) -> None:
    """Work on a group in a process that is connected, see `work_on`."""
    assert _channel is not None
    work_on(job, _channel.put)


def work_on(job: Job, tell: Callable[[Told], None]) -> None:
    """Make the cells of a group; each is in place whole or not at all.

    Raises:
        CellError: If an adversary raised anything but a ValueError.
        StoreError: If the group's store cannot serve.
        WorkerError: If one of its own processes died.
    """
    group = job.group
    for cell in group.cells:  # all modules are loaded now, not hours later
        if cell.adversary != IDEAL:
            cell.contender.make(1, seed=0)
    evaluator = Evaluator(group.track, env_kwargs=group.keywords, workers=job.workers)
    try:
        _attach(evaluator, store_file(job.out, group))
        application = evaluator.application
        assert application is not None
        reference = load_reference(group.track, application, job.references)
        mark = group.cells[0].reference
        usable = reference is not None and mark is not None and mark.usable
        to_cover, to_draw = reference.halves() if reference is not None and usable else (None, None)
        bench = Bench(job.out, evaluator, application, to_cover, to_draw, tell)
        for cell in group.cells:
            try:
                CellWork(bench, cell).make()
            except (StoreError, WorkerError):
                raise
            except Exception as error:
                raise CellError(f"{type(error).__name__} in {cell}: {error}") from error
    finally:
        evaluator.close(now=True)


def _attach(evaluator: Evaluator, path: Path) -> None:
    """Open the group's store; wait for a process of a killed run that is still about to end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + _PATIENCE_S
    while True:
        try:
            evaluator.attach(path)
        except StoreError as error:
            if "another run has it open" not in str(error) or time.monotonic() > end:
                raise
            time.sleep(0.2)
        else:
            return

"""Shows the progress of a benchmark: runs, rate, time left, and what each process does."""

from __future__ import annotations

import threading
import time
from collections import deque

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn

from sada_gym.board.benchmark.entries import Missing
from sada_gym.board.benchmark.folder import Timing
from sada_gym.board.benchmark.plan import BenchmarkPlan
from sada_gym.board.benchmark.progress import BenchmarkCallback
from sada_gym.board.benchmark.tables import short_name
from sada_gym.cli.console import say
from sada_gym.experiment.algorithm import RunProgress
from sada_gym.experiment.progress import COMPILING, Display, clock, will_compile
from sada_gym.experiment.record import RunSettings

_WINDOW_S = 30.0

_Group = tuple[str, str, int]


class BenchmarkProgress(Display, BenchmarkCallback):
    """A context manager that shows a benchmark's progress: pass it on as `callback`.

    Where the output is not a terminal, it prints a line for each finished run and one every half
    minute.
    """

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._bars = self._live = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.fields[detail]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self.finished = 0
        self._total = self._parallel = 0
        self._left: list[RunSettings] = []
        self._took: dict[tuple[str, str], list[float]] = {}
        self._all: TaskID | None = None
        self._tasks: dict[_Group, TaskID] = {}
        self._doing: dict[_Group, str] = {}
        self._evaluated: dict[_Group, int] = {}  # by each group's current run
        self._recent: deque[tuple[float, int]] = deque()
        self._lock = threading.RLock()  # another thread calls `_line`

    def on_start(self, plan: BenchmarkPlan, missing: Missing) -> None:
        """Show how many runs are missing."""
        self._total = sum(1 for _ in plan.runs)
        self.finished, self._left = self._total - len(missing.runs), list(missing.runs)
        say(describe_missing(missing), console=self._console)
        detail = COMPILING if missing.runs and will_compile() else "starting"
        self._all = self._bars.add_task(
            "Runs", total=self._total, completed=self.finished, detail=detail
        )
        if detail == COMPILING:
            self._print(COMPILING)

    def on_progress(self, run: RunSettings, progress: RunProgress) -> None:
        """Show how far a run is."""
        with self._lock:
            self._count(run, progress.evaluated)
            counts = f" {progress.done:,}/{progress.total:,}" if progress.total else ""
            detail = f"{run.label} ({run.key.table}): {progress.stage}{counts}"
            self._doing[_group(run)] = f"{short_name(run.key.track)} seed {run.seed}, {detail}"
            self._bars.update(self._task(run), detail=detail)
            self._refresh()

    def on_finish(self, run: RunSettings, timing: Timing) -> None:
        """Show that a run is finished."""
        with self._lock:
            task, group = self._task(run), _group(run)
            self._count(run, timing.evaluated)
            self._evaluated.pop(group)
            self.finished += 1
            self._left.remove(run)
            self._took.setdefault((run.key.table, run.label), []).append(timing.wall_s)
            self._bars.advance(task)
            self._doing.pop(group, None)
            if not any(_group(other) == group for other in self._left):
                self._bars.remove_task(task)
                del self._tasks[group]
            counts = f"{self.finished}/{self._total} runs"
            self._print(f"{counts}: {run}, {clock(timing.wall_s)}; {self._outlook()}")
            self._refresh()

    def _task(self, run: RunSettings) -> TaskID:
        group = _group(run)
        if group not in self._tasks:
            runs = sum(1 for other in self._left if _group(other) == group)
            name = f"{short_name(run.key.track)} {run.key.agent}".strip() + f" seed {run.seed}"
            self._tasks[group] = self._bars.add_task(name, total=runs, detail="")
        return self._tasks[group]

    def _count(self, run: RunSettings, evaluated: int) -> None:
        before = self._evaluated.get(_group(run), 0)
        # a run that is repeated because its process died counts from 0
        self._recent.append((time.monotonic(), max(0, evaluated - before)))
        self._evaluated[_group(run)] = evaluated

    def _refresh(self) -> None:
        assert self._all is not None
        self._bars.update(self._all, completed=self.finished, detail=self._outlook())

    def _line(self) -> str:
        with self._lock:
            idle = "starting" if self._left else "writing the report"
            doing = "; ".join(self._doing.values()) or idle
            return f"{self.finished}/{self._total} runs, {self._outlook()}: {doing}"

    def _outlook(self) -> str:
        # the time left follows from the duration of the runs so far
        now = time.monotonic()
        while self._recent and self._recent[0][0] < now - _WINDOW_S:
            self._recent.popleft()
        span = max(now - self._recent[0][0], 1.0) if self._recent else 1.0
        rate = sum(count for _, count in self._recent) / span
        parts = [f"{rate:,.0f} queries/s" if rate >= 10 else f"{rate:.1f} queries/s"]
        if self._took and self._left:
            self._parallel = max(self._parallel, len(self._tasks))
            side_by_side = min(self._parallel, len({_group(run) for run in self._left}))
            means = {key: sum(took) / len(took) for key, took in self._took.items()}
            mean = sum(means.values()) / len(means)
            left = sum(means.get((run.key.table, run.label), mean) for run in self._left)
            parts.append(f"about {clock(left / max(1, side_by_side))} left")
        return ", ".join(parts)

    def on_report(self) -> None:
        """Show that the report is being written."""
        if self._all is not None:
            self._bars.update(self._all, completed=self._total, detail="writing the report")


def describe_missing(missing: Missing) -> str:
    """Return a sentence on how many results are missing and how many are outdated."""
    if not missing.runs:
        return "No result is missing."
    runs = "One run" if len(missing.runs) == 1 else f"{len(missing.runs):,} runs"
    lacking = "one result is" if missing.lacking == 1 else f"{missing.lacking:,} results are"
    outdated = "one is" if missing.outdated == 1 else f"{missing.outdated:,} are"
    return (
        f"{runs} to do: {lacking} missing or incomplete, {outdated} outdated and will be repeated."
    )


def _group(run: RunSettings) -> _Group:
    return run.key.track, run.key.agent, run.seed

"""How far a benchmark is: cells, rate, time left, and what each process does."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn
from typing_extensions import Self

from sada_gym.benchmark.cell import Told
from sada_gym.benchmark.plan import CellKey, CellSettings, Plan
from sada_gym.benchmark.tables import short_name
from sada_gym.cli.console import say
from sada_gym.cli.kernels import COMPILING, will_compile
from sada_gym.cli.progress import Ticker, clock

_WINDOW_S = 30.0

_Group = tuple[str, str, int]


class BenchmarkProgress:
    """A context manager that shows a benchmark's progress; pass it on as `listener`.

    Where the output is no terminal, each finished cell gets a line instead, and so does every half
    minute.

    Args:
        console: Where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bars = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.completed:.0f}/{task.total:.0f}  {task.fields[detail]}"),
            console=console,
            disable=not console.is_terminal,
        )
        self._done = self._total = self._parallel = 0
        self._left: list[CellSettings] = []
        self._took: dict[tuple[str, str], list[float]] = {}
        self._all: TaskID | None = None
        self._tasks: dict[_Group, TaskID] = {}
        self._doing: dict[_Group, str] = {}
        self._recent: deque[tuple[float, int]] = deque()
        self._lock = threading.RLock()  # the ticker's thread reads what the other one writes
        self._ticker = Ticker(console, self._show_line)

    def __enter__(self) -> Self:
        """Start showing."""
        self._bars.start()
        self._ticker.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop showing."""
        self._ticker.__exit__(kind, error, traceback)
        self._bars.stop()

    def begin(self, plan: Plan, missing: Sequence[CellSettings]) -> None:
        """Show what there is to do."""
        self._total = sum(1 for _ in plan.cells)
        self._done, self._left = self._total - len(missing), list(missing)
        detail = COMPILING if missing and will_compile() else "starting"
        self._all = self._bars.add_task(
            "Cells", total=self._total, completed=self._done, detail=detail
        )
        if detail == COMPILING and not self._console.is_terminal:
            say("", COMPILING, console=self._console)

    def hear(self, told: Told) -> None:
        """Show what a process does."""
        with self._lock:
            self._hear(told)

    def _hear(self, told: Told) -> None:
        assert self._all is not None
        self._recent.append((time.monotonic(), told.new))
        group = _group(told.cell)
        if group not in self._tasks:
            cells = sum(1 for cell in self._left if _group(cell) == group)
            name = " ".join((short_name(told.cell.track), told.cell.agent)).strip()
            text = f"{name} seed {told.cell.seed}"
            self._tasks[group] = self._bars.add_task(text, total=cells, detail="")
        if told.wall_s is None:
            counts = f" {told.done:,}/{told.total:,}" if told.total else ""
            detail = f"{told.cell.label} ({told.cell.table}): {told.stage}{counts}"
            self._doing[group] = f"{short_name(told.cell.track)} seed {told.cell.seed}, {detail}"
            self._bars.update(self._tasks[group], detail=detail)
        else:
            self._finished(told, told.wall_s, self._tasks[group])
        self._bars.update(self._all, completed=self._done, detail=self._outlook())

    def _finished(self, told: Told, wall_s: float, task: TaskID) -> None:
        self._done += 1
        self._left.remove(told.cell)
        self._took.setdefault((told.cell.table, told.cell.label), []).append(wall_s)
        self._bars.advance(task)
        self._doing.pop(_group(told.cell), None)
        if not any(_group(cell) == _group(told.cell) for cell in self._left):
            self._bars.remove_task(task)
            del self._tasks[_group(told.cell)]
        if not self._console.is_terminal:
            outlook = self._outlook()
            line = f"{self._done}/{self._total} cells: {told.cell}, {clock(wall_s)}; {outlook}"
            say("", line, console=self._console)

    def _show_line(self) -> None:
        """Print one line on all that is done now."""
        with self._lock:
            doing = "; ".join(self._doing.values()) or "starting"
            line = f"{self._done}/{self._total} cells, {self._outlook()}: {doing}"
        say("", line, console=self._console)

    def _outlook(self) -> str:
        """The rate of evaluations, and the time left as the cells so far tell."""
        now = time.monotonic()
        while self._recent and self._recent[0][0] < now - _WINDOW_S:
            self._recent.popleft()
        span = max(now - self._recent[0][0], 1.0) if self._recent else 1.0
        rate = sum(count for _, count in self._recent) / span
        parts = [f"{rate:,.0f} queries/s" if rate >= 10 else f"{rate:.1f} queries/s"]
        if self._took and self._left:
            self._parallel = max(self._parallel, len(self._tasks))
            side_by_side = min(self._parallel, len({_group(cell) for cell in self._left}))
            means = {key: sum(took) / len(took) for key, took in self._took.items()}
            usual = sum(means.values()) / len(means)
            left = sum(means.get((cell.table, cell.label), usual) for cell in self._left)
            parts.append(f"about {clock(left / max(1, side_by_side))} left")
        return ", ".join(parts)

    def finish(self) -> None:
        """Show that the report is being written."""
        if self._all is not None:
            self._bars.update(self._all, completed=self._total, detail="writing the report")


def _group(cell: CellKey) -> _Group:
    return cell.track, cell.agent, cell.seed

"""The attack's progress on the terminal: queries with rate and time left, training, test."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    ProgressColumn,
    SpinnerColumn,
    Task,
    TaskID,
    TextColumn,
)
from rich.progress import (
    Progress as RichProgress,
)
from rich.text import Text
from typing_extensions import Self

from sada_gym.attack import Progress, Stage


class Bars:
    """A context manager that shows bars while it is open."""

    _bars: RichProgress

    def __enter__(self) -> Self:
        """Start showing."""
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop showing."""
        self._bars.stop()


class AttackBars(Bars):
    """A context manager that shows an attack's progress; pass it to `attack` as `on_progress`.

    Args:
        console: Where to.
        adversary: The adversary's name.
    """

    def __init__(self, console: Console, adversary: str) -> None:
        self._bars = RichProgress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=28),
            _Detail(),
            console=console,
        )
        self._adversary = adversary
        self._tasks: dict[Stage, TaskID] = {}
        self._learning: TaskID | None = None

    def __call__(self, progress: Progress) -> None:
        """Show how far a stage is."""
        if progress.stage not in self._tasks:
            self._begin(progress.stage, progress.total)
        task = self._tasks[progress.stage]
        self._bars.update(task, completed=progress.done, known=progress.known)

    def _begin(self, stage: Stage, total: int) -> None:
        descriptions: dict[Stage, str] = {
            "training": "Queries",
            "testing": "Test samples",
            "measuring": "Measures",
            "drawing": "Pictures",
        }
        if stage != "training" and self._learning is not None:
            self._bars.update(self._learning, total=1, completed=1)
        self._tasks[stage] = self._bars.add_task(descriptions[stage], total=total or 1, known=0)
        if stage == "training":
            self._learning = self._bars.add_task(f"Training {self._adversary}", total=None)


class _Detail(ProgressColumn):
    """Counts, rate and time left; for what cannot be counted, the time spent."""

    def render(self, task: Task) -> Text:
        """Write one task's detail."""
        if task.total is None or task.total == 1:
            return Text(f"{clock(task.elapsed)} spent" if task.elapsed else "", style="dim")
        parts = [f"{task.completed:,.0f}/{task.total:,.0f}"]
        if speed := task.finished_speed or task.speed:
            parts.append(f"{speed:,.0f}/s" if speed >= 10 else f"{speed:.2g}/s")
        if not task.finished and task.time_remaining is not None:
            parts.append(f"{clock(task.time_remaining)} left")
        if task.fields["known"]:
            parts.append(f"{task.fields['known']:,} known from the store")
        return Text("  ".join(parts))


def clock(seconds: float | None) -> str:
    """Write a time span as h:mm:ss, or m:ss where it is shorter than an hour."""
    whole = int(seconds or 0)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"

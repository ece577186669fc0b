"""Shows progress on a console: bars on a terminal, elsewhere a line every half minute."""

from __future__ import annotations

import re
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.live import Live
from rich.progress import Progress
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text
from typing_extensions import Self

from sada_gym.experiment.algorithm import RunProgress, Stage

COMPILING = "Compiling kernels for the first run (about a minute)"
LINE_EVERY_S = 30.0
_KERNEL = re.compile(r"^@(kernel|uncounted)$|\b(kernel|uncounted)\(", re.MULTILINE)

_NAMES: dict[Stage, str] = {
    "train": "Querying",
    "learn": "Learning",
    "sample": "Sampling",
    "test": "Testing",
    "measure": "Measuring",
    "diagnose": "Diagnosing",
    "confirm": "Confirming",
    "pictures": "Pictures",
}
_STEPS: tuple[Stage, ...] = ("learn", "pictures")
"""The stages that count steps or frames, not evaluations."""

_BAR_WIDTH = 28
_LEAST_BAR = 8
_BESIDE_BAR = 66  # columns that the rest of a line takes


class Display:
    """A context manager that shows progress: live on a terminal, elsewhere by lines."""

    _live: Live | Progress  # what a terminal shows

    def __init__(self, console: Console) -> None:
        self._console = console
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._show_lines, daemon=True)

    def __enter__(self) -> Self:
        """Start showing."""
        (self._live if self._console.is_terminal else self._thread).start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop showing."""
        self._stop.set()
        if self._console.is_terminal:
            self._live.stop()
        else:
            self._thread.join()

    def _print(self, line: str) -> None:
        # a terminal shows it live
        if not self._console.is_terminal:
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def _show_lines(self) -> None:
        while not self._stop.wait(LINE_EVERY_S):
            self._print(self._line())

    def _line(self) -> str:
        """Return one line on what is going on; another thread calls this."""
        raise NotImplementedError


@dataclass
class _Count:
    """The progress of one stage."""

    done: int = 0
    total: int = 0
    cached: int = 0
    spent_s: float = 0.0  # without the current visit
    # The rate leaves the first chunk out, which compiles kernels and starts workers. A stage that
    # counts from 0 again, such as a second training, has a first chunk again.
    first: int = 0
    first_s: float | None = None


class AttackProgress(Display):
    """A context manager that shows an attack's progress: pass it on as `on_progress`.

    Each stage shows its own time: training switches between querying and learning.
    """

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._counts: dict[Stage, _Count] = {}
        self._current: Stage | None = None
        self._since = time.monotonic()
        self._compiling = self._started = False
        self._spinner = Spinner("dots")
        self._live = Live(
            get_renderable=self._render,
            console=console,
            refresh_per_second=8,
            # what an agent prints goes to stdout, also where stdout is a file
            redirect_stdout=getattr(sys.stdout, "isatty", bool)(),
        )

    def __exit__(self, *error: object) -> None:
        """Stop showing."""
        self._leave()
        self._current = None
        super().__exit__(*error)

    def __call__(self, progress: RunProgress) -> None:
        """Show how far the run is."""
        stage, done, cached = progress.stage, progress.done, progress.cached
        if stage != self._current:
            self._leave()
            self._counts.setdefault(stage, _Count())
            self._current = stage
        count = self._counts[stage]
        if done < count.done and stage in _STEPS:
            count.first, count.first_s = done, self._spent(stage)
        count.done, count.total, count.cached = done, progress.total, cached
        if count.first_s is None and done > cached:
            count.first, count.first_s = done - cached, self._spent(stage)
        if stage in _STEPS:
            return
        if done > cached and not self._started:
            self._started, self._compiling = True, False
        elif count.total and not self._started and not self._compiling and will_compile():
            self._compiling = True
            self._print(COMPILING)

    def _leave(self) -> None:
        now = time.monotonic()
        if self._current is not None:
            self._counts[self._current].spent_s += now - self._since
        self._since = now

    def _spent(self, stage: Stage) -> float:
        visit = time.monotonic() - self._since if stage == self._current else 0.0
        return self._counts[stage].spent_s + visit

    def _rate(self, stage: Stage) -> float | None:
        count = self._counts[stage]
        made = count.done - count.cached - count.first
        took = self._spent(stage) - (count.first_s or 0.0)
        return made / took if made > 0 and took > 0 else None

    def _left_s(self, stage: Stage) -> float | None:
        # training also learns between the queries
        count, rate = self._counts[stage], self._rate(stage)
        if rate is None or stage != self._current or count.done >= count.total:
            return None
        learning = self._spent("learn") if stage == "train" and "learn" in self._counts else 0.0
        return (count.total - count.done) * (1 / rate + learning / max(1, count.done))

    def _detail(self, stage: Stage) -> list[str]:
        count, parts = self._counts[stage], list[str]()
        if count.total:
            parts.append(f"{count.done:,}/{count.total:,}")
        if (rate := self._rate(stage)) is not None:
            parts.append(f"{rate:,.0f}/s" if rate >= 10 else f"{rate:.2g}/s")
        if count.cached:
            parts.append(f"{count.cached:,} cached")
        parts.append(clock(self._spent(stage)))
        if (left := self._left_s(stage)) is not None:
            parts.append(f"{clock(left)} left")
        return parts

    def _render(self) -> Table:
        table = Table.grid(padding=(0, 1))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)  # the name; what follows wraps between words
        width = min(_BAR_WIDTH, self._console.width - _BESIDE_BAR)
        for stage in list(self._counts):
            count = self._counts[stage]
            mark = self._spinner if stage == self._current else Text(" ")
            cells: list[Spinner | Text | ProgressBar] = [mark, Text(_NAMES[stage])]
            if width >= _LEAST_BAR:
                bar = ProgressBar(count.total, count.done, width=width)
                cells.append(bar if count.total else Text())
            table.add_row(*cells, Text("  ".join(self._detail(stage))))
        if self._current is None and not self._counts:
            table.add_row(self._spinner, Text("Starting"))
        if self._compiling:
            table.add_row(self._spinner, Text(COMPILING))
        return table

    def _line(self) -> str:
        if self._current is None:
            return "Starting"
        doing = " (compiling kernels)" if self._compiling else ""
        return f"{_NAMES[self._current]}{doing}: {', '.join(self._detail(self._current))}"


def clock(seconds: float) -> str:
    """Format a time span as h:mm:ss, or as m:ss below an hour."""
    whole = int(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"


def will_compile(pattern: str = r"sada_gym\.envs\.\w+\.application") -> bool:
    """Return whether a loaded application has kernels, and no earlier run has compiled any of them.

    Their sources are read, not loaded: workers compile theirs, and this process may need none.
    `pattern` is that of the modules of applications; their folders are theirs.
    """
    modules = [module for name, module in list(sys.modules.items()) if re.fullmatch(pattern, name)]
    return any(_lacks_machine_code(Path(str(module.__file__)).parent) for module in modules)


def _lacks_machine_code(folder: Path) -> bool:
    sources = [file for file in folder.rglob("*.py") if _KERNEL.search(file.read_text("utf-8"))]
    if not sources:
        return False
    from sada_gym.foundations.compiled import was_compiled  # numba

    return not any(map(was_compiled, sources))

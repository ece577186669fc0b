"""Making one cell: train, sample, evaluate, measure, and put the result in place whole."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from sada_gym.application import Application
from sada_gym.benchmark.folder import CELL_FILE, TIMING_FILE, CellReport, Timing, cell_folder
from sada_gym.benchmark.ideal import draw_ideal
from sada_gym.benchmark.measure import ImageNovelty, follow_search, image_novelty, measure
from sada_gym.benchmark.plan import CellSettings
from sada_gym.benchmark.suite import IDEAL
from sada_gym.errors import StoreError, UserError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Evaluations, Oracle, Stream
from sada_gym.files import write_file, write_folder, write_model
from sada_gym.measures.novelty import image_neighbours
from sada_gym.parameters import Mu
from sada_gym.plots.attack import png
from sada_gym.plots.novelty import novelty_sheet
from sada_gym.runs.record import SAMPLES_FILE, write_samples

NOVELTY_PICTURE = "novelty.png"

Stage = Literal["training", "testing", "measuring", "finished"]

_TELL_EVERY_S = 0.1


@dataclass(frozen=True)
class Told:
    """What a process tells of its work.

    Attributes:
        cell: What it is at.
        stage: How far it is with that.
        done: Evaluations of this stage.
        total: How many there are at most.
        new: Evaluations made since the last message.
        wall_s: Seconds that a finished cell took.
    """

    cell: CellSettings
    stage: Stage
    done: int = 0
    total: int = 0
    new: int = 0
    wall_s: float | None = None


@dataclass(frozen=True)
class Bench:
    """What the cells of a group share.

    Attributes:
        out: The benchmark's folder.
        evaluator: Scores, from the group's store where it knows them.
        application: What is attacked.
        fooling_set: (R, d) points known to fool, to measure by; None where none are known.
        ideal_set: (R, d) other such points, which ideal samples are drawn from.
        tell: Hears of the progress.
    """

    out: Path
    evaluator: Evaluator
    application: Application
    fooling_set: Mu | None
    ideal_set: Mu | None
    tell: Callable[[Told], None]


class _Watched(Oracle):
    """An oracle that adds up what its queries cost."""

    evaluation_s = 0.0

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, see `Oracle`."""
        start = time.process_time()
        try:
            return super().__call__(mu)
        finally:
            self.evaluation_s += time.process_time() - start


@dataclass(frozen=True)
class _Outcome:
    """What there is to measure."""

    samples: Evaluations
    queries: Evaluations
    flags: tuple[str, ...] = ()


class CellWork:
    """The work on one cell.

    Args:
        bench: What it shares with the others of its group.
        cell: What to do.
    """

    def __init__(self, bench: Bench, cell: CellSettings) -> None:
        self._bench, self._cell = bench, cell
        self._threshold = float(bench.application.fooling_threshold)
        self._process_s = self._evaluation_s = 0.0
        self._evaluated = self._known = self._untold = 0
        self._told_at = 0.0

    def make(self) -> None:
        """Make the cell and put its folder in place.

        An adversary's ValueError, such as that of too small a budget, is a result as well.

        Raises:
            StoreError: If the store cannot serve.
        """
        started = time.monotonic()
        _forget_peak_memory()
        error, outcome = None, None
        try:
            outcome = self._attack()
        except StoreError:
            raise
        except ValueError as raised:
            error = str(raised)
        self._tell("measuring")
        images, sheet = self._compare_images(outcome) if outcome else (None, None)
        report = self._report(error, outcome, images)

        def fill(folder: Path) -> None:
            write_model(folder / CELL_FILE, report)
            if outcome is not None:
                write_samples(folder / SAMPLES_FILE, outcome.samples)
            if sheet is not None:
                write_file(folder / NOVELTY_PICTURE, sheet)
            write_model(folder / TIMING_FILE, self._timing(time.monotonic() - started))

        folder = cell_folder(self._bench.out, self._cell)
        folder.parent.mkdir(parents=True, exist_ok=True)
        write_folder(folder, fill)
        self._tell("finished", wall_s=time.monotonic() - started)

    def _attack(self) -> _Outcome:
        """Algorithm 1 of the paper, or what stands for it where the answer is known."""
        cell, dimension = self._cell, self._bench.evaluator.dimension
        start = time.process_time()
        self._tell("training", total=cell.budget)
        oracle = self._oracle("train", cell.budget, "training")
        flags: tuple[str, ...] = ()
        if cell.adversary == IDEAL:
            mu: npt.NDArray[np.float32] = self._draw_ideal()
        else:
            adversary = cell.contender.make(dimension, cell.seed)
            adversary.train(oracle)
            mu, flags = adversary.sample(cell.samples), tuple(adversary.flags)
        if np.shape(mu) != (cell.samples, dimension):
            raise UserError(
                f"Expected samples of shape ({cell.samples}, {dimension}) from {cell.adversary}, "
                f"got {np.shape(mu)}. Mend the adversary."
            )
        self._tell("testing", total=cell.samples)
        test = self._oracle("test", cell.samples, "testing")
        test(mu)
        self._evaluation_s = oracle.evaluation_s + test.evaluation_s
        self._process_s = time.process_time() - start
        return _Outcome(test.record, oracle.record, flags)

    def _oracle(self, stream: Stream, budget: int, stage: Stage) -> _Watched:
        """Give an oracle whose progress is told."""
        before = (self._evaluated, self._known)

        def progress(done: int, total: int, known: int) -> None:
            new = before[0] + done - known - self._evaluated
            self._evaluated, self._known = self._evaluated + new, before[1] + known
            self._untold += new
            if time.monotonic() - self._told_at > _TELL_EVERY_S:
                self._tell(stage, done, total)

        return _Watched(
            self._bench.evaluator,
            budget=budget,
            seed=self._cell.seed,
            stream=stream,
            progress=progress,
        )

    def _tell(
        self, stage: Stage, done: int = 0, total: int = 0, wall_s: float | None = None
    ) -> None:
        self._bench.tell(Told(self._cell, stage, done, total, self._untold, wall_s))
        self._told_at, self._untold = time.monotonic(), 0

    def _draw_ideal(self) -> Mu:
        assert self._bench.ideal_set is not None
        return draw_ideal(self._bench.ideal_set, self._cell.samples, self._cell.seed)

    @cached_property
    def _ideal(self) -> Evaluations | None:
        """The ideal samples, evaluated as this cell's are; the store knows them but once."""
        if self._bench.ideal_set is None:
            return None
        oracle = Oracle(
            self._bench.evaluator,
            budget=self._cell.samples,
            seed=self._cell.seed,
            stream="test",
        )
        oracle(self._draw_ideal())
        return oracle.record

    def _report(
        self, error: str | None, outcome: _Outcome | None, images: ImageNovelty | None
    ) -> CellReport:
        measures = search = None
        if outcome is not None:
            known, samples = self._bench.fooling_set, outcome.samples
            measures = measure(
                samples,
                outcome.queries,
                self._threshold,
                fooling_set=known,
                ideal=self._ideal,
                images=images,
                seed=self._cell.seed,
                feasible=self._bench.application.feasible(samples.mu, samples.seed.tolist()),
            )
            search = follow_search(outcome.queries, self._threshold, fooling_set=known)
        return CellReport(
            settings=self._cell,
            fooling_threshold=self._threshold,
            error=error,
            measures=measures,
            search=search,
            flags=outcome.flags if outcome else (),
        )

    def _compare_images(self, outcome: _Outcome) -> tuple[ImageNovelty | None, bytes | None]:
        """Look at the first samples that fool, ours and ideal ones, beside the nearest queries."""
        ideal = self._ideal
        pools = [outcome.samples] if ideal is None else [outcome.samples, ideal]
        rows = [np.flatnonzero(pool.score <= self._threshold) for pool in pools]
        count = min(self._cell.images, *map(len, rows))
        if not count or not len(outcome.queries):
            return None, None
        found = [
            image_neighbours(
                self._bench.application,
                pool.mu[chosen[:count]],
                pool.seed[chosen[:count]].tolist(),
                outcome.queries.mu,
                seed=self._cell.seed,
            )
            for pool, chosen in zip(pools, rows, strict=True)
        ]
        if not found[0]:
            return None, None
        ours, theirs = found[0], found[1] if len(found) > 1 else ()
        return image_novelty(ours, theirs), png(novelty_sheet(ours, theirs))

    def _timing(self, wall_s: float) -> Timing:
        return Timing(
            training_s=round(self._process_s - self._evaluation_s, 3),
            evaluation_s=round(self._evaluation_s, 3),
            evaluated=self._evaluated,
            known=self._known,
            wall_s=round(wall_s, 3),
            peak_memory_mib=_peak_memory_mib(),
        )


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

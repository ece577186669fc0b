"""One run of Algorithm 1: train an adversary, draw M samples, evaluate and measure them."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from sada_gym.adversaries.base import Adversary
from sada_gym.application import Application
from sada_gym.errors import AdversaryError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Evaluations, Oracle
from sada_gym.measures.collapse import collapse_flag
from sada_gym.measures.novelty import Neighbours, image_neighbours
from sada_gym.parameters import Mu
from sada_gym.runs.ideal import Ideal
from sada_gym.runs.measure import (
    ImageNovelty,
    feasible_rate,
    follow_search,
    image_novelty,
    measure,
    summarise_distances,
)
from sada_gym.runs.record import RunReport, RunSettings

Stage = Literal["train", "learn", "sample", "test", "measure", "pictures"]
"""What a run is doing: it queries (`train`), learns from the scores (`learn`), and so on."""


@dataclass(frozen=True)
class RunProgress:
    """How far a run has come.

    Attributes:
        stage: What the run is doing.
        done: The evaluations of this stage that are done.
        total: The most evaluations that this stage makes; 0 where it makes none.
        known: The evaluations among `done` that the store knew.
        evaluated: The evaluations made for training and testing since the run began. What the
            store knew doesn't count.
    """

    stage: Stage
    done: int = 0
    total: int = 0
    known: int = 0
    evaluated: int = 0


OnProgress = Callable[[RunProgress], None]


def ignore_progress(progress: RunProgress) -> None:
    """Do nothing."""


@dataclass(frozen=True)
class RunContext:
    """What a run needs besides its settings and its adversary.

    Attributes:
        evaluator: Gives the scores, from its store where that knows them.
        application: The application under attack.
        fooling_set: (R, d) points known to fool, to measure by; None where none are known.
        ideal_set: (R, d) other such points, which ideal samples are drawn from.
        on_progress: Called at the start of each stage, and after each chunk of evaluations.
    """

    evaluator: Evaluator
    application: Application
    fooling_set: Mu | None = None
    ideal_set: Mu | None = None
    on_progress: OnProgress = ignore_progress


@dataclass(frozen=True)
class ImageComparison:
    """Samples that fool, each with the training queries nearest to it.

    Attributes:
        ours: The adversary's samples.
        ideal: As many ideal samples, or none.
    """

    ours: tuple[Neighbours, ...]
    ideal: tuple[Neighbours, ...]

    @property
    def novelty(self) -> ImageNovelty:
        """Sum up the distances."""
        return image_novelty(self.ours, self.ideal)


class _TimedOracle(Oracle):
    """An oracle that adds up the process time of its queries."""

    evaluation_s = 0.0

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, see `Oracle`."""
        start = time.process_time()
        try:
            return super().__call__(mu)
        finally:
            self.evaluation_s += time.process_time() - start


class _TrainingOracle(_TimedOracle):
    """The oracle of the training: it reports when the adversary queries and when it learns."""

    on_answer: Callable[[], None]

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, see `Oracle`."""
        self._report(0, 0)
        scores = super().__call__(mu)
        self.on_answer()
        return scores


_AnyOracle = TypeVar("_AnyOracle", bound=_TimedOracle)


class Run:
    """A run of the paper's Algorithm 1: call `train`, `test` and `measure` in this order.

    Args:
        settings: What the run does.
        adversary: An untrained adversary that was made for these settings.
        context: What else the run needs.

    Attributes:
        process_s: The process seconds of training and testing.
        evaluated: The number of evaluations made for training and testing.
        known: The number of evaluations for training and testing that the store knew.
    """

    def __init__(self, settings: RunSettings, adversary: Adversary, context: RunContext) -> None:
        self.settings, self.adversary, self._context = settings, adversary, context
        self._threshold = float(context.application.fooling_threshold)
        self.process_s = 0.0
        self.evaluated = self.known = 0
        self._train = self._oracle(_TrainingOracle, "train", settings.budget)
        self._train.on_answer = lambda: self._report("learn")
        self._test = self._oracle(_TimedOracle, "test", settings.samples)

    @property
    def queries(self) -> Evaluations:
        """The training queries (Omega) so far."""
        return self._train.record

    @property
    def samples(self) -> Evaluations:
        """The test samples; none before `test`."""
        return self._test.record

    @property
    def evaluation_s(self) -> float:
        """Process seconds of evaluations; those of further worker processes don't count."""
        return self._train.evaluation_s + self._test.evaluation_s

    def train(self) -> None:
        """Train the adversary on the training stream.

        Raises:
            AdversaryError: If it cannot learn from what it got, such as too small a budget.
        """
        self._report("train", total=self.settings.budget)
        with self._timed():
            self.adversary.train(self._train)

    def test(self) -> None:
        """Draw M samples and evaluate them on the test stream, which training never used.

        Raises:
            AdversaryError: If the adversary cannot sample, or gives something else than M samples.
        """
        count = self.settings.samples
        self._report("sample")
        with self._timed():
            mu = self.adversary.sample(count)
            if np.shape(mu) != (count, self._test.dimension):
                raise AdversaryError(
                    f"Expected samples of shape ({count}, {self._test.dimension}) from "
                    f"{type(self.adversary).__name__}.sample, got {np.shape(mu)}. Mend the "
                    "adversary."
                )
            self._report("test", total=count)
            self._test(mu)

    def measure(self) -> RunReport:
        """Measure the test samples and the search."""
        self._report("measure")
        settings, samples, queries = self.settings, self.samples, self.queries
        context = self._context
        feasible = context.application.feasible(samples.mu, samples.seed.tolist())
        measures = measure(
            samples,
            queries,
            self._threshold,
            fooling_set=context.fooling_set,
            ideal=self.ideal_samples,
            images=self.images.novelty if self.images else None,
            seed=settings.seed,
            feasible=feasible_rate(samples.score <= self._threshold, feasible),
        )
        return RunReport(
            **{name: getattr(measures, name) for name in type(measures).model_fields},
            settings=settings,
            fooling_threshold=self._threshold,
            nearest_fooling_query=summarise_distances(
                samples.mu, queries.mu[queries.score <= self._threshold]
            ),
            search=follow_search(queries, self._threshold, fooling_set=context.fooling_set),
            seeds={
                "adversary": settings.seed,
                "oracle": settings.seed,
                "training_stream": "train",
                "test_stream": "test",
            },
            flags=self._flags(),
        )

    def _flags(self) -> tuple[str, ...]:
        collapse = collapse_flag(self.samples.mu)
        return (*self.adversary.flags, *([] if collapse is None else [collapse]))

    @cached_property
    def ideal_samples(self) -> Evaluations | None:
        """Evaluate M ideal samples on the test stream; None without points to draw from."""
        points, settings = self._context.ideal_set, self.settings
        if points is None:
            return None
        oracle = Oracle(
            self._context.evaluator,
            budget=settings.samples,
            seed=settings.seed,
            stream="test",
            progress=functools.partial(self._report, "measure"),
        )
        ideal = Ideal(oracle.dimension, seed=settings.seed, fooling_set=points)
        oracle(ideal.sample(settings.samples))
        return oracle.record

    @cached_property
    def images(self) -> ImageComparison | None:
        """Find the queries nearest to the first samples that fool, ours and ideal ones."""
        ideal, settings = self.ideal_samples, self.settings
        pools = [self.samples] if ideal is None else [self.samples, ideal]
        rows = [np.flatnonzero(pool.score <= self._threshold) for pool in pools]
        count = min(settings.images, *map(len, rows))
        if not count or not len(self.queries):
            return None
        found = [
            image_neighbours(
                self._context.application,
                pool.mu[chosen[:count]],
                pool.seed[chosen[:count]].tolist(),
                self.queries.mu,
                seed=settings.seed,
            )
            for pool, chosen in zip(pools, rows, strict=True)
        ]
        if not found[0]:
            return None
        return ImageComparison(tuple(found[0]), tuple(found[1]) if len(found) > 1 else ())

    @property
    def evaluations(self) -> tuple[Evaluations, ...]:
        """All evaluations so far, those from the store included."""
        ideal = self.__dict__.get("ideal_samples")  # nothing is evaluated for this
        parts = (self.queries, self.samples, *(() if ideal is None else (ideal,)))
        return tuple(part for part in parts if len(part))

    @contextmanager
    def _timed(self) -> Iterator[None]:
        start = time.process_time()
        try:
            yield
        finally:
            self.process_s += time.process_time() - start

    def _oracle(
        self, kind: type[_AnyOracle], stream: Literal["train", "test"], budget: int
    ) -> _AnyOracle:
        done_before = known_before = 0

        def progress(done: int, total: int, known: int) -> None:
            nonlocal done_before, known_before
            self.known += known - known_before
            self.evaluated += (done - known) - (done_before - known_before)
            done_before, known_before = done, known
            self._report(stream, done, total, known)

        return kind(
            self._context.evaluator,
            budget=budget,
            seed=self.settings.seed,
            stream=stream,
            progress=progress,
        )

    def _report(self, stage: Stage, done: int = 0, total: int = 0, known: int = 0) -> None:
        self._context.on_progress(RunProgress(stage, done, total, known, self.evaluated))

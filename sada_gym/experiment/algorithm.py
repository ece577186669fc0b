"""The paper's Algorithm 1: train an adversary, draw M samples, evaluate and measure them."""

from __future__ import annotations

import functools
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from sada_gym.adversaries.base import Adversary
from sada_gym.adversaries.query_pool import draw_permitted
from sada_gym.application import feasible_worlds
from sada_gym.errors import AdversaryError
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.oracle import Oracle
from sada_gym.evaluations import Evaluations, fools
from sada_gym.experiment.ideal import Ideal
from sada_gym.experiment.invalid import check_share, invalid_worlds
from sada_gym.experiment.measure import (
    feasible_rate,
    follow_search,
    image_novelty,
    measure,
    summarise_distances,
)
from sada_gym.experiment.nominal import (
    COMBINED,
    NominalWorld,
    explore_nominal,
    how_often,
    more_episodes,
    most_worlds,
    seeds_within,
)
from sada_gym.experiment.record import (
    BrokenRequirements,
    FailureProbability,
    RunReport,
    RunSettings,
    UniformQueries,
)
from sada_gym.measures.collapse import collapse_flag
from sada_gym.measures.novelty import Neighbours, image_neighbours
from sada_gym.measures.rates import weighted_rate
from sada_gym.measures.sensitivity import Influence, fit_failures
from sada_gym.parameters import Mu

_STEP_EVERY_S = 0.1
_JUDGED, _FEWEST_JUDGED = 0.05, 20
"""Failing samples played again for their requirements: as a share of all worlds; at least some."""

Stage = Literal["train", "learn", "sample", "test", "measure", "diagnose", "confirm", "pictures"]
"""What a run is doing: it queries (`train`), learns from the scores (`learn`), and so on."""


@dataclass(frozen=True)
class RunProgress:
    """How far a run has come.

    Attributes:
        stage: `train`, `learn`, `sample`, `test`, `measure`, `diagnose`, `confirm` or `pictures`.
        done: How many evaluations of this stage are done (or steps of learning, or frames drawn).
        total: The largest value that `done` can reach in this stage; 0 if it is not known.
        cached: How many evaluations of `done` came from the store.
        evaluated: How many evaluations were made for training and testing, not from the store.
    """

    stage: Stage
    done: int = 0
    total: int = 0
    cached: int = 0
    evaluated: int = 0


OnProgress = Callable[[RunProgress], None]


def ignore_progress(progress: RunProgress) -> None:
    """Do nothing."""


class _RunOracle(Oracle):
    """An oracle that adds up the process time of its queries, and reports each at once."""

    evaluation_s = 0.0
    on_answer: Callable[[], None] | None = None

    def __call__(self, mu: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Score mu, see `Oracle`."""
        start = time.process_time()
        self._report(0, 0)
        try:
            scores = super().__call__(mu)
        finally:
            self.evaluation_s += time.process_time() - start
        if self.on_answer is not None:
            self.on_answer()
        return scores


class Algorithm1:
    """The paper's Algorithm 1 for one adversary: call `train`, `test` and `measure` in this order.

    Args:
        settings: The settings of the run.
        adversary: An untrained adversary that was made for these settings.
        evaluator: Scores worlds of the application, or reads their scores from its store.
        fooling_set: (R, d) points known to fool, for the coverage; None if none are known.
        ideal_set: (R, d) other such points, from which ideal samples are drawn.
        on_progress: Called at the start of each stage, and after each chunk of evaluations.
    """

    def __init__(
        self,
        settings: RunSettings,
        adversary: Adversary,
        evaluator: Evaluator,
        *,
        fooling_set: Mu | None,
        ideal_set: Mu | None,
        on_progress: OnProgress = ignore_progress,
    ) -> None:
        assert evaluator.application is not None
        self.settings, self.adversary, self.application = settings, adversary, evaluator.application
        self._protocol = settings.experiment.protocol
        self._evaluator, self._on_progress = evaluator, on_progress
        self._fooling_set, self._ideal_set = fooling_set, ideal_set
        self._threshold = float(self.application.fooling_threshold)
        self.process_s = 0.0
        self._reported = 0.0
        self._counts: dict[Stage, tuple[int, int]] = {}  # done, cached
        self._train = self._oracle("train", self._protocol.budget)
        self._train.on_answer = lambda: self._report("learn")
        self._test = self._oracle("test", self._protocol.samples)

    @property
    def cached(self) -> int:
        """The number of evaluations for training and testing that came from the store."""
        return sum(cached for _, cached in self._counts.values())

    @property
    def evaluated(self) -> int:
        """The number of evaluations made for training and testing."""
        return sum(done - cached for done, cached in self._counts.values())

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
        """CPU seconds of evaluations in this process, without those of worker processes."""
        return self._train.evaluation_s + self._test.evaluation_s

    def train(self) -> None:
        """Train the adversary on the training stream of evaluation seeds.

        Raises:
            AdversaryError: If the adversary cannot learn from the scores.
            UserError: If too many worlds are invalid.
        """
        self._report("train", total=self._protocol.budget)
        self.adversary.on_step = self._report_step
        try:
            with self._timed():
                self.adversary.train(self._train)
        finally:
            self.adversary.on_step = None
        check_share(self.application, self._train)

    def test(self) -> None:
        """Draw M samples and evaluate them on the test stream, which training never used.

        Samples outside the feasible region, if there is one, are replaced by new ones.

        Raises:
            AdversaryError: If the adversary does not give M samples.
            UserError: If too many worlds are invalid.
        """
        count = self._protocol.samples
        self._report("sample")
        with self._timed():
            self._test(draw_permitted(self._sample, count, self._test.permits))
        check_share(self.application, self._test)

    def _sample(self, count: int) -> Mu:
        mu = self.adversary.sample(count)
        if np.shape(mu) != (count, self._test.dimension):
            raise AdversaryError(
                f"Expected samples of shape ({count}, {self._test.dimension}) from "
                f"{type(self.adversary).__name__}.sample, got {np.shape(mu)}. Fix the "
                "adversary."
            )
        return mu

    def measure(self, *, explain: bool = False, explore: bool = False) -> RunReport:
        """Measure the test samples and the search.

        With `explain`, also measure the influence of each parameter. With `explore`, also play
        worlds around the nominal one, if the application declares it.
        """
        self._report("measure")
        settings, samples, queries = self.settings, self.samples, self.queries
        feasible = feasible_worlds(self.application, samples.mu, samples.seed.tolist())
        measures = measure(
            samples,
            queries,
            self._threshold,
            fooling_set=self._fooling_set,
            ideal=self.ideal_samples,
            images=image_novelty(*self.images) if self.images else None,
            seed=settings.seed,
            feasible=feasible_rate(samples.fooled(self._threshold), feasible),
        )
        flags = (*self.adversary.flags, collapse_flag(samples.mu))
        return RunReport(
            **{name: getattr(measures, name) for name in type(measures).model_fields},
            settings=settings,
            nearest_fooling_query=summarise_distances(
                samples.mu, queries.mu[queries.fooled(self._threshold)]
            ),
            search=follow_search(queries, self._threshold, fooling_set=self._fooling_set),
            seeds={
                "adversary": settings.seed,
                "oracle": settings.seed,
                "training_stream": "train",
                "test_stream": "test",
            },
            flags=tuple(flag for flag in flags if flag is not None),
            invalid=invalid_worlds(self.application, self._train, self._test),
            uniform=self._uniform_queries(),
            in_use=self._failure_probability(),
            nominal=self._nominal_world() if explore else None,
            influences=self._influences() if explain else (),
            requirements=self._broken_requirements(),
        )

    def _broken_requirements(self) -> BrokenRequirements | None:
        application, names = self.application, self.application.requirements
        most = max(int(_JUDGED * (len(self.queries) + len(self.samples))), _FEWEST_JUDGED)
        failing = self.samples[self.samples.fooled(self._threshold)][:most]
        if not names or not application.repeatable or not len(failing):
            return None
        infos = application.evaluate(failing.mu, failing.seed.tolist()).infos  # no store has them
        broken = [
            [name for name in names if fools(info["requirements"][name], self._threshold)]
            for info in infos
        ]
        together = Counter(" and ".join(one) or "none on average" for one in broken)
        return BrokenRequirements(
            worlds=len(failing),
            each={name: sum(name in one for one in broken) for name in names},
            together=dict(together.most_common()),
        )

    def _nominal_world(self) -> NominalWorld | None:
        space, nominal = self.application.parameters, self.application.nominal
        if nominal is None or not self._protocol.budget:
            return None
        seeds = seeds_within(self._protocol.budget, len(space))
        more = more_episodes(seeds, self._protocol.budget + self._protocol.samples)
        oracle = Oracle(
            self._evaluator,
            budget=seeds * (most_worlds(len(space)) + COMBINED) + more,
            seed=self.settings.seed,
            stream="validation",
            progress=functools.partial(self._report, "measure"),
        )

        def play(mu: Mu) -> Evaluations:
            oracle(np.repeat(mu, seeds, axis=0))
            return oracle.record[np.arange(-seeds * len(mu), 0)]

        combine = np.random.default_rng(self.settings.seed) if self.application.combines else None
        known = Evaluations.joined([self.queries, self.samples])
        found = explore_nominal(
            *(space, nominal, play, known, self._threshold), samples=self.samples, combine=combine
        )
        if more:
            oracle(np.repeat(nominal[None], more, axis=0))
            played = oracle.record[np.r_[:seeds, -more:0]]
            found = found.model_copy(update=how_often(played, self._threshold))
        return found.model_copy(update={"beside_budget": len(oracle.record)})

    def _influences(self) -> tuple[Influence, ...]:
        worlds = Evaluations.joined([self.queries, self.samples]).valid
        model = fit_failures(worlds.mu, worlds.fooled(self._threshold))
        return () if model is None else model.influences(self.application.parameters.names)

    def _uniform_queries(self) -> UniformQueries | None:
        part = self.adversary.uniform_part(len(self.queries))
        if not part or not len(worlds := self.queries[np.arange(part)].valid):
            return None
        fooled = int(worlds.fooled(self._threshold).sum())
        return UniformQueries(worlds=len(worlds), fooled=fooled)

    def _failure_probability(self) -> FailureProbability | None:
        density = self.application.density
        part = self.adversary.uniform_part(len(self.queries))
        pools = [self.queries[np.arange(part)]]
        if self.settings.experiment.adversary.name == "random":
            pools.append(self.samples)
        worlds = Evaluations.joined(pools).valid
        if density is None or not len(worlds):
            return None
        rate = weighted_rate(worlds.fooled(self._threshold), density.log_density(worlds.mu))
        if rate is None:
            return None
        return FailureProbability(
            probability=rate.rate,
            interval_95=(rate.low, rate.high),
            density=density.data,
            held=density.held,
            worlds=len(worlds),
            worth=rate.worth,
        )

    @cached_property
    def ideal_samples(self) -> Evaluations | None:
        """Evaluate M ideal samples on the test stream; None without points to draw from."""
        points, settings = self._ideal_set, self.settings
        if points is None:
            return None
        oracle = Oracle(
            self._evaluator,
            budget=self._protocol.samples,
            seed=settings.seed,
            stream="test",
            progress=functools.partial(self._report, "measure"),
        )
        ideal = Ideal(oracle.dimension, seed=settings.seed, fooling_set=points)
        oracle(ideal.sample(self._protocol.samples))
        return oracle.record

    @cached_property
    def images(self) -> tuple[Sequence[Neighbours], Sequence[Neighbours]] | None:
        """The queries nearest to the first samples that fool: the adversary's, and ideal ones."""
        ideal, settings = self.ideal_samples, self.settings
        pools = [self.samples] if ideal is None else [self.samples, ideal]
        rows = [np.flatnonzero(pool.fooled(self._threshold)) for pool in pools]
        count = min(settings.images, *map(len, rows))
        if not count or not len(self.queries):
            return None
        neighbours = [
            image_neighbours(
                self.application,
                pool.mu[chosen[:count]],
                pool.seed[chosen[:count]].tolist(),
                self.queries.mu,
                seed=settings.seed,
            )
            for pool, chosen in zip(pools, rows, strict=True)
        ]
        return (neighbours[0], neighbours[1] if ideal else ()) if neighbours[0] else None

    @property
    def evaluations(self) -> tuple[Evaluations, ...]:
        """All evaluations so far, including those from the store."""
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

    def _oracle(self, stream: Literal["train", "test"], budget: int) -> _RunOracle:
        def progress(done: int, total: int, cached: int) -> None:
            self._counts[stream] = done, cached
            self._report(stream, done, total, cached)

        return _RunOracle(
            self._evaluator,
            budget=budget,
            seed=self.settings.seed,
            stream=stream,
            progress=progress,
        )

    def _report_step(self, done: int, total: int) -> None:
        """Report a step of learning, unless another one was reported just now."""
        now = time.monotonic()
        if done == total or now - self._reported >= _STEP_EVERY_S:
            self._reported = now
            self._report("learn", done, total)

    def _report(self, stage: Stage, done: int = 0, total: int = 0, cached: int = 0) -> None:
        self._on_progress(RunProgress(stage, done, total, cached, self.evaluated))

"""The oracle shows Q to an adversary, and nothing else: counted, seeded, stored, in parallel."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.application import Application
from sada_gym.errors import BudgetExhausted, UserError, UserTypeError, check_integer
from sada_gym.evaluation.evaluator import Evaluator
from sada_gym.evaluation.executors import Workers
from sada_gym.evaluation.problems import Problem
from sada_gym.evaluations import Evaluations, Stream, evaluation_seeds
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Permits, all_can_exist, validate_mu

Progress = Callable[[int, int, int], None]
"""A function progress(done, total, cached): queries answered, budget, answers from the store."""


MAX_QUERIES = 10_000_000
"""The largest budget. An oracle keeps its queries in memory; so many take a gigabyte."""


class Oracle:
    """Answers an adversary's queries, `oracle(mu) -> q`, until the budget is spent.

    The evaluation seed of query i follows only from (seed, stream, i), so the scores depend neither
    on chunks, nor on workers, nor on the scores that are already in the store.

    Args:
        problem: An environment id, an `Application`, a function (n, d) -> (n,), or an `Evaluator`,
            whose workers and store several oracles can share. The oracle does not close it.
        budget: The number of queries. A query that the store answers counts, too.
        seed: The seed from which the evaluation seeds follow.
        stream: `train`, `test`, `validation` or `verification`; streams never share seeds.
        env_kwargs: Keywords of the environment, if an id is given.
        dimension: The number of parameters, d, if a function is given.
        threshold: The fooling threshold, if a function is given.
        workers: 1 evaluates in this process, more start so many. See :class:`~sada_gym.Workers`.
        store: The file that keeps the scores; None keeps none.
        progress: Called as progress(done, total, cached) after each chunk.

    Raises:
        TypeError, ValueError: If the arguments do not fit together.
        StoreError: If the store cannot be used.

    Example:
        >>> with Oracle("SADA-Detection-Car-v0", budget=1_000, workers=2) as oracle:
        ...     q = oracle(np.zeros((10, oracle.dimension)))
    """

    def __init__(
        self,
        problem: Problem | Evaluator,
        *,
        budget: int,
        seed: int = 0,
        stream: Stream = "train",
        env_kwargs: Mapping[str, Any] | None = None,
        dimension: int | None = None,
        threshold: float | None = None,
        workers: int | Workers = 1,
        store: str | Path | None = None,
        progress: Progress | None = None,
    ) -> None:
        check_integer("budget", budget, 0, MAX_QUERIES)
        check_integer("seed", seed, 0)
        if progress is not None and not callable(progress):
            raise UserTypeError(f"Expected progress to be a function or None, got {progress!r}.")
        if stream not in get_args(Stream):
            raise UserError(f"Expected a stream of {', '.join(get_args(Stream))}, got {stream!r}.")
        self.budget = int(budget)
        self.seed = int(seed)
        self.stream: Stream = stream
        self._progress = progress
        self._used = self._cached = 0
        self._process = os.getpid()
        settings: dict[str, Any] = {
            "env_kwargs": env_kwargs,
            "dimension": dimension,
            "threshold": threshold,
            "store": store,
        }
        self._owns = not isinstance(problem, Evaluator)
        if not isinstance(problem, Evaluator):
            self._evaluator = Evaluator(problem, workers=workers, **settings)
        elif workers == 1 and all(value is None for value in settings.values()):
            self._evaluator = problem
        else:
            raise UserTypeError(
                "Expected only budget, seed, stream and progress with an Evaluator."
            )
        self._record = [Evaluations.empty(self.dimension)]
        self._invalid: dict[int, str] = {}

    @property
    def dimension(self) -> int:
        """d, the number of semantic parameters."""
        return self._evaluator.dimension

    @property
    def threshold(self) -> float:
        """The fooling threshold: the agent is fooled if Q <= threshold."""
        return self._evaluator.threshold

    @property
    def remaining(self) -> int:
        """The number of queries left."""
        return self.budget - self._used

    @property
    def application(self) -> Application | None:
        """The application under attack, or None for a function."""
        return self._evaluator.application

    @property
    def record(self) -> Evaluations:
        """All queries so far, in order."""
        return Evaluations.joined(self._record)

    @property
    def permits(self) -> Permits:
        """A function that returns which worlds of mu, (n, d), can exist, as (n,) bool."""
        return all_can_exist if self.application is None else self.application.permits

    @property
    def invalid(self) -> dict[int, str]:
        """The reasons for invalid worlds, by their row in `record`."""
        return dict(self._invalid)

    def __call__(self, mu: npt.ArrayLike) -> Floats:
        """Score n worlds, which costs n queries.

        Args:
            mu: (n, d), values in [-1, 1]; rounded to float32.

        Returns:
            (n,) float64 scores.

        Raises:
            ValueError: If mu is not as described, or this is a copy in another process, which would
                count a budget of its own.
            BudgetExhausted: If fewer than n queries are left. Then nothing is evaluated.
        """
        if os.getpid() != self._process:
            raise UserError(
                "Expected all queries in the process that made the oracle, got one in another, "
                "where a copy would count a budget of its own. Step environments in one process, "
                "as OracleVectorEnv does, and give the oracle workers=."
            )
        batch = validate_mu(mu, self.dimension)
        count = len(batch)
        if count > self.remaining:
            raise BudgetExhausted(
                f"Expected at most {self.remaining} more queries of {self.budget}, got {count}. "
                "Ask for at most oracle.remaining, or raise the budget."
            )
        seeds = evaluation_seeds(self.seed, self.stream, self._used, count)
        scores, cached, reasons = self._evaluator.evaluate(batch, seeds, self._report)
        invalid = np.zeros(count, np.bool_)
        invalid[[*reasons]] = True
        self._invalid.update({self._used + i: why for i, why in reasons.items()})
        self._used += count
        self._cached += cached
        self._record.append(
            Evaluations(batch.copy(), scores.copy(), np.array(seeds, np.int64), invalid)
        )
        return scores

    def _report(self, done: int, cached: int) -> None:
        if self._progress is not None:
            self._progress(self._used + done, self.budget, self._cached + cached)

    def close(self, *, now: bool = False) -> None:
        """Stop the workers and close the store; `now` drops running chunks. May be repeated."""
        if self._owns:
            self._evaluator.close(now=now)

    def __enter__(self) -> Self:
        """Return the oracle itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the oracle. After an error or Ctrl-C this does not wait for the workers."""
        self.close(now=kind is not None)

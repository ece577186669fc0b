"""The interface of every adversary, which learns the distribution of mu that fools the agent."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from sada_gym.adversaries.dialogue import Dialogue
from sada_gym.adversaries.options import Options, choose_options
from sada_gym.errors import UserError, check_integer
from sada_gym.foundations.arrays import Floats
from sada_gym.parameters import Mu, Permits, all_can_exist

MAX_DIMENSIONS = 1_000
"""The most semantic parameters: no application has nearly as many, and a covariance fits memory."""


class Query(Protocol):
    """What an adversary needs of an oracle: the type of `Adversary.train`'s argument."""

    @property
    def remaining(self) -> int:
        """The number of queries left."""
        ...

    @property
    def threshold(self) -> float:
        """The fooling threshold: the agent is fooled where Q <= threshold."""
        ...

    @property
    def permits(self) -> Permits:
        """A function of mu, (n, d), that says which worlds can exist at all, (n,)."""
        ...

    def __call__(self, mu: npt.ArrayLike) -> Floats:
        """Score mu (n, d) in [-1, 1]: (n,) float64 in [0, 1]. It costs n queries."""
        ...


class Adversary(ABC):
    """Learns, from a budget of queries, to sample mu that fool the agent.

    The dimension d is the number of semantic parameters. The seed fixes all randomness; None draws
    one. `options` are fields of `options_class`; the preset sets those that are not given.

    Attributes:
        presets: Named sets of options, one of them `default`; empty if the class has no presets.
        packages: The packages that its samples depend on, by their names on PyPI, except NumPy and
            SciPy. A run records their versions. If a class does not declare them, a run records
            the versions of all packages that any shipped adversary needs.
        flags: Warnings for a reader of the result, such as that no point fooled; set by `train`.
        on_step: A function on_step(done, total) that a long training calls after each step; a run
            sets it to show progress.
        uniform_queries: Whether all training queries are uniform in the box, so that their fooling
            rate is that of uniform worlds.

    Raises:
        ValueError: If the dimension, the seed, the preset or an option is unknown or bad.
    """

    name: ClassVar[str]
    options_class: ClassVar[type[Options]] = Options
    presets: ClassVar[Mapping[str, Options]] = {}
    uniform_queries: ClassVar[bool] = False
    packages: ClassVar[tuple[str, ...]]

    options: Options
    on_step: Callable[[int, int], None] | None = None
    _dialogue: Dialogue | None = None

    def __init__(
        self,
        dimension: int,
        *,
        seed: int | None = None,
        preset: str = "default",
        **options: Any,
    ) -> None:
        check_integer("dimension", dimension, 1, MAX_DIMENSIONS)
        if seed is not None:
            check_integer("seed", seed, 0)
        name = getattr(self, "name", type(self).__name__)
        self.options = choose_options(name, self.options_class(), self.presets, preset, options)
        self.dimension = int(dimension)
        self.rng = np.random.default_rng(seed)
        self.flags: list[str] = []

    def extra_queries(self, queries: int) -> int:  # noqa: ARG002 - subclasses use it
        """Return how many queries the paper allows beyond the budget (only for boosting)."""
        return 0

    def uniform_part(self, queries: int) -> int:
        """Return how many of the training queries are uniform; these are the first ones."""
        return queries if self.uniform_queries else 0

    @abstractmethod
    def train(self, oracle: Query) -> None:
        """Spend the oracle's remaining budget to learn the fooling distribution."""

    def start(self, budget: int, *, threshold: float, permits: Permits = all_can_exist) -> None:
        """Begin a training by `ask` and `tell`. It learns the same as `train`, bit for bit.

        Use it where your own loop or simulator farm evaluates the queries::

            adversary.start(budget=1_000, threshold=0.3)
            while len(mu := adversary.ask(32)):
                adversary.tell(mu, score(mu))
            adversary.sample(100)

        Args:
            budget: The number of queries.
            threshold: The agent is fooled where Q <= this.
            permits: A function of mu, (n, d), that says which worlds can exist at all, (n,).
        """
        check_integer("budget", budget, 0)
        if self._dialogue is not None:
            self._dialogue.leave()
        self._dialogue = Dialogue(self.train, self.dimension, budget, threshold, permits)

    def ask(self, n: int) -> Mu:
        """Return up to n queries to score, (m, d) float32; none when the training is over.

        Raises:
            UserError: If no training was started, or the scores of earlier queries are missing.
        """
        check_integer("n", n, 1)
        return self._started.ask(n)

    def tell(self, mu: npt.ArrayLike, q: npt.ArrayLike) -> None:
        """Give the scores q, (m,), of the queries mu, (m, d), that `ask` returned, in any order.

        Raises:
            UserError: If `ask` did not return one of the queries, or a score is not finite.
        """
        self._started.tell(mu, q)

    @property
    def _started(self) -> Dialogue:
        if self._dialogue is None:
            raise UserError(
                "Expected a training that was started, got none. Call start(budget, threshold=...)."
            )
        return self._dialogue

    @abstractmethod
    def sample(self, n: int) -> Mu:
        """Draw n fresh mu from the learnt distribution: (n, d) float32 in [-1, 1].

        Raise `RuntimeError` if the adversary was neither trained nor loaded.
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write the trained adversary to a folder: safetensors, JSON, NPZ; no pickles."""

    @classmethod
    @abstractmethod
    def load(cls, folder: Path) -> Self:
        """Read an adversary that `save` wrote. Its samples go on where the saved one stopped."""

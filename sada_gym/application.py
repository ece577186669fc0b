"""An application under attack: the black box Q(agent, world of mu)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError
from sada_gym.parameters import Mu, ParameterSpace

SEED_BOUND = 2**31
"""Evaluation seeds are Python ints in [0, SEED_BOUND)."""

RESERVED_KEYS = frozenset({"score", "fooled", "seed", "parameters"})
"""What `Application.evaluate` puts into every info itself."""

Frame = npt.NDArray[np.uint8]
"""An RGB image, (height, width, 3) uint8."""


@dataclass(frozen=True)
class Outcomes:
    """What a batch of n evaluations gave.

    Attributes:
        score: (n,) float64, Q in [0, 1]; high is good for the agent.
        fooled: (n,) bool, where Q <= the fooling threshold.
        infos: n dictionaries with `score`, `fooled`, `seed`, `parameters` (physical values by
            name) and what the application adds.
    """

    score: npt.NDArray[np.float64]
    fooled: npt.NDArray[np.bool_]
    infos: tuple[dict[str, Any], ...]


@dataclass(frozen=True)
class Scored:
    """What an application's own `_evaluate` returns: n scores and n dictionaries of extras.

    Every dictionary has the same keys, and a key always the same type (arrays: one shape, too), so
    that a vector environment can batch them; what varies in length goes into a list.
    """

    score: npt.NDArray[np.float64]
    extras: Sequence[Mapping[str, Any]]


class Application(ABC):
    """A frozen agent in a world built from mu, scored over a whole episode.

    A subclass sets the class attributes and `parameters`, and implements `_evaluate`; it may add
    `render`, `observation` and `replay`. `_evaluate` must be pure: Q(mu, seed) is the same to the
    last bit whatever else is in the batch. `sada-gym check` tests that.

    Attributes:
        name: The general environment's id without its version, such as `SADA-Detection`.
        version: The environment's version; raise it when a score changes.
        fooling_threshold: The agent is fooled where Q <= this (epsilon in the paper).
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        parameters: What mu controls.
        agent: The agent under test; None where it is part of the world.
        agent_name: What reports call it.
        render_fps: Frames of `replay` in a second of its episode.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 0
    render_fps: ClassVar[int] = 4
    fooling_threshold: float
    sample_size: int
    parameters: ParameterSpace
    agent: Any = None
    agent_name: str = ""

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that tell this application from its siblings, JSON-compatible.

        With `name`, `version` and `fingerprint` they identify what a stored score belongs to.
        """
        return {}

    @property
    def fingerprint(self) -> str | None:
        """A SHA-256 over the agent and whatever else a user brought, None where none is known.

        An evaluation store is refused without one. An application with nothing exchangeable
        inside returns the empty string.
        """
        return ""

    def evaluate(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Outcomes:
        """Score the agent in the worlds of a batch of mu.

        Args:
            mu: (n, d), values in [-1, 1]; rounded to float32.
            seeds: n seeds, Python ints in [0, 2**31); each fixes all randomness of its evaluation.

        Returns:
            The n outcomes in the same order.

        Raises:
            ValueError: If mu or the seeds are not as described, or a score is not in [0, 1].
        """
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        if not len(batch):
            return Outcomes(np.zeros(0), np.zeros(0, dtype=np.bool_), ())
        scored = self._evaluate(batch, checked)
        score = np.asarray(scored.score, dtype=np.float64)
        if score.shape != (len(batch),) or not ((score >= 0.0) & (score <= 1.0)).all():
            raise UserError(
                f"Expected {len(batch)} scores in [0, 1] from {type(self).__name__}._evaluate, "
                f"got shape {score.shape}: {score}. Mend the application's scoring."
            )
        self._check_extras(scored.extras, len(batch))
        fooled = score <= self.fooling_threshold
        names = self.parameters.names
        physical = self.parameters.physical(batch).tolist()  # in one go: it is much faster
        infos = tuple(
            {
                "score": float(score[i]),
                "fooled": bool(fooled[i]),
                "seed": checked[i],
                "parameters": dict(zip(names, physical[i], strict=True)),
                **scored.extras[i],
            }
            for i in range(len(batch))
        )
        return Outcomes(score, fooled, infos)

    def _check_extras(self, extras: Sequence[Mapping[str, Any]], count: int) -> None:
        if len(extras) != count:
            raise UserError(
                f"Expected {count} extras from {type(self).__name__}._evaluate, one for each mu, "
                f"got {len(extras)}. Give an empty dictionary where there is nothing to add."
            )
        taken = sorted(RESERVED_KEYS & set().union(*extras))
        if taken:
            raise UserError(
                f"Expected the extras of {type(self).__name__}._evaluate to leave {taken} to "
                "Application.evaluate, which sets them. Name yours differently."
            )

    @abstractmethod
    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        """Score a checked, non-empty batch: mu (n, d) float32 in [-1, 1], n seeds."""

    def feasible(
        self,
        mu: npt.ArrayLike,  # noqa: ARG002
        seeds: Sequence[int],  # noqa: ARG002
    ) -> npt.NDArray[np.bool_] | None:
        """Say in which worlds a privileged agent is not fooled: there a failure is the agent's own.

        Args:
            mu: (n, d), values in [-1, 1].
            seeds: n seeds.

        Returns:
            (n,), or None where no privileged agent is known, as by default.
        """
        return None

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw one frame of the world of mu, shape (d,), for a person to look at."""
        raise NotImplementedError(
            f"{type(self).__name__} draws no pictures. Implement `render(mu, seed)` in it."
        )

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """What the agent sees first in the world of mu, shape (d,), with nothing drawn into it.

        By it images of worlds are compared. The default, `render`, serves applications whose
        pictures show the world alone.
        """
        return self.render(mu, seed)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu of shape (d,) again and give all frames of the episode and its score.

        The default serves applications whose episode is a single frame.
        """
        one: Any = [mu]
        score = float(self.evaluate(one, [seed]).score[0])
        return [self.render(mu, seed)], score

    def close(self) -> None:  # noqa: B027 - most applications hold nothing
        """Free what the application holds; calling it twice is fine."""


def validate_world(parameters: ParameterSpace, mu: npt.ArrayLike, seed: int) -> tuple[Mu, int]:
    """Check one mu, (d,), and a seed, and give them as (1, d) and a Python int.

    Raises:
        ValueError: If they are not what `Application.evaluate` takes.
    """
    one: Any = [mu]
    row = parameters.validate(one)
    return row, validate_seeds([seed], 1)[0]


def fold_seed(seed: int) -> int:
    """Give an evaluation seed for any int from 0 up.

    One below 2**31 is its own. A larger one becomes the upper 31 bits of the first word that
    NumPy's `SeedSequence` makes of it, so that s and 2**31 + s have nothing in common.
    """
    if seed < SEED_BOUND:
        return seed
    return int(np.random.SeedSequence(seed).generate_state(1, np.uint32)[0]) >> 1


def validate_seeds(seeds: Sequence[int], count: int, *, bounded: bool = True) -> list[int]:
    """Check that there are `count` seeds, ints in [0, 2**31), and give them as Python ints.

    Args:
        seeds: The seeds.
        count: How many there are to be.
        bounded: Without it they may be any ints from 0 up, as Gymnasium's are.

    Raises:
        ValueError: If not.
    """
    if len(seeds) != count:
        raise UserError(f"Expected {count} seeds, one for each mu, got {len(seeds)}.")
    checked = []
    for seed in seeds:
        if (
            isinstance(seed, bool)
            or not isinstance(seed, int | np.integer)
            or seed < 0
            or (bounded and seed >= SEED_BOUND)
        ):
            allowed = "in [0, 2**31)" if bounded else "from 0 up"
            raise UserError(
                f"Expected seeds to be ints {allowed}, got {seed!r}. "
                "Draw them with rng.integers(2**31)."
            )
        checked.append(int(seed))
    return checked

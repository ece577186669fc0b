"""Scores of episodes: by return, success, failure, cost, length, or a function of the user's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.factory import code_name, function_name
from sada_gym.errors import InvalidWorld, UserError, UserTypeError, check_integer, explained
from sada_gym.foundations.lazy import load


@dataclass(frozen=True)
class Episode:
    """One episode of T steps, from its reset to its end.

    Attributes:
        rewards: (T,) float64.
        observations: The environment's observations at the reset and after each step, T + 1 of
            them, without the noise, delay and dropout of bindings.
        actions: The actions that the environment got, T of them.
        infos: The environment's infos at the reset and after each step, T + 1 of them.
        terminated: Whether the environment ended the episode.
        truncated: Whether a limit of steps ended the episode.
        probed: What each function of `env` in an "stl" score returned, T + 1 values by its `id`.
    """

    rewards: npt.NDArray[np.float64]
    observations: tuple[Any, ...]
    actions: tuple[Any, ...]
    infos: tuple[Mapping[str, Any], ...]
    terminated: bool
    truncated: bool
    probed: Mapping[int, list[Any]] = field(default_factory=dict)

    @property
    def total(self) -> float:
        """The sum of the rewards."""
        return float(self.rewards.sum())

    def __len__(self) -> int:
        """Count the steps."""
        return len(self.rewards)


ScoreLike = str | tuple[Any, ...] | list[Any] | Callable[[Episode], float]
"""("return", low, high) or, of rewards that are vectors, ("return", low, high, entry); "success" or
("success", key); ("failure", key); ("cost", limit) or ("cost", limit, key); ("length", maximum);
("stl", formula), ("stl", formula, signals) or ("stl", formula, signals, scale), see `Requirement`;
or a function of the episode."""


class Score(ABC):
    """Says how well the agent did in an episode, from 0 to 1."""

    keeps_all: bool = False
    """Whether it needs the observations, the actions and all infos."""

    keeps_infos: bool = False
    """Whether it needs all infos."""

    entry: int | None = None
    """Which entry of a reward counts; None where a reward is one number."""

    @property
    @abstractmethod
    def settings(self) -> Any:
        """The score as data for JSON."""

    @property
    def own_functions(self) -> dict[str, Callable[..., Any]]:
        """The user's functions that it calls, by what they do: no fingerprint covers their code."""
        return {}

    @property
    def probes(self) -> tuple[Callable[..., Any], ...]:
        """Functions of the unwrapped environment that are called at the reset and each step."""
        return ()

    @abstractmethod
    def __call__(self, episode: Episode) -> tuple[float, bool]:
        """Return the score in [0, 1], and whether it was clipped."""

    def judge(self, episode: Episode) -> tuple[float, bool, dict[str, float]]:
        """Return the same, and the margins of several requirements by name, see `Several`."""
        return *self(episode), {}


@dataclass(frozen=True)
class Return(Score):
    """The sum of rewards, from `low` (0) to `high` (1); what lies outside is clipped."""

    low: float
    high: float
    entry: int | None = None

    def __post_init__(self) -> None:
        """Check the range and the entry."""
        if self.entry is not None:
            check_integer("the entry in score=('return', low, high, entry)", self.entry, 0)
        if not (_is_finite(self.low) and _is_finite(self.high) and self.low < self.high):
            raise UserError(
                f"Expected score=('return', low, high) with finite low < high, got {self.low!r} "
                f"and {self.high!r}. Take the returns of a bad and of a good episode."
            )

    @property
    def settings(self) -> Any:  # noqa: D102
        entry = [] if self.entry is None else [self.entry]
        return ["return", float(self.low), float(self.high), *entry]

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        share = (episode.total - self.low) / (self.high - self.low)
        return min(max(share, 0.0), 1.0), not 0.0 <= share <= 1.0


SUCCESS_KEYS = ("is_success", "success")
"""Where environments say whether an episode was a success: the first one that an info has."""


@dataclass(frozen=True)
class Success(Score):
    """1 where an entry of the last info is true, else 0; `key` None takes `SUCCESS_KEYS`."""

    key: str | None = None

    @property
    def settings(self) -> Any:  # noqa: D102
        return "success" if self.key is None else ["success", self.key]

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        info, keys = episode.infos[-1], SUCCESS_KEYS if self.key is None else (self.key,)
        key = next((key for key in keys if key in info), None)
        if key is None:
            raise _missing(self, keys, info, "at the end")
        return float(_truth(info, key, "success")), False


@dataclass(frozen=True)
class Failure(Score):
    """1 unless an entry of any step's info is true; a step that lacks it did not fail."""

    key: str
    keeps_infos = True

    @property
    def settings(self) -> Any:  # noqa: D102
        return ["failure", self.key]

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        having = [info for info in episode.infos if self.key in info]
        if not having:
            raise _missing(self, (self.key,), episode.infos[-1], "at any step")
        return float(not any(_truth(info, self.key, "a failure") for info in having)), False


@dataclass(frozen=True)
class Cost(Score):
    """1 without costs, down to 0 where those of all steps' infos add up to `limit` or more."""

    limit: float
    key: str = "cost"
    keeps_infos = True

    def __post_init__(self) -> None:
        """Check the limit."""
        if not _is_finite(self.limit) or self.limit <= 0:
            raise UserError(
                f"Expected score=('cost', limit) with a limit above 0, got {self.limit!r}."
            )

    @property
    def settings(self) -> Any:  # noqa: D102
        return ["cost", float(self.limit), self.key]

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        costs = [info[self.key] for info in episode.infos if self.key in info]
        if not costs:
            raise _missing(self, (self.key,), episode.infos[-1], "at any step")
        for cost in costs:
            if np.size(cost) != 1 or not is_number(np.asarray(cost).item()):
                raise UserTypeError(
                    f"Expected info[{self.key!r}] to be a number, got {cost!r}. Name another key, "
                    "or pass a function of the episode as the score."
                )
        total = float(np.sum(costs))
        if not np.isfinite(total):
            reason = f"info[{self.key!r}] is not finite"
            raise InvalidWorld(f"Expected finite costs, but {reason}.", reason)
        return min(max(1.0 - total / self.limit, 0.0), 1.0), False


@dataclass(frozen=True)
class Length(Score):
    """The number of steps as a share of `maximum`, which makes a long episode a good one."""

    maximum: int

    def __post_init__(self) -> None:
        """Check the number of steps."""
        if not _is_finite(self.maximum) or self.maximum < 1:
            raise UserError(
                f"Expected score=('length', maximum) with a number of steps, got {self.maximum!r}."
            )

    @property
    def settings(self) -> Any:  # noqa: D102
        return ["length", self.maximum]

    def __call__(self, episode: Episode) -> tuple[float, bool]:  # noqa: D102
        return min(len(episode) / self.maximum, 1.0), False


@dataclass(frozen=True)
class FunctionScore(Score):
    """A function of the user's."""

    function: Callable[[Episode], float]
    keeps_all = True

    @property
    def settings(self) -> Any:  # noqa: D102
        return code_name(self.function)

    @property
    def own_functions(self) -> dict[str, Callable[..., Any]]:  # noqa: D102
        return {"score": self.function}

    def __call__(self, episode: Episode) -> tuple[float, bool]:
        """Call the function, and check what it returns."""
        name = function_name(self.function)
        with explained(f"Expected a score from {name}", "Fix the function."):
            score: Any = self.function(episode)
        if not _is_finite(score) and not isinstance(score, bool | np.bool_):
            raise UserTypeError(
                f"Expected a number in [0, 1] from {name}, got {score!r}. Return a float."
            )
        if not 0.0 <= score <= 1.0:
            raise UserError(
                f"Expected a score in [0, 1] from {name}, got {score}. Scale and clip it: 1 means "
                "that the agent did well."
            )
        return float(score), False


def as_score(given: Any) -> Score:
    """Return the score that a description means; raise `UserError` if it is none of `ScoreLike`."""
    if isinstance(given, str) and given == "success":
        return Success()
    if isinstance(given, tuple | list) and given:
        kind, *numbers = given
        if kind == "success" and len(numbers) == 1 and isinstance(numbers[0], str):
            return Success(*numbers)
        if kind == "failure" and len(numbers) == 1 and isinstance(numbers[0], str):
            return Failure(*numbers)
        if kind == "cost" and (
            len(numbers) == 1 or (len(numbers) == 2 and isinstance(numbers[1], str))
        ):
            return Cost(*numbers)
        if kind == "return" and len(numbers) in (2, 3):
            return Return(*numbers)
        if kind == "length" and len(numbers) == 1:
            return Length(*numbers)
        if kind == "stl" and 1 <= len(numbers) <= 3:
            requirement: Score = load("sada_gym.envs.wrapped.requirement:Requirement")(*numbers)
            return requirement
    if callable(given):
        return FunctionScore(given)
    raise UserTypeError(
        "Expected score to be ('return', low, high), 'success', ('success', key), ('failure', "
        "key), ('cost', limit), ('length', maximum), ('stl', formula, signals, scale), a function "
        "of the episode, or a dictionary of such scores by name, {'safe': ('cost', 1), ...}; got "
        f"{given!r}."
    )


def _missing(score: Score, keys: tuple[str, ...], info: Mapping[str, Any], when: str) -> UserError:
    wanted = " or ".join(f"info[{key!r}]" for key in keys)
    listed = ", ".join(repr(str(key)) for key in info) or "none"
    return UserError(
        f"Expected {wanted} {when} of an episode for score={score.settings!r}, got the keys "
        f"{listed}. Name another key, score=('success', 'key'), or pass a function such as "
        "score=lambda episode: float(episode.terminated)."
    )


def _truth(info: Mapping[str, Any], key: str, what: str) -> bool:
    value = info[key]
    if isinstance(value, np.generic | np.ndarray) and value.size == 1:
        value = value.item()
    if isinstance(value, float) and np.isnan(value):
        reason = f"info[{key!r}] is NaN"
        raise InvalidWorld(f"Expected True or False as {what}, but {reason}.", reason)
    if not isinstance(value, bool | int | float) or value not in (0, 1):
        raise UserTypeError(
            f"Expected info[{key!r}] to be True or False, 1 or 0, got {value!r}. Name another key, "
            "or pass a function of the episode as the score."
        )
    return bool(value)


def _is_finite(value: Any) -> bool:
    return is_number(value) and bool(np.isfinite(value))

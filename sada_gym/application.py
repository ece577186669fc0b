"""An application under attack: the black box Q(agent, world of mu)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from sada_gym.densities import WorldDensity
from sada_gym.errors import UserError, UserTypeError
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats, Floats32, real_scores
from sada_gym.foundations.determinism import check_deterministic, generators_kept, single_threaded
from sada_gym.foundations.frames import Frame, LegendEntry
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.parameters import Mu, ParameterSpace, Permits, all_can_exist

if TYPE_CHECKING:
    from sada_gym.foundations.behaviour import Behaviour

RESERVED_KEYS = frozenset({"score", "fooled", "seed", "parameters"})
"""The keys that `Application.evaluate` sets in every info itself."""

_ASKED_TWICE = 4
"""Worlds in which a user's agent is asked twice before its first score counts."""

_TRUSTED = ("sada_gym", "stable_baselines3")
"""Where the classes of shipped agents are defined."""

INVALID_SCORE = 1.0
"""The score of an invalid world: the highest, so that no adversary is drawn to it."""

INFEASIBLE = "it lies outside the region that feasible= allows"
"""Why a world is invalid that was not computed at all."""

OnError = Literal["raise", "invalid", "fooled"]
"""What becomes of a world that breaks: an error, an invalid world, or a failure of the agent."""


@dataclass(frozen=True)
class Outcomes:
    """The outcomes of a batch of n evaluations.

    `score`, (n,) float64, is Q in [0, 1]: high is good for the agent. `fooled`, (n,) bool, is true
    where Q <= the fooling threshold. Each of the n `infos` has `score`, `fooled`, `seed`,
    `parameters` (physical values by name) and what the application adds.
    """

    score: Floats
    fooled: npt.NDArray[np.bool_]
    infos: tuple[dict[str, Any], ...]

    @property
    def invalid(self) -> dict[int, str]:
        """Why worlds are invalid, by their place in the batch; see `Scored`."""
        return _invalid_reasons(self.infos)


@dataclass(frozen=True)
class Scored:
    """An application's own `evaluate_batch` returns it: n scores and n dictionaries of extras.

    Every dictionary has the same keys, and a key always the same type (arrays: one shape, too), so
    that a vector environment can batch them. Put data of varying length into a list.

    A world that cannot be computed is invalid: its extra `invalid` is a text that says why, which
    is empty in other worlds. It is no failure of the agent; its score becomes 1.
    """

    score: Floats
    extras: Sequence[Mapping[str, Any]]


class Application(ABC):
    """A frozen agent in a world built from mu, scored over a whole episode.

    A subclass must set `name`, `fooling_threshold`, `sample_size` and `parameters`, and implement
    `evaluate_batch`. That method must be pure: Q(mu, seed) is the same to the last bit whatever
    else is in the batch. `sada-gym check` tests that.

    A subclass may set or override

    - what a stored score belongs to: `version`, `settings`, `fingerprint`;
    - the agent: `agent`, `agent_name`, `privileged_score`;
    - what the agent does in a failure, in words: `behaviour`, or `behaviours`;
    - pictures: `render` and its `legend`, `frames_tell_values`, `render_batch`, `film_batch`,
      `replay` and its `render_fps`, `observation`;
    - what a run costs: `seconds_per_world`;
    - `close`, where it holds anything.

    It inherits `evaluate` and `can_render` for its callers and does not override them.

    Attributes:
        name: The general environment's id without its version, such as `SADA-Detection`.
        version: The environment's version; raise it when a score changes.
        fooling_threshold: The agent is fooled where Q <= this (epsilon in the paper).
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        agent: The agent under test, or None if it is part of the world.
        nominal: mu, (d,), of the world in ordinary use, or None if it is unknown.
        density: How likely worlds are in ordinary use, or None if it is unknown.
        permits: Says which worlds of mu, (n, d), can exist at all, (n,). The others are never
            computed, and no test sample is drawn there.
        repeatable: Whether Q(mu, seed) is the same to the last bit whenever it is evaluated. A
            simulator that cannot promise it says so; agents are then not asked twice.
        requirements: The names of several requirements that the score is the worst of; their
            margins stand in each info, and behaviours say which ones fail.
        combines: Whether its parameters are conditions that may do harm together alone: attacks
            then tell how much of each does none, and how many failures need no more.
        render_fps: Frames of `replay` in a second of its episode.
        frames_tell_values: Whether frames of `render` say the world's physical values; the sheet of
            failures then does not repeat them.
    """

    name: ClassVar[str]
    version: ClassVar[int] = 0
    repeatable: ClassVar[bool] = True
    combines: ClassVar[bool] = False
    render_fps: ClassVar[float] = 4
    frames_tell_values: ClassVar[bool] = False
    fooling_threshold: float
    sample_size: int
    parameters: ParameterSpace
    agent: Any = None
    agent_name: str = ""
    nominal: Floats32 | None = None
    density: WorldDensity | None = None
    permits: Permits = staticmethod(all_can_exist)
    requirements: tuple[str, ...] = ()
    _on_error: OnError = "raise"  # where a worker process dies in a world, see `watch`
    _timeout: float | None = None  # seconds that a worker process may take for a world
    _other_cause: ClassVar[str] = ""  # of different answers in one world, for messages

    @property
    def settings(self) -> dict[str, Any]:
        """The resolved keywords that tell this application from its siblings, JSON-compatible.

        With `name`, `version` and `fingerprint` they identify what a stored score belongs to.
        """
        return {}

    @property
    def fingerprint(self) -> str | None:
        """A SHA-256 over the agent and all else that a user brought, or None if it is unknown.

        An evaluation store is refused without one. An application with nothing exchangeable
        inside returns the empty string.
        """
        return ""

    @property
    def _own_code(self) -> tuple[Any, ...]:
        """Classes and functions whose code decides a score, besides the agent's."""
        return (type(self),)

    @abstractmethod
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        """Score a checked, non-empty batch: mu (n, d) float32 in [-1, 1], n seeds."""

    def evaluate(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Outcomes:
        """Score the agent in the worlds of a batch of mu, in one thread: see `single_threaded`.

        mu is (n, d) in [-1, 1], and rounded to float32. Each of the n seeds, Python ints in
        [0, 2**31), fixes all randomness of its evaluation. The outcomes have the same order.

        Raises:
            ValueError: If mu or the seeds are not as described, a score is not in [0, 1], or a
                user's agent answers differently when it is asked twice.
        """
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        if not len(batch):
            return Outcomes(np.zeros(0), np.zeros(0, dtype=np.bool_), ())
        with single_threaded(), isolated_rng(self):
            self._check_deterministic(batch[:_ASKED_TWICE], checked[:_ASKED_TWICE])
            score, extras = self._scored(batch, checked)
        fooled = fools(score, self.fooling_threshold)
        fooled[[*_invalid_reasons(extras)]] = False
        names = self.parameters.names
        physical = self.parameters.physical(batch).tolist()  # in one go: it is much faster
        infos = tuple(
            {
                "score": float(score[i]),
                "fooled": bool(fooled[i]),
                "seed": checked[i],
                "parameters": dict(zip(names, physical[i], strict=True)),
                **extras[i],
            }
            for i in range(len(batch))
        )
        return Outcomes(score, fooled, infos)

    @property
    def seconds_per_world(self) -> float | None:
        """About how many seconds a world takes in one process; None where worlds are fast.

        It may be measured. A run whose worlds are slow tells its cost before it starts.
        """
        return None

    @property
    def costs(self) -> str:
        """What a slow world's time is spent on, and what would save some, in sentences."""
        return ""

    @property
    def legend(self) -> Sequence[LegendEntry]:
        """What the lines and marks in frames of `render` mean, for the pictures of an attack."""
        return ()

    @property
    def can_render(self) -> bool:
        """Whether it can draw pictures."""
        return type(self).render is not Application.render

    def privileged_score(
        self,
        mu: npt.ArrayLike,  # noqa: ARG002
        seeds: Sequence[int],  # noqa: ARG002
    ) -> Floats | None:
        """Score a privileged agent: where it does well, a failure is the agent's own.

        Returns its Q, (n,), or None if none is known, as by default.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        return None

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Say what the agent did in a world, by its info of `evaluate`.

        The default takes a text `ending` of the info as what went wrong, and the other values as
        data.
        """
        from sada_gym.foundations.behaviour import Behaviour, plain_values  # they bring pydantic

        ending = info.get("ending")
        told = ending if isinstance(ending, str) and ending else ""
        extras = {key: info[key] for key in info if key not in {*RESERVED_KEYS, "invalid"}}
        return Behaviour(
            told or f"Q = {info['score']:.2f}",
            events=(told,) if told and info["fooled"] else (),
            data=plain_values(extras),
        )

    @property
    def tells_behaviour(self) -> bool:
        """Whether it says more of failures than their scores: attacks play some again to hear it.

        By default it does where a subclass overrides `behaviour` or `behaviours`.
        """
        kind = type(self)
        methods = (kind.behaviour, kind.behaviours)
        return methods != (Application.behaviour, Application.behaviours)

    def behaviours(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> tuple[Behaviour, ...]:
        """Play n worlds, mu (n, d), again, and say what the agent did in each.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        return tuple(map(self.behaviour, self.evaluate(mu, seeds).infos))

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw one frame of the world of mu, shape (d,), for a person to look at."""
        raise NotImplementedError(
            f"{type(self).__name__} draws no pictures. Implement `render(mu, seed)` in it."
        )

    def render_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw a frame, see `render`, of each world of mu, (n, d), with its seed.

        A subclass may play the episodes together; the frames stay the same.
        """
        for row, seed in zip(self.parameters.validate(mu), seeds, strict=True):
            yield self.render(row, seed)

    def film_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw such frames for a film, where they may show more than the agent sees."""
        return self.render_batch(mu, seeds)

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw what the agent sees first in the world of mu, shape (d,), without annotations.

        Novelty compares worlds by these images. The default, `render`, suits applications whose
        pictures show the world alone.
        """
        return self.render(mu, seed)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu of shape (d,) again and return all frames of the episode and its score.

        The default suits applications whose episode is a single frame.
        """
        batch: Any = [mu]
        score = float(self.evaluate(batch, [seed]).score[0])
        return [self.render(mu, seed)], score

    def close(self) -> None:  # noqa: B027 - most applications hold nothing
        """Free what the application holds; calling it twice is fine."""

    @property
    def _without_fingerprint(self) -> str:
        return (
            f"Expected a fingerprint of {self.name}'s agent to store evaluations under, got none. "
            "Pass agent_id='a name you change with the agent' and with any function of your own, "
            "give your own renderer an `identity`, or use no store."
        )

    def _scored(self, mu: Mu, seeds: list[int]) -> tuple[Floats, Sequence[Mapping[str, Any]]]:
        source = f"{type(self).__name__}.evaluate_batch"
        scored = self.evaluate_batch(mu, seeds)
        if not isinstance(scored, Scored):
            raise UserTypeError(f"Expected a Scored from {source}, got {scored!r}. Return one.")
        score = real_scores(scored.score, source)
        _check_extras(scored.extras, len(mu), source)
        if score.shape == (len(mu),) and (invalid := _invalid_reasons(scored.extras)):
            score = score.copy()
            score[[*invalid]] = INVALID_SCORE
        if score.shape != (len(mu),) or not ((score >= 0.0) & (score <= 1.0)).all():
            raise UserError(
                f"Expected {len(mu)} scores in [0, 1] from {source}, got shape {score.shape}: "
                f"{score}. Fix the application's scoring."
            )
        return score, scored.extras

    @cached_property
    def _brings_agent(self) -> bool:
        from sada_gym import agents  # the shipped ones are known to be deterministic

        package = type(self.agent).__module__.partition(".")[0]
        shipped = self.agent_name in agents.names(self.name) and package in _TRUSTED
        return self.agent is not None and not shipped

    def _check_deterministic(self, mu: Mu, seeds: list[int]) -> None:
        if self.repeatable and self._brings_agent and "_asked_twice" not in self.__dict__:
            first, second = (
                [{"score": q, **extra} for q, extra in zip(*self._scored(mu, seeds), strict=True)]
                for _ in range(2)
            )
            name = self.agent_name or type(self.agent).__name__
            check_deterministic(name, first, second, seeds, self._other_cause)
            self.__dict__["_asked_twice"] = True  # a frozen dataclass may be an application, too


def isolated_rng(application: Application) -> AbstractContextManager[None]:
    """Keep what a user's agent does to the global generators of libraries from the caller.

    `evaluate` does so itself; pictures need it, too.
    """
    return generators_kept() if application._brings_agent else nullcontext()


def feasible_worlds(
    application: Application, mu: npt.ArrayLike, seeds: Sequence[int]
) -> npt.NDArray[np.bool_] | None:
    """Return in which of n worlds, (n, d), a privileged agent is not fooled: failures count there.

    The answer is (n,) bool, or None if the application knows no privileged agent.
    """
    score = application.privileged_score(mu, seeds)
    return None if score is None else ~fools(score, application.fooling_threshold)


def check_declared(application: Application) -> None:
    """Check that an application has its parameters and its fooling threshold.

    Raises:
        UserTypeError: If one of them is missing, or the threshold is not within [0, 1].
    """
    name = type(application).__name__
    parameters = getattr(application, "parameters", None)
    if not isinstance(parameters, ParameterSpace):
        raise UserTypeError(
            f"Expected `parameters` of {name} to be a ParameterSpace, got {parameters!r}. Set it "
            "in the class or in __init__."
        )
    threshold = getattr(application, "fooling_threshold", None)
    if not isinstance(threshold, int | float | np.number) or not 0.0 <= threshold <= 1.0:
        raise UserTypeError(
            f"Expected `fooling_threshold` of {name} to be a number from 0 to 1, got "
            f"{threshold!r}. Set it in the class or in __init__."
        )


def _invalid_reasons(infos: Sequence[Mapping[str, Any]]) -> dict[int, str]:
    reasons = ((i, info.get("invalid")) for i, info in enumerate(infos))
    return {i: reason for i, reason in reasons if reason and isinstance(reason, str)}


def _check_extras(extras: Any, count: int, source: str) -> None:
    if not isinstance(extras, Sequence) or len(extras) != count:
        got = len(extras) if isinstance(extras, Sequence) else repr(extras)
        raise UserError(
            f"Expected {count} extras from {source}, one for each mu, got {got}. Return an "
            "empty dictionary where there is nothing to add."
        )
    odd = [extra for extra in extras if not isinstance(extra, Mapping)]
    if odd:
        raise UserTypeError(f"Expected dictionaries as extras from {source}, got {odd[0]!r}.")
    taken = sorted(RESERVED_KEYS & set().union(*extras))
    if taken:
        raise UserError(
            f"Expected the extras of {source} to leave {taken} to Application.evaluate, which sets "
            "them. Name yours differently."
        )


def validate_world(parameters: ParameterSpace, mu: npt.ArrayLike, seed: int) -> tuple[Mu, int]:
    """Return one mu, (d,), as (1, d), and a seed as an int, checked as `evaluate` checks them."""
    batch: Any = [mu]
    return parameters.validate(batch), validate_seeds([seed], 1)[0]

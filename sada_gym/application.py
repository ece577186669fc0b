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

    `score`, (n,) float64, is Q in [0, 1]; high is good for the agent. `fooled`, (n,) bool, is true
    where Q <= the fooling threshold. Each of the n `infos` has `score`, `fooled`, `seed`,
    `parameters` (physical values by name) and the application's own extras.
    """

    score: Floats
    fooled: npt.NDArray[np.bool_]
    infos: tuple[dict[str, Any], ...]

    @property
    def invalid(self) -> dict[int, str]:
        """The reasons for invalid worlds, by their row in the batch; see `Scored`."""
        return _invalid_reasons(self.infos)


@dataclass(frozen=True)
class Scored:
    """What `Application.evaluate_batch` returns: n scores and n dictionaries of extras.

    All dictionaries have the same keys, and a key always has values of one type (arrays: also of
    one shape), so a vector environment can batch them. Put data of varying length into a list.

    If a world cannot be computed, say why in its extra `invalid`; leave that text empty in other
    worlds. An invalid world is not a failure of the agent; its score becomes 1.
    """

    score: Floats
    extras: Sequence[Mapping[str, Any]]


class Application(ABC):
    """A frozen agent in a world built from mu, scored over a whole episode.

    A subclass must set `name`, `fooling_threshold`, `sample_size` and `parameters`, and implement
    `evaluate_batch`. That method must be pure: Q(mu, seed) is the same to the last bit, whatever
    else is in the batch. `sada-gym check` tests that.

    A subclass may set or override

    - what identifies a stored score: `version`, `settings`, `fingerprint`;
    - the agent: `agent`, `agent_name`, `privileged_score`;
    - a description of what the agent does in a failure: `behaviour`, or `behaviours`;
    - pictures: `render` and its `legend`, `frames_tell_values`, `render_batch`, `film_batch`,
      `replay` and its `render_fps`, `observation`;
    - the cost of a run: `seconds_per_world`;
    - `close`, if there is something to free.

    A subclass does not override `evaluate` and `can_render`, which its users call.

    Attributes:
        name: The general environment's id without its version, such as `SADA-Detection`.
        version: The environment's version; raise it when a score changes.
        fooling_threshold: The agent is fooled where Q <= this (epsilon in the paper).
        sample_size: The number of test samples from a trained adversary (M in the paper).
        agent: The agent under test, or None if it is part of the world.
        nominal: mu, (d,), of the usual world, or None if it is unknown.
        density: How likely worlds are in ordinary use, or None if it is unknown.
        permits: A function of mu, (n, d), that says which worlds can exist at all, (n,). The others
            are never computed, and no test sample is drawn there.
        repeatable: Whether Q(mu, seed) is always the same, to the last bit. If a simulator cannot
            promise this, set it to False: attacks then do not check an agent by asking it twice.
        requirements: The names of the requirements whose lowest score is the score. Each info has
            their margins, and behaviours say which ones fail.
        combines: Whether each parameter is a condition that may be harmless by itself but harmful
            with others. Attacks then report how much of each is harmless alone, and how many
            failures need a combination.
        render_fps: The frames of `replay` for each second of the episode.
        frames_tell_values: Whether the frames of `render` show the world's physical values; the
            sheet of failures then does not repeat them.
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
        """The keywords by which this application differs from others of its class, for JSON.

        Together with `name`, `version` and `fingerprint` they identify a stored score.
        """
        return {}

    @property
    def fingerprint(self) -> str | None:
        """A SHA-256 over the agent and everything else from a user, or None if it is unknown.

        With None, evaluations cannot be stored. An application with no exchangeable part returns
        the empty string.
        """
        return ""

    @property
    def _own_code(self) -> tuple[Any, ...]:
        """Classes and functions whose code decides a score, besides the agent's."""
        return (type(self),)

    @abstractmethod
    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        """Score a non-empty batch that was checked: mu (n, d) float32 in [-1, 1], and n seeds."""

    def evaluate(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Outcomes:
        """Score the agent in the worlds of a batch of mu, in one thread.

        mu is (n, d) in [-1, 1], and is rounded to float32. Each of the n seeds, Python ints in
        [0, 2**31), fixes all randomness of its evaluation. The outcomes have the same order.

        Raises:
            ValueError: If mu or the seeds are not as described, if a score is not in [0, 1], or if
                a user's agent answers differently when it is asked twice.
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
        """About how many seconds a world takes in one process; None if worlds are fast.

        It may be measured. If worlds are slow, a run says before it starts how long it will take.
        """
        return None

    @property
    def costs(self) -> str:
        """Sentences that say what takes the time in a slow world, and how to save some."""
        return ""

    @property
    def legend(self) -> Sequence[LegendEntry]:
        """What the lines and marks in frames of `render` mean, for pictures of an attack."""
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
        """Score a privileged agent. In worlds where it does well, a failure is the agent's fault.

        Return its Q, (n,), or None if there is no such agent; this is the default.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        return None

    def behaviour(self, info: Mapping[str, Any]) -> Behaviour:
        """Describe what the agent did in a world, from the info that `evaluate` returned.

        By default the info's text `ending` says what went wrong; the other values are data.
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
        """Whether it describes failures; attacks then replay some failures to describe them.

        By default it is true if a subclass overrides `behaviour` or `behaviours`.
        """
        kind = type(self)
        methods = (kind.behaviour, kind.behaviours)
        return methods != (Application.behaviour, Application.behaviours)

    def behaviours(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> tuple[Behaviour, ...]:
        """Replay n worlds, mu (n, d), and describe what the agent did in each.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes.
        """
        return tuple(map(self.behaviour, self.evaluate(mu, seeds).infos))

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw one frame of the world of mu, (d,), for people."""
        raise NotImplementedError(
            f"{type(self).__name__} draws no pictures. Implement `render(mu, seed)` in it."
        )

    def render_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw a frame, as `render` does, of each world of mu, (n, d), with its seed.

        A subclass may play the episodes together, if the frames stay the same.
        """
        for row, seed in zip(self.parameters.validate(mu), seeds, strict=True):
            yield self.render(row, seed)

    def film_batch(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Iterator[Frame]:
        """Draw frames for a film as `render_batch` does; they may show more than the agent sees."""
        return self.render_batch(mu, seeds)

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the first image that the agent sees in the world of mu, (d,), without annotations.

        Novelty compares worlds by these images. The default is `render`; override it if `render`
        adds anything to the world.
        """
        return self.render(mu, seed)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Evaluate one mu, (d,), again; return all frames of the episode, and its score.

        The default returns the single frame of `render`; override it for longer episodes.
        """
        batch: Any = [mu]
        score = float(self.evaluate(batch, [seed]).score[0])
        return [self.render(mu, seed)], score

    def close(self) -> None:  # noqa: B027 - most applications hold nothing
        """Free what the application holds; a second call does nothing."""

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

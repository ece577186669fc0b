"""Plays the worlds of mu in a Gymnasium environment: what scores and behaviours are made of."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.application import INFEASIBLE, INVALID_SCORE, Scored, isolated_rng, validate_world
from sada_gym.envs.episodes.base import play
from sada_gym.envs.episodes.closed_loop import EpisodesApplication
from sada_gym.envs.wrapped.behaviour import behaviour, mean_values
from sada_gym.envs.wrapped.bindings import Keyword
from sada_gym.envs.wrapped.derived import Derived
from sada_gym.envs.wrapped.episodes import (
    EpisodeSpec,
    EpisodeStart,
    GymnasiumEpisodes,
    RunningEpisode,
    in_groups,
    make_world,
    reset_arguments,
)
from sada_gym.envs.wrapped.feasible import Feasible
from sada_gym.envs.wrapped.loading import Privileged
from sada_gym.envs.wrapped.repeats import Trace, check_repeats, check_resets, trace
from sada_gym.envs.wrapped.scores import Length
from sada_gym.errors import InvalidWorld, plain
from sada_gym.evaluation.watch import is_watched, world_key
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.behaviour import Behaviour
from sada_gym.foundations.determinism import check_deterministic, same_answer, single_threaded
from sada_gym.foundations.figures import percent
from sada_gym.foundations.seeds import validate_seeds
from sada_gym.parameters import Mu

_MANY = 40
_FEW_CLIPPED = 0.05
_TRIED = 3
"""Worlds that are played together and alone before the first score counts."""
_MOST_AT_ONCE = 256
"""Worlds played at once, where their memory allows."""
_MUCH = 0.3
"""A part of a world's time that is worth saving."""


class EpisodePlayer(EpisodesApplication[GymnasiumEpisodes]):
    """Lets the agent of an application act in the worlds of mu.

    Attributes:
        episode_spec: What all episodes share.
    """

    episode_spec: EpisodeSpec
    _episode_count: int
    _feasible: Feasible
    _privileged: Privileged | None = None
    _clipped = _scores = 0
    _many_clipped = False
    _at_once = _MOST_AT_ONCE
    """Worlds played at once."""

    def episodes(self, mu: Mu, seeds: Sequence[int]) -> GymnasiumEpisodes:
        """Begin the episodes in the worlds of mu, (n, d), those of one evaluation in a row.

        All of them are alive at once, whatever `num_envs` is.
        """
        return GymnasiumEpisodes(self.episode_spec, self._starts(mu, seeds))

    def world(
        self,
        mu: npt.ArrayLike | None,
        seed: int,
        *,
        options: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> tuple[gym.Env[Any, Any], dict[str, Any]]:
        """Make the environment of an evaluation's first episode, without an agent, to train in.

        Its reset and its steps raise `InvalidWorld` where the world breaks. `mu`, (d,), None sets
        no parameter: the environment is as it is. `options` are your own for its reset.

        Returns:
            The environment, and the keywords for its `reset`, without which it is another world.
        """
        # a score that keeps no observations
        spec = replace(self.episode_spec, score=Length(1), kept=None)
        if mu is None:
            spec, values = replace(spec, bindings={}, derived=Derived()), {}
        else:
            row, seed = validate_world(self.parameters, mu, seed)
            (values,) = self._values(row)
        start = EpisodeStart(values, seed, 0)
        return make_world(spec, start, render_mode)[0], reset_arguments(spec, start, options)

    def _starts(self, mu: Mu, seeds: Sequence[int]) -> list[EpisodeStart]:
        starts = []
        for row, values, seed in zip(mu, self._values(mu), seeds, strict=True):
            world = world_key(row, seed)
            starts += [EpisodeStart(values, seed, i, world) for i in range(self._episode_count)]
        return starts

    def _values(self, mu: Mu) -> list[dict[str, Any]]:
        """Return what the parameters set in the worlds of mu, (n, d)."""
        bindings = self.episode_spec.bindings.items()
        worlds = []
        for row in self.parameters.physical(mu).tolist():
            left = iter(row)
            worlds.append({key: b.world_value([*islice(left, b.count)]) for key, b in bindings})
        return worlds

    def _named(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return what each parameter sets, by its name."""
        return {
            name: value
            for key, binding in self.episode_spec.bindings.items()
            for name, value in binding.named(key, values[key]).items()
        }

    def _possible(self, mu: Mu) -> npt.NDArray[np.bool_]:
        named = [self._named(values) for values in self._values(mu)]
        return np.array([self._feasible(one) for one in named], np.bool_)

    def evaluate_batch(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = np.full(len(mu), INVALID_SCORE)
        outside: dict[str, Any] = {"invalid": INFEASIBLE, "return": 0.0, "length": 0.0}
        outside["clipped"] = False
        if self.requirements:
            outside["requirements"] = dict.fromkeys(self.requirements, INVALID_SCORE)
        extras = [{**outside, **self._discrete_values(values)} for values in self._values(mu)]
        for i, together in self._played(mu, seeds, self.policy):
            broken = next((episode.broken for episode in together if episode.broken), "")
            mean = float(np.mean([episode.score for episode in together]))
            lost = bool(broken) and self._on_error == "fooled"
            score[i] = 0.0 if lost else mean
            extras[i] |= {
                "invalid": broken if self._on_error == "invalid" else "",
                "return": float(np.mean([sum(episode.rewards) for episode in together])),
                "length": float(np.mean([len(episode.rewards) for episode in together])),
                "clipped": any(episode.clipped for episode in together),
            }
            if self.requirements and lost:
                extras[i]["requirements"] = dict.fromkeys(self.requirements, 0.0)
            elif self.requirements and not broken:
                extras[i]["requirements"] = mean_values([one.margins for one in together])
        self._warn_of_clipping(extras)
        return Scored(score, extras)

    def behaviours(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> tuple[Behaviour, ...]:
        """Play n worlds, (n, d), again, and say when their episodes ended, and how."""
        batch = self.parameters.validate(mu)
        found = [Behaviour(INFEASIBLE)] * len(batch)
        for i, episodes in self._played(batch, validate_seeds(seeds, len(batch)), self.policy):
            found[i] = behaviour(episodes, self.fooling_threshold)
        return tuple(found)

    def privileged_score(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Floats | None:
        """Score the privileged agent, (n,); 0 where a world cannot be computed. None without one.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes, or the privileged agent
                answers differently when it is asked twice.
        """
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        if self._privileged is None:
            return None
        policy, scores = self._privileged.policy, np.zeros(len(batch))
        for i, episodes in self._played(batch, checked, policy):
            score = float(np.mean([episode.score for episode in episodes]))
            scores[i] = 0.0 if np.isnan(score) else score
        for i in range(min(len(batch), _TRIED)):
            for _, episodes in self._played(batch[i : i + 1], checked[i : i + 1], policy):
                again = float(np.nan_to_num(np.mean([episode.score for episode in episodes])))
                answers = ([{"score": float(scores[i])}], [{"score": again}])
                check_deterministic(self._privileged.name, *answers, checked[i : i + 1])
        return scores

    @property
    def seconds_per_world(self) -> float | None:
        """The seconds of one world, measured once; None where it breaks, or may take for ever."""
        return self._measured[0]

    @property
    def costs(self) -> str:
        """What that world's time was spent on, and what would save some."""
        return self._measured[1]

    @cached_property
    def _measured(self) -> tuple[float | None, str]:
        mu = np.zeros((1, len(self.parameters)), np.float32)
        if self.nominal is not None:
            mu[0] = self.nominal
        if self._timeout is not None or not self.permits(mu)[0]:
            return None, ""
        began = time.perf_counter()
        try:
            [(_, episodes)] = self._played(mu, [0], self.policy)
        except InvalidWorld:  # on_error="raise" is for the worlds of queries
            return None, ""
        total = time.perf_counter() - began
        if any(episode.broken for episode in episodes):
            return None, ""
        spent = {part: sum(e.spent[part] for e in episodes) for part in episodes[0].spent}
        kept = self.episode_spec.kept is not None
        if kept:  # made once for many worlds
            total -= spent.pop("constructor")
        spent["agent"] = max(total - sum(spent.values()), 0.0)
        shares = {part: seconds / total for part, seconds in spent.items()}
        told = [f"{part} {percent(share)}" for part, share in shares.items()]
        steps = sum(len(episode.rewards) for episode in episodes)
        text = f"Time: {', '.join(told)}; {steps:,} steps."
        by_keyword = any(isinstance(b, Keyword) for b in self.episode_spec.bindings.values())
        if not kept and not by_keyword and shares["constructor"] > _MUCH:
            text += " reuse=True would save the constructor, if reset undoes all that episodes do."
        if shares["steps"] > _MUCH and any(episode.truncated for episode in episodes):
            text += " A smaller max_steps= would shorten episodes."
        return total, f"{text} More workers share the worlds (--workers, workers=)."

    def _played(
        self, mu: Mu, seeds: Sequence[int], policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]]
    ) -> Iterator[tuple[int, list[RunningEpisode]]]:
        """Play all worlds that are feasible to their ends; yield their places and episodes."""

        def to_end(episodes: GymnasiumEpisodes) -> list[RunningEpisode]:
            play(policy, episodes)
            return episodes.running

        left, each = np.flatnonzero(self.permits(mu)).tolist(), self._episode_count
        together = 0 if self.episode_spec.lanes else each
        while left:
            worlds = left[: self._at_once]
            starts = self._starts(mu[worlds], [seeds[i] for i in worlds])
            with isolated_rng(self):
                running = in_groups(self.episode_spec, starts, to_end, together=together)
            count = len(running) // each
            if count < len(worlds):  # memory that was freed may not be seen the next time
                self._at_once = count
            for k, i in enumerate(worlds[:count]):
                yield i, running[k * each : (k + 1) * each]
            left = left[count:]

    def _check_deterministic(self, mu: Mu, seeds: list[int]) -> None:
        """Play worlds together and then alone, before the first score counts."""
        if "_asked_twice" in self.__dict__ or not self.repeatable:
            return
        # beside neighbours of the first, but for a worker: it might die in a world of no query
        if len(mu) < _TRIED and not is_watched():
            shares = np.linspace(0.9, 0.7, _TRIED - len(mu), dtype=np.float32)[:, None]
            others = shares * mu[0] - np.float32(0.01)
            others = others[self.permits(others)]
            mu, seeds = np.concatenate([mu, others]), [*seeds, *(len(others) * seeds[:1])]
        spec = self.episode_spec
        try:
            self.episode_spec = replace(spec, kept=None)  # in new environments
            together = self._answers(mu, seeds)
        finally:
            self.episode_spec = spec
        alone = [self._answers(mu[i : i + 1], seeds[i : i + 1])[0] for i in range(len(mu))]
        if not same_answer(together, alone):
            self._check_environment_repeats(mu, seeds)
            check_deterministic(self.agent_name, together, alone, seeds)
        self.__dict__["_asked_twice"] = True

    def _answers(self, mu: Mu, seeds: list[int]) -> list[dict[str, Any]]:
        return [{"score": q, **extra} for q, extra in zip(*self._scored(mu, seeds), strict=True)]

    def _check_environment_repeats(self, mu: Mu, seeds: list[int]) -> None:
        """Raise `UserError` if the same actions lead elsewhere, alone or beside other worlds."""

        def traced(
            worlds: slice, given: Sequence[Trace] = (), *, kept: bool = False
        ) -> list[Trace]:
            left = iter(given)
            spec = self.episode_spec if kept else replace(self.episode_spec, kept=None)

            def follow(episodes: GymnasiumEpisodes) -> list[Trace]:
                with single_threaded():
                    return trace(self.policy, episodes, [*islice(left, len(episodes))])

            return in_groups(spec, self._starts(mu[worlds], seeds[worlds]), follow)

        name, each = self.episode_spec.factory.name, self._episode_count
        together = check_repeats(name, traced, seeds, each)
        if self.episode_spec.kept is not None:
            again = traced(slice(None), together, kept=True)
            check_resets(name, together, again, seeds, each)

    def _discrete_values(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the choices and whole numbers that were set; `parameters` shows only positions."""
        named = self._named(values)
        pairs = [*zip(self.parameters.parameters, named.values(), strict=True)]
        chosen = {p.name: plain(str(v)) for p, v in pairs if p.choices and not p.whole}
        whole = {parameter.name: value for parameter, value in pairs if parameter.whole}
        return {"values": chosen | whole} if chosen or whole else {}

    def _warn_of_clipping(self, extras: Sequence[Mapping[str, Any]]) -> None:
        self._scores += len(extras)
        self._clipped += sum(extra["clipped"] for extra in extras)
        many = self._scores >= _MANY and self._clipped > _FEW_CLIPPED * self._scores
        if many and not self._many_clipped:
            warnings.warn(
                f"More than {_FEW_CLIPPED:.0%} of the evaluations of "
                f"{self.episode_spec.factory.name} had a return outside the range of "
                f"score={self.episode_spec.score.settings}. Their scores were clipped, so that an "
                "adversary cannot tell them apart. Widen the range.",
                stacklevel=2,
            )
        self._many_clipped = many

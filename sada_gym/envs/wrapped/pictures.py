"""Draws the episodes in a Gymnasium environment: frames, replays and films."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from sada_gym.application import INVALID_SCORE, validate_world
from sada_gym.envs.episodes.base import Rollout, play, record
from sada_gym.envs.wrapped.episodes import EpisodeStart, GymnasiumEpisodes, ResultT, in_groups
from sada_gym.envs.wrapped.inspection import Inspection
from sada_gym.envs.wrapped.playing import EpisodePlayer
from sada_gym.errors import Notice
from sada_gym.evaluations import fools
from sada_gym.foundations.arrays import Floats
from sada_gym.foundations.drawing import stamped
from sada_gym.foundations.figures import number
from sada_gym.foundations.frames import Frame, LegendEntry, Take
from sada_gym.parameters import Mu


class EpisodePictures(EpisodePlayer):
    """Draws what the agent of an application does in a world of mu."""

    _inspection: Inspection

    @property
    def can_render(self) -> bool:
        """Whether the environment renders as `rgb_array`."""
        modes = self._inspection.metadata.get("render_modes") or ()
        return "rgb_array" in modes and self.episode_spec.factory.takes_render_mode

    def _checked(self, mu: npt.ArrayLike, seed: int) -> tuple[Mu, int]:
        checked = validate_world(self.parameters, mu, seed)
        if not self.can_render:
            raise NotImplementedError(
                f"{self.episode_spec.factory.name} draws no pictures: it has no "
                "render_mode='rgb_array'."
            )
        return checked

    def _drawn(
        self,
        starts: Sequence[EpisodeStart],
        draw: Callable[[GymnasiumEpisodes], Sequence[ResultT]],
        pictures: bool = True,
    ) -> list[ResultT]:
        with _missing_drawing_library():
            return in_groups(self.episode_spec, starts, draw, pictures=pictures)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """Which frame of an episode is drawn."""
        count, name = self._episode_count, self.episode_spec.factory.name
        which = "the episode" if count == 1 else f"the worst of {count} episodes"
        return (LegendEntry(f"The last frame of {which}, as {name} draws it."),)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the last frame of the episode, of several that with the lowest score."""

        def draw(episodes: GymnasiumEpisodes) -> list[tuple[Floats, float, Frame]]:
            play(self.policy, episodes)
            (worst,) = which = episodes.score.argsort(kind="stable")[:1]
            return [(episodes.score, episodes.score[worst], episodes.render(which)[0])]

        row, seed = self._checked(mu, seed)
        scores, lowest, frames = zip(*self._drawn(self._starts(row, [seed]), draw), strict=True)
        frame = frames[np.argsort(lowest, kind="stable")[0]]
        (frame,) = self._compared(mu, seed, [frame], float(np.concatenate(scores).mean()))
        return frame

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the first frame of the first episode."""
        row, seed = self._checked(mu, seed)
        first = self._starts(row, [seed])[:1]
        (frame,) = self._drawn(first, lambda episodes: [*episodes.render(np.zeros(1, np.intp))])
        return np.asarray(frame)

    def rollouts(self, mu: npt.ArrayLike, seed: int) -> list[Rollout[Any]]:
        """Play all episodes in the world of one mu, (d,), and keep returns, and frames if any."""
        row, seed = validate_world(self.parameters, mu, seed)
        keep = partial(record, self.policy)
        return self._drawn(self._starts(row, [seed]), keep, pictures=self.can_render)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Play the episodes again, one after another: all frames, and the score."""
        self._checked(mu, seed)
        frames, score = super().replay(mu, seed)
        frames = self._compared(mu, seed, frames, score)
        if np.isnan(score):  # the world broke
            score = 0.0 if self._on_error == "fooled" else INVALID_SCORE
        return frames, score

    def takes(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Take], float]:
        """Play the episodes again, for a film: each of them, and the score."""
        self._checked(mu, seed)
        rollouts = self.rollouts(mu, seed)
        score = float(np.mean([rollout.score for rollout in rollouts]))
        return [self._take(rollouts, i) for i in range(len(rollouts))], score

    def _take(self, rollouts: list[Rollout[Any]], i: int) -> Take:
        rollout, count = rollouts[i], len(rollouts)
        name = f"episode {i + 1} of {count}  ·  " if count > 1 else ""

        def draw(step: int) -> tuple[Frame, str]:
            return rollout["frame"][step], f"{name}step {step}  ·  return {returns[step]}"

        returns = [number(value) for value in rollout["return"].tolist()]
        ending = f"return {returns[-1]} after {rollout.last} steps"
        return Take(rollout.last + 1, draw, ending, fools(rollout.score, self.fooling_threshold))

    def _compared(
        self, mu: npt.ArrayLike, seed: int, frames: list[Frame], score: float
    ) -> list[Frame]:
        """Say, in a warning and in the frames, where the same world has another score undrawn."""
        row, seed = validate_world(self.parameters, mu, seed)
        if not self.repeatable:
            return frames
        undrawn = self.evaluate(row, [seed])
        if undrawn.invalid or undrawn.score[0] == (0.0 if np.isnan(score) else score):
            return frames
        warnings.warn(
            f"Pictures of {self.episode_spec.factory.name} show other episodes than are scored: "
            "its render, or its render_mode, changes what happens. Fix it.",
            Notice,
            stacklevel=3,
        )
        text = f"not the episode that was scored: Q = {score:.2f} drawn, {undrawn.score[0]:.2f} not"
        return [stamped(frame, text) for frame in frames]

    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        return [frame for rollout in rollouts for frame in rollout["frame"]]


@contextmanager
def _missing_drawing_library() -> Iterator[None]:
    """Let a missing drawing library mean that there are no pictures."""
    try:
        yield
    except DependencyNotInstalled as error:
        raise NotImplementedError(f"The environment cannot be drawn: {error}") from error

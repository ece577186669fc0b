"""Tasks of ours in lockstep, for training: faster than one environment after another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sada_gym.analyses.training.curriculum import task_id
from sada_gym.analyses.training.mixture import WorldMixture
from sada_gym.analyses.training.tasks import KINDS
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.lazy import load
from sada_gym.foundations.sb3_vec_env import SB3VecEnv


@dataclass(frozen=True, eq=False)
class CurriculumStarts:
    """A start distribution whose worlds come from a mixture.

    Attributes:
        starts: Draws all else.
        mixture: Draws mu.
        at: See `sada_gym.analyses.training.tasks.TaskKind`.
    """

    starts: Any
    mixture: WorldMixture
    at: Callable[[Any, Floats32], Any]

    def draw(self, rng: np.random.Generator) -> Any:
        """Draw the start of one episode."""
        mu = self.mixture.draw(rng).mu
        starts = self.starts if mu is None else self.at(self.starts, mu)
        return starts.draw(rng)

    @property
    def layout(self) -> str:
        """The town of drives."""
        layout: str = self.starts.layout
        return layout


def curriculum_starts(
    name: str, source: Any = None, *, shares: Mapping[str, float] | None = None, starts: Any = None
) -> CurriculumStarts:
    """Return a start distribution for an application's task, `SADA-Driving` or `SADA-Robot`.

    `starts` draws all but the worlds; None takes the task's own. The others are those of
    `FailureCurriculum`, whose errors it raises.
    """
    card = find_card(name)
    assert card is not None
    kind, ((_, batch),) = KINDS[name], card.tasks.values()
    starts = load(batch).task_class.distribution_class() if starts is None else starts
    return CurriculumStarts(starts, WorldMixture(kind.space, source, shares), kind.at)


class CurriculumVecEnv(SB3VecEnv):
    """Episodes of a task in lockstep, each in a world that `mixture` draws."""

    def __init__(self, env: Any, starts: CurriculumStarts) -> None:
        super().__init__(env)
        env.unwrapped.task.distribution = starts
        self.mixture = starts.mixture

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """Call `set_source`, which all episodes share."""
        if method_name != "set_source":
            return super().env_method(method_name, *args, indices=indices, **kwargs)
        self.mixture.set_source(*args, **kwargs)
        return [None for _ in self._get_indices(indices)]


def curriculum_vec_env(
    environment: str,
    source: Any = None,
    *,
    num_envs: int,
    shares: Mapping[str, float] | None = None,
    starts: Any = None,
) -> CurriculumVecEnv:
    """Make a vector environment of `FailureCurriculum` for a shipped task and Stable-Baselines3.

    Args:
        environment: An id, such as `SADA-Robot-v0`.
        source: See `FailureCurriculum`.
        num_envs: The number of environments.
        shares: See `FailureCurriculum`.
        starts: The distribution of starts, such as `sada_gym.envs.driving.DriveDistribution()`.

    Raises:
        UserError: As `FailureCurriculum` does.
    """
    import gymnasium as gym

    env_id, name = task_id(environment)
    drawn = curriculum_starts(name, source, shares=shares, starts=starts)
    return CurriculumVecEnv(gym.make_vec(env_id, num_envs=num_envs), drawn)

"""The tasks on which our drivers and robots are trained, in worlds that mu sets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym

from sada_gym.analyses.training.worlds import WorldSpace
from sada_gym.application import Application
from sada_gym.envs.driving.application import DrivingApplication
from sada_gym.envs.driving.episodes import DriveDistribution
from sada_gym.envs.driving.world.weather import NAMES
from sada_gym.envs.robot.application import RobotApplication
from sada_gym.envs.robot.start import TripDistribution, conditions
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.cards import find_card
from sada_gym.foundations.lazy import load


@dataclass(frozen=True)
class TaskKind:
    """How a task of ours is played in the world of one mu.

    Attributes:
        application: Its parameters are those of mu.
        at: Takes a start distribution and mu, (d,), and returns the same one in that world.
    """

    application: type[Application]
    at: Callable[[Any, Floats32], Any]

    @property
    def space(self) -> WorldSpace:
        """The task's worlds; the nominal ones are those that the start distribution draws."""
        return WorldSpace(self.application.name, self.application.parameters)


def robot_at(starts: TripDistribution, mu: Floats32) -> TripDistribution:
    """Return trips that all take place in the conditions of one mu, (10,)."""
    return replace(starts, conditions=conditions(mu), spread=0.0)


def driving_at(starts: DriveDistribution, mu: Floats32) -> DriveDistribution:
    """Return drives that all have the camera and the weather of one mu, (3,)."""
    height, pitch, place = DrivingApplication.parameters.physical(mu).tolist()
    weather = NAMES[min(int(place), len(NAMES) - 1)]
    return replace(starts, height_m=(height, height), pitch_deg=(pitch, pitch), weathers=(weather,))


KINDS = {
    kind.application.name: kind
    for kind in (
        TaskKind(DrivingApplication, driving_at),
        TaskKind(RobotApplication, robot_at),
    )
}
"""By the application's name."""


class TaskWorlds(gym.Wrapper[Any, Any, Any, Any]):
    """A task of ours in worlds that mu sets; all else its own start distribution draws.

    Args:
        env: The task, such as `gymnasium.make("SADA-RobotTask-v0")`, wrapped or not.
        name: The application's name, one of `KINDS`.
    """

    def __init__(self, env: gym.Env[Any, Any], name: str) -> None:
        super().__init__(env)
        self._kind = KINDS[name]
        self.space = self._kind.space
        self._starts: Any = env.unwrapped.task.distribution  # type: ignore[attr-defined]

    def set_mu(self, mu: Floats32 | None) -> None:
        """Set the world, see `Worlds`."""
        starts = self._starts if mu is None else self._kind.at(self._starts, mu)
        self.unwrapped.task.distribution = starts  # type: ignore[attr-defined]


def task_of(env: gym.Env[Any, Any]) -> str | None:
    """Return the name of the application whose task an environment is; None where it is none."""
    for name in KINDS:
        card = find_card(name)
        entry_points = [] if card is None else [pair[0] for pair in card.tasks.values()]
        if any(isinstance(env.unwrapped, load(entry_point)) for entry_point in entry_points):
            return name
    return None

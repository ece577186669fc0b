"""Disturbed sensors and actuators for every environment: noise, delay, dropout, gain, repeats.

An observation passes noise, delay and dropout, in this order: the sensor is noisy, its messages are
late, and some are lost. An action passes delay, gain and noise, and is clipped to its space: the
command is late, and the actuator is worn and noisy. A step is one of the environment's.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from sada_gym.envs.wrapped import wrappers
from sada_gym.envs.wrapped.bindings import ParameterBinding
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.errors import UserError, check_integer, check_known
from sada_gym.parameters import Parameter

Env = gym.Env[Any, Any]


@dataclass(frozen=True)
class Disturbance(ParameterBinding):
    """A disturbance of what the agent sees or does: it wraps the environment for one episode."""

    minimum: ClassVar[float] = 0.0
    maximum: ClassVar[float] = np.inf
    whole: ClassVar[bool] = False
    layer: ClassVar[int]
    """Where its wrapper stands among those of an episode, from the inside out."""

    def __post_init__(self) -> None:
        """Make numbers of steps whole."""
        if self.whole and not self.choices:
            object.__setattr__(self, "integer", True)

    @abstractmethod
    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:
        """Wrap the environment of one episode.

        Args:
            env: The environment.
            value: The parameter's value.
            rng: The generator of this disturbance in this episode.
        """

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name.

        Raises:
            UserError: If the range is empty, or reaches beyond what the disturbance can be.
        """
        values = self._values(name)
        numbers = all(isinstance(value, int | float) for value in values)
        if not numbers or min(values) < self.minimum or max(values) > self.maximum:
            limit = "" if self.maximum == np.inf else f" and at most {self.maximum:g}"
            raise UserError(
                f"Expected {type(self).__name__} {name!r} of at least {self.minimum:g}{limit}, got "
                f"{values}. Mend its range."
            )
        return super().parameter(name)

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return one target for all: there is one disturbance of each kind."""
        return ("all",)

    def _values(self, name: str) -> list[Any]:
        return [*(self.choices or self._range(name))]


@dataclass(frozen=True)
class ObservationNoise(Disturbance):
    """Gaussian noise on observations; the value is its standard deviation, in their units.

    It is added anew at each step to the numbers of a Box, or to those of all Boxes of floats in a
    Dict. Noise never takes a number out of the bounds of its space; whole numbers, such as the
    pixels of an image, are rounded.

    Attributes:
        key: The one key of a Dict that is noisy; None means all.
        entries: The entries of the flattened Box that are noisy; None means all.
    """

    layer = 3
    key: str | None = None
    entries: tuple[int, ...] | None = None

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return the entries that are noisy."""
        return ((self.key, tuple(self.entries or ())),)

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that there are Boxes to be noisy."""
        space = env.observation_space
        if isinstance(space, spaces.Dict) and self.key is not None:
            check_known(f"key of the observations of {factory.name}", [self.key], [*space])
        elif self.key is not None:
            raise UserError(
                f"Expected no key of {name!r}, because the observations of {factory.name} are no "
                f"dictionary, got {self.key!r}."
            )
        boxes = self._boxes(space)
        if not boxes or not all(isinstance(box, spaces.Box) for box in boxes.values()):
            raise UserError(
                f"Expected observations of numbers (Box) in {factory.name} for the noise {name!r}, "
                f"got {space}. Use ObservationDropout or ObservationDelay, which fit all."
            )
        for box in boxes.values():
            for entry in self.entries or ():
                check_integer(f"the entries of {name!r}", entry, 0, int(np.prod(box.shape)) - 1)

    def _boxes(self, space: spaces.Space[Any]) -> dict[str | None, Any]:
        if not isinstance(space, spaces.Dict):
            return {None: space}
        if self.key is not None:
            return {self.key: space[self.key]}
        return {
            key: part
            for key, part in space.items()
            if isinstance(part, spaces.Box) and part.dtype.kind == "f"
        }

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:
        """Add noise to each observation."""
        boxes = self._boxes(env.observation_space)
        return wrappers.NoisyObservations(env, value, boxes, self.entries, rng)


@dataclass(frozen=True)
class ObservationDelay(Disturbance):
    """The agent sees what was the case some steps ago; until then, the first observation."""

    layer = 4
    whole = True

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:  # noqa: ARG002
        """Hold observations back."""
        return wrappers.LateObservations(env, value)


@dataclass(frozen=True)
class ObservationDropout(Disturbance):
    """The value is the probability, at each step, that the agent gets the last observation again.

    The first observation of an episode always arrives.
    """

    layer = 5
    maximum = 1.0

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:
        """Lose observations."""
        return wrappers.LostObservations(env, value, rng)


@dataclass(frozen=True)
class ActionDelay(Disturbance):
    """An action acts some steps after it was chosen.

    Until the first one arrives, a Box action is zero (or the number in the space nearest to it);
    another kind of action has no zero, and the first one acts from the beginning.
    """

    layer = 2
    whole = True

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:  # noqa: ARG002
        """Hold actions back."""
        return wrappers.LateActions(env, value)


@dataclass(frozen=True)
class ActionGain(Disturbance):
    """Box actions are multiplied by the value, and clipped to their space."""

    layer = 1
    minimum = -np.inf

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that actions are numbers."""
        if not isinstance(env.action_space, spaces.Box):
            raise UserError(
                f"Expected actions that are numbers (Box) in {factory.name} for the gain {name!r}, "
                f"got {env.action_space}. Use ActionNoise, ActionDelay or RepeatedActions, which "
                "fit all."
            )

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:  # noqa: ARG002
        """Multiply actions."""
        return wrappers.ScaledActions(env, value)


@dataclass(frozen=True)
class ActionNoise(Disturbance):
    """Noise on actions.

    On Box actions it is Gaussian; the value is its standard deviation as a share of half the range
    of the space. Of Discrete and MultiDiscrete actions, the value is the probability, at each step,
    that a uniformly drawn action acts instead.
    """

    layer = 0

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that a Box has a range, and that a probability is one."""
        space = env.action_space
        if isinstance(space, spaces.Box):
            if not space.is_bounded():
                raise UserError(
                    f"Expected finite bounds of the actions of {factory.name} for the noise "
                    f"{name!r}, which is a share of their range, got {space}. Leave it out."
                )
        elif max(self._values(name)) > 1.0:
            raise UserError(
                f"Expected the noise {name!r} of at most 1, because the actions of {factory.name} "
                f"are no numbers and it is a probability, got {self.choices or self.high}."
            )

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:
        """Disturb actions."""
        return wrappers.NoisyActions(env, value, rng)


@dataclass(frozen=True)
class RepeatedActions(Disturbance):
    """Each action of the agent acts for some steps, at least one, before it is asked again."""

    layer = 6
    minimum = 1.0
    whole = True

    def wrap(self, env: Env, value: Any, rng: np.random.Generator) -> Env:  # noqa: ARG002
        """Repeat each action."""
        return wrappers.RepeatedSteps(env, int(value))

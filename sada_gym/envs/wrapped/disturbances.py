"""Disturbed sensors and actuators for every environment: noise, delay, dropout, gain, repeats.

An observation passes noise, delay and dropout, in this order: the sensor is noisy, its messages are
late, and some are lost. An action passes delay, gain and noise, and is clipped to its space: the
command is late, and the actuator is worn and noisy. A step is one of the environment's.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from sada_gym.envs.wrapped.maker import Maker
from sada_gym.envs.wrapped.places import Place, Setup
from sada_gym.errors import UserError, check_integer, check_known
from sada_gym.parameters import Parameter

Space = spaces.Space[Any]


@dataclass(frozen=True)
class Disturbance(Place):
    """A disturbance of what the agent sees or does."""

    least: ClassVar[float] = 0.0
    most: ClassVar[float] = np.inf
    whole: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Make numbers of steps whole."""
        if self.whole and not self.choices:
            object.__setattr__(self, "integer", True)

    def parameter(self, name: str) -> Parameter:
        """Give the parameter of this name.

        Raises:
            UserError: If the range is empty, or reaches beyond what the disturbance can be.
        """
        if self.choices:
            ends = [*self.choices]
            numbers = all(isinstance(end, int | float) for end in ends)
        else:
            ends, numbers = [*self._range(name)], True
        if not numbers or min(ends) < self.least or max(ends) > self.most:
            most = "" if self.most == np.inf else f" and at most {self.most:g}"
            raise UserError(
                f"Expected {type(self).__name__} {name!r} of at least {self.least:g}{most}, got "
                f"{ends}. Mend its range."
            )
        return super().parameter(name)

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Say that there is one of each kind."""
        return ("all",)

    def check(self, name: str, maker: Maker, env: gym.Env[Any, Any]) -> None:
        """Check that it fits the environment's spaces."""
        self.fit(name, maker, env.observation_space, env.action_space)

    @abstractmethod
    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:
        """Check that it fits the space of what is seen and that of what is done.

        Raises:
            UserError: If it does not.
        """


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

    key: str | None = None
    entries: tuple[int, ...] | None = None

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Name the entries that are noisy."""
        return ((self.key, tuple(self.entries or ())),)

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:  # noqa: ARG002
        """Check that there are Boxes to be noisy."""
        parts = self._parts(name, maker, seen)
        for part in parts.values():
            size = int(np.prod(part.shape))
            for entry in self.entries or ():
                check_integer(f"the entries of {name!r}", entry, 0, size - 1)

    def _parts(self, name: str, maker: Maker, seen: Space) -> dict[str | None, spaces.Box[Any]]:
        found: dict[str | None, Space] = {None: seen}
        if isinstance(seen, spaces.Dict):
            if self.key is not None:
                check_known(f"key of the observations of {maker.name}", [self.key], [*seen])
                found = {self.key: seen[self.key]}
            else:
                found = {key: one for key, one in seen.items() if _is_float(one)}
        elif self.key is not None:
            raise UserError(
                f"Expected no key of {name!r}, because the observations of {maker.name} are no "
                f"dictionary, got {self.key!r}."
            )
        boxes = {key: one for key, one in found.items() if isinstance(one, spaces.Box)}
        if not boxes or len(boxes) < len(found):
            raise UserError(
                f"Expected observations of numbers (Box) in {maker.name} for the noise {name!r}, "
                f"got {seen}. Use ObservationDropout or ObservationDelay, which fit all."
            )
        return boxes

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Add noise to each observation."""
        rng = setup.generator(name)
        chosen = None if self.entries is None else [*self.entries]

        def disturb(number: Any, box: spaces.Box[Any]) -> Any:
            noise = rng.standard_normal(np.shape(number))
            if chosen is not None:
                kept = noise.reshape(-1)[chosen]
                noise = np.zeros_like(noise)
                noise.reshape(-1)[chosen] = kept
            if not value:
                return number
            clean = np.asarray(number, np.float64)
            noisy = clean + value * noise
            if box.dtype.kind in "iu":
                noisy = np.rint(noisy)
            # an environment may leave its own bounds: only noise does not
            low, high = np.minimum(box.low, clean), np.maximum(box.high, clean)
            return np.clip(noisy, low, high).astype(np.asarray(number).dtype)

        def sense(observation: Any) -> Any:
            seen = setup.observation_space
            if isinstance(seen, spaces.Dict):
                noisy = {
                    key: disturb(observation[key], box)
                    for key, box in parts.items()
                    if key is not None
                }
                return {**observation, **noisy}
            return disturb(observation, parts[None])

        parts = self._parts(name, setup.maker, setup.observation_space)
        setup.sensors.append((0, sense))


@dataclass(frozen=True)
class ObservationDelay(Disturbance):
    """The agent sees what was the case some steps ago; until then, the first observation."""

    whole = True

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:
        """It fits all spaces."""

    def prepare(self, name: str, value: Any, setup: Setup) -> None:  # noqa: ARG002
        """Hold observations back."""
        line: deque[Any] = deque(maxlen=value + 1)

        def sense(observation: Any) -> Any:
            line.append(observation)
            return line[0]

        setup.sensors.append((1, sense))


@dataclass(frozen=True)
class ObservationDropout(Disturbance):
    """The value is the probability, at each step, that the agent gets the last observation again.

    The first observation of an episode always arrives.
    """

    most = 1.0

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:
        """It fits all spaces."""

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Lose observations."""
        rng = setup.generator(name)
        last: list[Any] = []

        def sense(observation: Any) -> Any:
            lost = rng.random() < value
            if not last or not lost:
                last[:] = [observation]
            return last[0]

        setup.sensors.append((2, sense))


@dataclass(frozen=True)
class ActionDelay(Disturbance):
    """An action acts some steps after it was chosen.

    Until the first one arrives, a Box action is zero (or the number in the space nearest to it);
    another kind of action has no zero, and the first one acts from the beginning.
    """

    whole = True

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:
        """It fits all spaces."""

    def prepare(self, name: str, value: Any, setup: Setup) -> None:  # noqa: ARG002
        """Hold actions back."""
        line: deque[Any] = deque(maxlen=value + 1)
        if isinstance(setup.action_space, spaces.Box):
            line.extend([np.zeros(setup.action_space.shape)] * value)

        def act(action: Any) -> Any:
            line.append(action)
            return line[0]

        setup.actuators.append((0, act))


@dataclass(frozen=True)
class ActionGain(Disturbance):
    """Box actions are multiplied by the value, and clipped to their space."""

    least = -np.inf

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:  # noqa: ARG002
        """Check that actions are numbers."""
        _refuse_choices(f"the gain {name!r}", maker, done)

    def prepare(self, name: str, value: Any, setup: Setup) -> None:  # noqa: ARG002
        """Multiply actions."""
        setup.actuators.append((1, lambda action: np.asarray(action, np.float64) * value))


@dataclass(frozen=True)
class ActionNoise(Disturbance):
    """Noise on actions.

    On Box actions it is Gaussian; the value is its standard deviation as a share of half the range
    of the space. Of Discrete and MultiDiscrete actions, the value is the probability, at each step,
    that a uniformly drawn action acts instead.
    """

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:  # noqa: ARG002
        """Check that a Box has a range, and that a probability is one."""
        if isinstance(done, spaces.Box):
            if not done.is_bounded():
                raise UserError(
                    f"Expected finite bounds of the actions of {maker.name} for the noise "
                    f"{name!r}, which is a share of their range, got {done}. Leave it out."
                )
        elif max([*self.choices] or [*self._range(name)]) > 1.0:
            raise UserError(
                f"Expected the noise {name!r} of at most 1, because the actions of {maker.name} "
                f"are no numbers and it is a probability, got {self.choices or self.high}."
            )

    def prepare(self, name: str, value: Any, setup: Setup) -> None:
        """Disturb actions."""
        rng, space = setup.generator(name), setup.action_space
        if isinstance(space, spaces.Box):
            half = (space.high.astype(np.float64) - space.low) / 2.0

            def disturb(action: Any) -> Any:
                return action + value * half * rng.standard_normal(half.shape)

        else:
            draw = _drawing(space, rng)

            def disturb(action: Any) -> Any:
                other, swapped = draw(), rng.random() < value
                return other if swapped else action

        setup.actuators.append((2, disturb))


@dataclass(frozen=True)
class RepeatedActions(Disturbance):
    """Each action of the agent acts for some steps, at least one, before it is asked again."""

    least = 1.0
    whole = True

    def fit(self, name: str, maker: Maker, seen: Space, done: Space) -> None:
        """It fits all spaces."""

    def prepare(self, name: str, value: Any, setup: Setup) -> None:  # noqa: ARG002
        """Set the number of steps."""
        setup.repeats = int(value)


def refuse_doubles(places: dict[str, Place]) -> None:
    """Refuse two parameters of one place, of which one would be without effect.

    Noise on other entries is another place.

    Raises:
        UserError: If there are two.
    """
    seen: dict[Any, str] = {}
    for name, place in places.items():
        for target in dict.fromkeys(place.targets(name)):
            where = (type(place), target)
            if where in seen:
                raise UserError(
                    f"Expected one {type(place).__name__}, got {seen[where]!r} and {name!r} for "
                    "the same place. Leave one out."
                )
            seen[where] = name


def _is_float(space: Space) -> bool:
    return isinstance(space, spaces.Box) and space.dtype.kind == "f"


def _refuse_choices(what: str, maker: Maker, space: Space) -> None:
    if not isinstance(space, spaces.Box):
        raise UserError(
            f"Expected actions that are numbers (Box) in {maker.name} for {what}, got {space}. "
            "Use ActionNoise, ActionDelay or RepeatedActions, which fit all."
        )


def _drawing(space: Space, rng: np.random.Generator) -> Callable[[], Any]:
    """Give a function that draws a member of a space of choices."""
    if isinstance(space, spaces.Discrete):
        return lambda: space.dtype.type(space.start + rng.integers(space.n))
    if isinstance(space, spaces.MultiDiscrete):
        return lambda: (space.start + rng.integers(space.nvec)).astype(space.dtype)
    return lambda: rng.integers(2, size=space.shape).astype(space.dtype)

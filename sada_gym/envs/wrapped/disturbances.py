"""Disturbed sensors and actuators for every environment: noise, delay, dropout, gain, repeats.

An observation passes noise, delay and dropout, in this order: the sensor is noisy, its messages are
late, and some are lost. An action passes delay, gain and noise, and is clipped to its space: the
command is late, and the actuator is worn and noisy. A step is one of the environment's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from sada_gym.envs.wrapped.bindings import ParameterBinding
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.profiles import Profile
from sada_gym.errors import UserError, UserTypeError, check_integer, check_known
from sada_gym.parameters import Parameter

if TYPE_CHECKING:
    from sada_gym.envs.wrapped.pixel_noise import PixelNoise

Env = gym.Env[Any, Any]
Generator = np.random.Generator

_MOST_STEPS = 1_000_000
"""The most steps of a delay, which are kept in memory, and of a repetition."""


class EpisodeWrapper(gym.Wrapper[Any, Any, Any, Any]):
    """Disturbs one episode as much as a value says, by a generator of its own."""

    lag: ClassVar[int] = 0
    """1 for observations, which have the value of the step that led to them."""

    def __init__(self, env: Env, value: Any, rng: Generator) -> None:
        super().__init__(env)
        self._given, self.rng = value, rng

    @property
    def value(self) -> Any:
        """How much it disturbs at this step."""
        given = self._given
        return given(self.curve_step) if isinstance(given, Profile) else given

    @property
    def curve_step(self) -> int:
        """The step of a curve whose value holds now."""
        return max(self.time - self.lag, 0)

    @property
    def time(self) -> int:
        """The steps of the environment so far."""
        return len(self._rewards)

    @cached_property
    def _rewards(self) -> list[float]:
        rewards: list[float] = self.get_wrapper_attr("rewards")
        return rewards

    def leave(self) -> None:
        """Undo what the episode has changed in an environment that others will have."""

    @property
    def most(self) -> Any:
        """The greatest value of the episode."""
        return max(self._given.values) if isinstance(self._given, Profile) else self._given


class ChangedObservations(EpisodeWrapper, gym.ObservationWrapper[Any, Any, Any]):
    """Changes the numbers of some Boxes of an observation; None is the key of a Box alone."""

    lag = 1

    def among(self, boxes: Mapping[str | None, Any], entries: tuple[int, ...] | None) -> None:
        """Set the Boxes, and the entries that change; None means all."""
        self._boxes, self._entries = boxes, None if entries is None else [*entries]

    def observation(self, observation: Any) -> Any:
        """Change the Boxes of an observation."""
        if None in self._boxes:
            return self.changed(observation, None)
        changed = {key: self.changed(observation[key], key) for key in self._boxes}
        return {**observation, **changed}

    def changed(self, number: Any, key: str | None) -> Any:
        """Return what the agent sees in the place of a Box's numbers."""
        raise NotImplementedError

    def chosen(self, number: Any, other: Any) -> Any:
        """Return other numbers at the entries that change, in the form of the Box's."""
        given = np.asarray(number)
        whole = np.array(given, np.float64)
        if self._entries is None:
            whole[...] = other
        else:
            whole.reshape(-1)[self._entries] = np.ravel(other)[self._entries]
        return (np.rint(whole) if given.dtype.kind in "iu" else whole).astype(given.dtype)

    def added(self, number: Any, key: str | None, more: Any) -> Any:
        """Return the numbers and more, within the bounds of the Box."""
        box = self._boxes[key]
        clean = np.asarray(number, np.float64)
        noisy = clean + more
        if box.dtype.kind in "iu":
            noisy = np.rint(noisy)
        return self.bounded(noisy, number, key).astype(np.asarray(number).dtype)

    def bounded(self, values: Any, number: Any, key: str | None) -> Any:
        """Return values within the bounds of the Box, or its numbers, which may lie outside."""
        box, clean = self._boxes[key], np.asarray(number, np.float64)
        return np.clip(values, np.minimum(box.low, clean), np.maximum(box.high, clean))

    def at_entries(self, values: Any) -> Any:
        """Return values at the entries that change, and zeros elsewhere."""
        if self._entries is None:
            return values
        kept = np.zeros_like(values)
        kept.reshape(-1)[self._entries] = values.reshape(-1)[self._entries]
        return kept


class _NoisyObservations(ChangedObservations):
    def among(self, boxes: Mapping[str | None, Any], entries: tuple[int, ...] | None) -> None:
        super().among(boxes, entries)
        self._noise: tuple[float, PixelNoise] | None = None
        self._pictures = {key for key, box in boxes.items() if entries is None and _is_picture(box)}

    def _pixel_noise(self, deviation: float) -> PixelNoise:
        from sada_gym.envs.wrapped.pixel_noise import PixelNoise  # numba

        if self._noise is None or self._noise[0] != deviation:
            self._noise = (deviation, PixelNoise(deviation, self.rng))
        return self._noise[1]

    def changed(self, number: Any, key: str | None) -> Any:
        deviation = self.value
        if not deviation:
            return number
        if key in self._pictures:
            return self._pixel_noise(deviation)(np.asarray(number, np.uint8))
        noise = self.rng.standard_normal(np.shape(number))
        return self.added(number, key, deviation * self.at_entries(noise))


class _BiasedObservations(ChangedObservations):
    def changed(self, number: Any, key: str | None) -> Any:
        return self.added(number, key, self.at_entries(np.full(np.shape(number), self.value)))


class _DriftingObservations(_BiasedObservations):
    @property
    def value(self) -> Any:
        return self.time * super().value


def _is_picture(box: spaces.Box[Any]) -> bool:
    is_of_bytes = len(box.shape) > 1 and box.dtype == np.uint8
    return is_of_bytes and not box.low.any() and bool((box.high == 255).all())


class _LateObservations(EpisodeWrapper, gym.ObservationWrapper[Any, Any, Any]):
    lag = 1

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self._queue: deque[Any] = deque(maxlen=self.most + 1)
        return super().reset(**kwargs)

    def observation(self, observation: Any) -> Any:
        self._queue.append(observation)
        return self._queue[max(-1 - self.value, -len(self._queue))]


class _LostObservations(EpisodeWrapper, gym.ObservationWrapper[Any, Any, Any]):
    lag = 1

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self._last: list[Any] = []
        return super().reset(**kwargs)

    def observation(self, observation: Any) -> Any:
        lost = self.rng.random() < self.value
        if not self._last or not lost:
            self._last = [observation]
        return self._last[0]


class _LateActions(EpisodeWrapper, gym.ActionWrapper[Any, Any, Any]):
    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        space = self.action_space
        zeros = [np.zeros(space.shape)] * self.most if isinstance(space, spaces.Box) else []
        self._queue: deque[Any] = deque(zeros, maxlen=self.most + 1)
        return super().reset(**kwargs)

    def action(self, action: Any) -> Any:
        self._queue.append(action)
        return self._queue[max(-1 - self.value, -len(self._queue))]


class _ScaledActions(EpisodeWrapper, gym.ActionWrapper[Any, Any, Any]):
    def action(self, action: Any) -> Any:
        return np.asarray(action, np.float64) * self.value


class _NoisyActions(EpisodeWrapper, gym.ActionWrapper[Any, Any, Any]):
    def action(self, action: Any) -> Any:
        space = self.action_space
        if isinstance(space, spaces.Box):
            half_range = (space.high.astype(np.float64) - space.low) / 2.0
            return action + self.value * half_range * self.rng.standard_normal(half_range.shape)
        other, swapped = drawn_action(space, self.rng), self.rng.random() < self.value
        return other if swapped else action


def drawn_action(space: Any, rng: Generator) -> Any:
    """Draw an action of any space evenly."""
    if isinstance(space, spaces.Box):
        return rng.uniform(space.low, space.high)
    if isinstance(space, spaces.Discrete):
        return space.dtype.type(space.start + rng.integers(space.n))
    if isinstance(space, spaces.MultiDiscrete):
        return (space.start + rng.integers(space.nvec)).astype(space.dtype)
    return rng.integers(2, size=space.shape).astype(space.dtype)


class _RepeatedSteps(EpisodeWrapper):
    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        total = 0.0
        for _ in range(int(self.value)):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            if terminated or truncated:
                break
        return observation, total, terminated, truncated, info


@dataclass(frozen=True)
class Disturbance(ParameterBinding):
    """A disturbance of what the agent sees or does: it wraps the environment for one episode."""

    varies: ClassVar[bool] = True
    wrapper: ClassVar[type[EpisodeWrapper]]
    layer: ClassVar[float]
    """Where its wrapper stands among those of an episode, from the inside out."""
    minimum: ClassVar[float] = 0.0
    maximum: ClassVar[float] = np.inf
    without: ClassVar[float] = 0.0
    """The value that disturbs nothing."""
    whole: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Make numbers of steps whole."""
        super().__post_init__()
        if self.whole and not self.choices:
            object.__setattr__(self, "integer", True)

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Wrap the environment of one episode, in which `rng` belongs to this disturbance alone."""
        return self.wrapper(env, value, rng)

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name; raise `UserError` for a range too wide or empty."""
        values = self._values(name)
        numbers = all(isinstance(value, int | float) for value in values)
        whole = numbers and all(float(value).is_integer() for value in values)
        maximum = _MOST_STEPS if self.whole else self.maximum
        if (
            not numbers
            or (self.whole and not whole)
            or not all(self.minimum <= value <= maximum for value in values)
        ):
            limit = "" if maximum == np.inf else f" and at most {maximum:g}"
            raise UserError(
                f"Expected {type(self).__name__} {name!r} of at least {self.minimum:g}{limit}, "
                f"{'whole numbers, ' if self.whole else ''}got {values}. Fix its range."
            )
        return super().parameter(name)

    def present(self, name: str, factory: EnvFactory, env: Env) -> Any:  # noqa: ARG002
        """Return the value that disturbs nothing."""
        return int(self.without) if self.whole else self.without

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return one target for all: there is one disturbance of each kind."""
        return ("all",)

    def _values(self, name: str) -> list[Any]:
        return [*(self.choices or self._range(name))]


def check_entries(name: str, entries: Any, box: spaces.Box[Any]) -> None:
    """Raise `UserError` unless they are entries of a flattened Box, or None."""
    if entries is not None and not isinstance(entries, tuple | list):
        raise UserTypeError(
            f"Expected entries of {name!r} as a tuple such as (0, 2), got {entries!r}."
        )
    for entry in entries or ():
        check_integer(f"the entries of {name!r}", entry, 0, int(np.prod(box.shape)) - 1)


@dataclass(frozen=True)
class Sensor(Disturbance):
    """What happens to the numbers of a Box, or to those of all Boxes of floats in a Dict.

    Attributes:
        key: The one key of a Dict that it changes; None means all.
        entries: The entries of the flattened Box that it changes; None means all.
    """

    key: str | None = None
    entries: tuple[int, ...] | None = None

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return the entries that change."""
        return ((self.key, tuple(self.entries or ())),)

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that there are Boxes to change."""
        space = env.observation_space
        if isinstance(space, spaces.Dict) and self.key is not None:
            check_known(f"key of the observations of {factory.name}", [self.key], [*space])
        elif self.key is not None:
            raise UserError(
                f"Expected no key of {name!r}, because the observations of {factory.name} are no "
                f"dictionary, got {self.key!r}."
            )
        boxes = self.boxes(space)
        if not boxes or not all(isinstance(box, spaces.Box) for box in boxes.values()):
            raise UserError(
                f"Expected observations of numbers (Box) in {factory.name} for {name!r}, "
                f"got {space}. Use ObservationDropout or ObservationDelay, which fit all."
            )
        for box in boxes.values():
            check_entries(name, self.entries, box)

    def boxes(self, space: spaces.Space[Any]) -> dict[str | None, Any]:
        """Return the Boxes that it changes by their keys."""
        if not isinstance(space, spaces.Dict):
            return {None: space}
        if self.key is not None:
            return {self.key: space[self.key]}
        boxes = {key: part for key, part in space.items() if isinstance(part, spaces.Box)}
        return {key: box for key, box in boxes.items() if box.dtype.kind == "f"}

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Change each observation."""
        wrapper: Any = self.wrapper(env, value, rng)
        wrapper.among(self.boxes(env.observation_space), self.entries)
        wrapped: Env = wrapper
        return wrapped


@dataclass(frozen=True)
class ObservationNoise(Sensor):
    """Gaussian noise on observations; the value is its standard deviation, in their units.

    New noise is added at each step. Noisy numbers stay within the bounds of their space; whole
    numbers, such as the pixels of an image, are rounded.
    """

    wrapper, layer = _NoisyObservations, 3


@dataclass(frozen=True)
class ObservationBias(Sensor):
    """A constant error of sensors: the value, in their units, within the space's bounds."""

    wrapper, layer, minimum = _BiasedObservations, 2.8, -np.inf


@dataclass(frozen=True)
class ObservationDrift(Sensor):
    """An error of sensors that grows by the value at each step, within the space's bounds."""

    wrapper, layer, minimum = _DriftingObservations, 2.9, -np.inf


@dataclass(frozen=True)
class ObservationDelay(Disturbance):
    """The agent sees the observation of some steps ago, and at first the first observation."""

    wrapper, layer, whole = _LateObservations, 4, True


@dataclass(frozen=True)
class ObservationDropout(Disturbance):
    """Observations get lost, with the value as probability; the agent gets the last one again.

    The first observation of an episode always arrives.
    """

    wrapper, layer, maximum = _LostObservations, 5, 1.0


@dataclass(frozen=True)
class ActionDelay(Disturbance):
    """An action acts some steps after the agent chose it.

    Until the first action arrives, a Box action is zero (or the nearest number in its space). Other
    kinds of actions have no zero, so the first action acts from the beginning.
    """

    wrapper, layer, whole = _LateActions, 2, True


@dataclass(frozen=True)
class ActionGain(Disturbance):
    """Box actions are multiplied by the value, and clipped to their space."""

    wrapper, layer, minimum, without = _ScaledActions, 1, -np.inf, 1.0

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that actions are numbers."""
        if not isinstance(env.action_space, spaces.Box):
            raise UserError(
                f"Expected actions that are numbers (Box) in {factory.name} for the gain {name!r}, "
                f"got {env.action_space}. Use ActionNoise, ActionDelay or RepeatedActions, which "
                "fit all."
            )


@dataclass(frozen=True)
class ActionNoise(Disturbance):
    """Noise on actions.

    For Box actions it is Gaussian; the value is its standard deviation as a share of half the range
    of the space. For Discrete and MultiDiscrete actions, the value is the probability, at each
    step, that a random action acts instead.
    """

    wrapper, layer = _NoisyActions, 0

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


@dataclass(frozen=True)
class RepeatedActions(Disturbance):
    """Each action acts for some steps, at least one, before the agent is asked again."""

    wrapper, layer, minimum, without, whole = _RepeatedSteps, 6, 1.0, 1.0, True

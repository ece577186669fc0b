"""Events in an episode: anything that happens for a while, and sensors and actuators that fail."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, get_args

import numpy as np
from gymnasium import spaces
from typing_extensions import Self

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.disturbances import (
    ChangedObservations,
    Disturbance,
    Env,
    EpisodeWrapper,
    Generator,
    Sensor,
    check_entries,
    drawn_action,
)
from sada_gym.envs.wrapped.factory import EnvFactory, function_name
from sada_gym.envs.wrapped.timed import Occurrence, Timed
from sada_gym.errors import (
    InvalidWorld,
    UserError,
    UserTypeError,
    check_known,
    explained,
)
from sada_gym.parameters import Parameter

Mode = Literal["frozen", "zero", "noise"]
"""What a broken sensor or actuator gives: its last value, zeros, or noise."""


class Passing(EpisodeWrapper):
    """Disturbs some steps of an episode."""

    def __init__(self, env: Env, value: Any, rng: Generator) -> None:
        self._is_timed = isinstance(value, Occurrence)
        self.when = value if self._is_timed else Occurrence(value, 0, np.iinfo(np.int64).max)
        super().__init__(env, self.when.value, rng)

    @property
    def curve_step(self) -> int:
        """The step since it began; without times that of the episode."""
        return self.time - self.when.at if self._is_timed else super().curve_step

    @property
    def active(self) -> bool:
        """Whether it holds at this step."""
        return self.when.at <= self.time < self.when.at + self.when.lasts


class _Switched(Passing):
    """Calls a function when an event begins, and what it returned when the event ends."""

    function: Callable[[Any, Any], Any]

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self._undo: Any = None
        self._under_way: list[_Switched] = self.get_wrapper_attr("events")
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        if self.active and self not in self._under_way:
            self._begin()
            self._under_way.append(self)
        elif not self.active:
            self.leave()
        return self.env.step(action)

    def leave(self) -> None:
        """End the event, if it is under way, beneath those that began later."""
        if self not in self._under_way:
            return
        later = self._under_way[self._under_way.index(self) + 1 :]
        again = [event for event in later if event._undo is not None]
        for event in (*reversed(again), self):
            event._end()
        self._under_way.remove(self)
        for event in again:
            event._begin()

    def _begin(self) -> None:
        with explained(self._expected("begin"), kind=InvalidWorld):
            self._undo = self.function(self.unwrapped, self.value)
        if self._undo is not None and not callable(self._undo):
            raise UserTypeError(
                f"Expected {function_name(self.function)} to return a function that ends the "
                f"event, or nothing, got {self._undo!r}."
            )

    def _end(self) -> None:
        with explained(self._expected("end"), kind=InvalidWorld):
            if self._undo is not None:
                self._undo()

    def _expected(self, what: str) -> str:
        return f"Expected {function_name(self.function)} to {what} an event"


@dataclass(frozen=True)
class Event(Timed, Disturbance):
    """A change for some steps by a function of your own: `set(env.unwrapped, value)`.

    It is called before the first step of the event, with the value, or with True if the event has
    no range. To undo the change, return a function without arguments: it is called before the first
    step after the event, or after the episode. If events overlap, the end of one first undoes those
    that began later, and then begins them again. An evaluation store keeps the scores only if you
    give an `agent_id`; change that whenever you change the function.

    Attributes:
        set: The function. With worker processes it must be importable.
    """

    passes: ClassVar[bool] = True
    varies: ClassVar[bool] = False
    layer: ClassVar[float] = -1
    minimum: ClassVar[float] = -np.inf
    set: Callable[[Any, Any], Any] | None = None

    @property
    def own_function(self) -> Callable[..., Any] | None:
        """The function."""
        return self.set

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return (): what the function sets is unknown."""
        return ()

    def present(self, name: str, factory: EnvFactory, env: Env) -> Any:  # noqa: ARG002
        """Return None: nobody knows a value that changes nothing."""
        return None

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:  # noqa: ARG002
        """Check that there is a function."""
        if not callable(self.set):
            raise UserTypeError(
                f"Expected a function set(env, value) for the event {name!r}, got {self.set!r}. "
                "Write Event(set=brake, at=(0, 500), lasts=(1, 50))."
            )

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let it happen."""
        assert self.set is not None
        wrapper = _Switched(env, value, rng)
        wrapper.function = self.set
        return wrapper


class _FailedSensors(Passing, ChangedObservations):
    mode: Mode

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self._last: dict[str | None, Any] = {}
        return super().reset(**kwargs)

    def changed(self, number: Any, key: str | None) -> Any:
        if not self.active:
            self._last[key] = number
            return number
        value = np.asarray(number)
        if self.mode == "frozen":
            return self.chosen(value, np.asarray(self._last.setdefault(key, number)))
        other = np.zeros(value.shape)
        if self.mode == "noise":
            other = self.value * self.rng.standard_normal(value.shape)
        return self.chosen(value, self.bounded(other, number, key))


@dataclass(frozen=True)
class SensorFailure(Timed, Sensor):
    """Sensors fail for some steps; the agent sees their last values, zeros or noise.

    Attributes:
        mode: "frozen", "zero", or "noise": Gaussian noise replaces the values; `low` and `high` are
            the range of its standard deviation.
    """

    passes: ClassVar[bool] = True
    varies: ClassVar[bool] = False
    layer: ClassVar[float] = 3.5
    mode: Mode = "frozen"

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Check the mode, too."""
        check_known(f"mode of {name!r}", [self.mode], get_args(Mode))
        if self.valued != (self.mode == "noise"):
            raise UserError(
                f"Expected low and high of {name!r}, the standard deviation, with mode='noise' "
                f"alone, got low={self.low} and high={self.high} with mode={self.mode!r}."
            )
        return super().parameters(name)

    def targets(self, name: str) -> tuple[Any, ...]:
        """Return one target each: they may fail at different times."""
        return (name,)

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the sensors fail."""
        wrapper = _FailedSensors(env, value, rng)
        wrapper.among(self.boxes(env.observation_space), self.entries)
        wrapper.mode = self.mode
        return wrapper


class _FailedActuators(Passing):
    mode: Mode
    entries: tuple[int, ...] | None

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self._last: Any = None
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        given = np.asarray(action)
        if not self.active:
            self._last = given
            return self.env.step(action)
        is_box = isinstance(self.action_space, spaces.Box)
        if self.mode == "noise":
            broken = drawn_action(self.action_space, self.rng)
        elif self.mode == "zero":
            broken = np.zeros(given.shape)
        elif self._last is None:
            broken = self._last = np.zeros(given.shape) if is_box else given
        else:
            broken = self._last
        if self.entries is not None:
            whole = given.astype(np.float64)
            whole.reshape(-1)[[*self.entries]] = np.ravel(broken)[[*self.entries]]
            broken = whole
        return self.env.step(broken if is_box else broken.astype(given.dtype)[()])


@dataclass(frozen=True)
class ActuatorFailure(Timed, Disturbance):
    """Actuators fail for some steps: the last action acts, or zero, or noise.

    Noise is drawn from the action space at each step. If a failure begins before the first action,
    a frozen Box actuator stays at zero; another kind keeps the first action.

    Attributes:
        entries: The entries of the flattened Box that fail; None means all.
        mode: "frozen", "zero" (only for Box actions), or "noise".
    """

    passes: ClassVar[bool] = True
    varies: ClassVar[bool] = False
    layer: ClassVar[float] = -0.5
    entries: tuple[int, ...] | None = None
    mode: Mode = "frozen"

    def targets(self, name: str) -> tuple[Any, ...]:
        """Return one target each: they may fail at different times."""
        return (name,)

    def parameters(self, name: str) -> tuple[Parameter, ...]:
        """Check the mode, too."""
        check_known(f"mode of {name!r}", [self.mode], get_args(Mode))
        if self.valued:
            raise UserError(f"Expected no low and high of {name!r}, got {self.low}, {self.high}.")
        return super().parameters(name)

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that the actions can fail so."""
        space = env.action_space
        if isinstance(space, spaces.Box):
            check_entries(name, self.entries, space)
            wrong = self.mode == "noise" and not space.is_bounded()
        else:
            wrong = self.mode == "zero" or self.entries is not None
        if wrong:
            raise UserError(
                f"Expected actions of numbers (Box) in {factory.name} for mode='zero' and entries, "
                f"and with finite bounds for mode='noise' of {name!r}, got {space}. Use another "
                "mode."
            )

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the actuators fail."""
        wrapper = _FailedActuators(env, value, rng)
        wrapper.mode, wrapper.entries = self.mode, self.entries
        return wrapper


class _Slow(EpisodeWrapper):
    """Lets the last action act on for as long as the agent has taken to answer."""

    step_s: float

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        answer = super().reset(**kwargs)
        self._last: Any = None
        self._since = time.perf_counter()
        return answer

    def render(self) -> Any:
        """Draw, in time that is not the agent's."""
        began = time.perf_counter()
        frame: Any = self.env.render()
        self._since += time.perf_counter() - began
        return frame

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        taken = (time.perf_counter() - self._since) * self.value
        is_box = isinstance(self.action_space, spaces.Box)
        if self._last is None:
            self._last = np.zeros(self.action_space.shape or ()) if is_box else action
        total = 0.0
        for acts in [*[self._last] * int(taken / self.step_s), action]:
            observation, reward, terminated, truncated, info = self.env.step(acts)
            total += float(reward)
            if terminated or truncated:
                break
        self._last = action
        self._since = time.perf_counter()
        return observation, total, terminated, truncated, info


@dataclass(frozen=True)
class RealTime(Timed, Disturbance):
    """The environment does not wait: while the agent computes, its last action goes on acting.

    The agent's time is measured, so scores differ from run to run and from computer to computer:
    the application is not `repeatable`, and plays one episode at a time. The value, from `low` to
    `high`, multiplies the time, like a slower computer; without a range it is 1.

    Attributes:
        step: The duration of a step of the environment, in seconds.
    """

    varies: ClassVar[bool] = False
    layer: ClassVar[float] = 7
    repeatable: ClassVar[bool] = False
    step: float = 0.02

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return one target for all."""
        return ("all",)

    def present(self, name: str, factory: EnvFactory, env: Env) -> Any:  # noqa: ARG002
        """Return 1: this computer."""
        return 1.0

    def within(self, name: str, limit: int | None) -> Self:
        """Check the seconds, too."""
        if not is_number(self.step) or isinstance(self.step, bool) or not 0 < self.step < np.inf:
            raise UserError(f"Expected step of {name!r} in seconds above 0, got {self.step!r}.")
        if self.at is not None or self.lasts is not None:
            raise UserError(f"Expected neither at nor lasts of {name!r}, which holds always.")
        return super().within(name, limit)

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let time pass."""
        wrapper = _Slow(env, float(value), rng)
        wrapper.step_s = float(self.step)
        return wrapper

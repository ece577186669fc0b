"""Wind and pushes on a body of MuJoCo's or Box2D's, for environments that offer none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.disturbances import Disturbance, Env, EpisodeWrapper, Generator
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.paths import MISSING, read
from sada_gym.errors import UserError, UserTypeError, check_integer, check_known
from sada_gym.foundations.arrays import Floats

_MAIN_BODIES = ("lander", "hull", "car.hull")
"""Where Gymnasium's Box2D environments keep their main body."""


class _Forced(EpisodeWrapper):
    """Lets a force act on a body during some steps of an episode."""

    def __init__(
        self, env: Env, force: Floats, rng: Generator, body: str | None, start: Any, steps: float
    ) -> None:
        super().__init__(env, force, rng)
        self._body, self._start, self._steps = body, start, steps

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        first, last = self._start if isinstance(self._start, tuple) else (self._start, self._start)
        self._first = int(self.rng.integers(first, last + 1))
        self._time = 0
        answer = super().reset(**kwargs)
        self._apply = _applier(self.unwrapped, self._body)
        return answer

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        acts = self._first <= self._time < self._first + self._steps and self.value.any()
        self._time += 1
        if not acts:
            return self.env.step(action)
        undo = self._apply(self.value)
        answer = self.env.step(action)
        undo()
        return answer


@dataclass(frozen=True)
class _Force(Disturbance):
    """A force; the value is its strength, in the simulator's units (N in MuJoCo).

    Attributes:
        body: The body's name in MuJoCo, or the attribute of `env.unwrapped` that holds Box2D's.
            None takes the root of MuJoCo's model, or the main body of LunarLander, BipedalWalker
            or CarRacing.
        direction: Where the force points, three numbers in MuJoCo and two in Box2D, of any length;
            None takes (1, 0, 0) or (1, 0). A negative value acts the other way.
    """

    layer: ClassVar[int] = -1
    minimum: ClassVar[float] = -np.inf
    body: str | None = None
    direction: tuple[float, ...] | None = None

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return what it acts on, where to and when."""
        return ((self.body, self.direction and tuple(self.direction), self._when),)

    @property
    def _when(self) -> tuple[int | tuple[int, int], float]:
        """The first step, or the range in which it is drawn, and the number of steps."""
        return 0, np.inf

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that there are the body and the direction."""
        _applier(env.unwrapped, self.body, f" of {factory.name} for {name!r}")
        count = _dimension(env.unwrapped)
        given = (1.0, *[0.0] * (count - 1)) if self.direction is None else self.direction
        right = isinstance(given, tuple | list) and all(map(is_number, given))
        if not right or len(given) != count or not np.isfinite(given).all() or not any(given):
            raise UserError(
                f"Expected direction of {name!r} to be {count} numbers, not all 0, got {given!r}."
            )

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the force act."""
        way = np.zeros(_dimension(env.unwrapped))
        way[0] = 1.0
        if self.direction is not None:
            way = np.array(self.direction, np.float64) / np.linalg.norm(self.direction)
        return _Forced(env, value * way, rng, self.body, *self._when)


@dataclass(frozen=True)
class Wind(_Force):
    """A constant force on a body, in every step; the value is its strength."""


@dataclass(frozen=True)
class Push(_Force):
    """A force on a body for some steps; the value is its strength.

    Attributes:
        start: The environment's step at which it begins, or the first and the last one at which it
            may, of which each episode draws one.
        steps: For how many steps it acts.
    """

    start: int | tuple[int, int] = 50
    steps: int = 5

    @property
    def _when(self) -> tuple[int | tuple[int, int], float]:
        start = tuple(self.start) if isinstance(self.start, list | tuple) else self.start
        return start, self.steps  # type: ignore[return-value]

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check the steps as well."""
        check_integer(f"steps of {name!r}", self.steps, 1)
        ends = self.start if isinstance(self.start, tuple | list) else (self.start,)
        for end in ends:
            check_integer(f"start of {name!r}", end, 0)
        if len(ends) > 2 or [*ends] != sorted(ends) or not ends:
            raise UserTypeError(
                f"Expected start of {name!r} to be a step, or the first and the last one, got "
                f"{self.start!r}."
            )
        super().check(name, factory, env)


def _dimension(world: Any) -> int:
    return 3 if _is_mujoco(world) else 2


def _is_mujoco(world: Any) -> bool:
    return hasattr(getattr(world, "data", None), "xfrc_applied") and hasattr(world, "model")


def _applier(
    world: Any, name: str | None, where: str = ""
) -> Callable[[Floats], Callable[[], None]]:
    """Return what adds a force to those on a body until the next step, and returns its undoing."""
    if _is_mujoco(world):
        names = [world.model.body(i).name for i in range(world.model.nbody)]
        if name is not None:
            check_known(f"body{where}", [name], names[1:])
        row = world.data.xfrc_applied[1 if name is None else names.index(name)]

        def add(force: Floats) -> Callable[[], None]:
            before = row[:3].copy()
            row[:3] += force

            def undo() -> None:
                row[:3] = before

            return undo

        return add
    bodies = [read(world, path) for path in (_MAIN_BODIES if name is None else (name,))]
    body = next((body for body in bodies if hasattr(body, "ApplyForceToCenter")), MISSING)
    if body is MISSING:
        raise UserError(
            f"Expected a body of MuJoCo or Box2D{where}, found none"
            f"{'' if name is None else f' at {name!r}'}. Name an attribute that holds a Box2D "
            "body, or set a force by Function(low, high, set=...)."
        )

    def push(force: Floats) -> Callable[[], None]:
        body.ApplyForceToCenter(tuple(map(float, force)), True)  # type: ignore[attr-defined]
        return lambda: None  # Box2D clears forces after a step

    return push

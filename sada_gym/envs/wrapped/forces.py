"""Wind and pushes on a body of MuJoCo's, PyBullet's or Box2D's, and forces of any simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from typing_extensions import Self

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.disturbances import Disturbance, Env, EpisodeWrapper, Generator
from sada_gym.envs.wrapped.factory import EnvFactory, function_name
from sada_gym.envs.wrapped.paths import read
from sada_gym.envs.wrapped.timed import Occurrence, Timed
from sada_gym.errors import (
    InvalidWorld,
    UserError,
    UserTypeError,
    check_integer,
    check_known,
    explained,
)
from sada_gym.foundations.arrays import Floats

_MAIN_BODIES = ("lander", "hull", "car.hull")
"""Where Gymnasium's Box2D environments keep their main body."""

_PHYSICS = ("physics", "_env.physics", "env.physics")
"""Where environments of dm_control keep their simulation."""

_CLIENTS = ("_p", "client", "physics_client", "_client", "sim.physics_client", "env")
"""Where PyBullet's environments keep their client."""

_WORLD_FRAME = 2  # `pybullet.WORLD_FRAME`

Undo = Callable[[], object]
"""Takes a force away after a step."""

Act = Callable[[Any], Undo | None]
"""Lets a force act on the next step."""


class _Forced(EpisodeWrapper):
    """Lets a force act on a body during some steps of an episode."""

    def __init__(
        self, env: Env, force: Any, rng: Generator, find: Callable[[Any], Act], when: When
    ) -> None:
        if isinstance(force, Occurrence):
            force, when = force.value, (force.at, force.lasts)
        super().__init__(env, force, rng)
        self._find, (self._start, self._steps) = find, when
        self._first = 0

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        first, last = self._start if isinstance(self._start, tuple) else (self._start, self._start)
        self._first = int(self.rng.integers(first, last + 1))
        answer = super().reset(**kwargs)
        self._act = self._find(self.unwrapped)
        return answer

    @property
    def time(self) -> int:
        """The steps since it began to act."""
        return super().time - self._first

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        strength = self.value if 0 <= self.time < self._steps else 0.0
        if not np.any(strength):
            return self.env.step(action)
        undo = self._act(strength)
        try:
            return self.env.step(action)
        finally:
            if undo is not None:
                undo()


When = tuple[int | tuple[int, int], float]
"""The first step, or the range in which it is drawn, and the number of steps."""

_ALWAYS: When = (0, np.inf)


@dataclass(frozen=True)
class _BodyForce(Disturbance):
    """A force; the value is its strength, in the simulator's units (N in MuJoCo and PyBullet).

    Attributes:
        body: The body's name in MuJoCo (and dm_control), that of a body or a link in PyBullet, or
            the attribute of `env.unwrapped` that holds Box2D's. None takes the root of MuJoCo's
            model, PyBullet's first body that is not fixed, or the main body of LunarLander,
            BipedalWalker or CarRacing.
        direction: Where the force points, three numbers, and two in Box2D, of any length; None
            takes (1, 0, 0) or (1, 0). A negative value acts the other way.
    """

    layer: ClassVar[float] = -1
    minimum: ClassVar[float] = -np.inf
    body: str | None = None
    direction: tuple[float, ...] | None = None

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return what it acts on, where to and when."""
        return ((self.body, self.direction and tuple(self.direction), self._when),)

    @property
    def _when(self) -> When:
        return _ALWAYS

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check that there are the body and the direction."""
        count = _Body.of(env.unwrapped, self.body, f" of {factory.name} for {name!r}").dimension
        given = (1.0, *[0.0] * (count - 1)) if self.direction is None else self.direction
        right = isinstance(given, tuple | list) and all(map(is_number, given))
        if not right or len(given) != count or not np.isfinite(given).all() or not any(given):
            raise UserError(
                f"Expected direction of {name!r} to be {count} numbers, not all 0, got {given!r}."
            )

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the force act."""

        def find(world: Any) -> Act:
            body = _Body.of(world, self.body)
            way = np.eye(1, body.dimension)[0]
            if self.direction is not None:
                way = np.array(self.direction, np.float64) / np.linalg.norm(self.direction)
            return lambda strength: body.push(strength * way)

        return _Forced(env, value, rng, find, self._when)


@dataclass(frozen=True)
class Wind(_BodyForce):
    """A constant force on a body, at every step; the value is its strength."""


@dataclass(frozen=True)
class Push(Timed, _BodyForce):
    """A force on a body for some steps; the value is its strength.

    `at=(20, 80)` replaces `start`: the first step is then a parameter. `lasts=(1, 20)` replaces
    `steps`: the number of steps is then a parameter.

    Attributes:
        start: The environment's step at which the force begins; or a pair (first, last), from which
            each episode draws this step.
        steps: The number of steps for which the force acts.
    """

    start: int | tuple[int, int] = 50
    steps: int = 5

    @property
    def _when(self) -> When:
        return _when(self.start, self.steps)

    def targets(self, name: str) -> tuple[Any, ...]:
        """Return one target each where `at` says when."""
        return super().targets(name) if self.at is None else (name,)

    @property
    def usual_lasts(self) -> int:
        """The steps for which it acts where no parameter says it."""
        return self.steps

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:
        """Check the steps as well."""
        _check_when(name, self.start, self.steps)
        super().check(name, factory, env)


@dataclass(frozen=True)
class Force(Timed, Disturbance):
    """A force by a function of your own, for any simulator: `apply(env.unwrapped, strength)`.

    It is called before each step at which the force acts. If the simulator keeps a force after the
    step, return a function without arguments that removes it. An evaluation store keeps the scores
    only if you give an `agent_id`; change that whenever you change the function.

    Attributes:
        apply: The function. With worker processes it must be importable.
        start: The environment's step at which the force begins; or a pair (first, last), from which
            each episode draws this step. With None it acts at all steps.
        steps: The number of steps for which it acts. `at` and `lasts` replace both, see `Push`.
    """

    layer: ClassVar[float] = -1
    minimum: ClassVar[float] = -np.inf
    apply: Callable[[Any, float], Undo | None] | None = None
    start: int | tuple[int, int] | None = None
    steps: int = 5

    @property
    def own_function(self) -> Callable[..., Any] | None:
        """The function."""
        return self.apply

    def targets(self, name: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Return (): what the function acts on is unknown."""
        return ()

    def check(self, name: str, factory: EnvFactory, env: Env) -> None:  # noqa: ARG002
        """Check the function and the steps."""
        if not callable(self.apply):
            raise UserTypeError(
                f"Expected a function apply(env, strength) for {name!r}, got {self.apply!r}. Write "
                "Force(0.0, 10.0, apply=blow)."
            )
        if self.start is not None:
            _check_when(name, self.start, self.steps)

    def wrap(self, env: Env, value: Any, rng: Generator) -> Env:
        """Let the force act."""
        apply = self.apply
        assert apply is not None

        def find(world: Any) -> Act:
            def act(strength: float) -> Undo | None:
                expected = f"Expected {function_name(apply)} to let a force of {strength} act"
                with explained(expected, kind=InvalidWorld):
                    return apply(world, strength)

            return act

        when = _ALWAYS if self.start is None else _when(self.start, self.steps)
        return _Forced(env, value, rng, find, when)

    @property
    def usual_lasts(self) -> int | None:
        """The steps for which it acts where no parameter says it; None means all."""
        return None if self.start is self.at is None else self.steps


def _when(start: int | tuple[int, int], steps: int) -> When:
    first: Any = tuple(start) if isinstance(start, list | tuple) else start
    return first, steps


def _check_when(name: str, start: Any, steps: Any) -> None:
    check_integer(f"steps of {name!r}", steps, 1)
    ends = start if isinstance(start, tuple | list) else (start,)
    for end in ends:
        check_integer(f"start of {name!r}", end, 0)
    if len(ends) > 2 or [*ends] != sorted(ends) or not ends:
        raise UserTypeError(
            f"Expected start of {name!r} to be a step, or the first and the last one, got "
            f"{start!r}."
        )


@dataclass(frozen=True)
class _Body:
    """What pushes a body: `push` adds a force, (dimension,), until it is undone."""

    dimension: int
    push: Callable[[Floats], Undo]

    @classmethod
    def of(cls, world: Any, name: str | None, where: str = "") -> Self:
        if (mujoco := _mujoco(world)) is not None:
            return cls(3, _push_in_mujoco(*mujoco, name, where))
        if (client := _bullet_client(world)) is not None:
            return cls(3, _push_in_bullet(world, client, name, where))
        bodies = [read(world, path) for path in (_MAIN_BODIES if name is None else (name,))]
        body = next((body for body in bodies if hasattr(body, "ApplyForceToCenter")), None)
        if body is None:
            raise UserError(
                f"Expected a body of MuJoCo, PyBullet or Box2D{where}, found none"
                f"{'' if name is None else f' at {name!r}'}. Name an attribute that holds a Box2D "
                "body, or let your own function act: Force(low, high, apply=...)."
            )
        return cls(2, _push_in_box2d(body))


def _mujoco(world: Any) -> tuple[Any, Any] | None:
    """Return MuJoCo's model and data; None where there are none."""
    if hasattr(getattr(world, "data", None), "xfrc_applied") and hasattr(world, "model"):
        return world.model, world.data
    for path in _PHYSICS:  # of dm_control, around MuJoCo's own
        model, data = read(world, f"{path}.model.ptr"), read(world, f"{path}.data.ptr")
        if hasattr(data, "xfrc_applied"):
            return model, data
    return None


def _push_in_mujoco(
    model: Any, data: Any, name: str | None, where: str
) -> Callable[[Floats], Undo]:
    names = [model.body(i).name for i in range(model.nbody)]
    if name is not None:
        check_known(f"body{where}", [name], names[1:])
    row = data.xfrc_applied[1 if name is None else names.index(name)]

    def push(force: Floats) -> Undo:
        before = row[:3].copy()
        row[:3] += force
        return lambda: row.__setitem__(slice(3), before)

    return push


def _bullet_client(world: Any) -> Any:
    """Return PyBullet's client; None where there is none."""
    found = (read(world, path) for path in _CLIENTS)
    return next((client for client in found if hasattr(client, "applyExternalForce")), None)


def _push_in_bullet(
    world: Any, client: Any, name: str | None, where: str
) -> Callable[[Floats], Undo]:
    """Push a body or a link in each step of the simulator, of which a step may have several."""
    known: dict[str, tuple[int, int]] = {}
    free: list[tuple[int, int]] = []
    for body in map(client.getBodyUniqueId, range(client.getNumBodies())):
        known.setdefault(client.getBodyInfo(body)[1].decode(), (body, -1))
        for link in range(client.getNumJoints(body)):
            known.setdefault(client.getJointInfo(body, link)[12].decode(), (body, link))
        if client.getDynamicsInfo(body, -1)[0] > 0.0:
            free.append((body, -1))
    named = read(world, "sim._bodies_idx")  # panda-gym's
    known |= {key: (body, -1) for key, body in named.items()} if isinstance(named, dict) else {}
    if name is not None:
        check_known(f"body{where}", [name], [*known])
    elif not free:
        raise UserError(
            f"Expected a body{where} that is not fixed, got none. Name a link, body=..., of "
            f"{', '.join(known)}."
        )
    body, link = free[0] if name is None else known[name]

    def push(force: Floats) -> Undo:
        step = client.stepSimulation
        own = vars(client).get("stepSimulation")

        def forced(*args: Any, **kwargs: Any) -> Any:
            place = client.getBasePositionAndOrientation(body)[0]
            if link >= 0:
                place = client.getLinkState(body, link)[0]
            client.applyExternalForce(body, link, force.tolist(), place, _WORLD_FRAME)
            return step(*args, **kwargs)

        client.stepSimulation = forced
        if own is None:
            return lambda: delattr(client, "stepSimulation")
        return lambda: setattr(client, "stepSimulation", own)

    return push


def _push_in_box2d(body: Any) -> Callable[[Floats], Undo]:
    def push(force: Floats) -> Undo:
        body.ApplyForceToCenter(tuple(map(float, force)), True)
        return lambda: None  # Box2D clears forces after a step

    return push

"""An environment in a separate process, asked over a socket as if it were in this one."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import gymnasium as gym
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.wrappers import TimeLimit
from pydantic import Field, TypeAdapter

from sada_gym.agents.remote.messages import Failed, Header
from sada_gym.agents.remote.peer import Peer
from sada_gym.agents.remote.places import Address, Program, place_of
from sada_gym.agents.remote.spaces import Array, Described, Name
from sada_gym.errors import ServerLost, UserError, UserTypeError, described
from sada_gym.foundations import serve_environment as served
from sada_gym.foundations.files import Strict, shown
from sada_gym.foundations.serve_environment import MISSING, Opaque, decode, encode

FILE = Path(served.__file__)
"""The server, one file that needs NumPy alone."""

_OWN = ("observation_space", "action_space", "metadata", "spec", "render_mode", "action_masks")
"""What an environment holds here; all other attributes are in its process."""


class _Question(Header):
    """A question about an environment; `value` is data, see `serve_environment.encode`."""

    type: str
    env: int
    value: Any


class _Hello(Header):
    """The first question."""

    type: str = "hello"
    to: str = "environment"
    protocol: int = served.PROTOCOL


class _Greeting(Header):
    """The answer to a hello: what identifies the environment, and what its constructor takes."""

    type: Literal["hello"]
    protocol: Literal[2]
    name: Name
    digest: Name
    packages: dict[Name, Name]
    python: Name
    any_keyword: bool
    keywords: Any
    own: Any


class _Spaces(Strict, strict=True):
    observation_space: Described
    action_space: Described


class _Answer(Header):
    pass


class _Told(_Answer):
    """The answer to another question."""

    type: Literal["told"]
    value: Any = None
    spaces: _Spaces | None = None


class _Raised(_Answer):
    """The answer where the environment has raised an exception."""

    type: Literal["raised"]
    kind: Name
    message: str


_ANSWERS: TypeAdapter[_Greeting | _Told | _Raised | Failed] = TypeAdapter(
    Annotated[_Greeting | _Told | _Raised | Failed, Field(discriminator="type")]
)


class ServedEnvironment(Peer):
    """Makes environments in another process, as a function does that makes them here.

    Args:
        place: Where the server is, see `Peer`.
        timeout_s: How long to wait for the program's start, and for each whole answer.

    Raises:
        UserError: If nobody is there, or the server refuses.
    """

    role, wanted, lost, answers = "environment", "an environment", ServerLost, _ANSWERS
    start_it = "Start it there: python serve_environment.py ID"

    def __init__(self, place: Address | Program, timeout_s: float) -> None:
        super().__init__(place, timeout_s)
        self._count = self._bytes = 0
        try:
            self._greeting, arrays = self._connect()
            self._own = self._decoded(self._greeting.own, arrays)
            self._defaults: Any = self._decoded(self._greeting.keywords, arrays)
            if not isinstance(self._defaults, dict) or not all(
                isinstance(name, str) and name.isidentifier() for name in self._defaults
            ):
                self._lose(f"keywords that are none: {shown(repr(self._defaults))}")
        except ServerLost as error:
            raise UserError(str(error)) from error
        self.__name__ = self._greeting.name

    @property
    def settings(self) -> dict[str, Any]:
        """What identifies the environment."""
        told = self._greeting.model_dump(include={"name", "digest", "packages"})
        return {**told, "keywords": repr(self._own)}

    @property
    def __signature__(self) -> Signature:
        """The keywords that its constructor takes."""
        kind, any_name = Parameter.KEYWORD_ONLY, Parameter("others", Parameter.VAR_KEYWORD)
        defaults = {**self._defaults, "render_mode": None}
        named = [
            Parameter(name, kind, default=Parameter.empty if isinstance(value, Opaque) else value)
            for name, value in defaults.items()
        ]
        return Signature([*named, *([any_name] if self._greeting.any_keyword else [])])

    def __call__(
        self,
        *,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **keywords: Any,
    ) -> gym.Env[Any, Any]:
        """Make an environment; `max_episode_steps` takes the place of its own limit of steps."""
        if self._link is None:
            greeting, _ = self._connect()
            if greeting != self._greeting:
                self._lose(
                    f"not the environment of the first connection, which was {self.__name__}"
                )
        self._count = (self._count + 1) % served.MAX_ENVIRONMENTS
        limit = max_episode_steps
        asked = {"keywords": keywords, "render": render_mode is not None, "limit": limit}
        env = ServedEnv(self, self._count, asked, render_mode)
        limit = limit or env._limit
        return env if limit is None else TimeLimit(env, limit)

    def ask(self, kind: str, env: int, value: Any = None) -> tuple[Any, _Told, dict[str, Array]]:
        """Ask about an environment.

        It raises what the environment raised, or `ServerLost` where no answer came.
        """
        if self._link is None:
            self._lose("a new connection in the middle of an episode")
        arrays = dict[str, Array]()
        tree = encode(value, arrays)
        if not _is_whole(tree):
            raise UserTypeError(
                "Expected numbers, texts, arrays, and lists or dictionaries of them to send to the "
                f"environment in {self.place}, got {shown(repr(value))}."
            )
        question = _Question(number=0, type=kind, env=env, value=tree)
        told, given = self._exchange(question, arrays, _Answer)
        if isinstance(told, _Raised):
            message = " ".join(told.message.split())
            if told.kind == "DependencyNotInstalled":
                raise DependencyNotInstalled(message)
            raise type(told.kind, (RuntimeError,), {})(message)
        assert isinstance(told, _Told)
        return self._decoded(told.value, given), told, given

    def memory(self) -> int:
        """Return the bytes that the server's process held when it last made an environment."""
        return self._bytes

    def lose(self, got: str) -> NoReturn:
        """Close the connection, and raise `ServerLost`."""
        self._lose(got)

    def _connect(self) -> tuple[_Greeting, dict[str, Array]]:
        self._open()
        greeting, arrays = self._exchange(_Hello(number=0), {}, _Greeting)
        return greeting.model_copy(update={"number": 0}), arrays

    def _decoded(self, tree: Any, arrays: Mapping[str, Array]) -> Any:
        try:
            return decode(tree, arrays)
        except (ValueError, RecursionError) as error:
            self._lose(shown(str(error)))


def _is_whole(tree: Any) -> bool:
    """Say whether no part of a value was left out when it was encoded."""
    if isinstance(tree, dict):
        return "object" not in tree and all(map(_is_whole, tree.values()))
    return not isinstance(tree, list) or all(map(_is_whole, tree))


class ServedEnv(gym.Env[Any, Any]):
    """An environment in another process; its attributes are read and set there."""

    def __init__(
        self, home: ServedEnvironment, number: int, asked: dict[str, Any], render_mode: str | None
    ) -> None:
        self._home, self._number, self.render_mode = home, number, render_mode
        told = self._ask("make", asked)
        try:
            self._limit = None if told["limit"] is None else int(told["limit"])
            self.metadata = {"render_modes": [*map(str, told["modes"])], "render_fps": told["fps"]}
            home._bytes = int(told["bytes"])
            if told["masks"]:
                self.action_masks = self._action_masks
        except (LookupError, TypeError, ValueError) as error:
            home.lose(f"an answer that describes no environment ({described(error)})")
        self._link = home._link

    def _ask(self, kind: str, value: Any = None) -> Any:
        if kind != "make" and self._link is not self._home._link:
            self._home.lose("a new connection in the middle of an episode")
        value, told, arrays = self._home.ask(kind, self._number, value)
        if told.spaces is not None:
            try:
                self.observation_space = told.spaces.observation_space.made(arrays)
                self.action_space = told.spaces.action_space.made(arrays)
            except (ValueError, TypeError, LookupError, ArithmeticError, AssertionError) as error:
                self._home.lose(f"spaces that are none of Gymnasium ({described(error)})")
        return value

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self._tuple("reset", (seed, options), 2)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, terminated, truncated, info = self._tuple("step", action, 5)
        return observation, reward, bool(terminated), bool(truncated), info

    def _tuple(self, kind: str, value: Any, count: int) -> Any:
        told: Any = self._ask(kind, value)
        if not isinstance(told, tuple) or len(told) != count or not isinstance(told[-1], dict):
            self._home.lose(f"{shown(repr(told))} as the answer to a {kind}")
        info = {key: one for key, one in told[-1].items() if not isinstance(one, Opaque)}
        return (*told[:-1], info)

    def render(self) -> Any:
        """Draw a frame."""
        return self._ask("render")

    def close(self) -> None:
        """Close the environment; its connection stays open for others."""
        if self._link is not None and self._link is self._home._link:
            with suppress(ServerLost):
                self._ask("close")
        self._link = None

    @property
    def fault(self) -> str:
        """What went wrong in a MuJoCo simulation, see `mujoco_fault`."""
        return str(self._ask("fault"))

    def read_steps(self, steps: Sequence[Any]) -> Any:
        """Return what the steps of a path lead to, or `MISSING`."""
        return self._ask("get", steps)

    def write_steps(self, steps: Sequence[Any], value: Any) -> None:
        """Set what the steps of a path lead to."""
        self._ask("set", (steps, value))

    def _action_masks(self) -> Any:
        return self._ask("masks")

    def __getattr__(self, name: str) -> Any:
        """Read an attribute; what is in place in an array would be lost, so arrays refuse it."""
        value = MISSING if name.startswith("_") else self.read_steps([name])
        if value is MISSING:
            raise AttributeError(f"{self._home.__name__} has no attribute {name!r}")
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute."""
        if name.startswith("_") or name in _OWN:
            super().__setattr__(name, value)
        else:
            self.write_steps([name], value)

    @property
    def numbers(self) -> list[str]:
        """The names of the numbers and arrays that the environment's object or class holds."""
        return [str(name) for name in self._ask("names")[1]]

    def __dir__(self) -> list[str]:
        """List the attributes."""
        return [str(name) for name in self._ask("names")[0]]


def server_of(environment: Any, folder: str | Path = ".") -> Address | Program | None:
    """Return the address of an environment's server or the command that starts it; else None.

    A part `serve_environment.py` of a command is our own file where the folder has none. It raises
    `UserError` for an address or a command that is none.
    """
    if isinstance(environment, list | tuple) and not os.path.exists(Path(folder, FILE.name)):
        environment = [str(FILE) if part == FILE.name else part for part in environment]
    return place_of(environment, folder, role="environment")

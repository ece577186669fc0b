"""Environments that are reset for the next episode instead of made again."""

from __future__ import annotations

import atexit
from contextlib import suppress
from copy import deepcopy
from typing import Any
from weakref import WeakKeyDictionary

import gymnasium as gym

from sada_gym.envs.wrapped.constructed import read
from sada_gym.envs.wrapped.factory import KEEPERS, EnvFactory
from sada_gym.envs.wrapped.paths import restore


class KeptEnvironments:
    """Hands out environments, and takes them back for other episodes when one has ended.

    What `paths` name, which parameters set, has its first value in an environment that is handed
    out again: a factor multiplies that.
    """

    def __init__(self, factory: EnvFactory, paths: tuple[str, ...]) -> None:
        self._factory, self._paths = factory, paths
        self._idle: dict[str | None, list[gym.Env[Any, Any]]] = {}
        self._first = WeakKeyDictionary[gym.Env[Any, Any], dict[str, Any]]()
        KEEPERS.add(self)

    def __reduce__(self) -> Any:
        """Take no environment to another process."""
        return KeptEnvironments, (self._factory, self._paths)

    def take(self, render_mode: str | None) -> gym.Env[Any, Any]:
        """Return an environment in which no episode is under way."""
        if idle := self._idle.get(render_mode):
            env = idle.pop()
            restore(env.unwrapped, self._first[env])
        else:
            env = self._factory.make({}, render_mode)
            paths = {path: deepcopy(read(env.unwrapped, path)) for path in self._paths}
            self._first[env] = paths
        return env

    def give_back(self, env: gym.Env[Any, Any], render_mode: str | None) -> None:
        """Keep an environment whose episode is over."""
        self._idle.setdefault(render_mode, []).append(env)

    def close(self) -> None:
        """Close the environments in which no episode is under way."""
        idle, self._idle = self._idle, {}
        for env in (env for kept in idle.values() for env in kept):
            with suppress(Exception):  # nobody needs it any more
                env.close()


@atexit.register
def _close_all() -> None:
    for keeper in [*KEEPERS]:
        keeper.close()

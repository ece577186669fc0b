"""What is known of an environment before it is attacked, and whether it can be."""

from __future__ import annotations

import re
from typing import Any

import gymnasium as gym
from gymnasium import spaces

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.factory import EnvFactory, has_time_limit, layers
from sada_gym.errors import UserError, explained

_ACTIONS = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
_ID = re.compile(r"(.+)-v(\d+)")
_OWN_LIMITS = ("max_steps", "max_episode_steps", "_max_episode_steps", "max_path_length", "horizon")


def packages_of(env: gym.Env[Any, Any]) -> tuple[str, ...]:
    """Name the packages that an environment and an agent may need; some may not be installed."""
    modules = {kind.__module__ for layer in layers(env) for kind in type(layer).__mro__}
    engines = {
        engine
        for module in modules
        for engine in ("box2d", "mujoco")
        if module.startswith(f"gymnasium.envs.{engine}")
    }
    homes = {module.partition(".")[0] for module in modules} - {"builtins", "abc", "typing"}
    return tuple(sorted({"torch", "stable-baselines3", *engines, *homes}))


def name_and_version(factory: EnvFactory, env: gym.Env[Any, Any]) -> tuple[str, int]:
    """Split an id into its name and version; a class has version 0."""
    if not isinstance(factory.environment, str):
        return type(env.unwrapped).__name__, 0
    match = _ID.fullmatch(factory.name)
    return (factory.name, 0) if match is None else (match[1], int(match[2]))


def check_environment(env: gym.Env[Any, Any], factory: EnvFactory) -> Any:
    """Check that an environment can be attacked; return its first observation.

    Raises:
        UserError: If its wrappers learn, its actions are of another space, or it might never end.
    """
    for layer in layers(env):
        if getattr(layer, "update_running_mean", False) is True:
            raise UserError(
                f"Expected wrappers in {factory.name} that learn nothing, got "
                f"{type(layer).__name__}, whose statistics begin anew in each episode and are not "
                "those of the training. Let a function make the environment, and set the wrapper's "
                "statistics and update_running_mean = False there."
            )
    if not isinstance(env.action_space, _ACTIONS):
        raise UserError(
            "Expected Box, Discrete, MultiDiscrete or MultiBinary actions, got "
            f"{env.action_space} in {factory.name}. Wrap the environment in one that has them."
        )
    if not has_time_limit(env) and factory.max_steps != "own":
        raise UserError(
            f"Expected a limit of steps, because {factory.name} has no TimeLimit and its episodes "
            'might never end. Pass max_steps=1000, say, or max_steps="own" if it ends them by '
            f"itself{_own_limit(env)}."
        )
    with explained(f"Expected {factory.name} to be reset"):
        observation, _ = env.reset(seed=0)
    return observation


def _own_limit(env: gym.Env[Any, Any]) -> str:
    known = {name: getattr(env.unwrapped, name, None) for name in _OWN_LIMITS}
    limits = [f"{name}={value}" for name, value in known.items() if is_number(value)]
    return f" (it has {', '.join(limits)})" if limits else ""

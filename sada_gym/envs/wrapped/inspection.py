"""What is known of an environment before it is attacked, and whether it can be."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from typing_extensions import Self

from sada_gym.agents.contract import Interface
from sada_gym.envs.checks import has_nan, is_number
from sada_gym.envs.wrapped.bindings import Attribute, Config
from sada_gym.envs.wrapped.constructed import (
    by_keywords,
    describe_stale,
    describe_unscaled,
    stale_attributes,
)
from sada_gym.envs.wrapped.episodes import (
    EpisodeSpec,
    EpisodeStart,
    GymnasiumEpisodes,
    reset_arguments,
)
from sada_gym.envs.wrapped.factory import EnvFactory, has_time_limit, layers
from sada_gym.errors import Notice, UserError, explained

_ACTIONS = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
_ID = re.compile(r"(.+)-v(\d+)")
_OWN_LIMITS = ("max_steps", "max_episode_steps", "_max_episode_steps", "max_path_length", "horizon")


@dataclass(frozen=True)
class Inspection:
    """What is known of an environment as it is.

    `layers` are the classes of its wrappers from the outside in, and at last its own. It may be
    that its first observation holds NaN, `nan_observed`.
    """

    name: str
    version: int
    metadata: Mapping[str, Any]
    layers: tuple[type[Any], ...]
    packages: tuple[str, ...]
    interface: Interface
    nan_observed: bool

    @classmethod
    def of(cls, env: gym.Env[Any, Any], factory: EnvFactory) -> Self:
        """Inspect an environment; a UserError if it cannot be attacked."""
        kinds = tuple(type(layer) for layer in layers(env))
        wrappers = (gym.ObservationWrapper, gym.ActionWrapper)
        interface = Interface(
            factory.name,
            env.observation_space,
            env.action_space,
            tuple(kind for kind in wrappers if any(issubclass(layer, kind) for layer in kinds)),
            env.has_wrapper_attr("action_masks"),
        )
        return cls(
            *name_and_version(factory, env),
            dict(env.metadata),
            kinds,
            packages_of(env),
            interface,
            has_nan(check_environment(env, factory)),
        )


def packages_of(env: gym.Env[Any, Any]) -> tuple[str, ...]:
    """Name the packages that an environment and an agent may need; some may not be installed."""
    modules = {kind.__module__ for layer in layers(env) for kind in type(layer).__mro__}
    known = ("box2d", "mujoco")
    engines = {e for e in known for m in modules if m.startswith(f"gymnasium.envs.{e}")}
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


def check_ranges(spec: EpisodeSpec, starts: Sequence[EpisodeStart], each: int) -> dict[str, str]:
    """Begin worlds of `each` episodes, so that bad ranges are found at once.

    It warns of attributes that do not follow the parameters, so that the physics is wrong.

    Returns:
        These attributes, and the formulas that they should follow, "" where unknown.
    """
    roots, stale = {Attribute: "", Config: "config."}, dict[str, str]()
    places = [(roots[type(b)], b.targets(k)) for k, b in spec.bindings.items() if type(b) in roots]
    targets = [f"{root}{path}" for root, paths in places for path in paths]
    with ExitStack() as stack:
        strict = replace(spec, on_error="raise")
        running = stack.enter_context(closing(GymnasiumEpisodes(strict, starts))).running[::each]
        worlds = [episode.env.unwrapped for episode in running if episode.env is not None]

        @cache
        def make(*keywords: tuple[str, Any]) -> Any:
            env = stack.enter_context(closing(spec.factory.make(dict(keywords))))
            env.reset(**reset_arguments(replace(spec, bindings={}), EpisodeStart({}, 0, 0)))
            return env.unwrapped

        if targets and worlds:
            keywords = [target for target in targets if target in spec.factory.keywords]
            stale = stale_attributes(targets, worlds, make)
            stale = stale or by_keywords(keywords, worlds[-1], make)
        told = describe_stale(stale)
        if worlds:
            told += describe_unscaled([*targets, *spec.derived.formulas], worlds[0])
    if told:
        warnings.warn(f"In {spec.factory.name} {told}", Notice, stacklevel=3)
    return stale

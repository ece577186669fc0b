"""What is known of an environment before it is attacked, and whether it can be."""

from __future__ import annotations

import hashlib
import json
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import packages_distributions, version
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from typing_extensions import Self

from sada_gym.agents.contract import Interface
from sada_gym.envs.checks import has_nan, is_number
from sada_gym.envs.wrapped.bindings import Attribute, Config
from sada_gym.envs.wrapped.constructed import (
    Look,
    Survey,
    by_keywords,
    describe_stale,
    describe_unscaled,
)
from sada_gym.envs.wrapped.episodes import (
    EpisodeSpec,
    EpisodeStart,
    GymnasiumEpisodes,
    in_groups,
    reset_arguments,
)
from sada_gym.envs.wrapped.factory import EnvFactory, has_time_limit, layers
from sada_gym.envs.wrapped.paths import passed
from sada_gym.envs.wrapped.served import ServedEnvironment
from sada_gym.errors import Notice, UserError, explained

_ACTIONS = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
_ID = re.compile(r"(.+)-v(\d+)")
_OWN_LIMITS = ("max_steps", "max_episode_steps", "_max_episode_steps", "max_path_length", "horizon")

_PATIENCE_S, _SLOWER = 60.0, 20.0
"""A second environment may take so much longer than the first, and so many times as long."""


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

    def identity(self, keywords: Any) -> str:
        """Return a SHA-256 over the environment's class, its packages' versions, and keywords.

        The packages are its class's, else those that the module of the class imports.
        """
        kind, of = self.layers[-1], packages_distributions()
        home = kind.__module__.partition(".")[0]
        names = {home}
        if home not in of:  # a file of the user's, around a simulator
            used = vars(sys.modules[kind.__module__]).values()
            modules = [
                getattr(value, "__module__", getattr(value, "__name__", "")) for value in used
            ]
            names = {str(module).partition(".")[0] for module in modules} - {"numpy", "gymnasium"}
        found = {name for top in names for name in of.get(top, ())}
        packages = {name: version(name) for name in sorted(found)}
        text = json.dumps(
            [f"{kind.__module__}:{kind.__qualname__}", packages, keywords], default=str
        )
        return hashlib.sha256(text.encode()).hexdigest()


def packages_of(env: gym.Env[Any, Any]) -> tuple[str, ...]:
    """Name the packages that an environment and an agent may need; some may not be installed."""
    modules = {kind.__module__ for layer in layers(env) for kind in type(layer).__mro__}
    known = ("box2d", "mujoco")
    engines = {e for e in known for m in modules if m.startswith(f"gymnasium.envs.{e}")}
    homes = {module.partition(".")[0] for module in modules} - {"builtins", "abc", "typing"}
    return tuple(sorted({"torch", "stable-baselines3", *engines, *homes}))


def name_and_version(factory: EnvFactory, env: gym.Env[Any, Any]) -> tuple[str, int]:
    """Split an id into its name and version; a class has version 0."""
    if not isinstance(factory.environment, str | ServedEnvironment):
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
                f"{type(layer).__name__}, whose statistics begin again in each episode and are not "
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


def check_unshared(factory: EnvFactory, name: str, passed_before: Mapping[str, list[Any]]) -> None:
    """Check that a second environment shares nothing with a first that a parameter multiplies.

    The first one may be closed: `passed_before` holds what it had on the way to each path.
    """
    with closing(factory.make({})) as other:
        other.reset(seed=0)
        for path, values in passed_before.items():
            pairs = zip(values, passed(other.unwrapped, path), strict=False)
            if any(one is two for one, two in pairs):
                raise UserError(
                    f"Expected each {factory.name} to have a {path!r} of its own, because "
                    f"{name!r} multiplies it, but two share it. Copy it in the constructor."
                )


def check_ranges(spec: EpisodeSpec, starts: list[EpisodeStart], seconds: float) -> dict[str, str]:
    """Begin worlds, so that bad ranges are found at once; `seconds` is about what one takes.

    It warns of attributes that do not follow the parameters, so that the physics is wrong.

    Returns:
        These attributes, and the formulas that they should follow, "" where unknown.

    Raises:
        UserError: If a world cannot begin, or a process can hold one environment only.
    """
    roots = {Attribute: "", Config: "config."}
    places = [(roots[type(b)], b.targets(k)) for k, b in spec.bindings.items() if type(b) in roots]
    targets = [f"{root}{path}" for root, paths in places for path in paths]
    survey: Survey | None = None
    stale, told = dict[str, str](), ""
    patience_s = np.inf if spec.lanes == 1 else _PATIENCE_S + _SLOWER * seconds * len(starts)

    def look(episodes: GymnasiumEpisodes) -> list[Look]:
        nonlocal survey, told
        looks = list[Look]()
        for episode in episodes.running:
            if episode.env is not None and episode.start.number == 0:
                world = episode.env.unwrapped
                if not survey:
                    survey = Survey.of(targets, world)
                    told = describe_unscaled([*targets, *spec.derived.formulas], world)
                looks.append(survey.look(world))
        return looks

    def begin(lanes: int | None) -> list[Look]:
        strict = replace(spec, on_error="raise", lanes=lanes)
        with _within(patience_s, spec.factory.name):
            return in_groups(strict, starts if len(starts) > 1 else starts * 2, look)

    try:
        looks = begin(spec.lanes)
    except UserError as error:
        if spec.lanes == 1:
            raise
        begin(1)  # raises where a world fails alone, too
        reason = getattr(error, "reason", error)
        raise UserError(
            f"Expected several environments of {spec.factory.name} in one process, got one that "
            "fails beside another, while one alone works. Set num_envs=1 (num_envs = 1 in TOML); "
            f"worker processes then have one each. Beside another, {reason}"
        ) from error

    @cache
    def make(*keywords: tuple[str, Any]) -> Look:
        with closing(spec.factory.make(dict(keywords))) as env:
            env.reset(**reset_arguments(replace(spec, bindings={}), EpisodeStart({}, 0, 0)))
            assert survey is not None
            return survey.look(env.unwrapped)

    if targets and survey is not None:
        keywords = [target for target in targets if target in spec.factory.keywords]
        stale = survey.stale(looks, make) or by_keywords(keywords, looks[-1], make)
    if told := describe_stale(stale) + told:
        warnings.warn(f"In {spec.factory.name} {told}", Notice, stacklevel=3)
    return stale


def has_one_engine(factory: EnvFactory) -> bool:
    """Say whether a second environment fails beside the first, while one alone works."""

    def begin() -> gym.Env[Any, Any]:
        env = factory.make({})
        try:
            env.reset(seed=0)
        except BaseException:
            with suppress(Exception):
                env.close()
            raise
        return env

    began = time.monotonic()
    try:
        with closing(begin()):
            seconds = time.monotonic() - began
            with suppress(Exception), _within(_PATIENCE_S + _SLOWER * seconds, factory.name):
                begin().close()
                return False
        begin().close()
    except Exception:  # not even one works
        return False
    return True


@contextmanager
def _within(seconds: float, name: str) -> Iterator[None]:
    """Interrupt the main thread if a second environment takes too long, where systems can."""
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or not np.isfinite(seconds) or not hasattr(signal, "setitimer"):
        yield
        return

    def stop(*_: Any) -> None:
        raise UserError(f"Expected it to begin within {seconds:.0f} seconds. {name} hangs.")

    handler = signal.signal(signal.SIGALRM, stop)
    timer = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer)
        signal.signal(signal.SIGALRM, handler)

"""Any Gymnasium environment under attack, with any trained agent."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import DependencyNotInstalled

from sada_gym.agents import resolve
from sada_gym.agents.agent_files import find_agent_file, load_agent_file
from sada_gym.agents.contract import Agent, Interface
from sada_gym.agents.functions import agent_of
from sada_gym.agents.identity import check_agent_id
from sada_gym.agents.remote.client import RemoteAgent
from sada_gym.agents.remote.places import Address, Program, place_of
from sada_gym.application import (
    INFEASIBLE,
    INVALID_SCORE,
    OnError,
    Scored,
    check_declared,
    isolated_rng,
)
from sada_gym.arrays import Floats, Floats32
from sada_gym.behaviour import Behaviour
from sada_gym.densities import WorldDensity
from sada_gym.determinism import check_deterministic, same_answer, single_threaded
from sada_gym.drawing import stamped
from sada_gym.envs.checks import has_nan, is_number
from sada_gym.envs.episodes.closed_loop import EpisodesApplication
from sada_gym.envs.episodes.rollout import Rollout, play, record
from sada_gym.envs.wrapped.behaviour import behaviour
from sada_gym.envs.wrapped.bindings import (
    Attribute,
    Config,
    ParameterBinding,
    as_binding,
    as_json,
    check_distinct,
)
from sada_gym.envs.wrapped.constructed import (
    by_keywords,
    describe_stale,
    describe_unscaled,
    stale_attributes,
)
from sada_gym.envs.wrapped.derived import Derived
from sada_gym.envs.wrapped.episodes import (
    EpisodeSpec,
    EpisodeStart,
    GymnasiumEpisodes,
    RunningEpisode,
    make_world,
    reset_arguments,
)
from sada_gym.envs.wrapped.factory import (
    EnvFactory,
    EnvLike,
    code_name,
    function_name,
    layers,
)
from sada_gym.envs.wrapped.feasible import Feasible, FeasibleLike
from sada_gym.envs.wrapped.inspection import check_environment, name_and_version, packages_of
from sada_gym.envs.wrapped.privileged import Privileged
from sada_gym.envs.wrapped.repeats import Traces, check_repeats, trace
from sada_gym.envs.wrapped.scores import FunctionScore, Length, Score, ScoreLike, as_score
from sada_gym.errors import (
    Notice,
    UserError,
    UserTypeError,
    check_integer,
    check_known,
    check_plain,
    plain,
)
from sada_gym.evaluation.watch import is_watched, world_key
from sada_gym.evaluations import fools
from sada_gym.frames import Frame, LegendEntry, Take
from sada_gym.lazy import load
from sada_gym.parameters import Mu, ParameterSpace, number
from sada_gym.seeds import validate_seeds, validate_world

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

_USUAL_FPS = 30
"""Frames a second of environments that do not say it."""
_MANY = 40
_MOST_EPISODES = 100_000
_MOST_WHOLE = 2**53
_LONGEST_WAIT_S = 1e6  # sockets take twice as much
_FEW_CLIPPED = 0.05
_TRIED = 3
"""Worlds that are played together and alone before the first score counts."""
_MOST_AT_ONCE = 256
"""Worlds played at once, where their memory allows."""
_REGION_DRAWN, _REGION_FOUND = 10_000, 10
"""Worlds drawn to see whether the feasible region is large enough, and how many must lie in it."""


class GymnasiumApplication(EpisodesApplication[GymnasiumEpisodes]):
    """A frozen agent acts in a Gymnasium environment whose physics, sensors and actuators mu sets.

    Every episode has a fresh environment, whose seed follows from the evaluation's seed, so that
    the score is the same in any batch, order and process. The environment must draw its randomness
    from its own `np_random`, and the agent must answer the same whenever it is asked.

    Args:
        environment: An environment's id, `module:id`, or a function that makes one. A function gets
            `env_kwargs` and the parameters that are keywords, and `render_mode` where it takes it.
        agent: An SB3 model, the path of an SB3 zip, any object with `predict` for batches, a
            function `observation -> action`, or an agent with `fingerprint`, `start` and `act`. An
            agent in a process of its own is an address, "tcp://127.0.0.1:7788", or a command that
            starts it, ["python", "serve.py"].
            A function is called for one observation at a time, and must remember nothing, because
            many episodes go on at once. A class or function without arguments, or with the one
            argument `seed`, makes an agent for each episode; of an object with `reset` each episode
            gets a copy. These may remember. Box actions are clipped to their space.
        parameters: The parameters by name: (low, high), or a binding of `sada_gym.envs.wrapped`.
            (low, high) is a keyword of the environment's constructor of that name, else an
            attribute of `env.unwrapped`.
        score: ("return", low, high), which clips; "success", which reads `info["is_success"]` or
            `info["success"]`; ("success", key) for another key; ("length", maximum); or a function
            of an `Episode` that returns a number in [0, 1]. A high score is good for the agent.
        fooling_threshold: The agent is fooled where the score is at most this.
        episodes: The episodes whose mean score counts.
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        max_steps: The limit of steps of an episode; None keeps the environment's own. "own" says
            that it ends its episodes by itself, although no `TimeLimit` shows it; a world that goes
            on for `MOST_STEPS` breaks.
        env_kwargs: The keywords that every environment gets.
        name: The application's name in reports; None takes the environment's.
        agent_id: Names the agent in evaluation stores, together with all functions of your own;
            change it whenever you change one of them. SB3 models have a hash of their weights.
        allow_pickle: Whether files may be unpickled, which can run code: do it only with your own.
        vec_normalize: The `VecNormalize` that the agent was trained with, or its file, a pickle. A
            model that holds its training environment needs none. False says that there was none,
            although a file of one lies beside the agent's.
        deterministic: Whether the agent takes its best action. With False it draws its actions, one
            observation at a time, and all that it draws follows from the evaluation's seed.
        on_error: What becomes of a world that breaks: its environment raises, gives NaN as a reward
            or in an observation, takes longer than `timeout`, or ends its worker process. Such a
            world is `invalid` by default, which is no failure of the agent: its score is
            `INVALID_SCORE`, and an attack counts it apart. `fooled` counts it as a failure of the
            agent, with score 0, and `raise` raises. NaN in observations is normal where the
            environment's first observation holds it, too.
        valid: A function of the unwrapped environment after an episode. It returns whether the
            simulator computed the world, or what was wrong; False, and a text that is not empty,
            make the world break. By default MuJoCo's warnings, masses and inertias are looked at:
            `sada_gym.envs.wrapped.mujoco_fault`.
        feasible: Which worlds can exist: an expression such as `"mass * gravity < 30"`, a function
            of the parameters' values by name, or a list of them, which must all hold. Other worlds
            are never computed, and no sample is drawn there; an adversary that asks sees an invalid
            world. The region must hold at least a thousandth of the box.
        derived: Attributes of `env.unwrapped` that follow from others, and how, such as
            `{"total_mass": "masspole + masscart"}`: by paths and expressions like those of
            `feasible`, whose names are attributes or parameters. They are computed in every
            episode once the parameters are set, before `reset` and after it. A warning says where
            one is missing: where a constructor computed an attribute from one that a parameter
            sets, it keeps its old value.
        timeout: Seconds that the environment may take for an episode. A worker process is stopped
            in a call that takes longer, so use `workers=2` or more; a single process cannot
            interrupt a call.
        agent_timeout: How many seconds an agent in a process of its own may take to start, and to
            answer.
        privileged: A second agent, of the same kinds as `agent`, such as a controller that knows
            the physics or an older checkpoint. Where it fails as well, a failure may not be the
            agent's own: attacks tell such worlds apart. `vec_normalize`, `deterministic` and
            `agent_id` hold for it, too.

    Raises:
        UserError: If the environment, the agent, a parameter or the score is not as described.

    Example:
        >>> application = GymnasiumApplication(
        ...     "CartPole-v1", agent=lambda state: int(state[2] + state[3] > 0),
        ...     parameters={"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        ...     derived={"polemass_length": "masspole * length"},
        ...     score=("return", 0.0, 500.0), fooling_threshold=0.5, agent_id="by hand",
        ... )
    """

    episode_spec: EpisodeSpec
    packages: tuple[str, ...]
    stale: dict[str, str]
    """The attributes that do not follow the parameters, and the formulas, "" where unknown."""
    nominal: Floats32 | None
    """Of each binding its `nominal`, or what the environment has.

    None also where that lies outside a range, or makes a world that is not feasible.
    """

    def __init__(
        self,
        environment: EnvLike,
        *,
        agent: Any,
        parameters: Mapping[str, ParameterBinding | tuple[float, float]],
        score: ScoreLike,
        fooling_threshold: float,
        episodes: int = 1,
        sample_size: int = 100,
        max_steps: int | Literal["own"] | None = None,
        env_kwargs: Mapping[str, Any] | None = None,
        name: str | None = None,
        agent_id: str | None = None,
        allow_pickle: bool = False,
        vec_normalize: str | Path | VecNormalize | Literal[False] | None = None,
        deterministic: bool = True,
        on_error: OnError = "invalid",
        valid: Callable[[Any], bool | str] | None = None,
        feasible: FeasibleLike | None = None,
        derived: Mapping[str, str] | None = None,
        timeout: float | None = None,
        agent_timeout: float = 300.0,
        privileged: Any = None,
    ) -> None:
        check_integer("episodes", episodes, 1, _MOST_EPISODES)
        check_integer("sample_size", sample_size, 1, _MOST_WHOLE)
        if max_steps is not None and max_steps != "own":
            check_integer("max_steps", max_steps, 1, _MOST_WHOLE)
        if name is not None and (not isinstance(name, str) or not name):
            raise UserTypeError(f"Expected name to be a text or None, got {name!r}.")
        check_plain("name", name or "")
        check_agent_id(agent_id)
        check_known("on_error", [on_error], get_args(OnError))
        if valid is not None and not callable(valid):
            raise UserTypeError(
                f"Expected valid to be a function of the environment, got {valid!r}."
            )
        if timeout is not None and (
            not is_number(timeout) or not 0 < timeout <= sys.float_info.max
        ):
            raise UserError(f"Expected timeout to be a number of seconds above 0, got {timeout!r}.")
        self._on_error, self._timeout, self._valid = on_error, timeout, valid
        factory = EnvFactory(environment, {} if env_kwargs is None else env_kwargs, max_steps)
        self.fooling_threshold, self.sample_size = fooling_threshold, sample_size
        self._episode_count, self._allow_pickle = episodes, allow_pickle
        if not is_number(agent_timeout) or not 0.0 < agent_timeout <= _LONGEST_WAIT_S:
            raise UserTypeError(
                "Expected agent_timeout to be a number of seconds above 0 and of at most 1e6, got "
                f"{agent_timeout!r}."
            )
        if not isinstance(deterministic, bool):
            raise UserTypeError(f"Expected deterministic to be a bool, got {deterministic!r}.")
        self._deterministic = deterministic
        self._vec_normalize: VecNormalize | Literal[False] | None
        if vec_normalize is None or vec_normalize is False:
            self._vec_normalize = vec_normalize
        else:
            load_statistics = load("sada_gym.agents.wrappers:load_vec_normalize")
            self._vec_normalize = load_statistics(vec_normalize, allow_pickle=allow_pickle)
        with closing(factory.make({})) as env:
            self.episode_spec = self._explore(env, factory, parameters, as_score(score), derived)
        if name is not None:
            self.name = name  # type: ignore[misc]
        check_declared(self)
        given, name_of_agent = self._found(agent, agent_timeout)
        super().__init__(given, agent_id)
        self.agent_name = plain(agent_id or name_of_agent or self.agent_name)
        self._privileged: Privileged | None = None
        if privileged is not None:
            given, known_as = self._found(privileged, agent_timeout)
            known_as = known_as or resolve(given, self.name, None)[0]
            policy = self._as_agent(given, known_as)
            self._privileged = Privileged.of(known_as, policy, given, agent_id)
        self.episode_spec = replace(self.episode_spec, agent=self.agent_name)
        self._clipped = self._scores = 0
        self._at_once = _MOST_AT_ONCE
        self._feasible = Feasible.of(feasible, self.parameters.names)
        self._check_region()
        if self.nominal is not None and self._feasible.conditions:
            (may_exist,) = self.permits(self.nominal[None])  # type: ignore[misc]
            self.nominal = self.nominal if may_exist else None
        self._check_ranges()

    def _explore(
        self,
        env: gym.Env[Any, Any],
        factory: EnvFactory,
        parameters: Mapping[str, Any],
        score: Score,
        derived: Mapping[str, str] | None,
    ) -> EpisodeSpec:
        self._metadata = dict(env.metadata)
        fps: Any = self._metadata.get("render_fps")
        is_rate = is_number(fps) and 0 < fps < np.inf
        self.render_fps = fps if is_rate else _USUAL_FPS  # type: ignore[misc]
        self._wrapped_by = tuple(
            kind
            for kind in (gym.ObservationWrapper, gym.ActionWrapper)
            if any(isinstance(layer, kind) for layer in layers(env))
        )
        self._has_masks = env.has_wrapper_attr("action_masks")
        self.packages = packages_of(env)
        self._layers = tuple(type(layer) for layer in layers(env))
        self.name, self.version = name_and_version(factory, env)  # type: ignore[misc]
        nan_observed = has_nan(check_environment(env, factory))
        if not isinstance(parameters, Mapping) or not parameters:
            raise UserTypeError(
                "Expected parameters as a dictionary, such as {'gravity': (5.0, 15.0)}, got "
                f"{parameters!r}."
            )
        bindings = {key: as_binding(key, given, factory) for key, given in parameters.items()}
        self.parameters = ParameterSpace(*(b.parameter(key) for key, b in bindings.items()))
        for key, binding in bindings.items():
            binding.check(key, factory, env)
        check_distinct(bindings)
        if angles := [key for key, binding in bindings.items() if binding.looks_like_angle()]:
            warnings.warn(
                f"{' and '.join(angles)} may be an angle that goes all around. If so, write "
                "angle=True in its binding: else its ends are told as two places.",
                Notice,
                stacklevel=2,
            )
        places = [binding.nominal_place(key, factory, env) for key, binding in bindings.items()]
        known = [place for place in places if place is not None]
        given = {key: binding.density for key, binding in bindings.items()}
        densities = {key: density for key, density in given.items() if density is not None}
        self.density = WorldDensity(self.parameters, densities) if densities else None
        self.nominal = self.parameters.normalised(known) if len(known) == len(places) else None
        return EpisodeSpec(
            factory,
            bindings,
            env.observation_space,
            env.action_space,
            score,
            "the agent",
            self._on_error,
            self._valid,
            self._timeout,
            nan_observed,
            Derived.given(derived, bindings, factory, env),
        )

    def _check_ranges(self) -> None:
        """Begin the worlds at both ends of all ranges, so that bad ranges are found at once."""
        corners = np.array([[-1.0], [1.0]], np.float32).repeat(len(self.parameters), axis=1)
        worlds = corners[self._possible(corners)]
        spec = replace(self.episode_spec, on_error="raise")
        starts = self._starts(worlds, [0, 0][: len(worlds)])
        with closing(GymnasiumEpisodes(spec, starts)) as episodes:
            self._find_stale(episodes.running[:: self._episode_count])

    def _find_stale(self, running: Sequence[RunningEpisode]) -> None:
        """Warn of attributes that do not follow the parameters, so that the physics is wrong."""
        bindings, factory = self.episode_spec.bindings.items(), self.episode_spec.factory
        self.stale, derived = {}, self.episode_spec.derived
        roots = {Attribute: "", Config: "config."}
        places = [(roots[type(b)], b.targets(key)) for key, b in bindings if type(b) in roots]
        targets = [f"{root}{path}" for root, paths in places for path in paths]
        worlds = [episode.env.unwrapped for episode in running if episode.env is not None]
        with ExitStack() as stack:

            @cache
            def make(*keywords: tuple[str, Any]) -> Any:
                env = stack.enter_context(closing(factory.make(dict(keywords))))
                spec = replace(self.episode_spec, bindings={})
                env.reset(**reset_arguments(spec, EpisodeStart({}, 0, 0)))
                return env.unwrapped

            if targets and worlds:
                keywords = [t for t in targets if t in factory.keywords]
                self.stale = stale_attributes(targets, worlds, make)
                self.stale = self.stale or by_keywords(keywords, worlds[-1], make)
            told = describe_stale(self.stale)
            if worlds:
                told += describe_unscaled([*targets, *derived.formulas], worlds[0])
        if told:
            warnings.warn(f"In {factory.name} {told}", Notice, stacklevel=4)

    def _check_region(self) -> None:
        if not self._feasible.conditions:
            return
        rng, found, drawn = np.random.default_rng(0), 0, 0
        while found < _REGION_FOUND:
            if drawn >= _REGION_DRAWN:
                raise UserError(
                    f"Expected feasible={self._feasible.settings} to hold in a thousandth of all "
                    f"worlds at least, got {found} of {drawn:,}. Shrink the ranges to the region."
                )
            mu = rng.uniform(-1.0, 1.0, (100, len(self.parameters))).astype(np.float32)
            found, drawn = found + sum(map(self._feasible, self._values(mu))), drawn + len(mu)

    def permits(self, mu: Mu) -> npt.NDArray[np.bool_] | None:
        """Return which worlds of mu, (n, d), are feasible; None where all are."""
        return self._possible(mu) if self._feasible.conditions else None

    def _possible(self, mu: Mu) -> npt.NDArray[np.bool_]:
        if not self._feasible.conditions:
            return np.ones(len(mu), np.bool_)
        return np.array([self._feasible(values) for values in self._values(mu)], np.bool_)

    @property
    def _interface(self) -> Interface:
        spec = self.episode_spec
        return Interface(
            spec.factory.name,
            spec.observation_space,
            spec.action_space,
            self._wrapped_by,
            self._has_masks,
        )

    def _found(self, agent: Any, timeout_s: float) -> tuple[Any, str]:
        """Return the agent that a user's description means, and its name, empty if it has none."""
        place = place_of(agent)
        if place is not None:
            remote = self._reached(place, timeout_s)
            return remote, remote.name
        if isinstance(agent, str | Path):
            file = find_agent_file(agent)
            return self._load(file), file.stem
        return agent, ""

    def _reached(self, place: Address | Program, timeout_s: float) -> RemoteAgent:
        if self._vec_normalize:
            raise UserError(
                f"Expected no vec_normalize with the agent in {place}, got one. Pass it to "
                "sada_gym.serve there."
            )
        return RemoteAgent(
            place, self._interface, timeout_s=timeout_s, deterministic=self._deterministic
        )

    def _load(self, path: Path) -> Any:
        spec = self.episode_spec
        return load_agent_file(
            path,
            spec.observation_space,
            spec.action_space,
            allow_pickle=self._allow_pickle,
            has_statistics=self._vec_normalize is not None,
            environment=spec.factory.name,
        )

    def _as_agent(
        self, given: Any, name: str | None = None
    ) -> Agent[GymnasiumEpisodes, npt.NDArray[Any]]:
        return agent_of(
            given,
            self._interface,
            self.agent_name if name is None else name,
            normalisation=self._vec_normalize,
            deterministic=self._deterministic,
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the model that its policy holds as well, in a form that can be pickled."""
        shared = self.agent is getattr(self.policy, "model", None)
        return {**self.__dict__, "agent": None if shared else self.agent}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the model from its policy."""
        self.__dict__.update(state)
        self.agent = getattr(self.policy, "model", None) if self.agent is None else self.agent

    def close(self) -> None:
        """End the processes of agents that have one of their own."""
        policies = [self.policy, *([] if self._privileged is None else [self._privileged.policy])]
        for policy in policies:
            if isinstance(policy, RemoteAgent):
                policy.close()

    @property
    def settings(self) -> dict[str, Any]:
        """All that a score depends on besides the agent."""
        factory, bindings = self.episode_spec.factory, self.episode_spec.bindings
        # only what differs from the default: stores keep their keys
        edges = {
            "on_error": None if self._on_error == "invalid" else self._on_error,
            "valid": None if self._valid is None else code_name(self._valid),
            "feasible": self._feasible.settings or None,
            "derived": self.episode_spec.derived.settings or None,
            "timeout": None if self._timeout is None else float(self._timeout),
            "privileged": None if self._privileged is None else self._privileged.key,
        }
        return {
            **{key: value for key, value in edges.items() if value is not None},
            "environment": factory.identity,
            "env_kwargs": as_json(factory.env_kwargs),
            "parameters": {key: binding.settings for key, binding in bindings.items()},
            "order": [*bindings],
            "score": self.episode_spec.score.settings,
            "fooling_threshold": float(self.fooling_threshold),
            "episodes": self._episode_count,
            "max_steps": factory.max_steps,
            **({} if self._deterministic else {"deterministic": False}),
        }

    @property
    def _own_functions(self) -> dict[str, Any]:
        """The user's functions, by what they do: no fingerprint covers their code."""
        spec = self.episode_spec
        functions = {
            "environment": spec.factory.environment if callable(spec.factory.environment) else None,
            "score": spec.score.function if isinstance(spec.score, FunctionScore) else None,
            "valid": self._valid,
            **{f"feasible {i}": condition for i, condition in enumerate(self._feasible.functions)},
            **{f"parameter {key!r}": b.own_function for key, b in spec.bindings.items()},
            "privileged agent": None if self._privileged is None else self._privileged.unknown,
        }
        return {role: function for role, function in functions.items() if function is not None}

    @property
    def _own_code(self) -> tuple[Any, ...]:
        return (type(self), *self._layers, *self._own_functions.values())

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the agent, or None where a function of the user's has no `agent_id`."""
        return None if self._own_functions and not self._agent_id else super().fingerprint

    @property
    def _without_fingerprint(self) -> str:
        if not self._own_functions or self._agent_id:
            return super()._without_fingerprint
        named = [
            f"the {role} ({function_name(function)})"
            for role, function in self._own_functions.items()
        ]
        return (
            f"Expected agent_id in {self.name}, because {' and '.join(named)} "
            f"{'are functions' if len(named) > 1 else 'is a function'} of your own, and nobody "
            "else knows when such a function changes. Pass agent_id='a name', and another name "
            "whenever you change the agent or a function."
        )

    def episodes(
        self, mu: Mu, seeds: Sequence[int], *, pictures: bool = False
    ) -> GymnasiumEpisodes:
        """Begin the episodes in the worlds of mu, (n, d), those of one evaluation in a row."""
        return GymnasiumEpisodes(self.episode_spec, self._starts(mu, seeds), pictures=pictures)

    def world(
        self,
        mu: npt.ArrayLike | None,
        seed: int,
        *,
        options: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> tuple[gym.Env[Any, Any], dict[str, Any]]:
        """Make the environment of an evaluation's first episode, without an agent, to train in.

        Its reset and its steps raise `InvalidWorld` where the world breaks. `mu`, (d,), None sets
        no parameter: the environment is as it is. `options` are your own for its reset.

        Returns:
            The environment, and the keywords for its `reset`, without which it is another world.
        """
        spec = replace(self.episode_spec, score=Length(1))  # one that keeps no observations
        if mu is None:
            spec, values = replace(spec, bindings={}, derived=Derived()), {}
        else:
            row, seed = validate_world(self.parameters, mu, seed)
            (values,) = self._values(row)
        start = EpisodeStart(values, seed, 0)
        return make_world(spec, start, render_mode), reset_arguments(spec, start, options)

    def _starts(self, mu: Mu, seeds: Sequence[int]) -> list[EpisodeStart]:
        starts = []
        for row, values, seed in zip(mu, self._values(mu), seeds, strict=True):
            world = world_key(row, seed)
            starts += [EpisodeStart(values, seed, i, world) for i in range(self._episode_count)]
        return starts

    def _values(self, mu: Mu) -> list[dict[str, Any]]:
        """Return what the parameters set in the worlds of mu, (n, d)."""
        bindings = self.episode_spec.bindings.items()
        return [
            {
                key: binding.value(number)
                for (key, binding), number in zip(bindings, row, strict=True)
            }
            for row in self.parameters.physical(mu).tolist()
        ]

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        score = np.full(len(mu), INVALID_SCORE)
        outside = {"invalid": INFEASIBLE, "return": 0.0, "length": 0.0, "clipped": False}
        extras = [{**outside, **self._discrete_values(values)} for values in self._values(mu)]
        for i, together in self._all_ended(mu, seeds, self.policy):
            broken = next((episode.broken for episode in together if episode.broken), "")
            mean = float(np.mean([episode.score for episode in together]))
            score[i] = 0.0 if broken and self._on_error == "fooled" else mean
            extras[i] |= {
                "invalid": broken if self._on_error == "invalid" else "",
                "return": float(np.mean([sum(episode.rewards) for episode in together])),
                "length": float(np.mean([len(episode.rewards) for episode in together])),
                "clipped": any(episode.clipped for episode in together),
            }
        self._warn_of_clipping(extras)
        return Scored(score, extras)

    def _ended(
        self, mu: Mu, seeds: Sequence[int], policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]]
    ) -> list[list[RunningEpisode]]:
        """Play the episodes of the first of some worlds, at least one, to their ends."""
        count = self._episode_count
        starts = self._starts(mu[: self._at_once], seeds[: self._at_once])
        with closing(GymnasiumEpisodes(self.episode_spec, starts, together=count)) as episodes:
            play(policy, episodes)
            running = episodes.running
        if len(running) < len(starts):  # memory that was freed may not be seen the next time
            self._at_once = len(running) // count
        return [running[first : first + count] for first in range(0, len(running), count)]

    def behaviours(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> tuple[Behaviour, ...]:
        """Play n worlds, (n, d), again, and say when their episodes ended, and how."""
        batch = self.parameters.validate(mu)
        found = [Behaviour(INFEASIBLE)] * len(batch)
        for i, episodes in self._all_ended(batch, validate_seeds(seeds, len(batch)), self.policy):
            found[i] = behaviour(episodes, self.fooling_threshold)
        return tuple(found)

    def privileged_score(self, mu: npt.ArrayLike, seeds: Sequence[int]) -> Floats | None:
        """Score the privileged agent, (n,); 0 where a world cannot be computed. None without one.

        Raises:
            ValueError: If mu or the seeds are not what `evaluate` takes, or the privileged agent
                answers differently when it is asked twice.
        """
        batch = self.parameters.validate(mu)
        checked = validate_seeds(seeds, len(batch))
        if self._privileged is None:
            return None
        policy, scores = self._privileged.policy, np.zeros(len(batch))
        for i, episodes in self._all_ended(batch, checked, policy):
            score = float(np.mean([episode.score for episode in episodes]))
            scores[i] = 0.0 if np.isnan(score) else score
        for i in range(min(len(batch), _TRIED)):
            for _, episodes in self._all_ended(batch[i : i + 1], checked[i : i + 1], policy):
                again = float(np.nan_to_num(np.mean([episode.score for episode in episodes])))
                answers = ([{"score": float(scores[i])}], [{"score": again}])
                check_deterministic(self._privileged.name, *answers, checked[i : i + 1])
        return scores

    def _all_ended(
        self, mu: Mu, seeds: Sequence[int], policy: Agent[GymnasiumEpisodes, npt.NDArray[Any]]
    ) -> Iterator[tuple[int, list[RunningEpisode]]]:
        """Play all worlds that are feasible to their ends; yield their places and episodes."""
        left = np.flatnonzero(self._possible(mu)).tolist()
        while left:
            with isolated_rng(self):
                worlds = self._ended(mu[left], [seeds[i] for i in left], policy)
            yield from zip(left, worlds, strict=False)
            left = left[len(worlds) :]

    def _check_deterministic(self, mu: Mu, seeds: list[int]) -> None:
        """Play worlds together and then alone, before the first score counts."""
        if "_asked_twice" in self.__dict__:
            return
        # beside neighbours of the first, but for a worker: it might die in a world of no query
        if len(mu) < _TRIED and not is_watched():
            shares = np.linspace(0.9, 0.7, _TRIED - len(mu), dtype=np.float32)[:, None]
            others = shares * mu[0] - np.float32(0.01)
            others = others[self._possible(others)]
            mu, seeds = np.concatenate([mu, others]), [*seeds, *(len(others) * seeds[:1])]
        together = self._answers(mu, seeds)
        alone = [self._answers(mu[i : i + 1], seeds[i : i + 1])[0] for i in range(len(mu))]
        if not same_answer(together, alone):
            self._check_environment_repeats(mu, seeds)
            check_deterministic(self.agent_name, together, alone, seeds)
        self.__dict__["_asked_twice"] = True

    def _answers(self, mu: Mu, seeds: list[int]) -> list[dict[str, Any]]:
        return [{"score": q, **extra} for q, extra in zip(*self._scored(mu, seeds), strict=True)]

    def _check_environment_repeats(self, mu: Mu, seeds: list[int]) -> None:
        """Raise `UserError` if the same actions lead elsewhere, alone or beside other worlds."""

        def traced(worlds: slice, given: list[list[Any]] | None = None) -> Traces:
            with closing(self.episodes(mu[worlds], seeds[worlds])) as episodes, single_threaded():
                return trace(self.policy, episodes, given)

        check_repeats(self.episode_spec.factory.name, traced, seeds, self._episode_count)

    def _discrete_values(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the choices and whole numbers that were set; `parameters` shows only positions."""
        bindings = self.episode_spec.bindings.items()
        chosen = {key: plain(str(values[key])) for key, binding in bindings if binding.choices}
        whole = {key: values[key] for key, binding in bindings if binding.integer}
        return {"values": chosen | whole} if chosen or whole else {}

    def _warn_of_clipping(self, extras: Sequence[Mapping[str, Any]]) -> None:
        before = self._many_clipped
        self._scores += len(extras)
        self._clipped += sum(extra["clipped"] for extra in extras)
        if self._many_clipped and not before:
            warnings.warn(
                f"More than {_FEW_CLIPPED:.0%} of the evaluations of "
                f"{self.episode_spec.factory.name} had a return outside the range of "
                f"score={self.episode_spec.score.settings}. Their scores were clipped, so that an "
                "adversary cannot tell them apart. Widen the range.",
                stacklevel=2,
            )

    @property
    def _many_clipped(self) -> bool:
        return self._scores >= _MANY and self._clipped > _FEW_CLIPPED * self._scores

    @property
    def can_render(self) -> bool:
        """Whether the environment renders as `rgb_array`."""
        modes = self._metadata.get("render_modes") or ()
        return "rgb_array" in modes and self.episode_spec.factory.takes_render_mode

    def _rendering(self, mu: npt.ArrayLike, seed: int) -> GymnasiumEpisodes:
        row, seed = validate_world(self.parameters, mu, seed)
        if not self.can_render:
            raise NotImplementedError(
                f"{self.episode_spec.factory.name} draws no pictures: it has no "
                "render_mode='rgb_array'."
            )
        return self.episodes(row, [seed], pictures=True)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """Which frame of an episode is drawn."""
        count, name = self._episode_count, self.episode_spec.factory.name
        which = "the episode" if count == 1 else f"the worst of {count} episodes"
        return (LegendEntry(f"The last frame of {which}, as {name} draws it."),)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the last frame of the episode, of several that with the lowest score."""
        with closing(self._rendering(mu, seed)) as episodes, _missing_drawing_library():
            play(self.policy, episodes)
            frames = episodes.render(episodes.score.argsort(kind="stable")[:1])
        (frame,) = self._compared(mu, seed, [frames[0]], float(episodes.score.mean()))
        return frame

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the first frame of the first episode."""
        with closing(self._rendering(mu, seed)) as episodes, _missing_drawing_library():
            return np.asarray(episodes.render(np.zeros(1, np.intp))[0])

    def rollouts(self, mu: npt.ArrayLike, seed: int) -> list[Rollout[Any]]:
        """Play all episodes in the world of one mu, (d,), and keep returns, and frames if any."""
        row, seed = validate_world(self.parameters, mu, seed)
        episodes = self.episodes(row, [seed], pictures=self.can_render)
        with closing(episodes), _missing_drawing_library():
            return record(self.policy, episodes)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Play the episodes again, one after another: all frames, and the score."""
        if not self.can_render:
            self._rendering(mu, seed)
        frames, score = super().replay(mu, seed)
        frames = self._compared(mu, seed, frames, score)
        if np.isnan(score):  # the world broke
            score = 0.0 if self._on_error == "fooled" else INVALID_SCORE
        return frames, score

    def takes(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Take], float]:
        """Play the episodes again, for a film: each of them, and the score."""
        if not self.can_render:
            self._rendering(mu, seed)
        rollouts = self.rollouts(mu, seed)
        score = float(np.mean([rollout.score for rollout in rollouts]))
        return [self._take(rollouts, i) for i in range(len(rollouts))], score

    def _take(self, rollouts: list[Rollout[Any]], i: int) -> Take:
        rollout, count = rollouts[i], len(rollouts)
        name = f"episode {i + 1} of {count}  ·  " if count > 1 else ""

        def draw(step: int) -> tuple[Frame, str]:
            return rollout["frame"][step], f"{name}step {step}  ·  return {returns[step]}"

        returns = [number(value) for value in rollout["return"].tolist()]
        ending = f"return {returns[-1]} after {rollout.last} steps"
        return Take(rollout.last + 1, draw, ending, fools(rollout.score, self.fooling_threshold))

    def _compared(
        self, mu: npt.ArrayLike, seed: int, frames: list[Frame], score: float
    ) -> list[Frame]:
        """Say, in a warning and in the frames, where the same world has another score undrawn."""
        row, seed = validate_world(self.parameters, mu, seed)
        undrawn = self.evaluate(row, [seed])
        if undrawn.invalid or undrawn.score[0] == (0.0 if np.isnan(score) else score):
            return frames
        warnings.warn(
            f"Pictures of {self.episode_spec.factory.name} show other episodes than are scored: "
            "its render, or its render_mode, changes what happens. Mend it.",
            Notice,
            stacklevel=3,
        )
        text = f"not the episode that was scored: Q = {score:.2f} drawn, {undrawn.score[0]:.2f} not"
        return [stamped(frame, text) for frame in frames]

    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        return [frame for rollout in rollouts for frame in rollout["frame"]]


@contextmanager
def _missing_drawing_library() -> Iterator[None]:
    """Let a missing drawing library mean that there are no pictures."""
    try:
        yield
    except DependencyNotInstalled as error:
        raise NotImplementedError(f"The environment cannot be drawn: {error}") from error

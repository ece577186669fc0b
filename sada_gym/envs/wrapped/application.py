"""Any Gymnasium environment under attack, with any trained agent."""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from copy import copy
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from sada_gym.agents.contract import Agent
from sada_gym.agents.functions import FunctionAgent
from sada_gym.agents.identity import check_agent_id
from sada_gym.agents.remote.peer import Peer
from sada_gym.agents.remote.places import Address, Program
from sada_gym.application import OnError, check_declared
from sada_gym.densities import WorldDensity
from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.bindings import (
    Attribute,
    Keyword,
    ParameterBinding,
    as_binding,
    as_json,
    check_distinct,
)
from sada_gym.envs.wrapped.derived import Derived
from sada_gym.envs.wrapped.episodes import EpisodeSpec, GymnasiumEpisodes
from sada_gym.envs.wrapped.events import RealTime
from sada_gym.envs.wrapped.factory import EnvFactory, EnvLike, code_name, function_name
from sada_gym.envs.wrapped.feasible import Feasible, FeasibleLike
from sada_gym.envs.wrapped.inspection import Inspection, check_ranges, check_unshared
from sada_gym.envs.wrapped.kept import KeptEnvironments
from sada_gym.envs.wrapped.loading import AgentLoader
from sada_gym.envs.wrapped.paths import passed
from sada_gym.envs.wrapped.pictures import EpisodePictures
from sada_gym.envs.wrapped.scores import ScoreLike
from sada_gym.envs.wrapped.served import ServedEnvironment, server_of
from sada_gym.envs.wrapped.several import Several, given_score
from sada_gym.errors import (
    Notice,
    UserError,
    UserTypeError,
    check_integer,
    check_known,
    check_plain,
    plain,
)
from sada_gym.foundations.arrays import Floats32
from sada_gym.foundations.lazy import load
from sada_gym.parameters import ParameterSpace

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

_USUAL_FPS = 30
"""Frames a second of environments that do not say it."""
_MOST_EPISODES = 100_000
_MOST_WHOLE = 2**53
_LONGEST_WAIT_S = 1e6  # sockets take twice as much
_LANES = 16
"""As many episodes as a network answers in one call."""
_REGION_DRAWN, _REGION_FOUND = 10_000, 10
"""Worlds drawn to see whether the feasible region is large enough, and how many must lie in it."""


class GymnasiumApplication(EpisodePictures):
    """A frozen agent in a Gymnasium environment. mu sets its physics, sensors and actuators.

    Every episode has a fresh environment, whose seed follows from the evaluation's seed, so that
    the score is the same in any batch, order and process. The environment must draw all random
    numbers from its own `np_random`, and the agent must give the same answer when asked again.

    Args:
        environment: An environment's id, `module:id`, or a function that makes one. A function gets
            `env_kwargs`, the parameters that are keywords, and `render_mode` if it takes that.
            For an environment with its own packages: an address, `"tcp://127.0.0.1:7789"`, or a
            command, `["other/bin/python", "serve_environment.py", "CartPole-v1"]`.
        agent: An SB3 model, the path of an SB3 zip, any object with `predict` for batches, a
            function `observation -> action`, or an agent with `fingerprint`, `start` and `act`. For
            an agent in a separate process: its address, `"tcp://127.0.0.1:7788"`, or the command
            that starts it, `["python", "serve.py"]`. A function gets one observation at a time. It
            must have no memory, because many episodes run at once. For an agent with memory, pass a
            class or function that makes one (its only argument may be `seed`), or an object with
            `reset`, which each episode copies. If the function or `predict` has an argument `env`,
            it gets the environment. `"built-in"`: the environment acts by itself, and gets the
            action nearest to zero. Box actions are clipped.
        parameters: The parameters by name, each as (low, high) or as a binding of
            `sada_gym.envs.wrapped`. (low, high) sets the keyword of that name of the environment's
            constructor, if there is one, otherwise the attribute of `env.unwrapped`.
        score: `("return", low, high)`, scaled from low = 0 to high = 1 and clipped; `"success"`,
            for `info["is_success"]` or `info["success"]`; `("success", key)`;
            `("length", maximum)`; or a function of an `Episode` that returns a number from 0
            (worst) to 1 (best). For several requirements, a dictionary of such scores by name. An
            episode fails if it fails at least one of them: the score is then the smallest margin.
        fooling_threshold: The agent is fooled if the score is at most this. For several
            requirements, one number for all, or one for each by name.
        episodes: The number of episodes in an evaluation; their mean score counts.
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        max_steps: The limit of steps of an episode; None keeps the environment's own. Use `"own"`
            if the environment ends its episodes by itself without a `TimeLimit`; a world that
            reaches 100,000 steps then breaks.
        env_kwargs: The keywords that every environment gets.
        name: The application's name in reports; by default the environment's.
        agent_id: A name for the agent and all functions that you pass here. Stored scores are found
            by it: change it whenever you change one of them. SB3 models have a hash of weights.
        allow_pickle: Whether files may be unpickled. This can run code: allow only your own files.
        vec_normalize: The `VecNormalize` that the agent was trained with, or its file, a pickle. A
            model that holds its training environment needs none. False: the agent was trained
            without one, although such a file lies beside it.
        deterministic: Whether the agent takes its best action. With False it draws its actions, one
            observation at a time, and its random numbers follow from the evaluation's seed.
        on_error: What happens to a world that breaks: its environment raises, gives NaN as a reward
            or in an observation, takes longer than `timeout`, or ends its worker process. By
            default, such a world is `invalid`: it is not a failure of the agent, its score is 1,
            and attacks count it separately. `fooled` counts it as a failure of the agent with
            score 0, and `raise` raises the error. NaN in observations is accepted if the
            environment's first observation holds NaN, too.
        valid: A function of the unwrapped environment after an episode. It returns whether the
            simulator computed the world, or a text that says what was wrong. The world breaks if it
            returns False or a text that is not empty. The default checks MuJoCo's warnings, masses
            and inertias: `sada_gym.envs.wrapped.mujoco_fault`.
        feasible: Which worlds can exist: an expression such as `"mass * gravity < 30"`, a function
            of the parameters' values by name, or a list of these, which must all hold. Other worlds
            are never computed, and no sample is drawn there; an adversary that queries one gets an
            invalid world. The region must hold at least a thousandth of the box.
        derived: Attributes of `env.unwrapped` that are computed from others, by expressions like
            those of `feasible`: `{"total_mass": "masspole + masscart"}`. Names are paths of
            attributes, or parameters. They are computed in every episode after the parameters are
            set, before `reset` and after it. You need this if the constructor computes an attribute
            from one that a parameter sets: it would keep its old value. A warning names such ones.
        timeout: Seconds that the environment may take for an episode. A worker process that takes
            longer is stopped, so use `workers=2` or more: a single process cannot interrupt a call.
        agent_timeout: Seconds that a separate agent or environment may take to start or to answer.
        privileged: A second agent, of the same kinds as `agent`, such as a controller that knows
            the physics or an older checkpoint. If it fails as well, the failure may not be the
            agent's fault: attacks report such worlds separately. `vec_normalize`, `deterministic`
            and `agent_id` apply to it, too.
        num_envs: How many environments may be alive in one process at once, for engines that limit
            this: one is closed before the next is made. Scores stay the same, and each worker
            process may have this many. None plays many worlds at once.
        reuse: Whether to reset an environment for the next episode instead of making a new one,
            which saves slow constructors. No parameter may be a keyword of the constructor. Before
            the first score, three worlds must give the same episode in a new and in a reset one.
        requirement: One of several requirements: only this one counts as a failure, and adversaries
            see its margin. None takes the worst in each episode.

    Raises:
        UserError: If the environment, the agent, a parameter or the score is not as described here.

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
        environment: EnvLike | list[str] | Address | Program,
        *,
        agent: Any,
        parameters: Mapping[str, ParameterBinding | tuple[float, float]],
        score: ScoreLike | Mapping[str, ScoreLike],
        fooling_threshold: float | Mapping[str, float],
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
        num_envs: int | None = None,
        reuse: bool = False,
        requirement: str | None = None,
    ) -> None:
        check_integer("episodes", episodes, 1, _MOST_EPISODES)
        check_integer("sample_size", sample_size, 1, _MOST_WHOLE)
        if max_steps is not None and max_steps != "own":
            check_integer("max_steps", max_steps, 1, _MOST_WHOLE)
        if num_envs is not None:
            check_integer("num_envs", num_envs, 1, _MOST_WHOLE)
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
        if not is_number(agent_timeout) or not 0.0 < agent_timeout <= _LONGEST_WAIT_S:
            raise UserTypeError(
                "Expected agent_timeout to be a number of seconds above 0 and of at most 1e6, got "
                f"{agent_timeout!r}."
            )
        for flag, given in {"deterministic": deterministic, "reuse": reuse}.items():
            if not isinstance(given, bool):
                raise UserTypeError(f"Expected {flag} to be a bool, got {given!r}.")
        self._on_error, self._timeout, self._episode_count = on_error, timeout, episodes
        scored_by, self.fooling_threshold = given_score(score, fooling_threshold, requirement)
        self.requirements = tuple(scored_by.scores) if isinstance(scored_by, Several) else ()
        self.sample_size = sample_size
        server = server_of(environment)
        made: Any = environment if server is None else ServedEnvironment(server, agent_timeout)
        kwargs = {} if env_kwargs is None else env_kwargs
        factory = EnvFactory(made, kwargs, max_steps, num_envs)
        statistics: Any = vec_normalize
        if statistics is not None and statistics is not False:
            load_statistics = load("sada_gym.agents.wrappers:load_vec_normalize")
            statistics = load_statistics(vec_normalize, allow_pickle=allow_pickle)
        began = time.monotonic()
        with closing(factory.make({})) as env:
            self._inspection = inspection = Inspection.of(env, factory)
            bindings = self._bind(parameters, factory, env)
            if any(isinstance(binding, RealTime) for binding in bindings.values()):
                self.repeatable = False  # type: ignore[misc]
                warnings.warn(
                    "RealTime measures how long the agent computes, so that no score repeats "
                    "exactly: another run or computer gives other scores.",
                    Notice,
                    stacklevel=2,
                )
                num_envs = 1
                factory = replace(factory, num_envs=1)
            self.episode_spec = EpisodeSpec(
                factory,
                bindings,
                env.observation_space,
                env.action_space,
                scored_by,
                "the agent",
                on_error,
                valid,
                timeout,
                inspection.nan_observed,
                Derived.given(derived, bindings, factory, env),
                self._keeper(bindings, factory, derived) if reuse else None,
                num_envs,
            )
            factors = {
                key: {path: passed(env.unwrapped, path) for path in binding.targets(key)}
                for key, binding in bindings.items()
                if isinstance(binding, Attribute) and binding.factor
            }
        seconds = time.monotonic() - began
        for key, paths in factors.items():
            check_unshared(factory, key, paths)
        self.name, self.version = name or inspection.name, inspection.version  # type: ignore[misc]
        self.packages = inspection.packages
        fps: Any = inspection.metadata.get("render_fps")
        is_rate = is_number(fps) and 0 < fps < np.inf
        self.render_fps = fps if is_rate else _USUAL_FPS  # type: ignore[misc]
        check_declared(self)
        self._loader = AgentLoader(
            partial(inspection.identity, as_json(factory.env_kwargs)),
            inspection.interface,
            allow_pickle,
            statistics,
            deterministic,
            agent_timeout,
        )
        loaded, name_of_agent = self._loader.load(agent)
        super().__init__(loaded, agent_id)
        self.agent_name = plain(agent_id or name_of_agent or self.agent_name)
        self._privileged = self._loader.privileged(privileged, self.name, agent_id)
        self.episode_spec = replace(self.episode_spec, agent=self.agent_name)
        self._feasible = Feasible.of(feasible, self.parameters.names)
        if self._feasible.conditions:
            self.permits = self._possible
            self._check_region()
        if reuse and num_envs is None:  # more of them would be made than an agent has use for
            lanes = 1 if isinstance(self.policy, FunctionAgent) else _LANES
            self.episode_spec = replace(self.episode_spec, lanes=lanes)
        corners = np.array([[-1.0], [1.0]], np.float32).repeat(len(self.parameters), axis=1)
        worlds = corners[self.permits(corners)]
        starts = self._starts(worlds, [0, 0][: len(worlds)])
        self.stale = check_ranges(self.episode_spec, starts, seconds)

    def _bind(
        self, parameters: Mapping[str, Any], factory: EnvFactory, env: gym.Env[Any, Any]
    ) -> dict[str, ParameterBinding]:
        """Set `parameters`, `density` and `nominal`; return what the parameters set."""
        if not isinstance(parameters, Mapping) or not parameters:
            raise UserTypeError(
                "Expected parameters as a dictionary, such as {'gravity': (5.0, 15.0)}, got "
                f"{parameters!r}."
            )
        self.step_limit = limit = factory.step_limit(env)
        bindings = {
            key: as_binding(key, given, factory).within(key, limit)
            for key, given in parameters.items()
        }
        self.parameters = _space_of(bindings)
        for key, binding in bindings.items():
            binding.check(key, factory, env)
        check_distinct(bindings)
        if angles := [key for key, binding in bindings.items() if binding.looks_like_angle()]:
            warnings.warn(
                f"{' and '.join(angles)} may be an angle that goes all around. If so, write "
                "angle=True in its binding: else its ends are told as two places.",
                Notice,
                stacklevel=3,
            )
        places = [place for key, b in bindings.items() for place in b.places(key, factory, env)]
        known = [place for place in places if place is not None]
        self.density = _density_of(bindings, self.parameters)
        self.nominal = self.parameters.normalised(known) if len(known) == len(places) else None
        return bindings

    @property
    def curves(self) -> dict[str, ParameterBinding]:
        """The bindings whose value is a curve over the episode, by their names."""
        return {key: b for key, b in self.episode_spec.bindings.items() if b.knots is not None}

    def stepwise(self) -> GymnasiumApplication:
        """Return a copy whose parameters each have a value of their own in every step.

        Raises:
            UserError: If a parameter cannot change during an episode, there is a `feasible` region,
                several episodes count, or the limit of steps is unknown.
        """
        spec, limit = self.episode_spec, self.step_limit
        fixed = [
            key
            for key, b in spec.bindings.items()
            if not b.varies
            or b.knots is not None
            or b.count != 1
            or not getattr(b, "holds_always", True)
        ]
        if fixed or limit is None or self._feasible.conditions or self._episode_count > 1:
            raise UserError(
                "Expected parameters that may change in each step (disturbances, forces, Attribute "
                "and Function, without knots and times), one episode, a limit of steps and no "
                f"feasible region in {self.name}, got {', '.join(fixed) or 'one of the others'}. "
                "Make an application of its own for it."
            )
        bindings: dict[str, ParameterBinding] = {
            key: replace(binding, knots=limit, curve="steps", over=limit)
            for key, binding in spec.bindings.items()
        }
        changed = copy(self)
        changed.episode_spec = replace(spec, bindings=bindings)
        changed.parameters = _space_of(bindings)
        changed.density = _density_of(bindings, changed.parameters)
        if self.nominal is not None:
            changed.nominal = np.repeat(self.nominal, limit)
        for measured in ("_measured", "_asked_twice"):
            changed.__dict__.pop(measured, None)
        return changed

    def _keeper(
        self,
        bindings: Mapping[str, ParameterBinding],
        factory: EnvFactory,
        derived: Mapping[str, str] | None,
    ) -> KeptEnvironments:
        if keywords := [key for key, b in bindings.items() if isinstance(b, Keyword)]:
            raise UserError(
                "Expected parameters that an environment takes after it is made, with reuse=True, "
                f"got {' and '.join(map(repr, keywords))} for the constructor. Name attributes, "
                "reset options or functions instead, or leave reuse out."
            )
        kinds = (b.targets(key) for key, b in bindings.items() if isinstance(b, Attribute))
        return KeptEnvironments(factory, (*chain.from_iterable(kinds), *(derived or {})))

    def _check_region(self) -> None:
        """Check that enough worlds are feasible; forget a nominal world that is not."""
        rng, found, drawn = np.random.default_rng(0), 0, 0
        while found < _REGION_FOUND:
            if drawn >= _REGION_DRAWN:
                raise UserError(
                    f"Expected feasible={self._feasible.settings} to hold in a thousandth of all "
                    f"worlds at least, got {found} of {drawn:,}. Shrink the ranges to the region."
                )
            mu = rng.uniform(-1.0, 1.0, (100, len(self.parameters))).astype(np.float32)
            found, drawn = found + sum(self.permits(mu).tolist()), drawn + len(mu)
        if self.nominal is not None and not self.permits(self.nominal[None]).all():
            self.nominal = None

    def _as_agent(self, given: Any) -> Agent[GymnasiumEpisodes, npt.NDArray[Any]]:
        return self._loader.policy(given, self.agent_name)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the model that its policy holds as well, in a form that can be pickled."""
        shared = self.agent is getattr(self.policy, "model", None)
        return {**self.__dict__, "agent": None if shared else self.agent}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the model from its policy."""
        self.__dict__.update(state)
        self.agent = getattr(self.policy, "model", None) if self.agent is None else self.agent

    def close(self) -> None:
        """End the processes of agents and of the environment, and kept environments."""
        if self.episode_spec.kept is not None:
            self.episode_spec.kept.close()
        privileged = None if self._privileged is None else self._privileged.policy
        for peer in (self.policy, privileged, self.episode_spec.factory.environment):
            if isinstance(peer, Peer):
                peer.close()

    @property
    def settings(self) -> dict[str, Any]:
        """All that a score depends on besides the agent."""
        spec, factory = self.episode_spec, self.episode_spec.factory
        served = factory.environment
        # only what differs from the default: stores keep their keys
        edges = {
            "on_error": None if self._on_error == "invalid" else self._on_error,
            "valid": None if spec.valid is None else code_name(spec.valid),
            "feasible": self._feasible.settings or None,
            "derived": spec.derived.settings or None,
            "timeout": None if self._timeout is None else float(self._timeout),
            "privileged": None if self._privileged is None else self._privileged.key,
            "served": served.settings if isinstance(served, ServedEnvironment) else None,
        }
        return {
            **{key: value for key, value in edges.items() if value is not None},
            "environment": factory.identity,
            "env_kwargs": as_json(factory.env_kwargs),
            "parameters": {key: binding.settings for key, binding in spec.bindings.items()},
            "order": [*spec.bindings],
            "score": spec.score.settings,
            "fooling_threshold": float(self.fooling_threshold),
            "episodes": self._episode_count,
            "max_steps": factory.max_steps,
            **({} if self._loader.deterministic else {"deterministic": False}),
        }

    @property
    def _own_functions(self) -> dict[str, Any]:
        """The user's functions, by what they do: no fingerprint covers their code."""
        spec = self.episode_spec
        made = spec.factory.environment
        functions = {
            "environment": None if isinstance(made, str | ServedEnvironment) else made,
            **spec.score.own_functions,
            "valid": spec.valid,
            **{f"feasible {i}": condition for i, condition in enumerate(self._feasible.functions)},
            **{f"parameter {key!r}": b.own_function for key, b in spec.bindings.items()},
            "privileged agent": None if self._privileged is None else self._privileged.unknown,
        }
        return {role: function for role, function in functions.items() if function is not None}

    @property
    def _own_code(self) -> tuple[Any, ...]:
        return (type(self), *self._inspection.layers, *self._own_functions.values())

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


def _space_of(bindings: Mapping[str, ParameterBinding]) -> ParameterSpace:
    spaces = (binding.parameters(key) for key, binding in bindings.items())
    return ParameterSpace(*chain.from_iterable(spaces))


def _density_of(
    bindings: Mapping[str, ParameterBinding], space: ParameterSpace
) -> WorldDensity | None:
    pairs = (pair for key, b in bindings.items() for pair in b.densities(key).items())
    densities = dict(pairs)
    return WorldDensity(space, densities) if densities else None

"""Any Gymnasium environment under attack, with any trained agent."""

from __future__ import annotations

import pickle
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import DependencyNotInstalled

from sada_gym.agents.contract import Agent
from sada_gym.agents.identity import check_agent_id
from sada_gym.application import Scored, refuse_undeclared, validate_world
from sada_gym.envs.episodes.closed_loop import EpisodesApplication
from sada_gym.envs.episodes.rollout import Rollout, play, record
from sada_gym.envs.wrapped.disturbances import refuse_doubles
from sada_gym.envs.wrapped.episodes import Game, GymnasiumEpisodes, World
from sada_gym.envs.wrapped.maker import EnvLike, Maker, layers, own_limit
from sada_gym.envs.wrapped.places import Function, Place, found_place, plain
from sada_gym.envs.wrapped.plain import PlainAgent
from sada_gym.envs.wrapped.scores import Own, ScoreLike, as_score
from sada_gym.errors import FileError, UserError, UserTypeError, check_integer
from sada_gym.frames import Frame, LegendEntry
from sada_gym.lazy import load
from sada_gym.parameters import Mu, ParameterSpace

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecNormalize

_ACTIONS = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
_ID = re.compile(r"(.+)-v(\d+)")
_MANY = 40
_FEW_CLIPPED = 0.05


class GymnasiumApplication(EpisodesApplication[GymnasiumEpisodes]):
    """A frozen agent acts in a Gymnasium environment whose physics, sensors and actuators mu sets.

    Every episode has a fresh environment, whose seed follows from the evaluation's seed, so that
    the score is the same in any batch, order and process. The environment must draw its randomness
    from its own `np_random`, and the agent must answer the same whenever it is asked.

    Args:
        environment: An environment's id, `module:id`, or a function that makes one. A function gets
            `env_kwargs` and the parameters that are keywords, and `render_mode` where it takes it.
        agent: An SB3 model, the path of an SB3 zip, any object with `predict` for batches, a
            function `observation -> action`, or an agent with `fingerprint`, `start` and `act`.
            A function is called for one observation at a time, and must remember nothing, because
            many episodes go on at once. Box actions are clipped to their space.
        parameters: The parameters by name: (low, high), or a place of `sada_gym.envs.wrapped`.
            (low, high) is a keyword of the environment's constructor of that name, else an
            attribute of `env.unwrapped`.
        score: ("return", low, high), which clips; "success", which reads `info["is_success"]`;
            ("length", most); or a function of an `Episode` that gives a number in [0, 1]. A high
            score is good for the agent.
        fooling_threshold: The agent is fooled where the score is at most this.
        episodes: The episodes whose mean score counts.
        sample_size: Number of test samples drawn from a trained adversary (M in the paper).
        max_steps: The limit of steps of an episode; None keeps the environment's own.
        env_kwargs: The keywords that every environment gets.
        name: The application's name in reports; None takes the environment's.
        agent_id: Names the agent in evaluation stores, together with all functions of your own;
            change it whenever you change one of them. SB3 models have a hash of their weights.
        trust: Whether files may be unpickled, which can run code: do it only with your own.
        statistics: The file of the `VecNormalize` that the agent was trained with, a pickle, or
            the object itself. A model that holds its training environment needs none.

    Raises:
        UserError: If the environment, the agent, a parameter or the score is not as described.

    Example:
        >>> application = GymnasiumApplication(
        ...     "CartPole-v1", agent=lambda state: int(state[2] + state[3] > 0),
        ...     parameters={"gravity": (5.0, 20.0), "length": (0.2, 2.0)},
        ...     score=("return", 0.0, 500.0), fooling_threshold=0.5, agent_id="by hand",
        ... )
    """

    game: Game
    packages: tuple[str, ...]
    _other_cause = (
        "If it is the environment that is random, let it draw from its own np_random and not from "
        "numpy.random or random, and let its episodes share nothing."
    )

    def __init__(
        self,
        environment: EnvLike,
        *,
        agent: Any,
        parameters: Mapping[str, Place | tuple[float, float]],
        score: ScoreLike,
        fooling_threshold: float,
        episodes: int = 1,
        sample_size: int = 100,
        max_steps: int | None = None,
        env_kwargs: Mapping[str, Any] | None = None,
        name: str | None = None,
        agent_id: str | None = None,
        trust: bool = False,
        statistics: str | Path | VecNormalize | None = None,
    ) -> None:
        check_integer("episodes", episodes, 1)
        check_integer("sample_size", sample_size, 1)
        if max_steps is not None:
            check_integer("max_steps", max_steps, 1)
        check_agent_id(agent_id)
        maker = Maker(environment, {} if env_kwargs is None else env_kwargs, max_steps)
        self.fooling_threshold, self.sample_size = fooling_threshold, sample_size
        self._count, self._trust = episodes, trust
        self._normalisation = _statistics(statistics, trust=trust)
        with closing(maker.make({})) as env:
            self._explore(env, maker, parameters, as_score(score))
        if name is not None:
            if not isinstance(name, str) or not name:
                raise UserTypeError(f"Expected name to be a text or None, got {name!r}.")
            self.name = name  # type: ignore[misc]
        refuse_undeclared(self)
        if isinstance(agent, str | Path):
            file = Path(agent)
            agent, title = self._load(file), agent_id or file.stem
            super().__init__(agent, agent_id)
            self.agent_name = title
        else:
            super().__init__(agent, agent_id)
        self.game = Game(**{**vars(self.game), "agent": self.agent_name})
        self._clipped = self._scores = 0
        self._try_corners()

    def _explore(
        self, env: gym.Env[Any, Any], maker: Maker, parameters: Mapping[str, Any], score: Any
    ) -> None:
        """Learn from one environment what all have in common, and find the parameters' places."""
        self._metadata = dict(env.metadata)
        self.render_fps = int(self._metadata.get("render_fps") or 30)  # type: ignore[misc]
        self._wrapped_by = tuple(
            kind
            for kind in (gym.ObservationWrapper, gym.ActionWrapper)
            if any(isinstance(layer, kind) for layer in layers(env))
        )
        self.packages = _packages(env)
        self.name, self.version = _named(maker, env)  # type: ignore[misc]
        learning = [
            one for one in layers(env) if getattr(one, "update_running_mean", False) is True
        ]
        if learning:
            wrapper = type(learning[0]).__name__
            raise UserError(
                f"Expected wrappers in {maker.name} that learn nothing, got {wrapper}, whose "
                "statistics begin anew in each episode and are not those of the training. Let a "
                "function make the environment, and set the wrapper's statistics and "
                "update_running_mean = False there."
            )
        if not isinstance(env.action_space, _ACTIONS):
            raise UserError(
                "Expected Box, Discrete, MultiDiscrete or MultiBinary actions, got "
                f"{env.action_space} in {maker.name}. Wrap the environment in one that has them."
            )
        if maker.max_steps is None and not own_limit(env):
            raise UserError(
                f"Expected a limit of steps, because {maker.name} has none of its own and its "
                "episodes might never end. Pass max_steps=1000, say."
            )
        try:
            env.reset(seed=0)
        except Exception as error:  # whatever an environment may raise
            raise UserError(
                f"Expected {maker.name} to be reset, got {type(error).__name__}: {error}."
            ) from error
        if not isinstance(parameters, Mapping) or not parameters:
            raise UserTypeError(
                "Expected parameters as a dictionary, such as {'gravity': (5.0, 15.0)}, got "
                f"{parameters!r}."
            )
        places = {key: found_place(key, given, maker) for key, given in parameters.items()}
        self.parameters = ParameterSpace(*(place.parameter(key) for key, place in places.items()))
        for key, place in places.items():
            place.check(key, maker, env)
        refuse_doubles(places)
        self.game = Game(maker, places, env.observation_space, env.action_space, score, "the agent")

    def _load(self, path: Path) -> Any:
        """Load an SB3 zip."""
        if not path.is_file():
            raise FileError(f"Expected an SB3 zip as the agent, got {path}: no such file.")
        game, load_sb3 = self.game, load("sada_gym.agents.sb3_zip:load_sb3")
        return load_sb3(path, game.observation_space, game.action_space, trust=self._trust)

    def _as_agent(self, given: Any) -> Agent[GymnasiumEpisodes, npt.NDArray[Any]]:
        if isinstance(given, type):
            raise UserTypeError(
                f"Expected an agent, got the class {given.__name__}. Make one of it, such as "
                "PPO.load('agent.zip')."
            )
        if isinstance(given, Agent):
            return given
        if hasattr(given, "predict"):
            from sada_gym.agents.policy import Interface, Policy

            game = self.game
            seen = Interface(
                game.maker.name, game.observation_space, game.action_space, self._wrapped_by
            )
            return Policy(given, seen, normalisation=self._normalisation)
        if callable(given):
            return PlainAgent(given, self.agent_name)
        raise UserTypeError(
            "Expected an SB3 model, the path of an SB3 zip, an object with `predict`, or a "
            f"function of an observation as the agent, got {given!r}."
        )

    def _try_corners(self) -> None:
        """Begin an episode at either end of the ranges, so that bad ranges are found at once."""
        for corner in (-1.0, 1.0):
            mu = np.full((1, len(self.parameters)), corner, np.float32)
            self.episodes(mu, [0]).close()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the model that its policy holds as well, in a form that can be pickled."""
        shared = self.agent is getattr(self.policy, "model", None)
        return {**self.__dict__, "agent": None if shared else self.agent}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Take the model from its policy."""
        self.__dict__.update(state)
        self.agent = getattr(self.policy, "model", None) if self.agent is None else self.agent

    @property
    def settings(self) -> dict[str, Any]:
        """All that a score depends on besides the agent."""
        maker = self.game.maker
        return {
            "environment": maker.identity,
            "env_kwargs": plain(maker.env_kwargs),
            "parameters": {key: place.settings for key, place in self.game.places.items()},
            "order": [*self.game.places],
            "score": self.game.score.settings,
            "fooling_threshold": float(self.fooling_threshold),
            "episodes": self._count,
            "max_steps": maker.max_steps,
        }

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the agent, or None where a function of the user's has no `agent_id`."""
        own_code = (
            callable(self.game.maker.environment)
            or isinstance(self.game.score, Own)
            or any(place.own_code for place in self.game.places.values())
        )
        return None if own_code and not self._agent_id else super().fingerprint

    @property
    def without_fingerprint(self) -> str:
        """Says which function makes an `agent_id` necessary."""
        maker, score = self.game.maker, self.game.score
        functions = {
            **({"environment": maker.environment} if callable(maker.environment) else {}),
            **({"score": score.function} if isinstance(score, Own) else {}),
            **{
                f"parameter {key!r}": place.set
                for key, place in self.game.places.items()
                if isinstance(place, Function)
            },
        }
        if not functions or self._agent_id:
            return super().without_fingerprint
        named = [f"the {of} ({_function_name(given)})" for of, given in functions.items()]
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
        worlds = []
        for row, seed in zip(self.parameters.physical(mu).tolist(), seeds, strict=True):
            values = {
                key: place.value(number)
                for (key, place), number in zip(self.game.places.items(), row, strict=True)
            }
            worlds += [World(values, seed, number) for number in range(self._count)]
        return GymnasiumEpisodes(self.game, worlds, pictures=pictures)

    def _evaluate(self, mu: Mu, seeds: Sequence[int]) -> Scored:
        with closing(self.episodes(mu, seeds)) as episodes:
            self.play(episodes)
            score = episodes.score.reshape(len(mu), self._count).mean(axis=1)
            running = episodes.running
        extras = []
        for first in range(0, len(running), self._count):
            together = running[first : first + self._count]
            extras.append(
                {
                    "return": float(np.mean([sum(one.rewards) for one in together])),
                    "length": float(np.mean([len(one.rewards) for one in together])),
                    "clipped": any(one.clipped for one in together),
                    **self._whole(together[0].world.values),
                }
            )
        self._warn_of_clipping(extras)
        return Scored(score, extras)

    def _whole(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Give what choices and whole numbers were set, which `parameters` shows as a place."""
        places = self.game.places.items()
        chosen = {key: str(values[key]) for key, place in places if place.choices}
        whole = {key: values[key] for key, place in places if place.integer}
        return {"values": chosen | whole} if chosen or whole else {}

    def _warn_of_clipping(self, extras: Sequence[Mapping[str, Any]]) -> None:
        """Warn once where many returns lie outside the range of the score."""
        before = self._scores >= _MANY and self._clipped > _FEW_CLIPPED * self._scores
        self._scores += len(extras)
        self._clipped += sum(extra["clipped"] for extra in extras)
        if self._scores >= _MANY and self._clipped > _FEW_CLIPPED * self._scores and not before:
            warnings.warn(
                f"More than {_FEW_CLIPPED:.0%} of the evaluations of {self.game.maker.name} had a "
                f"return outside the range of score={self.game.score.settings}. Their scores were "
                "clipped, so that an adversary cannot tell them apart. Widen the range.",
                stacklevel=2,
            )

    @property
    def can_render(self) -> bool:
        """Whether the environment renders as `rgb_array`."""
        modes = self._metadata.get("render_modes") or ()
        return "rgb_array" in modes and self.game.maker.takes_render_mode

    def _drawn(self, mu: npt.ArrayLike, seed: int) -> GymnasiumEpisodes:
        row, seed = validate_world(self.parameters, mu, seed)
        if not self.can_render:
            raise NotImplementedError(
                f"{self.game.maker.name} draws no pictures: it has no render_mode='rgb_array'."
            )
        return self.episodes(row, [seed], pictures=True)

    @property
    def legend(self) -> tuple[LegendEntry, ...]:
        """Which frame of an episode is drawn."""
        of = "the episode" if self._count == 1 else f"the worst of {self._count} episodes"
        return (LegendEntry(f"The last frame of {of}, as {self.game.maker.name} draws it."),)

    def render(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the last frame of the episode, of several that with the lowest score."""
        with closing(self._drawn(mu, seed)) as episodes, _drawing():
            play(self.policy, episodes)
            return np.asarray(episodes.render(episodes.score.argsort(kind="stable")[:1])[0])

    def observation(self, mu: npt.ArrayLike, seed: int) -> Frame:
        """Draw the first frame of the first episode."""
        with closing(self._drawn(mu, seed)) as episodes, _drawing():
            return np.asarray(episodes.render(np.zeros(1, np.intp))[0])

    def rollouts(self, mu: npt.ArrayLike, seed: int) -> list[Rollout[Any]]:
        """Play all episodes in the world of one mu, (d,), and keep returns, and frames if any."""
        row, seed = validate_world(self.parameters, mu, seed)
        with closing(self.episodes(row, [seed], pictures=self.can_render)) as episodes, _drawing():
            return record(self.policy, episodes)

    def replay(self, mu: npt.ArrayLike, seed: int) -> tuple[list[Frame], float]:
        """Play the episodes again, one after another: all frames, and the score."""
        if not self.can_render:
            self._drawn(mu, seed)
        return super().replay(mu, seed)

    def _frames(self, rollouts: list[Rollout[Any]]) -> list[Frame]:
        return [frame for rollout in rollouts for frame in rollout["frame"]]


def _function_name(function: Any) -> str:
    return getattr(function, "__name__", type(function).__name__)


@contextmanager
def _drawing() -> Iterator[None]:
    """Let a missing drawing library mean that there are no pictures."""
    try:
        yield
    except DependencyNotInstalled as error:
        raise NotImplementedError(f"The environment cannot be drawn: {error}") from error


def _packages(env: gym.Env[Any, Any]) -> tuple[str, ...]:
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


def _named(maker: Maker, env: gym.Env[Any, Any]) -> tuple[str, int]:
    """Give the name and version of the environment's id, or its class's name and 0."""
    if not isinstance(maker.environment, str):
        return type(env.unwrapped).__name__, 0
    match = _ID.fullmatch(maker.name)
    return (maker.name, 0) if match is None else (match[1], int(match[2]))


def _statistics(given: Any, *, trust: bool) -> VecNormalize | None:
    """Load the statistics of a `VecNormalize`."""
    if given is None:
        return None
    from stable_baselines3.common.vec_env import VecNormalize

    if isinstance(given, VecNormalize):
        return given
    if not isinstance(given, str | Path):
        raise UserTypeError(
            f"Expected statistics to be a VecNormalize or the path of its file, got {given!r}."
        )
    if not trust:
        raise UserError(
            f"Expected trust=True with statistics={str(given)!r}: the file is a pickle, which can "
            "run code when it is loaded. Pass trust=True if it is your own."
        )
    try:
        with Path(given).open("rb") as file:
            found = pickle.load(file)
    except Exception as error:  # whatever an unpickled file may raise
        raise FileError(
            f"Expected the file of a VecNormalize in {given}, got {type(error).__name__}: {error}."
        ) from error
    if not isinstance(found, VecNormalize):
        raise FileError(
            f"Expected the file of a VecNormalize in {given}, got a {type(found).__name__}. Write "
            "it by VecNormalize.save."
        )
    # what its file leaves out, without which it could not be sent to worker processes
    vars(found).update(venv=None, class_attributes={}, returns=None)
    return found

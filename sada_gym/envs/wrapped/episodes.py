"""Episodes of any Gymnasium environment in lockstep, each in an environment of its own."""

from __future__ import annotations

import operator
import os
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch, as_batch
from sada_gym.environment_variables import environment_variables
from sada_gym.envs.episodes.base import Array, Episodes, Indices, Pictures
from sada_gym.envs.wrapped.maker import Maker
from sada_gym.envs.wrapped.places import Place, Setup
from sada_gym.envs.wrapped.scores import Episode, Score
from sada_gym.errors import UserError, UserTypeError


@dataclass(frozen=True)
class World:
    """One episode's world.

    Attributes:
        values: What each place sets, by the parameter's name.
        seed: The evaluation's seed.
        number: The episode's number within the evaluation.
    """

    values: Mapping[str, Any]
    seed: int
    number: int


@dataclass(frozen=True)
class Game:
    """What all episodes of an application share.

    Attributes:
        maker: Makes the environments.
        places: Where each parameter's value goes.
        observation_space: The space of the observations.
        action_space: The space of the actions.
        score: Scores an episode.
        agent: The agent's name, for messages.
    """

    maker: Maker
    places: Mapping[str, Place]
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    score: Score
    agent: str


class GymnasiumEpisodes(Episodes[World]):
    """Episodes of one Gymnasium environment that go on in lockstep.

    Args:
        game: What they share.
        worlds: How each episode begins.
        pictures: Whether the environments render.
    """

    def __init__(self, game: Game, worlds: Sequence[World], *, pictures: bool = False) -> None:
        super().__init__(worlds)
        self.game = game
        self.task_id = game.maker.name
        self.observation_space = game.observation_space
        self.action_space = game.action_space
        self._pictures = pictures
        self.running: list[Running] = []
        try:
            for world in worlds:
                self.running.append(Running(game, world, pictures=pictures))
        except BaseException:
            self.close()
            raise

    def begin(self, i: int, start: World) -> None:
        """Begin another episode in place i."""
        self.running[i].env.close()
        self.running[i] = Running(self.game, start, pictures=self._pictures)
        self.starts[i], self.steps[i] = start, 0

    def under_way(self) -> Indices:
        """Give the episodes that have not ended."""
        return np.flatnonzero([not running.ended for running in self.running])

    @property
    def score(self) -> Array:
        """The score Q of each episode that has ended, NaN of the others, (n,)."""
        return np.array([running.score for running in self.running])

    def seen(self, i: int) -> Any:
        """Give what the agent sees in episode i, in the form that the environment gave it."""
        return self.running[i].seen

    def observe(self, which: Indices) -> Batch:
        """Give the observations of some episodes, each key (len(which), ...)."""
        return as_batch([self.running[i].seen for i in which], self.observation_space)

    def render(self, which: Indices) -> Pictures:
        """Draw frames of some episodes, (len(which), rows, columns, 3)."""
        return np.stack([self.running[i].render() for i in which])

    def step(self, which: Indices, actions: Sequence[Any] | npt.NDArray[Any]) -> None:
        """Take one action of the agent in each of some episodes."""
        for i, action in zip(which.tolist(), actions, strict=True):
            where = f"{self.where(i)} of an episode of {self.task_id}"
            checked = checked_action(action, self.action_space, self.game.agent, where)
            self.running[i].step(checked)
            self.steps[i] += 1

    def snapshot(self) -> Batch:
        """Give the return so far, and a frame where the environments render."""
        found: Batch = {"return": np.array([sum(running.rewards) for running in self.running])}
        if self._pictures:
            found["frame"] = self.render(np.arange(len(self)))
        return found

    def close(self) -> None:
        """Close the environments; doing it again is fine."""
        for running in self.running:
            running.close()


class Running:
    """One episode under way.

    Attributes:
        world: How it began.
        env: Its environment.
        seen: What the agent sees.
        rewards: The rewards so far.
        ended: Whether it has ended.
        score: Its score, NaN as long as it goes on.
        clipped: Whether the score was clipped.
    """

    def __init__(self, game: Game, world: World, *, pictures: bool) -> None:
        self._game, self.world = game, world
        names = [*game.places]
        setup = Setup(
            game.maker,
            game.observation_space,
            game.action_space,
            lambda name: _generator(world, 1 + names.index(name)),
        )
        for name, place in game.places.items():
            place.prepare(name, world.values[name], setup)
        self._sensors = [act for _, act in sorted(setup.sensors, key=operator.itemgetter(0))]
        self._actuators = [act for _, act in sorted(setup.actuators, key=operator.itemgetter(0))]
        self._repeats = setup.repeats
        self.rewards: list[float] = []
        self.ended, self.clipped, self.score = False, False, np.nan
        self._observations: list[Any] = []
        self._actions: list[Any] = []
        self._infos: list[Mapping[str, Any]] = []
        self.env = game.maker.make(setup.keywords, "rgb_array" if pictures else None)
        self._closed = False
        self._frame_shape: tuple[int, ...] = ()
        try:
            for act in setup.before:
                act(self.env.unwrapped)
            observation, info = self._reset(setup.options)
            for act in setup.after:
                act(self.env.unwrapped)
            self._check_spaces()
            self._receive(observation, info)
        except BaseException:
            self.close()
            raise

    def step(self, action: Any) -> None:
        """Let one action of the agent act."""
        for _ in range(self._repeats):
            acted = action
            for actuator in self._actuators:
                acted = actuator(acted)
            acted = into_space(acted, self._game.action_space)
            try:
                observation, reward, terminated, truncated, info = self.env.step(acted)
            except Exception as error:  # whatever an environment may raise
                raise self._fault("a step", error) from error
            self._reward(reward)
            if self._game.score.keeps_all:
                self._actions.append(deepcopy(acted))
            self._receive(observation, info)
            most = self._game.maker.max_steps
            truncated = bool(truncated) or (most is not None and len(self.rewards) >= most)
            if terminated or truncated:
                self._end(bool(terminated), truncated)
                return

    def render(self) -> Pictures:
        """Draw a frame.

        Raises:
            NotImplementedError: If the environment draws none.
            UserError: If its drawing fails, or its frames differ in size.
        """
        name = self._game.maker.name
        # SDL draws without a screen, and does not complain that there is none
        headless = {} if "SDL_VIDEODRIVER" in os.environ else {"SDL_VIDEODRIVER": "dummy"}
        try:
            with environment_variables(headless):
                frame: Any = self.env.render()
        except Exception as error:  # whatever an environment may raise
            raise UserError(
                f"Expected {name} to draw a frame, got {type(error).__name__}: {error}. Mend its "
                "render."
            ) from error
        if not isinstance(frame, np.ndarray) or frame.ndim != 3 or frame.shape[2] != 3:
            raise NotImplementedError(
                f"Expected frames of shape (height, width, 3) from {name}, got "
                f"{type(frame).__name__} of shape {np.shape(frame)}."
            )
        self._frame_shape = self._frame_shape or frame.shape
        if frame.shape != self._frame_shape:
            raise UserError(
                f"Expected frames of one size from {name}, got {frame.shape} after "
                f"{self._frame_shape}. Mend its render."
            )
        return np.array(frame, np.uint8)

    def close(self) -> None:
        """Close the environment."""
        if not self._closed:
            self._closed = True
            self.env.close()

    def _reset(self, options: Mapping[str, Any]) -> tuple[Any, Any]:
        seed = np.random.SeedSequence(self.world.seed, spawn_key=(self.world.number, 0))
        first = int(seed.generate_state(1, np.uint32)[0]) >> 1
        try:
            observation, info = self.env.reset(seed=first, options=dict(options) or None)
        except Exception as error:  # whatever an environment may raise
            raise self._fault("its reset", error) from error
        return observation, info

    def _receive(self, observation: Any, info: Mapping[str, Any]) -> None:
        """Pass what the environment gave through the sensors."""
        if self._game.score.keeps_all:
            self._observations.append(deepcopy(observation))
            self._infos.append(deepcopy(info))
        else:
            self._infos = [info]
        seen = deepcopy(observation)
        for sensor in self._sensors:
            seen = sensor(seen)
        self.seen = seen

    def _reward(self, reward: Any) -> None:
        try:
            value = float(reward)
        except (TypeError, ValueError):
            value = np.nan
        if not np.isfinite(value):
            raise UserError(
                f"Expected rewards that are finite numbers from {self._game.maker.name}, got "
                f"{reward!r} at step {len(self.rewards)} with {dict(self.world.values)}. Narrow "
                "the ranges to worlds that the simulator can compute."
            )
        self.rewards.append(value)

    def _end(self, terminated: bool, truncated: bool) -> None:
        self.ended = True
        episode = Episode(
            np.array(self.rewards),
            tuple(self._observations),
            tuple(self._actions),
            tuple(self._infos),
            terminated,
            truncated,
        )
        self.score, self.clipped = self._game.score(episode)

    def _check_spaces(self) -> None:
        """Refuse a world in which the agent would see or do something else altogether."""
        for name in ("observation_space", "action_space"):
            here, usual = getattr(self.env, name), getattr(self._game, name)
            if type(here) is not type(usual) or shapes(here) != shapes(usual):
                raise UserError(
                    f"Expected the same {name.replace('_', ' ')} in all worlds, {usual}, got "
                    f"{here} with {dict(self.world.values)}. Leave out the parameter that "
                    "changes it."
                )

    def _fault(self, what: str, error: Exception) -> UserError:
        if isinstance(error, UserError):
            return error
        return UserError(
            f"Expected {self._game.maker.name} to make {what} with {dict(self.world.values)}, got "
            f"{type(error).__name__}: {error}. Narrow the ranges to worlds that it takes."
        )


def checked_action(action: Any, space: spaces.Space[Any], agent: str, where: str) -> Any:
    """Give an agent's action in the form that its space has: of its type, within its bounds.

    Box actions outside the bounds are clipped; other actions must be in the space.

    Args:
        action: The action.
        space: Its space.
        agent: What messages call the agent.
        where: What messages call the place in the episode.

    Raises:
        UserError: If it is of another shape, not finite, or no member of the space.
    """
    if isinstance(space, spaces.Discrete):
        try:
            number = operator.index(action)
        except TypeError:
            found = np.asarray(action)
            if found.shape or found.dtype.kind not in "fb" or found != np.floor(found):
                raise UserTypeError(
                    f"Expected a whole number as the action of {agent}, got {action!r} at {where}. "
                    "Return an int."
                ) from None
            number = int(found)
        if not space.start <= number < space.start + space.n:
            raise UserError(
                f"Expected an action of {agent} from {space.start} to {space.start + space.n - 1}, "
                f"got {number} at {where}."
            )
        return space.dtype.type(number)
    try:
        values = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        values = np.full((), np.nan)
        if np.shape(action) == space.shape:
            raise UserTypeError(
                f"Expected numbers as the action of {agent}, got {action!r} at {where}."
            ) from None
    if values.shape != space.shape:
        raise UserError(
            f"Expected an action of shape {space.shape} from {agent}, got shape {values.shape} at "
            f"{where}."
        )
    if not np.isfinite(values).all():
        raise UserError(
            f"Expected finite actions from {agent}, got {values.tolist()} at {where}. Look for NaN "
            "or infinity in the agent."
        )
    if isinstance(space, spaces.Box):
        return into_space(values, space)
    whole = values.astype(space.dtype)
    if (whole != values).any() or not space.contains(whole):
        raise UserError(
            f"Expected an action in {space} from {agent}, got {values.tolist()} at {where}."
        )
    return whole


def into_space(action: Any, space: spaces.Space[Any]) -> Any:
    """Clip a Box action into its space and give it the space's type; give others as they are."""
    if isinstance(space, spaces.Box):
        return np.clip(action, space.low, space.high).astype(space.dtype)
    return action


def shapes(space: spaces.Space[Any]) -> Any:
    """Reduce a space to what must not differ from one world to another."""
    if isinstance(space, spaces.Dict):
        return {key: shapes(one) for key, one in space.items()}
    if isinstance(space, spaces.Box):
        return (space.shape, space.dtype)
    return space


def _generator(world: World, stream: int) -> np.random.Generator:
    """Give a generator of one episode; stream 0 is the environment's own seed."""
    return np.random.default_rng(
        np.random.SeedSequence(world.seed, spawn_key=(world.number, stream))
    )

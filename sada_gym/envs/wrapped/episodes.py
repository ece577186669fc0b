"""Episodes of any Gymnasium environment in lockstep, each in an environment of its own."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym.agents.tile import Batch, as_batch
from sada_gym.application import OnError
from sada_gym.envs.checks import has_nan
from sada_gym.envs.episodes.base import Episodes
from sada_gym.envs.wrapped.actions import clip_action, validate_action
from sada_gym.envs.wrapped.bindings import Keyword, ParameterBinding, ResetOption
from sada_gym.envs.wrapped.derived import Derived, update_mujoco
from sada_gym.envs.wrapped.disturbances import Disturbance, EpisodeWrapper
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.kept import KeptEnvironments
from sada_gym.envs.wrapped.profiles import Profile, now
from sada_gym.envs.wrapped.scores import Episode, Score
from sada_gym.envs.wrapped.validity import check_valid
from sada_gym.errors import (
    InvalidWorld,
    UserError,
    UserTypeError,
    WorkerError,
    broken_world,
    explained,
)
from sada_gym.evaluation import watch
from sada_gym.foundations.arrays import Bytes, Floats, Indices, copied
from sada_gym.foundations.environment_variables import environment_variables
from sada_gym.foundations.files import shown
from sada_gym.foundations.frames import as_frame
from sada_gym.foundations.serve_environment import resident_bytes

ResultT = TypeVar("ResultT")

MEMORY_BYTES = 2**28
"""The memory that the environments of worlds played at once may take."""

MOST_STEPS = 100_000
"""Steps after which a world breaks, where its environment is said to end its episodes by itself."""

_NO_FRAME = (240, 320, 3)

_AGENT_STREAM = 2**31
"""Far from the streams of parameters."""

_GOLDEN = np.uint64(0x9E3779B1)
"""2**32 over the golden ratio, an odd number: the seeds of 2**32 steps differ."""


@dataclass(frozen=True)
class EpisodeStart:
    """How one episode begins: what bindings set, the evaluation's seed, and its number in it.

    `world` is the key of its world, see `sada_gym.evaluation.watch`.
    """

    values: Mapping[str, Any]
    seed: int
    number: int
    world: int = 0

    def value(self, name: str) -> Any:
        """Return a copy of what a parameter sets: an environment may write into its own."""
        return deepcopy(self.values[name])

    def seed_sequence(self, stream: int) -> np.random.SeedSequence:
        """Return a source of randomness; stream 0 seeds the environment, others the parameters."""
        return np.random.SeedSequence(self.seed, spawn_key=(self.number, stream))

    @cached_property
    def agent_seed(self) -> int:
        """What an agent's random choices follow from, below 2**32."""
        return int(self.seed_sequence(_AGENT_STREAM).generate_state(1, np.uint32)[0])


@dataclass(frozen=True)
class EpisodeSpec:
    """What all episodes of an application share; `agent` is its name, for messages.

    `nan_observed` says that the environment's observations hold NaN as it is, without an error.
    Environments come from `kept` where there is one, and episodes go on in at most so many `lanes`.
    The others are arguments of `GymnasiumApplication`.
    """

    factory: EnvFactory
    bindings: Mapping[str, ParameterBinding]
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    score: Score
    agent: str
    on_error: OnError = "invalid"
    valid: Callable[[Any], bool | str] | None = None
    timeout: float | None = None
    nan_observed: bool = False
    derived: Derived = field(default_factory=Derived)
    kept: KeptEnvironments | None = None
    lanes: int | None = None


class GymnasiumEpisodes(Episodes[EpisodeStart]):
    """Episodes of one Gymnasium environment that go on in lockstep; `pictures` lets them render.

    With `together`, the number of episodes of one world, only the first worlds begin whose
    environments fit the memory of `MEMORY_BYTES`, at least one.
    """

    def __init__(
        self,
        spec: EpisodeSpec,
        starts: Sequence[EpisodeStart],
        *,
        pictures: bool = False,
        together: int = 0,
    ) -> None:
        self.spec = spec
        self.task_id = spec.factory.name
        self.observation_space = spec.observation_space
        self.action_space = spec.action_space
        self._pictures = pictures
        self.running: list[RunningEpisode] = []
        try:
            measure = getattr(spec.factory.environment, "memory", resident_bytes)
            before = measure() if together else 0
            for i, start in enumerate(starts):
                full = together and i and i % together == 0
                if full and (measure() - before) * (1 + together / i) > MEMORY_BYTES:
                    break  # the next world would not fit
                self.running.append(RunningEpisode(spec, start, pictures=pictures))
        except BaseException:
            self.close()
            raise
        super().__init__(starts[: len(self.running)])

    def begin(self, i: int, start: EpisodeStart) -> None:
        """Begin another episode in place i."""
        self.running[i].close()
        self.running[i] = RunningEpisode(self.spec, start, pictures=self._pictures)
        self.starts[i], self.steps[i] = start, 0

    def under_way(self) -> Indices:
        """Return the episodes that have not ended."""
        return np.flatnonzero([not episode.ended for episode in self.running])

    @property
    def score(self) -> Floats:
        """The score Q of each episode that has ended in a valid world, NaN of the others, (n,)."""
        return np.array([episode.score for episode in self.running])

    def observation(self, i: int) -> Any:
        """Return what the agent sees in episode i, in the form that the environment gave it."""
        return self.running[i].observation

    def environment(self, i: int) -> gym.Env[Any, Any]:
        """Return the environment of episode i without its disturbances, for an agent inside."""
        return self.running[i].environment

    def observe(self, which: Indices) -> Batch:
        """Return the observations of some episodes, each key (len(which), ...)."""
        return as_batch([self.observation(i) for i in which], self.observation_space)

    def action_masks(self, which: Indices) -> npt.NDArray[np.bool_]:
        """Return which actions are valid in some episodes, as their `action_masks()` say."""
        return np.stack([self.running[i].action_mask() for i in which])

    def agent_seed(self, i: int) -> int:
        """Return what all random choices of the agent in episode i follow from, below 2**32."""
        return self.starts[i].agent_seed

    def agent_seeds(self, which: Indices) -> npt.NDArray[np.uint32]:
        """Return what the agent's random choices at this step follow from, (len(which),)."""
        episodes = np.array([self.starts[i].agent_seed for i in which], np.uint64)
        return (episodes + self.steps[which].astype(np.uint64) * _GOLDEN).astype(np.uint32)

    def render(self, which: Indices) -> Bytes:
        """Draw frames of some episodes, (len(which), rows, columns, 3)."""
        frames = [self.running[i].render() for i in which]
        shape = next((frame.shape for frame in frames if frame is not None), _NO_FRAME)
        return np.stack([np.zeros(shape, np.uint8) if f is None else f for f in frames])

    def step(self, which: Indices, actions: Sequence[Any] | npt.NDArray[Any]) -> None:
        """Take one action of the agent in each of some episodes."""
        for i, action in zip(which.tolist(), actions, strict=True):
            where = f"{self.where(i)} of an episode of {self.task_id}"
            valid = validate_action(action, self.action_space, self.spec.agent, where)
            self.running[i].step(valid)
            self.steps[i] += 1

    def snapshot(self) -> Batch:
        """Return the return so far, and a frame where the environments render."""
        snapshot: Batch = {"return": np.array([sum(episode.rewards) for episode in self.running])}
        if self._pictures:
            snapshot["frame"] = self.render(np.arange(len(self)))
        return snapshot

    def close(self) -> None:
        """Close the environments; doing it again is fine."""
        for episode in self.running:
            episode.close()


def in_groups(
    spec: EpisodeSpec,
    starts: Sequence[EpisodeStart],
    act: Callable[[GymnasiumEpisodes], Sequence[ResultT]],
    **options: Any,
) -> list[ResultT]:
    """Begin episodes, no more than `lanes` at once; `act` with each group, and join its results.

    One group is closed before the next begins. The options are those of `GymnasiumEpisodes`.
    """
    most = spec.lanes or max(len(starts), 1)
    results: list[ResultT] = []
    for first in range(0, len(starts), most):
        with closing(GymnasiumEpisodes(spec, starts[first : first + most], **options)) as episodes:
            results += act(episodes)
    return results


class RunningEpisode:
    """One episode under way, in an environment of its own under its disturbances.

    Its `observation` is what the agent sees; `score` is NaN as long as it goes on. It ends where
    its world breaks; `broken` then says why. `terminated`, `truncated` and `info` are what the
    environment said at the last step, and `spent` are the seconds of its parts. `margins` are those
    of several requirements.
    """

    def __init__(self, spec: EpisodeSpec, start: EpisodeStart, *, pictures: bool) -> None:
        self.spent = {"constructor": 0.0, "reset": 0.0, "steps": 0.0}
        self._spec, self.start = spec, start
        self.ended, self.clipped, self.score, self.broken = False, False, np.nan, ""
        self.margins: dict[str, float] = {}
        self.terminated, self.truncated = False, False
        self.info: Mapping[str, Any] = {}
        self.observation: Any = None
        self.rewards: list[float] = []
        self._frame_shape: tuple[int, ...] = ()
        self._seconds = 0.0
        self._render_mode = "rgb_array" if pictures else None
        self.env: gym.Env[Any, Any] | None = None
        try:
            self._timed(self._begin, self._render_mode)
        except InvalidWorld as error:
            self._end_broken(error)
        except BaseException:
            self.close()
            raise

    def _begin(self, render_mode: str | None) -> None:
        began = time.perf_counter()
        self.env, self._recorder = make_world(self._spec, self.start, render_mode)
        self.rewards = self._recorder.rewards
        made = time.perf_counter()
        self.observation, _ = self.env.reset(**reset_arguments(self._spec, self.start))
        self.spent |= {"constructor": made - began, "reset": time.perf_counter() - made}

    def step(self, action: Any) -> None:
        """Let one action of the agent act."""
        try:
            self._timed(self._step, action)
        except InvalidWorld as error:
            self._end_broken(error)

    def _step(self, action: Any) -> None:
        assert self.env is not None
        began = time.perf_counter()
        self.observation, _, terminated, truncated, info = self.env.step(action)
        self.spent["steps"] += time.perf_counter() - began
        if terminated or truncated:
            self.ended, self.info = True, info
            self.terminated, self.truncated = bool(terminated), bool(truncated)
            check_valid(self.env.unwrapped, self._spec.valid, self._spec.factory.name)
            episode = self._recorder.episode(terminated=self.terminated, truncated=self.truncated)
            self.score, self.clipped, self.margins = self._spec.score.judge(episode)

    @property
    def environment(self) -> gym.Env[Any, Any]:
        """The environment without disturbances, as its constructor made it."""
        return self._recorder.env

    def action_mask(self) -> npt.NDArray[np.bool_]:
        """Return which actions are valid now, (k,)."""
        assert self.env is not None
        name = self._spec.factory.name
        with explained(f"Expected valid actions from action_masks() of {name}", "Fix it."):
            mask = np.asarray(self.env.get_wrapper_attr("action_masks")(), np.bool_).ravel()
        if not mask.any():
            raise UserError(f"Expected a valid action in {name}, got action_masks() with none.")
        return mask

    def _timed(self, act: Callable[[Any], None], argument: Any) -> None:
        """Call one of the environment's methods; say in which world a worker is meanwhile."""
        timeout = self._spec.timeout
        begun = 0.0 if timeout is None else time.monotonic()
        watch.begin(self.start.world)
        try:
            act(argument)
        finally:
            watch.end()
        if timeout is not None:
            self._seconds += time.monotonic() - begun
            if self._seconds > timeout:
                reason = f"it took longer than {timeout:g} s"
                raise InvalidWorld(
                    f"Expected an episode of {self._spec.factory.name} within timeout={timeout:g} "
                    f"seconds, but with {dict(self.start.values)} {reason}. Raise timeout, or "
                    "narrow the ranges.",
                    reason,
                )

    def _end_broken(self, error: InvalidWorld) -> None:
        self.ended, self.score, self.broken = True, np.nan, error.reason
        self.close()
        if self._spec.on_error == "raise":
            raise error

    def render(self) -> Bytes | None:
        """Draw a frame: black where the world broke, None where it broke before the first one.

        Raises:
            UserError: If its drawing fails, or its frames are none, or differ in size.
        """
        name = self._spec.factory.name
        if self.broken or self.env is None:
            return np.zeros(self._frame_shape, np.uint8) if self._frame_shape else None
        # SDL draws without a screen, and does not complain that there is none
        headless = {} if "SDL_VIDEODRIVER" in os.environ else {"SDL_VIDEODRIVER": "dummy"}
        with (
            environment_variables(headless),
            explained(f"Expected {name} to draw a frame", "Fix its render."),
        ):
            frame: Any = self.env.render()
        frame = as_frame(frame, f"render of {name}")
        self._frame_shape = self._frame_shape or frame.shape
        if frame.shape != self._frame_shape:
            raise UserError(
                f"Expected frames of one size from {name}, got {frame.shape} after "
                f"{self._frame_shape}. Fix its render."
            )
        return np.array(frame)

    def close(self) -> None:
        """Close the environment, or give it back."""
        env, self.env = self.env, None
        if env is not None and self._spec.kept is not None and not self.broken:
            layer: Any = env
            try:
                while layer is not self._recorder:
                    if isinstance(layer, EpisodeWrapper):
                        layer.leave()
                    layer = layer.env
            except InvalidWorld:  # it is not as it was, so that no other episode may have it
                env.close()
            else:
                self._spec.kept.give_back(self._recorder.env, self._render_mode)
        elif env is not None:
            with suppress(Exception) if self.broken else nullcontext():
                env.close()


class _Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """Sets an episode's parameters around its reset, and records what its environment gave and got.

    Disturbances stand around it, so that they are in no record. It shows them the spaces that all
    episodes share, whatever bounds this one's environment has.
    """

    def __init__(self, env: gym.Env[Any, Any], spec: EpisodeSpec, start: EpisodeStart) -> None:
        super().__init__(env)
        self.observation_space, self.action_space = spec.observation_space, spec.action_space
        self._spec, self._start = spec, start
        self._world = f"with {dict(start.values)}"
        self._most_steps = MOST_STEPS if spec.factory.max_steps == "own" else np.inf
        self.rewards: list[float] = []
        self.events: list[Any] = []
        self._observations: list[Any] = []
        self._actions: list[Any] = []
        self._infos: list[Mapping[str, Any]] = []
        self._probes = {id(probe): probe for probe in spec.score.probes}
        self._probed: dict[int, list[Any]] = {name: [] for name in self._probes}
        self._changing = {
            name: binding
            for name, binding in spec.bindings.items()
            if isinstance(start.values[name], Profile) and not isinstance(binding, Disturbance)
        }
        self._first: dict[str, Any] = {}

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:
        self.rewards.clear()
        self._apply_bindings(after_reset=False)
        try:
            observation, info = self.env.reset(**kwargs)
        except (UserError, WorkerError):
            raise
        except (Exception, SystemExit) as error:  # whatever an environment may raise
            raise self._broken("its reset", error) from error
        self._apply_bindings(after_reset=True)
        self._check_spaces()
        return self._recorded(observation, info), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        action = clip_action(action, self.action_space)
        if self._changing and self.rewards:  # the first values are there since the reset
            self._change()
            self._derive(self._changing, after_reset=True)
        try:
            observation, reward, terminated, truncated, info = self.env.step(action)
        except (UserError, WorkerError):
            raise
        except (Exception, SystemExit) as error:  # whatever an environment may raise
            raise self._broken("a step", error) from error
        self.rewards.append(self._validate_reward(reward))
        if len(self.rewards) >= self._most_steps and not (terminated or truncated):
            reason = f"it did not end within {MOST_STEPS:,} steps"
            raise InvalidWorld(
                f"Expected {self._spec.factory.name} to end its episodes by itself, as "
                f"max_steps='own' says, but {self._world} {reason}. Pass max_steps=1000, say.",
                reason,
            )
        if self._spec.score.keeps_all:
            self._actions.append(deepcopy(action))
        return self._recorded(observation, info), self.rewards[-1], terminated, truncated, info

    def _apply_bindings(self, *, after_reset: bool) -> None:
        for name, binding in self._spec.bindings.items():
            if not (after_reset and name in self._changing):
                value = now(self._start.value(name), 0)
                binding.set_value(name, value, self.unwrapped, after_reset=after_reset)
        if after_reset and self._changing:
            self._first = {}
            self._change()
        self._derive(self._spec.bindings, after_reset=after_reset)

    def _change(self) -> None:
        """Set the values of this step that change during the episode."""
        for name, binding in self._changing.items():
            value = self._start.values[name](len(self.rewards))
            binding.set_during(name, value, self.unwrapped, self._first)

    def _derive(self, bindings: Mapping[str, ParameterBinding], *, after_reset: bool) -> None:
        derived, step = self._spec.derived, len(self.rewards)
        values = {name: now(value, step) for name, value in self._start.values.items()}
        derived.apply(self.unwrapped, values, after_reset=after_reset)
        targets = [t for name, binding in bindings.items() for t in binding.targets(name)]
        if any(str(t).startswith("model.") for t in (*targets, *derived.formulas)):
            update_mujoco(self.unwrapped)

    def _broken(self, what: str, error: BaseException) -> InvalidWorld:
        expected = f"Expected {self._spec.factory.name} to make {what} {self._world}"
        return broken_world(what, error, expected)

    def episode(self, *, terminated: bool, truncated: bool) -> Episode:
        return Episode(
            np.array(self.rewards),
            tuple(self._observations),
            tuple(self._actions),
            tuple(self._infos),
            terminated,
            truncated,
            self._probed,
        )

    def _recorded(self, observation: Any, info: Mapping[str, Any]) -> Any:
        """Record an observation and its info. Return a copy: environments may change theirs."""
        if has_nan(observation) and not self._spec.nan_observed:
            raise InvalidWorld(
                f"Expected observations without NaN from {self._spec.factory.name}, got "
                f"{shown(str(observation))} at step {len(self.rewards)} {self._world}. Narrow the "
                "ranges to worlds that the simulator can compute.",
                "an observation holds NaN",
            )
        if self._spec.score.keeps_all:
            self._observations.append(deepcopy(observation))
            self._infos.append(deepcopy(info))
            for name, probe in self._probes.items():
                with explained("Expected a signal of the environment", "Fix the function."):
                    self._probed[name].append(deepcopy(probe(env=self.unwrapped)))
        elif self._spec.score.keeps_infos:
            self._infos.append(deepcopy(info))
        else:
            self._infos = [info]
        return copied(observation)

    def _validate_reward(self, reward: Any) -> float:
        entry = self._spec.score.entry
        if entry is not None:
            if np.ndim(reward) != 1 or entry >= len(reward):
                raise UserError(
                    f"Expected rewards with an entry {entry} from {self._spec.factory.name}, as "
                    f"score= says, got {shown(str(reward))}. Name another entry, or none."
                )
            reward = reward[entry]
        if np.size(reward) != 1 or isinstance(reward, str | Mapping):
            raise UserTypeError(
                f"Expected one number as a reward from {self._spec.factory.name}, got "
                f"{shown(str(reward))}. Choose an entry by score=('return', low, high, ENTRY), or "
                "a weighted sum by a wrapper: let a function make the environment, "
                "TransformReward(env, lambda reward: reward @ weights)."
            )
        try:
            value = float(reward)
        except (TypeError, ValueError):
            value = np.nan
        if not np.isfinite(value):
            raise InvalidWorld(
                f"Expected rewards that are finite numbers from {self._spec.factory.name}, got "
                f"{reward!r} at step {len(self.rewards)} {self._world}. Narrow the ranges to "
                "worlds that the simulator can compute.",
                f"a reward is {reward!r}",
            )
        return value

    def _check_spaces(self) -> None:
        for name in ("observation_space", "action_space"):
            own, shared = getattr(self.env, name), getattr(self._spec, name)
            if type(own) is not type(shared) or _shapes(own) != _shapes(shared):
                raise UserError(
                    f"Expected the same {name.replace('_', ' ')} in all worlds, {shared}, got "
                    f"{own} {self._world}. Leave out the parameter that changes it."
                )


def reset_arguments(
    spec: EpisodeSpec, start: EpisodeStart, options: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return what the reset of an episode's environment takes; `options` are a user's own."""
    seed = int(start.seed_sequence(0).generate_state(1, np.uint32)[0]) >> 1
    own = _set_by(ResetOption, spec, start)
    return {"seed": seed, "options": {**(options or {}), **own} if own else options}


def make_world(
    spec: EpisodeSpec, start: EpisodeStart, render_mode: str | None
) -> tuple[gym.Env[Any, Any], _Recorder]:
    """Make the environment of an episode, which `reset_arguments` begin; no agent is in it.

    Its reset and its steps raise `InvalidWorld` where the world breaks. Its recorder comes, too.
    """
    if spec.kept is not None:
        env = spec.kept.take(render_mode)
    else:
        env = spec.factory.make(_set_by(Keyword, spec, start), render_mode)
    recorder = _Recorder(env, spec, start)
    try:
        return _disturbed(recorder, spec, start), recorder
    except BaseException:
        env.close()
        raise


def _set_by(kind: type[ParameterBinding], spec: EpisodeSpec, start: EpisodeStart) -> dict[str, Any]:
    bindings = [(name, b) for name, b in spec.bindings.items() if isinstance(b, kind)]
    return {b.targets(name)[0]: start.value(name) for name, b in bindings}


def _disturbed(env: gym.Env[Any, Any], spec: EpisodeSpec, start: EpisodeStart) -> gym.Env[Any, Any]:
    """Wrap an environment in the disturbances of one episode, each with a generator of its own."""
    disturbances = [
        (binding, start.value(name), 1 + i)
        for i, (name, binding) in enumerate(spec.bindings.items())
        if isinstance(binding, Disturbance)
    ]
    for disturbance, value, stream in sorted(disturbances, key=lambda entry: entry[0].layer):
        env = disturbance.wrap(env, value, np.random.default_rng(start.seed_sequence(stream)))
    return env


def _shapes(space: spaces.Space[Any]) -> Any:
    """Reduce a space to what must not differ from one world to another."""
    if isinstance(space, spaces.Dict):
        return {key: _shapes(part) for key, part in space.items()}
    if isinstance(space, spaces.Box):
        return (space.shape, space.dtype)
    return space

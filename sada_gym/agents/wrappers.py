"""SB3's wrappers of observations, applied to agents that act outside of an SB3 environment.

A model that holds its environment shows by its wrappers, from the inside out, what was done to
observations in training. A model without one shows less: its space shows how many frames are
stacked, and that images were normalised, but not by which statistics.
"""

from __future__ import annotations

import os
import pickle
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import VectorActionWrapper, VectorObservationWrapper, VectorWrapper
from stable_baselines3.common.vec_env import (
    VecCheckNan,
    VecEnv,
    VecEnvWrapper,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
    VecVideoRecorder,
)
from stable_baselines3.common.vec_env.stacked_observations import StackedObservations

from sada_gym.agents.tile import ALONE, Batch, keyed
from sada_gym.errors import FileError, UserError, UserTypeError, explained
from sada_gym.foundations.sb3_vec_env import SB3VecEnv

CHANGING_WRAPPERS: tuple[type[Any], ...] = (gym.ObservationWrapper, gym.ActionWrapper)
"""Gymnasium's wrappers that change what an agent sees and does."""

_LEAVE_OBSERVATIONS = (VecCheckNan, VecMonitor, VecVideoRecorder)


class Predictor(Protocol):
    """A model that chooses actions: one of SB3's, or any object with these three members."""

    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[npt.NDArray[Any], Any]:
        """Return actions (n, k) for a batch of observations."""
        ...


class Transform(ABC):
    """Does to observations what one wrapper did in training."""

    def start(self, count: int) -> None:  # noqa: B027 - most remember nothing
        """Begin `count` new episodes."""

    @abstractmethod
    def apply(self, observation: Batch, which: npt.NDArray[np.intp]) -> Batch:
        """Change the observations of some episodes."""


class TransposeImage(Transform):
    """Does what `VecTransposeImage` does: an image's channels come first.

    The wrapper itself is not kept: it holds the training's environment, which a worker process
    does not need, and which cannot always be pickled.
    """

    def __init__(self, wrapper: VecTransposeImage) -> None:
        images = getattr(wrapper, "image_space_keys", [ALONE])
        self._images = frozenset() if wrapper.skip else frozenset(images)

    def apply(self, observation: Batch, which: npt.NDArray[np.intp]) -> Batch:  # noqa: ARG002
        """Move the channels of a batch of images."""
        return {
            key: VecTransposeImage.transpose_image(part) if key in self._images else part
            for key, part in observation.items()
        }


class Normalize(Transform):
    """Does what `VecNormalize` does, with frozen statistics."""

    def __init__(self, wrapper: VecNormalize) -> None:
        self.wrapper = wrapper

    def apply(self, observation: Batch, which: npt.NDArray[np.intp]) -> Batch:  # noqa: ARG002
        """Normalise a batch of observations."""
        alone = [*observation] == [ALONE]
        given: Any = observation[ALONE] if alone else dict(observation)
        changed: Any = self.wrapper.normalize_obs(given)
        normalised: Batch = {ALONE: changed} if alone else changed
        return normalised


class StackFrames(Transform):
    """Does what `VecFrameStack` does: lays the last frames behind one another, zeros at first."""

    def __init__(self, stacked: StackedObservations[Any]) -> None:
        alone = {ALONE: stacked}
        self._parts: Mapping[str, StackedObservations[Any]] = getattr(
            stacked, "sub_stacked_observations", alone
        )
        self._memory: Batch = {}

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""
        self._memory = {
            key: np.zeros((count, *part.stacked_shape), part.observation_space.dtype)
            for key, part in self._parts.items()
        }

    def apply(self, observation: Batch, which: npt.NDArray[np.intp]) -> Batch:
        """Add the newest frames to the older ones."""
        for key, frame in observation.items():
            axis = self._parts[key].stack_dimension
            memory = self._memory[key] = self._memory[key].astype(frame.dtype, copy=False)
            _, kept = np.split(memory[which], [frame.shape[axis]], axis=axis)
            memory[which] = np.concatenate([kept, frame], axis=axis)
        return {key: self._memory[key][which] for key in observation}


def observation_transforms(
    model: Any,
    observation_space: spaces.Space[Any],
    task: str,
    *,
    normalisation: VecNormalize | Literal[False] | None = None,
    wrapped_by: tuple[type[Any], ...] = (),
) -> list[Transform]:
    """Find what must be done to a task's observations before a model gets them.

    Without `normalisation`, the `VecNormalize` that the model holds counts; False says that there
    is none where the model holds none. `wrapped_by` holds
    Gymnasium's kinds of wrappers that are already at work in the task itself. It raises `UserError`
    if the model was trained on other observations, or under a wrapper that is not known here, or on
    normalised observations whose statistics are missing.
    """
    env = getattr(model, "get_env", lambda: None)()
    if env is None or normalisation:
        return _by_spaces(model, observation_space, task, normalisation)
    transforms: list[Transform] = []
    wrappers = []
    while isinstance(env, VecEnvWrapper):
        wrappers.append(env)
        env = env.venv
    for wrapper in reversed(wrappers):
        if isinstance(wrapper, VecTransposeImage):
            transforms.append(TransposeImage(wrapper))
        elif isinstance(wrapper, VecFrameStack):
            transforms.append(StackFrames(wrapper.stacked_obs))
        elif isinstance(wrapper, VecNormalize):
            if wrapper.norm_obs:
                transforms.append(Normalize(wrapper))
        elif not isinstance(wrapper, _LEAVE_OBSERVATIONS):
            raise _unknown_wrapper(type(wrapper).__name__)
    normalised = {
        key
        for wrapper in wrappers
        if isinstance(wrapper, VecNormalize) and wrapper.norm_obs
        for key in wrapper.norm_obs_keys or keyed(observation_space)
    }
    if not _alike(env.observation_space, observation_space, normalised):
        raise _wrong_observations(env.observation_space, observation_space, task)
    _check_gymnasium_wrappers(env, wrapped_by)
    return transforms


def _check_gymnasium_wrappers(env: VecEnv, wrapped_by: tuple[type[Any], ...]) -> None:
    for kind in CHANGING_WRAPPERS:
        if kind not in wrapped_by and any(env.env_is_wrapped(kind)):
            raise _unknown_wrapper(f"gymnasium.{kind.__name__}")
    around = env.env if isinstance(env, SB3VecEnv) else None
    while isinstance(around, VectorWrapper):
        if isinstance(around, VectorObservationWrapper | VectorActionWrapper):
            raise _unknown_wrapper(type(around).__name__)
        around = around.env


def _unknown_wrapper(name: str) -> UserError:
    return UserError(
        "Expected an agent trained under VecTransposeImage, VecFrameStack, VecNormalize "
        f"or none, got the wrapper {name}, whose work can't be repeated "
        "here. Pass your own object with `predict` that does it."
    )


def normalisation_bytes(transforms: list[Transform]) -> bytes:
    """Return the statistics that observations are normalised by, as bytes for a fingerprint."""
    parts = []
    for transform in transforms:
        if isinstance(transform, Normalize):
            wrapper = transform.wrapper
            parts.append(f"{wrapper.clip_obs} {wrapper.epsilon}".encode())
            named = wrapper.obs_rms if isinstance(wrapper.obs_rms, dict) else {"": wrapper.obs_rms}
            for key, moments in sorted(named.items()):
                parts += [key.encode(), moments.mean.tobytes(), moments.var.tobytes()]
    return b"".join(parts)


def _by_spaces(
    model: Any,
    expected: spaces.Space[Any],
    task: str,
    normalisation: VecNormalize | Literal[False] | None,
) -> list[Transform]:
    """Find transforms by the model's own space; SB3 transposes images by itself where needed."""
    wrong = _wrong_observations(getattr(model, "observation_space", None), expected, task)
    if not isinstance(getattr(model, "observation_space", None), spaces.Space):
        raise wrong
    given, parts = keyed(model.observation_space), keyed(expected)
    if set(given) != set(parts) or any(type(given[key]) is not type(parts[key]) for key in parts):
        raise wrong
    sizes = {key: int(np.prod(part.shape or ())) for key, part in parts.items()}
    ratios = {np.prod(given[key].shape or ()) / size for key, size in sizes.items()}
    frames = int(ratios.pop())
    if ratios or frames < 1:
        raise wrong
    stack = []
    if frames > 1:
        if not all(isinstance(part, spaces.Box) for part in parts.values()):
            raise wrong
        stacked = StackedObservations[Any](1, frames, parts)
        stack = [StackFrames(stacked)]
        shapes = {key: part.stacked_shape for key, part in stacked.sub_stacked_observations.items()}
    else:
        shapes = {key: part.shape or () for key, part in parts.items()}
    for key, shape in shapes.items():
        if given[key].shape not in (shape, (*shape[-1:], *shape[:-1])):
            raise wrong
        if not isinstance(parts[key], spaces.Box) and given[key] != parts[key]:
            raise wrong
    if normalisation:
        return _normalised(normalisation, parts, shapes, stack)
    for space in given.values() if normalisation is None else ():
        # speeds and the like have wide bounds: there a space does not show it
        if isinstance(space, spaces.Box) and len(space.shape) == 3 and space.low.min() < 0:
            raise UserError(
                "Expected the statistics of the VecNormalize that this agent was trained with, "
                "got a model without. Load it as PPO.load(file, env=VecNormalize.load(statistics, "
                "env)), or say vec_normalize=False if there was none."
            )
    return [*stack]


def _normalised(
    normalisation: VecNormalize,
    single: spaces.Dict,
    stacked: Mapping[str, tuple[int, ...]],
    stack: list[StackFrames],
) -> list[Transform]:
    if not normalisation.norm_obs:
        return [*stack]
    statistics: Any = normalisation.obs_rms
    named = statistics if isinstance(statistics, dict) else {ALONE: statistics}
    shapes = {key: moments.mean.shape for key, moments in named.items()}
    usual = {key: part.shape for key, part in single.items()}
    if all(shape == usual.get(key) for key, shape in shapes.items()):
        return [Normalize(normalisation), *stack]
    if all(shape == stacked.get(key) for key, shape in shapes.items()):
        return [*stack, Normalize(normalisation)]
    raise UserError(
        f"Expected the statistics of observations of shape {[*usual.values()]}, got those of "
        f"{[*shapes.values()]}. Pass the VecNormalize that this agent was trained with."
    )


def load_vec_normalize(given: Any, *, allow_pickle: bool) -> VecNormalize:
    """Return a `VecNormalize` as it is, or load the file that its `save` wrote.

    It raises `UserError` if it is neither, or the file, a pickle, may not be unpickled, and
    `FileError` if the file holds something else.
    """
    if isinstance(given, VecNormalize):
        return given
    if not isinstance(given, str | Path):
        raise UserTypeError(
            f"Expected vec_normalize to be a VecNormalize or the path of its file, got {given!r}. "
            "Pass False if the agent needs none."
        )
    if not allow_pickle:
        raise UserError(
            f"Expected allow_pickle=True with vec_normalize={str(given)!r}: the file is a pickle, "
            "which can run code when it is loaded. Pass allow_pickle=True if it is your own."
        )
    expected = f"Expected the file of a VecNormalize in {given}"
    path = os.path.expanduser(given)
    with explained(expected, kind=FileError), open(path, "rb") as file:
        loaded = pickle.load(file)
    if not isinstance(loaded, VecNormalize):
        raise FileError(f"{expected}, got a {type(loaded).__name__}. Write it by its save.")
    # what its file leaves out, without which it could not be sent to worker processes
    vars(loaded).update(venv=None, class_attributes={}, returns=None)
    return loaded


def _alike(given: spaces.Space[Any], expected: spaces.Space[Any], normalised: set[str]) -> bool:
    """Compare spaces; `VecNormalize` writes its own bounds into the inner one."""
    own, parts = keyed(given), keyed(expected)
    return set(own) == set(parts) and all(
        own[key].shape == part.shape
        and type(own[key]) is type(part)
        and (key in normalised or own[key].dtype == part.dtype)
        for key, part in parts.items()
    )


def _wrong_observations(given: Any, expected: spaces.Space[Any], task: str) -> UserError:
    return UserError(
        f"Expected an agent with observations {expected} (pictures may be transposed, frames "
        f"stacked), got observations {given}. Train it on {task}."
    )

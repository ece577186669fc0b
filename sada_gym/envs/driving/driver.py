"""SB3 models as drivers: what their wrappers did in training is done to what they see here."""

from __future__ import annotations

import hashlib
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym import agents
from sada_gym.envs.driving.drives import Drives, Observation
from sada_gym.envs.driving.task import ACTION_SPACE, OBSERVATION_SPACE
from sada_gym.threads import one_thread

TILE = 16
"""A network always sees this many observations at once, padded: a batch of another size would give
other last bits, and a closed loop makes another drive of them."""

_KEYS = tuple(OBSERVATION_SPACE.spaces)


class DriverLike(Protocol):
    """What can drive: an SB3 model, or whatever has these three."""

    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]

    def predict(self, observation: Any, *, deterministic: bool) -> tuple[npt.NDArray[Any], Any]:
        """Give actions (n, 2) for a batch of observations."""
        ...


class Driver:
    """Lets a model drive a batch of cars, deterministically and each as if it were alone.

    Frames are stacked as `VecFrameStack` does where the model's space says so. `VecNormalize`'s
    statistics are those of the environment that the model holds.

    Args:
        model: An SB3 model trained on `SADA-DrivingTask-v0`.

    Raises:
        ValueError: If its spaces are not the task's.
    """

    def __init__(self, model: DriverLike) -> None:
        self.model = model
        self._frames = _frames(model)
        self._normaliser = _normaliser(model)
        self._memory: dict[str, npt.NDArray[Any]] = {}

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown."""
        weights = agents.fingerprint(getattr(self.model, "policy", None))
        if weights is None or self._normaliser is None:
            return weights
        digest = hashlib.sha256(weights.encode())
        statistics = self._normaliser.obs_rms
        for key, moments in sorted(statistics.items()):
            digest.update(key.encode() + moments.mean.tobytes() + moments.var.tobytes())
        return digest.hexdigest()

    def start(self, count: int) -> None:
        """Forget what `count` cars saw."""
        self._memory = {
            key: np.zeros((count, *_stacked_shape(key, self._frames)), OBSERVATION_SPACE[key].dtype)
            for key in _KEYS
        }

    def act(self, drives: Drives, which: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
        """Choose actions (n, 2) for some of the cars.

        Raises:
            ValueError: If the model gives something else than two finite numbers a car.
        """
        observation = self._remember(drives.observe(which), which)
        parts = []
        for start in range(0, len(which), TILE):
            tile = {key: value[start : start + TILE] for key, value in observation.items()}
            parts.append(self._predict(tile))
        actions = np.concatenate(parts)
        wrong = np.flatnonzero(~np.isfinite(actions).all(axis=1))
        if wrong.size:
            i = which[wrong[0]]
            raise ValueError(
                f"Expected finite actions from {type(self.model).__name__}, got "
                f"{actions[wrong[0]].tolist()} at step {drives.steps[i]} of the route "
                f"{' '.join(drives.starts[i].route.corners)}. Look for NaN in its weights."
            )
        return np.clip(actions.astype(np.float64), -1.0, 1.0)

    def _remember(self, seen: Observation, which: npt.NDArray[np.intp]) -> Observation:
        if self._frames == 1:
            return seen
        for key, value in seen.items():
            size = value.shape[-1]
            past = self._memory[key][which][..., size:]
            self._memory[key][which] = np.concatenate([past, value], axis=-1)
        return {key: self._memory[key][which] for key in _KEYS}

    def _predict(self, tile: Observation) -> npt.NDArray[Any]:
        rows = len(tile["speed"])
        padded: dict[str, npt.NDArray[Any]] = {
            key: np.concatenate([value, np.repeat(value[:1], TILE - rows, axis=0)])
            for key, value in tile.items()
        }
        if self._normaliser is not None:
            padded = self._normaliser.normalize_obs(padded)
        with one_thread():
            actions, _ = self.model.predict(padded, deterministic=True)
        if np.shape(actions) != (TILE, 2):
            raise ValueError(
                f"Expected actions of shape {(TILE, 2)} from {type(self.model).__name__}, got "
                f"{np.shape(actions)}."
            )
        return np.asarray(actions)[:rows]


def _frames(model: DriverLike) -> int:
    """How many frames a model's observations stack; refuses other spaces than the task's."""
    given, acts = getattr(model, "observation_space", None), getattr(model, "action_space", None)
    seen: dict[str, Any] = dict(given.spaces) if isinstance(given, spaces.Dict) else {}
    frames = 0
    if set(seen) == set(_KEYS) and isinstance(seen["speed"], spaces.Box):
        frames = seen["speed"].shape[-1]
    stacked = {key: _stacked_shape(key, frames) for key in _KEYS}
    rows, columns, channels = stacked["image"]
    fits = frames > 0 and all(
        isinstance(seen[key], spaces.Box)
        and seen[key].dtype in (OBSERVATION_SPACE[key].dtype, np.float32)
        and (
            seen[key].shape == stacked[key]
            or (key == "image" and seen[key].shape == (channels, rows, columns))
        )
        for key in _KEYS
    )
    if not fits or not isinstance(acts, spaces.Box) or acts != ACTION_SPACE:
        raise ValueError(
            f"Expected a driver with observations {OBSERVATION_SPACE} (its image transposed, its "
            f"frames stacked, if you like) and actions {ACTION_SPACE}, got observations {given} "
            f"and actions {acts}. Train it on SADA-DrivingTask-v0."
        )
    return frames


def _stacked_shape(key: str, frames: int) -> tuple[int, ...]:
    shape = OBSERVATION_SPACE[key].shape
    assert shape is not None
    return (*shape[:-1], frames * shape[-1])


def _normaliser(model: DriverLike) -> Any:
    """The `VecNormalize` of the environment that a model holds, None where it holds none.

    Raises:
        ValueError: If it was trained on normalised pictures, and the statistics are missing; of
            speeds and commands alone a model's spaces do not tell.
    """
    find = getattr(model, "get_vec_normalize_env", None)
    held = find() if find is not None else None
    if held is not None and held.norm_obs:
        return held
    if model.observation_space["image"].low.min() < 0:  # type: ignore[index]
        raise ValueError(
            "Expected the statistics of the VecNormalize that this driver was trained with, got a "
            "model without. Load it as PPO.load(file, env=VecNormalize.load(statistics, env))."
        )
    return None

"""SB3 models as frozen agents that act in lockstep, each as if it were alone."""

from __future__ import annotations

import hashlib
import traceback
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces

from sada_gym import agents
from sada_gym.agents.wrappers import Batch, Predictor, observation_transforms, statistics
from sada_gym.determinism import one_thread
from sada_gym.errors import UserError

TILE = 16
"""A network always sees this many observations at once, padded: a batch of another size would give
other last bits, and a closed loop makes another episode of them. A network that gives other bits
even to another place in the batch (narrow layers do) sees one observation at a time."""

_LIBRARIES = ("stable_baselines3", "sb3_contrib")


class Policy:
    """Lets a model choose actions for a batch of agents, deterministically.

    Frames are stacked, pictures transposed and observations normalised as SB3's wrappers did in
    training.

    Args:
        model: An SB3 model, or whatever has its spaces and `predict`.
        observation_space: The task's.
        action_space: The task's, within [-1, 1].
        task: The id of the task that it should have been trained on, for messages.

    Raises:
        UserError: If its spaces are others, or it has a memory of its own.
    """

    def __init__(
        self,
        model: Predictor,
        observation_space: spaces.Dict,
        action_space: spaces.Box[Any],
        task: str,
    ) -> None:
        given = getattr(model, "action_space", None)
        if not isinstance(given, spaces.Box) or given != action_space:
            raise UserError(
                f"Expected an agent with observations {observation_space} and actions "
                f"{action_space}, got observations {getattr(model, 'observation_space', None)} and "
                f"actions {given}. Train it on {task}."
            )
        self.model = model
        self._transforms = observation_transforms(model, observation_space, task)
        self._action_shape = action_space.shape
        self._tile = TILE
        if not self._same_in_every_place(observation_space):
            self._tile = 1

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown.

        Weights do not tell what the `predict` of a class other than SB3's does with them.
        """
        if type(self.model).__module__.partition(".")[0] not in _LIBRARIES:
            return None
        weights = agents.fingerprint(getattr(self.model, "policy", None))
        normalisation = statistics(self._transforms)
        if weights is None or not normalisation:
            return weights
        return hashlib.sha256(weights.encode() + normalisation).hexdigest()

    @property
    def use(self) -> dict[str, Any]:
        """How the model is used, as far as an action depends on it: for `agents.identity`."""
        return {
            "tile": self._tile,
            "transforms": [type(transform).__name__ for transform in self._transforms],
            "normalisation": hashlib.sha256(statistics(self._transforms)).hexdigest(),
        }

    def start(self, count: int) -> None:
        """Begin new episodes of `count` agents."""
        for transform in self._transforms:
            transform.start(count)

    def act(
        self,
        observation: Mapping[str, npt.NDArray[Any]],
        which: npt.NDArray[np.intp],
        where: Callable[[int], str] | None = None,
    ) -> npt.NDArray[np.float64]:
        """Choose actions (n, k) for some of the agents.

        Args:
            observation: Of the task, each key (n, ...).
            which: (n,) which of the agents they are.
            where: Says in a few words where an agent is, for messages. Without it actions that are
                not finite are returned, NaN where the model refuses to choose one.

        Returns:
            (n, k) actions.

        Raises:
            UserError: If the model gives actions of another shape, or, with `where`, one that is
                not finite; and whatever its `predict` raises.
        """
        batch: Batch = dict(observation)
        for transform in self._transforms:
            batch = transform.apply(batch, which)
        parts = []
        for start in range(0, len(which), self._tile):
            tile = {key: value[start : start + self._tile] for key, value in batch.items()}
            rows = which[start : start + self._tile]
            try:
                actions = self._predict(tile)
            except ValueError as error:
                if not _is_torchs_refusal(error):
                    raise
                actions = self._one_by_one(tile)
            if np.shape(actions) != (self._tile, *self._action_shape):
                raise UserError(
                    f"Expected actions of shape {(self._tile, *self._action_shape)} from "
                    f"{type(self.model).__name__}, got {np.shape(actions)}."
                )
            actions = np.asarray(actions)[: len(rows)]
            wrong = np.flatnonzero(~np.isfinite(actions).all(axis=1))
            if wrong.size and where is not None:
                raise UserError(
                    f"Expected finite actions from {type(self.model).__name__}, got "
                    f"{actions[wrong[0]].tolist()} at {where(rows[wrong[0]])}. Look for NaN or "
                    "infinity in its weights."
                )
            parts.append(actions)
        return np.concatenate(parts).astype(np.float64)

    def _same_in_every_place(self, observation_space: spaces.Dict) -> bool:
        """Whether each of a tile's observations keeps its action when the tile is reversed."""
        drawn = deepcopy(observation_space)
        drawn.seed(0)
        samples = [drawn.sample() for _ in range(TILE)]
        tile: Batch = {key: np.stack([one[key] for one in samples]) for key in observation_space}
        self.start(TILE)
        for transform in self._transforms:
            tile = transform.apply(tile, np.arange(TILE))
        try:
            actions, memory = self._ask(tile)
            reversed_, _ = self._ask({key: value[::-1] for key, value in tile.items()})
        except ValueError as error:
            if not _is_torchs_refusal(error):
                raise
            return True  # `act` says for whom
        if memory is not None:
            raise UserError(
                f"Expected an agent without a memory of its own, got {type(self.model).__name__}, "
                "whose predict gives a state. Train one under VecFrameStack instead."
            )
        return np.array_equal(actions, reversed_[::-1], equal_nan=True)

    def _predict(self, tile: Batch) -> npt.NDArray[Any]:
        return self._ask(tile)[0]

    def _ask(self, tile: Batch) -> tuple[npt.NDArray[Any], Any]:
        """Actions and the model's memory, of a tile that is padded."""
        rows = len(next(iter(tile.values())))
        padded = {
            key: np.concatenate([value, np.repeat(value[:1], self._tile - rows, axis=0)])
            for key, value in tile.items()
        }
        with one_thread():
            return self.model.predict(padded, deterministic=True)

    def _one_by_one(self, tile: Batch) -> npt.NDArray[Any]:
        """Actions of a whole tile, one agent at a time; NaN for those that got none."""
        actions = np.full((self._tile, *self._action_shape), np.nan)
        for row in range(len(next(iter(tile.values())))):
            try:
                alone = {key: value[row : row + 1] for key, value in tile.items()}
                actions[row] = self._predict(alone)[0]
            except ValueError as error:
                if not _is_torchs_refusal(error):
                    raise
        return actions


def _is_torchs_refusal(error: ValueError) -> bool:
    """Whether a distribution of torch's refused its parameters: the network's output was NaN.

    The error has no type of its own, so the place where it was raised decides.
    """
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return frame.f_code is torch.distributions.Distribution.__init__.__code__

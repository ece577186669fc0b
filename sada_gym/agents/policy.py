"""SB3 models as frozen agents that act in lockstep, each as if it were alone."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sada_gym import agents
from sada_gym.agents.wrappers import Acting, Batch, stages, statistics
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
        observation_space: What it is to see.
        action_space: What it is to give, within [-1, 1].
        task: The id of the task that it should have been trained on, for messages.

    Raises:
        ValueError: If its spaces are others, or it has a memory of its own.
    """

    def __init__(
        self,
        model: Acting,
        observation_space: spaces.Dict,
        action_space: spaces.Box[Any],
        task: str,
    ) -> None:
        acts = getattr(model, "action_space", None)
        if not isinstance(acts, spaces.Box) or acts != action_space:
            raise UserError(
                f"Expected an agent with observations {observation_space} and actions "
                f"{action_space}, got observations {getattr(model, 'observation_space', None)} and "
                f"actions {acts}. Train it on {task}."
            )
        self.model = model
        self._stages = stages(model, observation_space, task)
        self._action_shape = action_space.shape
        self._tile = TILE
        if not self._same_in_every_place(observation_space):
            self._tile = 1

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown.

        What a class of one's own does with its weights they don't tell.
        """
        if type(self.model).__module__.partition(".")[0] not in _LIBRARIES:
            return None
        weights = agents.fingerprint(getattr(self.model, "policy", None))
        told = statistics(self._stages)
        if weights is None or not told:
            return weights
        return hashlib.sha256(weights.encode() + told).hexdigest()

    def start(self, count: int) -> None:
        """Forget what `count` agents saw."""
        for stage in self._stages:
            stage.start(count)

    def act(
        self,
        seen: Mapping[str, npt.NDArray[Any]],
        which: npt.NDArray[np.intp],
        where: Callable[[int], str] | None = None,
    ) -> npt.NDArray[np.float64]:
        """Choose actions (n, k) for some of the agents.

        Args:
            seen: What they see, each key (n, ...).
            which: (n,) which of the agents they are.
            where: Says in a few words where an agent is, for messages; None where any number may
                be given: NaN is where the model gives none.

        Raises:
            ValueError: If the model gives anything but k numbers an agent, or, with `where`, one
                that is not finite; and whatever else its `predict` raises.
        """
        batch: Batch = dict(seen)
        for stage in self._stages:
            batch = stage.apply(batch, which)
        parts = []
        for start in range(0, len(which), self._tile):
            tile = {key: value[start : start + self._tile] for key, value in batch.items()}
            rows = which[start : start + self._tile]
            try:
                actions = self._predict(tile)
            except ValueError as error:
                if not _refuses_nan(error):
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
        """Whether each of a tile's observations has its action in the tile turned round, too."""
        drawn = deepcopy(observation_space)
        drawn.seed(0)
        seen = [drawn.sample() for _ in range(TILE)]
        tile: Batch = {key: np.stack([one[key] for one in seen]) for key in observation_space}
        self.start(TILE)
        for stage in self._stages:
            tile = stage.apply(tile, np.arange(TILE))
        try:
            actions, memory = self._ask(tile)
            turned, _ = self._ask({key: value[::-1] for key, value in tile.items()})
        except ValueError as error:
            if not _refuses_nan(error):
                raise
            return True  # `act` says for whom
        if memory is not None:
            raise UserError(
                f"Expected an agent without a memory of its own, got {type(self.model).__name__}, "
                "whose predict gives a state. Train one under VecFrameStack instead."
            )
        return np.array_equal(actions, turned[::-1], equal_nan=True)

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
        """Actions of a whole tile, each agent shown by itself; NaN for those who got none."""
        actions = np.full((self._tile, *self._action_shape), np.nan)
        for row in range(len(next(iter(tile.values())))):
            try:
                seen = {key: value[row : row + 1] for key, value in tile.items()}
                actions[row] = self._predict(seen)[0]
            except ValueError as error:
                if not _refuses_nan(error):
                    raise
        return actions


def _refuses_nan(error: ValueError) -> bool:
    """Whether it is what torch's distributions raise for NaN among their parameters."""
    return "to satisfy the constraint" in str(error)

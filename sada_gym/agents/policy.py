"""SB3 models as frozen agents that act in lockstep, each as if it were alone."""

from __future__ import annotations

import hashlib
import traceback
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from sada_gym import agents
from sada_gym.agents.contract import Agent, Indices, as_agent
from sada_gym.agents.tile import ALONE, Batch, keyed, tiled
from sada_gym.agents.wrappers import Predictor, normalisation_bytes, observation_transforms
from sada_gym.errors import UserError

POLICY_TILE = 16
"""The observations in one call of a model. A network that gives other bits to another place in the
batch (narrow layers do) sees one observation at a time."""

_LIBRARIES = ("stable_baselines3", "sb3_contrib")


@dataclass(frozen=True)
class Interface:
    """What an agent sees and does in a task; `task_id` is for messages.

    `wrapped_by` holds Gymnasium's kinds of wrappers that are already at work in the task itself.
    """

    task_id: str
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    wrapped_by: tuple[type[Any], ...] = ()


class Policy:
    """A model that was trained on an inner task, with the wrappers that it was trained under.

    It chooses actions deterministically. Frames are stacked, pictures transposed and observations
    normalised as SB3's wrappers did in training.

    Args:
        model: An SB3 model, or whatever has its spaces and `predict`.
        episodes: The `Episodes` in which it will act, or their class, or an `Interface`.
        normalisation: The `VecNormalize` of its training; None takes that which the model holds.

    Raises:
        UserError: If the model's spaces are others, or it has a memory of its own.
    """

    def __init__(
        self,
        model: Predictor,
        episodes: Any,
        *,
        normalisation: VecNormalize | None = None,
    ) -> None:
        observation_space, action_space = episodes.observation_space, episodes.action_space
        if not _fits_models(observation_space):
            raise UserError(
                f"Expected observations of {episodes.task_id} that are numbers or a flat "
                f"dictionary of them (Box, Discrete, MultiDiscrete, MultiBinary, Dict), got "
                f"{observation_space}. Flatten them by a wrapper, or pass a function observation "
                "-> action."
            )
        # an object with `predict` for any environment need not repeat its spaces
        no_spaces = isinstance(episodes, Interface) and not (
            hasattr(model, "action_space") or hasattr(model, "observation_space")
        )
        model_actions = action_space if no_spaces else getattr(model, "action_space", None)
        if model_actions != action_space:
            raise UserError(
                f"Expected an agent with observations {observation_space} and actions "
                f"{action_space}, got observations {getattr(model, 'observation_space', None)} and "
                f"actions {model_actions}. Train it on {episodes.task_id}."
            )
        self.model = model
        self._plain = not isinstance(observation_space, spaces.Dict)
        self._transforms = observation_transforms(
            episodes if no_spaces else model,
            observation_space,
            episodes.task_id,
            normalisation=normalisation,
            wrapped_by=getattr(episodes, "wrapped_by", ()),
        )
        self._action_shape = action_space.shape or ()
        self._tile = POLICY_TILE
        if not self._same_in_every_place(keyed(observation_space)):
            self._tile = 1

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown.

        Weights do not tell what the `predict` of a class other than SB3's does with them.
        """
        if type(self.model).__module__.partition(".")[0] not in _LIBRARIES:
            return None
        weights = agents.fingerprint(getattr(self.model, "policy", self.model))
        normalisation = normalisation_bytes(self._transforms)
        if weights is None or not normalisation:
            return weights
        return hashlib.sha256(weights.encode() + normalisation).hexdigest()

    @property
    def settings(self) -> dict[str, Any]:
        """How the model is used, as far as an action depends on it."""
        return {
            "tile": self._tile,
            "transforms": [type(transform).__name__ for transform in self._transforms],
            "normalisation": hashlib.sha256(normalisation_bytes(self._transforms)).hexdigest(),
        }

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what only training needs: environments, and functions of the learning rate."""
        return {**self.__dict__, "model": _for_acting(self.model)}

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""
        for transform in self._transforms:
            transform.start(count)

    def act(self, episodes: Any, which: Indices) -> npt.NDArray[np.float64]:
        """Return float64 actions (n, ...) in some of the episodes; NaN where the model refuses.

        It raises `UserError` if the model gives actions of another shape, or one that is not
        finite where the episodes take none, or its `predict` raises.
        """
        batch = self._transformed(episodes.observe(which), which)
        actions = np.concatenate(tiled(self._predict, batch, self._tile))
        wrong = np.flatnonzero(~np.isfinite(actions).reshape(len(actions), -1).all(axis=1))
        if wrong.size and episodes.finite_only:
            first = int(wrong[0])
            raise UserError(
                f"Expected finite actions from {type(self.model).__name__}, got "
                f"{actions[first].tolist()} at {episodes.where(int(which[first]))}. Look for NaN "
                "or infinity in its weights."
            )
        return actions.astype(np.float64)

    def _transformed(self, batch: Batch, which: Indices) -> Batch:
        for transform in self._transforms:
            batch = transform.apply(batch, which)
        return batch

    def _same_in_every_place(self, observation_space: Any) -> bool:
        """Whether each of a tile's observations keeps its action when the tile is reversed."""
        drawn = deepcopy(observation_space)
        drawn.seed(0)
        samples = [drawn.sample() for _ in range(POLICY_TILE)]
        batch = {key: np.stack([sample[key] for sample in samples]) for key in observation_space}
        self.start(POLICY_TILE)
        tile = self._transformed(batch, np.arange(POLICY_TILE))
        try:
            (actions,) = tiled(self._ask, tile, POLICY_TILE)
            backwards = {key: value[::-1] for key, value in tile.items()}
            (reversed_,) = tiled(self._ask, backwards, POLICY_TILE)
        except ValueError as error:
            if not _is_torchs_refusal(error):
                raise
            return True  # `act` says for whom
        return np.array_equal(actions, reversed_[::-1], equal_nan=True)

    def _ask(self, tile: Batch) -> npt.NDArray[Any]:
        observation: Any = tile[ALONE] if self._plain else tile
        try:
            answer = self.model.predict(observation, deterministic=True)
        except UserError:
            raise
        except Exception as error:  # whatever a user's model may raise
            if isinstance(error, ValueError) and _is_torchs_refusal(error):
                raise
            raise UserError(
                f"Expected actions from {type(self.model).__name__}, got {type(error).__name__}: "
                f"{error}. It is called as predict(observations, deterministic=True), with a batch "
                "of observations."
            ) from error
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise UserError(
                f"Expected (actions, None) from the predict of {type(self.model).__name__}, as "
                f"SB3's gives it, got {type(answer).__name__}. Return both."
            )
        actions, memory = answer
        if memory is not None:
            raise UserError(
                f"Expected an agent without a memory of its own, got {type(self.model).__name__}, "
                "whose predict gives a state. Train one under VecFrameStack instead."
            )
        return actions

    def _predict(self, tile: Batch) -> npt.NDArray[Any]:
        """Return the actions of a tile; NaN where the model refuses one."""
        try:
            actions = self._ask(tile)
        except ValueError as error:
            if not _is_torchs_refusal(error):
                raise
            actions = self._one_by_one(tile)
        shape = (self._tile, *self._action_shape)
        if np.shape(actions) != shape:
            raise UserError(
                f"Expected actions of shape {shape} from {type(self.model).__name__}, got "
                f"{np.shape(actions)}."
            )
        return np.asarray(actions)

    def _one_by_one(self, tile: Batch) -> npt.NDArray[Any]:
        actions = np.full((self._tile, *self._action_shape), np.nan)
        for row in range(self._tile):
            try:
                alone = {key: value[row : row + 1] for key, value in tile.items()}
                actions[row] = tiled(self._ask, alone, self._tile)[0][0]
            except ValueError as error:
                if not _is_torchs_refusal(error):
                    raise
        return actions


def as_policy(given: Any, episodes: Any) -> Agent[Any, Any]:
    """Return an agent as it is, or that of an SB3 model of the task of some episodes, a class.

    It raises `UserError` if the object is neither, or the model's spaces are not the task's.
    """
    kinds = f"an SB3 model trained on {episodes.task_id}"
    return as_agent(given, partial(Policy, episodes=episodes), kinds)


def _fits_models(space: Any) -> bool:
    kinds = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
    parts = space.values() if isinstance(space, spaces.Dict) else [space]
    return all(isinstance(part, kinds) for part in parts)


def _for_acting(model: Any) -> Any:
    """Copy an SB3 model without what cannot be pickled; return another model as it is."""
    if not isinstance(model, BaseAlgorithm):
        return model
    left_out = {*model._excluded_save_params()} - {"policy", "device"}
    copied: Any = object.__new__(type(model))
    vars(copied).update(
        {
            key: value
            for key, value in vars(model).items()
            if key not in left_out
            and (key == "policy" or isinstance(value, type) or not callable(value))
        }
    )
    copied.env = copied._vec_normalize_env = None
    return copied


def _is_torchs_refusal(error: ValueError) -> bool:
    """Whether a distribution of torch's refused its parameters: the network's output was NaN."""
    # the error has no type of its own, so the place where it was raised decides
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return frame.f_code is torch.distributions.Distribution.__init__.__code__

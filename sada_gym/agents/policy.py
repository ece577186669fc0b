"""SB3 models as frozen agents that act in lockstep, each as if it were alone."""

from __future__ import annotations

import hashlib
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from sada_gym import agents
from sada_gym.agents.contract import Agent, Indices, Interface, as_agent
from sada_gym.agents.exported import ExportedNetwork
from sada_gym.agents.model_call import (
    MASKS,
    SEEDS,
    STATE,
    Answers,
    ModelCall,
    Refused,
    StateLayout,
    mask_size,
)
from sada_gym.agents.tile import Batch, fits_batches, keyed, sampled, tiled
from sada_gym.agents.wrappers import Predictor, normalisation_bytes, observation_transforms
from sada_gym.errors import UserError
from sada_gym.foundations.determinism import generators_kept, one_thread

POLICY_TILE = 16
"""The observations in one call of a model. A network that gives other bits to another place in the
batch (narrow layers do) sees one observation at a time."""

_STATELESS = StateLayout(None, ())

_LIBRARIES = ("stable_baselines3", "sb3_contrib")


class Policy:
    """A model that was trained on an inner task, with the wrappers that it was trained under.

    Frames are stacked, pictures transposed and observations normalised as SB3's wrappers did in
    training. The state of a model with a memory, such as RecurrentPPO, is kept for each episode.

    Args:
        model: An SB3 model, or whatever has its spaces and `predict`.
        episodes: The `Episodes` in which it will act, or their class, or an `Interface`.
        normalisation: The `VecNormalize` of its training; None takes that which the model holds;
            False says that there was none.
        deterministic: Whether it takes the best action. Otherwise it draws one at each step, from
            the evaluation's seed, one episode at a time.

    Raises:
        UserError: If the model's spaces are others, or its memory cannot be kept.
    """

    def __init__(
        self,
        model: Predictor,
        episodes: Any,
        *,
        normalisation: VecNormalize | Literal[False] | None = None,
        deterministic: bool = True,
    ) -> None:
        observation_space, action_space = episodes.observation_space, episodes.action_space
        if not fits_batches(observation_space):
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
        plain = not isinstance(observation_space, spaces.Dict)
        self._call = ModelCall(model, plain=plain, deterministic=deterministic)
        self._deterministic = deterministic
        self._transforms = observation_transforms(
            episodes if no_spaces else model,
            observation_space,
            episodes.task_id,
            normalisation=normalisation,
            wrapped_by=getattr(episodes, "wrapped_by", ()),
        )
        self._action_shape = action_space.shape or ()
        self._choices = mask_size(action_space) if self._call.takes_masks else 0
        if self._choices and not getattr(episodes, "has_masks", False):
            raise UserError(
                f"Expected an environment with action_masks(), because {type(model).__name__} "
                f"chooses among valid actions, got {episodes.task_id} without. Pass a function "
                "that makes the environment within sb3_contrib's ActionMasker, or the function "
                "lambda observation: model.predict(observation)[0] as the agent."
            )
        self._tile = POLICY_TILE
        self.start(0)
        with generators_kept():
            if not self._same_in_every_place(keyed(observation_space)):
                self._tile = 1

    @property
    def fingerprint(self) -> str | None:
        """SHA-256 over the policy's weights and the normalisation, None where they are unknown.

        Weights do not tell what the `predict` of a class other than SB3's does with them.
        """
        if isinstance(self.model, ExportedNetwork):
            weights: str | None = self.model.weights_hash
        elif type(self.model).__module__.partition(".")[0] in _LIBRARIES:
            weights = agents.fingerprint(getattr(self.model, "policy", self.model))
        else:
            return None
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

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Let the model be asked again."""
        self.__dict__.update(state)
        self._call.model = self.model

    def start(self, count: int) -> None:
        """Begin `count` new episodes."""
        self._began = np.zeros(count, np.bool_)
        self._states: list[npt.NDArray[Any]] = []
        for transform in self._transforms:
            transform.start(count)

    def act(self, episodes: Any, which: Indices) -> npt.NDArray[np.float64]:
        """Return float64 actions (n, ...) in some of the episodes; NaN where the model refuses.

        It raises `UserError` if the model gives actions of another shape, or one that is not
        finite where the episodes take none, or its `predict` raises.
        """
        batch = self._transformed(episodes.observe(which), which)
        if self._call.takes_masks:
            batch[MASKS] = episodes.action_masks(which)
        if not self._deterministic:
            batch[SEEDS] = episodes.agent_seeds(which)
        with nullcontext() if self._deterministic else generators_kept():
            actions = self._answers(batch, which)
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

    def _answers(self, batch: Batch, which: Indices) -> npt.NDArray[Any]:
        """Return the actions in some episodes, and keep their states."""
        if self._call.layout is None:
            return np.concatenate([part.actions for part in tiled(self._ask, batch, self._tile)])
        actions = np.empty((len(which), *self._action_shape))
        began = self._began[which]
        for rows in (np.flatnonzero(~began), np.flatnonzero(began)):
            if not len(rows):
                continue
            chosen = {key: value[rows] for key, value in batch.items()}
            if began[rows[0]]:
                for i, kept in enumerate(self._states):
                    chosen[f"{STATE}{i}"] = kept[which[rows]]
            parts = tiled(self._ask, chosen, self._tile)
            actions[rows] = np.concatenate([part.actions for part in parts])
            states = [np.concatenate(same) for same in zip(*(p.state for p in parts), strict=True)]
            if not self._states:
                self._states = [
                    np.zeros((len(self._began), *state.shape[1:]), state.dtype) for state in states
                ]
            for kept, state in zip(self._states, states, strict=True):
                kept[which[rows]] = state
        self._began[which] = True
        return actions

    def _same_in_every_place(self, observation_space: Any) -> bool:
        """Whether each of a tile's observations keeps its action when the tile is reversed.

        It finds out, too, whether the model has a memory.
        """
        self.start(POLICY_TILE)
        batch = sampled(observation_space, POLICY_TILE)
        tile = self._transformed(batch, np.arange(POLICY_TILE))
        if self._choices:
            tile[MASKS] = np.ones((POLICY_TILE, self._choices), np.bool_)
        if not self._deterministic:
            tile[SEEDS] = np.zeros(POLICY_TILE, np.uint32)
        with one_thread():
            try:
                self._call.find_layout(tile)
                if not self._deterministic or (self._call.layout or _STATELESS).axes is None:
                    self._call({key: value[:1] for key, value in tile.items()})
                    return False
                answers, backwards = (self._twice(tile, step) for step in (1, -1))
            except Refused:
                return True  # `act` says for whom
        return all(
            np.array_equal(answer, backward[::-1], equal_nan=True)
            for answer, backward in zip(answers, backwards, strict=True)
        )

    def _twice(self, tile: Batch, step: int) -> list[npt.NDArray[Any]]:
        """Ask about a tile in this order, and again with the states of the first answers."""
        turned = {key: value[::step] for key, value in tile.items()}
        (first,) = tiled(self._call, turned, POLICY_TILE)
        if not first.state:
            return [first.actions]
        states = {f"{STATE}{i}": part for i, part in enumerate(first.state)}
        (second,) = tiled(self._call, {**turned, **states}, POLICY_TILE)
        return [first.actions, *first.state, second.actions, *second.state]

    def _ask(self, tile: Batch) -> Answers:
        """Return the answers to a tile; NaN where the model refuses one."""
        try:
            answers = self._call(tile)
        except Refused:
            answers = self._one_by_one(tile)
        shape = (self._tile, *self._action_shape)
        if answers.actions.shape != shape:
            raise UserError(
                f"Expected actions of shape {shape} from {type(self.model).__name__}, got "
                f"{answers.actions.shape}."
            )
        return answers

    def _one_by_one(self, tile: Batch) -> Answers:
        actions = np.full((self._tile, *self._action_shape), np.nan)
        for row in range(self._tile):
            with suppress(Refused):
                alone = {key: value[row : row + 1] for key, value in tile.items()}
                actions[row] = tiled(self._call, alone, self._tile)[0].actions[0]
        states = tuple(value for key, value in tile.items() if key.startswith(STATE))
        return Answers(actions, states)


def as_policy(given: Any, episodes: Any) -> Agent[Any, Any]:
    """Return an agent as it is, or that of an SB3 model of the task of some episodes, a class.

    It raises `UserError` if the object is neither, or the model's spaces are not the task's.
    """
    kinds = f"an SB3 model trained on {episodes.task_id}"
    return as_agent(given, partial(Policy, episodes=episodes), kinds)


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

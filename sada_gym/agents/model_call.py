"""Asks a model's `predict` for the actions of a tile of observations."""

from __future__ import annotations

import inspect
import random
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces

from sada_gym.agents.tile import ALONE, Batch
from sada_gym.errors import UserError, described

MASKS, SEEDS, STATE = "(action masks)", "(seeds)", "(state)"
"""Keys that a tile may have beside its observations: which actions are valid, (n, k) bool; what the
random choices of this step follow from, (n,) uint32; and the parts of the episodes' states."""

Array = npt.NDArray[Any]


class Refused(Exception):  # noqa: N818 - reads as what happened
    """A distribution of torch's refused its parameters: the network's output was NaN."""


@dataclass(frozen=True)
class Answers:
    """The actions of n episodes, (n, ...), and the parts of their states, (n, ...) each."""

    actions: Array
    state: tuple[Array, ...] = ()

    def __getitem__(self, rows: slice) -> Answers:
        """Return the answers in some rows."""
        return Answers(self.actions[rows], tuple(part[rows] for part in self.state))


@dataclass(frozen=True)
class StateLayout:
    """How a model's state is nested, and on which axis of each array its episodes lie.

    Without `axes` a state is that of one episode, and stays as it is.
    """

    nesting: Any
    axes: tuple[int, ...] | None

    @classmethod
    def of(cls, many: Any, few: Any) -> StateLayout:
        """Compare the states of two batches of different sizes."""
        first, second = [*_arrays(many)], [*_arrays(few)]
        differing = [
            np.flatnonzero(np.not_equal(a.shape, b.shape)).tolist()
            for a, b in zip(first, second, strict=False)
            if isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and a.ndim == b.ndim
        ]
        whole = len(first) == len(second) == len(differing)
        if whole and first and all(len(axes) == 1 for axes in differing):
            return cls(many, tuple(axes[0] for axes in differing))
        return cls(None, None)

    def parts(self, state: Any) -> tuple[Array, ...]:
        """Take a state apart, each part (n, ...)."""
        if self.axes is None:
            alone = np.empty(1, object)
            alone[0] = state
            return (alone,)
        arrays = zip(_arrays(state), self.axes, strict=True)
        return tuple(np.moveaxis(array, axis, 0) for array, axis in arrays)

    def state(self, parts: tuple[Array, ...]) -> Any:
        """Put a state together again."""
        if self.axes is None:
            return parts[0][0]
        arrays = [
            np.ascontiguousarray(np.moveaxis(part, 0, axis))
            for part, axis in zip(parts, self.axes, strict=True)
        ]
        return _nested(self.nesting, iter(arrays))


class ModelCall:
    """Calls `predict` with what it takes.

    A model whose predict takes `action_masks` gets them. One that takes `state` and
    `episode_start`, and returns a state, has a memory.

    Args:
        model: An SB3 model, or any object with `predict`.
        plain: Whether observations are no dictionaries.
        deterministic: Whether the model is asked for its best action. Otherwise it draws one, from
            the global generators, which are seeded for each call.
    """

    def __init__(self, model: Any, *, plain: bool, deterministic: bool) -> None:
        self.model, self._plain, self._deterministic = model, plain, deterministic
        taken = _parameters(model.predict)
        self.takes_masks = "action_masks" in taken
        self.takes_state = {"state", "episode_start"} <= taken.keys()
        self._deterministic_too = not self.takes_state or "deterministic" in taken
        self.layout: StateLayout | None = None
        if not deterministic and getattr(model, "use_sde", False):
            raise UserError(
                "Expected a policy that draws each action separately, got "
                f"{type(model).__name__} with use_sde=True, whose noise lasts for several steps. "
                "Use deterministic=True."
            )

    def __getstate__(self) -> dict[str, Any]:
        """Leave the model to the owner of both."""
        return {**self.__dict__, "model": None}

    def __call__(self, tile: Batch) -> Answers:
        """Return the answers to a tile."""
        count = len(next(iter(tile.values())))
        parts = tuple(value for key, value in tile.items() if key.startswith(STATE))
        beside = (MASKS, SEEDS, STATE)
        seen = {key: value for key, value in tile.items() if not key.startswith(beside)}
        keywords: dict[str, Any] = {}
        if MASKS in tile:
            keywords["action_masks"] = tile[MASKS]
        if self._deterministic_too:
            keywords["deterministic"] = self._deterministic
        if self.takes_state:
            keywords["state"] = self.layout.state(parts) if self.layout and parts else None
            keywords["episode_start"] = np.full(count, not parts)
        if SEEDS in tile:
            seed_generators(int(tile[SEEDS][0]), self.model)
        actions, state = self._predict(seen[ALONE] if self._plain else seen, keywords)
        if state is None:
            return Answers(np.asarray(actions))
        if not self.takes_state:
            raise UserError(
                f"Expected an agent without a memory of its own, got {type(self.model).__name__}, "
                "whose predict gives a state and takes none. Let it take state and episode_start "
                "beside observations, as that of RecurrentPPO does."
            )
        # before the layout is known, only the caller that finds it out asks
        return Answers(np.asarray(actions), self.layout.parts(state) if self.layout else (state,))

    def find_layout(self, tile: Batch) -> None:
        """Find out whether the model has a memory, and how; `tile` has several rows."""
        if not self.takes_state:
            return
        few = {key: value[:-1] for key, value in tile.items()}
        many = self(tile).state
        if many:
            self.layout = StateLayout.of(many[0], (self(few).state or (None,))[0])
        else:
            self.takes_state = False

    def _predict(self, observation: Any, keywords: Mapping[str, Any]) -> tuple[Any, Any]:
        name = type(self.model).__name__
        try:
            answer = self.model.predict(observation, **keywords)
        except UserError:
            raise
        except Exception as error:  # whatever a user's model may raise
            # torch's refusal has no type of its own, so the place where it was raised decides
            *_, (frame, _) = traceback.walk_tb(error.__traceback__)
            refused_by = torch.distributions.Distribution.__init__.__code__
            if isinstance(error, ValueError) and frame.f_code is refused_by:
                raise Refused from error
            shown = ", ".join(
                f"{key}={value}" if key == "deterministic" else f"{key}=..."
                for key, value in keywords.items()
            )
            raise UserError(
                f"Expected actions from {name}, got {described(error)}. It is called "
                f"as predict({', '.join(['observations', *filter(None, [shown])])}), with a batch "
                "of observations."
            ) from error
        if not isinstance(answer, tuple) or len(answer) != 2:
            raise UserError(
                f"Expected (actions, None) from the predict of {name}, as SB3's gives it, got "
                f"{type(answer).__name__}. Return both."
            )
        return answer


def mask_size(space: spaces.Space[Any]) -> int:
    """Return the number of choices in an action space: the length of its mask."""
    if isinstance(space, spaces.Discrete):
        return int(space.n)
    if isinstance(space, spaces.MultiDiscrete):
        return int(np.sum(space.nvec))
    if isinstance(space, spaces.MultiBinary):
        return 2 * int(np.prod(space.shape))
    raise UserError(
        f"Expected actions to choose from, which can be masked, got {space}. Pass an agent whose "
        "predict takes no action_masks."
    )


def seed_generators(seed: int, model: Any = None) -> None:
    """Seed the global generators of Python, NumPy and torch, and those of a model's action space.

    The caller keeps them: see `generators_kept`.
    """
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - agents draw from the global one
    torch.manual_seed(seed)
    for owner in (model, getattr(model, "policy", None)):
        space = getattr(owner, "action_space", None)
        if isinstance(space, spaces.Space):
            space.seed(seed)


def _parameters(function: Any) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):  # it is written in C
        return {}


def _arrays(state: Any) -> Iterator[Any]:
    if isinstance(state, tuple | list):
        for part in state:
            yield from _arrays(part)
    elif isinstance(state, dict):
        for part in state.values():
            yield from _arrays(part)
    else:
        yield state


def _nested(nesting: Any, arrays: Iterator[Array]) -> Any:
    if isinstance(nesting, dict):
        return {key: _nested(part, arrays) for key, part in nesting.items()}
    if isinstance(nesting, tuple | list):
        parts = [_nested(part, arrays) for part in nesting]
        named = hasattr(nesting, "_fields")
        return type(nesting)(*parts) if named else type(nesting)(parts)
    return next(arrays)

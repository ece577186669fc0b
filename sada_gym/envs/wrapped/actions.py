"""Actions of agents, validated against the action space of their environment."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from gymnasium import spaces

from sada_gym.errors import UserError, UserTypeError


def validate_action(action: Any, space: spaces.Space[Any], agent: str, where: str) -> Any:
    """Return an agent's action with its space's type: a Box action is clipped, others must fit.

    `agent` and `where` (the step and the episode) are for messages. It raises `UserError` if the
    action is of another shape, not finite, or no member of the space.
    """
    if isinstance(space, spaces.Discrete):
        return _validate_choice(action, space, agent, where)
    if action is None:
        raise UserTypeError(
            f"Expected an action from {agent}, got None at {where}. Return the action."
        )
    try:
        values = np.asarray(action, np.float64)
    except RuntimeError as error:  # a tensor of torch with a gradient
        raise UserTypeError(
            f"Expected an action of numbers from {agent}, got one that NumPy cannot read at "
            f"{where} ({error}). Return action.detach().cpu().numpy()."
        ) from error
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
        return clip_action(values, space)
    whole = values.astype(space.dtype)
    if (whole != values).any() or not space.contains(whole):
        raise UserError(
            f"Expected an action in {space} from {agent}, got {values.tolist()} at {where}."
        )
    return whole


def _validate_choice(action: Any, space: spaces.Discrete, agent: str, where: str) -> Any:
    try:
        number = operator.index(action)
    except TypeError:
        value = np.asarray(action)
        if value.shape or value.dtype.kind not in "fb" or value != np.floor(value):
            raise UserTypeError(
                f"Expected a whole number as the action of {agent}, got {action!r} at {where}. "
                "Return an int."
            ) from None
        number = int(value)
    if not space.start <= number < space.start + space.n:
        raise UserError(
            f"Expected an action of {agent} from {space.start} to {space.start + space.n - 1}, "
            f"got {number} at {where}."
        )
    return space.dtype.type(number)


def clip_action(action: Any, space: spaces.Space[Any]) -> Any:
    """Clip a Box action to its space, in the space's type; return other actions as they are."""
    if isinstance(space, spaces.Box):
        return np.asarray(action).clip(space.low, space.high).astype(space.dtype)
    return action

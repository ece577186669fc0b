"""Checks of the arguments of environments, scalar and vector ones alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from sada_gym.arrays import shaped
from sada_gym.errors import UserError, check_integer
from sada_gym.proposals import MAX_ENVS

MAX_TILE = 1_024
"""Larger tiles fill the memory with black images: 1,024 of 128 pixels take 200 MB."""


class RenderModes(list[str]):
    """The render modes of an environment; what is no string counts as one of them.

    `gymnasium.make` fails on such a mode before the environment can say what it expected.
    """

    def __contains__(self, mode: object) -> bool:
        """Say whether a mode is known, or is no mode at all."""
        return not isinstance(mode, str) or super().__contains__(mode)


def checked_render_mode(render_mode: str | None, known: Sequence[str]) -> str | None:
    """Give a render mode back.

    Raises:
        ValueError: If the mode is not known.
    """
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in known):
        raise UserError(f"Expected render_mode None or among {known}, got {render_mode!r}.")
    return render_mode


def checked_tile(tile: Any, network: str) -> int:
    """Give a tile back as an int.

    Args:
        tile: The number of images in one call of a network.
        network: The network's name in messages, such as `detector`.

    Raises:
        UserError: If it is no int from 1 to `MAX_TILE`.
    """
    whole = isinstance(tile, int | np.integer) and not isinstance(tile, bool)
    if not whole or not 1 <= tile <= MAX_TILE:
        raise UserError(
            f"Expected tile, the images in one call of the {network}, to be an int from 1 to "
            f"{MAX_TILE}, got {tile!r}."
        )
    return int(tile)


def refuse_training_mode(network: Any, kind: str) -> None:
    """Refuse a network that is in training mode, or has a part that is.

    Args:
        network: A torch module, or anything else, whose attribute `training` is checked.
        kind: The network's name in messages, such as `detector`.

    Raises:
        UserError: If it is in training mode.
    """
    import torch

    is_module = isinstance(network, torch.nn.Module)
    for name, part in network.named_modules() if is_module else [("", network)]:
        if getattr(part, "training", False):
            which = f" with its part {name} ({type(part).__name__})" if name else ""
            raise UserError(
                f"Expected a {kind} in evaluation mode, got {type(network).__name__}{which} in "
                "training mode, in which looking at images changes it. Call model.eval() first."
            )


def warn_without_render_mode() -> None:
    """Warn that nothing is drawn without a render mode."""
    gym.logger.warn(
        "render() draws nothing without a render mode. Make the environment with "
        "render_mode='rgb_array'."
    )


def checked_num_envs(num_envs: int) -> int:
    """Give a number of environments back.

    Raises:
        ValueError: If there are none.
    """
    whole = isinstance(num_envs, int) and not isinstance(num_envs, bool)
    if not whole or num_envs < 1:
        raise UserError(f"Expected at least one environment, got num_envs={num_envs!r}.")
    check_integer("num_envs", num_envs, 1, MAX_ENVS)
    return num_envs


def checked_actions(actions: Any, space: gym.Space[Any], what: str) -> npt.NDArray[Any]:
    """Give finite actions back as an array.

    Args:
        actions: One, or one an environment.
        space: The space that they belong to.
        what: `an action` or `actions`, for messages.

    Raises:
        ValueError: If they are of another shape or not finite numbers.
    """
    array = shaped(actions, space.shape, what, what.removeprefix("an "))
    if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
        raise UserError(f"Expected {what} of finite numbers, got {actions}.")
    return array


def check_number(name: str, given: Any, least: float, greatest: float) -> None:
    """Check that an argument is a number in a range.

    Raises:
        ValueError: If it is not a number from least to greatest.
    """
    if not is_number(given) or not least <= given <= greatest:
        raise UserError(f"Expected {name} from {least:g} to {greatest:g}, got {given!r}.")


def check_range(name: str, given: Any, least: float, greatest: float) -> None:
    """Check that an argument is a tuple of two numbers; ints if least and greatest are ints.

    Raises:
        ValueError: If it is not a tuple (low, high) between least and greatest.
    """
    whole = isinstance(least, int)
    if (
        not isinstance(given, tuple)
        or len(given) != 2
        or not all(isinstance(end, int) if whole else is_number(end) for end in given)
        or not least <= given[0] <= given[1] <= greatest
    ):
        raise UserError(
            f"Expected {name} to be a tuple of two {'ints' if whole else 'numbers'}, low and high, "
            f"from {least:g} to {greatest:g}, got {given!r}."
        )


def check_kind(name: str, given: Any, kind: type[Any]) -> None:
    """Check that an argument is an object of a class.

    Raises:
        ValueError: If its class is another one.
    """
    if not isinstance(given, kind):
        raise UserError(f"Expected {name} to be a {kind.__name__}, got {given!r}.")


def is_number(given: Any) -> bool:
    """Say whether an argument is a real number; True and False are none."""
    return isinstance(given, int | float | np.number) and not isinstance(given, bool)

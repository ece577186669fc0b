"""What environments check of what they are given, scalar and vector ones alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from sada_gym.application import validate_seeds
from sada_gym.errors import UserError

RESET_MASK = "reset_mask"

MAX_TILE = 1_024
"""Larger tiles fill the memory with black images: 1,024 of 128 pixels take 200 MB."""


class RenderModes(list[str]):
    """The render modes of an environment; what is no string counts as one of them.

    `gymnasium.make` fails on such a mode before the environment can say what it expected.
    """

    def __contains__(self, mode: object) -> bool:
        """Whether a mode is known, or is no mode at all."""
        return not isinstance(mode, str) or super().__contains__(mode)


def checked_render_mode(render_mode: str | None, known: Sequence[str]) -> str | None:
    """Give a render mode back.

    Raises:
        ValueError: If it is none of the known ones.
    """
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in known):
        raise UserError(f"Expected render_mode None or among {known}, got {render_mode!r}.")
    return render_mode


def checked_tile(tile: Any, network: str) -> int:
    """Give a tile back as an int.

    Args:
        tile: Images in one call of a network.
        network: What the message calls it, such as `detector`.

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
        network: A torch module; of anything else its attribute `training` is looked at.
        kind: What the message calls it, such as `detector`.

    Raises:
        UserError: If so.
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
    """Say why nothing is drawn."""
    gym.logger.warn(
        "render() draws nothing without a render mode. Make the environment with "
        "render_mode='rgb_array'."
    )


def checked_num_envs(num_envs: int) -> int:
    """Give a number of environments back.

    Raises:
        ValueError: If there are none.
    """
    if num_envs < 1:
        raise UserError(f"Expected at least one environment, got num_envs={num_envs}.")
    return num_envs


def checked_actions(actions: Any, space: gym.Space[Any], what: str) -> npt.NDArray[Any]:
    """Give finite actions back as an array.

    Args:
        actions: One, or one an environment.
        space: Of which shape they are to be.
        what: `an action` or `actions`, for messages.

    Raises:
        ValueError: If they are of another shape or not finite numbers.
    """
    shape = np.shape(actions)
    if shape != space.shape:
        raise UserError(f"Expected {what} of shape {space.shape}, got {shape}.")
    array = np.asarray(actions)
    if not np.issubdtype(array.dtype, np.number) or not np.isfinite(array).all():
        raise UserError(f"Expected {what} of finite numbers, got {actions}.")
    return array


def check_number(name: str, given: Any, least: float, greatest: float) -> None:
    """Check an argument that is one number.

    Raises:
        ValueError: If it is none from least to greatest.
    """
    if not _is_number(given) or not least <= given <= greatest:
        raise UserError(f"Expected {name} from {least:g} to {greatest:g}, got {given!r}.")


def check_range(name: str, given: Any, least: float, greatest: float) -> None:
    """Check an argument that is two numbers, whole ones where least and greatest are ints.

    Raises:
        ValueError: If they are no tuple from low to high between least and greatest.
    """
    whole = isinstance(least, int)
    if (
        not isinstance(given, tuple)
        or len(given) != 2
        or not all(isinstance(end, int) if whole else _is_number(end) for end in given)
        or not least <= given[0] <= given[1] <= greatest
    ):
        raise UserError(
            f"Expected {name} to be a tuple of two {'ints' if whole else 'numbers'}, low and high, "
            f"from {least:g} to {greatest:g}, got {given!r}."
        )


def check_kind(name: str, given: Any, kind: type[Any]) -> None:
    """Check an argument that is an object of a class.

    Raises:
        ValueError: If it is of another class.
    """
    if not isinstance(given, kind):
        raise UserError(f"Expected {name} to be a {kind.__name__}, got {given!r}.")


def _is_number(given: Any) -> bool:
    return isinstance(given, int | float | np.number) and not isinstance(given, bool)


def checked_seed(seed: int | None) -> int | None:
    """Give the seed of a reset back as a Python int.

    Raises:
        ValueError: If it is no int from 0 up.
    """
    return None if seed is None else validate_seeds([seed], 1, bounded=False)[0]


def spread_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Give each of `count` environments its seed: seed + i, or the i-th of a sequence.

    Raises:
        ValueError: If there is not one for each, or one is no int from 0 up.
    """
    if seed is None:
        return [None] * count
    if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
        (first,) = validate_seeds([seed], 1, bounded=False)
        return [first + i for i in range(count)]
    if len(seed) != count:
        raise UserError(
            f"Expected {count} seeds, one for each environment, got {len(seed)}. "
            "Pass an int to have them counted up from it."
        )
    return [checked_seed(one) for one in seed]


def check_reset_options(options: Mapping[str, Any] | None, known: Sequence[str] = ()) -> None:
    """Check the options of a reset.

    Gymnasium lets an environment ignore what it does not know. A misspelt mask or a seed among the
    options would then change nothing without a word.

    Raises:
        ValueError: If one is not among the known ones.
    """
    for name in options or {}:
        if name not in known:
            takes = f"reset options among {list(known)}" if known else "no reset options"
            hint = " Pass the seed as reset(seed=...)." if name == "seed" else ""
            raise UserError(f"Expected {takes}, got {name!r}.{hint}")


def reset_mask(options: dict[str, Any] | None, count: int) -> Sequence[int]:
    """Which of `count` environments are to be reset: those in `options["reset_mask"]`, or all.

    Raises:
        ValueError: If the mask is no array of bool, (count,), or there are other options.
    """
    check_reset_options(options, (RESET_MASK,))
    mask = (options or {}).get(RESET_MASK)
    if mask is None:
        return range(count)
    mask = np.asarray(mask)
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise UserError(
            f"Expected reset_mask of shape ({count},) and dtype bool, "
            f"got {mask.shape} and {mask.dtype}."
        )
    return [int(i) for i in np.flatnonzero(mask)]

"""Checks of arguments: ranges, which a dataclass states in its fields, tiles and networks."""

from __future__ import annotations

from dataclasses import field, fields
from typing import Any

import numpy as np

from sada_gym.errors import UserError

MAX_TILE = 1_024
"""Larger tiles fill the memory with black images: 1,024 of 128 pixels take 200 MB."""


def check_tile(tile: Any, network: str) -> int:
    """Return the number of images in one call of a network, an int from 1 to `MAX_TILE`.

    Raise `UserError` for anything else; `network` is its name there, such as `detector`.
    """
    whole = isinstance(tile, int | np.integer) and not isinstance(tile, bool)
    if not whole or not 1 <= tile <= MAX_TILE:
        raise UserError(
            f"Expected tile, the images in one call of the {network}, to be an int from 1 to "
            f"{MAX_TILE}, got {tile!r}."
        )
    return int(tile)


def check_evaluation_mode(network: Any, kind: str) -> None:
    """Raise `UserError` if a part of a network is in training mode; messages call it `kind`.

    Of anything but a torch module the attribute `training` is checked.
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


def check_number(name: str, given: Any, low: float, high: float) -> None:
    """Raise `UserError` if an argument is not a number from low to high."""
    if not is_number(given) or not low <= given <= high:
        raise UserError(f"Expected {name} from {low:g} to {high:g}, got {given!r}.")


def check_range(name: str, given: Any, low: float, high: float) -> None:
    """Raise `UserError` if an argument is no tuple of two numbers in order, from low to high.

    They must be ints if low is one.
    """
    whole = isinstance(low, int)
    if (
        not isinstance(given, tuple)
        or len(given) != 2
        or not all(isinstance(end, int) if whole else is_number(end) for end in given)
        or not low <= given[0] <= given[1] <= high
    ):
        raise UserError(
            f"Expected {name} to be a tuple of two {'ints' if whole else 'numbers'}, low and high, "
            f"from {low:g} to {high:g}, got {given!r}."
        )


def bounded(low: float, high: float, default: Any = None) -> Any:
    """Return a dataclass field whose range, low to high, `check_bounds` checks.

    The default is a number, by default the middle, or a tuple of two, see `check_range`.
    """
    middle = (low + high) / 2 if default is None else default
    return field(default=middle, metadata={"bounds": (low, high)})


def check_bounds(settings: Any) -> None:
    """Raise `UserError` if a `bounded` field of a dataclass's object is outside its range."""
    for setting in fields(settings):
        if "bounds" in setting.metadata:
            check = check_range if isinstance(setting.default, tuple) else check_number
            check(setting.name, getattr(settings, setting.name), *setting.metadata["bounds"])


def check_kind(name: str, given: Any, kind: type[Any]) -> None:
    """Raise `UserError` if an argument is not an object of a class."""
    if not isinstance(given, kind):
        raise UserError(f"Expected {name} to be a {kind.__name__}, got {given!r}.")


def has_nan(value: Any) -> bool:
    """Say whether an array, a number, or one in a dictionary or tuple of them, is NaN."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "f":
            return False
        flat = value.ravel()
        square = flat.dot(flat)  # of infinite numbers it is infinite; faster than isnan and any
        return bool(square != square)
    if isinstance(value, dict | tuple | list):
        return any(map(has_nan, value.values() if isinstance(value, dict) else value))
    return isinstance(value, float | np.floating) and bool(value != value)


def is_number(given: Any) -> bool:
    """Say whether an argument is a real number; True and False are none."""
    return isinstance(given, int | float | np.number) and not isinstance(given, bool)

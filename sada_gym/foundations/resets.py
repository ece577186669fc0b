"""Checks of the seeds and options of a reset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from sada_gym.errors import UserError, UserTypeError
from sada_gym.foundations.arrays import as_array
from sada_gym.foundations.seeds import validate_seeds

RESET_MASK = "reset_mask"


def validate_seed(seed: int | None) -> int | None:
    """Return the seed of a reset as a Python int; raise `UserError` if it is none from 0 up."""
    return None if seed is None else validate_seeds([seed], 1, bounded=False)[0]


def spread_seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return the seeds of `count` environments: seed + i, or the i-th of a sequence.

    It raises `UserError` if their number is another one, or one is not an int from 0 up.
    """
    if seed is None:
        return [None] * count
    scalar = isinstance(seed, np.ndarray) and seed.ndim == 0
    if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray) or scalar:
        (first,) = validate_seeds([cast("int", seed)], 1, bounded=False)
        return [first + i for i in range(count)]
    if len(seed) != count:
        raise UserError(
            f"Expected {count} seeds, one for each environment, got {len(seed)}. "
            "Pass an int to have them counted up from it."
        )
    return [validate_seed(value) for value in seed]


def check_reset_options(options: Mapping[str, Any] | None, known: Sequence[str] = ()) -> None:
    """Check that all options of a reset are known; Gymnasium would ignore a misspelt one."""
    if options is not None and not isinstance(options, Mapping):
        raise UserTypeError(f"Expected the options of a reset in a dictionary, got {options!r}.")
    for name in options or {}:
        if name not in known:
            expected = f"reset options among {list(known)}" if known else "no reset options"
            hint = " Pass the seed as reset(seed=...)." if name == "seed" else ""
            raise UserError(f"Expected {expected}, got {name!r}.{hint}")


def reset_mask(options: dict[str, Any] | None, count: int) -> Sequence[int]:
    """List which of `count` environments to reset: those in `options["reset_mask"]`, or all.

    It raises `UserError` if the mask is not a bool array (count,), or there are other options.
    """
    check_reset_options(options, (RESET_MASK,))
    mask = (options or {}).get(RESET_MASK)
    if mask is None:
        return range(count)
    mask = as_array(mask, RESET_MASK)
    if mask.shape != (count,) or mask.dtype != np.bool_:
        raise UserError(
            f"Expected reset_mask of shape ({count},) and dtype bool, "
            f"got {mask.shape} and {mask.dtype}."
        )
    return [int(i) for i in np.flatnonzero(mask)]

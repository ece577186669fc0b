"""Checks arrays that users hand over: what NumPy would misread raises an error."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError, UserTypeError

AnyFloats = npt.NDArray[np.floating[Any]]
Bools = npt.NDArray[np.bool_]
Bytes = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
Floats32 = npt.NDArray[np.float32]
Indices = npt.NDArray[np.intp]
Integers = npt.NDArray[np.int64]


def copied(value: Any) -> Any:
    """Return a deep copy, in a third of the time for arrays and what holds them."""
    if type(value) is np.ndarray and value.dtype != object:
        return value.copy()
    if type(value) is dict:
        return {key: copied(item) for key, item in value.items()}
    if type(value) is tuple:
        return tuple(map(copied, value))
    return value if isinstance(value, int | float | np.number) else deepcopy(value)


def check_unmasked(given: Any, what: str) -> None:
    """Raise `UserTypeError` for a masked array, or a list of rows with one among them.

    NumPy would drop the mask and count what it hides. `what` is a noun for messages: `mu`.
    """
    rows = given if isinstance(given, list | tuple) else [given]
    if any(np.ma.isMaskedArray(row) for row in rows):
        raise UserTypeError(
            f"Expected {what} without a mask, got a masked array, whose hidden values would count. "
            f"Fill it with {what}.filled(value)."
        )


def as_array(given: Any, what: str) -> npt.NDArray[Any]:
    """Return a user's array, of any dtype; raise `UserTypeError` if it has a mask or is ragged."""
    check_unmasked(given, what)
    try:
        return np.asarray(given)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged rows; a tensor with a gradient
        raise UserTypeError(
            f"Expected {what} to be an array of real numbers, got: {error}"
        ) from error


def real_numbers(given: Any, what: str) -> npt.NDArray[Any]:
    """Return a user's array of integers or floats; raise `UserTypeError` for anything else.

    NumPy would turn other types into numbers of another meaning.
    """
    array = as_array(given, what)
    if array.dtype.kind not in "iuf":
        raise UserTypeError(
            f"Expected {what} to be an array of real numbers, got dtype {array.dtype}. Convert it "
            f"with {what}.astype(numpy.float32)."
        )
    return array


def real_scores(given: Any, source: str) -> Floats:
    """Return scores from a user's code, the `source`, as float64; booleans count as 0 and 1.

    Raise `UserTypeError` if they have a mask or are no real numbers.
    """
    scores = as_array(given, "scores")
    if scores.dtype.kind not in "biuf":
        raise UserTypeError(
            f"Expected scores from {source} to be real numbers, got dtype {scores.dtype}: "
            f"{given!r}. Return floats."
        )
    return scores.astype(np.float64)


def validate_shape(
    given: Any, shape: tuple[int, ...] | None, what: str, noun: str = "mu"
) -> npt.NDArray[Any]:
    """Return an array of this shape; raise `UserError` if it is another one, ragged or masked.

    `what` is its name in messages on the shape: `an action` or `actions`; `noun` in others.
    """
    array = as_array(given, noun)
    if array.shape != shape:
        raise UserError(f"Expected {what} of shape {shape}, got {array.shape}.")
    return array

"""The check of the keys of scenes, places and shapes that are read from plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from sada_gym.errors import UserError


def check_keys(what: str, plain: Mapping[str, Any], names: Iterable[str]) -> None:
    """Check that plain data has exactly these keys.

    Args:
        what: What the data describes, for the message: `a scene`.
        plain: The data.
        names: The keys.

    Raises:
        UserError: If it is no mapping, a key is missing, or there is one that is not known.
    """
    expected = sorted(names)
    if not isinstance(plain, Mapping) or sorted(plain) != expected:
        got = ", ".join(map(str, plain)) if isinstance(plain, Mapping) else repr(plain)
        raise UserError(f"Expected {what} with the keys {', '.join(expected)}, got {got}.")

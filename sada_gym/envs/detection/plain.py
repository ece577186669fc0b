"""The check of the keys of scenes, places and shapes that are read from plain data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from sada_gym.errors import UserError


def check_keys(what: str, plain: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise `UserError` unless the plain data of `what`, such as `a scene`, has just these keys."""
    expected = sorted(names)
    if not isinstance(plain, Mapping) or sorted(plain) != expected:
        got = ", ".join(map(str, plain)) if isinstance(plain, Mapping) else repr(plain)
        raise UserError(f"Expected {what} with the keys {', '.join(expected)}, got {got}.")

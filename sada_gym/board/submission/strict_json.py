"""Refuses JSON from strangers that other programs may read differently."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sada_gym.errors import FileError
from sada_gym.foundations.files import read_file, shown


def check_strict_json(path: Path, max_bytes: int) -> None:
    """Raise a FileError for JSON that other programs may read differently, or that is none.

    It may hold a key twice, or a number that is infinite or beyond 64 bits.
    """
    content = read_file(path, max_bytes)
    cause: Exception
    try:
        json.loads(
            content.decode(),
            object_pairs_hook=_check_keys,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_bounded,
        )
        return
    except UnicodeDecodeError as error:
        expected, got, cause = "UTF-8", f"something else at byte {error.start}", error
    except RecursionError as error:
        expected, got, cause = "plain JSON", "one nested too deeply", error
    except ValueError as error:
        expected, got, cause = "plain JSON", f"something else: {shown(str(error))}", error
    raise FileError(f"Expected {expected} in {path}, got {got}. Make the entry anew.") from cause


def _check_keys(pairs: Sequence[tuple[str, Any]]) -> None:
    keys = set()
    for key, _ in pairs:
        if key in keys:
            raise ValueError(f"the key {key!r} twice")
        keys.add(key)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{text}, which is no finite number")
    return number


def _bounded(text: str) -> int:
    if len(text) > 20 or abs(int(text)) >= 2**63:
        raise ValueError("a whole number beyond 64 bits")
    return int(text)

"""Kernels compiled by numba that use constants and functions of one another's files.

Numba's cache notices changes in a kernel's own file only. A constant changed elsewhere would leave
it in force, and scores silently wrong. So these kernels are kept in a folder that is named by all
of the files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba as nb

_Function = TypeVar("_Function", bound=Callable[..., Any])
_HERE = Path(__file__).parent
_WORLD = _HERE / "envs" / "uav" / "world"
_SETTINGS: Any = nb.config


def sources_digest(folder: Path = _WORLD) -> str:
    """A short name for the state of the sources."""
    digest = hashlib.sha256()
    for file in sorted(folder.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays."""
    kept: str = _SETTINGS.CACHE_DIR
    folder = Path(kept) if kept else _HERE / "__pycache__"
    # where that can't be written to, numba takes a folder of the user's
    _SETTINGS.CACHE_DIR = str(folder / f"kernels-{_DIGEST}")
    try:
        compiled: Any = nb.njit(cache=True, nogil=True, error_model="numpy")(function)
    finally:
        _SETTINGS.CACHE_DIR = kept
    return cast(_Function, compiled)


_DIGEST = sources_digest()

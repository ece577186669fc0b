"""PyBullet, imported without the line that it prints when it is loaded."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from sada_gym.errors import MissingExtra, install_line


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Send what C code prints to standard error nowhere."""
    sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # it is closed
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


try:
    with _silent_stderr():
        import pybullet
except ModuleNotFoundError as error:
    raise MissingExtra(
        "Expected PyBullet for racing, but it is not installed: it has wheels for Python 3.11 and "
        "older. There it comes with sada-gym; elsewhere pip compiles it, which takes a C++ "
        f"compiler and ten minutes. {install_line('racing')}"
    ) from error

__all__ = ["pybullet"]

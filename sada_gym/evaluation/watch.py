"""Which world a worker process computes: the worker tells it, and its parent reads it.

Where a process dies or hangs, its parent so knows the world that did it.
"""

from __future__ import annotations

import os
import time
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

_IDLE = -1.0
_SIZE = 3
_place: Any = None
"""This process's part of the memory: its id, a world's key, and since when that is computed."""


def world_key(mu: npt.NDArray[np.float32], seed: int) -> int:
    """Return a number that tells a world, mu (d,) and its seed, from all others at work."""
    return seed << 20 | zlib.crc32(mu.tobytes()) >> 12


def shared_memory(context: Any, workers: int) -> Any:
    """Make the memory that so many workers of a multiprocessing context share with this process."""
    return context.RawArray("d", _SIZE * workers * [_IDLE])


def join(memory: Any, worker: int) -> None:
    """Tell the parent from now on, as the worker of this number."""
    global _place
    _place = memoryview(memory).cast("B").cast("d")[_SIZE * worker : _SIZE * (worker + 1)]
    _place[0] = os.getpid()


def is_watched() -> bool:
    """Return whether this process is such a worker."""
    return _place is not None


def begin(world: int) -> None:
    """Say that the world of a key is being computed."""
    if _place is not None:
        _place[2] = time.monotonic()
        _place[1] = world


def end() -> None:
    """Say that none is being computed."""
    if _place is not None:
        _place[1] = _IDLE


def worlds(memory: Any) -> dict[int, tuple[int, float]]:
    """Return the key of the world that each process computes, and for how many seconds, by id."""
    now = time.monotonic()
    rows = (memory[i : i + _SIZE] for i in range(0, len(memory), _SIZE))
    return {int(pid): (int(world), now - since) for pid, world, since in rows if world != _IDLE}

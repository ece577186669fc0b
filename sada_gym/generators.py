"""The process's global random generators, which libraries reseed and this package leaves alone."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def generators_kept() -> Iterator[None]:
    """Let a library seed Python's, NumPy's and torch's generators; afterwards they are as before.

    SB3 does so whenever a model with a seed is made or loaded.
    """
    import torch

    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the global one
    try:
        with torch.random.fork_rng():
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002

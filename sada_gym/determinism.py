"""Protects the state that libraries keep for a whole process: generators and torch's threads."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


@contextmanager
def generators_kept() -> Iterator[None]:
    """Restore Python's, NumPy's and torch's global generators after a library has seeded them.

    SB3 seeds them whenever a model with a seed is made or loaded.
    """
    import torch

    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the global one
    try:
        with torch.random.fork_rng():
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch compute in one thread, and restore the number of threads afterwards.

    Small networks gain nothing from more threads, and more threads give other last bits.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _one_thread_in_a_fork() -> None:
    """Let a forked process compute in one thread.

    OpenMP's threads do not survive the fork, and the process would wait for them for ever.
    """
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "set_num_threads"):  # else it is being imported
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_one_thread_in_a_fork)

"""What keeps scores repeatable: guarded generators, one thread of torch, agents asked twice."""

from __future__ import annotations

import os
import random
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from functools import lru_cache
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from sada_gym.errors import UserError


@contextmanager
def generators_kept() -> Iterator[None]:
    """Restore Python's, NumPy's and torch's global generators after other code has seeded them.

    SB3 seeds them whenever a model with a seed is made or loaded, and a user's agent may do so when
    it acts. Torch is left alone where nobody has imported it yet.
    """
    torch = sys.modules.get("torch")
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the global one
    try:
        with nullcontext() if torch is None else torch.random.fork_rng(_used_gpus(torch)):
            yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


def _used_gpus(torch: Any) -> Sequence[int]:
    # asking for the states of others would start an idle GPU
    return range(torch.cuda.device_count()) if torch.cuda.is_initialized() else ()


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


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let torch, BLAS and OpenMP compute in one thread, and restore their numbers afterwards.

    Evaluations run so in every process, as they do in worker processes. Agents and worlds ask for
    many small products. Threads that wait for one another take longer, many times longer where
    other programs need the cores, and more threads give other last bits.
    """
    # only the first caller sets the limit: a second one would restore the first one's
    first = _limiting.acquire(blocking=False)
    try:
        with ExitStack() as entered:
            if "torch" in sys.modules:
                entered.enter_context(one_thread())
            if first:
                entered.enter_context(_thread_pools(len(sys.modules)).limit(limits=1))
            yield
    finally:
        if first:
            _limiting.release()


_limiting = threading.Lock()


@lru_cache(maxsize=1)
def _thread_pools(modules: int) -> ThreadpoolController:  # noqa: ARG001
    # it takes milliseconds, so only where modules are new
    return ThreadpoolController()


def check_deterministic(
    agent: str,
    first: Sequence[Mapping[str, Any]],
    second: Sequence[Mapping[str, Any]],
    seeds: Sequence[int],
    hint: str = "",
) -> None:
    """Raise `UserError` if an agent's answers in the worlds of n seeds differed the second time.

    An answer is the score, and what else is known of a world: it must be equal to the last bit.
    `agent` is what messages call it; `hint` says what else may be the cause, a sentence.
    """
    for before, after, seed in zip(first, second, seeds, strict=True):
        for key in before:
            if not same_answer(before[key], after.get(key)):
                raise UserError(
                    f"Expected an agent that answers the same whenever it is asked, but {agent} "
                    f"gave the {key} {before[key]} and then {after.get(key)} in the same world "
                    f"(seed {seed}). Switch off what is random in it (a sampling policy: "
                    "deterministic=True; dropout: model.eval()), and let it remember nothing from "
                    f"one episode to the next.{hint and f' {hint}'}"
                )


def same_answer(first: Any, second: Any) -> bool:
    """Say whether two answers equal to the last bit, as far as they are data or arrays."""
    if isinstance(first, Mapping):
        return all(same_answer(first[key], second.get(key)) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same_answer, first, second))
    if isinstance(first, np.ndarray):
        return first.dtype == object or first.tobytes() == np.asarray(second).tobytes()
    if isinstance(first, int | float | str | np.generic):
        return bool(first == second or (first != first and second != second))
    return True


def _one_thread_in_a_fork() -> None:
    """Let a forked process compute in one thread.

    OpenMP's threads do not survive the fork, and the process would wait for them for ever.
    """
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "set_num_threads"):  # else it is being imported
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_one_thread_in_a_fork)

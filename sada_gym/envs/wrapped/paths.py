"""Paths of attributes, such as `model.body_mass[1]`: reading and setting what they name."""

from __future__ import annotations

import difflib
import re
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.errors import InvalidWorld, UserError, explained

_PART = re.compile(r"([A-Za-z_]\w*)((?:\[-?\d+\])*)")

MISSING = object()
"""What `read` returns where a path leads nowhere."""


def _steps(path: str) -> list[str | int]:
    steps: list[str | int] = []
    for part in path.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise UserError(
                f"Expected an attribute such as 'length', 'model.opt.timestep' or "
                f"'model.body_mass[1]', got {path!r}."
            )
        steps += [match[1], *map(int, re.findall(r"-?\d+", match[2]))]
    return steps


def _get(holder: Any, step: str | int) -> Any:
    try:
        return getattr(holder, step) if isinstance(step, str) else holder[step]
    except (AttributeError, IndexError, KeyError, TypeError):
        return MISSING


def read(env: Any, path: str) -> Any:
    """Return what a path names, or `MISSING`."""
    value = env
    for step in _steps(path):
        value = _get(value, step)
    return value


def write(env: Any, path: str, value: Any, *, must_exist: bool) -> None:
    """Set a value where it is not set yet; unless it must exist, a missing one is left alone.

    It raises `UserError` if the path leads nowhere, or cannot be set.
    """
    first, *_ = steps = _steps(path)
    if len(steps) > 1 and isinstance(first, str) and first not in vars(env):
        shared = getattr(type(env), first, None)
        if isinstance(shared, list | dict | np.ndarray):  # of the class: other episodes share it
            setattr(env, first, deepcopy(shared))
    holder, last = env, steps[-1]
    for step in steps[:-1]:
        holder = _get(holder, step)
    current = _get(holder, last)
    if current is MISSING:
        if must_exist:
            raise UserError(
                f"Expected {path!r} to exist in every episode, but it is missing in one. Set it "
                "by a function of your own, Function(low, high, set=...)."
            )
        return
    if must_exist and current == value:
        return
    mend = "Name another attribute, or set it by Function(low, high, set=...)."
    with explained(f"Expected {path!r} to be settable to {value!r}", mend, InvalidWorld):
        if isinstance(last, str):
            setattr(holder, last, value)
        else:
            holder[last] = value


def no_such_path(name: str, path: str, factory: EnvFactory, env: gym.Env[Any, Any]) -> UserError:
    """Return the error for an attribute that does not exist; it lists what there is."""
    world = env.unwrapped
    numbers = [
        key
        for key in dir(world)
        if not key.startswith("_") and is_number(getattr(world, key, None))
    ]
    near = difflib.get_close_matches(path, {*factory.keywords, *numbers}, n=3)
    hint = f" Did you mean {' or '.join(near)}?" if near else ""
    return UserError(
        f"Expected parameter {name!r} to be a keyword of {factory.name}'s constructor or an "
        f"attribute of env.unwrapped, found no {path!r}.{hint} Keywords: "
        f"{', '.join(factory.keywords) or 'none'}. Attributes that are numbers: "
        f"{', '.join(numbers) or 'none'}. Other bindings need a form of their own, such as "
        "ResetOption(low, high)."
    )

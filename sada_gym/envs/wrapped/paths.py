"""Paths of attributes, such as `model.body_mass[1]`: what they name is read, set and scaled."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from copy import deepcopy
from functools import cache, reduce
from typing import Any

import gymnasium as gym
import numpy as np

from sada_gym.envs.checks import is_number
from sada_gym.envs.wrapped.factory import EnvFactory
from sada_gym.envs.wrapped.served import ServedEnv
from sada_gym.errors import InvalidWorld, UserError, explained
from sada_gym.foundations.arrays import Bools
from sada_gym.foundations.serve_environment import MISSING, assign, follow

_NAME = re.compile(r"[A-Za-z_]\w*")
_ENTRY = re.compile(r"""\[(?:"([^"]*)"|'([^']*)'|([^\]\["']*))\]""")
_INDEX = re.compile(r"\s*(-?\d+)?\s*(?:(:)\s*(-?\d+)?\s*(?::\s*(-?\d+)?)?)?\s*")

_ALL = np.ones((), np.bool_)
_CONTAINERS = (list, dict, np.ndarray)
_BEFORE_RESET = "_sada_gym_before_reset"
_CHANGED = "_sada_gym_changed_by_reset"


@cache
def _steps(path: str) -> tuple[Any, ...]:
    """Split a path into names and `(key,)` of brackets: a key, an index, a slice, or a tuple."""
    steps: list[Any] = []
    rest = f".{path}"
    while rest:
        name = _NAME.match(rest, 1) if rest[0] == "." else None
        entry = _ENTRY.match(rest) if steps else None
        match = name or entry
        if match is None:
            raise _no_path(path)
        steps.append(match[0] if entry is None else (_place(entry, path),))
        rest = rest[match.end() :]
    return tuple(steps)


def _place(entry: re.Match[str], path: str) -> Any:
    key = entry[1] if entry[1] is not None else entry[2]
    if key is not None:
        return key
    places: list[int | slice] = []
    for text in entry[3].split(","):
        match = _INDEX.fullmatch(text)
        if match is None or not text.strip() or int(match[4] or 1) == 0:
            raise _no_path(path)
        first, stop, step = (None if n is None else int(n) for n in match.group(1, 3, 4))
        places.append(slice(first, stop, step) if match[2] else int(match[1]))
    return places[0] if len(places) == 1 else tuple(places)


def _no_path(path: str) -> UserError:
    return UserError(
        "Expected an attribute such as 'length', 'model.opt.timestep', 'model.body_mass[1]', "
        f"'model.geom_friction[:,0]' or 'params[\"mass\"]', got {path!r}."
    )


def read(env: Any, path: str) -> Any:
    """Return what a path names, or `MISSING`.

    A name after a dot is an attribute, or the entry of that name where a dictionary holds it.
    """
    steps = _steps(path)
    return env.read_steps(steps) if isinstance(env, ServedEnv) else reduce(follow, steps, env)


def held(world: Any) -> dict[str, Any]:
    """Return the attributes of an object, in another process those that are numbers."""
    if isinstance(world, ServedEnv):
        return {name: read(world, name) for name in world.numbers}
    return {**vars(world)}


def plain_path(path: str) -> str:
    """Write `config["mass"]` as `config.mass`, which names the same."""
    return re.sub(r"""\[["']([A-Za-z_]\w*)["']\]""", r".\1", path)


def passed(env: Any, path: str) -> list[Any]:
    """Return the objects on the way to what a path names, which others may hold, too.

    None stands for what the class holds: `write` and `scale` copy it.
    """
    if isinstance(env, ServedEnv):  # its server knows
        return []
    first, *rest = _steps(path)
    value = follow(env, first)
    if isinstance(first, str) and first not in vars(env) and isinstance(value, _CONTAINERS):
        return []
    values = [value]
    for step in rest:
        values.append(value := follow(value, step))
    return values if isinstance(value, _CONTAINERS) else values[:-1]


def names_several(path: str) -> bool:
    """Say whether a path ends in a slice, as in `model.body_mass[:]`."""
    last = _steps(path)[-1]
    at = last[0] if isinstance(last, tuple) else None
    return any(isinstance(i, slice) for i in (at if isinstance(at, tuple) else [at]))


def write(env: Any, path: str, value: Any, *, must_exist: bool) -> None:
    """Set a value where it is not set yet; unless it must exist, a missing one is left alone.

    All entries of a slice get the value. It raises `UserError` if the path leads nowhere, or cannot
    be set.
    """
    current = _current(env, path, must_exist=must_exist)
    if current is not MISSING and not (must_exist and np.all(_equal(current, value))):
        _set(env, path, _filled(current, value) if names_several(path) else value)


def scale(env: Any, path: str, factor: float, *, after_reset: bool) -> None:
    """Multiply what a path names by a factor, before a reset and once more where that changed it.

    Several factors may act on one value; each acts once.
    """
    current = _current(env, path, must_exist=after_reset)
    if current is MISSING:
        return
    if not after_reset:
        _set(env, path, _scaled(current, factor, _ALL))
        noted: dict[str, Any] = vars(env).setdefault(_BEFORE_RESET, {})
        noted[path] = None
        noted.update({known: deepcopy(read(env, known)) for known in noted})
        return
    if _CHANGED not in vars(env):  # before the first factor acts
        noted = vars(env).get(_BEFORE_RESET, {})
        changed = {known: ~_equal(read(env, known), old) for known, old in noted.items()}
        setattr(env, _CHANGED, changed)
    is_new = vars(env)[_CHANGED].get(path, _ALL)
    if np.any(is_new):
        _set(env, path, _scaled(current, factor, is_new))


def scaled(value: Any, factor: float) -> Any:
    """Return what a path named, multiplied by a factor."""
    return _scaled(value, factor, _ALL)


def restore(env: Any, first: Mapping[str, Any]) -> None:
    """Set again what paths named at first, and forget the factors that acted since."""
    for mark in (_BEFORE_RESET, _CHANGED):
        vars(env).pop(mark, None)
    for path, value in first.items():
        if value is MISSING:
            vars(env).pop(path, None)
        elif read(env, path) is not MISSING:
            _set(env, path, deepcopy(value))


def _current(env: Any, path: str, *, must_exist: bool) -> Any:
    current = read(env, path)
    if current is MISSING and must_exist:
        raise UserError(
            f"Expected {path!r} to exist in every episode, but it is missing in one. Set it "
            "by your own function, Function(low, high, set=...)."
        )
    return current


def _set(env: Any, path: str, value: Any) -> None:
    fix = "Name another attribute, or set it by Function(low, high, set=...)."
    with explained(f"Expected {path!r} to be settable to {value!r}", fix, InvalidWorld):
        if isinstance(env, ServedEnv):
            env.write_steps(_steps(path), value)
        else:
            assign(env, _steps(path), value)


def _has_many(value: Any) -> bool:
    return isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim > 0)


def _filled(current: Any, value: Any) -> Any:
    return [_filled(item, value) for item in current] if isinstance(current, list) else value


def _scaled(current: Any, factor: float, where: Bools) -> Any:
    if isinstance(current, list):
        # where it is a single truth, it holds for all
        parts = np.broadcast_to(where, np.shape(current))
        return [_scaled(item, factor, part) for item, part in zip(current, parts, strict=True)]
    if isinstance(current, np.ndarray) and current.ndim:
        return np.where(where, current * factor, current)
    return current * factor if where else current


def _equal(current: Any, value: Any) -> Bools:
    """Say of each entry of a list or an array, or of one value, whether it is equal."""
    if _has_many(current):
        return np.asarray(np.asarray(current) == value, np.bool_)
    return np.asarray(bool(np.all(current == value)))


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

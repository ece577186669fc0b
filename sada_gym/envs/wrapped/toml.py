"""An application in a TOML file, so that an agent is attacked without a line of Python."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from sada_gym.envs.wrapped import disturbances, places
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.errors import UserError, UserTypeError, check_known
from sada_gym.files import as_path, read_toml

KINDS: Mapping[str, type[places.Place]] = {
    "keyword": places.Keyword,
    "attribute": places.Attribute,
    "reset-option": places.ResetOption,
    "config": places.Config,
    "observation-noise": disturbances.ObservationNoise,
    "observation-delay": disturbances.ObservationDelay,
    "observation-dropout": disturbances.ObservationDropout,
    "action-noise": disturbances.ActionNoise,
    "action-delay": disturbances.ActionDelay,
    "action-gain": disturbances.ActionGain,
    "repeated-actions": disturbances.RepeatedActions,
}
"""The `kind` of a parameter's table, and the place whose fields its other keys are."""


@dataclass(frozen=True)
class _Type:
    """What the value of a key can be.

    Attributes:
        kinds: Python's types.
        words: What messages call them.
    """

    kinds: tuple[type, ...]
    words: str

    def fits(self, value: Any) -> bool:
        """Say whether a value is one; a boolean is no number."""
        return isinstance(value, self.kinds) and (bool in self.kinds or not isinstance(value, bool))


_TEXT = _Type((str,), 'a text in quotes, such as "a"')
_NUMBER = _Type((int, float), "a number")
_WHOLE = _Type((int,), "a whole number")
_BOOL = _Type((bool,), "true or false")
_TABLE = _Type((dict,), "a table")
_ARRAY = _Type((list,), "an array, such as [1, 2]")

_KEYS = {
    "environment": _TEXT,
    "agent": _TEXT,
    "parameters": _TABLE,
    "score": _Type((str, list), '["return", low, high], ["length", most] or "success"'),
    "fooling_threshold": _NUMBER,
    "episodes": _WHOLE,
    "sample_size": _WHOLE,
    "max_steps": _WHOLE,
    "env_kwargs": _TABLE,
    "name": _TEXT,
    "agent_id": _TEXT,
    "trust": _BOOL,
    "statistics": _TEXT,
}
_REQUIRED = ("environment", "agent", "parameters", "score", "fooling_threshold")
_PLACE_KEYS = {
    "low": _NUMBER,
    "high": _NUMBER,
    "unit": _TEXT,
    "choices": _ARRAY,
    "integer": _BOOL,
    "name": _TEXT,
    "paths": _Type((str, list), 'a path in quotes or an array of them, such as ["a", "b[1]"]'),
    "key": _TEXT,
    "entries": _ARRAY,
}


def read_application(path: str | Path) -> GymnasiumApplication:
    """Read a TOML file that describes an application.

    Its keys are the arguments of `GymnasiumApplication`. A parameter is an array `[low, high]`, or
    a table with a `kind` of `KINDS` and that place's fields. Paths in it are relative to its
    folder. An agent that is no `.zip` is `module:object`, which is imported.

    Args:
        path: The TOML file.

    Raises:
        FileError: If the file is missing or no TOML.
        UserError: If a key is unknown or missing, a value has the wrong type, or the application
            refuses it.
    """
    path = as_path(path, "a TOML file")
    table = read_toml(path)
    check_known(f"key in {path}", table, [*_KEYS])
    missing = [key for key in _REQUIRED if key not in table]
    if missing:
        raise UserError(f"Expected the key {missing[0]!r} in {path}, got none. Add it to the file.")
    _check_types(table, _KEYS, path)
    given: dict[str, Any] = {**table, "agent": _agent(table["agent"], path)}
    given["parameters"] = {
        name: _place(name, value, path) for name, value in table["parameters"].items()
    }
    if "statistics" in table:
        given["statistics"] = path.parent / table["statistics"]
    return GymnasiumApplication(given.pop("environment"), **given)


def _check_types(
    table: Mapping[str, Any], types: Mapping[str, _Type], path: Path, of: str = ""
) -> None:
    for key, value in table.items():
        if not types[key].fits(value):
            raise UserTypeError(
                f"Expected {key!r}{of} in {path} to be {types[key].words}, got {value!r}."
            )


def _agent(text: str, path: Path) -> Any:
    """Give the path of an SB3 zip, or the object that `module:object` names."""
    module, colon, name = text.rpartition(":")
    if text.endswith(".zip") or not colon:
        return path.parent / text
    try:
        return getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        raise UserError(
            f"Expected 'agent' in {path} to be an SB3 zip or module:object, got {text!r} "
            f"({type(error).__name__}: {error}). Set PYTHONPATH to the folder that holds the "
            "module."
        ) from error


def _place(name: str, value: Any, path: Path) -> Any:
    """Give a parameter's (low, high) or its place."""
    if isinstance(value, list):
        if len(value) != 2 or not all(map(_NUMBER.fits, value)):
            raise UserTypeError(
                f"Expected parameter {name!r} in {path} to be [low, high], got {value!r}."
            )
        return tuple(value)
    if not isinstance(value, dict):
        raise UserTypeError(
            f"Expected parameter {name!r} in {path} to be [low, high] or a table with a kind, got "
            f"{value!r}."
        )
    of = f" of parameter {name!r}"
    kind = value.get("kind")
    check_known(f"kind{of} in {path}", [kind], [*KINDS])
    place = KINDS[str(kind)]
    rest = {key: one for key, one in value.items() if key != "kind"}
    check_known(f"key{of} in {path}", rest, ["kind", *_fields(place)])
    _check_types(rest, _PLACE_KEYS, path, of)
    return place(**{key: _frozen(one) for key, one in rest.items()})


def _fields(place: type[places.Place]) -> Iterable[str]:
    return (one.name for one in fields(place))


def _frozen(value: Any) -> Any:
    """Turn arrays into tuples, which frozen places hold."""
    return tuple(map(_frozen, value)) if isinstance(value, list) else value

"""An application in a TOML file, so that an agent is attacked without a line of Python.

Keys and their types are those of the Python classes: arguments of `GymnasiumApplication`, and
fields of the bindings.
"""

from __future__ import annotations

import filecmp
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from datetime import date, time
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from sada_gym.agents.agent_files import SUFFIXES
from sada_gym.agents.built_in import BUILT_IN
from sada_gym.agents.remote.places import place_of
from sada_gym.application import Application
from sada_gym.envs.wrapped import bindings, camera, disturbances, events, forces
from sada_gym.envs.wrapped.application import GymnasiumApplication
from sada_gym.envs.wrapped.served import server_of
from sada_gym.errors import UserError, UserTypeError, check_known, described
from sada_gym.foundations.files import as_path, read_toml
from sada_gym.foundations.lazy import load

KINDS: Mapping[str, type[bindings.ParameterBinding]] = {
    re.sub(r"(?<!^)(?=[A-Z])", "-", kind.__name__).lower(): kind
    for kind in (
        bindings.Keyword,
        bindings.Attribute,
        bindings.ResetOption,
        bindings.Config,
        bindings.Function,
        disturbances.ObservationNoise,
        disturbances.ObservationBias,
        disturbances.ObservationDrift,
        disturbances.ObservationDelay,
        disturbances.ObservationDropout,
        disturbances.ActionNoise,
        disturbances.ActionDelay,
        disturbances.ActionGain,
        disturbances.RepeatedActions,
        forces.Wind,
        forces.Push,
        forces.Force,
        events.Event,
        events.SensorFailure,
        events.ActuatorFailure,
        events.RealTime,
        camera.CameraFault,
    )
}
"""The `kind` of a parameter's table, and the binding whose fields its other keys are."""

_CALLING = (bindings.Function, forces.Force, events.Event)
"""The kinds that call a function, which a file names by `module:function`."""

_WORDS: Mapping[type, str] = {
    str: 'a text in quotes, such as "a"',
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    dict: "a table",
    list: "an array, such as [1, 2]",
}
_TOML_TYPES = {
    **{kind: kind for kind in _WORDS},
    Path: str,
    tuple: list,
    Sequence: list,
    Mapping: dict,
}
_WORDS_OF_KEYS = {
    "score": '["return", low, high], ["length", maximum], "success", ["success", key] or a table '
    "of these by name",
    "max_steps": "a whole number",
    "environment": "a text in quotes, or a command as an array of texts",
    "agent": "a text in quotes, or a command as an array of texts",
    "privileged": "a text in quotes, or a command as an array of texts",
    "vec_normalize": "the path of a file in quotes, or false",
    "paths": 'a path in quotes or an array of them, such as ["a", "b[1]"]',
}
_TEXTS = {"max_steps": ("own",)}
"""The texts that stand beside another type."""

_WHOLE = 2**63
_NAMES = {"VecNormalize": object}
"""Names that only type checkers load."""


def read_application(path: str | Path, *, agent: Any = None) -> Application:
    """Read a TOML file that describes an application.

    Its keys are the arguments of `GymnasiumApplication`, or those of `ImageApplication` in a file
    with the key `images`. A parameter is an array `[low, high]`, or a table with the `kind` of a
    binding, such as `observation-noise`, and that binding's arguments. Paths in the file are
    relative to its folder. An agent `module:object` is imported, also from that folder.

    Args:
        path: The TOML file.
        agent: An agent in place of the file's, which is then ignored.

    Raises:
        FileError: If the file is missing or not TOML.
        UserError: If a key is unknown or missing, a value has the wrong type, or the application
            raises it.
    """
    path = as_path(path, "a TOML file")
    return application_of(read_toml(path), path, agent=agent)


def find_modules_in(folder: Path) -> None:
    """Let modules be imported from a folder, behind all others."""
    place = str(folder.absolute())
    if place not in sys.path:
        sys.path.append(place)


def application_of(table: Mapping[str, Any], path: Path, *, agent: Any = None) -> Application:
    """Make the application that the table of a TOML file describes, see `read_application`.

    Paths in the table are relative to the folder of `path`, which need not exist.
    """
    find_modules_in(path.parent)
    if "images" in table:
        images: Application = load("sada_gym.envs.images.toml:images_of")(table, path, agent)
        return images
    table = checked_table(table, path, *application_keys(), agent)
    server = server_of(table["environment"], path.parent)
    if server is None:
        _check_own(table["environment"], path)
    agents = {key: table[key] for key in ("agent", "privileged") if key in table}
    arguments: dict[str, Any] = {
        **table,
        **{key: agent_of(given, path, key) for key, given in agents.items()},
    }
    if agent is not None:
        arguments["agent"] = agent
    if "valid" in table:
        arguments["valid"] = imported(table["valid"], path, "valid", "module:function")
    arguments["parameters"] = {
        name: binding_of(name, value, path) for name, value in table["parameters"].items()
    }
    if isinstance(table.get("vec_normalize"), str):
        arguments["vec_normalize"] = path.parent / os.path.expanduser(table["vec_normalize"])
    environment = arguments.pop("environment")
    return GymnasiumApplication(environment if server is None else server, **arguments)


def checked_table(
    table: Mapping[str, Any],
    path: Path,
    keys: Mapping[str, Sequence[type]],
    required: Sequence[str],
    agent: Any,
) -> dict[str, Any]:
    """Return a file's table, without its agent where another one is given.

    It raises `UserError` for a key that is unknown or missing, and for a value of the wrong type.
    """
    check_known(f"key in {path}", table, [*keys])
    # statistics beside the file's agent are not another one's
    unused = () if agent is None else ("agent", "vec_normalize")
    kept = {key: value for key, value in table.items() if key not in unused}
    missing = [key for key in required if key not in kept and key not in unused]
    if missing:
        raise UserError(f"Expected the key {missing[0]!r} in {path}, got none. Add it to the file.")
    check_values(kept, path)
    check_types(kept, keys, path)
    return kept


def application_keys() -> tuple[dict[str, list[type]], list[str]]:
    """Return the types of the keys of a file, and the keys that are required."""
    texts = str | list[str]
    return argument_keys(
        GymnasiumApplication,
        environment=texts,
        agent=texts,
        privileged=texts,
        valid=str,
        feasible=texts,
    )


def argument_keys(kind: Any, **others: Any) -> tuple[dict[str, list[type]], list[str]]:
    """Return the types in TOML of a class's arguments, and those that are required.

    `others` are the annotations of what a file writes otherwise than Python does.
    """
    constructor: Any = kind.__init__
    hints = {**get_type_hints(constructor, localns=_NAMES), **others}
    arguments = [*inspect.signature(kind).parameters.values()]
    required = [argument.name for argument in arguments if argument.default is argument.empty]
    return {argument.name: toml_types(hints[argument.name]) for argument in arguments}, required


def binding_keys(kind: type[bindings.ParameterBinding]) -> dict[str, list[type]]:
    """Return the types of the keys in a parameter's table, besides its `kind`."""
    hints = get_type_hints(kind)
    return {field.name: toml_types(hints[field.name]) or [str] for field in fields(kind)}


def binding_of(name: str, value: Any, path: Path) -> Any:
    """Return a parameter's (low, high) or its binding; raise `UserError` if a value is neither."""
    if isinstance(value, list):
        if len(value) != 2 or not all(_fits(number, [float]) for number in value):
            raise UserTypeError(
                f"Expected parameter {name!r} in {path} to be [low, high], got {value!r}."
            )
        return tuple(value)
    if not isinstance(value, dict):
        raise UserTypeError(
            f"Expected parameter {name!r} in {path} to be [low, high] or a table with a kind, got "
            f"{value!r}."
        )
    parameter = f" of parameter {name!r}"
    if (kind := value.get("kind")) is None:
        raise UserError(
            f'Expected the kind{parameter} in {path}, got none. Write kind = "keyword" for an '
            'argument of the environment, kind = "attribute" for an attribute of it, or one of '
            f"{', '.join([*KINDS][2:])}."
        )
    check_known(f"kind{parameter} in {path}", [kind], [*KINDS])
    binding = KINDS[str(kind)]
    keys = binding_keys(binding)
    arguments = {key: argument for key, argument in value.items() if key != "kind"}
    check_known(f"key{parameter} in {path}", arguments, ["kind", *keys])
    check_types(arguments, keys, path, parameter)
    given = {key: _as_tuples(argument) for key, argument in arguments.items()}
    for key in ("set", "apply"):
        if key in given and binding in _CALLING:
            given[key] = imported(given[key], path, key, "module:function")
    return binding(**given)


def toml_types(hint: Any) -> list[type]:
    """Return the types that a value of an annotation has in TOML."""
    origin = get_origin(hint) or hint
    if origin is Literal:
        return [*dict.fromkeys(type(value) for value in get_args(hint))]
    if origin is Union or origin is UnionType:
        types = [kind for part in get_args(hint) for kind in toml_types(part)]
        return [*dict.fromkeys(types)]
    return [_TOML_TYPES[origin]] if origin in _TOML_TYPES else []


def _fits(value: Any, types: Sequence[type]) -> bool:
    if isinstance(value, bool):
        return bool in types
    return isinstance(value, tuple(types)) or (isinstance(value, int) and float in types)


def check_values(table: Mapping[str, Any], path: Path) -> None:
    """Raise `UserError` for dates and for whole numbers that TOML does not have, however deep."""
    parts: list[Any] = [table]
    while parts:
        part = parts.pop()
        if isinstance(part, dict | list):
            parts += part.values() if isinstance(part, dict) else part
        elif isinstance(part, date | time):
            raise UserTypeError(
                f"Expected no dates or times in {path}, got {part}. Write a text in quotes."
            )
        elif isinstance(part, int) and not -_WHOLE <= part < _WHOLE:
            raise UserError(
                f"Expected whole numbers of 64 bits in {path}, got one of {part.bit_length() + 1} "
                "bits. Write a smaller one, or a number with a point."
            )


def check_types(
    table: Mapping[str, Any], keys: Mapping[str, Sequence[type]], path: Path, parameter: str = ""
) -> None:
    """Raise `UserError` for a value of a type that its key does not take."""
    for key, value in table.items():
        texts = _TEXTS.get(key, ())
        is_other = isinstance(value, str) and texts and value not in texts
        if is_other or not _fits(value, keys[key]):
            words = _WORDS_OF_KEYS.get(key) or " or ".join(_WORDS[kind] for kind in keys[key])
            if is_other:
                words += f" or {' or '.join(map(repr, texts))}"
            raise UserTypeError(
                f"Expected {key!r}{parameter} in {path} to be {words}, got {value!r}."
            )


def agent_of(text: str | list[Any], path: Path, key: str = "agent") -> Any:
    """Return the agent that a file names: where it is, or the imported object."""
    if text == BUILT_IN:
        return text
    place = place_of(text, path.parent)
    if place is not None or isinstance(text, list):
        return place
    file = path.parent / os.path.expanduser(text)
    if file.suffix.lower() in SUFFIXES or ":" not in text:
        return file
    return imported(text, path, key, "an agent's file or module:object")


def imported(text: str, path: Path, key: str, expected: str) -> Any:
    """Import what `module:name` names; raise `UserError` where that fails."""
    module, _, name = text.rpartition(":")
    _check_own(text, path)
    try:
        return getattr(importlib.import_module(module), name)
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        raise UserError(
            f"Expected {key!r} in {path} to be {expected}, got {text!r} "
            f"({described(error)}). Put the module beside the file, or set PYTHONPATH to the "
            "folder that holds it."
        ) from error


def _check_own(text: str, path: Path) -> None:
    """Refuse a `module:name` whose module lies beside the file, where another one is imported."""
    top, *rest = re.split(r"[.:]", text)
    files = [path.parent / f"{top}.py", path.parent / top / "__init__.py"]
    own = [os.path.realpath(file) for file in files if rest and os.path.isfile(file)]
    found = str(getattr(importlib.util.find_spec(top), "origin", None) or "") if own else ""
    is_other = found and os.path.realpath(found) not in own
    if is_other and not (own[0].endswith(f"{top}.py") and _equal(found, own[0])):  # a copy may be
        raise UserError(
            f"Expected the module {top!r} of {path} to be {own[0]}, got {found}, which has the "
            "same name. Rename one of them."
        )


def _equal(one: str, other: str) -> bool:
    return os.path.isfile(one) and filecmp.cmp(one, other, shallow=False)


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value

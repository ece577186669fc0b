"""The environments' ids: one table, registered with Gymnasium when `sada_gym` is imported."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from sada_gym.application import Application
from sada_gym.errors import UserError, UserTypeError


@dataclass(frozen=True)
class Registration:
    """One row of the table.

    Attributes:
        id: The environment's id, with its version.
        entry_point: `module:class` of the scalar environment; a string, so that nothing is loaded.
        vector_entry_point: `module:class` of the native batched environment.
        kwargs: Keywords that the id fixes; an id that fixes some is a track of the leaderboard.
    """

    id: str
    entry_point: str
    vector_entry_point: str
    kwargs: Mapping[str, Any] = field(default_factory=dict)


def _track(application: str, suffix: str = "", **kwargs: Any) -> Registration:
    module = f"sada_gym.envs.{application.lower()}"
    return Registration(
        id=f"SADA-{application}{suffix}-v0",
        entry_point=f"{module}:{application}Env",
        vector_entry_point=f"{module}:{application}VectorEnv",
        kwargs=kwargs,
    )


TABLE: tuple[Registration, ...] = (
    _track("Analytic"),
    _track("Detection"),
    _track("Detection", "-Aeroplane", object_class="aeroplane"),
    _track("Detection", "-Bench", object_class="bench"),
    _track("Detection", "-Bicycle", object_class="bicycle"),
    _track("Detection", "-Boat", object_class="boat"),
    _track("Detection", "-Bottle", object_class="bottle"),
    _track("Detection", "-Bus", object_class="bus"),
    _track("Detection", "-Car", object_class="car"),
    _track("Detection", "-Chair", object_class="chair"),
    _track("Detection", "-DiningTable", object_class="diningtable"),
    _track("Detection", "-Motorbike", object_class="motorbike"),
    _track("Detection", "-Train", object_class="train"),
    _track("Detection", "-Truck", object_class="truck"),
    _track("Driving"),
    _track("Driving", "-Straight", task="straight"),
    _track("Driving", "-OneCurve", task="one_curve"),
    _track("Driving", "-Navigation", task="navigation"),
    _track("UAV"),
    _track("UAV", "-3Anchors", anchors=3),
    _track("UAV", "-4Anchors", anchors=4),
    _track("UAV", "-5Anchors", anchors=5),
    _track("Digits"),
    *(_track("Digits", f"-{digit}", digit=digit) for digit in range(10)),
    _track("Pixel"),
)

INNER_TASKS: tuple[Registration, ...] = (
    Registration(
        id="SADA-DrivingTask-v0",
        entry_point="sada_gym.envs.driving:DrivingTaskEnv",
        vector_entry_point="sada_gym.envs.driving:DrivingTaskVectorEnv",
    ),
    Registration(
        id="SADA-RacingTask-v0",
        entry_point="sada_gym.envs.uav:RacingTaskEnv",
        vector_entry_point="sada_gym.envs.uav:RacingTaskVectorEnv",
    ),
)
"""What the agents under attack are trained on: no adversary environments."""


def register_environments() -> None:
    """Register the whole table with Gymnasium; doing it again changes nothing."""
    for row in (*TABLE, *INNER_TASKS):
        if row.id not in gym.registry:
            gym.register(
                id=row.id,
                entry_point=row.entry_point,
                vector_entry_point=row.vector_entry_point,
                kwargs=dict(row.kwargs),
            )


def env_ids() -> tuple[str, ...]:
    """Give this package's ids, in the table's order."""
    return tuple(row.id for row in TABLE)


def tracks() -> tuple[str, ...]:
    """Give the leaderboard's tracks: the ids that fix their keywords, in the table's order."""
    return tuple(row.id for row in TABLE if row.kwargs)


def find_spec(env_id: str) -> EnvSpec:
    """Look up the specification of a registered id.

    Args:
        env_id: A Gymnasium id with its version; `module:ID` imports the module first.

    Raises:
        ValueError: If the module can't be imported or no such id is registered.
    """
    module, _, name = env_id.rpartition(":")
    if module:
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            raise UserError(
                f"Expected an importable module before the colon of {env_id!r}, got: {error}. "
                "Install it, or set PYTHONPATH to the folder that holds it."
            ) from error
        except (Exception, SystemExit) as error:  # whatever a user's module may raise
            raise UserError(
                f"Expected to import {module!r} for {env_id!r}, but the module raised "
                f"{type(error).__name__}: {error}. Mend the module."
            ) from error
    if name not in gym.registry:
        raise UserError(
            f"Expected a registered environment id, got {name!r}."
            f"{_did_you_mean(name, gym.registry)} `sada-gym envs` lists the ids; write module:ID "
            "for one that a module of yours registers."
        )
    return gym.registry[name]


def make_env(env_id: str, **env_kwargs: Any) -> gym.Env[Any, Any]:
    """Make an adversary environment, unwrapped: one whose `application` is an `Application`.

    Args:
        env_id: Any Gymnasium id of such an environment; `module:ID` imports the module first.
        **env_kwargs: The environment's keywords, as `gymnasium.make` takes them.

    Raises:
        ValueError: If the id or a keyword is unknown, or it is no adversary environment.
    """
    spec = find_spec(env_id)
    _check_keywords(spec, env_kwargs)
    render_mode = env_kwargs.get("render_mode")
    if render_mode is not None and not isinstance(render_mode, str):  # Gymnasium fails on those
        raise UserTypeError(f"Expected render_mode to be a string or None, got {render_mode!r}.")
    env = gym.make(spec, disable_env_checker=True, **env_kwargs).unwrapped
    if not isinstance(getattr(env, "application", None), Application):
        env.close()
        raise UserError(
            f"Expected an adversary environment behind {env_id!r}, got {type(env).__name__}. "
            "Wrap your application in sada_gym.envs.AdversaryEnv and register that."
        )
    return env


def make_application(env_id: str, **env_kwargs: Any) -> Application:
    """Make the application behind an adversary environment; arguments and errors as `make_env`."""
    env: Any = make_env(env_id, **env_kwargs)
    application: Application = env.application
    return application


def _check_keywords(spec: EnvSpec, env_kwargs: Mapping[str, Any]) -> None:
    if spec.entry_point is None:
        raise UserError(f"Expected {spec.id!r} to have an entry point, got none. Register one.")
    render_mode = env_kwargs.get("render_mode")
    if render_mode is not None and not isinstance(render_mode, str):  # gymnasium.make fails on it
        raise UserError(f"Expected render_mode to be a string or None, got {render_mode!r}.")
    creator = spec.entry_point
    accepted = inspect.signature(
        load_env_creator(creator) if isinstance(creator, str) else creator
    ).parameters.values()
    if any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in accepted):
        return
    names = [parameter.name for parameter in accepted]
    for keyword in env_kwargs:
        if keyword not in names:
            raise UserError(
                f"Expected keywords of {spec.id} among {', '.join(names)}, got {keyword!r}."
                f"{_did_you_mean(keyword, names)}"
            )


def _did_you_mean(word: str, known: Mapping[str, Any] | list[str]) -> str:
    matches = difflib.get_close_matches(word, known, n=3, cutoff=0.5)
    return f" Did you mean {' or '.join(map(repr, matches))}?" if matches else ""

"""The environments' ids, registered with Gymnasium when `sada_gym` is imported."""

from __future__ import annotations

import difflib
import importlib
import inspect
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from sada_gym.application import Application
from sada_gym.envs.catalogue import cards
from sada_gym.errors import UserError, refuse_unknown

_ENTRY_POINTS = ("sada_gym.envs:AdversaryEnv", "sada_gym.envs:AdversaryVectorEnv")


def register_environments() -> None:
    """Register the ids of all cards with Gymnasium; doing it again changes nothing."""
    for card in cards():
        for env_id, keywords in ids_of(card.name).items():
            _register(env_id, _ENTRY_POINTS, {"application": card.application, **keywords})
        for env_id, entry_points in card.tasks.items():
            _register(env_id, entry_points, {})


def _register(env_id: str, entry_points: tuple[str, str], kwargs: dict[str, Any]) -> None:
    if env_id not in gym.registry:
        env, vector_env = entry_points
        gym.register(env_id, entry_point=env, vector_entry_point=vector_env, kwargs=kwargs)


def ids_of(application: str | None = None) -> dict[str, Mapping[str, Any]]:
    """Give the ids of an application, or of all, with the keywords that each fixes."""
    found: dict[str, Mapping[str, Any]] = {}
    for card in cards():
        if application in (None, card.name):
            found[card.id] = {}
            found |= {card.track_id(suffix): card.tracks[suffix] for suffix in card.tracks}
    return found


def env_ids() -> tuple[str, ...]:
    """Give the ids of this package's adversary environments."""
    return tuple(ids_of())


def tracks() -> tuple[str, ...]:
    """Give the leaderboard's tracks."""
    return tuple(env_id for card in cards() for env_id in card.track_ids)


def task_ids() -> tuple[str, ...]:
    """Give the ids of the inner tasks, on which the agents under attack are trained."""
    return tuple(env_id for card in cards() for env_id in card.tasks)


def names_file(env_id: str) -> bool:
    """Say whether a name stands for a TOML file with an application, and not for an id."""
    return env_id.endswith(".toml")


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
        close = difflib.get_close_matches(name, gym.registry, n=3, cutoff=0.5)
        hint = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
        raise UserError(
            f"Expected a registered environment id, got {name!r}.{hint} `sada-gym envs` lists the "
            "ids; write module:ID for one that a module of yours registers."
        )
    return gym.registry[name]


def make_env(env_id: str, **env_kwargs: Any) -> gym.Env[Any, Any]:
    """Make an adversary environment, unwrapped: one whose `application` is an `Application`.

    Args:
        env_id: Any Gymnasium id of such an environment; `module:ID` imports the module first. Or
            the path of a TOML file, see `sada_gym.envs.wrapped.toml.read_application`.
        **env_kwargs: The environment's keywords, as `gymnasium.make` takes them.

    Raises:
        ValueError: If the id or a keyword is unknown, it is no adversary environment, or the file
            describes none.
    """
    if names_file(env_id):
        return _of_file(env_id, env_kwargs)
    spec = find_spec(env_id)
    _check_keywords(spec, env_kwargs)
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


def _of_file(path: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    from sada_gym.envs.adversary import AdversaryEnv
    from sada_gym.envs.wrapped.toml import read_application

    if env_kwargs:
        raise UserError(
            f"Expected keywords of an environment only with its id, got {dict(env_kwargs)} with "
            f"{path}. Write them into the file."
        )
    return AdversaryEnv(read_application(path))


def _check_keywords(spec: EnvSpec, env_kwargs: Mapping[str, Any]) -> None:
    creator = spec.entry_point
    if creator is None:
        raise UserError(f"Expected {spec.id!r} to have an entry point, got none. Register one.")
    accepted = inspect.signature(
        load_env_creator(creator) if isinstance(creator, str) else creator
    ).parameters
    # an AdversaryEnv takes any keywords and checks them itself, by its application's
    if not any(parameter.kind is parameter.VAR_KEYWORD for parameter in accepted.values()):
        refuse_unknown(f"keyword of {spec.id}", env_kwargs, list(accepted))

"""Gymnasium ids and what else names an environment."""

from __future__ import annotations

import difflib
import importlib
from dataclasses import replace
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec, load_env_creator

from sada_gym.errors import UserError, described


def names_file(env_id: str) -> bool:
    """Whether a name stands for a TOML file with an application, and not for an id."""
    return env_id.lower().endswith(".toml")


def sent_spec(env_id: object) -> EnvSpec | None:
    """Return the specification of an id that a script registered: workers may not know it."""
    spec = gym.registry.get(env_id) if isinstance(env_id, str) else None
    if spec is None or str(spec.entry_point).startswith(("gymnasium.", "sada_gym.")):
        return None
    if str(spec.entry_point).startswith("__main__:"):
        creator: Any = load_env_creator(str(spec.entry_point))
        return replace(spec, entry_point=creator)
    return spec


def receive_spec(spec: EnvSpec | None) -> None:
    """Register an id that `sent_spec` sent, if it is not known here."""
    if spec is not None:
        gym.registry.setdefault(spec.id, spec)


def find_spec(env_id: str) -> EnvSpec:
    """Look up the specification of a Gymnasium id; `module:ID` imports the module first.

    It raises `UserError` if the module can't be imported or no such id is registered.
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
                f"{described(error)}. Fix the module."
            ) from error
    if name not in gym.registry:
        close = difflib.get_close_matches(name, gym.registry, n=3, cutoff=0.5)
        hint = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
        if "/" in env_id or "-v" not in env_id:
            hint += " If it is a path: no such file or folder is there."
        raise UserError(
            f"Expected a registered environment id, got {name!r}.{hint} `sada-gym envs` lists the "
            "ids; write module:ID for one that your own module registers."
        )
    return gym.registry[name]

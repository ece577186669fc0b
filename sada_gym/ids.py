"""Gymnasium ids and what else names an environment."""

from __future__ import annotations

import difflib
import importlib

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec

from sada_gym.errors import UserError


def names_file(env_id: str) -> bool:
    """Whether a name stands for a TOML file with an application, and not for an id."""
    return env_id.lower().endswith(".toml")


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

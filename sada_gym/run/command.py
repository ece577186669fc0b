"""The command that made a run."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sada_gym.experiment.record import RunSettings


def attack_command(
    settings: RunSettings,
    track: str,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    agent: str | None = None,
    samples: bool = False,
) -> str:
    """Write the command that made a run, without --out; empty where no command can.

    A class has no name, and a keyword that JSON does not hold cannot be written.

    Args:
        settings: The run's.
        track: The environment's id or its TOML file.
        env_kwargs: Keywords that differ from those of the track.
        agent: How the agent was named; None where it is not to be named, as with a TOML file.
        samples: Whether to name the number of test samples.
    """
    experiment, adversary = settings.experiment, settings.experiment.adversary
    if not adversary.is_ours and ":" not in adversary.name:
        return ""
    words = ["sada-gym", "attack", track, "--adversary", adversary.name]
    words += [] if adversary.preset is None else ["--preset", adversary.preset]
    try:
        for option, given in (("--set", adversary.options), ("--env-kwargs", env_kwargs or {})):
            for name, value in given.items():
                words += [option, f"{name}={json.dumps(value)}"]
    except TypeError:
        return ""
    words += ["--agent", agent] if agent else []
    words += ["--budget", str(experiment.protocol.budget)]
    words += ["--samples", str(experiment.protocol.samples)] if samples else []
    return shlex.join([*words, "--seed", str(settings.seed)])


def from_here(path: str | Path) -> str:
    """Write a path as a command that is typed in the working directory names it."""
    absolute, here = Path(path).absolute(), Path.cwd()
    return str(absolute.relative_to(here) if absolute.is_relative_to(here) else absolute)

"""The command that made a run."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from typing import Any

from sada_gym.experiment.record import RunSettings


def attack_command(
    settings: RunSettings,
    track: str,
    *,
    env_kwargs: Mapping[str, Any] | None = None,
    samples: bool = False,
) -> str:
    """Write the command that made a run, without --out; empty for a class without a name.

    Args:
        settings: The run's.
        track: The environment's id or its TOML file.
        env_kwargs: Keywords that differ from those of the track.
        samples: Whether to name the number of test samples.
    """
    experiment, adversary = settings.experiment, settings.experiment.adversary
    if not adversary.is_ours and ":" not in adversary.name:
        return ""
    words = ["sada-gym", "attack", track, "--adversary", adversary.name]
    words += [] if adversary.preset is None else ["--preset", adversary.preset]
    for option, given in (("--set", adversary.options), ("--env-kwargs", env_kwargs or {})):
        for name, value in given.items():
            words += [option, f"{name}={json.dumps(value)}"]
    words += ["--agent", experiment.target.agent] if experiment.target.agent else []
    words += ["--budget", str(experiment.protocol.budget)]
    words += ["--samples", str(experiment.protocol.samples)] if samples else []
    return shlex.join([*words, "--seed", str(settings.seed)])

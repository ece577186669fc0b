"""Writes a first TOML file for a model and images, with every condition there is."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

from sada_gym.agents.agent_files import ONNX, TORCHSCRIPT
from sada_gym.envs.images.application import ImageApplication
from sada_gym.envs.images.conditions import CONDITIONS, SETS
from sada_gym.envs.images.toml import agent_of
from sada_gym.envs.wrapped.starter import StarterFile
from sada_gym.foundations.figures import number, percent

_SECONDS, _LEAST_IMAGES = 0.5, 2
"""How long a world should take, with as many images at least."""


def images_file(images: Any, agent: str, labels: Path | None, task: Any, file: Path) -> StarterFile:
    """Return the text of a TOML file in the place of `file`, and what to know about it.

    Raises:
        UserError: If images, labels and model do not fit.
    """
    model = agent_of(agent, Path("file"))  # as the user typed it: from here, not from the file
    application = ImageApplication(images, agent=model, labels=labels, task=task)
    count, clean = len(application.images), application.clean_score
    began = time.monotonic()
    application.agent.found(application.images.image(0))
    seconds = time.monotonic() - began
    batch = min(application.batch, max(_LEAST_IMAGES, round(_SECONDS / seconds)))
    known = application.images.labels is not None
    is_file = Path(agent).suffix.lower() in (*ONNX, *TORCHSCRIPT)
    given = {
        "images": _from(file, images),
        "agent": _from(file, Path(agent)) if is_file else agent,
        "labels": _from(file, labels) if labels is not None else None,
        "task": None if application.images.task else task,
        "fooling_threshold": application.fooling_threshold,
        "batch": batch,
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in given.items() if value is not None]
    lines += ["", "[conditions]  # true, or another range [low, high] of the first parameter"]
    for name, condition in CONDITIONS.items():
        ranges = ", ".join(
            f"{each.label} {number(each.low)} to {number(each.high)} {each.unit}".strip()
            for each in condition.parameters
        )
        lines.append(f"{'' if name in SETS['common'] else '# '}{name} = true  # {ranges}")
    right = "right" if application.task == "classify" else "found"
    truth = f"Of {count} images: {percent(clean)} {right} untouched."
    if not known:
        truth = (
            f"{count} images without labels: the model's answers on the untouched images are the "
            "truth."
        )
    threshold = number(application.fooling_threshold)
    notes = (
        truth,
        f"Threshold {threshold}: halfway to chance. A score of at most this is a failure.",
        f"A world has {batch} images, as the model takes {number(seconds)} s for one. More give a "
        "finer score.",
    )
    return StarterFile("\n".join(lines) + "\n", notes, ready=True)


def _from(file: Path, path: Path) -> str:
    """Return a path as the file has it: relative to its folder."""
    return Path(os.path.relpath(os.path.expanduser(path), file.parent or ".")).as_posix()

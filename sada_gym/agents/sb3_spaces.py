"""The spaces of a model in an SB3 zip, compared with an environment's without unpickling.

The file's JSON shows a space in words: its kind, shape and dtype, and its bounds as NumPy prints
them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
from stable_baselines3.common.vec_env import VecTransposeImage
from stable_baselines3.common.vec_env.stacked_observations import StackedObservations

from sada_gym.errors import UserError

MAX_FRAMES = 64
"""More stacked frames than this are taken for another environment's observations."""

_BOX_WORDS = re.compile(r"'([^']*)'(?:: |, )Box\(.*?\(([\d, ]*)\), ([a-z]+\d*)\)", re.DOTALL)
_NUMBER = re.compile(r"-?(?:inf|\d[\d.]*(?:e[+-]?\d+)?)")


def network_space(path: Path, entry: Any, space: gym.Space[Any]) -> gym.Space[Any]:
    """Return the observations of a network: an environment's, as SB3's wrappers change its space.

    `entry` holds the file's words for the space of its network. It raises `UserError` if the
    environment's observations are others.
    """
    of_env = dict(space.spaces) if isinstance(space, spaces.Dict) else {"": space}
    boxes = {key: part for key, part in of_env.items() if isinstance(part, spaces.Box)}
    words = _boxes_in_words(entry)
    if words.keys() != boxes.keys():
        raise _wrong_observations(path, words, space)
    ratios = {math.prod(words[key][0]) / max(1, math.prod(box.shape)) for key, box in boxes.items()}
    frames = ratios.pop() if len(ratios) == 1 else 1.0
    if ratios or not frames.is_integer() or not 1 <= frames <= MAX_FRAMES:
        raise _wrong_observations(path, words, space)
    parts = dict(deepcopy(of_env))
    for key, box in boxes.items():
        shape, dtype = words[key]
        part: Any = deepcopy(box)
        if frames > 1:
            part = StackedObservations(1, int(frames), part).stacked_observation_space
        if is_image_space(part) and not is_image_space_channels_first(part):
            part = VecTransposeImage.transpose_space(part)
        if part.shape != shape or (dtype == "uint8") != (part.dtype == np.uint8):
            raise _wrong_observations(path, words, space)
        parts[key] = part
    return spaces.Dict(parts) if isinstance(space, spaces.Dict) else parts[""]


def _boxes_in_words(entry: Any) -> dict[str, tuple[tuple[int, ...], str]]:
    """Read shape and dtype of a Box, or of each Box in a Dict, from a file's words for a space."""
    if not isinstance(entry, dict):
        return {}
    if str(entry.get(":type:")).endswith(".Dict'>"):
        return {
            key: (tuple(int(size) for size in shape.replace(",", " ").split()), dtype)
            for key, shape, dtype in _BOX_WORDS.findall(str(entry.get("spaces")))
        }
    shape = entry.get("_shape", entry.get("shape"))
    if not str(entry.get(":type:")).endswith(".Box'>") or not isinstance(shape, list):
        return {}
    if not all(isinstance(size, int) for size in shape):
        return {}
    return {"": (tuple(shape), str(entry.get("dtype")))}


def _wrong_observations(path: Path, words: Mapping[str, Any], space: gym.Space[Any]) -> UserError:
    named = [f"{key}{shape} of {dtype}" for key, (shape, dtype) in words.items()]
    return UserError(
        f"Expected an agent for observations {space} in {path}, got one for "
        f"{', '.join(named) or 'another kind'}. Name an agent that was trained on this "
        "environment; one that was trained on pictures under VecNormalize needs "
        "allow_pickle=True."
    )


def validate_action_space(path: Path, entry: Any, space: gym.Space[Any]) -> gym.Space[Any]:
    """Return a copy of an environment's action space if it is the one that a file describes."""
    words = entry if isinstance(entry, dict) else {}
    fits = str(words.get(":type:")).endswith(f".{type(space).__name__}'>")
    for name in ("low", "high") if isinstance(space, spaces.Box) else ("n", "start"):
        fits = fits and _same_numbers(words.get(name, 0), getattr(space, name, 0))
    if not fits:
        shown = {key: words.get(key) for key in ("n", "start", "low", "high") if key in words}
        raise UserError(
            f"Expected an agent for actions {space} in {path}, got one for "
            f"{words.get(':type:', 'unknown actions')} with {shown}. Name an agent that was "
            "trained on this environment."
        )
    return deepcopy(space)


def _same_numbers(words: Any, values: npt.ArrayLike) -> bool:
    """Compare numbers with NumPy's words for them, which leave out some of a thousand."""
    expected = np.ravel(values).astype(np.float64)
    numbers = [float(number) for number in _NUMBER.findall(str(words))]
    return "..." in str(words) or (
        len(numbers) == expected.size and np.allclose(numbers, expected, rtol=1e-6)
    )

"""Streaks of rain over a picture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sada_gym.compiled import inlined, kernel
from sada_gym.envs.driving.camera.pixel_world import Light, clip


@inlined
def _hash(state: np.uint64) -> np.uint64:
    """One step of splitmix64 (Steele, Lea & Flood 2014)."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@inlined
def _uniform(state: np.uint64) -> float:
    return float(state >> np.uint64(11)) / 9007199254740992.0


@kernel
def draw_rain(picture: npt.NDArray[np.uint8], rain: float, light: Light, key: np.uint64) -> None:
    """Draw streaks of rain, each a short slanting line."""
    rows, columns = picture.shape[0], picture.shape[1]
    brightness = 255.0 * clip(0.55 * (light.ambient[0] + light.ambient[1] + light.ambient[2]))
    thick = max(1, columns // 220)
    state = _hash(key)
    for _ in range(int(110 * rain)):
        state = _hash(state)
        u = _uniform(state) * columns
        state = _hash(state)
        v = (1.3 * _uniform(state) - 0.3) * rows
        state = _hash(state)
        near = _uniform(state)
        length = int((0.05 + 0.22 * near * near) * rows) + 1
        share = 0.12 + 0.30 * near
        for k in range(length):
            row = int(v) + k
            if not 0 <= row < rows:
                continue
            for t in range(thick):
                column = int(u + 0.12 * k) + t
                if 0 <= column < columns:
                    for channel in range(3):
                        value = float(picture[row, column, channel])
                        picture[row, column, channel] = int(value + share * (brightness - value))

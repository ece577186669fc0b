"""Streaks of rain over a picture."""

from __future__ import annotations

import numpy as np

from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import clip, splitmix, uniform
from sada_gym.foundations.arrays import Bytes
from sada_gym.foundations.compiled import kernel


@kernel
def draw_rain(picture: Bytes, rain: float, light: Light, key: np.uint64) -> None:
    """Draw streaks of rain, each a short slanting line."""
    rows, columns = picture.shape[0], picture.shape[1]
    brightness = 255.0 * clip(0.55 * (light.ambient[0] + light.ambient[1] + light.ambient[2]))
    thick = max(1, columns // 220)
    state = splitmix(key)
    for _ in range(int(110 * rain)):
        state = splitmix(state)
        u = uniform(state) * columns
        state = splitmix(state)
        v = (1.3 * uniform(state) - 0.3) * rows
        state = splitmix(state)
        near = uniform(state)
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

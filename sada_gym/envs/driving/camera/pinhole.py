"""The driver's camera: a pinhole at the front of the car, looking into a town in some weather."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from sada_gym.envs.driving.camera.casting import sunlit
from sada_gym.envs.driving.camera.drawing import draw_all
from sada_gym.envs.driving.camera.ground import SHADE_LEVEL, paint
from sada_gym.envs.driving.camera.scenery import TownArrays, furnish
from sada_gym.envs.driving.world.town import town
from sada_gym.envs.driving.world.weather import LIGHTS
from sada_gym.envs.pixels import pixel_size, ranked, tone_table
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Integers

FIELD_OF_VIEW_DEG = 100.0
FORWARD_M = 2.0
"""The distance from the car's middle to the camera."""
HALF_ANGLE_DEG = 62.0
"""Half the angle of the fan of vertical planes: a little more than the picture's corners need."""

_NEAR_M = 10.0
"""Cameras that stand within this distance are drawn one after another, which is faster."""


@dataclass(frozen=True)
class Mount:
    """How a camera is mounted."""

    height_m: float = 1.4  # the camera's height above the ground
    pitch_deg: float = -15.0  # the pitch of its axis; a negative one looks down


class Lens:
    """The directions of a picture's pixels."""

    def __init__(self, rows: int, columns: int) -> None:
        self.rows, self.columns = rows, columns
        self.pixel = pixel_size(FIELD_OF_VIEW_DEG, columns)
        self.planes = 2 * columns + 56
        self._right = self.pixel * (np.arange(columns) + 0.5 - columns / 2)
        self._down = self.pixel * (np.arange(rows) + 0.5 - rows / 2)

    def rays(self, pitch_deg: float) -> Floats32:
        """Return forward, right, slope and the vertical plane of each pixel, (rows, columns, 4)."""
        pitch = np.deg2rad(pitch_deg)
        forward = (np.cos(pitch) + self._down * np.sin(pitch))[:, None]
        up = (np.sin(pitch) - self._down * np.cos(pitch))[:, None]
        flat = np.hypot(forward, self._right)
        angle = np.rad2deg(np.arctan2(self._right, forward)) / HALF_ANGLE_DEG
        plane = np.floor((angle + 1) / 2 * self.planes).clip(0, self.planes - 1)
        parts = np.broadcast_arrays(forward / flat, self._right / flat, up / flat, plane)
        return np.stack(parts, axis=-1).astype(np.float32)


class TownCamera:
    """Draws a town, `benchmark` or `training`."""

    def __init__(self, layout_name: str) -> None:
        place = town(layout_name)
        self.ground = paint(place)
        self.scenery = furnish(place, self.ground)
        self.town = TownArrays(self.ground, self.scenery, _clouds(), tone_table(2048, exposure=1.3))
        suns = [light[:3] for light in LIGHTS]
        different = list(dict.fromkeys(suns))
        self._shades = np.stack([self._shade(sun) for sun in different])
        self._shade_of = np.array([different.index(sun) for sun in suns])

    def draw(
        self,
        lens: Lens,
        rays: Floats32,
        rays_of: Integers,
        poses: Floats,
        weathers: Integers,
        keys: npt.NDArray[np.uint64],
    ) -> Bytes:
        """Draw what n cameras see.

        `lens`: the pixels' directions; `rays` (m, rows, columns, 4) of the lens, at each pitch that
        occurs; `rays_of` (n,) which of them each camera has; `poses` (n, 4): the car's x, y and
        heading, and the camera's height; `weathers` (n,) indices into `LIGHTS`; `keys` (n,) what
        fixes the rain. Returns (n, rows, columns, 3).
        """
        pictures = np.empty((len(poses), lens.rows, lens.columns, 3), np.uint8)
        draw_all(
            pictures,
            np.lexsort(tuple(poses[:, :2].T // _NEAR_M)),
            rays,
            rays_of,
            poses,
            FORWARD_M,
            LIGHTS,
            weathers,
            lens.pixel,
            np.deg2rad(HALF_ANGLE_DEG),
            lens.planes,
            self.town,
            self._shades,
            self._shade_of[weathers],
            keys,
        )
        return pictures

    def plan(self, level: int) -> Bytes:
        """Return the ground from above, at a level of the mip map: (rows, columns, 3)."""
        rows, columns = self.ground.shape[level]
        first = self.ground.offset[level]
        texels = self.ground.texels[first : first + rows * columns]
        return texels[:, :3].reshape(rows, columns, 3)

    def _shade(self, sun: tuple[float, float, float]) -> Bytes:
        shade = np.empty(tuple(self.ground.shape[SHADE_LEVEL]), np.uint8)
        sunlit(shade, *sun, self.town)
        soft: Bytes = gaussian_filter(shade, 0.6)
        return soft


@cache
def camera(layout_name: str) -> TownCamera:
    """Build a town's camera once a process."""
    return TownCamera(layout_name)


def _clouds() -> Floats32:
    clouds = gaussian_filter(np.random.default_rng(1).normal(size=(256, 256)), 2.0, mode="wrap")
    clouds += (
        0.35
        * gaussian_filter(np.random.default_rng(2).normal(size=(256, 256)), 0.7, mode="wrap")
        * clouds.std()
        / 0.4
    )
    return ranked(clouds).astype(np.float32)

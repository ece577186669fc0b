"""The drone's camera: a wide pinhole at its front, looking over a field with gates."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, gaussian_filter1d
from scipy.spatial.transform import Rotation

from sada_gym.envs.pixels import pixel_size, ranked
from sada_gym.envs.uav.camera import drawing
from sada_gym.foundations.arrays import Bytes, Floats

ROWS, COLUMNS = 48, 64
"""The size of the pictures that pilots see."""
FIELD_OF_VIEW_DEG = 90.0
"""The angle from the picture's left edge to its right edge."""
TILT_DEG = 10.0
"""The camera points upwards from the drone's own forward axis by this angle."""
FORWARD_M, UP_M = 0.1, 0.02
"""The way from the drone's middle to the camera."""

_SIZE, _TEXEL_M, _STRIPE_M = 512, 0.125, 4.0


class DroneCamera:
    """Draws what drones see.

    A picture depends on its own gates, pose and seed alone. The seed fixes the sun, the light's
    colour, and where field, clouds and hills lie; it changes no gate.
    The field of view is the same whatever the number of rows and columns.
    """

    def __init__(self, rows: int = ROWS, columns: int = COLUMNS) -> None:
        self.rows, self.columns = rows, columns
        self.pixel = pixel_size(FIELD_OF_VIEW_DEG, columns)
        self._mount = np.array([np.deg2rad(TILT_DEG), FORWARD_M, UP_M])
        self._field = field()

    def draw(self, gates: Floats, poses: Floats, seeds: npt.ArrayLike) -> Bytes:
        """Draw what n drones see, (n, rows, columns, 3).

        Args:
            gates: (n, g, 4): x, y, z of the openings' centres, and headings.
            poses: (n, 7) or more: position, quaternion x, y, z, w. Where one is no number, or
                farther off than 1,000 km, the picture is black.
            seeds: (n,) integers.
        """
        pictures = np.empty((len(poses), self.rows, self.columns, 3), np.uint8)
        keys = np.asarray(seeds, np.int64).astype(np.uint64)
        drawing.draw_all(pictures, gates, poses, keys, self._mount, self.pixel, self._field)
        return pictures

    def project(self, pose: Floats, points: Floats) -> Floats:
        """Return the columns and rows (k, 2) of points (k, 3) in the picture of a pose (7,).

        They are NaN where a point is behind the camera.
        """
        tilt, forward, up = self._mount
        turn = Rotation.from_quat(pose[3:7])
        eye = pose[:3] + turn.apply([forward, 0.0, up])
        x, y, z = turn.inv().apply(points - eye).T
        depth = np.cos(tilt) * x + np.sin(tilt) * z
        down = np.sin(tilt) * x - np.cos(tilt) * z
        depth = np.where(depth > 0, depth, np.nan)
        middle = np.array([self.columns, self.rows]) / 2
        place: Floats = middle + np.stack([-y, down], axis=1) / (depth[:, None] * self.pixel)
        return place


@cache
def camera(rows: int = ROWS, columns: int = COLUMNS) -> DroneCamera:
    """Build a camera once a process."""
    return DroneCamera(rows, columns)


@cache
def field() -> drawing.Field:
    """Sow the field, once a process: mown grass, clouds and hills, none of it from photographs."""
    rng = np.random.default_rng(7)

    def noise(size: int, width: float) -> Floats:
        values = gaussian_filter(rng.normal(size=(size, size)), width, mode="wrap")
        return np.asarray(values / values.std())

    stripes = np.floor(np.arange(_SIZE) * _TEXEL_M / _STRIPE_M) % 2 * 2 - 1
    grass = 7 * noise(_SIZE, 0.8) + 8 * noise(_SIZE, 5) + 9 * noise(_SIZE, 28) + 9 * stripes
    dry = 0.5 * noise(_SIZE, 12) + 0.3 * noise(_SIZE, 2)
    earth = np.stack([96 + 14 * dry + grass, 132 + grass, 66 + 8 * dry + 0.6 * grass], axis=-1)
    levels = [earth]
    while len(levels[-1]) > 2:
        last = levels[-1]
        half = len(last) // 2
        levels.append(last.reshape(half, 2, half, 2, 3).mean(axis=(1, 3)))
    texels = np.concatenate([level.reshape(-1, 3) for level in levels]).clip(0, 255)
    first = np.cumsum([0, *(level.size // 3 for level in levels[:-1])])
    clouds = noise(256, 9) + 0.6 * noise(256, 3)
    hills = gaussian_filter1d(rng.normal(size=1024), 24, mode="wrap")
    trees = gaussian_filter1d(rng.normal(size=1024), 1.5, mode="wrap")
    ridge = 0.045 + 0.02 * hills / hills.std() + 0.007 * trees / trees.std()
    return drawing.Field(
        texels=np.round(texels).astype(np.uint8),
        first=first,
        size=_SIZE,
        scales=1 / (_TEXEL_M * 2.0 ** np.arange(len(levels))),
        clouds=(0.8 * (ranked(clouds) - 0.55).clip(0, None) / 0.45).astype(np.float32),
        hills=ridge.clip(0.005, None).astype(np.float32),
    )

"""The pole between camera and object, drawn over a finished picture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.renderers.shading import SUN, TONE_STEPS
from sada_gym.envs.detection.scene import OCCLUDER_COLOUR, OCCLUDER_WIDTH, Pinhole
from sada_gym.envs.pixels import TONE_WHITE, Triple

Floats = npt.NDArray[np.float64]


def draw_pole(
    image: npt.NDArray[np.uint8],
    shift: float,
    camera: Pinhole,
    toward: Floats,
    ambient: Triple,
    tone: npt.NDArray[np.uint8],
) -> None:
    """Draw `Scene.occluder` into a picture, (size, size, 3).

    Args:
        image: Gets the pole.
        shift: The pole's middle, in units of half the picture.
        camera: Sees the pole upright.
        toward: (3,), the unit vector towards the light.
        ambient: Light from everywhere.
        tone: Of `tone_table`.
    """
    size = len(image)
    edges = np.linspace(-1, 1, size + 1)
    low = np.clip(edges, shift - OCCLUDER_WIDTH, shift + OCCLUDER_WIDTH)
    covered = (low[1:] - low[:-1]) * (size / 2)
    columns = np.flatnonzero(covered)
    middles = (edges[1:] + edges[:-1]) / 2
    x, y = middles[columns], -middles[:, None]
    right, _, back = camera.axes
    across = np.clip((x - shift) / OCCLUDER_WIDTH, -1, 1)
    facing = np.sqrt(1 - across * across)
    sun = np.maximum(0, across * _dot(right, toward) + facing * _dot(back, toward))
    upward = 0.5 + 0.5 * facing * back[2]
    glare = _glare(camera, x, y, toward)
    for channel in range(3):
        albedo = 0.02 + 0.9 * OCCLUDER_COLOUR[channel] ** 2.2
        light = albedo * (sun * SUN[channel] + upward * ambient[channel]) + glare * SUN[channel]
        steps = (light * ((TONE_STEPS - 1) / TONE_WHITE) + 0.5).astype(np.int64)
        pole = tone[np.minimum(steps, TONE_STEPS - 1)]
        behind = image[:, columns, channel]
        mixed = behind + covered[columns] * (pole - behind.astype(np.float64))
        image[:, columns, channel] = np.round(mixed)


def _glare(camera: Pinhole, x: Floats, y: Floats, toward: Floats) -> Floats:
    """Return the veil of light that lies over the picture at (y, x), as over all else in it."""
    right, up, back = camera.axes
    u, v = (x + camera.offset[0]) * camera.tangent, (y + camera.offset[1]) * camera.tangent
    along = u * _dot(right, toward) + v * _dot(up, toward) - _dot(back, toward)
    veil = _square(np.maximum(0, along / np.sqrt(u * u + v * v + 1)), 3)
    return 0.12 * veil + 0.3 * _square(veil, 5)


def _square(values: Floats, repeats: int) -> Floats:
    # NumPy's own powers differ from processor to processor
    for _ in range(repeats):
        values = values * values
    return values


def _dot(a: Floats, b: Floats) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])

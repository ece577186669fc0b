"""The default renderer: a z-buffer finds the object's faces in sight, pixel kernels light them.

A scene is a few calls of compiled kernels, which hold no state. The pole between camera and object
is drawn over the finished picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.backdrop import Backdrop
from sada_gym.envs.detection.renderers import gbuffer, zbuffer
from sada_gym.envs.detection.renderers.base import DEFAULT_KEY, Renderer, Rendering
from sada_gym.envs.detection.renderers.gbuffer import (
    GBuffer,
    KernelBackdrop,
    KernelCamera,
    Lamp,
    Skin,
)
from sada_gym.envs.detection.renderers.shading import SUN, SUPERSAMPLING, TONE_STEPS, compose
from sada_gym.envs.detection.renderers.skin import looks, skin_of
from sada_gym.envs.detection.scene import (
    OCCLUDER_COLOUR,
    OCCLUDER_WIDTH,
    Pinhole,
    Scene,
    axes_facing,
    camera_of,
    centre_of,
    light_of,
)
from sada_gym.envs.detection.shapes.model import NOTHING, Shape
from sada_gym.envs.pixels import TONE_WHITE, Triple, tone_table

AMBIENT = 0.2
LIGHT_SIZE = 64
"""Samples a side of the light's view, for shadows; textured models cast sharper ones."""
TEXTURED_LIGHT_SIZE = 160
LIGHT_HALF = 2.7
LIGHT_DISTANCE = 30.0

Matrix = npt.NDArray[np.float64]


class Rasteriser(Renderer):
    """Renders scenes by kernels of our own."""

    any_size: ClassVar[bool] = True

    def __init__(self) -> None:
        self._noise = gbuffer.noise_tile()
        self._tone = tone_table(TONE_STEPS, exposure=1.5)

    @property
    def identity(self) -> str:
        """The renderer's name; its version is that of the environment."""
        return DEFAULT_KEY

    @property
    def key(self) -> str:
        """The plain name; subclasses have keys like any other renderer."""
        return DEFAULT_KEY if type(self) is Rasteriser else super().key

    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        """Make a square picture of `image_size` pixels a side of each scene, in the same order."""
        images = np.empty((len(scenes), image_size, image_size, 3), np.uint8)
        return [self._render(*pair) for pair in zip(scenes, images, strict=True)]

    def _render(self, scene: Scene, image: npt.NDArray[np.uint8]) -> Rendering:
        size, shape = len(image), scene.shape or NOTHING
        pinhole = camera_of(scene)
        camera = _kernel_camera(pinhole, SUPERSAMPLING * size)
        points = _projected(shape, camera)
        left, top, right, bottom = (
            SUPERSAMPLING * n for n in zbuffer.bounds(points, SUPERSAMPLING, size)
        )
        window = (left, top), (bottom - top, right - left)
        skin, faces, materials = None, shape.faces, shape.materials
        table = gbuffer.painted(scene.colour)
        planes, shown, nearest = _rasterised(shape, points, *window)
        seen = zbuffer.extent(shown)
        if shape.surfaces:
            skin = _with_panes(shape, points, window[0], planes, nearest)
            faces, materials = skin.faces, skin.materials
            table = looks(shape.surfaces, scene.colour)
            seen = zbuffer.extent(np.maximum(shown, skin.panes))
        coverage = np.empty((size, size), np.uint8)
        compose(
            image,
            coverage,
            camera,
            _lamp(scene, shape),
            self._place(scene.backdrop, pinhole),
            GBuffer(left, top, shown, planes, shape.normals, faces, materials),
            table,
            self._tone,
            np.empty((3, size)),
            skin,
        )
        if scene.occluder is not None:
            toward, ambient = light_of(scene), _ambient(scene.backdrop)
            draw_pole(image, scene.occluder, pinhole, toward, ambient, self._tone)
        x0, y0, x1, y1 = seen
        box = np.array([left + x0, top + y0, left + x1, top + y1]) / SUPERSAMPLING
        return Rendering(image, coverage > SUPERSAMPLING, box if x0 < x1 else None)

    def _place(self, backdrop: Backdrop, camera: Pinhole) -> KernelBackdrop:
        ours = {
            "buildings": _buildings_in_sight(backdrop.buildings, camera),
            "ambient": _ambient(backdrop),
            "noise": self._noise,
        }
        return KernelBackdrop(**vars(backdrop) | ours)


def _ambient(backdrop: Backdrop) -> Triple:
    red, green, blue = map(sum, zip(backdrop.horizon, backdrop.zenith, strict=True))
    return AMBIENT * red, AMBIENT * green, AMBIENT * blue


def _kernel_camera(camera: Pinhole, samples: int) -> KernelCamera:
    right, up, back = map(_triple, camera.axes)
    x, y = camera.offset
    middle = (0.5 * samples * (1 - x), 0.5 * samples * (1 + y))
    return KernelCamera(_triple(camera.eye), right, up, back, 2 * camera.tangent / samples, middle)


def _lamp(scene: Scene, shape: Shape) -> Lamp:
    centre, axes = centre_of(scene), axes_facing(light_of(scene))
    eye = centre + LIGHT_DISTANCE * axes[2]
    tangent = LIGHT_HALF / LIGHT_DISTANCE
    size = TEXTURED_LIGHT_SIZE if shape.surfaces else LIGHT_SIZE
    camera = _kernel_camera(Pinhole(eye, axes, tangent, (0.0, 0.0)), size)
    points = _projected(shape, camera)
    _, _, nearest = _rasterised(shape, points, (0, 0), (size, size), for_light=True)
    return Lamp(
        camera.right, camera.up, camera.back, _triple(centre), LIGHT_DISTANCE, tangent, nearest
    )


def _projected(shape: Shape, camera: KernelCamera) -> Matrix:
    points = np.empty((len(shape.vertices), zbuffer.COORDINATES))
    zbuffer.project(shape.vertices, camera, points)
    return points


def _rasterised(
    shape: Shape,
    points: Matrix,
    corner: tuple[int, int],
    size: tuple[int, int],
    *,
    for_light: bool = False,
) -> tuple[Matrix, npt.NDArray[np.int32], Matrix]:
    """Draw a shape in a window; return `planes`, `shown` and `nearest` of `zbuffer.rasterise`.

    The faces of a textured shape are those of its `Skin`, without glass. The light sees dark glass
    too, and needs no planes.
    """
    # the light asks for depths alone
    planes = np.empty((0 if for_light else len(shape.faces), zbuffer.PLANES))
    nearest, places = np.zeros(size), np.empty((len(points), 2), np.int32)
    shown = np.full(size, -1, np.int32)
    skin = skin_of(shape) if shape.surfaces else None
    window = (shape.double_sided, corner, planes, nearest, shown)
    if skin is None:
        zbuffer.rasterise(points, places, shape.faces, *window)
    else:
        part = (0, skin.clear if for_light else skin.dark)
        zbuffer.rasterise(points, places, skin.faces, *window, skin, part)
    return planes, shown, nearest


def _with_panes(
    shape: Shape, points: Matrix, corner: tuple[int, int], planes: Matrix, nearest: Matrix
) -> Skin:
    """Draw the nearest glass before what `_rasterised` drew."""
    skin = skin_of(shape)
    panes = np.full(nearest.shape, -1, np.int32)
    part = (skin.dark, len(skin.faces))
    if part[0] < part[1]:
        window = (shape.double_sided, corner, planes, nearest.copy(), panes)
        places = np.empty((len(points), 2), np.int32)
        zbuffer.rasterise(points, places, skin.faces, *window, skin, part)
    return skin._replace(nearest=nearest, panes=panes)


def _buildings_in_sight(buildings: Matrix, camera: Pinhole) -> Matrix:
    reach = np.hypot(buildings[:, 2], buildings[:, 3])
    offset = buildings[:, :2] - camera.eye[:2]
    ahead = -camera.axes[2, :2]
    norm = np.hypot(ahead[0], ahead[1])
    ahead = ahead / norm
    along = offset @ ahead
    across = np.abs(offset @ np.array([ahead[1], -ahead[0]]))
    # steep cameras widen the frame's edge on the ground: divide by the pitch's cosine
    half = camera.tangent * (1 + abs(camera.offset[0])) / norm
    in_sight: Matrix = buildings[(along > -reach) & (across < along * half + reach * (1 + half))]
    return in_sight


def _triple(vector: npt.NDArray[Any]) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z


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

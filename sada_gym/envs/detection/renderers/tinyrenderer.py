"""The default renderer: PyBullet's TinyRenderer rasterises the object, our kernels light it."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.envs.detection.backdrop import Backdrop
from sada_gym.envs.detection.renderers.base import DEFAULT, Renderer, Rendering
from sada_gym.envs.detection.renderers.encoding import code_texture, encode
from sada_gym.envs.detection.renderers.gbuffer import (
    GBuffer,
    KernelCamera,
    Lamp,
    Place,
    noise_tile,
    painted,
)
from sada_gym.envs.detection.renderers.shading import SUPERSAMPLING, TONE_STEPS, compose
from sada_gym.envs.detection.scene import (
    Pinhole,
    Scene,
    axes_facing,
    camera_of,
    centre_of,
    light_of,
)
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.pixels import Triple, tone_table
from sada_gym.errors import UserError

NEAR, FAR = 2.0, 32.0
AMBIENT = 0.2
LIGHT_SIZE = 64
LIGHT_HALF = 2.7
LIGHT_DISTANCE = 30.0
VISUALS = 64
"""Shapes kept in PyBullet, 0.3 MB each; one of them is drawn at a time."""
FACES = 400_000
"""Faces kept in PyBullet, in all of these shapes; 2,500 of the benchmark's largest shape."""
CORNERS = 3 * 2_500
"""Corners in one of PyBullet's visual shapes; larger shapes become several, drawn as one.

PyBullet copies 68 bytes a corner into a buffer of 8 MB without looking at its end. From 123,362
corners on it overwrites what lies behind: pictures vary, or it crashes. From 131,073 on it raises.
"""

Matrix = npt.NDArray[np.float64]

_EMPTY = GBuffer(0, 0, np.zeros((0, 0, 4), np.uint8), np.zeros((0, 0)), np.zeros((0, 0), np.bool_))


class TinyRenderer(Renderer):
    """Renders scenes with a PyBullet client of its own. One shape is loaded at a time."""

    def __init__(self) -> None:
        from sada_gym.envs.bullet import pybullet

        self._bullet = pybullet
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._texture = self._load_texture()
        self._rows = (_Rows(), _Rows(), _Rows())
        self._visuals: dict[Shape, list[int]] = {}
        self._shape: Shape | None = None
        self._bodies: list[int] = []
        self._lock = threading.Lock()
        self._noise = noise_tile()
        self._tone = tone_table(TONE_STEPS, exposure=1.5)

    @property
    def identity(self) -> str:
        """The renderer's name; its version is that of the environment."""
        return DEFAULT

    @property
    def key(self) -> str:
        """The plain name; subclasses have keys like any other renderer."""
        return DEFAULT if type(self) is TinyRenderer else super().key

    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        """Make a square picture of `image_size` pixels a side of each scene, in the same order."""
        renderings: dict[int, Rendering] = {}
        # sorted, so that a shape is loaded once
        for i in sorted(range(len(scenes)), key=lambda i: scenes[i].shape_name):
            renderings[i] = self._render(scenes[i], image_size)
        return [renderings[i] for i in range(len(scenes))]

    def close(self) -> None:
        """Free PyBullet's memory; nothing can be rendered afterwards."""
        with self._lock:
            if self._client >= 0:
                self._bullet.disconnect(physicsClientId=self._client)
            self._client = -1
            self._visuals.clear()
            self._shape = None

    def _render(self, scene: Scene, image_size: int) -> Rendering:
        camera, centre, toward = camera_of(scene), centre_of(scene), light_of(scene)
        light_axes = axes_facing(toward)
        with self._lock:
            if self._client < 0:
                raise UserError("Expected an open renderer, got one that was closed. Make another.")
            g = self._object(scene.shape, camera, image_size)
            light_depth = self._light_depth(scene.shape, centre, light_axes)
        image = np.empty((image_size, image_size, 3), dtype=np.uint8)
        coverage = np.empty((image_size, image_size), dtype=np.uint8)
        compose(
            image,
            coverage,
            _kernel_camera(camera, image_size),
            _lamp(centre, toward, light_axes, light_depth),
            self._place(scene.backdrop, camera),
            g,
            painted(scene.colour),
            self._tone,
        )
        return Rendering(image, coverage > SUPERSAMPLING, _box(g))

    def _place(self, backdrop: Backdrop, camera: Pinhole) -> Place:
        ambient = AMBIENT * (np.array(backdrop.horizon) + np.array(backdrop.zenith))
        buildings = _buildings_in_sight(backdrop.buildings, camera)
        ours = {"buildings": buildings, "ambient": _triple(ambient), "noise": self._noise}
        return Place(**vars(backdrop) | ours)

    def _object(self, shape: Shape | None, camera: Pinhole, image_size: int) -> GBuffer:
        """Rasterise the object in the window of the image that it can touch."""
        if shape is None:
            return _EMPTY
        self._load(shape)
        low, high = _window(shape, camera, image_size)
        if (high <= low).any():
            return _EMPTY
        width, height = (int(n) for n in SUPERSAMPLING * (high - low))
        # TinyRenderer samples a pixel at its lower right corner: shift by half a sub-pixel
        offset = np.array(camera.offset) + 1 / (SUPERSAMPLING * image_size)
        corner = np.array([low[0], image_size - high[1]])
        opposite = np.array([high[0], image_size - low[1]])
        start, end = (2 * pixel / image_size - 1 + offset for pixel in (corner, opposite))
        projection = _frustum(start, end, camera.tangent, NEAR, FAR)
        colour, depth, seen = self._picture(width, height, camera, projection, NEAR, FAR)
        return GBuffer(int(low[0]), int(low[1]), colour, depth, seen)

    def _light_depth(self, shape: Shape | None, centre: Matrix, axes: Matrix) -> Matrix:
        """Draw the object's depth along the light's axis, -inf beside the object."""
        if shape is None:
            return np.full((2, 2), -np.inf)
        self._load(shape)
        camera = Pinhole(
            centre + LIGHT_DISTANCE * axes[2], axes, LIGHT_HALF / LIGHT_DISTANCE, (0.0, 0.0)
        )
        near, far = LIGHT_DISTANCE - 4.0, LIGHT_DISTANCE + 4.0
        projection = _frustum(-np.ones(2), np.ones(2), camera.tangent, near, far)
        _, depth, seen = self._picture(LIGHT_SIZE, LIGHT_SIZE, camera, projection, near, far)
        return np.where(seen, LIGHT_DISTANCE - depth, -np.inf)

    def _picture(
        self, width: int, height: int, camera: Pinhole, projection: Matrix, near: float, far: float
    ) -> tuple[npt.NDArray[np.uint8], Matrix, npt.NDArray[np.bool_]]:
        """Draw the codes, the depth along the viewing axis, and where the object is seen."""
        bullet = self._bullet
        _, _, colour, raw, bodies = bullet.getCameraImage(
            width,
            height,
            camera.matrix.T.ravel().tolist(),
            projection.T.ravel().tolist(),
            lightDirection=(0, 0, 1),
            lightColor=(1, 1, 1),
            lightAmbientCoeff=1.0,
            lightDiffuseCoeff=0.0,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=bullet.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        shape = (height, width)
        depth = far * near / (far - (far - near) * np.reshape(raw, shape).astype(np.float64))
        return np.reshape(colour, (*shape, 4)), depth, np.reshape(bodies, shape) >= 0

    def _load(self, shape: Shape) -> None:
        if shape is self._shape:
            return
        bullet = self._bullet
        for body in self._bodies:
            bullet.removeBody(body, physicsClientId=self._client)
        self._shape, self._bodies = None, []
        if shape not in self._visuals and self._is_full(shape):
            # nothing less frees a visual shape
            bullet.resetSimulation(physicsClientId=self._client)
            self._visuals.clear()
            self._texture = self._load_texture()
        if shape not in self._visuals:
            self._visuals[shape] = self._create_visuals(shape)
        for visual in self._visuals[shape]:
            body = bullet.createMultiBody(0, -1, visual, physicsClientId=self._client)
            self._bodies.append(body)
            bullet.changeVisualShape(
                body, -1, textureUniqueId=self._texture, physicsClientId=self._client
            )
        self._shape = shape

    def _is_full(self, shape: Shape) -> bool:
        faces = sum(len(known.faces) for known in self._visuals) + len(shape.faces)
        return bool(self._visuals) and (len(self._visuals) == VISUALS or faces > FACES)

    def _create_visuals(self, shape: Shape) -> list[int]:
        mesh: tuple[npt.NDArray[Any], ...] = encode(shape)
        visuals = []
        for start in range(0, len(mesh[0]), CORNERS):
            corners, codes, normals = (
                rows.fill(values[start : start + CORNERS])
                for rows, values in zip(self._rows, mesh, strict=True)
            )
            indices = list(range(len(corners)))
            visual = self._bullet.createVisualShape(
                self._bullet.GEOM_MESH,
                vertices=corners,
                indices=indices,
                uvs=codes,
                normals=normals,
                rgbaColor=(1, 1, 1, 1),
                flags=self._bullet.VISUAL_SHAPE_DOUBLE_SIDED if shape.double_sided else 0,
                physicsClientId=self._client,
            )
            for given in (corners, codes, normals, indices):
                given.clear()
            visuals.append(int(visual))
        return visuals

    def _load_texture(self) -> int:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "code.png"
            Image.fromarray(code_texture()).save(path)
            return int(self._bullet.loadTexture(str(path), physicsClientId=self._client))


def _kernel_camera(camera: Pinhole, image_size: int) -> KernelCamera:
    right, up, back = map(_triple, camera.axes)
    step = 2 * camera.tangent / image_size
    return KernelCamera(_triple(camera.eye), right, up, back, step, camera.offset)


def _lamp(centre: Matrix, toward: Matrix, axes: Matrix, depth: Matrix) -> Lamp:
    right, up, back = map(_triple, axes)
    place = _triple(centre)
    return Lamp(_triple(toward), right, up, back, place, LIGHT_DISTANCE, LIGHT_HALF, depth)


def _frustum(low: Matrix, high: Matrix, tangent: float, near: float, far: float) -> Matrix:
    """Project (4, 4) the window low..high (right, up), in units of half the image."""
    projection = np.zeros((4, 4))
    projection[[0, 1], [0, 1]] = 2 / (tangent * (high - low))
    projection[:2, 2] = (high + low) / (high - low)
    projection[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
    projection[3, 2] = -1.0
    return projection


def _window(
    shape: Shape, camera: Pinhole, image_size: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Find the pixels that the shape's bounding box can touch: first and last + 1 (column, row)."""
    seen = (shape.corners - camera.eye) @ camera.axes.T
    plane = seen[:, :2] / (-seen[:, 2:] * camera.tangent) - np.array(camera.offset)
    columns = (plane[:, 0] + 1) / 2 * image_size
    rows = (1 - plane[:, 1]) / 2 * image_size
    first = np.floor([columns.min(), rows.min()]).astype(np.int64) - 1
    last = np.ceil([columns.max(), rows.max()]).astype(np.int64) + 1
    return first.clip(0, image_size), last.clip(0, image_size)


def _buildings_in_sight(buildings: Matrix, camera: Pinhole) -> Matrix:
    """Find the buildings that can stand in the frame: the kernel's inner loop is over these."""
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


def _box(g: GBuffer) -> npt.NDArray[np.float64] | None:
    rows, columns = np.flatnonzero(g.seen.any(axis=1)), np.flatnonzero(g.seen.any(axis=0))
    if not len(rows):
        return None
    corners = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
    corner = np.array([g.column, g.row, g.column, g.row])
    box: npt.NDArray[np.float64] = corners / SUPERSAMPLING + corner
    return box


def _triple(vector: npt.NDArray[np.float64]) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z


class _Rows:
    """Lists that PyBullet gets over and over: it never releases one, and a new shape has 0.8 MB."""

    def __init__(self) -> None:
        self._rows: list[list[float]] = []

    def fill(self, values: npt.NDArray[Any]) -> list[list[float]]:
        """Give (n, k) values as n of the lists; clear the outer list after use."""
        self._rows += [[] for _ in range(len(values) - len(self._rows))]
        for row, value in zip(self._rows, values.tolist(), strict=False):
            row[:] = value
        return self._rows[: len(values)]

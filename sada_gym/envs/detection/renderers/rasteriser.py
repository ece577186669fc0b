"""The default renderer: our z-buffer rasterises the object, our kernels light it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.renderers.base import DEFAULT, Renderer, Rendering
from sada_gym.envs.detection.renderers.gbuffer import (
    GBuffer,
    KernelCamera,
    Lamp,
    Place,
    noise_tile,
    painted,
)
from sada_gym.envs.detection.renderers.shading import SUPERSAMPLING, TONE_STEPS, compose
from sada_gym.envs.detection.renderers.zbuffer import PLANES, project, rasterise, window
from sada_gym.envs.detection.scene import (
    Pinhole,
    Scene,
    axes_facing,
    camera_of,
    centre_of,
    light_of,
)
from sada_gym.envs.pixels import Triple, tone_table
AMBIENT = 0.2
LIGHT_SIZE = 64
LIGHT_HALF = 2.7
LIGHT_DISTANCE = 30.0

Matrix = npt.NDArray[np.float64]
NO_VECTORS = np.empty((0, 3), np.float32)
NO_FACES = np.empty((0, 3), np.int32)
NO_MATERIALS = np.empty(0, np.uint8)


class Rasteriser(Renderer):
    def __init__(self) -> None:
        self._noise = noise_tile()
        self._tone = tone_table(TONE_STEPS, exposure=1.5)

    @property
    def identity(self) -> str:
        return DEFAULT

    @property
    def key(self) -> str:
        return DEFAULT if type(self) is Rasteriser else super().key

    def render_batch(self, scenes: Sequence[Scene], image_size: int) -> list[Rendering]:
        return [self._render(scene, image_size) for scene in scenes]

    def _render(self, scene: Scene, image_size: int) -> Rendering:
        pinhole, centre, toward = camera_of(scene), centre_of(scene), light_of(scene)
        light_axes = axes_facing(toward)
        shape = scene.shape
        v, n, f, m = (NO_VECTORS, NO_VECTORS, NO_FACES, NO_MATERIALS) if shape is None else (shape.vertices, shape.normals, shape.faces, shape.materials)
        double = shape is not None and shape.double_sided
        samples = SUPERSAMPLING * image_size
        camera = _kernel_camera(pinhole, samples)
        points, planes = np.empty((len(v), 5)), np.empty((len(f), PLANES))
        project(v, camera, points)
        left, top, right, bottom = window(points, samples)
        left, top = left // SUPERSAMPLING * SUPERSAMPLING, top // SUPERSAMPLING * SUPERSAMPLING
        right, bottom = -(-right // SUPERSAMPLING) * SUPERSAMPLING, -(-bottom // SUPERSAMPLING) * SUPERSAMPLING
        shown = np.full((max(bottom - top, 0), max(right - left, 0)), -1, np.int32)
        nearest = np.zeros(shown.shape)
        # light first: it uses the same planes
        lamp_nearest = np.zeros((LIGHT_SIZE, LIGHT_SIZE))
        lamp_shown = np.empty((LIGHT_SIZE, LIGHT_SIZE), np.int32)
        right_, up, back = map(_triple, light_axes)
        lstep = 2 * LIGHT_HALF / LIGHT_DISTANCE / LIGHT_SIZE
        eye = _triple(centre + LIGHT_DISTANCE * light_axes[2])
        lcam = KernelCamera(eye, right_, up, back, lstep, (LIGHT_SIZE / 2, LIGHT_SIZE / 2))
        lpoints = np.empty((len(v), 5))
        project(v, lcam, lpoints)
        rasterise(lpoints, f, double, (0, 0), planes, lamp_nearest, lamp_shown)
        rasterise(points, f, double, (left, top), planes, nearest, shown)
        image = np.empty((image_size, image_size, 3), dtype=np.uint8)
        coverage = np.empty((image_size, image_size), dtype=np.uint8)
        lamp = Lamp(_triple(toward), right_, up, back, _triple(centre), LIGHT_DISTANCE, LIGHT_HALF/LIGHT_DISTANCE, lamp_nearest)
        compose(image, coverage, camera, lamp, self._place(scene.backdrop, pinhole), GBuffer(left, top, shown, planes, n, f, m), painted(scene.colour), self._tone, np.empty((3, image_size)))
        return Rendering(image, coverage > SUPERSAMPLING, _box(left, top, shown >= 0))

    def _place(self, backdrop, camera: Pinhole) -> Place:
        ambient = AMBIENT * (np.array(backdrop.horizon) + np.array(backdrop.zenith))
        buildings = _buildings_in_sight(backdrop.buildings, camera)
        ours = {"buildings": buildings, "ambient": _triple(ambient), "noise": self._noise}
        return Place(**vars(backdrop) | ours)


def _kernel_camera(camera: Pinhole, samples: int) -> KernelCamera:
    right, up, back = map(_triple, camera.axes)
    step = 2 * camera.tangent / samples
    x, y = camera.offset
    return KernelCamera(_triple(camera.eye), right, up, back, step, ((1 - x) / 2 * samples, (1 + y) / 2 * samples))


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


def _box(left: int, top: int, seen) -> npt.NDArray[np.float64] | None:
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if not len(rows):
        return None
    corners = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], dtype=np.float64)
    corner = np.array([left, top, left, top])
    box: npt.NDArray[np.float64] = (corners + corner) / SUPERSAMPLING
    return box


def _triple(vector: npt.NDArray[np.float64]) -> Triple:
    x, y, z = vector.tolist()
    return x, y, z



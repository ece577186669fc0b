"""The z-buffer: PyBullet's TinyRenderer as a second opinion, no gaps, equal bits everywhere."""

import dataclasses
import hashlib
import os
import subprocess
import sys

import numpy as np
import pybullet
import pytest
from scipy.spatial import Delaunay

from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.renderers.gbuffer import KernelCamera
from sada_gym.envs.detection.renderers.rasteriser import _kernel_camera
from sada_gym.envs.detection.renderers.zbuffer import COORDINATES, PLANES, project, rasterise
from sada_gym.envs.detection.scene import camera_of
from sada_gym.envs.detection.shapes import Material, Surface, benchmark_shapes

MU = np.random.default_rng(5).uniform(-1, 1, (12, 8)).astype(np.float32)
SAMPLES, NEAR, FAR = 192, 2.0, 32.0


def drawn(vertices, faces, camera, samples=SAMPLES, double_sided=False):
    """Return the inverse depth (samples, samples) of what is nearest, and which face it is."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    points = np.empty((len(vertices), COORDINATES))
    project(vertices, camera, points)
    nearest, shown = np.zeros((samples, samples)), np.full((samples, samples), -1, np.int32)
    planes = np.empty((len(faces), PLANES))
    faces = np.ascontiguousarray(faces, np.int32)
    places = np.empty((len(points), 2), np.int32)
    rasterise(points, places, faces, double_sided, (0, 0), planes, nearest, shown)
    return nearest, shown


def tiny(shape, camera):
    """Draw a shape by TinyRenderer: depth (samples, samples), and where it is seen."""
    client = pybullet.connect(pybullet.DIRECT)
    corners = shape.vertices[shape.faces].reshape(-1, 3)
    visual = pybullet.createVisualShape(
        pybullet.GEOM_MESH,
        vertices=corners.tolist(),
        indices=list(range(len(corners))),
        normals=shape.normals[shape.faces].reshape(-1, 3).tolist(),
        physicsClientId=client,
    )
    pybullet.createMultiBody(0, -1, visual, physicsClientId=client)
    projection = np.zeros((4, 4))
    projection[[0, 1], [0, 1]] = 1 / camera.tangent
    # a sample is its lower right corner there
    projection[:2, 2] = np.array(camera.offset) + 1 / SAMPLES
    projection[2, 2:] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)
    projection[3, 2] = -1.0
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([camera.axes, -camera.axes @ camera.eye])
    _, _, _, depth, bodies = pybullet.getCameraImage(
        SAMPLES,
        SAMPLES,
        matrix.T.ravel().tolist(),
        projection.T.ravel().tolist(),
        renderer=pybullet.ER_TINY_RENDERER,
        physicsClientId=client,
    )
    pybullet.disconnect(client)
    square = (SAMPLES, SAMPLES)
    depth = FAR * NEAR / (FAR - (FAR - NEAR) * np.reshape(depth, square).astype(np.float64))
    return depth, np.reshape(bodies, square) >= 0


@pytest.mark.parametrize("name", ["car", "bicycle", "chair"])
def test_silhouettes_and_depths_are_those_of_tinyrenderer(name):
    application = DetectionApplication(name)
    for seed, mu in enumerate(MU[:4]):
        scene = application.scene(mu, seed)
        camera = camera_of(scene)
        nearest, _ = drawn(scene.shape.vertices, scene.shape.faces, _kernel_camera(camera, SAMPLES))
        depth, seen = tiny(scene.shape, camera)
        assert seen.sum() > 300
        assert ((nearest > 0) != seen).sum() <= 0.002 * seen.sum()
        both = seen & (nearest > 0)
        assert np.abs(1 / nearest[both] - depth[both]).mean() < 1e-4


def looking_down(samples, tangent=1.0):
    """Place a camera 2 above the origin that looks down; up is +y."""
    middle = (samples / 2, samples / 2)
    axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return KernelCamera((0.0, 0.0, 2.0), *axes, 2 * tangent / samples, middle)


@pytest.mark.parametrize("samples", [64, 129])
def test_triangles_that_share_edges_show_every_sample_once(samples):
    """Corners lie on samples, between them, and anywhere; many triangles are smaller than one."""
    rng = np.random.default_rng(samples)
    grid = (np.arange(samples) + 0.5) * 4 / samples - 2
    flat = np.concatenate(
        [
            rng.uniform(-2, 2, (2_000, 2)),
            rng.choice(grid, (2_000, 2)),
            rng.choice(np.linspace(-2, 2, 17), (300, 2)),
            [[-3, -3], [-3, 3], [3, -3], [3, 3]],
        ]
    )
    flat = np.unique(flat.astype(np.float32), axis=0)
    faces = Delaunay(flat).simplices
    turned = np.linalg.det(flat[faces[:, 1:]] - flat[faces[:, :1]]) < 0
    faces[turned] = faces[turned][:, ::-1]
    vertices = np.column_stack([flat, np.zeros(len(flat))])
    camera = looking_down(samples)
    nearest, shown = drawn(vertices, faces, camera, samples)
    np.testing.assert_allclose(nearest, 0.5, atol=1e-9)
    counts = np.zeros((samples, samples), int)
    for face in faces:
        counts += drawn(vertices[face], [[0, 1, 2]], camera, samples)[1] >= 0
    np.testing.assert_array_equal(counts, 1)
    assert shown.min() >= 0


def test_the_nearest_face_is_shown_whatever_the_order():
    rng = np.random.default_rng(1)
    vertices = rng.uniform(-1, 1, (90, 3))
    faces = np.arange(90).reshape(-1, 3)
    nearest, shown = drawn(vertices, faces, looking_down(64), 64, double_sided=True)
    back, other = drawn(vertices, faces[::-1], looking_down(64), 64, double_sided=True)
    np.testing.assert_array_equal(back, nearest)
    np.testing.assert_array_equal(np.where(other >= 0, 29 - other, -1), shown)
    assert len(np.unique(shown)) > 10


def textured(shape):
    """Give a shape's materials textures, one with holes, and make its windows glass."""
    rng = np.random.default_rng(0)
    surfaces = [
        Surface(
            material=material,
            texture=rng.integers(100, 256, (37, 64, 4), dtype=np.uint8),
            opacity=0.4 if material == Material.GLASS else 1.0,
        )
        for material in Material
    ]
    return dataclasses.replace(shape, surfaces=tuple(surfaces), uv=shape.vertices[:, ::2])


def digest():
    """Digest pictures of all materials and grounds, and their masks."""
    pictures = hashlib.sha256()
    for name in ("car", "bicycle", "diningtable"):
        application = DetectionApplication(name)
        scenes = [application.scene(mu, seed) for seed, mu in enumerate(MU)]
        scenes += [dataclasses.replace(this, shape=textured(this.shape)) for this in scenes[:2]]
        for rendering in default_renderer().render_batch(scenes, 96):
            pictures.update(rendering.image.tobytes() + rendering.mask.tobytes())
            pictures.update(rendering.box.tobytes())
    return pictures.hexdigest()


@pytest.mark.long
def test_pictures_are_the_same_whatever_processor_the_kernels_are_compiled_for(tmp_path):
    """With a generic target there is neither AVX nor a fused multiplication and addition."""
    environment = os.environ | {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTHONPATH": os.path.dirname(__file__),
    }
    command = [sys.executable, "-c", "import test_zbuffer; print(test_zbuffer.digest())"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert run.stdout.strip() == digest(), run.stderr


def test_the_benchmarks_shapes_are_closed():
    """A face that looks away is never needed: what is drawn double-sided looks the same."""
    for shape in (benchmark_shapes("car")[0], benchmark_shapes("chair")[0]):
        camera = looking_down(128, 4.0)._replace(eye=(0.0, 0.0, 9.0))
        nearest, _ = drawn(shape.vertices, shape.faces, camera, 128)
        both, _ = drawn(shape.vertices, shape.faces, camera, 128, double_sided=True)
        np.testing.assert_array_equal(nearest, both)

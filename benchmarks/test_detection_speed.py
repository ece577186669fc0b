"""Detection's speed, as ratios within one run: `make bench`. No test fails on a time.

The yardstick is one bare TinyRenderer frame of the same scene with everything in it (ground,
buildings, object) and its own shadow, 128 pixels, over uniform mu.
"""

import dataclasses
import statistics
import time

import gymnasium as gym
import numpy as np
import pytest
import torch
import trimesh

import sada_gym  # noqa: F401
from sada_gym.adversaries import make
from sada_gym.envs.detection import DetectionApplication
from sada_gym.envs.detection.detector import DETECTOR_TILE
from sada_gym.envs.detection.renderers import default_renderer
from sada_gym.envs.detection.scene import FIELD_OF_VIEW_DEG, camera_of, light_of
from sada_gym.envs.detection.shapes import Material, Surface
from sada_gym.envs.detection.shapes.assembly import Part, assemble
from sada_gym.evaluation.oracle import Oracle

BATCH = 64
RNG = np.random.default_rng(0)
MU = RNG.uniform(-1, 1, (BATCH, 8)).astype(np.float32)
SEEDS = RNG.integers(2**31, size=BATCH).tolist()
MEDIANS: dict[str, float] = {}
"""Seconds an evaluation (or a frame), by what was measured."""


@pytest.fixture(autouse=True)
def one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def record(benchmark, name, count=1):
    MEDIANS[name] = statistics.median(benchmark.stats.stats.data) / count
    benchmark.extra_info["ms each"] = 1e3 * MEDIANS[name]


class BareFrames:
    """The same scenes with PyBullet alone."""

    def __init__(self, application):
        import pybullet

        self.bullet, self.application = pybullet, application
        self.client = pybullet.connect(pybullet.DIRECT)

    def place(self, mu, seed):
        """Load ground, buildings and object; give the arguments of the frame."""
        bullet, client = self.bullet, self.client
        bullet.resetSimulation(physicsClientId=client)
        scene = self.application.scene(mu, seed)
        self._box((60, 60, 0.5), (0, 0, -0.5))
        for x, y, half_x, half_y, height, *_ in scene.backdrop.buildings.tolist():
            self._box((half_x, half_y, height / 2), (x, y, height / 2))
        faces = scene.shape.faces
        visual = bullet.createVisualShape(
            bullet.GEOM_MESH,
            vertices=scene.shape.vertices[faces].reshape(-1, 3).tolist(),
            indices=list(range(faces.size)),
            normals=scene.shape.normals[faces].reshape(-1, 3).tolist(),
            rgbaColor=(*scene.colour, 1),
            physicsClientId=client,
        )
        bullet.createMultiBody(0, -1, visual, physicsClientId=client)
        return (), {
            "width": 128,
            "height": 128,
            "viewMatrix": camera_of(scene).matrix.T.ravel().tolist(),
            "projectionMatrix": bullet.computeProjectionMatrixFOV(FIELD_OF_VIEW_DEG, 1, 0.02, 80),
            "lightDirection": light_of(scene).tolist(),
            "shadow": 1,
            "renderer": bullet.ER_TINY_RENDERER,
            "physicsClientId": client,
        }

    def _box(self, half, centre):
        visual = self.bullet.createVisualShape(
            self.bullet.GEOM_BOX, halfExtents=half, physicsClientId=self.client
        )
        self.bullet.createMultiBody(0, -1, visual, basePosition=centre, physicsClientId=self.client)


def test_bare_frame(benchmark):
    frames = BareFrames(DetectionApplication("car"))
    turn = iter(range(10_000))

    def setup():
        i = next(turn) % BATCH
        return frames.place(MU[i], SEEDS[i])

    benchmark.pedantic(frames.bullet.getCameraImage, setup=setup, rounds=BATCH)
    record(benchmark, "bare frame")


def textured(faces):
    """Make a ball of so many faces, with a texture of 1,024 pixels; it shows from both sides."""
    ball = trimesh.creation.icosphere(6)
    part = trimesh.Trimesh(ball.vertices, ball.faces[:faces], process=False)
    shape = assemble("bench/ball", "car", [Part(part)])
    pixels = np.random.default_rng(0).integers(0, 256, (1_024, 1_024, 4), dtype=np.uint8)
    pixels[..., 3] = 255
    surface = Surface(texture=pixels, material=Material.PAINT)
    uv = shape.normals[:, :2]
    return dataclasses.replace(shape, surfaces=(surface,), uv=uv, double_sided=True)


@pytest.mark.benchmark(timer=time.process_time)
@pytest.mark.parametrize("faces", [0, 5_000, 60_000])
def test_pictures_of_320_pixels(benchmark, faces):
    """The default renderer alone: the benchmark's cars, and a textured model of so many faces."""
    application = DetectionApplication("car")
    scenes = [application.scene(mu, seed) for mu, seed in zip(MU[:16], SEEDS, strict=False)]
    if faces:
        shape = textured(faces)
        scenes = [dataclasses.replace(this, shape=shape) for this in scenes]
    benchmark.pedantic(default_renderer().render_batch, (scenes, 320), rounds=10, warmup_rounds=1)
    record(benchmark, f"320 pixels, {faces:,} textured faces", len(scenes))


def test_batch(benchmark):
    application = DetectionApplication("car")
    benchmark.pedantic(application.evaluate, (MU, SEEDS), rounds=10, warmup_rounds=1)
    record(benchmark, "batch of 64", BATCH)


@pytest.mark.parametrize("tile", [DETECTOR_TILE, 1])
def test_scalar_step(benchmark, tile):
    env = gym.make("SADA-Detection-Car-v0", tile=tile).unwrapped

    def loop():
        for mu in MU:
            env.reset()
            env.step(mu)

    benchmark.pedantic(loop, rounds=5, warmup_rounds=1)
    record(benchmark, "scalar step" if tile > 1 else "scalar step, unpadded", BATCH)


def test_make_vec(benchmark):
    envs = gym.make_vec("SADA-Detection-Car-v0", num_envs=BATCH)
    envs.reset(seed=0)
    benchmark.pedantic(envs.step, (MU,), rounds=10, warmup_rounds=1)
    record(benchmark, "make_vec of 64", BATCH)


@pytest.mark.parametrize("workers", [1, 2])
def test_workers(benchmark, workers):
    count = 1_024
    mu = np.random.default_rng(1).uniform(-1, 1, (count, 8))
    with Oracle("SADA-Detection-Car-v0", budget=100 * count, workers=workers, seed=0) as oracle:
        benchmark.pedantic(oracle, (mu,), rounds=3, warmup_rounds=1)
    record(benchmark, f"oracle, {workers} worker(s)", count)


def test_bbgan_training(benchmark):
    """BBGAN's own time: an instant function is queried."""

    def train():
        oracle = Oracle(
            lambda mu: np.abs(mu).max(axis=1), dimension=8, threshold=0.7, budget=2_000, seed=0
        )
        make("bbgan", 8, seed=0).train(oracle)

    benchmark.pedantic(train, rounds=1)
    record(benchmark, "bbgan's training")


def test_ratios(capsys):
    """Print the ratios of what ran."""
    wanted = (
        ("batch of 64", "bare frame", "at most 0.25"),
        ("scalar step", "batch of 64", "at most 3"),
        ("scalar step", "scalar step, unpadded", "at most 3"),
        ("make_vec of 64", "batch of 64", "at most 1.2"),
        (*("320 pixels, 5,000 textured faces", "320 pixels, 0 textured faces"), "at most 2"),
        (*("320 pixels, 60,000 textured faces", "320 pixels, 0 textured faces"), "at most 2.1"),
        ("oracle, 1 worker(s)", "oracle, 2 worker(s)", "at least 1.9"),
    )
    with capsys.disabled():
        print("\n\n| what | over | ratio | target |\n| --- | --- | --- | --- |")
        for a, b, target in wanted:
            if a in MEDIANS and b in MEDIANS:
                print(f"| {a} | {b} | {MEDIANS[a] / MEDIANS[b]:.2f} | {target} |")
        print("\n| what | ms each | a second |\n| --- | --- | --- |")
        for name, seconds in MEDIANS.items():
            print(f"| {name} | {1e3 * seconds:.2f} | {1 / seconds:.0f} |")

"""Labelled renders, on which the detectors are trained and measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.renderers import Renderer, default_renderer
from sada_gym.envs.detection.scene import Scene
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from sada_gym.envs.detection.shapes.model import Shape
from studies.shapes.catalogue import TRAINING_SEED, generate
from studies.training.detection.prior import photograph, survey

TRAINING_SHAPES = range(TRAINING_SEED, TRAINING_SEED + 120)
"""Shape seeds, of each class, to train on."""

VALIDATION_SHAPES = range(TRAINING_SEED + 1_000, TRAINING_SEED + 1_040)
"""Shape seeds, of each class, that training never sees; the benchmark's lie below TRAINING_SEED."""

RENDERED_AT_ONCE = 64
"""Scenes handed to the renderer in one call: masks and pictures of a whole set fill the memory."""

Sampler = Callable[[Shape | None, np.random.Generator], Scene]


@dataclass(frozen=True, eq=False)
class LabelledFrames:
    """Frames with at most one object each.

    Attributes:
        images: (n, size, size, 3) uint8.
        boxes: (n, 4) float32, x0 y0 x1 y1 in pixels; zeros where there is no object.
        labels: (n,) int64 from 1; 0 where there is no object.
    """

    images: npt.NDArray[np.uint8]
    boxes: npt.NDArray[np.float32]
    labels: npt.NDArray[np.int64]


def training_frames(
    per_class: int,
    *,
    survey_share: float,
    empty_share: float,
    image_size: int,
    seed: int,
    renderer: Renderer | None = None,
) -> LabelledFrames:
    """Render the training set.

    Args:
        per_class: Frames of each class.
        survey_share: Share of views from everywhere; the rest are the photographer's.
        empty_share: Empty places, as a share of all frames with an object.
        image_size: Pixels a side.
        seed: Fixes the set.
        renderer: What draws the frames, by default the process's `Rasteriser`.
    """

    def mixed(shape: Shape | None, rng: np.random.Generator) -> Scene:
        return (survey if rng.uniform() < survey_share else photograph)(shape, rng)

    empty = round(per_class * len(CLASSES) * empty_share)
    requests = _requests(per_class, TRAINING_SHAPES, empty)
    return _render(requests, mixed, image_size, np.random.default_rng(seed), renderer)


def validation_frames(
    per_class: int,
    sampler: Sampler,
    *,
    image_size: int,
    seed: int,
    renderer: Renderer | None = None,
) -> LabelledFrames:
    """Render frames of shapes that training never sees, in a sampler's scenes."""
    requests = _requests(per_class, VALIDATION_SHAPES, 0)
    return _render(requests, sampler, image_size, np.random.default_rng(seed), renderer)


def _requests(per_class: int, seeds: Sequence[int], empty: int) -> list[tuple[Shape | None, int]]:
    """Yield pairs (shape, label), shape by shape: a renderer loads each only once."""
    counts = np.bincount(np.arange(per_class) % len(seeds), minlength=len(seeds))
    placed: list[tuple[Shape | None, int]] = []
    for label, name in enumerate(CLASSES, 1):
        for shape_seed, count in zip(seeds, counts.tolist(), strict=True):
            placed += [(generate(name, shape_seed), label)] * count if count else []
    return placed + [(None, 0)] * empty


def _render(
    requests: Sequence[tuple[Shape | None, int]],
    sampler: Sampler,
    image_size: int,
    rng: np.random.Generator,
    renderer: Renderer | None,
) -> LabelledFrames:
    chosen = default_renderer() if renderer is None else renderer
    images = np.empty((len(requests), image_size, image_size, 3), dtype=np.uint8)
    boxes = np.zeros((len(requests), 4), dtype=np.float32)
    labels = np.zeros(len(requests), dtype=np.int64)
    for start in range(0, len(requests), RENDERED_AT_ONCE):
        rows = range(start, min(start + RENDERED_AT_ONCE, len(requests)))
        scenes = [replace(sampler(requests[i][0], rng), seed=i) for i in rows]
        for i, rendering in zip(rows, chosen.render_batch(scenes, image_size), strict=True):
            images[i] = rendering.image
            if rendering.box is not None:
                boxes[i], labels[i] = rendering.box, requests[i][1]
    return LabelledFrames(images, boxes, labels)


def batches(
    frames: LabelledFrames, size: int, rng: np.random.Generator
) -> Iterator[LabelledFrames]:
    """Yield an epoch of shuffled batches, mirrored, brightened and with sensor noise at random."""
    order = rng.permutation(len(frames.images))
    width = frames.images.shape[2]
    for start in range(0, len(order) - size + 1, size):
        chosen = order[start : start + size]
        images, boxes = frames.images[chosen], frames.boxes[chosen].copy()
        mirrored = rng.uniform(size=size) < 0.5
        images[mirrored] = images[mirrored, :, ::-1]
        boxes[mirrored, 0::2] = width - boxes[mirrored, 2::-2]
        gain = rng.uniform(0.85, 1.15, (size, 1, 1, 1))
        noise = rng.normal(0, 2.5, (size, width, width, 1))
        images = np.clip(images * gain + noise, 0, 255).astype(np.uint8)
        yield LabelledFrames(images, boxes, frames.labels[chosen])

"""A renderer, sets of shapes and a loader of agents that tests choose by a name."""

from dataclasses import replace

import numpy as np

from sada_gym.envs.detection.renderers import Renderer, Rendering
from sada_gym.envs.detection.shapes import benchmark_shapes


class Flat(Renderer):
    """Draws every scene in one grey that its seed picks."""

    version = 1

    def __init__(self):
        self.closed = 0

    @property
    def identity(self):
        return f"flat {self.version}"

    def render_batch(self, scenes, image_size):
        size = (image_size, image_size)
        return [
            Rendering(np.full((*size, 3), scene.seed % 256, np.uint8), np.zeros(size, bool), None)
            for scene in scenes
        ]

    def close(self):
        self.closed += 1


def first_two(object_class):
    """Return the first two of the benchmark's shapes, from behind as well."""
    return tuple(replace(shape, double_sided=True) for shape in benchmark_shapes(object_class)[:2])


def no_shapes(object_class):
    """Return nothing."""
    return ()


def as_loaded(path):
    """Load an agent that is nothing but its file's path."""
    return "loaded", path

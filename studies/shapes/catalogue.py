"""The procedural shapes by class and seed: the benchmark's, and as many more as training wants."""

from __future__ import annotations

import functools
import importlib
from typing import Protocol, cast

import numpy as np

from sada_gym.envs.detection.shapes.assembly import Part, assemble
from sada_gym.envs.detection.shapes.catalogue import CLASSES
from sada_gym.envs.detection.shapes.model import Shape

TRAINING_SEED = 1_000
"""Seeds from here on are for training; the benchmark's lie below, so the two share no shape."""

BENCHMARK_COUNT = dict.fromkeys(CLASSES, 8) | dict.fromkeys(
    ("aeroplane", "boat", "car", "chair"), 9
)
"""How many shapes of each class are the benchmark's: those of the first seeds."""


class _Generator(Protocol):
    """What a class's module offers: its styles, and parts of one shape in metres."""

    STYLES: tuple[str, ...]

    def build(self, style: str, rng: np.random.Generator) -> list[Part]: ...


@functools.lru_cache(maxsize=2_048)
def generate(object_class: str, seed: int) -> Shape:
    """Return the shape of a class and seed; consecutive seeds cycle through the class's styles.

    Args:
        object_class: One of `CLASSES`.
        seed: At least 0. Those below `TRAINING_SEED` belong to the benchmark, others to training.

    Returns:
        A shape whose arrays are read-only, the same for the same arguments.

    Raises:
        ValueError: If the class is unknown or the seed negative.
    """
    generator = _generator(object_class)
    if seed < 0:
        raise ValueError(f"Expected a seed of at least 0, got {seed}; benchmark shapes start at 0.")
    style = generator.STYLES[seed % len(generator.STYLES)]
    rng = np.random.default_rng([CLASSES.index(object_class), seed])
    parts = generator.build(style, rng)
    shape = assemble(f"{object_class}/{style}-{seed}", object_class, parts)
    for array in (shape.vertices, shape.normals, shape.faces, shape.materials):
        array.flags.writeable = False
    return shape


def styles(object_class: str) -> tuple[str, ...]:
    """Return the names of a class's styles in the order in which consecutive seeds take them.

    Args:
        object_class: One of `CLASSES`.

    Raises:
        ValueError: If the class is unknown.
    """
    return _generator(object_class).STYLES


def _generator(object_class: str) -> _Generator:
    if object_class not in CLASSES:
        raise ValueError(
            f"Expected object_class to be one of {', '.join(CLASSES)}, got {object_class!r}; "
            "choose one of these."
        )
    return cast("_Generator", importlib.import_module(f"{__package__}.{object_class}"))

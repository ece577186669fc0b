"""The shapes by class and seed: the fixed benchmark of 100, and as many more as training wants."""

from __future__ import annotations

import functools
import importlib
import re
from typing import Protocol, cast

import numpy as np

from sada_gym.envs.detection.shapes.assembly import assemble
from sada_gym.envs.detection.shapes.kit import Part
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.errors import UserError

CLASSES = (
    "aeroplane",
    "bench",
    "bicycle",
    "boat",
    "bottle",
    "bus",
    "car",
    "chair",
    "diningtable",
    "motorbike",
    "train",
    "truck",
)
"""The paper's 12 classes, in the order of their labels."""

TRAINING_SEED = 1_000
"""Seeds from here on are for training; the benchmark's lie below, so the two share no shape."""

_BENCHMARK_COUNT = dict.fromkeys(CLASSES, 8) | dict.fromkeys(
    ("aeroplane", "boat", "car", "chair"), 9
)

_NAME = re.compile(r"(?P<object_class>[a-z]+)/[a-z_]+-(?P<seed>[0-9]{1,9})")


class _Generator(Protocol):
    """What a class's module offers: its styles, and parts of one shape in metres."""

    STYLES: tuple[str, ...]

    def build(self, style: str, rng: np.random.Generator) -> list[Part]: ...


@functools.lru_cache(maxsize=2_048)
def generate(object_class: str, seed: int) -> Shape:
    """Gives the shape of a class and seed; consecutive seeds cycle through the class's styles.

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
        raise UserError(f"Expected a seed of at least 0, got {seed}; benchmark shapes start at 0.")
    style = generator.STYLES[seed % len(generator.STYLES)]
    rng = np.random.default_rng([CLASSES.index(object_class), seed])
    parts = generator.build(style, rng)
    shape = assemble(f"{object_class}/{style}-{seed}", object_class, parts)
    for array in (shape.vertices, shape.normals, shape.faces, shape.materials):
        array.flags.writeable = False
    return shape


@functools.cache
def benchmark_shapes(object_class: str) -> tuple[Shape, ...]:
    """Gives a class's benchmark shapes: 8, or 9 of aeroplane, boat, car and chair; 100 in all.

    Args:
        object_class: One of `CLASSES`.

    Raises:
        ValueError: If the class is unknown.
    """
    _check(object_class)
    return tuple(generate(object_class, seed) for seed in range(_BENCHMARK_COUNT[object_class]))


def find_shape(name: str) -> Shape | None:
    """Gives the shape of `generate` that has a name, such as `car/saloon-0`; None if none has."""
    found = _NAME.fullmatch(name)
    if found is None or found["object_class"] not in CLASSES:
        return None
    shape = generate(found["object_class"], int(found["seed"]))
    return shape if shape.name == name else None


def styles(object_class: str) -> tuple[str, ...]:
    """Gives the names of a class's styles in the order in which consecutive seeds take them.

    Args:
        object_class: One of `CLASSES`.

    Raises:
        ValueError: If the class is unknown.
    """
    return _generator(object_class).STYLES


def _check(object_class: str) -> None:
    if object_class not in CLASSES:
        raise UserError(
            f"Expected object_class to be one of {', '.join(CLASSES)}, got {object_class!r}; "
            "choose one of these, or load your own shapes from a folder a class."
        )


def _generator(object_class: str) -> _Generator:
    _check(object_class)
    return cast("_Generator", importlib.import_module(f"{__package__}.{object_class}"))

"""CAD shapes of 12 classes: procedural by seed, the fixed benchmark of 100, or a user's files."""

from sada_gym.envs.detection.shapes.cad import fingerprint, load_class, load_folder
from sada_gym.envs.detection.shapes.catalogue import (
    CLASSES,
    TRAINING_SEED,
    benchmark_shapes,
    generate,
    styles,
)
from sada_gym.envs.detection.shapes.model import DIAGONAL, Material, Shape

__all__ = [
    "CLASSES",
    "DIAGONAL",
    "TRAINING_SEED",
    "Material",
    "Shape",
    "benchmark_shapes",
    "fingerprint",
    "generate",
    "load_class",
    "load_folder",
    "styles",
]

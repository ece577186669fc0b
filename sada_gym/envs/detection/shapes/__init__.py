"""CAD shapes: the fixed benchmark of 100 in 12 classes, or a user's files."""

from sada_gym.envs.detection.shapes.cad import fingerprint, load_class, load_folder
from sada_gym.envs.detection.shapes.catalogue import CLASSES, benchmark_shapes
from sada_gym.envs.detection.shapes.model import DIAGONAL, Material, Shape, Surface
from sada_gym.envs.detection.shapes.registry import find_shapes

__all__ = [
    "CLASSES",
    "DIAGONAL",
    "Material",
    "Shape",
    "Surface",
    "benchmark_shapes",
    "find_shapes",
    "fingerprint",
    "load_class",
    "load_folder",
]

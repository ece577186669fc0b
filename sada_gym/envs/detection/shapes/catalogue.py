"""The 100 shapes of the benchmark, as one file of arrays holds them."""

from __future__ import annotations

import functools
import hashlib
from io import BytesIO
from pathlib import Path

import numpy as np

from sada_gym.envs.detection.card import CARD
from sada_gym.envs.detection.shapes.model import MESH_ARRAYS, Shape
from sada_gym.errors import FileError, UserError

CLASSES: tuple[str, ...] = tuple(track["object_class"] for track in CARD.tracks.values())
"""The paper's 12 classes, in the order of their labels."""

FILE = Path(__file__).with_name("benchmark.npz")
"""The shapes, written by `python -m studies.shapes.build` in the repository.

Each class has the arrays of its k shapes one after another: `car.names` (k,), `car.sizes` (k, 2),
the numbers of vertices and faces, and `car.vertices`, `car.normals`, `car.faces`, `car.materials`.
"""

SHA256 = "46e44bb2531813763af0fbe3b8bfdf5572f5318beff8809ac7206f457a739bf3"
"""The SHA-256 of the file that the benchmark was measured with."""


@functools.cache
def benchmark_shapes(object_class: str) -> tuple[Shape, ...]:
    """Return a class's benchmark shapes: 8, or 9 of aeroplane, boat, car and chair; 100 in all.

    Raises:
        UserError: If the class is unknown.
        FileError: If the file of shapes is missing or was changed.
    """
    if object_class not in CLASSES:
        raise UserError(
            f"Expected object_class to be one of {', '.join(CLASSES)}, got {object_class!r}; "
            "choose one of these, or give shapes=PATH for CAD files of another class."
        )
    with np.load(BytesIO(_verified(FILE)), allow_pickle=False) as file:
        names, ends = file[f"{object_class}.names"], file[f"{object_class}.sizes"].cumsum(axis=0)
        meshes = {name: file[f"{object_class}.{name}"] for name in MESH_ARRAYS}
    # one shape's arrays after another's, cut where a shape's vertices or faces end
    cuts = {"vertices": 0, "normals": 0, "faces": 1, "materials": 1}
    pieces = [np.split(meshes[name], ends[:-1, column]) for name, column in cuts.items()]
    return tuple(
        Shape(name, object_class, *arrays)
        for name, *arrays in zip(names.tolist(), *pieces, strict=True)
    )


def find_shape(name: str) -> Shape | None:
    """Find the benchmark's shape of a name, such as `car/saloon-0`; None if there is none."""
    object_class = name.partition("/")[0]
    shapes = benchmark_shapes(object_class) if object_class in CLASSES else ()
    return next((shape for shape in shapes if shape.name == name), None)


def _verified(path: Path) -> bytes:
    if not path.is_file():
        raise FileError(
            f"Expected the benchmark's shapes in {path}, got no such file. Install the package "
            "again."
        )
    content = path.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    if sha256 != SHA256:
        raise FileError(
            f"Expected {path.name} with SHA-256 {SHA256[:12]}..., got {sha256[:12]}...: the "
            "benchmark's shapes were changed. Install the package again."
        )
    return content

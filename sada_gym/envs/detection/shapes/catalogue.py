"""The 100 shapes of the benchmark, as one file of arrays holds them."""

from __future__ import annotations

import functools
import hashlib
from io import BytesIO
from pathlib import Path

import numpy as np

from sada_gym.envs.detection.card import CARD
from sada_gym.envs.detection.shapes.model import Shape
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
    """Give a class's benchmark shapes: 8, or 9 of aeroplane, boat, car and chair; 100 in all.

    Args:
        object_class: One of `CLASSES`.

    Returns:
        Shapes whose arrays are read-only, the same for the same class.

    Raises:
        UserError: If the class is unknown.
        FileError: If the file of shapes is missing or was changed.
    """
    if object_class not in CLASSES:
        raise UserError(
            f"Expected object_class to be one of {', '.join(CLASSES)}, got {object_class!r}; "
            "give shapes=PATH for CAD files of another class."
        )
    with np.load(BytesIO(_verified(FILE)), allow_pickle=False) as file:
        arrays = {
            name: file[f"{object_class}.{name}"]
            for name in ("names", "sizes", "vertices", "normals", "faces", "materials")
        }
    shapes = []
    ends = arrays["sizes"].cumsum(axis=0)
    for name, (vertex, face), (vertices, faces) in zip(
        arrays["names"].tolist(), (ends - arrays["sizes"]).tolist(), ends.tolist(), strict=True
    ):
        shape = Shape(
            name=name,
            object_class=object_class,
            vertices=arrays["vertices"][vertex:vertices],
            normals=arrays["normals"][vertex:vertices],
            faces=arrays["faces"][face:faces],
            materials=arrays["materials"][face:faces],
        )
        shapes.append(shape)
    return tuple(shapes)


def find_shape(name: str) -> Shape | None:
    """Find the benchmark's shape of a name, such as `car/saloon-0`; None if there is none."""
    object_class = name.partition("/")[0]
    shapes = benchmark_shapes(object_class) if object_class in CLASSES else ()
    return next((shape for shape in shapes if shape.name == name), None)


def _verified(path: Path) -> bytes:
    """Read the file, and refuse one that is not the recorded one."""
    if not path.is_file():
        raise FileError(
            f"Expected the benchmark's shapes in {path}, got no such file. Install the package "
            "again."
        )
    content = path.read_bytes()
    found = hashlib.sha256(content).hexdigest()
    if found != SHA256:
        raise FileError(
            f"Expected {path.name} with SHA-256 {SHA256[:12]}..., got {found[:12]}...: the "
            "benchmark's shapes were changed. Install the package again."
        )
    return content

"""A CAD shape as the renderer takes it: a triangle mesh with normals and a material per face."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.errors import UserError

DIAGONAL = 5.0
"""Length of every shape's bounding-box diagonal in scene units."""

MESH_ARRAYS: dict[str, type[np.generic]] = {
    "vertices": np.float32,
    "normals": np.float32,
    "faces": np.int32,
    "materials": np.uint8,
}
"""The arrays of a mesh and their types."""


def check_keys(what: str, plain: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise `UserError` unless the plain data of `what`, such as `a scene`, has just these keys."""
    expected = sorted(names)
    if not isinstance(plain, Mapping) or sorted(plain) != expected:
        got = ", ".join(map(str, plain)) if isinstance(plain, Mapping) else repr(plain)
        raise UserError(f"Expected {what} with the keys {', '.join(expected)}, got {got}.")


class Material(IntEnum):
    """What a face is made of; only PAINT takes the colour that the adversary chooses."""

    PAINT = 0
    RUBBER = 1  # tyres: near black, matt
    GLASS = 2  # windows: dark, glossy
    METAL = 3  # rims, frames, chrome: light grey, glossy
    LAMP = 4  # head lamps, white labels: bright
    DARK = 5  # seats, plastic, undersides: dark grey, matt
    WOOD = 6  # brown, matt


@dataclass(frozen=True, eq=False)
class Shape:
    """One object, in scene units.

    The front looks along +x, the left side along +y, up is +z. The bounding box is centred on
    x = y = 0, its lowest point lies at z = 0 and its diagonal measures `DIAGONAL`.

    Attributes:
        name: Unique, such as `car/saloon-3`.
        vertices: (v, 3) float32.
        normals: (v, 3) float32, unit length; vertices are doubled where an edge is sharp.
        faces: (f, 3) int32, counter-clockwise seen from outside.
        materials: (f,) uint8, values of `Material`.
        double_sided: Whether faces show from behind too; a user's files may hold open surfaces.

    The arrays are kept as read-only views; what is of another type is copied.

    Raises:
        UserError: If an array has another shape, or a face names a vertex that there is not.
    """

    name: str
    object_class: str
    vertices: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    materials: npt.NDArray[np.uint8]
    double_sided: bool = False

    def __post_init__(self) -> None:
        """Check the mesh: kernels read it without looking."""
        vertices, faces = len(self.vertices), len(self.faces)
        shapes = ((vertices, 3), (vertices, 3), (faces, 3), (faces,))
        for (name, dtype), shape in zip(MESH_ARRAYS.items(), shapes, strict=True):
            array = np.ascontiguousarray(getattr(self, name), dtype).view()
            if array.shape != shape:
                raise UserError(
                    f"Expected {name} of shape {shape} in {self.name}, got {array.shape}."
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if faces and not (self.faces.min() >= 0 and self.faces.max() < vertices):
            raise UserError(
                f"Expected faces of {self.name} to name vertices 0 to {vertices - 1}, got "
                f"{self.faces.min()} to {self.faces.max()}."
            )

    @cached_property
    def height(self) -> float:
        """Height above the ground, in scene units."""
        return float(self.vertices[:, 2].max())

    def equals(self, other: Shape) -> bool:
        """Say whether another shape has the same name, class and mesh."""
        return self is other or all(
            np.array_equal(value, getattr(other, name)) for name, value in self.to_dict().items()
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the shape by the names of its attributes, the mesh in arrays."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Shape:
        """Make the shape that `to_dict` returned; the mesh may be in arrays or in lists.

        Raises:
            UserError: If a key is missing or unknown.
        """
        check_keys("a shape", plain, [field.name for field in fields(cls)])
        return cls(
            name=str(plain["name"]),
            object_class=str(plain["object_class"]),
            **{name: np.asarray(plain[name]) for name in MESH_ARRAYS},
            double_sided=bool(plain["double_sided"]),
        )


_NO_VECTORS = np.empty((0, 3), np.float32)
NOTHING = Shape("", "", _NO_VECTORS, _NO_VECTORS, np.empty((0, 3), np.int32), np.empty(0, np.uint8))
"""No object: a place that is empty."""

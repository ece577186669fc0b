"""A CAD shape as the renderer takes it: a triangle mesh with normals and a material per face."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.surface import Material, Surface
from sada_gym.errors import UserError

__all__ = ["DIAGONAL", "MESH_ARRAYS", "NOTHING", "Material", "Shape", "Surface", "check_keys"]

DIAGONAL = 5.0
"""Length of every shape's bounding-box diagonal in scene units."""

MESH_ARRAYS: dict[str, type[np.generic]] = {
    "vertices": np.float32,
    "normals": np.float32,
    "faces": np.int32,
    "materials": np.uint8,
}
"""The arrays of a mesh and their types."""

MAX_UV = 1_000.0
"""How often a texture may repeat: places in it would become coarse."""


def check_keys(
    what: str, plain: Mapping[str, Any], names: Iterable[str], optional: Collection[str] = ()
) -> None:
    """Raise `UserError` unless the plain data of `what`, such as `a scene`, has these keys."""
    expected = sorted(names)
    if not isinstance(plain, Mapping) or sorted(set(plain) - set(optional)) != expected:
        got = ", ".join(map(str, plain)) if isinstance(plain, Mapping) else repr(plain)
        raise UserError(f"Expected {what} with the keys {', '.join(expected)}, got {got}.")


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
        materials: (f,) uint8, values of `Material`; with `surfaces` uint16, indices into these.
        double_sided: Whether faces show from behind too; a user's files may hold open surfaces.
        surfaces: What the faces of a textured model are made of; empty for others.
        uv: (v, 2) float32, where the vertices lie in textures: u to the right, v up, (0, 0) is the
            lower left corner, and beyond 1 the texture repeats. None without textures.

    The arrays are kept as read-only views; what is of another type is copied.

    Raises:
        UserError: If an array has another shape, or a face names a vertex or a surface that there
            is not.
    """

    name: str
    object_class: str
    vertices: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int32]
    materials: npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
    double_sided: bool = False
    surfaces: tuple[Surface, ...] = ()
    uv: npt.NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        """Check the mesh: kernels read it without looking."""
        vertices, faces = len(self.vertices), len(self.faces)
        shapes: dict[str, tuple[int, ...]] = {
            "vertices": (vertices, 3),
            "normals": (vertices, 3),
            "faces": (faces, 3),
            "materials": (faces,),
            "uv": (vertices, 2),
        }
        if self.surfaces:
            self._check_surfaces()
        for name, dtype in self.array_types.items():
            array = np.ascontiguousarray(getattr(self, name), dtype).view()
            if array.shape != shapes[name]:
                raise UserError(
                    f"Expected {name} of shape {shapes[name]} in {self.name}, got {array.shape}."
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.uv is not None and not np.abs(self.uv).max(initial=0) <= MAX_UV:
            raise UserError(
                f"Expected uv of {self.name} within {MAX_UV:,.0f} of 0, got "
                f"{np.abs(self.uv).max():g}; shift them by whole numbers, or set them to 0."
            )
        if faces and not (self.faces.min() >= 0 and self.faces.max() < vertices):
            raise UserError(
                f"Expected faces of {self.name} to name vertices 0 to {vertices - 1}, got "
                f"{self.faces.min()} to {self.faces.max()}."
            )

    def _check_surfaces(self) -> None:
        # before conversion, which would wrap numbers around
        materials, count = np.asarray(self.materials), len(self.surfaces)
        if materials.size and not (materials.min() >= 0 and materials.max() < count):
            raise UserError(
                f"Expected materials of {self.name} to be surfaces 0 to {count - 1}, got "
                f"{materials.min()} to {materials.max()}."
            )
        textured = [surface.name for surface in self.surfaces if surface.texture is not None]
        if textured and self.uv is None:
            raise UserError(
                f"Expected uv in {self.name}, whose surface {textured[0]!r} has a texture, got "
                "None; give each vertex its place in the texture, or drop the texture."
            )

    @property
    def array_types(self) -> dict[str, type[np.generic]]:
        """The arrays that there are, and their types."""
        types = dict(MESH_ARRAYS)
        if self.surfaces:
            types["materials"] = np.uint16
        return types if self.uv is None else types | {"uv": np.float32}

    @cached_property
    def height(self) -> float:
        """Height above the ground, in scene units."""
        return float(self.vertices[:, 2].max())

    def equals(self, other: Shape) -> bool:
        """Say whether another shape has the same name, class, mesh and surfaces."""
        if self is other:
            return True
        mine, its = self.to_dict(), other.to_dict()
        return mine.keys() == its.keys() and all(
            np.array_equal(value, its[name]) for name, value in mine.items()
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the shape by the names of its attributes, the mesh in arrays.

        Surfaces are those of `Surface.to_dict`; `surfaces` and `uv` are left out where they are not
        set.
        """
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        if not self.surfaces:
            del plain["surfaces"]
        else:
            plain["surfaces"] = [surface.to_dict() for surface in self.surfaces]
        if self.uv is None:
            del plain["uv"]
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Shape:
        """Make the shape that `to_dict` returned; the mesh may be in arrays or in lists.

        Raises:
            UserError: If a key is missing or unknown.
        """
        optional = ("surfaces", "uv")
        names = [field.name for field in fields(cls) if field.name not in optional]
        check_keys("a shape", plain, names, optional)
        uv = plain.get("uv")
        return cls(
            name=str(plain["name"]),
            object_class=str(plain["object_class"]),
            **{name: np.asarray(plain[name]) for name in MESH_ARRAYS},
            double_sided=bool(plain["double_sided"]),
            surfaces=tuple(Surface.from_dict(surface) for surface in plain.get("surfaces", ())),
            uv=None if uv is None else np.asarray(uv, np.float32),
        )


_NO_VECTORS = np.empty((0, 3), np.float32)
NOTHING = Shape("", "", _NO_VECTORS, _NO_VECTORS, np.empty((0, 3), np.int32), np.empty(0, np.uint8))
"""No object: a place that is empty."""

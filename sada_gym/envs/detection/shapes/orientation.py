"""How mesh files are to be read: which axis points up, which one to the front, and so on."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, model_validator
from typing_extensions import Self

from sada_gym.errors import UserError

Direction = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class Orientation(BaseModel):
    """The files' axes that point up and where an object looks, ShapeNet's by default."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    up: Direction = "+y"
    front: Direction = "-z"

    @model_validator(mode="after")
    def _is_plane(self) -> Self:
        if self.up[1] == self.front[1]:
            raise UserError(
                f"Expected up and front along two different axes, got {self.up} and {self.front}; "
                "ShapeNet's are +y and -z"
            )
        return self

    def rotation(self) -> npt.NDArray[np.float64]:
        """Return the matrix (3, 3) from the files' axes to front +x, left +y, up +z."""
        up, front = _vector(self.up), _vector(self.front)
        return np.stack([front, np.cross(up, front), up])


class FolderSettings(Orientation):
    """What `shapes.json` says of a folder's files.

    Attributes:
        textures: Whether the files' materials and textures are drawn, not the paint alone.
        paint: Patterns of names of materials, such as `body*`, that take the paint all the same.
    """

    textures: bool = False
    paint: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _has_materials(self) -> Self:
        if self.paint and not self.textures:
            raise UserError(
                'Expected "textures": true beside "paint", got none; without textures, all faces '
                "are painted"
            )
        return self


def _vector(direction: str) -> npt.NDArray[np.float64]:
    vector = np.zeros(3)
    vector["xyz".index(direction[1])] = 1.0 if direction[0] == "+" else -1.0
    return vector

"""How the axes of mesh files lie: which one points up, and which one to the front."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, model_validator
from typing_extensions import Self

from sada_gym.errors import UserError

Direction = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class Orientation(BaseModel):
    """The files' axes that point up and where an object looks: of `shapes.json`, or ShapeNet's."""

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


def _vector(direction: str) -> npt.NDArray[np.float64]:
    vector = np.zeros(3)
    vector["xyz".index(direction[1])] = 1.0 if direction[0] == "+" else -1.0
    return vector

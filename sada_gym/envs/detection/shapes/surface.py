"""What the faces of shapes are made of: the benchmark's materials, and a textured model's."""

from __future__ import annotations

import base64
import binascii
import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from sada_gym.errors import UserError

MAX_TEXTURE = 1_024
"""Pixels a side of a texture."""


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
class Surface:
    """What faces of a textured model are made of.

    Attributes:
        name: The material's name in its file.
        colour: (3,) sRGB in [0, 1], multiplied with the texture where there is one.
        texture: (h, w, 4) uint8 or None: sRGB and alpha, row 0 at the top, at most `MAX_TEXTURE`
            pixels a side. Where alpha is below a half, there is a hole.
        opacity: From 0, invisible, to 1, opaque; glass lies between.
        material: Whose gloss, reflectance and metal share the surface has.
        painted: Whether the scene's colour, the adversary's, takes the place of `colour`.

    Raises:
        UserError: If one of them is not as described.
    """

    name: str = ""
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: npt.NDArray[np.uint8] | None = None
    opacity: float = 1.0
    material: Material = Material.DARK
    painted: bool = False

    def __post_init__(self) -> None:
        """Check the values; the texture is kept as a read-only view."""
        colour = np.asarray(self.colour, np.float64)
        shares = np.append(colour.ravel(), self.opacity)
        if colour.shape != (3,) or not ((shares >= 0) & (shares <= 1)).all():
            raise UserError(
                f"Expected three channels of colour and an opacity from 0 to 1 in the surface "
                f"{self.name!r}, got {self.colour!r} and {self.opacity!r}."
            )
        object.__setattr__(self, "colour", tuple(colour.tolist()))
        object.__setattr__(self, "material", _material(self.material))
        if self.texture is not None:
            object.__setattr__(self, "texture", _texture(self.name, self.texture))

    def parts(self) -> Iterator[bytes]:
        """Yield all that a picture depends on, as bytes: for fingerprints."""
        texture = np.empty((0, 0, 4), np.uint8) if self.texture is None else self.texture
        plain = self._numbers() | {"texture": texture.shape}
        yield json.dumps(plain, sort_keys=True).encode()
        yield texture.tobytes()

    def to_dict(self) -> dict[str, Any]:
        """Return numbers and texts by the attributes' names; a texture is a PNG file in base64."""
        texture = None if self.texture is None else _encoded(self.texture)
        return {"name": self.name, "texture": texture, **self._numbers()}

    def _numbers(self) -> dict[str, Any]:
        return {
            "colour": list(self.colour),
            "opacity": float(self.opacity),
            "material": int(self.material),
            "painted": bool(self.painted),
        }

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> Surface:
        """Make the surface that `to_dict` returned; a texture may be an array or lists too.

        Raises:
            UserError: If a key is missing or unknown, or a value is not as `Surface` says.
        """
        names = cls.__dataclass_fields__
        if not isinstance(plain, Mapping) or plain.keys() != names.keys():
            got = ", ".join(map(str, plain)) if isinstance(plain, Mapping) else repr(plain)
            raise UserError(f"Expected a surface with the keys {', '.join(names)}, got {got}.")
        texture = plain["texture"]
        if isinstance(texture, str):
            texture = _decoded(str(plain["name"]), texture)
        elif texture is not None:
            texture = np.asarray(texture, np.uint8)
        return cls(**{**plain, "texture": texture})


def _material(value: int) -> Material:
    try:
        return Material(value)
    except ValueError:
        names = ", ".join(f"{int(material)} ({material.name})" for material in Material)
        raise UserError(f"Expected a material among {names}, got {value!r}.") from None


def _texture(name: str, texture: Any) -> npt.NDArray[np.uint8]:
    array = np.ascontiguousarray(texture).view()
    height, width, channels = array.shape if array.ndim == 3 else (0, 0, 0)
    fits = channels == 4 and 1 <= height <= MAX_TEXTURE and 1 <= width <= MAX_TEXTURE
    if not fits or array.dtype != np.uint8:
        raise UserError(
            f"Expected a texture of shape (h, w, 4), uint8, 1 to {MAX_TEXTURE:,} pixels a side, in "
            f"the surface {name!r}, got {array.shape}, {array.dtype}."
        )
    array.flags.writeable = False
    return array


def _encoded(texture: npt.NDArray[np.uint8]) -> str:
    file = io.BytesIO()
    Image.fromarray(texture).save(file, "PNG", compress_level=1)
    return base64.b64encode(file.getvalue()).decode()


def _decoded(name: str, text: str) -> npt.NDArray[np.uint8]:
    try:
        file = io.BytesIO(base64.b64decode(text, validate=True))
        with Image.open(file, formats=["PNG"]) as image:
            if max(image.size) > MAX_TEXTURE:  # before its pixels take memory
                raise UserError(
                    f"Expected a texture of at most {MAX_TEXTURE:,} pixels a side in the surface "
                    f"{name!r}, got {image.width} x {image.height}."
                )
            return np.asarray(image.convert("RGBA"))
    except (OSError, SyntaxError, binascii.Error) as error:
        raise UserError(
            f"Expected the texture of the surface {name!r} to be a PNG file in base64, got text "
            f"that is none ({error})."
        ) from error

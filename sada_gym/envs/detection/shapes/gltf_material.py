"""Materials and textures of glTF 2.0 as surfaces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sada_gym.envs.detection.shapes.companions import Texture, decode_texture
from sada_gym.envs.detection.shapes.gltf_file import GltfFile, Json
from sada_gym.envs.detection.shapes.surface import Material, Surface
from sada_gym.envs.detection.shapes.triangles import Points
from sada_gym.errors import UserError
from sada_gym.foundations.files import shown

_REPEAT = 10497
_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


class Materials:
    """The surfaces of one file, made as primitives ask for them."""

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self._numbers: dict[tuple[int | None, bool], int] = {}
        self._surfaces: list[Surface] = []
        self._textures: dict[int, Texture] = {}

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """The surfaces by their numbers."""
        return tuple(self._surfaces)

    def of(self, primitive: Json) -> tuple[int, Points | None]:
        """Return the number of a primitive's surface, and its uv (v, 2), None without a texture."""
        attributes, index = primitive["attributes"], primitive.get("material")
        if "COLOR_0" in attributes and not _is_white(self._file.array(attributes["COLOR_0"])):
            raise UserError("colours of vertices, which are not drawn: bake them into a texture")
        material = {} if index is None else self._file.item("materials", index)
        info, factor = _base(material)
        extension = {} if info is None else info.get("extensions", {})
        transform = extension.get("KHR_texture_transform", {})
        channel = 0 if info is None else transform.get("texCoord", info.get("texCoord", 0))
        name = f"TEXCOORD_{channel}"
        uv = None
        if info is not None and name in attributes:
            uv = _transformed(self._file.array(attributes[name]).astype(float), transform)
            self._check_wrap(info["index"], uv)
        key = (index, uv is not None)
        if key not in self._numbers:
            self._numbers[key] = len(self._surfaces)
            texture = None if uv is None or info is None else self._texture(info["index"])
            self._surfaces.append(_surface(material, factor, texture))
        return self._numbers[key], None if uv is None else np.column_stack([uv[:, 0], 1 - uv[:, 1]])

    def _check_wrap(self, index: int, uv: Points) -> None:
        texture = self._file.item("textures", index)
        sampler = self._file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
        wraps = [sampler.get(name, _REPEAT) for name in ("wrapS", "wrapT")]
        for wrap, column in zip(wraps, uv.T, strict=True):
            if wrap != _REPEAT and len(column) and (column.min() < -0.01 or column.max() > 1.01):
                raise UserError(
                    "a texture that is clamped or mirrored beyond its edge, which is not drawn: "
                    "bake it, or let it repeat"
                )

    def _texture(self, index: int) -> Texture:
        texture = self._file.item("textures", index)
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = webp.get("source", texture.get("source"))
        if source is None:
            names = ", ".join(map(str, texture.get("extensions", {}))) or "no source"
            raise UserError(f"a texture with {shown(names)}, which is not read: use PNG or JPEG")
        if source not in self._textures:
            image = self._file.item("images", source)
            name = image.get("name", f"image {source}")
            if "bufferView" in image:
                content = self._file.view(image["bufferView"])
            else:
                content = self._file.uri(image["uri"], "a texture")
            self._textures[source] = decode_texture(content, name)
        return self._textures[source]


def _base(material: Json) -> tuple[Json | None, list[float]]:
    """Return a material's texture, None without one, and its linear colour and opacity."""
    old = material.get("extensions", {}).get(_GLOSSINESS)
    if old is not None:
        return old.get("diffuseTexture"), old.get("diffuseFactor", [1, 1, 1, 1])
    metal = material.get("pbrMetallicRoughness", {})
    return metal.get("baseColorTexture"), metal.get("baseColorFactor", [1, 1, 1, 1])


def _surface(material: Json, factor: list[float], texture: Texture | None) -> Surface:
    red, green, blue = (_srgb(min(max(float(share), 0.0), 1.0)) for share in factor[:3])
    mode, opacity = material.get("alphaMode", "OPAQUE"), 1.0
    if mode == "BLEND":
        opacity = float(np.clip(factor[3], 0, 1))
    elif texture is not None:
        alpha = texture[..., 3] * float(factor[3])
        cutoff = 255 * material.get("alphaCutoff", 0.5)
        solid = (alpha >= cutoff) | (mode == "OPAQUE")
        texture = np.dstack([texture[..., :3], np.where(solid, 255, 0).astype(np.uint8)])
    extensions = material.get("extensions", {})
    passing = extensions.get("KHR_materials_transmission", {}).get("transmissionFactor", 0.0)
    opacity *= 1 - float(np.clip(passing, 0, 1))
    return Surface(
        material.get("name", ""), (red, green, blue), texture, opacity, _look(material, opacity)
    )


def _look(material: Json, opacity: float) -> Material:
    if opacity < 1:
        return Material.GLASS
    metal: dict[str, Any] = material.get("pbrMetallicRoughness", {})
    if "metallicRoughnessTexture" in metal or _GLOSSINESS in material.get("extensions", {}):
        return Material.DARK
    rough = metal.get("roughnessFactor", 1.0)
    if metal.get("metallicFactor", 1.0) >= 0.5 and rough < 0.7:
        return Material.METAL
    return Material.PAINT if rough < 0.4 else Material.DARK


def _srgb(linear: float) -> float:
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def _transformed(uv: Points, transform: Json) -> Points:
    """Scale, turn and move texture coordinates as KHR_texture_transform says."""
    across, up = transform.get("scale", (1, 1))
    angle = transform.get("rotation", 0.0)
    u, v = uv[:, 0] * across, uv[:, 1] * up
    cosine, sine = math.cos(angle), math.sin(angle)
    turned = np.column_stack([u * cosine + v * sine, v * cosine - u * sine])
    return np.asarray(turned + np.array(transform.get("offset", (0, 0)), float))


def _is_white(colours: Any) -> bool:
    most = 1.0 if colours.dtype.kind == "f" else np.iinfo(colours.dtype).max
    return bool((colours >= most).all())

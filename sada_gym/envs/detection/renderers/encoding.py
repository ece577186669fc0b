"""A shape as TinyRenderer takes it: normals and materials hidden in texture coordinates.

TinyRenderer paints a pixel with the texture's colour at interpolated coordinates. With a texture
whose colour says where it was sampled, the picture tells each pixel's normal and material, and the
lighting can be ours: a G-buffer. Normals lie on an octahedral map (Cigolle et al. 2014), one map a
material, one above the other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.shapes.model import Material, Shape

CODE_SIZE = 256
"""Texels a side of the map of one material."""

Matrix = npt.NDArray[np.float64]


class Mesh(NamedTuple):
    """A mesh with a vertex a corner, as codes belong to faces: (c, 3), (c, 2), (c, 3)."""

    corners: npt.NDArray[np.float32]
    texture: Matrix
    normals: npt.NDArray[np.float32]


def code_texture() -> npt.NDArray[np.uint8]:
    """Make the texture, (7 * CODE_SIZE, CODE_SIZE, 3): red, green code normals, blue materials."""
    count = len(Material)
    code = np.empty((count, CODE_SIZE, CODE_SIZE, 3), dtype=np.uint8)
    ramp = np.round((np.arange(CODE_SIZE) + 0.5) / CODE_SIZE * 255).astype(np.uint8)
    code[..., 0] = ramp
    code[..., 1] = ramp[:, None]
    code[..., 2] = np.arange(count)[:, None, None]
    return code.reshape(-1, CODE_SIZE, 3)


def encode(shape: Shape) -> Mesh:
    """Lay a shape's corners out with their codes as texture coordinates."""
    faces = shape.faces
    corners = shape.vertices[faces].reshape(-1, 3)
    codes = _octahedral(shape.normals)[faces]
    spread = np.ptp(codes, axis=1).max(axis=1)
    sides = np.cross(
        shape.vertices[faces[:, 1]] - shape.vertices[faces[:, 0]],
        shape.vertices[faces[:, 2]] - shape.vertices[faces[:, 0]],
    )
    flat = _octahedral(sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-12))
    # a face that straddles the map's seam would sample texels of foreign normals on the way
    codes[spread > 0.5] = flat[spread > 0.5][:, None]
    texture = codes.reshape(-1, 2).clip(0.5 / CODE_SIZE, 1 - 0.5 / CODE_SIZE)
    rows = np.repeat(shape.materials, 3)
    texture[:, 1] = 1 - (rows + texture[:, 1]) / len(Material)
    return Mesh(corners, texture, shape.normals[faces].reshape(-1, 3))


def _octahedral(normals: npt.NDArray[Any]) -> Matrix:
    """Map unit vectors (n, 3) to the unit square (n, 2)."""
    scaled = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-12)
    signs = np.where(scaled[:, :2] >= 0, 1.0, -1.0)
    folded = (1 - np.abs(scaled[:, 1::-1])) * signs
    code: Matrix = np.where(scaled[:, 2:] < 0, folded, scaled[:, :2]).astype(np.float64)
    return code / 2 + 0.5

"""Prepares a textured model for the kernels: its faces sorted, its textures at all sizes."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

from sada_gym.envs.detection.renderers.gbuffer import MATERIALS, Skin
from sada_gym.envs.detection.shapes.model import Shape
from sada_gym.envs.detection.shapes.surface import Surface

Texture = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]

LINEAR = np.array([(level / 255) ** 2.2 for level in range(256)])
"""Light of each sRGB byte."""

DARK = 0.5
"""Glass that lets less than this through casts a shadow."""

_HALF = 127.5
_SKINS: WeakKeyDictionary[Shape, Skin] = WeakKeyDictionary()


def skin_of(shape: Shape) -> Skin:
    """Prepare a shape with surfaces; it is done once while the shape lives."""
    skin = _SKINS.get(shape)
    if skin is None:
        skin = _SKINS[shape] = _prepared(shape)
    return skin


def looks(surfaces: Sequence[Surface], colour: tuple[float, float, float]) -> Floats:
    """Make the table of `MATERIALS` for surfaces in a scene's colour, (s, 7), colours as light."""
    table: Floats = MATERIALS[[int(surface.material) for surface in surfaces]]
    for row, surface in zip(table, surfaces, strict=True):
        row[:3] = [channel**2.2 for channel in (colour if surface.painted else surface.colour)]
    return table


def _prepared(shape: Shape) -> Skin:
    surfaces, levels, texels = shape.surfaces, [np.empty((0, 3), np.int64)], [_NO_TEXELS]
    textures, known = np.zeros((len(surfaces), 3), np.int64), dict[int, tuple[int, int, bool]]()
    for s, surface in enumerate(surfaces):
        if surface.texture is None:
            continue
        if id(surface.texture) not in known:  # several surfaces may share one
            holes = bool((surface.texture[..., 3] < _HALF).any())
            pyramid = _pyramid(surface.texture)
            first, start = sum(map(len, levels)), sum(map(len, texels))
            known[id(surface.texture)] = (first, first + len(pyramid), holes)
            sizes = np.array([level.shape[:2] for level in pyramid], np.int64)
            starts = start + np.append(0, sizes.prod(axis=1).cumsum()[:-1])
            levels.append(np.column_stack([starts, sizes]))
            texels += [level.reshape(-1, 4) for level in pyramid]
        textures[s] = known[id(surface.texture)]
    opacity = np.array([surface.opacity for surface in surfaces])
    # solid faces, those with holes, dark glass, clear glass; what is invisible is left out
    glass = np.where(opacity >= DARK, 2, np.where(opacity > 0, 3, 4))
    kind = np.where(opacity == 1, textures[:, 2], glass)[shape.materials]
    order = np.argsort(kind, kind="stable")
    cut, dark, clear, seen = np.searchsorted(kind[order], [1, 2, 3, 4]).tolist()
    order = order[:seen]
    return Skin(
        cut=cut,
        dark=dark,
        clear=clear,
        faces=shape.faces[order],
        materials=shape.materials[order],
        uv=np.zeros((len(shape.vertices), 2), np.float32) if shape.uv is None else shape.uv,
        opacity=opacity,
        textures=textures,
        levels=np.concatenate(levels),
        texels=np.concatenate(texels),
        linear=LINEAR,
        nearest=np.empty((0, 0)),
        panes=np.empty((0, 0), np.int32),
    )


_NO_TEXELS = np.empty((0, 4), np.uint8)


def _pyramid(texture: Texture) -> list[Texture]:
    """Make a texture's levels, each half as large as the one before, down to one texel.

    Their alpha is how much of a texel is solid: all or nothing in the largest one.
    """
    share = (texture[..., 3:] > _HALF).astype(np.float64)
    levels = [np.concatenate([texture[..., :3], 255 * share], axis=2).astype(np.uint8)]
    # holes have no say in the colour
    light = np.concatenate([LINEAR[texture[..., :3]] * share, share], axis=2)
    while max(light.shape[:2]) > 1:
        light = _halved(_halved(light).swapaxes(0, 1)).swapaxes(0, 1)
        levels.append(_bytes_of(light))
    return levels if share.all() else _filled(levels)


def _halved(light: Floats) -> Floats:
    """Halve the rows; an odd number of them is shared out by area."""
    count = len(light)
    if count == 1:
        return light
    if count % 2 == 0:
        return (light[::2] + light[1::2]) / 2
    half = count // 2
    place = np.arange(half)[:, None, None]
    middle: Floats = half * light[1::2]
    return (middle + (half - place) * light[:-1:2] + (place + 1) * light[2::2]) / count


def _bytes_of(light: Floats) -> Texture:
    share = light[..., 3:]
    colour = np.divide(light[..., :3], share, out=np.zeros_like(light[..., :3]), where=share > 0)
    levels = np.searchsorted((LINEAR[1:] + LINEAR[:-1]) / 2, colour)
    return np.concatenate([levels, np.round(255 * share)], axis=2).astype(np.uint8)


def _filled(levels: list[Texture]) -> list[Texture]:
    """Let colours go on into holes, so that no other colour shows at their rims."""
    for level, smaller in zip(levels[-2::-1], levels[:0:-1], strict=True):
        (height, width), (rows, columns) = level.shape[:2], smaller.shape[:2]
        j = np.minimum(np.arange(height) // 2, rows - 1)[:, None]
        i = np.minimum(np.arange(width) // 2, columns - 1)
        hole = level[..., 3] == 0
        level[hole, :3] = smaller[j, i, :3][hole]
    return levels

"""Kernels that look textures up: perspective-correct, bilinear, filtered by the pixel's footprint.

They call no function of the machine's mathematics library but the square root.
"""

from __future__ import annotations

import math

from sada_gym.envs.detection.renderers.gbuffer import Array, Skin
from sada_gym.envs.pixels import Triple, plus, scaled
from sada_gym.foundations.compiled import inlined

MOST_PROBES = 8
"""Texture is averaged along the longer side of a pixel's footprint in at most so many places."""


@inlined
def barycentric(plane: Array, u: float, v: float) -> Triple:
    """Return a face's depth and first two barycentric coordinates at sample coordinates (u, v)."""
    depth = 1.0 / (plane[6] * u + plane[7] * v + plane[8])
    a = (plane[0] * u + plane[1] * v + plane[2]) * depth
    b = (plane[3] * u + plane[4] * v + plane[5]) * depth
    return depth, a, b


@inlined
def uv_at(uv: Array, corners: Array, a: float, b: float) -> tuple[float, float]:
    """Interpolate the place in a texture between a face's corners."""
    p, q, r = uv[corners[0]], uv[corners[1]], uv[corners[2]]
    c = 1.0 - a - b
    return a * p[0] + b * q[0] + c * r[0], a * p[1] + b * q[1] + c * r[1]


@inlined
def texel(skin: Skin, level: int, u: float, v: float) -> tuple[float, float, float, float]:
    """Return linear RGB and alpha of a level at (u, v), bilinearly; it repeats beyond [0, 1]."""
    start, height, width = skin.levels[level]
    x, y = (u - math.floor(u)) * width - 0.5, (math.ceil(v) - v) * height - 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    # a place outside is one of a number that is none, or lies between the last texel and the first
    left, right = (i if 0 <= i < width else width - 1), (i + 1 if 0 <= i + 1 < width else 0)
    top, bottom = (j if 0 <= j < height else height - 1), (j + 1 if 0 <= j + 1 < height else 0)
    top, bottom = start + top * width, start + bottom * width
    a, b = skin.texels[top + left], skin.texels[top + right]
    c, d = skin.texels[bottom + left], skin.texels[bottom + right]
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    light = skin.linear
    return (
        light[a[0]] * wa + light[b[0]] * wb + light[c[0]] * wc + light[d[0]] * wd,
        light[a[1]] * wa + light[b[1]] * wb + light[c[1]] * wc + light[d[1]] * wd,
        light[a[2]] * wa + light[b[2]] * wb + light[c[2]] * wc + light[d[2]] * wd,
        (a[3] * wa + b[3] * wb + c[3] * wc + d[3] * wd) * (1 / 255.0),
    )


@inlined
def _slope(plane: Array, k: int, place: Triple, at: float) -> float:
    """Return how fast a coordinate of the texture, over the depth, changes with sample k (0, 1)."""
    p, q, r = place
    slope: float = plane[k] * (p - r) + plane[3 + k] * (q - r) + plane[6 + k] * (r - at)
    return slope


@inlined
def filtered(
    plane: Array, corners: Array, share: Triple, surface: int, samples: int, skin: Skin
) -> Triple:
    """Average a surface's texture over a pixel, `samples` wide; white where there is none.

    Along the footprint's shorter side a smaller level of the texture averages, along its longer
    side several places in it do: surfaces seen at a flat angle stay sharp.
    """
    first, last = skin.textures[surface, 0], skin.textures[surface, 1]
    if first >= last:
        return 1.0, 1.0, 1.0
    depth, a, b = share
    u, v = uv_at(skin.uv, corners, a, b)
    p, q, r = skin.uv[corners[0]], skin.uv[corners[1]], skin.uv[corners[2]]
    us, vs = (p[0], q[0], r[0]), (p[1], q[1], r[1])
    step = depth * samples
    height, width = skin.levels[first, 1], skin.levels[first, 2]
    # texels that a step to the right and one down in the picture cross
    right = (step * width * _slope(plane, 0, us, u), step * height * _slope(plane, 0, vs, v))
    down = (step * width * _slope(plane, 1, us, u), step * height * _slope(plane, 1, vs, v))
    length = right[0] * right[0] + right[1] * right[1]
    other = down[0] * down[0] + down[1] * down[1]
    longer = right if length > other else down
    major = math.sqrt(max(length, other))
    minor = abs(right[0] * down[1] - right[1] * down[0]) / max(major, 1e-12)
    probes = int(min(max(major / max(minor, 1.0), 1.0), float(MOST_PROBES)) + 0.5)
    footprint, level = max(minor, major / probes), first
    while footprint > 1.4 and level < last - 1:
        footprint, level = 0.5 * footprint, level + 1
    light = (0.0, 0.0, 0.0)
    for k in range(probes):
        along = (k + 0.5) / probes - 0.5
        red, green, blue, _ = texel(
            skin, level, u + along * longer[0] / width, v + along * longer[1] / height
        )
        light = plus(light, (red, green, blue), 1.0)
    return scaled(light, 1.0 / probes)

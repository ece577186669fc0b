"""The colour of the ground, out of its mip map, and what it mirrors where it is wet."""

from __future__ import annotations

import math

from sada_gym.envs.driving.camera.ground import SHADE_TEXEL_M, TEXEL_M
from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import Triple, clip, plus, times
from sada_gym.foundations.arrays import Bytes, Integers
from sada_gym.foundations.compiled import inlined


@inlined
def _texel(
    texels: Bytes,
    offset: Integers,
    shape: Integers,
    x: float,
    y: float,
    size: float,
) -> tuple[float, float, float, float]:
    """Return albedo and water of the ground around a point, averaged over about a size."""
    level = 0
    texel = TEXEL_M
    while texel < size and level < shape.shape[0] - 1:
        level += 1
        texel *= 2.0
    rows, columns = shape[level, 0], shape[level, 1]
    u = x / texel - 0.5
    v = y / texel - 0.5
    column = min(max(math.floor(u), 0), columns - 2)
    row = min(max(math.floor(v), 0), rows - 2)
    fu, fv = clip(u - column), clip(v - row)
    at = offset[level] + row * columns + column
    a, b, c, d = (1 - fu) * (1 - fv), fu * (1 - fv), (1 - fu) * fv, fu * fv
    t = texels
    e = at + columns
    red = a * t[at, 0] + b * t[at + 1, 0] + c * t[e, 0] + d * t[e + 1, 0]
    green = a * t[at, 1] + b * t[at + 1, 1] + c * t[e, 1] + d * t[e + 1, 1]
    blue = a * t[at, 2] + b * t[at + 1, 2] + c * t[e, 2] + d * t[e + 1, 2]
    water = a * t[at, 3] + b * t[at + 1, 3] + c * t[e, 3] + d * t[e + 1, 3]
    scale = 1.0 / 255.0
    red, green, blue = red * scale, green * scale, blue * scale
    return red * red, green * green, blue * blue, water * scale


@inlined
def ground_colour(
    texels: Bytes,
    offset: Integers,
    shape: Integers,
    shade: Bytes,
    x: float,
    y: float,
    dx: float,
    dy: float,
    distance: float,
    height: float,
    pixel: float,
    light: Light,
) -> tuple[Triple, float]:
    """Return the ground's colour without mirroring, and how much water lies there."""
    across = distance * pixel
    along = across * math.sqrt(1 + (distance / height) ** 2)
    samples = min(4, 1 + int(along / (2.0 * across + TEXEL_M)))
    size = max(across, along / 6.0)
    red = green = blue = water = 0.0
    for k in range(samples):
        at = distance + along * ((k + 0.5) / samples - 0.5)
        r, g, b, w = _texel(texels, offset, shape, x + at * dx, y + at * dy, size)
        red, green, blue, water = red + r, green + g, blue + b, water + w
    share = 1.0 / samples
    red, green, blue, water = red * share, green * share, blue * share, water * share
    column = int((x + distance * dx) / SHADE_TEXEL_M)
    row = int((y + distance * dy) / SHADE_TEXEL_M)
    sunlit = 1.0
    if 0 <= row < shade.shape[0] and 0 <= column < shade.shape[1]:
        sunlit = shade[row, column] / 255.0
    power = sunlit * light.sun_z
    dark = 1.0 - 0.45 * light.wetness * clip(3.0 * water)
    albedo = (dark * red, dark * green, dark * blue)
    return times(albedo, plus(light.ambient, light.sun, power)), water


@inlined
def mirrored_share(slope: float, water: float, light: Light) -> float:
    """Say how much of the light a wet ground mirrors under a ray; drops roughen the water."""
    if light.wetness <= 0.0:
        return 0.0
    cosine = -slope / math.sqrt(1 + slope * slope)
    glancing = (1.0 - cosine) ** 5
    film = clip(2.2 * (water - 1.0 + light.wetness)) * (1.0 - 0.5 * light.rain)
    return (0.03 + 0.85 * glancing) * film

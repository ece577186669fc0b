"""The colours that a ray meets: sky, ground, buildings and trees; and rain over the picture."""

from __future__ import annotations

import math

import numpy as np

from sada_gym.envs.driving.camera.ground import SHADE_TEXEL_M, TEXEL_M
from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import Triple, clip, mix, periodic, plus, scaled, splitmix, times, uniform
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Integers
from sada_gym.foundations.compiled import inlined, kernel


@inlined
def sky_colour(clouds: Floats32, dx: float, dy: float, slope: float, light: Light) -> Triple:
    """Return the colour of the sky, and of the hills at its foot, in a direction."""
    rise = slope / math.sqrt(1 + slope * slope)
    colour = mix(light.horizon, light.zenith, clip(1.3 * math.sqrt(max(rise, 0.0))))
    flat = 1.0 / (max(slope, 0.0) + 0.07)
    noise = periodic(clouds, 9.0 * dx * flat + 40.0, 9.0 * dy * flat + 40.0)
    share = clip(3.0 * (noise - 1.0 + light.cover)) if light.cover < 1.0 else 1.0
    shade = 0.82 + 0.36 * noise if light.cover >= 1.0 else 1.0
    cloud = scaled(light.cloud, shade)
    fade = clip(6.0 * slope)  # clouds melt into the haze low down
    colour = mix(colour, cloud, 0.85 * share * (0.35 + 0.65 * fade))
    cosine = (dx * light.sun_x + dy * light.sun_y + slope * light.sun_z) * (
        rise / slope if slope > 1e-9 else 1.0
    )
    if cosine > 0.8:
        glow = cosine**24
        disc = 9.0 * clip(1200.0 * (cosine - 0.9985))
        power = (0.45 * glow + disc) * (1.0 - light.cover)
        colour = plus(colour, light.sun, power)
    # no hill is higher than 0.047: most of the sky need not ask
    if slope < 0.047 and slope < 0.012 + 0.035 * periodic(clouds, 20.0 * dx, 20.0 * dy):
        wood = times((0.05, 0.08, 0.05), light.ambient)
        colour = mix(wood, light.horizon, 1.0 - math.exp(-450.0 * light.haze))
    return colour


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


@inlined
def _facing(objects: Floats, i: int, normal: float, light: Light) -> float:
    ax, ay = objects[i, 3], objects[i, 4]
    facing: float = 0.5 * normal * (-ay * light.sun_x + ax * light.sun_y)
    if abs(normal) < 1.5:
        facing = normal * (ax * light.sun_x + ay * light.sun_y)
    return max(0.0, facing)


@inlined
def _wall(
    objects: Floats,
    i: int,
    hit: float,
    where: float,
    z: float,
    facing: float,
    pixel: float,
    light: Light,
) -> Triple:
    own, height = objects[i, 11], objects[i, 7]
    albedo = (objects[i, 8], objects[i, 9], objects[i, 10])
    pitch = 2.4 + 1.4 * own
    across = where / pitch + 100.5
    across -= math.floor(across)
    storey = z / 3.2
    up = storey - math.floor(storey)
    wide = 0.20 if storey >= 1.0 else 0.10
    window = wide < across < 1 - wide and 0.28 < up < 0.80
    sharp = clip(1.5 - 1.2 * hit * pixel)
    share = sharp * (1.0 if window else 0.0) + (1 - sharp) * (1 - 2 * wide) * 0.52
    if z > height - 0.5:
        share = 0.0
        albedo = mix(albedo, (0.6, 0.6, 0.58), 0.5)
    plain = times(albedo, plus(scaled(light.ambient, 0.85), light.sun, facing))
    glass = mix((0.02, 0.025, 0.03), light.horizon, 0.16)
    return mix(plain, glass, share)


@inlined
def _leaves(
    objects: Floats,
    clouds: Floats32,
    i: int,
    where: float,
    z: float,
    middle: float,
    trunk: bool,
    light: Light,
) -> Triple:
    if trunk:
        albedo = (0.09, 0.065, 0.045)
        lit = 0.25
    else:
        albedo = (objects[i, 8], objects[i, 9], objects[i, 10])
        mottle = periodic(clouds, 7.0 * where + 50.0 * objects[i, 11], 7.0 * z)
        lit = clip(0.35 + 0.28 * (z - middle)) * (0.55 + 0.8 * mottle)
    return times(albedo, plus(scaled(light.ambient, 0.8), light.sun, lit))


@inlined
def first_upright(
    objects: Floats,
    clouds: Floats32,
    hits: Floats,
    count: int,
    beyond: float,
    within: float,
    height: float,
    slope: float,
    pixel: float,
    light: Light,
) -> tuple[float, Triple]:
    """Find the first object that a ray meets between two distances: distance (or -1) and colour."""
    for k in range(count):
        distance = hits[k, 0]
        if distance <= beyond:
            continue
        if distance >= within:
            break
        i = int(hits[k, 1])
        z = height + slope * distance
        if z > objects[i, 7]:
            continue
        if objects[i, 0] == 0.0:
            facing = _facing(objects, i, hits[k, 3], light)
            return distance, _wall(objects, i, distance, hits[k, 2], z, facing, pixel, light)
        radius = objects[i, 5]
        tall = 1.25 * radius
        middle = objects[i, 7] - tall
        across, up = hits[k, 2] / radius, (z - middle) / tall
        off = across * across + up * up
        edge = 1.15
        if 0.69 < off < edge:  # the crown is ragged there, and nowhere else
            grain = periodic(clouds, 5.0 * hits[k, 2] + 90.0 * objects[i, 11], 5.0 * z)
            edge -= 0.45 * grain
        if off < edge:
            return distance, _leaves(objects, clouds, i, hits[k, 2], z, middle, False, light)
        if abs(hits[k, 2]) < objects[i, 6] and z < middle:
            return distance, _leaves(objects, clouds, i, hits[k, 2], z, middle, True, light)
    return -1.0, (0.0, 0.0, 0.0)


@kernel
def draw_rain(picture: Bytes, rain: float, light: Light, key: np.uint64) -> None:
    """Draw streaks of rain, each a short slanting line."""
    rows, columns = picture.shape[0], picture.shape[1]
    brightness = 255.0 * clip(0.55 * (light.ambient[0] + light.ambient[1] + light.ambient[2]))
    thick = max(1, columns // 220)
    state = splitmix(key)
    for _ in range(int(110 * rain)):
        state = splitmix(state)
        u = uniform(state) * columns
        state = splitmix(state)
        v = (1.3 * uniform(state) - 0.3) * rows
        state = splitmix(state)
        near = uniform(state)
        length = int((0.05 + 0.22 * near * near) * rows) + 1
        share = 0.12 + 0.30 * near
        for k in range(length):
            row = int(v) + k
            if not 0 <= row < rows:
                continue
            for t in range(thick):
                column = int(u + 0.12 * k) + t
                if 0 <= column < columns:
                    for channel in range(3):
                        value = float(picture[row, column, channel])
                        picture[row, column, channel] = int(value + share * (brightness - value))

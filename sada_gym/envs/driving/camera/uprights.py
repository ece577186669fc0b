"""The colours of what stands upright: buildings and trees."""

from __future__ import annotations

import math

from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import Triple, clip, mix, periodic, plus, scaled, times
from sada_gym.foundations.arrays import Floats, Floats32
from sada_gym.foundations.compiled import inlined


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

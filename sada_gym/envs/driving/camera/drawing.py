"""Pixel kernels of the driving camera: one ray a pixel to ground, walls, trees and sky.

The camera never rolls, so all rays of one azimuth stand in one vertical plane: what upright
objects a plane meets is found once an azimuth, on a grid, and each pixel only compares heights.
Ground comes from a mip map. Scalar loops without fast-math, so that equal scenes give equal bytes
whatever else is drawn.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from sada_gym.envs.driving.camera.casting import MOST_HITS, REACH_M, cast
from sada_gym.envs.driving.camera.colours import (
    draw_rain,
    first_upright,
    ground_colour,
    mirrored_share,
    sky_colour,
)
from sada_gym.envs.driving.camera.scenery import TownArrays
from sada_gym.envs.driving.world.weather import Light
from sada_gym.envs.pixels import TONE_WHITE, mix, plus
from sada_gym.foundations.arrays import Bytes, Floats, Floats32, Indices, Integers
from sada_gym.foundations.compiled import kernel, uncounted


@uncounted
def _draw(
    picture: Bytes,
    rays: Floats32,
    x: float,
    y: float,
    heading: float,
    height: float,
    pixel: float,
    half_angle: float,
    town: TownArrays,
    shade: Bytes,
    light: Light,
    hits: Floats,
    sun_hits: Floats,
    counts: Integers,
) -> None:
    # looked up once: taking an array out of the tuple costs as much as a texel
    texels, offset, shape = town.ground.texels, town.ground.offset, town.ground.shape
    objects, clouds, tone = town.scenery.objects, town.clouds, town.tone
    left, top = town.ground.origin[0], town.ground.origin[1]
    rows, columns = picture.shape[0], picture.shape[1]
    planes = counts.shape[0]
    for a in range(planes):
        angle = heading + half_angle * (2.0 * (a + 0.5) / planes - 1.0)
        counts[a] = cast(x, y, math.cos(angle), math.sin(angle), REACH_M, town, hits[a])
    # is the sun in sight? then it dazzles
    sun_flat = math.hypot(light.sun_x, light.sun_y)
    met = cast(x, y, light.sun_x / sun_flat, light.sun_y / sun_flat, REACH_M, town, sun_hits)
    dazzle = 1.0 - light.cover
    for k in range(met):
        if objects[int(sun_hits[k, 1]), 7] > height + sun_hits[k, 0] * light.sun_z / sun_flat:
            dazzle = 0.0
    cos_h, sin_h = math.cos(heading), math.sin(heading)
    last = tone.shape[0] - 1
    for row in range(rows):
        for column in range(columns):
            forward, right, slope = rays[row, column, 0], rays[row, column, 1], rays[row, column, 2]
            dx, dy = cos_h * forward - sin_h * right, sin_h * forward + cos_h * right
            a = int(rays[row, column, 3])
            reach = -height / slope if slope < -1e-6 else 1e9
            met_at, colour = first_upright(
                objects, clouds, hits[a], counts[a], 0.0, reach, height, slope, pixel, light
            )
            if met_at > 0.0:
                distance = met_at
            elif slope < -height / 400.0:
                distance = reach
                colour, water = ground_colour(
                    texels,
                    offset,
                    shape,
                    shade,
                    x - left,
                    y - top,
                    dx,
                    dy,
                    reach,
                    height,
                    pixel,
                    light,
                )
                mirrored = mirrored_share(slope, water, light)
                if mirrored > 0.01:
                    up, seen = first_upright(
                        objects,
                        clouds,
                        hits[a],
                        counts[a],
                        reach,
                        1e9,
                        -height,
                        -slope,
                        pixel,
                        light,
                    )
                    if up < 0.0:
                        seen = sky_colour(clouds, dx, dy, -slope, light)
                    colour = mix(colour, seen, mirrored)
            else:
                distance = 0.0
                colour = sky_colour(clouds, dx, dy, slope, light)
            if distance > 0.0:
                colour = mix(light.horizon, colour, math.exp(-light.haze * distance))
            if dazzle > 0.0:
                length = math.sqrt(1 + slope * slope)
                cosine = (dx * light.sun_x + dy * light.sun_y + slope * light.sun_z) / length
                if cosine > 0.0:
                    veil = 0.16 * dazzle * cosine**10
                    colour = plus(colour, light.sun, veil)
            for channel in range(3):
                level = min(int(colour[channel] * (last / TONE_WHITE)), last)
                picture[row, column, channel] = tone[level]


@kernel
def draw_all(
    pictures: Bytes,
    order: Indices,
    rays: Floats32,
    rays_of: Integers,
    poses: Floats,
    ahead: float,
    lights: tuple[Light, ...],
    weathers: Integers,
    pixel: float,
    half_angle: float,
    planes: int,
    town: TownArrays,
    shades: Bytes,
    shade_of: Integers,
    keys: npt.NDArray[np.uint64],
) -> None:
    """Draw a picture (h, w, 3) for each of n cameras.

    order (n,) in which they are drawn: neighbours one after another find the same ground in the
    processor's cache; rays (m, h, w, 4): forward and right share of each pixel's azimuth, slope,
    and its plane; rays_of (n,) which of them each camera has; poses (n, 4): the cars' x, y and
    heading, and the cameras' height; ahead: from a car's middle to its camera; lights: those of
    all weathers; weathers (n,) which of them; shades (k, ...) where the sun reaches the ground,
    shade_of (n,) which of them; keys (n,) fix the rain.
    """
    hits, sun_hits = np.empty((planes, MOST_HITS, 4)), np.empty((MOST_HITS, 4))
    counts = np.zeros(planes, np.int64)
    for i in order:
        light = lights[weathers[i]]
        x, y, heading, height = poses[i, 0], poses[i, 1], poses[i, 2], poses[i, 3]
        _draw(
            pictures[i],
            rays[rays_of[i]],
            x + ahead * math.cos(heading),
            y + ahead * math.sin(heading),
            heading,
            height,
            pixel,
            half_angle,
            town,
            shades[shade_of[i]],
            light,
            hits,
            sun_hits,
            counts,
        )
        if light.rain > 0.0:
            draw_rain(pictures[i], light.rain, light, keys[i])

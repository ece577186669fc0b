"""Pixel kernels of the driving camera: one ray a pixel to ground, walls, trees and sky.

The camera never rolls, so all rays of one azimuth stand in one vertical plane: what upright
objects a plane meets is found once an azimuth, on a grid, and each pixel only compares heights.
Ground comes from a mip map. Scalar loops compiled by numba without fast-math, so that equal scenes
give equal bytes whatever else is drawn. Light is linear RGB.

All kernels stand in this one file, because numba's cache notices changes in a kernel's
own file only.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar

import numba as nb
import numpy as np
import numpy.typing as npt

_kernel = nb.njit(cache=True, nogil=True, error_model="numpy")
_part = nb.njit(inline="always", error_model="numpy")

REACH_M = 160.0
"""How far upright objects are seen."""
MOST_HITS = 8
TONE_STEPS = 2048
TONE_WHITE = 3.0

_Function = TypeVar("_Function")
Triple = tuple[float, float, float]
Array = npt.NDArray[np.float64]


def _uncounted(function: _Function) -> _Function:
    """Compile a kernel that makes no array, without counts of references.

    Numba counts them wherever an array is passed on: a picture takes a fifth longer with them.
    """
    options: dict[str, Any] = {"_nrt": False}
    compiled: _Function = nb.njit(cache=True, nogil=True, error_model="numpy", **options)(function)
    return compiled


class World(NamedTuple):
    """A town for the kernels; see `Ground` and `Scenery`."""

    texels: npt.NDArray[np.uint8]
    offset: npt.NDArray[np.int64]
    shape: npt.NDArray[np.int64]
    texel_m: float
    objects: Array
    first: npt.NDArray[np.int64]
    items: npt.NDArray[np.int64]
    cells: npt.NDArray[np.int64]
    cell_m: float
    origin: Array
    clouds: npt.NDArray[np.float32]
    tone: npt.NDArray[np.uint8]
    shade_texel_m: float


class Light(NamedTuple):
    """A weather for the kernels; see `Weather`."""

    sun_x: float
    sun_y: float
    sun_z: float
    sun: Triple
    ambient: Triple
    zenith: Triple
    horizon: Triple
    cloud: Triple
    cover: float
    haze: float
    wetness: float
    rain: float


def tone_table() -> npt.NDArray[np.uint8]:
    """Map linear light in [0, TONE_WHITE] to bytes: exponential shoulder, then gamma 2.2."""
    mapped = 1 - np.exp(-1.3 * np.linspace(0, TONE_WHITE, TONE_STEPS))
    level: Array = 255 * (mapped / mapped[-1]) ** (1 / 2.2)
    return np.round(level).astype(np.uint8)


@_part
def _mix(a: Triple, b: Triple, share: float) -> Triple:
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


@_part
def _clip(value: float) -> float:
    return min(max(value, 0.0), 1.0)


@_part
def _light_of(numbers: Array) -> Light:
    return Light(
        numbers[0],
        numbers[1],
        numbers[2],
        (numbers[3], numbers[4], numbers[5]),
        (numbers[6], numbers[7], numbers[8]),
        (numbers[9], numbers[10], numbers[11]),
        (numbers[12], numbers[13], numbers[14]),
        (numbers[15], numbers[16], numbers[17]),
        numbers[18],
        numbers[19],
        numbers[20],
        numbers[21],
    )


@_uncounted
def cast(x: float, y: float, dx: float, dy: float, reach: float, world: World, hits: Array) -> int:
    """Find the upright objects that a horizontal ray meets, nearest first.

    `hits` (MOST_HITS, 4) takes for each: the distance, the object, where along a wall or how far
    beside a trunk it passes, and the angle's cosine between the wall's normal and north (x).
    Returns their number.
    """
    objects, first, items, cell = world.objects, world.first, world.items, world.cell_m
    rows, columns = world.cells[0], world.cells[1]
    px, py = (x - world.origin[0]) / cell, (y - world.origin[1]) / cell
    column, row = math.floor(px), math.floor(py)
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    per_x = abs(1.0 / dx) if abs(dx) > 1e-12 else 1e30
    per_y = abs(1.0 / dy) if abs(dy) > 1e-12 else 1e30
    next_x = ((column + 1 - px) if dx > 0 else (px - column)) * per_x
    next_y = ((row + 1 - py) if dy > 0 else (py - row)) * per_y
    count, entered = 0, 0.0
    while entered * cell < reach:
        if count == MOST_HITS and hits[count - 1, 0] < entered * cell:
            break
        if 0 <= column < columns and 0 <= row < rows:
            at = row * columns + column
            for k in range(first[at], first[at + 1]):
                i = items[k]
                rx, ry = objects[i, 1] - x, objects[i, 2] - y
                distance, where, normal = -1.0, 0.0, 0.0
                if objects[i, 0] == 1.0:
                    where = rx * dy - ry * dx
                    if abs(where) < objects[i, 5]:
                        distance = rx * dx + ry * dy
                elif abs(rx * dy - ry * dx) < objects[i, 5] + objects[i, 6]:
                    ax, ay = objects[i, 3], objects[i, 4]
                    lx, ly = -(rx * ax + ry * ay), rx * ay - ry * ax
                    ldx, ldy = dx * ax + dy * ay, -dx * ay + dy * ax
                    half_l, half_w = objects[i, 5], objects[i, 6]
                    sx, sy = (1.0 if ldx > 0 else -1.0), (1.0 if ldy > 0 else -1.0)
                    in_x = (-sx * half_l - lx) / ldx if abs(ldx) > 1e-9 else -1e30
                    out_x = (sx * half_l - lx) / ldx if abs(ldx) > 1e-9 else 1e30
                    in_y = (-sy * half_w - ly) / ldy if abs(ldy) > 1e-9 else -1e30
                    out_y = (sy * half_w - ly) / ldy if abs(ldy) > 1e-9 else 1e30
                    if abs(ldx) <= 1e-9 and abs(lx) > half_l:
                        out_x = -1.0
                    if abs(ldy) <= 1e-9 and abs(ly) > half_w:
                        out_y = -1.0
                    near, far = max(in_x, in_y), min(out_x, out_y)
                    if near < far and near > 0.0:
                        distance = near
                        if in_x > in_y:
                            where = ly + near * ldy
                            normal = -sx  # along the axis
                        else:
                            where = lx + near * ldx
                            normal = -2.0 * sy  # across it
                if distance < 0.3 or distance > reach:
                    continue
                known = False
                for j in range(count):
                    known |= hits[j, 1] == i
                if known or (count == MOST_HITS and distance >= hits[count - 1, 0]):
                    continue
                j = min(count, MOST_HITS - 1)
                while j > 0 and hits[j - 1, 0] > distance:
                    for part in range(4):
                        hits[j, part] = hits[j - 1, part]
                    j -= 1
                hits[j, 0], hits[j, 1], hits[j, 2], hits[j, 3] = distance, i, where, normal
                count = min(count + 1, MOST_HITS)
        if next_x < next_y:
            entered = next_x
            next_x += per_x
            column += step_x
        else:
            entered = next_y
            next_y += per_y
            row += step_y
    return count


@_part
def _facing(objects: Array, i: int, normal: float, light: Light) -> float:
    """How squarely the sun shines on a wall."""
    ax, ay = objects[i, 3], objects[i, 4]
    facing: float = 0.5 * normal * (-ay * light.sun_x + ax * light.sun_y)
    if abs(normal) < 1.5:
        facing = normal * (ax * light.sun_x + ay * light.sun_y)
    return max(0.0, facing)


@_part
def _cloud_noise(clouds: npt.NDArray[np.float32], u: float, v: float) -> float:
    last = clouds.shape[0] - 1  # the size is a power of two
    i, j = math.floor(u), math.floor(v)
    fu, fv = u - i, v - j
    i, j = i & last, j & last
    k, m = (i + 1) & last, (j + 1) & last
    top = clouds[i, j] * (1 - fv) + clouds[i, m] * fv
    bottom = clouds[k, j] * (1 - fv) + clouds[k, m] * fv
    value: float = top * (1 - fu) + bottom * fu
    return value


@_part
def _sky(
    clouds: npt.NDArray[np.float32], dx: float, dy: float, slope: float, light: Light
) -> Triple:
    """The colour of the sky, and of the hills at its foot, in a direction."""
    rise = slope / math.sqrt(1 + slope * slope)
    colour = _mix(light.horizon, light.zenith, _clip(1.3 * math.sqrt(max(rise, 0.0))))
    flat = 1.0 / (max(slope, 0.0) + 0.07)
    noise = _cloud_noise(clouds, 9.0 * dx * flat + 40.0, 9.0 * dy * flat + 40.0)
    share = _clip(3.0 * (noise - 1.0 + light.cover)) if light.cover < 1.0 else 1.0
    shade = 0.82 + 0.36 * noise if light.cover >= 1.0 else 1.0
    cloud = (light.cloud[0] * shade, light.cloud[1] * shade, light.cloud[2] * shade)
    fade = _clip(6.0 * slope)  # clouds melt into the haze low down
    colour = _mix(colour, cloud, 0.85 * share * (0.35 + 0.65 * fade))
    cosine = (dx * light.sun_x + dy * light.sun_y + slope * light.sun_z) * (
        rise / slope if slope > 1e-9 else 1.0
    )
    if cosine > 0.8:
        glow = cosine**24
        disc = 9.0 * _clip(1200.0 * (cosine - 0.9985))
        power = (0.45 * glow + disc) * (1.0 - light.cover)
        colour = (
            colour[0] + power * light.sun[0],
            colour[1] + power * light.sun[1],
            colour[2] + power * light.sun[2],
        )
    # no hill is higher than 0.047: most of the sky need not ask
    if slope < 0.047 and slope < 0.012 + 0.035 * _cloud_noise(clouds, 20.0 * dx, 20.0 * dy):
        wood = (0.05 * light.ambient[0], 0.08 * light.ambient[1], 0.05 * light.ambient[2])
        colour = _mix(wood, light.horizon, 1.0 - math.exp(-450.0 * light.haze))
    return colour


@_part
def _wall(
    objects: Array,
    i: int,
    hit: float,
    where: float,
    z: float,
    facing: float,
    pixel: float,
    light: Light,
) -> Triple:
    """The colour of a building's front: storeys of windows that blur with distance."""
    own, height = objects[i, 11], objects[i, 7]
    albedo = (objects[i, 8], objects[i, 9], objects[i, 10])
    pitch = 2.4 + 1.4 * own
    across = where / pitch + 100.5
    across -= math.floor(across)
    storey = z / 3.2
    up = storey - math.floor(storey)
    wide = 0.20 if storey >= 1.0 else 0.10
    window = wide < across < 1 - wide and 0.28 < up < 0.80
    sharp = _clip(1.5 - 1.2 * hit * pixel)
    share = sharp * (1.0 if window else 0.0) + (1 - sharp) * (1 - 2 * wide) * 0.52
    if z > height - 0.5:
        share = 0.0
        albedo = _mix(albedo, (0.6, 0.6, 0.58), 0.5)
    power = (
        light.ambient[0] * 0.85 + light.sun[0] * facing,
        light.ambient[1] * 0.85 + light.sun[1] * facing,
        light.ambient[2] * 0.85 + light.sun[2] * facing,
    )
    plain = (albedo[0] * power[0], albedo[1] * power[1], albedo[2] * power[2])
    glass = _mix((0.02, 0.025, 0.03), light.horizon, 0.16)
    return _mix(plain, glass, share)


@_part
def _leaves(
    objects: Array,
    clouds: npt.NDArray[np.float32],
    i: int,
    where: float,
    z: float,
    middle: float,
    trunk: bool,
    light: Light,
) -> Triple:
    """The colour of a tree: its lit top, its dark foot, or its trunk."""
    if trunk:
        albedo = (0.09, 0.065, 0.045)
        lit = 0.25
    else:
        albedo = (objects[i, 8], objects[i, 9], objects[i, 10])
        mottle = _cloud_noise(clouds, 7.0 * where + 50.0 * objects[i, 11], 7.0 * z)
        lit = _clip(0.35 + 0.28 * (z - middle)) * (0.55 + 0.8 * mottle)
    return (
        albedo[0] * (0.8 * light.ambient[0] + light.sun[0] * lit),
        albedo[1] * (0.8 * light.ambient[1] + light.sun[1] * lit),
        albedo[2] * (0.8 * light.ambient[2] + light.sun[2] * lit),
    )


@_part
def _upright(
    objects: Array,
    clouds: npt.NDArray[np.float32],
    hits: Array,
    count: int,
    beyond: float,
    within: float,
    height: float,
    slope: float,
    pixel: float,
    light: Light,
) -> tuple[float, Triple]:
    """The first object that a ray meets between two distances: (distance, colour); -1: none."""
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
            grain = _cloud_noise(clouds, 5.0 * hits[k, 2] + 90.0 * objects[i, 11], 5.0 * z)
            edge -= 0.45 * grain
        if off < edge:
            return distance, _leaves(objects, clouds, i, hits[k, 2], z, middle, False, light)
        if abs(hits[k, 2]) < objects[i, 6] and z < middle:
            return distance, _leaves(objects, clouds, i, hits[k, 2], z, middle, True, light)
    return -1.0, (0.0, 0.0, 0.0)


@_part
def _texel(
    texels: npt.NDArray[np.uint8],
    offset: npt.NDArray[np.int64],
    shape: npt.NDArray[np.int64],
    texel_m: float,
    x: float,
    y: float,
    size: float,
) -> tuple[float, float, float, float]:
    """Albedo and water of the ground around a point, averaged over about a size."""
    level = 0
    texel = texel_m
    while texel < size and level < shape.shape[0] - 1:
        level += 1
        texel *= 2.0
    rows, columns = shape[level, 0], shape[level, 1]
    u = x / texel - 0.5
    v = y / texel - 0.5
    column = min(max(math.floor(u), 0), columns - 2)
    row = min(max(math.floor(v), 0), rows - 2)
    fu, fv = _clip(u - column), _clip(v - row)
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


@_part
def _ground(
    texels: npt.NDArray[np.uint8],
    offset: npt.NDArray[np.int64],
    shape: npt.NDArray[np.int64],
    texel_m: float,
    shade: npt.NDArray[np.uint8],
    shade_texel_m: float,
    x: float,
    y: float,
    dx: float,
    dy: float,
    distance: float,
    height: float,
    pixel: float,
    light: Light,
) -> tuple[Triple, float]:
    """The ground's colour without mirroring, and how much water lies there."""
    across = distance * pixel
    along = across * math.sqrt(1 + (distance / height) ** 2)
    samples = min(4, 1 + int(along / (2.0 * across + texel_m)))
    size = max(across, along / 6.0)
    red = green = blue = water = 0.0
    for k in range(samples):
        at = distance + along * ((k + 0.5) / samples - 0.5)
        r, g, b, w = _texel(texels, offset, shape, texel_m, x + at * dx, y + at * dy, size)
        red, green, blue, water = red + r, green + g, blue + b, water + w
    share = 1.0 / samples
    red, green, blue, water = red * share, green * share, blue * share, water * share
    column = int((x + distance * dx) / shade_texel_m)
    row = int((y + distance * dy) / shade_texel_m)
    sunlit = 1.0
    if 0 <= row < shade.shape[0] and 0 <= column < shade.shape[1]:
        sunlit = shade[row, column] / 255.0
    power = sunlit * light.sun_z
    dark = 1.0 - 0.45 * light.wetness * _clip(3.0 * water)
    return (
        dark * red * (light.ambient[0] + power * light.sun[0]),
        dark * green * (light.ambient[1] + power * light.sun[1]),
        dark * blue * (light.ambient[2] + power * light.sun[2]),
    ), water


@_part
def _mirror(slope: float, water: float, light: Light) -> float:
    """How much of the light is mirrored by a wet ground under a ray; drops roughen the water."""
    if light.wetness <= 0.0:
        return 0.0
    cosine = -slope / math.sqrt(1 + slope * slope)
    glancing = (1.0 - cosine) ** 5
    film = _clip(2.2 * (water - 1.0 + light.wetness)) * (1.0 - 0.5 * light.rain)
    return (0.03 + 0.85 * glancing) * film


@_uncounted
def _draw(
    picture: npt.NDArray[np.uint8],
    rays: npt.NDArray[np.float32],
    x: float,
    y: float,
    heading: float,
    height: float,
    pixel: float,
    half_angle: float,
    world: World,
    shade: npt.NDArray[np.uint8],
    light: Light,
    hits: Array,
    sun_hits: Array,
    counts: npt.NDArray[np.int64],
) -> None:
    # looked up once: taking an array out of the tuple costs as much as a texel
    texels, offset, shape, texel_m = world.texels, world.offset, world.shape, world.texel_m
    objects, clouds, tone = world.objects, world.clouds, world.tone
    shade_texel_m = world.shade_texel_m
    left, top = world.origin[0], world.origin[1]
    rows, columns = picture.shape[0], picture.shape[1]
    planes = counts.shape[0]
    for a in range(planes):
        angle = heading + half_angle * (2.0 * (a + 0.5) / planes - 1.0)
        counts[a] = cast(x, y, math.cos(angle), math.sin(angle), REACH_M, world, hits[a])
    # is the sun in sight? then it dazzles
    sun_flat = math.hypot(light.sun_x, light.sun_y)
    met = cast(x, y, light.sun_x / sun_flat, light.sun_y / sun_flat, REACH_M, world, sun_hits)
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
            met_at, colour = _upright(
                objects, clouds, hits[a], counts[a], 0.0, reach, height, slope, pixel, light
            )
            if met_at > 0.0:
                distance = met_at
            elif slope < -height / 400.0:
                distance = reach
                colour, water = _ground(
                    texels,
                    offset,
                    shape,
                    texel_m,
                    shade,
                    shade_texel_m,
                    x - left,
                    y - top,
                    dx,
                    dy,
                    reach,
                    height,
                    pixel,
                    light,
                )
                mirrored = _mirror(slope, water, light)
                if mirrored > 0.01:
                    up, seen = _upright(
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
                        seen = _sky(clouds, dx, dy, -slope, light)
                    colour = _mix(colour, seen, mirrored)
            else:
                distance = 0.0
                colour = _sky(clouds, dx, dy, slope, light)
            if distance > 0.0:
                colour = _mix(light.horizon, colour, math.exp(-light.haze * distance))
            if dazzle > 0.0:
                length = math.sqrt(1 + slope * slope)
                cosine = (dx * light.sun_x + dy * light.sun_y + slope * light.sun_z) / length
                if cosine > 0.0:
                    veil = 0.16 * dazzle * cosine**10
                    colour = (
                        colour[0] + veil * light.sun[0],
                        colour[1] + veil * light.sun[1],
                        colour[2] + veil * light.sun[2],
                    )
            for channel in range(3):
                level = min(int(colour[channel] * (last / TONE_WHITE)), last)
                picture[row, column, channel] = tone[level]


@_part
def _hash(state: np.uint64) -> np.uint64:
    """One step of splitmix64 (Steele, Lea & Flood 2014)."""
    state = state + np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


@_part
def _uniform(state: np.uint64) -> float:
    return float(state >> np.uint64(11)) / 9007199254740992.0


@_kernel
def _rain(picture: npt.NDArray[np.uint8], rain: float, light: Light, key: np.uint64) -> None:
    """Draw streaks of rain, each a short slanting line."""
    rows, columns = picture.shape[0], picture.shape[1]
    brightness = 255.0 * _clip(0.55 * (light.ambient[0] + light.ambient[1] + light.ambient[2]))
    thick = max(1, columns // 220)
    state = _hash(key)
    for _ in range(int(110 * rain)):
        state = _hash(state)
        u = _uniform(state) * columns
        state = _hash(state)
        v = (1.3 * _uniform(state) - 0.3) * rows
        state = _hash(state)
        near = _uniform(state)
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


@_kernel
def draw_all(
    pictures: npt.NDArray[np.uint8],
    order: npt.NDArray[np.intp],
    rays: npt.NDArray[np.float32],
    rays_of: npt.NDArray[np.int64],
    poses: Array,
    ahead: float,
    weathers: Array,
    pixel: float,
    half_angle: float,
    planes: int,
    world: World,
    shades: npt.NDArray[np.uint8],
    shade_of: npt.NDArray[np.int64],
    keys: npt.NDArray[np.uint64],
) -> None:
    """Draw a picture (h, w, 3) for each of n cameras.

    order (n,) in which they are drawn: neighbours one after another find the same ground in the
    processor's cache; rays (m, h, w, 4): forward and right share of each pixel's azimuth, slope,
    and its plane; rays_of (n,) which of them each camera has; poses (n, 4): the cars' x, y and
    heading, and the cameras' height; ahead: from a car's middle to its camera; weathers (n, 22);
    shades (k, ...) where the sun reaches the ground, shade_of (n,) which of them; keys (n,) fix
    the rain.
    """
    hits, sun_hits = np.empty((planes, MOST_HITS, 4)), np.empty((MOST_HITS, 4))
    counts = np.zeros(planes, np.int64)
    for i in order:
        light = _light_of(weathers[i])
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
            world,
            shades[shade_of[i]],
            light,
            hits,
            sun_hits,
            counts,
        )
        if light.rain > 0.0:
            _rain(pictures[i], light.rain, light, keys[i])


@_kernel
def sunlit(
    shade: npt.NDArray[np.uint8], sun_x: float, sun_y: float, sun_z: float, world: World
) -> None:
    """Mark where the sun reaches the ground: 255, or 0 in a shadow."""
    flat = math.hypot(sun_x, sun_y)
    rise = sun_z / flat
    hits = np.empty((MOST_HITS, 4))
    for row in range(shade.shape[0]):
        y = world.origin[1] + (row + 0.5) * world.shade_texel_m
        for column in range(shade.shape[1]):
            x = world.origin[0] + (column + 0.5) * world.shade_texel_m
            met = cast(x, y, sun_x / flat, sun_y / flat, 25.0 / rise, world, hits)
            light = 255
            for k in range(met):
                i = int(hits[k, 1])
                z = hits[k, 0] * rise
                if world.objects[i, 0] == 0.0:
                    if z < world.objects[i, 7]:
                        light = 0
                else:
                    tall = 1.25 * world.objects[i, 5]
                    up = (z - world.objects[i, 7] + tall) / tall
                    across = hits[k, 2] / world.objects[i, 5]
                    if across * across + up * up < 0.9:
                        light = min(light, 70)
            shade[row, column] = light

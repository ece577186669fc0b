"""Pixel kernels of the default renderer: the place by ray casting, the object from a G-buffer.

The z-buffer says which face of the object a sample shows; these kernels light it, cast its shadow,
and draw ground, buildings and sky behind it. They are compiled by numba without fast-math, and call
no function of the machine's mathematics library, so that equal scenes give equal bytes on all
processors. Vectors are tuples of three floats, which the compiler keeps in registers. Light is
linear RGB.
"""

from __future__ import annotations

import math

from sada_gym.envs.detection.renderers.gbuffer import (
    Array,
    GBuffer,
    KernelBackdrop,
    KernelCamera,
    Lamp,
    Skin,
)
from sada_gym.envs.detection.renderers.texture import barycentric, filtered
from sada_gym.envs.pixels import TONE_WHITE, Triple, dot, mix, periodic, plus, scaled, times
from sada_gym.foundations.compiled import inlined, uncounted

SUPERSAMPLING = 2
"""Samples per pixel and axis, of the object."""

SUN = (1.3, 1.22, 1.08)
FAR_AWAY = 120.0
TONE_STEPS = 4096

Row = Array | tuple[float, ...]
"""A row of a table of materials, see `MATERIALS`."""


@inlined
def _square(value: float, repeats: int) -> float:
    for _ in range(repeats):
        value *= value
    return value


@inlined
def _ray(camera: KernelCamera, u: float, v: float) -> Triple:
    """Return the direction through sample coordinates (u, v), at distance 1 along the axis."""
    x, y = (u - camera.middle[0]) * camera.step, (camera.middle[1] - v) * camera.step
    return plus(plus(scaled(camera.right, x), camera.up, y), camera.back, -1.0)


@inlined
def _unit(a: Triple) -> Triple:
    return scaled(a, 1 / math.sqrt(dot(a, a)))


@inlined
def _light(sun: float, ambient: float, place: KernelBackdrop) -> Triple:
    return plus(scaled(SUN, sun), place.ambient, ambient)


@inlined
def _sunlit(point: Triple, bias: float, lamp: Lamp) -> float:
    """Return the share of the light that reaches a point, by the light's depth view, bilinearly."""
    p = plus(point, lamp.centre, -1.0)
    across, up = dot(lamp.right, p), dot(lamp.up, p)
    depth = lamp.distance - dot(lamp.back, p)
    # most of the ground lies beside the view, which shows without a division
    if max(abs(across), abs(up)) >= depth * lamp.tangent:
        return 1.0
    size = lamp.nearest.shape[0]
    inverse = 1.0 / depth
    scale = 0.5 * size / lamp.tangent * inverse
    u, v = scale * across + 0.5 * size - 0.5, 0.5 * size - 0.5 - scale * up
    if not (0 <= u < size - 1 and 0 <= v < size - 1):
        return 1.0
    i, j = int(u), int(v)
    fu, fv = u - i, v - j
    biased = inverse * (1.0 + bias * inverse)
    a = 1.0 if lamp.nearest[j, i] <= biased else 0.0
    b = 1.0 if lamp.nearest[j, i + 1] <= biased else 0.0
    c = 1.0 if lamp.nearest[j + 1, i] <= biased else 0.0
    d = 1.0 if lamp.nearest[j + 1, i + 1] <= biased else 0.0
    lit: float = (a + fu * (b - a)) * (1 - fv) + (c + fu * (d - c)) * fv
    return lit


@inlined
def _sky(height: float, place: KernelBackdrop) -> Triple:
    return mix(place.horizon, place.zenith, min(1.0, 1.6 * max(0.0, height)))


@inlined
def _grain(texture: Array, row: float, column: float) -> float:
    """Return the texel of a periodic texture, square, 2^k a side, in which a place lies."""
    last = texture.shape[0] - 1
    return float(texture[math.floor(row) & last, math.floor(column) & last])


@inlined
def _ground_albedo(place: KernelBackdrop, x: float, y: float, sharpness: float) -> Triple:
    # lines thinner than a pixel fade: sharpness is the inverse of a pixel's width on the ground
    u = place.ground_turn[0] * x - place.ground_turn[1] * y + place.ground_shift[0]
    v = place.ground_turn[1] * x + place.ground_turn[0] * y + place.ground_shift[1]
    fine = _grain(place.noise, v * 14.0, u * 14.0) * min(1.0, 0.05 * sharpness)
    shade = 1.0 + 0.22 * periodic(place.noise, v * 3.1, u * 3.1) + 0.3 * fine
    line = 0.0
    if place.ground == 0:  # asphalt: a dashed marking every 9 units
        across = abs(u - 9.0 * math.floor(u * (1 / 9.0) + 0.5))
        if across < 0.09 and v - 3.0 * math.floor(v * (1 / 3.0)) < 1.8:
            line = min(1.0, 0.18 * sharpness)
    elif place.ground == 3:  # grass
        shade += 0.35 * fine + 0.15 * periodic(place.noise, v * 0.9, u * 0.9)
    else:  # paving stones, brick in running bond, concrete slabs
        brick = place.ground == 2
        size = place.tile * (0.7 if brick else 1.0 if place.ground == 1 else 2.6)
        per_unit = 1 / size
        cv = v * 2 * per_unit if brick else v * per_unit
        iv = math.floor(cv)
        cu = u * per_unit + (0.5 * (iv & 1) if brick else 0.0)
        iu = math.floor(cu)
        if cu - iu < 0.05 * per_unit or cv - iv < (0.1 if brick else 0.05) * per_unit:
            line = 0.65 * min(1.0, 0.05 * sharpness)
        shade *= 1.0 + 0.3 * _grain(place.noise, iv * 23.7, iu * 37.3)
    return mix(scaled(place.ground_colour, max(0.2, shade)), place.joint_colour, line)


@inlined
def _slab(eye: float, inverse: float, low: float, high: float) -> tuple[float, float]:
    a, b = (low - eye) * inverse, (high - eye) * inverse
    return (a, b) if a < b else (b, a)


@inlined
def _inverse(part: float) -> float:
    # a part of a ray counts as no less than 1e-12
    return 1.0 / part if abs(part) > 1e-12 else 1e12


@inlined
def _building(
    eye: Triple, ray: Triple, reach: float, toward: Triple, place: KernelBackdrop
) -> tuple[float, Triple]:
    best, face, which = reach, -1, -1
    inverse = _inverse(ray[0]), _inverse(ray[1]), _inverse(ray[2])
    for b in range(place.buildings.shape[0]):
        box = place.buildings[b]
        x0, x1 = _slab(eye[0], inverse[0], box[0] - box[2], box[0] + box[2])
        y0, y1 = _slab(eye[1], inverse[1], box[1] - box[3], box[1] + box[3])
        z0, z1 = _slab(eye[2], inverse[2], 0.0, box[4])
        near = max(x0, y0, z0)
        if 0.0 < near < min(x1, y1, z1) and near < best:
            best, which = near, b
            face = 0 if near == x0 else 1 if near == y0 else 2
    if which < 0:
        return reach, (0.0, 0.0, 0.0)
    box = place.buildings[which]
    slope, along = 0.0, 0.0
    if face == 0:
        slope = -toward[0] if ray[0] > 0 else toward[0]
        along = eye[1] + best * ray[1] - box[1]
    elif face == 1:
        slope = -toward[1] if ray[1] > 0 else toward[1]
        along = eye[0] + best * ray[0] - box[0]
    else:
        slope = toward[2]
    column, storey = along / box[8] + 0.25, (eye[2] + best * ray[2]) / box[9]
    if face < 2 and column - math.floor(column) < 0.5 and 0.3 < storey - math.floor(storey) < 0.8:
        return best, plus((0.03, 0.04, 0.05), place.horizon, 0.2)
    light = _light(0.75 * max(0.0, slope), 1.2, place)
    return best, times((box[5], box[6], box[7]), light)


@inlined
def _ground(
    ray: Triple, x: float, y: float, width: float, lamp: Lamp, place: KernelBackdrop
) -> Triple:
    albedo = _ground_albedo(place, x, y, max(0.15, -ray[2]) / width)
    sun = _sunlit((x, y, 0.0), 0.03, lamp)
    toward = lamp.back
    glint = ray[0] * toward[0] + ray[1] * toward[1] - ray[2] * toward[2]
    glint = 1.5 * place.gloss * sun * _square(max(0.0, glint), 5)
    mirror = place.gloss * (0.04 + 0.96 * _square(1 + ray[2], 2))
    light = times(scaled(albedo, 1 - mirror), _light(sun * toward[2], 1.0, place))
    return plus(plus(light, place.horizon, mirror), SUN, glint)


@inlined
def _background(
    eye: Triple, ray: Triple, reach: float, step: float, lamp: Lamp, place: KernelBackdrop
) -> Triple:
    distance, colour = reach, (0.0, 0.0, 0.0)
    x, y = eye[0] + reach * ray[0], eye[1] + reach * ray[1]
    if x * x + y * y > 280.0:  # the plaza's radius squared
        distance, colour = _building(eye, ray, reach, lamp.back, place)
    if distance == reach:
        if reach == FAR_AWAY:
            return _sky(ray[2], place)
        colour = _ground(ray, x, y, reach * step, lamp, place)
    return mix(colour, place.horizon, min(0.45, max(0.0, (distance - 18.0) * (1 / 150))))


@inlined
def _surface(
    normal: Triple,
    ray: Triple,
    facing: float,
    sun: float,
    row: Row,
    toward: Triple,
    place: KernelBackdrop,
) -> Triple:
    """Light a point of the object as the eye sees it: Blinn-Phong and a mirrored place."""
    slope = sun * max(0.0, dot(normal, toward))
    half = _unit((toward[0] - ray[0], toward[1] - ray[1], toward[2] - ray[2] + 1e-9))
    peak = _square(max(0.0, dot(normal, half)), int(row[5])) * (row[6] * slope)
    mirrored = ray[2] + 2 * facing * normal[2]
    upward = 0.5 + 0.5 * normal[2]
    fresnel = 0.7 * _square(1 - min(1.0, max(0.0, facing)), 2)
    floor = times(place.ground_colour, _light(toward[2], 1.0, place))
    around = _sky(mirrored, place) if mirrored > 0 else floor
    metal = row[4]
    plain = row[3] * (1 - metal)
    tint = (
        plain + metal * 0.6 * min(1.0, 0.15 + row[0]),
        plain + metal * 0.6 * min(1.0, 0.15 + row[1]),
        plain + metal * 0.6 * min(1.0, 0.15 + row[2]),
    )
    matt = 1 - 0.5 * metal
    light = plus(_light(slope, upward, place), floor, 0.35 * (1 - upward))
    mirror = mix(tint, (1.0, 1.0, 1.0), fresnel)
    return (
        row[0] * matt * light[0] + 0.7 * mirror[0] * around[0] + tint[0] * peak * SUN[0],
        row[1] * matt * light[1] + 0.7 * mirror[1] * around[1] + tint[1] * peak * SUN[1],
        row[2] * matt * light[2] + 0.7 * mirror[2] * around[2] + tint[2] * peak * SUN[2],
    )


@inlined
def _glare(toward: float) -> float:
    veil = _square(max(0.0, toward), 3)
    return 0.12 * veil + 0.3 * _square(veil, 5)


@inlined
def _lit(
    camera: KernelCamera,
    u: float,
    v: float,
    face: int,
    share: Triple,
    row: Row,
    g: GBuffer,
    lamp: Lamp,
    place: KernelBackdrop,
) -> tuple[Triple, float]:
    """Light a face where `share`, depth and two barycentric coordinates, says; and how it faces."""
    depth, a, b = share
    plane, corners = g.planes[face], g.faces[face]
    c = 1.0 - a - b
    n0, n1, n2 = g.normals[corners[0]], g.normals[corners[1]], g.normals[corners[2]]
    normal = _unit(plus(plus(scaled(n0, a), n1, b), n2, c))
    if plane[9] < 0.0:  # an open surface from behind
        normal = scaled(normal, -1.0)
    ray = _ray(camera, u, v)
    point = plus(camera.eye, ray, depth)
    ray = _unit(ray)
    sun = _sunlit(plus(point, normal, 0.06), 0.05, lamp)
    facing = -dot(normal, ray)
    colour = _surface(normal, ray, facing, sun, row, lamp.back, place)
    return plus(colour, SUN, _glare(dot(ray, lamp.back))), facing


@inlined
def _object(
    camera: KernelCamera,
    u: float,
    v: float,
    face: int,
    g: GBuffer,
    lamp: Lamp,
    place: KernelBackdrop,
    materials: Array,
) -> Triple:
    share = barycentric(g.planes[face], u, v)
    row = materials[min(g.materials[face], materials.shape[0] - 1)]
    return _lit(camera, u, v, face, share, row, g, lamp, place)[0]


@inlined
def _skinned(
    camera: KernelCamera,
    u: float,
    v: float,
    face: int,
    g: GBuffer,
    lamp: Lamp,
    place: KernelBackdrop,
    materials: Array,
    skin: Skin,
) -> tuple[Triple, float]:
    """Light a face of a textured model; and how much of what is behind it is not seen."""
    plane = g.planes[face]
    share = barycentric(plane, u, v)
    surface = skin.materials[face]
    row = materials[surface]
    hue = filtered(plane, skin.faces[face], share, surface, SUPERSAMPLING, skin)
    red, green, blue = times((row[0], row[1], row[2]), hue)
    # no surface is pure black or white
    look = (0.02 + 0.9 * red, 0.02 + 0.9 * green, 0.02 + 0.9 * blue, row[3], row[4], row[5], row[6])
    light, facing = _lit(camera, u, v, face, share, look, g, lamp, place)
    opacity = skin.opacity[surface]
    if opacity < 1.0:  # glass mirrors more where it is seen at a flat angle
        opacity += (1.0 - opacity) * 0.7 * _square(1 - min(1.0, max(0.0, facing)), 2)
    return light, opacity


@inlined
def _goes_on(
    camera: KernelCamera, g: GBuffer, skin: Skin, face: int, row: int, column: int
) -> bool:
    """Say whether a sample's surface lies in a face's plane, by a third of a sample's width."""
    plane, inverse = g.planes[face], skin.nearest[row, column]
    there = plane[6] * (g.column + column + 0.5) + plane[7] * (g.row + row + 0.5) + plane[8]
    return bool(abs(there - inverse) < 0.35 * camera.step * inverse)


@inlined
def _skinned_pixel(
    i: int,
    j: int,
    camera: KernelCamera,
    g: GBuffer,
    lamp: Lamp,
    place: KernelBackdrop,
    materials: Array,
    skin: Skin,
) -> tuple[int, float, Triple]:
    """Light what a pixel shows of a textured model.

    Samples of one surface are lit once, even those of several faces, if it goes on evenly.

    It returns how many samples show it, how many, in parts, the place behind it has, and the light.
    """
    samples = SUPERSAMPLING * SUPERSAMPLING
    left, top = SUPERSAMPLING * i - g.column, SUPERSAMPLING * j - g.row
    covered, bare, sum_of_light, taken = 0, float(samples), (0.0, 0.0, 0.0), 0
    for s in range(samples):
        y, x = top + s // SUPERSAMPLING, left + s % SUPERSAMPLING
        face, pane = g.shown[y, x], skin.panes[y, x]
        if (taken >> s) & 1 or (face < 0 and pane < 0):
            continue
        count, own, u, v = 0, 0, 0, 0
        for t in range(s, samples):
            y, x = t // SUPERSAMPLING, t % SUPERSAMPLING
            other, glass = g.shown[top + y, left + x], skin.panes[top + y, left + x]
            if other == face and glass == pane:
                own, u, v = own + 1, u + x, v + y
            elif (
                max(pane, glass) >= 0
                or min(other, face) < 0
                or skin.materials[other] != skin.materials[face]
                or not _goes_on(camera, g, skin, face, top + y, left + x)
            ):
                continue
            count, taken = count + 1, taken | (1 << t)
        covered += count
        right, down = SUPERSAMPLING * i + u / own + 0.5, SUPERSAMPLING * j + v / own + 0.5
        through = 1.0
        for layer in range(2):
            drawn = pane if layer == 0 else face
            if drawn >= 0:
                light, opacity = _skinned(
                    camera, right, down, drawn, g, lamp, place, materials, skin
                )
                sum_of_light = plus(sum_of_light, light, through * opacity * count)
                through *= 1.0 - opacity
        bare -= (1.0 - through) * count
    return covered, bare, sum_of_light


@uncounted
def compose(
    image: Array,
    coverage: Array,
    camera: KernelCamera,
    lamp: Lamp,
    place: KernelBackdrop,
    g: GBuffer,
    materials: Array,
    tone: Array,
    rows: Array,
    skin: Skin | None = None,
) -> None:
    """Light every pixel; a face that several samples of one show is lit once, in their middle.

    It fills the image, (size, size, 3) uint8, and the coverage, (size, size) uint8: samples that
    the object covers. The camera is that of the samples; `materials`, (m, 7), are of `painted`, and
    `tone` of `tone_table`; `rows`, (3, size), hold what is computed of a row of pixels at a time.
    With a skin, `materials` are its surfaces; without one the machine code knows none.
    """
    size, samples = image.shape[0], SUPERSAMPLING * SUPERSAMPLING
    across_step = SUPERSAMPLING * camera.step
    across = scaled(camera.right, across_step)
    inverses, reaches, glares = rows[0], rows[1], rows[2]
    height, width = g.shown.shape
    scale = (TONE_STEPS - 1) / TONE_WHITE / samples
    for j in range(size):
        top = SUPERSAMPLING * j - g.row
        start = _ray(camera, 0.5 * SUPERSAMPLING, SUPERSAMPLING * (j + 0.5))
        for i in range(size):
            ray = plus(start, across, i)
            inverses[i] = 1.0 / math.sqrt(dot(ray, ray))
        for i in range(size):
            reach = -camera.eye[2] / (inverses[i] * (start[2] + i * across[2]))
            reaches[i] = reach if 0.0 < reach < FAR_AWAY else FAR_AWAY
        facing, turn = dot(start, lamp.back), dot(across, lamp.back)
        for i in range(size):
            glares[i] = _glare(inverses[i] * (facing + i * turn))
        for i in range(size):
            left = SUPERSAMPLING * i - g.column
            covered, red, green, blue = 0, 0.0, 0.0, 0.0
            bare = float(samples)
            if 0 <= left < width and 0 <= top < height:
                if skin is not None:
                    covered, bare, (red, green, blue) = _skinned_pixel(
                        i, j, camera, g, lamp, place, materials, skin
                    )
                else:
                    for s in range(samples):
                        face = g.shown[top + s // SUPERSAMPLING, left + s % SUPERSAMPLING]
                        if face < 0:
                            continue
                        count, u, v = 0, 0, 0
                        for t in range(samples):
                            y, x = t // SUPERSAMPLING, t % SUPERSAMPLING
                            if g.shown[top + y, left + x] == face:
                                if t < s:
                                    break
                                count, u, v = count + 1, u + x, v + y
                        if count == 0:
                            continue
                        covered += count
                        right = SUPERSAMPLING * i + u / count + 0.5
                        down = SUPERSAMPLING * j + v / count + 0.5
                        light = _object(camera, right, down, face, g, lamp, place, materials)
                        red, green, blue = plus((red, green, blue), light, count)
                    bare -= covered
            if bare > 0.0:
                ray = scaled(plus(start, across, i), inverses[i])
                light = _background(camera.eye, ray, reaches[i], across_step, lamp, place)
                light = plus(light, SUN, glares[i])
                red, green, blue = plus((red, green, blue), light, bare)
            coverage[j, i] = covered
            image[j, i, 0] = tone[min(int(red * scale + 0.5), TONE_STEPS - 1)]
            image[j, i, 1] = tone[min(int(green * scale + 0.5), TONE_STEPS - 1)]
            image[j, i, 2] = tone[min(int(blue * scale + 0.5), TONE_STEPS - 1)]

"""What cameras, weather and scenes do to pixels: images are (height, width, 3) uint8 in sRGB.

Nothing here keeps a state: what is random follows from the generator that is given. OpenCV does the
filtering, coding and drawing. Lengths among the values are shares of an image's longer side.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from sada_gym.foundations.arrays import Bytes, Floats, Floats32
from sada_gym.foundations.compiled import kernel

Values = tuple[float, ...]
"""The values of a condition's parameters."""

Table = npt.NDArray[np.uint8]
"""What becomes of each value in each channel, (256, 3)."""

FULL_WELL = 10_000.0
"""Electrons of a white pixel at ISO 100, and the noise of reading one: a small sensor's."""
READ_NOISE = 3.0
SCENE_M = 30.0
"""How far away everything is in fog."""
AIR_LIGHT = 0.7
"""What fog of no visibility looks like, in linear light."""
_KOSCHMIEDER = 3.912  # the contrast that is still visible is 2 %
_NORMALS = 2**20 + 7  # no multiple of a row, so that repetitions do not show
_BLOCK = 1_024
_GREY = 0.18
_BLACK, _WHITE, _BROWN = np.array([(0, 0, 0), (255, 255, 255), (70, 60, 50)], np.float32)
_LONGEST_LINE = 11  # longer kernels are slower by a Fourier transform


def linear(values: npt.ArrayLike) -> Floats:
    """Return sRGB values in [0, 1] as linear light (IEC 61966-2-1)."""
    given = np.asarray(values, np.float64)
    light: Floats = np.where(given <= 0.04045, given / 12.92, ((given + 0.055) / 1.055) ** 2.4)
    return light


def encoded(light: npt.ArrayLike) -> Floats:
    """Return linear light, clipped to [0, 1], as sRGB: the inverse of `linear`."""
    given = np.clip(np.asarray(light, np.float64), 0.0, 1.0)
    values: Floats = np.where(
        given <= 0.0031308, 12.92 * given, 1.055 * given ** (1.0 / 2.4) - 0.055
    )
    return values


@cache
def _light() -> Floats:
    return linear(np.arange(256) / 255.0)[:, None].repeat(3, axis=1)


def _table(light: Floats) -> Table:
    return np.rint(255.0 * encoded(light)).astype(np.uint8)


def chained(first: Table, second: Table) -> Table:
    """Make one table of two."""
    return np.take_along_axis(second, first.astype(np.intp), axis=0)


def exposed(stops: float) -> Table:
    """Expose by so many stops (EV) more."""
    return _table(_light() * 2.0**stops)


def lit(kelvin: float) -> Table:
    """Light a scene with another colour temperature than the white balance of 6,500 K is for.

    Colours are those of a black body, by the matching functions of Wyman et al. (JCGT 2013); green
    stays as it is.
    """
    gains = _black_body(kelvin) / _black_body(6_500.0)
    return _table(_light() * (gains / gains[1]))


def _black_body(kelvin: float) -> Floats:
    nm = np.arange(380.0, 781.0, 5.0)

    def lobe(middle: float, below: float, above: float) -> Floats:
        width = np.where(nm < middle, below, above)
        shape: Floats = np.exp(-0.5 * ((nm - middle) * width) ** 2)
        return shape

    matching = np.stack(
        [
            0.362 * lobe(442.0, 0.0624, 0.0374)
            + 1.056 * lobe(599.8, 0.0264, 0.0323)
            - 0.065 * lobe(501.1, 0.0490, 0.0382),
            0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322),
            1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725),
        ]
    )
    radiance = (nm / 560.0) ** -5.0 / np.expm1(1.4388e7 / (nm * kelvin))
    to_rgb = np.array(
        [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
    )
    colour: Floats = np.maximum(to_rgb @ (matching @ radiance), 1e-12)
    return colour


def contrasted(factor: float) -> Table:
    """Change the contrast around middle grey, as an image's processing does: in sRGB."""
    middle = encoded(_GREY)
    values = np.clip(middle + factor * (np.arange(256) / 255.0 - middle), 0.0, 1.0)
    return np.rint(255.0 * values).astype(np.uint8)[:, None].repeat(3, axis=1)


def fogged(visibility_m: float) -> Table:
    """Put fog before a scene that is `SCENE_M` away (Koschmieder's law)."""
    clear = np.exp(-_KOSCHMIEDER * SCENE_M / visibility_m)
    return _table(_light() * clear + AIR_LIGHT * (1.0 - clear))


def defocused(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Blur by a circle of confusion of a radius: the Gaussian of the same variance."""
    import cv2

    (radius,) = values
    blurred: Bytes = cv2.GaussianBlur(image, (0, 0), radius * max(image.shape) / 2.0)
    return blurred


def moved(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Blur along a line of a length and a direction; 0 deg is to the right, 90 deg downwards.

    A long line is the mean of two halves, which is the same and faster.
    """
    import cv2

    length, angle, halves = values[0] * max(image.shape), np.radians(values[1]), 0
    while length > _LONGEST_LINE - 2:
        length, halves = length / 2.0, halves + 1
    step = np.array([np.cos(angle), np.sin(angle)])
    kernel = np.zeros((_LONGEST_LINE, _LONGEST_LINE), np.float32)
    samples = 64
    for along in (np.arange(samples) + 0.5) / samples - 0.5:
        x, y = _LONGEST_LINE // 2 + along * length * step
        column, row = int(x), int(y)
        right, down = x - column, y - row
        kernel[row, column] += (1 - right) * (1 - down)
        kernel[row, column + 1] += right * (1 - down)
        kernel[row + 1, column] += (1 - right) * down
        kernel[row + 1, column + 1] += right * down
    blurred: Any = cv2.filter2D(image, -1, kernel / samples, borderType=cv2.BORDER_REFLECT_101)
    for _half in range(halves):
        x, y = (round(float(part)) for part in length * step)
        blurred = cv2.addWeighted(blurred, 0.5, _shifted(blurred, x, y), 0.5, 0.0)
        length *= 2.0
    result: Bytes = blurred
    return result


def _shifted(image: Any, x: int, y: int) -> Any:
    import cv2

    border = max(abs(x), abs(y))
    wide = cv2.copyMakeBorder(image, border, border, border, border, cv2.BORDER_REFLECT_101)
    rows, columns = image.shape[:2]
    return wide[border + y : border + y + rows, border + x : border + x + columns]


@cache
def _normals() -> Floats32:
    """Normal numbers that noise is made of; drawing new ones would take ten times as long."""
    drawn = np.random.default_rng(0).standard_normal(_NORMALS, np.float32)
    drawn.flags.writeable = False
    return drawn


def noisy(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Add the shot noise and the read noise of a sensor at an ISO (EMVA 1288's linear model)."""
    electrons = FULL_WELL * 100.0 / values[0]
    light = _light()[:, 0]
    deviation = np.sqrt(light / electrons + (READ_NOISE / electrons) ** 2)
    slope = np.gradient(np.arange(256) / 255.0, light)
    scale = np.minimum(255.0 * deviation * slope, 255.0).astype(np.float32)
    return _with_noise(image, scale, _normals(), int(rng.integers(_NORMALS)))


@kernel
def _with_noise(image: Bytes, scale: Floats32, normals: Floats32, first: int) -> Bytes:
    result = np.empty_like(image)
    given, noisy = image.reshape(-1), result.reshape(-1)
    deviations = np.empty(_BLOCK, np.float32)
    begin = 0
    while begin < len(given):
        count = min(_BLOCK, len(given) - begin, len(normals) - first)
        values, normal = given[begin : begin + count], normals[first : first + count]
        for i in range(count):  # looked up beforehand, the rest is computed many at a time
            deviations[i] = scale[values[i]]
        for i in range(count):
            value = np.float32(values[i]) + deviations[i] * normal[i]
            noisy[begin + i] = np.uint8(
                np.int32(min(max(value, np.float32(0.0)), np.float32(255.0)) + np.float32(0.5))
            )
        begin, first = begin + count, (first + count) % len(normals)
    return result


def compressed(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Write an image as JPEG of a quality (libjpeg's scale), and read it again."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, round(values[0])]
    _done, file = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    decoded: Any = cv2.imdecode(file, cv2.IMREAD_COLOR_RGB)
    read: Bytes = decoded
    return read


def coarser(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Take a share of the pixels a side, and enlarge the image to its size again."""
    import cv2

    (factor,), (rows, columns) = values, image.shape[:2]
    size = max(1, round(columns * factor)), max(1, round(rows * factor))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    large: Bytes = cv2.resize(small, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return large


def dead_rows(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Lose a share of an image's rows: they are black."""
    rows = rng.permutation(len(image))[: round(values[0] * len(image))]
    result = image.copy()
    result[rows] = 0
    return result


def rained(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Draw streaks of rain, 15 a mm/h on 640 px, slanted alike; more rain adds streaks."""
    import cv2

    (mm_h,), (rows, columns) = values, image.shape[:2]
    slant, count = rng.uniform(-0.3, 0.3), round(15.0 * mm_h * columns * rows / (640 * 480))
    drawn = rng.random((count, 3))
    streaks = np.zeros((rows, columns), np.uint8)
    lengths = (0.02 + 0.05 * drawn[:, 2]) * rows
    starts = drawn[:, :2] * (columns * 1.2, rows * 1.1) - (0.1 * columns, 0.05 * rows)
    ends = starts + np.stack([slant * lengths, lengths], axis=1)
    lines = np.rint(np.stack([starts, ends], axis=1)).astype(np.int32)
    thickness = max(1, round(columns / 640))
    cv2.polylines(streaks, [*lines], isClosed=False, color=90, thickness=thickness)
    streaks = cv2.blur(streaks, (thickness, 3 * thickness))
    result: Bytes = cv2.add(image, cv2.cvtColor(streaks, cv2.COLOR_GRAY2RGB))
    return result


def snowed(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Draw flakes of snow, 150 a mm/h of water on 640 px; more snow adds flakes."""
    import cv2

    (mm_h,), (rows, columns) = values, image.shape[:2]
    count = round(150.0 * mm_h * columns * rows / (640 * 480))
    drawn = rng.random((count, 3))
    flakes = np.zeros((rows, columns), np.uint8)
    radii = np.rint((0.5 + 3.0 * drawn[:, 2] ** 3) * columns / 640).astype(int)
    for x, y, radius in zip(drawn[:, 0] * columns, drawn[:, 1] * rows, radii, strict=True):
        cv2.circle(flakes, (int(x), int(y)), int(radius), 230, -1)
    flakes = cv2.blur(flakes, (3, 3))
    result: Bytes = cv2.max(image, cv2.cvtColor(flakes, cv2.COLOR_GRAY2RGB))
    return result


def sunlit(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Let a low sun shine into the lens: its strength, and its place at the upper edge, -1 to 1.

    With strength 1 its surroundings are white, and a quarter of that light veils the rest.
    """
    import cv2

    (strength, place), (rows, columns) = values, image.shape[:2]
    y, x = np.mgrid[0.0:1.0:48j, -1.0:1.0:64j]
    away = np.hypot(x - place, 0.75 * y)
    light = strength * (1.5 * np.exp(-6.0 * away) + 0.25)
    glare = cv2.resize(np.rint(255.0 * encoded(light)).astype(np.uint8), (columns, rows))
    # the two images' screen: nearly their sum in linear light, and never above white
    return _painted(image, glare, _WHITE)


def shaded(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Lay a shadow's edge over an image: by how many stops it is darker, and its place, -1 to 1.

    The seed turns the edge.
    """
    import cv2

    (stops, place), (rows, columns) = values, image.shape[:2]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    y, x = np.mgrid[-0.75:0.75:96j, -1.0:1.0:128j]
    beyond = np.clip(20.0 * (x * np.cos(angle) + y * np.sin(angle) - place) + 0.5, 0.0, 1.0)
    kept = 1.0 - beyond * (1.0 - 2.0 ** (-stops / 2.2))
    mask = cv2.resize(np.rint(255.0 * kept).astype(np.uint8), (columns, rows))
    return _painted(image, ~mask, _BLACK)


def dirtied(image: Bytes, values: Values, rng: np.random.Generator) -> Bytes:
    """Put dirt on about a share of the lens: brown blotches without sharp edges."""
    import cv2

    (share,), (rows, columns) = values, image.shape[:2]
    field = cv2.GaussianBlur(rng.random((24, 32)), (0, 0), 1.5)
    level = np.quantile(field, 1.0 - share)
    cover = np.clip(0.5 + (field - level) / (0.5 * field.std()), 0.0, 1.0)
    mask = cv2.resize(np.rint(230.0 * cover).astype(np.uint8), (columns, rows))
    return _painted(image, mask, _BROWN)


@kernel
def _painted(image: Bytes, mask: Any, colour: Floats32) -> Bytes:
    """Let a colour, (3,), cover an image where a mask, (height, width) uint8, is 255."""
    rows, columns = mask.shape
    result = np.empty_like(image)
    clear, paint = np.empty(3 * columns, np.float32), np.empty(3 * columns, np.float32)
    half, full = np.float32(0.5), np.float32(1.0 / 255.0)
    for row in range(rows):
        for column in range(columns):
            for channel in range(3):
                cover = np.float32(mask[row, column])
                clear[3 * column + channel] = np.float32(255.0) - cover
                paint[3 * column + channel] = colour[channel] * cover
        given, painted = image[row].reshape(-1), result[row].reshape(-1)
        for i in range(3 * columns):
            shown = np.int32(np.float32(given[i]) * clear[i] * full + half)
            painted[i] = np.uint8(shown + np.int32(paint[i] * full + half))
    return result


def occluder(size: float, x: float, y: float, columns: int, rows: int) -> tuple[int, ...]:
    """Return the box x0 y0 x1 y1 in px of a square before the lens.

    `size` is its side as a share of the longer side; x and y, -1 to 1, are where its middle is.
    """
    half = 0.5 * size * max(columns, rows)
    middle = 0.5 * (1.0 + np.array([x, y])) * (columns, rows)
    ends = np.concatenate([middle - half, middle + half])
    return tuple(map(round, ends.clip(0, (columns, rows, columns, rows)).tolist()))


def occluded(image: Bytes, values: Values, _: np.random.Generator) -> Bytes:
    """Hold a grey square before the lens, see `occluder`."""
    rows, columns = image.shape[:2]
    size, x, y = values
    x0, y0, x1, y1 = occluder(size, x, y, columns, rows)
    result = image.copy()
    result[y0:y1, x0:x1] = 96
    return result
